"""Ladders: their scenes are valid, climb, and are what they say, measured from the numbers exactly."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import pytest

import tracer
from tracer import Scene
from validation.ladders import LADDERS, SIDE, Ladder, get, names

Point = tuple[Fraction, Fraction, Fraction]

#: What a scene's own decimals are read as.
EPSILON = Fraction(1, 10_000)


def exactly(values: Any) -> Point:
    x, y, z = (Fraction(value) for value in values)
    return x, y, z


def dot(a: Point, b: Point) -> Fraction:
    return sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))


def minus(a: Point, b: Point) -> Point:
    x, y, z = (p - q for p, q in zip(a, b, strict=True))
    return x, y, z


def length(a: Point) -> Fraction:
    """To 40 digits."""
    squared = dot(a, a)
    scale = 10**80
    return Fraction(math.isqrt(int(squared * scale)), 10**40)


def centre(scene: Scene, j: int = 0) -> Point:
    return exactly(scene.spheres[j].position)


def radius(scene: Scene, j: int = 0) -> Fraction:
    return Fraction(scene.spheres[j].scaling[0])


def light(scene: Scene, i: int = 0) -> Point:
    return exactly(scene.lights[i].position)


def gap(scene: Scene) -> Fraction:
    """Between the first two spheres."""
    return length(minus(centre(scene), centre(scene, 1))) - radius(scene) - radius(scene, 1)


def low(scene: Scene, j: int) -> Fraction:
    """The end of a sphere that is farthest from the eye."""
    return centre(scene, j)[2] - Fraction(scene.spheres[j].scaling[2])


def half(scene: Scene) -> Fraction:
    """Of the window's width."""
    assert scene.view.left == -scene.view.right
    return Fraction(scene.view.right)


def touches(scene: Scene, start: Point, direction: Point, j: int) -> Fraction:
    """0 where a line touches a sphere: its discriminant, over the squared radius and the squared direction."""
    o = minus(start, centre(scene, j))
    a, b, c = dot(direction, direction), dot(o, direction), dot(o, o) - radius(scene, j) ** 2
    return (b * b - a * c) / a / radius(scene, j) ** 2


EYE: Point = (Fraction(0), Fraction(0), Fraction(0))
AHEAD: Point = (Fraction(0), Fraction(0), Fraction(-1))


def zoomed(holds: Callable[[Scene], bool]) -> Callable[[Scene], Fraction]:
    """A window that narrows about a place where something holds."""

    def measured(scene: Scene) -> Fraction:
        assert holds(scene)
        return half(scene)

    return measured


def middle_touches_after_mirror(scene: Scene) -> bool:
    x: Point = (Fraction(0), Fraction(0), Fraction(-2))
    assert dot(minus(x, centre(scene)), minus(x, centre(scene))) == radius(scene) ** 2
    N = tuple(value / radius(scene) for value in minus(x, centre(scene)))
    d = tuple(a - 2 * dot(AHEAD, N) * n for a, n in zip(AHEAD, N, strict=True))  # type: ignore[arg-type]
    return abs(touches(scene, x, d, 1)) < Fraction(1, 10**15)  # type: ignore[arg-type]


def middle_turns_dark(scene: Scene) -> bool:
    x: Point = (Fraction(0), Fraction(0), Fraction(-2))
    on = dot(minus(x, centre(scene)), minus(x, centre(scene))) == radius(scene) ** 2
    return on and dot(minus(x, centre(scene)), minus(light(scene), x)) == 0


def shadow_ray_touches(scene: Scene) -> bool:
    x: Point = (Fraction(0), Fraction(0), Fraction(-4))
    on = dot(minus(x, centre(scene)), minus(x, centre(scene))) == radius(scene) ** 2
    return on and touches(scene, x, minus(light(scene), x), 1) == 0


def leaves_at_epsilon(scene: Scene) -> bool:
    x: Point = (Fraction(0), Fraction(0), Fraction(-2))
    to_light = minus(light(scene), x)
    there = minus(tuple(a + EPSILON * b for a, b in zip(x, to_light, strict=True)), centre(scene, 1))  # type: ignore[arg-type]
    leaves = dot(there, to_light) > 0
    return leaves and abs(dot(there, there) / radius(scene, 1) ** 2 - 1) < Fraction(1, 10**14)


def shell(scene: Scene) -> Fraction:
    """Where, by t, the sphere about the light is, seen from the inside of the other: all three have one centre."""
    assert centre(scene) == centre(scene, 1) == light(scene)
    plane = Fraction(scene.view.near) + centre(scene)[2]
    assert radius(scene, 1) < plane < radius(scene)
    return 1 - radius(scene, 1) / radius(scene)


def height_of_light(scene: Scene) -> Fraction:
    return length(minus(light(scene), centre(scene))) / radius(scene) - 1


