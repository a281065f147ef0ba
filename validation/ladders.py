"""Ladders: families of scenes in which one number climbs by decades until something has to give."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

import tracer
from tracer import Light, Scene, Sphere, View

Number: TypeAlias = Fraction | float | int
Point: TypeAlias = tuple[Number, Number, Number]

#: Columns and rows: the middle column and row are x = 0 and y = 0 exactly where the window is symmetric.
SIDE = 20
#: How far before its ball the ray of `eye-outside` starts: nearer than any rung.
CLOSE = Fraction(1, 1 << 46)

RED, BLUE, SAND, WHITE = (0.9, 0.2, 0.1), (0.1, 0.3, 0.9), (0.8, 0.7, 0.5), (1.0, 1.0, 1.0)
HALF, QUARTER, EIGHTH = Fraction(1, 2), Fraction(1, 4), Fraction(1, 8)


@dataclass(frozen=True)
class Ladder:
    """A family of scenes.

    `about`: one sentence. `parameter`: what climbs. `rungs`: its values as decimal numbers, from easy to hard. `build`
    makes the scene of a value, which it gets exactly; every number of a scene is rounded once.
    """

    name: str
    about: str
    parameter: str
    rungs: tuple[str, ...]
    build: Callable[[Fraction], Scene]

    def scene(self, rung: str) -> Scene:
        """The scene of a rung: the same for ever."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tracer.SceneWarning)  # the second of two equal spheres
            return self.build(Fraction(rung)).replace(output=f"{self.name}-{rung}.ppm")


def up(last: int, first: int = 0, step: int = 1) -> tuple[str, ...]:
    """1e`first` to 1e`last`."""
    return tuple(f"1e{k}" for k in range(first, last + 1, step))


def down(last: int, first: int = 1, step: int = 1, *, zero: bool = False) -> tuple[str, ...]:
    """1e-`first` to 1e-`last`, and 0."""
    return (*(f"1e-{k}" if k else "1e0" for k in range(first, last + 1, step)), *(["0"] if zero else []))


# ---- the parts of scenes


def triple(point: Sequence[Number]) -> tuple[float, float, float]:
    """Each number rounded once."""
    x, y, z = (float(value) for value in point)
    return x, y, z


def ball(
    name: str,
    at: Point,
    radius: Number | Point,
    color: tuple[float, float, float] = SAND,
    *,
    ka: float = 0.25,
    kd: float = 0.75,
    ks: float = 0.0,
    kr: float = 0.0,
    n: Number = 1,
) -> Sphere:
    """A sphere, or with three radii an ellipsoid: dull, unless told."""
    radii = radius if isinstance(radius, tuple) else (radius,) * 3
    return Sphere(
        name=name,
        position=triple(at),
        scaling=triple(radii),
        color=color,
        ka=ka,
        kd=kd,
        ks=ks,
        kr=kr,
        exponent=float(n),
    )


def lamp(at: Point, intensity: Number = 1) -> Light:
    """A white light."""
    return Light(name="lamp", position=triple(at), intensity=triple((intensity,) * 3))


def window(half: Number, *, near: Number = 1, middle: tuple[Number, Number] = (0, 0), high: Number = 0) -> View:
    """The image plane at `near`, `half` to each side of its middle; `high`: to above and below, if that is another."""
    x, y = middle
    high = high or half
    return View(
        near=float(near),
        left=float(x - half),
        right=float(x + half),
        bottom=float(y - high),
        top=float(y + high),
        columns=SIDE,
        rows=SIDE,
    )


def scene(view: View, spheres: Sequence[Sphere], light: Light | Sequence[Light], *, glow: Number = HALF) -> Scene:
    """`glow`: of the ambient light; a quarter of it is the background's blue."""
    return Scene(
        view=view,
        spheres=list(spheres),
        lights=[light] if isinstance(light, Light) else list(light),
        background=(0.0, 0.0, float(min(Fraction(glow), Fraction(4)) / 4)),
        ambient=triple((glow,) * 3),
        output="ladder.ppm",
    )


