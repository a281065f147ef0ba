"""Stability: planted defects break where they must and nowhere else; crashes, refusals and claims are told apart."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import doubles
import numpy as np
import pytest
from conftest import strict
from doubles import Double, with_patch, with_settings
from planted import Planted, no_near_plane, unchanged

import tracer
from tracer import Scene
from tracer.passes import Passes
from validation import renderers
from validation import stability as climbing
from validation.curves import write_curves
from validation.ladders import LADDERS, Ladder, get, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.native import Native
from validation.stability import Stability, Standard, Step, measure, prove_rung, stability

#: As a renderer draws one rung.
ONE = Settings(threads=1)


def rungs(name: str, *some: str) -> Ladder:
    """A ladder with some of its rungs alone."""
    return dataclasses.replace(get(name), rungs=some)


def climbed(ladders: Sequence[Ladder | str], *tested: Any, **options: Any) -> Stability:
    """In this process: what a test makes up cannot be sent."""
    return stability(ladders, tested, **({"jobs": 0} | options))


def cells(result: Stability, standard: str = "own") -> dict[str, str]:
    """By ladder, of the one renderer."""
    (name,) = result.tested
    return {ladder.name: result.cell(ladder, name, standard) for ladder in result.ladders}


# ---- what holds


@pytest.mark.parametrize("ladder", LADDERS, ids=names())
def test_our_kernels_hold_above_64_roundings_and_draw_no_nan(ladder: Ladder) -> None:
    result = climbed([ladder], "native-f64", "native-f32")
    assert result.failures == []
    for name in result.tested:
        for rung, step in result.steps(ladder, name):
            assert step is not None
            assert step.own == step.careful  # for our own renderers the two claims are one
            assert step.not_numbers == 0
            assert not step.broken("own"), f"{rung}: {step.says('own')}"
            # Only what the specification has outside of float32's range is refused.
            assert not step.refused or (name == "native-f32" and "1e15" in step.refused), step.refused


def test_every_pixel_of_a_rung_is_proved() -> None:
    proof = prove_rung(get("mirrors"), "1e-9", ONE)
    assert (len(proof.x), proof.unproved) == (400, ())
    step = measure(proof, Native("f64"))
    assert step.own is not None
    assert step.own.held == step.own.colors == 400
    assert step.own.ratio is not None
    assert 0 < step.own.ratio < 1
    assert step.error is not None
    assert 0 < step.error < 1e-3
    assert step.seconds > 0


# ---- what breaks


def textbook(original: Any, origin: Any, direction: Any) -> Any:
    """The discriminant of the textbook: b^2 - a c."""
    line = original(origin, direction)
    a, b, c = (direction**2).sum(axis=0), (origin * direction).sum(axis=0), (origin**2).sum(axis=0) - 1
    D = b * b - a * c
    root = np.sqrt(np.maximum(D, 0))
    half = root / np.sqrt(a)
    return dataclasses.replace(line, meets=D >= 0, near=(-b - root) / a, far=(-b + root) / a, half=half)


def test_the_discriminant_of_the_textbook_breaks_far_away_and_a_good_one_does_not() -> None:
    far = rungs("far-on-axis", "1e1", "1e2", "1e4", "1e6", "1e9")
    ladders = [far, rungs("narrow", "1e-1", "1e-12")]
    good = climbed(ladders, Double(draw=with_patch(chord=unchanged)))
    assert set(cells(good).values()) == {"-"}
    assert good.status == 0
    bad = climbed(ladders, Double(draw=with_patch(chord=textbook)))
    # Its error is u (distance / radius)^2 where that of a good one is u distance / radius.
    assert cells(bad) == {"far-on-axis": "1e4", "narrow": "-"}
    assert bad.status == 1
    found = bad.breaks(far, "double")
    assert found is not None
    _, step = found
    assert step.own is not None
    assert step.own.worst is not None
    assert step.own.worst.claim > 1
    assert "tolerances" in step.says("own")


def test_another_shadow_epsilon_breaks_where_the_epsilon_is_and_nowhere_else() -> None:
    ladders = [
        rungs(name, *get(name).rungs[:2]) for name in ("epsilon", "epsilon-above", "epsilon-below", "shadow-edge")
    ]
    found = cells(climbed(ladders, Double(draw=with_settings(shadow_epsilon=1.02e-4))))
    # Of the first, half of the window is off by more than 2 %; t is 11, then 2 epsilon; 0.9, then 0.99.
    assert found == {"epsilon": "1e-1", "epsilon-above": "-", "epsilon-below": "-", "shadow-edge": "-"}
    longer = cells(climbed(ladders, Double(draw=with_settings(shadow_epsilon=3e-4))))
    assert longer == {"epsilon": "1e-1", "epsilon-above": "1e0", "epsilon-below": "-", "shadow-edge": "-"}
    shorter = cells(climbed(ladders, Double(draw=with_settings(shadow_epsilon=0.95e-4))))
    assert shorter["epsilon-below"] == "1e-2"


def test_an_image_plane_that_is_ignored_breaks_at_once() -> None:
    ladders = [rungs("near-plane", "1e-1", "1e-12"), rungs("eye-outside", "1e-1")]
    found = cells(climbed(ladders, Double(draw=with_patch(nearest=no_near_plane))))
    assert found["near-plane"] == "1e-1"


def test_the_format_is_held_to_its_own_roundings_alone() -> None:
    """Float32 with the claim of float64 breaks on the first rung, with its own on none."""
    ladder = rungs("far-off-axis", "1e1", "1e3")
    f32 = Native("f32")
    scene = ladder.scene("1e1")
    boast = Planted(f32, claim=Native("f64").uncertainty(scene, ONE))
    assert cells(climbed([ladder], boast)) == {"far-off-axis": "1e1"}
    assert cells(climbed([ladder], f32)) == {"far-off-axis": "-"}


def test_no_number_breaks_on_its_rung() -> None:
    def draw(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: array.copy() for name, array in doubles.faithful(scene, passes, settings).items()}
        if scene.view.near < 1e-6:
            arrays["beauty"][3, 5] = np.nan
        return Passes(arrays)

    ladder = get("smaller")
    result = climbed([ladder], Double(draw=draw))
    assert cells(result) == {"smaller": "1e-7"}
    step = dict(result.steps(ladder, "double"))["1e-7"]
    assert step is not None
    assert (step.not_numbers, step.says("own")[:23]) == (1, "1 pixels of NaN or Inf,"[:23])


def test_a_mirror_that_shows_nothing_is_a_wrong_decision() -> None:
    ladder = rungs("mirrors", "1e-1")
    result = climbed([ladder], Double(draw=blind))
    step = dict(result.steps(ladder, "double"))["1e-1"]
    assert step is not None
    assert step.own is not None
    proof = prove_rung(ladder, "1e-1", ONE)
    assert step.own.wrong == (proof.value["reflection.3"] != 0).any(axis=-1).sum() > 0
    assert result.cell(ladder, "double") == "1e-1"


def blind(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """Nothing in the third mirror."""
    two = dict(doubles.faithful(scene, [n for n in passes if n != "reflection.3"], Settings(max_reflections=2)).items())
    del settings
    blank = np.zeros_like(two["beauty"])
    return Passes({name: two.get(name, blank) for name in passes})


# ---- claims


def test_what_claims_to_tell_nothing_says_nothing() -> None:
    ladder = rungs("narrow", "1e-1", "1e-12")
    nothing = Uncertainty(silhouette=2.0, range=2.0, order=2.0, terminator=np.inf, unit=1.0)
    result = climbed([ladder], Double(draw=with_patch(chord=unchanged), claim=nothing))
    assert cells(result) == {"narrow": "(1e-1)"}
    assert result.status == 0
    # As a careful renderer it has something to say.
    assert cells(result, "careful") == {"narrow": "-"}


def test_who_refuses_does_not_break() -> None:
    ladder = rungs("narrow", "1e-1", "1e-12")
    result = climbed([ladder], Double(refuses=True))
    assert cells(result) == {"narrow": "refused"}
    bright = rungs("bright", "1e15", "1e18", "1e30")
    assert cells(climbed([bright], "native-f32")) == {"bright": "(1e18)"}
    both = climbed([bright], "native-f32", "numpy-f32")
    assert [(ladder.name, ours, other) for ladder, ours, other in both.outlasted()] == [
        ("bright", "native-f32", "numpy-f32")
    ]


@pytest.mark.parametrize(("ladder", "rung"), [("speck-off-axis", "1e-7"), ("far-off-axis", "1e9")])
def test_nobody_has_to_meet_a_ball_that_a_rounding_takes_away(ladder: str, rung: str) -> None:
    """In its middle the discriminant is at its largest: to first order it does not move."""
    proof = prove_rung(get(ladder), rung, ONE)
    missing = Double(draw=lambda scene, passes, settings: doubles.faithful(without(scene), passes, settings))
    step = measure(proof, missing)  # float64 has no such excuse
    assert step.own is not None
    assert step.own.wrong >= 1
    single = dataclasses.replace(missing, claim=Native("f32").uncertainty(proof.scene, ONE))
    step = measure(proof, single)
    assert step.own is not None
    assert (step.own.wrong, step.own.worst) == (0, None)
    assert step.wrong >= 1


def without(scene: Scene) -> Scene:
    """The ball moved out of sight."""
    (ball,) = scene.spheres
    return scene.replace(spheres=[ball.replace(position=(0, 0, 8))])


def test_names_are_short_where_that_is_clear() -> None:
    result = climbed([rungs("narrow", "1e-1")], "native-f64")
    result.tested = ("native-f64", "mitsuba-path@llvm", "mitsuba-spec@llvm", "mitsuba-spec@scalar", "cmd:mine a@b")
    shown = [result.short(name) for name in result.tested]
    assert shown == ["native-f64", "mitsuba-path", "mitsuba-spec@llvm", "mitsuba-spec@scalar", "cmd:mine a@b"]


# ---- what goes wrong


def test_a_renderer_that_raises_fails_and_the_others_go_on() -> None:
    def draw(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        if scene.view.near < 1e-2:
            raise RuntimeError("too small for me")
        return doubles.faithful(scene, passes, settings)

    ladder = rungs("smaller", "1e0", "1e-1", "1e-3", "1e-4")
    result = climbed([ladder], Double(draw=draw), "native-f64")
    assert [bool(step) for _, step in result.steps(ladder, "double")] == [True, True, True, False], "not asked again"
    assert result.cell(ladder, "double") == "!1e-3"
    assert result.cell(ladder, "native-f64") == "-"
    assert result.status == 3
    assert [(note.scene, note.renderer) for note in result.failures] == [("smaller 1e-3", "double")]
    assert "too small for me" in result.failures[0].message


def crash(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """Small scenes end the process."""
    if scene.view.near < 1e-2:
        os._exit(7)
    return doubles.faithful(scene, passes, settings)


def hang(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """Small scenes take for ever."""
    if scene.view.near < 1e-2:
        time.sleep(600)
    return doubles.faithful(scene, passes, settings)


@pytest.mark.parametrize(("draw", "words"), [(crash, "crashed: its process ended with status 7"), (hang, "hangs")])
def test_a_crash_or_a_hang_costs_one_renderer_one_ladder(draw: Any, words: str) -> None:
    ladder, other = rungs("smaller", "1e0", "1e-3", "1e-4"), rungs("larger", "1e0")
    result = climbed([ladder, other], Double(draw=draw), "native-f64", jobs=1, seconds=4.0)
    assert result.cell(ladder, "double") == "!1e-3"
    assert [step for _, step in result.steps(ladder, "native-f64") if step is None] == []
    assert [step for _, step in result.steps(ladder, "double")][2] is None  # not asked again
    assert result.cell(other, "double") == "-"
    (note,) = result.failures
    assert (note.scene, note.renderer) == ("smaller 1e-3", "double")
    assert words in note.message
    assert result.status == 3


def test_processes_find_what_this_one_finds() -> None:
    ladders = [rungs("ground", "1e0", "1e4"), "speck"]

    def told(result: Stability) -> Any:
        return [
            [(entry["rung"], {name: step["own"] for name, step in entry["steps"].items()}) for entry in ladder["rungs"]]
            for ladder in result.record()["ladders"]
        ]

    here, there = (climbed(ladders, "native-f32", "numpy-f64", jobs=jobs) for jobs in (0, 2))
    assert told(here) == told(there)


# ---- what comes out


def test_the_record_is_strict_json_and_says_all(tmp_path: Path) -> None:
    result = climbed(["speck", rungs("flat-along", "1e7")], "native-f32", Double(draw=with_patch(chord=textbook)))
    record = result.record()
    assert strict(json.dumps(record, allow_nan=False)) == record
    speck, flat = record["ladders"]
    assert (speck["name"], speck["parameter"]) == ("speck", "radius in pixels")
    assert [entry["rung"] for entry in speck["rungs"]] == list(get("speck").rungs)
    assert set(speck["breaks"]) == {"native-f32", "double"}
    assert speck["breaks"]["native-f32"] is None
    first = speck["rungs"][0]
    assert (first["proved"], first["unproved"], first["file"]) == (400, 0, None)
    assert first["steps"]["native-f32"]["own"]["held"] == 400
    assert flat["breaks"]["double"] == "1e7"
    worst = flat["rungs"][0]["steps"]["double"]["own"]["worst"]
    assert worst["pass"] in ("id", "shadow.L0", "beauty")
    assert record["versions"]["whitted"] == tracer.version()
    page = write_curves(result, tmp_path / "curves")
    assert page.read_text() == write_curves(result, tmp_path / "again").with_name("index.html").read_text()
    pictures = re.findall(r'<svg class="plot" .*?</svg>', page.read_text(), re.DOTALL)
    assert len(pictures) == 2
    for picture in pictures:
        assert ElementTree.fromstring(picture).tag == "svg"
    assert "double breaks at 1e7" in page.read_text()


def test_the_command(run: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["--ladder", "speck,exponent", "--renderer", "native-f64", "--jobs", "1"]
    result = run("stability", *words, "--json", "s.json", "--report", "curves", "--write", "rungs")
    assert (result.status, result.err) == (0, "")
    assert re.search(r"^speck +1e-12 +- *$", result.out, re.MULTILINE)
    assert re.search(r"^exponent +1e6 +- *$", result.out, re.MULTILINE)
    assert "1 of 1 renderers hold on all of 2 ladders" in result.out
    assert result.out.endswith("curves/index.html\nrungs\n")
    record = strict((tmp_path / "s.json").read_text())
    assert record["ok"] is True
    assert [ladder["name"] for ladder in record["ladders"]] == ["speck", "exponent"]
    for ladder in record["ladders"]:
        for entry in ladder["rungs"]:
            assert tracer.load(entry["file"]) == get(ladder["name"]).scene(entry["rung"])
    assert {path.name for path in (tmp_path / "curves").iterdir()} == {"index.html"}
    # Again, over what is ours.
    words[1] = "exponent"
    assert run("stability", *words, "--json", "s.json", "--report", "curves").status == 0
    page = (tmp_path / "curves" / "index.html").read_text()
    assert 'id="exponent"' in page
    assert 'id="speck"' not in page
    made = strict((tmp_path / "s.json").read_text())["date"][:16].replace("T", " ")
    for fact in (f"{made} UTC", tracer.version(), "whitted stability --ladder exponent", "GCC"):
        assert fact in page


def test_the_command_tells_what_breaks_and_how_to_look_at_it(run: Any, registered: Any, monkeypatch: Any) -> None:
    registered(Double(draw=with_patch(chord=textbook)))
    real = climbing.stability
    monkeypatch.setattr(climbing, "stability", lambda *words, **options: real(*words, **(options | {"jobs": 0})))
    result = run("stability", "--ladder", "far-on-axis", "--renderer", "double")
    assert result.status == 1
    assert re.search(r"^double: far-on-axis 1e3: .*tolerances$", result.out, re.MULTILINE)
    assert re.search(r"^  \S+ at x \d+, y \d+.*, exact is .*; margin ", result.out, re.MULTILINE)
    assert "hint: --write DIR keeps the scenes" in result.out
    assert "0 of 1 renderers hold" in result.out


#: The command line, what its error says, and what its hint says.
WRONG = {
    "ladder": ("--ladder spek", "unknown ladder 'spek'", "did you mean 'speck'?"),
    "renderer": ("--renderer nativ-f32", "unknown renderer 'nativ-f32'", "did you mean 'native-f32'?"),
    "seed": ("--seed 3", "--seed is for random scenes, which --fuzz N draws", "--fuzz 100 --seed ..."),
    "against": ("--against native-f32", "--against is for random scenes", "--fuzz 100 --against ..."),
    "output": ("-o found", "--output is for random scenes", "--fuzz 100 --output ..."),
    "fuzz": ("--fuzz 3 --ladder speck", "--ladder is for ladders", "leave out --fuzz, or --ladder"),
    "report": ("--fuzz 3 --report curves", "--report is for ladders", "leave out --fuzz, or --report"),
    "write": ("--fuzz 3 --write rungs", "--write is for ladders", "leave out --fuzz, or --write"),
    "json": ("--ladder speck --json no/where.json", "there is no folder no", "mkdir -p no"),
    "foreign": (
        "--ladder speck --report .",
        "index.html has not been written by whitted stability",
        "name another folder",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_with_a_hint(case: str, run: Any, tmp_path: Path, monkeypatch: Any) -> None:
    words, message, hint = WRONG[case]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "index.html").write_text("mine")
    result = run("stability", *words.split())
    assert (result.status, result.out) == (2, "")
    assert message in result.err
    assert hint in result.err.partition("  hint: ")[2]
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]


def test_a_renderer_that_is_not_here_is_a_failure(run: Any, registered: Any) -> None:
    registered(Double(absent="it is not here: install it"))
    result = run("stability", "--ladder", "speck", "--renderer", "double")
    assert result.status == 3
    assert "it is not here" in result.err + result.out


def test_ctrl_c_keeps_what_was_found(run: Any, tmp_path: Path, monkeypatch: Any) -> None:
    def interrupted(tasks: Any, tested: Any, settings: Any, *_: Any) -> Any:
        yield climbing.climb(tasks[0], tested, settings)
        raise KeyboardInterrupt

    monkeypatch.setattr(climbing, "_in_processes", interrupted)
    file = tmp_path / "s.json"
    result = run("stability", "--ladder", "speck", "--renderer", "native-f64", "--json", file)
    assert result.status == 130
    assert "\n1 of 13 rungs in " in result.out
    assert result.err == f"\ninterrupted: kept {file} with 1 of 13 rungs\n"
    assert strict(file.read_text())["interrupted"] is True


def test_standards() -> None:
    good = Standard(held=3, colors=3, wrong=0, ratio=1.0, worst=None)
    assert not good.broken
    assert dataclasses.replace(good, ratio=1.01).broken
    assert dataclasses.replace(good, ratio=float("inf")).broken
    assert dataclasses.replace(good, wrong=1).broken
    step = Step(renderer="r", own=good, careful=good)
    assert not step.broken("own")
    assert dataclasses.replace(step, not_numbers=1).broken("own")
    assert Step(renderer="r", refused="no").silent("own")
    assert not Step(renderer="r", failed="no").silent("own")
    assert names()[0] == "far-on-axis"
    assert renderers.get("native-f64").name == "native-f64"
