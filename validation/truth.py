"""Proves the colours of single pixels: balls that hold the exact values of the specification for a scene's numbers.

Every decision of a pixel (does the ray meet this sphere, which hit is nearer, is the light hidden, does it face the
surface) is the sign of a polynomial in the scene's numbers and in roots of discriminants. A ball that does not hold 0
decides it; else the precision doubles; else the sign is worked out exactly (`validation.exact`), so a tie is proved and
not guessed. What is 0 by structure is never computed: the root at which a secondary ray starts, the root t = 1 of a
light that lies on a surface, spheres that are the same.

A sphere is the quadratic form f(v) = sum w_k v_k^2 - 1 about its centre, w = 1 / s^2. On a ray m + t d (m from the
centre) f = A t^2 + 2 B t + C, with A = sum w d^2, B = sum w m d, C = f(m), and D = B^2 - A C a quarter of the
discriminant.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from flint import arb, ctx, fmpq

from validation.exact import Lazy, TooLargeError, Tower
from validation.renderers import Settings

if TYPE_CHECKING:
    from tracer import Scene

#: Balls begin with this many bits; where a decision or a value is not certain enough they get twice as many.
BITS = 128
#: A decision that this many bits do not settle is worked out exactly, beside balls of four times as many.
EXACT_FROM = 4096
#: No pixel gets more bits than this.
MOST_BITS = 1 << 16
#: The largest radius of a ball that is returned, relative above 1.
RADIUS = 1e-30
#: Pixels that are cheaper to prove here than in other processes.
FEW = 64

Vector: TypeAlias = tuple[Any, Any, Any]


#: The smallest float64.
TINY = 2.0**-1074


class Ball(NamedTuple):
    """A real number: middle = mantissa 2^exponent, exactly, and an upper bound of the distance from it.

    `mantissa` None stands for infinity, the depth where nothing is hit.
    """

    mantissa: int | None
    exponent: int
    radius: float

    @staticmethod
    def of(value: arb) -> Ball:
        """The same ball; what no float64 can tell from 0 is 0, as (R.V)^n may have more zeros than a machine holds."""
        if not value.abs_upper() > TINY:
            return Ball(0, 0, 0.0 if value == 0 else TINY)
        mantissa, exponent = value.mid().man_exp()
        # A radius has 30 bits, so that only underflow changes it.
        radius = float(value.rad())
        if radius < sys.float_info.min and not value.is_exact():
            radius = math.nextafter(radius, math.inf)
        return Ball(int(mantissa), int(exponent), radius)

    def arb(self) -> arb:
        """As a ball of python-flint."""
        if self.mantissa is None:
            return arb.pos_inf()
        return arb((self.mantissa, self.exponent), self.radius)

    @property
    def value(self) -> float:
        """The float64 nearest to the middle."""
        if self.mantissa is None:
            return math.inf
        try:
            if self.exponent >= 0:
                return float(self.mantissa << self.exponent)
            return self.mantissa / (1 << -self.exponent)
        except OverflowError:
            return math.copysign(math.inf, self.mantissa)

    def contains(self, value: Any) -> bool:
        """Whether a number (an int, float or rational) lies in the ball."""
        if self.mantissa is None:
            return bool(value == math.inf)
        rational = fmpq(*value.as_integer_ratio()) if isinstance(value, float) else fmpq(value)
        return bool(abs(rational - self.middle()) <= fmpq(*self.radius.as_integer_ratio()))

    def middle(self) -> fmpq:
        """The middle of a finite ball."""
        assert self.mantissa is not None
        return fmpq(self.mantissa) * fmpq(2) ** self.exponent

    def error(self, value: float) -> float:
        """How far a float is from the exact value at most: nan for nan."""
        if self.mantissa is None or not math.isfinite(value):
            return 0.0 if value == self.value else abs(value - self.value)
        distance = abs(fmpq(*value.as_integer_ratio()) - self.middle()) + fmpq(*self.radius.as_integer_ratio())
        p, q = int(distance.p), int(distance.q)
        return math.nextafter(p / q, math.inf) if p else 0.0


INFINITE = Ball(None, 0, 0.0)
_NOTHING = Ball(0, 0, 0.0)


class Key(NamedTuple):
    """Which decision: what is asked, at which hit of the chain (0: the primary ray), about which sphere and light.

    `what`:
    meets   D >= 0: the ray meets the sphere (0: it touches)
    start   f > 0 where the ray begins to count: t = 1, the point of reflection, the shadow epsilon
    ahead   the closest point of the line lies where the ray has not begun yet (< 0: the sphere is ahead)
    end     the light's end of a shadow ray: the closest point, or the other root where the light lies on the sphere
    order   the hit of `sphere` is behind (> 0) or before (< 0) that of `other`
    faces   N.L > 0
    shines  R.V > 0
    at      the light is not at x itself
    """

    what: str
    bounce: int
    light: int
    sphere: int
    other: int = -1


KINDS = {
    "meets": "silhouette",
    "ahead": "silhouette",
    "start": "range",
    "end": "range",
    "at": "range",
    "order": "order",
    "faces": "terminator",
    "shines": "terminator",
}


@dataclass(frozen=True)
class Tie:
    """A decision whose quantity is exactly 0, or that could not be told from 0.

    `settled`: the sentence of the specification that decides it, "" where none does. `outcomes`: what the pixel may be:
    `beauty` of every way to decide that is not settled, as float64; one entry where it makes no difference.
    """

    key: Key
    settled: str
    outcomes: tuple[tuple[float, float, float], ...]
    proved: bool = True


@dataclass(frozen=True)
class Truth:
    """What the specification says about one pixel.

    `values`: by name of the pass one ball a channel. `bits`: the precision at which everything was certain.
    """

    x: int
    y: int
    id: int
    values: Mapping[str, tuple[Ball, ...]]
    ties: tuple[Tie, ...]
    bits: int


class UncertainError(ArithmeticError):
    """A ball that holds 0 does not tell a sign."""

    def __init__(self, key: Key) -> None:
        """`key` is the decision."""
        super().__init__(key)
        self.key = key


class UnprovedError(ArithmeticError):
    """A pixel whose value could not be had at any precision; the text says where."""


# ---- the numbers of a scene


def rational(value: float) -> fmpq:
    """The exact value of a float64."""
    return fmpq(*value.as_integer_ratio())


@dataclass
class Numbers:
    """Every number of a scene as a rational, by name: `view.near`, `s0.position.1`, `l2.intensity.0` ..."""

    of: dict[str, fmpq]

    @staticmethod
    def exact(scene: Scene) -> Numbers:
        """The float64 values, which are the scene."""
        of: dict[str, fmpq] = {}

        def put(name: str, value: float | Sequence[float]) -> None:
            if isinstance(value, Sequence):
                of.update({f"{name}.{k}": rational(float(entry)) for k, entry in enumerate(value)})
            else:
                of[name] = rational(float(value))

        for side in ("near", "left", "right", "bottom", "top"):
            put(f"view.{side}", getattr(scene.view, side))
        for j, sphere in enumerate(scene.spheres):
            for name in ("position", "scaling", "color", "ka", "kd", "ks", "kr", "exponent"):
                put(f"s{j}.{name}", getattr(sphere, name))
        for i, light in enumerate(scene.lights):
            put(f"l{i}.position", light.position)
            put(f"l{i}.intensity", light.intensity)
        put("background", scene.background)
        put("ambient", scene.ambient)
        return Numbers(of)

    def changed(self, relative: Mapping[str, fmpq]) -> Numbers:
        """Numbers multiplied by 1 + `relative`."""
        return Numbers(
            {name: value * (1 + relative[name]) if name in relative else value for name, value in self.of.items()}
        )

    def vector(self, name: str) -> Vector:
        """Three of them."""
        return self.of[f"{name}.0"], self.of[f"{name}.1"], self.of[f"{name}.2"]


@dataclass(frozen=True)
class Structure:
    """What a scene is by design, which no change of its numbers undoes."""

    distinct: tuple[int, ...]  # spheres that exist: of equal ones the first
    light_on: frozenset[tuple[int, int]]  # (sphere, light): the light lies on the sphere

    @staticmethod
    def of(numbers: Numbers, distinct: Sequence[int], lights: int) -> Structure:
        """Decided exactly."""
        on = {(j, i) for j in distinct for i in range(lights) if _light_side(numbers, j, i) == 0}
        return Structure(tuple(distinct), frozenset(on))


def _light_side(numbers: Numbers, j: int, i: int) -> fmpq:
    """The form f of sphere j at light i: below 0 inside, 0 on it, above 0 outside."""
    p, s, light = numbers.vector(f"s{j}.position"), numbers.vector(f"s{j}.scaling"), numbers.vector(f"l{i}.position")
    return sum((((a - b) / c) ** 2 for a, b, c in zip(light, p, s, strict=True)), fmpq(-1))


class Tables:
    """The numbers of a scene in one kind of arithmetic; `lift` takes a rational to it."""

    def __init__(
        self, numbers: Numbers, structure: Structure, spheres: int, lights: int, lift: Callable[[fmpq], Any]
    ) -> None:
        """Also what all pixels share: the forms of the spheres, and where the eye and the lights are in them."""
        of = numbers.of

        def several(values: Iterable[fmpq]) -> Any:
            return tuple(lift(value) for value in values)

        self.lift, self.numbers, self.lights = lift, numbers, lights
        self.distinct = structure.distinct
        position = [numbers.vector(f"s{j}.position") for j in range(spheres)]
        weight = [tuple(1 / (s * s) for s in numbers.vector(f"s{j}.scaling")) for j in range(spheres)]
        self.position = [several(p) for p in position]
        self.w = [several(w) for w in weight]
        self.light = [several(numbers.vector(f"l{i}.position")) for i in range(lights)]
        self.side = {
            (j, i): 0 if (j, i) in structure.light_on else _sign(_light_side(numbers, j, i))
            for j in self.distinct
            for i in range(lights)
        }
        # The eye stands at the origin: m = -p, and f there.
        from_centre = [tuple(-a for a in p) for p in position]
        self.eye = [
            (
                several(m),
                several(a * b for a, b in zip(w, m, strict=True)),
                lift(sum((a * b * b for a, b in zip(w, m, strict=True)), fmpq(-1))),
            )
            for m, w in zip(from_centre, weight, strict=True)
        ]
        color = [numbers.vector(f"s{j}.color") for j in range(spheres)]
        intensity = [numbers.vector(f"l{i}.intensity") for i in range(lights)]
        ambient = numbers.vector("ambient")
        self.background = several(numbers.vector("background"))
        self.ambient = [
            several(of[f"s{j}.ka"] * a * b for a, b in zip(ambient, color[j], strict=True)) for j in range(spheres)
        ]
        # None: nothing of that term there, so nothing to compute.
        self.diffuse = [
            [
                _some(several, [of[f"s{j}.kd"] * a * b for a, b in zip(intensity[i], color[j], strict=True)])
                for i in range(lights)
            ]
            for j in range(spheres)
        ]
        self.specular = [
            [_some(several, [of[f"s{j}.ks"] * a for a in intensity[i]]) for i in range(lights)] for j in range(spheres)
        ]
        self.kr = [lift(of[f"s{j}.kr"]) if of[f"s{j}.kr"] != 0 else None for j in range(spheres)]
        exponent = [of[f"s{j}.exponent"] for j in range(spheres)]
        self.exponent = [int(n.p) if n.q == 1 else lift(n) for n in exponent]


def _some(several: Callable[[Iterable[fmpq]], Any], values: list[fmpq]) -> Any:
    return several(values) if any(value != 0 for value in values) else None


def _sign(value: Any) -> int:
    return int(value > 0) - int(value < 0)


# ---- one pixel


@dataclass
class Sight:
    """One light seen from a hit."""

    light: int
    faces: int  # sign of N.L
    blockers: tuple[int, ...]  # spheres that hide it; at most one unless all were asked for
    asked: bool  # whether the shadow was asked for
    cosine: Any = 0  # N.L where lit
    shine: Any = 0  # R.V where it shines
    diffuse: Vector | None = None
    specular: Vector | None = None


@dataclass
class Hit:
    """One hit of the chain."""

    bounce: int
    sphere: int
    t: Any
    inside: bool
    touches: bool
    point: Vector
    gradient: Vector  # w (x - p), turned to the side that is seen
    direction: Vector  # of the ray that arrives
    weight: Any  # product of the Kr's before
    ambient: Vector = (0, 0, 0)
    sights: list[Sight] = field(default_factory=list)


class Follower:
    """Follows a pixel's ray through the scene by the letter of the specification, in one kind of arithmetic.

    A subclass that overrides one of the small methods below follows another rule: a renderer's documented one, or a
    mistake; so the judge can show what that rule makes of a pixel.
    """

    #: Whether colours are wanted, or decisions alone.
    shades = True
    #: Whether all spheres that hide a light are wanted, or whether it is hidden.
    every_blocker = False
    #: Whether a certain quantity may save the questions after it. Not where someone watches, or forces decisions: there
    #: every question of a path is asked.
    hurries = True
    #: The weight of the reflected ray that hit nothing; None: there was none.
    missed: Any = None

    def __init__(self, tables: Tables, sign: Callable[..., int], epsilon: Any, max_reflections: int) -> None:
        """`sign(value, *key)` decides."""
        self.tables, self.sign, self.epsilon, self.max_reflections = tables, sign, epsilon, max_reflections

    # What a rule may change.

    def begins(self, bounce: int) -> int:
        """Hits count after this t: the near plane limits primary rays alone."""
        return 1 if bounce == 0 else 0

    def turned(self, gradient: Vector, sphere: int, inside: bool) -> Vector:
        """The gradient to the side that is seen."""
        del sphere
        return (-gradient[0], -gradient[1], -gradient[2]) if inside else gradient

    def casts(self, sphere: int, own: bool, light: int) -> bool:
        """Whether a sphere may hide a light."""
        del sphere, own, light
        return True

    def color(self, hit: Hit) -> Vector:
        """The sum of a hit's own terms, as a mirror shows it."""
        return add(hit.ambient, *(sight.diffuse for sight in hit.sights), *(sight.specular for sight in hit.sights))

    def beyond(self) -> Vector | None:
        """What a mirror shows where the reflected ray hits nothing."""
        return None

    def highlight(self, hit: Hit, to_light: Vector, gl: Any, gg: Any) -> tuple[Any, Callable[[], Any]]:
        """R.V in two factors: a polynomial with its sign, and what that is to be divided by."""
        lx, ly, lz = to_light
        dx, dy, dz = hit.direction
        gx, gy, gz = hit.gradient
        # R.V |L| |d| |g|^2, with R = 2 (N.L) N - L and V = -d / |d|.
        shine = (lx * dx + ly * dy + lz * dz) * gg - 2 * gl * (gx * dx + gy * dy + gz * dz)
        return shine, lambda: gg * ((lx * lx + ly * ly + lz * lz) * (dx * dx + dy * dy + dz * dz)).sqrt()

    # The ray.

    def follow(self, direction: Vector) -> list[Hit]:
        """The hits of the chain, each with its light."""
        tables = self.tables
        hits: list[Hit] = []
        origin: Vector = (tables.lift(fmpq(0)),) * 3
        relative, own, inside, weight = tables.eye, -1, False, None
        for bounce in range(self.max_reflections + 1):
            found = self.nearest(relative, direction, bounce, own, inside)
            if found is None:
                self.missed = weight
                break
            own, t, inside, touches = found
            dx, dy, dz = direction
            point = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
            relative = self.around(point, own)
            gradient = self.turned(relative[own][1], own, inside)
            hit = Hit(bounce, own, t, inside, touches, point, gradient, direction, weight)
            hits.append(hit)
            self.illuminate(hit, relative)
            if tables.kr[own] is None or bounce == self.max_reflections:
                break
            weight = tables.kr[own] if weight is None else weight * tables.kr[own]
            direction = self.reflect(direction, gradient)
            origin = point
        return hits

    def reflect(self, direction: Vector, normal: Vector) -> Vector:
        """The mirror: d - 2 (d.N) N with N = g / |g|."""
        dx, dy, dz = direction
        x, y, z = normal
        factor = 2 * (dx * x + dy * y + dz * z) / (x * x + y * y + z * z)
        return dx - factor * x, dy - factor * y, dz - factor * z

    def around(self, point: Vector, own: int) -> list[Any]:
        """For each sphere: the point from its centre, its gradient there, and f there, but for the own sphere's 0."""
        tables = self.tables
        x, y, z = point
        found: list[Any] = [None] * len(tables.position)
        for j in tables.distinct:
            px, py, pz = tables.position[j]
            wx, wy, wz = tables.w[j]
            mx, my, mz = x - px, y - py, z - pz
            gx, gy, gz = wx * mx, wy * my, wz * mz
            found[j] = (mx, my, mz), (gx, gy, gz), None if j == own else gx * mx + gy * my + gz * mz - 1
        return found

    def nearest(
        self, relative: list[Any], direction: Vector, bounce: int, own: int, inside: bool
    ) -> tuple[int, Any, bool, bool] | None:
        """The nearest hit: sphere, t, whether from inside, whether it only touches."""
        tables, sign, begins = self.tables, self.sign, self.begins(bounce)
        dx, dy, dz = direction
        best: tuple[int, Any, bool, bool] | None = None
        for j in tables.distinct:
            if j == own and not inside:
                continue  # it starts there, and leaves
            wx, wy, wz = tables.w[j]
            A = wx * dx * dx + wy * dy * dy + wz * dz * dz
            _, (gx, gy, gz), C = relative[j]
            B = gx * dx + gy * dy + gz * dz
            touches = False
            if j == own:
                # One root is the start; it runs inside, so the other is ahead.
                t, far = -2 * B / A, True
                if begins and not t > begins:
                    continue
            else:
                f, slope = (A + 2 * B + C, A + B) if begins else (C, B)
                at_start = sign(f, "start", bounce, -1, j)
                if at_start > 0:
                    if self.hurries and slope > 0:
                        continue
                    D = B * B - A * C
                    meets = sign(D, "meets", bounce, -1, j)
                    if meets < 0 or sign(slope, "ahead", bounce, -1, j) >= 0:
                        continue
                    touches, far = meets == 0, False
                    t = -B / A if touches else (-B - root(D)) / A
                elif at_start < 0:
                    far, t = True, (-B + root(B * B - A * C)) / A
                elif sign(slope, "ahead", bounce, -1, j) < 0:
                    # One root is where the ray begins to count, and does not count; the other by the sum of both.
                    far, t = True, -2 * B / A - begins
                else:
                    continue
            if best is not None and sign(t - best[1], "order", bounce, -1, j, best[0]) >= 0:
                continue
            best = j, t, far, touches
        return best

    # The lights.

    def illuminate(self, hit: Hit, relative: list[Any]) -> None:
        """Every light from a hit: does it face it, is it hidden, what does it give."""
        tables, sign = self.tables, self.sign
        j, bounce = hit.sphere, hit.bounce
        hit.ambient = tables.ambient[j]
        x, y, z = hit.point
        gx, gy, gz = hit.gradient
        for i in range(tables.lights):
            px, py, pz = tables.light[i]
            to_light = lx, ly, lz = px - x, py - y, pz - z
            useful = tables.diffuse[j][i] is not None or tables.specular[j][i] is not None
            if not useful and bounce:
                continue
            if tables.side[j, i] == 0 and sign(lx * lx + ly * ly + lz * lz, "at", bounce, i, j) == 0:
                hit.sights.append(Sight(i, 0, (), True))
                continue
            gl = gx * lx + gy * ly + gz * lz
            faces = sign(gl, "faces", bounce, i, j)
            asked = bounce == 0 or faces > 0
            blockers = self.blockers(hit, relative, to_light, i) if asked else ()
            sight = Sight(i, faces, blockers, asked)
            hit.sights.append(sight)
            if faces > 0 and not blockers and useful:
                self.shade(hit, sight, to_light, gl)

    def blockers(self, hit: Hit, relative: list[Any], to_light: Vector, i: int) -> tuple[int, ...]:
        """The spheres with a root epsilon < t < 1 on the way to the light; only the first unless all are wanted."""
        found: list[int] = []
        for j in self.tables.distinct:
            if self.casts(j, j == hit.sphere, i) and self.hides(hit, relative[j], to_light, i, j):
                found.append(j)
                if not self.every_blocker:
                    break
        return tuple(found)

    def hides(self, hit: Hit, relative: Any, to_light: Vector, i: int, j: int) -> bool:
        """Whether sphere j has a root epsilon < t < 1 on the way to the light."""
        tables, sign, epsilon, bounce, own = self.tables, self.sign, self.epsilon, hit.bounce, j == hit.sphere
        side = tables.side[j, i]
        if own and side <= 0:
            return False  # the other root is the light, or behind it
        lx, ly, lz = to_light
        _, (gx, gy, gz), C = relative
        B = gx * lx + gy * ly + gz * lz
        if self.hurries and side > 0 and B > 0 and (own or C > 0):
            return False  # x and light outside, and the ray leaves
        wx, wy, wz = tables.w[j]
        A = wx * lx * lx + wy * ly * ly + wz * lz * lz
        if own:
            # The roots are 0 and -2 B / A, and the light is outside: it is before the light.
            return sign(-2 * B - epsilon * A, "start", bounce, i, j) > 0
        if side == 0:
            # The roots are 1, which does not hide, and their product C / A.
            return sign(C - epsilon * A, "start", bounce, i, j) > 0 and sign(A - C, "end", bounce, i, j) > 0
        slope = B + epsilon * A
        at_start = sign(C + epsilon * (B + slope), "start", bounce, i, j)
        if side < 0 or at_start < 0:
            # One root before epsilon or behind the light, or both of them if the segment is all inside.
            return at_start > 0 or side > 0
        if at_start == 0:
            return sign(slope, "ahead", bounce, i, j) < 0
        if self.hurries and (slope > 0 or A + B < 0):
            return False
        return (
            sign(B * B - A * C, "meets", bounce, i, j) >= 0
            and sign(slope, "ahead", bounce, i, j) < 0
            and sign(A + B, "end", bounce, i, j) > 0
        )

    def shade(self, hit: Hit, sight: Sight, to_light: Vector, gl: Any) -> None:
        """Diffuse and specular term of a light that reaches the hit."""
        tables, j, i = self.tables, hit.sphere, sight.light
        diffuse, specular = tables.diffuse[j][i], tables.specular[j][i]
        gx, gy, gz = hit.gradient
        gg = gx * gx + gy * gy + gz * gz
        if self.shades and diffuse is not None:
            lx, ly, lz = to_light
            sight.cosine = gl * (gg * (lx * lx + ly * ly + lz * lz)).rsqrt()
            sight.diffuse = tuple(value * sight.cosine for value in diffuse)
        if specular is None:
            return
        shine, size = self.highlight(hit, to_light, gl, gg)
        if self.sign(shine, "shines", hit.bounce, i, j) > 0 and self.shades:
            # Below 0 only a forced decision leads.
            sight.shine = 0 * shine if shine < 0 else shine / size()
            power = sight.shine ** tables.exponent[j]
            sight.specular = tuple(value * power for value in specular)


