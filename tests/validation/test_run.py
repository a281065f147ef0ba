"""What `validate` does around the comparisons: files, sizes, what is drawn, and the status at the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from doubles import Double

import tracer.margins
import validation
from tracer.passes import Passes
from validation import Settings, run, validate
from validation.run import InputError, Note, SceneFilesError, load_scenes, resized, scene_files, shrink


def test_scene_files_are_sorted_and_named_once(tmp_path: Path) -> None:
    for name in ("b.txt", "a.txt", "deep/c.txt", "deep/notes.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    found = scene_files([tmp_path, tmp_path / "a.txt", tmp_path / "deep" / "notes.md"])
    assert [path.name for path in found] == ["a.txt", "b.txt", "c.txt", "notes.md"]


def test_paths_that_are_wrong_are_named_together(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneFilesError) as error:
        scene_files([tmp_path / "empty", tmp_path / "nowhere"])
    assert len(error.value.messages) == 2
    assert "no scene in this folder" in error.value.messages[0]
    assert "no such file or folder" in error.value.messages[1]


def test_files_that_cannot_be_read_are_named_together(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("NEAR x")
    (tmp_path / "b.txt").write_bytes(b"\xff\x00")
    with pytest.raises(SceneFilesError) as error:
        load_scenes([tmp_path])
    assert len(error.value.messages) == 2


@pytest.mark.parametrize("size", [(400, 400), (1600, 900), (1, 10_000), (10_000, 1), (3, 2), (640, 160)])
@pytest.mark.parametrize("pixels", [1, 2, 50, 1000, 10**6])
def test_shrink_keeps_the_aspect_and_the_limit(size: tuple[int, int], pixels: int) -> None:
    columns, rows = shrink(*size, pixels)
    assert 1 <= columns <= size[0]
    assert 1 <= rows <= size[1]
    assert columns * rows <= max(pixels, 1)
    if size[0] * size[1] <= pixels:
        assert (columns, rows) == size
    elif min(columns, rows) > 1:
        # Each side is rounded down by less than one.
        exact = (size[0] / size[1] * pixels) ** 0.5, (size[1] / size[0] * pixels) ** 0.5
        assert exact[0] - 1 < columns <= exact[0] + 1e-9
        assert exact[1] - 1 < rows <= exact[1] + 1e-9


@pytest.mark.parametrize("change", [{"sample": "center"}, {"shadow_epsilon": 0.3}, {"max_reflections": 0}], ids=str)
def test_margins_are_those_of_the_settings(change: dict[str, Any]) -> None:
    scene = doubles.full()
    plain, changed = tracer.margins.analyse(scene), tracer.margins.analyse(scene, **change)
    found = run.analyse(scene, Settings(**change))

    def same(a: Any, b: Any) -> bool:
        margins = all(np.array_equal(a.margins[kind], b.margins[kind]) for kind in a.margins)
        return margins and np.array_equal(a.sensitivity["beauty"], b.sensitivity["beauty"])

    assert same(found, changed)
    assert not same(found, plain)


def test_resized_changes_nothing_else() -> None:
    scene = doubles.full()
    assert resized(scene, (64, 48)) is scene
    small = resized(scene, (8, 6))
    assert (small.view.columns, small.view.rows) == (8, 6)
    assert resized(small, (64, 48)) == scene


def test_each_renderer_draws_a_scene_once() -> None:
    tested, first, second = Double(name="tested"), Double(name="first"), Double(name="second", missing=("depth",))
    result = validate({"full": doubles.full()}, tested, [first, second])
    assert (len(tested.rendered), len(first.rendered), len(second.rendered)) == (1, 1, 1)
    assert result.ok
    assert len(result.comparisons) == 15 + 14
    assert [note.message for note in result.notes] == ["not compared, as it does not deliver them: depth"]


def test_what_is_quick_keeps_its_size_and_the_rest_is_drawn_smaller() -> None:
    tested = Double(name="tested")
    slow = Double(name="slow", limit=768, quick=("id", "depth", "normal", "specular"), missing=("ambient",))
    rendered: list[Any] = []
    result = validate({"full": doubles.full()}, tested, [slow, "numpy-f64"], on_rendered=rendered.append)
    assert result.ok
    sizes = {(entry.reference, entry.pass_name): entry.size for entry in result.comparisons}
    assert {name for (by, name), size in sizes.items() if (by, size) == ("slow", (64, 48))} == set(slow.quick)
    assert {size for (by, name), size in sizes.items() if by == "slow" and name not in slow.quick} == {(32, 24)}
    assert {size for (by, _), size in sizes.items() if by == "numpy-f64"} == {(64, 48)}
    assert len(result.comparisons) == 14 + 15
    assert (slow.rendered, tested.rendered) == ([(64, 48), (32, 24)],) * 2, "each size is drawn once"
    assert [entry.scene.view.columns for entry in rendered] == [64, 32, 64]
    assert "diffuse, direct, shadow.L0" in result.notes[1].message
    assert result.notes[1].message.endswith(" drawn at 32x24 instead of 64x48: slow would take too long")


def test_all_is_drawn_smaller_where_not_even_hits_are_quick() -> None:
    slow = Double(name="slow", limit=768, quick=("depth", "normal"))
    result = validate({"full": doubles.full()}, Double(name="tested"), slow)
    assert {entry.size for entry in result.comparisons} == {(32, 24)}
    assert [note.message for note in result.notes] == ["drawn at 32x24 instead of 64x48: slow would take too long"]


def test_a_scene_beyond_the_analysis_is_compared_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "ANALYSIS_MAX_PIXELS", 768)
    result = validate({"full": doubles.full()}, "native-f64", "numpy-f64")
    assert {entry.size for entry in result.comparisons} == {(32, 24)}
    message = "compared at 32x24 instead of 64x48: finding the edges would take too long"
    assert [note.message for note in result.notes] == [message]


def test_a_renderer_is_not_compared_with_itself() -> None:
    double = Double()
    result = validate({"full": doubles.full()}, [double, "native-f64"], [double, "native-f64"], passes=["beauty"])
    pairs = [(comparison.renderer, comparison.reference) for comparison in result.comparisons]
    assert pairs == [("double", "native-f64"), ("native-f64", "double")]
    assert validate({"full": doubles.full()}, double, double).status == 3, "nothing compared is no success"


def test_no_scene_is_no_success() -> None:
    assert validate({}, "native-f64", "numpy-f64").status == 3


def test_statuses() -> None:
    def black(scene: Any, passes: Any, settings: Settings) -> Passes:
        drawn = doubles.faithful(scene, passes, settings)
        return Passes({name: array * 0 if name == "beauty" else array for name, array in drawn.items()})

    good = validate({"full": doubles.full()}, "native-f64", "numpy-f64")
    assert (good.status, good.ok) == (0, True)
    bad = validate({"full": doubles.full()}, Double(draw=black), "numpy-f64")
    assert (bad.status, bad.ok) == (1, False)
    bad.failures.append(Note("", "somebody", "failed"))
    assert bad.status == 3, "a failure outweighs a difference"


def test_a_pass_that_was_promised_and_is_not_there_is_a_failure() -> None:
    def forgetful(scene: Any, passes: Any, settings: Settings) -> Passes:
        return doubles.faithful(scene, [name for name in passes if name != "normal"], settings)

    result = validate({"full": doubles.full()}, Double(draw=forgetful), "native-f64")
    (failed,) = [comparison for comparison in result.comparisons if not comparison.ok]
    assert failed.pass_name == "normal"
    assert failed.reasons == ("double did not deliver the pass 'normal'",)


def test_a_picture_of_another_size_is_a_failure() -> None:
    def small(scene: Any, passes: Any, settings: Settings) -> Passes:
        return doubles.faithful(resized(scene, (64, 47)), passes, settings)

    result = validate({"full": doubles.full()}, Double(draw=small), "native-f64")
    assert result.status == 1
    assert all("delivered 64x47 pixels, expected 64x48" in comparison.reasons[0] for comparison in result.comparisons)


def test_pass_names_are_checked_first() -> None:
    double = Double()
    with pytest.raises(ValueError, match="did you mean 'depth'"):
        validate({"full": doubles.full()}, double, "native-f64", passes=["dept"])
    with pytest.raises(ValueError, match="not compared"):
        validate({"full": doubles.full()}, double, "native-f64", passes=["margin.*"])
    assert double.rendered == []


def test_a_light_that_a_scene_lacks_is_noted() -> None:
    result = validate({"full": doubles.full()}, "native-f64", "numpy-f64", passes=["shadow.L9"])
    assert result.status == 3
    assert "none of the passes asked for" in result.notes[0].message


def test_versions_of_two_variants_do_not_hide_each_other() -> None:
    class Other(Double):
        def versions(self) -> dict[str, str]:
            return {"double": "2"}

    result = validate({"full": doubles.full()}, Double(), Other(name="other"), passes=["beauty"])
    assert result.versions["double"] == "1"
    assert result.versions["other: double"] == "2"


def test_the_face_of_the_package() -> None:
    assert validation.validate is validate
    assert set(validation.__all__) >= {"Comparison", "Settings", "compare_passes", "validate"}
    for name in validation.__all__:
        assert getattr(validation, name) is not None
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = validation.nothing


def test_wrong_input_at_two_sizes_is_one_failure() -> None:
    def large(*_: Any) -> Passes:
        raise InputError("too large")

    slow = Double(name="slow", limit=768, quick=("id", "depth"), draw=large)
    result = validate({"full": doubles.full()}, slow, "numpy-f64")
    assert slow.rendered == [(64, 48), (32, 24)]
    assert (result.status, result.wrong_input, len(result.failures)) == (2, 1, 1)


def test_wrong_input_is_no_failure_of_a_renderer() -> None:
    def large(*_: Any) -> Passes:
        raise MemoryError

    result = validate({"full": doubles.full()}, Double(draw=large), "numpy-f64")
    assert result.status == 2
    message = "full: error: double: not enough memory for 64x48 pixels\n  hint: a smaller --size, or fewer --passes"
    assert [note.message for note in result.failures] == [message]
    result.failures.append(Note("", "somebody", "failed"))
    assert result.status == 3, "a renderer that failed outweighs it"


def test_the_words_that_name_renderers_mean_these_renderers() -> None:
    """As the command line reads them: a comma after `cmd:` belongs to the command."""
    from validation.options import Names
    from validation.run import renderer_words

    for names in (["a"], ["a", "b", "a"], ["cmd:x {scene},y", "a"], ["cmd:x {scene}", "cmd:y {scene}", "b", "a"], []):
        words = renderer_words(names)
        assert words[::2] == ["--renderer"] * (len(words) // 2)
        read = [name for word in words[1::2] for name in Names().convert(word, None, None)]
        assert sorted(read) == sorted(set(names))
    assert renderer_words(["native-f64", "numpy-f64"]) == ["--renderer", "native-f64,numpy-f64"]
