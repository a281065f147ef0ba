"""Float arrays as text in a page: predicted, byte-shuffled, deflated, in base64; `viewer/codec.js` undoes it.

An array is stored as float32, the *base*, exact where it came as such. What a float64 has beyond its nearest float32 is
the *rest*: how many float64 lie between the two. Of the first renderer of a scene the rest is noise that no
compression helps, so it may be left out to keep a page small. Of any other it is stored less the first one's, which is
next to nothing, so that differences between two float64 renderers stay what they are.

A base is the difference from a prediction, of the bits as integers in the order of the numbers:
    planar  left + above - above left, of the same channel
    first   the base of the first renderer
    sum     the float32 nearest to the float64 sum of other passes of the same renderer
    ray     of `position`: the point of the pixel's ray at the renderer's `depth`
    surface of `normal`: that of the renderer's sphere `id` at its `position`
"""

from __future__ import annotations

import base64
import os
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.passes import OFFSETS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tracer import Scene
    from validation.renderers import Settings

Ints: TypeAlias = NDArray[np.int32]
Floats: TypeAlias = NDArray[np.float64]

#: Level 9 takes several times as long for a hundredth less.
COMPRESS = 6

#: In a rest: the value is the sum of its parts; another number beyond this one stands among the exceptions.
IS_SUM = -(2**31)


@dataclass(frozen=True)
class Stored:
    """One pass of one renderer: `base` and `rest` are text for the page, `rest` empty where it is all 0."""

    channels: int
    prediction: str
    base: str
    rest: str = ""
    parts: tuple[str, ...] = ()
    #: Passes behind the predictions `ray` and `surface`.
    guides: tuple[str, ...] = ()
    #: Whether the array was float64 with values that are no float32.
    wide: bool = False
    #: Whether `rest` is less that of the first renderer.
    based: bool = False


@dataclass
class Source:
    """What later renderers of a scene are predicted from: the arrays of the first."""

    bases: dict[str, Ints] = field(default_factory=dict)
    rests: dict[str, Ints] = field(default_factory=dict)


def parts_of(name: str, have: Sequence[str]) -> tuple[str, ...]:
    """The passes whose sum a pass is, where there are all of them."""
    bounces = tuple(sorted((n for n in have if n.startswith("reflection.")), key=lambda n: int(n[11:])))
    sums = {"beauty": ("ambient", "direct", "reflection"), "direct": ("diffuse", "specular"), "reflection": bounces}
    parts = sums.get(name, ())
    return parts if parts and all(part in have for part in parts) else ()


@dataclass(frozen=True)
class Guide:
    """What geometry says of a scene; the viewer computes with the same numbers in the same order."""

    #: First x, its step from column to column, first y, its step from row to row, z.
    rays: tuple[float, float, float, float, float]
    #: Centre and squared half axes.
    spheres: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, scene: Scene, settings: Settings) -> Guide:
        """That of a scene and where the rays go through the pixels."""
        view, (ox, oy) = scene.view, OFFSETS[settings.sample]
        less = 1 if settings.sample == "inclusive" else 0
        across = (view.right - view.left) / max(view.columns - less, 1)
        down = (view.bottom - view.top) / max(view.rows - less, 1)
        rays = (view.left + across * ox, across, view.top + down * oy, down, -view.near)
        return cls(rays, tuple((*s.position, *(axis * axis for axis in s.scaling)) for s in scene.spheres))

    def points(self, depth: Floats) -> Floats:
        """The point of every pixel's ray at that distance from the eye."""
        x0, across, y0, down, z = self.rays
        rows, columns = depth.shape
        x = np.broadcast_to(x0 + across * np.arange(columns), depth.shape)
        y = np.broadcast_to((y0 + down * np.arange(rows))[:, None], depth.shape)
        with np.errstate(all="ignore"):
            share = depth / np.sqrt(x * x + y * y + z * z)
            return _finite(np.stack([x * share, y * share, z * share]))

    def normals(self, points: Floats, ids: Floats) -> Floats:
        """The normals of spheres at points, towards the eye."""
        if not self.spheres:
            return np.zeros_like(points)
        with np.errstate(all="ignore"):
            known = (ids >= 0) & (ids < len(self.spheres))
            place = np.where(known, ids, 0).astype(np.int64)
            of = np.moveaxis(np.array(self.spheres)[place], 2, 0)
            x, y, z = ((points[axis] - of[axis]) / of[axis + 3] for axis in range(3))
            length = np.sqrt(x * x + y * y + z * z)
            away = x * points[0] + y * points[1] + z * points[2] > 0
            length = np.where(away, -length, length)
            return _finite(np.where(known, np.stack([x / length, y / length, z / length]), 0.0))


def _finite(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, 0.0)


