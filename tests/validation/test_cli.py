"""Every command: what it prints, what it writes, its exit status, and the words of its errors."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from conftest import Result, strict
from doubles import KEYS, Double, with_arrays
from PIL import Image
from rich.console import Console

import validation.__main__ as program
from tracer import _native
from tracer.passes import SAMPLES, Passes
from validation import cli, options, terminal
from validation.compare import Comparison
from validation.renderers import Settings, Uncertainty
from validation.renderers.native import Native
from validation.run import MOST_VERDICTS, Validation


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene file."""
    path = tmp_path / "full.txt"
    path.write_text(doubles.FULL)
    return path


def one_pixel(arrays: doubles.Arrays) -> None:
    arrays["beauty"][20, 30, 1] += 0.25


NATIVE = ("--renderer", "native-f64", "--against", "numpy-f64")


def test_validate_agrees(run: Any, scene: Path) -> None:
    result = run("validate", scene, *NATIVE)
    assert (result.status, result.err) == (0, "")
    assert "native-f64 against numpy-f64" in result.out
    assert "beauty" in result.out
    assert "15 of 15 comparisons agree" in result.out


def test_validate_differs(run: Any, scene: Path, registered: Any) -> None:
    registered(Double(draw=with_arrays(one_pixel)))
    result = run("validate", scene, "--renderer", "double", "--against", "numpy-f64")
    assert result.status == 1
    assert "DIFFER" in result.out
    assert "beauty (double, numpy-f64): 1 of" in result.out
    assert "worst pixel x 30, y 20 G" in result.out
    assert "14 of 15 comparisons agree" in result.out


def test_validate_writes_strict_json(run: Any, scene: Path, tmp_path: Path, registered: Any) -> None:
    def holes(arrays: doubles.Arrays) -> None:
        arrays["depth"][3, 3] = np.nan
        arrays["ambient"][20, 30] = np.inf

    registered(Double(draw=with_arrays(holes)))
    file = tmp_path / "results.json"
    result = run("validate", scene, "--renderer", "double,native-f64", "--against", "numpy-f64", "--json", file)
    assert result.status == 1
    record = strict(file.read_text())
    assert set(record) == {
        *("ok", "command", "settings", "versions", "counts", "pairs", "comparisons", "verdicts", "notes", "failures")
    }
    assert record["counts"]["double"]["depth"] == {"compared": 1, "agree": 0, "lacking": 0}
    assert record["counts"]["numpy-f64"]["depth"] == {"compared": 2, "agree": 1, "lacking": 0}
    assert record["ok"] is False
    assert record["command"][:2] == ["whitted", "validate"]
    assert record["settings"] == {"sample": "corner", "shadow_epsilon": 1e-4, "max_reflections": 3, "threads": 0}
    assert {"whitted", "python", "compiler", "instruction set", "numpy", "double"} <= set(record["versions"])
    assert len(record["comparisons"]) == 30
    for comparison in record["comparisons"]:
        assert set(comparison) >= KEYS
        assert comparison["size"] == [64, 48]
        assert ("reason" in comparison) is not comparison["ok"]
    failed = {entry["pass"] for entry in record["comparisons"] if not entry["ok"]}
    assert failed == {"depth", "ambient"}


def test_validate_takes_folders(run: Any, tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "one.txt").write_text(doubles.CUT)
    (tmp_path / "a" / "b" / "two.txt").write_text(doubles.CAVE)
    (tmp_path / "a" / "README.md").write_text("no scene")
    result = run("validate", tmp_path / "a", *NATIVE)
    assert result.status == 0
    assert "one.txt 48x48" in result.out
    assert "two.txt 32x32" in result.out
    assert "worst" in result.out, "several scenes have a row each"


