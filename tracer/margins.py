"""How far each pixel is from a discontinuity, and how much its values move: first-order analysis in float64.

Everything is per unit of a relative change delta of the pixel's ray and of every number of the scene. A decision
"g > 0" can flip where delta is its margin, |g| over the motion of g; a value moves by delta times its sensitivity.
Where they are at an extreme the second order counts as well. Both also count what a careful renderer rounds on the way:
DECISION roundings in a decision, and VALUE in a value, count like one change of all numbers. docs/tolerances.md has the
formulas in the same order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracer.cosines import NORMAL, Cosines, Terms
from tracer.motion import (
    DECISION,
    EQUATION,
    NEAR,
    VALUE,
    Beam,
    Gradient,
    Shape,
    Vectors,
    along,
    beside,
    carry,
    mirrored,
    norm,
    primary,
    ratio,
    rounding,
    turned,
)
from tracer.passes import MARGINS, Sample, lookup, names
from tracer.reference import (
    Flags,
    Index,
    Rays,
    Real,
    Surface,
    Tables,
    bands,
    check,
    chord,
    dot,
    eye_rays,
    hides,
    incidence,
    other_root,
    own_hides,
    pick,
    to_unit_space,
    trace,
    unit,
)

if TYPE_CHECKING:
    from tracer import Scene, View

# A renderer that keeps to the specification with unit roundoff u is off by at most VALUE_ROUNDINGS u sensitivity, where
# every margin is above EDGE_ROUNDINGS u. docs/tolerances.md derives both.
VALUE_ROUNDINGS = 15
EDGE_ROUNDINGS = 64
# A light is beside a surface if a change of this size takes it to the other side: what float32 may round.
BESIDE = EDGE_ROUNDINGS * 2.0**-24
# Outlines hidden behind a hit do not count; this much of t is still in front.
SLACK = 1e-5
# The largest delta that the first-order bounds are meant for: where a term that is 0 may grow within it, it counts.
REACH = 1e-4
# Rays analysed at a time: their derivatives stay in the cache.
BAND = 1 << 12


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
    #: Where it matters on which side of a surface a light is that lies on it but for a rounding: whole areas.
    beside: NDArray[np.bool_]

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
        parts = [
            Band(scene, tables, eye_rays(tables, view, sample, rows), shadow_epsilon) for rows in bands(view, BAND)
        ]
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
        image([part.beside for part in parts]),
    )


class Band:
    """The analysis of a band of pixels."""

    def __init__(self, scene: Scene, tables: Tables, rays: Rays, epsilon: float) -> None:
        self.tables, self.epsilon, self.rays, self.scene = tables, epsilon, rays, scene
        count = rays.pixel.size
        self.position = np.array([s.position for s in scene.spheres], dtype=np.float64).reshape(-1, 3).T
        self.light = np.array([p.position for p in scene.lights], dtype=np.float64).reshape(-1, 3).T
        self.ends = light_ends(self.light[:, None, :], self.position[:, :, None], tables.scaling[:, :, None])
        self.margins = {kind: np.full(count, np.inf) for kind in MARGINS}
        self.primary: dict[str, Real] = {}
        self.lighted: dict[str, Real] = {}
        self.ids = np.full(count, -1, np.int32)
        self.lit = [np.zeros(count, bool) for _ in range(tables.lights)]
        self.beside = np.zeros(count, bool)
        self.sensitivity: dict[str, NDArray[np.float64]] = {}

    def run(self, max_reflections: int) -> None:
        """Follow the rays from hit to hit, each with its derivatives."""
        tables, sensitivity = self.tables, self.sensitivity
        for name in names(tables.lights, max_reflections, margins=False):
            sensitivity[name] = np.zeros(self.rays.pixel.size)
        beam = primary(view_moves(self.scene.view, self.rays.direction), self.rays.direction)
        for bounce, (rays, hits, at) in enumerate(trace(tables, self.rays, max_reflections)):
            met = self.first_hits(rays, hits.sphere, hits.t, beam, after=1 if bounce == 0 else 0)
            hit, i = np.flatnonzero(hits.sphere >= 0), at.x.start
            rays, shape = rays[hit], self.shape(at)
            beam = carry(beam[hit], rays, at, shape)
            goes_on = (pick(tables.kr, i) > 0) & (bounce < max_reflections)
            self.between_spheres(at, beam, {j: flags[hit] for j, flags in met.items()}, goes_on)
            if bounce == 0:
                self.primary = {kind: margin.copy() for kind, margin in self.margins.items()}
                self.ids = hits.sphere.astype(np.int32)
            for name, moves in self.shading(at, beam, shape, rays.direction, bounce).items():
                sensitivity[name][at.x.pixel] = moves
            if bounce == 0:
                self.lighted = {kind: margin.copy() for kind, margin in self.margins.items()}
            if bounce > 0 and not goes_on.any():
                break
            normals = turned(beam, shape, i)
            if bounce == 0:
                self.geometry(at, beam, shape, normals)
            beam = mirrored(beam, shape, normals, rays.direction, at.x.direction)[np.flatnonzero(goes_on)]
        sensitivity["beauty"][self.ids < 0] = np.abs(tables.background).max()
        for bounce in range(1, max_reflections + 1):
            sensitivity["reflection"] += sensitivity[f"reflection.{bounce}"]
        sensitivity["beauty"] += sensitivity["ambient"] + sensitivity["direct"] + sensitivity["reflection"]
        for name in sensitivity:
            sensitivity[name] = np.nan_to_num(sensitivity[name], nan=np.inf, posinf=np.inf)

    def decide(
        self, counts: dict[str, Flags], pixel: Index, beam: Beam, gap: Real, of: Gradient, sphere: Index | int
    ) -> None:
        """Take the decision gap > 0 into account, for each kind where it can change what is seen."""
        limits = [np.where(flags, self.margins[kind][pixel], 0) for kind, flags in counts.items()]
        margin = beam.margin(gap, of, sphere, np.max(limits, axis=0))
        for kind, flags in counts.items():
            self.lower(kind, pixel, np.where(flags, margin, np.inf))

    def lower(self, kind: str, pixel: Index, margin: Real) -> None:
        """The smallest margin of a kind counts."""
        self.margins[kind][pixel] = np.minimum(self.margins[kind][pixel], margin)

    def shape(self, at: Surface) -> Shape:
        """The surfaces at hits."""
        scaling, position = pick(self.tables.scaling, at.x.start), pick(self.position, at.x.start)
        gradient = at.x.point / scaling
        return Shape(at.x.point, gradient, norm(gradient), scaling, position)

    def geometry(self, at: Surface, beam: Beam, shape: Shape, normals: Vectors) -> None:
        """How far primary hits and their normals move."""
        pixel, sensitivity = at.x.pixel, self.sensitivity
        away, _ = unit(at.x.offset + shape.position)
        sensitivity["depth"][pixel] = beam.size(along(beam.starts, away), VALUE)
        sensitivity["position"][pixel] = np.max([beam.size(beam.starts[:, k], VALUE) for k in range(3)], axis=0)
        # An angle: no more than the sum of the lengths of all turns.
        sensitivity["normal"][pixel] = beam.size(np.sqrt((normals**2).sum(axis=1)), VALUE) + NORMAL / VALUE

    def form(
        self,
        j: int,
        y: Real,
        t: Real | float | None,
        lengths: Real,
        beam: Beam,
        counts: Flags,
        axis: Real | None = None,
    ) -> tuple[Real, Gradient]:
        """The decision |y| > 1, where rays are at y in the unit space of sphere j, at t; None: at their starts.

        `lengths` are those that the point is made of, by component. `counts`: where it is asked for. `axis`: the ray's
        unit vector there, if only what y moves across it tells.
        """
        scaling, position = self.tables.scaling[:, j : j + 1], self.position[:, j : j + 1]
        g, squares = y / scaling, y * y
        gap = (squares.sum(axis=0) - 1) / 2

        def strays(some: Index) -> Real:
            made_of = lengths[:, some] + np.abs(position)
            moves = beam.start_moves[:, some] + np.abs(position) + EQUATION / DECISION * made_of
            if t is not None:
                moves += (t[some] if isinstance(t, np.ndarray) else t) * beam.direction_moves[:, some]
            moves = moves / scaling + np.abs(y[:, some])
            return norm(moves) if axis is None else beside(moves, axis[:, some])

        # Half of |y|^2 changes with the point by g, and with the sphere's numbers.
        rounded = rounding(g, lengths + np.abs(position))
        by_direction, bend = None if t is None else t * g, leaves(counts & (gap < 0), strays)
        return gap, Gradient(g, by_direction, -g * position, -squares, np.zeros_like(rounded), rounded, bend)

    def first_hits(self, rays: Rays, sphere: Index, t: Real, beam: Beam, after: float) -> dict[int, Flags]:
        """The decisions on the way to the nearest hits: outlines, and the near plane; returns who meets each sphere."""
        lines, first = {}, {}
        every = np.ones(t.size, bool)
        for j in self.tables.distinct:
            origin, direction = to_unit_space(self.tables, rays, rays.direction, j)
            lines[j] = line = chord(origin, direction)
            root = np.where(line.near > after, line.near, line.far)
            first[j] = np.where(line.meets & (root > after) & (rays.start != j), root, np.inf)
            if after:
                lengths = beam.reach + np.abs(after * rays.direction)
                of = self.form(j, origin + after * direction, after, lengths, beam, every)
                self.decide({"range": every}, rays.pixel, beam, *of, j)
        for j, line in lines.items():
            # The outline of a sphere that would be seen where it begins: before the nearest hit on any other one.
            others = [root for k, root in first.items() if k != j]
            rival = np.where(sphere == j, np.min(others, axis=0, initial=np.inf), t) * (1 + SLACK)
            middle = line.height / line.speed
            counts = (rays.start != j) & (middle > after * (1 - SLACK)) & (middle < rival)
            lengths = beam.reach + np.abs(middle * rays.direction)
            of = self.form(j, line.middle, middle, lengths, beam, counts, line.axis)
            self.decide({"silhouette": counts}, rays.pixel, beam, *of, j)
        # On its own sphere a ray that runs inside meets the other root.
        return {j: np.isfinite(root) | ((rays.start == j) & rays.inside) for j, root in first.items()}

    def between_spheres(self, at: Surface, beam: Beam, met: dict[int, Flags], goes_on: Flags) -> None:
        """Whether hits lie in other spheres: so which is nearer, and what a mirrored ray starts in."""
        for j, rival in met.items():
            other = at.x.start != j
            if (other & (rival | goes_on)).any():
                y, _ = to_unit_space(self.tables, at.x, at.x.direction, j)
                counts = {"order": other & rival, "range": other & goes_on}
                self.decide(counts, at.x.pixel, beam, *self.form(j, y, None, beam.reach, beam, other), j)

    def shading(self, at: Surface, beam: Beam, shape: Shape, direction: Real, bounce: int) -> dict[str, Real]:
        """The decisions behind each light, and how much the terms move, by pass."""
        tables, i, pixel = self.tables, at.x.start, at.x.pixel
        color = pick(tables.color, i)
        kd, ks, n = pick(tables.kd, i), pick(tables.ks, i), pick(tables.exponent, i)
        # The factors of each term are numbers of the scene; that has room for the roundings of their products.
        ambient = 3 * (pick(tables.ka, i) * np.abs(tables.ambient) * color).max(axis=0)
        size = ambient / 3
        cosines = Cosines(at, beam, shape, direction)
        diffuse, specular = Terms(i.size), Terms(i.size)
        for light in range(tables.lights):
            seen, p = incidence(tables, at, light), self.light[:, light : light + 1]
            NL, RV, facing = seen.NL, seen.RV, seen.NL > 0
            intensity = tables.intensity[:, light : light + 1]
            dull, glossy = kd * intensity * color, ks * intensity * np.ones_like(color)
            has_dull, has_glossy = (dull != 0).any(axis=0), (glossy != 0).any(axis=0)
            by_NL, sign = cosines.incident(seen, p)
            of, moves = cosines.of(sign), beam.bound(cosines.of(by_NL))

            asked = np.flatnonzero((NL + NEAR * moves > 0) & (has_dull | has_glossy | (bounce == 0)))
            hides, by_others = np.ones(i.size, bool), np.zeros(i.size, bool)
            sight = self.shadow(at.x[asked], beam[asked], seen.to_light[:, asked], light)
            hides[asked], by_others[asked] = sight.hides, sight.by_others
            for kind, margin in sight.margins.items():
                self.lower(kind, pixel[asked], np.where(facing[asked], margin, np.inf))
            self.beside[pixel[asked]] |= sight.beside & facing[asked]
            # At the primary hit the pass `shadow` is compared where N.L > 0. Behind mirrors only the specular term
            # jumps where N.L changes its sign; the diffuse term does not.
            turns = ~by_others & ((bounce == 0) | (has_glossy & (RV > 0)))
            self.decide({"terminator": turns}, pixel, beam, NL, of, i)
            if bounce == 0:
                self.lit[light][pixel] = facing

            # A term that is 0 counts where it may be lit within REACH, and then may or may not make up for others.
            lit = has_dull & np.where(facing, ~hides, NL + REACH * moves > 0)
            cosine = np.maximum(NL, 0)
            diffuse.add(lit, np.abs(NL) < REACH * moves, dull, by_NL, moves, 3 * cosine)
            size = size + np.where(lit, np.abs(dull).max(axis=0) * cosine, 0)
            lit = has_glossy & facing & ~hides
            if not lit.any():
                continue
            by_RV, sign = cosines.mirrored(seen, p)
            moves = beam.bound(cosines.of(by_RV))
            self.decide({"terminator": lit & (n < 1)}, pixel, beam, RV, cosines.of(sign), i)
            lit &= RV + REACH * moves > 0
            # The derivative of (R.V)^n; where R.V is nearly 0, at the far end of what it may reach.
            base = np.where(n < 1, np.abs(RV), np.maximum(RV, np.minimum(REACH * moves, 1)))
            slope = np.where(n > 0, n * base ** (n - 1), 0)
            value = np.where(RV > 0, np.abs(RV) ** n, 0)
            # The logarithm is the derivative by the exponent.
            logarithm = np.where(RV > 0, n * np.abs(np.log(np.abs(RV))), 0)
            specular.add(lit, REACH * moves > RV, glossy, by_RV, moves, value * (2 + logarithm), slope)
            size = size + np.where(lit, np.abs(glossy).max(axis=0) * value, 0)
        if bounce:
            # Each Kr on the way is a number of the scene.
            direct = (diffuse + specular).sizes(cosines)
            return {f"reflection.{bounce}": at.weight * (ambient + direct + bounce * size)}
        return {
            "ambient": ambient,
            "diffuse": diffuse.sizes(cosines),
            "specular": specular.sizes(cosines),
            "direct": (diffuse + specular).sizes(cosines),
        }

    def shadow(self, x: Rays, beam: Beam, to_light: Real, light: int) -> Sight:
        """What stands between points and a light."""
        count = x.start.size
        limit = np.maximum(self.margins["silhouette"][x.pixel], self.margins["range"][x.pixel])
        blockers, by_others, beside = np.zeros(count, int), np.zeros(count, bool), np.zeros(count, bool)
        # While nothing hides the light, the first sphere to come decides; else all that hide it must go.
        comes = {kind: np.full(count, np.inf) for kind in ("silhouette", "range")}
        goes = {kind: np.zeros(count) for kind in ("silhouette", "range")}
        goes_any = np.zeros(count)
        for j in self.tables.distinct:
            own, on = x.start == j, self.tables.light_side[j, light] == 0
            origin, direction = to_unit_space(self.tables, x, to_light, j)
            blocks, found = np.zeros(count, bool), {kind: np.full(count, np.inf) for kind in comes}
            # From the outside a sphere never hides a light that it faces, nor a light that lies on it from its points.
            cases = ((~own, Segments.of_other), (own & x.inside & (not on), Segments.of_own))
            for some, decide in cases:
                rays = np.flatnonzero(some)
                if rays.size:
                    start = x.point if decide == Segments.of_own else origin
                    segments = Segments(self, j, light, start[:, rays], direction[:, rays], beam[rays], limit[rays])
                    blocks[rays], found["silhouette"][rays], found["range"][rays] = decide(segments, self.epsilon)
                    beside[rays] |= segments.beside
            blockers += blocks
            by_others |= blocks & ~own
            for kind, margin in found.items():
                comes[kind] = np.where(blocks, comes[kind], np.minimum(comes[kind], margin))
                goes[kind] = np.where(blocks, np.maximum(goes[kind], margin), goes[kind])
            goes_any = np.where(blocks, np.maximum(goes_any, np.minimum(*found.values())), goes_any)
        margins = {
            kind: np.where(blockers == 0, comes[kind], np.where(blockers == 1, goes[kind], goes_any)) for kind in comes
        }
        return Sight(blockers > 0, by_others, beside, margins)


@dataclass
class Sight:
    """A light seen from points."""

    hides: Flags  # something hides it
    by_others: Flags  # a sphere other than the point's own does
    beside: Flags  # it depends on the side of a surface that a light is on, by a rounding
    margins: dict[str, Real]


class Segments:
    """Lines from points to a light, and one sphere: o = (x - c) / s and d = (p - x) / s, light p and centre c."""

    def __init__(
        self, band: Band, sphere: int, light: int, origin: Real, direction: Real, beam: Beam, limit: Real
    ) -> None:
        """`limit`: margins above it do not count."""
        self.sphere, self.beam, self.limit = sphere, beam, limit
        self.origin, self.direction = origin, direction
        #: Where the side of the surface matters that the light is on, and a rounding may change it.
        self.beside = np.zeros(origin.shape[1], bool)
        self.side = int(band.tables.light_side[sphere, light])
        self.p, self.c = band.light[:, light : light + 1], band.position[:, sphere : sphere + 1]
        self.s = band.tables.scaling[:, sphere : sphere + 1]
        #: The margin of the side of the surface that the light is on.
        self.end = float(band.ends[sphere, light])

    def moves(self, y: Real, t: Real | float, some: Index) -> Real:
        """How far the components of o + t d = y move, for some of the lines."""
        at = t if isinstance(t, float) else t[some]
        start, own = self.beam.start_moves[:, some], self.beam.reach[:, some]
        end, center = np.abs(self.p), np.abs(self.c)
        found = np.abs(1 - at) * start + np.abs(at) * end + center
        found += EQUATION / DECISION * (own + center + np.abs(at) * (own + end))
        moves: Real = found / self.s + np.abs(y[:, some])
        return moves

    def direction_moves(self) -> Real:
        """How far the components of d move."""
        end = np.abs(self.p)
        found = self.beam.start_moves + end + EQUATION / DECISION * (self.beam.reach + end)
        moves: Real = found / self.s + np.abs(self.direction)
        return moves

    def margin(self, gap: Real, by_o: Real, by_d: Real, counts: Flags | None = None, bend: Real | float = 0.0) -> Real:
        """The margin of a decision on o and d, where it counts."""
        scalings = -by_o * self.origin - by_d * self.direction
        by_o, by_d = by_o / self.s, by_d / self.s
        rounded = rounding(by_o, self.beam.reach + np.abs(self.c)) + rounding(by_d, self.beam.reach + np.abs(self.p))
        of = Gradient(by_o - by_d, None, -by_o * self.c, scalings, dot(np.abs(by_d), np.abs(self.p)), rounded, bend)
        if counts is None:
            return self.beam.margin(gap, of, self.sphere, self.limit)
        return np.where(counts, self.beam.margin(gap, of, self.sphere, np.where(counts, self.limit, 0)), np.inf)

    def of_other(self, epsilon: float) -> tuple[Flags, Real, Real]:
        """Whether a sphere hides the light from points of other ones; the margins of the outline and of both ends."""
        o, d = self.origin, self.direction
        blocks = hides(o, d, (self.p - self.c) / self.s, self.side, epsilon)
        if self.side == 0:
            # The roots are 1, which does not hide, and, by their product, c / a.
            a, c = dot(d, d), dot(o, o) - 1
            every = np.arange(a.size)
            by_o, by_d = 2 * norm(self.moves(o, 0.0, every)) ** 2, 2 * norm(self.direction_moves()) ** 2
            ends = np.minimum(
                *(
                    self.margin(gap, 2 * o, -2 * end * d, bend=np.where(gap < 0, by_o, end * by_d))
                    for end, gap in ((end, c - end * a) for end in (epsilon, 1.0))
                )
            )
            return blocks, np.full_like(ends, np.inf), ends
        line = chord(o, d)
        y, middle = o + epsilon * d, line.height / line.speed
        starts_inside, ends_inside, end = dot(y, y) < 1, self.side < 0, self.end
        # The start counts where the line leaves the sphere there, or leads to a light inside; ...
        counts = (dot(y, d) > 0) | ends_inside
        bend = leaves(counts & starts_inside, lambda some: norm(self.moves(y, epsilon, some)))
        ends = self.margin((dot(y, y) - 1) / 2, y, epsilon * y, counts, bend)
        # ... the light's end where the line enters there, or starts inside.
        sided = (dot(o + d, d) < 0) | starts_inside
        self.beside = sided & (end < BESIDE)
        ends = np.where(sided, np.minimum(ends, end), ends)
        if ends_inside:
            # A light inside has to leave the sphere on the side where lines enter.
            behind = dot(o + d, d) / line.speed
            strays = norm(self.moves(o + d, 1.0, np.arange(behind.size))) + norm(self.direction_moves()) / line.speed
            ends = np.minimum(ends, np.where(sided, end, np.maximum(end, ratio(behind, strays))))
        # The outline counts between the two, with both outside.
        over = (middle > epsilon * (1 - SLACK)) & (middle < 1 + SLACK) & (blocks | ~line.meets)
        y = line.middle
        # A light just inside, on a chord so short that the line may miss all of it, counts too.
        outside = ~starts_inside & (not ends_inside or middle < 1)
        counts, gap = over & outside, (dot(y, y) - 1) / 2
        bend = leaves(counts & (gap < 0), lambda some: beside(self.moves(y, middle, some), line.axis[:, some]))
        outline = self.margin(gap, y, middle * y, counts, bend)
        return blocks, outline, ends

    def of_own(self, epsilon: float) -> tuple[Flags, Real, Real]:
        """The same from points of the sphere's inside, which start from x in unit space."""
        n, d = self.origin, self.direction
        t, end = other_root(n, d), self.end
        # t > epsilon: -2 n.d - epsilon d.d
        by_d = norm(self.direction_moves())
        bend = 4 * beside(self.moves(n, 0.0, np.arange(t.size)), n) * by_d + 2 * epsilon * by_d**2
        start = self.margin(-2 * dot(n, d) - epsilon * dot(d, d), -2 * d, -2 * (n + epsilon * d), bend=bend)
        blocks = own_hides(n, d, self.side, epsilon)
        self.beside = (t > epsilon) & (end < BESIDE)
        ends = np.where(blocks, np.minimum(start, end), np.where(t > epsilon, end, start))
        return blocks, np.full_like(ends, np.inf), ends


