"""Mitsuba 3 as a reference that keeps to the specification's ray ranges: `mitsuba-spec@llvm` and `mitsuba-spec@scalar`.

What is Mitsuba's: which shape a ray meets first and where (its acceleration structure, its sphere routine, its instance
transforms), the hit point, its normal, the identity of the shape, the ambient colour (a shape attribute), and the value
of the BSDF for a direction to the viewer and one to a light.

What is ours: the rays (their origins and directions are worked out in float64 from Mitsuba's float32 hit points), the
loop over lights and bounces, and the rules of the specification about which hits count. A ray that leaves a sphere has
a root at its start. Exactly it is 0 and does not count; in float32 Mitsuba may find it a little later. So on the sphere
that a ray starts on, a hit counts only if it can be the other root: from the inside, and on the way out. Any other hit
of that sphere is passed over, and the ray goes on behind it. No origin is moved off a surface.

Mitsuba's own integrators move origins by 1e-4 of the scene; here nothing is moved, and the only lengths of ours are
`SLACK`, one step for rays that go on and one for a light that lies on a surface. docs/tolerances.md derives what
follows from float32.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib.metadata
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from converters import mitsuba_plugins
from tracer import reference
from tracer.passes import Passes, lookup, names
from validation.renderers import PerPixel, Settings, Uncertainty, floats

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis

Vectors = NDArray[np.float64]  # (rays, 3)
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]

UNIT_ROUNDOFF = 2.0**-24
#: Mitsuba's roots are off by up to this times the largest coordinate; docs/tolerances.md counts it.
SLACK = 16 * UNIT_ROUNDOFF
#: How often a ray goes on behind a hit that does not count, each time by a step four times as long.
RETRIES = 8
#: Magnitudes that float32 holds together with their squares.
RANGE = (1e-15, 1e15)
#: Roundings on the way to a decision or a value, each a relative change by at most the unit roundoff of the ray or of a
#: scene number, as margins count them; how much the sphere routine adds in an oblique instance, times h^2; and how the
#: discriminant of a chord moves with such a change. docs/tolerances.md lists them.
SPHERE_ROUNDINGS = 21
INSTANCE_ROUNDINGS = 8
GROWTH = 2
CHORD = 8
#: How long a scene may take in scalar mode, in seconds, and what a piece of work takes on a machine of 2024.
BUDGET = 4.0
COST = {"ray": 1.5e-6, "hit": 3e-6, "stock": 1.5e-6, "phong": 7e-6}
#: The edge of the picture that tells how much work a scene is, in pixels.
PROBE = 32

#: Where LLVM libraries lie, or below.
FOLDERS = ("/usr/lib", "/usr/lib64", "/usr/local/lib", "/opt/homebrew/opt/llvm/lib")

VARIANTS = {"llvm": "llvm_ad_rgb", "scalar": "scalar_rgb"}


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

    def take(self, hits: Hits, wanted: Index) -> Hits:
        """Some of the hits."""

    def ambient(self, hits: Hits, wanted: Index) -> Vectors:
        """Ka times the colour, for some of the hits."""

    def reflect(self, hits: Hits, wanted: Index, to_light: Vectors, lobe: str) -> Vectors:
        """The BSDF's value times pi for light from a direction; `lobe` is "diffuse" or "specular"."""


