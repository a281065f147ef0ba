"""Ladders: their scenes are valid, climb, and are what they say, measured from the numbers exactly."""

from __future__ import annotations

import dataclasses
import functools
import math
import warnings
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from doubles import Double, with_patch, with_settings

import tracer
from tracer import Scene, reference
from validation.certify import Proof
from validation.ladders import LADDERS, SIDE, Ladder, get, names
from validation.renderers import Settings
from validation.renderers.native import Native
from validation.renderers.numpy import Reference
from validation.stability import measure, prove_rung
from validation.truth import Prover

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


def over_the_surface(scene: Scene) -> Fraction:
    """Of the place where the axis meets the image plane, on the second sphere, which eye and lights are in."""
    x: Point = (Fraction(0), Fraction(0), -Fraction(scene.view.near))
    assert length(minus(x, centre(scene, 1))) / radius(scene, 1) == pytest.approx(1, rel=1e-15)
    assert all(length(minus(p, centre(scene, 1))) < radius(scene, 1) for p in (EYE, light(scene), light(scene, 1)))
    return x[2] - centre(scene)[2] - radius(scene)


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
    "blocker-around": over_the_surface,
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


# ---- ladders of gaps: what each is about shows on every rung, and who passes over so much falls there


@functools.cache
def proof(name: str, rung: str) -> Proof:
    """Once for all that is held against it."""
    return prove_rung(get(name), rung, Settings(threads=1))


#: Where pixels have to be lit, and others hidden; or dark in a mirror, and others not.
LIT = {
    "blocker-surface": ["shadow.L0"],
    "blocker-around": ["shadow.L0"],
    "blocker-light": ["shadow.L0"],
    "touching": ["shadow.L0"],
    "light-outside": ["shadow.L0"],
    "light-inside": ["shadow.L0"],
    "light-centre": ["shadow.L0"],
    "mirrors": ["reflection.1", "reflection.2", "reflection.3"],
}


@pytest.mark.parametrize("name", LIT)
def test_what_a_gap_decides_is_seen_on_every_rung(name: str) -> None:
    for rung in get(name).rungs:
        found = proof(name, rung)
        assert (len(found.x), found.unproved, int(found.unsettled.sum())) == (SIDE * SIDE, (), 0)
        for decision in LIT[name]:
            yes = (found.value[decision] != 0).any(axis=-1)
            asked = found.lit[0] & (found.value["id"][:, 0] >= 0) if "shadow" in decision else np.ones_like(yes)
            counts = int((asked & yes).sum()), int((asked & ~yes).sum())
            if rung == "0" and name.startswith("light-"):
                assert counts[1] == 0, "a light on a surface, and one in the centre of nothing, is not hidden"
            else:
                assert min(counts) >= SIDE * SIDE / 10, (rung, decision)


@pytest.mark.parametrize("name", ["blocker-surface", "blocker-around"])
def test_what_hides_one_light_is_before_the_shadow_epsilon_of_the_other_where_the_gap_is_smaller(name: str) -> None:
    for rung in get(name).rungs:
        near, far = (proof(name, rung).value[f"shadow.L{i}"][:, 0] for i in (0, 1))
        if Fraction(rung) < EPSILON:
            assert far.all()
        else:
            assert (far == near).mean() > 0.9


@pytest.mark.parametrize("name", LIT)
def test_our_renderers_hold_on_gaps_and_have_something_to_say(name: str) -> None:
    for rung in get(name).rungs:
        for renderer in (Native("f64"), Native("f32"), Reference("f64"), Reference("f32")):
            step = measure(proof(name, rung), renderer)
            assert step.careful is not None
            assert not step.broken("careful"), step.says("careful")
            # To the end in float64; in float32 while a gap is some hundred times as large as 64 roundings.
            if (
                renderer.precision == "f64"
                or Fraction(rung) >= Fraction(1, 1000)
                or (name, rung) == ("light-centre", "0")
            ):
                assert step.careful.colors >= 0.8 * SIDE * SIDE


@pytest.mark.parametrize("maker", [Native, Reference])
def test_a_blocker_just_before_the_light_hides_it_in_float32(maker: Any) -> None:
    scene = tracer.loads(JUST_BEFORE)
    assert Prover(scene).pixel(0, 0).values["shadow.L0"][0].value == 0
    margins = ["margin.silhouette", "margin.range"]
    assert all(margin.min() > 0.05 for margin in Reference("f64").render(scene, margins, Settings()).values())
    assert maker("f32").render(scene, ["shadow.L0"], Settings())["shadow.L0"].item() == 0


#: One pixel, its ray along the axis, the light in the eye: a ball hides it that ends 0.8e-7 before it.
JUST_BEFORE = """NEAR 1
LEFT 0
RIGHT 1
BOTTOM -1
TOP 0
RES 1 1
SPHERE wall 0 0 -7 5 5 5 1 1 1 0.25 0.75 0 0 1
SPHERE blocker 0 0 -1e-7 2e-8 2e-8 2e-8 1 1 1 0.25 0.75 0 0 1
LIGHT lamp 0 0 0 1 1 1
BACK 0 0 0
AMBIENT 1 1 1
OUTPUT just-before.ppm
"""


