"""How the cosines N.L and R.V at hit points, and the terms made of them, move with the numbers of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracer.motion import DECISION, VALUE, Beam, Gradient, Shape, beside, norm
from tracer.reference import Flags, Light, Real, Surface, dot

# Roundings at most: of a normal, and of the directions to a light and to the eye, as angles; of a difference of
# positions, by the lengths it is made of; of N.L and of R.V besides.
NORMAL, UNIT, DIFFERENCE, COSINE, SHINE = 4, 2, 3, 3, 46
# Powers and products below 2^-24 times this, of a term's full size or of 1, may underflow to 0 in float32.
UNDERFLOW = 2.0**-100
# Where a cosine is at an extreme its second derivative tells: values count it for changes up to this.
LARGEST = 64 * 2.0**-24


def across(v: Real, unit: Real) -> Real:
    """The part of v that is perpendicular to a unit vector."""
    return v - dot(v, unit) * unit


@dataclass
class Cosine:
    """How a cosine depends on the gradient of the surface, on the hit point by L, and on the direction by V."""

    gradient: Real
    point: Real
    direction: Real | None
    rest: Real  # how far it moves with the light's position
    rounded: Real  # by how many roundings it may be off besides
    bend: Real | float = 0.0  # how far besides in decisions, times delta^2 / 2


class Cosines:
    """Hit points, each on its own sphere, with the derivatives of the rays that arrive there."""

    def __init__(self, at: Surface, beam: Beam, shape: Shape, direction: Real) -> None:
        self.at, self.beam, self.shape = at, beam, shape
        self.speed = norm(direction)
        # The normal is turned to the side that is seen.
        self.steep = np.where(at.x.inside, -1.0, 1.0) * shape.steep
        self.flat = 1 / (shape.scaling * shape.scaling)
        # By how much the normal turns at most.
        moves = self.flat * (beam.start_moves + np.abs(shape.position)) + 2 * np.abs(shape.gradient)
        self.turns = beside(moves, at.normal) / shape.steep

    def incident(self, seen: Light, p: Real) -> tuple[Cosine, Cosine]:
        """N.L for a light at p: its value, and its sign."""
        L, N, distance = seen.L, self.at.normal, norm(seen.to_light)
        gradient, point = across(L, N) / self.steep, -across(N, L) / distance
        rounded = sine(seen.NL) * (NORMAL + UNIT) + COSINE
        moves = self.light_moves(p)
        second = LARGEST * (self.turns + norm(moves) / distance) ** 2
        value = Cosine(gradient, point, None, *self.rest(point, p, rounded, second))
        # The sign is that of N.(p - x), which moves where L does not.
        point = -N / distance
        bend = 2 * self.turns * beside(moves, N) / distance
        return value, Cosine(gradient, point, None, *self.rest(point, p, rounded), bend)

    def mirrored(self, seen: Light, p: Real) -> tuple[Cosine, Cosine]:
        """R.V for a light at p, 2 (N.L) (N.V) - L.V: its value, and its sign."""
        L, N, V, distance = seen.L, self.at.normal, self.at.viewer, norm(seen.to_light)
        NV = dot(N, V)
        toward = 2 * NV * N - V
        point = -across(toward, L) / distance
        # V = -d / |d|
        direction = -across(2 * seen.NL * N - L, V) / self.speed
        rounded = sine(seen.RV) * (2 * NORMAL + 2 * UNIT) + SHINE
        gradient = across(2 * (NV * L + seen.NL * V), N) / self.steep
        turns = 2 * self.turns + beside(self.beam.direction_moves, V) / self.speed
        bend = (turns + norm(self.light_moves(p)) / distance) ** 2
        value = Cosine(gradient, point, direction, *self.rest(point, p, rounded, LARGEST * bend))
        point = -toward / distance
        return value, Cosine(gradient, point, direction, *self.rest(point, p, rounded), bend)

    def light_moves(self, p: Real) -> Real:
        """How far the components of p - x move."""
        lengths = np.abs(p)
        return self.beam.start_moves + lengths + DIFFERENCE / DECISION * (lengths + self.beam.reach)

    def rest(self, point: Real, p: Real, rounded: Real, second: Real | float = 0.0) -> tuple[Real, Real]:
        """How far a cosine moves with the light's position, and all its roundings; `point` as in Cosine."""
        moves = dot(np.abs(point), np.abs(p)) + second
        return moves, DIFFERENCE * dot(np.abs(point), np.abs(p) + self.beam.reach) + rounded

    def of(self, cosine: Cosine) -> Gradient:
        """By x, d and the sphere: the surface's gradient is g = (x - p) / s^2."""
        bent, shape = cosine.gradient * self.flat, self.shape
        scalings = -2 * shape.gradient * cosine.gradient
        start, position = bent + cosine.point, -bent * shape.position
        return Gradient(start, cosine.direction, position, scalings, cosine.rest, cosine.rounded, cosine.bend)


class Terms:
    """Sums over lights of a factor times a cosine, by channel: what they depend on, and how they move besides."""

    def __init__(self, count: int) -> None:
        self.gradient, self.point, self.direction = np.zeros((3, 3, 3, count))
        self.rest, self.rounded = np.zeros((2, 3, count))
        self.shiny = False

    def __add__(self, other: Terms) -> Terms:
        total = Terms(0)
        total.gradient, total.point = self.gradient + other.gradient, self.point + other.point
        total.direction = self.direction + other.direction
        total.rest, total.rounded = self.rest + other.rest, self.rounded + other.rounded
        total.shiny = self.shiny or other.shiny
        return total

    def add(
        self, lit: Flags, near: Flags, size: Real, of: Cosine, moves: Real, factors: Real, slope: Real | float = 1.0
    ) -> None:
        """One light more, for the rays where it is lit: a size by channel times a function of a cosine.

        `slope` is the function's derivative by the cosine, `factors` its value times the numbers that it is a product
        of, `moves` the cosine's motion. `near`: where the cosine is nearly 0, and the function not smooth.
        """
        factor = size * slope
        wide, smooth = factor[:, None], lit & ~near
        self.gradient += np.where(smooth, wide * of.gradient, 0)
        self.point += np.where(smooth, wide * of.point, 0)
        if of.direction is not None:
            self.shiny = True
            self.direction += np.where(smooth, wide * of.direction, 0)
        # Roundings count for more in values than in `moves`.
        rest = np.where(near, DECISION / VALUE * moves, of.rest)
        self.rest += np.where(lit, np.abs(factor) * rest + np.abs(size) * (factors + UNDERFLOW), 0)
        self.rounded += np.where(smooth, np.abs(factor) * of.rounded, 0)

    def sizes(self, cosines: Cosines) -> Real:
        """The motion of the channel that moves most."""
        moves = []
        for k in range(3):
            direction = self.direction[k] if self.shiny else None
            of = cosines.of(Cosine(self.gradient[k], self.point[k], direction, self.rest[k], self.rounded[k]))
            moves.append(cosines.beam.motion(of, cosines.at.x.start, VALUE))
        largest: Real = np.max(moves, axis=0)
        return largest


def sine(cosine: Real) -> Real:
    """How far a cosine moves with its angle."""
    found: Real = np.sqrt(np.maximum(1 - cosine * cosine, 0))
    return found