class Arrays:
    """All rays at once, in a variant of Mitsuba that compiles."""

    def __init__(self, shapes: Mapping[str, Any]) -> None:
        """Load the shapes."""
        import drjit as dr
        import mitsuba as mi

        self.scene = mi.load_dict(dict(shapes))
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
        si = found.compute_surface_interaction(ray, +mi.RayFlags.Minimal)
        si.sh_frame = mi.Frame3f(si.n)
        si.wi = si.to_local(-ray.d)
        shape = dr.select(
            dr.reinterpret_array(mi.UInt32, si.instance) != 0,
            dr.reinterpret_array(mi.UInt32, si.instance),
            dr.reinterpret_array(mi.UInt32, si.shape),
        )
        dr.eval(si, shape)
        count = hit.size
        return Hits(
            hit,
            self.ids[np.array(shape)[:count]],
            np.array(si.t, dtype=np.float64)[:count],
            _rows(si.p, count),
            _rows(si.n, count),
            si,
        )

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

    def __init__(self, shapes: Mapping[str, Any]) -> None:
        """Load the shapes; `work` counts what is done, by kind."""
        import mitsuba as mi

        self.scene = mi.load_dict(dict(shapes))
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
                p, n = si.p, si.n
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


def _dot(a: Vectors, b: Vectors) -> NDArray[np.float64]:
    products: NDArray[np.float64] = np.einsum("ij,ij->i", a, b)
    return products


@dataclasses.dataclass(frozen=True)
class Start:
    """Where rays leave a surface: the point, the sphere it is on, its outward normal, and on which side."""

    point: Vectors
    sphere: Index
    outward: Vectors
    inside: Flags

    def __getitem__(self, chosen: Index) -> Start:
        return Start(self.point[chosen], self.sphere[chosen], self.outward[chosen], self.inside[chosen])


@dataclasses.dataclass(frozen=True)
class Terms:
    """The terms of the colour at some hits, and the visibility of each light there."""

    ambient: Vectors
    diffuse: Vectors
    specular: Vectors
    visible: list[Flags]

    @property
    def color(self) -> Vectors:
        return self.ambient + self.diffuse + self.specular


