"""Mitsuba's intersections and BSDFs for rays of ours: all rays at once, or one after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]  # (rays, 3)
Index = NDArray[np.intp]


@dataclasses.dataclass(frozen=True)
class Hits:
    """The rays that hit something: which, what and where."""

    ray: Index  # index among the rays that were traced
    sphere: Index  # index in scene.spheres
    t: NDArray[np.float64]
    position: Vectors
    normal: Vectors  # outward
    interactions: Any  # Mitsuba's own records of the same hits


class Engine(Protocol):
    """A scene in one variant of Mitsuba: what differs between one ray at a time and arrays of rays."""

    def hit(self, origin: Vectors, direction: Vectors, until: NDArray[np.float64] | None = None) -> Hits:
        """The nearest hits of rays with directions of length 1, with 0 < t < until."""

    def face(self, hits: Hits, inside: NDArray[np.bool_]) -> None:
        """Have the BSDFs seen from the side that was hit: at an outline the directions alone may say the other one."""

    def take(self, hits: Hits, wanted: Index) -> Hits:
        """Some of the hits."""

    def ambient(self, hits: Hits, wanted: Index) -> Vectors:
        """Ka times the colour, for some of the hits."""

    def reflect(self, hits: Hits, wanted: Index, to_light: Vectors, lobe: str) -> Vectors:
        """The BSDF's value times pi for light from a direction; `lobe` is "diffuse" or "specular"."""


class Arrays:
    """All rays at once, in a variant of Mitsuba that compiles."""

    def __init__(self, shapes: Mapping[str, Any], *, smooth: bool = False) -> None:
        """Load the shapes; `smooth`: normals are those between the vertices of a mesh."""
        import drjit as dr
        import mitsuba as mi

        self.smooth = smooth
        # Meshes that were merged into one would have no name.
        self.scene = mi.load_dict(dict(shapes), optimize=not smooth)
        # A shape in a kernel is its number in a registry.
        registry = np.array(dr.reinterpret_array(mi.UInt32, self.scene.shapes_dr())).tolist()
        found = dict(zip(registry, self.scene.shapes(), strict=True))
        self.ids = np.full(max(registry, default=0) + 1, -1)
        for number, shape in found.items():
            self.ids[number] = _index(shape)

    def hit(self, origin: Vectors, direction: Vectors, until: NDArray[np.float64] | None = None) -> Hits:
        """One kernel finds the nearest shapes, another works out the hits."""
        import drjit as dr
        import mitsuba as mi

        if not len(origin):
            return _nothing()
        ray = mi.Ray3f(mi.Point3f(*_lanes(origin)), mi.Vector3f(*_lanes(direction)))
        if until is not None:
            (ray.maxt,) = _lanes(until)
        found = self.scene.ray_intersect_preliminary(ray)
        dr.eval(found)
        hit = np.flatnonzero(np.isfinite(np.array(found.t)[: len(origin)]))
        if not hit.size:
            return _nothing()
        # Only for the rays that hit something: on a miss there is no shape to ask.
        (index,) = _lanes(hit)
        found, ray = dr.gather(type(found), found, index), dr.gather(type(ray), ray, index)
        flags = mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame if self.smooth else mi.RayFlags.Minimal
        si = found.compute_surface_interaction(ray, +flags)
        normal = si.sh_frame.n if self.smooth else si.n
        si.sh_frame = mi.Frame3f(normal)
        si.wi = si.to_local(-ray.d)
        shape = dr.select(
            dr.reinterpret_array(mi.UInt32, si.instance) != 0,
            dr.reinterpret_array(mi.UInt32, si.instance),
            dr.reinterpret_array(mi.UInt32, si.shape),
        )
        dr.eval(si, shape, normal)
        count = hit.size
        return Hits(
            hit,
            self.ids[np.array(shape)[:count]],
            np.array(si.t, dtype=np.float64)[:count],
            _rows(si.p, count),
            _rows(normal, count),
            si,
        )

    def face(self, hits: Hits, inside: NDArray[np.bool_]) -> None:
        """The cosine to the viewer gets the sign of that side."""
        import drjit as dr

        if hits.ray.size:
            (side,) = _lanes(np.where(inside, -1.0, 1.0))
            wi = hits.interactions.wi
            wi.z = side * dr.abs(wi.z)
            hits.interactions.wi = wi

    def take(self, hits: Hits, wanted: Index) -> Hits:
        """Gather Mitsuba's records too."""
        import drjit as dr

        si = hits.interactions
        chosen = dr.gather(type(si), si, _lanes(wanted)[0]) if wanted.size else None
        return _take(hits, wanted, chosen)

    def ambient(self, hits: Hits, wanted: Index) -> Vectors:
        """The attribute, for all of them, as a kernel is no slower."""
        si = hits.interactions
        return _rows(si.shape.eval_attribute_3("ambient", si), hits.ray.size)[wanted]

    def reflect(self, hits: Hits, wanted: Index, to_light: Vectors, lobe: str) -> Vectors:
        """The BSDF, for all of them."""
        import mitsuba as mi

        directions = np.zeros((hits.ray.size, 3), np.float32)
        directions[wanted] = to_light
        si = hits.interactions
        wo = si.to_local(mi.Vector3f(*_lanes(directions)))
        return np.pi * _rows(si.bsdf().eval(_context(lobe), si, wo), hits.ray.size)[wanted]


