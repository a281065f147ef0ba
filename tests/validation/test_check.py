"""Conventions fitted to images of every kind, also of those that have a real defect, and what is said of both."""

from __future__ import annotations

import dataclasses
import functools
import html
import itertools
import os
import re
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import doubles
import numpy as np
import planted
import pytest
from conftest import Result, strict
from doubles import with_patch
from PIL import Image

import tracer
import validation.check
from tracer.passes import SAMPLES, Sample
from validation import Settings, cli
from validation.check import FEW, FIRST_ALIKE, LAYOUTS, Convention, Pace, Picture, check, fit, together
from validation.encoding import QUANTISATIONS, Encoding
from validation.report.report import headline
from validation.run import MOST_VERDICTS, InputError, resized
from validation.terminal import print_check

CONVENTIONS = [
    Convention(sample, flipped, quantisation)
    for sample, quantisation, flipped in itertools.product(SAMPLES, QUANTISATIONS, (False, True))
]
#: One of each sampling and of each quantisation: with a defect a fit takes longer.
SOME = [
    Convention(sample, False, quantisation)
    for sample, quantisation in zip((*SAMPLES, *SAMPLES), list(QUANTISATIONS)[1:], strict=False)
] + [Convention("corner", True)]

Colors = np.ndarray[Any, np.dtype[np.float64]]
Draw = Callable[..., Any]


@functools.cache
def full() -> tracer.Scene:
    """Three mirrors and two lights, some of it brighter than 1."""
    scene = resized(doubles.full(), (64, 48))
    return scene.replace(lights=[light.replace(intensity=(2, 1.5, 1.2)) for light in scene.lights])


@functools.cache
def cut() -> tracer.Scene:
    """A sphere cut by the near plane, with a light inside and one outside."""
    scene = resized(doubles.cut(), (64, 64))
    return scene.replace(
        lights=[*scene.lights, tracer.Light(name="sun", position=(4, 5, 6), intensity=(0.5, 0.6, 0.7))]
    )


@functools.cache
def colors(scene: tracer.Scene, sample: Sample, draw: Draw = doubles.faithful) -> Colors:
    drawn: Colors = draw(scene, ("beauty",), Settings(sample=sample))["beauty"]
    return drawn


def picture(scene: tracer.Scene, convention: Convention, draw: Draw = doubles.faithful, **encoding: Any) -> Picture:
    levels = Encoding(convention.quantisation, **encoding).encode(colors(scene, convention.sample, draw))
    return Picture("scene", scene, convention.upright(levels), encoding.get("steps", 255))


@pytest.mark.parametrize(
    "convention", CONVENTIONS, ids=lambda convention: "-".join(map(str, dataclasses.astuple(convention)))
)
def test_every_convention_is_found(convention: Convention) -> None:
    found = fit([picture(full(), convention)], Settings())
    assert found.convention == convention
    assert found.explained == found.pixels == 64 * 48
    assert (found.alike, found.wraps, found.mistake) == ((), False, "")
    assert (found.plain == found.pixels) == convention.specified


def test_more_levels_than_255() -> None:
    convention = Convention("top-right", True, "round")
    assert fit([picture(full(), convention, steps=65535)], Settings()).convention == convention


def test_several_pictures_have_one_convention() -> None:
    convention = Convention("center", False, "256")
    pictures = [
        dataclasses.replace(picture(scene, convention), label=str(place)) for place, scene in enumerate((full(), cut()))
    ]
    found = fit(pictures, Settings())
    assert (found.convention, found.pixels) == (convention, 64 * 48 + 64 * 64)


def test_what_cannot_be_told_apart_is_said() -> None:
    """An empty image has no sample points, and two of its levels are the same."""
    empty = full().replace(spheres=[], background=(0, 1, 0))
    found = fit([picture(empty, Convention())], Settings())
    assert found.convention == Convention()
    assert len(found.alike) == len(CONVENTIONS) - 1


