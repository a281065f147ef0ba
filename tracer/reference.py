"""The renderer in NumPy, in float32 or float64: the specification in the order in which it is written.

Everything works on arrays of rays. A vector is an array of shape (3, rays); `pick(table, index)` is the column of a
table for each ray. In the unit space of a sphere, (x - p) / |s|, the sphere is the unit sphere and a point of it is its
own outward gradient. A ray starts on a sphere, or in the eye, which stands as the last row (index -1) in the tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracer.passes import MARGINS, OFFSETS, SAMPLES, Passes, Precision, Sample, lookup, names

if TYPE_CHECKING:
    from tracer import Scene, View

Real = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]
Index = NDArray[np.intp]

# A discriminant as little below 0 as this many roundings can bring it counts as 0, and so does f at the image plane.
# docs/tolerances.md derives both.
TANGENT = 16
# Beyond this f has lost its digits.
WIDEST = 0.5
# Rays traced at a time: the arrays of one band stay in the cache.
BAND = 1 << 15


def dot(a: Real, b: Real) -> Real:
    """The dot product of each pair of vectors."""
    product: Real = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def unit(v: Real) -> tuple[Real, Real]:
    """Unit vectors v / |v| and lengths |v|, without overflow or underflow on the way; nan for a zero vector."""
    largest = np.maximum(np.maximum(np.abs(v[0]), np.abs(v[1])), np.abs(v[2]))
    scaled = v / largest
    length = np.sqrt(dot(scaled, scaled))
    return scaled / length, largest * length


def pick(table: Real, index: Index) -> Real:
    """The column of a table for each ray."""
    return np.take(table, index, axis=-1, mode="wrap")


def light_sides(light: Real, position: Real, scaling: Real) -> NDArray[np.int8]:
    """The signs of |(p - p_j) / s_j|^2 - 1: in float64 where that is certain, else in fractions; a row a sphere."""
    place = (light[:, None, :] - position[:, :, None]) / scaling[:, :, None]
    squared = (place**2).sum(axis=0)
    sides: NDArray[np.int8] = np.sign(squared - 1).astype(np.int8)
    # Each of the squares is off by 5 roundings at most, and each of the sums by one.
    for j, i in np.argwhere(np.abs(squared - 1) <= 2.0**-50 * (1 + squared)):
        columns = zip(light[:, i].tolist(), position[:, j].tolist(), scaling[:, j].tolist(), strict=True)
        form = sum(((Fraction(p) - Fraction(c)) / Fraction(s)) ** 2 for p, c, s in columns)
        sides[j, i] = (form > 1) - (form < 1)
    return sides


class Tables:
    """The numbers of a scene in the precision of the rendering. Differences of positions are taken in float64."""

    def __init__(self, scene: Scene, real: type[np.floating[Any]]) -> None:
        def column(rows: Sequence[Any]) -> Real:
            return np.array(rows, dtype=np.float64).reshape(len(rows), -1 if rows else 3).T.astype(real)

        spheres, lights = scene.spheres, scene.lights
        position = np.array([s.position for s in spheres], dtype=np.float64).reshape(-1, 3).T
        start = np.append(position, np.zeros((3, 1)), axis=1)
        light = np.array([p.position for p in lights], dtype=np.float64).reshape(-1, 3).T
        scaling = np.abs(np.array([s.scaling for s in spheres], dtype=np.float64).reshape(-1, 3).T)

        self.real = real
        self.distinct = tuple(scene.distinct)
        self.lights = len(lights)
        self.scaling = scaling.astype(real)
        # between[j]: from the centre of sphere j to each start; toward[i]: from each start to light i.
        self.between = [(start - position[:, j : j + 1]).astype(real) for j in range(len(spheres))]
        self.toward = [(light[:, i : i + 1] - start).astype(real) for i in range(len(lights))]
        # On which side of each surface each light is, exactly: -1 inside, 0 on it, 1 outside. Row: sphere.
        self.light_side = light_sides(light, position, scaling)

        # Spheres that reach the image plane (|y_z| = 1.25 is beyond f = WIDEST), and their part of f's rounding bound.
        view = scene.view
        corner = np.array([[view.left], [view.top], [0.0]])
        reach = (np.abs(position) + 0.375 * np.abs(corner)) / scaling
        on_plane = np.abs(view.near + position[2]) <= 1.25 * scaling[2]
        self.plane = {j: reach[:, j : j + 1].astype(real) for j in self.distinct if on_plane[j]}

        self.color = column([s.color for s in spheres])
        self.ka, self.kd, self.ks, self.kr, self.exponent = (
            np.array([getattr(s, name) for s in spheres], dtype=np.float64).astype(real)
            for name in ("ka", "kd", "ks", "kr", "exponent")
        )
        self.intensity = column([p.intensity for p in lights])
        self.ambient = column([scene.ambient])
        self.background = column([scene.background])


@dataclass
class Rays:
    """Rays that start on spheres, or in the eye."""

    pixel: Index  # which pixel of the band a ray belongs to
    start: Index  # the sphere it starts on, -1: the eye
    point: Real  # where, in that sphere's unit space
    offset: Real  # where, from that sphere's centre, in world units
    inside: Flags  # whether it starts into that sphere
    direction: Real
    weight: Real  # product of the Kr's on the way here

    def __getitem__(self, chosen: Flags | Index) -> Rays:
        return Rays(*(getattr(self, field)[..., chosen] for field in self.__dataclass_fields__))


@dataclass
class Hits:
    """The nearest hit of each ray; sphere -1 where there is none."""

    sphere: Index
    t: Real
    inside: Flags  # hit on the way out of the sphere: the inside is what is seen
    point: Real  # in the sphere's unit space

    def __getitem__(self, chosen: Flags | Index) -> Hits:
        return Hits(*(getattr(self, field)[..., chosen] for field in self.__dataclass_fields__))


@dataclass
class Chord:
    """What a line and the unit sphere have in common. t counts in lengths of the line's direction."""

    meets: Flags
    near: Real
    far: Real
    height: Real  # where on its axis the line is closest to the centre
    axis: Real  # the line's unit direction
    speed: Real  # length of its direction
    middle: Real  # its point closest to the centre
    discriminant: Real  # 1 - |middle|^2
    half: Real  # half the length of the chord

    def at(self, far: Flags, chosen: Index) -> Real:
        """The unit-space point of the far or the near root."""
        half = np.where(far, self.half, -self.half)[chosen]
        return self.middle[:, chosen] + half * self.axis[:, chosen]