class Driver:
    """The specification's loop over lights and bounces, on Mitsuba's intersections and BSDFs."""

    def __init__(self, scene: Scene, settings: Settings, engine: Engine) -> None:
        """Numbers of the spheres as tables."""
        self.scene, self.settings, self.engine = scene, settings, engine
        spheres = scene.spheres
        self.kr = np.array([s.kr for s in spheres])
        self.diffuse = np.array([s.kd != 0 and any(s.color) for s in spheres], dtype=bool)
        self.specular = np.array([s.ks != 0 for s in spheres], dtype=bool)
        self.ambient = np.array([s.ka != 0 and any(s.color) for s in spheres], dtype=bool) & any(scene.ambient)

    def leave(
        self, start: Start, origin: Vectors, direction: Vectors, until: NDArray[np.float64] | None = None
    ) -> Hits:
        """The nearest hits of rays that leave surfaces, but for the roots that are the start itself."""
        step = SLACK * np.abs(start.point).max(axis=1, initial=0)
        passed = np.zeros(len(origin))
        rays = np.arange(len(origin))
        hits = first = self.engine.hit(origin, direction, until)
        for retry in range(RETRIES):
            false = self.at_start(start[rays], direction[rays], hits)
            if not false.any():
                break
            rays = rays[hits.ray[false]]
            passed[rays] += hits.t[false] + 4.0**retry * step[rays]
            hits = self.engine.hit(
                origin[rays] + passed[rays, None] * direction[rays],
                direction[rays],
                None if until is None else until[rays] - passed[rays],
            )
        if passed.any():
            first = self.engine.hit(
                origin + passed[:, None] * direction, direction, None if until is None else until - passed
            )
            first = dataclasses.replace(first, t=first.t + passed[first.ray])
        false = self.at_start(start, direction, first)
        return self.engine.take(first, np.flatnonzero(~false)) if false.any() else first

    def at_start(self, start: Start, direction: Vectors, hits: Hits) -> Flags:
        """Which hits are the root that a ray starts from: on its own sphere only the way out is another root."""
        out = _dot(hits.normal, direction[hits.ray]) > 0
        false: Flags = (hits.sphere == start.sphere[hits.ray]) & ~(start.inside[hits.ray] & out)
        return false

    def lights(self, start: Start, normal: Vectors) -> Iterator[tuple[Vectors, NDArray[np.float64], Flags]]:
        """For each light: the direction to it, N.L, and whether it is visible."""
        for light in self.scene.lights:
            position = np.array(light.position)
            to_light = position - start.point
            distance = np.sqrt(_dot(to_light, to_light))
            # A light at x itself contributes nothing and counts as visible.
            direction = to_light / np.where(distance > 0, distance, 1)[:, None]
            NL = _dot(normal, direction)
            epsilon = self.settings.shadow_epsilon
            origin, until = start.point + epsilon * to_light, (1 - epsilon) * distance
            visible = np.ones(len(distance), dtype=bool)
            for facing in (True, False):
                # From a light behind the surface the sphere itself hides x, as its roots say.
                ask = np.flatnonzero((NL > 0) == facing)
                trace = self.leave if facing else self.straight
                hits = trace(start[ask], origin[ask], direction[ask], until[ask])
                # A light on a surface is not hidden by it, however flat the ray comes in.
                ray = ask[hits.ray]
                size = np.maximum(np.abs(position).max(), np.abs(start.point[ray]).max(axis=1, initial=0))
                depth = (until[ray] - hits.t) * np.abs(_dot(hits.normal, direction[ray]))
                visible[ray[depth > SLACK * size]] = False
            yield direction, NL, visible

    def straight(self, start: Start, origin: Vectors, direction: Vectors, until: NDArray[np.float64]) -> Hits:
        """The nearest hits, whatever they are."""
        del start
        return self.engine.hit(origin, direction, until)

    def shade(self, hits: Hits, start: Start, normal: Vectors, wanted: frozenset[str]) -> Terms:
        """The terms of the specification at each hit; `visible` is filled where `shadow` is wanted."""
        count = hits.ray.size
        ambient, diffuse, specular = (np.zeros((count, 3)) for _ in range(3))
        visibility: list[Flags] = []
        if "ambient" in wanted and (index := np.flatnonzero(self.ambient[hits.sphere])).size:
            ambient[index] = self.engine.ambient(hits, index) * np.array(self.scene.ambient)
        lobes = [
            (name, term, has[hits.sphere])
            for name, term, has in (("diffuse", diffuse, self.diffuse), ("specular", specular, self.specular))
            if name in wanted and has[hits.sphere].any()
        ]
        if lobes or "shadow" in wanted:
            for light, (direction, NL, visible) in zip(self.scene.lights, self.lights(start, normal), strict=True):
                visibility.append(visible)
                for name, term, has in lobes:
                    index = np.flatnonzero(has & visible & (NL > 0))
                    if index.size:
                        value = self.engine.reflect(hits, index, direction[index], name)
                        term[index] += value * np.array(light.intensity)
        return Terms(ambient, diffuse, specular, visibility)

    def render(self, passes: Sequence[str]) -> dict[str, NDArray[Any]]:
        """The passes asked for, each with one row a pixel."""
        wanted = _terms(passes)
        points = _eye_rays(self.scene, self.settings)
        direction = points / np.sqrt(_dot(points, points))[:, None]
        images = {name: _blank(name, self.scene, len(points)) for name in passes}

        def put(name: str, pixels: Index, values: NDArray[Any]) -> None:
            if name in images:
                images[name][pixels] = values

        # A primary ray starts on the image plane, t = 1: what lies before it is not there.
        hits = self.engine.hit(points, direction)
        pixels = hits.ray
        start, normal, direction = _land(hits, direction)
        put("id", pixels, hits.sphere)
        put("position", pixels, hits.position)
        put("depth", pixels, np.sqrt(_dot(hits.position, hits.position)))
        put("normal", pixels, normal)
        terms = self.shade(hits, start, normal, wanted)
        put("ambient", pixels, terms.ambient)
        put("diffuse", pixels, terms.diffuse)
        put("specular", pixels, terms.specular)
        put("direct", pixels, terms.diffuse + terms.specular)
        for light, visible in enumerate(terms.visible):
            put(f"shadow.L{light}", pixels, visible)
        put("beauty", pixels, terms.color)

        bounces = self.settings.max_reflections if "reflection" in wanted else 0
        weight = np.ones(len(pixels))
        for bounce in range(1, bounces + 1):
            weight = weight * self.kr[hits.sphere]
            index = np.flatnonzero(weight > 0)
            if not index.size:
                break
            reflected = direction[index] - 2 * _dot(direction[index], normal[index])[:, None] * normal[index]
            reflected /= np.sqrt(_dot(reflected, reflected))[:, None]
            hits = self.leave(start[index], start.point[index], reflected)
            pixels, weight = pixels[index][hits.ray], weight[index][hits.ray]
            start, normal, direction = _land(hits, reflected)
            color = weight[:, None] * self.shade(hits, start, normal, wanted - {"shadow"}).color
            put(f"reflection.{bounce}", pixels, color)
            for name in ("reflection", "beauty"):
                if name in images:
                    images[name][pixels] += color
        return images


