"""The judge against an independent program, against values worked out by hand, and against the published images.

`oracle.py` computes a pixel in another way, with 60 digits to spare. What is left of them: a chord that is as short as
two numbers that differ by one rounding in 2^52 can make it costs half of its 32 leading zeros, 16 digits, and what the
scene's spread of sizes and the exponents cost the oracle adds by itself. So 1e-35 of the magnitude bounds its error.
"""

from __future__ import annotations

import ast
import functools
import itertools
import math
import pickle
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import doubles
import flint
import numpy as np
import oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath.libmp import to_rational
from PIL import Image
from strategies import scenes

import tracer
import tracer.errors
import tracer.reference
from tracer import Light, Scene, Sphere, View
from tracer.passes import SAMPLES, names, quantise
from validation import truth as proving
from validation.follow import Follower
from validation.renderers import Settings
from validation.rules import MISTAKES
from validation.truth import Ball, Prover, Truth, prove

ROOT = Path(__file__).resolve().parent.parent.parent
Vec3 = tuple[float, float, float]

#: The most that a radius may be, times the value where that is more than 1.
BAR = 1e-30
#: The error of the oracle, times the magnitude of a value.
ORACLE = Fraction(1, 10**35)


# Balls as rational numbers


def bounds(ball: Ball) -> tuple[Fraction, Fraction]:
    """The ends of a ball, exactly."""
    middle, radius = (_dyadic(part) for part in (ball.arb().mid(), ball.arb().rad()))
    return middle - radius, middle + radius


def _dyadic(number: flint.arb) -> Fraction:
    mantissa, exponent = number.man_exp()
    return int(mantissa) * Fraction(2) ** int(exponent)


def rational(number: Any) -> Fraction:
    """A number of mpmath, exactly."""
    return Fraction(int(number)) if isinstance(number, int) else Fraction(*to_rational(number._mpf_))


def total(balls: Sequence[Ball]) -> tuple[Fraction, Fraction]:
    """The ends of a sum."""
    ends = [bounds(ball) for ball in balls]
    return sum((low for low, _ in ends), Fraction(0)), sum((high for _, high in ends), Fraction(0))


def proved(truth: Truth, lights: int, max_reflections: int) -> None:
    """What holds for every pixel: all passes, small radii, sums of their parts, an id that is an integer."""
    expected = names(lights, max_reflections, margins=False)
    assert sorted(truth.values) == sorted(expected)
    for name in expected:
        balls = truth.values[name]
        assert isinstance(balls, tuple)
        assert len(balls) == (1 if name in ("depth", "id") or name.startswith("shadow.") else 3), name
        for ball in balls:
            assert not math.isnan(ball.value), name
            assert 0 <= ball.radius <= BAR * max(1, abs(ball.value)), (name, ball)
            if math.isinf(ball.value):
                assert (name, truth.id, ball.radius) == ("depth", -1, 0)
                continue
            low, high = bounds(ball)
            # The radius of an arb has 30 bits: rounded up once more.
            assert (high - low) / 2 <= Fraction(ball.radius) * (1 + Fraction(1, 2**24)), name
            assert ball.value == float((low + high) / 2), name
    assert truth.values["id"][0].value == truth.id
    assert truth.values["id"][0].radius == 0
    for name in (f"shadow.L{i}" for i in range(lights)):
        assert truth.values[name][0].value in (0, 1)
        assert truth.values[name][0].radius == 0
    parts = {
        "direct": ("diffuse", "specular"),
        "reflection": tuple(f"reflection.{k}" for k in range(1, max_reflections + 1)),
    }
    if truth.id >= 0:
        parts["beauty"] = ("ambient", "direct", "reflection")
    for whole, names_of_parts in parts.items():
        for k, ball in enumerate(truth.values[whole]):
            low, high = total([truth.values[name][k] for name in names_of_parts])
            own_low, own_high = bounds(ball)
            assert own_low <= high, whole
            assert low <= own_high, whole


def differences(truth: Truth, expected: dict[str, tuple[Any, ...]], *, absolute: bool = True) -> list[str]:
    """Where truth and oracle are farther apart than the radius and the oracle's own error; empty: nowhere.

    `absolute`: the error of the oracle counts against 1 where a value is less.
    """
    found = []
    for name, values in expected.items():
        finite = [rational(value) for value in values if value != float("inf")]
        scale = max([abs(value) for value in finite] + [Fraction(1 if absolute else 0)])
        for k, (ball, value) in enumerate(zip(truth.values[name], values, strict=True)):
            if value == float("inf") or math.isinf(ball.value):
                apart = ball.value != value
            else:
                low, high = bounds(ball)
                apart = not low - ORACLE * scale <= rational(value) <= high + ORACLE * scale
            if apart:
                found.append(f"{name}[{k}]: truth {ball.value!r} +- {ball.radius}, oracle {value}")
    return found


def agree(scene: Scene, column: int, row: int, *, digits: int = 60, absolute: bool = True, **changes: Any) -> Truth:
    """Prove a pixel and compare every pass with the oracle."""
    chosen = Settings(**changes)
    truth = prover(scene, chosen).pixel(column, row)
    assert (truth.x, truth.y) == (column, row)
    proved(truth, len(scene.lights), chosen.max_reflections)
    expected = oracle.pixel(
        scene,
        column,
        row,
        sample=chosen.sample,
        shadow_epsilon=chosen.shadow_epsilon,
        max_reflections=chosen.max_reflections,
        digits=digits,
    )
    assert differences(truth, expected, absolute=absolute) == []
    return truth


@functools.lru_cache(maxsize=64)
def prover(scene: Scene, chosen: Settings) -> Prover:
    """One prover for all pixels of a scene."""
    return Prover(scene, chosen)


