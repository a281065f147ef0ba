"""How the levels of an image file stand for colours: what programs do between a colour and a byte."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from validation import metrics

Array: TypeAlias = NDArray[np.float64]
Levels: TypeAlias = NDArray[np.int64]

#: What each does with a colour v that is clamped to [0, 1], for `steps` levels above 0; the specification's first.
QUANTISATIONS = {
    "truncate": "v * 255, truncated",
    "round": "v * 255, rounded",
    "255.9": "v * 255.9, truncated",
    "256": "v * 256, truncated, at most 255",
    "srgb": "the sRGB curve of v, times 255, rounded",
    "srgb-truncate": "the sRGB curve of v, times 255, truncated",
    "gamma": "v to the power of 1/2.2, times 255, rounded",
    "gamma-truncate": "v to the power of 1/2.2, times 255, truncated",
}

#: What a program in float32 may be off by on a curve, u = 2^-24: in the power, which is 1.055 p, by 2 u of it for pow,
#: by u for a factor and by |ln p| u for the rounded exponent, where p |ln p| <= 1 / e; by u of the result for the
#: difference, by u for its 0.055, and by u for the product with the levels: less than 8 u in all where the result is
#: at most 1, and as much of it beyond.
CURVE_ROUNDINGS = 8 * 2.0**-24


@dataclass(frozen=True)
class Encoding:
    """How a level stands for a colour: every level from 0 to `steps` for an interval of them.

    `quantisation`: a key of QUANTISATIONS. `wraps`: colours above 1 are not clamped: their levels begin again at 0, as
    those of a byte do.
    """

    quantisation: str = "truncate"
    steps: int = 255
    wraps: bool = False

    def __post_init__(self) -> None:
        """Refuse what is not known."""
        if self.quantisation not in QUANTISATIONS:
            raise ValueError(f"unknown quantisation '{self.quantisation}': expected one of {', '.join(QUANTISATIONS)}")

    @property
    def says(self) -> str:
        """In words, for a v between 0 and 1."""
        text = QUANTISATIONS[self.quantisation]
        if self.steps == 255:
            return text
        return (
            text.replace("255.9", f"{self.steps + 0.9:g}")
            .replace("256", f"{self.steps + 1}")
            .replace("255", str(self.steps))
        )

    @property
    def curved(self) -> bool:
        """Whether it is more than a product."""
        return self.quantisation.startswith(("srgb", "gamma"))

    def encode(self, colors: NDArray[Any], roundings: float = 0.0) -> Levels:
        """The levels of colours; `roundings`: what the curve is off by."""
        values = np.asarray(colors, dtype=np.float64)
        values = np.where(values > 0, values if self.wraps else np.where(values < 1, values, 1.0), 0.0)
        # A little above 1 a colour that wraps begins again.
        curve = self._curve(values)
        if roundings:
            curve = np.maximum(curve + roundings * np.maximum(curve, 1.0), 0.0)
        scaled = np.floor(self._scale() * curve + self._offset())
        most = self.steps + 1 if self.wraps else np.inf
        levels: Levels = np.where(scaled == np.inf, 0, np.mod(scaled, most) if self.wraps else scaled).astype(np.int64)
        return levels if self.wraps else np.minimum(levels, self.steps)

    def makes(self, colors: NDArray[Any], levels: NDArray[Any]) -> NDArray[np.bool_]:
        """Where these are the levels of colours, as far as the roundings of a curve tell."""
        either = self.either(colors)
        same: NDArray[np.bool_] = (either[0] == levels) | (either[-1] == levels)
        return same

    def either(self, colors: NDArray[Any]) -> list[Levels]:
        """The levels that colours may have: of a curve two, as no level is as narrow as its roundings are.

        Two, too, where a colour is halfway between levels: some programs round that up, others to the even one.
        """
        if self.quantisation == "round":
            levels, values = self.encode(colors), np.asarray(colors, dtype=np.float64)
            within = (values > 0) & np.isfinite(values) & (self.wraps | (values < 1))
            scaled = np.where(within, values, 0.0) * self.steps
            half = np.mod(scaled, 1.0) == 0.5
            even = np.mod(np.rint(scaled), self.steps + 1).astype(np.int64)
            return [levels, np.where(half, even, levels)] if half.any() else [levels]
        if not self.curved:
            return [self.encode(colors)]
        return [self.encode(colors, roundings) for roundings in (-CURVE_ROUNDINGS, CURVE_ROUNDINGS)]

    def interval(self, levels: NDArray[Any]) -> tuple[Array, Array]:
        """The colours that levels may come from, from the lowest to the highest; those of the ends have no bound."""
        at = np.asarray(levels, dtype=np.float64)
        low, high = self._curve_between(at)
        # Colours above 1 become 1: next to it the curve may round to the level below.
        last = (at >= self.steps) | (self.curved & (high >= 1))
        return np.where(at <= 0, -np.inf, self._inverse(low)), np.where(last, np.inf, self._inverse(high))

    def distance(self, levels: NDArray[Any], colors: NDArray[Any]) -> Array:
        """How far colours lie from those that levels may come from, 0 inside; NaN of what is no number."""
        values = np.asarray(colors, dtype=np.float64)
        at = np.asarray(levels, dtype=np.float64)
        if self.wraps:
            # The turn that brings a level nearest to the colour.
            turn = self.steps + 1
            scaled = self._scale() * self._curve(np.maximum(values, 0.0)) + self._offset() - 0.5
            at = at + turn * np.maximum(np.rint((scaled - at) / turn), 0.0)
            low, high = map(self._inverse, self._curve_between(at))
            low = np.where(at <= 0, -np.inf, low)
        else:
            low, high = self.interval(at)
        with np.errstate(invalid="ignore"):
            apart = np.where(values < low, low - values, np.where(values > high, values - high, 0.0))
        result: Array = np.where(np.isnan(values), np.nan, apart)
        return result

    def _curve_between(self, at: Array) -> tuple[Array, Array]:
        """Between which values of the curve a level lies."""
        low, high = ((at + k - self._offset()) / self._scale() for k in (0, 1))
        if not self.curved:
            return low, high
        return low - CURVE_ROUNDINGS * np.maximum(low, 1.0), high + CURVE_ROUNDINGS * np.maximum(high, 1.0)

    def _scale(self) -> float:
        return {"255.9": self.steps + 0.9, "256": self.steps + 1.0}.get(self.quantisation, float(self.steps))

    def _offset(self) -> float:
        return 0.5 if self.quantisation in ("round", "srgb", "gamma") else 0.0

    def _curve(self, values: Array) -> Array:
        if self.quantisation.startswith("gamma"):
            return np.power(np.maximum(values, 0.0), 1 / 2.2)
        if not self.quantisation.startswith("srgb"):
            return values
        # IEC 61966-2-1, written so that 1 stays 1.
        with np.errstate(invalid="ignore"):
            power = np.power(np.maximum(values, 0.0), 1 / 2.4)
            return np.where(values <= 0.0031308, 12.92 * values, 1 - 1.055 * (1 - power))

    def _inverse(self, values: Array) -> Array:
        if self.quantisation.startswith("gamma"):
            return np.power(np.maximum(values, 0.0), 2.2)
        if not self.quantisation.startswith("srgb"):
            return values
        with np.errstate(invalid="ignore"):
            power = np.power((np.maximum(values, 0.0) + 0.055) / 1.055, 2.4)
            return np.where(values <= 0.04045, values / 12.92, power)


#: Of two images; None: it holds colours.
Encodings: TypeAlias = tuple[Encoding | None, Encoding | None]


def difference(a: Array, b: Array, encodings: Encodings) -> Array:
    """How far apart colours are at least, of which one side or both are levels over their steps."""
    first, second = encodings
    if first is None and second is None:
        return metrics.difference(a, b)
    if second is None:
        assert first is not None
        return first.distance(_levels(a, first), b)
    if first is None:
        return second.distance(_levels(b, second), a)
    (a_low, a_high), (b_low, b_high) = first.interval(_levels(a, first)), second.interval(_levels(b, second))
    apart: Array = np.maximum(np.maximum(a_low - b_high, b_low - a_high), 0.0)
    return apart


def signs(a: Array, b: Array, encodings: Encodings) -> Array:
    """Which of two colours is larger where they are apart, of which one side or both are levels over their steps."""
    (a_low, _), (b_low, _) = (
        of.interval(_levels(values, of)) if of else (values, values)
        for values, of in zip((a, b), encodings, strict=True)
    )
    larger: Array = np.where(a_low > b_low, 1.0, -1.0)
    return larger


def shown(a: Array, b: Array, encodings: Encodings) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Both as bytes: what holds colours encoded as the other side is."""
    first, second = encodings
    known = first or second or Encoding()
    sides = ((a, first), (b, second))
    levels = [(_levels(values, of) if of else known.encode(values), of or known) for values, of in sides]
    one, other = ((entry * 255 // of.steps).astype(np.uint8) for entry, of in levels)
    return one, other


def _levels(values: Array, of: Encoding) -> Levels:
    levels: Levels = np.rint(np.where(np.isfinite(values), values, 0.0) * of.steps).astype(np.int64)
    return levels
