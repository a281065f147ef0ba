"""The epsilons of Mitsuba's own integrators: what they change of a picture, and the rule for the judge.

A ray that leaves a surface starts beside it, along the normal, and a shadow ray ends before the light. Both numbers are
documented (`interaction.h`, `math.h`), so a picture is followed by them as well as by the specification, in float64:
which quantities behind decisions come out otherwise, by how much, and what a mirror shows. docs/tolerances.md derives
what is claimed of that.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tracer import reference
from tracer.motion import DECISION
from tracer.passes import MARGINS
from tracer.reference import Flags, Index, Real
from validation.renderers import PerPixel, Settings, Uncertainty
from validation.renderers.mitsuba import precision
from validation.renderers.mitsuba.precision import UNIT_ROUNDOFF

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.rules import Rule

#: A ray starts beside its surface by this times 1 + the largest coordinate; a shadow ray lacks this part of its length.
RAY_EPSILON = 1500 * UNIT_ROUNDOFF
SHADOW_EPSILON = 10 * RAY_EPSILON
#: Steps larger than this part of the smallest scaling pass a sphere unnoticed; margins above MOST say nothing.
SMALL, MOST = 1 / 8, 1 / 2
#: A quantity within NEAR times what the epsilons change of it may change its sign, if roundings move it by less than a
#: quarter of itself; where they may move it by more, within CLOSE times.
NEAR, CLOSE = 2, 8
#: In float32 half a discriminant is off by so many u h^2 more than counted: h how far from the point next to the centre
#: the quadratic is set up, for the plain one of `ray_test`, and for a ray that walks there first.
TEXTBOOK, WALKED = 7.5, 3.0
#: Each coordinate of a place that is looked up in a texture about the sphere is off by so many u of its own size, the
#: centre's, and four radii; docs/tolerances.md derives it.
LOOKUP = 12
#: On spheres with no scaling above this the step is larger than roundings, wherever it is.
COARSE = 90
#: The passes that show what mirrors do.
MIRRORED = ("beauty", "reflection", "reflection.*")


def check() -> None:
    """Hold the installed Mitsuba, with a variant set, to these numbers.

    Raises:
        RuntimeError: it has others; all that is derived from them is wrong then.
    """
    import mitsuba as mi

    for name, expected in (("RayEpsilon", RAY_EPSILON), ("ShadowEpsilon", SHADOW_EPSILON)):
        found = float(getattr(mi.math, name))
        if not math.isclose(found, expected, rel_tol=1e-6):
            raise RuntimeError(f"{name} is {found:.3g} in Mitsuba {mi.__version__}, and {expected:.3g} in those known")


def step(point: Real) -> Real:
    """How far beside a surface rays start, for columns of points."""
    found: Real = (1 + np.abs(point).max(axis=0, initial=0.0)) * RAY_EPSILON
    return found


def reach(scene: Scene, settings: Settings) -> float:
    """How far the ends of shadow rays are at most from where the specification has them, near surfaces."""
    lights = [math.dist(light.position, (0, 0, 0)) for light in scene.lights]
    size = max((_size(scene, i) for i in scene.distinct), default=0.0)
    return (1 + size) * RAY_EPSILON + settings.shadow_epsilon * (size + max(lights, default=0.0))


def _size(scene: Scene, sphere: int) -> float:
    """The largest distance of a point of a sphere from the origin."""
    entry = scene.spheres[sphere]
    return math.dist(entry.position, (0, 0, 0)) + max(map(abs, entry.scaling))


def too_small(scene: Scene, settings: Settings) -> int | None:
    """A sphere that is so small that these epsilons are no small change; None if there is none."""
    if not scene.distinct:
        return None
    smallest = min(scene.distinct, key=lambda i: min(map(abs, scene.spheres[i].scaling)))
    far = reach(scene, settings)
    return smallest if far > SMALL * min(map(abs, scene.spheres[smallest].scaling)) else None


# ---- what they change


@dataclasses.dataclass
class Asked:
    """One quantity behind a decision, for some rays: its value, nan where it is not asked for."""

    kind: str
    value: Real
    moves: Real  # what its margin divides by, at least
    blur: Real | float = 0.0  # by how much the quadratic may be off in float32
    slack: Real | float = 0.0  # what else the epsilons may change of it
    yes: Flags | None = None  # what comes of it together with others: whether the light is hidden


@dataclasses.dataclass
class Bounce:
    """One hit of every ray: the sphere, -1 where there is none, what is seen, and the quantities behind it."""

    sphere: Index
    color: Real
    facing: Flags  # the lights, a row each
    visible: Flags
    shines: Flags  # highlights, and those of exponents below 1
    sharp: Flags
    lost: Flags  # roundings may be larger than the step: what leaves the surface may meet it
    falloff: Real  # by how much the color may be off where the falloff of lights is undone
    asked: dict[tuple[Any, ...], Asked]


class Chains:
    """Follows rays by the specification, or by Mitsuba's epsilons, and keeps every quantity that is asked for."""

    def __init__(self, scene: Scene, settings: Settings, *, moved: bool) -> None:
        """`moved`: by Mitsuba's epsilons."""
        self.scene, self.settings, self.moved = scene, settings, moved
        self.tables = reference.Tables(scene, np.float64)
        self.position = np.array([s.position for s in scene.spheres], dtype=np.float64).reshape(-1, 3).T
        self.light = np.array([p.position for p in scene.lights], dtype=np.float64).reshape(-1, 3).T
        #: Of those of a careful renderer.
        self.roundings = precision.roundings_of(scene)[1] / DECISION
        #: Nothing that could be hidden: no light gives anything there.
        self.dull: Flags = (self.tables.kd * self.tables.color.max(axis=0, initial=0.0) == 0) & (self.tables.ks == 0)

    def follow(self, direction: Real, other: Sequence[Bounce] = ()) -> Iterator[Bounce]:
        """The chains of primary rays; `other`: of the same rays, to be asked about what was hit there."""
        count = direction.shape[1]
        origin, weight = np.zeros((3, count)), np.ones(count)
        alive, inside_of = np.ones(count, bool), np.full(count, -1)
        on = np.full(count, -1)
        for bounce in range(self.settings.max_reflections + 1):
            asked: dict[tuple[Any, ...], Asked] = {}
            sphere, t, inside, roots = self.nearest(origin, direction, bounce, on, inside_of, asked)
            sphere = np.where(alive, sphere, -1)
            hit = sphere >= 0
            point = origin + np.where(hit, t, 0) * direction
            self.order(asked, origin, direction, other[bounce].sphere if bounce < len(other) else sphere, roots)
            gradient = (point - self.at(self.position, sphere)) / self.at(self.tables.scaling, sphere) ** 2
            outward, _ = reference.unit(np.where(hit, gradient, 1.0))
            normal = np.where(inside, -outward, outward)
            color, seen, falloff = self.shade(asked, bounce, hit, sphere, point, normal, inside, direction)
            lost = hit & self.lost(point, gradient, sphere)
            yield Bounce(
                sphere, weight * color, seen[:, 0], seen[:, 1], seen[:, 2], seen[:, 3], lost, weight * falloff, asked
            )
            kr = np.where(hit, self.at(self.tables.kr, sphere), 0.0)
            alive = hit & (kr > 0)
            if not alive.any():
                return
            weight = weight * kr
            direction = direction - 2 * reference.dot(direction, normal) * normal
            origin = point + step(point) * normal if self.moved else point
            on, inside_of = np.where(alive, sphere, -1), np.where(inside & alive, sphere, -1)

    def lost(self, point: Real, gradient: Real, sphere: Index) -> Flags:
        """Whether the step changes a sphere's equation by less than roundings may."""
        rounded = 4 * reference.dot(np.abs(gradient), np.abs(point) + np.abs(self.at(self.position, sphere))) + 4
        found: Flags = step(point) * np.linalg.norm(gradient, axis=0) <= self.roundings * UNIT_ROUNDOFF * rounded
        return found

    @staticmethod
    def at(table: Any, index: Index) -> Any:
        """The column of a table for each ray; of -1 any."""
        return reference.pick(table, index)

    def quadratic(self, origin: Real, direction: Real, j: int) -> tuple[Real, Real, Real, Real, Real]:
        """A, B, C of sphere j, and start and direction in its unit space."""
        scaling = self.tables.scaling[:, j : j + 1]
        o, d = (origin - self.position[:, j : j + 1]) / scaling, direction / scaling
        return reference.dot(d, d), reference.dot(o, d), reference.dot(o, o) - 1, o, d

    def moves(self, y: Real, lengths: Real, j: int) -> Real:
        """The least that a margin divides by: the roundings of the sphere's equation at a point of its unit space."""
        scaling, center = self.tables.scaling[:, j : j + 1], np.abs(self.position[:, j : j + 1])
        found: Real = (reference.dot(np.abs(y) / scaling, lengths + center) + 1) / 4
        return found

    def outline(self, o: Real, d: Real, A: Real, B: Real, origin: Real, direction: Real, j: int) -> tuple[Real, Real]:
        """Half the discriminant, and what its margin divides by at least."""
        along = -B / A
        closest = o + along * d
        return (1 - reference.dot(closest, closest)) / 2, self.moves(
            closest, np.abs(origin) + np.abs(along * direction), j
        )

    def walk(self, A: Real, B: Real, direction: Real, j: int) -> Real:
        """By how much the quadratic of a ray that is walked along first is off: in instances, where it stops short."""
        scaling = self.tables.scaling[:, j : j + 1]
        speed = np.sqrt(A / reference.dot(direction, direction)) * scaling.min()
        found: Real = WALKED * UNIT_ROUNDOFF * (B * B / A) * (1 - speed) ** 2
        return found

    def nearest(
        self,
        origin: Real,
        direction: Real,
        bounce: int,
        on: Index,
        inside_of: Index,
        asked: dict[tuple[Any, ...], Asked],
    ) -> tuple[Index, Real, Flags, Real]:
        """The nearest hit of each ray: sphere, t, whether from inside; and the t of every sphere, nan where none is."""
        count, begins = direction.shape[1], 0.0 if bounce else 1.0
        roots = np.full((len(self.scene.spheres), count), np.nan)
        best, nearest, within = np.full(count, -1), np.full(count, np.inf), np.zeros(count, bool)
        for j in self.tables.distinct:
            A, B, C, o, d = self.quadratic(origin, direction, j)
            D = B * B - A * C
            half = np.sqrt(np.maximum(D, 0))
            near, far = (-B - half) / A, (-B + half) / A
            takes_far = ~(near > begins)
            t = np.where(takes_far, far, near)
            counts = (D >= 0) & (t > begins)
            own, blur = on == j, self.walk(A, B, direction, j)
            if not self.moved:
                t = np.where(own, -2 * B / A, t)
                takes_far = np.where(own, inside_of == j, takes_far)
                counts = np.where(own, inside_of == j, counts)
            q, moves = self.outline(o, d, A, B, origin, direction, j)
            asked["meets", j] = Asked("silhouette", np.where(own, np.nan, q), moves, blur)
            y = o + begins * d
            start = np.where(own, np.nan, (reference.dot(y, y) - 1) / 2)
            lengths = np.abs(origin) + begins * np.abs(direction)
            asked["start", j] = Asked("range", start, self.moves(y, lengths, j), blur)
            roots[j] = np.where(counts, t, np.nan)
            closer = counts & (t < nearest)
            best, nearest, within = (
                np.where(closer, j, best),
                np.where(closer, t, nearest),
                np.where(closer, takes_far, within),
            )
        return best, np.where(best >= 0, nearest, 0.0), within, roots

    def order(
        self, asked: dict[tuple[Any, ...], Asked], origin: Real, direction: Real, sphere: Index, roots: Real
    ) -> None:
        """Whether the hit on `sphere` lies inside other ones: which of two hits is nearer."""
        point = origin + (roots[sphere, np.arange(sphere.size)] if len(roots) else np.nan) * direction
        off = np.zeros(sphere.size)
        for j in self.tables.distinct:
            # The hit is where its own sphere's quadratic has it.
            off = np.maximum(off, np.asarray(asked["meets", j].blur))
        for j in self.tables.distinct:
            _, _, C, o, _ = self.quadratic(point, direction, j)
            value = np.where((sphere == j) | (sphere < 0), np.nan, C / 2)
            asked["order", j] = Asked("order", value, self.moves(o, np.abs(point), j), off)

    def shade(
        self,
        asked: dict[tuple[Any, ...], Asked],
        bounce: int,
        hit: Flags,
        sphere: Index,
        point: Real,
        normal: Real,
        inside: Flags,
        direction: Real,
    ) -> tuple[Real, Flags, Real]:
        """The colour of the hits, for each light what of it is a matter of yes and no, and what undoing falloff loses.

        In the order of `Bounce`.
        """
        tables, at = self.tables, self.at
        color = at(tables.ka, sphere) * tables.ambient * at(tables.color, sphere)
        viewer, _ = reference.unit(-direction)
        center, radius = at(self.position, sphere), at(tables.scaling, sphere)[0]
        place = np.linalg.norm(np.abs(point) + np.abs(center) + 4 * radius, axis=0) * LOOKUP * UNIT_ROUNDOFF
        falloff = np.zeros(hit.size)
        seen: list[tuple[Flags, ...]] = []
        for i in range(tables.lights):
            to_light = self.light[:, i : i + 1] - point
            L, distance = reference.unit(to_light)
            NL = reference.dot(normal, L)
            RV = 2 * NL * reference.dot(normal, viewer) - reference.dot(L, viewer)
            useful = hit & ~(at(self.dull, sphere) & (bounce > 0))
            facing = useful & (NL > 0)
            visible = facing & ~self.hidden(asked, i, facing, sphere, point, normal, inside, to_light)
            shines = visible & (RV > 0)
            glossy = useful & (at(tables.ks, sphere) > 0)
            sharp = glossy & (at(tables.exponent, sphere) < 1)
            if bounce:
                asked["faces", i] = Asked("terminator", np.where(glossy, NL, np.nan), np.full(NL.size, 3 / 16))
                asked["shines", i] = Asked("terminator", np.where(sharp, RV, np.nan), np.full(NL.size, 46 / 16))
            intensity = tables.intensity[:, i : i + 1]
            power = np.power(np.where(shines, RV, 1.0), at(tables.exponent, sphere))
            diffuse = np.where(visible, at(tables.kd, sphere) * intensity * NL * at(tables.color, sphere), 0)
            color = color + diffuse
            share = place / distance
            falloff = falloff + np.where(visible, np.abs(diffuse).max(axis=0) * (2 + share) * share, 0)
            color = color + np.where(shines, at(tables.ks, sphere) * intensity * power, 0)
            seen.append((facing, visible, glossy & shines, sharp & shines))
        return np.where(hit, color, 0), np.array(seen, bool).reshape(-1, 4, hit.size), falloff

    def hidden(
        self,
        asked: dict[tuple[Any, ...], Asked],
        i: int,
        facing: Flags,
        sphere: Index,
        point: Real,
        normal: Real,
        inside: Flags,
        to_light: Real,
    ) -> Flags:
        """Whether a sphere meets the way to light i."""
        found = np.zeros(facing.size, bool)
        begins, ends = self.settings.shadow_epsilon, 1.0
        origin, direction = point, to_light
        size = np.linalg.norm(to_light, axis=0)
        # How far the ends of a ray are moved along it, at most.
        slide = step(point) + self.settings.shadow_epsilon * size
        if self.moved:
            origin = point + step(point) * normal
            direction = self.light[:, i : i + 1] - origin
            begins, ends = 0.0, 1 - SHADOW_EPSILON
        for j in self.tables.distinct:
            A, B, C, o, d = self.quadratic(origin, direction, j)
            own = sphere == j
            if not self.moved:
                C = np.where(own, 0.0, C)
            D = B * B - A * C
            half = np.sqrt(np.maximum(D, 0))
            near, far = (-B - half) / A, (-B + half) / A
            blocks = (D >= 0) & (((near > begins) & (near < ends)) | ((far > begins) & (far < ends)))
            if not self.moved:
                # One root is the start itself; a light on the surface does not hide itself.
                other = -2 * B / A
                blocks = np.where(own, (other > begins) & (other < ends), blocks)
                if self.tables.light_side[j, i] == 0:
                    blocks = ~own & (begins < C / A) & (C / A < 1)
            blocks &= facing & ~(own & ~inside)
            found |= blocks
            # Of its own sphere a ray that leaves it to the outside has nothing to decide.
            said = facing & ~(own & ~inside)
            q, moves = self.outline(o, d, A, B, origin, direction, j)
            scaling = self.tables.scaling[:, j]
            blur = TEXTBOOK * UNIT_ROUNDOFF * B * B / A
            asked["meets", j, i] = Asked(
                "silhouette",
                np.where(said & ~own, q, np.nan),
                moves,
                blur,
                (slide / scaling.min()) ** 2 / 2,
                blocks,
            )
            for what, t in (("start", begins), ("end", ends)):
                y = o + t * d
                value = (reference.dot(y, y) - 1) / 2
                # A light is where it is, from wherever it is seen.
                lengths = np.abs(self.light[:, i : i + 1]) if what == "end" else np.abs(origin) + np.abs(t * direction)
                moves, slack = self.moves(y, lengths, j), np.zeros(own.size)
                if what == "end" and self.tables.light_side[j, i] == 0:
                    # It is met at 1, before that if C < A, and by these rays if C is less than that part of A.
                    by = np.abs(o / scaling[:, None]) + np.abs(d / scaling[:, None])
                    value = np.where(own, value, (C - A) / 2)
                    moves = np.where(own, moves, (reference.dot(by, np.abs(origin)) + 1) / 4)
                    slack = np.where(own, 0.0, SHADOW_EPSILON * A / 2)
                asked[what, j, i] = Asked("range", np.where(said, value, np.nan), moves, blur, slack)
        return found