def still_life(scale: Number = 1, *, aside: Number = 0, bright: Number = 1, glossy: bool = False) -> Scene:
    """A ball beside a mirror on a round floor, one shadow on another.

    Everything `scale` times as large, moved aside with the window that shows it, and in a light so bright.
    """

    def at(x: Number, y: Number, z: Number) -> Point:
        return (x - aside * z / 4) * scale, y * scale, z * scale

    half = HALF * scale
    spheres = [
        ball("floor", at(0, -9, -4), 8 * scale),
        ball("ball", at(-HALF, -HALF, -4), HALF * scale, RED, ks=0.5 if glossy else 0, n=8),
        ball("mirror", at(3 * QUARTER, -QUARTER, -19 * QUARTER), 3 * QUARTER * scale, WHITE, ka=0, kd=0, kr=0.5),
    ]
    view = window(half, near=scale, middle=(aside * scale / 4, 0))
    return scene(view, spheres, lamp(at(-3, 4, -4), bright), glow=HALF * bright)


#: A point on the axis of the view where the normal is (3, 0, 4) / 5: the ball's centre, radius 5.
SLOPE: Point = (-3, 0, -6)


# ---- the ladders


def far_on_axis(D: Fraction) -> Scene:
    """The light as far as the ball, so that nothing but their numbers' first digits counts."""
    return scene(window(Fraction(5, 4) / D), [ball("ball", (0, 0, -D), 1)], lamp((D, D, 0)))


def far_off_axis(D: Fraction) -> Scene:
    """In the direction (1, 1/2, -1)."""
    view = window(Fraction(5, 4) / D, middle=(1, HALF))
    return scene(view, [ball("ball", (D, D / 2, -D), 1, ks=0.25, n=8)], lamp((0, D, 0)))


def ground(R: Fraction) -> Scene:
    """The eye 1/1024 above it, a ball on it, and the light low."""
    height, radius = Fraction(1, 1024), Fraction(1, 2048)
    spheres = [
        ball("ground", (0, -R - height, 0), R),
        ball("ball", (0, radius - height, Fraction(-1, 256)), radius, RED),
    ]
    near = Fraction(1, 4096)
    return scene(window(near / 2, near=near), spheres, lamp((Fraction(1, 32), Fraction(3, 64), Fraction(1, 64))))


def plate_across(F: Fraction) -> Scene:
    """It faces the eye, and a ball before it casts a shadow on it."""
    spheres = [ball("plate", (0, 0, -4), (1, 1, 1 / F)), ball("ball", (QUARTER, QUARTER, -3), EIGHTH, RED)]
    return scene(window(Fraction(5, 16)), spheres, lamp((2, 3, 1)))


def plate_along(F: Fraction) -> Scene:
    """It lies under the eye like a floor, a ball above it."""
    spheres = [ball("plate", (0, -HALF, -4), (1, 1 / F, 1)), ball("ball", (QUARTER, -EIGHTH, -4), EIGHTH, RED)]
    return scene(window(Fraction(5, 16), middle=(0, -EIGHTH)), spheres, lamp((1, 3, -3)))


def plate_edge(F: Fraction) -> Scene:
    """The eye is in its plane, and the window as narrow as the plate."""
    view = window(Fraction(5, 12) / F, high=Fraction(5, 12))
    return scene(view, [ball("plate", (0, 0, -4), (1 / F, 1, 1))], lamp((3, 2, -1)))


def grazing(h: Fraction) -> Scene:
    """The middle column touches the ball."""
    return scene(window(h), [ball("ball", (1, 0, -4), 1)], lamp((-2, 3, 0)))