@pytest.mark.parametrize("fault", LAYOUTS)
def test_a_fault_of_the_layout_is_told(fault: str) -> None:
    """The image is wrong, but what is in it is compared as if it were right."""
    scene = full().replace(view=full().view.replace(columns=48, rows=48))
    right = picture(scene, Convention("center", False, "round"))
    undone = {
        "red and blue are swapped": lambda levels: levels[:, :, ::-1],
        "the first column of the file is the rightmost": np.fliplr,
        "rows and columns are swapped": lambda levels: levels.transpose(1, 0, 2),
        "the image is one pixel too far to the right": lambda levels: np.roll(levels, 1, axis=1),
        "the image is one pixel too far to the left": lambda levels: np.roll(levels, -1, axis=1),
        "the image is one pixel too low": lambda levels: np.roll(levels, 1, axis=0),
        "the image is one pixel too high": lambda levels: np.roll(levels, -1, axis=0),
    }[fault]
    result = check([dataclasses.replace(right, levels=undone(right.levels))])
    assert result.fit is not None
    assert result.fit.convention == Convention("center", False, "round", fault)
    assert result.fit.explained == result.fit.pixels
    assert [entry.off for entry in result.left] == [0]
    assert result.status == 1
    # In the file and the report too, alone and beside other programs.
    assert result.record()["ok"] is False
    both = together({"mine": result})
    assert not both.ok
    assert headline(result.validation).startswith(f"Wrong: {fault}. ")
    assert headline(both).startswith(f"Wrong: mine: {fault}. ")
    assert f"wrong: {fault}; it is compared as if that were right" in result.about()


class Defect(NamedTuple):
    draw: Draw
    scene: Callable[[], tracer.Scene]
    says: str


NORMALS = with_patch(surface=planted.wrong_normals)
DEFECTS = {
    "normals": Defect(NORMALS, full, "divides the normal by the scaling once, not twice"),
    "shadows": Defect(with_patch(hidden=planted.no_shadows), full, "casts no shadows"),
    "near plane": Defect(
        with_patch(nearest=planted.no_near_plane), cut, "ignores the near plane: primary hits count from t > 0 on"
    ),
}


@pytest.mark.parametrize("convention", SOME, ids=lambda convention: "-".join(map(str, dataclasses.astuple(convention))))
@pytest.mark.parametrize("name", DEFECTS)
def test_a_convention_is_found_beside_a_defect(name: str, convention: Convention) -> None:
    defect = DEFECTS[name]
    found = fit([picture(defect.scene(), convention, defect.draw)], Settings())
    assert found.convention == convention
    assert found.explained < found.pixels


@pytest.mark.parametrize("name", DEFECTS)
def test_the_defect_is_found_beside_the_convention(name: str) -> None:
    defect, convention = DEFECTS[name], Convention("center", True, "round")
    result = check([picture(defect.scene(), convention, defect.draw)], verdicts=20)
    assert result.fit is not None
    assert result.fit.convention == convention
    assert result.status == 1
    (verdicts,) = result.validation.verdicts
    because = {finding.because for verdict in verdicts.verdicts for finding in verdict.wrong}
    assert because == {f"truth makes this pixel if it {defect.says}"}
    assert {finding.renderer for verdict in verdicts.verdicts for finding in verdict.wrong} == {"image"}
    (left,) = result.left
    assert left.off == left.by_one + left.by_more > 20


ACNE_SAYS = "hides some lights behind the very sphere that the shadow ray starts on: shadow acne"


@pytest.mark.parametrize("scene", [full, cut], ids=["mirrors", "inside"])
def test_shadow_acne_is_named(scene: Callable[[], tracer.Scene]) -> None:
    """It comes and goes with rounding, so no rule makes it: of every pixel truth is asked which lights are hidden."""
    image = picture(scene(), Convention("center"), with_patch(hidden=planted.shadow_acne))
    result = check([image], verdicts=40)
    (verdicts,) = result.validation.verdicts
    told = [verdict.renderer for verdict in verdicts.verdicts]
    named = [finding for finding in told if finding.because == f"truth makes this pixel if it {ACNE_SAYS}"]
    assert len(named) >= 0.9 * len(told) > 0, "a reflected ray may meet its own sphere again as well"
    assert {finding.cause for finding in named} == {"mistake"}
    for finding in named:
        assert finding.decision is not None
        assert finding.decision.says.startswith("hides light ")
        assert finding.decision.says.endswith(", where its shadow ray starts")
        assert finding.decision.t == 0
    assert result.status == 1