@functools.cache
def bundled(name: str) -> Scene:
    """A scene of ours."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tracer.errors.SceneWarning)  # of duplicate-spheres
        return tracer.load(ROOT / "scenes" / f"{name}.txt")


# The oracle itself


@pytest.mark.parametrize("make", [doubles.full, doubles.cut, doubles.contact, doubles.cave], ids=lambda f: f.__name__)
def test_the_oracle_agrees_with_the_reference(make: Any) -> None:
    # Two programs of which neither knows the other, so far as float64 goes.
    scene = make()
    every = names(len(scene.lights), margins=False)
    image = tracer.reference.render(scene, every)
    random = np.random.default_rng(3)
    for _ in range(25):
        column, row = (int(random.integers(size)) for size in (scene.view.columns, scene.view.rows))
        seen = oracle.pixel(scene, column, row)
        assert sorted(seen) == sorted(every)
        for name in every:
            value = [float(number) for number in seen[name]]
            assert value == pytest.approx(np.atleast_1d(image[name][row, column]).tolist(), rel=1e-9, abs=1e-10), name


@pytest.mark.parametrize("place", [("gallery/hall", 143, 173), ("spec/exact-tangents", 200, 70)], ids=lambda p: p[0])
def test_more_digits_do_not_change_the_oracle(place: tuple[str, int, int]) -> None:
    name, column, row = place
    few, many = (oracle.pixel(bundled(name), column, row, digits=digits) for digits in (60, 120))
    for key, values in many.items():
        for one, other in zip(few[key], values, strict=True):
            assert one == other or abs(rational(one) - rational(other)) <= ORACLE, key


# Pixels picked by hand. Those called nearest have the smallest margin of their scene.

PIXELS: list[tuple[str, int, int, str, dict[str, Any]]] = [
    ("gallery/hall", 143, 173, "bright after three mirrors", {}),
    ("gallery/hall", 143, 173, "no mirrors at all", {"max_reflections": 0}),
    ("gallery/hall", 143, 173, "one mirror", {"max_reflections": 1}),
    ("gallery/hall", 143, 173, "two mirrors", {"max_reflections": 2}),
    ("gallery/hall", 143, 173, "four mirrors", {"max_reflections": 4}),
    ("gallery/hall", 143, 173, "five mirrors", {"max_reflections": 5}),
    ("gallery/hall", 350, 63, "nearest outline, in a mirror, from inside an ellipsoid", {}),
    ("gallery/hall", 231, 195, "nearest terminator, in a mirror", {}),
    ("gallery/hall", 227, 153, "nearest order of two hits", {}),
    ("gallery/hall", 192, 192, "highlight with n = 200", {}),
    ("gallery/lantern", 244, 99, "cut by the near plane, on the rim", {}),
    ("gallery/lantern", 213, 92, "nearest outline, cut by the near plane", {}),
    ("gallery/lantern", 250, 139, "nearest terminator", {"shadow_epsilon": 1e-3}),
    ("gallery/lantern", 241, 236, "inside of the bowl, three mirrors", {}),
    ("gallery/lantern", 147, 279, "a pearl before the bowl", {"sample": "center"}),
    ("gallery/mirrors", 135, 192, "three mirrors three deep", {}),
    ("gallery/mirrors", 49, 314, "nearest outline", {}),
    ("gallery/mirrors", 163, 277, "nearest terminator", {}),
    ("gallery/mirrors", 163, 280, "nearest order, where two balls meet", {"max_reflections": 5}),
    ("gallery/mirrors", 77, 126, "highlight with n = 120", {"sample": "inclusive"}),
    ("gallery/nested", 69, 284, "shells: nearest outline", {}),
    ("gallery/nested", 154, 39, "shells: nearest end of the range", {}),
    ("gallery/nested", 234, 164, "shells: nearest terminator", {"shadow_epsilon": 1e-3}),
    ("gallery/planets", 303, 296, "outline of the shadow on the ice moon", {}),
    ("gallery/planets", 141, 210, "ring into giant", {"sample": "bottom-left"}),
    ("gallery/plates", 205, 148, "flat ellipsoid, 1 to 20", {}),
    ("gallery/plates", 206, 221, "needle through a plate", {}),
    ("gallery/plates", 287, 358, "nearest terminator of a plate", {}),
    ("gallery/shadows", 366, 262, "border of an umbra on the floor", {}),
    ("gallery/shadows", 91, 207, "inside a ball's shadow border", {"shadow_epsilon": 1e-3}),
    ("gallery/shadows", 313, 120, "terminator of a tall ellipsoid", {}),
    ("gallery/sunset", 96, 231, "very flat mirror that sees the sky", {}),
    ("gallery/sunset", 230, 244, "very flat mirror that sees the far sun", {"max_reflections": 4}),
    ("gallery/sunset", 122, 242, "highlight on a sea seen at a low angle", {}),
    ("spec/before-near-plane", 147, 294, "border of the shadow of what is not seen", {}),
    ("spec/before-near-plane", 336, 52, "nearest end of the range", {}),
    ("spec/behind-eye", 214, 129, "outline of what is behind the eye, in a mirror", {}),
    ("spec/beyond-light", 0, 340, "N.L = 0 but for rounding", {}),
    ("spec/beyond-light", 304, 273, "a sphere beyond the light", {}),
    ("spec/cut-by-near-plane", 192, 27, "the rim of the cut", {}),
    ("spec/cut-by-near-plane", 210, 179, "the bowl in itself, three times", {}),
    ("spec/diffuse-only", 245, 109, "terminator within one rounding", {}),
    ("spec/duplicate-spheres", 200, 200, "the first of two in one place", {}),
    ("spec/duplicate-spheres", 280, 195, "the other sphere sees the first of two", {}),
    ("spec/equal-hits", 72, 200, "equal t: the small one is first in the file", {}),
    ("spec/equal-hits", 328, 200, "equal t: the large one is first in the file", {}),
    ("spec/exact-tangents", 150, 80, "touches exactly", {}),
    ("spec/exact-tangents", 80, 250, "touches exactly, N.L nearly 0", {}),
    ("spec/exact-tangents", 88, 266, "touches exactly and the light grazes", {}),
    ("spec/exact-tangents", 200, 70, "touches within one rounding", {}),
    ("spec/exponent-0", 245, 109, "n = 0 at the terminator", {}),
    ("spec/exponent-0", 247, 135, "n = 0 within a highlight", {}),
    ("spec/exponent-half", 193, 175, "n = 1/2", {}),
    ("spec/exponent-half", 245, 109, "n = 1/2 at the terminator", {}),
    ("spec/exponent-1000", 158, 161, "n = 1000 in the highlight", {}),
    ("spec/exponent-1000", 230, 230, "n = 1000 far from the highlight", {}),
    ("spec/eye-inside", 172, 182, "inside a sphere, seven mirrors", {"max_reflections": 7}),
    ("spec/eye-inside", 119, 75, "inside a sphere, nearest terminator", {}),
    ("spec/light-at-centre", 200, 200, "N.L = 1 and R.V = 1", {}),
    ("spec/light-at-centre", 180, 28, "near the rim", {}),
    ("spec/light-before-near-plane", 100, 176, "the light is not in the view", {}),
    ("spec/light-inside", 260, 140, "the shadow ray meets a sphere at the light", {}),
    ("spec/light-inside", 20, 140, "within one rounding of the end of the range", {}),
    ("spec/light-on-surface", 200, 84, "the inside, lit by a light on it", {}),
    ("spec/light-on-surface", 125, 55, "the other sphere grazed by that light", {}),
    ("spec/mirror-corridor", 11, 193, "three mirrors between two walls", {}),
    ("spec/mirror-corridor", 176, 195, "nearest outline between two walls", {"max_reflections": 5}),
    ("spec/negative-light", 170, 289, "terminator of a negative light", {}),
    ("spec/negative-light", 230, 240, "lit by a negative light", {}),
    ("spec/negative-scalings", 148, 161, "negative scalings", {}),
    ("spec/no-lights", 284, 94, "no lights, an outline within one rounding", {}),
    ("spec/no-spheres", 0, 399, "no spheres", {}),
    ("spec/non-square-pixels", 198, 282, "pixels that are not square", {"sample": "center"}),
    ("spec/off-centre-frustum", 193, 291, "a frustum off the centre, corner", {"sample": "corner"}),
    ("spec/off-centre-frustum", 193, 291, "a frustum off the centre, centre", {"sample": "center"}),
    ("spec/off-centre-frustum", 193, 291, "a frustum off the centre, bottom-left", {"sample": "bottom-left"}),
    ("spec/off-centre-frustum", 193, 291, "a frustum off the centre, inclusive", {"sample": "inclusive"}),
    ("spec/one-pixel", 0, 0, "one pixel, inclusive", {"sample": "inclusive"}),
    ("spec/over-range", 158, 161, "brighter than 1", {}),
    ("spec/over-range", 0, 0, "background beyond 0 to 1", {}),
    ("spec/own-shadow", 316, 160, "terminator of a light behind", {}),
    ("spec/own-shadow", 200, 200, "in its own shadow", {}),
    ("spec/own-shadow-inside", 192, 27, "the inside hides an outside light", {}),
    ("spec/reflected-miss", 213, 187, "a mirror that sees nothing", {}),
    ("spec/shadow-epsilon", 207, 280, "border of a shadow that starts at its blocker", {}),
    ("spec/shadow-epsilon", 207, 280, "the same, epsilon 1e-3", {"shadow_epsilon": 1e-3}),
    ("spec/shadow-epsilon", 207, 280, "the same, no epsilon", {"shadow_epsilon": 0.0}),
    ("spec/shadow-of-another", 156, 208, "end of the range within one rounding", {}),
    ("spec/shadow-of-another", 160, 220, "terminator within one rounding", {}),
    ("spec/shadow-of-another", 200, 200, "N.L is 0 exactly", {}),
    ("spec/shadow-of-another", 180, 160, "outline within one rounding", {}),
    ("spec/touching-spheres", 200, 200, "the ray touches two spheres where they touch", {}),
    ("spec/touching-spheres", 173, 141, "near where two spheres touch", {}),
    ("spec/touching-spheres", 222, 155, "mirrors that touch", {"max_reflections": 5}),
    ("spec/wide-image", 232, 30, "just beside a sphere", {}),
]

KEY_PIXELS: list[tuple[str, int, int, str]] = [
    ("Sample", 300, 300, "lit from the eye"),
    ("Sample", 339, 245, "border of a shadow"),
    ("Sample", 446, 215, "nearest end of the range"),
    ("Ambient", 345, 345, "ambient light alone"),
    ("Background", 443, 240, "nearest outline"),
    ("Background", 0, 0, "misses in the corner"),
    ("Diffuse", 264, 252, "terminator within one rounding"),
    ("Shadow", 306, 240, "border of a shadow"),
    ("Shadow", 300, 300, "N = V on the axis"),
    ("Specular", 300, 323, "highlight"),
    ("Specular", 264, 252, "terminator within one rounding"),
]


@pytest.mark.parametrize(
    ("name", "column", "row", "changes"),
    [pytest.param(n, c, r, s, id=f"{n.partition('/')[2]}-{c}-{r}: {why}") for n, c, r, why, s in PIXELS],
)
def test_a_picked_pixel(name: str, column: int, row: int, changes: dict[str, Any]) -> None:
    agree(bundled(name), column, row, **changes)


@pytest.mark.parametrize(
    ("name", "column", "row"), [pytest.param(n, c, r, id=f"{n}-{c}-{r}: {why}") for n, c, r, why in KEY_PIXELS]
)
def test_a_picked_pixel_of_the_keys(keys: Path, name: str, column: int, row: int) -> None:
    agree(tracer.load(keys / f"test{name}.txt"), column, row, shadow_epsilon=1e-3)


@pytest.mark.parametrize("sample", SAMPLES)
def test_the_corners_of_the_image(sample: str) -> None:
    # In the room every ray hits, so that its direction tells.
    scene = bundled("spec/eye-inside")
    view = View(near=1, left=-0.3, right=0.7, bottom=-0.1, top=0.9, columns=7, rows=3)
    for column, row in itertools.product((0, 3, 6), (0, 2)):
        agree(scene.replace(view=view), column, row, sample=sample)
    agree(scene.replace(view=view.replace(columns=1, rows=1)), 0, 0, sample=sample)


# Closed forms. The ray of a one-pixel view whose top-left corner is (x, y) runs exactly along (x, y, -near).


@dataclass(frozen=True)
class Root:
    """The square root of a rational number, negative where `sign` is -1."""

    square: Fraction | int
    sign: int = 1


Exact = int | Fraction | Root


def ball(
    position: Vec3,
    scaling: float | Vec3 = 1,
    *,
    color: Vec3 = (1, 1, 1),
    ka: float = 0,
    kd: float = 0,
    ks: float = 0,
    kr: float = 0,
    exponent: float = 1,
) -> Sphere:
    """A sphere or an ellipsoid; black unless a coefficient is given."""
    sizes = scaling if isinstance(scaling, tuple) else (scaling,) * 3
    return Sphere(
        name="s", position=position, scaling=sizes, color=color, ka=ka, kd=kd, ks=ks, kr=kr, exponent=exponent
    )


def lamp(*position: float, intensity: Vec3 = (1, 1, 1)) -> Light:
    """A light, white by default."""
    return Light(name="l", position=position, intensity=intensity)


def one(
    spheres: Sequence[Sphere],
    lights: Sequence[Light] = (),
    *,
    ray: Vec3 = (0, 0, -1),
    background: Vec3 = (0, 0, 0),
    ambient: Vec3 = (0, 0, 0),
    **changes: Any,
) -> Truth:
    """The truth of the single pixel whose ray has this direction; the oracle agrees."""
    x, y, z = ray
    view = View(near=-z, left=x, right=x + 1, bottom=y - 1, top=y, columns=1, rows=1)
    scene = Scene(view=view, spheres=spheres, lights=lights, background=background, ambient=ambient)
    return agree(scene, 0, 0, **changes)


def holds(truth: Truth, **expected: Exact | tuple[Exact, ...]) -> None:
    """The passes (`_` for `.`) contain their exact values; a number stands for all three channels."""
    for name, value in expected.items():
        balls = truth.values[name.replace("_", ".")]
        values = value if isinstance(value, tuple) else (value,) * len(balls)
        for k, (found, wanted) in enumerate(zip(balls, values, strict=True)):
            low, high = bounds(found)
            if isinstance(wanted, Root):
                if wanted.sign < 0:
                    low, high = -high, -low
                assert max(low, Fraction(0)) ** 2 <= wanted.square <= high**2, f"{name}[{k}] = {found}"
                assert high > 0
            else:
                assert low <= wanted <= high, f"{name}[{k}] = {found}, expected {wanted}"
                assert found.contains(flint.fmpq(*Fraction(wanted).as_integer_ratio()))


def settled(truth: Truth) -> list[str]:
    """The rules that settled the ties of a pixel; all of them were settled."""
    assert all(tie.settled for tie in truth.ties), truth.ties
    return [tie.settled for tie in truth.ties]


# The unit sphere whose nearest point to the eye is (0, 0, -4), with N = V = (0, 0, 1) there.
CENTRAL = (0.0, 0.0, -5.0)


def test_a_sphere_seen_and_lit_from_the_eye() -> None:
    # N = L = V = R: ambient Ka Ia O, diffuse Kd Ip O, specular Ks Ip 1^7.
    sphere = ball(CENTRAL, color=(0.5, 0.25, 1), ka=0.5, kd=0.75, ks=0.25, exponent=7)
    truth = one([sphere], [lamp(0, 0, 0, intensity=(1, 0.5, -2))], ambient=(0.25, 0.5, 1))
    half, quarter = Fraction(1, 2), Fraction(1, 4)
    holds(truth, id=0, depth=4, position=(0, 0, -4), normal=(0, 0, 1), shadow_L0=1)
    holds(truth, ambient=(half**4, half**4, half), diffuse=(Fraction(3, 8), Fraction(3, 32), -Fraction(3, 2)))
    holds(truth, specular=(quarter, half**3, -half), direct=(Fraction(5, 8), Fraction(7, 32), -2))
    holds(truth, beauty=(Fraction(11, 16), Fraction(9, 32), -Fraction(3, 2)), reflection=0, reflection_3=0)


@pytest.mark.parametrize(
    ("exponent", "power"), [(0, 1), (0.5, Root(Fraction(4, 5))), (1, Fraction(4, 5)), (3, Fraction(64, 125))]
)
def test_a_light_from_the_side(exponent: float, power: Exact) -> None:
    # From (0, 0, -4) to (3, 0, 0): L = (3, 0, 4) / 5, N.L = R.V = 4 / 5.
    truth = one([ball(CENTRAL, kd=1, ks=1, exponent=exponent)], [lamp(3, 0, 0)])
    holds(truth, shadow_L0=1, diffuse=Fraction(4, 5), specular=power)


def test_an_ellipsoid_off_the_axis() -> None:
    # (3, 0, -6) of |(x / 5, y, (z + 10) / 5)| = 1, seen along V = (-1, 0, 2) / sqrt 5: N = (3, 0, 4) / 5.
    truth = one([ball((0, 0, -10), (-5, 1, 5), kd=1)], [lamp(6, 0, -2)], ray=(0.5, 0, -1))
    holds(truth, depth=Root(45), position=(3, 0, -6), normal=(Fraction(3, 5), 0, Fraction(4, 5)), diffuse=1)


def test_mirrors_that_face_each_other() -> None:
    # The ray runs between (0, 0, -4) and (0, 0, 4); eye and light are half way: N.L = R.V = 1 at each hit.
    # A local term of the front is Kd O = (1/2, 1/4, 1/8), of the back Ks = 1/4.
    front = ball(CENTRAL, color=(1, 0.5, 0.25), kd=0.5, kr=0.5)
    back = ball((0, 0, 5), ks=0.25, kr=0.25)
    eighth = Fraction(1, 8)
    truth = one([front, back], [lamp(0, 0, 0)])
    holds(truth, direct=(4 * eighth, 2 * eighth, eighth), reflection_1=eighth)
    holds(truth, reflection_2=(eighth / 2, eighth / 4, eighth / 8), reflection_3=eighth**2)
    # 1/8 + 1/64, and 1/16, 1/32 and 1/64 of the second bounce; the fourth does not count.
    nine = Fraction(9, 64)
    holds(truth, reflection=(nine + Fraction(1, 16), nine + Fraction(1, 32), nine + Fraction(1, 64)))
    holds(truth, beauty=(nine + Fraction(9, 16), nine + Fraction(9, 32), nine + Fraction(9, 64)))


def test_a_tangent_is_a_hit() -> None:
    # Distance of (0, 0, -5) from the line along (3, 0, -4): 5 * 3/5 = 3, the radius. t = 5 / (1 + 9/16) = 16/5.
    truth = one([ball((0, 0, -5), 3, kd=1, ks=1, exponent=0)], [lamp(0, 0, 0)], ray=(0.75, 0, -1))
    holds(truth, id=0, depth=4, position=(Fraction(12, 5), 0, -Fraction(16, 5)))
    # The light is in the eye: its ray is the tangent too, N.L = 0, and the sphere does not hide it.
    holds(truth, normal=(Fraction(4, 5), 0, Fraction(3, 5)), shadow_L0=1, direct=0)
    assert settled(truth)


def test_a_tangent_on_the_image_plane_is_none() -> None:
    # The same line and sphere five times as large: t = 1 at the touching point (12, 0, -16).
    sphere = ball((0, 0, -25), 15)
    on_the_plane = one([sphere], ray=(12, 0, -16), background=(0.25, 0.5, 1))
    holds(on_the_plane, id=-1, position=0, normal=0, beauty=(Fraction(1, 4), Fraction(1, 2), 1))
    assert on_the_plane.values["depth"][0].value == math.inf
    assert settled(on_the_plane)
    holds(one([sphere], ray=(6, 0, -8)), id=0, depth=20)


def test_a_tangent_beside_its_near_misses() -> None:
    # One unit in the last place of the radius decides.
    for radius, hit in ((math.nextafter(15, 0), -1), (15.0, 0), (math.nextafter(15, 16), 0)):
        truth = one([ball((0, 0, -25), radius, kd=1)], [lamp(16, 0, -13)], ray=(0.75, 0, -1))
        holds(truth, id=hit)
        assert bool(truth.ties) == (radius == 15)
    # d^2 = 25/16, b = 25, c = 625 - r^2: t = 16 -+ sqrt(256 - 16 c / 25), at the distance 5/4 t from the eye.
    square = 256 - Fraction(16, 25) * (625 - Fraction(math.nextafter(15, 16)) ** 2)
    low, high = (Fraction(20) - end * Fraction(5, 4) for end in (Fraction(1, 10**6), Fraction(1, 10**8)))
    assert low < bounds(truth.values["depth"][0])[0] < high
    near, far = bounds(truth.values["depth"][0])
    middle = (near + far) / 2
    assert abs((16 - middle * Fraction(4, 5)) ** 2 - square) < Fraction(1, 10**30)


def test_r_dot_v_is_exactly_zero() -> None:
    # The tangent again: at (12, 0, -16) N = (4, 0, 3) / 5. A light along N: R = N, perpendicular to the ray.
    sphere = ball((0, 0, -25), 15, kd=1, ks=1, exponent=0)
    truth = one([sphere], [lamp(16, 0, -13)], ray=(0.75, 0, -1))
    holds(truth, normal=(Fraction(4, 5), 0, Fraction(3, 5)), diffuse=1, specular=0)
    # Not at a tangent: at (-3, 0, -4) N = (0, 0, 1), V = (3, 0, 4) / 5, L = (4, 0, 3) / 5, R = (-4, 0, 3) / 5.
    for exponent in (0, 0.5, 2):
        sphere = ball((-3, 0, -5), kd=1, ks=1, exponent=exponent)
        truth = one([sphere], [lamp(1, 0, -1)], ray=(-1.5, 0, -2))
        holds(truth, depth=5, normal=(0, 0, 1), shadow_L0=1, diffuse=Fraction(3, 5), specular=0)
        assert settled(truth)


def test_n_dot_l_is_exactly_zero() -> None:
    # The light is in the tangent plane of (0, 0, -4); its ray touches the sphere at t = 0 and is not hidden.
    truth = one([ball(CENTRAL, kd=1, ks=1, exponent=0)], [lamp(3, 0, -4)])
    holds(truth, shadow_L0=1, diffuse=0, specular=0)
    assert settled(truth)


@pytest.mark.parametrize(
    ("near", "depth"),
    [(3.5, 4), (4, 6), (4.5, 6), (6, None), (7, None)],
    ids=["before", "on", "cut", "on far", "after"],
)
def test_the_near_plane(near: float, depth: int | None) -> None:
    truth = one([ball(CENTRAL, ka=1)], ray=(0, 0, -near), ambient=(1, 1, 1))
    if depth is None:
        holds(truth, id=-1, ambient=0, normal=0)
    else:
        # The far side is the inside, whose normal is turned to the eye.
        holds(truth, id=0, depth=depth, normal=(0, 0, 1), ambient=1)
    assert bool(truth.ties) == (near in (4, 6))
    settled(truth)


def test_a_sphere_behind_the_eye_is_not_seen() -> None:
    holds(one([ball((0, 0, 5), 2, ka=1)], ambient=(1, 1, 1)), id=-1, beauty=0)


def test_the_eye_inside_a_sphere() -> None:
    # (3, 0, -1) is 5 from (0, 0, 3): the normal there turns inward. L to (0, 0, 3) is that normal.
    truth = one([ball((0, 0, 3), 5, kd=1)], [lamp(0, 0, 3), lamp(0, 0, 9)], ray=(1.5, 0, -0.5))
    holds(truth, depth=Root(10), position=(3, 0, -1), normal=(-Fraction(3, 5), 0, Fraction(4, 5)), diffuse=1)
    holds(truth, shadow_L0=1, shadow_L1=0)


def test_the_inside_of_a_mirror_sees_itself() -> None:
    # Along the axis between (0, 0, -2) and (0, 0, 2), through the eye.
    truth = one([ball((0, 0, 0), 2, ka=1, kr=0.5)], ambient=(1, 0.5, 1), max_reflections=4)
    for k in (1, 2, 3, 4):
        holds(truth, **{f"reflection_{k}": (Fraction(1, 2**k), Fraction(1, 2 ** (k + 1)), Fraction(1, 2**k))})


def test_of_identical_spheres_the_first_exists() -> None:
    first, other = ball(CENTRAL, (1, 2, 3), ka=0.5), ball((9, 0, -5), ka=1)
    twin = ball(CENTRAL, (1, -2, -3), ka=1, kr=1)
    with pytest.warns(tracer.errors.SceneWarning):
        truth = one([other, first, twin], ambient=(1, 1, 1))
    holds(truth, id=1, ambient=Fraction(1, 2), reflection=0)
    # What does not exist is not counted as a tie, or as one that the rule settles; it keeps its number.
    settled(truth)
    with pytest.warns(tracer.errors.SceneWarning):
        truth = one([first, twin, other], ray=(2.25, 0, -1), ambient=(1, 1, 1))
    holds(truth, id=2)


@pytest.mark.parametrize(
    ("centre", "radius", "visible"), [(0, 1, 1), (0.5, 1.5, 1), (-1.5, 0.5, 0)], ids=["near", "large", "far side"]
)
def test_a_light_on_a_surface(centre: float, radius: float, visible: int) -> None:
    # From (0, 0, -4) to the light at (0, 0, -1), where the way meets the other sphere's surface at t = 1.
    truth = one([ball(CENTRAL, kd=1), ball((0, 0, centre), radius)], [lamp(0, 0, -1)], ray=(0, 0, -3.5))
    holds(truth, shadow_L0=visible, diffuse=visible)
    settled(truth)


def test_a_light_on_the_own_surface() -> None:
    # The inside at (0, 0, -15); the light at (3, 0, -6): L = (3, 0, 9) / sqrt 90, N.L = 3 / sqrt 10.
    truth = one([ball((0, 0, -10), 5, kd=1)], [lamp(3, 0, -6)], ray=(0, 0, -6))
    holds(truth, depth=15, normal=(0, 0, 1), shadow_L0=1, diffuse=Root(Fraction(9, 10)))
    # From the outside at (0, 0, -5) the light (3, 0, -14) on the far side is hidden: the other root is the light's,
    # t = 1, but the first is the start. It is dark because N.L < 0.
    truth = one([ball((0, 0, -10), 5, kd=1)], [lamp(3, 0, -14)], ray=(0, 0, -1))
    holds(truth, depth=5, shadow_L0=1, diffuse=0)


def test_a_light_on_a_surface_far_from_binary_numbers() -> None:
    # 3/5 and 4/5 of a radius that is no binary fraction: on the surface as decimals, beside it as float64.
    for radius in (0.1, 0.7, 1.3):
        sphere = ball((0, 0, -2), radius, kd=1)
        agree(
            Scene(
                view=View(near=1, left=-1, right=1, bottom=-1, top=1, columns=9, rows=9),
                spheres=[sphere, ball((0, 0, -9), 5, kd=1)],
                lights=[lamp(0.6 * radius, 0, -2 + 0.8 * radius)],
            ),
            4,
            4,
        )


def test_a_light_at_the_hit_itself() -> None:
    truth = one([ball(CENTRAL, ka=0.5, kd=1, ks=1, exponent=0)], [lamp(0, 0, -4)], ambient=(1, 1, 1))
    holds(truth, shadow_L0=1, direct=0, beauty=Fraction(1, 2))
    # The light at the touching point of a tangent.
    truth = one([ball((0, 0, -25), 15, kd=1)], [lamp(12, 0, -16)], ray=(0.75, 0, -1))
    holds(truth, shadow_L0=1, direct=0)


@pytest.mark.parametrize(
    ("epsilon", "visible"), [(0.25, 1), (math.nextafter(0.25, 0), 0), (math.nextafter(0.25, 1), 1)]
)
def test_a_shadow_that_ends_at_the_epsilon(epsilon: float, visible: int) -> None:
    # From (0, 0, -4) to (0, 0, 0); the blocker spans t = 1/8 to 1/4. The near plane runs through the gap before it.
    blocker = ball((0, 0, -3.25), 0.25)
    truth = one([ball(CENTRAL, kd=1), blocker], [lamp(0, 0, 0)], ray=(0, 0, -3.75), shadow_epsilon=epsilon)
    holds(truth, depth=4, shadow_L0=visible, diffuse=visible)
    assert bool(truth.ties) == (epsilon == 0.25)
    settled(truth)


@pytest.mark.parametrize(
    ("epsilon", "visible"), [(0.25, 1), (math.nextafter(0.25, 0), 0), (math.nextafter(0.25, 1), 1)]
)
def test_the_own_shadow_that_ends_at_the_epsilon(epsilon: float, visible: int) -> None:
    # The inside at (0, 0, -6); the other root on the way to (0, 0, 2) is (0, 0, -4), t = 1/4.
    truth = one([ball(CENTRAL, kd=1)], [lamp(0, 0, 2)], ray=(0, 0, -4.5), shadow_epsilon=epsilon)
    holds(truth, depth=6, shadow_L0=visible)
    settled(truth)


def test_a_shadow_that_starts_at_the_epsilon() -> None:
    # The blocker spans t = 1/4 to 1/2: its first root does not count, its second one hides.
    truth = one([ball(CENTRAL), ball((0, 0, -2.5), 0.5)], [lamp(0, 0, 0)], ray=(0, 0, -3.75), shadow_epsilon=0.25)
    holds(truth, shadow_L0=0)


@pytest.mark.parametrize(("side", "visible"), [(-1, 0), (0, 1), (1, 1)], ids=["before", "on", "beyond"])
def test_a_shadow_range_that_ends_at_the_light(side: int, visible: int) -> None:
    # From (0, 0, -4) up to (0, 0, 0); the blocker's first point is at the light or one unit of 2^-52 off, inside or
    # outside of it.
    blocker = ball((0, 0, 1), 1 - side * 2.0**-52)
    truth = one([ball(CENTRAL, kd=1), blocker], [lamp(0, 0, 0)], ray=(0, 0, -3.5))
    holds(truth, shadow_L0=visible, diffuse=visible)
    settled(truth)


def test_a_shadow_ray_that_touches() -> None:
    # From (0, 0, -4) along (3, 0, 4): a sphere of radius 3 about (0, 0, 1) touches at t = 4/5 of the way to (3, 0, 0).
    # The double root is an intersection and hides; a radius less by one unit does not.
    for radius, visible in ((3.0, 0), (math.nextafter(3, 0), 1), (math.nextafter(3, 4), 0)):
        truth = one([ball(CENTRAL), ball((0, 0, 1), radius)], [lamp(3, 0, 0)], ray=(0, 0, -3.5))
        holds(truth, shadow_L0=visible)
        assert bool(truth.ties) == (radius == 3)


@pytest.mark.parametrize("swap", [False, True])
def test_equal_hits_of_primary_rays(swap: bool) -> None:
    # Both touch from within at (0, 0, -2); then two that cross there, (+-3, 0, -6) with radius 5.
    pair = [ball((0, 0, -3), ka=0.5), ball((0, 0, -4), 2, ka=1)]
    truth = one(pair[:: -1 if swap else 1], ambient=(1, 1, 1))
    holds(truth, id=0, depth=2, ambient=1 if swap else Fraction(1, 2))
    assert settled(truth)
    pair = [ball((3, 0, -6), 5), ball((-3, 0, -6), 5)]
    truth = one(pair[:: -1 if swap else 1])
    holds(truth, id=0, depth=2, normal=(Fraction(3 if swap else -3, 5), 0, Fraction(4, 5)))
    assert settled(truth)


def test_equal_hits_of_a_reflected_ray_are_reported() -> None:
    # The mirror sends the ray back to (0, 0, 5), where two spheres cross.
    mirror = ball(CENTRAL, kr=1)
    pair = [ball((3, 0, 9), 5, ka=0.5), ball((-3, 0, 9), 5, ka=0.25)]
    truth = one([mirror, *pair], ambient=(1, 1, 1))
    holds(truth, id=0, reflection_1=Fraction(1, 2))
    assert len(truth.ties) == 1
    assert len(truth.ties[0].outcomes) >= 2


def test_mirrors_that_touch() -> None:
    # Both at (0, 0, -4): the ray leaves one, for which the other's t = 0 does not count, only its far side (0, 0, -2).
    back, front = ball(CENTRAL, ka=0.5, kd=1, kr=0.5), ball((0, 0, -3), ka=0.25, kr=0.5)
    truth = one([back, front], [lamp(0, 0, -2.5)], ray=(0, 0, -3.5), ambient=(1, 1, 1))
    holds(truth, id=0, normal=(0, 0, 1), shadow_L0=1, diffuse=1, reflection_1=Fraction(1, 8))
    assert any(tie.settled for tie in truth.ties)


def chained(max_reflections: int) -> Truth:
    """Two spheres that a ray hits at the same point by symmetry, behind three mirrors one after the other."""
    places: list[tuple[Vec3, Vec3]] = [
        ((0, 2.1, -5.2), (2.8, 1.7, 2)),
        ((0, -0.6, 5.1), (2.6, 2.1, 2.2)),
        ((0, 2.4, -6.5), (2.6, 2.6, 2.2)),
        ((0, -1.5, 5.6), (4, 2.7, 2.8)),
        ((-0.7, 4, 1.3), (1.3, 1.1, 1.2)),
        ((0.7, 4, 1.3), (1.3, 1.1, 1.2)),
    ]
    spheres = [ball(position, scaling, ka=0.1, kr=0.5) for position, scaling in places]
    view = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=16, rows=16)
    return Prover(Scene(view=view, spheres=spheres, limits=False), Settings(max_reflections=max_reflections)).pixel(
        8, 4
    )


def test_a_pixel_whose_ties_take_too_much_work_is_not_proved() -> None:
    # Where both spheres are left together, the other's root at the start is known exactly only four roots deep.
    truth = chained(3)
    assert [(tie.key.what, tie.key.bounce) for tie in truth.ties] == [("order", 2), ("start", 3)]
    assert all(tie.proved for tie in truth.ties)
    truth = chained(8)
    assert not all(tie.proved for tie in truth.ties)
    assert all(math.isfinite(value.value) for value in truth.values["beauty"])


@pytest.mark.parametrize("radius", [1e-30, 1e-60])
def test_a_sign_that_could_not_be_had_stays_unproved(
    radius: float, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the values need another round with more bits, which takes the sign as known."""
    for name, value in {"EXACT_FROM": 128, "BUDGET": 0, "RADIUS": radius}.items():
        monkeypatch.setattr(proving, name, value)
    found = Prover(tracer.load(root / "scenes/spec/touching-spheres.txt")).pixel(200, 200)
    assert found.ties
    assert not any(tie.proved for tie in found.ties)


