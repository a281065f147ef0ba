"""How far rays, and the points where they meet spheres, move: to first order, per unit of a relative change.

The change is one of the pixel's ray, of every number of the scene and of every intermediate result. An `Aim` knows how
far the points of its rays move in any direction; docs/tolerances.md has the formulas in the same order.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tracer.reference import Chord, Flags, Index, Rays, Real, Tables, chord, dot, other_root, to_unit_space

Matrix = Real  # of shape (3, 3, rays)


def norm(v: Real) -> Real:
    """Length of each vector."""
    return np.sqrt(dot(v, v))


def ratio(gap: Real, error: Real) -> Real:
    """The margin of a decision: how far it is from flipping, over how fast it moves."""
    margin: Real = np.abs(gap) / error
    return np.where(np.isnan(margin), 0.0, margin)


class Aim(Protocol):
    """What is known about the errors of rays: of their starts and of their directions."""

    def __getitem__(self, chosen: Index) -> Aim:
        """Those of some of the rays."""

    def both(self, v: Real, w: Real) -> Real:
        """How far v.start + w.direction moves."""

    def across(self, v: Real, t: Real) -> Real:
        """How far v.(start + t direction) moves."""


@dataclass
class Pencil:
    """Rays from the eye, which is where it is; the direction moves within a ball."""

    radius: Real

    def both(self, v: Real, w: Real) -> Real:  # noqa: ARG002
        """How far v.start + w.direction moves."""
        return norm(w) * self.radius

    def across(self, v: Real, t: Real) -> Real:
        """How far v.(start + t direction) moves."""
        return norm(v) * np.abs(t) * self.radius

    def point(self, t: Real, gradient: Real, direction: Real) -> Real:
        """How far the point at t moves, slid along the ray back to the surface of that gradient."""
        steep = dot(gradient, gradient) * dot(direction, direction) / dot(gradient, direction) ** 2
        return np.abs(t) * self.radius * np.sqrt(1 + steep)

    def turn(self) -> Real:
        """How far the direction moves."""
        return self.radius

    def blocks(self) -> tuple[Matrix, Matrix, Matrix]:
        """The squares of the errors: of starts, of starts by directions, of directions."""
        zero = np.zeros((3, 3, self.radius.size))
        return zero, zero, identity(self.radius.size) * self.radius**2

    def __getitem__(self, chosen: Index) -> Pencil:
        return Pencil(self.radius[chosen])


@dataclass
class Segment:
    """Rays from points to a light; each end moves within a ball."""

    start: Real
    end: Real

    def both(self, v: Real, w: Real) -> Real:
        """How far v.start + w.direction moves."""
        return norm(v - w) * self.start + norm(w) * self.end

    def across(self, v: Real, t: Real) -> Real:
        """How far v.(start + t direction) moves."""
        return norm(v) * (np.abs(1 - t) * self.start + np.abs(t) * self.end)

    def __getitem__(self, chosen: Index) -> Segment:
        return Segment(self.start[chosen], self.end[chosen])


@dataclass
class Ellipsoid:
    """Reflected rays: start and direction move together, within an ellipsoid of six dimensions given by its squares.

    How the two hang together is what tells a mirror that gathers rays from one that spreads them.
    """

    starts: Matrix
    mixed: Matrix  # starts by directions
    directions: Matrix

    def both(self, v: Real, w: Real) -> Real:
        """How far v.start + w.direction moves."""
        return root_of(form(v, self.starts, v) + 2 * form(v, self.mixed, w) + form(w, self.directions, w))

    def across(self, v: Real, t: Real) -> Real:
        """How far v.(start + t direction) moves."""
        return self.both(v, t * v)

    def point(self, t: Real, gradient: Real, direction: Real) -> Real:
        """How far the point at t moves, slid along the ray back to the surface of that gradient."""
        sliding = slide(gradient, direction)
        return root_of(trace_of(product(product(sliding, at_point(self.blocks(), t)), turned(sliding))))

    def turn(self) -> Real:
        """How far the direction moves."""
        return root_of(trace_of(self.directions))

    def blocks(self) -> tuple[Matrix, Matrix, Matrix]:
        """The squares of the errors: of starts, of starts by directions, of directions."""
        return self.starts, self.mixed, self.directions

    def __getitem__(self, chosen: Index) -> Ellipsoid:
        return Ellipsoid(*(block[..., chosen] for block in self.blocks()))


@dataclass
class Place:
    """A hit on a sphere, and what the sphere adds to its errors."""

    t: Real
    direction: Real
    normal: Real  # outward
    scaling: Real
    gradient: Real  # (x - p) / s^2
    along: Real  # how far the surface moves the hit along the ray, in lengths of its direction
    tilt: Real  # by what angle the surface turns the normal

    def bend(self) -> Real:
        """By what angle at most the normal turns for a step on the surface."""
        return curvature(self.scaling, self.gradient)


def place(t: Real, direction: Real, n: Real, scaling: Real, position: Real) -> Place:
    """What the surface |y| = 1 of a sphere adds to the errors of a hit at y = n."""
    gradient = n / scaling
    normal = gradient / norm(gradient)
    slope = dot(gradient, direction)
    # Along the ray the hit moves with the centre, the scalings, and the rounding of y = o + t d.
    step = np.abs(n) + 2 * np.abs(t * direction / scaling)
    own = (dot(np.abs(n), step) + 1) / np.abs(slope)
    along = own + dot(np.abs(n), np.abs(position) / scaling) / np.abs(slope)
    # The normal turns by what of that goes along the surface, ...
    stretched = direction / (scaling * scaling)
    across = norm(stretched - dot(stretched, normal) * normal) / norm(gradient)
    # ... by the hit's step over the surface, P dp, when the centre moves by dp, ...
    slid = [
        np.abs(position[k])
        * root_of(1 + gradient[k] / slope * (dot(direction, direction) * gradient[k] / slope - 2 * direction[k]))
        for k in range(3)
    ]
    # ... because n is rounded, and because unequal changes of the scalings tilt it.
    rounding = 2 + 1 / (scaling.min(axis=0) * norm(gradient))
    tilt = across * own + curvature(scaling, gradient) * (slid[0] + slid[1] + slid[2]) + rounding
    return Place(t, direction, normal, scaling, gradient, along, tilt)


def reflected(beam: Pencil | Ellipsoid, at: Place) -> Ellipsoid:
    """The errors of the rays that mirrors send on."""
    carried, added = carry(beam, at).blocks(), add(at).blocks()
    # (a + b)^2 <= (1 + 1/p) a^2 + (1 + p) b^2 for any p; best where p = a / b.
    p = np.clip(root_of(trace_of(carried[2]) / trace_of(added[2])), 1e-6, 1e6)
    return Ellipsoid(*((1 + 1 / p) * a + (1 + p) * b for a, b in zip(carried, added, strict=True)))


def mirror(at: Place) -> tuple[Matrix, Matrix]:
    """What a step of the hit does to the reflected direction, and what a turn of the normal does to it."""
    one, normal = identity(at.t.size), at.normal
    # The outward normal: dN = K dx, K = (1 - N N) / |g| diag(1 / s^2).
    bend = (one - outer(normal, normal)) / norm(at.gradient) / (at.scaling * at.scaling)[None, :, :]
    # The direction: d' = d - 2 (d.N) N, so dd' = (1 - 2 N N) dd - 2 (N d + (d.N) 1) dN, whichever way N points.
    swing = -2 * (outer(normal, at.direction) + dot(at.direction, normal) * one)
    return product(swing, bend), swing


def carry(beam: Pencil | Ellipsoid, at: Place) -> Ellipsoid:
    """The errors that rays bring to mirrors, after the mirrors."""
    starts, mixed, directions = beam.blocks()
    turn, _ = mirror(at)
    # The hit point: dx = P (do + t dd), with P sliding along the ray back to the surface.
    sliding = slide(at.gradient, at.direction)
    flip = identity(at.t.size) - 2 * outer(at.normal, at.normal)
    hit = product(product(sliding, at_point((starts, mixed, directions), at.t)), turned(sliding))
    arriving = product(product(sliding, mixed + at.t * directions), turned(flip))
    through = product(turn, arriving)
    bent = product(product(turn, hit), turned(turn))
    flipped = product(product(flip, directions), turned(flip))
    return Ellipsoid(hit, product(hit, turned(turn)) + arriving, bent + through + turned(through) + flipped)


def add(at: Place) -> Ellipsoid:
    """What mirrors add: they move along the ray, their normals tilt, and d' is rounded.

    Of three terms the square is at most 3 times the sum of the squares.
    """
    turn, swing = mirror(at)
    pushed = at.direction * at.along
    swung = (turn * pushed[None]).sum(axis=1)
    tilted = product(swing, turned(swing)) * at.tilt**2
    rounded = identity(at.t.size) * (4 * dot(at.direction, at.direction))
    return Ellipsoid(3 * outer(pushed, pushed), 3 * outer(pushed, swung), 3 * (outer(swung, swung) + tilted + rounded))


def identity(count: int) -> Matrix:
    """The unit matrix of each ray."""
    return np.repeat(np.eye(3)[:, :, None], count, axis=2)


def outer(a: Real, b: Real) -> Matrix:
    """The matrix a b^T of each pair of vectors."""
    return a[:, None] * b[None, :]


def product(a: Matrix, b: Matrix) -> Matrix:
    """The matrix product of each pair."""
    return np.stack([np.stack([dot(a[i], b[:, k]) for k in range(3)]) for i in range(3)])


def turned(a: Matrix) -> Matrix:
    """The transposed matrices."""
    return a.transpose(1, 0, 2)


def trace_of(a: Matrix) -> Real:
    """The sum of each diagonal."""
    total: Real = a[0, 0] + a[1, 1] + a[2, 2]
    return total


def form(v: Real, a: Matrix, w: Real) -> Real:
    """The product v^T a w of each ray."""
    return dot(v, np.stack([dot(a[i], w) for i in range(3)]))


def root_of(squared: Real) -> Real:
    """Square roots of what is not below 0 but by rounding."""
    root: Real = np.sqrt(np.maximum(squared, 0))
    return root


def slide(gradient: Real, direction: Real) -> Matrix:
    """The projection along a direction onto the plane across a gradient."""
    return identity(gradient.shape[1]) - outer(direction, gradient) / dot(gradient, direction)


def at_point(blocks: tuple[Matrix, Matrix, Matrix], t: Real) -> Matrix:
    """The squares of the error of start + t direction."""
    starts, mixed, directions = blocks
    return starts + t * (mixed + turned(mixed)) + t * t * directions


@dataclass
class Root:
    """Where rays meet a sphere: t, and what it takes to move it."""

    t: Real
    moves: Real  # by how much it moves where the ray runs through the centre
    half: Real  # half the chord: a root of a short chord moves the more
    speed: Real  # length of the ray's direction in the sphere's unit space

    def error(self, gap: Real | float = 0.0) -> Real:
        """How far t moves. To move it by a gap longer than the chord it takes the square root's slope at the gap."""
        return self.moves / np.maximum(self.half, np.minimum(np.abs(gap) * self.speed / 2, 1))

    def margin(self, end: float) -> Real:
        """The margin of the decision t > end."""
        return ratio(self.t - end, self.error(self.t - end))

    def where(self, flags: Flags, other: Root) -> Root:
        """This root where the flags hold, else the other."""
        mine, others = (self.t, self.moves, self.half, self.speed), (other.t, other.moves, other.half, other.speed)
        return Root(*(np.where(flags, a, b) for a, b in zip(mine, others, strict=True)))