@dataclasses.dataclass
class Changes:
    """What the epsilons do to a picture, by pixel: claims by kind of decision, and to what mirrors show."""

    claims: dict[str, Real]
    color: Real
    parted: Flags  # whether the two chains of rays part somewhere


def changes(
    scene: Scene,
    settings: Settings,
    analysis: Analysis,
    base: Uncertainty,
    *,
    plain: bool,
    mirrors: bool,
    falloff: bool = False,
) -> Changes:
    """Follow by both, and compare.

    `base`: what roundings may do. `plain`: shadow rays are decided by the plain quadratic in float32. `mirrors`:
    whether reflected rays count. `falloff`: the falloff of lights is undone with a place that was looked up.
    """
    shape = analysis.ids.shape
    total = Changes({kind: np.zeros(shape) for kind in MARGINS}, np.zeros(shape), np.zeros(shape, bool))
    if not mirrors:
        settings = dataclasses.replace(settings, max_reflections=0)
    margins = analysis.margins if mirrors else analysis.lighted
    near = np.min([margins[kind] for kind in MARGINS], axis=0) < MOST
    if mirrors:
        reflecting = np.array([s.kr > 0 for s in scene.spheres])
        if settings.max_reflections and reflecting.any():
            near |= reflecting[analysis.ids] & (analysis.ids >= 0)
    coarse = np.array([*(max(map(abs, s.scaling)) > COARSE for s in scene.spheres), False])
    near |= coarse[analysis.ids]
    if not plain:
        near &= analysis.ids >= 0
    times = np.full(shape, float(NEAR))
    for kind in MARGINS:
        times[margins[kind] <= 4 * np.asarray(getattr(base, kind))] = CLOSE
    tables = reference.Tables(scene, np.float64)
    with np.errstate(all="ignore"):
        for rows in reference.bands(scene.view):
            ys, xs = np.nonzero(near[rows.start : rows.stop])
            if not ys.size:
                continue
            rays = reference.eye_rays(tables, scene.view, settings.sample, rows)
            direction = rays.direction[:, ys * scene.view.columns + xs]
            place = (ys + rows.start, xs)
            _compare(scene, settings, direction, times[place], total, place, plain=plain, falloff=falloff)
    return total


