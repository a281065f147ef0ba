"""Proves the colours of single pixels: balls that hold the exact values of the specification for a scene's numbers.

Every decision of a pixel is the sign of a number that `validation.follow` asks for. A ball that does not hold 0 decides
it; else the precision doubles; else the sign is worked out exactly (`validation.exact`), so a tie is proved and not
guessed.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from flint import arb, ctx, fmpq
from flint.utils.flint_exceptions import FlintError

from validation.exact import BUDGET, Lazy, TooLargeError, Tower
from validation.follow import SETTLED, Follower, Hit, Key, Numbers, Structure, Tables, Vector, add, rational, sign_of
from validation.renderers import Settings

if TYPE_CHECKING:
    from tracer import Scene

#: Balls begin with this many bits; where a decision or a value is not certain enough they get twice as many.
BITS = 128
#: A decision that this many bits do not settle is worked out exactly, beside balls of four times as many.
EXACT_FROM = 4096
#: No pixel gets more bits than this.
MOST_BITS = 1 << 16
#: Seconds that the end of a pool may take; without trouble it takes none.
PATIENCE = 10
#: The largest radius of a ball that is returned, relative above 1.
RADIUS = 1e-30
#: The smallest float64.
TINY = 2.0**-1074


class Ball(NamedTuple):
    """A real number: middle = mantissa 2^exponent, exactly, and an upper bound of the distance from it.

    `mantissa` None stands for infinity, the depth where nothing is hit.
    """

    mantissa: int | None
    exponent: int
    radius: float

    @staticmethod
    def of(value: arb) -> Ball:
        """The same ball; what no float64 can tell from 0 is 0, as (R.V)^n may have more zeros than a machine holds."""
        if not value.abs_upper() > TINY:
            return Ball(0, 0, 0.0 if value == 0 else TINY)
        mantissa, exponent = value.mid().man_exp()
        # A radius has 30 bits, so that only underflow changes it.
        radius = float(value.rad())
        if radius < sys.float_info.min and not value.is_exact():
            radius = math.nextafter(radius, math.inf)
        return Ball(int(mantissa), int(exponent), radius)

    def arb(self) -> arb:
        """As a ball of python-flint."""
        if self.mantissa is None:
            return arb.pos_inf()
        return arb((self.mantissa, self.exponent), self.radius)

    @property
    def value(self) -> float:
        """The float64 nearest to the middle."""
        if self.mantissa is None:
            return math.inf
        try:
            if self.exponent >= 0:
                return float(self.mantissa << self.exponent)
            return self.mantissa / (1 << -self.exponent)
        except OverflowError:
            return math.copysign(math.inf, self.mantissa)

    def contains(self, value: Any) -> bool:
        """Whether a number (an int, float or rational) lies in the ball."""
        if self.mantissa is None:
            return bool(value == math.inf)
        rational = fmpq(*value.as_integer_ratio()) if isinstance(value, float) else fmpq(value)
        return bool(abs(rational - self.middle()) <= fmpq(*self.radius.as_integer_ratio()))

    def middle(self) -> fmpq:
        """The middle of a finite ball."""
        assert self.mantissa is not None
        return fmpq(self.mantissa) * fmpq(2) ** self.exponent

    def error(self, value: float) -> float:
        """How far a float is from the exact value at most: nan for nan."""
        if self.mantissa is None or not math.isfinite(value):
            return 0.0 if value == self.value else abs(value - self.value)
        distance = abs(fmpq(*value.as_integer_ratio()) - self.middle()) + fmpq(*self.radius.as_integer_ratio())
        p, q = int(distance.p), int(distance.q)
        return math.nextafter(p / q, math.inf) if p else 0.0


INFINITE = Ball(None, 0, 0.0)


@dataclass(frozen=True)
class Tie:
    """A decision whose quantity is exactly 0, or that could not be told from 0.

    `settled`: the sentence of the specification that decides it, "" where none does. `outcomes`: what the pixel may be:
    `beauty` of every way to decide that is not settled, as float64; one entry where it makes no difference. `proved`:
    whether all that is told here is certain.
    """

    key: Key
    settled: str
    outcomes: tuple[tuple[float, float, float], ...]
    proved: bool = True


@dataclass(frozen=True)
class Truth:
    """What the specification says about one pixel.

    `values`: by name of the pass one ball a channel. `bits`: the precision at which everything was certain.
    """

    x: int
    y: int
    id: int
    values: Mapping[str, tuple[Ball, ...]]
    ties: tuple[Tie, ...]
    bits: int


class UncertainError(ArithmeticError):
    """A ball that holds 0 does not tell a sign."""

    def __init__(self, key: Key) -> None:
        """`key` is the decision."""
        super().__init__(key)
        self.key = key


class UnprovedError(ArithmeticError):
    """A pixel whose value could not be had at any precision; the text says where."""


#: What truth that cannot be had ends in: no precision is enough, or a forced decision leads to the root of a negative
#: number or to a division by 0.
NOWHERE = (ArithmeticError, FlintError)


@dataclass
class Allowance:
    """What exact work may take, in bits of sums and products: see `exact.BUDGET`."""

    left: int = BUDGET

    def restore(self) -> None:
        """As at first."""
        self.left = BUDGET


class _Signs:
    """Signs of balls; those known already, and those that are to be otherwise, by their keys."""

    def __init__(self, known: Mapping[Key, int], forced: Mapping[Key, int], watch: dict[Key, Any] | None) -> None:
        self.known, self.forced, self.watch = known, forced, watch
        self.ties: list[Key] = []

    def quick(self, value: arb, *key: Any) -> int:
        """Nothing but the sign."""
        if value > 0:
            return 1
        if value < 0:
            return -1
        return self.hard(Key(*key))

    def hard(self, key: Key) -> int:
        """A ball that holds 0."""
        sign = self.known.get(key)
        if sign is None:
            raise UncertainError(key)
        if sign == 0:
            self.ties.append(key)
        return sign

    def careful(self, value: arb, *key: Any) -> int:
        """The sign, told to whoever watches, and the forced one where there is one."""
        name = Key(*key)
        if self.watch is not None:
            self.watch[name] = value
        if name in self.forced:
            return self.forced[name]
        return self.quick(value, *key)


@dataclass
class _Path:
    """A pixel's ray, followed."""

    bits: int  # that were enough for its decisions
    follower: Follower
    hits: list[Hit]
    ties: tuple[Key, ...]
    unproved: set[Key]