def _eye_rays(scene: Scene, settings: Settings) -> Vectors:
    """The points of the image plane that the pixels' rays go through."""
    view, frame = scene.view, converter.window(scene.view, settings.sample)
    x = frame.left + (frame.right - frame.left) * (np.arange(view.columns) + 0.5) / view.columns
    y = frame.top - (frame.top - frame.bottom) * (np.arange(view.rows) + 0.5) / view.rows
    points = np.empty((view.rows, view.columns, 3))
    points[..., 0], points[..., 1], points[..., 2] = x, y[:, None], -view.near
    return points.reshape(-1, 3)


def _land(hits: Hits, direction: Vectors) -> tuple[Start, Vectors, Vectors]:
    """The surface where rays hit, its normals turned to where the rays come from, and the rays that hit."""
    arriving = direction[hits.ray]
    inside = _dot(hits.normal, arriving) > 0
    normal = np.where(inside[:, None], -hits.normal, hits.normal)
    return Start(hits.position, hits.sphere, hits.normal, inside), normal, arriving


def _terms(passes: Sequence[str]) -> frozenset[str]:
    """The terms that the passes are made of."""
    made_of = {
        "direct": ("diffuse", "specular"),
        "beauty": ("ambient", "diffuse", "specular", "reflection"),
        "reflection": ("ambient", "diffuse", "specular", "reflection"),
    }
    stems = {name.partition(".")[0] for name in passes}
    return frozenset(term for stem in stems for term in made_of.get(stem, (stem,)))


def _blank(name: str, scene: Scene, pixels: int) -> NDArray[Any]:
    """A pass where every ray misses."""
    row = lookup(name)
    if row.quantity == "id":
        return np.full(pixels, -1, np.int32)
    if name == "beauty":
        return np.tile(np.array(scene.background, dtype=np.float64), (pixels, 1))
    shape = (pixels, len(row.channels)) if row.channels else (pixels,)
    return np.full(shape, row.miss, np.float64)