def grazing_mirror(h: Fraction) -> Scene:
    """The middle ray, after a mirror, touches a ball."""
    # The mirror's normal is (3, 0, 4) / 5 at (0, 0, -2): it sends the ray to (24, 0, 7) / 25, which touches at 5/2.
    touch = (Fraction(12, 5), 0, -2 + Fraction(7, 10))
    centre = (touch[0] - Fraction(7, 25), 0, touch[2] + Fraction(24, 25))
    spheres = [ball("mirror", SLOPE, 5, WHITE, ka=0, kd=0, kr=0.5), ball("ball", centre, 1, RED)]
    return scene(window(h), spheres, lamp((0, 4, 2)))


def terminator(h: Fraction) -> Scene:
    """N.L = 0 at the middle pixel; the highlight is cut off there."""
    return scene(window(h), [ball("ball", SLOPE, 5, ks=0.5, n=4)], lamp((4, 0, -5)))


def shadow_edge(h: Fraction) -> Scene:
    """The shadow ray of the middle pixel touches the blocker halfway."""
    blocker = ball("blocker", (Fraction(5, 2), 0, Fraction(-11, 4)), Fraction(5, 4), RED)
    return scene(window(h), [ball("ball", (0, 0, -9), 5), blocker], lamp((6, 0, 4)))


def flake(at: Point, size: Number) -> Sphere:
    """A blocker that faces the eye, half as wide to each side as what it is measured by, an eighth of that thick.

    Both of its roots lie between `size` and 9/8 `size` from what it shades, or from the light: if a ray begins or ends
    a little later or earlier, there is nothing left that hides the light.
    """
    return ball("blocker", at, (size / 2, size / 2, size / 16), RED)


def blocker_at_surface(g: Fraction) -> Scene:
    """The light is so low that the eye sees the place beside the blocker that this shades.

    One light 64 g above that place, so that t is 1/64 for ever, and one 1 above it, so that t is g.
    """
    place = (0, 0, -1)  # on the ball, whose normal there faces the eye; the light comes along (4, 0, 3) / 5
    height = g + g / 16
    spheres = [
        ball("ball", (0, 0, -2), 1),
        flake((Fraction(4, 3) * height, 0, height + place[2]), g),
    ]
    lights = [lamp((Fraction(4, 3) * up, 0, up + place[2])) for up in (64 * g, 1)]
    return scene(window(Fraction(3, 8) * g, near=HALF), spheres, lights)


def blocker_around(g: Fraction) -> Scene:
    """The eye and the lights are in a ball, whose wall is g to 5/2 g over the surface outside that the window shows.

    It stands askew there: to the right of the middle it lies before the image plane, and the surface is seen behind
    it, dark; to the left behind the plane, where its inside is seen, lit; farther left it is below the surface, which
    is lit there. So one root alone hides a light, that at the gap. That light is 8 g above, a second one 1/4, so that
    t is 4 g to 10 g there.
    """
    wall = g - 1  # where it crosses the image plane on the axis, its normal (-3, 0, -4) / 5
    spheres = [
        ball("ball", (0, 0, -2), 1),
        ball("around", (Fraction(6, 5), 0, Fraction(8, 5) + wall), 2, RED),
    ]
    view = window(2 * g, near=-wall)
    return scene(view, spheres, [lamp((0, 0, 8 * g - 1)), lamp((HALF, 0, -3 * QUARTER))])


def blocker_at_light(g: Fraction) -> Scene:
    """The light is beside the eye, and the blocker before it: its shadow is always as large."""
    light = (2 * g, 0, 0)
    spheres = [ball("wall", (0, 0, -7), 5), flake((light[0], 0, -g - g / 16), g)]
    return scene(window(3 * QUARTER), spheres, lamp(light))


def epsilon(h: Fraction) -> Scene:
    """The shadow ray of the middle pixel leaves the blocker at t = 0.0001: half of the pixels are shaded."""
    blocker = ball("blocker", (Fraction(18, 25), 0, Fraction(-179, 100)), QUARTER, RED)
    return scene(window(h), [ball("ball", SLOPE, 5), blocker], lamp((9600, 0, 2798)))