def _compare(
    scene: Scene,
    settings: Settings,
    direction: Real,
    times: Real,
    total: Changes,
    place: tuple[Index, Index],
    *,
    plain: bool,
    falloff: bool,
) -> None:
    """Both chains of some rays, bounce by bounce."""
    count = direction.shape[1]
    together = np.ones(count, bool)
    color, parted, gone = np.zeros(count), np.zeros(count, bool), np.zeros(count, bool)
    kr = np.array([*(s.kr for s in scene.spheres), 0.0])
    claims = {kind: np.zeros(count) for kind in MARGINS}
    exact = list(Chains(scene, settings, moved=False).follow(direction))
    moved = Chains(scene, settings, moved=True).follow(direction, exact)
    for bounce, (a, b) in enumerate(zip(exact, moved, strict=False)):
        for key, mine in a.asked.items():
            theirs = b.asked[key]
            change = np.abs(theirs.value - mine.value) + mine.slack
            if plain:
                change = change + np.maximum(mine.blur, theirs.blur)
            if mine.yes is not None and theirs.yes is not None:
                # A sphere that is all behind the end of a shadow ray: no quantity is near 0, but it does not hide.
                change = np.where(mine.yes != theirs.yes, np.maximum(change, np.abs(mine.value)), change)
            counts = together & (np.abs(mine.value) <= times * change)
            claim = np.where(counts, change / np.minimum(mine.moves, theirs.moves), 0.0)
            claims[mine.kind] = np.maximum(claims[mine.kind], claim)
        # A highlight jumps at the terminator, and one of an exponent below 1 where it begins; else colours do not jump.
        jumps = np.where(a.facing == b.facing, a.visible != b.visible, a.shines | b.shines) | (a.sharp != b.sharp)
        parted |= together & ((a.sphere != b.sphere) | jumps.any(axis=0))
        if bounce:
            off = np.abs(a.color - b.color).max(axis=0)
            if falloff:
                off = off + np.maximum(a.falloff, b.falloff)
            color += np.where(together, off, 0.0)
        lost = together & (a.lost | b.lost)
        claims["terminator"][lost] = np.inf
        gone |= lost & ((bounce > 0) | (kr[a.sphere] > 0))
        together &= (a.sphere == b.sphere) & (a.sphere >= 0)
    for kind in MARGINS:
        total.claims[kind][place] = claims[kind]
    total.parted[place] = parted
    # Where they part the values differ by more than an error, and no tolerance is to hide that.
    total.color[place] = np.where(gone, np.inf, np.where(parted, 0.0, color))


