"""What other commands found, in the report: curves and plots whose points name themselves, tables, and errors."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from validation.cli import main
from validation.report.included import IncludeError, read, value

NATIVE = ("--renderer", "native-f64", "--against", "numpy-f64", "--size", "16x12")


def made(*words: object) -> None:
    arguments = [*map(str, words)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["whitted", *arguments])
        with pytest.raises(SystemExit) as status:
            main(arguments)
    assert status.value.code == 0


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of stability.json and speed.json, of two renderers each."""
    folder = tmp_path_factory.mktemp("results")
    scene = Path(__file__).resolve().parents[2] / "scenes" / "gallery" / "mirrors.txt"
    made("stability", "-q", "--ladder", "speck,far-on-axis", "--renderer", "native-f64,native-f32", "--jobs", 1,
         "--json", folder / "stability.json")  # fmt: skip
    made("speed", "-q", scene, "--size", "24x24", "--renderer", "native-f64@scalar,numpy-f64", "--seconds", 0.01,
         "--rounds", 2, "--pixels", 20, "--edges", 2, "--json", folder / "speed.json")  # fmt: skip
    return folder


def titles(path: Path) -> list[str]:
    """What the points say, in all plots of a file."""
    return [text for figure in read(path).figures for text in re.findall("<title>(.*?)</title>", figure.svg)]


def test_every_point_of_a_curve_says_its_numbers(results: Path) -> None:
    record = json.loads((results / "stability.json").read_text())
    told = titles(results / "stability.json")
    expected = []
    for ladder in record["ladders"]:
        for rung in ladder["rungs"]:
            for name, step in rung["steps"].items():
                error = "no pixel that it claims to tell" if step["error"] is None else f"{step['error']:.3g}"
                wrong = f"{step['wrong']} wrong decision{'s' * (step['wrong'] != 1)}"
                head = f"{name}, {ladder['parameter']} {rung['rung']}: "
                clause = error if step["error"] is None else f"largest error {error}"
                text = f"{head}{clause}, {wrong}, {step['own']['colors']} of {rung['proved']} pixels held to its claim"
                # Once in each of the panels; where nothing is held there is no error to draw.
                expected += [text] * (2 + (step["error"] is not None))
    assert sorted(told) == sorted(expected)
    assert len(told) > 100


def test_every_point_of_speed_says_its_numbers(results: Path) -> None:
    record = json.loads((results / "speed.json").read_text())
    expected = []
    for entry in record["scenes"][0]["entries"]:
        threads = f"{entry['threads']} thread{'s' * (entry['threads'] > 1)}"
        text = f"{entry['name']}, {threads}: {entry['ns_per_pixel']:.3g} ns/pixel, "
        text += f"RMSE {entry['errors']['random_rmse']:.3g}" + ", on the front" * entry["front"]
        expected.append(text)
    assert sorted(titles(results / "speed.json")) == sorted(expected)
    assert any("on the front" in text for text in expected)


def test_tables_say_the_same_as_the_plots(results: Path) -> None:
    record = json.loads((results / "stability.json").read_text())
    ladder, figure = record["ladders"][1], read(results / "stability.json").figures[1]
    assert [*figure.table.headings] == [ladder["parameter"], "native-f64", "native-f32"]
    for row, rung in zip(figure.table.rows, ladder["rungs"], strict=True):
        assert row[0] == rung["rung"]
        for cell, name in zip(row[1:], ("native-f64", "native-f32"), strict=True):
            error = rung["steps"][name]["error"]
            assert cell.partition(",")[0] == ("claims nothing" if error is None else f"{error:.3g}")
    assert any("claims nothing more: native-f32 from" in line for line in figure.sums)
    entries = json.loads((results / "speed.json").read_text())["scenes"][0]["entries"]
    rows = read(results / "speed.json").figures[0].table.rows
    assert [row[0] for row in rows] == [entry["name"] for entry in entries]


def test_a_break_is_ringed_and_a_failure_told(results: Path, tmp_path: Path) -> None:
    record = json.loads((results / "stability.json").read_text())
    ladder = record["ladders"][1]
    ladder["breaks"]["native-f32"] = ladder["rungs"][2]["rung"]
    last = ladder["rungs"][-1]["steps"]["native-f64"]
    last |= {"own": None, "careful": None, "error": None, "failed": "crashed <here>"}
    ladder["rungs"][0]["steps"]["native-f64"]["error"] = "inf"
    (tmp_path / "more.json").write_text(json.dumps(record))
    figure = read(tmp_path / "more.json").figures[1]
    assert figure.svg.count('class="ring"') == 2
    assert figure.svg.count("it first breaks here") == 3
    assert any(line.startswith("native-f32 breaks at ") for line in figure.sums)
    assert figure.table.rows[-1][1] == "crashed <here>"
    assert "<here>" not in figure.svg
    assert "nan" not in figure.svg


