"""What is finished is on the disk, whole, while a run goes on, and stays there when it ends early."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import click
import doubles
import pytest
from conftest import strict
from doubles import Double, with_arrays
from test_schema import STRICT

import tracer
from tracer.passes import replaceable
from validation import proofs, speed, speed_kernels, validate
from validation.commands import results
from validation.commands.results import Results
from validation.timing import Pulse, TimeLeft, duration


@pytest.fixture
def three(tmp_path: Path) -> list[Path]:
    """Three scenes."""
    paths = [tmp_path / f"{name}.txt" for name in ("one", "two", "three")]
    for path in paths:
        path.write_text(doubles.FULL)
    return paths


class Stops(Double):
    """Ends as with Ctrl-C when it draws the scene after so many."""

    def __init__(self, after: int) -> None:
        super().__init__(draw=with_arrays(lambda _: None))
        self.left = after

    def render(self, *arguments: Any) -> Any:
        if not self.left:
            raise KeyboardInterrupt
        self.left -= 1
        return super().render(*arguments)


def test_interrupted_in_the_third_scene_two_are_kept(
    run: Any, three: list[Path], tmp_path: Path, registered: Any
) -> None:
    registered(Stops(2))
    files = ("--json", tmp_path / "r.json", "--report", tmp_path / "report")
    ended = run("validate", *three, "--renderer", "double", "--against", "native-f64", "--size", "16x12", *files)
    page = tmp_path / "report" / "index.html"
    assert ended.status == 130
    assert ended.err == f"\ninterrupted: kept {tmp_path / 'r.json'} and {page} with 2 of 3 scenes\n"
    assert ended.out.endswith("\n30 of 30 comparisons agree, 1 of 3 scenes are missing\n")
    record = strict((tmp_path / "r.json").read_text())
    assert (record["ok"], record["unfinished"]) == (False, [str(three[2])])
    assert {entry["scene"] for entry in record["comparisons"]} == {str(path) for path in three[:2]}
    text = page.read_text()
    assert "<h1>Unfinished: 2 of 3 scenes. All 30 comparisons agree" in text
    assert text.rstrip().endswith("</html>")
    assert "two.txt" in text
    assert f"<li>{three[2]}</li>" in text
    assert text.count("three.txt") == 3, "there, and in the command, which the viewer has, too"


def test_what_is_half_done_is_not_in_the_report(run: Any, three: list[Path], tmp_path: Path, registered: Any) -> None:
    """The first pair of the second scene is in the report before the second pair stops it."""
    registered(Stops(1))
    sides = ("--renderer", "native-f64", "--against", "numpy-f64,double", "--size", "16x12")
    ended = run("validate", *three[:2], *sides, "--report", tmp_path / "report", "--json", tmp_path / "r.json")
    assert ended.status == 130
    record = strict((tmp_path / "r.json").read_text())
    assert {entry["scene"] for entry in record["comparisons"]} == {str(three[0])}
    page = (tmp_path / "report" / "index.html").read_text()
    assert 'id="s1"' in page
    assert 'id="s2"' not in page


def test_interrupted_in_the_first_scene_nothing_is_written(
    run: Any, three: list[Path], tmp_path: Path, registered: Any
) -> None:
    registered(Stops(0))
    sides = ("--renderer", "double", "--against", "native-f64", "--size", "16x12")
    ended = run("validate", *three, *sides, "--json", tmp_path / "r.json")
    assert (ended.status, ended.out) == (130, "")
    assert ended.err == "\ninterrupted: nothing was finished, nothing was written\n"
    assert not (tmp_path / "r.json").exists()
    assert run("validate", *three, *sides).err == "\ninterrupted\n"


def test_the_files_are_whole_after_every_scene(
    run: Any, three: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "SHARE", float("inf"))
    seen: list[tuple[int, bool]] = []
    real = Results.scene

    def scene(self: Results, result: Any) -> None:
        real(self, result)
        page = (tmp_path / "report" / "index.html").read_text() if result.unfinished else ""
        record = strict((tmp_path / "r.json").read_text()) if result.unfinished else {}
        seen.append((len(record.get("unfinished", [])), page.rstrip().endswith("</html>")))
        assert f"Unfinished: {3 - len(result.unfinished)} of 3 scenes" in page or not result.unfinished

    monkeypatch.setattr(Results, "scene", scene)
    files = ("--json", tmp_path / "r.json", "--report", tmp_path / "report")
    ended = run("validate", *three, "--renderer", "native-f64", "--against", "native-f32", "--size", "16x12", *files)
    assert ended.status == 0
    assert seen == [(2, True), (1, True), (0, False)]
    assert strict((tmp_path / "r.json").read_text())["unfinished"] == []
    assert "Unfinished" not in (tmp_path / "report" / "index.html").read_text()
    assert not list(tmp_path.rglob(".whitted-*"))


QUICK = ("--renderer", "native-f64", "--against", "native-f32", "--size", "16x12")


def test_a_pipe_gets_one_document_at_the_end(
    run: Any, three: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert not replaceable(tmp_path / "pipe")
    monkeypatch.setattr(results, "SHARE", float("inf"))
    out = run("validate", *three, *QUICK, "--quiet", "--junit", "/dev/stdout").out
    document, _, last = out.rpartition("</testsuites>\n")
    assert ET.fromstring(f"{document}</testsuites>").attrib["skipped"] == "0"
    assert last == "45 of 45 comparisons agree\n"


@pytest.mark.parametrize("command", ["validate", "check"])
def test_a_reader_that_has_gone_loses_no_file(three: list[Path], tmp_path: Path, command: str) -> None:
    sides = (
        QUICK
        if command == "validate"
        else ("--command", f"{Path(sysconfig.get_path('scripts'), 'raytrace')} {{scene}}")
    )
    words = [command, *map(str, three), *sides, "--json", str(tmp_path / "p.json"), "--report", str(tmp_path / "r")]
    ours, theirs = os.pipe()
    os.close(ours)
    code = "from validation import cli; from validation.commands import results; results.SHARE = 1e9; cli.main()"
    done = subprocess.run([sys.executable, "-c", code, *words], stdout=theirs, stderr=subprocess.PIPE, check=False)
    os.close(theirs)
    assert (done.returncode, done.stderr) == (141, b"")
    assert strict((tmp_path / "p.json").read_text())["unfinished"] == []
    page = (tmp_path / "r" / "index.html").read_text()
    assert page.rstrip().endswith("</html>")
    assert "Unfinished" not in page


def test_an_interrupted_run_writes_before_it_tells(tmp_path: Path) -> None:
    outputs = results.Outputs(None, False, (), False, tmp_path / "r.json", None, None)
    files = Results(click.Context(click.Command("x")), ["whitted"], outputs)

    def gone(_: Any) -> None:
        raise BrokenPipeError

    files.kept = validate({"one": doubles.full()}, "native-f64", "native-f32", size=(16, 12))
    files.kept.scenes, files.kept.unfinished = ("one", "two"), ("two",)
    with pytest.raises(BrokenPipeError), files.keeping(gone):
        raise KeyboardInterrupt
    assert strict((tmp_path / "r.json").read_text())["unfinished"] == ["two"]


def test_what_is_not_added_to_the_page_of_a_job_is_not_kept(
    run: Any, three: list[Path], tmp_path: Path, registered: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "step.md"
    page.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(page))
    registered(Stops(2))
    sides = ("--renderer", "double", "--against", "native-f64", "--size", "16x12")
    assert run("validate", *three, *sides, "--markdown", page).err == "\ninterrupted: 2 of 3 scenes were finished\n"
    assert page.read_text() == "before\n"


def test_writing_again_takes_a_share_of_the_time(
    run: Any, three: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []
    real = Results.write

    def write(self: Results, result: Any, record: Any = None, **options: Any) -> list[Path]:
        written.append(len(result.unfinished))
        paths = real(self, result, record, **options)
        self._took = 1000.0  # as if it were a large one
        return paths

    monkeypatch.setattr(Results, "write", write)
    run("validate", *three, "--renderer", "native-f64", "--against", "native-f32", "--json", tmp_path / "r.json")
    assert written == [2, 0], "after the first scene and at the end"


def stopping(real: Any, after: int) -> Any:
    """The same generator, ended as with Ctrl-C."""

    def stops(*arguments: Any, **options: Any) -> Any:
        found = real(*arguments, **options)
        for _ in range(after):
            yield next(found)
        found.close()
        raise KeyboardInterrupt

    return stops


def test_proved_pixels_are_kept_an_image_that_lacks_some_is_not(
    run: Any, three: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(proofs, "proved", stopping(proofs.proved, 30))
    file, image = tmp_path / "truth.json", tmp_path / "truth.npz"
    ended = run("truth", three[0], "--size", "16x12", "--pixels", "all", "--json", file, "-o", image)
    assert ended.status == 130
    lost = f"{image} is not written, as it would lack the others"
    assert ended.err == f"\ninterrupted: kept {file} with 30 of 192 pixels; {lost}\n"
    assert "  proved         30 pixels" in ended.out
    record = strict(file.read_text())
    STRICT.validate(record)
    assert record["interrupted"] is True
    assert len(record["scenes"][0]["pixels"]) == record["scenes"][0]["summary"]["pixels"] == 30
    assert not image.exists()
    bare = run("truth", *three[:2], "--pixels", 50)
    assert bare.err == "\ninterrupted: 30 of 100 pixels were finished\n"


def test_certificates_are_kept(run: Any, three: list[Path], tmp_path: Path, registered: Any) -> None:
    registered(Stops(1))
    file = tmp_path / "truth.json"
    words = ("--renderer", "double", "--pixels", 10, "--edges", 1, "--size", "16x12", "--json", file)
    ended = run("truth", *three, *words)
    assert (ended.status, ended.err) == (130, f"\ninterrupted: kept {file} with 1 of 3 certificates\n")
    record = strict(file.read_text())
    STRICT.validate(record)
    assert (record["ok"], record["interrupted"], len(record["certificates"])) == (False, True, 1)


def test_where_nothing_is_finished_that_is_said(
    run: Any, three: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stops(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(speed._SceneRun, "start", stops)
    monkeypatch.setattr("validation.stability.climb", stops)
    monkeypatch.setattr("validation.stability._in_processes", stops)
    file = tmp_path / "x.json"
    for words in (("speed", three[0], *SPEED), ("stability", "--ladder", "speck", "--renderer", "native-f32")):
        assert run(*words).err == "\ninterrupted\n"
        ended = run(*words, "--json", file)
        assert (ended.status, ended.out) == (130, "")
        assert ended.err == "\ninterrupted: nothing was finished, nothing was written\n"
        assert not file.exists()


SPEED = ("--size", "16x12", "--renderer", "native-f32@scalar", "--threads", 1, "--pixels", 4, "--edges", 1)


def test_measurements_are_kept(run: Any, three: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = speed._SceneRun.warm
    times: list[int] = []

    def warm(self: Any, *arguments: Any) -> None:
        real(self, *arguments)
        times.append(1)
        if len(times) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(speed._SceneRun, "warm", warm)
    file, page = tmp_path / "speed.json", tmp_path / "report" / "index.html"
    quick = ("--seconds", 0.01, "--rounds", 3, "--json", file, "--report", page.parent)
    ended = run("speed", *three, *SPEED, *quick)
    assert (ended.status, ended.err) == (130, f"\ninterrupted: kept {file} and {page} with 2 measurements\n")
    record = strict(file.read_text())
    STRICT.validate(record)
    assert (record["ok"], record["interrupted"]) == (False, True)
    assert [len(scene["entries"]) for scene in record["scenes"]] == [1, 1]
    assert "two.txt" in page.read_text()


def test_the_kernels_keep_to_the_limit_and_what_is_measured(
    run: Any, three: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stops(*_: Any) -> None:
        raise KeyboardInterrupt

    file = tmp_path / "speed.json"
    words = (*SPEED, "--kernels", "--seconds", 0.01, "--rounds", 3, "--json", file)
    late = run("speed", three[0], *words, "--limit", 0.01)
    assert "kernels by size: the time was up: --limit gives more" in late.out
    assert strict(file.read_text())["kernels"]["rows"] == []
    monkeypatch.setattr(speed_kernels, "_measure", stops)
    ended = run("speed", three[0], *words)
    assert (ended.status, ended.err) == (130, f"\ninterrupted: kept {file} with 1 measurement\n")
    record = strict(file.read_text())
    STRICT.validate(record)
    assert record["interrupted"] is True


def test_a_long_judging_says_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Pulse, "due", lambda _: True)
    told: list[str] = []
    scene = tracer.loads(doubles.FULL)
    wrong = Double(draw=with_arrays(lambda arrays: arrays["beauty"].fill(0.5)))
    validate({"one": scene, "two": scene}, wrong, "native-f64", passes=["beauty"], progress=told.append, verdicts=3)
    pair = "double against native-f64"
    assert told[:2] == [f"scene 1 of 2: one: {pair}", f"scene 1 of 2: 0 of 3 pixels judged: one: {pair}"]
    assert re.fullmatch(rf"scene 1 of 2: 2 of 3 pixels judged, \d+ s left: one: {pair}", told[3])
    assert len(told) == 8


def test_what_goes_on_quickly_is_told_once_a_second() -> None:
    now = [100.0]
    pulse = Pulse(clock=lambda: now[0])
    due = []
    for now[0] in (100.5, 101.0, 101.5, 101.9, 102.1):
        due.append(pulse.due())
    assert due == [False, True, False, False, True]


def test_time_left() -> None:
    now = [100.0]
    left = TimeLeft(10, clock=lambda: now[0])
    assert left.says(0) == ""
    now[0] = 130.0
    assert left.says(3) == ", 70 s left"
    assert left.says(1) == ", 4 min left"
    assert TimeLeft(1, clock=lambda: now[0]).says(1) == ""
    assert [duration(seconds) for seconds in (0.4, 89, 91, 5399, 7200)] == ["0 s", "89 s", "2 min", "90 min", "2.0 h"]
