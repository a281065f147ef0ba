"""Margins of decisions and the numbers that flip them, against truth of those numbers; sensitivities likewise."""

from __future__ import annotations

import functools
import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path

import doubles
import pytest
from flint import fmpq

import tracer
from tracer import View
from validation.flips import Flip, changed, flipped, flips, sensitivity
from validation.follow import KINDS, Key
from validation.truth import Prover

#: A change so small that what is of second order is beyond the 10th digit.
TINY = fmpq(1, 1 << 60)

#: Two spheres that cross, a floor, and lights to all sides; some of it before the near plane.
CROSSING = """NEAR 1
LEFT -1
RIGHT 1
BOTTOM -1
TOP 1
RES 8 8
SPHERE left -0.4 0 -4 1 1.2 0.9 0.5 0.2 0.9 0.2 0.6 0.5 0.4 0.5
SPHERE right 0.5 0.3 -4.2 1.1 0.8 1 0.1 0.5 0.7 0.2 0.6 0.4 0.9 7
SPHERE floor 0 -41 -6 40 39.2 41 0.6 0.6 0.5 0.2 0.7 0.1 0.9 12
SPHERE near 0.6 -0.5 -1.1 0.3 0.2 0.4 0.6 0.9 0.5 0.2 0.7 0.1 0 0.5
LIGHT left -6 8 -2 2.6 1.2 0.9
LIGHT right 6 4 -4 0.3 0.4 0.9
LIGHT inside 0.6 0.3 -4 0.3 0.4 0.9
BACK 0.3 0.5 0.8
AMBIENT 0.6 0.5 0.4
OUTPUT crossing.ppm
"""


@functools.cache
def crossing() -> tracer.Scene:
    """The scene."""
    return tracer.loads(CROSSING)


def through(scene: tracer.Scene, x: float, y: float) -> Prover:
    """One pixel, whose ray goes through that point of the image plane."""
    near = scene.view.near
    return Prover(scene.replace(view=View(near=near, left=x, right=x + 1, bottom=y - 1, top=y, columns=1, rows=1)))


@functools.cache
def brink(what: str, seed: int, steps: int = 36) -> tuple[Prover, Flip]:
    """A pixel next to a place where such a decision changes: halved again and again between two random ones."""
    scene, random_ = crossing(), random.Random(seed)

    def anywhere() -> tuple[float, float]:
        """Where the spheres are."""
        return random_.uniform(-0.35, 0.45), random_.uniform(-0.4, 0.4)

    def signs(at: tuple[float, float]) -> dict[Key, int]:
        return through(scene, *at).signs(0, 0)

    while True:
        a, b = anywhere(), anywhere()
        first, second = signs(a), signs(b)
        keys = [key for key, sign in first.items() if key.what == what and second.get(key, sign) != sign]
        if not keys:
            continue
        key = random_.choice(keys)
        for _ in range(steps):
            middle = (a[0] + b[0]) / 2, (a[1] + b[1]) / 2
            if signs(middle).get(key) == first[key]:
                a = middle
            else:
                b = middle
        prover = through(scene, *a)
        flip = next(flip for flip in flips(prover, 0, 0) if flip.key == key)
        # Else another decision came between.
        if 0 < flip.margin < 1e-8:
            return prover, flip


BRINKS = [(what, seed) for what in ("meets", "start", "order", "faces", "shines") for seed in range(5)]


@pytest.mark.parametrize(("what", "seed"), BRINKS)
def test_numbers_changed_by_the_margin_flip_the_decision(what: str, seed: int) -> None:
    prover, flip = brink(what, seed)
    assert flip.key.what == what
    assert flip.kind == KINDS[flip.key.what]
    signs = prover.signs(0, 0)
    assert signs[flip.key] == flip.sign == -flip.other
    for share, expected in ((1 - 1e-6, flip.sign), (1 + 1e-6, flip.other), (-1, flip.sign)):
        other = changed(prover, 0, 0, flip, share * flip.margin)
        assert other.signs(0, 0)[flip.key] == expected, share


@pytest.mark.parametrize(("what", "seed"), BRINKS[::3])
def test_no_other_change_of_that_size_flips_it(what: str, seed: int) -> None:
    """Every number changed by less than the margin, at random, and the ray."""
    (prover, flip), random_ = brink(what, seed), random.Random(seed)
    names = [name for name in prover.numbers.of if "view." in name or ".position." in name or ".scaling." in name]
    for _ in range(25):
        turn = [random_.gauss(0, 1) for _ in range(3)]
        length = math.hypot(*turn)
        some = Flip(
            flip.key,
            flip.sign,
            flip.other,
            flip.margin,
            {name: random_.choice((-1, 1)) for name in names},
            (turn[0] / length, turn[1] / length, turn[2] / length),
        )
        other = changed(prover, 0, 0, some, flip.margin * (1 - 1e-6))
        assert other.signs(0, 0).get(flip.key, flip.sign) == flip.sign


@pytest.mark.parametrize(("what", "seed"), BRINKS)
def test_a_forced_decision_is_what_the_changed_numbers_make(what: str, seed: int) -> None:
    """The pixel with the decision taken otherwise is, but for the change, that of the numbers that flip it."""
    prover, flip = brink(what, seed)
    forced = flipped(prover, 0, 0, flip)
    made = changed(prover, 0, 0, flip, 2 * flip.margin).pixel(0, 0, ties=False)
    assert forced.id == made.id
    # Where two spheres cross, the rays that go on start as near to a decision of their own.
    for name in ("ambient", "depth", "normal") if what == "order" else ("beauty", "diffuse", "depth"):
        for a, b in zip(forced.values[name], made.values[name], strict=True):
            # A tangent's normal is off by the square root of the change.
            assert a.value == pytest.approx(b.value, abs=1e-2), (name, flip.key)


