"""How far each pixel is from a discontinuity, and how much its values move: first-order error analysis in float64.

Everything is per unit of a relative change delta of the pixel's ray, of every number of the scene, and of every
intermediate result. A point in the world then lies within a ball of some radius times delta, a unit vector within some
angle times delta. A decision "g > 0" whose g moves by at most e delta can flip where delta >= |g| / e: its margin.
docs/tolerances.md has the formulas in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracer.motion import Ellipsoid, Meeting, Pencil, Place, Root, Segment, norm, place, ratio, reflected, slant
from tracer.passes import MARGINS, Sample, lookup, names
from tracer.reference import (
    Flags,
    Index,
    Rays,
    Real,
    Surface,
    Tables,
    bands,
    between,
    check,
    eye_rays,
    incidence,
    pick,
    trace,
)

if TYPE_CHECKING:
    from tracer import Scene

# A renderer that keeps to the specification with unit roundoff u is off by at most VALUE_ROUNDINGS u sensitivity, where
# every margin is above EDGE_ROUNDINGS u. docs/tolerances.md derives both.
VALUE_ROUNDINGS = 16
EDGE_ROUNDINGS = 32
# Outlines hidden behind a hit do not count; this much of t is still in front.
SLACK = 1e-5
# The largest delta that the first-order bounds are meant for: where a term that is 0 may grow within it, it counts.
REACH = 1e-4
# Powers and products below 2^-24 times this, of a term's full size or of 1, may underflow to 0 in float32.
UNDERFLOW = 2.0**-100


@dataclass
class Analysis:
    """What is known about each pixel of a scene before any renderer has drawn it; arrays are (rows, columns)."""

    margins: dict[str, NDArray[np.float64]]  # by kind; inf where there is no such decision
    # The same of fewer decisions: those behind the primary hit alone, and those with the lights that reach it.
    primary: dict[str, NDArray[np.float64]]
    lighted: dict[str, NDArray[np.float64]]
    sensitivity: dict[str, NDArray[np.float64]]  # by pass: change of any channel per unit delta, to first order
    outline: float  # length of the spheres' outlines in pixels
    ids: NDArray[np.int32]
    lit: list[NDArray[np.bool_]]  # by light: where N.L > 0, so where `shadow` is compared

    def behind(self, name: str) -> dict[str, NDArray[np.float64]]:
        """The margins of the decisions that a pass depends on, by kind.

        Raises:
            ValueError: there is no such pass.
        """
        if name in ("diffuse", "specular", "direct") or lookup(name).quantity == "visibility":
            return self.lighted
        if name == "beauty" or lookup(name).name.startswith("reflection"):
            return self.margins
        return self.primary


@dataclass
class Motion:
    """How far things move with delta: radii in world units, angles in radians."""

    point: Real  # the hit point
    normal: Real  # angle
    view: Real  # angle


def moved(beam: Pencil | Ellipsoid, at: Place) -> Motion:
    """How far hit points, normals and views move."""
    speed = norm(at.direction)
    point = beam.point(at.t, at.gradient, at.direction)
    return Motion(point + speed * at.along, at.bend() * point + at.tilt, beam.turn() / speed)


def analyse(
    scene: Scene, *, sample: Sample = "corner", shadow_epsilon: float = 1e-4, max_reflections: int = 3
) -> Analysis:
    """Margins and sensitivities of every pixel.

    Raises:
        ValueError: a setting that cannot be.
    """
    check(scene, (), "f64", sample, shadow_epsilon, max_reflections)
    view = scene.view
    with np.errstate(all="ignore"):
        tables = Tables(scene, np.float64)
        parts = [Band(scene, tables, eye_rays(tables, view, sample, rows), shadow_epsilon) for rows in bands(view)]
        for part in parts:
            part.run(max_reflections)
        length = sum(outline(scene, j) for j in scene.distinct)

    def image(pieces: list[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(pieces).reshape(view.rows, view.columns)

    return Analysis(
        {kind: image([part.margins[kind] for part in parts]) for kind in MARGINS},
        {kind: image([part.primary[kind] for part in parts]) for kind in MARGINS},
        {kind: image([part.lighted[kind] for part in parts]) for kind in MARGINS},
        {name: image([part.sensitivity[name] for part in parts]) for name in parts[0].sensitivity},
        length,
        image([part.ids for part in parts]),
        [image([part.lit[light] for part in parts]) for light in range(tables.lights)],
    )


def times(size: Real, error: Real) -> Real:
    """A size times its error, where nothing of no size has an error."""
    return np.where(size == 0, 0.0, size * error)


class Band:
    """The analysis of a band of pixels."""

    def __init__(self, scene: Scene, tables: Tables, rays: Rays, epsilon: float) -> None:
        self.tables, self.epsilon, self.rays, self.scene = tables, epsilon, rays, scene
        count = rays.pixel.size
        self.position = np.array([s.position for s in scene.spheres], dtype=np.float64).reshape(-1, 3).T
        self.light = np.array([p.position for p in scene.lights], dtype=np.float64).reshape(-1, 3).T
        self.margins = {kind: np.full(count, np.inf) for kind in MARGINS}
        self.primary: dict[str, Real] = {}
        self.lighted: dict[str, Real] = {}
        self.ids = np.full(count, -1, np.int32)
        self.lit = [np.zeros(count, bool) for _ in range(tables.lights)]
        self.sensitivity: dict[str, NDArray[np.float64]] = {}

    def lower(self, kind: str, pixel: Index, margin: Real, counts: Flags | None = None) -> None:
        """Take a decision into account, where it can change what is seen."""
        image = self.margins[kind]
        found = margin if counts is None else np.where(counts, margin, np.inf)
        image[pixel] = np.minimum(image[pixel], found)

    def run(self, max_reflections: int) -> None:
        """Follow the rays from bounce to bounce, each with the radius of its error."""
        view, tables, direction = self.scene.view, self.tables, self.rays.direction
        count = self.rays.pixel.size
        sensitivity = {name: np.zeros(count) for name in names(tables.lights, max_reflections, margins=False)}
        self.sensitivity = sensitivity
        # The ray's own change, and that of the numbers of the view.
        right = (direction[0] - view.left) / (view.right - view.left)
        top = (direction[1] - view.bottom) / (view.top - view.bottom)
        radius = norm(direction) + norm(
            np.stack(
                [
                    abs(view.left) * np.abs(1 - right) + abs(view.right) * np.abs(right),
                    abs(view.bottom) * np.abs(1 - top) + abs(view.top) * np.abs(top),
                    np.full(count, abs(view.near)),
                ]
            )
        )
        beam: Pencil | Ellipsoid = Pencil(radius)
        for bounce, (rays, hits, at) in enumerate(trace(tables, self.rays, max_reflections)):
            self.first_hit(rays, hits.sphere, hits.t, beam, after=1 if bounce == 0 else 0)
            if bounce == 0:
                self.primary = {kind: margin.copy() for kind, margin in self.margins.items()}
            hit = np.flatnonzero(hits.sphere >= 0)
            motion = moved(beam[hit], self.place(at, rays.direction[:, hit]))
            pixel = at.x.pixel
            ambient, diffuse, specular, size = self.shading(at, motion, bounce)
            if bounce == 0:
                self.lighted = {kind: margin.copy() for kind, margin in self.margins.items()}
                self.ids = hits.sphere.astype(np.int32)
                missed = self.ids < 0
                sensitivity["ambient"][pixel], sensitivity["diffuse"][pixel] = ambient, diffuse
                sensitivity["specular"][pixel] = specular
                sensitivity["depth"][pixel] = motion.point + at.t * norm(rays.direction[:, pixel])
                sensitivity["position"][pixel] = motion.point + at.t * norm(rays.direction[:, pixel])
                sensitivity["normal"][pixel] = motion.normal
                sensitivity["beauty"][missed] = np.abs(tables.background).max()
            else:
                # Each Kr is a number of the scene, and a product more.
                sensitivity[f"reflection.{bounce}"][pixel] = at.weight * (
                    ambient + diffuse + specular + 2 * bounce * size
                )
            on = np.flatnonzero(pick(tables.kr, at.x.start) > 0)
            beam = reflected(beam[hit[on]], self.place(at[on], rays.direction[:, hit[on]]))
        sensitivity["direct"] = sensitivity["diffuse"] + sensitivity["specular"]
        for bounce in range(1, max_reflections + 1):
            sensitivity["reflection"] += sensitivity[f"reflection.{bounce}"]
        sensitivity["beauty"] += sensitivity["ambient"] + sensitivity["direct"] + sensitivity["reflection"]
        for name in sensitivity:
            sensitivity[name] = np.nan_to_num(sensitivity[name], nan=np.inf, posinf=np.inf)

    def first_hit(self, rays: Rays, sphere: Index, t: Real, beam: Pencil | Ellipsoid, after: float) -> None:
        """The decisions behind the nearest hit."""
        tables = self.tables
        count = rays.pixel.size
        found = {j: Meeting(tables, self.position, rays, rays.direction, j, beam) for j in tables.distinct}
        first = {j: meeting.first(after) for j, meeting in found.items()}
        best = Root(np.full(count, np.inf), np.full(count, np.inf), np.ones(count), np.ones(count))
        second = np.full(count, np.inf)  # the nearest hit on any other sphere
        for j, root in first.items():
            best = root.where(sphere == j, best)
            second = np.where(sphere == j, second, np.minimum(second, root.t))

        for j, meeting in found.items():
            rival = np.where(sphere == j, second, t) * (1 + SLACK)
            # The outline of a sphere that would be seen where it begins.
            middle = meeting.line.height / meeting.line.speed
            counts = ~meeting.own & (middle > after * (1 - SLACK)) & (middle < rival)
            self.lower("silhouette", rays.pixel, meeting.outline(counts))
            # A root that crosses the near plane, or the point a reflected ray starts from.
            for root in meeting.roots:
                self.lower("range", rays.pixel, root.margin(after), root.t < rival)
            # Another hit that is nearly as near.
            gap = first[j].t - t
            margin = ratio(gap, first[j].error(gap) + best.error(gap))
            self.lower("order", rays.pixel, margin, (sphere != j) & np.isfinite(gap))

    def place(self, at: Surface, direction: Real) -> Place:
        """What the spheres add to the errors of hits."""
        scaling, position = pick(self.tables.scaling, at.x.start), pick(self.position, at.x.start)
        return place(at.t, direction, at.x.point, scaling, position)

    def shading(self, at: Surface, motion: Motion, bounce: int) -> tuple[Real, Real, Real, Real]:
        """The decisions behind each light, and how much the terms move; last, the size of all terms together."""
        tables, i, pixel = self.tables, at.x.start, at.x.pixel
        color = np.abs(pick(tables.color, i))
        kd, ks, n = pick(tables.kd, i), pick(tables.ks, i), pick(tables.exponent, i)
        # Products of numbers of the scene: one for each factor and each multiplication.
        size = (pick(tables.ka, i) * np.abs(tables.ambient) * color).max(axis=0)
        ambient = 5 * size
        diffuse, specular = np.zeros_like(ambient), np.zeros_like(ambient)
        for light in range(tables.lights):
            seen = incidence(tables, at, light)
            NL, RV = seen.NL, seen.RV
            distance = norm(seen.to_light)
            far = np.linalg.norm(self.light[:, light])
            turn = (motion.point + far) / distance + 1
            NL_error = slant(NL) * (motion.normal + turn) + 3
            RV_error = slant(RV) * (2 * motion.normal + turn + motion.view) + 6
            intensity = np.abs(tables.intensity[:, light])
            diffuse_size = kd * (intensity[:, None] * color).max(axis=0)
            specular_size = ks * intensity.max(initial=0)
            matters = (diffuse_size > 0) | (specular_size > 0)

            facing = NL > 0
            asked = np.arange(i.size) if bounce == 0 else np.flatnonzero(facing & matters)
            hides, by_others = np.ones(i.size, bool), np.zeros(i.size, bool)
            hides[asked], by_others[asked], margins = self.shadow(
                at, asked, seen.to_light[:, asked], light, motion.point[asked]
            )
            for kind, margin in margins.items():
                self.lower(kind, pixel[asked], margin, facing[asked])
            if bounce == 0:
                self.lit[light][pixel] = facing
                # The pass `shadow` is compared where N.L > 0.
                self.lower("terminator", pixel, ratio(NL, NL_error), ~by_others)
            else:
                # The specular term jumps where N.L changes sign; the diffuse term does not.
                self.lower("terminator", pixel, ratio(NL, NL_error), (specular_size > 0) & (RV > 0))
            lit = facing & ~hides
            self.lower("terminator", pixel, ratio(RV, RV_error), lit & (specular_size > 0) & (n < 1))

            near_lit = (NL + REACH * NL_error > 0) & ~(facing & hides)
            diffuse += np.where(near_lit, times(diffuse_size, NL_error + 8 * np.maximum(NL, 0)) + UNDERFLOW, 0)
            # The derivative of (R.V)^n, taken at the far end of what R.V may reach.
            reached = np.clip(RV + REACH * RV_error, 0, 1)
            slope = np.where(n < 1, n * np.abs(RV) ** (n - 1), n * np.where(RV > 0, np.abs(RV), reached) ** (n - 1))
            value = np.where(RV > 0, np.abs(RV) ** n, 0)
            logarithm = np.where(RV > 0, n * np.abs(np.log(np.abs(RV))), 0)
            near_shine = lit & (RV + REACH * RV_error > 0)
            change = times(slope, RV_error) + value * (8 + logarithm) + UNDERFLOW
            specular += np.where(near_shine, times(specular_size, change) + UNDERFLOW, 0)
            size = size + np.where(lit, diffuse_size * np.maximum(NL, 0) + specular_size * value, 0)
        return ambient, diffuse, specular, size

    def shadow(
        self, at: Surface, asked: Index, to_light: Real, light: int, point: Real
    ) -> tuple[Flags, Flags, dict[str, Real]]:
        """Which points a light is hidden from, which of them by other spheres, and the margins of that."""
        tables, epsilon, x = self.tables, self.epsilon, at.x[asked]
        count = asked.size
        far = np.full(count, np.linalg.norm(self.light[:, light]))
        beam = Segment(point, far)
        none = np.full(count, np.inf)
        blockers, by_others = np.zeros(count, int), np.zeros(count, bool)
        # While nothing hides the light, the first sphere to come decides; else all that hide it must go.
        comes = {"silhouette": none, "range": none}
        goes = {"silhouette": np.zeros(count), "range": np.zeros(count)}
        goes_any = np.zeros(count)
        for j in tables.distinct:
            meeting = Meeting(tables, self.position, x, to_light, j, beam)
            own, line = meeting.own, meeting.line
            if tables.light_on[j, light]:
                root = meeting.second_root()
                blocks = ~own & between(epsilon, root.t)
                silhouette = none
                span = np.where(own, np.inf, np.minimum(root.margin(epsilon), root.margin(1)))
            else:
                middle = line.height / line.speed
                ends = [
                    (between(epsilon, root.t), np.minimum(root.margin(epsilon), root.margin(1)))
                    for root in meeting.roots
                ]
                blocks = line.meets & (ends[0][0] | ends[1][0])
                leaves = np.maximum(*(np.where(inside, margin, 0) for inside, margin in ends))
                enters = np.minimum(ends[0][1], ends[1][1])
                span = np.where(line.meets, np.where(blocks, leaves, enters), np.inf)
                over = (middle > epsilon * (1 - SLACK)) & (middle < 1 + SLACK) & (blocks | ~line.meets)
                silhouette = meeting.outline(over & ~own)
                if own.any():
                    # From the inside, x's own sphere stands before an outer light; from the outside it never does.
                    root, end = meeting.own_root(), self.light_end(j, light)
                    starts = root.margin(epsilon)
                    own_blocks = between(epsilon, root.t)
                    own_span = np.where(own_blocks, np.minimum(starts, end), np.where(root.t > epsilon, end, starts))
                    blocks = np.where(own, own_blocks, blocks)
                    span = np.where(own, np.where(x.inside, own_span, np.inf), span)
            blockers += blocks
            by_others |= blocks & ~own
            for kind, margin in (("silhouette", silhouette), ("range", span)):
                comes[kind] = np.where(blocks, comes[kind], np.minimum(comes[kind], margin))
                goes[kind] = np.where(blocks, np.maximum(goes[kind], margin), goes[kind])
            goes_any = np.where(blocks, np.maximum(goes_any, np.minimum(silhouette, span)), goes_any)
        margins = {
            kind: np.where(blockers == 0, comes[kind], np.where(blockers == 1, goes[kind], goes_any)) for kind in comes
        }
        return blockers > 0, by_others, margins

    def light_end(self, j: int, light: int) -> float:
        """Margin of a light being inside or outside a sphere, |m| < 1."""
        scaling = self.tables.scaling[:, j]
        p, c = self.light[:, light], self.position[:, j]
        m = (p - c) / scaling
        moves = 2 * (m @ m + np.abs(m) @ ((np.abs(p) + np.abs(c)) / scaling))
        return float(abs(m @ m - 1) / moves)


def outline(scene: Scene, j: int) -> float:
    """Length in pixels of a sphere's outline, inside the image: where the cone of its tangents cuts the image plane.

    In unit space the tangents from o = -p / s touch the sphere where n.o = 1: on the circle about o / |o|^2 of squared
    radius 1 - 1 / |o|^2. The circle is divided until no piece inside the image is longer than a pixel.
    """
    view, sphere = scene.view, scene.spheres[j]
    position, scaling = np.array(sphere.position), np.abs(np.array(sphere.scaling))
    eye = -position / scaling
    squared = eye @ eye
    if not squared > 1:
        return 0.0
    first = np.cross(eye, np.eye(3)[np.argmin(np.abs(eye))])
    first /= np.linalg.norm(first)
    second = np.cross(eye, first) / np.sqrt(squared)
    radius = np.sqrt(1 - 1 / squared)

    def project(angle: Real) -> Real:
        n = eye[:, None] / squared + radius * (np.cos(angle) * first[:, None] + np.sin(angle) * second[:, None])
        x = position[:, None] + scaling[:, None] * n
        t = np.where(x[2] < 0, -x[2] / view.near, np.nan)
        column = (x[0] / t - view.left) / (view.right - view.left) * view.columns
        row = (view.top - x[1] / t) / (view.top - view.bottom) * view.rows
        return np.stack([column, row])

    angle = np.linspace(0, 2 * np.pi, 257)
    for _ in range(24):
        place = project(angle)
        low, high = np.fmin(place[:, :-1], place[:, 1:]), np.fmax(place[:, :-1], place[:, 1:])
        # A piece that crosses the plane of the eye has one end in sight and no length yet.
        touches = (low[0] <= view.columns) & (high[0] >= 0) & (low[1] <= view.rows) & (high[1] >= 0)
        lengths = np.hypot(*np.diff(place, axis=1))
        long = touches & ~(lengths < 1)
        if not long.any() or angle.size > 1 << 20:
            break
        angle = np.sort(np.append(angle, (angle[:-1] + angle[1:])[long] / 2))
    middle = project((angle[:-1] + angle[1:]) / 2)
    inside = (middle[0] >= 0) & (middle[0] <= view.columns) & (middle[1] >= 0) & (middle[1] <= view.rows)
    return float(np.nansum(np.where(inside, np.hypot(*np.diff(project(angle), axis=1)), 0)))
