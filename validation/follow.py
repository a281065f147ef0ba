"""Follows a pixel's ray by the letter of the specification, in any arithmetic that tells the signs of its numbers.

Every decision of a pixel (does the ray meet this sphere, which hit is nearer, is the light hidden, does it face the
surface) is the sign of a polynomial in the scene's numbers and in roots of discriminants. What is 0 by structure is
never computed: the root at which a secondary ray starts, the root t = 1 of a light that lies on a surface, spheres that
are the same.

A sphere is the quadratic form f(v) = sum w_k v_k^2 - 1 about its centre, w = 1 / s^2. On a ray m + t d (m from the
centre) f = A t^2 + 2 B t + C, with A = sum w d^2, B = sum w m d, C = f(m), and D = B^2 - A C a quarter of the
discriminant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from flint import fmpq

if TYPE_CHECKING:
    from tracer import Scene

Vector: TypeAlias = tuple[Any, Any, Any]


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
    side    the light is outside the sphere: as it is seen from a hit, for rounding is another one at each
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
    "side": "range",
    "order": "order",
    "faces": "terminator",
    "shines": "terminator",
}

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
        forms = {(j, i): _light_side(numbers, j, i) for j in self.distinct for i in range(lights)}
        self.side = {key: 0 if key in structure.light_on else sign_of(form) for key, form in forms.items()}
        # The same as numbers, where whoever asks may take a light to the other side.
        self.sided = {key: lift(form) for key, form in forms.items()}
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


def sign_of(value: Any) -> int:
    """-1, 0 or 1."""
    return int(value > 0) - int(value < 0)


# ---- one pixel


@dataclass
class Sight:
    """One light seen from a hit."""

    light: int
    faces: int  # sign of N.L
    blockers: tuple[int, ...]  # spheres that hide it; at most one unless all were asked for
    asked: bool  # whether the shadow was asked for
    cosine: Any = 0  # N.L where a term of it is wanted
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
        if side and not self.hurries:
            side = sign(tables.sided[j, i], "side", bounce, i, j)
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
        if self.shades:
            lx, ly, lz = to_light
            sight.cosine = gl * (gg * (lx * lx + ly * ly + lz * lz)).rsqrt()
            if diffuse is not None:
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
