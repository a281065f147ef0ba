"""What Mitsuba may be off by, in float32 and with `SLACK`, pixel by pixel; docs/tolerances.md derives it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from tracer import reference
from tracer.motion import DECISION, VALUE
from validation.renderers import PerPixel, Settings, Uncertainty, floats

if TYPE_CHECKING:
    from tracer import Scene
    from validation.rules import Rule

UNIT_ROUNDOFF = floats.UNIT_ROUNDOFF["f32"]
#: Mitsuba's roots are off by up to this times the largest coordinate; docs/tolerances.md counts it.
SLACK = 16 * UNIT_ROUNDOFF
#: Magnitudes that float32 holds together with their squares.
RANGE = (1e-15, 1e15)
#: Roundings for each change that margins count, in a decision about a plain sphere, and by how many an instance adds;
#: how much the sphere routine adds in an oblique instance, times h^2; and how the discriminant of a chord moves with a
#: change. docs/tolerances.md derives them.
SPHERE_ROUNDINGS = DECISION
INSTANCE_ROUNDINGS = DECISION
GROWTH = 2
CHORD = 8
#: Margins are this many times the roundings at least: so a discriminant keeps a part 1 - 1 / ROOM of itself.
ROOM = 2


def uncertainty(scene: Scene, settings: Settings, *, float32_roots: bool) -> Uncertainty:
    """How far any picture of this scene may be off; `float32_roots`: whether the sphere routine works in float32."""
    ellipsoids, roundings = roundings_of(scene)
    oblique: PerPixel = 0.0
    hits: PerPixel = 0.0
    undecided: PerPixel = 0.0
    slope: PerPixel = 1.0
    if (ellipsoids and float32_roots) or _window_inside(scene, settings):
        losses = _losses(scene, settings, roundings)
        # 1: above the margin of any terminator.
        slope, undecided = losses.slope, losses.undecided.astype(np.float64)
        if ellipsoids and float32_roots:
            oblique, hits = GROWTH * losses.oblique, GROWTH * losses.hits
    relative = ROOM * (roundings + oblique) * UNIT_ROUNDOFF
    # The slope of each root of the chain, 1 / sqrt(D), grows by sqrt(1 - 1 / ROOM) at most.
    mirrors = any(scene.spheres[i].kr > 0 for i in scene.distinct)
    slope = slope * (1 - 1 / ROOM) ** (-0.5 * (1 + (settings.max_reflections if mirrors else 0)))
    # Sensitivities count roundings twice as much as margins do.
    unit = (roundings * VALUE / DECISION + hits) * UNIT_ROUNDOFF * slope
    terminator = np.maximum(relative, undecided)
    return Uncertainty(
        silhouette=relative,
        range=relative + SLACK,
        order=relative,
        terminator=terminator,
        unit=unit,
        absolute=floats.uncertainty("f32", scene, settings).absolute,
    )


def roundings_of(scene: Scene) -> tuple[bool, float]:
    """Whether a scene has ellipsoids, which are instances, and the roundings of a decision."""
    ellipsoids = any(len({abs(value) for value in scene.spheres[i].scaling}) > 1 for i in scene.distinct)
    return ellipsoids, SPHERE_ROUNDINGS + INSTANCE_ROUNDINGS * ellipsoids


def _flat(lost: Any, size: Any, shortest: Any) -> Any:
    """A chord inside a sphere with c^2 below this is too flat for float32.

    `lost`: roundings; `size`: the distances of its ends from the eye, added; `shortest`: of the sphere's scalings.
    """
    return CHORD * lost * UNIT_ROUNDOFF * size / shortest


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
    hits: NDArray[np.float64]  # that of the spheres that are hit
    undecided: NDArray[np.bool_]  # a shadow ray inside a sphere whose other root float32 cannot tell
    slope: NDArray[np.float64]  # by how much the errors of roots grow where rays stay inside a sphere; inf: lost


def _losses(scene: Scene, settings: Settings, roundings: float) -> Losses:
    """Follow every ray of the picture, in NumPy, and look at how it meets what it may meet."""
    view, tables = scene.view, reference.Tables(scene, np.float64)
    eye = np.append(np.array([s.position for s in scene.spheres]).reshape(-1, 3).T, np.zeros((3, 1)), axis=1)
    lights = [np.array(light.position)[:, None] for light in scene.lights]
    parts = []
    for rows in reference.bands(view):
        count = len(rows) * view.columns
        part = Losses(np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool), np.ones(count))
        with np.errstate(all="ignore"):
            primary = reference.eye_rays(tables, view, settings.sample, rows)
            for rays, hits, at in reference.trace(tables, primary, settings.max_reflections):
                _oblique(scene, part, rays.pixel, eye[:, rays.start] + rays.offset, rays.direction, hits.sphere)
                x = at.x
                position = eye[:, x.start] + x.offset
                facing = [np.flatnonzero((at.normal * (light - position)).sum(axis=0) > 0) for light in lights]
                for light, lit in zip(lights, facing, strict=True):
                    _oblique(scene, part, x.pixel[lit], position[:, lit], (light - position)[:, lit])
                scaling = tables.scaling[:, x.start]
                lost, shortest = roundings + GROWTH * part.oblique[x.pixel], scaling.min(axis=0)
                size = np.linalg.norm(position, axis=0)
                for light, lit in zip(lights, facing, strict=True):
                    c = _cosine(x.point, (light - position) / scaling)
                    flat = x.inside & (c**2 < _flat(lost, size + np.linalg.norm(light), shortest))
                    part.undecided[x.pixel[lit]] |= flat[lit]
                c = _cosine(x.point, x.direction / scaling)
                steep = np.where(c**2 < _flat(lost, size, shortest), np.inf, 1 / c)
                mirrors = np.flatnonzero(x.inside & (tables.kr[x.start] > 0))
                part.slope[x.pixel[mirrors]] = np.maximum(part.slope[x.pixel], steep)[mirrors]
        parts.append(part)
    shape = (view.rows, view.columns)
    return Losses(
        np.concatenate([part.oblique for part in parts]).reshape(shape),
        np.concatenate([part.hits for part in parts]).reshape(shape),
        np.concatenate([part.undecided for part in parts]).reshape(shape),
        np.concatenate([part.slope for part in parts]).reshape(shape),
    )


def _oblique(scene: Scene, part: Losses, pixel: NDArray[np.intp], origin: Any, direction: Any, hit: Any = -1) -> None:
    """How far a ray still is from the point closest to an ellipsoid's centre when Mitsuba sets up the quadratic.

    In the ellipsoid's space, its radius 1. The routine first walks along the ray to that point, to keep the digits of
    the discriminant, but divides by |d| where |d|^2 is due: in an instance, where |d| < 1, it stops h short of it.
    `hit` is the sphere that each ray hits.
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
        part.hits[pixel] = np.maximum(part.hits[pixel], np.where(hit == i, h**2, 0))