def shells(e: Fraction) -> Scene:
    """Two spheres about one light: the eye sees the inside of the outer one, from where the inner one is at t = e."""
    spheres = [ball("outer", (0, 0, -3), 4), ball("blocker", (0, 0, -3), 4 * (1 - e), RED)]
    # The image plane lies between the two.
    return scene(window(Fraction(1, 100), near=7 - Fraction(2, 10_000)), spheres, lamp((0, 0, -3)))


def touching(g: Fraction) -> Scene:
    """The eye looks down into the place between them: a dull wall to the left, its picture in a mirror to the right.

    At a height w over the narrowest place the walls are g + w^2 apart. So the window is sqrt(g) high and g wide, and
    the light as low as that: it comes over the mirror, and ends on the wall at a height of about sqrt(g).
    """
    deep = g or Fraction(1, 10**6)  # what stands for g where that is 0
    width = Fraction(math.sqrt(deep))
    spheres = [
        ball("left", (-1 - g / 2, 0, -1), 1, RED),
        ball("right", (1 + g / 2, 0, -1), 1, WHITE, ka=0, kd=0, kr=0.5),
    ]
    view = window(Fraction(9, 8) * deep, near=HALF, high=Fraction(5, 8) * width)
    return scene(view, spheres, lamp((24 * deep, 0, 8 * width - 1)))


def coincident(g: Fraction) -> Scene:
    """Of two colours, one beside the other."""
    spheres = [ball("first", (0, 0, -4), 1, RED), ball("second", (g, 0, -4), 1, BLUE)]
    return scene(window(Fraction(5, 16)), spheres, lamp((2, 3, 0)))


def nested(g: Fraction) -> Scene:
    """Of two colours, one within the other."""
    spheres = [ball("inner", (0, 0, -4), 1, RED), ball("outer", (0, 0, -4), 1 + g, BLUE)]
    return scene(window(Fraction(5, 16)), spheres, lamp((2, 3, 0)))


def eye_outside(g: Fraction) -> Scene:
    """The ball is ahead; a light outside it and one inside."""
    lights = [lamp((2, 2, 2)), lamp((0, HALF, -1))]
    return scene(window(2 * CLOSE, near=CLOSE), [ball("ball", (0, 0, -1 - g), 1)], lights)


def eye_inside(g: Fraction) -> Scene:
    """The wall is ahead; a light inside and one outside."""
    lights = [lamp((HALF, QUARTER, HALF)), lamp((2, 2, -2))]
    return scene(window(2 * CLOSE, near=CLOSE), [ball("ball", (0, 0, 1 - g), 1)], lights)


def light_near(g: Fraction) -> Scene:
    """A light over the wall of a room, within it where g < 0, and seen through the wall from what is outside.

    The image plane opens the room: to the left the window shows its inside, to the right a ball outside. One of them
    has the light, the other the wall before it; if the light lies on the wall, both have it.
    """
    spheres = [ball("room", (-1, 0, -1), 1), ball("other", (2, 0, -4), Fraction(7, 4), RED)]
    return scene(window(HALF), spheres, lamp((g, 0, -1)))


def light_at_centre(g: Fraction) -> Scene:
    """The image plane opens the ball; a bead at its centre, half as large as the light is far, hides that from some."""
    beads = [ball("bead", (0, 0, -4), g / 2, RED)] if g else []
    light = (Fraction(3, 5) * g, 0, Fraction(4, 5) * g - 4)
    return scene(window(1, near=3), [ball("ball", (0, 0, -4), 2), *beads], lamp(light))


def near_plane(g: Fraction) -> Scene:
    """The window is as wide as the cap."""
    half = Fraction(3, 2) * Fraction(math.sqrt(2 * g or 1e-12))
    return scene(window(half, near=2), [ball("ball", (0, 0, g - 3), 1)], [lamp((2, 2, 0)), lamp((0, HALF, -3))])


