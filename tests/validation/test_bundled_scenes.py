"""The bundled scenes, pass by pass, against Mitsuba in both variants."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import tracer
from tracer.passes import names
from validation import renderers, validate
from validation.run import resized, shrink

pytestmark = pytest.mark.mitsuba

FOLDER = Path(__file__).resolve().parents[2] / "scenes"
FILES = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.glob("*/*.txt"))
#: Mitsuba's loop over single rays takes about a millisecond a pixel where there are mirrors.
PIXELS = {"llvm": 40_000, "scalar": 2_500}


def test_the_scenes_are_there() -> None:
    assert {name.split("/")[0] for name in FILES} == {"gallery", "hard", "spec"}


@pytest.mark.filterwarnings("ignore::tracer.SceneWarning")
@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("backend", PIXELS)
def test_every_pass_agrees_with_mitsuba(name: str, backend: str, need: Callable[[object, str], None]) -> None:
    reference = renderers.get(f"mitsuba-spec@{backend}")
    need(reference.unavailable() is None, str(reference.unavailable()))
    scene = tracer.load(FOLDER / name)
    scene = resized(scene, shrink(scene.view.columns, scene.view.rows, PIXELS[backend]))
    result = validate({name: scene}, "native-f64", reference)
    assert not result.failures
    assert not result.notes
    assert [comparison.pass_name for comparison in result.comparisons] == list(names(len(scene.lights), margins=False))
    assert [comparison.reasons for comparison in result.comparisons if not comparison.ok] == []