def test_whole_areas_in_their_own_shadow_are_no_acne() -> None:
    """Speckles alone tell that rounding is behind it."""

    def hidden(original: Any, tables: Any, x: Any, to_light: Any, light: int, epsilon: float) -> Any:
        return original(tables, x, to_light, light, epsilon) | ((x.start == 0) & (light == 0))

    result = check([picture(full(), Convention(), with_patch(hidden=hidden))], verdicts=30)
    (verdicts,) = result.validation.verdicts
    assert {verdict.renderer.cause for verdict in verdicts.verdicts} == {"unexplained"}
    assert len(verdicts.verdicts) == 30


def test_two_pixels_in_their_own_shadow_are_no_acne() -> None:
    lit = picture(full(), Convention())
    acne = picture(full(), Convention(), with_patch(hidden=planted.shadow_acne))
    rows, columns = np.nonzero((lit.levels != acne.levels).any(axis=-1))
    for count, cause in ((2, "unexplained"), (3, "mistake")):
        levels = lit.levels.copy()
        for k in range(count):
            place = rows[k * len(rows) // 3], columns[k * len(rows) // 3]
            levels[place] = acne.levels[place]
        (verdicts,) = check([dataclasses.replace(lit, levels=levels)]).validation.verdicts
        assert [verdict.renderer.cause for verdict in verdicts.verdicts] == [cause] * count


@pytest.mark.parametrize("convention", SOME, ids=lambda convention: "-".join(map(str, dataclasses.astuple(convention))))
def test_colors_that_are_not_clamped(convention: Convention) -> None:
    assert (colors(full(), "corner") > 1).any()
    found = check([picture(full(), convention, wraps=True)], verdicts=20)
    assert found.fit is not None
    assert (found.fit.convention, found.fit.wraps) == (convention, True)
    (verdicts,) = found.validation.verdicts
    assert {verdict.renderer.because for verdict in verdicts.verdicts} == {
        "truth makes this pixel if it does not clamp colors: those above 1 begin again at 0"
    }
    assert found.status == 1


def test_a_right_image_leaves_nothing() -> None:
    result = check([picture(full(), Convention("inclusive", False, "srgb"))])
    assert result.status == 0
    assert [entry.off for entry in result.left] == [0]
    assert not result.validation.verdicts


def test_one_wrong_pixel_is_left() -> None:
    right = picture(full(), Convention("center"))
    levels = right.levels.copy()
    levels[10, 20] ^= 64
    levels[0, 0, 1] += 1
    result = check([dataclasses.replace(right, levels=levels)])
    (left,) = result.left
    assert (left.by_one, left.by_more, left.off, result.status) == (1, 1, 2, 1)
    (verdicts,) = result.validation.verdicts
    assert [(verdict.x, verdict.y) for verdict in verdicts.verdicts] == [(0, 0), (20, 10)]
    assert {verdict.renderer.cause for verdict in verdicts.verdicts} == {"unexplained"}


def test_what_is_missing_everywhere_is_found() -> None:
    """No pixel is right, so none tells the sampling: truth without the ambient term does."""
    scene = full().replace(background=(0, 0, 0))
    convention = Convention("center", True, "round")
    dark = picture(scene.replace(ambient=(0, 0, 0)), convention)
    found = fit([dataclasses.replace(dark, scene=scene)], Settings())
    assert (found.convention, found.mistake) == (convention, "leaves out the ambient term")


def test_part_of_an_image_in_another_quantisation_is_no_mistake() -> None:
    """Surfaces rounded, the rest truncated: no rule that changes next to nothing is taken for the reason."""
    right, other = picture(full(), Convention()), picture(full(), Convention(quantisation="round"))
    levels = np.where((np.arange(48) < 16)[:, None, None], right.levels, other.levels)
    found = fit([dataclasses.replace(right, levels=levels)], Settings())
    assert (found.convention, found.mistake) == (Convention(quantisation="round"), "")
    assert found.explained > 32 * 64


def test_an_image_of_something_else() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (48, 64, 3))
    result = check([dataclasses.replace(picture(full(), Convention()), levels=noise)], verdicts=0)
    assert result.fit is not None
    assert not result.fit.known
    assert result.fit.convention == Convention()
    assert result.about()[0].startswith("no known convention explains the image; as: samples at the top-left corner")


