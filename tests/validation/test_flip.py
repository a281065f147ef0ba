"""FLIP, where flip-evaluator is installed: its numbers, its map in the report, and what is said where it is not."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import NATIVE, one_pixel
from conftest import strict
from doubles import Double, with_arrays

from validation import metrics


@pytest.fixture(autouse=True)
def flip_evaluator(request: pytest.FixtureRequest, need: Any) -> None:
    """All but the last test need it."""
    if "without" not in request.node.name:
        need(importlib.util.find_spec("flip_evaluator"), "no flip-evaluator: pip install 'whitted[flip]'")


def test_flip_of_images() -> None:
    a = np.zeros((40, 60, 3))
    b = a.copy()
    b[10, 20] = 1
    same, one = metrics.flip(a, a), metrics.flip(a, b)
    assert (same.max, same.mean) == (0, 0)
    assert one.map.shape == (40, 60)
    assert np.unravel_index(one.map.argmax(), one.map.shape) == (10, 20)
    assert 0.1 < one.max <= 1
    assert one.mean == pytest.approx(one.map.mean())
    # Black against white everywhere is the most there can be.
    assert metrics.flip(a, np.ones_like(a)).mean == pytest.approx(1, abs=0.05)


def test_in_the_results_and_in_the_report(run: Any, scene: Path, tmp_path: Path, registered: Any) -> None:
    registered(Double(draw=with_arrays(one_pixel)))
    sides = ("--renderer", "double", "--against", "native-f64", "--passes", "beauty,depth")
    file, page = tmp_path / "r.json", tmp_path / "report" / "index.html"
    run("validate", scene, *sides, "--flip", "--json", file, "--report", page.parent)
    beauty, depth = strict(file.read_text())["comparisons"]
    assert 0 < beauty["flip"]["mean"] < beauty["flip"]["max"] <= 1
    assert "flip" not in depth
    text = page.read_text()
    assert re.search(r'alt="FLIP of beauty of [^"]*full.txt, up to 0[.]\d+"', text)
    assert "<dt>FLIP</dt><dd>up to 0." in text
    assert "<b>FLIP</b><br>magma, from black, 0, to light, 1" in text
    run("validate", scene, *sides, "--json", file, "--report", page.parent)
    assert "flip" not in strict(file.read_text())["comparisons"][0], "only where it is asked for"
    assert "FLIP of" not in page.read_text()


def test_of_two_files(run: Any, scene: Path, tmp_path: Path) -> None:
    for name, more in (("a", ()), ("b", ("--max-reflections", "0"))):
        assert run("render", scene, "-o", tmp_path / f"{name}.npz", "--passes", "beauty", *more).status == 0
    file = tmp_path / "r.json"
    assert run("compare", tmp_path / "a.npz", tmp_path / "b.npz", "--flip", "--json", file).status == 1
    assert strict(file.read_text())["comparisons"][0]["flip"]["max"] > 0


def test_without_it_what_to_install_is_said(run: Any, scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "flip_evaluator" else real(name))
    result = run("validate", scene, *NATIVE, "--flip")
    assert (result.status, result.out) == (2, "")
    assert result.err == (
        "error: --flip needs flip-evaluator, which is not installed\n  hint: pip install 'whitted[flip]'\n"
    )
