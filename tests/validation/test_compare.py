"""Compares pictures made by hand: what counts, what is excused, and what can never pass."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import doubles
import numpy as np
import pytest

from tracer.margins import Analysis
from tracer.passes import MARGINS, Passes
from validation import Comparison, Judge, Settings, Uncertainty, compare_passes, compare_plain

ROWS, COLUMNS = 24, 32
SHAPE = (ROWS, COLUMNS)
#: Right of this column nothing is hit; in the left column a decision is close.
HIT, NEAR = 24, 0

NAMES = ("beauty", "ambient", "diffuse", "shadow.L0", "depth", "position", "normal", "id")


def passes(**changed: Any) -> Passes:
    """What a faultless renderer would draw, some passes exchanged."""
    hit = np.zeros(SHAPE, bool)
    hit[:, :HIT] = True
    color = np.random.default_rng(7).random((*SHAPE, 3)) * hit[..., None]
    normal = np.zeros((*SHAPE, 3))
    normal[hit] = (0.6, 0.0, 0.8)
    arrays: dict[str, Any] = {
        "beauty": np.where(hit[..., None], color, 0.25),
        "ambient": color / 2,
        "diffuse": color / 2,
        "shadow.L0": hit * 1.0,
        "depth": np.where(hit, 5.0, np.inf),
        "position": np.where(hit[..., None], (1.0, 2.0, -5.0), 0.0),
        "normal": normal,
        "id": np.where(hit, 0, -1).astype(np.int32),
    }
    return Passes({**arrays, **{name.replace("shadow_L0", "shadow.L0"): array for name, array in changed.items()}})


def analysis(since: str = "primary", **margins: Any) -> Analysis:
    """One sphere: margins of 1 but in one column, sensitivity 1 everywhere, lit in the upper half.

    `since`: the margins are those of decisions at the primary hit, of its lights ("lighted"), or of what it mirrors.
    """
    stages = {stage: {kind: np.full(SHAPE, 1.0) for kind in MARGINS} for stage in ("primary", "lighted", "margins")}
    for stage in list(stages)[list(stages).index(since) :]:
        for kind, value in margins.items():
            stages[stage][kind][:, NEAR] = value
    ids = np.where(np.arange(COLUMNS) < HIT, 0, -1) * np.ones(SHAPE, np.int32)
    lit = np.zeros(SHAPE, bool)
    lit[: ROWS // 2] = True
    sensitivity = {name: np.full(SHAPE, 1.0) for name in NAMES}
    sensitivity["id"] = sensitivity["shadow.L0"] = np.zeros(SHAPE)
    return Analysis(
        **stages, sensitivity=sensitivity, outline=20.0, ids=ids, lit=[lit], beside=np.zeros(ids.shape, bool)
    )


def claim(unit: float = 0.5e-6, decision: float = 1e-6, absolute: Mapping[str, float] | None = None) -> Uncertainty:
    return Uncertainty(decision, decision, decision, decision, unit, absolute or {})


def judge(found: Analysis | None = None, a: Uncertainty | None = None, b: Uncertainty | None = None) -> Judge:
    scene = doubles.cut()
    scene = scene.replace(view=scene.view.replace(columns=COLUMNS, rows=ROWS))
    return Judge(scene, Settings(), found or analysis(), a or claim(), b or claim())


def compare(a: Passes, b: Passes, name: str, by: Judge | None = None) -> Comparison:
    (comparison,) = compare_passes(a, b, [name], by or judge(), scene="s", renderer="left", reference="right")
    return comparison


def changed(name: str, place: Any, value: Any) -> Passes:
    array = passes()[name].copy()
    array[place] = value
    return passes(**{name.replace(".", "_"): array})


@pytest.mark.parametrize("name", NAMES)
def test_equal_pictures_agree(name: str) -> None:
    comparison = compare(passes(), passes(), name)
    assert comparison.ok
    assert (comparison.max, comparison.rmse, comparison.p999, comparison.ratio) == (0, 0, 0, 0)
    assert comparison.interior_over == comparison.edge_over == 0


@pytest.mark.parametrize("name", ["beauty", "ambient", "diffuse", "position", "normal"])
def test_the_tolerance_is_the_sum_of_both_uncertainties(name: str) -> None:
    # unit (0.5e-6 + 0.5e-6) times sensitivity 1; a unit normal may also be off by one unit of each in its length.
    limit = 2e-6 if name == "normal" else 1e-6
    place = (5, 5, 0)
    base = passes()[name][place]
    assert compare(changed(name, place, base + 0.99 * limit), passes(), name).ok
    over = compare(changed(name, place, base + 1.01 * limit), passes(), name)
    assert over.interior_over == 1
    assert not over.ok
    assert over.tolerance == pytest.approx(limit)
    assert over.ratio == pytest.approx(1.01, rel=1e-6)
    assert over.worst is not None
    assert (over.worst.x, over.worst.y) == (5, 5)


def test_the_tolerance_counts_absolute_errors_of_the_quantity() -> None:
    by = judge(a=claim(absolute={"color": 1e-3}))
    assert compare(changed("ambient", (5, 5, 1), passes()["ambient"][5, 5, 1] + 1e-3), passes(), "ambient", by).ok
    assert not compare(changed("depth", (5, 5), 5.001), passes(), "depth", by).ok


def test_an_absolute_error_of_one_pass_loosens_no_other() -> None:
    by = judge(a=claim(absolute={"color": 0.0, "beauty": 1e-3}), b=claim(absolute={"beauty": 1e-3}))
    for name, ok in (("beauty", True), ("ambient", False)):
        assert compare(changed(name, (5, 5, 1), passes()[name][5, 5, 1] + 1.9e-3), passes(), name, by).ok == ok
    assert not compare(changed("beauty", (5, 5, 1), passes()["beauty"][5, 5, 1] + 2.1e-3), passes(), "beauty", by).ok


def test_tolerances_may_differ_from_pixel_to_pixel() -> None:
    unit = np.zeros(SHAPE)
    unit[5, 5] = 1e-3
    by = judge(a=dataclasses.replace(claim(), unit=unit))
    assert compare(changed("depth", (5, 5), 5.0009), passes(), "depth", by).ok
    assert not compare(changed("depth", (5, 6), 5.0009), passes(), "depth", by).ok


@pytest.mark.parametrize("kind", MARGINS)
def test_a_pixel_near_a_decision_is_an_edge_for_the_less_certain_renderer(kind: str) -> None:
    wrong = changed("beauty", (5, NEAR, 0), 7.0)
    for side in ("a", "b"):
        sure, unsure = judge(analysis(**{kind: 1e-5})), judge(analysis(**{kind: 1e-5}), **{side: claim(decision=1e-4)})
        assert compare(wrong, passes(), "beauty", sure).interior_over == 1
        excused = compare(wrong, passes(), "beauty", unsure)
        assert excused.ok
        assert (excused.edge, excused.edge_over, excused.interior) == (ROWS, 1, ROWS * (COLUMNS - 1))


@pytest.mark.parametrize("kind", MARGINS)
@pytest.mark.parametrize(
    ("since", "strict", "excused"),
    [
        ("lighted", ("id", "depth", "position", "normal", "ambient"), "diffuse"),
        ("margins", ("id", "depth", "position", "normal", "ambient", "diffuse", "shadow.L0"), "beauty"),
    ],
)
def test_a_later_decision_excuses_nothing_before_it(
    kind: str, since: str, strict: tuple[str, ...], excused: str
) -> None:
    by = judge(analysis(since, **{kind: 0.0}))
    for name in strict:
        value = {"id": 1, "shadow.L0": 0.0}.get(name, 6.0)
        assert not compare(changed(name, (5, NEAR), value), passes(), name, by).ok
    assert compare(changed(excused, (5, NEAR, 0), 9.0), passes(), excused, by).ok


def test_a_margin_that_is_no_number_makes_an_edge() -> None:
    assert compare(passes(), passes(), "beauty", judge(analysis(order=np.nan))).edge == ROWS


def test_a_pixel_without_a_bound_is_counted_as_an_edge() -> None:
    found = analysis()
    found.sensitivity["beauty"][3, 4] = np.inf
    found.sensitivity["beauty"][3, 5] = np.nan
    assert compare(passes(), passes(), "beauty", judge(found)).edge == 2


@pytest.mark.parametrize("unbounded", [np.inf, np.nan])
def test_a_pixel_without_a_bound_is_held_to_the_largest_of_the_interior(unbounded: float) -> None:
    found = analysis()
    found.sensitivity["beauty"][3, 4] = unbounded
    found.sensitivity["beauty"][8, 8] = 50.0  # times a unit of 1e-6: the largest tolerance is 5e-5
    base = passes()["beauty"][3, 4, 0]
    for error, over in ((4.9e-5, 0), (5.1e-5, 1), (0.5, 1)):
        comparison = compare(changed("beauty", (3, 4, 0), base + error), passes(), "beauty", judge(found))
        assert (comparison.edge, comparison.edge_over, comparison.interior_over) == (1, over, 0)
        assert comparison.ok
    found.sensitivity["beauty"][:] = unbounded
    alone = compare(changed("beauty", (3, 4, 0), base + 1e-9), passes(), "beauty", judge(found))
    assert (alone.interior, alone.edge_over) == (0, 1)


@pytest.mark.parametrize("kind", MARGINS)
@pytest.mark.parametrize("side", ["a", "b"])
def test_too_many_edge_pixels_are_a_failure_even_of_equal_pictures(kind: str, side: str) -> None:
    by = judge(**{side: dataclasses.replace(claim(), **{kind: 2.0})})
    comparison = compare(passes(), passes(), "beauty", by)
    assert comparison.edge == ROWS * COLUMNS
    assert not comparison.ok
    assert "too many edge pixels: 768 of 768" in comparison.reasons[0]


@pytest.mark.parametrize("kind", MARGINS)
@pytest.mark.parametrize("claimed", [2.0, np.inf])
def test_what_is_claimed_for_a_few_pixels_does_not_raise_the_limit(kind: str, claimed: float) -> None:
    few = np.full(SHAPE, 1e-6)
    few[: ROWS // 3] = claimed
    by = judge(a=dataclasses.replace(claim(), **{kind: few}))
    assert by.edge_cap() == judge().edge_cap()
    assert "too many edge pixels" in compare(passes(), passes(), "beauty", by).reasons[0]


def test_the_limit_of_edge_pixels() -> None:
    # 20 pixels of outlines and the frame, 2 (24 + 32), once a hit: there is no mirror. What is claimed changes nothing.
    for decision in (0.0, 1e-6, 1e-4, 1.0):
        assert judge(a=claim(decision=decision), b=claim(decision=0.0)).edge_cap() == 132
    # Never more than a quarter of the image.
    assert judge(dataclasses.replace(analysis(), outline=1e4)).edge_cap() == ROWS * COLUMNS // 4


def test_a_margin_exactly_at_the_uncertainty_is_interior() -> None:
    assert compare(passes(), passes(), "beauty", judge(analysis(order=1e-6))).edge == 0
    assert compare(passes(), passes(), "beauty", judge(analysis(order=0.999e-6))).edge == ROWS


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("side", [0, 1])
def test_nan_never_passes(name: str, side: int) -> None:
    # Also where nothing is compared, and in both pictures alike.
    for place in ((5, 5), (5, NEAR), (ROWS - 1, 5), (5, COLUMNS - 1)):
        if name == "id":
            array = passes()["id"].astype(np.float64)
            array[place] = np.nan
            wrong = passes(id=array)
        else:
            wrong = changed(name, place, np.nan)
        pair = [passes(), passes()]
        pair[side] = wrong
        by = judge(analysis(silhouette=0.0))
        comparison = compare(*pair, name, by)
        assert not comparison.ok
        assert any("NaN" in reason and f"x {place[1]}, y {place[0]}" in reason for reason in comparison.reasons)
        assert not compare(wrong, wrong, name, by).ok
        json.dumps(comparison.record(), allow_nan=False)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("id", "shadow.L0")])
@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_infinity_never_passes_where_something_is_hit(name: str, value: float) -> None:
    wrong = changed(name, (5, 5), value)
    for pair in ((wrong, passes()), (passes(), wrong), (wrong, wrong)):
        comparison = compare(*pair, name)
        assert not comparison.ok
        assert any("infinite" in reason for reason in comparison.reasons)
        json.dumps(comparison.record(), allow_nan=False)


def test_infinity_is_the_depth_of_a_miss_and_of_nothing_else() -> None:
    assert compare(passes(), passes(), "depth").ok
    place = (5, COLUMNS - 1)
    assert not compare(changed("depth", place, -np.inf), passes(), "depth").ok
    assert not compare(changed("depth", place, 1e9), passes(), "depth").ok
    assert not compare(changed("beauty", place, np.inf), changed("beauty", place, np.inf), "beauty").ok


@pytest.mark.parametrize(("name", "value"), [("depth", 0.0), ("position", 1.0), ("normal", 1.0), ("shadow.L0", 1.0)])
def test_what_a_miss_holds_is_checked(name: str, value: float) -> None:
    comparison = compare(changed(name, (7, COLUMNS - 2), value), passes(), name)
    assert not comparison.ok
    assert "hits nothing, first at x 30, y 7" in comparison.reasons[0]


def test_hits_are_compared_by_id_alone() -> None:
    ids = passes()["id"].copy()
    ids[5, 5] = -1
    hole = passes(
        id=ids,
        depth=np.where(ids >= 0, 5.0, np.inf),
        position=passes()["position"] * (ids >= 0)[..., None],
        normal=passes()["normal"] * (ids >= 0)[..., None],
        shadow_L0=passes()["shadow.L0"] * (ids >= 0),
    )
    assert compare(hole, passes(), "id").interior_over == 1
    for name in ("depth", "position", "normal", "shadow.L0"):
        assert compare(hole, passes(), name).ok, "where only one of the two hits there is nothing to compare"


def test_another_sphere_is_an_error_of_id() -> None:
    comparison = compare(changed("id", (3, 4), 1), passes(), "id")
    assert not comparison.ok
    assert comparison.worst is not None
    assert (comparison.worst.a, comparison.worst.b) == (1, 0)
    assert comparison.ratio == math.inf
    assert comparison.record()["ratio"] == "inf"


def test_without_ids_the_analysis_says_what_is_hit() -> None:
    without = Passes({name: array for name, array in passes().items() if name != "id"})
    assert compare(without, passes(), "depth").ok
    assert not compare(Passes({"depth": np.full(SHAPE, 5.0)}), passes(), "depth").ok


def test_shadow_is_compared_where_the_light_is_above_the_surface() -> None:
    assert not compare(changed("shadow.L0", (0, 5), 0), passes(), "shadow.L0").ok
    assert compare(changed("shadow.L0", (ROWS - 1, 5), 0), passes(), "shadow.L0").ok


def test_visibility_is_zero_or_one() -> None:
    half = changed("shadow.L0", (ROWS - 1, 5), 0.5)
    assert "neither 0 nor 1" in compare(half, passes(), "shadow.L0").reasons[0]


def test_a_normal_of_another_length_differs() -> None:
    assert not compare(passes(normal=passes()["normal"] * 1.001), passes(), "normal").ok


def test_a_missing_pass_is_a_failure() -> None:
    without = Passes({name: array for name, array in passes().items() if name != "ambient"})
    for pair, who in (((without, passes()), "left"), ((passes(), without), "right")):
        comparison = compare(*pair, "ambient")
        assert comparison.reasons == (f"{who} did not deliver the pass 'ambient'",)
        assert comparison.max is None
        assert comparison.record()["worst"] is None


@pytest.mark.parametrize("shape", [(ROWS, COLUMNS - 1), (ROWS - 1, COLUMNS), (COLUMNS, ROWS), (1, 1)])
def test_another_size_is_a_failure(shape: tuple[int, int]) -> None:
    small = Passes({"ambient": np.zeros((*shape, 3))})
    for pair in ((small, passes()), (passes(), small)):
        comparison = compare(*pair, "ambient")
        assert f"delivered {shape[1]}x{shape[0]} pixels, expected 32x24" in comparison.reasons[0]
    both = compare(small, small, "ambient")
    assert len(both.reasons) == 2, "both may be wrong in the same way"


def test_arrays_of_the_wrong_shape_are_no_passes() -> None:
    with pytest.raises(ValueError, match="shape"):
        Passes({"ambient": np.zeros(SHAPE)})
    with pytest.raises(ValueError, match="size"):
        Passes({"ambient": np.zeros((*SHAPE, 3)), "depth": np.zeros((2, 2))})


@pytest.mark.parametrize("kind", [complex, object, "U3"])
def test_values_that_are_no_real_numbers_are_no_passes(kind: Any) -> None:
    with pytest.raises(ValueError, match="expected numbers"):
        Passes({"depth": np.zeros(SHAPE).astype(kind)})


def test_the_record_has_what_the_format_promises() -> None:
    comparison = compare(changed("beauty", (2, 3, 1), 9.0), passes(), "beauty")
    record = json.loads(json.dumps(comparison.record(), allow_nan=False))
    assert set(record) == doubles.KEYS | {"levels", "psnr", "ciede2000", "reason"}
    assert record["size"] == [COLUMNS, ROWS]
    assert [record[key] for key in ("scene", "renderer", "reference", "pass")] == ["s", "left", "right", "beauty"]
    assert {key: record["worst"][key] for key in ("x", "y", "channel", "a")} == {"x": 3, "y": 2, "channel": "G", "a": 9}
    assert record["ok"] is False
    assert record["levels"]["by_more"] == 1
    assert "levels" not in compare(passes(), passes(), "depth").record()
    assert compare(passes(), passes(), "beauty").record()["psnr"] == "inf"


def test_errors_on_edges_are_measured_but_excused() -> None:
    by = judge(analysis(silhouette=0.0))
    comparison = compare(changed("diffuse", (5, NEAR, 2), 3.0), passes(), "diffuse", by)
    assert comparison.ok
    assert comparison.max is not None
    assert comparison.max > 2
    assert comparison.ratio == 0
    assert comparison.worst is not None
    assert comparison.worst.channel == "B"


def test_the_worst_pixel_is_an_inexcusable_one() -> None:
    by = judge(analysis(silhouette=0.0))
    array = passes()["diffuse"].copy()
    array[5, NEAR, 0], array[6, 7, 1] = 1e9, 2.0
    comparison = compare(passes(diffuse=array), passes(), "diffuse", by)
    assert comparison.worst is not None
    assert (comparison.worst.x, comparison.worst.y) == (7, 6)


def test_plain_comparison_is_for_equal_bits_unless_told_otherwise() -> None:
    third = passes(depth=passes()["depth"] * (1 + 2**-52))
    assert compare_plain(passes(), passes(), "depth", 0.0).ok
    assert not compare_plain(passes(), third, "depth", 0.0).ok
    assert compare_plain(passes(), third, "depth", 1e-9).ok
    assert not compare_plain(changed("depth", (0, 0), np.nan), changed("depth", (0, 0), np.nan), "depth", 1.0).ok
    assert "pixels" in compare_plain(passes(), Passes({"depth": np.zeros((2, 2))}), "depth", 0.0).reasons[0]