def test_flips_come_with_the_nearest_first() -> None:
    scene = doubles.full()
    prover = Prover(scene)
    for x, y in ((30, 20), (32, 24), (10, 40), (0, 0)):
        found = flips(prover, x, y)
        margins = [flip.margin for flip in found]
        assert margins == sorted(margins)
        assert all(margin > 0 for margin in margins)
        keys = [flip.key for flip in found]
        assert len(set(keys)) == len(keys)
        assert set(keys) == {key for key in prover.examine(x, y)[1] if key.what != "at"}
        assert all(abs(math.hypot(*flip.turn) - 1) < 1e-12 or flip.turn == (0, 0, 0) for flip in found)


def test_a_tie_goes_both_ways(root: Path) -> None:
    scene = tracer.load(root / "scenes" / "spec" / "exact-tangents.txt")
    prover = Prover(scene)
    x, y = next(tangents(prover))
    ways = [flip for flip in flips(prover, x, y) if flip.key.what == "meets" and flip.sign == 0]
    assert [(flip.margin, flip.other) for flip in ways] == [(0.0, -1), (0.0, 1)]
    key = ways[0].key
    for flip in ways:
        for delta in (1e-18, 1e-9):
            assert changed(prover, x, y, flip, delta).signs(x, y)[key] == flip.other
            assert changed(prover, x, y, flip, -delta).signs(x, y)[key] == -flip.other
    assert flipped(prover, x, y, ways[0]).id != key.sphere
    assert flipped(prover, x, y, ways[1]).id == key.sphere


def tangents(prover: Prover) -> Iterator[tuple[int, int]]:
    """Pixels whose ray touches a sphere exactly."""
    view = prover.scene.view
    for y in range(view.rows):
        for x in range(view.columns):
            if any(tie.key.what == "meets" and tie.key.bounce == 0 for tie in prover.pixel(x, y).ties):
                yield x, y


def test_what_nothing_flips_has_no_margin() -> None:
    """N.L of a light at the centre of the sphere that the ray comes into: every change of numbers moves it along."""
    scene = doubles.cut()
    prover = Prover(scene)
    for flip in flips(prover, 24, 24):
        assert flip.margin > 0
        assert not math.isnan(flip.margin)


def slopes(prover: Prover, x: int, y: int) -> dict[str, list[float]]:
    """By pass and channel the sum of the slopes, from proved values of changed numbers."""
    exact = prover.pixel(x, y, ties=False)
    length = math.hypot(*(float(entry.p) / float(entry.q) for entry in prover.direction(x, y)))

    def difference(other: Prover, name: str, k: int) -> float:
        moved = other.pixel(x, y, ties=False).values[name][k]
        return float((moved.middle() - exact.values[name][k].middle()) / TINY)

    colors = {name for name in exact.values if name != "id"}
    by_number = [
        prover.with_numbers(prover.numbers.changed({name: TINY})) for name, value in prover.numbers.of.items() if value
    ]
    axes = [(TINY, fmpq(0), fmpq(0)), (fmpq(0), TINY, fmpq(0)), (fmpq(0), fmpq(0), TINY)]
    by_axis = [prover.with_numbers(prover.numbers, axis) for axis in axes]
    return {
        name: [
            sum(abs(difference(other, name, k)) for other in by_number)
            + length * math.hypot(*(difference(other, name, k) for other in by_axis))
            for k in range(len(exact.values[name]))
        ]
        for name in colors
        if exact.values[name][0].mantissa is not None
    }


@pytest.mark.parametrize(
    ("scene", "place"),
    [(doubles.full, (30, 20)), (doubles.full, (44, 10)), (doubles.cut, (20, 30)), (crossing, (4, 4))],
)
def test_sensitivities_are_the_slopes_of_truth(scene: Callable[[], tracer.Scene], place: tuple[int, int]) -> None:
    prover = Prover(scene())
    found, expected = sensitivity(prover, *place), slopes(prover, *place)
    assert set(found) == set(expected)
    for name, channels in expected.items():
        assert list(found[name]) == pytest.approx(channels, rel=1e-9, abs=1e-15), name
    assert max(found["beauty"]) > 0


def test_sensitivities_of_a_miss_are_those_of_the_background() -> None:
    prover = Prover(doubles.full())
    found = sensitivity(prover, 0, 0)
    assert found["beauty"] == pytest.approx((0.3, 0.5, 0.8))
    assert found["diffuse"] == (0, 0, 0)
    assert "depth" not in found


def test_no_value_moves_more_than_its_sensitivity() -> None:
    """All numbers and the ray, changed at random by one delta."""
    prover, random_ = Prover(crossing()), random.Random(5)
    x, y = 4, 5
    exact, moves = prover.pixel(x, y, ties=False), sensitivity(prover, x, y)
    delta = 2.0**-60
    for _ in range(20):
        turn = [random_.gauss(0, 1) for _ in range(3)]
        length = math.hypot(*turn)
        way = Flip(
            Key("meets", 0, -1, 0),
            1,
            -1,
            delta,
            {name: random_.choice((-1, 1)) for name in prover.numbers.of},
            (turn[0] / length, turn[1] / length, turn[2] / length),
        )
        other = changed(prover, x, y, way, delta).pixel(x, y, ties=False)
        for name, channels in moves.items():
            for k, most in enumerate(channels):
                moved = abs(float(other.values[name][k].middle() - exact.values[name][k].middle()))
                assert moved <= most * delta * (1 + 1e-9) + 1e-40, name
