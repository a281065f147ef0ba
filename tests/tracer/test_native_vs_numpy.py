"""The C++ renderer against the NumPy reference, with which it shares nothing but the scene."""

from __future__ import annotations

import functools
import warnings
from pathlib import Path

import numpy as np
import pytest
import scene_zoo as zoo
from agreement import Agreement, all_passes, compare

import tracer
from tracer import Scene, reference
from tracer.margins import EDGE_ROUNDINGS, VALUE_ROUNDINGS, Analysis, analyse
from tracer.passes import SAMPLES, Passes

FOLDER = Path(__file__).resolve().parents[2] / "scenes"
FILES = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.glob("*/*.txt"))
UNIT = {"f64": 2.0**-53, "f32": 2.0**-24}
RANDOM = [f"{kind}-{seed}" for kind in ("ordinary", "wild") for seed in range(100)]


def load(name: str) -> Scene:
    """A scene of the zoo, or a file of the project's own scenes at no more than 200 x 200."""
    if name in zoo.hard():
        return zoo.hard()[name]
    kind, _, seed = name.partition("-")
    if kind in ("ordinary", "wild") and seed.isdigit():
        return (zoo.ordinary if kind == "ordinary" else zoo.wild)(int(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tracer.errors.SceneWarning)
        scene = tracer.load(FOLDER / name)
    view = scene.view
    shrink = max(1, -(-max(view.columns, view.rows) // 200))
    return scene.replace(view=view.replace(columns=-(-view.columns // shrink), rows=-(-view.rows // shrink)))


@functools.lru_cache(maxsize=2)
def expected(name: str) -> tuple[Analysis, Passes]:
    """What the reference makes of a scene, kept for the other precision."""
    scene = load(name)
    return analyse(scene), reference.render(scene, all_passes(scene))


def check(found: Agreement) -> None:
    """Interior values within tolerance, both sides' errors together; decisions flip at edges only."""
    assert found.worst <= VALUE_ROUNDINGS, found.where
    assert found.flipped <= EDGE_ROUNDINGS


def test_the_scenes_are_there() -> None:
    assert len([name for name in FILES if name.startswith("gallery/")]) >= 5
    assert len([name for name in FILES if name.startswith("spec/")]) >= 20


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("name", [*FILES, *zoo.hard(), *RANDOM])
def test_agreement(name: str, precision: tracer.reference.Precision) -> None:
    analysis, truth = expected(name)
    scene = load(name)
    image = tracer.render(scene, all_passes(scene), precision=precision)
    found = compare(image, truth, analysis, UNIT["f64"] + UNIT[precision], EDGE_ROUNDINGS)
    check(found)
    # Else margins of 0 would excuse everything. Thin curves, no longer than what encloses the spheres' pictures, have
    # no more pixels; in float32 the ground's horizon is no thin curve: docs/tolerances.md, section 9.
    if (name, precision) != ("ground", "f32"):
        assert found.edges <= analysis.outline + 2 * sum(truth.shape)


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("bounces", [0, 1, 5])
def test_agreement_under_other_settings(sample: reference.Sample, bounces: int) -> None:
    settings = {"sample": sample, "shadow_epsilon": 0.01 * bounces, "max_reflections": bounces}
    for name in ("mutual", "eye-inside", "crossing"):
        scene = load(name)
        names = tracer.passes.names(len(scene.lights), bounces, margins=False)
        image, truth = tracer.render(scene, names, **settings), reference.render(scene, names, **settings)
        check(compare(image, truth, analyse(scene, **settings), 2 * UNIT["f64"], EDGE_ROUNDINGS))


def test_a_planted_error_is_found() -> None:
    # A shadow epsilon, a bounce fewer, lights brighter by a part in 10^13: each exceeds the tolerance.
    analysis, truth = expected("eye-inside")
    scene = load("eye-inside")
    for changes in ({"shadow_epsilon": 0.2}, {"max_reflections": 2}, {"sample": "center"}):
        image = tracer.render(scene, all_passes(scene), **changes)
        with pytest.raises(AssertionError):
            check(compare(image, truth, analysis, 2 * UNIT["f64"], EDGE_ROUNDINGS))
    brighter = [p.replace(intensity=tuple(c * (1 + 1e-13) for c in p.intensity)) for p in scene.lights]
    image = tracer.render(scene.replace(lights=brighter), all_passes(scene))
    with pytest.raises(AssertionError):
        check(compare(image, truth, analysis, 2 * UNIT["f64"], EDGE_ROUNDINGS))
    assert np.isfinite(truth["beauty"]).all()
