"""Opens the report in a browser as a reader does: from a file, in light and in dark. The viewer: test_viewer.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import doubles
import pytest
from doubles import POOR, Double, with_arrays

from validation import validate
from validation.report.report import Report

pytestmark = pytest.mark.browser


#: Columns of row 21 that are a little wrong: with the worst pixel more than a table has in sight.
DENTS = range(8, 20)


def dented(arrays: doubles.Arrays) -> None:
    """Wrong in one pixel, and a little in some others."""
    arrays["beauty"][20, 30] = (0.9, 0.1, 2.5)
    arrays["beauty"][21, DENTS] += 1e-3


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A report with failures, edges, and pictures that occur twice."""
    page = Report(small=True)
    scenes = {"full": doubles.full(), "cave": doubles.cave()}
    result = validate(scenes, ["native-f32", Double(draw=with_arrays(dented))], "numpy-f64", on_rendered=page.add)
    result.command = ["whitted", "validate", "full.txt"]
    return page.write(tmp_path_factory.mktemp("report"), result).as_uri() + "#report"


@pytest.fixture(params=["light", "dark"])
def page(request: pytest.FixtureRequest, browser: Any, address: str) -> Iterator[Any]:
    """The report, opened; nothing may be asked of the network, nothing may end up on the console."""
    opened = browser.new_page(viewport={"width": 1280, "height": 900}, color_scheme=request.param)
    complaints: list[str] = []
    opened.on("console", lambda message: complaints.append(message.text))
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    opened.on("request", lambda asked: asked.url.startswith(("file:", "data:")) or complaints.append(asked.url))
    opened.goto(address)
    yield opened
    opened.close()
    assert complaints == []


def test_every_picture_shows(page: Any) -> None:
    page.evaluate("document.querySelectorAll('details').forEach(details => details.open = true)")
    count = page.locator("img").count()
    assert count > 60
    # Lazy pictures are decoded when they come near the screen.
    page.evaluate("document.querySelectorAll('img').forEach(image => image.loading = 'eager')")
    page.wait_for_function("[...document.images].every(image => image.complete)")
    assert page.evaluate("[...document.images].filter(image => image.naturalWidth > 0).length") == count


def test_the_page_is_no_wider_than_the_window(page: Any) -> None:
    page.evaluate("document.querySelectorAll('details').forEach(details => details.open = true)")
    for width in (1280, 800, 400):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.fixture
