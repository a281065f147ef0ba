"""What all pairs of several renderers say together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import doubles
import pytest
from conftest import strict
from doubles import Double, with_scene

import tracer
from validation import Validation, pairs, validate


def brighter(scene: tracer.Scene) -> tracer.Scene:
    return scene.replace(ambient=[2 * value for value in scene.ambient])


@pytest.fixture(scope="module")
def result() -> Validation:
    """Three that agree, one of them without `normal`, and one with twice the ambient light."""
    some = [Double(name="a"), Double(name="b"), Double(name="c", missing=("normal",))]
    odd = Double(name="odd", draw=with_scene(brighter))
    return validate({"full": doubles.full()}, [*some, odd], (), all_pairs=True)


def test_every_pair_is_compared_once(result: Validation) -> None:
    found = {(entry.renderer, entry.reference) for entry in result.comparisons}
    assert found == {("a", "b"), ("a", "c"), ("a", "odd"), ("b", "c"), ("b", "odd"), ("c", "odd")}
    assert len(result.comparisons) == 6 * 15 - 3


def test_every_renderer_draws_once() -> None:
    some = [Double(name=name) for name in "abcd"]
    assert validate({"full": doubles.full()}, some, (), all_pairs=True).ok
    assert [len(entry.rendered) for entry in some] == [1, 1, 1, 1]


def test_the_matrix_has_both_orders(result: Validation) -> None:
    matrix = pairs.matrix(result.comparisons)
    assert matrix["a", "b"] == matrix["b", "a"] == pairs.Cell(15, 15)
    assert matrix["c", "a"] == pairs.Cell(14, 14)
    assert matrix["odd", "b"] == pairs.Cell(15 - len(different(result)), 15)


def different(result: Validation) -> set[str]:
    return {entry.pass_name for entry in result.comparisons if not entry.ok}


def test_who_stands_alone_is_named(result: Validation) -> None:
    alone = pairs.alone(result.comparisons)
    assert {(entry.renderer, entry.others) for entry in alone} == {("odd", 3)}
    assert {entry.pass_name for entry in alone} == different(result) >= {"ambient", "beauty"}
    assert alone[0].sentence() == "full: beauty: odd stands alone against 3 that agree"


def test_two_alone_are_none() -> None:
    """Of two that differ neither is alone, nor is one of three where the others differ too."""
    two = [Double(name="a"), Double(name="odd", draw=with_scene(brighter))]
    assert not pairs.alone(validate({"full": doubles.full()}, two, (), all_pairs=True).comparisons)
    darker = Double(name="dark", draw=with_scene(lambda scene: scene.replace(ambient=(0, 0, 0))))
    three = validate({"full": doubles.full()}, [*two, darker], (), all_pairs=True)
    assert not pairs.alone(three.comparisons)


def test_who_lacks_a_pass_does_not_stand_alone() -> None:
    some = [Double(name="a"), Double(name="b"), Double(name="c", missing=("normal",))]
    result = validate({"full": doubles.full()}, some, (), all_pairs=True, passes=("normal", "id"))
    assert not pairs.alone(result.comparisons)
    assert pairs.matrix(result.comparisons)["a", "c"] == pairs.Cell(1, 1)
    assert result.counts()["c"]["normal"] == {"compared": 0, "agree": 0, "lacking": 1}
    assert not pairs.several([])


def test_what_is_lacking_is_counted(result: Validation) -> None:
    counts = result.counts()
    assert counts["c"]["normal"] == {"compared": 0, "agree": 0, "lacking": 1}
    assert counts["a"]["normal"] == {"compared": 2, "agree": 2, "lacking": 0}
    refusing = validate({"full": doubles.full()}, Double(name="a"), Double(name="no", refuses=True))
    assert refusing.counts()["no"]["beauty"] == {"compared": 0, "agree": 0, "lacking": 1}
    assert len(refusing.counts()["no"]) == 15


def test_the_command_prints_the_matrix(run: Any, tmp_path: Path, registered: Any) -> None:
    scene = tmp_path / "full.txt"
    scene.write_text(doubles.FULL, encoding="utf-8")
    registered(Double(name="odd", draw=with_scene(brighter)))
    arguments = ("--renderer", "native-f64,numpy-f64,odd", "--json", tmp_path / "r.json", "--report", tmp_path / "r")
    told = run("validate", scene, "--all-pairs", *arguments)
    assert told.status == 1
    lines = told.out.splitlines()
    at = next(place for place, line in enumerate(lines) if line.startswith("all pairs"))
    assert lines[at + 1].split() == ["native-f64", "numpy-f64", "odd"]
    assert lines[at + 2].split()[:4] == ["native-f64", "-", "15/15", lines[at + 4].split()[1]]
    assert f"{scene}: ambient: odd stands alone against 2 that agree" in told.out
    record = strict((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert {"scene": str(scene), "pass_name": "ambient", "renderer": "odd", "others": 2} in record["pairs"]["alone"]
    page = (tmp_path / "r" / "index.html").read_text(encoding="utf-8")
    assert "All pairs" in page
    assert "stands alone" in page


def test_all_pairs_of_everything(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmp_path / "full.txt"
    scene.write_text(doubles.FULL, encoding="utf-8")
    some = [Double(name="a@1"), Double(name="a@2"), Double(name="b"), Double(name="c", absent="no")]
    monkeypatch.setattr("validation.renderers.registry", lambda: registry(some))
    told = run("validate", scene, "--all-pairs", "--passes", "id")
    assert told.status == 0
    assert "1 of 1 comparisons agree" in told.out
    assert "a@1 against b" in told.out


def registry(some: list[Double]) -> Any:
    from validation.renderers import Registry

    return Registry({entry.name: entry for entry in some}, {})