def noise(of: Picture, seed: int = 1) -> Picture:
    """Every third pixel is anything."""
    rng = np.random.default_rng(seed)
    anything = rng.integers(0, 256, of.levels.shape)
    return dataclasses.replace(
        of, levels=np.where(rng.random(of.levels.shape[:2])[..., None] < 1 / 3, anything, of.levels)
    )


def test_what_comes_to_the_same_is_judged_a_few_times(capsys: pytest.CaptureFixture[str]) -> None:
    """Every sphere has one of the few, and so has what lies behind them."""
    result = check([noise(picture(full(), Convention()))])
    (verdicts,) = result.validation.verdicts
    assert verdicts.stopped
    assert len(verdicts.verdicts) == 2 * FIRST_ALIKE < verdicts.differ
    assert {verdict.truth.id for verdict in verdicts.verdicts} == {-1, 0, 1, 2}
    places = [(verdict.y, verdict.x) for verdict in verdicts.verdicts]
    assert places == sorted(places)
    assert verdicts.record()["stopped"] is True
    print_check(result)
    told = "the first 24 judged, taken at random from every sphere, all are unexplained; --verdicts N judges more"
    assert f"{verdicts.differ} pixels differ; {told}\n" in capsys.readouterr().out
    (more,) = check([noise(picture(full(), Convention()))], verdicts=26).validation.verdicts
    assert (len(more.verdicts), more.stopped) == (26, False)
    assert "stopped" not in more.record()


@pytest.fixture(autouse=True)
def any_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is judged does not depend on how busy a machine is."""
    monkeypatch.setattr("validation.check.SECONDS", 1e6)


def mixed() -> Picture:
    """With a mistake, and noise in its upper part: every judgement goes on."""
    image = picture(full(), Convention(), DEFECTS["normals"].draw)
    levels = np.where((np.arange(48) < 16)[:, None, None], noise(image).levels, image.levels)
    return dataclasses.replace(image, levels=levels)


def test_as_much_is_judged_as_there_is_time_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("validation.check.SECONDS", 0.0)
    monkeypatch.setattr("validation.verdict.Pulse.due", lambda _: True)
    told: list[str] = []
    two = [mixed(), dataclasses.replace(mixed(), label="again")]
    result = check(two, progress=told.append)
    assert [len(verdicts.verdicts) for verdicts in result.validation.verdicts] == [FEW, 1]
    assert all(verdicts.late and not verdicts.stopped for verdicts in result.validation.verdicts)
    judged = [text.partition("corner, truncate: ")[2] for text in told if "judged" in text]
    assert [text.partition(": ")[2].split(" judged")[0] for text in judged] == [
        f"{k} of {MOST_VERDICTS} pixels" for k in (0, 1, 2, 0)
    ]
    assert result.validation.verdicts[0].record()["late"] is True
    print_check(result)
    differ = result.validation.verdicts[0].differ
    assert f": {differ} pixels differ; 3 of them judged, taken at random" in (out := capsys.readouterr().out)
    assert "to keep it short; --verdicts N judges more" in out
    (more,) = check([mixed()], verdicts=5).validation.verdicts
    assert (len(more.verdicts), more.late) == (5, False), "what is asked for takes its time"


def test_a_mistake_that_enough_pixels_show_needs_no_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = itertools.count()
    monkeypatch.setattr("validation.check.time.monotonic", lambda: next(now))
    mistake: Any = SimpleNamespace(renderer=SimpleNamespace(cause="mistake", because="it does"))
    other: Any = SimpleNamespace(renderer=SimpleNamespace(cause="unexplained", because="nothing"))
    places = [(k, 0) for k in range(100)]
    few, enough = [mistake] * (FIRST_ALIKE - 1) + [other] * 9, [mistake] * FIRST_ALIKE + [other] * 9
    count = {len(verdicts): len(list(Pace(2, 80).through(places, verdicts))) for verdicts in (few, enough)}
    assert count == {len(few): 40, len(enough): 10}, "each image has half of the time, which passes by 1 a pixel"


def test_what_does_not_come_to_the_same_is_judged_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """An image with a mistake, and noise in its upper part."""
    monkeypatch.setattr("validation.check.MOST_VERDICTS", 20)
    (verdicts,) = check([mixed()]).validation.verdicts
    assert (len(verdicts.verdicts), verdicts.stopped) == (20, False)
    assert {verdict.renderer.cause for verdict in verdicts.verdicts} == {"mistake", "unexplained"}


def test_one_mistake_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever it makes of decisions: light that goes past this sphere or that one, a highlight that is not there."""
    defect = DEFECTS["normals"]
    result = check([picture(full(), Convention(), defect.draw)])
    (verdicts,) = result.validation.verdicts
    patterns = {verdict.renderer.decision.pattern for verdict in verdicts.verdicts if verdict.renderer.decision}
    assert len(patterns) > 1
    (group,) = verdicts.groups()
    assert len(group.verdicts) == FIRST_ALIKE
    print_check(result)
    out = capsys.readouterr().out
    assert "all come to one mistake; --verdicts N judges more" in out
    (line,) = (line for line in out.splitlines() if "WRONG" in line)
    assert line.startswith(f"  WRONG: 12 pixels: image parts from truth in {len(patterns)} ways, for example it ")
    first = group.verdicts[0]
    assert line.endswith(f" (e.g. at {first.x} {first.y}): truth makes this pixel if it {defect.says}")