class Loop:
    """One ray after the other: needs no compiler, and intersects in float64."""

    def __init__(self, shapes: Mapping[str, Any], *, smooth: bool = False) -> None:
        """Load the shapes; `work` counts what is done, by kind; `smooth` as in Arrays."""
        import mitsuba as mi

        self.smooth = smooth
        # Meshes that were merged into one would have no name.
        self.scene = mi.load_dict(dict(shapes), optimize=not smooth)
        self.work = {"ray": 0, "hit": 0, "stock": 0, "phong": 0}

    def hit(self, origin: Vectors, direction: Vectors, until: NDArray[np.float64] | None = None) -> Hits:
        """Mitsuba's numbers go out as Python's, a ray at a time."""
        import mitsuba as mi

        intersect, make = self.scene.ray_intersect, mi.Ray3f
        limits = [float("inf")] * len(origin) if until is None else until.tolist()
        rows: list[int] = []
        ids: list[int] = []
        numbers: list[list[float]] = []
        interactions: list[Any] = []
        for row, (o, d, limit) in enumerate(zip(origin.tolist(), direction.tolist(), limits, strict=True)):
            si = intersect(make(o, d, limit, 0.0, []))
            if si.is_valid():
                p, n = si.p, si.sh_frame.n if self.smooth else si.n
                si.sh_frame = mi.Frame3f(n)
                si.wi = si.to_local(-mi.Vector3f(d))
                rows.append(row)
                ids.append(_index(si.instance or si.shape))
                numbers.append([si.t, p.x, p.y, p.z, n.x, n.y, n.z])
                interactions.append(si)
        self.work["ray"] += len(origin)
        self.work["hit"] += len(rows)
        if not rows:
            return _nothing()
        table = np.array(numbers)
        return Hits(np.array(rows), np.array(ids), table[:, 0], table[:, 1:4], table[:, 4:7], interactions)

    def face(self, hits: Hits, inside: NDArray[np.bool_]) -> None:
        """Only where it is the other one: records of single hits are slow."""
        for i, within in enumerate(inside.tolist()):
            si = hits.interactions[i]
            if (si.wi.z < 0) != within:
                x, y, z = si.wi
                si.wi = [x, y, -z]

    def take(self, hits: Hits, wanted: Index) -> Hits:
        """Mitsuba's records are a list."""
        return _take(hits, wanted, [hits.interactions[i] for i in wanted])

    def ambient(self, hits: Hits, wanted: Index) -> Vectors:
        """The attribute, one hit after the other."""
        self.work["stock"] += len(wanted)
        chosen = [hits.interactions[i] for i in wanted]
        return np.array([list(si.shape.eval_attribute_3("ambient", si)) for si in chosen]).reshape(-1, 3)

    def reflect(self, hits: Hits, wanted: Index, to_light: Vectors, lobe: str) -> Vectors:
        """The BSDF, one hit after the other."""
        import mitsuba as mi

        context = _context(lobe)
        values = []
        for i, direction in zip(wanted, to_light.tolist(), strict=True):
            si = hits.interactions[i]
            bsdf = si.bsdf()
            self.work["stock" if bsdf.class_name() == "TwoSidedBRDF" else "phong"] += 1
            values.append(list(bsdf.eval(context, si, si.to_local(mi.Vector3f(direction)))))
        return np.pi * np.array(values).reshape(-1, 3)


def _lanes(values: NDArray[Any]) -> list[Any]:
    """The columns of an array for Dr.Jit.

    One at a time, as a table would be taken apart by a kernel that is compiled anew for every length; and filled up, as
    an array of length 1 would be taken for a constant.
    """
    import mitsuba as mi

    kind = mi.UInt32 if values.dtype.kind in "iu" else mi.Float
    padded = np.concatenate([values, np.repeat(values[-1:], -len(values) % 16, axis=0)])
    columns = padded.astype(np.uint32 if kind is mi.UInt32 else np.float32).reshape(len(padded), -1).T
    return [kind(np.ascontiguousarray(column)) for column in columns]


def _rows(values: Any, count: int) -> Vectors:
    """Vectors of Dr.Jit as rows."""
    import drjit as dr

    dr.eval(values)
    return np.stack([np.array(column, dtype=np.float64)[:count] for column in values], axis=1)


def _index(shape: Any) -> int:
    """The index in scene.spheres, which the converter puts into the shape's name."""
    return int(shape.id().removeprefix("sphere_"))


def _nothing() -> Hits:
    none, vectors = np.zeros(0, np.intp), np.zeros((0, 3))
    return Hits(none, none, np.zeros(0), vectors, vectors, None)


def _take(hits: Hits, wanted: Index, interactions: Any) -> Hits:
    return Hits(
        hits.ray[wanted],
        hits.sphere[wanted],
        hits.t[wanted],
        hits.position[wanted],
        hits.normal[wanted],
        interactions,
    )


def _context(lobe: str) -> Any:
    import mitsuba as mi

    context = mi.BSDFContext()
    flag = {"diffuse": mi.BSDFFlags.DiffuseReflection, "specular": mi.BSDFFlags.GlossyReflection}[lobe]
    context.type_mask = +flag
    return context