def root(discriminant: Any) -> Any:
    """Half the chord; 0 below 0, where only a forced decision leads."""
    return 0 if discriminant < 0 else discriminant.sqrt()


def add(*vectors: Vector | None) -> Vector:
    """The sum; None is nothing."""
    x: Any = 0
    y: Any = 0
    z: Any = 0
    for vector in vectors:
        if vector is not None:
            x, y, z = x + vector[0], y + vector[1], z + vector[2]
    return x, y, z


# ---- the proof


class _Signs:
    """Signs of balls; those known already, and those that are to be otherwise, by their keys."""

    def __init__(self, known: Mapping[Key, int], forced: Mapping[Key, int], watch: dict[Key, Any] | None) -> None:
        self.known, self.forced, self.watch = known, forced, watch
        self.ties: list[Key] = []

    def quick(self, value: arb, *key: Any) -> int:
        """Nothing but the sign."""
        if value > 0:
            return 1
        if value < 0:
            return -1
        return self.hard(Key(*key))

    def hard(self, key: Key) -> int:
        """A ball that holds 0."""
        sign = self.known.get(key)
        if sign is None:
            raise UncertainError(key)
        if sign == 0:
            self.ties.append(key)
        return sign

    def careful(self, value: arb, *key: Any) -> int:
        """The sign, told to whoever watches, and the forced one where there is one."""
        name = Key(*key)
        if self.watch is not None:
            self.watch[name] = value
        if name in self.forced:
            return self.forced[name]
        return self.quick(value, *key)