def test_the_reflection_at_a_tangent_runs_straight_on() -> None:
    # d.N = 0: the ray goes on to the wall behind, five units after the touching point (12, 0, -16).
    wall = ball((18, 0, -24), 5, ka=1)
    truth = one([ball((0, 0, -25), 15, kr=0.5), wall], ray=(0.75, 0, -1), ambient=(1, 1, 1))
    holds(truth, id=0, depth=20, reflection_1=Fraction(1, 2))


@pytest.mark.parametrize("kd", [0, 0.75])
def test_a_highlight_that_fades_with_n_dot_l_does_so_without_a_diffuse_term(kd: float) -> None:
    # N = (3, 0, 4) / 5, L = (24, 0, 7) / 25: N.L = 4/5.
    view = View(near=1, left=0.5, right=1.5, bottom=-1, top=0, columns=1, rows=1)
    scene = Scene(view=view, spheres=[ball((0, 0, -10), (-5, 1, 5), kd=kd, ks=1)], lights=[lamp(27, 0, 1)])
    fading = next(rule.follower for rule in MISTAKES if rule.says == "multiplies the highlight by N.L")
    plain, faded = (Prover(scene, follower=follower).pixel(0, 0) for follower in (Follower, fading))
    for full, less in zip(plain.values["specular"], faded.values["specular"], strict=True):
        low, high = (Fraction(4, 5) * end for end in bounds(full))
        assert low > 0
        assert bounds(less)[0] <= high
        assert low <= bounds(less)[1]