def test_an_image_with_a_mistake_is_tallied_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of other layouts a few pixels are looked at, and none of it again for the mistake."""
    tallied: list[tuple[str, int]] = []
    original = validation.check._tally

    def tally(pictures: Any, chosen: Any, colors: Any, fault: str) -> Any:
        tallied.append((fault, sum(map(len, chosen))))
        return original(pictures, chosen, colors, fault)

    monkeypatch.setattr(validation.check, "_tally", tally)
    monkeypatch.setattr(validation.check, "PROBED", 100)
    defect = DEFECTS["shadows"]
    found = fit([picture(full(), Convention("center"), defect.draw)], Settings())
    assert found.mistake == defect.says
    assert tallied[0] == ("", found.pixels)
    assert [fault for fault, _ in tallied[1:]] == [
        fault for fault in LAYOUTS if "swapped" not in fault or "red" in fault
    ]
    assert all(count == 100 for _, count in tallied[1:])


def test_scenes_that_are_equal_have_images_of_their_own() -> None:
    again = tracer.loads(full().text())
    right = picture(full(), Convention())
    wrong = Picture("again", again, np.zeros_like(right.levels))
    result = check([right, wrong], verdicts=0)
    assert [entry.off > 0 for entry in result.left] == [False, True]


def test_an_image_that_is_too_large_is_refused() -> None:
    large = full().replace(view=full().view.replace(columns=2100, rows=2100))
    with pytest.raises(InputError, match="scene: error: an image of 2100x2100 pixels takes too long to be checked"):
        check([Picture("scene", large, np.zeros((2100, 2100, 3), np.uint8))])


# ---- the command


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "full.txt"
    path.write_text(full().text(), encoding="utf-8")
    return path


def save(path: Path, of: Picture) -> Path:
    Image.fromarray(of.levels.astype(np.uint8)).save(path)
    return path


def test_the_command_says_all_of_it(scene_file: Path, tmp_path: Path, run: Callable[..., Result]) -> None:
    image = save(tmp_path / "mine.png", picture(full(), Convention("center", True, "round"), DEFECTS["shadows"].draw))
    result = run(
        "check",
        scene_file,
        "--image",
        image,
        "--verdicts",
        10,
        "--json",
        tmp_path / "r.json",
        "--report",
        tmp_path / "r",
    )
    assert result.status == 1
    assert result.out.startswith(
        "convention: samples at the centre of the pixels; v * 255, rounded; the first row of the file is the lowest\n"
    )
    assert "most likely: it casts no shadows (10 of 10 pixels judged)" in result.out
    assert "hint:" not in result.out
    assert " are left: " in result.out
    assert "\nnot right\n" in result.out
    assert (tmp_path / "r" / "index.html").stat().st_size > 10_000
    record = strict((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert record["fit"]["sample"] == "center"
    assert record["fit"]["flipped"] is True
    assert record["left"][0]["by_more"] > 100


def test_a_single_cause_is_told() -> None:
    """The fit takes the first mistake that makes sense of the bytes, the judge what makes the pixels."""
    image = picture(full(), Convention(), with_patch(hidden=planted.shadow_acne))
    result = check([image], verdicts=12)
    assert list(result.likely()) == [ACNE_SAYS]
    assert result.fit is not None
    fitted = "fitted with the mistake"
    other = dataclasses.replace(
        result, fit=dataclasses.replace(result.fit, mistake="lets spheres behind a light hide it")
    )
    assert fitted not in "".join(other.about())
    same = dataclasses.replace(result, fit=dataclasses.replace(result.fit, mistake=ACNE_SAYS))
    assert fitted in "".join(same.about())


def test_what_to_do_about_shadow_acne(scene_file: Path, tmp_path: Path, run: Callable[..., Result]) -> None:
    image = picture(full(), Convention(), with_patch(hidden=planted.shadow_acne))
    mine = save(tmp_path / "mine.png", image)
    result = run("check", scene_file, "--image", mine, "--report", tmp_path / "r")
    assert f"most likely: it {ACNE_SAYS} (12 of 12 pixels judged)\n  hint: a shadow ray meets the surface" in result.out
    assert "if they do, compute in double, or take a larger epsilon, or leave out the near root" in result.out
    assert result.status == 1
    page = html.unescape((tmp_path / "r" / "index.html").read_text(encoding="utf-8"))
    assert f"truth makes this pixel if it {ACNE_SAYS}" in page
    assert "no more of an image whose first few all come to the same" in page


def test_a_right_image(scene_file: Path, tmp_path: Path, run: Callable[..., Result]) -> None:
    result = run("check", scene_file, "--image", save(tmp_path / "mine.png", picture(full(), Convention())))
    assert (result.status, result.err) == (0, "")
    assert result.out.splitlines()[-1] == "right"
    other = save(tmp_path / "mine.png", picture(full(), Convention("center")))
    assert run("check", scene_file, "--image", other).out.splitlines()[-1] == "right but for its convention"


def test_a_program(scene_file: Path, run: Callable[..., Result]) -> None:
    raytrace = Path(sys.executable).parent / "raytrace"
    command = f"{shlex.quote(str(raytrace))} {{scene}} --sample center -o {{output}}"
    result = run("check", scene_file, "--command", command)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("convention: samples at the centre of the pixels; v * 255, truncated\n")
    failing = run("check", scene_file, "--command", f"{shlex.quote(sys.executable)} -c 'raise SystemExit(7)' {{scene}}")
    assert failing.status == 3
    assert "status 7" in failing.err


def test_a_failing_program_is_not_sent_to_check(
    scene_file: Path, run: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    result = run("check", scene_file, "--verdicts", 1, "--command", "raytrace {scene} --max-reflections 0")
    assert result.status == 1
    assert "whitted check" not in result.out


def test_a_program_that_ends_badly_is_checked(
    scene_file: Path, tmp_path: Path, run: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    Path("bad").write_text('raytrace "$@"; echo bye >&2; exit 4\n', encoding="utf-8")
    command = "sh bad {scene}"
    result = run("check", scene_file, "--command", command, "--json", tmp_path / "r.json")
    assert (result.status, result.err) == (1, "")
    assert result.out.splitlines()[-1] == "right, but it ended with exit status 4"
    assert "ended with exit status 4, though its image is whole\n  stderr: bye\n  hint: " in result.out
    record = strict((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert (record["ending"], record["left"][0]["edge"], record["failures"]) == ("ended with exit status 4", 0, [])
    wrong = f"{command} --max-reflections 0"
    result = run("check", scene_file, "--verdicts", 1, "--command", wrong, "--command", command)
    assert result.status == 1
    assert "it reflects 0 times, not 3" in result.out
    assert "0 of 2 programs are right" in result.out
    assert result.out.count("it ended with exit status 4") == 2
    one = run("check", scene_file, "--verdicts", 1, "--command", wrong)
    assert one.out.splitlines()[-1] == "not right"


def test_what_is_finished_is_told_where_the_rest_is_not(
    scene_file: Path, tmp_path: Path, run: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    original = validation.check.draw_pictures

    def interrupted(scenes: Any, template: str, *arguments: Any, **more: Any) -> Any:
        if "center" in template:
            raise KeyboardInterrupt
        return original(scenes, template, *arguments, **more)

    monkeypatch.setattr(validation.check, "draw_pictures", interrupted)
    programs = ("--command", "raytrace {scene}", "--command", "raytrace {scene} --sample center")
    file, page = tmp_path / "all.json", tmp_path / "report" / "index.html"
    result = run("check", scene_file, *programs, "--json", file, "--report", page.parent)
    assert result.status == 130
    assert result.out.endswith("\nright\n")
    assert result.err == f"\ninterrupted: kept {file} and {page} with 1 of 2 programs\n"
    record = strict(file.read_text())
    assert (record["ok"], record["unfinished"]) == (False, ["raytrace {scene} --sample center"])
    assert [entry["program"] for entry in record["programs"]] == ["cmd:raytrace {scene}"]
    assert "<h1>Unfinished: 1 of 2 programs. " in page.read_text()


def test_of_one_program_the_scenes_that_are_finished_are_kept(
    scene_file: Path, tmp_path: Path, run: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    second = tmp_path / "second.txt"
    second.write_text(scene_file.read_text())
    original = validation.run._draw

    def interrupted(result: Any, label: str, *arguments: Any) -> Any:
        if label == str(second):
            raise KeyboardInterrupt
        return original(result, label, *arguments)

    monkeypatch.setattr(validation.run, "_draw", interrupted)
    file, page = tmp_path / "one.json", tmp_path / "report" / "index.html"
    words = ("--command", "raytrace {scene} --max-reflections 0", "--json", file, "--report", page.parent)
    result = run("check", scene_file, second, *words)
    assert result.status == 130
    assert result.err == f"\ninterrupted: kept {file} and {page} with 1 of 2 scenes\n"
    assert "most likely: it reflects 0 times, not 3" in result.out
    record = strict(file.read_text())
    assert (record["ok"], record["unfinished"]) == (False, [str(second)])
    assert record["fit"]["sample"] == "corner"
    assert [entry["label"] for entry in record["left"]] == [str(scene_file)]
    assert "<h1>Unfinished: 1 of 2 scenes. " in page.read_text()


def test_several_programs_have_a_line_each(
    scene_file: Path, tmp_path: Path, run: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For who grades: right or not, the convention, how much is left, and the likeliest mistake."""
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    programs = {
        "raytrace {scene}": "right  corner, truncate  0/3072  0  -",
        "raytrace {scene} --sample center": "right  center, truncate  0/3072  0  -",
        "raytrace {scene} --max-reflections 0": "not right  corner, truncate  N/3072  N  it reflects 0 times, not 3",
        "python -c 'exit(7)' {scene}": "failed  -  0/0  -  failed in 1 of 1 scenes: ended with exit status 7",
    }
    words = [word for program in programs for word in ("--command", program)]
    result = run("check", scene_file, *words, "--json", tmp_path / "all.json", "--report", tmp_path / "r")
    assert result.status == 3
    for program, row in programs.items():
        (line,) = (line for line in result.out.splitlines() if line.startswith(f"{program}  "))
        told = re.sub(" {2,}", "  ", line.removeprefix(program)).strip()
        assert re.fullmatch(re.escape(row).replace("N", "[0-9.]+"), told), line
    assert "2 of 4 programs are right" in result.out
    record = strict((tmp_path / "all.json").read_text(encoding="utf-8"))
    assert [entry["program"] for entry in record["programs"]] == [f"cmd:{program}" for program in programs]
    assert [entry["ok"] for entry in record["programs"]] == [True, True, False, False]
    assert [(entry["fit"] or {}).get("sample") for entry in record["programs"]] == ["corner", "center", "corner", None]
    assert record["ok"] is False
    page = html.unescape((tmp_path / "r" / "index.html").read_text(encoding="utf-8"))
    for program in programs:
        assert f"cmd:{program}: " in page, "what came out of each is in the head of the page"
    one = run("check", scene_file, "--command", next(iter(programs)), "--command", next(iter(programs)))
    assert one.out.startswith("convention: "), "one that is named twice is one"


