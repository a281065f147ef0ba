"""Random scenes that are hard to draw: each has a theme, and follows from a seed and its index alone."""

from __future__ import annotations

import math
import random
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import tracer
from tracer import Light, Scene, Sphere, View

Vec3 = tuple[float, float, float]
Value = TypeVar("Value")

#: Columns and rows: small, so that a scene is drawn, analysed and judged in about a second.
SIZES = ((32, 24), (24, 32), (40, 30), (48, 36), (48, 48), (64, 48), (64, 64), (33, 31))
#: Ordinary and special exponents; n < 1 makes highlights steep where R.V is 0.
EXPONENTS = (0.0, 0.5, 1.0, 1.5, 2.0, 5.0, 7.3, 30.0, 99.5, 200.0, 1000.0)
#: Sizes of flat and long ellipsoids beside their other radii.
FLAT = (0.01, 0.02, 0.05, 0.1)
#: As the scene format limits spheres and lights.
MOST = 5


@dataclass(frozen=True)
class Drawn:
    """A random scene, and what it was made of."""

    scene: Scene
    theme: str
    twists: tuple[str, ...]


class Dice:
    """Random numbers of one scene, some of them round, so that exact ties happen, others of all digits."""

    def __init__(self, seed: int, index: int) -> None:
        """The same for ever: Python keeps its generator and the hash of texts."""
        self.random = random.Random(f"{seed} {index}")
        self.roundness = self.random.choice((0.0, 0.3, 0.7, 1.0))

    def chance(self, share: float) -> bool:
        """True in that share of all calls."""
        return self.random.random() < share

    def whole(self, least: int, most: int) -> int:
        """Both ends count."""
        return self.random.randint(least, most)

    def one(self, values: tuple[Value, ...]) -> Value:
        """Any of them."""
        return self.random.choice(values)

    def number(self, low: float, high: float) -> float:
        """Between the two."""
        value = self.random.uniform(low, high)
        if not self.chance(self.roundness):
            return value
        step = self.random.choice((1.0, 0.5, 0.25, 0.1))
        rounded = round(round(value / step) * step, 10)
        if not low <= rounded <= high or (rounded == 0 and not low <= 0 <= high):
            rounded = float(f"{value:.2g}")
        return rounded if low <= rounded <= high else value

    def share(self) -> float:
        """A number in [0, 1], often an end."""
        return self.random.choice((0.0, 1.0, 0.5, self.random.random(), round(self.random.random(), 1)))

    def vector(self, size: float) -> Vec3:
        """Components up to that size."""
        return self.number(-size, size), self.number(-size, size), self.number(-size, size)

    def direction(self) -> Vec3:
        """A unit vector: along an axis, rational, or any."""
        if self.chance(0.4):
            axis, sign = self.whole(0, 2), self.one((-1.0, 1.0))
            return (sign * (axis == 0), sign * (axis == 1), sign * (axis == 2))
        if self.chance(0.3):
            a, b = self.one(((0.6, 0.8), (0.28, 0.96), (0.8, -0.6)))
            return self.one(((a, b, 0.0), (0.0, a, b), (b, 0.0, a)))
        x, y, z = (self.random.gauss(0, 1) for _ in range(3))
        length = math.sqrt(x * x + y * y + z * z) or 1.0
        return x / length, y / length, z / length


@dataclass
class Stage:
    """A scene in the making."""

    dice: Dice
    view: View
    spheres: list[Sphere] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)

    def point(self, low: float, high: float, spread: float = 1.0) -> Vec3:
        """Within the frustum, that many near planes away; `spread`: of its width."""
        dice, view = self.dice, self.view
        depth = dice.number(low, high)
        u, v = (0.5 + spread * (dice.random.random() - 0.5) for _ in range(2))
        x, y = view.left + (view.right - view.left) * u, view.bottom + (view.top - view.bottom) * v
        place = x * depth, y * depth, -depth * view.near
        if dice.chance(dice.roundness):
            place = tuple(round(value * 4) / 4 for value in place)  # type: ignore[assignment]
        return place

    @property
    def width(self) -> float:
        """Half of the window's larger side at a distance of one near plane."""
        return max(self.view.right - self.view.left, self.view.top - self.view.bottom) / 2

    def sphere(self, position: Vec3, scaling: Vec3 | float) -> Sphere:
        """One with a random material."""
        dice = self.dice
        sizes = scaling if isinstance(scaling, tuple) else (scaling, scaling, scaling)
        made = Sphere(
            name=f"s{len(self.spheres)}",
            position=position,
            scaling=tuple(max(abs(size), 1e-3) for size in sizes),
            color=(dice.share(), dice.share(), dice.share()),
            ka=dice.share(),
            kd=dice.share(),
            ks=dice.share(),
            kr=dice.one((0.0, 0.0, dice.share())),
            exponent=dice.one((*EXPONENTS, dice.random.uniform(0, 1), dice.random.uniform(1, 300))),
        )
        self.spheres.append(made)
        return made

    def light(self, position: Vec3) -> None:
        """One with a random colour."""
        color = self.dice.one(((1.0, 1.0, 1.0), (self.dice.share(), self.dice.share(), self.dice.share())))
        self.lights.append(Light(name=f"l{len(self.lights)}", position=position, intensity=color))

    def sizes(self, size: float) -> Vec3:
        """Radii of about that size: round or not."""
        dice = self.dice
        if dice.chance(0.5):
            return size, size, size
        x, y, z = (size * dice.number(0.3, 1.5) for _ in range(3))
        return x, y, z

    def lit(self, least: int = 0) -> None:
        """Lights anywhere."""
        for _ in range(max(least, self.dice.whole(0, 3)) - len(self.lights)):
            reach = self.dice.one((4.0, 10.0, 100.0)) * self.view.near
            self.light(self.dice.vector(reach))