def wide(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """A report with as many passes as a scene within the limits has, and with long names."""
    scene = doubles.full()
    lights = [scene.lights[0].replace(name=f"l{i}", position=(i, 5, 0)) for i in range(5)]
    scene = scene.replace(lights=lights)
    names = [f"a/{'long' * 10}/folder-with-{'many-' * 5}words/{'x' * 30}.{k}.txt" for k in range(30)]
    page = Report()
    result = validate(dict.fromkeys(names, scene), "native-f32", "numpy-f64", size=(24, 18), on_rendered=page.add)
    result.command = ["whitted", "validate", "x" * 500]
    opened = browser.new_page(viewport={"width": 1280, "height": 900})
    opened.goto(page.write(tmp_path, result).as_uri() + "#report")
    yield opened
    opened.close()


def test_a_table_of_every_pass_fits(wide: Any) -> None:
    table = wide.locator("#report .wide:not(.plainly)")
    assert table.locator("thead th").count() == 19
    assert table.evaluate("box => box.scrollWidth <= box.clientWidth")
    wide.set_viewport_size({"width": 420, "height": 900})
    assert wide.evaluate("document.documentElement.scrollWidth") <= 420
    # Scrolled, the headings and the names of the scenes stay in sight.
    corner = table.bounding_box()
    table.evaluate("box => box.scrollTo(300, 300)")
    heading, name = table.locator("thead th").nth(9).bounding_box(), table.locator("tbody th").nth(9).bounding_box()
    assert abs(heading["y"] - corner["y"]) < 2
    assert abs(name["x"] - corner["x"]) < 2


def test_both_pictures_and_their_difference_stand_in_one_row(page: Any) -> None:
    figures = page.locator("details.pass[open] .figures.of3").first.locator("figure")
    places = [figures.nth(index).bounding_box() for index in range(3)]
    assert len({place["y"] for place in places}) == 1
    assert places[0]["x"] < places[1]["x"] < places[2]["x"]
    assert figures.first.locator(".frame").bounding_box()["width"] == 384  # whole pixels: 64 times 6


def test_a_link_of_the_summary_opens_its_pass(page: Any) -> None:
    closed = page.locator("details.pass:not([open])").first
    name = closed.get_attribute("id")
    assert closed.evaluate("details => details.open") is False
    page.locator(f'table.summary a[href="#{name}"]').click()
    page.wait_for_function("name => document.getElementById(name).open", arg=name)


def test_a_link_of_the_summary_leads_to_the_numbers_of_a_pass_without_pictures(wide: Any) -> None:
    row = wide.locator(".agreeing tbody tr").first
    name = row.get_attribute("id")
    wide.locator(f'table.summary a[href="#{name}"]').click()
    assert wide.evaluate("document.querySelector(':target').id") == name
    assert row.is_visible()
    assert len(row.locator("td").all_inner_texts()) == row.locator("xpath=../../thead//th").count() - 1


def test_the_report_is_there_where_the_modules_of_the_viewer_do_not_run(
    browser: Any, address: str, tmp_path: Path
) -> None:
    text = Path(address.removeprefix("file://").removesuffix("#report")).read_text(encoding="utf-8")
    broken = tmp_path / "index.html"
    broken.write_text(text.replace('import "viewer/main.js"', 'import "viewer/none.js"'), encoding="utf-8")
    page = browser.new_page()
    page.goto(broken.as_uri())
    assert page.locator("#report h1").is_visible()
    assert not page.locator("#viewer").is_visible()
    page.close()


def test_failures_are_open_and_marked(page: Any) -> None:
    failed = page.locator("details.pass", has=page.locator(".chip.bad"))
    assert failed.count() == 2
    for index in range(2):
        assert failed.nth(index).evaluate("details => details.open")
        picture = failed.nth(index).locator(".frame").first.bounding_box()
        mark = failed.nth(index).locator(".frame .mark").first.bounding_box()
        columns, rows = (64, 48) if index == 0 else (32, 32)
        assert abs(mark["x"] + mark["width"] / 2 - picture["x"] - 30.5 / columns * picture["width"]) < 1
        assert abs(mark["y"] + mark["height"] / 2 - picture["y"] - 20.5 / rows * picture["height"]) < 1


def test_text_has_contrast(page: Any) -> None:
    seen, poor = page.evaluate(POOR, "#report *")
    assert poor == []
    assert seen > 100


def test_a_mark_of_the_map_stands_on_its_pixel_and_leads_to_its_row(page: Any) -> None:
    scene = page.locator("section.scene", has=page.locator(".judgement")).first
    picture, marks = scene.locator(".judgement .frame").bounding_box(), scene.locator(".map a")
    assert marks.count() == 1 + len(DENTS)
    for index in range(marks.count()):
        x, y = map(int, marks.nth(index).locator("title").text_content().split(", "))
        place = marks.nth(index).locator("use").bounding_box()
        assert abs(place["x"] + place["width"] / 2 - picture["x"] - (x + 0.5) / 64 * picture["width"]) < 1
        assert abs(place["y"] + place["height"] / 2 - picture["y"] - (y + 0.5) / 48 * picture["height"]) < 1
        assert 5 < place["width"] < 30
    # The row of one mark is folded up, until the mark is clicked.
    folded = scene.locator(".told details tbody").last
    name = folded.get_attribute("id")
    assert not folded.is_visible()
    scene.locator(f'.map a[href="#{name}"]').click()
    page.wait_for_function("name => document.getElementById(name).closest('details').open", arg=name)
    folded.wait_for(state="visible")
    page.wait_for_function(
        """name => {
            const place = document.getElementById(name).getBoundingClientRect();
            return place.top >= 0 && place.bottom <= innerHeight;
        }""",
        arg=name,
    )


def test_why_pixels_differ_leads_to_their_rows(page: Any) -> None:
    rows = page.locator("table.why tbody tr")
    assert rows.count() >= 2
    for index in range(rows.count()):
        for link in rows.nth(index).locator("a").all():
            name = link.get_attribute("href").removeprefix("#")
            assert page.locator(f'[id="{name}"]').count() == 1
    rows.first.locator("a").last.click()
    target = page.locator("tbody:target")
    assert target.count() == 1
    assert target.is_visible()


def test_a_click_on_a_command_selects_all_of_it(page: Any) -> None:
    command = page.locator("code.command").first
    command.click()
    selected = page.evaluate("getSelection().toString()")
    assert selected == command.text_content()
    assert selected.startswith("whitted explain full ")


def test_causes_are_told_by_words_and_shape(page: Any) -> None:
    for chip in page.locator("table.why .chip, table.verdicts .chip").all():
        words = chip.text_content()
        assert words[0] in "✓✗"
        assert (words[0] == "✗") == ("unexplained" in words or "wrong" in words)


def test_rows_of_verdicts_fit_a_narrow_window(page: Any) -> None:
    page.set_viewport_size({"width": 800, "height": 900})
    box = page.locator(".plainly").first
    assert box.evaluate("box => box.scrollWidth <= box.clientWidth")
    # Values stand side by side, whole.
    values = page.locator("table.verdicts tbody").first.locator("td.value")
    tops = {values.nth(index).bounding_box()["y"] for index in range(3)}
    assert len(tops) == 1
    assert values.first.bounding_box()["height"] < 60
    page.set_viewport_size({"width": 400, "height": 900})
    assert page.locator("table.why").first.evaluate("table => table.getBoundingClientRect().right <= innerWidth")
