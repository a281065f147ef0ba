"""The viewer in the report, used as a reader uses it: modes, values of pixels, filters, links, keys."""

from __future__ import annotations

import importlib.util
import itertools
import math
import re
import sys
import urllib.parse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from doubles import POOR, Double, with_arrays

import tracer
from tracer.passes import Sample
from validation import Settings, validate
from validation.check import Convention, Picture, check
from validation.cli import main
from validation.encoding import QUANTISATIONS, Encoding
from validation.renderers.native import Native
from validation.renderers.numpy import Reference
from validation.report import floats
from validation.report.report import Report

pytestmark = pytest.mark.browser

MODES = {"b": "side", "s": "slider", "f": "flip", "d": "diff", "h": "heat", "v": "verdict"}


def dented(arrays: doubles.Arrays) -> None:
    """Wrong in one pixel, and a little in some others."""
    arrays["beauty"][20, 30] = (0.9, 0.1, 2.5)
    arrays["beauty"][21, 8:20] += 1e-3


def written(folder: Path, *, small: bool = False) -> str:
    """A report of two scenes, one of which agrees, and three renderers, one with a defect."""
    page = Report(small=small)
    scenes = {"scenes/cave.txt": doubles.cave(), "scenes/full.txt": doubles.full()}
    double = Double(draw=lambda s, p, t: with_arrays(dented if len(s.spheres) == 3 else lambda _: None)(s, p, t))
    result = validate(scenes, ["native-f32", double], "numpy-f64", on_rendered=page.add)
    result.command = ["whitted", "validate", "scenes"]
    return page.write(folder, result).as_uri()


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("report"))