def chord(origin: Real, direction: Real) -> Chord:
    """Line and unit sphere: roots that keep their digits, tangents that touch exactly."""
    axis, speed = unit(direction)
    height = -dot(origin, axis)
    middle = origin + height * axis
    discriminant = 1 - dot(middle, middle)
    unit_roundoff = np.finfo(height.dtype).eps / 2
    bound = TANGENT * unit_roundoff * (1 + dot(np.abs(middle), np.abs(origin) + np.abs(height * axis)))
    half = np.sqrt(np.maximum(discriminant, 0))
    # (t speed)^2 - 2 height (t speed) + c = 0: the larger root by addition, the other from their product c.
    larger = height + np.copysign(half, height)
    smaller = (dot(origin, origin) - 1) / larger
    ahead = larger > 0
    near, far = np.where(ahead, smaller, larger) / speed, np.where(ahead, larger, smaller) / speed
    return Chord(discriminant >= -bound, near, far, height, axis, speed, middle, discriminant, half)


def settle_plane(line: Chord, origin: Real, direction: Real, plane: Real) -> None:
    """A root of f = |y|^2 - 1 within its rounding bound of the image plane, t = 1, is 1.

    It is the near root where the ray runs inwards at its point y = origin + direction, y.d < 0, else the far one.
    """
    y = origin + direction
    size, reach = np.abs(y), np.abs(direction) + plane
    roundings = TANGENT * np.finfo(y.dtype).eps / 2
    on = np.abs(dot(y, y) - 1) <= np.minimum(roundings * (1 + dot(size, reach)), WIDEST)
    inwards = dot(y, direction) < -roundings * dot(size + np.abs(direction), reach)
    line.near[on] = 1
    line.far[on & ~inwards] = 1


def other_root(point: Real, direction: Real) -> Real:
    """Where a ray that starts at a point of the unit sphere meets it again: its roots are 0 and this one."""
    return -2 * dot(point, direction) / dot(direction, direction)


def to_unit_space(tables: Tables, rays: Rays, direction: Real, j: int) -> tuple[Real, Real]:
    """Start and direction in the unit space of sphere j."""
    scaling = tables.scaling[:, j : j + 1]
    return (pick(tables.between[j], rays.start) + rays.offset) / scaling, direction / scaling


