"""One pixel of a scene in mpmath, from the page of the specification alone: what `validation.truth` is checked against.

Naive on purpose, and unlike `validation.truth` in every way that matters. Points are world coordinates, an ellipsoid is
the unit sphere after an explicit division, its roots come from the quadratic formula, both at once, and a number is a
multiprecision float without an error bound. Exactness is replaced by digits: `digits` are left after what the spread
of the scene's own numbers can cost, and what is below 10^(15 - digits) of its scale counts as 0. What the
specification settles by structure is settled by structure: of the two roots of a ray on the sphere that it starts from,
the smaller one is the start, and on the surface that a light lies on, the one nearest to 1 is the light.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import mpmath

from tracer import Light, Scene, Sphere

#: mpmath has no types. A number, and a vector of three.
Number = Any
Vector = list[Number]


def dot(a: Vector, b: Vector) -> Number:
    """The dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: Vector, b: Vector) -> Vector:
    """The difference a - b."""
    return [p - q for p, q in zip(a, b, strict=True)]


def along(a: Vector, t: Number, b: Vector) -> Vector:
    """The point a + t b of a line."""
    return [p + t * q for p, q in zip(a, b, strict=True)]


@dataclass
class Hit:
    """Where a ray meets a sphere: its index, t, the point, and the normal that is shaded."""

    sphere: int
    t: Number
    x: Vector
    normal: Vector


@dataclass
class Local:
    """The terms at one hit, RGB each, and the visibility of every light."""

    ambient: Vector
    diffuse: Vector
    specular: Vector
    visible: list[int]


def spread(scene: Scene) -> int:
    """Powers of ten between the largest and the smallest number that a point can be measured with."""
    view = scene.view
    large = [view.near, view.left, view.right, view.bottom, view.top, *(c for p in scene.lights for c in p.position)]
    large += [c for s in scene.spheres for c in (*s.position, *s.scaling)]
    small = [c for s in scene.spheres for c in s.scaling] + [view.near]
    largest, smallest = max(abs(c) for c in large), min(abs(c) for c in small)
    return max(0, math.ceil(math.log10(largest) - math.log10(smallest)))


