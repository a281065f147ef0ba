"""How passes and comparisons show themselves in a notebook."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET

import doubles
import numpy as np
import pytest
from PIL import Image

import tracer
from tracer.passes import Passes
from validation import validate
from validation.compare import Comparison, compare_plain


@pytest.fixture
def drawn() -> Passes:
    scene = tracer.loads(doubles.FULL)
    return tracer.render(scene, tracer.passes.names(len(scene.lights), margins=False))


def parsed(text: str) -> ET.Element:
    """It is well-formed, whatever is in it."""
    return ET.fromstring(re.sub(r"<img ([^>]*)>", r"<img \1/>", text))


def picture(image: ET.Element) -> Image.Image:
    head, _, data = image.attrib["src"].partition(",")
    assert head == "data:image/png;base64"
    return Image.open(io.BytesIO(base64.b64decode(data)))


def test_every_pass_has_a_picture_and_its_range(drawn: Passes) -> None:
    drawn.metadata["renderer"] = "cmd:<mine> & yours"
    page = parsed(drawn._repr_html_())
    about = page.find("p")
    assert about is not None
    assert about.text == f"64×48, {len(drawn)} passes by cmd:<mine> & yours"
    captions = ["".join(caption.itertext()) for caption in page.iter("figcaption")]
    assert [text.split()[0] for text in captions] == list(drawn)
    for image in page.iter("img"):
        assert picture(image).size == (64, 48)
        assert image.attrib["alt"]
    depth = drawn["depth"][np.isfinite(drawn["depth"])]
    assert f"depth float64, {depth.min():.4g} to {depth.max():.4g}" in captions
    beauty = next(image for image in page.iter("img") if image.attrib["alt"].startswith("beauty"))
    assert (np.asarray(picture(beauty)) == tracer.passes.quantise(drawn["beauty"])).all()


def test_near_is_bright_and_what_is_hit_is_not_black(drawn: Passes) -> None:
    page = parsed(Passes({name: drawn[name] for name in ("depth", "id")})._repr_html_())
    depth, spheres = (np.asarray(picture(image)).astype(int) for image in page.iter("img"))
    hit = drawn["id"] >= 0
    for levels in (depth, spheres):
        assert (levels[~hit] == 0).all()
        assert (levels[hit] > 0).all()
    near, far = drawn["depth"][hit].argmin(), drawn["depth"][hit].argmax()
    assert depth[hit][near] > depth[hit][far]


def test_of_large_and_odd_ones() -> None:
    large = Passes({"beauty": np.zeros((10, 1000, 3)), "depth": np.full((10, 1000), np.inf)})
    page = parsed(large._repr_html_())
    assert {picture(image).size for image in page.iter("img")} == {(200, 2)}
    assert "no finite value" in large._repr_html_()
    assert "0×0, 0 passes" in Passes({})._repr_html_()
    parsed(Passes({"beauty": np.full((2, 2, 3), np.nan), "depth": np.ones((2, 2))})._repr_html_())


def cells(comparison: Comparison) -> dict[str, str]:
    page = parsed(comparison._repr_html_())
    return {row[0].text or "": row[1].text or "" for row in page.iter("tr")}


def test_a_comparison_has_its_numbers_and_a_map(drawn: Passes) -> None:
    other = Passes({"beauty": drawn["beauty"].copy()})
    other._arrays["beauty"][20, 30, 1] += 0.25
    found = compare_plain(drawn, other, "beauty", 0.0, renderer="<a>", reference="b")
    shown = cells(found)
    assert shown["beauty"] == "64×48: <a> against b"
    assert shown["result"].startswith("✗ DIFFER: 1 of 3072 interior pixels over tolerance")
    assert shown["max error"] == "0.25"
    assert shown["worst pixel"].startswith("x 30, y 20 G: ")
    assert {"PSNR", "CIEDE2000", "p99.9"} <= set(shown)
    (image,) = parsed(found._repr_html_()).iter("img")
    assert picture(image).size == (64, 48)
    assert image.attrib["alt"] == "errors of beauty, up to 0.25"


def test_what_agrees_and_what_could_not_be_compared(drawn: Passes) -> None:
    assert cells(compare_plain(drawn, drawn, "depth", 0.0))["result"] == "✓ agree"
    missing = cells(compare_plain(drawn, Passes({"beauty": drawn["beauty"]}), "depth", 0.0))
    assert missing["result"] == "✗ DIFFER: b did not deliver the pass 'depth'"
    assert "max error" not in missing


def test_of_a_validation_the_numbers_alone() -> None:
    scene = tracer.loads(doubles.FULL)
    result = validate({"a scene": scene}, "native-f32", "native-f64", passes=["beauty"], size=(16, 12))
    (comparison,) = result.comparisons
    assert cells(comparison)["beauty"] == "a scene 16×12: native-f32 against native-f64"
    assert "<img" not in comparison._repr_html_()