def opened(browser: Any, address: str, **options: Any) -> Any:
    """The page once it shows something; what ends up on the console, or is asked of the network, is kept."""
    page = browser.new_page(viewport={"width": 1280, "height": 720}, **options)
    page.complaints = []
    page.on("console", lambda message: page.complaints.append(message.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    page.on(
        "request", lambda asked: asked.url.startswith(("file:", "data:", "blob:")) or page.complaints.append(asked.url)
    )
    page.goto(address)
    page.wait_for_function("document.getElementById('v-stage').dataset.ready")
    return page


#: Tests of what it looks like have the page in light and in dark.
EITHER = pytest.mark.parametrize("scheme", ["light", "dark"])


@pytest.fixture
def scheme() -> str:
    return "light"


@pytest.fixture
def page(scheme: str, browser: Any, address: str) -> Iterator[Any]:
    found = opened(browser, address, color_scheme=scheme)
    yield found
    complaints = found.complaints
    found.close()
    assert complaints == []


def settled(page: Any, **expected: str) -> None:
    """Wait until the picture on the screen is the one of an address with these entries."""
    page.wait_for_function(
        """expected => {
            const shown = new URLSearchParams(document.getElementById("v-stage").dataset.ready.slice(2));
            return Object.entries(expected).every(([key, value]) => (shown.get(key) ?? "") === value);
        }""",
        arg=expected,
    )


def whole(page: Any) -> None:
    """Wait until all values of the scene are there."""
    page.wait_for_function("document.getElementById('v-values').dataset.complete")


def colors(page: Any, canvas: int = 0) -> int:
    """How many colours a canvas has."""
    count: int = page.evaluate(
        """index => {
            const canvas = document.querySelectorAll(".stage canvas")[index];
            const { width, height } = canvas;
            const copy = Object.assign(document.createElement("canvas"), { width, height });
            const context = copy.getContext("2d", { willReadFrequently: true });
            context.drawImage(canvas, 0, 0);
            const data = context.getImageData(0, 0, width, height).data;
            return new Set(new Uint32Array(data.buffer)).size;
        }""",
        canvas,
    )
    return count


def into(report: Report, kept: list[Any]) -> Callable[[Any], None]:
    """What was drawn goes to both."""

    def both(rendered: Any) -> None:
        kept.append(rendered)
        report.add(rendered)

    return both


def color_at(page: Any, x: int, y: int) -> list[int]:
    """The colour of a pixel of the scene, in the only canvas, where all of it is in sight."""
    found: list[int] = page.evaluate(
        """([x, y]) => {
            const canvas = document.querySelector(".stage canvas");
            const shown = new URLSearchParams(document.getElementById("v-stage").dataset.ready.slice(2));
            const [columns, rows] = shown.get("size").split("x").map(Number);
            const { width, height } = canvas;
            const scale = parseFloat(document.getElementById("v-zoom").textContent) * width / canvas.clientWidth;
            const copy = Object.assign(document.createElement("canvas"), { width, height });
            const context = copy.getContext("2d", { willReadFrequently: true });
            context.drawImage(canvas, 0, 0);
            const at = [width / 2 + (x + 0.5 - columns / 2) * scale, height / 2 + (y + 0.5 - rows / 2) * scale];
            return [...context.getImageData(Math.floor(at[0]), Math.floor(at[1]), 1, 1).data.slice(0, 3)];
        }""",
        [x, y],
    )
    return found


def scale_of(errors: Any, edge: Any) -> tuple[int, int]:
    """The exponents between which errors are shown: at most six factors of ten below the largest of the interior."""
    inside = errors[(errors > 0) & ~edge]
    top = math.ceil(math.log10(inside.max()))
    return max(top - 6, min(math.floor(math.log10(inside.min())), top - 1)), top


def expected_color(page: Any, value: float, scale: tuple[int, int], *, signed: bool) -> list[float]:
    """That of the scale of errors, or of signed differences."""
    if value == 0:
        return [0, 0, 0]
    share = (math.log10(abs(value)) - scale[0]) / (scale[1] - scale[0])
    share = math.copysign(max(0.02, min(1, share)), value) if signed else min(1, share)
    found: list[float] = page.evaluate(
        "async ([name, share]) => (await import('viewer/colors.js'))[name](share)",
        ["signed" if signed else "inferno", share],
    )
    return found


def test_errors_and_signs_have_the_colors_of_their_decades(browser: Any, tmp_path: Path) -> None:
    report = Report()
    double = Double(draw=with_arrays(dented))
    kept: list[Any] = []
    result = validate({"full.txt": doubles.full()}, [double], "numpy-f64", on_rendered=into(report, kept))
    page = opened(browser, report.write(tmp_path, result).as_uri())
    maps = next(one.maps for one in kept[0].comparisons if one.pass_name == "beauty")
    apart = kept[0].renderer["beauty"] - kept[0].reference["beauty"]
    signed = np.take_along_axis(apart, np.abs(apart).argmax(axis=-1)[..., None], axis=-1)[..., 0]
    assert np.abs(signed) == pytest.approx(maps.error)
    scale = scale_of(maps.error, maps.edge)
    page.keyboard.press("Escape")
    for key, mode, values in (("h", "heat", maps.error), ("d", "diff", signed)):
        page.keyboard.press(key)
        settled(page, mode=mode, at="")
        for x, y in ((30, 20), (12, 21), (19, 21)):
            expected = expected_color(page, values[y, x], scale, signed=mode == "diff")
            assert color_at(page, x, y) == pytest.approx(expected, abs=2), (mode, x, y)
        assert color_at(page, 2, 2) == [0, 0, 0], "far below all decades"
    page.keyboard.press("x")
    settled(page, mode="diff", a="numpy-f64")
    assert color_at(page, 30, 20) == pytest.approx(expected_color(page, -signed[20, 30], scale, signed=True), abs=2)
    assert page.complaints == []
    page.close()


def checked(folder: Path, convention: Convention, *, wrong: int = 0) -> tuple[str, Any]:
    """The report of an image made by that convention, and what was drawn; one pixel is off by so many levels."""
    scene = doubles.full()
    colors = tracer.render(scene, ("beauty",), sample=convention.sample)["beauty"]
    levels = convention.encoding().encode(colors)
    levels[20, 30] += np.where(levels[20, 30] > 127, -wrong, wrong)
    report = Report()
    kept: list[Any] = []
    result = check([Picture("full.txt", scene, levels)], on_rendered=into(report, kept)).validation
    return report.write(folder, result).as_uri(), kept[0]


@pytest.mark.parametrize("quantisation", ["srgb", "round"])
def test_of_bytes_the_error_that_was_measured_is_shown(browser: Any, tmp_path: Path, quantisation: str) -> None:
    address, kept = checked(tmp_path, Convention("center", quantisation=quantisation), wrong=40)
    maps = kept.comparisons[0].maps
    assert (maps.error > 0).sum() == 1
    page = opened(browser, address)
    page.keyboard.press("Escape")
    scale = scale_of(maps.error, maps.edge)
    for key, mode in (("h", "heat"), ("d", "diff")):
        page.keyboard.press(key)
        settled(page, mode=mode, at="")
        how = page.locator("#v-how").inner_text()
        assert f"A is bytes: {QUANTISATIONS[quantisation]}" in how
        assert "black: the right level" in how
        sign = sign_of(kept, 30, 20) if mode == "diff" else 1
        expected = expected_color(page, sign * maps.error[20, 30], scale, signed=mode == "diff")
        assert color_at(page, 30, 20) == pytest.approx(expected, abs=2)
        for x, y in ((31, 20), (5, 40), (30, 9)):
            assert color_at(page, x, y) == [0, 0, 0]
    page.keyboard.press("x")
    settled(page, mode="diff", b="image")
    expected = expected_color(page, -sign_of(kept, 30, 20) * maps.error[20, 30], scale, signed=True)
    assert color_at(page, 30, 20) == pytest.approx(expected, abs=2)
    assert "B is bytes" in page.locator("#v-how").inner_text()
    page.keyboard.press("x")
    page.keyboard.press("b")
    settled(page, mode="side", at="", b="native-f64")
    assert f"A is bytes: {QUANTISATIONS[quantisation]}" in page.locator("#v-how").inner_text()
    # The 8-bit column: the program's own byte, and what the other colour becomes by its rule.
    page.locator("#v-stage").focus()
    shown = page.locator("#v-stage").get_attribute("data-ready")
    encoding = Convention(quantisation=quantisation).encoding()
    for x, y in ((5, 40), (30, 20), (30, 9)):
        page.evaluate("hash => { location.hash = hash }", re.sub("&at=[^&]*", "", shown) + f"&at={x},{y}")
        page.wait_for_function("at => document.getElementById('v-values').dataset.at === at", arg=f"{x},{y}")
        whole(page)
        page.wait_for_function("!document.querySelector('#v-values').innerText.includes('…')")
        rows = page.locator("#v-values table.values").first.locator("tbody tr.pair")
        cells = [int(row.locator("td").last.inner_text()) for row in rows.all()]
        assert cells[::2] == np.rint(kept.renderer["beauty"][y, x] * 255).tolist()
        assert cells[1::2] == encoding.encode(kept.reference["beauty"][y, x]).tolist()
    assert page.complaints == []
    page.close()


def sign_of(kept: Any, x: int, y: int) -> float:
    """Whether the byte that is off most stands for more than the colour that it should."""
    encoding = kept.encodings[0]
    a, b = np.rint(kept.renderer["beauty"][y, x] * 255), kept.reference["beauty"][y, x]
    channel = int(encoding.distance(a, b).argmax())
    return math.copysign(1, a[channel] - encoding.encode(b)[channel])


def test_levels_are_those_of_the_encodings(page: Any) -> None:
    colors = [
        -1.0,
        0.0,
        0.5 / 255,
        1e-9,
        1.0,
        7.0,
        *np.random.default_rng(0).random(2000).tolist(),
        *(np.arange(255) / 255),
    ]
    for name, steps in itertools.product(QUANTISATIONS, (255, 1000)):
        encoding = Encoding(name, steps)
        found = page.evaluate(
            """async ([colors, encoding]) => {
                const { levels } = await import("viewer/inspector.js");
                return colors.map(color => levels(color, encoding));
            }""",
            [list(map(float, colors)), {"quantisation": name, "steps": steps, "says": ""}],
        )
        either = encoding.either(np.array(colors))
        assert [few[0] for few in found] == encoding.encode(np.array(colors)).tolist(), name
        assert [{*few} | {few[0]} for few in found] == [
            {*few}
            for few in zip(encoding.encode(np.array(colors)).tolist(), *(one.tolist() for one in either), strict=True)
        ], name


@EITHER
def test_it_opens_at_what_is_worst_and_says_why(page: Any) -> None:
    settled(page, scene="scenes/full.txt", at="30,20", **{"pass": "beauty"})
    assert page.locator("#v-where").inner_text().startswith("x 30, y 20")
    verdict = page.locator("#v-values .verdict")
    assert "unexplained" in verdict.inner_text()
    assert re.search(r"A double is off in beauty by 1\.7", verdict.inner_text())
    assert re.search(r"right\s+B numpy-f64", verdict.inner_text())
    command = page.locator("#v-command").inner_text()
    assert command == "whitted explain scenes/full.txt 30 20 --renderer double,numpy-f64 --size 64x48"


@EITHER
def test_every_mode_shows_something(page: Any) -> None:
    for key, mode in MODES.items():
        page.keyboard.press(key)
        settled(page, mode=mode)
        assert page.locator(f'#v-modes [data-mode="{mode}"]').get_attribute("aria-pressed") == "true"
        assert page.locator(".stage canvas").count() == (2 if mode == "side" else 1)
        assert colors(page) > 2
    for mode in MODES.values():
        page.locator(f'#v-modes [data-mode="{mode}"]').click()
        settled(page, mode=mode)
    page.keyboard.press("s")
    settled(page, split="0.5")
    page.keyboard.press(".")
    settled(page, split="0.52")
    page.locator('#v-modes [data-mode="heat"]').click()
    settled(page, mode="heat")
    assert page.locator("#v-bar .ticks span").count() >= 2
    page.locator('#v-modes [data-mode="flip"]').click()
    settled(page, mode="flip")
    before = page.locator(".stage figcaption").inner_text()
    page.keyboard.press("f")
    settled(page, flipped="1")
    assert {before, page.locator(".stage figcaption").inner_text()} == {"A  double", "B  numpy-f64"}


@EITHER
def test_verdicts_are_told_by_shape_and_words(page: Any) -> None:
    page.keyboard.press("v")
    settled(page, mode="verdict")
    key = page.locator("#v-bar").inner_text()
    assert "double is off: 13" in key
    assert "crossed: unexplained, or a known mistake: 13" in key
    assert page.locator("#v-bar svg g.square").count() == 1
    page.keyboard.press("Escape")
    settled(page, at="")
    told = page.locator("#v-values .verdict").inner_text()
    assert re.search(r"unexplained\s+13 × double", told)
    page.keyboard.press("n")
    page.wait_for_function("/at=\\d/.test(location.hash)")


@EITHER
def test_edges_are_outlined_in_every_line_style(page: Any) -> None:
    page.locator("#v-a").select_option(label="native-f32")
    settled(page, a="native-f32")
    before = colors(page)
    page.keyboard.press("o")
    settled(page, edges="1")
    kinds = page.locator("#v-kinds > span")
    assert [kinds.nth(k).inner_text().strip() for k in range(4)] == ["silhouette", "range", "order", "terminator"]
    dashes = {line.get_attribute("stroke-dasharray") for line in page.locator("#v-kinds line").all()}
    assert len(dashes) == kinds.count()
    assert colors(page) != before


def values(page: Any, renderer: str, name: str) -> dict[str, float]:
    """What the inspector says, by channel."""
    cells = page.locator(f'td.value[data-renderer="{renderer}"][data-pass="{name}"]')
    found = {}
    for cell in cells.all():
        text = cell.evaluate(
            "cell => [...cell.childNodes].filter(n => n.nodeName !== 'SPAN').map(n => n.textContent).join('')"
        )
        found[cell.get_attribute("data-channel")] = float(text.strip().replace("∞", "inf"))
    return found


def test_the_inspector_shows_the_values_of_the_arrays(browser: Any, tmp_path: Path, scene: Path) -> None:
    options = ["--renderer", "native-f64,native-f32", "--against", "numpy-f64", "--size", "40x30"]
    with pytest.raises(SystemExit) as status:
        main(["validate", str(scene), *options, "--report", str(tmp_path / "out")])
    assert status.value.code == 0
    loaded = tracer.load(scene)
    loaded = loaded.replace(view=loaded.view.replace(columns=40, rows=30))
    every = tracer.passes.names(len(loaded.lights), margins=False)
    drawn = {
        "native-f64": tracer.render(loaded, passes=every),
        "native-f32": tracer.render(loaded, passes=every, precision="f32"),
        "numpy-f64": Reference("f64").render(loaded, every, Settings()),
    }
    page = opened(browser, (tmp_path / "out" / "index.html").as_uri())
    whole(page)
    base = page.evaluate("location.hash") or page.locator("#v-stage").get_attribute("data-ready")
    for x, y in ((0, 0), (39, 29), (17, 14), (23, 16), (30, 9)):
        page.evaluate("hash => { location.hash = hash }", re.sub("&at=[^&]*", "", base) + f"&at={x},{y}")
        page.wait_for_function("at => document.getElementById('v-values').dataset.at === at", arg=f"{x},{y}")
        whole(page)
        page.wait_for_function("!document.querySelector('#v-values').innerText.includes('…')")
        for renderer, passes in drawn.items():
            for name in every:
                expected = np.atleast_1d(passes[name][y, x]).tolist()
                shown = values(page, renderer, name)
                if passes[name].dtype == np.float32:
                    shown = {channel: float(np.float32(value)) for channel, value in shown.items()}
                assert [*shown.values()] == expected, (x, y, renderer, name)
    assert page.complaints == []
    page.close()


def test_programs_with_conventions_of_their_own_have_values_of_their_own(
    browser: Any, tmp_path: Path, scene: Path
) -> None:
    raytrace = Path(sys.executable).parent / "raytrace"
    commands = [f"{raytrace} {{scene}} -o {{output}}{more}" for more in (" --sample center", "")]
    words = [word for command in commands for word in ("--command", command)]
    with pytest.raises(SystemExit) as status:
        main(["check", str(scene), *words, "--report", str(tmp_path / "out")])
    assert status.value.code == 0
    page = opened(browser, (tmp_path / "out" / "index.html").as_uri())
    assert names(page) == ["full.txt · center", "full.txt · corner"]
    loaded = tracer.load(scene)
    samples: tuple[Sample, ...] = ("center", "corner")
    for sample, command in zip(samples, commands, strict=True):
        drawn = tracer.render(loaded, ("beauty",), sample=sample)["beauty"]
        page.locator("#v-scenes button", has_text=sample).click()
        settled(page, **{"as": sample, "a": f"cmd:{command}"})
        shown = page.locator("#v-stage").get_attribute("data-ready")
        for x, y in ((30, 9), (20, 20), (5, 40)):
            link = re.sub("&at=[^&]*", "", shown) + f"&at={x},{y}"
            page.evaluate("hash => { location.hash = hash }", link)
            page.wait_for_function("at => document.getElementById('v-values').dataset.at === at", arg=f"{x},{y}")
            settled(page, **{"as": sample, "at": f"{x},{y}"})
            whole(page)
            assert [*values(page, "native-f64", "beauty").values()] == drawn[y, x].tolist()
            levels = np.trunc(drawn[y, x].clip(0, 1) * 255) / 255
            assert [*values(page, f"cmd:{command}", "beauty").values()] == pytest.approx(levels.tolist(), abs=1e-7)
            said = page.locator("#v-command").inner_text()
            assert ("--sample center" in said.split(" --renderer ")[-1].split("'")[-1]) == (sample == "center")
    page.locator("#v-summary-open").click()
    heads = [head.inner_text() for head in page.locator("#v-matrix th[scope=rowgroup]").all()]
    assert heads == ["full.txt · center", "full.txt · corner"]
    assert page.complaints == []
    page.close()


def test_one_pair_with_several_settings_is_several_scenes(browser: Any, tmp_path: Path) -> None:
    report = Report()
    every = [
        Settings(),
        Settings(shadow_epsilon=1e-2),
        Settings(sample="center", max_reflections=0),
        Settings(threads=2),
    ]
    result: Any = None
    for settings in every:
        double = Double(draw=with_arrays(dented))
        options: Any = {"passes": ("beauty",), "verdicts": 1, "settings": settings, "on_rendered": report.add}
        one = validate({"full.txt": doubles.full()}, [double], "native-f64", **options)
        result = result or one
        result.comparisons += one.comparisons
    page = opened(browser, report.write(tmp_path, result).as_uri())
    variants = ["corner", "corner, epsilon 0.01", "center, reflections 0"]
    assert names(page) == [f"full.txt · {variant}" for variant in variants]
    # Those of the report in plain words lead there, too.
    links = page.evaluate("[...document.querySelectorAll('#report a.viewed')].map(link => link.getAttribute('href'))")
    assert len(links) >= 3
    found = []
    for link in dict.fromkeys(links):
        page.evaluate("hash => { location.hash = hash }", link)
        told = dict(urllib.parse.parse_qsl(link[2:]))
        settled(page, **{key: told[key] for key in ("as", "at", "a", "b")})
        found.append(told["as"])
        x, y = map(int, told["at"].split(","))
        whole(page)
        page.wait_for_function("at => document.getElementById('v-values').dataset.at === at", arg=told["at"])
        page.wait_for_function("!document.querySelector('#v-values').innerText.includes('…')")
        drawn = Native("f64").render(doubles.full(), ("beauty",), every[variants.index(told["as"])])["beauty"]
        assert [*values(page, "native-f64", "beauty").values()] == drawn[y, x].tolist()
    assert {*found} == {*variants}
    assert page.complaints == []
    page.close()


def test_differences_and_levels_are_those_of_the_values(page: Any) -> None:
    whole(page)
    rows = page.locator("#v-values table.values").first.locator("tbody tr.pair")
    cells = [[cell.inner_text() for cell in row.locator("td").all()] for row in rows.all()]
    assert cells[0][-1] == "229"  # 0.9 * 255, truncated
    assert cells[4][-1] == "255"
    # Against the exact value, as this pixel was judged.
    exact = float(page.locator("#v-values table.values").first.locator("tbody tr.truth td").nth(10).inner_text())
    held_against(cells[4], exact, 2.5)
    right = page.locator("#v-values table.values").first.locator('td[data-renderer="numpy-f64"]').last
    assert abs(float(right.get_attribute("title")) - exact) < 1e-15
    # Elsewhere against A.
    page.locator("#v-stage").focus()
    page.keyboard.press("ArrowDown")
    settled(page, at="30,21")
    whole(page)
    page.wait_for_function("document.getElementById('v-values').dataset.at === '30,21'")
    rows = page.locator("#v-values table.values").first.locator("tbody tr.pair")
    cells = [[cell.inner_text() for cell in row.locator("td").all()] for row in rows.all()]
    assert cells[0][1:4] == ["", "", ""]
    first, second = float(cells[4][0]), float(cells[5][0])
    held_against(cells[5], first, second) if first != second else pytest.fail("they differ in every pixel")


def held_against(cells: list[str], base: float, value: float) -> None:
    assert float(cells[1]) == pytest.approx(value - base, rel=1e-2)
    assert float(cells[2]) == pytest.approx(abs(value - base) / base, rel=6e-2)
    apart = abs(int(np.float64(value).view(np.int64)) - int(np.float64(base).view(np.int64)))
    assert float(cells[3].removesuffix("64").strip()) == pytest.approx(apart, rel=0.06)


def test_a_link_restores_everything(browser: Any, page: Any) -> None:
    page.locator("#v-pass").select_option("depth")
    page.keyboard.press("Escape")
    page.keyboard.press("s")
    page.keyboard.press("o")
    page.locator("#v-stage").focus()
    for key in ("+", "+", "ArrowRight", "ArrowDown", "ArrowDown", "e"):
        page.keyboard.press(key)
    page.locator("#v-search").fill("full")
    settled(page, **{"pass": "depth", "mode": "slider", "find": "full", "edges": "1", "exposure": "0.5"})
    page.wait_for_function("location.hash === document.getElementById('v-stage').dataset.ready")
    link = page.evaluate("location.href")
    assert "zoom=" in link
    again = opened(browser, link)
    assert again.locator("#v-stage").get_attribute("data-ready") == page.locator("#v-stage").get_attribute("data-ready")
    assert again.locator("#v-search").input_value() == "full"
    assert again.locator("#v-where").inner_text() == page.locator("#v-where").inner_text()
    again.close()


def test_addresses_that_say_nonsense_are_taken_as_far_as_they_make_sense(browser: Any, address: str) -> None:
    odd = ("#/scene=none&pass=x", "#/at=-1,9999&zoom=NaN&a=nobody&mode=upside", "#/scene=%zz")
    for hash in ("#/", "#nowhere", "#%zz", *odd):
        page = opened(browser, address + hash)
        assert colors(page) > 2
        assert page.complaints == []
        page.close()


def names(page: Any) -> list[str]:
    return [entry.inner_text() for entry in page.locator("#v-scenes b").all()]


def test_filters_and_failures_first(page: Any) -> None:
    assert names(page) == ["full.txt", "cave.txt"]
    page.locator("#v-failed").check()
    page.wait_for_function("document.querySelectorAll('#v-scenes li').length === 1")
    assert names(page) == ["full.txt"]
    page.locator("#v-filter-pass").select_option("depth")
    page.wait_for_function("document.querySelectorAll('#v-scenes li').length === 0")
    page.locator("#v-failed").uncheck()
    page.wait_for_function("document.querySelectorAll('#v-scenes li').length === 2")
    page.locator("#v-filter-pass").select_option("")
    page.locator("#v-filter-renderer").select_option("native-f32")
    page.locator("#v-search").fill("CAV")
    page.wait_for_function("document.querySelectorAll('#v-scenes li').length === 1")
    assert names(page) == ["cave.txt"]
    assert re.search(r"all \d+ agree", page.locator("#v-scenes").inner_text())


def test_keys(page: Any) -> None:
    page.keyboard.press("ArrowDown")
    settled(page, scene="scenes/cave.txt")
    page.keyboard.press("ArrowUp")
    settled(page, scene="scenes/full.txt")
    page.keyboard.press("2")
    settled(page, **{"pass": "ambient"})
    page.keyboard.press("ArrowRight")
    settled(page, **{"pass": "diffuse"})
    page.keyboard.press("ArrowLeft")
    settled(page, **{"pass": "ambient"})
    page.keyboard.press("x")
    settled(page, a="numpy-f64", b="double")
    page.keyboard.press("Enter")
    page.keyboard.press("ArrowRight")
    settled(page, at="31,20")
    page.keyboard.press("Shift+ArrowDown")
    settled(page, at="31,30")
    page.keyboard.press("Escape")
    settled(page, at="")
    page.keyboard.press("?")
    assert page.locator("#v-help").is_visible()
    page.keyboard.press("Escape")
    assert not page.locator("#v-help").is_visible()
    page.keyboard.press("/")
    page.keyboard.type("hsd")
    settled(page, mode="side", find="hsd")


def test_the_pointer_chooses_zooms_and_drags(page: Any) -> None:
    page.keyboard.press("f")
    page.keyboard.press("Escape")
    settled(page, mode="flip", at="")
    canvas = page.locator(".stage canvas")
    box = canvas.bounding_box()
    scale = float(page.locator("#v-zoom").inner_text().removesuffix("×"))
    left, top = box["x"] + box["width"] / 2 - 32 * scale, box["y"] + box["height"] / 2 - 24 * scale
    page.mouse.move(left + 10.5 * scale, top + 5.5 * scale)
    page.wait_for_function("document.getElementById('v-values').dataset.at === '10,5'")
    page.mouse.down()
    page.mouse.up()
    settled(page, at="10,5")
    page.mouse.wheel(0, -480)
    page.wait_for_function("parseFloat(document.getElementById('v-zoom').textContent) > 30")
    page.mouse.move(left + 20.5 * scale, top + 5.5 * scale)
    page.mouse.move(left + 10.5 * scale, top + 5.5 * scale)
    page.mouse.down()
    page.mouse.move(left + 12.5 * scale, top + 9.5 * scale, steps=4)
    page.mouse.up()
    assert "at=10%2C5" in page.locator("#v-stage").get_attribute("data-ready"), "a drag does not choose"


def test_the_summary_leads_to_comparisons(page: Any) -> None:
    page.locator("#v-summary-open").click()
    dialog = page.locator("#v-summary")
    assert dialog.locator("td.bad").count() == 1
    assert "whitted validate scenes" in dialog.inner_text()
    dialog.locator('a[href*="pass=normal"]').first.click()
    settled(page, **{"pass": "normal"})
    assert not dialog.is_visible()


def test_the_report_in_plain_words_is_one_click_away_and_back(page: Any) -> None:
    page.keyboard.press("h")
    settled(page, mode="heat")
    page.locator("#v-report").click()
    page.locator("#report h1").wait_for(state="visible")
    assert not page.locator("#viewer").is_visible()
    page.locator("#report .kicker a").click()
    page.locator("#viewer").wait_for(state="visible")
    settled(page, mode="heat")


@EITHER
def test_text_of_the_viewer_has_contrast_in_every_mode_and_controls_have_names(page: Any) -> None:
    whole(page)
    for key in MODES:
        page.keyboard.press(key)
        settled(page, mode=MODES[key])
        seen, poor = page.evaluate(POOR, "#viewer *")
        assert poor == []
        assert seen > 100
    for opener in ("#v-summary-open", "#v-help-open"):
        page.locator(opener).click()
        page.evaluate("document.querySelectorAll('dialog details').forEach(details => details.open = true)")
        seen, poor = page.evaluate(POOR, "dialog[open] *")
        assert poor == []
        assert seen > 20
        page.keyboard.press("Escape")
    page.keyboard.press("Escape")
    settled(page, at="")
    assert page.evaluate(POOR, "#viewer *")[1] == []
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("#viewer button, #viewer select, #viewer input, #viewer canvas")].filter(
            element => ![element.getAttribute("aria-label"), element.textContent, element.labels?.[0]?.textContent]
                .join("").trim()
        ).map(element => element.id)"""
    )
    assert nameless == []
    assert page.locator("#viewer img:not([alt])").count() == 0


@EITHER
def test_tab_goes_through_list_tools_picture_and_inspector_and_shows_where_it_is(page: Any) -> None:
    whole(page)
    page.evaluate("document.activeElement.blur()")
    places = []
    for _ in range(40):
        page.keyboard.press("Tab")
        place, outline = page.evaluate(
            """() => {
                const at = document.activeElement;
                const within = ["#viewer > header", "#v-scenes", ".filters", ".pairs", "#v-modes", "#v-stage", ".low",
                    ".inspector"];
                const { outlineStyle, outlineWidth } = getComputedStyle(at);
                const place = within.find(selector => at.closest(selector)) ?? at.className;
                return [place, `${outlineStyle} ${outlineWidth}`];
            }"""
        )
        if places and place == "skip":
            break
        if place:
            assert outline not in ("none 0px", "none 3px"), place
            places.append(place)
    order = list(dict.fromkeys(places))
    assert order[:8] == ["skip", "#viewer > header", ".filters", "#v-scenes", ".pairs", "#v-modes", "#v-stage", ".low"]
    assert order[8] == ".inspector"
    assert places.count("#v-scenes") == 1, "arrow keys go through the scenes"


def test_a_dialog_gives_the_focus_back_and_a_kept_pixel_is_said(page: Any) -> None:
    whole(page)
    for opener in ("#v-summary-open", "#v-help-open"):
        page.locator(opener).focus()
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.closest('dialog[open]') !== null")
        page.keyboard.press("Escape")
        assert page.evaluate("'#' + document.activeElement.id") == opener
    page.wait_for_function("document.getElementById('v-live').textContent.startsWith('x 30, y 20')")
    said = page.locator("#v-live").inner_text()
    assert "beauty: A double 0.9 0.1 2.5; B numpy-f64" in said
    assert "double is off in beauty" in said
    assert "numpy-f64 is right" in said
    assert page.locator("#v-live").get_attribute("role") == "status"
    label = page.locator(".stage canvas").first.get_attribute("aria-label")
    assert label == "beauty of scenes/full.txt: A  double"
    assert page.evaluate("document.getAnimations().length") == 0


def test_without_a_map_of_flip_its_mode_is_grey_and_says_why(page: Any) -> None:
    button = page.locator('#v-modes [data-mode="flipmap"]')
    assert button.get_attribute("aria-disabled") == "true"
    assert "--flip" in button.get_attribute("title")
    page.keyboard.press("m")
    assert "whitted validate --flip" in page.locator("#v-how").inner_text()
    assert "mode=side" in page.locator("#v-stage").get_attribute("data-ready")


@pytest.mark.parametrize("small", [False, True])
def test_the_map_of_flip_is_a_mode(browser: Any, tmp_path: Path, need: Any, *, small: bool) -> None:
    need(importlib.util.find_spec("flip_evaluator"), "no flip-evaluator: pip install 'whitted[flip]'")
    report = Report(small=small)
    double = Double(draw=with_arrays(dented))
    result = validate({"full.txt": doubles.full()}, [double], "numpy-f64", on_rendered=report.add, flip=True)
    result.command = ["whitted", "validate", "full.txt"]
    flip = next(one.flip for one in result.comparisons if one.flip)
    page = opened(browser, report.write(tmp_path, result).as_uri())
    page.keyboard.press("m")
    settled(page, mode="flipmap")
    assert page.locator('#v-modes [data-mode="flipmap"]').get_attribute("aria-pressed") == "true"
    assert f"up to {flip.max:.3g}" in page.locator(".stage figcaption").inner_text()
    assert colors(page) > 5
    assert page.locator("#v-bar .ticks span").count() == 5
    page.locator("#v-pass").select_option("depth")
    settled(page, mode="flipmap", **{"pass": "depth"})
    assert "FLIP is of beauty alone" in page.locator("#v-how").inner_text()
    assert page.complaints == []
    page.close()


def test_nothing_is_wider_than_the_window(page: Any) -> None:
    for width, height in ((1280, 720), (1920, 1080)):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate("document.documentElement.scrollHeight") <= height
        assert page.locator(".stage canvas").first.bounding_box()["height"] > 200


def test_without_a_script_the_report_is_there(browser: Any, address: str) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(address)
    assert not page.locator("#viewer").is_visible()
    assert page.locator("#report h1").is_visible()
    assert page.locator("#report table.summary").first.is_visible()
    assert page.locator("#report details.pass[open] img").first.is_visible()
    context.close()


def test_an_image_of_another_size_is_not_shown_as_one_of_this(browser: Any, tmp_path: Path) -> None:
    def half(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> tracer.Passes:
        view = scene.view
        smaller = scene.replace(view=view.replace(columns=view.columns // 2, rows=view.rows // 2))
        return doubles.faithful(smaller, passes, settings)

    report = Report()
    result = validate({"full.txt": doubles.full()}, [Double(draw=half)], "numpy-f64", on_rendered=report.add)
    page = opened(browser, report.write(tmp_path, result).as_uri())
    assert "differs" in page.locator("#v-state").inner_text()
    whole(page)
    assert page.locator('td.value[data-renderer="double"]').count() == 0
    for key, mode in MODES.items():
        page.keyboard.press(key)
        settled(page, mode=mode)
    page.keyboard.press("b")
    settled(page, mode="side")
    assert "double has no beauty" in page.locator("#v-how").inner_text()
    assert colors(page) < 5, "nothing but what shines through"
    assert colors(page, 1) > 20
    page.locator("#v-stage").focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_function("document.getElementById('v-values').dataset.at")
    x, y = map(int, page.locator("#v-values").get_attribute("data-at").split(","))
    drawn = Reference("f64").render(doubles.full(), ("beauty",), Settings())["beauty"]
    assert [*values(page, "numpy-f64", "beauty").values()] == drawn[y, x].tolist()
    assert page.complaints == []
    page.close()


def test_of_what_truth_cannot_tell_the_inspector_says_so(browser: Any, tmp_path: Path) -> None:
    def untold(rendered: Any) -> None:
        verdicts = rendered.verdicts
        last = verdicts.verdicts.pop()
        verdicts.unproved.append((last.x, last.y))
        report.add(rendered)

    report = Report()
    result = validate({"full.txt": doubles.full()}, [Double(draw=with_arrays(dented))], "numpy-f64", on_rendered=untold)
    x, y = result.verdicts[0].unproved[0]
    page = opened(browser, report.write(tmp_path, result).as_uri())
    whole(page)
    link = re.sub("&at=[^&]*", "", page.locator("#v-stage").get_attribute("data-ready"))
    page.evaluate("hash => { location.hash = hash }", f"{link}&at={x},{y}")
    page.wait_for_function("at => document.getElementById('v-values').dataset.at === at", arg=f"{x},{y}")
    assert "could not be had" in page.locator("#v-values .verdict").inner_text()
    # In the list it counts with those that nothing explains.
    count = len(result.verdicts[0].verdicts) + 1
    found = page.evaluate(
        """async () => {
            const [{ result }, { run }] = await Promise.all([import("viewer/list.js"), import("viewer/data.js")]);
            return result(run.scenes[0], "", "").wrong;
        }"""
    )
    assert found == count
    page.close()


def test_a_small_report_has_pictures_alone_and_says_so(browser: Any, tmp_path: Path) -> None:
    page = opened(browser, written(tmp_path, small=True))
    for key, mode in MODES.items():
        page.keyboard.press(key)
        settled(page, mode=mode)
        assert ("no float data" in page.locator(".stage figcaption").first.inner_text()) == (mode == "diff")
        # Errors are few colors.
        assert mode == "diff" or colors(page) > (10 if mode == "heat" else 20), mode
    assert "--small" in page.locator("#v-values .missing").inner_text()
    assert page.locator("#v-values td.value").count() == 0
    assert "unexplained" in page.locator("#v-values .verdict").inner_text()
    assert page.locator("#v-exposure").is_disabled()
    assert page.locator('script[type^="application/octet-stream"]').count() == 0
    assert page.complaints == []
    page.close()


def test_numbers_of_the_inspector(page: Any) -> None:
    found = page.evaluate(
        """async () => {
            const { digits, ulps, level } = await import("viewer/inspector.js");
            return [digits(Math.fround(0.1), true), digits(0.1, false), digits(-0, true), digits(Infinity, true),
                ulps(1, 1 + 2 ** -52, true), ulps(1, 1 + 2 ** -23, false), ulps(0, 2 ** -149, false),
                ulps(-0, 0, false), level(0.999, false), level(-1, false), level(7, true)];
        }"""
    )
    assert found == ["0.1", "0.1", "-0", "∞", -1, -1, -1, 0, 254, 0, 255]


def test_what_float32_leaves_is_told_as_it_was_stored(page: Any) -> None:
    values = np.array([0.1, -0.1, 5e-324, -5e-324, 1e-46, -1e-46, 0.0, -0.0, np.inf, 1e300, -1 / 3])
    with np.errstate(over="ignore"):
        base = values.astype(np.float32)
    expected = floats._rest(values, base)[0].tolist()
    found = page.evaluate(
        """async values => {
            const { restOf } = await import("viewer/codec.js");
            const wide = new Float64Array(values.map(text => text === "inf" ? Infinity : Number(text)));
            return [...restOf(wide, new Float32Array(wide))];
        }""",
        [repr(float(value)) for value in values],
    )
    assert found == expected


def test_names_are_text(browser: Any, tmp_path: Path) -> None:
    name = "cmd:<img src=x onerror='document.title = 666'>"
    found = Report()
    result = validate({"<b>bold</b>": doubles.full()}, Double(name), "numpy-f64", on_rendered=found.add)
    result.command = ["whitted", "validate", "<i>"]
    page = opened(browser, found.write(tmp_path, result).as_uri())
    page.locator("#v-summary-open").click()
    whole(page)
    assert name in page.locator("#v-matrix").inner_text()
    assert page.locator("#viewer img[src=x], #viewer b b, #viewer i i").count() == 0
    assert page.title() != "666"
    assert page.complaints == []
    page.close()