# ---- themes


def apart(stage: Stage) -> None:
    """Ellipsoids anywhere in sight."""
    for _ in range(stage.dice.whole(1, 5)):
        depth = stage.dice.number(2, 10)
        size = stage.dice.number(0.1, 0.6) * stage.width * depth
        stage.sphere(stage.point(depth, depth), stage.sizes(size))


def cut(stage: Stage) -> None:
    """Spheres that the near plane cuts, some of which it touches exactly, with lights in them and before it."""
    dice, near = stage.dice, stage.view.near
    for _ in range(dice.whole(1, 4)):
        radius = dice.number(0.3, 2) * max(near, stage.width)
        x, y, z = stage.point(1, 1)
        offset = dice.one((0.0, radius, -radius, dice.number(-1, 1) * radius))
        stage.sphere((x, y, z - offset), stage.sizes(radius))
    stage.light((0.0, 0.0, 0.0))
    if dice.chance(0.7):
        stage.light(stage.point(0.3, 2))


def nested(stage: Stage) -> None:
    """Shells in shells, with lights between them."""
    dice = stage.dice
    place, size = stage.point(3, 8, 0.5), dice.number(0.5, 4) * stage.width
    around = stage.sizes(size)
    for _ in range(dice.whole(2, 5)):
        stage.sphere(place, around)
        factor = dice.one((0.5, 0.9, 0.99, dice.number(0.3, 0.95)))
        around = around[0] * factor, around[1] * factor, around[2] * factor
        if dice.chance(0.4):
            place = place[0] + (1 - factor) * size * 0.3, place[1], place[2]
        if dice.chance(0.6) and len(stage.lights) < MOST:
            stage.light(on(stage.spheres[-1], dice.direction(), dice.one((0.0, 0.5, 0.95, 0.999))))


def crossing(stage: Stage) -> None:
    """Spheres that cross each other, mirrors among them."""
    dice = stage.dice
    place, size = stage.point(2, 6, 0.6), dice.number(0.4, 2) * stage.width
    for _ in range(dice.whole(2, 5)):
        step = dice.vector(1.0)
        center = place[0] + step[0] * size, place[1] + step[1] * size, place[2] + step[2] * size
        stage.sphere(center, stage.sizes(size * dice.one((1.0, 1.0, dice.number(0.5, 1.5)))))


def touching(stage: Stage) -> None:
    """Spheres that touch exactly, outside or inside, with lights where they touch."""
    dice = stage.dice
    place = dice.whole(-2, 2) / 2, dice.whole(-2, 2) / 2, -float(dice.whole(3, 8))
    size = dice.one((0.5, 1.0, 1.5))
    stage.sphere(place, size)
    for _ in range(dice.whole(1, 3)):
        first, other = dice.one(tuple(stage.spheres)), dice.one((0.25, 0.5, 1.0, 2.0))
        direction, inner = dice.direction(), dice.chance(0.25)
        radius = first.scaling[0]
        gap = radius - other if inner else radius + other
        x, y, z = (p + gap * d for p, d in zip(first.position, direction, strict=True))
        stage.sphere((x, y, z), other)
        if dice.chance(0.4) and len(stage.lights) < MOST:
            stage.light(on(first, direction, 1.0))