@functools.cache
def llvm() -> tuple[str | None, str]:
    """The newest LLVM library that Mitsuba works with and its version, or None and the reason.

    Some versions end the whole process, so each is tried in a process of its own.
    """
    asked = os.environ.get("DRJIT_LIBLLVM_PATH")
    candidates = [asked] if asked else _libraries()
    reason = "no LLVM library was found"
    for path in candidates:
        try:
            result = subprocess.run(
                [sys.executable, "-c", _PROBE],
                env={**os.environ, "DRJIT_LIBLLVM_PATH": path},
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
        except subprocess.TimeoutExpired:
            reason = f"Mitsuba hangs with {path}"
            continue
        if result.returncode == 0:
            return path, result.stdout.strip()
        reason = f"Mitsuba does not work with {path}"
    return None, f"{reason}: apt-get install libllvm19"


_PROBE = """
import drjit, mitsuba
mitsuba.set_variant("llvm_ad_rgb")
drjit.eval(drjit.minimum(drjit.arange(mitsuba.Float, 3), 1))
scene = mitsuba.load_dict({"type": "scene", "shape": {"type": "sphere"}})
ray = mitsuba.Ray3f(mitsuba.Point3f(0, 0, 3), mitsuba.Vector3f(0, 0, drjit.arange(mitsuba.Float, 3) - 1))
assert list(scene.ray_intersect_preliminary(ray).t)[:1] == [2.0]
print(".".join(map(str, drjit.detail.llvm_version())))
"""


def _libraries() -> list[str]:
    """LLVM libraries where distributions put them, newest first, without those that Mitsuba refuses or that abort."""
    found: dict[Path, int] = {}
    for folder in FOLDERS:
        for pattern in ("libLLVM*", "*-linux-gnu/libLLVM*", "llvm*/lib/libLLVM*"):
            for path in Path(folder).glob(pattern):
                # libLLVM-19.so, libLLVM.so.19.1, libLLVM.dylib; a number is 0 where the name has none.
                path = path.resolve()
                if path.is_file() and re.fullmatch(r"libLLVM[-.\d]*(so|dylib)[.\d]*", path.name):
                    found[path] = int((re.findall(r"\d+", path.name) or ["0"])[0])
    newest = sorted(found, key=lambda path: found[path], reverse=True)
    return [str(path) for path in newest if found[path] not in range(1, 17)]


class MitsubaSpec:
    """Mitsuba behind the face of a renderer, in one variant."""

    def __init__(self, backend: str) -> None:
        """`backend` is a key of VARIANTS."""
        self.backend = backend
        self.name = f"mitsuba-spec@{backend}"

    def version(self) -> str:
        """Mitsuba's version and the variant."""
        return f"{importlib.metadata.version('mitsuba')} {VARIANTS[self.backend]}"

    def versions(self) -> Mapping[str, str]:
        """Mitsuba, Dr.Jit, the variant, and the compiler where there is one."""
        versions = {package: importlib.metadata.version(package) for package in ("mitsuba", "drjit")}
        versions["mitsuba variant"] = VARIANTS[self.backend]
        if self.backend == "llvm":
            path, version = llvm()
            versions["LLVM"] = version if path else "none"
        return versions

    def unavailable(self) -> str | None:
        """The scalar variant needs nothing."""
        if self.backend == "scalar":
            return None
        path, reason = llvm()
        return None if path else reason

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Every pass but the margins; none where float32 does not hold the scene."""
        if not _fits_float32(scene):
            return ()
        every = names(len(scene.lights), settings.max_reflections)
        return tuple(name for name in every if not name.startswith("margin."))

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """What float32 and SLACK allow; docs/tolerances.md derives it."""
        del analysis
        roundings = SPHERE_ROUNDINGS
        ellipsoids = any(len({abs(value) for value in scene.spheres[i].scaling}) > 1 for i in scene.distinct)
        if ellipsoids:
            roundings += INSTANCE_ROUNDINGS
        relative: PerPixel = roundings * UNIT_ROUNDOFF
        terminator, unit = relative, relative
        oblique = ellipsoids and self.backend == "llvm"
        if oblique or _window_inside(scene, settings):
            losses = _losses(scene, settings, roundings)
            if oblique:
                relative = (roundings + GROWTH * losses.oblique) * UNIT_ROUNDOFF
            # 1: above the margin of any terminator.
            terminator = np.where(losses.undecided, 1.0, relative)
            unit = relative * losses.slope
        return Uncertainty(
            silhouette=relative,
            range=relative + SLACK,
            order=relative,
            terminator=terminator,
            unit=unit,
            absolute=floats.uncertainty("f32", scene, settings).absolute,
        )

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for.

        Raises:
            ValueError: a pass that it does not have for this scene.
            RuntimeError: this variant cannot run here.
        """
        if unknown := [name for name in passes if name not in self.passes(scene, settings)]:
            raise ValueError(f"{self.name} has no pass '{unknown[0]}' for this scene")
        with self.ready():
            driver = Driver(scene, settings, self.engine(scene))
            images = driver.render(passes)
        size = (scene.view.rows, scene.view.columns)
        return Passes({name: image.reshape(*size, *image.shape[1:]) for name, image in images.items()}, self.versions())

    def shapes(self, scene: Scene) -> dict[str, Any]:
        """What is loaded of the scene. Robust: boxes around shapes are not missed by a rounding."""
        return {"type": "scene", "embree_use_robust_intersections": True, **converter.geometry(scene)}

    def engine(self, scene: Scene) -> Engine:
        """The scene's shapes in this variant, which is set."""
        return Arrays(self.shapes(scene)) if self.backend == "llvm" else Loop(self.shapes(scene))

    def ready(self) -> contextlib.AbstractContextManager[None]:
        """Have the variant set."""
        if reason := self.unavailable():
            raise RuntimeError(f"{self.name} cannot run: {reason}")
        if self.backend == "llvm":
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(llvm()[0]))
        return mitsuba_plugins.variant(VARIANTS[self.backend])

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """For the loop, as many as it can do in BUDGET seconds: the work of a small picture tells.

        Counted, not timed, so that the same scene is always drawn at the same size.
        """
        if self.backend == "llvm":
            return None
        return _loop_pixels(scene, tuple(passes))