def nearest(tables: Tables, rays: Rays, after: float) -> Hits:
    """The smallest t > after of each ray; of equal ones that of the sphere that is first in the file.

    `after` is 1, the image plane, for primary rays, and 0 for reflected ones.
    """
    count = rays.start.size
    best = Hits(
        np.full(count, -1), np.full(count, np.inf, tables.real), np.zeros(count, bool), np.zeros_like(rays.direction)
    )
    for j in tables.distinct:
        origin, direction = to_unit_space(tables, rays, rays.direction, j)
        line = chord(origin, direction)
        if after == 1 and j in tables.plane:
            settle_plane(line, origin, direction, tables.plane[j])
        far = ~(line.near > after)
        t = np.where(far, line.far, line.near)
        candidate = np.flatnonzero(line.meets & (t > after) & (t < best.t) & (rays.start != j))
        keep(best, candidate, j, t[candidate], far[candidate], line.at(far, candidate))

        # On its own sphere a ray has one other root, and meets it if it runs inside.
        own = np.flatnonzero((rays.start == j) & rays.inside)
        if own.size:
            t = other_root(rays.point[:, own], direction[:, own])
            closer = (t > after) & (t < best.t[own])
            point = rays.point[:, own] + t * direction[:, own]
            keep(best, own[closer], j, t[closer], np.True_, point[:, closer])
    return best


def keep(best: Hits, where: Index, j: int, t: Real, inside: Any, point: Real) -> None:
    """Write nearer hits over the best so far."""
    best.sphere[where] = j
    best.t[where] = t
    best.inside[where] = inside
    best.point[:, where] = point


def hidden(tables: Tables, x: Rays, to_light: Real, light: int, epsilon: float) -> Flags:
    """Whether a sphere meets x + t to_light with epsilon < t < 1."""
    found = np.zeros(x.start.size, bool)
    for j in tables.distinct:
        origin, direction = to_unit_space(tables, x, to_light, j)
        own = x.start == j
        side, end = tables.light_side[j, light], tables.toward[light][:, j : j + 1] / tables.scaling[:, j : j + 1]
        blocks = hides(origin, direction, end, side, epsilon)
        found |= np.where(own, own_hides(x.point, direction, side, epsilon), blocks)
    return found


def hides(origin: Real, direction: Real, end: Real, side: int, epsilon: float) -> Flags:
    """Whether the unit sphere has a root epsilon < t < 1 on lines to a light at t = 1, at `end`, on that side of it.

    As the side is known, no root is held against 1, where rounding could take it to the wrong side of the light.
    """
    if side == 0:
        # The roots are 1, which does not hide, and the other one, by their product.
        t = (dot(origin, origin) - 1) / dot(direction, direction)
        between: Flags = (t > epsilon) & (t < 1)
        return between
    line = chord(origin, direction)
    if side < 0:
        # The way to a light inside enters, unless it starts inside.
        enters: Flags = line.near > epsilon
        return enters
    # Both roots are before a light outside where the line comes to it going away from the centre, else both behind it.
    passes: Flags = line.meets & (line.far > epsilon) & (dot(end, direction) > 0)
    return passes


def own_hides(point: Real, direction: Real, side: int, epsilon: float) -> Flags:
    """The same of the sphere that the lines start on, whose other root is before every light outside."""
    meets: Flags = (other_root(point, direction) > epsilon) & (side > 0)
    return meets


@dataclass
class Surface:
    """The hit points of rays: each the start of the reflected ray, with its normal and the direction to the viewer."""

    x: Rays  # direction: that of the reflected ray; weight: with this sphere's Kr
    normal: Real
    viewer: Real
    weight: Real  # before this sphere's Kr
    t: Real

    def __getitem__(self, chosen: Flags | Index) -> Surface:
        return Surface(self.x[chosen], *(v[..., chosen] for v in (self.normal, self.viewer, self.weight, self.t)))


def surface(tables: Tables, rays: Rays, hits: Hits) -> Surface:
    """Hit points, normals that face the ray's start, and reflected rays."""
    i = hits.sphere
    scaling = pick(tables.scaling, i)
    outward, _ = unit(hits.point / scaling)
    normal = np.where(hits.inside, -outward, outward)
    viewer, _ = unit(-rays.direction)
    reflected = rays.direction - 2 * dot(rays.direction, normal) * normal
    weight = rays.weight * pick(tables.kr, i)
    x = Rays(rays.pixel, i, hits.point, scaling * hits.point, hits.inside, reflected, weight)
    return Surface(x, normal, viewer, rays.weight, hits.t)


