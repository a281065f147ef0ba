"""`whitted explain`: the numbers and words of one pixel, and where renderers with planted defects first differ."""

from __future__ import annotations

import functools
import json
import math
import random
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from conftest import strict
from doubles import Double, with_arrays, with_scene
from rich.console import Console

import tracer
from validation import explain_text, renderers
from validation.cli import main
from validation.explain import Explanation, decision, evenness, explain, order
from validation.explain_text import lines, show
from validation.follow import KINDS, Key
from validation.renderers import Settings, Uncertainty
from validation.run import resized
from validation.truth import Ball

WIDTH = 100

#: All of it can be worked out by hand. The ray of pixel 2 2 goes along -z: it hits `front` at t = 4, is reflected back
#: along +z, and hits `back` behind the eye after 7. `eye` stands where the eye is, `top` is hidden by `blocker`, whose
#: centre is half way between.
PLAIN = """NEAR 1
LEFT -1
RIGHT 1
BOTTOM -1
TOP 1
RES 4 4
SPHERE front 0 0 -5 1 1 1 0.5 1 0.25 0.5 0.5 0 0.5 1
SPHERE blocker 0 1.5 -2.5 0.2 0.2 0.2 1 1 1 0 0 0 0 1
SPHERE back 0 0 4 1 1 1 1 1 1 0.25 0.5 0.5 0 2
SPHERE far 0 0 -10 2 2 2 1 1 1 0 0 0 0 1
LIGHT eye 0 0 0 0.5 0.5 0.5
LIGHT top 0 3 -1 1 1 1
BACK 0.25 0.5 0.75
AMBIENT 0.5 0.5 0.5
OUTPUT plain.ppm
"""

ROOT = Path(__file__).resolve().parents[2]


def text_of(told: Explanation) -> str:
    """The page, with single blanks and without line ends."""
    return " ".join(" ".join(line for line, _ in lines(told)).split())


def at(text: str, x: int = 2, y: int = 2, settings: Settings | None = None, *extra: Any) -> Explanation:
    """Explain a pixel of a scene."""
    scene = tracer.loads(text) if "\n" in text else tracer.load(text)
    return explain(scene, x, y, settings or Settings(), extra, label="scene")


@pytest.fixture(scope="module")
def scenes(root: Path) -> dict[str, tracer.Scene]:
    """The bundled scenes by name."""
    with pytest.warns(tracer.SceneWarning):
        return {path.stem: tracer.load(path) for path in sorted((root / "scenes").rglob("*.txt"))}


# ---- the chain


def test_numbers_that_can_be_worked_out_by_hand() -> None:
    told = at(PLAIN)
    text = text_of(told)
    assert "scene, 4x4" in text
    assert "along (0, 0, -1) exactly" in text
    assert "hits sphere 0 'front' at t = 4 from outside, out again at t = 6" in text
    assert "behind sphere 3 'far' at t = 8 from outside, out again at t = 12" in text
    # blocker: 1.5 from the ray, with a radius of 0.2
    assert "misses sphere 1 'blocker' at 7.5 radii" in text
    assert "point (0, 0, -4), 4 from the eye" in text
    assert "normal (0, 0, 1), outwards" in text
    assert "light 0 'eye': visible; N.L = 1 " in text
    # The way to `top` is sqrt(18) long, and half of it less the radius is free.
    t = 0.5 - 0.2 / math.sqrt(18)
    assert f"light 1 'top': hidden by sphere 1 'blocker' at t = {t:.7g} (0: the point, 1: the light)" in text
    assert f"N.L = {math.sqrt(0.5):.7g}" in text
    assert "ambient 0.125 0.25 0.0625 Ka Ia O" in text
    assert "diffuse, light 0 0.125 0.25 0.0625 Kd Ip (N.L) O" in text
    assert "diffuse, light 1" not in text.partition("REFLECTED")[0]
    assert "the pixel so far 0.25 0.5 0.125" in text
    assert "REFLECTED RAY 1, which counts 0.5" in text
    assert "along (0, 0, 1): d - 2 (d.N) N" in text
    # It starts on `front`, from outside: that sphere is not on its way; nor do the spheres behind it show.
    reflected = text.partition("REFLECTED")[2].partition("PASS BY PASS")[0]
    assert "hits sphere 2 'back' at t = 7 from outside, out again at t = 9" in reflected
    assert "'far'" not in reflected
    assert {entry.sphere for entry in told.bounces[1].crossings} == {1, 2, 3}
    assert "point (0, 0, 3), 7 from the start" in reflected
    assert "0.5 x Ks Ip (R.V)^2" in reflected
    assert "end Kr of sphere 2 'back' is 0, so nothing is reflected." in text
    # From (0, 0, 3) to `top`: L = (0, 3, -4) / 5; both normal and viewer look along -z.
    assert "light 1 'top': visible; N.L = 0.8, R.V = 0.8" in reflected
    terms = 0.125 + 0.25 + (0.5 * 0.8 + 0.5 * 0.64) + (0.25)
    beauty = [0.25 + 0.5 * terms, 0.5 + 0.5 * terms, 0.125 + 0.5 * terms]
    assert [ball.value for ball in told.bounces[-1].total] == pytest.approx(beauty, rel=1e-15)
    assert f"8-bit RGB {', '.join(str(int(min(v, 1) * 255)) for v in beauty)}" in text
    assert "RENDERERS none" in text