class Oracle:
    """A scene, the settings, and the precision."""

    def __init__(
        self, scene: Scene, *, sample: str, shadow_epsilon: float, max_reflections: int, digits: int = 60
    ) -> None:
        """Work out how many digits may be lost: lengths against sizes, once a bounce, and the exponent."""
        exponent = max([1.0, *(s.exponent for s in scene.spheres)])
        self.mp = mpmath.MPContext()
        self.mp.dps = digits + (3 + max_reflections) * spread(scene) + math.ceil(math.log10(exponent))
        self.tiny = self.mp.mpf(10) ** (15 - digits)
        self.scene = scene
        self.sample = sample
        self.epsilon = self.mp.mpf(shadow_epsilon)
        self.max_reflections = max_reflections
        # The first of two spheres in the same place is the one that exists.
        places = [(s.position, tuple(abs(c) for c in s.scaling)) for s in scene.spheres]
        self.existing = [i for i, place in enumerate(places) if place not in places[:i]]

    def vector(self, values: Sequence[float]) -> Vector:
        """Three float64 values, exactly."""
        return [self.mp.mpf(value) for value in values]

    def sign(self, value: Number, scale: Number) -> int:
        """-1, 0 or 1; 0 for what is tiny against the scale."""
        if abs(value) <= self.tiny * scale:
            return 0
        return 1 if value > 0 else -1

    def normalised(self, v: Vector) -> Vector:
        """The unit vector v / |v|."""
        length = self.mp.sqrt(dot(v, v))
        return [c / length for c in v]

    def ray(self, column: int, row: int) -> Vector:
        """The direction of a pixel's ray."""
        view, mpf = self.scene.view, self.mp.mpf
        columns, rows = mpf(view.columns), mpf(view.rows)
        ox, oy = {
            "corner": (mpf(0), mpf(0)),
            "center": (mpf(0.5), mpf(0.5)),
            "bottom-left": (mpf(0), mpf(1)),
            "top-right": (mpf(1), mpf(0)),
            "inclusive": (mpf(0), mpf(0)),
        }[self.sample]
        if self.sample == "inclusive":
            columns, rows = columns - 1, rows - 1
        left, right, bottom, top = self.vector([view.left, view.right, view.bottom, view.top])
        across = (column + ox) / columns if columns else mpf(0)
        down = (row + oy) / rows if rows else mpf(0)
        return [left + (right - left) * across, top - (top - bottom) * down, -mpf(view.near)]

    def roots(self, sphere: Sphere, origin: Vector, direction: Vector) -> tuple[list[Number], bool]:
        """Where a line meets a sphere: no t or two, sorted, and whether it touches."""
        p, s = self.vector(sphere.position), [abs(c) for c in self.vector(sphere.scaling)]
        u = [(o - c) / r for o, c, r in zip(origin, p, s, strict=True)]
        v = [d / r for d, r in zip(direction, s, strict=True)]
        a, b, c = dot(v, v), 2 * dot(u, v), dot(u, u) - 1
        discriminant = b * b - 4 * a * c
        side = self.sign(discriminant, b * b + 4 * a * (dot(u, u) + 1))
        if side < 0:
            return [], False
        if side == 0:
            return [-b / (2 * a)] * 2, True
        root = self.mp.sqrt(discriminant)
        return sorted([(-b - root) / (2 * a), (-b + root) / (2 * a)]), False

    def span(self, sphere: Sphere, origin: Vector, direction: Vector) -> Number:
        """What t's on this sphere are measured with: its distance and size, in lengths of the direction."""
        lengths = [*self.vector(sphere.position), *self.vector(sphere.scaling), *origin]
        return max(abs(c) for c in lengths) / self.mp.sqrt(dot(direction, direction))

    def meetings(
        self, j: int, origin: Vector, direction: Vector, start: int | None, light: Light | None = None
    ) -> tuple[list[Number], bool]:
        """The t's on sphere j, less the start on its own sphere and the light on its surface; whether it touches."""
        sphere = self.scene.spheres[j]
        found, touches = self.roots(sphere, origin, direction)
        if found and j == start:
            found.remove(min(found, key=abs))
        if found and light is not None and on_surface(sphere, light.position):
            found.remove(min(found, key=lambda t: abs(t - 1)))
        return found, touches

    def nearest(self, origin: Vector, direction: Vector, after: int, start: int | None) -> Hit | None:
        """The hit with the smallest t > after; of equal ones that of the first sphere in the file."""
        best: Hit | None = None
        for j in self.existing:
            sphere = self.scene.spheres[j]
            span = self.span(sphere, origin, direction)
            found, touches = self.meetings(j, origin, direction, start)
            beyond = [t for t in found if self.sign(t - after, span + after) > 0]
            if not beyond or (best and self.sign(beyond[0] - best.t, span + best.t) >= 0):
                continue
            x = along(origin, beyond[0], direction)
            best = Hit(j, beyond[0], x, self.normal(sphere, x, direction, touches))
        return best

    def normal(self, sphere: Sphere, x: Vector, direction: Vector, touches: bool) -> Vector:
        """(x - p) / s^2, normalised, turned against the ray unless that only touches."""
        p, s = self.vector(sphere.position), self.vector(sphere.scaling)
        outward = self.normalised([(c - q) / r**2 for c, q, r in zip(x, p, s, strict=True)])
        return [-c for c in outward] if dot(outward, direction) > 0 and not touches else outward

    def hidden(self, hit: Hit, to_light: Vector, light: Light) -> bool:
        """Whether a sphere has an intersection with epsilon < t < 1."""
        for j in self.existing:
            span = self.span(self.scene.spheres[j], hit.x, to_light)
            found, _ = self.meetings(j, hit.x, to_light, hit.sphere, light)
            for t in found:
                after = self.sign(t - self.epsilon, span + self.epsilon) > 0
                before = self.sign(t - 1, span + 1) < 0
                if after and before:
                    return True
        return False

    def illuminate(self, hit: Hit, direction: Vector) -> Local:
        """Ambient, diffuse and specular at a hit that is seen along a direction."""
        sphere = self.scene.spheres[hit.sphere]
        color, ambient = self.vector(sphere.color), self.vector(self.scene.ambient)
        ka, kd, ks, n = self.vector([sphere.ka, sphere.kd, sphere.ks, sphere.exponent])
        out = Local([ka * i * o for i, o in zip(ambient, color, strict=True)], [0 * ka] * 3, [0 * ka] * 3, [])
        viewer = self.normalised([-c for c in direction])
        for light in self.scene.lights:
            p = self.vector(light.position)
            to_light = minus(p, hit.x)
            size = max(abs(c) for c in [*p, *hit.x, *self.vector(sphere.scaling)])
            if all(self.sign(c, size) == 0 for c in to_light):
                # At x itself: visible, and adds nothing.
                out.visible.append(1)
                continue
            out.visible.append(0 if self.hidden(hit, to_light, light) else 1)
            L = self.normalised(to_light)
            NL = dot(hit.normal, L)
            R = along([-c for c in L], 2 * NL, hit.normal)
            RV = dot(R, viewer)
            if not out.visible[-1] or self.sign(NL, 1) <= 0:
                continue
            for k, intensity in enumerate(self.vector(light.intensity)):
                out.diffuse[k] += kd * intensity * NL * color[k]
                if self.sign(RV, 1) > 0:
                    out.specular[k] += ks * intensity * RV**n
        return out

    def pixel(self, column: int, row: int) -> dict[str, tuple[Number, ...]]:
        """Every pass: a tuple of one number or of three; `id` an int, depth inf and position 0 on a miss."""
        mpf = self.mp.mpf
        zero = [mpf(0)] * 3
        bounces = [f"reflection.{k}" for k in range(1, self.max_reflections + 1)]
        vectors = ("ambient", "diffuse", "specular", "direct", "reflection", "position", "normal", *bounces)
        values: dict[str, Sequence[Number]] = dict.fromkeys(vectors, zero)
        for i in range(len(self.scene.lights)):
            values[f"shadow.L{i}"] = [mpf(0)]
        values |= {"beauty": self.vector(self.scene.background), "depth": [self.mp.inf], "id": [-1]}

        direction = self.ray(column, row)
        hit = self.nearest(zero, direction, after=1, start=None)
        if hit is None:
            return {name: tuple(value) for name, value in values.items()}
        seen = self.illuminate(hit, direction)
        values |= {"ambient": seen.ambient, "diffuse": seen.diffuse, "specular": seen.specular}
        values |= {f"shadow.L{i}": [mpf(visible)] for i, visible in enumerate(seen.visible)}
        values |= {"position": hit.x, "normal": hit.normal, "id": [hit.sphere]}
        values["depth"] = [self.mp.sqrt(dot(hit.x, hit.x))]
        weight, reflection = mpf(1), zero
        for bounce in bounces:
            weight *= mpf(self.scene.spheres[hit.sphere].kr)
            if weight == 0:
                break
            direction = along(direction, -2 * dot(direction, hit.normal), hit.normal)
            hit = self.nearest(hit.x, direction, after=0, start=hit.sphere)
            if hit is None:
                break
            local = self.illuminate(hit, direction)
            terms = zip(local.ambient, local.diffuse, local.specular, strict=True)
            values[bounce] = [weight * sum(term) for term in terms]
            reflection = along(reflection, 1, list(values[bounce]))
        values["direct"] = along(seen.diffuse, 1, seen.specular)
        values["reflection"] = reflection
        values["beauty"] = [a + d + r for a, d, r in zip(seen.ambient, values["direct"], reflection, strict=True)]
        return {name: tuple(value) for name, value in values.items()}


def on_surface(sphere: Sphere, point: Sequence[float]) -> bool:
    """Whether |(point - p) / s| is exactly 1."""
    squares = [
        ((Fraction(c) - Fraction(p)) / Fraction(s)) ** 2
        for c, p, s in zip(point, sphere.position, sphere.scaling, strict=True)
    ]
    return sum(squares) == 1


def pixel(
    scene: Scene,
    column: int,
    row: int,
    *,
    sample: str = "corner",
    shadow_epsilon: float = 1e-4,
    max_reflections: int = 3,
    digits: int = 60,
) -> dict[str, tuple[Number, ...]]:
    """Every pass of one pixel, as `Oracle.pixel` has it."""
    oracle = Oracle(scene, sample=sample, shadow_epsilon=shadow_epsilon, max_reflections=max_reflections, digits=digits)
    return oracle.pixel(column, row)
