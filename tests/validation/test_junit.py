"""JUnit XML and Markdown: what pages of CI systems show of a run."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import NATIVE, one_pixel
from doubles import Double, with_arrays

import tracer
from validation import validate
from validation.junit import junit
from validation.markdown import MOST, escaped, markdown, write_markdown
from validation.renderers import Settings
from validation.run import Note, Validation


@pytest.fixture
def off(run: Any, scene: Path, tmp_path: Path, registered: Any) -> tuple[ET.Element, str]:
    """Of a renderer that is off at one pixel: the JUnit XML and the Markdown."""
    registered(Double(draw=with_arrays(one_pixel)))
    xml, text = tmp_path / "junit.xml", tmp_path / "summary.md"
    sides = ("--renderer", "double", "--against", "numpy-f64")
    assert run("validate", scene, *sides, "--junit", xml, "--markdown", text).status == 1
    return ET.parse(xml).getroot(), text.read_text()


def test_a_case_for_every_pass_and_the_verdicts(off: tuple[ET.Element, str], scene: Path) -> None:
    root, _ = off
    assert root.attrib == {"name": "whitted", "tests": "16", "failures": "2", "errors": "0", "skipped": "0"}
    (suite,) = root
    assert suite.attrib == root.attrib | {"name": "double against numpy-f64"}
    cases = {case.attrib["name"]: case for case in suite}
    assert len(cases) == 16
    assert {case.attrib["classname"] for case in suite} == {str(scene)}
    failed = {name: case.find("failure") for name, case in cases.items() if case.find("failure") is not None}
    assert set(failed) == {"beauty", "verdicts"}
    beauty, verdicts = failed["beauty"], failed["verdicts"]
    assert beauty is not None
    assert verdicts is not None
    assert beauty.attrib["message"].startswith("1 of ")
    assert "worst pixel x 30, y 20 G: " in beauty.attrib["message"]
    assert verdicts.attrib["type"] == "not explained"
    assert "double is off in beauty by 0.25" in (verdicts.text or "")


def test_the_summary_says_what_differs_and_why(off: tuple[ET.Element, str], scene: Path) -> None:
    _, text = off
    assert text.startswith("## ❌ 1 of 15 comparisons differ")
    assert "| scene | pass | renderer | against | why |\n|---|---|---|---|---|\n| " in text
    row = next(line for line in text.splitlines() if "| beauty |" in line)
    assert "| beauty | double | numpy-f64 | 1 of" in row
    assert row.count(" | ") == 4
    assert "- **not explained** " in text
    assert "| double | numpy-f64 | 1 | 14 of 15 | 0.25 |" in text
    assert f"\n    whitted validate {scene} --renderer double" in text


def test_all_agree(run: Any, scene: Path, tmp_path: Path) -> None:
    xml, text = tmp_path / "junit.xml", tmp_path / "summary.md"
    assert run("validate", scene, *NATIVE, "--junit", xml, "--markdown", text).status == 0
    assert ET.parse(xml).getroot().attrib["failures"] == "0"
    assert text.read_text().startswith("## ✅ All 15 comparisons agree")
    assert "What differs" not in text.read_text()


def test_of_a_checked_image(run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("render", scene, "-o", "mine.png", "--max-reflections", 0).status == 0
    files = ("--junit", "junit.xml", "--markdown", "summary.md")
    assert run("check", scene, "--image", "mine.png", *files).status == 1
    assert ET.parse("junit.xml").getroot().attrib["failures"] != "0"
    text = Path("summary.md").read_text()
    assert "- convention: samples at the top-left corner" in text
    assert "**wrong** " in text


def made(**more: Any) -> Validation:
    return Validation(settings=Settings(), **more)


def test_what_failed_lacks_or_is_not_done() -> None:
    result = made(
        failures=[Note("a.txt", "mine", "failed: ValueError: \x1b[31m<no>\nat all"), Note("", "", "no memory")],
        lacking={("a.txt", "mine", "depth")},
        wrong=("the rows are upside down",),
        scenes=("a.txt", "b.txt"),
        unfinished=("b.txt",),
    )
    root = ET.fromstring(junit(result))
    assert root.attrib == {"name": "whitted", "tests": "5", "failures": "1", "errors": "2", "skipped": "2"}
    first = root.find(".//error")
    assert first is not None
    assert first.attrib["message"] == "failed: ValueError: \ufffd[31m<no>"
    assert (first.text or "").endswith("\nat all")
    text = markdown(result)
    assert text.startswith("## ❌ Unfinished: 1 of 2 scenes. mine, ") or "Unfinished: 1 of 2 scenes" in text
    assert "- a.txt: mine: failed: ValueError: \x1b\\[31m\\<no\\> at all\n" in text


def test_a_long_summary_is_cut() -> None:
    notes = [Note(f"{number}.txt", "mine", "not compared") for number in range(MOST + 3)]
    text = markdown(made(notes=notes))
    assert f"{MOST - 1}.txt" in text
    assert f"\n{MOST}.txt" not in text
    assert "and 3 more notes" in text


def test_text_is_no_markup() -> None:
    assert escaped("a|b *c* <d>\n`e` _f_ [g](h)") == r"a\|b \*c\* \<d\> \`e\` \_f\_ \[g\](h)"


def test_the_page_of_a_job_is_added_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page, other = tmp_path / "step.md", tmp_path / "other.md"
    for path in (page, other):
        path.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(page))
    result = made(scenes=("a", "b"))
    for path in (page, other):
        write_markdown(path, replace(result, unfinished=("b",)))
    assert page.read_text() == "before\n", "not yet"
    assert other.read_text().startswith("## ❌ Unfinished")
    for path in (page, other):
        write_markdown(path, result)
    assert page.read_text() == "before\n" + other.read_text()


def test_the_page_of_a_job_is_known_by_another_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "step.md"
    page.write_text("before\n")
    (tmp_path / "link.md").hardlink_to(page)
    (tmp_path / "to").symlink_to(tmp_path)
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(page))
    monkeypatch.chdir(tmp_path)
    for count, path in enumerate((Path("step.md"), tmp_path / "to" / "step.md", tmp_path / "link.md"), 1):
        assert write_markdown(path, made())
        assert page.read_text().startswith("before\n")
        assert page.read_text().count("Nothing was compared") == count


def test_the_name_of_a_renderer_may_have_anything(scene: Path) -> None:
    found = validate({"one": tracer.load(scene)}, "native-f64", "native-f32", passes=["beauty"], size=(16, 12))
    found.comparisons = [replace(comparison, renderer="cmd:a\x01") for comparison in found.comparisons]
    assert ET.fromstring(junit(found))[0].attrib["name"] == "cmd:a\ufffd against native-f32"


def test_a_file_may_have_a_name_that_is_no_text(run: Any, scene: Path, tmp_path: Path) -> None:
    odd = tmp_path / os.fsdecode(b"f\xff.txt")
    odd.write_text(scene.read_text())
    files = ("--report", tmp_path / "r", "--junit", tmp_path / "j.xml", "--markdown", tmp_path / "m.md")
    assert run("validate", odd, *NATIVE, "--size", "16x12", "--quiet", *files).status == 0
    for written in ("r/index.html", "m.md", "j.xml"):
        assert "f\ufffd.txt" in (tmp_path / written).read_text()


@pytest.mark.parametrize("number", ["nan", "inf"])
def test_an_id_that_is_no_number_fails_and_is_reported(
    run: Any, scene: Path, tmp_path: Path, registered: Any, number: str
) -> None:
    def odd(arrays: Any) -> None:
        arrays["id"] = arrays["id"].astype(float)
        arrays["id"][3, 4] = float(number)

    registered(Double(draw=with_arrays(odd)))
    sides = ("validate", scene, "--renderer", "double", "--against", "numpy-f64", "--size", "16x12")
    without = run(*sides)
    assert without.status == 1
    assert ("NaN" if number == "nan" else "infinite") in without.out
    assert run(*sides, "--report", tmp_path / "r").status == 1
    assert "double delivered" in (tmp_path / "r" / "index.html").read_text()
