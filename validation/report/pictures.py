"""Passes and errors as PNG pictures that a browser shows."""

from __future__ import annotations

import base64
import functools
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tracer.passes import Pass, quantise
from validation.compare import Mask

Bytes: TypeAlias = NDArray[np.uint8]

#: Steps of the heatmap's colours in a factor of ten, and factors of ten that it shows below its largest error.
STEPS, DECADES = 3, 6

#: Level 9 takes four times as long for a tenth less.
COMPRESS = 6

#: A value that is no number; no renderer draws it, no colour map has it.
NO_NUMBER = (255, 0, 255)


@dataclass(frozen=True)
class Picture:
    """A PNG as a data URI, its size, and in words how values became colours."""

    uri: str
    columns: int
    rows: int
    how: str


@dataclass(frozen=True)
class Heatmap:
    """The picture of the errors with its colour bar: (share of the length, text) of each tick, (share, colour)."""

    picture: Picture
    ticks: tuple[tuple[float, str], ...]
    colors: tuple[str, ...]


def encode(image: Image.Image, how: str, **options: Any) -> Picture:
    """A picture as PNG inside a data URI."""
    stream = io.BytesIO()
    image.save(stream, "PNG", compress_level=COMPRESS, **options)
    uri = "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
    return Picture(uri, image.width, image.height, how)


def pair(row: Pass, a: NDArray[Any], b: NDArray[Any], hits: tuple[Mask, Mask]) -> tuple[Picture, Picture]:
    """Both renderings of a pass with the same mapping of values to colours."""
    how, pixels = _pixels(row, [np.asarray(a, np.float64), np.asarray(b, np.float64)], hits)
    first = encode(pixels[0], how)
    return first, first if pixels[0] == pixels[1] else encode(pixels[1], how)


def _pixels(row: Pass, values: list[NDArray[np.float64]], hits: tuple[Mask, Mask]) -> tuple[str, list[Image.Image]]:
    """What a pass looks like: the mapping in words, and the pictures."""
    if row.quantity == "id":
        return "a colour for each sphere, nothing hit: see-through", [_ids(ids) for ids in values]
    if row.quantity == "visibility":
        return "white: the light is visible, black: hidden or nothing hit", [_color(_grey(value)) for value in values]
    if row.quantity == "normal":
        how = "red, green, blue = 0.5 + 0.5 (x, y, z)"
        return how, [_color(0.5 + 0.5 * value, hit) for value, hit in zip(values, hits, strict=True)]
    if row.quantity in ("length", "position"):
        return _ranged(row, values, hits)
    largest = max((float(value[np.isfinite(value)].max(initial=0)) for value in values), default=0.0)
    smallest = min((float(value[np.isfinite(value)].min(initial=0)) for value in values), default=0.0)
    if row.name != "beauty" and 0 < largest <= 0.5:
        # A power of two, so that the brightened picture shows the same digits.
        gain = 2.0 ** -math.ceil(math.log2(largest))
        return f"linear values up to {largest:.3g}, shown {gain:g} times brighter", [
            _color(value * gain) for value in values
        ]
    outside = smallest < 0 or largest > 1
    how = f"linear values from {smallest:.3g} to {largest:.3g}" + (", shown clipped to 0 to 1" if outside else "")
    return how, [_color(value) for value in values]


def _ranged(row: Pass, values: list[NDArray[np.float64]], hits: tuple[Mask, Mask]) -> tuple[str, list[Image.Image]]:
    """Lengths and positions, each axis stretched over the range that both renderings have."""
    planes = [value if value.ndim == 3 else value[..., None] for value in values]
    inside = [plane[hit & np.isfinite(plane).all(axis=-1)] for plane, hit in zip(planes, hits, strict=True)]
    both = np.concatenate(inside)
    if not both.size:
        flat = [np.broadcast_to(plane, (*plane.shape[:2], 3)) for plane in planes]
        return "no value to show", [_color(plane, hit) for plane, hit in zip(flat, hits, strict=True)]
    low, high = both.min(axis=0), both.max(axis=0)
    stretch = np.where(high > low, high - low, 1)
    shares = [(plane - low) / stretch for plane in planes]
    if row.quantity == "length":
        # Near is bright; the farthest stays lighter than black, so that it shows against nothing hit.
        pictures = [_grey(1 - 0.9 * share[..., 0]) for share in shares]
        how = f"bright: {low[0]:.4g}, dark: {high[0]:.4g} world units; nothing hit: see-through"
    else:
        pictures = shares
        ranges = zip(("red", "green", "blue"), ("x", "y", "z"), low, high, strict=True)
        how = ", ".join(f"{color}: {axis} from {lo:.3g} to {hi:.3g}" for color, axis, lo, hi in ranges)
    return how, [_color(picture, hit) for picture, hit in zip(pictures, hits, strict=True)]


