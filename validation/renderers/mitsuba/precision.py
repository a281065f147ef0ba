"""What Mitsuba may be off by, in float32 and with `SLACK`, pixel by pixel; docs/tolerances.md derives it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from tracer import reference
from tracer.motion import DECISION, VALUE
from validation.renderers import PerPixel, Settings, Uncertainty, floats

if TYPE_CHECKING:
    from tracer import Scene
    from validation.follow import Follower, Tables, Vector
    from validation.rules import Rule

Flags = NDArray[np.bool_]

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
#: A hit point of an instance is off by so many u of the way to the point next to the centre, in radii.
POINT = 16
#: Of what an equation is off by at a point, half the discriminant of a short chord next to it shows four times as much.
SHORT = 4
#: A light counts as beside a surface if its equation there is below this.
BESIDE = 1 / 8
#: Margins are this many times the roundings at least: so a discriminant keeps a part 1 - 1 / ROOM of itself.
ROOM = 2


def uncertainty(scene: Scene, settings: Settings, *, float32_roots: bool) -> Uncertainty:
    """How far any picture of this scene may be off; `float32_roots`: whether the sphere routine works in float32."""
    ellipsoids, roundings = roundings_of(scene)
    oblique: PerPixel = 0.0
    hits: PerPixel = 0.0
    undecided: PerPixel = 0.0
    slope: PerPixel = 1.0
    thin = _thin(scene)
    if (ellipsoids and float32_roots) or thin or _window_inside(scene, settings):
        losses = _losses(scene, settings, roundings, UNIT_ROUNDOFF if float32_roots else floats.UNIT_ROUNDOFF["f64"])
        # 1: above the margin of any terminator.
        slope, undecided = losses.slope, losses.undecided.astype(np.float64)
        if (ellipsoids and float32_roots) or thin:
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


def _thin(scene: Scene) -> bool:
    """Whether a ray may be so many radii from the centre of an ellipsoid that its hit points have no normal left."""
    view = scene.view
    corner = math.hypot(max(abs(view.left), abs(view.right)), max(abs(view.bottom), abs(view.top)), view.near)
    spheres = [scene.spheres[i] for i in scene.distinct]
    extent = max([corner, *(math.hypot(*s.position) + max(map(abs, s.scaling)) for s in spheres)])
    shortest = [min(map(abs, s.scaling)) for s in spheres if len(set(map(abs, s.scaling))) > 1]
    return any(4 * POINT * UNIT_ROUNDOFF * extent > length for length in shortest)


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

    oblique: NDArray[np.float64]  # h^2, see `_oblique`, in units of what float32 makes of it
    hits: NDArray[np.float64]  # that of the spheres that are hit
    undecided: NDArray[np.bool_]  # a shadow ray inside a sphere whose other root float32 cannot tell
    slope: NDArray[np.float64]  # by how much the errors of roots grow where rays stay inside a sphere; inf: lost


def _losses(scene: Scene, settings: Settings, roundings: float, roots: float) -> Losses:
    """Follow every ray of the picture, in NumPy, and look at how it meets what it may meet.

    `roots`: the unit roundoff in which the sphere routine works.
    """
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
                start = eye[:, rays.start] + rays.offset
                _oblique(scene, part, roots, rays.pixel, start, rays.direction, hits.sphere)
                x = at.x
                position = eye[:, x.start] + x.offset
                facing = [np.flatnonzero((at.normal * (light - position)).sum(axis=0) > 0) for light in lights]
                for light, lit in zip(lights, facing, strict=True):
                    _oblique(scene, part, roots, x.pixel[lit], position[:, lit], (light - position)[:, lit])
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


def _oblique(
    scene: Scene,
    part: Losses,
    roots: float,
    pixel: NDArray[np.intp],
    origin: Any,
    direction: Any,
    hit: Any = -1,
) -> None:
    """How far a ray still is from the point closest to an ellipsoid's centre when Mitsuba sets up the quadratic.

    In the ellipsoid's space, its radius 1. The routine first walks along the ray to that point, to keep the digits of
    the discriminant, but divides by |d| where |d|^2 is due: in an instance, where |d| < 1, it stops h short of it.
    `roots`: the unit roundoff of that. `hit` is the sphere that each ray hits: where the hit point is off by as much as
    the radius, nothing is known of its normal.
    """
    direction = direction / np.linalg.norm(direction, axis=0)
    for i in scene.distinct:
        scaling = np.abs(np.array(scene.spheres[i].scaling))[:, None]
        if np.ptp(scaling) == 0:
            continue
        to_center = (np.array(scene.spheres[i].position)[:, None] - origin) / scaling
        local = direction * (scaling.min() / scaling)
        speed = np.linalg.norm(local, axis=0)
        along = (to_center * local).sum(axis=0) / speed
        beside = (to_center**2).sum(axis=0) - along**2
        h_squared = (along * (1 - speed)) ** 2
        # Far from the outline no error of the discriminant decides anything.
        near = beside - 1 < np.maximum(3, ROOM * 3 * GROWTH * roots * h_squared)
        h_squared = np.where(near, h_squared * (roots / UNIT_ROUNDOFF), 0)
        part.oblique[pixel] = np.maximum(part.oblique[pixel], h_squared)
        part.hits[pixel] = np.maximum(part.hits[pixel], np.where(hit == i, h_squared, 0))
        lost = pixel[(hit == i) & (POINT * UNIT_ROUNDOFF * np.abs(along) > 1 / 2)]
        part.undecided[lost], part.slope[lost] = True, np.inf


def _cosine(normal: Any, direction: Any) -> Any:
    """|n.d| / |d| for columns, |n| = 1."""
    return np.abs((normal * direction).sum(axis=0)) / np.linalg.norm(direction, axis=0)


class Approach:
    """The ways to a light that is beside a surface, which they may meet before the light or not.

    Mitsuba's hits do not count that are less than SLACK, times the largest coordinate, from the light, across the
    surface; docs/tolerances.md derives on which ways float32 may say either.
    """

    def __init__(self, scene: Scene, sphere: int, light: int, *, oblique: bool) -> None:
        """`oblique`: whether rays lose digits on the way to an instance."""
        ball = scene.spheres[sphere]
        self.sphere, self.light = sphere, light
        self.scaling = np.abs(np.array(ball.scaling))[:, None]
        self.center = np.array(ball.position)[:, None]
        self.place = np.array(scene.lights[light].position)[:, None]
        self.side = int(reference.light_sides(self.place, self.center, self.scaling)[0, 0])
        self.oblique = oblique and np.ptp(self.scaling) > 0
        _, self.roundings = roundings_of(scene)

    @staticmethod
    def all(scene: Scene, *, oblique: bool) -> list[Approach]:
        """Of every light and every surface that it is beside."""
        every = [Approach(scene, j, i, oblique=oblique) for j in scene.distinct for i in range(len(scene.lights))]
        return [each for each in every if abs(float(reference.dot(*[each.scaled(each.place)] * 2)[0]) - 1) < BESIDE]

    def scaled(self, point: Any) -> Any:
        """In the unit space of the sphere."""
        return (point - self.center) / self.scaling

    def open(self, origin: Any, position: Any, own: Any, epsilon: float) -> Flags:
        """For columns: `position` in the world, `origin` the same in unit space, `own` whether on the sphere itself."""
        to_light = self.place - position
        direction = to_light / self.scaling
        A, B = reference.dot(direction, direction), reference.dot(origin, direction)
        if self.side == 0:
            # One root is 1, and the other by their product.
            t = (reference.dot(origin, origin) - 1) / A
            counts = ~own & (t > epsilon)
        else:
            line = reference.chord(origin, direction)
            t = np.where(own, -2 * B / A, np.where(line.near > epsilon, line.near, line.far))
            counts = np.where(own, self.side > 0, line.meets) & (t > epsilon) & (t < 1)
        lost: Any = self.roundings
        if self.oblique:
            # As in `_oblique`.
            speed = np.sqrt(A) * self.scaling.min() / np.linalg.norm(to_light, axis=0)
            lost = lost + GROWTH * (B / np.sqrt(A) * (1 - speed)) ** 2
        y = origin + t * direction
        gradient = np.abs(y / self.scaling)
        off = reference.dot(gradient, np.abs(position) + np.abs(to_light) + np.abs(self.center)) + 1
        off = ROOM * lost * UNIT_ROUNDOFF * off
        size = np.maximum(np.abs(self.place).max(), np.abs(position).max(axis=0))
        slack = SLACK * size * np.linalg.norm(gradient, axis=0)
        if self.side == 0:
            # The square of half the chord is what is left of the discriminant.
            return np.asarray(counts & (A * ((1 - t) / 2) ** 2 <= slack / 2 + 2 * off))
        # From the inside of the sphere itself the light's own depth: chords that are flat are told apart elsewhere.
        deep = (1 - t) * np.where(own, A / 2, np.abs(reference.dot(y, direction)))
        return np.asarray(counts & (deep <= slack + off * np.where(own | (self.side < 0), 1, SHORT)))


def at_lights(scene: Scene, settings: Settings, *, float32_roots: bool) -> Flags:
    """Pixels with a shadow ray of which Mitsuba may not tell whether it meets a sphere just before the light."""
    view, tables = scene.view, reference.Tables(scene, np.float64)
    found = np.zeros(view.columns * view.rows, bool)
    approaches = Approach.all(scene, oblique=float32_roots)
    eye = np.append(np.array([s.position for s in scene.spheres]).reshape(-1, 3).T, np.zeros((3, 1)), axis=1)
    with np.errstate(all="ignore"):
        for rows in reference.bands(view) if approaches else ():
            primary = reference.eye_rays(tables, view, settings.sample, rows)
            for _, _, at in reference.trace(tables, primary, settings.max_reflections):
                x = at.x
                position = eye[:, x.start] + x.offset
                for way in approaches:
                    own = x.start == way.sphere
                    origin = np.where(own, x.point, way.scaled(position))
                    either = way.open(origin, position, own, settings.shadow_epsilon) & (x.inside | ~own)
                    either &= reference.dot(at.normal, way.place - position) > 0
                    found[rows.start * view.columns + x.pixel[either]] = True
    return found.reshape(view.rows, view.columns)


def passed_over(scene: Scene, settings: Settings, *, float32_roots: bool) -> Sequence[Rule]:
    """The rule by which hits just before a light do not count, where a light is beside a surface."""
    from validation.follow import Follower, Hit
    from validation.rules import Rule

    approaches = {(way.light, way.sphere): way for way in Approach.all(scene, oblique=float32_roots)}

    class Passing(Follower):
        """Each such hit, named by bounce, light and sphere, counts or does not."""

        otherwise: frozenset[tuple[int, int, int]] = frozenset()
        found: set[tuple[int, int, int]]

        def hides(self, hit: Hit, relative: Any, to_light: Vector, i: int, j: int) -> bool:
            hidden, own = super().hides(hit, relative, to_light, i, j), j == hit.sphere
            if (i, j) in approaches and (hit.inside or not own):
                way = approaches[i, j]
                from_center, position = (np.array([[about(v)] for v in of]) for of in (relative[0], hit.point))
                with np.errstate(all="ignore"):
                    either = way.open(from_center / way.scaling, position, np.array([own]), settings.shadow_epsilon)
                if either[0]:
                    self.found.add((hit.bounce, i, j))
                    hidden ^= (hit.bounce, i, j) in self.otherwise
            return hidden

    says = (
        f"does not count hits that are nearer to a light than {SLACK:.2g} of the largest coordinate, across the surface"
    )
    return [Rule(says, choices=choosing(scene, settings, Passing))] if approaches else []


def choosing(scene: Scene, settings: Settings, kind: type[Follower]) -> Callable[[int, int], Iterator[type[Follower]]]:
    """Of a follower that puts what it may take either way into `found`: one is in `otherwise`, then two, and so on."""
    from validation.truth import Prover

    def choices(x: int, y: int) -> Iterator[type[Follower]]:
        waiting: list[frozenset[tuple[int, ...]]] = [frozenset()]
        for otherwise in waiting:
            found: set[tuple[int, ...]] = set()
            follower = type(kind.__name__, (kind,), {"otherwise": otherwise, "found": found})
            # After one that is taken otherwise a ray may have others.
            Prover(scene, settings, follower=follower).examine(x, y)
            waiting += [otherwise | {one} for one in sorted(found) if one > max(otherwise, default=(-1,))]
            if otherwise:
                yield follower

    return choices


def fits_float32(scene: Scene) -> bool:
    """Whether every number of the scene lies in RANGE, or is 0."""
    view = scene.view
    numbers = [view.near, view.left, view.right, view.bottom, view.top, *scene.background, *scene.ambient]
    for sphere in scene.spheres:
        numbers += [*sphere.position, *sphere.scaling]
    for light in scene.lights:
        numbers += [*light.position, *light.intensity]
    return all(number == 0 or RANGE[0] <= abs(number) <= RANGE[1] for number in numbers)


def flat(
    scene: Scene,
    tables: Tables,
    sphere: int,
    gradient: Vector,
    direction: Vector,
    along: float,
    size: float,
    *,
    oblique: bool,
) -> bool:
    """Whether c^2 = (n.d)^2 / d.d, in the space of the sphere, is below what float32 can tell from 0.

    `along`: how much of the direction lies between the start of the ray and the point n; `size`: the distances of both
    from the eye, added; `oblique`: whether rays lose digits on the way to an instance.
    """
    A = sum(about(w) * about(d) ** 2 for w, d in zip(tables.w[sphere], direction, strict=True))
    B = sum(about(g) * about(d) for g, d in zip(gradient, direction, strict=True))
    scaling = [abs(value) for value in scene.spheres[sphere].scaling]
    _, lost = roundings_of(scene)
    if oblique and len(set(scaling)) > 1:
        # As in `_oblique`: along the ray to the point next to the centre, and how short of it the walk ends.
        speed = math.sqrt(A) * min(scaling) / math.hypot(*map(about, direction))
        lost += GROWTH * ((B / A - along) * math.sqrt(A) * (1 - speed)) ** 2
    return bool(_flat(lost, size, min(scaling)) * A > B**2)


def flat_chords(scene: Scene, settings: Settings, *, float32_roots: bool) -> Sequence[Rule]:
    """The rule by which Mitsuba decides on flat chords inside a sphere; docs/tolerances.md derives the bound."""
    from validation.follow import Follower, Hit
    from validation.rules import Rule

    class Flat(Follower):
        """A ray from the inside of a sphere whose discriminant c^2 is within the rounding of float32.

        A chord is the bounce at which it starts and the light that it leads to, -1: it is reflected. Mitsuba may miss
        its far end, or find it before a light that stands before it.
        """

        otherwise: frozenset[tuple[int, int]] = frozenset()
        found: set[tuple[int, int]]

        def flat(self, sphere: int, gradient: Vector, direction: Vector, point: Vector, end: float) -> bool:
            """Whether the chord inside a sphere that starts at a point is too flat."""
            B = sum(about(g) * about(d) for g, d in zip(gradient, direction, strict=True))
            size = math.hypot(*map(about, point)) + end
            return B < 0 and flat(scene, self.tables, sphere, gradient, direction, 0.0, size, oblique=float32_roots)

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

    says = "cannot tell the far end of a chord inside a sphere from its start, where the chord is so flat"
    return [Rule(says, choices=choosing(scene, settings, Flat))]


def about(value: Any) -> float:
    """A ball or an exact number as a float."""
    return float(getattr(value, "ball", value).mid())