@pytest.mark.parametrize(
    ("most", "end", "rays"),
    [
        (0, "a chain has 0 reflected rays at most", 1),
        (1, "Kr of sphere 2 'back' is 0", 2),
        (3, "Kr of sphere 2 'back' is 0", 2),
    ],
)
def test_the_end_of_the_chain(most: int, end: str, rays: int) -> None:
    told = at(PLAIN, settings=Settings(max_reflections=most))
    assert told.end.startswith(end)
    assert len(told.bounces) == rays


def test_a_reflected_ray_that_hits_nothing_adds_black() -> None:
    told = at(PLAIN.replace("0 0 0.25 0.5 0.5 0 2", "9 9 0.25 0.5 0.5 0 2").replace("back 0 0 4", "back 0 9 4"))
    assert told.bounces[-1].sphere == -1
    assert "BACK is for primary rays alone" in text_of(told)
    assert told.bounces[-1].total == told.bounces[0].total


def test_three_reflected_rays(scenes: dict[str, tracer.Scene]) -> None:
    scene = resized(scenes["mirror-corridor"], (40, 40))
    told = explain(scene, 6, 20)
    assert [bounce.bounce for bounce in told.bounces] == [0, 1, 2, 3]
    assert "three reflected rays at most" in told.end
    assert [bounce.sphere for bounce in told.bounces] == [0, 2, 0, 2]
    weights = [scene.spheres[j].kr for j in (0, 2, 0)]
    assert [bounce.weight.value for bounce in told.bounces] == pytest.approx([1, *np.cumprod(weights)])
    for before, after in zip(told.bounces, told.bounces[1:], strict=False):
        d, n, r = (
            np.array([ball.value for ball in vector or ()])
            for vector in (before.direction, before.normal, after.direction)
        )
        assert r == pytest.approx(d - 2 * (d @ n) * n, abs=1e-13)


def test_background(scenes: dict[str, tracer.Scene]) -> None:
    told = explain(resized(scenes["diffuse-only"], (4, 4)), 0, 0)
    text = text_of(told)
    assert "hits nothing" in text
    assert "so the pixel is BACK" in text
    assert told.truth.id == -1
    assert "id -1, nothing" in text
    assert told.levels == tuple(int(v * 255) for v in scenes["diffuse-only"].background)


def test_a_sphere_cut_by_the_near_plane(scenes: dict[str, tracer.Scene]) -> None:
    text = text_of(explain(resized(scenes["cut-by-near-plane"], (4, 4)), 2, 2))
    # The ray (0, 0, -3): a ball of radius 2 about z = -4 is left at t = 2, and entered at t = 2/3.
    assert "hits sphere 0 'bowl' at t = 2 from inside; its root t = 0.6666667 is before the near plane" in text
    assert "normal (0, 0, 1), turned inwards" in text


def test_a_sphere_before_the_near_plane() -> None:
    text = text_of(at(PLAIN.replace("blocker 0 1.5 -2.5", "blocker 0 0 -0.5")))
    assert "no hit sphere 1 'blocker' at t = 0.3 and 0.7: before the near plane" in text


def test_inside_a_sphere(scenes: dict[str, tracer.Scene]) -> None:
    told = explain(resized(scenes["eye-inside"], (40, 40)), 18, 25)
    # The ray (-0.1, -0.25, -1) in the ellipsoid about (1, 0.5, -2) with half axes 5, 4, 6.
    d, p, s = np.array([-0.1, -0.25, -1]), np.array([1, 0.5, -2]), np.array([5, 4, 6])
    A, B, C = (d / s) @ (d / s), -(p / s) @ (d / s), (p / s) @ (p / s) - 1
    near, far = (-B - math.sqrt(B * B - A * C)) / A, (-B + math.sqrt(B * B - A * C)) / A
    text = text_of(told)
    assert f"at t = {far:.7g} from inside; its root t = {near:.7g} is behind the eye" in text
    assert "from inside; its other root is the start of the ray" in text


def test_numbers_close_to_others_keep_their_digits() -> None:
    # From (0, 0, -4) to the light at (0, 4, -4), and a blocker that begins just behind or just before the light.
    one = PLAIN.replace("LIGHT top 0 3 -1", "LIGHT top 0 4 0").replace("blocker 0 1.5 -2.5 0.2 0.2 0.2", "blocker X")
    beyond = text_of(at(one.replace("X", f"0 {4 + 1e-9 + math.sqrt(2)} {math.sqrt(2)} 2 2 2")))
    assert "'top': visible" in beyond
    assert "its ray meets sphere 1 'blocker' at t = 1.000000000" in beyond
    assert "behind the light: does not hide it" in beyond
    hidden = text_of(at(one.replace("X", f"0 {4 - 1e-9 + math.sqrt(2)} {math.sqrt(2)} 2 2 2")))
    assert "hidden by sphere 1 'blocker' at t = 0.999999999" in hidden


