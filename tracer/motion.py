"""How rays move with the numbers of a scene: exact first derivatives, carried from hit to hit.

Everything is per unit of a relative change delta of the pixel's ray and of every number x of the scene: the motion of a
quantity q is the sum of |x dq/dx| over all of them. A `Beam` holds these derivatives of its rays, one column a number;
what a renderer rounds on the way has columns too. docs/tolerances.md has the formulas in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracer.reference import Index, Rays, Real, Surface, dot

# So many roundings count like one relative change of the numbers of the scene: in decisions, and in values.
DECISION, VALUE = 16, 8
# Roundings at most: of a hit point, by the lengths it is made of; of the lengths in a sphere's equation, and of the
# equation besides; of a mirrored direction, by what is subtracted from d.
POINT, EQUATION, SQUARES, MIRROR = 8, 4, 4, 38
# Above this nothing is near, and first order says little: margins may be lower bounds of themselves.
NEAR = 1 / 256
# Columns: the primary ray's direction; for each hit what is rounded there: t, the point and the mirrored direction; for
# each sphere that was met its position and its scaling.
FIRST, ROUNDED, NUMBERS = 3, 7, 6

Columns = Real  # (columns, rays)
Vectors = Real  # (columns, 3, rays)


def norm(v: Real) -> Real:
    """Length of each vector."""
    return np.sqrt(dot(v, v))


def ratio(gap: Real, motion: Real, bend: Real | float = 0.0) -> Real:
    """The margin of a decision: the least delta with motion delta + bend delta^2 / 2 as large as its gap."""
    size = np.abs(gap)
    if np.any(bend):
        motion = (motion + np.sqrt(motion * motion + 2 * bend * size)) / 2
    margin: Real = size / motion
    return np.where(np.isnan(margin), 0.0, margin)


def beside(moves: Real, axis: Real) -> Real:
    """How far vectors move across unit vectors at most, when their components move that far."""
    x, y, z = axis * axis
    return dot(moves, np.sqrt(np.stack([y + z, z + x, x + y])))


def along(columns: Vectors, v: Real) -> Columns:
    """The dot product of each column with the ray's vector."""
    product: Columns = np.einsum("ckr,kr->cr", columns, v)
    return product


@dataclass
class Gradient:
    """How a quantity of each ray depends on the ray's start and direction and, per relative change, on a sphere.

    `rest`: how far it moves besides; `rounded`: by how many roundings it may be off besides. `bend`: by how much times
    delta^2 / 2 it comes nearer to 0, at most, than its derivatives tell.
    """

    start: Real
    direction: Real | None  # None: not at all
    position: Real
    scaling: Real
    rest: Real
    rounded: Real
    bend: Real | float = 0.0

    def own(self) -> Real:
        """How far it moves with the sphere's numbers alone."""
        total: Real = np.abs(self.position).sum(axis=0) + np.abs(self.scaling).sum(axis=0)
        return total

    def __getitem__(self, some: Index) -> Gradient:
        direction = None if self.direction is None else self.direction[:, some]
        position, scaling = self.position[:, some], self.scaling[:, some]
        bend = self.bend if isinstance(self.bend, float) else self.bend[some]
        return Gradient(self.start[:, some], direction, position, scaling, self.rest[some], self.rounded[some], bend)


@dataclass
class Shape:
    """Spheres where rays meet them, each its own."""

    point: Real  # in unit space
    gradient: Real  # outward: (x - p) / s^2
    steep: Real  # length of the gradient
    scaling: Real
    position: Real