@dataclass
class _Path:
    """A pixel's ray, followed."""

    bits: int  # that were enough for its decisions
    follower: Follower
    hits: list[Hit]
    ties: tuple[Key, ...]
    unproved: set[Key]


class Prover:
    """Proves pixels of a scene.

    Balls take their precision from a setting that all of python-flint shares: one thread at a time.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings | None = None,
        *,
        follower: type[Follower] = Follower,
        numbers: Numbers | None = None,
        structure: Structure | None = None,
        turn: tuple[fmpq, fmpq, fmpq] | None = None,
    ) -> None:
        """`follower`: another rule than the specification's; `numbers`, `structure`: instead of the scene's own.

        `turn` is added to the direction of every pixel's ray.
        """
        self.scene, self.settings = scene, settings or Settings()
        self.numbers = numbers or Numbers.exact(scene)
        self.structure = structure or Structure.of(self.numbers, scene.distinct, len(scene.lights))
        self.follower, self.turn = follower, turn
        self.forced: Mapping[Key, int] = {}
        self._tables: dict[int, Tables] = {}

    def direction(self, x: int, y: int) -> tuple[fmpq, fmpq, fmpq]:
        """The ray of a pixel, exactly: column x, row y."""
        view, of, sample = self.scene.view, self.numbers.of, self.settings.sample
        over, down = {"corner": (0, 0), "center": (1, 1), "bottom-left": (0, 2), "inclusive": (0, 0)}[sample]
        wide, high = view.columns, view.rows
        if sample == "inclusive":
            wide, high = max(wide - 1, 1), max(high - 1, 1)
        left, right, bottom, top = (of[f"view.{side}"] for side in ("left", "right", "bottom", "top"))
        across = left + (right - left) * fmpq(2 * x + over, 2 * wide)
        up = top - (top - bottom) * fmpq(2 * y + down, 2 * high)
        turn = self.turn or (fmpq(0),) * 3
        return across + turn[0], up + turn[1], turn[2] - of["view.near"]

    def pixel(self, x: int, y: int, *, forced: Mapping[Key, int] | None = None, ties: bool = True) -> Truth:
        """Every pass of column x, row y.

        `forced`: decisions to take otherwise, with the sign to take; `ties` False: without their outcomes.

        Raises:
            IndexError: there is no such pixel.
            UnprovedError: no precision was enough.
        """
        if not (0 <= x < self.scene.view.columns and 0 <= y < self.scene.view.rows):
            raise IndexError(f"there is no pixel {x} {y} in {self.scene.view.columns}x{self.scene.view.rows}")
        before = ctx.prec
        try:
            return self._prove(x, y, {**self.forced, **(forced or {})}, ties)
        finally:
            ctx.prec = before

    def raw(
        self, x: int, y: int, *, forced: Mapping[Key, int] | None = None, bits: int = 2 * BITS
    ) -> dict[str, tuple[Any, ...]]:
        """Every pass in balls of that many bits, however wide they come out."""
        before = ctx.prec
        try:
            return self._raw(self._follow(x, y, bits, {}, {**self.forced, **(forced or {})}, None))
        finally:
            ctx.prec = before

    def examine(
        self, x: int, y: int, *, forced: Mapping[Key, int] | None = None, bits: int = 2 * BITS
    ) -> tuple[list[Hit], dict[Key, arb]]:
        """The hits of a pixel with every sphere that hides a light, and every decision with its quantity: balls."""
        before = ctx.prec
        watch: dict[Key, arb] = {}
        try:
            return self._follow(x, y, bits, {}, {**self.forced, **(forced or {})}, watch).hits, watch
        finally:
            ctx.prec = before

    def signs(self, x: int, y: int, *, forced: Mapping[Key, int] | None = None) -> dict[Key, int]:
        """Every decision of a pixel with its sign, exactly."""
        before = ctx.prec
        watch: dict[Key, arb] = {}
        known: dict[Key, int] = {}
        taken = {**self.forced, **(forced or {})}
        try:
            self._follow(x, y, BITS, known, taken, watch)
            return {key: taken.get(key, known.get(key, _sign(value))) for key, value in watch.items()}
        finally:
            ctx.prec = before

    def with_numbers(self, numbers: Numbers, turn: tuple[fmpq, fmpq, fmpq] | None = None) -> Prover:
        """The same scene, by its structure, with other numbers; `turn` is added to that of every ray."""
        if self.turn is not None and turn is not None:
            turn = self.turn[0] + turn[0], self.turn[1] + turn[1], self.turn[2] + turn[2]
        other = Prover(
            self.scene,
            self.settings,
            follower=self.follower,
            numbers=numbers,
            structure=self.structure,
            turn=turn or self.turn,
        )
        other.forced = self.forced
        return other

    def forcing(self, forced: Mapping[Key, int]) -> Prover:
        """The same, with decisions that are taken otherwise: the sign to take."""
        other = self.with_numbers(self.numbers)
        other.forced = {**self.forced, **forced}
        return other

    def crossings(self, hit: Hit, light: int, sphere: int) -> tuple[arb, ...]:
        """Where the line from a hit that `examine` found to a light meets a sphere: t of both roots, or nothing.

        t is 0 at the hit and 1 at the light, exactly where the hit or the light lies on the sphere.
        """
        before = ctx.prec
        ctx.prec = 2 * BITS
        try:
            tables = self._at(ctx.prec)
            to_light = [a - b for a, b in zip(tables.light[light], hit.point, strict=True)]
            m = [a - b for a, b in zip(hit.point, tables.position[sphere], strict=True)]
            A = sum(w * d * d for w, d in zip(tables.w[sphere], to_light, strict=True))
            B = sum(w * a * d for w, a, d in zip(tables.w[sphere], m, to_light, strict=True))
            C = sum(w * a * a for w, a in zip(tables.w[sphere], m, strict=True)) - 1
            on = tables.side[sphere, light] == 0
            if sphere == hit.sphere:
                roots = (arb(0), arb(1) if on else -2 * B / A)
            elif on:
                roots = (arb(1), C / A)
            elif (D := B * B - A * C) < 0:
                return ()
            else:
                half = D.sqrt() if D > 0 else arb(0)
                roots = ((-B - half) / A, (-B + half) / A)
            return tuple(sorted(roots, key=lambda root: float(root.mid())))
        finally:
            ctx.prec = before

    def _prove(self, x: int, y: int, forced: Mapping[Key, int], with_ties: bool) -> Truth:
        known: dict[Key, int] = {}
        bits = BITS
        while True:
            path = self._follow(x, y, bits, known, forced, None)
            bits, values = path.bits, _balls(self._raw(path))
            if values is not None:
                break
            bits *= 2
            if bits > MOST_BITS:
                raise UnprovedError(f"pixel {x} {y}: {MOST_BITS} bits are not enough")
        ties = path.ties if with_ties else ()
        reported = tuple(self._tie(x, y, forced, key, values, key not in path.unproved) for key in ties)
        return Truth(x, y, path.hits[0].sphere if path.hits else -1, values, reported, bits)

    def _follow(
        self,
        x: int,
        y: int,
        bits: int,
        known: dict[Key, int],
        forced: Mapping[Key, int],
        watch: dict[Key, arb] | None,
    ) -> _Path:
        """Follow the ray in balls, at first with `bits` bits."""
        unproved: set[Key] = set()
        exact = False
        direction = self.direction(x, y)
        while True:
            ctx.prec = bits
            tables = self._at(bits)
            signs = _Signs(known, forced, watch)
            sign = signs.quick if watch is None and not forced else signs.careful
            epsilon = arb(rational(self.settings.shadow_epsilon))
            follower = self.follower(tables, sign, epsilon, self.settings.max_reflections)
            follower.every_blocker = watch is not None
            follower.hurries = watch is None and not forced
            try:
                hits = follower.follow(tuple(arb(entry) for entry in direction))  # type: ignore[arg-type]
                ties = tuple(key for key in dict.fromkeys(signs.ties) if key.what != "at" or key in unproved)
                return _Path(bits, follower, hits, ties, unproved)
            except UncertainError:
                if bits >= EXACT_FROM and not exact:
                    exact = True
                    unproved |= self._exactly(direction, known, forced, every_blocker=watch is not None)
                else:
                    # With exact signs known: a ball so wide that it led to a question which the path does not ask.
                    bits *= 2
                if bits > MOST_BITS:
                    raise UnprovedError(f"pixel {x} {y}: {MOST_BITS} bits are not enough") from None

    def _at(self, bits: int) -> Tables:
        """The scene in balls of that precision."""
        if bits not in self._tables:
            self._tables[bits] = self._make(arb)
        return self._tables[bits]

    def _make(self, lift: Callable[[fmpq], Any]) -> Tables:
        return Tables(self.numbers, self.structure, len(self.scene.spheres), len(self.scene.lights), lift)

    def _exactly(
        self, direction: Sequence[fmpq], known: dict[Key, int], forced: Mapping[Key, int], *, every_blocker: bool
    ) -> set[Key]:
        """Fill in the exact sign of every decision of a pixel. What cannot be had counts as 0, and is returned."""
        ctx.prec = 4 * EXACT_FROM
        tower = Tower()

        def lift(value: fmpq) -> Lazy:
            return Lazy.rational(tower, fmpq(value))

        unproved: set[Key] = set()

        def sign(value: Lazy, *names: Any) -> int:
            key = Key(*names)
            if key in forced:
                return forced[key]
            if key not in known:
                try:
                    known[key] = value.sign()
                except TooLargeError:
                    known[key] = 0
                    unproved.add(key)
            return known[key]

        epsilon = lift(rational(self.settings.shadow_epsilon))
        follower = self.follower(self._make(lift), sign, epsilon, self.settings.max_reflections)
        follower.shades, follower.every_blocker = False, every_blocker
        follower.hurries = not every_blocker and not forced
        follower.follow(tuple(lift(entry) for entry in direction))  # type: ignore[arg-type]
        return unproved

    def _raw(self, path: _Path) -> dict[str, tuple[Any, ...]]:
        """Every pass, in balls of whatever width."""
        hits, lights, bounces = path.hits, self.scene.lights, self.settings.max_reflections
        nothing: Vector = (0, 0, 0)
        raw: dict[str, Any] = {"ambient": nothing, "diffuse": nothing, "specular": nothing, "direct": nothing}
        raw |= {f"shadow.L{i}": (0,) for i in range(len(lights))}
        reflected: list[Vector | None] = [None] * bounces
        for hit in hits[1:]:
            color = path.follower.color(hit)
            reflected[hit.bounce - 1] = tuple(hit.weight * value for value in color)
        if (beyond := path.follower.beyond()) and path.follower.missed is not None:
            # As a rule that is not the specification's has it: nothing was hit, and something is seen.
            reflected[len(hits) - 1] = tuple(path.follower.missed * value for value in beyond)
        raw |= {f"reflection.{k + 1}": color or nothing for k, color in enumerate(reflected)}
        raw["reflection"] = add(*reflected)
        raw["beauty"] = self._at(path.bits).background
        raw["id"] = (hits[0].sphere if hits else -1,)
        if hits:
            hit = hits[0]
            raw["ambient"] = hit.ambient
            raw["diffuse"] = add(*(sight.diffuse for sight in hit.sights))
            raw["specular"] = add(*(sight.specular for sight in hit.sights))
            raw["direct"] = add(raw["diffuse"], raw["specular"])
            raw["beauty"] = add(hit.ambient, raw["direct"], raw["reflection"])
            for sight in hit.sights:
                raw[f"shadow.L{sight.light}"] = (0 if sight.blockers else 1,)
            dx, dy, dz = hit.direction
            raw["depth"] = (hit.t * (dx * dx + dy * dy + dz * dz).sqrt(),)
            raw["position"] = hit.point
            gx, gy, gz = hit.gradient
            inverse = (gx * gx + gy * gy + gz * gz).rsqrt()
            raw["normal"] = gx * inverse, gy * inverse, gz * inverse
        else:
            raw["depth"], raw["position"], raw["normal"] = (INFINITE,), nothing, nothing
        return raw

    def _tie(
        self,
        x: int,
        y: int,
        forced: Mapping[Key, int],
        key: Key,
        values: Mapping[str, tuple[Ball, ...]],
        proved: bool,
    ) -> Tie:
        def color(of: Mapping[str, tuple[Ball, ...]]) -> tuple[float, float, float]:
            red, green, blue = (ball.value for ball in of["beauty"])
            return red, green, blue

        # More than touching has two roots as near as one likes to the double one: the same value, but no ball has it.
        signs = (0, -1) if key.what == "meets" else (1, -1)
        others = []
        for sign in signs:
            # A way that leads nowhere is no outcome.
            with contextlib.suppress(UnprovedError):
                others.append(color(self._prove(x, y, {**forced, key: sign}, with_ties=False).values))
        settled = SETTLED[key.what] if proved and (key.what != "order" or key.bounce == 0) else ""
        return Tie(key, settled, tuple(dict.fromkeys([color(values), *others])), proved)


#: What the specification says about a quantity that is exactly 0. Of equal hits of a reflected ray it says nothing.
SETTLED = {
    "meets": "a ray that touches a sphere hits it",
    "ahead": "the double root lies where the ray begins to count, and does not count",
    "start": "a hit counts behind the start of the ray's range, not on it",
    "end": "a sphere that a light lies on does not hide it",
    "order": "of equal hits the sphere first in the file counts",
    "faces": "light gives nothing where N.L = 0",
    "shines": "there is no highlight where R.V = 0",
}


def _balls(raw: Mapping[str, tuple[Any, ...]]) -> dict[str, tuple[Ball, ...]] | None:
    """Every pass as a result, or None where a ball is too wide."""
    values: dict[str, tuple[Ball, ...]] = {}
    for name, channels in raw.items():
        found = []
        for channel in channels:
            ball = _ball(channel)
            if ball is None:
                return None
            found.append(ball)
        values[name] = tuple(found)
    return values


def _ball(value: Any) -> Ball | None:
    """As a result; None if it is too wide."""
    if isinstance(value, Ball):
        return value
    if isinstance(value, int):
        return Ball(value, 0, 0.0)
    radius = float(value.rad())
    if radius <= RADIUS or radius <= RADIUS * float(abs(value).lower()):
        return Ball.of(value)
    return None


# ---- many pixels


_prover: Prover | None = None


def _begin(scene: Scene, settings: Settings) -> None:
    global _prover
    # A parent that was killed does not tell them to end.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _prover = Prover(scene, settings)


def _work(pixels: Sequence[tuple[int, int]]) -> list[Truth]:
    assert _prover is not None
    return [_prover.pixel(x, y) for x, y in pixels]


def prove(
    scene: Scene,
    pixels: Sequence[tuple[int, int]],
    settings: Settings | None = None,
    *,
    jobs: int | None = None,
) -> Iterator[Truth]:
    """Prove pixels (column, row), in their order, with that many processes; None: one a processor."""
    settings = settings or Settings()
    jobs = jobs or os.cpu_count() or 1
    if jobs == 1 or len(pixels) <= FEW:
        prover = Prover(scene, settings)
        for x, y in pixels:
            yield prover.pixel(x, y)
        return
    size = max(1, min(FEW, math.ceil(len(pixels) / jobs / 4)))
    parts = [pixels[at : at + size] for at in range(0, len(pixels), size)]
    # Started afresh: a fork of a process in which Mitsuba has threads may hang.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(min(jobs, len(parts)), context, _begin, (scene, settings))
    try:
        with _deaf():
            # This starts them; what is blocked here stays so in them.
            results = pool.map(_work, parts)
        for found in results:
            yield from found
    except BaseException:
        # A pool that is interrupted while its workers start may wait for them for ever.
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _deaf() -> Iterator[None]:
    """Put Ctrl-C off: a terminal sends it to all processes, and a pool whose workers end by themselves may hang."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