def test_balls() -> None:
    truth = one([ball((0, 0, -10), (-5, 1, 5), kd=0.75)], [lamp(3, 0, 0)], ray=(0.5, 0, -1))
    # N = (3, 0, 4) / 5, L = (0, 0, 1): N.L = 4/5.
    cosine = truth.values["diffuse"][0]
    assert float(cosine.value) == 0.6
    assert cosine.contains("3/5")
    assert cosine.contains(flint.fmpq(3, 5))
    assert not cosine.contains(0.6)  # the float64 nearest to it
    assert not cosine.contains(1)
    assert truth.values["shadow.L0"][0].contains(1)
    for value in (0.6, 0.5, 1.0, -2.0):
        true = abs(Fraction(value) - Fraction(3, 5))
        error = cosine.error(value)
        assert true <= Fraction(error) <= true * (1 + Fraction(1, 10**9)) + Fraction(1, 10**25)
    for balls in truth.values.values():
        for original in balls:
            copy = pickle.loads(pickle.dumps(original))
            assert (copy.value, copy.radius, bounds(copy)) == (original.value, original.radius, bounds(original))
    missed = one([]).values["depth"][0]
    assert (missed.value, missed.radius) == (math.inf, 0)
    assert pickle.loads(pickle.dumps(missed)).value == math.inf