def _cosine(normal: Any, direction: Any) -> Any:
    """|n.d| / |d| for columns, |n| = 1."""
    return np.abs((normal * direction).sum(axis=0)) / np.linalg.norm(direction, axis=0)


def fits_float32(scene: Scene) -> bool:
    """Whether every number of the scene lies in RANGE, or is 0."""
    view = scene.view
    numbers = [view.near, view.left, view.right, view.bottom, view.top, *scene.background, *scene.ambient]
    for sphere in scene.spheres:
        numbers += [*sphere.position, *sphere.scaling]
    for light in scene.lights:
        numbers += [*light.position, *light.intensity]
    return all(number == 0 or RANGE[0] <= abs(number) <= RANGE[1] for number in numbers)


def flat_chords(scene: Scene, settings: Settings, *, float32_roots: bool) -> Sequence[Rule]:
    """The rule by which Mitsuba decides on flat chords inside a sphere; docs/tolerances.md derives the bound."""
    from validation.follow import Follower, Hit, Vector
    from validation.rules import Rule
    from validation.truth import Prover

    _, roundings = roundings_of(scene)

    class Flat(Follower):
        """A ray from the inside of a sphere whose discriminant c^2 is within the rounding of float32.

        A chord is the bounce at which it starts and the light that it leads to, -1: it is reflected. Mitsuba may miss
        its far end, or find it before a light that stands before it.
        """

        otherwise: frozenset[tuple[int, int]] = frozenset()
        found: set[tuple[int, int]]

        def flat(self, sphere: int, gradient: Vector, direction: Vector, point: Vector, end: float) -> bool:
            """Whether c^2 = (n.d)^2 / d.d, in the space of the sphere, is below the bound."""
            A = sum(w * d * d for w, d in zip(self.tables.w[sphere], direction, strict=True))
            B = sum(g * d for g, d in zip(gradient, direction, strict=True))
            scaling = [abs(value) for value in scene.spheres[sphere].scaling]
            size = math.hypot(*map(about, point)) + end
            lost = roundings
            if float32_roots and len(set(scaling)) > 1:
                # As in `_oblique`: along the ray to the point next to the centre, and how short of it the walk ends.
                length = math.hypot(*map(about, direction))
                speed = math.sqrt(about(A)) * min(scaling) / length
                lost += GROWTH * (about(B) / math.sqrt(about(A)) * (1 - speed)) ** 2
            return about(B) < 0 and bool(about(B) ** 2 < _flat(lost, size, min(scaling)) * about(A))

        def nearest(
            self, relative: list[Any], direction: Vector, bounce: int, own: int, inside: bool
        ) -> tuple[int, Any, bool, bool] | None:
            """The chord's far end is there, or not."""
            if inside:
                (mx, my, mz), gradient, _ = relative[own]
                px, py, pz = self.tables.position[own]
                if self.flat(own, gradient, direction, (mx + px, my + py, mz + pz), 0.0):
                    self.found.add((bounce - 1, -1))
                    inside = (bounce - 1, -1) not in self.otherwise
            return super().nearest(relative, direction, bounce, own, inside)

        def hides(self, hit: Hit, relative: Any, to_light: Vector, i: int, j: int) -> bool:
            """The sphere hides the light, or not."""
            hidden = super().hides(hit, relative, to_light, i, j)
            end = math.hypot(*scene.lights[i].position)
            if j == hit.sphere and hit.inside and self.flat(j, relative[1], to_light, hit.point, end):
                self.found.add((hit.bounce, i))
                hidden ^= (hit.bounce, i) in self.otherwise
            return hidden

    def choices(x: int, y: int) -> Iterator[type[Follower]]:
        """One chord is decided otherwise, then two, and so on; after a chord that is lost the ray has others."""
        waiting: list[frozenset[tuple[int, int]]] = [frozenset()]
        for otherwise in waiting:
            found: set[tuple[int, int]] = set()
            follower = type("Flat", (Flat,), {"otherwise": otherwise, "found": found})
            Prover(scene, settings, follower=follower).examine(x, y)
            waiting += [otherwise | {chord} for chord in sorted(found) if chord > max(otherwise, default=(-1, -1))]
            if otherwise:
                yield follower

    says = "cannot tell the far end of a chord inside a sphere from its start, where the chord is so flat"
    return [Rule(says, choices=choices)]


def about(value: Any) -> float:
    """A ball or an exact number as a float."""
    return float(getattr(value, "ball", value).mid())