#: What climbs, worked out of the scene alone.
MEASURES: dict[str, Callable[[Scene], Fraction]] = {
    "far-on-axis": lambda s: length(centre(s)) / radius(s),
    "far-off-axis": lambda s: -centre(s)[2] / radius(s),
    "ground": radius,
    "flat-across": lambda s: Fraction(s.spheres[0].scaling[0]) / Fraction(s.spheres[0].scaling[2]),
    "flat-along": lambda s: Fraction(s.spheres[0].scaling[0]) / Fraction(s.spheres[0].scaling[1]),
    "flat-edge": lambda s: Fraction(s.spheres[0].scaling[1]) / Fraction(s.spheres[0].scaling[0]),
    "smaller": lambda s: Fraction(s.view.near),
    "larger": lambda s: Fraction(s.view.near),
    "aside": lambda s: centre(s)[0],
    "grazing": zoomed(lambda s: touches(s, EYE, AHEAD, 0) == 0),
    "grazing-mirror": zoomed(middle_touches_after_mirror),
    "terminator": zoomed(middle_turns_dark),
    "shadow-edge": zoomed(shadow_ray_touches),
    "blocker-surface": lambda s: low(s, 1) - centre(s)[2] - radius(s),
    "blocker-light": lambda s: light(s)[2] - centre(s, 1)[2] - Fraction(s.spheres[1].scaling[2]),
    "epsilon": zoomed(leaves_at_epsilon),
    "epsilon-above": lambda s: shell(s) / EPSILON - 1,
    "epsilon-below": lambda s: 1 - shell(s) / EPSILON,
    "touching": gap,
    "coincident": lambda s: length(minus(centre(s), centre(s, 1))),
    "nested": lambda s: radius(s, 1) - radius(s) if centre(s) == centre(s, 1) else Fraction(9),
    "eye-outside": lambda s: length(centre(s)) - radius(s),
    "eye-inside": lambda s: radius(s) - length(centre(s)),
    "light-outside": height_of_light,
    "light-inside": lambda s: -height_of_light(s),
    "light-centre": lambda s: length(minus(light(s), centre(s))),
    "near-plane": lambda s: centre(s)[2] + radius(s) + Fraction(s.view.near),
    "exponent": lambda s: Fraction(s.spheres[0].exponent),
    "mirrors": gap,
    "inside-mirror": lambda s: radius(s) - length(centre(s)),
    "bright": lambda s: Fraction(s.lights[0].intensity[0]),
    "dim": lambda s: Fraction(s.lights[0].intensity[0]),
    "wide": lambda s: Fraction(s.view.right) / Fraction(s.view.near),
    "narrow": half,
    "speck": lambda s: radius(s) / (8 * 2 * half(s) / SIDE),
    "speck-off-axis": lambda s: radius(s) / (8 * 2 * half(s) / SIDE),
}


def test_every_ladder_is_measured() -> None:
    assert names() == list(MEASURES)
    assert len(set(names())) == len(LADDERS)


@pytest.mark.parametrize("ladder", LADDERS, ids=names())
def test_rungs_are_valid_and_climb(ladder: Ladder) -> None:
    values = [Fraction(rung) for rung in ladder.rungs]
    assert values in (sorted(values), sorted(values, reverse=True))
    assert len(set(values)) == len(values) >= 7
    assert ladder.about.endswith(".")
    assert get(ladder.name) is ladder
    for rung in ladder.rungs:
        scene = ladder.scene(rung)
        assert scene == ladder.scene(rung)
        assert (scene.view.columns, scene.view.rows) == (SIDE, SIDE)
        assert len(scene.spheres) <= 5
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tracer.SceneWarning)
            assert tracer.loads(scene.text()) == scene


@pytest.mark.parametrize("ladder", LADDERS, ids=names())
def test_rungs_are_what_they_say(ladder: Ladder) -> None:
    for rung in ladder.rungs:
        measured = MEASURES[ladder.name](ladder.scene(rung))
        # The numbers of a scene are rounded, and some distances are no float64.
        assert measured == pytest.approx(
            float(Fraction(rung)), rel=1e-3, abs=3e-12 if "epsilon-" in ladder.name else 3e-16
        )


def test_what_stays_the_same_while_a_ladder_climbs() -> None:
    for rung in get("ground").rungs:
        scene = get("ground").scene(rung)
        assert -centre(scene)[1] - radius(scene) == Fraction(1, 1024)
    for ladder in map(get, ("smaller", "larger")):
        first = ladder.scene(ladder.rungs[0])
        for rung in ladder.rungs:
            scene, scale = ladder.scene(rung), Fraction(rung)
            for a, b in zip(scene.spheres, first.spheres, strict=True):
                assert a.position == tuple(float(Fraction(value) * scale) for value in b.position)
    for rung in get("far-on-axis").rungs:
        # The picture is the same: as many pixels across.
        scene = get("far-on-axis").scene(rung)
        assert half(scene) * length(centre(scene)) == pytest.approx(1.25)
    for name in ("coincident", "nested"):
        assert len(get(name).scene("0").distinct) == 1
        assert len(get(name).scene("1e-12").distinct) == 2


def test_the_ray_of_a_pixel_goes_through_the_centre_of_a_speck() -> None:
    for name in ("speck", "speck-off-axis"):
        for rung in get(name).rungs:
            scene = get(name).scene(rung)
            x, y, z = centre(scene)
            column, row = ((value / -z + half(scene)) / (2 * half(scene)) * SIDE for value in (x, -y))
            assert column.denominator == row.denominator == 1
            assert 0 < column < SIDE


def test_there_is_no_other_ladder() -> None:
    with pytest.raises(KeyError):
        get("step-ladder")