class Beam:
    """Rays and their derivatives."""

    def __init__(
        self, view: Real, length: Real, starts: Vectors, directions: Vectors, hits: int, met: list[Index], reach: Real
    ) -> None:
        """`met`: by place among the columns the sphere that each ray has there, -1: none."""
        self.view = view  # how far each component of the primary direction moves with the numbers of the view
        self.length = length  # of the primary direction
        self.hits, self.met = hits, met
        self.reach = reach  # by component: the lengths that the starts are made of
        self._starts, self._directions = starts, directions
        self._rays: Index | None = None  # which of these are meant; None: all
        self.start_moves = np.stack([self.size(starts[:, k], DECISION) for k in range(3)])
        self.direction_moves = np.stack([self.size(directions[:, k], DECISION) for k in range(3)])

    @property
    def numbers(self) -> int:
        """Where the columns of the spheres' numbers begin."""
        return FIRST + ROUNDED * self.hits

    def __getitem__(self, some: Index) -> Beam:
        """Some of the rays; their derivatives are not copied before they are used."""
        part = Beam.__new__(Beam)
        part._starts, part._directions = self._starts, self._directions
        part._rays = some if self._rays is None else self._rays[some]
        part.view, part.length, part.reach = self.view[:, some], self.length[some], self.reach[:, some]
        part.start_moves, part.direction_moves = self.start_moves[:, some], self.direction_moves[:, some]
        part.hits, part.met = self.hits, [sphere[some] for sphere in self.met]
        return part

    @property
    def starts(self) -> Vectors:
        """The derivatives of the starts."""
        return self._starts if self._rays is None else np.take(self._starts, self._rays, axis=-1)

    @property
    def directions(self) -> Vectors:
        """The derivatives of the directions."""
        return self._directions if self._rays is None else np.take(self._directions, self._rays, axis=-1)

    def columns_of(self, sphere: Index | int) -> Index:
        """Where the columns of a sphere's numbers begin; -1: it has none."""
        found = np.full(self.length.size, -1)
        for place, met in enumerate(self.met):
            found[met == sphere] = self.numbers + NUMBERS * place
        return found

    def size(self, columns: Columns, roundings: float) -> Real:
        """The motion that columns amount to. The primary ray turns anywhere within a ball."""
        total: Real = norm(columns[:FIRST]) * self.length + dot(np.abs(columns[:FIRST]), self.view)
        total += np.abs(columns[FIRST : self.numbers]).sum(axis=0) / roundings
        total += np.abs(columns[self.numbers :]).sum(axis=0)
        return total

    def motion(self, of: Gradient, sphere: Index | int, roundings: float) -> Real:
        """How far a quantity moves that depends on the rays and on a sphere."""
        columns = along(self.starts, of.start)
        if of.direction is not None:
            columns += along(self.directions, of.direction)
        at = self.columns_of(sphere)
        add(columns, at, of.position, of.scaling)
        moves = self.size(columns, roundings) + of.rest + of.rounded / roundings
        return moves + np.where(at < 0, of.own(), 0)

    def bound(self, of: Gradient) -> Real:
        """No less than `motion`, for decisions, and quicker."""
        moves = dot(np.abs(of.start), self.start_moves) + of.own() + of.rest + of.rounded / DECISION
        if of.direction is not None:
            moves += dot(np.abs(of.direction), self.direction_moves)
        return moves

    def margin(self, gap: Real, of: Gradient, sphere: Index | int, limit: Real) -> Real:
        """The margin of gap > 0; where it is sure to be above the limit, or NEAR, a lower bound of it above that."""
        found = ratio(gap, self.bound(of), of.bend)
        some = np.flatnonzero(~(found >= np.minimum(limit, NEAR)))
        if some.size:
            spheres = sphere if isinstance(sphere, int) else sphere[some]
            part = of[some]
            found[some] = ratio(gap[some], self[some].motion(part, spheres, DECISION), part.bend)
        return found


def add(columns: Columns, at: Index, position: Real, scaling: Real) -> None:
    """Add the derivatives by a sphere's own numbers, where it has columns."""
    rays = np.flatnonzero(at >= 0)
    if not rays.size:
        return
    place = at[rays]
    for k in range(3):
        columns[place + k, rays] += position[k, rays]
        columns[place + 3 + k, rays] += scaling[k, rays]


def primary(view: Real, direction: Real) -> Beam:
    """The rays from the eye, which is where it is."""
    count = direction.shape[1]
    axes = np.repeat(np.eye(3)[:, :, None], count, axis=2)
    return Beam(view, norm(direction), np.zeros((3, 3, count)), axes, 0, [], np.zeros((3, count)))


def rounding(gradient: Real, lengths: Real) -> Real:
    """By how many roundings half of |y|^2 is off, y made of those lengths, by component, in the world."""
    return EQUATION * dot(np.abs(gradient), lengths) + SQUARES