def inside(stage: Stage) -> None:
    """The eye inside one or two ellipsoids, others and lights in there with it."""
    dice = stage.dice
    room = dice.number(3, 10) * max(stage.view.near, stage.width)
    stage.sphere(dice.vector(0.3 * room), stage.sizes(room))
    if dice.chance(0.3):
        stage.sphere(dice.vector(0.3 * room), stage.sizes(room * dice.number(1, 2)))
    for _ in range(dice.whole(0, 3)):
        stage.sphere(stage.point(1.5, 5, 0.8), stage.sizes(0.2 * room * dice.random.random() + 0.02))
    stage.light(dice.vector(0.6 * room))


def lamps(stage: Stage) -> None:
    """Lights at centres, exactly on surfaces, and just off them."""
    apart(stage)
    dice = stage.dice
    for _ in range(dice.whole(1, 4)):
        sphere = dice.one(tuple(stage.spheres))
        stage.light(on(sphere, dice.direction(), dice.one((0.0, 1.0, 1.0, 1.0, 0.999, 1.001, 1.0000001, 1.5))))


def flat(stage: Stage) -> None:
    """Plates and needles, down to 1 : 100, seen from all sides and close to each other."""
    dice = stage.dice
    for _ in range(dice.whole(1, 4)):
        depth = dice.number(2, 6)
        size = dice.number(0.3, 1.2) * stage.width * depth
        thin = size * dice.one(FLAT)
        stage.sphere(
            stage.point(depth, depth, 0.7),
            dice.one(((size, thin, size), (thin, size, size), (size, size, thin), (thin, size, thin))),
        )
    if dice.chance(0.5):
        sphere = stage.spheres[0]
        stage.light(on(sphere, dice.direction(), dice.one((0.5, 1.0, 1.1, 3.0))))


def corridor(stage: Stage) -> None:
    """Mirrors that face each other: rays are reflected as often as may be, and errors grow."""
    dice = stage.dice
    wall, gap = dice.one((3.0, 10.0, 100.0)), dice.number(0.5, 2)
    z = -dice.number(3, 8) * stage.view.near
    for side in (-1, 1):
        made = stage.sphere((side * (wall + gap), dice.number(-1, 1), z), wall)
        stage.spheres[-1] = made.replace(kr=dice.one((1.0, 0.9)))
    for _ in range(dice.whole(0, 2)):
        made = stage.sphere((dice.number(-gap, gap) / 2, dice.number(-1, 1), z), gap * dice.number(0.1, 0.6))
        stage.spheres[-1] = made.replace(kr=1.0)
    stage.light((dice.number(-gap, gap) / 2, dice.number(-2, 2), z * dice.number(0.2, 1.2)))


def distant(stage: Stage) -> None:
    """Small and far away, through a narrow window."""
    dice = stage.dice
    center = dice.number(-1, 1), dice.number(-1, 1)
    half = dice.number(0.01, 0.1)
    left, right, bottom, top = center[0] - half, center[0] + half, center[1] - half, center[1] + half
    stage.view = stage.view.replace(left=left, right=right, bottom=bottom, top=top)
    for _ in range(dice.whole(1, 4)):
        depth = dice.number(50, 300) / stage.view.near
        stage.sphere(stage.point(depth, depth), stage.sizes(dice.number(0.2, 0.8) * half * depth))
    sphere = stage.spheres[0]
    stage.light(on(sphere, dice.direction(), dice.one((1.5, 3.0, 20.0))))


def giant(stage: Stage) -> None:
    """A ground of radius up to 1000 with small things on it, and lights low over it."""
    dice = stage.dice
    radius, height = dice.one((30.0, 100.0, 1000.0)), dice.number(0.3, 2)
    stage.sphere((0.0, -radius - height, -dice.number(3, 8)), radius)
    for _ in range(dice.whole(1, 3)):
        size = dice.number(0.05, 1)
        x, z = dice.number(-2, 2), -dice.number(2, 8)
        # Resting on the ground, or almost.
        top = -radius - height + math.sqrt(max(radius**2 - x**2 - (z - stage.spheres[0].position[2]) ** 2, 0.0))
        stage.sphere((x, top + size * dice.one((1.0, 0.99, 1.01, 0.5)), z), size)
    reach = dice.one((5.0, 50.0, 500.0))
    stage.light((dice.number(-1, 1) * reach, dice.number(0, 0.3) * reach, -dice.number(0, 1) * reach))