# The exact tangents of the keys


def exact_tangents(scene: Scene) -> Iterator[tuple[int, int, int, list[Fraction]]]:
    """Column, row, sphere and outward gradient of every primary ray that touches the nearest surface beyond t = 1."""
    view = scene.view
    x = view.left + (view.right - view.left) * np.arange(view.columns) / view.columns
    y = view.top - (view.top - view.bottom) * np.arange(view.rows) / view.rows
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -view.near), axis=-1)
    for j, sphere in enumerate(scene.spheres):
        # Where float64 is in doubt, and far beyond its doubt, rational numbers decide.
        u, v = np.array(sphere.position) / sphere.scaling, rays / np.array(sphere.scaling)
        a, b, c = (v * v).sum(axis=-1), v @ u, u @ u - 1
        for row, column in np.argwhere(np.abs(b * b - a * c) <= 1e-9 * b * b).tolist():
            left, right, bottom, top = (Fraction(e) for e in (view.left, view.right, view.bottom, view.top))
            ray = [
                left + (right - left) * Fraction(column, view.columns),
                top - (top - bottom) * Fraction(row, view.rows),
                -Fraction(view.near),
            ]
            A, B, C = _quadratic(sphere, ray)
            if B * B != A * C or B <= A:
                continue
            if any(_before(other, ray, B / A) for k, other in enumerate(scene.spheres) if k != j):
                continue
            gradient = [
                (B / A * d - Fraction(p)) / Fraction(s) ** 2
                for d, p, s in zip(ray, sphere.position, sphere.scaling, strict=True)
            ]
            yield column, row, j, gradient


