"""Verdicts: planted decisions and mistakes are told of whoever made them, and real differences are explained."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import planted
import pytest
from doubles import with_patch
from planted import Planted, otherwise

import tracer
from tracer.margins import analyse
from tracer.passes import names
from validation import Settings, Validation, renderers, validate
from validation.compare import json_value
from validation.verdict import Verdict

ADAPTORS = ["native-f64", "native-f32", "numpy-f64", "numpy-f32", "mitsuba-spec@llvm", "mitsuba-spec@scalar"]
LIGHT, SHADOW = 0, 1


@pytest.fixture(params=ADAPTORS)
def adaptor(request: Any, need: Any) -> Any:
    """Every real renderer."""
    renderer = renderers.get(request.param)
    need(renderer.unavailable() is None, str(renderer.unavailable()))
    return renderer


def against(renderer: Any) -> str:
    """Another renderer to compare it with."""
    return "numpy-f64" if renderer.name != "numpy-f64" else "native-f64"


def passes(scene: tracer.Scene) -> Any:
    """The scene by the reference."""
    return doubles.reference(scene, names(len(scene.lights), margins=False), Settings())


def interior(scene: tracer.Scene, chosen: Any) -> tuple[int, int]:
    """The pixel (column, row) of a mask that is farthest from every discontinuity."""
    margins = np.minimum.reduce(list(analyse(scene).margins.values()))
    y, x = np.unravel_index(np.where(chosen, margins, -1).argmax(), margins.shape)
    assert chosen[y, x]
    return int(x), int(y)


def roots(scene: tracer.Scene, place: tuple[int, int], sphere: int, light: int) -> list[float]:
    """Where the shadow ray of a pixel's hit meets a sphere, by the textbook's quadratic."""
    at = passes(scene)["position"][place[1], place[0]].astype(float)
    s = scene.spheres[sphere]
    o, d = (at - s.position) / s.scaling, (np.array(scene.lights[light].position) - at) / s.scaling
    return sorted(t.real for t in np.roots([d @ d, 2 * o @ d, o @ o - 1]) if not t.imag)


def judged(planted_: Any, scene: tracer.Scene, **options: Any) -> tuple[Validation, list[Verdict]]:
    """Both ways round: the verdicts are the same."""
    other = against(planted_)
    result = validate({"scene": scene}, planted_, other, settings=options.get("settings"))
    turned = validate({"scene": scene}, other, planted_, settings=options.get("settings"))
    found = [verdict for verdicts in result.verdicts for verdict in verdicts.verdicts]
    back = [verdict for verdicts in turned.verdicts for verdict in verdicts.verdicts]
    assert [(v.x, v.y, v.renderer.cause) for v in found] == [(v.x, v.y, v.reference.cause) for v in back]
    assert result.status == turned.status
    return result, found


def test_a_sphere_that_is_missed(adaptor: Any) -> None:
    scene = doubles.full()
    place = interior(scene, passes(scene)["id"] == 0)
    result, verdicts = judged(Planted(adaptor, otherwise([place], misses=0)), scene)
    (verdict,) = [v for v in verdicts if (v.x, v.y) == place]
    assert verdict.reference.right
    decision = verdict.renderer.decision
    assert decision is not None
    assert (verdict.renderer.renderer, verdict.renderer.cause, decision.sphere) == (adaptor.name, "unexplained", 0)
    assert decision.says.startswith("misses 'ball' at t = ")
    assert decision.t == pytest.approx(-passes(scene)["position"][place[1], place[0], 2], rel=1e-6)
    assert result.status == 1


def test_a_light_let_past_a_sphere(adaptor: Any) -> None:
    scene = doubles.full()
    seen = passes(scene)
    # On the floor, in the shadow of the ball.
    hidden = (seen["id"] == 2) & (seen["shadow.L0"] == 0)
    place = interior(scene, hidden)
    blocker = next(j for j in (0, 1) if any(1e-4 < t < 1 for t in roots(scene, place, j, 0)))
    _, verdicts = judged(Planted(adaptor, otherwise([place], light=0, hidden=False)), scene)
    (verdict,) = [v for v in verdicts if (v.x, v.y) == place]
    decision = verdict.renderer.decision
    assert verdict.reference.right
    assert decision is not None
    assert (verdict.renderer.renderer, verdict.renderer.cause) == (adaptor.name, "unexplained")
    assert (decision.light, decision.sphere) == (0, blocker)
    assert decision.says.startswith(f"lets light 'left' past '{scene.spheres[blocker].name}'")
    assert decision.t is not None
    assert min(abs(t - decision.t) for t in roots(scene, place, blocker, 0)) < 1e-6


def test_a_light_that_is_hidden_by_nothing(adaptor: Any) -> None:
    scene = doubles.full()
    seen = passes(scene)
    place = interior(scene, (seen["id"] == 2) & (seen["shadow.L1"] == 1))
    _, verdicts = judged(Planted(adaptor, otherwise([place], light=1, hidden=True)), scene)
    (verdict,) = [v for v in verdicts if (v.x, v.y) == place]
    assert verdict.reference.right
    assert (verdict.renderer.renderer, verdict.renderer.explained) == (adaptor.name, False)
    assert verdict.renderer.decision is not None
    assert verdict.renderer.decision.light == 1


MISTAKES = {
    "ignores the near plane": (with_patch(nearest=planted.no_near_plane), doubles.cut),
    "lets the near plane": (with_patch(nearest=planted.near_plane_everywhere), doubles.full),
    "keeps the outward normal": (with_patch(surface=planted.never_flipped), doubles.cut),
    "divides the normal by the scaling once": (with_patch(surface=planted.wrong_normals), doubles.full),
    "takes the normal of a sphere": (with_patch(surface=planted.sphere_normals), doubles.full),
    "casts no shadows": (with_patch(hidden=planted.no_shadows), doubles.full),
    "lets no sphere shadow itself": (with_patch(hidden=planted.no_own_shadow), doubles.cave),
    "lets spheres behind a light hide it": (with_patch(hidden=planted.beyond_the_light), doubles.cave),
    "takes N.H in the place of R.V": (with_patch(incidence=planted.blinn), doubles.full),
    "multiplies the highlight by the sphere's color": (with_patch(illuminate=planted.colored_highlight), doubles.full),
    "multiplies the highlight by N.L": (with_patch(illuminate=planted.fading_highlight), doubles.cut),
    "lets light fall off": (with_patch(illuminate=planted.squared), doubles.cut),
    "clamps what a mirror shows": (with_patch(illuminate=planted.clamped), doubles.full),
    "shows BACK where a reflected ray": (planted.mirrored_background, doubles.full),
}


@pytest.mark.parametrize("says", MISTAKES)
@pytest.mark.parametrize("name", ["native-f64", "mitsuba-spec@llvm"])
def test_a_mistake_is_named(name: str, says: str, need: Any) -> None:
    renderer = renderers.get(name)
    need(renderer.unavailable() is None, str(renderer.unavailable()))
    draw, scene = MISTAKES[says]
    result = validate({"scene": scene()}, Planted(renderer, draw), "numpy-f64", verdicts=12)
    findings = [verdict.renderer for verdicts in result.verdicts for verdict in verdicts.verdicts]
    told = [finding for finding in findings if finding.cause == "mistake" and says in finding.because]
    assert len(told) >= 0.75 * len([finding for finding in findings if not finding.right]) > 0
    assert all(verdict.reference.right for verdicts in result.verdicts for verdict in verdicts.verdicts)
    assert result.status == 1


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"sample": "center"}, "samples at the centre of the pixels"),
        ({"shadow_epsilon": 0.01}, "begins shadow rays at t > 0.01, not 0.0001"),
        ({"max_reflections": 1}, "reflects 1 times, not 3"),
    ],
)
def test_other_settings_are_named(changes: dict[str, Any], says: str, root: Path) -> None:
    scene = doubles.full()
    if "shadow_epsilon" in changes:
        scene = tracer.load(root / "scenes" / "spec" / "shadow-epsilon.txt")
        scene = scene.replace(view=scene.view.replace(columns=100, rows=100))
    double = doubles.Double(draw=doubles.with_settings(**changes))
    result = validate({"scene": scene}, double, "numpy-f64", verdicts=12)
    found = [verdict.renderer.because for verdicts in result.verdicts for verdict in verdicts.verdicts]
    assert sum(says in because for because in found) >= 0.75 * len(found) > 0


def test_what_is_in_no_catalogue_is_unexplained() -> None:
    def brighter(arrays: doubles.Arrays) -> None:
        arrays["diffuse"] *= 1.01

    double = doubles.Double(draw=doubles.with_arrays(brighter, recompose=True))
    result = validate({"scene": doubles.full()}, double, "numpy-f64", verdicts=12)
    for verdicts in result.verdicts:
        for verdict in verdicts.verdicts:
            assert (verdict.renderer.cause, verdict.reference.right) == ("unexplained", True)
    assert result.status == 1


def test_a_sample_is_said_to_be_one() -> None:
    double = doubles.Double(draw=with_patch(hidden=planted.no_shadows))
    (verdicts,) = validate({"scene": doubles.full()}, double, "numpy-f64", verdicts=5).verdicts
    assert len(verdicts.verdicts) == 5 < verdicts.differ
    record = json_value(verdicts.record())
    assert (record["differ"], record["judged"], record["explained"]) == (verdicts.differ, 5, False)
    assert sum(len(group["pixels"]) for group in record["groups"]) >= 5
    json.dumps(record, allow_nan=False)


@pytest.mark.mitsuba
@pytest.mark.parametrize("reference", ["native-f32", "numpy-f32", "mitsuba-spec@llvm"])
def test_every_difference_on_the_bundled_scenes_is_explained(reference: str, root: Path, need: Any) -> None:
    renderer = renderers.get(reference)
    need(renderer.unavailable() is None, str(renderer.unavailable()))
    # Where something differs at the scenes' own size; the others are compared in other tests.
    gallery, spec = ("lantern", "nested", "planets"), ("equal-hits", "light-inside", "touching-spheres", "beyond-light")
    files = [root / "scenes" / "gallery" / f"{name}.txt" for name in gallery]
    files += [root / "scenes" / "spec" / f"{name}.txt" for name in spec]
    result = validate(files, "native-f64", renderer)
    assert result.status == 0
    found = [verdict for verdicts in result.verdicts for verdict in verdicts.verdicts]
    assert found
    for verdict in found:
        assert verdict.explained
        assert verdict.renderer.right, "native-f64 is off"


def test_a_reflected_tie_that_nothing_settles_may_go_either_way() -> None:
    # Two spheres behind the eye, equally far for the ray that the mirror throws back.
    text = doubles.FULL.splitlines()
    lines = [line for line in text if not line.startswith(("SPHERE", "RES", "LEFT", "RIGHT", "BOTTOM", "TOP"))]
    lines += ["LEFT -1", "RIGHT 1", "BOTTOM -1", "TOP 1", "RES 4 4"]
    lines += ["SPHERE mirror 0 0 -5 1 1 1 1 1 1 .1 .5 0 1 1"]
    lines += ["SPHERE small 0 0 5 2 2 2 1 .5 1 .1 .5 0 0 1", "SPHERE large 0 0 6 3 3 3 .2 .5 1 .1 .5 0 0 1"]
    scene = tracer.loads("\n".join(lines))
    swapped = doubles.with_scene(lambda s: s.replace(spheres=(s.spheres[0], s.spheres[2], s.spheres[1])))

    def draw(scene: tracer.Scene, passes: Any, settings: Settings) -> Any:
        arrays = dict(doubles.faithful(scene, passes, settings))
        for name in ("reflection", "reflection.1", "beauty"):
            arrays[name] = swapped(scene, passes, settings)[name]
        return tracer.Passes(arrays)

    result = validate({"scene": scene}, doubles.Double(draw=draw), "numpy-f64")
    (verdict,) = [verdict for verdicts in result.verdicts for verdict in verdicts.verdicts]
    assert (verdict.x, verdict.y) == (2, 2)
    assert verdict.explained
    assert any(not tie.settled for tie in verdict.truth.ties)