def uncertainty(
    scene: Scene,
    settings: Settings,
    analysis: Analysis | None,
    *,
    float32_roots: bool,
    mirrors: bool,
    shadows: bool,
    falloff: bool = False,
) -> Uncertainty:
    """What float32 allows, and the epsilons besides; the words are those of `changes`."""
    worst = precision.uncertainty(scene, settings, float32_roots=float32_roots)
    if analysis is None or not shadows:
        return worst
    # Where the quadratic loses digits is looked up ray by ray below; values may lose them anywhere.
    base = worst
    if float32_roots:
        base = dataclasses.replace(precision.uncertainty(scene, settings, float32_roots=False), unit=worst.unit)
    found = changes(scene, settings, analysis, base, plain=float32_roots, mirrors=mirrors, falloff=falloff)
    # Roundings act on a quantity that the epsilons have brought nearer to 0 by one part in CLOSE at most.
    nearer = CLOSE / (CLOSE - 1)

    claims = {kind: np.asarray(getattr(base, kind)) * nearer + found.claims[kind] for kind in MARGINS}
    # Where they part, and no quantity says so, a step has grown to so much that no decision near there is certain: no
    # bound is claimed of the nearest, and the rule tells what became of it.
    margins = analysis.margins if mirrors else analysis.lighted
    nearest = np.min([margins[kind] for kind in MARGINS], axis=0)
    silent = found.parted & np.all([margins[kind] >= claims[kind] for kind in MARGINS], axis=0)
    for kind in MARGINS:
        claims[kind] = np.where(silent & (margins[kind] == nearest), np.inf, claims[kind])
    return dataclasses.replace(base, **claims, absolute=with_mirrors(base, found.color))