@functools.lru_cache(maxsize=256)
def _loop_pixels(scene: Scene, passes: tuple[str, ...]) -> int | None:
    view = scene.view
    if view.columns * view.rows <= PROBE * PROBE:
        return None
    small = scene.replace(view=view.replace(columns=PROBE, rows=PROBE))
    scalar = MitsubaSpec("scalar")
    with scalar.ready():
        engine = Loop(scalar.shapes(small))
        Driver(small, Settings(), engine).render(passes)
    seconds = sum(COST[kind] * count for kind, count in engine.work.items())
    return max(PROBE * PROBE, int(BUDGET / seconds * PROBE * PROBE))


def _window_inside(scene: Scene, settings: Settings) -> bool:
    """Whether any primary ray starts inside a sphere: no others ever come to see an inside."""
    frame = converter.window(scene.view, settings.sample)
    for i in scene.distinct:
        (x, y, z), scaling = scene.spheres[i].position, scene.spheres[i].scaling
        nearest = (min(max(x, frame.left), frame.right), min(max(y, frame.bottom), frame.top), -scene.view.near)
        if sum(((a - b) / c) ** 2 for a, b, c in zip(nearest, (x, y, z), scaling, strict=True)) < 1:
            return True
    return False


@dataclasses.dataclass
class Losses:
    """Where Mitsuba's sphere routine loses digits, by pixel; the worst over the chain of rays of each."""

    oblique: NDArray[np.float64]  # h^2, see `_oblique`
    undecided: Flags  # a shadow ray inside a sphere whose other root float32 cannot tell
    slope: NDArray[np.float64]  # by how much the errors of roots grow where rays stay inside a sphere; inf: lost


