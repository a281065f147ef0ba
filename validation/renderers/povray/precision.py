"""What POV-Ray may be off by: 16 bits, colors in float32, and its epsilons; docs/tolerances.md derives it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from converters import povray as converter
from converters.povray import DIGITS, STEPS, TERMS, TRANSMIT
from tracer import reference
from tracer.motion import DECISION, VALUE
from validation.renderers import Settings, Uncertainty, floats
from validation.renderers.povray.pictures import PLAIN, Model

if TYPE_CHECKING:
    from tracer import Scene, Sphere
    from tracer.margins import Analysis
    from tracer.reference import Flags, Rays, Real, Surface, Tables
    from validation.rules import Rule

UNIT_ROUNDOFF = floats.UNIT_ROUNDOFF["f64"]
SINGLE = floats.UNIT_ROUNDOFF["f32"]

# POV-Ray 3.7's own epsilons; lengths are its, so in units of the scene they are divided by the converter's `unit`.
#: Hits nearer to the start of a ray do not count (MIN_ISECT_DEPTH), ...
NEAREST = 1e-4
#: ... nor, for shadow rays, those nearer than this to the start or to the light (SMALL_TOLERANCE, SHADOW_TOLERANCE).
SHADOW = 1e-3
#: In the space of an ellipsoid's own sphere hits nearer than this do not count (DEPTH_TOLERANCE of its spheres).
OWN_SPACE = 1e-6
#: The square of half a chord, the depth before a plane that clips, a cosine to the light: below this they are 0
#: (EPSILON).
EPSILON = 1e-10

#: Roundings in a decision: those of an instance in Mitsuba, whose steps are the same; and how many the textbook
#: discriminant adds, times the square of the distance to the sphere in its radii. docs/tolerances.md derives them.
ROUNDINGS = 2 * DECISION
GROWTH = 7
#: Margins are this many times the roundings at least: so a discriminant keeps a part 1 - 1 / ROOM of itself.
ROOM = 2


def uncertainty(scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
    """How far any picture of this scene may be off.

    Without `analysis`, what has no bound is infinite. With it, as large as makes an edge of the passes that depend on
    it, so that others, which do not, are not lost.
    """
    unit = converter.unit(scene)
    losses = _Losses(scene, settings)
    relative = ROOM * (ROUNDINGS + GROWTH * losses.far) * UNIT_ROUNDOFF
    smallest = min((_radius(sphere, unit) for sphere in converter.distinct(scene)), default=math.inf)
    mirrors = any(sphere.kr > 0 for sphere in converter.distinct(scene))
    slope = (1 - 1 / ROOM) ** (-0.5 * (1 + (settings.max_reflections if mirrors else 0)))
    values = (ROUNDINGS * VALUE / DECISION + GROWTH * losses.hit) * UNIT_ROUNDOFF * slope
    near = relative + EPSILON / (scene.view.near * unit)
    lighted = analysis.lighted["range"] if analysis else np.inf
    every = analysis.margins["range"] if analysis else np.inf
    near = np.where(losses.lighted, np.maximum(near, np.nextafter(lighted, np.inf)), near)
    near = np.where(losses.mirrored, np.maximum(near, np.nextafter(every, np.inf)), near)
    return Uncertainty(
        # Half a squared chord of a unit sphere, so a margin's whole.
        silhouette=relative + EPSILON / smallest**2,
        range=near,
        order=relative,
        terminator=np.where(losses.terminator, np.inf, relative),
        unit=np.where(losses.lost, np.inf, values),
        absolute={**colors(scene, settings), **lengths(scene)},
    )


def steps(scene: Scene, bounces: int) -> float:
    """By how many steps of the output a color may be off: half of one, and what float32 makes of it."""
    # A light's two terms: numbers 3, products 3, the power's exponent and the pigment's share 2; then the sums.
    singles = 8 + 2 * len(scene.lights) + 3
    # Each mirror: its Kr, which POV-Ray puts together of two shares, the product and the sum.
    singles = (singles + 5) * (1 + bounces)
    # POV-Ray gives up a light whose color is below EPSILON, and a surface that hides one lets TRANSMIT of it through.
    dim = 2 * len(scene.lights) * (EPSILON + TRANSMIT) * (1 + bounces)
    # The last two: the product with 65535 and the half that is added to it.
    return 0.5 + STEPS * ((singles + 2) * SINGLE + dim)


def colors(scene: Scene, settings: Settings) -> dict[str, float]:
    """The absolute errors of passes that hold colors: of a picture, or of the difference of two."""
    mirrors = any(sphere.kr > 0 for sphere in converter.distinct(scene))
    bounces = settings.max_reflections if mirrors else 0

    def off(model: Model) -> float:
        return sum(
            steps(scene, model.bounces) / STEPS / model.gain(scene, settings, sign)
            for sign in (1, -1)
            if model.text(scene, settings, sign) is not None
        )

    found = {name: off(Model(terms, 0)) for name, terms in PLAIN.items()}
    found["beauty"] = off(Model(TERMS, bounces))
    # Both as uncertain as the one with all reflections. The same picture twice, without mirrors, is no difference.
    found["reflection"] = found["reflection.*"] = 2 * found["beauty"] if bounces else 0.0
    return found


def lengths(scene: Scene) -> dict[str, float]:
    """The absolute errors of what is made of pictures of coordinates and normals."""
    corner, edge = converter.box(scene)
    # Of a coordinate: the fine picture, whose pigment is a mean of three, and float64 in the function.
    off = edge / DIGITS * (0.5 / STEPS + 8 * SINGLE) + 16 * UNIT_ROUNDOFF * (max(map(abs, corner)) + edge)
    # Of a component of the normal: two pictures, of which one is 0.
    return {"position": off, "length": math.sqrt(3) * off, "normal": math.sqrt(3) * (0.5 / STEPS + 8 * SINGLE)}


def _radius(sphere: Sphere, unit: float) -> float:
    """That of the sphere that POV-Ray meets, in its own space."""
    return abs(sphere.scaling[0]) * unit if converter.uniform(sphere) else converter.ball(sphere, unit)


def starts(sphere: Sphere, least: float, unit: float) -> float:
    """From which distance on a hit of a sphere counts, in units of the scene, where POV-Ray's own is `least`."""
    stretch = 1.0
    if not converter.uniform(sphere):
        stretch = max(map(abs, sphere.scaling)) * unit / converter.ball(sphere, unit)
    return max(least, OWN_SPACE * stretch) / unit