def with_mirrors(of: Uncertainty, color: Real | float) -> dict[str, PerPixel]:
    """Its absolute errors with so much more in what mirrors show."""
    return {**of.absolute, **{name: np.add(of.absolute_of(name.replace("*", "1")), color) for name in MIRRORED}}


# ---- the rule


def rules(scene: Scene, settings: Settings, *, float32_roots: bool) -> Sequence[Rule]:
    """How Mitsuba's own integrators begin and end rays, and decide what they meet, for the judge to follow."""
    from flint import fmpq

    from validation.follow import Follower, Hit, Vector
    from validation.rules import Rule

    ray, shadow = fmpq(1500, 1 << 24), fmpq(15000, 1 << 24)
    oblique = float32_roots

    class Beside(Follower):
        """Rays start beside surfaces, and shadow rays end before the light."""

        def beside(self, point: Vector, gradient: Vector) -> Vector:
            """The step from a point of a surface along its gradient."""
            largest = max(point, key=lambda value: abs(precision.about(value)))
            size = -largest if precision.about(largest) < 0 else largest
            length = self.tables.lift(ray) * (size + 1)
            gx, gy, gz = gradient
            factor = length / (gx * gx + gy * gy + gz * gz).sqrt()
            return factor * gx, factor * gy, factor * gz

        def moved(self, relative: Any, j: int, by: Vector) -> tuple[Vector, Vector, Any]:
            """From the centre of sphere j: a point that is moved, its gradient, and f there."""
            mx, my, mz = (a + b for a, b in zip(relative[0], by, strict=True))
            wx, wy, wz = self.tables.w[j]
            gx, gy, gz = wx * mx, wy * my, wz * mz
            return (mx, my, mz), (gx, gy, gz), gx * mx + gy * my + gz * mz - 1

        def follow(self, direction: Vector) -> list[Hit]:
            """As the specification has it, but for where reflected rays start."""
            tables = self.tables
            hits: list[Hit] = []
            origin: Vector = (tables.lift(fmpq(0)),) * 3
            relative: list[Any] = tables.eye
            weight = None
            for bounce in range(self.max_reflections + 1):
                found = self.nearest(relative, direction, bounce, -1, False)
                if found is None:
                    self.missed = weight
                    break
                own, t, inside, touches = found
                x, y, z = (a + t * b for a, b in zip(origin, direction, strict=True))
                around = self.around((x, y, z), own)
                gradient = self.turned(around[own][1], own, inside)
                hit = Hit(bounce, own, t, inside, touches, (x, y, z), gradient, direction, weight)
                hits.append(hit)
                self.illuminate(hit, around)
                if tables.kr[own] is None or bounce == self.max_reflections:
                    break
                weight = tables.kr[own] if weight is None else weight * tables.kr[own]
                direction = self.reflect(direction, gradient)
                by = self.beside(hit.point, gradient)
                origin = x + by[0], y + by[1], z + by[2]
                # Nothing is known of spheres that do not exist.
                relative = [entry and self.moved(entry, j, by) for j, entry in enumerate(around)]
            return hits

        def hides(self, hit: Hit, relative: Any, to_light: Vector, i: int, j: int) -> bool:
            """Whether sphere j is met between a start beside the surface and an end before the light."""
            sign, bounce = self.sign, hit.bounce
            gl = sum(g * a for g, a in zip(hit.gradient, to_light, strict=True))
            # From behind a surface rays start on the other side.
            side = -1 if precision.about(gl) < 0 else 1
            gx, gy, gz = hit.gradient
            by = self.beside(hit.point, (side * gx, side * gy, side * gz))
            _, (gx, gy, gz), C = self.moved(relative, j, by)
            lx, ly, lz = (a - b for a, b in zip(to_light, by, strict=True))
            wx, wy, wz = self.tables.w[j]
            A = wx * lx * lx + wy * ly * ly + wz * lz * lz
            B = gx * lx + gy * ly + gz * lz
            ends = self.tables.lift(1 - shadow)
            at_start = sign(C, "start", bounce, i, j) > 0
            at_end = sign(ends * (ends * A + 2 * B) + C, "end", bounce, i, j) > 0
            if not (at_start and at_end):
                return at_start or at_end
            # Both ends are outside: it is met if it is there, behind the start and before the end.
            if sign(B, "ahead", bounce, i, j) >= 0 or sign(ends * A + B, "end", bounce, i, j, j) <= 0:
                return False
            return self.meets(A, B, C, bounce, i, j)

        def meets(self, A: Any, B: Any, C: Any, bounce: int, i: int, j: int) -> bool:
            """Whether a shadow ray meets sphere j, which is before it."""
            return self.sign(B * B - A * C, "meets", bounce, i, j) >= 0

    class Open(Beside):
        """Leaves some decisions open, each named by the bounce, the light, -1 for none, and the sphere."""

        otherwise: frozenset[tuple[int, int, int]] = frozenset()
        found: set[tuple[int, int, int]]

    class Blurred(Open):
        """A shadow ray whose discriminant is within the rounding of the plain quadratic in float32 meets, or not."""

        def meets(self, A: Any, B: Any, C: Any, bounce: int, i: int, j: int) -> bool:
            h_squared = precision.about(B) ** 2 / precision.about(A)
            if abs(precision.about(B * B - A * C)) <= 2 * TEXTBOOK * UNIT_ROUNDOFF * h_squared * precision.about(A):
                self.found.add((bounce, i, j))
            return super().meets(A, B, C, bounce, i, j) != ((bounce, i, j) in self.otherwise)

    class Turned(Open):
        """A hit beside an outline, where N.V is within rounding of 0, is on the side that is seen, or on the other."""

        def nearest(
            self, relative: list[Any], direction: Vector, bounce: int, own: int, inside: bool
        ) -> tuple[int, Any, bool, bool] | None:
            hit = super().nearest(relative, direction, bounce, own, inside)
            if hit is None:
                return None
            j, t, within, touches = hit
            start = [precision.about(m + p) for m, p in zip(relative[j][0], self.tables.position[j], strict=True)]
            end = [a + precision.about(t * d) for a, d in zip(start, direction, strict=True)]
            mx, my, mz = (a + t * b for a, b in zip(relative[j][0], direction, strict=True))
            wx, wy, wz = self.tables.w[j]
            gradient, size = (wx * mx, wy * my, wz * mz), math.hypot(*start) + math.hypot(*end)
            if precision.flat(scene, self.tables, j, gradient, direction, precision.about(t), size, oblique=oblique):
                self.found.add((bounce, -1, j))
                within ^= (bounce, -1, j) in self.otherwise
            return j, t, within, touches

        def follow(self, direction: Vector) -> list[Hit]:
            """The pass `normal` knows the side: by where the ray starts, as our code tells it."""
            hits = super().follow(direction)
            for hit in hits:
                if (hit.bounce, -1, hit.sphere) in self.otherwise:
                    x, y, z = hit.gradient
                    hit.gradient = -x, -y, -z
            return hits

    says = (
        f"starts rays (1 + the largest coordinate) x {RAY_EPSILON:.3g} beside surfaces and ends shadow rays at "
        f"t = {1 - SHADOW_EPSILON:.4f}, not at the light"
    )
    found = [Rule(says, Beside)]
    if float32_roots:
        says = "decides on a float32 discriminant, not set up near the sphere, whether shadow rays meet it"
        found.append(Rule(says, choices=precision.choosing(scene, settings, Blurred)))
    says = "tells by a rounded normal which side of a surface a ray has hit, and so on which side the next one starts"
    return [*found, Rule(says, choices=precision.choosing(scene, settings, Turned))]