def _quadratic(sphere: Sphere, ray: Sequence[Fraction]) -> tuple[Fraction, Fraction, Fraction]:
    # A t^2 - 2 B t + C = 0 where the ray meets the sphere.
    scaled = [
        (d / Fraction(s), Fraction(p) / Fraction(s))
        for d, p, s in zip(ray, sphere.position, sphere.scaling, strict=True)
    ]
    A, B = sum((d * d for d, _ in scaled), Fraction(0)), sum((d * p for d, p in scaled), Fraction(0))
    return A, B, sum((p * p for _, p in scaled), Fraction(-1))


def _before(sphere: Sphere, ray: Sequence[Fraction], t: Fraction) -> bool:
    # Whether it has a root between 1 and t: from outside, the first or both lie there.
    A, B, C = _quadratic(sphere, ray)
    if B * B < A * C:
        return False
    root = math.sqrt(B * B - A * C)
    return any(1 < (float(B) + side * root) / A < t for side in (-1, 1))


KEYS = ("Ambient", "Background", "Diffuse", "Sample", "Shadow", "Specular")


def test_the_ten_exact_tangents_of_the_keys(keys: Path) -> None:
    count = 0
    for name in KEYS:
        scene = tracer.load(keys / f"test{name}.txt")
        with Image.open(keys / f"key{name}.png") as image:
            key = np.asarray(image.convert("RGB"))
        for column, row, sphere, gradient in exact_tangents(scene):
            count += 1
            truth = agree(scene, column, row, shadow_epsilon=1e-3)
            assert truth.id == sphere
            assert settled(truth)
            # Outward: gradient / |gradient|, so that normal * |gradient|^2 = gradient * |gradient|, sign by sign.
            square = sum((g * g for g in gradient), Fraction(0))
            for found, g in zip(truth.values["normal"], gradient, strict=True):
                low, high = bounds(found)
                expected = g * abs(g) / square  # x |x| of the component x
                assert low * abs(low) <= expected <= high * abs(high)
            assert levels(truth) == key[row, column].tolist(), (name, column, row)
    assert count == 10