def exponent(n: Fraction) -> Scene:
    """The window is as wide as the highlight."""
    half = Fraction(1 / math.sqrt(n)) / 2
    return scene(window(half), [ball("ball", SLOPE, 5, ks=0.75, n=n)], lamp((6, 0, -QUARTER)))


def between_mirrors(g: Fraction) -> Scene:
    """The eye is in the gap, and so are a light and a bead, that is seen directly and after one to three bounces."""
    mirror = {"color": WHITE, "ka": 0.0, "kd": 0.0, "kr": 0.875}
    spheres = [
        ball("left", (-1 - g / 2, 0, 0), 1, **mirror),  # type: ignore[arg-type]
        ball("right", (1 + g / 2, 0, 0), 1, **mirror),  # type: ignore[arg-type]
        ball("bead", (0, 0, Fraction(-3, 2) * g), Fraction(7, 16) * g, RED),
    ]
    near = g / 64
    view = window(3 * near, near=near, high=near / 3)
    return scene(view, spheres, lamp((g / 4, g, -3 * QUARTER * g)))


def inside_mirror(g: Fraction) -> Scene:
    """The eye looks along the wall, g below it: chords as long as sqrt(g)."""
    spheres = [ball("mirror", (0, g - 1, 0), 1, SAND, ka=0.25, kd=0.5, kr=0.875)]
    return scene(window(g * Fraction(math.sqrt(2 * g)), near=g), spheres, lamp((QUARTER, -HALF, -QUARTER)))


def wide_frustum(W: Fraction) -> Scene:
    """The image plane comes near: rays run along it."""
    spheres = [
        ball("right", (3, 0, -2), Fraction(3, 2)),
        ball("left", (-3, 1, 0), 1, RED),
        ball("below", (0, -3, -HALF), 1, BLUE),
    ]
    return scene(window(1, near=1 / W), spheres, lamp((1, 3, -2)))


def narrow_frustum(h: Fraction) -> Scene:
    """A smooth place, seen as through a telescope: nothing is near that could be decided otherwise."""
    spheres = [ball("ball", SLOPE, 5, ks=0.5, n=8), ball("other", (3, 3, -3), 1, RED)]
    return scene(window(h), spheres, lamp((6, 2, 1)))


def speck(r: Fraction) -> Scene:
    """On the axis, where the ray of the middle pixel goes through its centre; r: in pixels."""
    return scene(window(Fraction(5, 8)), [ball("speck", (0, 0, -8), r / 2)], lamp((2, 3, 0)))


def speck_off_axis(r: Fraction) -> Scene:
    """The ray of another pixel goes through its centre, exactly."""
    return scene(window(Fraction(5, 8)), [ball("speck", (-3, 2, -8), r / 2)], lamp((2, 3, 0)))


