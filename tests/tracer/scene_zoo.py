"""Scenes for the tests of the reference: the hard ones by name, and ordinary ones by seed."""

from __future__ import annotations

import math
import random

from tracer import Light, Scene, Sphere, View

SIZE = 64


def view(near: float = 1, half: float = 1, size: int = SIZE) -> View:
    """A square frustum."""
    return View(near=near, left=-half, right=half, bottom=-half, top=half, columns=size, rows=size)


def sphere(
    position: tuple[float, float, float],
    scaling: float | tuple[float, float, float] = 1.0,
    *,
    kr: float = 0.3,
    ks: float = 0.6,
    n: float = 30,
    kd: float = 0.7,
) -> Sphere:
    """A sphere whose colour is a function of its place."""
    sizes = scaling if isinstance(scaling, tuple) else (scaling, scaling, scaling)
    color = tuple(0.5 + 0.5 * math.sin(1 + position[k] * (k + 1)) for k in range(3))
    return Sphere(name="s", position=position, scaling=sizes, color=color, ka=0.4, kd=kd, ks=ks, kr=kr, exponent=n)


def light(*position: float) -> Light:
    """A light that is not white."""
    return Light(name="l", position=position, intensity=(0.9, 0.7, 0.4))


def scene(spheres: list[Sphere], lights: list[Light], frustum: View | None = None) -> Scene:
    """A scene with a background and an ambient light."""
    return Scene(
        view=frustum or view(), spheres=spheres, lights=lights, background=(0.2, 0.3, 0.5), ambient=(0.3, 0.3, 0.2)
    )


def pair(n: float) -> list[Sphere]:
    """A small sphere before a large one, with that exponent."""
    return [sphere((0, 0, -4), 1.5, n=n), sphere((1, 1, -3), 0.5, n=n)]


def hard() -> dict[str, Scene]:
    """What is hard for a ray tracer in floating point, one scene each."""
    corridor = [sphere((-102, 0, -4), 100, kr=1), sphere((102, 0, -4), 100, kr=1), sphere((0, 0.2, -4), 0.7, kr=1)]
    mutual = [sphere((-1.1, 0, -4), kr=1), sphere((1.1, 0, -4), kr=1), sphere((0, 1.7, -4.5), kr=1)]
    plates = [sphere((0, -1, -5), (4, 0.2, 4)), sphere((0, 0.5, -5), (0.1, 2, 2), kr=0.9)]
    far = [sphere((0, 0, -1000), 8), sphere((12, 3, -990), 5), sphere((3, -2, -980), 2)]
    aside = View(near=1, left=0.74, right=0.76, bottom=-0.01, top=0.01, columns=SIZE, rows=SIZE)
    ground = [sphere((0, -1e5 - 1, 0), 1e5), sphere((0, 0, -5), 1), sphere((2, -0.5, -4), 0.5)]
    small = [sphere((0, 0, -0.004), 0.001), sphere((0.001, 0.001, -0.003), 0.0004)]
    touching = [sphere((-1, 0, -4), 1, kr=0.9), sphere((1, 0, -4), 1, kr=0.9)]
    crossing = [sphere((-0.5, 0, -4), 1, kr=0.9), sphere((0.5, 0, -4), 1, kr=0.9)]
    return {
        "eye-inside": scene(
            [sphere((0, 0, 0), 5, kr=0.8), sphere((0.5, 0, -3), 0.8)], [light(1, 2, 1), light(9, 9, 0)]
        ),
        "eye-inside-plate": scene([sphere((0.3, 0.2, 0), (6, 1, 9), kr=1)], [light(0, 0.5, -1)]),
        "cut": scene([sphere((0, 0, -1.5), 1), sphere((1.5, 0.5, -4), 1)], [light(0, 0, 0), light(3, 4, -2)]),
        "light-inside": scene([sphere((0, 0, -3), 2.5, kr=0.5), sphere((0, 0.5, -2.4), 0.4)], [light(0.2, 1, -2.5)]),
        "light-on-surface": scene([sphere((0, 0, -4)), sphere((2, 0, -4), 0.9)], [light(1, 0, -4), light(0, 1, -4)]),
        "plate": scene(plates, [light(3, 4, 0), light(-4, 5, -5)]),
        "far": scene(far, [light(300, 500, -700)], view(half=0.02)),
        "far-off-axis": scene(
            [sphere((6000, 0, -8000), 50), sphere((6030, 30, -7950), 20)], [light(5000, 3000, 0)], aside
        ),
        "ground": scene(ground, [light(4, 6, -1)]),
        "small": scene(small, [light(1, 1, 0)], view(1e-3, 1e-3)),
        "corridor": scene(corridor, [light(0, 1.4, -3), light(0.5, -1, 0)]),
        "mutual": scene(mutual, [light(2, 5, 0), light(-5, 1, -1)]),
        "n-0": scene(pair(0), [light(3, 3, -1), light(-4, 1, -6)]),
        "n-half": scene(pair(0.5), [light(3, 3, -1), light(-4, 1, -6)]),
        "n-1": scene(pair(1), [light(3, 3, -1), light(-3, 1, -4)]),
        "n-1000": scene(pair(1000), [light(3, 3, -1), light(0, 1, 0)]),
        "touching": scene(touching, [light(0, 4, -2)]),
        "crossing": scene(crossing, [light(0, 4, -2), light(0, 0, -4)]),
        "no-lights": scene([sphere((0, 0, -4), 1.5)], []),
        "no-spheres": scene([], [light(0, 0, 0)]),
    }