@pytest.mark.parametrize(
    ("value", "apart", "text"),
    [
        (0.99997, (1.0,), "0.99997"),
        (0.999999999999, (1.0,), "0.999999999999"),
        (0.999999999999, (), "1"),
        (1.0, (1.0,), "1"),
        (1 / 3, (), "0.3333333"),
        (-12345.678, (), "-12345.68"),
        (1e-9, (), "1e-9"),
        (1.5e100, (), "1.5e100"),
        (0.0, (), "0"),
        (math.inf, (), "inf"),
        (math.nan, (), "nan"),
        (0.0001000000001, (1e-4,), "0.0001000000001"),
    ],
)
def test_digits(value: float, apart: tuple[float, ...], text: str) -> None:
    assert show(value, *apart) == text
    if math.isfinite(value):
        p, q = value.as_integer_ratio()
        assert show(Ball(p, 1 - q.bit_length(), 0.0), *apart) == text


# ---- ties


def test_an_exact_tangent(scenes: dict[str, tracer.Scene]) -> None:
    told = explain(resized(scenes["exact-tangents"], (40, 40)), 20, 7)
    text = text_of(told)
    assert "at t = 3.6, which it only touches" in text
    assert "EXACTLY the primary ray touches sphere 0 'needle' exactly." in text
    assert "The specification: a ray that touches a sphere hits it." in text
    assert "Otherwise the pixel would be (0.2, 0.25, 0.35)" in text
    assert "silhouette 0 the outline of sphere 0 'needle'" in text


def test_equal_hits(scenes: dict[str, tracer.Scene]) -> None:
    text = text_of(explain(resized(scenes["equal-hits"], (50, 50)), 9, 25))
    assert "sphere 1 'large-last' and sphere 0 'small-first' are hit at exactly the same t" in text
    assert "of equal hits the sphere first in the file counts" in text
    assert "order 0 which is nearer" in text


def test_what_is_even_has_no_margin_besides(scenes: dict[str, tracer.Scene]) -> None:
    other = Double(draw=with_arrays(lambda a: a["id"].__setitem__((25, 9), 1)))
    told = explain(resized(scenes["equal-hits"], (50, 50)), 9, 25, Settings(), [other])
    assert "its order margin 0 is below the 7.1e-15 that it can tell" in text_of(told)


def test_ties_stand_at_their_ray(scenes: dict[str, tracer.Scene]) -> None:
    text = text_of(explain(resized(scenes["touching-spheres"], (4, 4)), 2, 2))
    primary, _, reflected = text.partition("PASS BY PASS")[0].partition("REFLECTED RAY 1")
    assert "the primary ray touches sphere 1 'right' exactly" in primary
    assert "the reflected ray 1 touches sphere 1 'right' exactly where it starts" in reflected
    assert text.count("exactly where it starts") == 1
    assert text.count("the primary ray touches sphere 0 'left' exactly") == 1


@pytest.mark.parametrize("what", KINDS)
def test_every_decision_has_words(what: str) -> None:
    scene = tracer.loads(PLAIN)
    keys = [Key(what, bounce, light, 0, 1) for bounce in (0, 2) for light in (-1, 1)]
    if what in ("faces", "shines", "at", "end"):
        keys = [key for key in keys if key.light >= 0]
    if what == "order":
        keys = [key for key in keys if key.light < 0]
    for key in keys:
        for text in (decision(scene, key), evenness(scene, key, Settings())):
            assert text
            assert ("'top'" in text) == (key.light >= 0)
        assert ("reflection 2" in decision(scene, key)) == (key.bounce == 2)


def test_the_decision_that_is_nearest_to_turning() -> None:
    told = at(PLAIN, settings=Settings(max_reflections=0))
    # N.L of `top` is nearer to 0, but that light is hidden by another sphere.
    assert told.calls["terminator"].key[:3] == ("faces", 0, 0)
    assert decision(told.scene, told.calls["terminator"].key) == "the sign of N.L of light 0 'eye' on sphere 0 'front'"
    assert told.calls["order"].key[:4] in (("order", 0, -1, 3), ("order", 0, -1, 0))
    near = explain(doubles.full(), X, Y)
    for kind, call in near.calls.items():
        if near.margins[kind] < 1:
            assert decision(near.scene, call.key) in text_of(near)
    assert {"silhouette", "terminator"} <= set(near.calls)