def test_numbers_that_are_none() -> None:
    assert value("inf") == math.inf
    assert math.isnan(value(None))
    assert math.isnan(value("nan"))


@pytest.mark.parametrize(
    ("text", "says"),
    {
        "no JSON": ("{", "is no JSON"),
        "a list": ("[]", "is no result of whitted"),
        "another result": ('{"comparisons": []}', "holds no stability curves and no speeds"),
        "a field is missing": ('{"kind": "stability", "ladders": [], "versions": {}}', "it has no 'renderers'"),
        "a field is something else": (
            '{"kind": "stability", "ladders": 3, "renderers": [], "versions": {}, "command": []}',
            "is damaged",
        ),
        "nested deeply": ("[" * 100_000, "is nested too deeply"),
        "infinite": ('{"kind": "speed", "scenes": [Infinity]}', "Infinity is no finite number"),
        "beyond float64": ('{"kind": "speed", "scenes": [1e999]}', "1e999 is no finite number"),
        "half a character": ('{"kind": "speed", "command": ["\\ud800"]}', "has text that is no Unicode"),
        "a speed without its scene": ('{"kind": "speed", "machine": {}, "scenes": [{}], "versions": {}}', "it has no"),
    }.values(),
)
def test_other_files_are_refused_before_anything_is_drawn(
    run: Any, scene: Path, tmp_path: Path, text: str, says: str
) -> None:
    path = tmp_path / "some.json"
    path.write_text(text)
    with pytest.raises(IncludeError, match=re.escape(says)):
        read(path)
    result = run("validate", scene, *NATIVE, "--report", tmp_path / "out", "--include", path)
    assert (result.status, result.out) == (2, "")
    assert f"error: --include: {path}" in result.err
    assert "hint: whitted stability --json FILE" in result.err
    assert not (tmp_path / "out").exists()


def test_numbers_too_large_for_an_axis_are_refused(results: Path, tmp_path: Path) -> None:
    record = json.loads((results / "speed.json").read_text())
    record["scenes"][0]["entries"][0]["ns_per_pixel"] = 1.7e308
    (tmp_path / "large.json").write_text(json.dumps(record))
    with pytest.raises(IncludeError, match="too large to draw"):
        read(tmp_path / "large.json")


def test_what_is_included_needs_a_report_and_is_there(run: Any, scene: Path, results: Path, tmp_path: Path) -> None:
    result = run("validate", scene, *NATIVE, "--include", results / "speed.json")
    assert result.status == 2
    assert "--report DIR --include FILE" in result.err
    assert run("validate", scene, *NATIVE, "--report", tmp_path / "out", "--include", tmp_path / "none").status == 2


@pytest.mark.browser
@pytest.mark.parametrize("scripted", [True, False])
def test_a_point_under_the_pointer_is_named(
    browser: Any, scene: Path, results: Path, tmp_path: Path, *, scripted: bool
) -> None:
    both = [word for name in ("stability", "speed") for word in ("--include", results / f"{name}.json")]
    made("validate", "-q", scene, *NATIVE, "--report", tmp_path / "out", *both)
    context = browser.new_context(viewport={"width": 1280, "height": 720}, java_script_enabled=scripted)
    page = context.new_page()
    page.goto((tmp_path / "out" / "index.html").as_uri())
    place = page.locator("#report")
    if scripted:
        page.wait_for_function("document.getElementById('v-stage').dataset.ready")
        page.locator("#v-summary-open").click()
        place = page.locator("#v-summary")
    every = titles(results / "stability.json") + titles(results / "speed.json")
    points = place.locator("svg.plot .point")
    assert points.locator("title").all_text_contents() == every
    named = 0
    for index in range(0, len(every), max(1, len(every) // 25)):
        point = points.nth(index)
        point.scroll_into_view_if_needed()
        box = point.locator(".reach").bounding_box()
        assert box["width"] >= 8, "large enough to be met"
        if scripted:
            # What lies there is the point, or a neighbour that covers it; its title is what the browser shows.
            found = page.evaluate(
                "([x, y]) => document.elementFromPoint(x, y)?.closest('.point')?.querySelector('title').textContent",
                [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2],
            )
            assert found in every
            named += found == every[index]
    assert not scripted or named > 15
    # The numbers for those who do not see the plot, and how to repeat it.
    assert place.locator("svg.plot[role=img][aria-label]").count() == 3
    commands = place.locator(".included .repeat code").all_text_contents()
    assert [command.split()[1] for command in commands] == ["stability", "speed"]
    place.locator(".plotted details summary").first.click()
    assert place.locator(".plotted table tbody tr").first.is_visible()
    context.close()