@dataclass
class Light:
    """One light seen from hit points."""

    to_light: Real  # p - x
    L: Real
    NL: Real
    RV: Real


def incidence(tables: Tables, at: Surface, light: int) -> Light:
    """L, N.L and R.V; nan for a light at x itself, which no comparison lets through."""
    to_light = pick(tables.toward[light], at.x.start) - at.x.offset
    L, _ = unit(to_light)
    NL = dot(at.normal, L)
    R = 2 * NL * at.normal - L
    return Light(to_light, L, NL, dot(R, at.viewer))


def illuminate(
    tables: Tables, at: Surface, epsilon: float, *, every_shadow: bool
) -> tuple[Real, Real, Real, list[Real]]:
    """Ambient, diffuse and specular term of each hit, and the visibility of each light where it was asked for."""
    i = at.x.start
    ambient = pick(tables.ka, i) * tables.ambient * pick(tables.color, i)
    diffuse, specular = np.zeros_like(ambient), np.zeros_like(ambient)
    shadows = []
    for light in range(tables.lights):
        seen = incidence(tables, at, light)
        asked = np.arange(i.size) if every_shadow else np.flatnonzero(seen.NL > 0)
        visible = np.zeros(i.size, bool)
        visible[asked] = ~hidden(tables, at.x[asked], seen.to_light[:, asked], light, epsilon)
        shadows.append(visible.astype(tables.real))

        lit = visible & (seen.NL > 0)
        shines = lit & (seen.RV > 0)
        intensity = tables.intensity[:, light : light + 1]
        power = np.power(np.where(shines, seen.RV, 1), pick(tables.exponent, i))
        diffuse += np.where(lit, pick(tables.kd, i) * intensity * seen.NL * pick(tables.color, i), 0)
        specular += np.where(shines, pick(tables.ks, i) * intensity * power, 0)
    return ambient, diffuse, specular, shadows


def eye_rays(tables: Tables, view: View, sample: Sample, rows: range) -> Rays:
    """The primary rays of a band of rows. The grid is laid out in float64, like every other set-up."""
    offset_x, offset_y = OFFSETS[sample]
    inclusive = sample == "inclusive"
    wide = max(view.columns - 1, 1) if inclusive else view.columns
    high = max(view.rows - 1, 1) if inclusive else view.rows
    x = view.left + (view.right - view.left) * (np.arange(view.columns) + offset_x) / wide
    y = view.top - (view.top - view.bottom) * (np.arange(rows.start, rows.stop) + offset_y) / high
    count = x.size * y.size
    direction = np.empty((3, y.size, x.size), tables.real)
    direction[0], direction[1], direction[2] = x, y[:, None], -view.near
    zero = np.zeros((3, count), tables.real)
    weight = np.ones(count, tables.real)
    return Rays(
        np.arange(count), np.full(count, -1), zero, zero, np.zeros(count, bool), direction.reshape(3, -1), weight
    )


def trace(tables: Tables, rays: Rays, max_reflections: int) -> Iterator[tuple[Rays, Hits, Surface]]:
    """The chain of mirrors: of each bounce, from 0, the rays, their nearest hits, and the surface where they hit."""
    for bounce in range(max_reflections + 1):
        # The near plane, t = 1, limits primary rays only.
        hits = nearest(tables, rays, after=1 if bounce == 0 else 0)
        hit = np.flatnonzero(hits.sphere >= 0)
        at = surface(tables, rays[hit], hits[hit])
        yield rays, hits, at
        rays = at.x[np.flatnonzero(pick(tables.kr, at.x.start) > 0)] if hit.size else at.x
        if not rays.start.size:
            return