def test_what_hides_a_light_is_told_from_the_surface_on() -> None:
    # t = 0.3 on the way to `top`, and later in the file than the blocker.
    near = "SPHERE near 0 0.9 -3.1 0.1 0.1 0.1 1 1 1 0 0 0 0 1\n"
    first, second = 0.3 - 0.1 / math.sqrt(18), 0.5 - 0.2 / math.sqrt(18)
    text = text_of(at(PLAIN.replace("LIGHT eye", near + "LIGHT eye")))
    assert f"hidden by sphere 4 'near' at t = {first:.7g} and sphere 1 'blocker' at t = {second:.7g} (0" in text


def test_a_light_on_a_surface(scenes: dict[str, tracer.Scene]) -> None:
    text = text_of(explain(resized(scenes["light-on-surface"], (4, 4)), 2, 2))
    assert "'pole': visible" in text
    assert "it lies on sphere 0 'bowl' exactly, at t = 1, which does not hide it" in text


def test_what_nothing_settles_has_its_outcomes() -> None:
    # Behind the eye a small ball touches a large one from inside, where the reflected ray arrives.
    balls = "SPHERE back 0 0 4 1 1 1 1 1 1 0.25 0.5 0.5 0 2\n"
    other = "SPHERE large 0 0 5 2 2 2 0.25 0.25 0.25 1 0 0 0 1\n"
    told = at(PLAIN.replace(balls, balls + other))
    (tie,) = told.ties
    assert tie.settled == ""
    assert len(tie.outcomes) == 2
    text = text_of(told)
    assert "sphere 3 'large' and sphere 2 'back' are hit at exactly the same t. Nothing settles it" in text
    for outcome in tie.outcomes:
        assert f"({', '.join(show(value) for value in outcome)})" in text


def test_a_light_at_the_point_itself() -> None:
    text = text_of(at(PLAIN.replace("LIGHT top 0 3 -1", "LIGHT top 0 0 -4")))
    assert "light 1 'top' is at the point itself" in text


def test_behind_the_surface_and_own_shadow() -> None:
    text = text_of(at(PLAIN.replace("LIGHT top 0 3 -1", "LIGHT top 0 0 -7")))
    assert "light 1 'top': behind the surface; N.L = -1" in text
    assert "shadow.L1 0, hidden, but behind the surface: not compared" in text


# ---- all scenes


def test_every_scene_reads_well(scenes: dict[str, tracer.Scene]) -> None:
    chosen = random.Random(1)
    for name, whole in scenes.items():
        scene = resized(whole, (23, 19))
        for _ in range(3):
            x, y = chosen.randrange(23), chosen.randrange(19)
            told = explain(scene, x, y, label=name)
            for line, _style in lines(told):
                assert len(line) <= WIDTH
                assert line == line.rstrip()
                assert line.split()[-1:] not in (["="], [">"], ["sphere"], ["light"])
            for ball, exact in zip(told.bounces[-1].total, told.truth.values["beauty"], strict=True):
                assert ball.arb().overlaps(exact.arb())
            assert told.bounces[0].sphere == told.truth.id
            record = strict(json.dumps(told.record(), allow_nan=False))
            assert record["x"] == x
            assert len(record["bounces"]) == len(told.bounces)


def test_the_same_pixel_as_truth_with_other_settings(scenes: dict[str, tracer.Scene]) -> None:
    settings = Settings(sample="center", shadow_epsilon=0.01, max_reflections=2)
    scene = resized(scenes["mirrors"], (40, 40))
    told = explain(scene, 20, 25, settings, [renderers.get("native-f64")])
    assert told.direction != explain(scene, 20, 25).direction
    assert not told.drawn[0].differences
    assert "reflection.3" not in told.truth.values


def test_many_spheres_are_counted() -> None:
    row = "".join(f"SPHERE s{k} 0 0 {-20 - 3 * k} 1 1 1 1 1 1 1 1 0 0 1\n" for k in range(60))
    scene = tracer.loads(PLAIN.replace("LIGHT eye", row + "LIGHT eye"), limits=False)
    text = text_of(explain(scene, 2, 2))
    assert "and 56 other spheres" in text
    assert "'s50'" not in text


def test_a_large_image_has_truth_alone() -> None:
    told = explain(resized(tracer.loads(PLAIN), (5000, 4000)), 2500, 2000, Settings(), [renderers.get("native-f64")])
    assert told.bounces[0].sphere == 0
    assert not told.drawn
    assert "truth alone" in text_of(told)


# ---- renderers


#: On the floor, whose mirror shows the ball and in that the floor again; both lights reach it.
X, Y = 31, 40


def full(*extra: Any, x: int = X, y: int = Y) -> Explanation:
    """The scene with every pass, and renderers."""
    return explain(doubles.full(), x, y, Settings(), extra, label="full")


def changed(name: str, by: Callable[[Any], Any]) -> Callable[..., Any]:
    """A renderer whose pass is wrong at the pixel, and what follows from that."""

    def change(arrays: doubles.Arrays) -> None:
        arrays[name][Y, X] = by(arrays[name][Y, X])

    return with_arrays(change, recompose=True)


