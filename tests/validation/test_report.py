"""The report: one file that needs no other, with every scene and pass in it, and pictures that say what they claim."""

from __future__ import annotations

import base64
import io
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from doubles import Double, with_arrays
from PIL import Image

from tracer.passes import lookup, quantise
from validation import Comparison, Settings, Validation, validate
from validation.cli import main
from validation.compare import Maps, Worst
from validation.report import pictures
from validation.report.report import Report, bound, cell, headline, ours, share, shared_folder, short
from validation.run import Note

VOID = {"meta", "link", "img", "br", "path", "use", "wbr"}


class Page(HTMLParser):
    """The tags of a page with their attributes, and its text; checks that tags are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == [], "every tag is closed"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        """All text, white space folded."""
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        """The attributes of every such tag."""
        return [attributes for name, attributes in self.tags if name == tag]


def dented(arrays: doubles.Arrays) -> None:
    """Wrong in one pixel of two passes."""
    arrays["beauty"][20, 30] = (0.9, 0.1, 2.5)
    arrays["depth"][3, 3] = 1.0


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Validation, str, Path]:
    """A validation of three scenes with two renderers, one with a defect, and its page."""
    page = Report()
    scenes = {"scenes/full.txt": doubles.full(), "scenes/<cave> & co.txt": doubles.cave(), "cut.txt": doubles.cut()}
    found = validate(scenes, ["native-f32", Double(draw=with_arrays(dented))], "numpy-f64", on_rendered=page.add)
    found.command = ["whitted", "validate", "my scenes", "--against", "numpy-f64"]
    found.notes.append(Note("scenes/full.txt", "somebody", "drawn smaller"))
    found.failures.append(Note("cut.txt", "somebody", "failed: <b>boom</b>"))
    path = page.write(tmp_path_factory.mktemp("report"), found)
    return found, path.read_text(encoding="utf-8"), path


def test_the_page_needs_nothing_else(result: tuple[Validation, str, Path]) -> None:
    _, text, path = result
    page = Page(text)
    for tag, attributes in page.tags:
        for name in ("src", "href", "srcset", "data", "action", "poster"):
            value = attributes.get(name)
            assert value is None or value.startswith(("#", "data:")), f"{tag} {name} leads elsewhere"
    style = re.sub(r"data:[^)\"']*", "", text)
    assert "@import" not in style
    assert not re.search(r"url\(", style)
    assert not re.search(r"https?://", style)
    assert [entry.name for entry in path.parent.iterdir()] == ["index.html"]


def test_links_within_the_page_lead_somewhere(result: tuple[Validation, str, Path]) -> None:
    page = Page(result[1])
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for tag in ("a", "use"):
        for attributes in page.all(tag):
            assert (attributes["href"] or "")[1:] in ids
    for attributes in page.all("img"):
        if "data-same" in attributes:
            assert attributes["data-same"] in ids


def test_every_scene_and_pass_is_there(result: tuple[Validation, str, Path]) -> None:
    found, text, _ = result
    page = Page(text)
    for comparison in found.comparisons:
        assert comparison.scene in page.text
        assert comparison.renderer in page.text
    assert len([attributes for attributes in page.all("details") if attributes.get("class") == "pass"]) == len(
        found.comparisons
    )
    assert "<cave>" not in text, "names of files are text, not markup"
    assert "<b>boom" not in text
    assert "failed: <b>boom</b>" in page.text
    assert "drawn smaller" in page.text


def test_what_differs_comes_first_and_in_words(result: tuple[Validation, str, Path]) -> None:
    found, text, _ = result
    page = Page(text)
    failed = [comparison for comparison in found.comparisons if not comparison.ok]
    assert {comparison.pass_name for comparison in failed} == {"beauty", "depth"}
    assert f"{len(failed)} of {len(found.comparisons)} comparisons differ" in page.text
    scenes = re.findall(r'<section class="scene".*?</section>', text, re.S)
    verdicts = ["chip bad" in re.search(r"<h2>.*?</h2>", scene, re.S).group() for scene in scenes]  # type: ignore[union-attr]
    assert verdicts == sorted(verdicts, reverse=True)
    assert verdicts.count(True) == 3
    for scene in scenes:
        order = ["differs" in summary for summary in re.findall(r"<summary><span.*?</summary>", scene, re.S)]
        assert order == sorted(order, reverse=True)
    for comparison in failed:
        for reason in comparison.reasons:
            assert reason in page.text


def test_the_page_says_how_to_repeat_it_and_with_what(result: tuple[Validation, str, Path]) -> None:
    found, text, _ = result
    page = Page(text)
    assert "whitted validate 'my scenes' --against numpy-f64" in page.text
    for name, value in found.versions.items():
        assert f"{name} {value}" in page.text


def test_numbers_and_worst_pixels_are_there(result: tuple[Validation, str, Path]) -> None:
    found, text, _ = result
    page = Page(text)
    dent = next(c for c in found.comparisons if c.pass_name == "beauty" and not c.ok and c.scene == "scenes/full.txt")
    assert dent.worst is not None
    assert (dent.worst.x, dent.worst.y, dent.worst.a) == (30, 20, 2.5)
    assert "Worst pixel (ring): x 30, y 20, B" in page.text
    assert repr(dent.worst.b) in page.text
    marks = [attributes["style"] for attributes in page.all("span") if attributes.get("class") == "mark"]
    assert f"left:{30.5 / 64 * 100:.3f}%;top:{20.5 / 48 * 100:.3f}%" in marks
    assert "PSNR" in page.text
    assert "CIEDE2000" in page.text


def test_pictures_decode_and_have_words(result: tuple[Validation, str, Path]) -> None:
    images = Page(result[1]).all("img")
    stored = {}
    for attributes in images:
        assert "alt" in attributes
        source = attributes.get("src")
        if source:
            assert source.startswith("data:image/png;base64,")
            image = Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2])))
            image.load()
            stored[source] = image.size
            if attributes.get("class") != "thumb":
                assert image.size == (int(attributes["width"] or 0), int(attributes["height"] or 0))
    assert set(stored.values()) == {(64, 48), (48, 48), (32, 32)}
    long = [source for source in (attributes.get("src") for attributes in images) if source and len(source) > 1000]
    assert len(long) == len(set(long)), "a picture is stored once"


def decode(picture: pictures.Picture) -> np.ndarray:
    """The colours and the opacity of a picture."""
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.uri.partition(",")[2]))).convert("RGBA"))


HIT = np.array([[True, True, False]])


def shown(name: str, values: Any) -> tuple[np.ndarray, str]:
    array = np.array([values], dtype=np.float64)
    first, second = pictures.pair(lookup(name), array, array, (HIT, HIT))
    assert first == second
    return decode(first)[0], first.how


def test_beauty_is_shown_as_the_image_file_has_it() -> None:
    values = [(0.1, 0.5, 1.0), (2.0, -1.0, 0.999), (0.3, 0.3, 0.3)]
    pixels, how = shown("beauty", values)
    assert (pixels[:, :3] == quantise(np.array(values))).all()
    assert "-1 to 2" in how
    assert "clipped" in how


def test_a_dark_pass_is_shown_brighter_and_says_so() -> None:
    pixels, how = shown("reflection.2", [(0.05, 0.0, 0.0), (0.025, 0, 0), (0, 0, 0)])
    assert "16 times brighter" in how  # 0.05 * 16 = 0.8, the next power of two would pass 1
    assert pixels[0, 0] == int(0.8 * 255)


def test_depth_and_position_state_their_range() -> None:
    pixels, how = shown("depth", [2.0, 10.0, np.inf])
    assert "bright: 2, dark: 10" in how
    assert pixels[0, 0] > pixels[1, 0] > 0
    assert pixels[:, 3].tolist() == [255, 255, 0]
    _, how = shown("position", [(-1.0, 2.0, -3.0), (1.0, 2.0, -9.0), (0, 0, 0)])
    assert "red: x from -1 to 1, green: y from 2 to 2, blue: z from -9 to -3" in how


def test_normals_ids_and_shadows() -> None:
    pixels, _ = shown("normal", [(1, 0, 0), (0, -1, 0), (0, 0, 0)])
    assert pixels[:, :3].tolist() == [[255, 127, 127], [127, 0, 127], [0, 0, 0]]
    assert pixels[2, 3] == 0
    pixels, _ = shown("id", [0, 1, -1])
    assert pixels[0].tolist() != pixels[1].tolist()
    assert pixels[:, 3].tolist() == [255, 255, 0]
    pixels, _ = shown("shadow.L0", [1, 0, 0])
    assert pixels[:, 0].tolist() == [255, 0, 0]


@pytest.mark.parametrize("name", ["beauty", "position", "normal"])
def test_what_is_no_number_is_magenta(name: str) -> None:
    pixels, _ = shown(name, [(0.1, np.nan, 0.2), (0.5, 0.5, np.inf), (0, 0, 0)])
    assert pixels[0, :3].tolist() == [255, 0, 255]
    assert pixels[1, :3].tolist() == [255, 0, 255]


def test_nothing_hit_has_a_picture_too() -> None:
    nothing = np.zeros((1, 3), bool)
    for name in ("depth", "position", "normal"):
        array = np.full((1, 3), np.inf) if name == "depth" else np.zeros((1, 3, 3))
        first, _ = pictures.pair(lookup(name), array, array, (nothing, nothing))
        assert decode(first)[0, :, 3].tolist() == [0, 0, 0]


def test_the_heatmap_is_logarithmic() -> None:
    errors = np.array([[0.0, 1e-8, 1e-7, 1e-6, 2e-6, 1e-5, 1e-3]])
    compared = np.ones(errors.shape, bool)
    compared[0, 6] = False
    found = pictures.heatmap(errors, compared, ~compared)
    assert found is not None
    assert [text for _, text in found.ticks] == ["1e-8", "1e-7", "1e-6", "1e-5"]
    assert [share for share, _ in found.ticks] == pytest.approx([0, 1 / 3, 2 / 3, 1])
    pixels = decode(found.picture)[0]
    bar = [tuple(int(color[i : i + 2], 16) for i in (1, 3, 5)) for color in found.colors]
    assert len(bar) == 9
    assert pixels[0, :3].tolist() == [0, 0, 0], "no error is black"
    for pixel, step in ((1, 0), (2, 3), (3, 6), (5, 8)):
        assert tuple(pixels[pixel, :3].tolist()) == bar[step]
    assert pixels[6, 3] == 0, "what is not compared is see-through"
    light = [0.2126 * red + 0.7152 * green + 0.0722 * blue for red, green, blue in bar]
    assert light == sorted(light), "larger errors are brighter"


def test_the_heatmap_of_infinite_and_of_tiny_errors() -> None:
    every = np.ones((1, 2), bool)
    assert pictures.heatmap(np.zeros((1, 2)), every, ~every) is None
    for errors in ([np.inf, 0.0], [np.inf, 1e-3], [5e-324, 0.0], [1e-3, 1e-3], [1e300, 1e-300], [1.0, 1.0]):
        for edge in (every, ~every):
            found = pictures.heatmap(np.array([errors]), every, edge)
            assert found is not None
            assert decode(found.picture)[0, 0, :3].any()
            assert len(found.ticks) >= 2


def test_the_heatmap_has_the_scale_of_the_interior() -> None:
    every = np.ones((1, 3), bool)
    found = pictures.heatmap(np.array([[0.7, 3e-9, 2e-8]]), every, np.array([[True, False, False]]))
    assert found is not None
    assert [text for _, text in found.ticks] == ["1e-9", "1e-8", "1e-7+"]
    pixels = decode(found.picture)[0]
    assert "#{:02x}{:02x}{:02x}".format(*pixels[0, :3]) == found.colors[-1]
    wide = pictures.heatmap(np.array([[1.0, 1e-3, 1e-9]]), every, ~every)
    assert wide is not None
    assert [text for _, text in wide.ticks] == ["<1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "1e-1", "1e0"]


def test_the_outline_goes_round_edge_pixels() -> None:
    edge = np.array([[0, 1, 1], [0, 1, 1], [1, 0, 0]], bool)
    path = pictures.outline(edge)
    drawn = re.findall(r"M(\d+) (\d+)([hv])(\d+)", path)
    assert "".join("M{} {}{}{}".format(*part) for part in drawn) == path
    # Above, between and below the square of four and the single pixel; then the uprights.
    assert " ".join("".join(part) for part in drawn) == "10h2 02h3 03h1 02v1 10v3 30v2"
    assert pictures.outline(np.zeros((2, 2), bool)) == ""


def test_a_scene_of_two_sizes_has_a_row_for_each(tmp_path: Path) -> None:
    page = Report()
    slow = Double(name="slow", limit=768, quick=("id", "depth"))
    found = validate({"full": doubles.full(), "cut": doubles.cut()}, "native-f64", slow, on_rendered=page.add)
    text = page.write(tmp_path, found).read_text(encoding="utf-8")
    for expected in ("full 64×48</span>", "full 32×24</span>", "cut 48×48</span>", "cut 27×27</span>"):
        assert text.count(expected) == 1


def test_a_comparison_without_pictures_is_shown_in_words(tmp_path: Path) -> None:
    page = Report()
    found = validate(
        {"full": doubles.full()}, Double(missing=("depth",)), "numpy-f64", passes=["depth"], on_rendered=page.add
    )
    text = Page(page.write(tmp_path, found).read_text()).text
    assert "double did not deliver the pass &#39;depth&#39;" not in text
    assert "double did not deliver the pass 'depth'" in text
    assert "1 of 1 comparison differs" in text


def test_a_report_of_nothing(tmp_path: Path) -> None:
    found = validate({"full": doubles.full()}, Double(refuses=True), "numpy-f64")
    text = Page(Report().write(tmp_path, found).read_text()).text
    assert "Nothing was compared" in text
    assert "cannot carry this scene" in text
    assert "Each cell" not in text, "there is no table to explain"


def test_the_headline_says_all_that_happened() -> None:
    def of(agree: int, differ: int, failures: int) -> str:
        found = [Comparison("s", (1, 1), "a", "b", "id")] * agree
        found += [Comparison("s", (1, 1), "a", "b", "id", reasons=("off",))] * differ
        return headline(Validation(Settings(), found, failures=[Note("s", "a", "failed")] * failures))

    assert of(8, 0, 0) == "All 8 comparisons agree"
    assert of(1, 0, 0) == "The only comparison agrees"
    assert of(7, 1, 0) == "1 of 8 comparisons differ"
    assert of(7, 1, 1) == "1 of 8 comparisons differ, and there was 1 failure"
    assert of(8, 0, 2) == "All 8 comparisons agree, but there were 2 failures"
    assert of(0, 0, 1) == "Nothing was compared"


def test_numbers_read_well() -> None:
    assert [short(value) for value in (None, 0.0, 5.2e12, 1.3e-7, 0.0123, math.inf)] == [
        *("–", "0", "5.2e12", "1.3e-7", "0.012", "∞"),
    ]
    # Narrow, and on the side of 1 where the value is.
    ratios = (None, 0.0, 1e-9, 0.0501, 0.994, 0.9951, 1.0, 1.0001, 1.5, 999.4, 5e12, math.inf)
    shown = ("–", "0", "<.01", ".05", ".99", "<1", "1", ">1", "1.5", "999", "5e12", "∞")
    assert [cell(ratio) for ratio in ratios] == [*shown]
    assert [share(ratio) for ratio in (0.0, 1e-9, 0.0072, 1.0)] == ["0 %", "less than 0.1 %", "0.72 %", "100 %"]
    assert bound(0.5) == "0.5"
    assert bound(math.inf) == bound(math.nan) == "none: the values have no bound"


def test_the_folder_that_all_scenes_share() -> None:
    assert shared_folder(["scenes/a/x.txt", "scenes/b/x.txt", "scenes/c.txt"]) == "scenes/"
    assert shared_folder(["scenes/a/x.txt"]) == "scenes/a/"
    assert shared_folder(["scenes/a.txt", "scenesx/a.txt"]) == shared_folder(["a", "a/b"]) == ""
    assert shared_folder(["/tmp/a.txt", "/tmp/b.txt"]) == "/tmp/"


def test_what_somebody_else_made_is_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.txt").write_text(doubles.full().text())
    command = ["validate", "scene.txt", "--against", "numpy-f64", "--passes", "id", "--report", "page"]
    for _ in range(2):  # a page of our own gives way to the next
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert ended.value.code == 0
    page = Path("page/index.html")
    assert ours(page)
    assert ours(Path("page/none.html"))
    page.write_text("<!doctype html><title>my thesis</title>")
    capfd.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 2
    assert capfd.readouterr() == (
        "",
        f"error: {page} is no report of whitted\n  hint: name another folder, or remove that file\n",
    )
    assert "my thesis" in page.read_text()


def test_an_edge_pixel_that_differs_most_is_called_one(tmp_path: Path) -> None:
    page = Report()
    found = validate({"hall": doubles.full()}, "native-f64", "numpy-f64", passes=["beauty"])
    rendered: list[Any] = []
    validate({"hall": doubles.full()}, "native-f64", "numpy-f64", passes=["beauty"], on_rendered=rendered.append)
    (drawn,) = rendered
    (comparison,) = drawn.comparisons
    edge, tolerance = np.zeros((48, 64), bool), np.full((48, 64), 0.25)
    edge[7, 9], tolerance[7, 9] = True, np.inf
    error = np.zeros((48, 64))
    error[7, 9] = 0.5
    maps = Maps(error, tolerance, ~np.zeros((48, 64), bool), edge)
    worst = Worst(9, 7, "R", 0.75, 0.25)
    comparison = replace(comparison, maps=maps, worst=worst, max=0.5, edge=1, edge_over=1)
    page.add(replace(drawn, comparisons=[comparison]))
    text = Page(page.write(tmp_path, found).read_text()).text
    assert "Worst pixel (ring, on an edge): x 9, y 7, R" in text
    assert "tolerance there none: the values have no bound" in text
    assert "largest error 0.5, on an edge" in text
    assert "1, 1 over tolerance" in text


def test_a_large_report_stays_small(tmp_path: Path) -> None:
    # 25 scenes of 12 passes at 400 x 400 are to stay under 40 MB: that is 133 kB a pass. Errors of float32 are the
    # noisiest pictures that there are.
    page = Report()
    scene = doubles.full()
    scene = scene.replace(view=scene.view.replace(columns=400, rows=400))
    found = validate({"full": scene}, "native-f32", "numpy-f64", on_rendered=page.add)
    assert page.write(tmp_path, found).stat().st_size < len(found.comparisons) * 40e6 / (25 * 12)
    assert math.isfinite(found.comparisons[0].max or 0)