def levels(truth: Truth) -> list[int]:
    """The 8-bit colour, which the whole of each ball gives."""
    found = []
    for ball_ in truth.values["beauty"]:
        low, high = (min(max(end, Fraction(0)), Fraction(1)) * 255 // 1 for end in bounds(ball_))
        assert low == high
        assert low == quantise(np.array(ball_.value))
        found.append(int(low))
    return found


def test_all_tangents_of_the_scene_of_tangents_are_hits() -> None:
    scene = bundled("spec/exact-tangents")
    found = list(exact_tangents(scene))
    assert len(found) == 36
    for column, row, _, _ in found:
        truth = agree(scene, column, row)
        assert truth.id == 0
        assert settled(truth)


@pytest.mark.parametrize("name", KEYS)
def test_pixels_of_the_keys(keys: Path, name: str) -> None:
    scene = tracer.load(keys / f"test{name}.txt")
    with Image.open(keys / f"key{name}.png") as image:
        key = np.asarray(image.convert("RGB"))
    random = np.random.default_rng(4)
    hits = np.argwhere((key != key[0, 0]).any(axis=-1))
    for row, column in random.choice(hits, 8, replace=False).tolist():
        truth = prover(scene, Settings(shadow_epsilon=1e-3)).pixel(column, row)
        assert levels(truth) == key[row, column].tolist(), (column, row)


# What needs more bits


@pytest.mark.parametrize("power", [-328, 326])
@pytest.mark.parametrize(
    "name", ["gallery/mirrors", "spec/eye-inside", "spec/shadow-of-another", "spec/exact-tangents"]
)
def test_a_scene_has_the_same_colors_at_any_scale(name: str, power: int) -> None:
    # Lengths times 2^-328 = 2e-100 and 2^326 = 1e98 are exact.
    scene, scale = bundled(name), 2.0**power
    view = scene.view
    edges = {edge: getattr(view, edge) * scale for edge in ("near", "left", "right", "bottom", "top")}

    def scaled(thing: Any, *fields: str) -> Any:
        return thing.replace(**{field: tuple(c * scale for c in getattr(thing, field)) for field in fields})

    far = scene.replace(
        view=view.replace(**edges),
        spheres=[scaled(sphere, "position", "scaling") for sphere in scene.spheres],
        lights=[scaled(light, "position") for light in scene.lights],
    )
    for column, row in ((200, 200), (163, 280), (200, 70), (150, 80)):
        truth, other = agree(scene, column, row), agree(far, column, row, absolute=False)
        assert truth.id == other.id
        for pass_ in ("beauty", "diffuse", "specular", "reflection.3", "normal"):
            for one_, two in zip(truth.values[pass_], other.values[pass_], strict=True):
                assert abs(bounds(one_)[0] - bounds(two)[0]) <= Fraction(4 * BAR) * max(
                    Fraction(1), abs(Fraction(one_.value))
                )
        if truth.id >= 0:
            ratio = bounds(other.values["depth"][0])[0] / bounds(truth.values["depth"][0])[0]
            assert abs(ratio / Fraction(2) ** power - 1) <= Fraction(1, 10**25)


def test_large_and_small_in_one_scene() -> None:
    # A mirror of 1e-100 before the eye in a room of 1e100, with lights near both.
    speck = ball((2e-100, 1e-100, -5e-100), (1e-100, 2e-100, 1e-100), ka=0.25, kd=0.5, ks=0.5, kr=0.5, exponent=3)
    room = ball((1e99, -2e99, 3e99), (9e99, 1e100, 8e99), ka=0.5, kd=0.5, ks=0.5, kr=0.75, exponent=20)
    middle = ball((3, 2, 10), 4, ka=0.5, kd=0.5, kr=0.5)
    scene = Scene(
        view=View(near=1e-100, left=-1e-100, right=1e-100, bottom=-1e-100, top=1e-100, columns=8, rows=8),
        spheres=[speck, room, middle],
        lights=[lamp(0, 1e-99, 0), lamp(1e99, 1e99, 1e99), lamp(1, -3, 2)],
        ambient=(0.5, 0.25, 1),
    )
    places = ((4, 4), (5, 3), (6, 3), (0, 0), (7, 6))
    seen = {agree(scene, column, row, digits=500).id for column, row in places}
    assert seen == {0, 1}


def test_a_chain_that_needs_more_than_a_thousand_bits() -> None:
    # No decision is closer than 1e-206 to its border. The way to that from 1e-3 and 1e100 is bits, not algebra.
    blade = ball((-4e99, -4e99, 0), (1e-3, 6e99, 5e16), ka=0.5, kd=0.5, kr=0.5)
    shell = ball((-1e100, -1e-3, -2), (6.4e16, 8e99, 9e99), ka=0.5, kd=0.5, kr=0.5)
    scene = Scene(
        view=View(near=5e-24, left=-5e99, right=-2, bottom=-5e99, top=-2, columns=4, rows=1),
        spheres=[blade, shell],
        lights=[lamp(0, 0, 0)],
        ambient=(1, 1, 1),
    )
    assert agree(scene, 0, 0, digits=500, max_reflections=2).id == 1


def test_an_exponent_of_any_size() -> None:
    # 1^n is 1 and (4/5)^n is too small for any exponent of a float.
    sphere, view = (
        ball(CENTRAL, ks=0.5, exponent=1.5e308),
        View(near=1, left=0, right=1, bottom=-1, top=0, columns=1, rows=1),
    )
    bright = Prover(Scene(view=view, spheres=[sphere], lights=[lamp(0, 0, 0)])).pixel(0, 0).values["specular"][0]
    assert bright.contains(flint.fmpq(1, 2))
    dark = Prover(Scene(view=view, spheres=[sphere], lights=[lamp(3, 0, 0)])).pixel(0, 0).values["specular"][0]
    assert (bright.value, dark.value) == (0.5, 0.0)
    assert max(bright.radius, dark.radius) <= BAR


def test_a_tangent_in_a_mirror() -> None:
    # At (0, 0, -4) N = (3, 0, 4) / 5 and the ray goes on along (24, 0, 7) / 25. From there 2 (24, 0, 7) and, across,
    # (-7, 0, 24) / 8, which is 25/8 long, lead to the centre: a radius of 25/8 touches.
    mirror = ball((-0.75, 0, -5), 1.25, kr=0.5)
    for radius, hit in ((3.125, 1), (math.nextafter(3.125, 4), 1), (math.nextafter(3.125, 3), 0)):
        ahead = ball((47.125, 0, 13), radius, ka=0.5, kd=0.5)
        truth = one([mirror, ahead], [lamp(47.125, 0, 0)], ambient=(1, 1, 1))
        holds(truth, normal=(Fraction(3, 5), 0, Fraction(4, 5)))
        assert (truth.values["reflection.1"][0].value > 0) == bool(hit)
        assert bool(settled(truth)) == (radius == 3.125)


def test_near_terminators_and_shadow_borders() -> None:
    # A light that one unit moves across the tangent plane of (0, 0, -4), and a highlight with an n that is no integer.
    for z in (-4.0, math.nextafter(-4, 0), math.nextafter(-4, -5)):
        sphere = ball(CENTRAL, kd=1, ks=1, exponent=0.3)
        truth = one([sphere], [lamp(3, 0, z)], shadow_epsilon=1e-3)
        holds(truth, shadow_L0=1)
        assert (truth.values["diffuse"][0].value > 0) == (z > -4)
        assert (truth.values["specular"][0].value > 0) == (z > -4)


# Random scenes


@given(st.data())
@settings(max_examples=40)
def test_random_scenes(data: st.DataObject) -> None:
    scene = data.draw(scenes(max_size=6))
    chosen = Settings(
        sample=data.draw(st.sampled_from(SAMPLES)),
        shadow_epsilon=data.draw(st.sampled_from((0.0, 1e-4, 1e-3, 0.25))),
        max_reflections=data.draw(st.integers(0, 4)),
    )
    judge = Prover(scene, chosen)
    for _ in range(3):
        column, row = (data.draw(st.integers(0, size - 1)) for size in (scene.view.columns, scene.view.rows))
        truth = judge.pixel(column, row)
        proved(truth, len(scene.lights), chosen.max_reflections)
        assert -1 <= truth.id < len(scene.spheres)
        expected = oracle.pixel(
            scene,
            column,
            row,
            sample=chosen.sample,
            shadow_epsilon=chosen.shadow_epsilon,
            max_reflections=chosen.max_reflections,
        )
        if all(tie.settled for tie in truth.ties):
            assert differences(truth, expected) == []


@given(st.data())
@settings(max_examples=60)
def test_random_scenes_of_any_size(data: st.DataObject) -> None:
    drawn = data.draw(scenes(extreme=True, max_size=4, max_spheres=3, max_lights=2))
    # What has a million digits does not fit into a rational number: see the test of exponents.
    scene = drawn.replace(spheres=[sphere.replace(exponent=min(sphere.exponent, 1e3)) for sphere in drawn.spheres])
    column, row = (data.draw(st.integers(0, size - 1)) for size in (scene.view.columns, scene.view.rows))
    truth = Prover(scene, Settings()).pixel(column, row)
    proved(truth, len(scene.lights), 3)
    if all(tie.settled for tie in truth.ties):
        # N.L and N.V may be as small as the ratio of two scalings, squared.
        assert differences(truth, oracle.pixel(scene, column, row, digits=500)) == []


@st.composite
def lattices(draw: st.DrawFn) -> Scene:
    """Small whole numbers and rays along Pythagorean triples: many decisions fall on their border exactly."""
    whole = st.integers(-3, 3)
    round_ = st.integers(1, 5).map(lambda radius: (float(radius),) * 3)
    spheres = st.builds(
        ball,
        st.tuples(whole, st.just(0) | whole, st.integers(-8, 2)),
        round_ | st.tuples(*[st.integers(1, 5).map(float)] * 3),
        ka=st.just(0.5),
        kd=st.just(1),
        ks=st.just(1),
        kr=st.sampled_from((0, 0.5, 1)),
        exponent=st.sampled_from((0, 0.5, 1, 2)),
    )
    lights = st.builds(lamp, st.integers(-4, 4), st.just(0) | whole, st.integers(-8, 4))
    directions = (
        (0, 0, 1),
        (0, 0, 4),
        (0.75, 0, 1),
        (0, -0.75, 1),
        (3, 0, 4),
        (4, 0, 3),
        (1, 0, 1),
        (1, 2, 2),
        (2, 3, 6),
    )
    x, y, near = draw(st.sampled_from(directions))
    return Scene(
        view=View(near=near, left=x, right=x + 1, bottom=y - 1, top=y, columns=1, rows=1),
        spheres=draw(st.lists(spheres, max_size=4, unique_by=lambda sphere: (sphere.position, sphere.scaling))),
        lights=draw(st.lists(lights, max_size=3)),
        ambient=(1, 1, 1),
    )


@given(lattices(), st.sampled_from((0.0, 1e-4, 0.125, 0.25, 0.5)), st.integers(0, 3))
@settings(max_examples=200)
def test_scenes_full_of_ties(scene: Scene, epsilon: float, bounces: int) -> None:
    chosen = Settings(shadow_epsilon=epsilon, max_reflections=bounces)
    truth = Prover(scene, chosen).pixel(0, 0)
    proved(truth, len(scene.lights), bounces)
    if all(tie.settled for tie in truth.ties):
        expected = oracle.pixel(scene, 0, 0, shadow_epsilon=epsilon, max_reflections=bounces)
        assert differences(truth, expected) == []


# The pool, and what the judge is made of


def test_the_pool_gives_the_same_in_order() -> None:
    scene = bundled("gallery/mirrors")
    pixels = [(135, 192), (0, 0), (163, 280), (49, 314), (135, 192)]
    chosen = Settings(shadow_epsilon=1e-3, max_reflections=2)
    here = [prover(scene, chosen).pixel(x, y) for x, y in pixels]
    for jobs in (1, 2):
        pooled = list(prove(scene, pixels, chosen, jobs=jobs))
        assert [(truth.x, truth.y) for truth in pooled] == pixels
        for one_, two in zip(here, pooled, strict=True):
            assert (one_.id, one_.bits, one_.ties) == (two.id, two.bits, two.ties)
            assert list(one_.values) == list(two.values)
            for name, balls in one_.values.items():
                for first, second in zip(balls, two.values[name], strict=True):
                    assert (first.value, first.radius) == (second.value, second.radius)
                    assert math.isinf(first.value) or bounds(first) == bounds(second)
    assert list(prove(scene, [], chosen)) == []
    assert [truth.id for truth in prove(scene, pixels[:2])] == [
        prover(scene, Settings()).pixel(*p).id for p in pixels[:2]
    ]


#: What the judge may take from others: a scene, the settings, and the table of passes.
MAY_TAKE = {
    "tracer": {"Scene", "Sphere", "Light", "View"},
    "tracer.passes": {"names", "lookup", "Pass", "Sample", "SAMPLES", "TABLE"},
    "validation.renderers": {"Settings"},
}


def test_the_judge_shares_no_code_with_the_renderers() -> None:
    todo, done = ["validation.truth"], set()
    while todo:
        module = todo.pop()
        done.add(module)
        for node in ast.walk(ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text())):
            imported: list[tuple[str, str]] = []
            if isinstance(node, ast.Import):
                imported = [(alias.name, "") for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{module}: a relative import hides what it is"
                imported = [(str(node.module), alias.name) for alias in node.names]
            for source, name in imported:
                if source.partition(".")[0] not in ("tracer", "converters", "validation"):
                    assert source.partition(".")[0] not in ("numpy", "mitsuba", "drjit"), f"{module} imports {source}"
                elif source in MAY_TAKE:
                    assert name in MAY_TAKE[source], f"{module} takes {name} from {source}"
                else:
                    inner = f"{source}.{name}" if source == "validation" else source
                    assert inner.startswith("validation."), f"{module} imports {source}"
                    assert not inner.startswith("validation.renderers"), f"{module} imports {source}"
                    if inner not in done:
                        todo.append(inner)


def test_proving_loads_no_renderer() -> None:
    program = (
        "import sys; from validation.truth import Prover; from tracer import Scene, Sphere, View\n"
        "view = View(near=1, left=0, right=1, bottom=-1, top=0, columns=1, rows=1)\n"
        "ball = Sphere(name='s', position=(0, 0, -5), scaling=(1, 1, 1), color=(1, 1, 1), ka=1, kd=1, ks=1, kr=1,"
        " exponent=1)\n"
        "assert Prover(Scene(view=view, spheres=[ball])).pixel(0, 0).id == 0\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = set(done.stdout.split())
    assert "validation.truth" in loaded
    forbidden = {
        "tracer.reference",
        "tracer.motion",
        "tracer.margins",
        "mitsuba",
        "validation.run",
        "validation.compare",
    }
    assert not loaded & forbidden
    assert not [name for name in loaded if name.startswith("validation.renderers.")]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sample": "centre"}, f"sample is 'centre', expected one of {str(SAMPLES)[1:-1]}"),
        ({"shadow_epsilon": 1}, "shadow_epsilon is 1, expected 0 <= shadow_epsilon < 1"),
        ({"shadow_epsilon": -1e-4}, "shadow_epsilon is -0.0001, expected 0 <= shadow_epsilon < 1"),
        ({"shadow_epsilon": math.nan}, "shadow_epsilon is nan, expected 0 <= shadow_epsilon < 1"),
        ({"max_reflections": -1}, "max_reflections is -1, expected 0 or more"),
        ({"threads": -1}, "threads is -1, expected 0 or more"),
    ],
)
def test_the_judge_is_never_asked_for_settings_that_no_renderer_takes(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(said)}$"):
        Settings(**changes)
    with pytest.raises(ValueError, match=f"^{re.escape(said)}$"):
        replace(Settings(), **changes)


def test_settings_that_renderers_take() -> None:
    for sample in SAMPLES:
        assert Settings(sample, 0, 0).sample == sample
    assert Settings(shadow_epsilon=math.nextafter(1, 0), max_reflections=1000, threads=1024).threads == 1024
