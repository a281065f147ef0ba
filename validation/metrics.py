"""Numbers that say how far two images are apart; one function each."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.passes import quantise

Array: TypeAlias = NDArray[np.float64]


def difference(a: NDArray[Any], b: NDArray[Any]) -> Array:
    """|a - b| in float64, 0 where both are the same infinity, NaN where it has no value."""
    a64, b64 = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(a64 == b64, 0.0, np.abs(a64 - b64))


def maximum(errors: Array) -> float:
    """The largest error; 0 of nothing."""
    return float(errors.max()) if errors.size else 0.0


def rmse(errors: Array) -> float:
    """The root of the mean square, scaled so that squares neither overflow nor underflow."""
    largest = maximum(errors)
    if largest == 0 or not math.isfinite(largest):
        return largest
    return largest * math.sqrt(float(np.mean(np.square(errors / largest))))


def percentile(errors: Array, share: float = 99.9) -> float:
    """The error that `share` per cent of the pixels do not exceed: one of the errors, never a value in between."""
    if not errors.size:
        return 0.0
    # Rounded first: 99.9 per cent of 1000 are 999, not a little more.
    place = math.ceil(round(errors.size * share / 100, 6)) - 1
    return float(np.partition(errors, max(place, 0))[max(place, 0)])


@dataclass(frozen=True)
class Levels:
    """How 8-bit images differ: pixels whose worst channel is off by one level, by more, and the largest difference."""

    by_one: int
    by_more: int
    max: int


def shown(values: NDArray[Any]) -> NDArray[np.uint8]:
    """The 8-bit image of linear colours; bytes are one already."""
    return values if values.dtype == np.uint8 else quantise(values)


def levels(a: NDArray[Any], b: NDArray[Any]) -> Levels:
    """Differences of the 8-bit images of linear colours, or of bytes."""
    steps = np.abs(shown(a).astype(np.int16) - shown(b).astype(np.int16)).max(axis=-1)
    return Levels(int((steps == 1).sum()), int((steps > 1).sum()), int(steps.max(initial=0)))


def psnr(a: NDArray[Any], b: NDArray[Any]) -> float:
    """The peak signal-to-noise ratio in decibels of the colours clamped to [0, 1]; infinity when they are equal."""
    error = rmse(difference(np.clip(a, 0, 1), np.clip(b, 0, 1)))
    return math.inf if error == 0 else -20 * math.log10(error)


@dataclass(frozen=True)
class ColorDifference:
    """CIEDE2000: 1 is about what an eye just notices."""

    max: float
    mean: float


def ciede2000(a: NDArray[Any], b: NDArray[Any]) -> ColorDifference:
    """The difference that an eye sees between the 8-bit images, shown as sRGB as every viewer does."""
    first, second = shown(a), shown(b)
    differs = (first != second).any(axis=-1)
    if not differs.any():
        return ColorDifference(0.0, 0.0)
    with warnings.catch_warnings():
        # Its optional parts (plots, spectra) are not what is used here.
        warnings.filterwarnings(
            "ignore", message='.*"(Matplotlib|SciPy|NetworkX|Trimesh|vtk|OpenImageIO)" related API.*'
        )
        import colour

    # Equal pixels differ by 0: only the others are worth converting, and only one of each pair of colours.
    pairs, count = np.unique(np.concatenate([first[differs], second[differs]], axis=-1), axis=0, return_counts=True)
    lab = [colour.XYZ_to_Lab(colour.sRGB_to_XYZ(pairs[:, part] / 255.0)) for part in (slice(0, 3), slice(3, 6))]
    delta = np.asarray(colour.delta_E(lab[0], lab[1], method="CIE 2000"), dtype=np.float64)
    return ColorDifference(float(delta.max()), float((delta * count).sum() / differs.size))


@dataclass(frozen=True)
class Flip:
    """FLIP, which models what one sees who flips between two images: from 0, nothing, to 1; `map`: of every pixel."""

    max: float
    mean: float
    map: Array = field(repr=False, compare=False)


def flip(a: NDArray[Any], b: NDArray[Any]) -> Flip:
    """FLIP of the 8-bit images, shown as sRGB, at the 67 pixels a degree of its authors.

    Raises:
        ModuleNotFoundError: flip-evaluator is not installed.
    """
    import flip_evaluator

    test, reference = (shown(values).astype(np.float32) / np.float32(255) for values in (a, b))
    errors, _, _ = flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False, computeMeanError=False)
    found = np.asarray(errors, dtype=np.float64).reshape(test.shape[:2])
    return Flip(maximum(found), float(found.mean()) if found.size else 0.0, found)