class Meeting:
    """Rays and one sphere: where they meet, and how that moves. `beam` has the errors of the rays."""

    def __init__(self, tables: Tables, position: Real, rays: Rays, direction: Real, j: int, beam: Aim) -> None:
        self.origin, self.direction = to_unit_space(tables, rays, direction, j)
        self.line: Chord = chord(self.origin, self.direction)
        self.scaling = tables.scaling[:, j : j + 1]
        self.reach = np.abs(position[:, j : j + 1]) / self.scaling
        self.beam, self.rays, self.own = beam, rays, rays.start == j

    def moved(self, n: Real, t: Real, some: Index) -> Real:
        """How far |y|^2 / 2 moves at the rays' points y = n at t: ray, centre, scalings, and the rounding of y."""
        step = np.abs(self.origin[:, some]) + np.abs(t * self.direction[:, some])
        size = np.abs(n)
        return self.beam[some].across(n / self.scaling, t) + dot(size, self.reach + step + size)

    def outline(self, counts: Flags) -> Real:
        """Margin of the sign of D = 1 - |l|^2 where it counts. l is closest to the centre: it moves across its ray."""
        margin = np.full(counts.size, np.inf)
        some = np.flatnonzero(counts)
        middle = (self.line.height / self.line.speed)[some]
        moved = 2 * self.moved(self.line.middle[:, some], middle, some) + 1
        margin[some] = ratio(self.line.discriminant[some], moved)
        return margin

    @functools.cached_property
    def roots(self) -> tuple[Root, Root]:
        """The near and the far root; nan where the ray misses."""
        near, far = self.root(self.line.near, -1.0), self.root(self.line.far, 1.0)
        return near, far

    def root(self, t: Real, side: float) -> Root:
        """One of the two roots."""
        line, some = self.line, np.flatnonzero(self.line.meets & ~self.own)
        root, moved = np.full_like(t, np.nan), np.ones_like(t)
        root[some] = t[some]
        n = line.middle[:, some] + side * line.half[some] * line.axis[:, some]
        moved[some] = self.moved(n, t[some], some) / line.speed[some]
        return Root(root, moved, line.half, line.speed)

    def first(self, after: float) -> Root:
        """The root that a ray meets first after t = after; inf where there is none."""
        near, far = self.roots
        root = near.where(near.t > after, far)
        if self.own.any():
            other = self.own_root()
            other.t = np.where(self.rays.inside, other.t, np.inf)
            root = other.where(self.own, root)
        root.t = np.where(root.t > after, root.t, np.inf)
        return root

    def own_root(self) -> Root:
        """The other root -2 n.d / d.d of the rays that start on this sphere; nan on other rays."""
        some = np.flatnonzero(self.own)
        n, d = self.rays.point[:, some], self.direction[:, some]
        t, squared = other_root(n, d), dot(d, d)
        v, w = d / self.scaling / squared, (n + t * d) / self.scaling / squared
        scalings = 3 * dot(np.abs(n), np.abs(d)) / squared + 2 * np.abs(t)
        centre = dot(np.abs(v), self.reach * self.scaling)
        root, moved = np.full(self.own.size, np.nan), np.ones(self.own.size)
        root[some], moved[some] = t, 2 * (self.beam[some].both(v, w) + centre + scalings)
        return Root(root, moved, np.ones_like(root), self.line.speed)

    def second_root(self) -> Root:
        """The other root c / d.d of rays that end, at t = 1, on this sphere: from their product."""
        o, d = self.origin, self.direction
        squared = dot(d, d)
        t = (dot(o, o) - 1) / squared
        v, w = o / self.scaling / squared, t * d / self.scaling / squared
        centre = dot(np.abs(v), self.reach * self.scaling)
        rest = (2 * dot(o, o) + 1) / squared + 2 * np.abs(t)
        return Root(t, 2 * (self.beam.both(v, -w) + centre + rest), np.ones_like(t), np.sqrt(squared))


def slant(cosine: Real) -> Real:
    """The sine: how far a cosine moves with its angle."""
    return root_of(1 - cosine * cosine)


def curvature(scaling: Real, gradient: Real) -> Real:
    """The larger principal curvature of an ellipsoid, from its gradient n / s: H + sqrt(H^2 - K)."""
    squared, flat = dot(gradient, gradient), 1 / (scaling * scaling)
    mean = (flat.sum(axis=0) - dot(gradient * gradient, flat) / squared) / (2 * np.sqrt(squared))
    gaussian = flat[0] * flat[1] * flat[2] / (squared * squared)
    larger: Real = mean + root_of(mean * mean - gaussian)
    return larger
