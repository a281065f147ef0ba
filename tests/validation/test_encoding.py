"""What levels of image files stand for: every encoding against its own words, and images compared through it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import doubles
import numpy as np
import pytest
from doubles import Double
from hypothesis import given
from hypothesis import strategies as st

import tracer
from tracer.passes import Passes, quantise
from validation import Settings, compare, encoding, validate
from validation.encoding import QUANTISATIONS, Encoding

EVERY = [Encoding(*chosen) for chosen in itertools.product(QUANTISATIONS, (255, 65535, 15), (False, True))]

#: As programs are written, for one channel of a clamped colour.
PROGRAMS: dict[str, Callable[[float], int]] = {
    "truncate": lambda v: int(v * 255),
    "round": lambda v: int(v * 255 + 0.5),
    "255.9": lambda v: int(v * 255.9),
    "256": lambda v: min(int(v * 256), 255),
    "srgb": lambda v: int((12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055) * 255 + 0.5),
    "srgb-truncate": lambda v: int((12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055) * 255 + 1e-12),
    "gamma": lambda v: int(v ** (1 / 2.2) * 255 + 0.5),
    "gamma-truncate": lambda v: int(v ** (1 / 2.2) * 255),
}

colors = st.floats(-2, 4)


@pytest.mark.parametrize("name", QUANTISATIONS)
@given(v=colors)
def test_levels_are_those_of_the_program_in_words(name: str, v: float) -> None:
    assert Encoding(name).encode(np.array([v]))[0] == PROGRAMS[name](min(max(v, 0.0), 1.0))


def test_the_specification_truncates() -> None:
    v = np.random.default_rng(0).uniform(-0.5, 1.5, 10_000)
    assert np.array_equal(Encoding().encode(v), quantise(v))


@given(v=colors)
def test_a_colour_lies_in_the_interval_of_its_level(v: float) -> None:
    for of in EVERY:
        level = of.encode(np.array([v]))
        assert 0 <= level[0] <= of.steps
        assert of.distance(level, np.array([v]))[0] <= 1e-13, of
        if not of.wraps:
            low, high = of.interval(level)
            assert low[0] - 1e-13 <= v <= high[0] + 1e-13


@given(v=st.floats(0.01, 0.99))
def test_other_levels_are_as_far_as_their_interval(v: float) -> None:
    for of in EVERY:
        level = of.encode(np.array([v]))
        above = of.distance(level + 1, np.array([v]))[0] if level[0] < of.steps else 1.0
        below = of.distance(level - 1, np.array([v]))[0] if level[0] > 0 else 1.0
        assert above > 0 or below > 0  # at a border one of them may be 0
        # Two levels are one interval apart, the narrowest of which is that of the steepest part of sRGB's curve.
        if level[0] + 2 <= of.steps:
            narrowest = 1 / (of.steps + 1) - 2 * of.curved * encoding.CURVE_ROUNDINGS
            assert of.distance(level + 2, np.array([v]))[0] > narrowest / 12.92 * 0.999


def in_floats(name: str, values: Any, number: Any) -> Any:
    """The levels of a program that computes a curve in these numbers."""
    v = np.clip(values, 0, 1).astype(number)
    if name.startswith("gamma"):
        curve = v ** number(1 / 2.2)
    else:
        power = number(1.055) * v ** number(1 / 2.4) - number(0.055)
        curve = np.where(v <= number(0.0031308), number(12.92) * v, power)
    return np.floor(curve * number(255) + number(0 if "truncate" in name else 0.5)).astype(np.int64)


def test_halfway_between_levels_either_may_be_right() -> None:
    # Python, NumPy and C's rint round to even, v + 0.5 truncated rounds up; backgrounds of one digit are such colours.
    values, of = np.array([0.1, 0.3, 0.5, 0.7, 0.9]), Encoding("round")
    up, even = np.floor(values * 255 + 0.5), np.rint(values * 255)
    assert (up != even).any()
    assert of.makes(values, up).all()
    assert of.makes(values, even).all()
    assert not of.makes(values, even - 1).any()
    assert not of.makes(values + 1e-9, np.floor(values * 255)).any()
    assert not of.makes(np.array([1.5, np.inf, -0.5]), np.array([254, 254, 255])).any()


@pytest.mark.parametrize("number", [np.float32, np.float64])
@pytest.mark.parametrize("name", [name for name in QUANTISATIONS if Encoding(name).curved])
def test_a_curve_may_be_rounded(name: str, number: Any) -> None:
    """Next to a border between levels a right program may take the other one, and of 1 the level below the last."""
    of = Encoding(name)
    border = (of.interval(np.arange(254))[1] + of.interval(np.arange(1, 255))[0]) / 2
    values = np.concatenate([border * (1 + k * 2.0**-23) for k in range(-8, 9)] + [np.linspace(-0.1, 1.7, 10_001)])
    # The program has the numbers of its own precision.
    values = values.astype(number).astype(np.float64)
    levels = in_floats(name, values, number)
    assert of.makes(values, levels).all()
    assert of.distance(levels, values).max() == 0
    assert number is np.float64 or (of.encode(values) != levels).any(), "it makes a difference"
    wrong = np.where(levels < 2, levels + 2, levels - 2)
    assert not of.makes(values, wrong).any()
    assert of.distance(wrong, values).min() > 1e-5


def test_the_curve_of_1_may_be_a_little_less() -> None:
    assert in_floats("srgb-truncate", np.array([1.0, 1.7]), np.float64).tolist() == [254, 254]
    assert Encoding("srgb-truncate").distance(np.array([254, 254]), np.array([1.0, 1.7])).tolist() == [0, 0]
    assert Encoding("srgb").distance(np.array([254]), np.array([1.7]))[0] > 0.69
    assert Encoding().distance(np.array([254]), np.array([1.7]))[0] > 0.69
    assert Encoding("srgb-truncate", wraps=True).distance(np.array([254]), np.array([1.7]))[0] > 0.01


def test_the_ends_have_no_bound_and_nan_has_no_distance() -> None:
    of = Encoding()
    assert of.distance(np.array([0, 255, 255]), np.array([-1e300, 1e300, np.inf])).tolist() == [0, 0, 0]
    assert np.isnan(of.distance(np.array([3]), np.array([np.nan]))[0])
    wrapping = Encoding(wraps=True)
    assert wrapping.distance(np.array([44]), np.array([300 / 255]))[0] == 0
    assert wrapping.distance(np.array([255]), np.array([300 / 255]))[0] > 0.1


def test_an_unknown_quantisation_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown quantisation 'floor': expected one of truncate, round"):
        Encoding("floor")


def test_words_name_the_steps() -> None:
    assert Encoding("round", 65535).says == "v * 65535, rounded"
    assert Encoding("256").says == "v * 256, truncated, at most 255"
    assert Encoding("255.9", 15).says == "v * 15.9, truncated"


# ---- images compared


def encoded(of: Encoding, change: float = 0.0) -> Double:
    """The native renderer's image in bytes, a little brighter or darker."""

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        beauty = doubles.faithful(scene, passes, settings)["beauty"]
        return Passes({"beauty": of.encode(beauty + change) / of.steps}, {"levels": str(of.steps)})

    class Bytes(Double):
        encoding = of

        def passes(self, *_: Any) -> tuple[str, ...]:
            return ("beauty",)

    return Bytes(draw=draw)