def ordinary(seed: int) -> Scene:
    """Up to five spheres and five lights in sight, round or not, with mirrors."""
    random_ = random.Random(seed)
    spheres = []
    for _ in range(random_.randint(1, 5)):
        depth = random_.uniform(1, 10)
        width = 0.8 * depth
        size = random_.uniform(0.2, 1.5)
        sizes = tuple(size * random_.uniform(0.3, 1.5) for _ in range(3)) if random_.random() < 0.6 else (size,) * 3
        spheres.append(
            sphere(
                (random_.uniform(-width, width), random_.uniform(-width, width), -depth),
                sizes,
                kr=random_.choice((0, 0.3, 0.7, 1)),
                ks=random_.choice((0, 0.5, 1)),
                kd=random_.choice((0, 0.5, 1)),
                n=random_.choice((0, 0.5, 1, 2, 7.5, 30, 200, 1000)),
            )
        )
    lights = [light(*(random_.uniform(-8, 8) for _ in range(3))) for _ in range(random_.randint(0, 5))]
    frustum = View(
        near=random_.choice((0.5, 1, 2)),
        left=-random_.uniform(0.2, 1.2),
        right=random_.uniform(0.2, 1.2),
        bottom=-random_.uniform(0.2, 1.2),
        top=random_.uniform(0.2, 1.2),
        columns=random_.randint(24, 40),
        rows=random_.randint(24, 40),
    )
    return scene(spheres, lights, frustum)


def wild(seed: int) -> Scene:
    """Like `ordinary`, with the eye and lights inside spheres, plates, needles, and numbers that coincide."""
    random_ = random.Random(-1 - seed)

    def number(span: float) -> float:
        return random_.randint(-4, 4) * span / 4 if random_.random() < 0.5 else random_.uniform(-span, span)

    spheres = [
        sphere(
            (number(4), number(4), number(6) - 2),
            tuple(random_.choice((0.25, 0.5, 1, 2, 4, random_.uniform(0.1, 5))) for _ in range(3)),
            kr=random_.choice((0, 0.5, 1)),
            n=random_.choice((0, 0.5, 1, 5, 100)),
        )
        for _ in range(random_.randint(1, 5))
    ]
    return scene(
        spheres, [light(number(4), number(4), number(6)) for _ in range(3)], view(random_.choice((0.5, 1)), size=24)
    )
