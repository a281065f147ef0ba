"""The specification's loop over lights and bounces, on Mitsuba's intersections and BSDFs."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from tracer.passes import lookup
from validation.renderers.mitsuba.engines import Engine, Hits, Index, Vectors
from validation.renderers.mitsuba.precision import SLACK, UNIT_ROUNDOFF

if TYPE_CHECKING:
    from tracer import Scene
    from validation.renderers import Settings

Flags = NDArray[np.bool_]

#: How often a ray goes on behind a hit that does not count, each time by a step four times as long.
RETRIES = 8


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
        self.position = np.array([s.position for s in spheres]).reshape(-1, 3)
        self.scaling = np.array([s.scaling for s in spheres]).reshape(-1, 3)
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

    def land(
        self, hits: Hits, origin: Vectors, direction: Vectors, own: Index | None = None
    ) -> tuple[Start, Vectors, Vectors]:
        """The surface where rays hit, its normals turned to where the rays come from, and the rays that hit.

        `own`: the spheres that rays start on; their hits that count are all from inside. Of another sphere the inside
        is hit by what starts in it. The angle of ray and normal does not tell: at an outline rounding turns it over. It
        does tell where a primary ray starts on the sphere as far as float32 knows: only the other root is left then.
        """
        start, position, scaling = origin[hits.ray], self.position[hits.sphere], self.scaling[hits.sphere]
        beside = (start - position) / scaling
        depth = _dot(beside, beside) - 1
        # Start, centre and scaling are rounded to float32, each by u times itself: half the motion of |beside|^2.
        moves = np.abs(beside / scaling) * (np.abs(start) + np.abs(position) + np.abs(start - position))
        on = np.abs(depth) <= 2 * UNIT_ROUNDOFF * moves.sum(axis=1)
        inside = np.where(on, _dot(hits.normal, direction[hits.ray]) > 0, depth < 0)
        if own is not None:
            inside |= own[hits.ray] == hits.sphere
        self.engine.face(hits, inside)
        normal = np.where(inside[:, None], -hits.normal, hits.normal)
        return Start(hits.position, hits.sphere, hits.normal, inside), normal, direction[hits.ray]

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
        start, normal, direction = self.land(hits, points, direction)
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
            left = start[index]
            hits = self.leave(left, left.point, reflected)
            pixels, weight = pixels[index][hits.ray], weight[index][hits.ray]
            start, normal, direction = self.land(hits, left.point, reflected, left.sphere)
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
