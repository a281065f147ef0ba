"""`whitted validate`: what it prints, what it writes, and its exit status."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from command_line import NATIVE, one_pixel
from conftest import strict
from doubles import KEYS, Double, with_arrays

from tracer.passes import Passes
from validation.renderers import Uncertainty
from validation.renderers.native import Native


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
        *(
            "schema",
            "kind",
            "ok",
            "command",
            "settings",
            "versions",
            "counts",
            "pairs",
            "comparisons",
            "verdicts",
            "notes",
            "failures",
            "unfinished",
        )
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


def test_json_goes_into_a_pipe(scene: Path) -> None:
    command = f"{sys.executable} -m validation validate {scene} {' '.join(NATIVE)} --passes id --json >(cat >&2)"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0
    assert "1 of 1 comparisons agree" in done.stdout


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


def test_passes_that_the_scene_does_not_have_are_answered_with_those_it_has(run: Any, scene: Path) -> None:
    result = run("validate", scene, *NATIVE, "--passes", "shadow.L7")
    assert result.status == 3
    assert "the scene has none of the passes asked for, but beauty, " in result.out
    assert "shadow.L0, shadow.L1, reflection" in result.out


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