def _ladders() -> tuple[Ladder, ...]:
    gap = down(12, zero=True)
    zoom = apart = down(12)
    return (
        Ladder("far-on-axis", "A ball far away on the axis of the view.", "distance / radius", up(12, 1), far_on_axis),
        Ladder("far-off-axis", "A ball far away and aside.", "depth / radius", up(12, 1), far_off_axis),
        Ladder("ground", "The eye 1e-3 above a ground that is a sphere, with a ball on it.", "radius", up(8), ground),
        Ladder("flat-across", "A plate that faces the eye.", "radius / thickness", up(8), plate_across),
        Ladder("flat-along", "A plate under the eye.", "radius / thickness", up(8), plate_along),
        Ladder("flat-edge", "A plate, seen from its own plane.", "radius / thickness", up(8), plate_edge),
        Ladder("smaller", "A ball, a mirror and a floor, all smaller and nearer.", "scale", down(12, 0), still_life),
        Ladder("larger", "A ball, a mirror and a floor, all larger and farther.", "scale", up(12), still_life),
        Ladder(
            "aside",
            "A ball, a mirror and a floor far aside, and the window there too.",
            "shift",
            up(8),
            lambda shift: still_life(aside=shift),
        ),
        Ladder("grazing", "A window about a ray that touches a ball.", "half width", zoom, grazing),
        Ladder(
            "grazing-mirror",
            "A window about a ray that touches a ball after a mirror.",
            "half width",
            zoom,
            grazing_mirror,
        ),
        Ladder("terminator", "A window about a point with N.L = 0.", "half width", zoom, terminator),
        Ladder("shadow-edge", "A window about a shadow ray that touches its blocker.", "half width", zoom, shadow_edge),
        Ladder("blocker-surface", "A blocker near the surface that it shades.", "gap", apart, blocker_at_surface),
        Ladder("blocker-around", "A light in a ball whose wall is near a surface.", "gap", apart, blocker_around),
        Ladder("blocker-light", "A blocker near the light.", "gap", apart, blocker_at_light),
        Ladder(
            "epsilon", "A window about a shadow ray that leaves its blocker at t = 0.0001.", "half width", zoom, epsilon
        ),
        Ladder(
            "epsilon-above",
            "A sphere about the light, met just behind the shadow epsilon: it hides the light.",
            "t / 0.0001 - 1",
            ("1e1", "1e0", *zoom),
            lambda g: shells(Fraction(1, 10_000) * (1 + g)),
        ),
        Ladder(
            "epsilon-below",
            "A sphere about the light, met just before the shadow epsilon: it does not.",
            "1 - t / 0.0001",
            zoom,
            lambda g: shells(Fraction(1, 10_000) * (1 - g)),
        ),
        Ladder("touching", "Two balls that almost touch.", "gap", gap, touching),
        Ladder("coincident", "Two balls almost in the same place; at 0 only one exists.", "offset", gap, coincident),
        Ladder("nested", "A ball just within another; at 0 only one exists.", "difference of radii", gap, nested),
        Ladder("eye-outside", "The eye just outside a ball.", "distance", gap, eye_outside),
        Ladder("eye-inside", "The eye just inside a ball.", "distance", gap, eye_inside),
        Ladder("light-outside", "A light just outside a ball.", "height / radius", gap, light_near),
        Ladder("light-inside", "A light just inside a ball.", "depth / radius", gap, lambda g: light_near(-g)),
        Ladder(
            "light-centre",
            "A light near the centre of a ball that is seen from inside.",
            "offset",
            gap,
            light_at_centre,
        ),
        Ladder(
            "near-plane",
            "The image plane cuts a cap off a ball; at 0 it touches.",
            "height of the cap",
            gap,
            near_plane,
        ),
        Ladder("exponent", "A highlight that gets sharper.", "n", up(6), exponent),
        Ladder("mirrors", "Three bounces between two mirrors that almost touch.", "gap", apart, between_mirrors),
        Ladder("inside-mirror", "The eye inside a mirror, looking along its wall.", "distance", zoom, inside_mirror),
        Ladder(
            "bright", "Ever brighter lights.", "intensity", up(30, 0, 3), lambda b: still_life(bright=b, glossy=True)
        ),
        Ladder("dim", "Ever dimmer lights.", "intensity", down(30, 0, 3), lambda b: still_life(bright=b, glossy=True)),
        Ladder("wide", "An ever wider field of view.", "width / near", up(12), wide_frustum),
        Ladder("narrow", "An ever narrower field of view of a smooth surface.", "half width", zoom, narrow_frustum),
        Ladder("speck", "A ball smaller than a pixel, on the axis.", "radius in pixels", down(12, 0), speck),
        Ladder(
            "speck-off-axis", "A ball smaller than a pixel, aside.", "radius in pixels", down(12, 0), speck_off_axis
        ),
    )


LADDERS = _ladders()


def names() -> list[str]:
    """Of all ladders, in their order."""
    return [ladder.name for ladder in LADDERS]


def get(name: str) -> Ladder:
    """The ladder of that name.

    Raises:
        KeyError: there is none.
    """
    return {ladder.name: ladder for ladder in LADDERS}[name]
