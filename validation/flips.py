"""By how little a single decision of a pixel could change: margins from truth itself, and the numbers that flip it.

The quantity g of a decision is differentiated by every number x of the scene and by the pixel's ray, along the path
that the pixel takes. To first order a relative change delta of all of them moves g by delta (sum |x dg/dx| + |d|
|dg/dd|) at most, so g reaches 0 at the margin |g| / (...), and there are numbers and a ray, all changed by the margin,
where it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from flint import arb, ctx, fmpq

from validation.follow import KINDS, Key, rational
from validation.truth import Ball, Prover, Truth

#: Differences are taken over this relative step, with balls of four times its bits: derivatives keep 60 digits.
STEP_BITS = 256
WIDE = 4 * STEP_BITS
#: The ray is turned by a little less than it may be: its length and direction are rounded.
ROUNDED = 1 - 2.0**-40


@dataclass(frozen=True)
class Flip:
    """A decision of a pixel, and how its quantity comes to 0.

    `sign`: what it is, `other`: what it would be; of a tie either way is a flip of its own. `margin`: the relative
    change of the ray and of every number of the scene that takes it there, to first order; 0 for a tie, inf where
    nothing does. `signs`: by name of a number, which way to change it, -1 to 1. `turn`: the unit vector along which
    to change the ray. `moves`: how far the quantity goes with such a change of 1.
    """

    key: Key
    sign: int
    other: int
    margin: float
    signs: Mapping[str, float]
    turn: tuple[float, float, float]
    moves: float = 0.0

    @property
    def kind(self) -> str:
        """The kind of margin."""
        return KINDS[self.key.what]

    @property
    def forced(self) -> int:
        """The sign to force for the decision to be taken otherwise: a ray that comes to a sphere touches it first."""
        return 0 if self.key.what == "meets" and self.other > 0 else self.other


def flips(prover: Prover, x: int, y: int, forced: Mapping[Key, int] | None = None) -> list[Flip]:
    """Every decision of a pixel, those with the smallest margins first.

    `forced`: decisions that are taken otherwise on the way.
    """
    before = ctx.prec
    try:
        return sorted(_flips(prover, x, y, forced or {}), key=lambda flip: flip.margin)
    finally:
        ctx.prec = before


def sensitivity(prover: Prover, x: int, y: int) -> dict[str, tuple[float, ...]]:
    """How much each channel of each pass moves with a relative change of all numbers and the ray, to first order.

    The sum |x dv/dx| over every number, colours too, and |d| |dv/dd|; inf where a derivative is not finite.
    """
    before = ctx.prec
    try:
        signs = prover.signs(x, y)
        values = _finite(prover.raw(x, y, forced=signs, bits=WIDE))

        def moved(changed: Prover) -> dict[str, tuple[arb, ...]]:
            return _finite(changed.raw(x, y, forced=signs, bits=WIDE))

        by_number, by_axis = _slopes(prover, values, moved, geometric=False)
        length = _length(prover, x, y)
        return {
            name: tuple(
                sum(abs(_number(slope[name][k])) for slope in by_number.values())
                + length * math.hypot(*(_number(slope[name][k]) for slope in by_axis))
                for k in range(len(channels))
            )
            for name, channels in values.items()
        }
    finally:
        ctx.prec = before


def _finite(raw: Mapping[str, tuple[Any, ...]]) -> dict[str, tuple[arb, ...]]:
    """The passes that numbers move."""
    return {
        name: tuple(arb(value) if isinstance(value, int) else value for value in channels)
        for name, channels in raw.items()
        if name != "id" and not any(isinstance(value, Ball) for value in channels)
    }


_Values = TypeVar("_Values", dict[Key, arb], dict[str, tuple[arb, ...]])


def _slopes(
    prover: Prover, values: _Values, moved: Callable[[Prover], _Values], *, geometric: bool
) -> tuple[dict[str, _Values], list[_Values]]:
    """Derivatives by the logarithm of every number, and by the ray's three coordinates."""
    numbers = prover.numbers
    step = fmpq(1, 1 << STEP_BITS)
    scale = arb(2) ** STEP_BITS

    def slope(changed: Prover) -> _Values:
        found: Any = moved(changed)
        ctx.prec = WIDE
        result: Any = {}
        for key, value in values.items():
            after = found[key]
            if isinstance(value, tuple):
                result[key] = tuple((b - a) * scale for a, b in zip(value, after, strict=True))
            else:
                result[key] = (after - value) * scale
        return result  # type: ignore[no-any-return]

    by_number = {
        name: slope(prover.with_numbers(numbers.changed({name: step})))
        for name, value in numbers.of.items()
        if value != 0 and (_geometric(name) or not geometric)
    }
    axes = [(step, fmpq(0), fmpq(0)), (fmpq(0), step, fmpq(0)), (fmpq(0), fmpq(0), step)]
    return by_number, [slope(prover.with_numbers(numbers, axis)) for axis in axes]


def _flips(prover: Prover, x: int, y: int, forced: Mapping[Key, int]) -> Iterator[Flip]:
    # Decisions of a change so small are those of the exact numbers, and ties stay ties.
    signs = prover.signs(x, y, forced=forced)

    def moved(changed: Prover) -> dict[Key, arb]:
        return changed.examine(x, y, forced=signs, bits=WIDE)[1]

    quantities = moved(prover)
    by_number, by_axis = _slopes(prover, quantities, moved, geometric=True)
    length = _length(prover, x, y)
    for key, value in quantities.items():
        if key.what == "at":
            continue
        gradient = [_number(slope[key]) for slope in by_axis]
        across = math.hypot(*gradient)
        derivative = {name: _number(slope[key]) for name, slope in by_number.items()}
        moves = sum(map(abs, derivative.values())) + length * across
        sign = signs[key]
        margin = 0.0 if sign == 0 else abs(_number(value)) / moves if 0 < moves < math.inf else math.inf
        # A tie can go both ways.
        for way in (sign,) if sign else (1, -1):
            change = {name: -int(math.copysign(1, entry)) * way for name, entry in derivative.items() if entry}
            turn = [-way * entry / across if across else 0.0 for entry in gradient]
            yield Flip(key, sign, -way, margin, change, (turn[0], turn[1], turn[2]), moves)


def _geometric(name: str) -> bool:
    """Whether a number is one that decisions depend on: a length."""
    return name.startswith("view.") or ".position." in name or ".scaling." in name


def _length(prover: Prover, x: int, y: int) -> float:
    """Of the direction of a pixel's ray."""
    return math.hypot(*(float(arb(entry)) for entry in prover.direction(x, y)))


def _number(value: arb) -> float:
    return float(value.mid())


def changed(prover: Prover, x: int, y: int, flip: Flip, delta: float) -> Prover:
    """The same scene with every number and the pixel's ray changed by a relative `delta`, the way a decision flips.

    A negative `delta` changes them the other way.
    """
    step = rational(delta)
    relative = {name: rational(float(sign)) * step for name, sign in flip.signs.items()}
    length = _length(prover, x, y)
    along = [rational(component * length * delta * ROUNDED) for component in flip.turn]
    return prover.with_numbers(prover.numbers.changed(relative), (along[0], along[1], along[2]))


def flipped(prover: Prover, x: int, y: int, flip: Flip, forced: Mapping[Key, int] | None = None) -> Truth:
    """The pixel with that decision taken the other way."""
    return prover.pixel(x, y, forced={**(forced or {}), flip.key: flip.forced}, ties=False)