@pytest.mark.parametrize("name", QUANTISATIONS)
def test_an_image_of_bytes_agrees_with_the_colours_it_was_made_of(name: str) -> None:
    for steps in (255, 1023):
        (comparison,) = validate({"scene": doubles.full()}, encoded(Encoding(name, steps)), "numpy-f64").comparisons
        assert comparison.ok, comparison.reasons
        assert comparison.max is not None
        assert comparison.max < 1e-12
        assert comparison.levels is not None
        assert comparison.levels.by_more == 0


def test_a_change_below_a_level_is_seen_where_a_level_changes() -> None:
    """3e-5 is a hundredth of a level: of a hundred pixels one goes to the next, and has to."""
    comparison, *_ = validate({"scene": doubles.full()}, encoded(Encoding(), 3e-5), "native-f64").comparisons
    assert not comparison.ok
    assert comparison.interior_over > 10
    assert comparison.max == pytest.approx(3e-5, rel=0.1)
    assert comparison.levels is not None
    assert comparison.levels.by_more == 0
    assert comparison.levels.by_one > 10


def test_two_images_of_bytes() -> None:
    result = validate({"scene": doubles.full()}, encoded(Encoding()), encoded(Encoding("round")))
    assert all(comparison.ok for comparison in result.comparisons)
    result = validate({"scene": doubles.full()}, encoded(Encoding()), encoded(Encoding("round"), 0.01))
    assert not any(comparison.ok for comparison in result.comparisons)


def test_colours_that_are_not_clamped_are_a_mistake_that_the_judge_names() -> None:
    over = doubles.full()
    over = over.replace(lights=[light.replace(intensity=(3, 3, 3)) for light in over.lights])
    wrapping = encoded(Encoding(wraps=True))
    type(wrapping).encoding = Encoding()  # type: ignore[attr-defined]
    (verdicts,) = validate({"scene": over}, wrapping, "native-f64").verdicts
    assert {verdict.renderer.cause for verdict in verdicts.verdicts} == {"mistake"}
    assert {verdict.renderer.because for verdict in verdicts.verdicts} == {
        "truth makes this pixel if it does not clamp colors: those above 1 begin again at 0"
    }


def test_what_is_shown_are_bytes() -> None:
    colors = np.array([[[0.5, 1.5, -1.0]]])
    levels = Encoding("round", 65535).encode(colors) / 65535
    one, other = encoding.shown(levels, colors, (Encoding("round", 65535), None))
    assert one.tolist() == other.tolist() == [[[127, 255, 0]]]
    assert compare.metrics.levels(one, other) == compare.metrics.Levels(0, 0, 0)