def sphere(number: int, **changes: Any) -> Callable[[tracer.Scene], tracer.Scene]:
    """Another scene: a sphere has other numbers."""

    def other(scene: tracer.Scene) -> tracer.Scene:
        spheres = list(scene.spheres)
        spheres[number] = spheres[number].replace(**changes)
        return scene.replace(spheres=spheres)

    return other


def test_the_pixel_of_the_defects_shows_everything() -> None:
    told = full()
    assert [bounce.sphere for bounce in told.bounces][:3] == [2, 0, 2]
    assert [seen.state for seen in told.bounces[0].lights] == ["visible", "visible"]
    assert told.truth.values["specular"][0].value > 1e-7
    assert told.truth.values["reflection.2"][0].value > 0.1


def test_no_difference_is_said() -> None:
    told = full(Double(), renderers.get("numpy-f32"))
    assert [entry.differences for entry in told.drawn] == [(), ()]
    text = text_of(told)
    assert "agree no difference beyond what it may be off by: double, numpy-f32" in text
    assert "first difference" not in text
    assert f"8-bit RGB {', '.join(map(str, told.levels))}, also double" in text


DEFECTS = {
    "other sphere": (
        changed("id", lambda _: 1),
        "id",
        "double says sphere 1 'egg', truth says sphere 2 'floor' at t =",
    ),
    "no sphere": (changed("id", lambda _: -1), "id", "double says nothing, truth says sphere 2 'floor' at t ="),
    "far away": (changed("depth", lambda v: v * 1.001), "depth", "off by "),
    "turned": (changed("normal", lambda v: -v), "normal", "it points the other way"),
    "bent": (changed("normal", lambda v: v + 0.01), "normal", "off by 0.017"),
    "brighter": (changed("ambient", lambda v: v * 1.01), "ambient", "off by "),
    "mirror": (changed("reflection.1", lambda v: v + 0.25), "reflection.1", "off by 0.25"),
    "second mirror": (changed("reflection.2", lambda v: v + 0.25), "reflection.2", "off by 0.25"),
    "no number": (changed("diffuse", lambda v: v * math.nan), "diffuse", "says (nan, nan, nan)"),
    "Kd": (with_scene(sphere(2, kd=0.8)), "diffuse", "off by "),
    "Ks": (with_scene(sphere(2, ks=0.2)), "specular", "off by "),
    "Kr": (with_scene(sphere(2, kr=0.8)), "reflection.1", "off by "),
    "Kr of the second": (with_scene(sphere(0, kr=0.5)), "reflection.2", "off by "),
    "color": (with_scene(sphere(2, color=(0.5, 0.6, 0.5))), "ambient", "off by "),
    "sum": (
        with_arrays(lambda arrays: arrays["beauty"].__setitem__((Y, X), 0.125)),
        "beauty",
        "says (0.125, 0.125, 0.125)",
    ),
}


@pytest.mark.parametrize(("draw", "first", "says"), DEFECTS.values(), ids=DEFECTS)
def test_the_first_difference_is_named(draw: Callable[..., Any], first: str, says: str) -> None:
    told = full(Double(draw=draw))
    (entry,) = told.drawn
    assert entry.differences[0].name == first
    text = text_of(told)
    assert f"first difference: {first}: " in text
    assert says in text.partition("first difference: ")[2]
    marked = [line for line, _ in lines(told) if "<- first difference" in line]
    assert len(marked) == 1
    place = [line for line, _ in lines(told)].index(marked[0])
    assert [line for line, _ in lines(told)][place - 1].split()[0] == first
    assert not entry.differences[0].edge


def test_a_wrong_shadow_names_what_hides_the_light() -> None:
    told = at(PLAIN, 2, 2, None, Double(draw=with_arrays(lambda a: a["shadow.L1"].__setitem__((2, 2), 1))))
    t = 0.5 - 0.2 / math.sqrt(18)
    says = "shadow.L1: double says visible, truth says hidden by sphere 1 'blocker' at t ="
    assert f"first difference: {says} {t:.7g}" in text_of(told)
    told = at(PLAIN, 2, 2, None, Double(draw=with_arrays(lambda a: a["shadow.L0"].__setitem__((2, 2), 0))))
    assert "shadow.L0: double says hidden, truth says visible" in text_of(told)


def test_a_shadow_on_the_dark_side_is_not_compared() -> None:
    behind = PLAIN.replace("LIGHT top 0 3 -1", "LIGHT top 0 0 -7")
    told = at(behind, 2, 2, None, Double(draw=with_arrays(lambda a: a["shadow.L1"].__setitem__((2, 2), 1))))
    assert not told.drawn[0].differences


def test_what_is_no_value_of_a_miss() -> None:
    def wrong(arrays: doubles.Arrays) -> None:
        arrays["shadow.L0"][0, 0] = 1
        arrays["position"][0, 0, 0] = 2

    told = full(Double(draw=with_arrays(wrong)), x=0, y=0)
    assert told.truth.id == -1
    assert [difference.name for difference in told.drawn[0].differences] == ["position", "shadow.L0"]