@dataclasses.dataclass(frozen=True)
class Late:
    """Rays begin `beyond` their start, or `beside` it along the normal; those to lights end `short` of them.

    The first two are lengths, `short` is a share of the way. What a ray passes over so does not count.
    """

    beyond: float = 0.0
    beside: float = 0.0
    short: float = 0.0

    def moved(self, x: Any, direction: Any) -> Any:
        """The same rays from where they begin."""
        normal, _ = reference.unit(x.offset)
        step = self.beyond * reference.unit(direction)[0] + self.beside * np.where(x.inside, -normal, normal)
        return dataclasses.replace(x, offset=np.where(x.start >= 0, x.offset + step, x.offset))

    def nearest(self, original: Any, tables: Any, rays: Any, after: float) -> Any:
        """What reflected rays meet."""
        return original(tables, self.moved(rays, rays.direction), after)

    def other_root(self, original: Any, point: Any, direction: Any) -> Any:
        """On the sphere that a ray starts on, of radius 1."""
        t = original(point, direction)
        return np.where(t * np.sqrt(reference.dot(direction, direction)) > self.beyond, t, -1)

    def hidden(self, original: Any, tables: Any, x: Any, to_light: Any, light: int, epsilon: float) -> Any:
        """Whether there is a root on the way to a light, now held against both ends."""
        del original
        begins = self.moved(x, to_light)
        to_light = to_light - (begins.offset - x.offset)
        found = np.zeros(x.start.size, bool)
        for j in tables.distinct:
            o, d = reference.to_unit_space(tables, begins, to_light, j)
            own, line = x.start == j, reference.chord(o, d)
            roots = [np.where(own, reference.other_root(x.point, d), root) for root in (line.near, line.far)]
            if tables.light_side[j, light] == 0:
                # The root at the light is known to be there.
                roots = [np.where(own, 1, (reference.dot(o, o) - 1) / reference.dot(d, d))]
            for t in roots:
                found |= (line.meets | own) & (t > epsilon) & (t < 1 - self.short) & (t != 1)
        return found

    def draw(self) -> Any:
        """The reference with all that."""
        return with_patch(nearest=self.nearest, hidden=self.hidden, other_root=self.other_root)


def falls(name: str, draw: Any) -> str:
    """The first rung with a decision wrong that a careful renderer tells."""
    for rung in get(name).rungs:
        step = measure(proof(name, rung), Double(draw=draw))
        assert step.own is not None  # the claim of a careful renderer in float64
        if step.own.wrong:
            return rung
    return "never"


@pytest.mark.parametrize("name", [*LIT, "inside-mirror"])
def test_rays_that_begin_and_end_where_they_should_fall_nowhere(name: str) -> None:
    assert falls(name, Late().draw()) == "never"


#: What is passed over, by how much, and the rung on which it takes the first decision otherwise.
FALLS = [
    # The blocker's roots are at 1 to 9/8 of the gap, 5/3 of that along the ray.
    ("blocker-surface", {"beyond": 1e-3}, "1e-4"),
    ("blocker-surface", {"beyond": 1e-7}, "1e-8"),
    # A step aside moves the shadow, which is as small as the gap.
    ("blocker-surface", {"beside": 1e-7}, "1e-5"),
    # The only root is at the gap and up to 5/2 of it.
    ("blocker-around", {"beyond": 2e-3}, "1e-3"),
    ("blocker-around", {"beyond": 2e-7}, "1e-7"),
    ("blocker-around", {"beside": 2e-3}, "1e-3"),
    ("blocker-around", {"beside": 2e-7}, "1e-7"),
    # The light is farther than the blocker is from it by 2 / gap.
    ("blocker-light", {"short": 1e-3}, "1e-3"),
    ("blocker-light", {"short": 1e-7}, "1e-7"),
    # A step from one wall to the other; along the rays these are sqrt(gap) apart.
    ("touching", {"beside": 1e-3}, "1e-1"),
    ("touching", {"beside": 1e-7}, "1e-6"),
    ("touching", {"beyond": 1e-3}, "1e-7"),
    # A ray that ends too early, and one that goes on.
    ("light-outside", {"short": 1e-3}, "1e-3"),
    ("light-outside", {"short": -1e-3}, "1e-3"),
    ("light-outside", {"short": -1e-7}, "1e-7"),
    ("light-inside", {"short": 1e-3}, "1e-3"),
    ("light-inside", {"short": 1e-7}, "1e-7"),
    ("light-inside", {"short": -1e-3}, "1e-4"),
    ("light-centre", {"short": 1e-3}, "1e-3"),
    ("light-centre", {"short": 1e-7}, "1e-7"),
    ("mirrors", {"beyond": 1e-3}, "1e-3"),
    ("mirrors", {"beyond": 1e-7}, "1e-7"),
    # Chords inside are 2 sqrt(2 gap) long.
    ("inside-mirror", {"beyond": 1e-3}, "1e-7"),
]


@pytest.mark.parametrize(("name", "late", "rung"), FALLS)
def test_who_passes_over_a_length_falls_off_a_ladder_at_its_rung(name: str, late: Any, rung: str) -> None:
    assert falls(name, Late(**late).draw()) == rung


@pytest.mark.parametrize(
    ("epsilon", "rung"), [(3e-2, "1e-1"), (1e-2, "1e-3"), (1e-3, "1e-4"), (1e-5, "1e-5"), (0.0, "1e-5")]
)
def test_another_shadow_epsilon_falls_off_the_blocker_at_the_surface(epsilon: float, rung: str) -> None:
    assert falls("blocker-surface", with_settings(shadow_epsilon=epsilon)) == rung