def light_ends(light: Real, center: Real, scaling: Real) -> Real:
    """The margin of the side of each sphere that each light is on."""
    y, lengths = (light - center) / scaling, np.abs(light) + np.abs(center)
    gap, g = (dot(y, y) - 1) / 2, y / scaling
    moves = dot(np.abs(g), lengths) + dot(y, y) + rounding(g, lengths) / DECISION
    strays = norm((1 + EQUATION / DECISION) * lengths / scaling + np.abs(y))
    return ratio(gap, moves, np.where(gap < 0, strays * strays, 0.0))


def leaves(within: Flags, strays: Callable[[Index], Real]) -> Real:
    """How (|y|^2 - 1) / 2 bends: a point within the sphere leaves it sooner than its derivatives tell.

    `strays`: how far y moves at most, for some of the rays.
    """
    bend, some = np.zeros(within.shape), np.flatnonzero(within)
    if some.size:
        bend[some] = strays(some) ** 2
    return bend


def view_moves(view: View, direction: Real) -> Real:
    """How far each component of primary directions moves with the numbers of the view."""
    right = (direction[0] - view.left) / (view.right - view.left)
    top = (direction[1] - view.bottom) / (view.top - view.bottom)
    across = abs(view.left) * np.abs(1 - right) + abs(view.right) * np.abs(right)
    down = abs(view.bottom) * np.abs(1 - top) + abs(view.top) * np.abs(top)
    return np.stack([across, down, np.full(right.size, abs(view.near))])


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