def test_options_that_validate_has_too_are_the_same() -> None:
    both = [{option.name: option for option in command.params} for command in (cli.validate, cli.check)]
    for name in ("report", "json_file", "verdicts", "size", "shadow_epsilon", "max_reflections", "threads"):
        first, second = (options[name].to_info_dict() for options in both)
        assert {**first, "help": ""} == {**second, "help": ""}


@pytest.mark.parametrize(
    ("arguments", "error", "hint"),
    [
        ([], "expected either --image or --command", "whitted check SCENE --image FILE"),
        (["--image", "a.png", "--command", "x {scene}"], "--image and --command exclude each other", "whitted check"),
        (["--image", "a.png", "--size", "8x8"], "--size: an image has the size that it has", "--command"),
        (["--command", ""], "the command", "./mine"),
        (["--image", "a.png", "--image", "b.png"], "expected 1 --image for 1 scene, found 2", "one each"),
        (["--image", "missing.png"], "missing.png: error: no such file", ""),
        (["--image", "small.png"], "small.png: error: the image is 2x3, the scene asks for 64x48", ""),
        (["--image", "text.txt"], "text.txt: error: it is no image", "PPM"),
        (["--command", "x"], "it lacks {scene}", "./mine {scene}"),
        (["--image", "small.png", "--verdicts", "x"], "--verdicts: 'x' is not a whole number", "--verdicts 500"),
    ],
)
def test_what_is_wrong_is_said(
    arguments: list[str], error: str, hint: str, scene_file: Path, tmp_path: Path, run: Callable[..., Result]
) -> None:
    Image.new("RGB", (2, 3)).save(tmp_path / "small.png")
    (tmp_path / "text.txt").write_text("hello", encoding="utf-8")
    words = [str(tmp_path / word) if word.endswith((".png", ".txt")) else word for word in arguments]
    result = run("check", scene_file, *words)
    assert result.status == 2
    assert error in result.err
    assert hint in result.err
    assert "Traceback" not in result.err
    assert not result.out


def test_all_that_is_wrong_with_images_is_said_in_their_order(run: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    scenes = [Path(f"{name}.txt") for name in "bac"]
    for path in scenes:
        path.write_text(doubles.FULL)
    Path("folder").mkdir()
    Path("empty.ppm").touch()
    images = [word for name in ("nowhere.ppm", "folder", "empty.ppm") for word in ("--image", name)]
    result = run("check", *scenes, *images)
    assert (result.status, result.out) == (2, "")
    places = [line.partition(": error: ")[0] for line in result.err.splitlines() if ": error: " in line]
    assert places == ["nowhere.ppm", "folder", "empty.ppm"]
    assert "folder: error: this is a folder, expected an image" in result.err


def test_a_hint_about_a_command_is_one_that_can_be_typed(run: Any, scene: Path) -> None:
    assert run("check", scene, "--command", "raytrace").err.endswith("\n  hint: for example './mine {scene}'\n")