def test_validate_reports_the_errors_of_all_files(run: Any, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(doubles.FULL.replace("NEAR 1", "NEAR -1").replace("SPHERE ball", "SPHRE ball"))
    (tmp_path / "b.txt").write_text(doubles.FULL.replace("RES 64 48", "RES 64"))
    result = run("validate", tmp_path, *NATIVE)
    assert (result.status, result.out) == (2, "")
    for expected in ("a.txt:1:", "a.txt:7:1: error:", "did you mean", "b.txt:6:"):
        assert expected in result.err
    assert result.err.count("error:") == 3


def test_validate_settings_reach_both_renderers(run: Any, scene: Path, tmp_path: Path) -> None:
    file = tmp_path / "r.json"
    options = ("--sample", "center", "--shadow-epsilon", "0.001", "--max-reflections", "1", "--threads", "1")
    result = run("validate", scene, *NATIVE, *options, "--size", "40x30", "--json", file)
    assert result.status == 0
    record = strict(file.read_text())
    assert record["settings"] == {"sample": "center", "shadow_epsilon": 0.001, "max_reflections": 1, "threads": 1}
    names = [comparison["pass"] for comparison in record["comparisons"]]
    assert "reflection.1" in names
    assert "reflection.2" not in names
    assert {tuple(comparison["size"]) for comparison in record["comparisons"]} == {(40, 30)}


def test_validate_limits(run: Any, tmp_path: Path) -> None:
    light = "LIGHT right 6 4 -4 0.3 0.4 0.9\n"
    crowded = tmp_path / "six.txt"
    crowded.write_text(doubles.FULL.replace(light, light * 5))
    refused = run("validate", crowded, *NATIVE)
    assert refused.status == 2
    assert "found 6 lights, expected at most 5" in refused.err
    assert run("validate", crowded, *NATIVE, "--no-limits", "--passes", "beauty").status == 0


def test_validate_passes(run: Any, scene: Path) -> None:
    result = run("validate", scene, *NATIVE, "--passes", "id,shadow.L*")
    assert result.status == 0
    assert "3 of 3 comparisons agree" in result.out


def test_validate_draws_smaller_what_takes_too_long(run: Any, scene: Path, tmp_path: Path, registered: Any) -> None:
    slow = Double(name="slow", limit=768)
    registered(slow)
    file = tmp_path / "r.json"
    result = run("validate", scene, "--renderer", "native-f64", "--against", "slow,numpy-f64", "--json", file)
    assert result.status == 0
    assert "drawn at 32x24 instead of 64x48: slow would take too long" in result.out
    assert slow.rendered == [(32, 24)]
    sizes = {(entry["reference"], tuple(entry["size"])) for entry in strict(file.read_text())["comparisons"]}
    assert sizes == {("slow", (32, 24)), ("numpy-f64", (64, 48))}


def test_validate_says_what_one_of_them_lacks(run: Any, scene: Path, registered: Any) -> None:
    registered(Double(name="poor", missing=("specular", "direct")))
    result = run("validate", scene, "--renderer", "native-f64", "--against", "poor")
    assert result.status == 0
    assert "poor: not compared, as it does not deliver them: specular, direct" in result.out
    asked = run("validate", scene, "--renderer", "native-f64", "--against", "poor", "--passes", "beauty,specular")
    assert asked.status == 1
    assert "poor did not deliver the pass 'specular'" in asked.out


def test_validate_a_scene_that_nobody_can_carry_is_no_success(run: Any, scene: Path, registered: Any) -> None:
    registered(Double(name="picky", refuses=True))
    result = run("validate", scene, "--renderer", "native-f64", "--against", "picky")
    assert result.status == 3
    assert "picky: cannot carry this scene" in result.out


def test_validate_a_renderer_that_fails(run: Any, scene: Path, registered: Any) -> None:
    def broken(*_: Any) -> Passes:
        raise RuntimeError("no luck")

    registered(Double(name="broken", draw=broken))
    result = run("validate", scene, "--renderer", "native-f64", "--against", "broken,numpy-f64")
    assert result.status == 3
    assert "error: " in result.err
    assert "broken: failed: RuntimeError: no luck" in result.err
    assert "15 of 15 comparisons agree, 1 failure" in result.out


def test_validate_a_renderer_that_is_not_there(run: Any, scene: Path, registered: Any) -> None:
    registered(Double(name="absent", absent="it is not installed: apt-get install absent"))
    result = run("validate", scene, "--renderer", "native-f64", "--against", "absent")
    assert result.status == 3
    assert "apt-get install absent" in result.err


def test_validate_writes_a_report_and_says_where(run: Any, scene: Path, tmp_path: Path) -> None:
    result = run("validate", scene, *NATIVE, "--passes", "beauty", "--report", tmp_path / "deep" / "report")
    assert result.status == 0
    assert result.out.splitlines()[-1] == str(tmp_path / "deep" / "report" / "index.html")
    assert "<!doctype html>" in (tmp_path / "deep" / "report" / "index.html").read_text().lower()
    assert [entry.name for entry in (tmp_path / "deep" / "report").iterdir()] == ["index.html"], "nothing else is left"


@pytest.fixture
def dotted(registered: Any) -> None:
    """A renderer that is wrong at eight pixels, and at one of them the other one is, too."""

    def dots(arrays: doubles.Arrays) -> None:
        arrays["beauty"][20, 20:28, 1] += 0.25

    def dot(arrays: doubles.Arrays) -> None:
        arrays["beauty"][20, 20, 0] += 0.25

    registered(Double(draw=with_arrays(dots)), Double(name="other", draw=with_arrays(dot)))


DOTTED = ("--renderer", "double", "--passes", "beauty")


def test_of_many_differing_pixels_a_sample_is_judged(run: Any, scene: Path, dotted: None, tmp_path: Path) -> None:
    del dotted
    file = tmp_path / "r.json"
    result = run("validate", scene, *DOTTED, "--against", "native-f64", "--verdicts", 3, "--json", file)
    assert result.status == 1
    assert "8 pixels differ, 3 of them judged, chosen at random" in result.out
    assert "0 of 1 comparisons agree, at least 3 pixels without an excuse" in result.out
    (judged,) = strict(file.read_text())["verdicts"]
    assert (judged["differ"], judged["judged"]) == (8, 3)
    every = run("validate", scene, *DOTTED, "--against", "native-f64", "--verdicts", 8)
    assert "(double, native-f64): 8 pixels differ\n" in every.out
    assert "0 of 1 comparisons agree, 8 pixels without an excuse" in every.out


def test_none_of_them_may_be_judged(run: Any, scene: Path, dotted: None) -> None:
    del dotted
    result = run("validate", scene, *DOTTED, "--against", "native-f64", "--verdicts", 0)
    assert result.status == 1
    assert "8 pixels differ, none of them judged" in result.out
    assert result.out.endswith("\n0 of 1 comparisons agree\n")


def test_a_pixel_in_two_groups_is_one(run: Any, scene: Path, dotted: None) -> None:
    del dotted
    result = run("validate", scene, *DOTTED, "--against", "other")
    assert "(double, other): 8 pixels differ\n" in result.out
    assert "(1 pixel, at which both are off, is in two of these lines)" in result.out
    assert ", 8 pixels without an excuse" in result.out


def test_of_a_file_that_is_no_scene_the_beginning_is_told(run: Any, tmp_path: Path) -> None:
    text = tmp_path / "novel.txt"
    for lines in (30, 150):  # the parser itself counts no further than 100
        text.write_text("once upon a time\n" * lines)
        result = run("validate", text, *NATIVE)
        assert result.status == 2
        assert result.err.count(": error: found 'once'") == cli.MOST_ERRORS
        counted = result.err.splitlines()[-1]
        assert counted.startswith(f"{text}: error: and ")
        assert int(counted.split()[-2]) > lines - cli.MOST_ERRORS, "what is missing is counted, too"


def test_a_report_that_is_not_written_leaves_no_folder(
    run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: Any) -> Any:
        raise KeyboardInterrupt

    (tmp_path / "old").mkdir()
    monkeypatch.setattr(Native, "render", interrupt)
    for folder in ("new", "deep/er", "old", "old/new"):
        assert run("validate", scene, *NATIVE, "--report", tmp_path / folder).status == 130
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full.txt", "old"]
    assert not list((tmp_path / "old").iterdir())


#: The command line (SCENE stands for a scene file), what its error says, and what its hint says.
WRONG = {
    "no command": ("bogus", "unknown command 'bogus'", "see `whitted --help`"),
    "near command": ("validat", "unknown command 'validat'", "did you mean 'validate'?"),
    "option": ("validate SCENE --repor x", "no such option '--repor'", "did you mean '--report'?"),
    "no scene": ("validate", "missing argument 'SCENE_OR_FOLDER...'", "see `whitted validate --help`"),
    "renderer": ("validate SCENE --renderer nativ-f64", "unknown renderer 'nativ-f64'", "did you mean 'native-f64'?"),
    "against": ("validate SCENE --against numpy-f46", "unknown renderer 'numpy-f46'", "did you mean 'numpy-f64'?"),
    "pass": ("validate SCENE --passes beuaty", "unknown pass 'beuaty'", "did you mean 'beauty'?"),
    "margin": ("validate SCENE --passes margin.order", "'margin.order' is not compared", "the passes are beauty, "),
    "no pass": ("validate SCENE --passes foo", "unknown pass 'foo'", "the passes are beauty, ambient, "),
    "far option": ("validate SCENE --quiet", "no such option '--quiet'", "see `whitted validate --help`"),
    "empty size": ("validate SCENE --size 0x10", "'0x10' is not a size: at least 1x1", "see `whitted"),
    "long size": ("validate SCENE --size 9999999999x10", "'9999999999x10' is too large", "see `whitted"),
    "memory of validate": (
        "validate SCENE --size 100000x100000 --against numpy-f64",
        "full.txt: error: 15 passes of 100000x100000 pixels need 2960000000000 bytes",
        "a smaller --size, or fewer --passes",
    ),
    "memory of numpy": (
        "render SCENE -o x.npz --passes id --renderer numpy-f64 --no-limits --size 9000000x9000000",
        "1 pass of 9000000x9000000 pixels needs 648000000000000 bytes",
        "a smaller --size",
    ),
    "empty name": ("validate SCENE --passes beauty,,id", "has an empty name", "see `whitted validate --help`"),
    "size": ("validate SCENE --size 400", "'400' is not a size such as 400x300", "see `whitted"),
    "zero size": ("validate SCENE --size 0x5", "'0x5' is not a size", "see `whitted"),
    "sample": ("validate SCENE --sample middle", "'middle' is not one of", "see `whitted"),
    "epsilon": ("validate SCENE --shadow-epsilon nan", "nan", "see `whitted"),
    "epsilon of one": ("validate SCENE --shadow-epsilon 1", "1.0 is not a number from 0 to below 1", "see `whitted"),
    "reflections": ("validate SCENE --max-reflections -1", "'-1' is not a whole number from 0 to 100", "see `whitted"),
    "threads": ("validate SCENE --threads 1025", "'1025' is not a whole number from 0 to 1024", "see `whitted"),
    "threads of render": ("render SCENE -o x.npz --threads 5000", "'5000' is not a whole number", "see `whitted"),
    "wide": ("validate SCENE --size 100001x1", "--size 100001x1: at most 100000 columns", "--no-limits allows more"),
    "wide render": ("render SCENE -o x.npz --size 1x100001", "at most 100000 columns", "--no-limits allows more"),
    "itself": (
        "validate SCENE --renderer numpy-f64 --against numpy-f64",
        "a renderer is not compared with itself: numpy-f64",
        "--against with another name",
    ),
    "verdicts": ("validate SCENE --verdicts x", "--verdicts: 'x' is not a whole number from 0 on", "--verdicts 500"),
    "negative verdicts": ("validate SCENE --verdicts -1", "'-1' is not a whole number", "--verdicts 0 none"),
    "part of a verdict": ("validate SCENE --verdicts 1.5", "--verdicts: '1.5' is not a whole number", "--verdicts 500"),
    "report to a file": ("validate SCENE --report SCENE", "full.txt is a file, expected a folder", "name a folder"),
    "report in a file": ("validate SCENE --report SCENE/x", "full.txt/x: Not a directory", "name another folder"),
    "report to sysfs": ("validate SCENE --report /sys/x/y", "--report: /sys/x/y: ", "name another folder"),
    "json to -": ("validate SCENE --json -", "'-' is not the name of a file to write", "name a file"),
    "json to sysfs": ("validate SCENE --json /sys/x.json", "/sys/x.json: ", "name a file in another folder"),
    "render to sysfs": ("render SCENE -o /sys/x.exr", "/sys/x.exr: ", "name a file in another folder"),
    "memory": (
        "render SCENE -o x.npz --no-limits --size 90000000x90000000",
        "15 passes of 90000000x90000000 pixels need",
        "a smaller --size, or fewer --passes",
    ),
    "no file": ("validate nowhere.txt", "nowhere.txt: error: no such file or folder", ""),
    "json folder": ("validate SCENE --json no/where.json", "there is no folder no", "mkdir -p no"),
    "render ending": ("render SCENE -o x.jpg", "unknown file ending '.jpg'", "expected .exr, .npz, .png or .ppm"),
    "render folder": ("render SCENE -o no/x.png", "there is no folder no", "mkdir -p no"),
    "render scene": ("render nowhere.txt -o x.png", "nowhere.txt: error: no such file or folder", ""),
    "render pass": ("render SCENE -o x.npz --passes dephth", "unknown pass 'dephth'", "did you mean 'depth'?"),
    "render light": (
        "render SCENE -o x.npz --passes shadow.L7",
        "native-f64 has no pass 'shadow.L7'",
        "shadow.L0, shadow.L1",
    ),
    "render no beauty": ("render SCENE -o x.png --passes depth", "would hold the pass 'beauty'", "write .exr or .npz"),
    "render no renderer": (
        "render SCENE -o x.npz --renderer numpy",
        "unknown renderer 'numpy'",
        "did you mean 'numpy-f",
    ),
    "render no output": ("render SCENE", "missing option '-o' / '--output'", "see `whitted render --help`"),
    "convert target": ("convert SCENE --to blender -o x", "'blender' is not", "see `whitted convert --help`"),
    "compare no file": ("compare a.npz b.npz", "a.npz: no such file", ""),
    "compare ending": ("compare SCENE SCENE", "unknown file ending '.txt'", "expected .exr, .npz, .png or .ppm"),
    "tolerance": ("compare a.npz b.npz --tolerance -1", "-1.0 is not a finite number from 0 on", "see `whitted"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_in_one_sentence_with_a_hint(
    case: str, run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words, message, hint = WRONG[case]
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    result = run(*words.replace("SCENE", str(scene)).split())
    assert (result.status, result.out) == (2, "")
    lines = result.err.rstrip("\n").split("\n")
    assert message in lines[0]
    assert "error: " in lines[0]
    assert len(lines) == (2 if hint else 1)
    if hint:
        assert lines[1].startswith("  hint: ")
        assert hint in lines[1]
    assert sorted(tmp_path.rglob("*")) == before, "nothing is written"


@pytest.mark.parametrize(
    "words", ["validate SCENE", "render SCENE -o x.npz", "renderers", "convert SCENE --to mitsuba -o x.xml"]
)
def test_an_instruction_set_that_is_not_there(
    words: str, run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WHITTED_ISA", "mmx")
    result = run(*[scene if word == "SCENE" else word for word in words.split()])
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("error: WHITTED_ISA is 'mmx', but here it can be one of ")
    assert result.err.endswith("\n  hint: unset WHITTED_ISA to use the best one\n")


def test_the_samples_are_those_of_the_renderers() -> None:
    assert options.SAMPLES == SAMPLES
    assert options.MOST_THREADS == _native.MOST_THREADS
    assert f"more than {cli.LONGEST_SIDE} columns" in options.NO_LIMITS
    assert cli.MOST_VERDICTS == MOST_VERDICTS


def test_renderers_lists_them(run: Any, registered: Any) -> None:
    registered(Double(name="absent", absent="run: pip install absent"), failures={"third": "party: ImportError: gone"})
    result = run("renderers")
    assert result.status == 0
    lines = {line.split()[0]: line for line in result.out.splitlines()}
    for name in ("native-f64", "native-f32", "numpy-f64", "numpy-f32"):
        assert " yes " in lines[name]
        assert "shadow.L*, reflection, reflection.*" in lines[name]
    assert "no" in lines["absent"].split()
    assert "pip install absent" in lines["absent"]
    assert "entry point 'third' could not be loaded: party: ImportError: gone" in result.err


def test_renderers_as_json(run: Any, registered: Any) -> None:
    registered(Double(name="absent", absent="run: pip install absent"))
    record = strict(run("renderers", "--json").out)
    entries = {entry["name"]: entry for entry in record["renderers"]}
    assert entries["native-f64"]["available"] is True
    assert "reflection.*" in entries["native-f64"]["passes"]
    assert entries["absent"] == {
        "name": "absent",
        "available": False,
        "reason": "run: pip install absent",
        "version": None,
        "precision": None,
        "passes": [],
        "sources": {},
    }
    assert entries["numpy-f32"]["precision"] == "float32"
    assert entries["native-f64"]["sources"]["beauty"] == {"how": "stock", "always": True}


def test_names_of_a_repeated_option_count_all(run: Any, scene: Path) -> None:
    result = run("validate", scene, "--renderer", "native-f32", "--renderer", "native-f64", "--against", "numpy-f64")
    assert result.status == 0
    assert "native-f32 against numpy-f64" in result.out
    assert "native-f64 against numpy-f64" in result.out
    alone = run("validate", scene, "--all-pairs", "--renderer", "native-f32")
    assert (alone.status, alone.err) == (
        2,
        "error: --all-pairs: native-f32 alone makes no pair\n  hint: --renderer A,B names two\n",
    )


def test_who_delivers_which_pass(run: Any, registered: Any) -> None:
    class Some(Double):
        precision = "8-bit"

        def passes(self, scene: Any, settings: Any) -> tuple[str, ...]:
            del settings
            return ("id", "beauty") if scene.spheres[0].ks == 0 else ("id",)

        def sources(self, *_: Any) -> dict[str, str]:
            return {"id": "plugin", "beauty": "derived"}

    registered(Some(name="some"))
    every = run("renderers", "--passes").out.splitlines()
    head = next(place for place, line in enumerate(every) if line.startswith("pass ") and "some" in line)
    at, lines = every[head].index("some"), every[head : every.index("", head)]
    column = {line.split()[0]: line[at:].split("  ")[0].strip() for line in lines if line}
    assert column["id"] == "plugin"
    assert column["beauty"] == "derived *"
    assert column["depth"] == "-"
    assert column["precision"] == "8-bit"
    assert column["here"] == "yes"
    assert sum(line.startswith("pass ") for line in every) > 1, "as many side by side as there is room for"
    assert max(map(len, every)) <= 160


def test_render_and_compare(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b, c = tmp_path / "a.npz", tmp_path / "b.npz", tmp_path / "c.exr"
    assert run("render", scene, "-o", a) == Result(0, "", "")
    assert run("render", scene, "-o", b, "--threads", "1") == Result(0, "", "")
    assert run("render", scene, "-o", c, "--renderer", "native-f32") == Result(0, "", "")
    stored = Passes.load(a)
    assert len(stored) == 15
    assert stored.metadata["renderer"] == "native-f64"
    assert stored.metadata["command"].startswith("whitted render ")

    equal = run("compare", a, b)
    assert (equal.status, equal.err) == (0, "")
    assert equal.out.count("equal") == 15
    different = run("compare", a, c, "--json", tmp_path / "d.json")
    assert different.status == 1
    assert "DIFFERENT" in different.out
    assert "worst pixel x" in different.out
    record = strict((tmp_path / "d.json").read_text())
    assert record["ok"] is False
    assert len(record["comparisons"]) == 15
    loose = run("compare", a, c, "--passes", "beauty,ambient", "--tolerance", "1e-3")
    assert loose.status == 0
    assert "equal within the tolerance" in loose.out


def test_compare_says_what_only_one_has(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b = tmp_path / "a.npz", tmp_path / "b.npz"
    run("render", scene, "-o", a, "--passes", "beauty,depth")
    run("render", scene, "-o", b, "--passes", "beauty,id")
    result = run("compare", a, b)
    assert result.status == 0
    assert "only in one of the two, not compared: depth, id" in result.out
    missing = run("compare", a, b, "--passes", "depth")
    assert missing.status == 2
    assert f"{b} has no pass 'depth'" in missing.err
    Passes({"id": Passes.load(b)["id"]}).save(b)
    assert run("compare", a, b).status == 2


def test_compare_images(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b, c = tmp_path / "a.png", tmp_path / "b.ppm", tmp_path / "c.png"
    run("render", scene, "-o", a)
    run("render", scene, "-o", b, "--renderer", "numpy-f64")
    run("render", scene, "-o", c, "--sample", "center")
    assert run("compare", a, b).status == 0
    result = run("compare", a, c)
    assert result.status == 1
    assert "beauty" in result.out
    mixed = tmp_path / "a.npz"
    run("render", scene, "-o", mixed)
    assert "the other is an 8-bit image" in run("compare", a, mixed).err


def test_compare_different_sizes(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b = tmp_path / "a.npz", tmp_path / "b.npz"
    run("render", scene, "-o", a, "--passes", "depth")
    run("render", scene, "-o", b, "--passes", "depth", "--size", "8x6")
    result = run("compare", a, b)
    assert result.status == 1
    assert result.out == f"DIFFERENT: {a} is 64x48, {b} is 8x6 pixels: no pixel was compared\n"


@pytest.mark.parametrize("ending", [".npz", ".exr", ".png", ".ppm"])
def test_compare_a_file_that_is_none(run: Any, tmp_path: Path, ending: str) -> None:
    bad = tmp_path / f"bad{ending}"
    bad.write_bytes(b"not this")
    result = run("compare", bad, bad)
    assert result.status == 2
    assert str(bad) in result.err
    assert len(result.err.splitlines()) == 1


@pytest.mark.mitsuba
def test_convert(run: Any, scene: Path, tmp_path: Path, need: Any) -> None:
    need(importlib.util.find_spec("mitsuba"), "no Mitsuba: pip install mitsuba")
    xml = tmp_path / "out.xml"
    assert run("convert", scene, "--to", "mitsuba", "-o", xml) == Result(0, "", "")
    assert "<scene" in xml.read_text()
    xml.unlink()
    refused = run("convert", scene, "--to", "mitsuba", "-o", xml, "--stock-only")
    assert refused.status == 2
    assert "stock Mitsuba cannot say this scene" in refused.err
    assert "hint: without --stock-only" in refused.err
    no_light = run("convert", scene, "--to", "mitsuba", "-o", xml, "--light", "2")
    assert (no_light.status, "has no light 2" in no_light.err) == (2, True)
    assert not xml.exists()


def test_a_scene_with_a_duplicate_warns_on_stderr(run: Any, tmp_path: Path) -> None:
    ball = "SPHERE shell 0.1 0.2 -3 1.5 1.5 1.5 0.9 0.7 0.2 0.3 0.7 0.2 0 5\n"
    twice = tmp_path / "twice.txt"
    twice.write_text(doubles.CUT.replace(ball, ball * 2))
    result = run("validate", twice, *NATIVE)
    assert result.status == 0
    assert "warning" in result.err
    assert "Warning" not in result.err, "in words, not as Python prints it"


def whitted(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    code = "from validation.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False, timeout=60, **options
    )


def test_help_and_version_import_nothing_heavy() -> None:
    code = (
        "import sys\nfrom validation.cli import main\n"
        "try:\n    main({arguments})\nfinally:\n    print('LOADED', *sys.modules, file=sys.stderr)"
    )
    for arguments in (["--help"], ["--version"], ["validate", "--help"]):
        done = subprocess.run(
            [sys.executable, "-c", code.format(arguments=arguments)],
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        loaded = set(done.stderr.partition("LOADED")[2].split())
        assert "click" in loaded
        heavy = {"numpy", "rich", "jinja2", "matplotlib", "PIL", "colour", "scipy", "mitsuba", "tracer", "OpenEXR"}
        assert not heavy & loaded


def test_help_names_every_command() -> None:
    done = whitted("--help")
    assert done.returncode == 0
    for command in ("validate", "renderers", "render", "convert", "compare"):
        assert f"  {command} " in done.stdout


def test_version() -> None:
    assert whitted("--version").stdout == f"whitted {importlib.metadata.version('whitted')}\n"


@pytest.fixture
def endless(tmp_path: Path) -> Path:
    """A scene that takes minutes to draw and to compare."""
    path = tmp_path / "endless.txt"
    path.write_text(doubles.FULL.replace("RES 64 48", "RES 4000 3000"))
    return path


def test_interrupted_it_ends_with_130_and_no_traceback(endless: Path, tmp_path: Path) -> None:
    code = "import sys; from validation.cli import main; print('started', flush=True); main()"
    words = ["validate", str(endless), "--renderer", "numpy-f64", "--against", "numpy-f32", "--no-limits"]
    words += ["--json", str(tmp_path / "r.json")]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        time.sleep(2)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.strip() == "interrupted"
    assert not (tmp_path / "r.json").exists()


def test_a_closed_pipe_is_no_error(scene: Path) -> None:
    code = "from validation.cli import main; main()"
    words = f"{sys.executable} -c '{code}' validate {scene} --renderer native-f64 --against numpy-f64 | true"
    done = subprocess.run(["bash", "-c", words], capture_output=True, text=True, check=False, timeout=60)
    assert done.stderr == ""


def test_colours_are_for_terminals(scene: Path) -> None:
    done = whitted("validate", str(scene), *NATIVE, env={**os.environ, "TERM": "xterm-256color"})
    assert "\x1b" not in done.stdout + done.stderr


def far_away(tmp_path: Path) -> Path:
    """A scene that float32 does not hold."""
    path = tmp_path / "far.txt"
    path.write_text(doubles.CUT.replace("SPHERE shell 0.1 ", "SPHERE shell 1e20 "))
    return path


@pytest.mark.parametrize("words", ["validate {} --renderer native-f32 --against numpy-f64", "render {} -o x.npz"])
def test_a_scene_that_float32_does_not_hold_is_wrong_input(
    words: str, run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    far = far_away(tmp_path)
    extra = () if "validate" in words else ("--renderer", "native-f32")
    result = run(*words.format(far).split(), *extra)
    assert result.status == 2
    assert result.err == (
        f"{far}: error: SPHERE: found '1e+20' for 'pos x' of spheres[0], expected a magnitude from 1e-15 to 1e15 "
        "in float32\n  hint: render it in float64\n"
    )


@pytest.mark.mitsuba
def test_why_a_renderer_cannot_carry_a_scene(run: Any, tmp_path: Path, need: Any) -> None:
    need(importlib.util.find_spec("mitsuba"), "no Mitsuba: pip install mitsuba")
    far = far_away(tmp_path)
    validated = run("validate", far, "--against", "mitsuba-spec@scalar")
    assert validated.status == 3
    assert "cannot carry this scene (it has numbers outside 1e-15 to 1e+15" in validated.out
    assert "nothing was compared" in validated.out
    rendered = run("render", far, "-o", tmp_path / "x.npz", "--renderer", "mitsuba-spec@scalar")
    assert rendered.status == 3
    assert f"cannot carry the scene {far}: it has numbers outside 1e-15 to 1e+15" in rendered.err


def leaves(*_: Any) -> Passes:
    sys.exit(0)


@pytest.mark.parametrize(
    ("draw", "reason"),
    [(lambda *_: None, "it returned NoneType, expected Passes"), (leaves, "SystemExit: 0")],
    ids=["nothing", "the end"],
)
def test_a_renderer_that_returns_nothing_or_ends_the_program(
    draw: Any, reason: str, run: Any, scene: Path, tmp_path: Path, registered: Any
) -> None:
    registered(Double(name="odd", draw=draw))
    validated = run("validate", scene, "--renderer", "native-f64", "--against", "odd")
    assert (validated.status, validated.err) == (3, f"error: {scene}: odd: failed: {reason}\n")
    assert "nothing was compared, 1 failure" in validated.out
    rendered = run("render", scene, "-o", tmp_path / "x.npz", "--renderer", "odd")
    assert (rendered.status, rendered.err) == (3, f"error: odd failed: {reason}\n")


@pytest.mark.parametrize("method", ["passes", "unavailable", "versions", "uncertainty", "max_pixels"])
def test_whatever_a_renderer_raises_is_its_failure(
    method: str, run: Any, scene: Path, registered: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> Any:
        raise KeyError("lost")

    monkeypatch.setattr(Double, method, broken)
    registered(Double(name="odd"))
    result = run("validate", scene, "--renderer", "native-f64", "--against", "odd,numpy-f64")
    if method == "versions":  # the comparisons are worth no less
        assert (result.status, result.err) == (0, "")
        return
    assert result.status == 3
    assert result.err.count("error: ") == 1
    assert "odd: failed: KeyError: 'lost'" in result.err
    assert "15 of 15 comparisons agree, 1 failure" in result.out


def test_without_a_command_the_help_is_shown(run: Any) -> None:
    result = run()
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("Usage: whitted [OPTIONS] COMMAND")


@pytest.mark.parametrize("words", ["validate {} --size 8x6 --renderer native-f64 --against numpy-f64", "renderers"])
def test_a_reader_that_has_gone_is_no_difference(words: str, scene: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "validation", *words.format(scene).split()],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=60,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (128 + 13, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    "words", ["validate {} --size 8x6 --renderer native-f64 --against numpy-f64", "renderers", "--help"]
)
def test_output_that_cannot_be_written(words: str, scene: Path) -> None:
    command = f"{sys.executable} -m validation {words.format(scene)}"
    expected = {
        ">/dev/full": "error: standard output: No space left on device\n  hint: send it elsewhere\n",
        ">&-": "error: standard output is closed\n  hint: send it to a file or to /dev/null\n",
    }
    for redirection, message in expected.items():
        done = subprocess.run(
            ["bash", "-c", command + redirection], stderr=subprocess.PIPE, text=True, check=False, timeout=60
        )
        assert (done.returncode, done.stderr) == (2, message)


def test_interrupted_while_it_is_imported(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    class Interrupted:
        def __getattr__(self, name: str) -> Any:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "validation.cli", Interrupted())
    with pytest.raises(SystemExit) as exit_info:
        program.main()
    assert exit_info.value.code == 130
    assert capfd.readouterr().err == "interrupted\n"


def test_json_goes_into_a_pipe(scene: Path) -> None:
    command = f"{sys.executable} -m validation validate {scene} {' '.join(NATIVE)} --passes id --json >(cat >&2)"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0
    assert "1 of 1 comparisons agree" in done.stdout


@pytest.mark.parametrize(
    "words",
    [
        "validate - --renderer native-f64 --against numpy-f64 --size 8x6",
        "render - -o x.npz --size 8x6",
        pytest.param("convert - --to mitsuba -o x.xml", marks=pytest.mark.mitsuba),
    ],
)
def test_a_scene_from_standard_input(words: str, tmp_path: Path) -> None:
    if "convert" in words:
        pytest.importorskip("mitsuba")
    done = whitted(*words.split(), input=doubles.FULL, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "validate" not in words or "<stdin> 8x6" in done.stdout
    wrong = whitted(*words.split(), input="NEAR x", cwd=tmp_path)
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("<stdin>:1:6: error: NEAR: found 'x'")


def test_names_given_twice_count_once(run: Any, scene: Path) -> None:
    assert "1 of 1 comparisons agree" in run("validate", scene, *NATIVE, "--passes", "beauty,beauty").out


def test_how_many_files_are_wrong(run: Any, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("NEAR x")
    (tmp_path / "b.txt").write_text(doubles.FULL)
    result = run("validate", tmp_path, *NATIVE)
    assert result.status == 2
    assert result.err.endswith("\nnothing was compared: 1 of 2 files is wrong\n")
    (tmp_path / "b.txt").write_text("NEAR x")
    assert run("validate", tmp_path, *NATIVE).err.endswith("\nnothing was compared: 2 of 2 files are wrong\n")


def test_the_place_of_errors_is_the_file_whatever_its_name(run: Any, tmp_path: Path) -> None:
    text = tmp_path / "odd: error: name.txt"
    text.write_text("once upon a time\n" * 30)
    result = run("validate", text, *NATIVE)
    assert result.err.splitlines()[-1].startswith(f"{text}: error: and ")


def test_passes_that_the_scene_does_not_have_are_answered_with_those_it_has(run: Any, scene: Path) -> None:
    result = run("validate", scene, *NATIVE, "--passes", "shadow.L7")
    assert result.status == 3
    assert "the scene has none of the passes asked for, but beauty, " in result.out
    assert "shadow.L0, shadow.L1, reflection" in result.out


def test_a_warning_says_so_once(run: Any, tmp_path: Path) -> None:
    ball = "SPHERE shell 0.1 0.2 -3 1.5 1.5 1.5 0.9 0.7 0.2 0.3 0.7 0.2 0 5\n"
    (tmp_path / "twice.txt").write_text(doubles.CUT.replace(ball, ball * 2))
    result = run("validate", tmp_path / "twice.txt", *NATIVE)
    assert result.err.startswith(f"{tmp_path / 'twice.txt'}:8:1: warning: ")
    assert result.err.count("warning: ") == 1


def test_passes_that_fail_alike_are_told_together(run: Any, scene: Path, registered: Any) -> None:
    registered(Double(claim=Uncertainty(1.0, 1.0, 1.0, 1.0, 1e-9)))
    result = run("validate", scene, "--renderer", "double", "--against", "native-f64")
    assert result.status == 1
    (told,) = [line for line in result.out.splitlines() if "too many edge pixels: " in line]
    assert "beauty, " in told
    assert "id (double, native-f64): too many" in told
    assert result.out.count("--against numpy-f64 may decide more") == 1


def test_a_pixel_that_differs_is_told_once(run: Any, scene: Path, registered: Any) -> None:
    registered(Double(draw=with_arrays(one_pixel)))
    result = run("validate", scene, "--renderer", "double", "--against", "numpy-f64", "--passes", "beauty")
    (told,) = [line for line in result.out.splitlines() if "interior pixels over tolerance" in line]
    assert told.count("x 30, y 20") == 1


def test_a_narrow_terminal_shows_the_result(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    agreeing = [
        Comparison(f"scenes/gallery/{name}.txt", (400, 400), "a", "b", "reflection.1", max=1e-15, ratio=0.01)
        for name in ("mirrors", "a-longer-name-of-a-scene")
    ]
    monkeypatch.setattr(terminal, "console", lambda: Console(width=72))
    terminal.print_validation(Validation(settings=Settings(), comparisons=agreeing), verbose=True)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[:4])) <= 72
    assert lines[1].split() == ["scene", "result", "pass", "/tolerance", "interior", "edge"]
    assert "max error" not in "".join(lines), "the legend is of what is shown"
    assert any(line.startswith("mirrors.txt 400x400 ") and " agree " in line for line in lines)


def summary(
    *found: Comparison, width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    monkeypatch.setattr(terminal, "console", lambda: Console(width=width))
    terminal.print_validation(Validation(settings=Settings(), comparisons=list(found)), verbose=False)
    return capsys.readouterr().out.splitlines()


def test_a_scene_in_one_row_says_what_differs_at_edges(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    edges = Comparison("s.txt", (9, 9), "a", "b", "beauty", max=0.338, ratio=0.01, interior=70, edge=11, edge_over=3)
    worst = Comparison("s.txt", (9, 9), "a", "b", "direct", max=1.4e-6, ratio=0.5, interior=80, edge=1)
    lines = summary(worst, edges, width=120, capsys=capsys, monkeypatch=monkeypatch)
    assert lines[2].split("  ")[-1].strip() == "3/11"
    assert " ".join(lines[2].split()) == "s.txt 9x9 agree all 2, worst direct, edges differ 0.34 0.5 0/80 3/11"
    told = "all: /tolerance and interior of the worst pass; max error: of beauty; edge: of that with most over"
    assert told in lines
    narrow = summary(worst, edges, width=80, capsys=capsys, monkeypatch=monkeypatch)
    assert " ".join(narrow[2].split()).startswith("s.txt 9x9 agree all 2, worst direct")
    assert narrow[2].endswith("3/11")
    assert max(map(len, narrow)) <= 80
    assert told.replace(" max error: of beauty;", "") in narrow
    without = summary(worst, width=120, capsys=capsys, monkeypatch=monkeypatch)
    assert " ".join(without[2].split()) == "s.txt 9x9 agree all 1, worst direct 1.4e-06 0.5 0/80 0/1"
    assert any("max error: of beauty or else of that pass" in line for line in without)


def test_paths_break_at_slashes() -> None:
    long, other = "scenes/a-folder/touching-spheres.txt 400x400", "scenes/other/touching-spheres.txt 400x400"
    assert terminal.paths([long], 60) == {long: long}
    assert terminal.paths([long], 30) == {long: "touching-spheres.txt 400x400"}
    assert terminal.paths([long], 20) == {long: "touching-spheres.txt\n400x400"}
    both = terminal.paths([long, other], 24)
    assert both[long] == "scenes/a-folder/\ntouching-spheres.txt\n400x400", "they are not the same without folders"
    assert both[other] == "scenes/other/\ntouching-spheres.txt\n400x400"


def test_compare_takes_families(run: Any, scene: Path, tmp_path: Path) -> None:
    a = tmp_path / "a.npz"
    run("render", scene, "-o", a)
    result = run("compare", a, a, "--passes", "reflection*")
    assert result.status == 0
    assert result.out.count("equal") == 4
    none = run("compare", a, a, "--passes", "margin.*")
    assert (none.status, none.out) == (2, "")


def test_compare_shows_levels_as_integers(run: Any, tmp_path: Path) -> None:
    a, b = tmp_path / "a.png", tmp_path / "b.ppm"
    levels = np.full((2, 3, 3), 40, dtype=np.uint8)
    Image.fromarray(levels).save(a)
    levels[1, 2, 1] = 206
    Image.fromarray(levels).save(b)
    result = run("compare", a, b)
    assert result.status == 1
    assert " 166 " in result.out
    assert "worst pixel x 2, y 1 G: 40 and 206" in result.out


def test_compare_does_not_reduce_16_bits(run: Any, tmp_path: Path) -> None:
    deep = tmp_path / "deep.ppm"
    deep.write_bytes(b"P6 # a comment\n1 1\n65535\n" + bytes(6))
    header = struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)
    png = tmp_path / "deep.png"
    png.write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + header)
    for path in (deep, png):
        result = run("compare", path, path)
        assert (result.status, result.out) == (2, "")
        assert f"{path}: an image of 16 bits a channel, expected 8" in result.err


@pytest.mark.mitsuba
def test_convert_names_its_own_options(run: Any, scene: Path, tmp_path: Path, need: Any) -> None:
    need(importlib.util.find_spec("mitsuba"), "no Mitsuba: pip install mitsuba")
    result = run("convert", scene, "--to", "mitsuba", "-o", tmp_path / "x.xml", "--stock-only")
    assert "--light INDEX" in result.err
    assert "light=" not in result.err