def tangent(stage: Stage) -> None:
    """Outlines that pixel rays touch exactly, and near planes that touch spheres exactly."""
    dice = stage.dice
    columns, rows = dice.one(((32, 24), (48, 48), (64, 64)))
    stage.view = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=columns, rows=rows)
    for _ in range(dice.whole(1, 4)):
        depth, radius = float(dice.whole(1, 6)), dice.one((0.25, 0.5, 1.0, 2.0, 3.0))
        # The column of rays x = 0, and the row y = 0, are within the plane x = 0 or y = 0, which this touches.
        x, y = dice.one(((radius, 0.0), (0.0, radius), (-radius, 0.0), (radius, radius)))
        z = dice.one((-depth, -1.0 - radius, -1.0 + radius))
        stage.sphere((x, y, z), radius)
    stage.light(dice.one(((0.0, 0.0, 0.0), (0.0, 4.0, -3.0), dice.vector(5))))


def copies(stage: Stage) -> None:
    """Equal hits: spheres in one place, all but in one place, and with a point in common."""
    dice = stage.dice
    apart(stage)
    del stage.spheres[2:]
    for _ in range(dice.whole(1, 3)):
        first = dice.one(tuple(stage.spheres))
        x, y, z = first.position
        a, b, c = first.scaling
        how = dice.whole(0, 3)
        if how == 0 and dice.chance(0.3):
            stage.sphere((x, y, z), (a, b, c))
        elif how == 1:
            factor = 1 + dice.one((1e-15, 1e-9, 1e-6, 1e-3)) * dice.one((-1, 1))
            stage.sphere((x * factor, y, z), (a, b * factor, c))
        elif how == 2:
            factor = dice.one((0.5, 2.0))  # they share the point next to the eye's side
            stage.sphere((x, y, z + c * (1 - factor)), (a * factor, b * factor, c * factor))
        else:
            stage.sphere((x, y, z), dice.one(((a, b, c / 2), (b, a, c), (a / 2, b * 2, c))))


def grazing(stage: Stage) -> None:
    """Light along surfaces: lights in tangent planes, and inside close to the wall, where chords are flat."""
    dice = stage.dice
    apart(stage)
    for _ in range(dice.whole(1, 3)):
        sphere = dice.one(tuple(stage.spheres))
        at = on(sphere, dice.direction(), dice.one((1.0, 0.999, 0.99)))
        step = dice.one((0.0, dice.number(0.5, 20)))
        axis = dice.whole(0, 2)
        x, y, z = (value + step * sphere.scaling[k] * (k == axis) for k, value in enumerate(at))
        stage.light((x, y, z))


def anything(stage: Stage) -> None:
    """No order at all."""
    dice, near = stage.dice, stage.view.near
    for _ in range(dice.whole(1, 5)):
        x, y, z = dice.vector(4 * near)
        a, b, c = (near * dice.one((0.25, 0.5, 1.0, 2.0, 4.0, dice.number(0.1, 5))) for _ in range(3))
        stage.sphere((x, y, z - 2 * near), (a, b, c))
    for _ in range(dice.whole(0, 5)):
        stage.light(dice.vector(6 * near))


def on(sphere: Sphere, direction: Vec3, radii: float) -> Vec3:
    """A point that many radii from the centre; 1: on the surface, as exactly as float64 has it."""
    x, y, z = (p + radii * s * d for p, s, d in zip(sphere.position, sphere.scaling, direction, strict=True))
    return x, y, z


THEMES: dict[str, Callable[[Stage], None]] = {
    theme.__name__: theme
    for theme in (
        apart,
        cut,
        nested,
        crossing,
        touching,
        inside,
        lamps,
        flat,
        corridor,
        distant,
        giant,
        tangent,
        copies,
        grazing,
        anything,
    )
}


# ---- twists: what may happen to the scene of any theme


def negative_scalings(stage: Stage) -> None:
    """Signs that have no effect."""
    for k, sphere in enumerate(stage.spheres):
        a, b, c = (stage.dice.one((-1, 1)) * size for size in sphere.scaling)
        stage.spheres[k] = sphere.replace(scaling=(a, b, c))


def squeezed(stage: Stage) -> None:
    """All of one axis: what touches goes on touching."""
    axis, factor = stage.dice.whole(0, 2), stage.dice.one((0.02, 0.1, 0.5, 2.0, 5.0))
    resize(stage, tuple(factor if k == axis else 1.0 for k in range(3)))


def scaled(stage: Stage) -> None:
    """All of it in other units."""
    factor = stage.dice.one((0.01, 0.1, 3.0, 10.0, 64.0))
    largest = max(abs(value) for sphere in stage.spheres for value in (*sphere.position, *sphere.scaling))
    resize(stage, (factor if largest * factor <= 5000 else 0.1,) * 3)