class Prover:
    """Proves pixels of a scene.

    Balls take their precision from a setting that all of python-flint shares: one thread at a time.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings | None = None,
        *,
        follower: type[Follower] = Follower,
        numbers: Numbers | None = None,
        structure: Structure | None = None,
        turn: tuple[fmpq, fmpq, fmpq] | None = None,
        allowance: Allowance | None = None,
    ) -> None:
        """`follower`: another rule than the specification's; `numbers`, `structure`: instead of the scene's own.

        `turn` is added to the direction of every pixel's ray. `allowance`: what exact work may take over all questions,
        in the place of one for each.
        """
        self.scene, self.settings = scene, settings or Settings()
        self.numbers = numbers or Numbers.exact(scene)
        self.structure = structure or Structure.of(self.numbers, scene.distinct, len(scene.lights))
        self.follower, self.turn = follower, turn
        self.forced: Mapping[Key, int] = {}
        self._tables: dict[int, Tables] = {}
        self._shared = allowance
        self._allowance = allowance or Allowance()

    def direction(self, x: int, y: int) -> tuple[fmpq, fmpq, fmpq]:
        """The ray of a pixel, exactly: column x, row y."""
        view, of, sample = self.scene.view, self.numbers.of, self.settings.sample
        halves = {"corner": (0, 0), "center": (1, 1), "bottom-left": (0, 2), "top-right": (2, 0), "inclusive": (0, 0)}
        over, down = halves[sample]
        wide, high = view.columns, view.rows
        if sample == "inclusive":
            wide, high = max(wide - 1, 1), max(high - 1, 1)
        left, right, bottom, top = (of[f"view.{side}"] for side in ("left", "right", "bottom", "top"))
        across = left + (right - left) * fmpq(2 * x + over, 2 * wide)
        up = top - (top - bottom) * fmpq(2 * y + down, 2 * high)
        turn = self.turn or (fmpq(0),) * 3
        return across + turn[0], up + turn[1], turn[2] - of["view.near"]

    def pixel(self, x: int, y: int, *, forced: Mapping[Key, int] | None = None, ties: bool = True) -> Truth:
        """Every pass of column x, row y.

        `forced`: decisions to take otherwise, with the sign to take; `ties` False: without their outcomes.

        Raises:
            IndexError: there is no such pixel.
            UnprovedError: no precision was enough.
        """
        if not (0 <= x < self.scene.view.columns and 0 <= y < self.scene.view.rows):
            raise IndexError(f"there is no pixel {x} {y} in {self.scene.view.columns}x{self.scene.view.rows}")
        with self._question():
            return self._prove(x, y, {**self.forced, **(forced or {})}, ties)

    def raw(
        self, x: int, y: int, *, forced: Mapping[Key, int] | None = None, bits: int = 2 * BITS
    ) -> dict[str, tuple[Any, ...]]:
        """Every pass in balls of that many bits, however wide they come out."""
        with self._question():
            return self._raw(self._follow(x, y, bits, {}, {**self.forced, **(forced or {})}, None))

    def examine(
        self, x: int, y: int, *, forced: Mapping[Key, int] | None = None, bits: int = 2 * BITS
    ) -> tuple[list[Hit], dict[Key, arb]]:
        """The hits of a pixel with every sphere that hides a light, and every decision with its quantity: balls."""
        watch: dict[Key, arb] = {}
        with self._question():
            return self._follow(x, y, bits, {}, {**self.forced, **(forced or {})}, watch).hits, watch

    def signs(self, x: int, y: int, *, forced: Mapping[Key, int] | None = None) -> dict[Key, int]:
        """Every decision of a pixel with its sign, exactly."""
        watch: dict[Key, arb] = {}
        known: dict[Key, int] = {}
        taken = {**self.forced, **(forced or {})}
        with self._question():
            self._follow(x, y, BITS, known, taken, watch)
            return {key: taken.get(key, known.get(key, sign_of(value))) for key, value in watch.items()}

    def with_numbers(self, numbers: Numbers, turn: tuple[fmpq, fmpq, fmpq] | None = None) -> Prover:
        """The same scene, by its structure, with other numbers; `turn` is added to that of every ray."""
        if self.turn is not None and turn is not None:
            turn = self.turn[0] + turn[0], self.turn[1] + turn[1], self.turn[2] + turn[2]
        other = Prover(
            self.scene,
            self.settings,
            follower=self.follower,
            numbers=numbers,
            structure=self.structure,
            turn=turn or self.turn,
            allowance=self._shared,
        )
        other.forced = self.forced
        return other

    def forcing(self, forced: Mapping[Key, int]) -> Prover:
        """The same, with decisions that are taken otherwise: the sign to take."""
        other = self.with_numbers(self.numbers)
        other.forced = {**self.forced, **forced}
        return other

    def crossings(self, hit: Hit, light: int, sphere: int) -> tuple[arb, ...]:
        """Where the line from a hit that `examine` found to a light meets a sphere: t of both roots, or nothing.

        t is 0 at the hit and 1 at the light, exactly where the hit or the light lies on the sphere.
        """
        with self._question():
            ctx.prec = 2 * BITS
            tables = self._at(ctx.prec)
            to_light = [a - b for a, b in zip(tables.light[light], hit.point, strict=True)]
            m = [a - b for a, b in zip(hit.point, tables.position[sphere], strict=True)]
            A = sum(w * d * d for w, d in zip(tables.w[sphere], to_light, strict=True))
            B = sum(w * a * d for w, a, d in zip(tables.w[sphere], m, to_light, strict=True))
            C = sum(w * a * a for w, a in zip(tables.w[sphere], m, strict=True)) - 1
            on = tables.side[sphere, light] == 0
            if sphere == hit.sphere:
                roots = (arb(0), arb(1) if on else -2 * B / A)
            elif on:
                roots = (arb(1), C / A)
            elif (D := B * B - A * C) < 0:
                return ()
            else:
                half = D.sqrt() if D > 0 else arb(0)
                roots = ((-B - half) / A, (-B + half) / A)
            return tuple(sorted(roots, key=lambda root: float(root.mid())))

    @contextmanager
    def _question(self) -> Iterator[None]:
        """Precision is put back after it; exact numbers, those of the outcomes of ties included, share one budget."""
        before = ctx.prec
        if self._shared is None:
            self._allowance.restore()
        try:
            yield
        finally:
            ctx.prec = before

    def _prove(self, x: int, y: int, forced: Mapping[Key, int], with_ties: bool) -> Truth:
        path, values = self._certain(x, y, forced)
        ties = path.ties if with_ties else ()
        reported = tuple(self._tie(x, y, forced, key, values, key not in path.unproved) for key in ties)
        return Truth(x, y, path.hits[0].sphere if path.hits else -1, values, reported, path.bits)

    def _certain(self, x: int, y: int, forced: Mapping[Key, int]) -> tuple[_Path, dict[str, tuple[Ball, ...]]]:
        """The path, and every pass, at a precision that is enough for both."""
        known: dict[Key, int] = {}
        unproved: set[Key] = set()
        bits = BITS
        while bits <= MOST_BITS:
            path = self._follow(x, y, bits, known, forced, None, unproved)
            values = _balls(self._raw(path))
            if values is not None:
                return path, values
            bits = 2 * path.bits
        raise UnprovedError(f"pixel {x} {y}: {MOST_BITS} bits are not enough")

    def _follow(
        self,
        x: int,
        y: int,
        bits: int,
        known: dict[Key, int],
        forced: Mapping[Key, int],
        watch: dict[Key, arb] | None,
        unproved: set[Key] | None = None,
    ) -> _Path:
        """Follow the ray in balls, at first with `bits` bits.

        `known` and `unproved` are filled in: exact signs, and those of them that could not be had.
        """
        unproved = set() if unproved is None else unproved
        exact = False
        direction = self.direction(x, y)
        while True:
            ctx.prec = bits
            tables = self._at(bits)
            signs = _Signs(known, forced, watch)
            sign = signs.quick if watch is None and not forced else signs.careful
            epsilon = arb(rational(self.settings.shadow_epsilon))
            follower = self.follower(tables, sign, epsilon, self.settings.max_reflections)
            follower.every_blocker = watch is not None
            follower.hurries = watch is None and not forced
            try:
                hits = follower.follow(tuple(arb(entry) for entry in direction))  # type: ignore[arg-type]
                ties = tuple(key for key in dict.fromkeys(signs.ties) if key.what != "at" or key in unproved)
                return _Path(bits, follower, hits, ties, unproved)
            except UncertainError:
                if bits >= EXACT_FROM and not exact:
                    exact = True
                    unproved |= self._exactly(direction, known, forced, every_blocker=watch is not None)
                else:
                    # With exact signs known: a ball so wide that it led to a question which the path does not ask.
                    bits *= 2
                if bits > MOST_BITS:
                    raise UnprovedError(f"pixel {x} {y}: {MOST_BITS} bits are not enough") from None

    def _at(self, bits: int) -> Tables:
        """The scene in balls of that precision."""
        if bits not in self._tables:
            self._tables[bits] = self._make(arb)
        return self._tables[bits]

    def _make(self, lift: Callable[[fmpq], Any]) -> Tables:
        return Tables(self.numbers, self.structure, len(self.scene.spheres), len(self.scene.lights), lift)

    def _exactly(
        self, direction: Sequence[fmpq], known: dict[Key, int], forced: Mapping[Key, int], *, every_blocker: bool
    ) -> set[Key]:
        """Fill in the exact sign of every decision of a pixel. What cannot be had counts as 0, and is returned."""
        ctx.prec = 4 * EXACT_FROM
        tower = Tower(self._allowance.left)

        def lift(value: fmpq) -> Lazy:
            return Lazy.rational(tower, fmpq(value))

        unproved: set[Key] = set()

        def sign(value: Lazy, *names: Any) -> int:
            key = Key(*names)
            if key in forced:
                return forced[key]
            if key not in known:
                try:
                    known[key] = value.sign()
                except TooLargeError:
                    known[key] = 0
                    unproved.add(key)
            return known[key]

        epsilon = lift(rational(self.settings.shadow_epsilon))
        follower = self.follower(self._make(lift), sign, epsilon, self.settings.max_reflections)
        follower.shades, follower.every_blocker = False, every_blocker
        follower.hurries = not every_blocker and not forced
        try:
            follower.follow(tuple(lift(entry) for entry in direction))  # type: ignore[arg-type]
        finally:
            self._allowance.left = tower.budget
        return unproved

    def _raw(self, path: _Path) -> dict[str, tuple[Any, ...]]:
        """Every pass, in balls of whatever width."""
        hits, lights, bounces = path.hits, self.scene.lights, self.settings.max_reflections
        nothing: Vector = (0, 0, 0)
        raw: dict[str, Any] = {"ambient": nothing, "diffuse": nothing, "specular": nothing, "direct": nothing}
        raw |= {f"shadow.L{i}": (0,) for i in range(len(lights))}
        reflected: list[Vector | None] = [None] * bounces
        for hit in hits[1:]:
            color = path.follower.color(hit)
            reflected[hit.bounce - 1] = tuple(hit.weight * value for value in color)
        if (beyond := path.follower.beyond()) and path.follower.missed is not None:
            # As a rule that is not the specification's has it: nothing was hit, and something is seen.
            reflected[len(hits) - 1] = tuple(path.follower.missed * value for value in beyond)
        raw |= {f"reflection.{k + 1}": color or nothing for k, color in enumerate(reflected)}
        raw["reflection"] = add(*reflected)
        raw["beauty"] = self._at(path.bits).background
        raw["id"] = (hits[0].sphere if hits else -1,)
        if hits:
            hit = hits[0]
            raw["ambient"] = hit.ambient
            raw["diffuse"] = add(*(sight.diffuse for sight in hit.sights))
            raw["specular"] = add(*(sight.specular for sight in hit.sights))
            raw["direct"] = add(raw["diffuse"], raw["specular"])
            raw["beauty"] = add(hit.ambient, raw["direct"], raw["reflection"])
            for sight in hit.sights:
                raw[f"shadow.L{sight.light}"] = (0 if sight.blockers else 1,)
            dx, dy, dz = hit.direction
            raw["depth"] = (hit.t * (dx * dx + dy * dy + dz * dz).sqrt(),)
            raw["position"] = hit.point
            gx, gy, gz = hit.gradient
            inverse = (gx * gx + gy * gy + gz * gz).rsqrt()
            raw["normal"] = gx * inverse, gy * inverse, gz * inverse
        else:
            raw["depth"], raw["position"], raw["normal"] = (INFINITE,), nothing, nothing
        return raw

    def _tie(
        self,
        x: int,
        y: int,
        forced: Mapping[Key, int],
        key: Key,
        values: Mapping[str, tuple[Ball, ...]],
        proved: bool,
    ) -> Tie:
        def color(of: Mapping[str, tuple[Ball, ...]]) -> tuple[float, float, float]:
            red, green, blue = (ball.value for ball in of["beauty"])
            return red, green, blue

        # More than touching has two roots as near as one likes to the double one: the same value, but no ball has it.
        signs = (0, -1) if key.what == "meets" else (1, -1)
        settled = SETTLED[key.what] if proved and (key.what != "order" or key.bounce == 0) else ""
        others = []
        for sign in signs:
            # A way that leads nowhere is no outcome.
            with contextlib.suppress(*NOWHERE):
                path, other = self._certain(x, y, {**forced, key: sign})
                others.append(color(other))
                proved = proved and not path.unproved
        return Tie(key, settled, tuple(dict.fromkeys([color(values), *others])), proved)


def _balls(raw: Mapping[str, tuple[Any, ...]]) -> dict[str, tuple[Ball, ...]] | None:
    """Every pass as a result, or None where a ball is too wide."""
    values: dict[str, tuple[Ball, ...]] = {}
    for name, channels in raw.items():
        found = []
        for channel in channels:
            ball = _ball(channel)
            if ball is None:
                return None
            found.append(ball)
        values[name] = tuple(found)
    return values


def _ball(value: Any) -> Ball | None:
    """As a result; None if it is too wide."""
    if isinstance(value, Ball):
        return value
    if isinstance(value, int):
        return Ball(value, 0, 0.0)
    radius = float(value.rad())
    if radius <= RADIUS or radius <= RADIUS * float(abs(value).lower()):
        return Ball.of(value)
    return None


# ---- many pixels


#: Pixels that are cheaper to prove here than in other processes.
FEW = 64

_prover: Prover | None = None


def _begin(scene: Scene, settings: Settings) -> None:
    global _prover
    # A parent that was killed does not tell them to end.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _prover = Prover(scene, settings)


def _work(pixels: Sequence[tuple[int, int]]) -> list[Truth]:
    assert _prover is not None
    return [_prover.pixel(x, y) for x, y in pixels]


def prove(
    scene: Scene,
    pixels: Sequence[tuple[int, int]],
    settings: Settings | None = None,
    *,
    jobs: int | None = None,
) -> Iterator[Truth]:
    """Prove pixels (column, row), in their order, with that many processes; None: one a processor."""
    settings = settings or Settings()
    jobs = jobs or os.cpu_count() or 1
    if jobs == 1 or len(pixels) <= FEW:
        prover = Prover(scene, settings)
        for x, y in pixels:
            yield prover.pixel(x, y)
        return
    size = max(1, min(FEW, math.ceil(len(pixels) / jobs / 4)))
    parts = [pixels[at : at + size] for at in range(0, len(pixels), size)]
    # Started afresh: a fork of a process in which Mitsuba has threads may hang.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(min(jobs, len(parts)), context, _begin, (scene, settings))
    try:
        with _deaf():
            # This starts them; what is blocked here stays so in them.
            # Not by its map, which cancels what is to be done: that and workers that end make it hang.
            results = [pool.submit(_work, part) for part in parts]
        for found in results:
            yield from found.result()
    except BaseException:
        # A pool that is interrupted while its workers start may wait for them for ever.
        workers = set(multiprocessing.active_children()) - others
        for worker in workers:
            worker.terminate()
        for worker in workers:
            worker.join()
        # One may have ended halfway through a result: what reads that must not wait for the rest.
        pool._result_queue._writer.close()  # type: ignore[attr-defined]
        raise
    finally:
        # What reads the results of a pool that was broken up has been seen to wait for ever: it is not waited for.
        ending = threading.Thread(target=pool.shutdown, kwargs={"cancel_futures": True}, daemon=True)
        ending.start()
        ending.join(PATIENCE)


@contextmanager
def _deaf() -> Iterator[None]:
    """Put Ctrl-C off: a terminal sends it to all processes, and a pool whose workers end by themselves may hang."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
