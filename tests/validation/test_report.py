"""The report: one file that needs no other, with every scene and pass in it, and pictures that say what they claim."""

from __future__ import annotations

import base64
import io
import math
import re
import shlex
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
from validation.parting import Decision
from validation.report import pictures
from validation.report.report import LINES, Report, bound, cell, headline, ours, share, shared_folder, short
from validation.report.verdicts import ROWS, SHAPES, Row, mark, view
from validation.run import Note, Rendered
from validation.truth import Prover
from validation.verdict import Finding, Verdict, Verdicts

VOID = {"meta", "link", "img", "br", "path", "use", "wbr", "col", "input"}


class Page(HTMLParser):
    """The tags of a page with their attributes, and the text of the part that needs no script.

    Checks that tags are closed in order.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.plain = 'id="report"' not in text
        self.feed(text)
        self.close()
        assert self.open == [], "every tag is closed"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.plain |= dict(attrs).get("id") == "report"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.plain and "script" not in self.open:
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
            href = attributes["href"] or ""
            assert href[1:] in ids or href.startswith("#/scene="), "an anchor, or an address of the viewer"
    for attributes in page.all("img"):
        if "data-same" in attributes:
            assert attributes["data-same"] in ids


def test_every_scene_and_pass_is_there(result: tuple[Validation, str, Path]) -> None:
    found, text, _ = result
    page = Page(text)
    for comparison in found.comparisons:
        assert comparison.scene in page.text
        assert comparison.renderer in page.text
    anchors = [attributes["id"] for tag in ("details", "tr") for attributes in page.all(tag) if "id" in attributes]
    passes = [anchor for anchor in anchors if not anchor.endswith("-why")]
    assert len(set(passes)) == len(passes) == len(found.comparisons)
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
        order = [
            "differs" in summary
            for summary in re.findall(r"<summary><span(?! class=.name.>verdicts).*?</summary>", scene)
        ]
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
    assert "Worst interior pixel (ring): x 30, y 20, B" in page.text
    assert re.search(r"worst interior pixel x 30, y 20: [0-9.e]+ times its tolerance", page.text)
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
    # But for readers without a script, under the marks of verdicts.
    once = [attributes for attributes in images if attributes.get("class") != "again"]
    long = [source for source in (attributes.get("src") for attributes in once) if source and len(source) > 1000]
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


#: Names that are no markup, whatever they look like.
SCENE, RENDERER = 'a <b> & "c".txt', '<i>new</i> & "co"'


def finding(renderer: str, cause: str, says: str = "misses 'ball' at t = 2", *, off: str = "beauty") -> Finding:
    """One that is off in a pass."""
    decision = Decision("silhouette", says, re.sub(" at t = .*", "", says))
    return Finding(renderer, {off: 0.5}, decision, cause, f"because <of> {cause}")


def judged_by_hand(*, excused: bool = False, differ: int = 40) -> tuple[Rendered, Validation]:
    """One scene with verdicts of every kind, 20 of one rule; `excused`: without those that nothing explains."""
    name, reference, scene = RENDERER, "native-f64", doubles.full()
    kept: list[Rendered] = []
    double = Double(name=name, draw=with_arrays(dented))
    found = validate({SCENE: scene}, double, reference, verdicts=0, on_rendered=kept.append)
    prover, fine, beauty = Prover(scene), Finding(name), ("beauty", "diffuse", "direct", "specular", "reflection")

    def verdict(
        x: int, y: int, a: Finding, b: Finding, passes: tuple[str, ...] = beauty, *, edge: bool = True
    ) -> Verdict:
        return Verdict(x, y, passes, prover.pixel(x, y), a, b, edge)

    says = "hits '<b>ball</b>' at t = 3"
    every = [
        verdict(30, 20, finding(name, "unexplained"), fine, edge=False),
        verdict(31, 40, finding(name, "mistake", says), fine, ("id",)),
    ]
    every = [] if excused else every
    every += [
        verdict(x, 46, finding(name, "rule", f"misses 'floor' at t = {x}"), fine, ("shadow.L0",)) for x in range(20)
    ]
    every += [
        verdict(9, 40, fine, finding(reference, "rounding"), ("depth",)),
        verdict(8, 40, finding(name, "tie"), finding(reference, "rounding", "misses 'egg'")),
        verdict(7, 40, fine, fine, ("normal", "depth")),
    ]
    verdicts = Verdicts(SCENE, name, reference, differ, every)
    found.verdicts[:] = [verdicts]
    return replace(kept[0], verdicts=verdicts), found


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rendered, str]:
    """The scene with verdicts and the page of it."""
    rendered, found = judged_by_hand()
    page = Report()
    page.add(rendered)
    return rendered, page.write(tmp_path_factory.mktemp("judged"), found).read_text(encoding="utf-8")


def text_of(markup: str) -> str:
    """Of a piece of a page."""
    return Page(markup).text


def table_rows(text: str, table: str, row: str) -> list[str]:
    """The pieces `row` of every such table, in order."""
    tables = re.findall(rf'<table class="{table}">.*?</table>', text, re.S)
    return [
        piece for found in tables for piece in re.findall(rf"<{row}[ >].*?</{row}>", found.split("</thead>")[1], re.S)
    ]


def test_why_pixels_differ_comes_first(judged: tuple[Rendered, str]) -> None:
    text = judged[1]
    assert text.index("Why they differ") < text.index("What differs") < text.index("<h2>Summary")
    assert "at least 1 pixel is unexplained and 1 wrong" in re.search(r"<h1>.*?</h1>", text, re.S).group()  # type: ignore[union-attr]
    rows = table_rows(text, "why", "tr")
    assert ["alarm" in row for row in rows] == [True, True] + [False] * 5
    lines = [text_of(row) for row in rows]
    where = f"{SCENE} {RENDERER}, native-f64"
    assert (
        lines[0]
        == f"✗ unexplained 1 pixel {where} {RENDERER} misses 'ball' at t = 2 ( 30 20 ) because <of> unexplained"
    )
    assert lines[1].startswith(f"✗ wrong 1 pixel {where} {RENDERER} hits '<b>ball</b>' at t = 3 ( 31 40 )")
    assert lines[2].startswith(f"✓ documented rule 20 pixels {where} {RENDERER} misses 'floor' (e.g. 0 46 )")
    assert sorted(line.split(" 1 ")[0] for line in lines[3:]) == [
        "✓ rounding",
        "✓ rounding",
        "✓ tie",
        "✓ within both claims",
    ]
    assert "40 pixels of 1 scene are over tolerance. 25 of them, a random sample" in Page(text).text
    assert "1 pixel, at which both are off, is in two rows." in Page(text).text


def test_many_reasons_are_folded_up(tmp_path: Path) -> None:
    rendered, found = judged_by_hand()
    assert rendered.verdicts is not None
    first = rendered.verdicts.verdicts[0]
    for k in range(LINES):
        other = replace(first, renderer=finding(RENDERER, "unexplained", f"misses 'ball' {k} times"))
        rendered.verdicts.verdicts.append(other)
    page = Report()
    page.add(rendered)
    text = page.write(tmp_path, found).read_text(encoding="utf-8")
    shown, folded = re.findall(r'<table class="why">.*?</table>', text, re.S)
    assert shown.count("<tr") == LINES + 1  # and the heading
    assert folded.count("<tr") == 7 + 1
    assert "7 more, 2 of them unexplained or wrong" in Page(text).text


def test_a_pixel_has_its_values_and_errors(judged: tuple[Rendered, str]) -> None:
    rendered, text = judged
    assert rendered.verdicts is not None
    rows = table_rows(text, "verdicts", "tbody")
    dent, _, shadow, *_ = (text_of(row) for row in rows)
    exact, drawn = rendered.verdicts.verdicts[0].truth.values["beauty"][2], rendered.reference["beauty"][20, 30, 2]
    error = exact.error(float(drawn))
    assert error < 1e-15
    far, near = f"off by {2.5 - exact.value:.2g}", f"error {error:.2g}" if error else "exact"
    values = f"{exact.value!r} 2.5 {far} {float(drawn)!r} {near}"
    command = f"whitted explain '{SCENE}' 30 20 --renderer '{RENDERER},native-f64' --size 64x48"
    assert dent == (
        f"30, 20 interior beauty B also diffuse, direct, specular, reflection {values} "
        f"✗ unexplained {RENDERER} misses 'ball' at t = 2 because <of> unexplained {command} in the viewer"
    )
    assert "shadow.L0" in shadow


def test_the_table_begins_with_one_of_each_kind(judged: tuple[Rendered, str]) -> None:
    rendered, text = judged
    assert rendered.verdicts is not None
    rows = table_rows(text, "verdicts", "tbody")
    places = [tuple(map(int, re.findall(r">(\d+), (\d+)</a>", row)[0])) for row in rows]
    assert sorted(places) == sorted((verdict.x, verdict.y) for verdict in rendered.verdicts.verdicts)
    assert places[:3] == [(30, 20), (31, 40), (0, 46)]
    assert set(places[3:6]) == {(9, 40), (8, 40), (7, 40)}
    assert places[6:] == [(x, 46) for x in range(1, 20)]
    assert ["alarm" in row for row in rows] == [True, True] + [False] * 23
    shown, folded = re.findall(r'<table class="verdicts">.*?</table>', text, re.S)
    assert (shown.count("<tbody"), folded.count("<tbody")) == (ROWS, 25 - ROWS)
    assert f"{25 - ROWS} more pixels" in Page(text).text
    both = next(text_of(row) for row in rows if ">8, 40<" in row)
    assert f"✓ tie {RENDERER} misses 'ball' at t = 2 because <of> tie ✓ rounding native-f64 misses 'egg'" in both
    neither = next(text_of(row) for row in rows if ">7, 40<" in row)
    assert "✓ within both claims neither is off by more than it claims" in neither


def test_the_map_marks_every_pixel(judged: tuple[Rendered, str]) -> None:
    rendered, text = judged
    assert rendered.verdicts is not None
    (drawn,) = re.findall(r'<svg class="map" viewBox="0 0 (\S+) (\S+)".*?>(.*?)</svg>', text, re.S)
    unit = 64 / float(drawn[0])
    assert 48 / float(drawn[1]) == pytest.approx(unit, rel=1e-3)
    marks = re.findall(r'<a href="#(s0-x(\d+)-y(\d+))" .*?<use href="#mark-(\w+)" x="(\S+)" y="(\S+)"', drawn[2])
    assert len(marks) == 25
    for anchor, x, y, _, across, down in marks:
        assert f'<tbody id="{anchor}"' in text
        assert float(across) * unit == pytest.approx(int(x) + 0.5, abs=0.01)
        assert float(down) * unit == pytest.approx(int(y) + 0.5, abs=0.01)
    kinds = {(int(x), int(y)): kind for _, x, y, kind, *_ in marks}
    assert kinds[30, 20] == kinds[31, 40] == "cross"
    assert (kinds[0, 46], kinds[9, 40], kinds[8, 40], kinds[7, 40]) == ("square", "circle", "both", "dot")
    legend = text_of(re.search(r'<ul class="key">.*?</ul>', text, re.S).group())  # type: ignore[union-attr]
    assert legend == (
        f"unexplained or wrong: 2 pixels {RENDERER} is off: 20 pixels native-f64 is off: 1 pixel "
        "both are off: 1 pixel neither is off by more than it claims: 1 pixel"
    )
    assert set(re.findall(r'<g id="mark-(\w+)"', text)) == set(SHAPES)


def test_names_in_verdicts_are_text(judged: tuple[Rendered, str]) -> None:
    text = judged[1]
    for markup in ("<b>ball", "<i>new", "a <b>", "<of>"):
        assert markup not in text


def test_a_sample_is_called_one(judged: tuple[Rendered, str], tmp_path: Path) -> None:
    assert "40 pixels differ; 25 of them, chosen at random, were judged" in Page(judged[1]).text
    rendered, found = judged_by_hand(excused=True, differ=23)
    page = Report()
    page.add(rendered)
    text = Page(page.write(tmp_path, found).read_text(encoding="utf-8")).text
    assert "random" not in text
    assert "23 pixels of 1 scene are over tolerance, on edges only" in text
    assert "unexplained" not in text.replace("and unexplained (✗)", "")


def test_the_worst_pixel_has_its_verdict(judged: tuple[Rendered, str]) -> None:
    worst = re.findall(r'<table class="plain worst">.*?</table>', judged[1], re.S)
    told = [text_of(table) for table in worst if ">verdict</a>" in table]
    assert len(told) == 1, "of the pass that differs there alone"
    assert "x 30, y 20, B" in told[0]
    assert told[0].endswith(f"verdict ✗ unexplained {RENDERER} misses 'ball' at t = 2")


def test_a_scene_that_agrees_may_be_unexplained(tmp_path: Path) -> None:
    rendered, found = judged_by_hand()
    rendered = replace(rendered, comparisons=[c for c in rendered.comparisons if c.ok])
    found.comparisons = [replace(c, maps=None) for c in rendered.comparisons]
    other = replace(rendered, label="fine.txt", verdicts=None)
    page = Report()
    page.add(other)
    page.add(rendered)
    text = page.write(tmp_path, found).read_text(encoding="utf-8")
    assert found.status == 1
    assert f"All {len(found.comparisons)} comparisons agree, but at least 1 pixel is unexplained and 1 wrong" in text
    names = [text_of(name) for name in re.findall(r'<section class="scene".*?(<h2>.*?</h2>)', text, re.S)]
    assert names == [f"{SCENE} agrees ✗ 1 pixel unexplained ✗ 1 pixel wrong", "fine.txt agrees"]
    (row, _) = re.findall(r'<tr>(<th scope="row"><a.*?</th>)', text, re.S)
    assert text_of(row) == f"{SCENE} ✗ 1 unexplained ✗ 1 wrong"


def test_without_verdicts_there_is_nothing_of_them(tmp_path: Path) -> None:
    page = Report()
    found = validate({"full": doubles.full()}, "native-f64", "numpy-f64", on_rendered=page.add)
    text = page.write(tmp_path, found).read_text(encoding="utf-8")
    assert "Why they differ" not in text
    assert "mark-cross" not in text
    assert 'class="verdicts"' not in text
    assert 'class="judgement"' not in text


def shown_row(rendered: Rendered, name: str, arrays: doubles.Arrays) -> Row:
    """The row of pixel 30 20 of a renderer that drew `arrays`."""
    assert rendered.verdicts is not None
    verdict = replace(
        rendered.verdicts.verdicts[0], passes=(name,), renderer=finding(RENDERER, "unexplained", off=name)
    )
    verdicts = replace(rendered.verdicts, verdicts=[verdict])
    drawn = doubles.with_arrays(lambda every: every.update(arrays))
    passes = drawn(rendered.scene, list(rendered.renderer), rendered.settings)
    found = view(replace(rendered, renderer=passes, verdicts=verdicts), "s0", 6)
    assert found is not None
    return found.rows[0]


def test_values_read_well(judged: tuple[Rendered, str]) -> None:
    rendered = judged[0]

    def row(name: str, value: float) -> Row:
        array = rendered.reference[name].copy()
        array[20, 30] = value
        return shown_row(rendered, name, {name: array})

    def told(name: str, value: float) -> tuple[str, str]:
        side = row(name, value).sides[0]
        return side.text, side.error

    assert told("id", 1) == ("1, 'egg'", "wrong")
    assert told("id", -1) == ("-1, nothing", "wrong")
    assert told("id", 7) == ("7", "wrong")
    assert told("shadow.L0", 1 - rendered.reference["shadow.L0"][20, 30])[1] == "wrong"
    assert {told("shadow.L0", value)[0] for value in (0, 1)} == {"0, hidden", "1, visible"}
    assert told("depth", math.inf) == ("∞", "off")
    assert told("beauty", math.nan) == ("not a number", "off")
    assert row("depth", 5.0).channel == ""
    assert row("position", 5.0).channel in "XYZ"


def test_the_command_draws_the_same(judged: tuple[Rendered, str], tmp_path: Path) -> None:
    rendered = judged[0]
    file = tmp_path / "a scene.txt"
    file.write_text(rendered.scene.text())

    def words(**changes: Any) -> list[str]:
        found = view(replace(rendered, **changes), "s0", 1)
        assert found is not None
        return shlex.split(found.rows[0].command)

    start = ["whitted", "explain"]
    end = ["30", "20", "--renderer", f"{RENDERER},native-f64"]
    assert words(label=str(file)) == [*start, str(file), *end]
    assert words(label="<stdin>") == [*start, "-", *end, "--size", "64x48"]
    settings = Settings(sample="center", shadow_epsilon=1e-3, max_reflections=5, threads=2)
    options = ["--sample", "center", "--shadow-epsilon", "0.001", "--max-reflections", "5"]
    assert words(label=str(file), settings=settings) == [*start, str(file), *end, *options]
    many = rendered.scene.replace(lights=rendered.scene.lights * 3, limits=False)
    file.write_text(many.text())
    assert words(label=str(file), scene=many) == [*start, str(file), *end, "--no-limits"]
    file.write_text("no scene")
    assert words(label=str(file)) == [*start, str(file), *end, "--size", "64x48"]


def test_who_is_off_has_a_shape() -> None:
    fine, truth = Finding("a"), Prover(doubles.full()).pixel(0, 0)

    def of(a: Finding, b: Finding) -> str:
        return mark(Verdict(0, 0, ("id",), truth, a, b, edge=True))

    off, lost = finding("a", "rounding"), finding("b", "mistake")
    assert [of(off, fine), of(fine, off), of(off, off), of(fine, fine)] == ["square", "circle", "both", "dot"]
    assert [of(lost, fine), of(off, lost), of(lost, lost)] == ["cross"] * 3


def test_verdicts_take_little_of_the_page(judged: tuple[Rendered, str]) -> None:
    text = judged[1]
    for row in table_rows(text, "verdicts", "tbody"):
        assert len(row) < 2000
    (drawn,) = re.findall(r'<svg class="map".*?</svg>', text, re.S)
    assert len(drawn) < 25 * 200


def test_a_report_of_nothing(tmp_path: Path) -> None:
    found = validate({"full": doubles.full()}, Double(refuses=True), "numpy-f64")
    text = Page(Report().write(tmp_path, found).read_text()).text
    assert "Nothing was compared" in text
    assert "cannot carry this scene" in text
    assert "Each cell" not in text, "there is no table to explain"


def test_the_headline_says_all_that_happened() -> None:
    truth = Prover(doubles.full()).pixel(0, 0)

    def of(agree: int, differ: int, failures: int, *causes: str, sampled: bool = False) -> str:
        found = [Comparison("s", (1, 1), "a", "b", "id")] * agree
        found += [Comparison("s", (1, 1), "a", "b", "id", reasons=("off",))] * differ
        pixels = [Verdict(0, 0, ("id",), truth, finding("a", cause), Finding("b"), edge=True) for cause in causes]
        verdicts = [Verdicts("s", "a", "b", len(pixels) + sampled, pixels)]
        return headline(
            Validation(
                settings=Settings(),
                comparisons=found,
                failures=[Note(f"s{k}", "a", "failed") for k in range(failures)],
                verdicts=verdicts,
            )
        )

    assert of(8, 0, 0) == "All 8 comparisons agree"
    assert of(1, 0, 0) == "The only comparison agrees"
    assert of(7, 1, 0) == "1 of 8 comparisons differ"
    assert of(7, 1, 1) == "a failed on s0. 1 of 8 comparisons differ"
    assert of(8, 0, 2) == "a failed on 2 scenes. All 8 comparisons agree"
    assert of(0, 0, 1) == "a failed on s0. Nothing was compared"
    assert of(0, 0, 0) == "Nothing was compared"
    assert of(8, 0, 0, "rounding", "rule", "tie", sampled=True) == (
        "All 8 comparisons agree within tolerance; 4 edge pixels differ, the 3 judged are explained"
    )
    both_true = "agrees within tolerance; 1 edge pixel differs and is explained"
    assert of(1, 0, 0, "tie") == f"The only comparison {both_true}"
    assert of(1, 0, 1, "tie") == f"a failed on s0. The only comparison {both_true}"
    assert of(8, 0, 0, sampled=True) == "All 8 comparisons agree within tolerance; 1 edge pixel differs"
    assert of(8, 0, 0, "unexplained") == "All 8 comparisons agree, but 1 pixel is unexplained"
    assert of(8, 0, 0, "mistake", "mistake") == "All 8 comparisons agree, but 2 pixels are wrong"
    both = "unexplained", "unexplained", "mistake"
    assert of(7, 1, 0, *both) == "1 of 8 comparisons differ, and 2 pixels are unexplained and 1 wrong"
    many = "a failed on s0. 1 of 8 comparisons differ, and at least 2 pixels are unexplained and 1 wrong"
    assert of(7, 1, 1, *both, sampled=True) == many


def test_the_headline_begins_with_who_crashed(tmp_path: Path) -> None:
    def of(*failures: Note) -> str:
        agree = [Comparison("s", (1, 1), "a", "b", "id")]
        return headline(Validation(settings=Settings(), comparisons=agree, failures=list(failures)))

    crash = "crashed: SIGSEGV (segmentation fault)"
    one, other = Note("x.txt", "cmd:./mine {scene}", crash), Note("y.txt", "cmd:./mine {scene}", crash)
    assert of(one) == "cmd:./mine {scene} crashed on x.txt. The only comparison agrees"
    assert of(one, other) == "cmd:./mine {scene} crashed on 2 scenes. The only comparison agrees"
    assert of(one, Note("x.txt", "b", "took longer than 60 s")) == (
        "2 renderers failed on x.txt. The only comparison agrees"
    )
    assert of(Note("", "b", "it is not installed")) == "b failed. The only comparison agrees"
    assert of(Note("", "", "s: error: too large")) == "What was asked for failed. The only comparison agrees"
    page = Report().write(tmp_path, Validation(settings=Settings(), failures=[one])).read_text()
    assert re.search(r"<h1>(.*)</h1>", page)[1] == "cmd:./mine {scene} crashed on x.txt. Nothing was compared"  # type: ignore[index]


def test_a_pixel_of_several_pairs_counts_once() -> None:
    truth = Prover(doubles.full()).pixel(0, 0)

    def pair(reference: str, extra: int = 0) -> Verdicts:
        pixels = [Verdict(x, 0, ("id",), truth, finding("a", "tie"), Finding(reference), edge=True) for x in range(3)]
        return Verdicts("s", "a", reference, len(pixels) + extra, pixels)

    found = [Comparison("s", (9, 9), "a", name, "id") for name in "bc"]
    both = Validation(settings=Settings(), comparisons=found, verdicts=[pair("b"), pair("c")])
    assert headline(both) == "All 2 comparisons agree within tolerance; 3 edge pixels differ and are explained"
    sampled = Validation(settings=Settings(), comparisons=found, verdicts=[pair("b"), pair("c", 4)])
    assert headline(sampled) == (
        "All 2 comparisons agree within tolerance; 10 edge pixels differ in 2 pairs, the 6 judged are explained"
    )


def test_what_is_found_in_two_pairs_is_said_once(tmp_path: Path) -> None:
    def dot(arrays: doubles.Arrays) -> None:
        arrays["beauty"][20, 30, 1] += 0.25

    page = Report()
    odd = Double(draw=with_arrays(dot))
    found = validate({"full": doubles.full()}, odd, ["native-f64", "numpy-f64"], on_rendered=page.add)
    text = page.write(tmp_path, found).read_text()
    (row,) = table_rows(text, "why", "tr")
    assert "double, native-f64" in row
    assert "double, numpy-f64" in row
    assert "1<span" in row
    assert "and 1 pixel is unexplained" in Page(text).text


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
    maps = Maps(error, tolerance, ~np.zeros((48, 64), bool), edge, error > 0)
    worst = Worst(9, 7, "R", 0.75, 0.25)
    comparison = replace(comparison, maps=maps, worst=worst, max=0.5, edge=1, edge_over=1)
    page.add(replace(drawn, comparisons=[comparison]))
    text = Page(page.write(tmp_path, found).read_text()).text
    assert "Largest error (ring, on an edge): x 9, y 7, R" in text
    assert "tolerance there none: the values have no bound" in text
    assert "; 1 edge pixel with an error of 0.5" in text
    assert "1, 1 over tolerance; at most" in text
    assert re.search(r"worst interior pixel x \d+, y \d+: uses", text)


def test_a_large_report_stays_small(tmp_path: Path) -> None:
    # 25 scenes of 12 passes at 400 x 400 are to stay under 40 MB: that is 133 kB a pass. Errors of float32 are the
    # noisiest pictures that there are.
    page = Report(small=True)
    scene = doubles.full()
    scene = scene.replace(view=scene.view.replace(columns=400, rows=400))
    found = validate({"full": scene}, "native-f32", "numpy-f64", on_rendered=page.add)
    assert page.write(tmp_path, found).stat().st_size < len(found.comparisons) * 40e6 / (25 * 12)
    assert math.isfinite(found.comparisons[0].max or 0)


def test_the_headline_of_a_check_keeps_the_words_of_the_diagnosis() -> None:
    says = "most likely: it takes N.H in the place of R.V (3 of 3 pixels judged)"
    assert headline(Validation(settings=Settings(), about=[says])).startswith(f"M{says[1:]}. ")