def store(
    passes: Mapping[str, NDArray[Any]], source: Source | None, guide: Guide | None = None
) -> tuple[dict[str, Stored], Source]:
    """Every pass of one renderer; `source`: that of the first renderer of the scene, None for the first itself."""
    planes = {name: _planes(array) for name, array in passes.items()}
    with np.errstate(over="ignore", invalid="ignore"):
        bases = {name: plane.astype(np.float32) for name, plane in planes.items()}
    own = Source()

    def stored(name: str) -> Stored:
        plane = planes[name]
        parts = parts_of(name, [*planes])
        order = ordered(bases[name])
        own.bases[name] = order
        candidates: dict[str, Ints] = {}
        if source and name in source.bases and source.bases[name].shape == order.shape:
            candidates["first"] = source.bases[name]
        if parts:
            candidates["sum"] = _as_order(_sum([bases[part].astype(np.float64) for part in parts]))
        guides: tuple[str, ...] = ()
        if guide and name == "position" and "depth" in bases:
            guides = ("depth",)
            candidates["ray"] = _as_order(guide.points(bases["depth"][0].astype(np.float64)))
        if guide and name == "normal" and "position" in bases and "id" in bases:
            guides = ("position", "id")
            points, ids = bases["position"].astype(np.float64), bases["id"][0].astype(np.float64)
            candidates["surface"] = _as_order(guide.normals(points, ids))
        if "first" not in candidates and "sum" not in candidates:
            candidates["planar"] = _planar(order)
        with np.errstate(over="ignore"):
            residuals = {how: order - prediction for how, prediction in candidates.items()}
        how = min(residuals, key=lambda how: float(np.log2(1 + np.abs(residuals[how].astype(np.float64))).sum()))
        rest, exceptions, wide = _rest(plane, bases[name])
        own.rests[name] = rest
        text, based = "", False
        if wide:
            first = source.rests.get(name) if source else None
            if first is not None and first.shape == rest.shape:
                with np.errstate(over="ignore"):
                    rest, based = rest - first, True
            elif parts:
                is_sum = _bits(plane) == _bits(_sum([planes[part] for part in parts]))
                rest = np.where(is_sum, np.int32(IS_SUM), rest)
            text = pack(rest, exceptions)
        used = parts if how == "sum" or (wide and not based) else ()
        guides = guides if how in ("ray", "surface") else ()
        return Stored(plane.shape[0], how, pack(residuals[how]), text, used, guides, wide, based)

    # Compression leaves the interpreter to others.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return dict(zip(planes, pool.map(stored, planes), strict=True)), own


def store_margins(margins: Mapping[str, NDArray[Any]]) -> str:
    """Margins, one channel a kind, to two digits."""
    planes = np.stack([np.asarray(plane, np.float64) for plane in margins.values()])
    with np.errstate(over="ignore"):
        bits = planes.astype(np.float32).view(np.uint32)
    rounded = ((bits.astype(np.uint64) + 0x10000) & 0xFFFE0000).astype(np.uint32).view(np.float32)
    order = ordered(rounded)
    with np.errstate(over="ignore"):
        return pack(order - _planar(order))


def store_plane(values: Floats) -> str:
    """One number a pixel, as float32."""
    with np.errstate(over="ignore"):
        order = ordered(values.astype(np.float32))[None]
        return pack(order - _planar(order))


def store_bytes(flags: NDArray[np.uint8]) -> str:
    """Bytes, as they are."""
    return _text(flags.tobytes())


def ordered(values: NDArray[np.float32]) -> Ints:
    """The bits as integers that go the way of the numbers; every pattern, those of NaN too, has one of its own."""
    bits = np.ascontiguousarray(values).view(np.int32)
    return np.where(bits < 0, bits ^ np.int32(0x7FFFFFFF), bits).astype(np.int32)


def pack(values: Ints, exceptions: tuple[NDArray[np.int64], Floats] | None = None) -> str:
    """Integers, small ones of either sign small, the lowest bytes of all first; then the places of others and these."""
    zigzag = np.ascontiguousarray((values << 1) ^ (values >> 31)).view(np.uint32).astype("<u4")
    data = zigzag.reshape(-1).view(np.uint8).reshape(-1, 4).T.tobytes()
    if exceptions:
        places, floats = exceptions
        data += places.astype("<u4").tobytes() + floats.astype("<f8").tobytes()
    return _text(data)


def _text(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, COMPRESS)).decode("ascii")


def _planes(array: NDArray[Any]) -> Floats:
    """(channels, rows, columns)."""
    values = np.asarray(array, np.float64)
    return np.ascontiguousarray(np.moveaxis(values, 2, 0) if values.ndim == 3 else values[None])


def _sum(parts: Sequence[Floats]) -> Floats:
    total = parts[0]
    with np.errstate(invalid="ignore", over="ignore"):
        for part in parts[1:]:
            total = total + part
    return total


def _as_order(values: Floats) -> Ints:
    with np.errstate(over="ignore", invalid="ignore"):
        return ordered(values.astype(np.float32))


def _planar(order: Ints) -> Ints:
    """The plane through three neighbours; along the first row and column the neighbour."""
    prediction = np.zeros_like(order)
    with np.errstate(over="ignore"):
        prediction[:, :, 1:] = order[:, :, :-1]
        prediction[:, 1:, 0] = order[:, :-1, 0]
        prediction[:, 1:, 1:] = order[:, 1:, :-1] + order[:, :-1, 1:] - order[:, :-1, :-1]
    return prediction


def _bits(values: Floats) -> NDArray[np.int64]:
    return np.ascontiguousarray(values).view(np.int64)


def _rest(exact: Floats, base: NDArray[np.float32]) -> tuple[Ints, tuple[NDArray[np.int64], Floats], bool]:
    """How many float64 farther from 0 a value is than its float32; what that cannot say, and whether there is any."""
    near = base.astype(np.float64)
    far = _bits(exact) - _bits(near)  # of the same sign the magnitudes
    other = ((_bits(exact) < 0) != (_bits(near) < 0)) | (np.abs(far) >= 2**30) | np.isnan(exact)
    same = np.isnan(exact) | (_bits(exact) == _bits(near))
    rest = np.where(other | same, 0, far).astype(np.int32)
    places = np.flatnonzero(other & ~same)
    return rest, (places, exact.reshape(-1)[places]), not bool(same.all())