def test_differences_on_an_edge_say_so() -> None:
    claim = Uncertainty(0.5, 1e-9, 1e-9, 2.0, 1e-9)
    told = full(Double(draw=changed("id", lambda _: 1), claim=claim))
    assert "An edge, where double may differ: its silhouette margin " in text_of(told)
    assert "is below the 0.5 that it can tell" in text_of(told)
    assert told.drawn[0].differences[0].edge[-1][0] != "terminator"  # not behind the pass `id`
    told = full(Double(draw=changed("diffuse", lambda v: v * 2), claim=claim))
    assert "it claims to tell no terminator decision here" in text_of(told)
    assert told.drawn[0].differences[0].edge[0][0] == "silhouette"


def test_one_level_more_may_be_a_rounding() -> None:
    # BACK is a little below 128 / 255; a renderer that has it a little above is right, and one level off.
    level = 128 / 255

    def nearly(arrays: doubles.Arrays) -> None:
        arrays["beauty"][2, 2, 1] = math.nextafter(level, 1)

    away = PLAIN.replace("front 0 0 -5", "front 0 90 -5").replace("far 0 0 -10", "far 0 90 -10")
    scene = away.replace("BACK 0.25 0.5 0.75", f"BACK 0.25 {math.nextafter(level, 0)!r} 0.75")
    told = at(scene, 2, 2, None, Double(draw=with_arrays(nearly)))
    assert (told.truth.id, told.levels[1]) == (-1, 127)
    assert told.drawn[0].levels == (63, 128, 191)
    assert not told.drawn[0].differences
    assert "double: 63, 128, 191 (within its tolerance: a rounding before the truncation)" in text_of(told)


def smaller(scene: tracer.Scene, passes: Any, settings: Settings) -> Any:
    return doubles.faithful(resized(scene, (3, 3)), passes, settings)


def breaks(*_: Any) -> Any:
    raise ValueError("lost")


@pytest.mark.parametrize(
    ("double", "says", "failed"),
    [
        (Double(absent="no such program: get it"), "double is not available: no such program: get it", False),
        (Double(refuses=True), "double cannot carry this scene", False),
        (Double(limit=100), "double would take too long at 64x48: it draws up to 100 pixels", False),
        (Double(draw=breaks), "double failed: ValueError: lost", True),
        (Double(draw=lambda *_: None), "double failed: it returned NoneType, expected Passes", True),
        (Double(draw=smaller), "double failed: it did not deliver the pass 'beauty' of the size of the scene", True),
    ],
    ids=["absent", "refuses", "slow", "breaks", "nothing", "smaller"],
)
def test_renderers_that_do_not_draw_have_a_line(double: Double, says: str, failed: bool) -> None:
    told = full(double, Double(name="other"))
    assert f"not drawn {says}" in text_of(told)
    assert told.failed == failed
    assert "agree no difference beyond what it may be off by: other" in text_of(told)


def test_a_scene_that_float32_does_not_hold() -> None:
    scene = tracer.loads(doubles.CUT.replace("SPHERE shell 0.1 ", "SPHERE shell 1e20 "))
    told = explain(scene, 3, 3, Settings(), [renderers.get("native-f32"), renderers.get("native-f64")])
    assert "not drawn native-f32 cannot carry this scene: SPHERE: found '1e+20'" in text_of(told)
    assert not told.failed


def test_a_pass_that_a_renderer_lacks_is_not_compared() -> None:
    told = full(Double(draw=changed("depth", lambda v: v * 2), missing=("depth", "id")))
    assert not told.drawn[0].differences


def test_the_record_names_the_first_difference() -> None:
    told = full(Double(draw=changed("diffuse", lambda v: v * math.nan)))
    record = strict(json.dumps(told.record(), allow_nan=False))
    (entry,) = record["renderers"]
    assert entry["first_difference"] == "diffuse"
    assert entry["values"]["diffuse"] == ["nan", "nan", "nan"]
    assert entry["agrees"] is False
    assert record["truth"]["depth"] == [told.truth.values["depth"][0].value]
    x, y, z = record["direction"]
    assert (x, y, z) == ("-1/32", "-1/2", "-1")
    lights = record["bounces"][0]["lights"]
    assert [light["state"] for light in lights] == [seen.state for seen in told.bounces[0].lights]


def test_the_order_of_computation() -> None:
    names = order(2, 2)
    assert set(names) == set(tracer.passes.names(2, 2, margins=False))
    places = ["id", "depth", "normal", "ambient", "shadow.L0", "shadow.L1", "diffuse", "reflection.1", "beauty"]
    assert [name for name in names if name in places] == places


# ---- the command