def resize(stage: Stage, factors: tuple[float, ...]) -> None:
    """Multiply all lengths along the axes; with the window, so that the picture stays."""

    def times(place: Vec3) -> Vec3:
        x, y, z = (value * factor for value, factor in zip(place, factors, strict=True))
        return x, y, z

    for k, sphere in enumerate(stage.spheres):
        stage.spheres[k] = sphere.replace(position=times(sphere.position), scaling=times(sphere.scaling))
    for k, light in enumerate(stage.lights):
        stage.lights[k] = light.replace(position=times(light.position))
    view, (x, y, z) = stage.view, factors
    stage.view = view.replace(
        near=view.near * z, left=view.left * x, right=view.right * x, bottom=view.bottom * y, top=view.top * y
    )


def dark_light(stage: Stage) -> None:
    """A light that is black, and hides nothing of it."""
    if stage.lights:
        stage.lights[0] = stage.lights[0].replace(intensity=(0.0, 0.0, 0.0))


def negative_light(stage: Stage) -> None:
    """A light that takes light away, and one brighter than 1."""
    for k, light in enumerate(stage.lights[-2:]):
        factor = stage.dice.one((-1.0, -0.5, 3.0))
        r, g, b = (factor * value for value in light.intensity)
        stage.lights[k - min(2, len(stage.lights))] = light.replace(intensity=(r, g, b))


def mirrors(stage: Stage) -> None:
    """Everything reflects."""
    for k, sphere in enumerate(stage.spheres):
        stage.spheres[k] = sphere.replace(kr=stage.dice.one((1.0, 1.0, 0.5)))


def matte(stage: Stage) -> None:
    """Nothing reflects."""
    stage.spheres = [sphere.replace(kr=0.0) for sphere in stage.spheres]


def bare(stage: Stage) -> None:
    """Highlights alone, with special exponents."""
    n = stage.dice.one((0.0, 0.5, 1.0, 1000.0, stage.dice.random.uniform(0, 1)))
    stage.spheres = [sphere.replace(kd=0.0, ks=1.0, exponent=n) for sphere in stage.spheres]


def unlit(stage: Stage) -> None:
    """No light but the ambient one."""
    stage.lights.clear()


#: Each with the share of the scenes that it happens to.
TWISTS: dict[Callable[[Stage], None], float] = {
    negative_scalings: 0.15,
    squeezed: 0.12,
    scaled: 0.15,
    dark_light: 0.08,
    negative_light: 0.1,
    mirrors: 0.15,
    matte: 0.2,
    bare: 0.1,
    unlit: 0.04,
}


def window(dice: Dice) -> View:
    """A frustum: wide or narrow, off the centre, with pixels that are not square."""
    columns, rows = dice.one(SIZES)
    near = dice.one((1.0, 1.0, 0.5, 2.0, dice.number(0.2, 4)))
    half = near * dice.one((1.0, 0.5, dice.number(0.1, 1.5)))
    wide = half * columns / rows
    left, right, bottom, top = -wide, wide, -half, half
    if dice.chance(0.25):
        left, right = left * dice.one((0.3, 2.0)), right * dice.one((0.5, 1.7))
    if dice.chance(0.2):
        shift = dice.number(-1.5, 1.5)
        left, right = left + shift * wide, right + shift * wide
    if dice.chance(0.2):
        bottom, top = bottom * dice.one((0.1, 1.0)), top * dice.one((0.1, 3.0))
    return View(near=near, left=left, right=right, bottom=bottom, top=top, columns=columns, rows=rows)


def draw_scene(seed: int, index: int) -> Drawn:
    """The scene of that index; the same scene for the same seed and index, whatever else is drawn."""
    dice = Dice(seed, index)
    # Every theme in turn, in an order that depends on the seed, so that a few scenes show most of them.
    order = list(THEMES)
    random.Random(f"{seed}").shuffle(order)
    theme = order[index % len(order)]
    stage = Stage(dice, window(dice))
    THEMES[theme](stage)
    stage.lit(least=0 if dice.chance(0.1) else 1)
    del stage.spheres[MOST:], stage.lights[MOST:]
    if dice.chance(0.3):
        dice.random.shuffle(stage.spheres)
    twists = [twist for twist, share in TWISTS.items() if dice.chance(share)]
    for twist in twists:
        twist(stage)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tracer.SceneWarning)  # copies
        scene = Scene(
            view=stage.view,
            spheres=stage.spheres,
            lights=stage.lights,
            background=(dice.share(), dice.share(), dice.share()),
            ambient=dice.one(((0.0, 0.0, 0.0), (dice.share(), dice.share(), dice.share()))),
            output="fuzz.ppm",
        )
    return Drawn(scene, theme, tuple(twist.__name__ for twist in twists))