def _grey(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.repeat(values[..., None], 3, axis=-1)


def _color(values: NDArray[np.float64], visible: Mask | None = None) -> Image.Image:
    """A picture of values from 0 to 1, see-through where nothing is visible."""
    pixels = quantise(values)
    wrong = ~np.isfinite(values).all(axis=-1)
    if visible is None:
        pixels[wrong] = NO_NUMBER
        return _smallest(pixels)
    pixels[wrong & visible] = NO_NUMBER
    pixels[~visible] = 0
    if visible.all():
        return _smallest(pixels)
    opaque = np.where(visible, 255, 0).astype(np.uint8)
    return Image.fromarray(np.dstack([pixels, opaque]))


def _smallest(pixels: Bytes) -> Image.Image:
    """A grey picture where no colour is needed: a third of the bytes."""
    if (pixels[..., 0] == pixels[..., 1]).all() and (pixels[..., 1] == pixels[..., 2]).all():
        return Image.fromarray(pixels[..., 0])
    return Image.fromarray(pixels)


def _ids(ids: NDArray[np.float64]) -> Image.Image:
    import matplotlib

    colors = np.array(matplotlib.colormaps["tab10"].colors)[:, :3]  # type: ignore[attr-defined]
    return _color(colors[np.maximum(ids, 0).astype(np.int64) % len(colors)], ids >= 0)


@functools.cache
def _inferno(count: int) -> Bytes:
    """`count` colours, dark to bright, perceptually uniform; the first, black, is for no error at all."""
    import matplotlib

    shares = np.linspace(0.1, 1, count)
    colors: Bytes = (np.array(matplotlib.colormaps["inferno"](shares))[:, :3] * 255).round().astype(np.uint8)
    return np.concatenate([np.zeros((1, 3), np.uint8), colors])


def heatmap(error: NDArray[np.float64], compared: Mask, edge: Mask) -> Heatmap | None:
    """The errors on a logarithmic scale; None where there is none.

    The scale is that of the interior pixels, so that one edge pixel that went the other way does not hide them all.
    """
    shown = np.where(compared, error, 0.0)
    if not (shown > 0).any():
        return None
    measured = np.isfinite(shown) & (shown > 0)
    finite = shown[measured & ~edge] if (measured & ~edge).any() else shown[measured]
    top = math.ceil(math.log10(float(finite.max()))) if finite.size else 0
    bottom = top - DECADES
    if finite.size:
        bottom = max(bottom, min(math.floor(math.log10(float(finite.min()))), top - 1))
    count = (top - bottom) * STEPS
    palette = _inferno(count)
    with np.errstate(divide="ignore"):
        steps = np.floor((np.log10(shown) - bottom) * STEPS)
    level = np.where(shown > 0, np.clip(steps, 0, count - 1) + 1, 0).astype(np.uint8)
    see_through = count + 1
    level[~compared] = see_through
    image = Image.fromarray(level)
    image.putpalette([*palette.reshape(-1).tolist(), 128, 128, 128])
    how = f"largest difference of a channel, {STEPS} steps in a factor of ten; black: none; see-through: not compared"
    # What lies outside takes the colour of the end.
    above, below = float(shown.max()) > 10.0**top, bool((shown[shown > 0] < 10.0**bottom).any())
    names = {decade: f"1e{decade}" for decade in range(bottom, top + 1)}
    names[top] += "+" if above else ""
    names[bottom] = ("<" if below else "") + names[bottom]
    ticks = tuple(((decade - bottom) / (top - bottom), name) for decade, name in names.items())
    colors = tuple("#{:02x}{:02x}{:02x}".format(*color) for color in palette[1:].tolist())
    return Heatmap(encode(image, how, transparency=see_through), ticks, colors)


def flip(errors: NDArray[np.float64]) -> Picture:
    """A map of FLIP in the colours that its authors use."""
    import matplotlib

    colors = np.array(matplotlib.colormaps["magma"](np.clip(errors, 0, 1)))[..., :3]
    return encode(_color(colors), "magma, from black, 0, to light, 1")


def outline(edge: Mask) -> str:
    """An SVG path along every border between edge pixels and others."""
    padded = np.pad(edge, 1)
    across = padded[1:, 1:-1] != padded[:-1, 1:-1]  # [y, x]: between rows y - 1 and y
    down = (padded[1:-1, 1:] != padded[1:-1, :-1]).T  # [x, y]: between columns x - 1 and x
    horizontal = "".join(f"M{x} {y}h{length}" for y, x, length in _runs(across))
    return horizontal + "".join(f"M{x} {y}v{length}" for x, y, length in _runs(down))


def _runs(mask: Mask) -> Iterator[tuple[int, int, int]]:
    """(row, start, length) of every run in a row."""
    change = np.diff(np.pad(mask.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)
    yield from zip(rows.tolist(), starts.tolist(), (ends - starts).tolist(), strict=True)