def carry(beam: Beam, rays: Rays, at: Surface, shape: Shape) -> Beam:
    """The rays at their hits: the starts are the hit points, the directions still those of the rays that arrive."""
    i, t, d = at.x.start, at.t, rays.direction
    g, n, s, p = shape.gradient, shape.point, shape.scaling, shape.position
    lengths = beam.reach + np.abs(p) + np.abs(t * d)
    # The point stays on the surface, |n|^2 / 2 = const: what the ray, centre and scalings change of that, t undoes.
    slope = dot(g, d)
    by_start, by_scaling = -g / slope, n * n / slope
    by_direction, rounded = t * by_start, rounding(g, lengths) / np.abs(slope)
    own = np.flatnonzero(rays.start == i)
    if own.size:
        # The other root of a ray that starts on the same sphere, -2 n.d / d.d there.
        start, local = rays.point[:, own], (d / s)[:, own]
        squared = dot(local, local)
        by_n, by_d = -2 * local / squared, -2 * n[:, own] / squared
        by_start[:, own], by_direction[:, own] = by_n / s[:, own], by_d / s[:, own]
        by_scaling[:, own] = -by_n * start - by_d * local
        rounded[own] = EQUATION * (dot(np.abs(by_n), np.abs(start)) + dot(np.abs(by_d), np.abs(local)))

    # New columns for what is rounded here, and for the spheres that are met for the first time.
    hits, before, (met, place) = beam.hits + 1, beam.numbers, meet(beam.met, i)
    after = before + ROUNDED
    starts, directions = np.zeros((2, after + NUMBERS * len(met), 3, i.size))
    back = np.zeros(starts[:, 0].shape)
    for old, new in (
        (slice(before), slice(before)),
        (slice(before, None), slice(after, after + NUMBERS * len(beam.met))),
    ):
        directions[new] = beam.directions[old]
        starts[new] = beam.starts[old]
        back[new] = along(starts[new], by_start) + along(directions[new], by_direction)
        starts[new] += t * directions[new]
    back[before] = rounded
    add(back, after + NUMBERS * place, -by_start * p, by_scaling)
    for k in range(3):
        starts[:, k] += back * d[k]
        starts[before + 1 + k, k] = POINT * lengths[k]
    return Beam(beam.view, beam.length, starts, directions, hits, met, np.abs(at.x.offset + p) + np.abs(p))


def meet(met: list[Index], sphere: Index) -> tuple[list[Index], Index]:
    """The places of spheres among those that rays have met, with new ones, and where each ray has its sphere now."""
    place = np.full(sphere.size, -1)
    for at, found in enumerate(met):
        place[found == sphere] = at
    new = np.flatnonzero(place < 0)
    place[new] = sum((found[new] >= 0 for found in met), np.zeros(new.size, int))
    places = [found.copy() for found in met]
    places += [np.full(sphere.size, -1) for _ in range(int(place.max(initial=-1)) + 1 - len(met))]
    for at, found in enumerate(places):
        some = new[place[new] == at]
        found[some] = sphere[some]
    return places, place


def turned(beam: Beam, shape: Shape, sphere: Index) -> Vectors:
    """The derivatives of the outward normal at hits."""
    g, s = shape.gradient, shape.scaling
    bent = beam.starts / (s * s * shape.steep)
    at, rays = beam.columns_of(sphere), np.arange(sphere.size)
    for k in range(3):
        bent[at + k, k, rays] -= shape.position[k] / (s[k] * s[k] * shape.steep)
        bent[at + 3 + k, k, rays] -= 2 * g[k] / shape.steep
    normal = g / shape.steep
    back = along(bent, normal)
    for k in range(3):
        bent[:, k] -= back * normal[k]
    return bent


def mirrored(beam: Beam, shape: Shape, normals: Vectors, direction: Real, reflected: Real) -> Beam:
    """The rays that mirrors send on: d' = d - 2 (d.N) N, whichever way N points."""
    normal = shape.gradient / shape.steep
    directions = beam.directions
    rounded = MIRROR * np.abs(normal) * dot(np.abs(direction), np.abs(normal)) + np.abs(reflected)
    moved = 2 * (along(directions, normal) + along(normals, direction))
    directions = directions - (2 * dot(direction, normal)) * normals
    for k in range(3):
        directions[:, k] -= moved * normal[k]
        directions[beam.numbers - 3 + k, k] += rounded[k]
    return Beam(beam.view, beam.length, beam.starts, directions, beam.hits, beam.met, beam.reach)