def bands(view: View, rays: int = BAND) -> Iterator[range]:
    """The rows of the image, a few at a time."""
    step = max(1, rays // view.columns)
    for row in range(0, view.rows, step):
        yield range(row, min(row + step, view.rows))


def render(
    scene: Scene,
    passes: Sequence[str] = ("beauty",),
    *,
    precision: Precision = "f64",
    sample: Sample = "corner",
    shadow_epsilon: float = 1e-4,
    max_reflections: int = 3,
) -> Passes:
    """Render the passes asked for, margins included.

    Raises:
        ValueError: an unknown pass, precision or sample, or a pass of a light or bounce that there is not.
    """
    check(scene, passes, precision, sample, shadow_epsilon, max_reflections)
    real: type[np.floating[Any]] = np.float32 if precision == "f32" else np.float64
    with np.errstate(all="ignore"):
        tables = Tables(scene, real)
        parts = [
            render_band(tables, eye_rays(tables, scene.view, sample, rows), shadow_epsilon, max_reflections)
            for rows in bands(scene.view)
        ]
    shape = (scene.view.rows, scene.view.columns)
    images: dict[str, NDArray[Any]] = {}
    for name in passes:
        if name.startswith("margin."):
            continue
        if name not in parts[0]:  # a bounce that is not traced
            images[name] = np.zeros((*shape, 3), real)
            continue
        whole = np.concatenate([part[name] for part in parts], axis=-1)
        images[name] = np.ascontiguousarray(whole.T).reshape(*shape, *whole.shape[:-1])
    if len(images) < len(set(passes)):
        from tracer.margins import analyse

        found = analyse(scene, sample=sample, shadow_epsilon=shadow_epsilon, max_reflections=max_reflections)
        images |= {f"margin.{kind}": found.margins[kind].astype(real) for kind in MARGINS}
    settings = {"sample": sample, "shadow_epsilon": repr(shadow_epsilon), "max_reflections": str(max_reflections)}
    return Passes({name: images[name] for name in passes}, {"renderer": f"numpy-{precision}"} | settings)


def render_band(tables: Tables, rays: Rays, epsilon: float, max_reflections: int) -> dict[str, NDArray[Any]]:
    """Every pass of a band of pixels, channels first."""
    count = rays.pixel.size
    zero = np.zeros((3, count), tables.real)
    image: dict[str, NDArray[Any]] = {
        name: np.zeros(count, tables.real) if not lookup(name).channels else zero.copy()
        for name in names(tables.lights, max_reflections, margins=False)
    }
    for bounce, (bounce_rays, hits, at) in enumerate(trace(tables, rays, max_reflections)):
        pixel = at.x.pixel
        ambient, diffuse, specular, shadows = illuminate(tables, at, epsilon, every_shadow=bounce == 0)
        if bounce > 0:
            image[f"reflection.{bounce}"][:, pixel] = (ambient + (diffuse + specular)) * at.weight
            continue
        image["id"] = hits.sphere.astype(np.int32)
        image["ambient"][:, pixel], image["diffuse"][:, pixel], image["specular"][:, pixel] = ambient, diffuse, specular
        for light, shadow in enumerate(shadows):
            image[f"shadow.L{light}"][pixel] = shadow
        _, length = unit(bounce_rays.direction)
        image["depth"] = hits.t * length
        image["position"][:, pixel] = at.t * bounce_rays.direction[:, pixel]
        image["normal"][:, pixel] = at.normal
    image["direct"] = image["diffuse"] + image["specular"]
    for bounce in range(1, max_reflections + 1):
        image["reflection"] = image["reflection"] + image[f"reflection.{bounce}"]
    seen = (image["ambient"] + image["direct"]) + image["reflection"]
    image["beauty"] = np.where(image["id"] >= 0, seen, tables.background)
    return image


def check(
    scene: Scene, passes: Sequence[str], precision: str, sample: str, shadow_epsilon: float, max_reflections: int
) -> None:
    """Refuse what cannot be rendered, in one sentence."""
    if precision not in ("f32", "f64"):
        raise ValueError(f"unknown precision '{precision}': expected f32 or f64")
    if sample not in SAMPLES:
        raise ValueError(f"unknown sample '{sample}': expected one of {', '.join(SAMPLES)}")
    if not 0 <= shadow_epsilon < 1:
        raise ValueError(f"shadow_epsilon is {shadow_epsilon}: expected a number from 0 to below 1")
    if max_reflections < 0:
        raise ValueError(f"max_reflections is {max_reflections}: expected 0 or more")
    for name in passes:
        quantity, lights = lookup(name).quantity, len(scene.lights)
        if quantity == "visibility" and name not in names(lights):
            raise ValueError(f"pass '{name}' asks for a light that is not there: the scene has {lights}, from 0")