def _losses(scene: Scene, settings: Settings, roundings: float) -> Losses:
    """Follow every ray of the picture, in NumPy, and look at how it meets what it may meet."""
    view, tables = scene.view, reference.Tables(scene, np.float64)
    eye = np.append(np.array([s.position for s in scene.spheres]).reshape(-1, 3).T, np.zeros((3, 1)), axis=1)
    lights = [np.array(light.position)[:, None] for light in scene.lights]
    parts = []
    for rows in reference.bands(view):
        count = len(rows) * view.columns
        part = Losses(np.zeros(count), np.zeros(count, dtype=bool), np.ones(count))
        with np.errstate(all="ignore"):
            primary = reference.eye_rays(tables, view, settings.sample, rows)
            for rays, _, at in reference.trace(tables, primary, settings.max_reflections):
                _oblique(scene, part, rays.pixel, eye[:, rays.start] + rays.offset, rays.direction)
                x = at.x
                position = eye[:, x.start] + x.offset
                facing = [np.flatnonzero((at.normal * (light - position)).sum(axis=0) > 0) for light in lights]
                for light, lit in zip(lights, facing, strict=True):
                    _oblique(scene, part, x.pixel[lit], position[:, lit], (light - position)[:, lit])
                # The discriminant of a chord is c^2; it moves by this times the size of what is between its ends.
                scaling = tables.scaling[:, x.start]
                error = CHORD * (roundings + GROWTH * part.oblique[x.pixel]) * UNIT_ROUNDOFF / scaling.min(axis=0)
                size = np.linalg.norm(position, axis=0)
                for light, lit in zip(lights, facing, strict=True):
                    c = _cosine(x.point, (light - position) / scaling)
                    lost = x.inside & (c**2 < error * (size + np.linalg.norm(light)))
                    part.undecided[x.pixel[lit]] |= lost[lit]
                c = _cosine(x.point, x.direction / scaling)
                steep = np.where(c**2 < error * size, np.inf, 1 / c)
                mirrors = np.flatnonzero(x.inside & (tables.kr[x.start] > 0))
                part.slope[x.pixel[mirrors]] = np.maximum(part.slope[x.pixel], steep)[mirrors]
        parts.append(part)
    shape = (view.rows, view.columns)
    return Losses(
        np.concatenate([part.oblique for part in parts]).reshape(shape),
        np.concatenate([part.undecided for part in parts]).reshape(shape),
        np.concatenate([part.slope for part in parts]).reshape(shape),
    )


def _oblique(scene: Scene, part: Losses, pixel: Index, origin: Any, direction: Any) -> None:
    """How far a ray still is from the point closest to an ellipsoid's centre when Mitsuba sets up the quadratic.

    In the ellipsoid's space, its radius 1. The routine first walks along the ray to that point, to keep the digits of
    the discriminant, but divides by |d| where |d|^2 is due: in an instance, where |d| < 1, it stops h short of it.
    """
    direction = direction / np.linalg.norm(direction, axis=0)
    for i in scene.distinct:
        scaling = np.abs(np.array(scene.spheres[i].scaling))[:, None]
        to_center = (np.array(scene.spheres[i].position)[:, None] - origin) / scaling
        local = direction * (scaling.min() / scaling)
        speed = np.linalg.norm(local, axis=0)
        along = (to_center * local).sum(axis=0) / speed
        beside = (to_center**2).sum(axis=0) - along**2
        # Far from the outline no error of the discriminant decides anything.
        h = np.where(beside < 4, along * (1 - speed), 0)
        part.oblique[pixel] = np.maximum(part.oblique[pixel], h**2)


def _cosine(normal: Any, direction: Any) -> Any:
    """|n.d| / |d| for columns, |n| = 1."""
    return np.abs((normal * direction).sum(axis=0)) / np.linalg.norm(direction, axis=0)


def _fits_float32(scene: Scene) -> bool:
    """Whether every number of the scene lies in RANGE, or is 0."""
    view = scene.view
    numbers = [view.near, view.left, view.right, view.bottom, view.top, *scene.background, *scene.ambient]
    for sphere in scene.spheres:
        numbers += [*sphere.position, *sphere.scaling]
    for light in scene.lights:
        numbers += [*light.position, *light.intensity]
    return all(number == 0 or RANGE[0] <= abs(number) <= RANGE[1] for number in numbers)


def renderers() -> list[MitsubaSpec]:
    """The entry point: the best first."""
    return [MitsubaSpec("llvm"), MitsubaSpec("scalar")]