@pytest.fixture
def run(run: Any) -> Any:
    """Run `whitted explain` in this process."""
    return functools.partial(run, "explain")


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A scene file in the current folder."""
    monkeypatch.chdir(tmp_path)
    Path("full.txt").write_text(doubles.FULL)
    return "full.txt"


def test_the_command_shows_all_renderers(run: Any, scene: str, registered: Any) -> None:
    registered(Double(), Double(name="absent", absent="get it"), Double("odd", changed("id", lambda _: 1)), alone=True)
    result = run(scene, X, Y)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("full.txt, 64x48\n")
    assert "not drawn absent is not available: get it" in result.out
    assert "differs   odd: first difference: id: odd says sphere 1 'egg'" in result.out
    assert "\x1b" not in result.out
    narrowed = run(scene, X, Y, "--renderer", "double")
    assert "odd" not in narrowed.out
    assert "absent" not in narrowed.out


def test_the_command_writes_strict_json(run: Any, scene: str, tmp_path: Path) -> None:
    file = tmp_path / "pixel.json"
    result = run(scene, X, Y, "--renderer", "native-f64", "--size", "65x49", "--max-reflections", 1, "--json", file)
    assert result.status == 0
    record = strict(file.read_text())
    assert record["size"] == [65, 49]
    assert record["settings"]["max_reflections"] == 1
    assert (record["x"], record["y"]) == (X, Y)
    assert record["renderers"][0]["agrees"] is True
    assert f"x {X}, y {Y}" in result.out


def test_a_renderer_that_fails_is_status_3(run: Any, scene: str, registered: Any) -> None:
    registered(Double(draw=breaks), alone=True)
    result = run(scene, X, Y)
    assert result.status == 3
    assert "PRIMARY RAY" in result.out
    assert "double failed: ValueError: lost" in result.out


def test_where_nobody_asked_for_draws_it_is_said(run: Any, scene: str, registered: Any) -> None:
    registered(Double(name="slow", limit=768), Double(name="absent", absent="get it"))
    result = run(scene, X, Y, "--renderer", "slow", "--json", "pixel.json")
    assert result.status == 3
    assert "PRIMARY RAY" in result.out, "truth is there nonetheless"
    assert result.err == (
        "error: slow would take too long at 64x48: it draws up to 768 pixels of this scene\n"
        "  hint: --size 32x24 is small enough; the columns and rows are then others\n"
    )
    assert strict(Path("pixel.json").read_text())["renderers"][0]["drawn"] is False
    both = run(scene, X, Y, "--renderer", "absent,slow")
    assert both.status == 3
    assert both.err.startswith("error: absent is not available: get it; slow would take too long")
    assert run(scene, X, Y, "--renderer", "slow,native-f64").status == 0
    assert run(scene, 10, 10, "--renderer", "slow", "--size", "32x24").status == 0


@pytest.mark.parametrize(
    ("words", "message", "hint"),
    [
        ("full.txt 64 0", "full.txt has no pixel 64 0", "columns are 0 to 63 from the left, rows 0 to 47 from the top"),
        ("full.txt 0 48", "full.txt has no pixel 0 48", "columns are 0 to 63"),
        ("full.txt 30 20 --size 20x30", "full.txt has no pixel 30 20", "columns are 0 to 19"),
        ("full.txt -1 0", "'-1' is no column or row of an image", "from 0 at the top left: whitted explain SCENE X Y"),
        ("full.txt 1.5 0", "X: '1.5' is no column or row of an image", "whitted explain SCENE X Y"),
        ("full.txt 1 two", "Y: 'two' is no column or row of an image", "whitted explain SCENE X Y"),
        ("full.txt other.txt 1 2", "X: 'other.txt' is no column or row of an image", "one scene"),
        ("full.txt 1 2 3", "'3' is one word too many", "one pixel at a time"),
        ("full.txt 1", "missing argument 'Y'", "whitted explain --help"),
        ("full.txt 1 2 --renderer native-f46", "unknown renderer 'native-f46'", "did you mean 'native-f64'?"),
        ("full.txt 1 2 --json no/where.json", "no/where.json: there is no folder no", "mkdir -p no"),
        ("full.txt 1 2 --threads -1", "--threads: '-1' is not a whole number", "whitted explain --help"),
    ],
)
def test_wrong_words(words: str, message: str, hint: str, run: Any, scene: str) -> None:
    del scene
    result = run(*words.split())
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith(f"error: {message}")
    assert f"\n  hint: {hint}" in result.err or (hint in result.err.partition("\n  hint: ")[2])


@pytest.mark.parametrize(
    ("words", "message"),
    [(". 1 2", ".: error: this is a folder, expected a scene file"), ("none.txt 1 2", "none.txt: error: no such file")],
)
def test_wrong_files(words: str, message: str, run: Any, scene: str) -> None:
    del scene
    result = run(*words.split())
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith(message)


def test_a_long_name_is_not_broken(run: Any, tmp_path: Path) -> None:
    path = tmp_path / ("long-" * 30 + "name.txt")
    path.write_text(PLAIN)
    result = run(path, 2, 2, "--renderer", "native-f64")
    assert result.out.startswith(f"{path}, 4x4\n")
    assert max(map(len, result.out.splitlines()[1:])) <= WIDTH


def test_colours_are_for_terminals(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    told = full(Double("odd", changed("id", lambda _: 1)))
    monkeypatch.delenv("NO_COLOR", raising=False)
    color = {"force_terminal": True, "color_system": "standard", "width": 120}
    monkeypatch.setattr(explain_text, "console", lambda: Console(**color))
    explain_text.print_explanation(told)
    assert "\x1b[31m" in capsys.readouterr().out
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(explain_text, "console", lambda: Console(**color))
    explain_text.print_explanation(told)
    assert "\x1b[31m" not in capsys.readouterr().out


def test_what_another_setting_changes_is_told() -> None:
    told = at(PLAIN, 2, 2, replace(Settings(), shadow_epsilon=0.99))
    assert "its ray meets sphere 1 'blocker' at t = 0.4528595, which is not above 0.99" in text_of(told)


def test_powers_too_small_for_any_float_are_0() -> None:
    # R.V = 0.8 in the mirror, to a power that no float64 holds; nor has its exponent few digits.
    for exponent in ("99999", "1e15", "1e300"):
        told = at(PLAIN.replace("0.25 0.5 0.5 0 2", f"0.25 0.5 0.5 0 {exponent}"))
        seen = told.bounces[1].lights[1]
        assert seen.specular is not None
        assert [show(ball) for ball in seen.specular] == ["0", "0", "0"]
        strict(json.dumps(told.record(), allow_nan=False))
        assert max(len(line) for line, _ in lines(told)) <= WIDTH


def test_rules_that_fail_are_a_failure_of_the_renderer(run: Any, scene: str, registered: Any) -> None:
    class Ruled(Double):
        def rules(self, *_: Any) -> Any:
            raise KeyError("lost")

    registered(Ruled("odd", changed("id", lambda _: 1)))
    result = run(scene, X, Y, "--renderer", "odd")
    assert (result.status, result.err) == (3, "")
    assert "first difference: id: odd says sphere 1 'egg'" in result.out
    assert "No verdict: its rules failed: KeyError: 'lost'." in result.out


def test_a_size_that_is_too_large_is_said_once(run: Any, scene: str, registered: Any) -> None:
    size = ("--size", "4000x3000")
    asked = run(scene, 5, 5, *size, "--renderer", "native-f64")
    assert asked.status == 3
    assert asked.err == (
        "error: 4000x3000 pixels take too long to draw: truth alone\n"
        "  hint: --size 2309x1732 is small enough; the columns and rows are then others\n"
    )
    assert "note" not in asked.out
    registered(Double(name="slow", limit=768))
    assert "  hint: --size 32x24 is small enough" in run(scene, 5, 5, *size, "--renderer", "slow,native-f64").err
    every = run(scene, 5, 5, *size)
    assert (every.status, every.err) == (0, "")
    assert "truth alone; --size 2309x1732 is small enough" in " ".join(every.out.split())


def test_passes_of_many_bounces_are_told_together(run: Any, scene: str) -> None:
    text = " ".join(run(scene, 0, 0, "--renderer", "native-f64", "--max-reflections", 99).out.split())
    assert "reflection.1 to .99, reflection" in text
    assert "reflection.2" not in text


def test_bytes_of_a_program_are_held_as_the_program_makes_them(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    program = tmp_path / "rounds.py"
    program.write_text(
        "import sys, numpy, tracer\n"
        "color = tracer.render(tracer.load(sys.argv[1]), ['beauty'])['beauty'].clip(0, 1)\n"
        "levels = numpy.rint(color[::-1] * 255).astype('u1')\n"
        "sys.stdout.buffer.write(b'P6 %d %d 255\\n' % levels.shape[1::-1] + levels.tobytes())\n"
    )
    scene = ROOT / "scenes" / "gallery" / "shadows.txt"
    name = f"cmd:{sys.executable} {program} {{scene}}"
    words = ["explain", str(scene), "20", "30", "--size", "60x40", "--renderer", name]

    def told(*options: str) -> tuple[str, Any]:
        with pytest.raises(SystemExit):
            main([*words, *options, "--json", str(tmp_path / "told.json")])
        (entry,) = json.loads((tmp_path / "told.json").read_text())["renderers"]
        return capsys.readouterr().out, entry

    text, entry = told("--quantisation", "round", "--flipped")
    assert entry["agrees"], text
    assert entry["quantisation"] == "round"
    assert not told("--flipped")[1]["agrees"]
    assert not told("--quantisation", "round")[1]["agrees"]
    mirrors = str(ROOT / "scenes" / "gallery" / "mirrors.txt")
    program.write_text(program.read_text().replace("['beauty'])", "['beauty'], max_reflections=1)"))
    command = ["check", mirrors, "--size", "60x40", "--command", name.removeprefix("cmd:")]
    with pytest.raises(SystemExit):
        main([*command, "--report", str(tmp_path / "report")])
    page = (tmp_path / "report" / "index.html").read_text()
    assert page.count("--quantisation round --flipped --size 60x40</code>") > 3
    assert '"options": "--quantisation round --flipped --size 60x40"' in page