class _Losses:
    """What POV-Ray cannot tell, by pixel; the worst over the chain of rays of each."""

    def __init__(self, scene: Scene, settings: Settings) -> None:
        self.scene, self.settings, self.unit = scene, settings, converter.unit(scene)
        self.tables: Tables = reference.Tables(scene, np.float64)
        self.spheres, left_out = scene.spheres, untold(scene)
        self.lights = [light for light in range(self.tables.lights) if light not in left_out]
        centres = np.array([s.position for s in self.spheres], dtype=np.float64).reshape(-1, 3).T
        self.eye = np.append(centres, np.zeros((3, 1)), axis=1)
        shape = (scene.view.rows, scene.view.columns)
        # Squared distances in radii: to the spheres that a ray may meet, and to the one that it hits.
        self.far, self.hit = np.zeros(shape), np.zeros(shape)
        # An epsilon decides about a light of the primary hit; about another light or a reflected ray; about the side
        # of a light; or nothing is sure.
        self.lighted, self.mirrored, self.terminator, self.lost = (np.zeros(shape, bool) for _ in range(4))
        self.follow()

    def follow(self) -> None:
        """Every ray of the picture."""
        view, first = self.scene.view, 0
        with np.errstate(all="ignore"):
            for rows in reference.bands(view):
                rays = reference.eye_rays(self.tables, view, self.settings.sample, rows)
                rays.pixel = rays.pixel + first
                first += rays.pixel.size
                traced = reference.trace(self.tables, rays, self.settings.max_reflections)
                for bounce, (some, hits, at) in enumerate(traced):
                    self.ray(some, hits.sphere, bounce)
                    self.shadows(at, self.mirrored if bounce else self.lighted)
                    if bounce < self.settings.max_reflections:
                        mirrors = self.tables.kr[at.x.start] > 0
                        self.leaves(at.x, at.x.direction, mirrors, self.lost, NEAREST)

    def ray(self, rays: Rays, hit: Any, bounce: int) -> None:
        """Distances to what a ray may meet, and hits too near to its start."""
        speed = np.linalg.norm(rays.direction, axis=0)
        for j in self.tables.distinct:
            origin, direction = reference.to_unit_space(self.tables, rays, rays.direction, j)
            line, least = reference.chord(origin, direction), 2 * starts(self.spheres[j], NEAREST, self.unit)
            squared = (origin**2).sum(axis=0)
            near = (line.middle**2).sum(axis=0) < 4
            self.raise_to(self.far, rays.pixel, np.where(near, squared, 0))
            self.raise_to(self.hit, rays.pixel, np.where(hit == j, squared, 0))
            own = rays.start == j
            if not bounce:
                # Only what is behind the near plane counts.
                soon = line.meets & ((line.near > 1) & (line.near * speed < least) | (line.far * speed < least))
                self.lost.flat[rays.pixel[soon & (line.far > 1)]] = True
                continue
            soon = [(root > 0) & (root * speed < least) for root in (line.near, line.far)]
            self.mirrored.flat[rays.pixel[~own & line.meets & (soon[0] | soon[1])]] = True
            inside = own & rays.inside
            chord = reference.other_root(rays.point, direction)
            self.lost.flat[rays.pixel[inside & (chord * speed < least)]] = True

    def shadows(self, at: Surface, marks: Flags) -> None:
        """Marks where POV-Ray's epsilons decide about a light."""
        x, tables, epsilon = at.x, self.tables, self.settings.shadow_epsilon
        for light in self.lights:
            seen = reference.incidence(tables, at, light)
            distance = np.linalg.norm(seen.to_light, axis=0)
            self.terminator.flat[x.pixel[np.abs(seen.NL) < 2 * EPSILON]] = True
            facing = seen.NL > 0
            self.leaves(x, seen.to_light, facing, self.terminator, SHADOW)
            for j in tables.distinct:
                origin, direction = reference.to_unit_space(tables, x, seen.to_light, j)
                share = starts(self.spheres[j], SHADOW, self.unit) / distance
                own = x.start == j
                line = reference.chord(origin, direction)
                self.raise_to(
                    self.far,
                    x.pixel,
                    np.where(facing & ((line.middle**2).sum(axis=0) < 4), (origin**2).sum(axis=0), 0),
                )
                if tables.light_side[j, light] == 0:
                    roots = [((origin**2).sum(axis=0) - 1) / (direction**2).sum(axis=0)]
                    meets = ~own
                else:
                    roots, meets = [line.near, line.far], ~own & line.meets
                    inside = own & x.inside
                    other = reference.other_root(x.point, direction)
                    marks.flat[x.pixel[facing & inside & self.between(other, share, epsilon)]] = True
                for root in roots:
                    marks.flat[x.pixel[facing & meets & self.between(root, share, epsilon)]] = True

    @staticmethod
    def between(root: Real, share: Real, epsilon: float) -> Flags:
        """Whether a root counts for POV-Ray alone, or for the specification alone; with room for its rounding."""
        low, high = np.minimum(epsilon, share / 2), np.maximum(epsilon, 2 * share)
        return ((root > low) & (root < high)) | ((root > 1 - 2 * share) & (root < 1 + share))

    def leaves(self, x: Rays, direction: Real, some: Flags, marks: Flags, least: float) -> None:
        """Marks rays that may meet the sphere that they start on once more, at once.

        The start lies off the sphere by `off`, in its form: the root that should be 0 is at most off / c, c the cosine
        of ray and normal, or the root of off.
        """
        scaling = self.tables.scaling[:, x.start]
        size = np.linalg.norm(self.eye[:, x.start] + x.offset, axis=0) / scaling.min(axis=0)
        off = ROOM * (ROUNDINGS + GROWTH * self.hit.flat[x.pixel] + 4 * size) * UNIT_ROUNDOFF
        local = direction / scaling
        cosine = np.abs((x.point * local).sum(axis=0)) / np.linalg.norm(local, axis=0)
        depth = np.minimum(2 * off / cosine, 2 * np.sqrt(off)) * scaling.max(axis=0)
        marks.flat[x.pixel[some & (depth * self.unit > least / 2)]] = True

    @staticmethod
    def raise_to(values: Real, pixel: Any, to: Real) -> None:
        """No pixel is there twice."""
        values.flat[pixel] = np.maximum(values.flat[pixel], to)


def untold(scene: Scene) -> tuple[int, ...]:
    """Lights so near to a surface that POV-Ray's epsilon decides on which side of it they are, seen from anywhere.

    Not those that lie on it: a surface does not hide these, and for POV-Ray neither.
    """
    unit, on = converter.unit(scene), reference.Tables(scene, np.float64).light_side == 0
    spheres, found = list(zip(scene.distinct, converter.distinct(scene), strict=True)), []
    for index, light in enumerate(scene.lights):
        for j, sphere in spheres:
            scaling = np.abs(sphere.scaling)
            local = (np.array(light.position) - sphere.position) / scaling
            form, slope = local @ local - 1, 2 * math.hypot(*(local / scaling))
            # To first order, which is enough next to the surface; its centre has no slope, and is far from it.
            if not on[j, index] and abs(form) < 2 * slope * starts(sphere, SHADOW, unit):
                found.append(index)
                break
    return tuple(found)


def rules(scene: Scene) -> Sequence[Rule]:
    """The rules by which POV-Ray decides: its lengths where the specification has shares of a length, or none."""
    from validation.follow import Follower, Hit, Vector, rational
    from validation.rules import Rule

    unit, spheres = converter.unit(scene), scene.spheres

    class Shadows(Follower):
        """A hit counts that is farther than SHADOW from the surface and from the light."""

        def hides(self, hit: Hit, relative: Any, to_light: Vector, i: int, j: int) -> bool:
            """Whether sphere j has a root between the two."""
            tables, sign, bounce, own = self.tables, self.sign, hit.bounce, j == hit.sphere
            if own and not hit.inside:
                return False
            _, (gx, gy, gz), C = relative
            lx, ly, lz = to_light
            wx, wy, wz = tables.w[j]
            A = wx * lx * lx + wy * ly * ly + wz * lz * lz
            B = gx * lx + gy * ly + gz * lz
            distance = (lx * lx + ly * ly + lz * lz).sqrt()
            least = tables.lift(rational(starts(spheres[j], SHADOW, unit))) / distance
            most = 1 - tables.lift(rational(SHADOW / unit)) / distance
            if own:
                # The roots are 0 and -2 B / A.
                return (
                    sign(-2 * B - least * A, "start", bounce, i, j) > 0
                    and sign(2 * B + most * A, "end", bounce, i, j) > 0
                )
            ahead, behind = B + least * A, B + most * A
            start = sign(C + least * (B + ahead), "start", bounce, i, j)
            end = sign(C + most * (B + behind), "end", bounce, i, j)
            if start <= 0 or end <= 0:
                return start * end < 0
            return (
                sign(B * B - A * C, "meets", bounce, i, j) > 0
                and sign(ahead, "ahead", bounce, i, j) < 0
                and sign(behind, "end", bounce, i, j) > 0
            )

    class Tangents(Follower):
        """A ray that touches a sphere misses it: half a chord has to be longer than the root of EPSILON."""

        along: Vector

        def nearest(
            self, relative: list[Any], direction: Vector, bounce: int, own: int, inside: bool
        ) -> tuple[int, Any, bool, bool] | None:
            """Remembers the direction."""
            self.along = direction
            plain = self.sign

            def sign(value: Any, *key: Any) -> int:
                if key[0] == "meets":
                    j = key[3]
                    A = sum(w * d * d for w, d in zip(self.tables.w[j], self.along, strict=True))
                    least = self.tables.lift(rational(EPSILON / _radius(spheres[j], unit) ** 2))
                    return plain(value - least * A, *key) or -1
                return plain(value, *key)

            self.sign = sign
            try:
                return super().nearest(relative, direction, bounce, own, inside)
            finally:
                self.sign = plain

    length = f"{SHADOW / unit:.2g}"
    return [
        Rule(f"counts what hides a light from {length} after the surface to {length} before the light", Shadows),
        Rule("misses a sphere that a ray only touches", Tangents),
    ]
