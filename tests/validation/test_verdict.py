"""Plants wrong decisions in every renderer: the judge has to name the renderer, the decision and the cause."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import random
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import doubles
import numpy as np
import planted
import pytest
from doubles import Double, with_arrays, with_patch, with_scene
from planted import Planted, otherwise

import tracer
import tracer.margins
from tracer.margins import Analysis
from tracer.passes import Passes, names
from validation import Settings, Validation, court, exact, parting, renderers, terminal, validate
from validation.flips import flips
from validation.follow import Follower, Key
from validation.renderers import Renderer, Uncertainty
from validation.renderers.mitsuba import driver
from validation.run import resized, scene_files
from validation.truth import Prover, UnprovedError
from validation.verdict import Court, Finding, Side, Verdict, Verdicts

NAMES = ("native-f64", "native-f32", "numpy-f64", "numpy-f32", "mitsuba-spec@llvm", "mitsuba-spec@scalar")


def marked(*values: str) -> Any:
    """A parameter whose last value is the name of a renderer."""
    return pytest.param(*values, marks=[pytest.mark.mitsuba] if values[-1].startswith("mitsuba") else [])


Need = Callable[[object, str], None]


@pytest.fixture(params=[marked(name) for name in NAMES])
def real(request: pytest.FixtureRequest, need: Need) -> Renderer:
    """Every renderer there is."""
    renderer = renderers.get(request.param)
    need(renderer.unavailable() is None, str(renderer.unavailable()))
    return renderer


def beside(renderer: Renderer) -> str:
    """A faithful renderer of another name."""
    return "numpy-f64" if renderer.name == "native-f64" else "native-f64"


@functools.cache
def full() -> tracer.Scene:
    """Three mirrors and two lights."""
    return resized(doubles.full(), (32, 24))


@functools.cache
def cut() -> tracer.Scene:
    """A sphere cut by the near plane, with a light inside."""
    return resized(doubles.cut(), (24, 24))


@functools.cache
def cave() -> tracer.Scene:
    """The eye inside a sphere."""
    return resized(doubles.cave(), (16, 16))


@functools.cache
def contact() -> tracer.Scene:
    """Shadows that begin at their blocker, and one that comes from far."""
    kite = "SPHERE kite 3.09 2.97 -4.82 0.1 0.1 0.1 0.9 0.9 0.9 0.1 0.8 0 0 1\nLIGHT sun"
    return tracer.loads(doubles.CONTACT.replace("LIGHT sun", kite))


@functools.cache
def analysis(scene: tracer.Scene) -> Analysis:
    """Margins and sensitivities."""
    return tracer.margins.analyse(scene)


def only(result: Validation) -> Verdicts:
    """The verdicts of the one scene and pair."""
    assert not result.failures
    (verdicts,) = result.verdicts
    return verdicts


def side(renderer: Renderer, scene: tracer.Scene) -> Side:
    """What a renderer draws and claims."""
    every = [name for name in renderer.passes(scene, Settings()) if not name.startswith("margin.")]
    claim = renderer.uncertainty(scene, Settings(), analysis(scene))
    return Side(renderer, renderer.render(scene, every, Settings()), claim)


def find(renderer: Renderer, scene: tracer.Scene, x: int, y: int, *, ties: bool = True) -> Finding:
    """What the judge finds about one pixel."""
    judge = Court(scene, Settings(), analysis(scene))
    of = side(renderer, scene)
    return judge.find(judge.prover.pixel(x, y, ties=ties), of, tuple(of.passes))


def interior(scene: tracer.Scene, condition: np.ndarray[Any, Any], least: float = 1e-3) -> tuple[int, int]:
    """A pixel (column, row) far from every decision."""
    margins = analysis(scene).margins
    far = np.min([margins[kind] for kind in margins], axis=0) > least
    found = np.argwhere(condition & far)
    y, x = found[len(found) // 2]
    return int(x), int(y)


# ---- known mistakes, all over the image


class Mistake(NamedTuple):
    """What is planted, in which scene, and the rule that the judge names."""

    plant: Mapping[str, Any]
    rule: str
    scene: Callable[[], tracer.Scene] = full
    kinds: frozenset[str] = frozenset({"value"})  # of the decisions that part, one of them at least


def patched(**changed: Callable[..., Any]) -> dict[str, Any]:
    return {"wrong": with_patch(**changed)}


def told(**changes: Any) -> dict[str, Any]:
    return {"settings": lambda settings: dataclasses.replace(settings, **changes)}


VALUE, HIT, RANGE, TERMINATOR = (frozenset({kind}) for kind in ("value", "silhouette", "range", "terminator"))

MISTAKES = {
    "normals": Mistake(patched(surface=planted.wrong_normals), "divides the normal by the scaling once, not twice"),
    "sphere normals": Mistake(
        patched(surface=planted.sphere_normals), "takes the normal of a sphere for that of an ellipsoid"
    ),
    "inside": Mistake(
        patched(surface=planted.never_flipped), "keeps the outward normal on the inside of a sphere", cut, TERMINATOR
    ),
    "shadow epsilon": Mistake(
        told(shadow_epsilon=1e-2), "begins shadow rays at t > 0.01, not 0.0001", contact, RANGE | HIT
    ),
    "shadows": Mistake(patched(hidden=planted.no_shadows), "casts no shadows", full, RANGE | HIT),
    "own shadow": Mistake(patched(hidden=planted.no_own_shadow), "lets no sphere shadow itself", cave, RANGE),
    "behind the light": Mistake(
        patched(hidden=planted.beyond_the_light), "lets spheres behind a light hide it", cut, RANGE
    ),
    "centre": Mistake(told(sample="center"), "samples at the centre of the pixels"),
    "bottom left": Mistake(told(sample="bottom-left"), "samples at the bottom-left corner of the pixels"),
    "inclusive": Mistake(
        told(sample="inclusive"), "samples from the first column and row to the last, both on the border"
    ),
    "short": Mistake(told(max_reflections=2), "reflects 2 times, not 3", full, RANGE),
    "long": Mistake(told(max_reflections=4), "reflects 4 times, not 3", full, RANGE),
    "clamped": Mistake(patched(illuminate=planted.clamped), "clamps what a mirror shows to 1"),
    "Blinn": Mistake(patched(incidence=planted.blinn), "takes N.H in the place of R.V"),
    "falloff": Mistake(patched(illuminate=planted.squared), "lets light fall off with the square of the distance", cut),
    "colour": Mistake(patched(illuminate=planted.colored_highlight), "multiplies the highlight by the sphere's color"),
    "fading": Mistake(patched(illuminate=planted.fading_highlight), "multiplies the highlight by N.L", cut),
    "near plane": Mistake(
        patched(nearest=planted.no_near_plane),
        "ignores the near plane: primary hits count from t > 0 on",
        cut,
        RANGE,
    ),
    "near plane in mirrors": Mistake(
        patched(nearest=planted.near_plane_everywhere),
        "lets the near plane, t > 1, limit reflected rays too",
        full,
        RANGE,
    ),
    "BACK": Mistake({"wrong": planted.mirrored_background}, "shows BACK where a reflected ray hits nothing"),
}


def blamed(verdicts: Verdicts, name: str, mistake: Mistake, *, place: int) -> None:
    """Every pixel is that mistake of that renderer, and the other one, at `place`, is right."""
    assert not verdicts.explained
    kinds = set()
    for entry in verdicts.verdicts:
        wrong, right = (entry.findings[1 - place], entry.findings[place])
        assert right.right, right
        assert (wrong.renderer, wrong.cause) == (name, "mistake"), wrong
        assert wrong.because == f"truth makes this pixel if it {mistake.rule}"
        assert wrong.decision is not None
        kinds.add(wrong.decision.kind)
    assert kinds & mistake.kinds, kinds


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_and_blamed_on_who_makes_it(name: str, real: Renderer) -> None:
    mistake = MISTAKES[name]
    result = validate({"scene": mistake.scene()}, Planted(real, **mistake.plant), beside(real), verdicts=3)
    assert result.status == 1
    blamed(only(result), real.name, mistake, place=1)


@pytest.mark.parametrize(
    ("name", "adaptor"), [marked(*pair) for pair in zip(MISTAKES, NAMES * len(MISTAKES), strict=False)]
)
def test_the_reference_is_blamed_in_its_place(name: str, adaptor: str, need: Need) -> None:
    real = renderers.get(adaptor)
    need(real.unavailable() is None, str(real.unavailable()))
    mistake = MISTAKES[name]
    result = validate({"scene": mistake.scene()}, beside(real), Planted(real, **mistake.plant), verdicts=3)
    assert result.status == 1
    blamed(only(result), real.name, mistake, place=0)


#: In Mitsuba's own driver.
DRIVER: dict[str, tuple[Any, str, Mistake]] = {
    "near plane": (driver, "_eye_rays", MISTAKES["near plane"]),
    "own shadow": (driver.Driver, "at_start", MISTAKES["own shadow"]),
    "shadows": (driver.Driver, "lights", MISTAKES["shadows"]),
}


def in_the_driver(name: str) -> Callable[..., Any]:
    """What stands there instead."""
    eye_rays, lights = driver._eye_rays, driver.Driver.lights

    def nearer(*arguments: Any) -> Any:
        """Rays start at t = 0.001."""
        return eye_rays(*arguments) / 1000

    def own(_: Any, start: driver.Start, direction: Any, hits: Any) -> Any:
        """No hit of the sphere that a ray starts on counts."""
        del direction
        return hits.sphere == start.sphere[hits.ray]

    def visible(self: driver.Driver, *arguments: Any) -> Iterator[Any]:
        """Every light is."""
        for direction, cosine, seen in lights(self, *arguments):
            yield direction, cosine, np.ones_like(seen)

    return {"near plane": nearer, "own shadow": own, "shadows": visible}[name]


@pytest.mark.mitsuba
@pytest.mark.parametrize("backend", ["llvm", "scalar"])
@pytest.mark.parametrize("name", DRIVER)
def test_a_mistake_in_the_driver_of_mitsuba(name: str, backend: str, need: Need) -> None:
    real = renderers.get(f"mitsuba-spec@{backend}")
    need(real.unavailable() is None, str(real.unavailable()))
    place, function, mistake = DRIVER[name]
    with mock.patch.object(place, function, in_the_driver(name)):
        result = validate({"scene": mistake.scene()}, "native-f64", real, verdicts=3)
    blamed(only(result), real.name, mistake, place=0)


# ---- one decision of one pixel: nothing explains it, but the judge says which, with numbers worked out otherwise


def roots(scene: tracer.Scene, sphere: int, origin: Sequence[float], direction: Sequence[float]) -> list[float]:
    """Where a line meets a sphere, by the textbook."""
    of = scene.spheres[sphere]
    o = (np.array(origin) - of.position) / of.scaling
    d = np.array(direction) / of.scaling
    found = np.roots([d @ d, 2 * o @ d, o @ o - 1])
    return sorted(float(root.real) for root in found if abs(root.imag) < 1e-9)


def ray(scene: tracer.Scene, x: int, y: int) -> np.ndarray[Any, Any]:
    """Of a pixel."""
    view = scene.view
    across = view.left + (view.right - view.left) * x / view.columns
    return np.array((across, view.top - (view.top - view.bottom) * y / view.rows, -view.near))


def reflected(scene: tracer.Scene, at: Passes, x: int, y: int) -> np.ndarray[Any, Any]:
    """The mirror's ray of a pixel."""
    d, normal = ray(scene, x, y), at["normal"][y, x]
    turned: np.ndarray[Any, Any] = d - 2 * (d @ normal) * normal
    return turned


def drawn(scene: tracer.Scene) -> Passes:
    """All of it, faithfully."""
    return doubles.reference(scene, names(len(scene.lights), 3, margins=False), Settings())


def between(found: Sequence[float]) -> float:
    """The root that hides a light."""
    return min(root for root in found if 1e-4 < root < 1)


class Planting(NamedTuple):
    """A pixel, how one decision of it is planted, and what the judge has to say."""

    scene: tracer.Scene
    place: tuple[int, int]
    draw: planted.Draw
    kind: set[str]
    says: str
    bounce: int = 0
    sphere: int | None = None
    light: int | None = None
    t: float | None = None


def missed_sphere() -> Planting:
    """The ball is missed, and the floor behind it seen."""
    scene = full()
    at, without = drawn(scene), drawn(scene.replace(spheres=scene.spheres[1:]))
    x, y = interior(scene, (at["id"] == 0) & (without["id"] == 1), 1e-4)
    t = roots(scene, 0, (0, 0, 0), ray(scene, x, y))[0]
    draw = otherwise([(x, y)], misses=0)
    return Planting(scene, (x, y), draw, {"silhouette", "order"}, "misses 'ball' at t = ", sphere=0, t=t)


def missed_all() -> Planting:
    """The egg is missed, and BACK seen."""
    scene = full()
    at, without = drawn(scene), drawn(scene.replace(spheres=[scene.spheres[0], scene.spheres[2]]))
    x, y = interior(scene, (at["id"] == 1) & (without["id"] < 0))
    t = roots(scene, 1, (0, 0, 0), ray(scene, x, y))[0]
    return Planting(scene, (x, y), otherwise([(x, y)], misses=1), {"silhouette"}, "misses 'egg' at t = ", sphere=1, t=t)


def lost_shadow() -> Planting:
    """A light comes past the ball."""
    scene = full()
    at = drawn(scene)
    L = np.array(scene.lights[0].position)
    past = np.zeros(at["id"].shape, bool)
    for y, x in np.argwhere((at["id"] == 2) & (at["shadow.L0"] == 0) & analysis(scene).lit[0]):
        x_ = at["position"][y, x]
        ball = [t for t in roots(scene, 0, x_, L - x_) if 0.01 < t < 0.99]
        past[y, x] = bool(ball) and not [t for t in roots(scene, 1, x_, L - x_) if 0 < t < 1]
    x, y = interior(scene, past, 1e-4)
    t = between(roots(scene, 0, at["position"][y, x], L - at["position"][y, x]))
    draw = otherwise([(x, y)], light=0, hidden=False)
    says = "lets light 'left' past 'ball' at t = "
    return Planting(scene, (x, y), draw, {"silhouette", "range"}, says, sphere=0, light=0, t=t)


def more_shadow() -> Planting:
    """A light is hidden, though nothing is in its way: by the sphere that is nearest to be."""
    scene = full()
    at = drawn(scene)
    x, y = interior(scene, (at["id"] == 2) & (at["shadow.L1"] == 1) & (at["diffuse"].sum(axis=-1) > 0.1))
    draw = otherwise([(x, y)], light=1, hidden=True)
    return Planting(scene, (x, y), draw, {"silhouette", "range"}, "hides light 'right' behind ", light=1)


def lost_own_shadow() -> Planting:
    """The inside of the cave is lit from outside, at one place."""
    scene = cave()
    at = drawn(scene)
    x, y = interior(scene, (at["id"] == 0) & (at["shadow.L0"] == 0) & analysis(scene).lit[0])
    where = at["position"][y, x]
    t = between(roots(scene, 0, where, np.array(scene.lights[0].position) - where))
    draw = otherwise([(x, y)], light=0, hidden=False)
    return Planting(scene, (x, y), draw, {"range"}, "lets light 'moon' past 'cave' at t = ", sphere=0, light=0, t=t)


def turned_away() -> Planting:
    """A light before the surface is taken to be behind it."""
    scene = full()
    at = drawn(scene)
    x, y = interior(scene, (at["id"] == 2) & (at["shadow.L0"] == 1) & (at["diffuse"].sum(axis=-1) > 0.3))
    draw = otherwise([(x, y)], light=0, faces=False)
    return Planting(
        scene, (x, y), draw, {"terminator"}, "takes light 'left' to be behind the surface", sphere=2, light=0
    )


def no_near_plane() -> Planting:
    """The part of the shell that the near plane cuts away is seen."""
    scene = cut()
    at, uncut = drawn(scene), with_patch(nearest=planted.no_near_plane)(scene, ("depth",), Settings())
    x, y = interior(scene, at["depth"] != uncut["depth"])
    t = roots(scene, 0, (0, 0, 0), ray(scene, x, y))[0]
    assert t < 1
    says = "hits the outside of 'shell' at t = "
    return Planting(scene, (x, y), otherwise([(x, y)], near_plane=False), {"range"}, says, sphere=0, t=t)


def missed_in_mirror() -> Planting:
    """The mirror's ray misses the floor, and all else."""
    scene = full()
    at, alone = drawn(scene), drawn(scene.replace(spheres=scene.spheres[:2]))
    seen = (at["id"] == 0) & (at["reflection.1"].sum(axis=-1) > 0.01) & (alone["reflection.1"].sum(axis=-1) == 0)
    x, y = interior(scene, seen)
    t = min(t for t in roots(scene, 2, at["position"][y, x], reflected(scene, at, x, y)) if t > 0)
    draw = otherwise([(x, y)], bounce=1, misses=2)
    says = "misses 'floor' after 1 reflection at t = "
    return Planting(scene, (x, y), draw, {"silhouette"}, says, bounce=1, sphere=2, t=t)


PLANTINGS = (
    missed_sphere,
    missed_all,
    lost_shadow,
    more_shadow,
    lost_own_shadow,
    turned_away,
    no_near_plane,
    missed_in_mirror,
)


@pytest.mark.parametrize("make", PLANTINGS)
def test_a_single_wrong_decision_is_named_with_its_numbers(make: Callable[[], Planting], real: Renderer) -> None:
    planting = make()
    result = validate({"scene": planting.scene}, Planted(real, planting.draw), beside(real))
    assert result.status == 1
    # Mitsuba may be off elsewhere.
    (judged,) = (judged for judged in only(result).verdicts if (judged.x, judged.y) == planting.place)
    assert judged.reference.right
    found = judged.renderer
    assert (found.renderer, found.cause) == (real.name, "unexplained")
    assert "nothing explains it: to decide so takes numbers changed by" in found.because
    decision = found.decision
    assert decision is not None
    assert decision.kind in planting.kind
    assert decision.says.startswith(planting.says), decision.says
    assert (decision.bounce, decision.light) == (planting.bounce, planting.light)
    assert planting.sphere is None or decision.sphere == planting.sphere
    if planting.t is not None:
        assert decision.t == pytest.approx(planting.t, rel=1e-9)


# ---- outside the catalogue


def brighter(scene: tracer.Scene) -> tracer.Scene:
    """One light by 1 %."""
    first, *others = scene.lights
    red, green, blue = first.intensity
    return scene.replace(lights=[first.replace(intensity=(1.01 * red, 1.01 * green, 1.01 * blue)), *others])


def moved(scene: tracer.Scene, by: float = 1e-4) -> tracer.Scene:
    """One sphere."""
    ball, *others = scene.spheres
    return scene.replace(spheres=[ball.replace(position=(by, 0, -10)), *others])


@pytest.mark.parametrize("change", [brighter, moved])
def test_what_no_cause_makes_is_unexplained(change: Callable[..., tracer.Scene], real: Renderer) -> None:
    if change is moved and "mitsuba" in real.name:
        change = functools.partial(moved, by=1e-2)  # 1e-4 is within what it claims
    result = validate({"scene": full()}, Planted(real, scene=change), beside(real), verdicts=5)
    assert result.status == 1
    for judged in only(result).verdicts:
        assert judged.reference.right
        assert judged.renderer.cause == "unexplained", judged.renderer


@pytest.mark.parametrize("consistent", [True, False])
def test_a_shadow_out_of_nowhere(consistent: bool, real: Renderer) -> None:
    """With the colours that follow from it, and without."""
    scene, (x, y), draw, *_ = more_shadow()

    def alone(of: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = dict(doubles.reference(of, passes, settings))
        arrays["shadow.L1"] = arrays["shadow.L1"].copy()
        arrays["shadow.L1"][y, x] = 0
        return Passes(arrays)

    result = validate({"scene": scene}, Planted(real, draw if consistent else alone), beside(real))
    assert result.status == 1
    (judged,) = only(result).verdicts
    assert (judged.x, judged.y, judged.renderer.cause) == (x, y, "unexplained")
    assert judged.reference.right
    assert judged.renderer.decision is not None
    assert judged.renderer.decision.light == 1
    assert set(judged.renderer.errors) >= {"shadow.L1"}
    assert ("direct" in judged.renderer.errors) == consistent


def test_what_is_no_number_is_unexplained() -> None:
    def broken(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: array.copy() for name, array in doubles.faithful(scene, passes, settings).items()}
        arrays["diffuse"][5, 5, 1] = math.nan
        arrays["depth"][0, 0] = -math.inf
        arrays["id"][3, 3] = 7
        arrays["id"][3, 4] = -9
        return Passes(arrays)

    result = validate({"scene": full()}, Double(draw=broken), "native-f64")
    record = only(result).record()
    assert {tuple(place) for group in record["groups"] for place in group["pixels"]} >= {(5, 5), (3, 3)}
    assert all(not group["explained"] for group in record["groups"])
    json.dumps(result.record(), allow_nan=False)
    assert "sees sphere 7 where there is" in str(record)


# ---- no false comfort


@pytest.mark.parametrize("claim", [1e-3, 1.0])
@pytest.mark.parametrize("make", PLANTINGS)
def test_a_large_claim_alone_excuses_nothing(make: Callable[[], Planting], claim: float) -> None:
    """Numbers changed so far that the decision flips make another pixel."""
    planting = make()
    honest = renderers.get("native-f64").uncertainty(planting.scene, Settings())
    large = dataclasses.replace(honest, silhouette=claim, range=claim, order=claim, terminator=claim)
    double = Double(draw=planting.draw, claim=large)
    finding = find(double, planting.scene, *planting.place)
    assert finding.cause == "unexplained"
    assert finding.decision is not None
    assert finding.decision.says.startswith(planting.says)


def test_a_claim_that_covers_the_pixel_explains_it() -> None:
    """A sphere is too large by less than is claimed: at its outline the pixels are those of other numbers."""
    delta, kinds = 2e-3, ("silhouette", "range", "order", "terminator")
    outline = tracer.View(near=1, left=0.2, right=0.23, bottom=-0.015, top=0.015, columns=20, rows=20)
    scene = doubles.full().replace(view=outline)
    honest = renderers.get("native-f64").uncertainty(scene, Settings())
    large = dataclasses.replace(honest, unit=delta / 2, **dict.fromkeys(kinds, 4 * delta))

    def larger(of: tracer.Scene) -> tracer.Scene:
        ball, *others = of.spheres
        return of.replace(spheres=[ball.replace(scaling=(2.1 * (1 + delta),) * 3), *others])

    claimed = only(validate({"scene": scene}, Double(draw=with_scene(larger), claim=large), "native-f64"))
    assert len(claimed.verdicts) >= 5
    # Next to the outline some pixels are off by more than any in the interior, and still within what is claimed.
    assert {judged.renderer.cause for judged in claimed.verdicts} - {""} == {"rounding"}
    unclaimed = only(validate({"scene": scene}, Double(draw=with_scene(larger)), "native-f64", verdicts=20))
    assert {judged.renderer.cause for judged in unclaimed.verdicts} == {"unexplained"}


@pytest.mark.parametrize(("name", "right"), [("reflection", True), ("reflection.1", True), ("direct", False)])
def test_an_absolute_error_of_mirrors_covers_what_mirrors_show(name: str, right: bool) -> None:
    scene, off = full(), 1e-4
    absolute = dict.fromkeys(("reflection", "reflection.*"), 1.5 * off)
    honest = renderers.get("native-f64").uncertainty(scene, Settings())
    x, y = interior(scene, analysis(scene).ids >= 0)

    def more(arrays: Any) -> None:
        arrays[name][y, x] += off

    claim = dataclasses.replace(honest, absolute={**honest.absolute, **absolute})
    finding = find(Double(draw=with_arrays(more), claim=claim), scene, x, y)
    assert finding.right == right
    assert set(finding.errors) == (set() if right else {name})


def test_a_change_that_is_another_scene_is_no_rounding() -> None:
    """Where only ids are compared a change by a third makes them; but no rounding is so large."""
    scene, place = looking_back(), (4, 4)
    (meets,) = (flip for flip in flips(Prover(scene), *place) if flip.key == Key("meets", 0, -1, 0))
    assert court.LARGEST < meets.margin < 1
    honest = renderers.get("native-f64").uncertainty(scene, Settings())
    absurd = dataclasses.replace(honest, **dict.fromkeys(("silhouette", "range", "order", "terminator"), 1.0))
    of = side(Double(draw=otherwise([place], misses=0), claim=absurd), scene)
    judge = Court(scene, Settings(), analysis(scene))
    finding = judge.find(judge.prover.pixel(*place), of, ("id",))
    assert (finding.cause, set(finding.errors)) == ("unexplained", {"id"})


def test_a_single_pixel_that_looks_like_a_mistake_is_none() -> None:
    """Truth that casts no shadows makes the pixel; but its neighbours have shadows."""
    planting = lost_shadow()
    rule = next(rule for rule in court.mistakes(planting.scene, Settings()) if rule.says == "casts no shadows")
    made = Prover(planting.scene, follower=rule.follower).pixel(*planting.place)
    double = Double(draw=planting.draw)
    at = double.render(planting.scene, ("beauty",), Settings())["beauty"][planting.place[1], planting.place[0]]
    assert [ball.value for ball in made.values["beauty"]] == pytest.approx(list(at))
    assert find(double, planting.scene, *planting.place).cause == "unexplained"


def test_a_mistake_at_an_edge_is_not_believed_by_chance() -> None:
    """A pixel at the terminator, lit as by a light that fades by N.L, in a renderer that does not."""
    scene = cut()
    faded = with_patch(illuminate=planted.fading_highlight)

    def one(of: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: array.copy() for name, array in doubles.faithful(of, passes, settings).items()}
        for name, array in faded(of, passes, settings).items():
            arrays[name][place[1], place[0]] = array[place[1], place[0]]
        return Passes(arrays)

    right, wrong = doubles.faithful(scene, ("specular",), Settings()), faded(scene, ("specular",), Settings())
    shows = np.abs(right["specular"] - wrong["specular"]).max(axis=-1) > 1e-3
    nearest = np.where(shows, analysis(scene).margins["terminator"], np.inf)
    place = (int(nearest.argmin() % scene.view.columns), int(nearest.argmin() // scene.view.columns))
    assert find(Double(draw=one), scene, *place).cause == "unexplained"
    assert find(Double(draw=faded), scene, *place).cause == "mistake"


GRAZED = """NEAR 1\nLEFT 1.3333333332\nRIGHT 2\nBOTTOM -1\nTOP 0\nRES 1 1
SPHERE ball 0 0 -5 4 4 4 1 1 1 0 1 0 0 1
SPHERE blocker 9.4 0 -0.8 1 1 1 1 1 1 0 1 0 0 1
LIGHT sun 16.4 0 0.2 1 1 1\nBACK 0 0 0\nAMBIENT 0 0 0\nOUTPUT grazed.ppm\n"""


@pytest.mark.parametrize(("off", "cause"), [(0.0, "rule"), (0.02, "unexplained"), (0.1, "unexplained")])
def test_a_rule_makes_no_more_next_to_an_outline_than_elsewhere(off: float, cause: str) -> None:
    """Truth is dark; with the rule the ray grazes the ball, where a first order bounds nothing."""
    scene = tracer.loads(GRAZED)

    def lit(of: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: array.copy() for name, array in unshadowed(of, passes, settings).items()}
        for name in set(passes) & {"diffuse", "direct", "beauty"}:
            arrays[name] += off
        return Passes(arrays)

    unshadowed = with_patch(hidden=planted.no_shadows)
    claim = renderers.get("native-f32").uncertainty(scene, Settings(), analysis(scene))
    double = Double(draw=lit, claim=claim)
    rule = next(rule for rule in court.mistakes(scene, Settings()) if rule.says == "casts no shadows")
    with mock.patch.object(double, "rules", return_value=[rule], create=True):
        finding = find(double, scene, 0, 0)
    assert finding.cause == cause, finding.because
    assert set(finding.errors) == {"shadow.L0", "diffuse", "direct", "beauty"}


@pytest.mark.parametrize(
    ("exponent", "off", "cause"),
    [
        (0.5, 0.0, "rule"),
        (0.1, 0.0, "rule"),
        (0.5, 0.02, "unexplained"),
        (0.5, 0.3, "unexplained"),
        # R.V is 1e-9, and may be off by 4e-6: (R.V)^n is anything up to 0.29.
        (0.1, 0.02, "rounding"),
        (0.1, 0.3, "unexplained"),
    ],
)
def test_a_rule_makes_no_more_where_a_highlight_begins(exponent: float, off: float, cause: str) -> None:
    """(R.V)^n with n < 1 is as steep at R.V = 0 as a value behind an outline."""
    eye, hit = np.array([0.2, 0.1, -1.0]), None
    centre = np.array([0.0, 0.0, -5.0])
    a, b, c = eye @ eye, eye @ -centre, centre @ centre - 4
    hit = eye * (-b - math.sqrt(b * b - a * c)) / a
    N, V = (hit - centre) / 2, -eye / np.linalg.norm(eye)
    across = N - (N @ V) * V
    R = across / np.linalg.norm(across) + 1e-9 * V
    L = 2 * (R @ N) * N - R
    numbers = [" ".join(f"{value!r}" for value in map(float, hit + t * L)) for t in (4, 8)]
    scene = tracer.loads(
        "NEAR 1\nLEFT 0.2\nRIGHT 2\nBOTTOM -1\nTOP 0.1\nRES 1 1\n"
        f"SPHERE ball 0 0 -5 2 2 2 1 1 1 0 0 1 0 {exponent}\n"
        f"SPHERE blocker {numbers[0]} 0.2 0.2 0.2 1 1 1 0 1 0 0 1\n"
        f"LIGHT sun {numbers[1]} 1 1 1\nBACK 0 0 0\nAMBIENT 0 0 0\nOUTPUT steep.ppm\n"
    )

    def lit(of: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        drawn = with_patch(hidden=planted.no_shadows)(of, passes, settings)
        return Passes({name: array + off * (name in ("specular", "direct", "beauty")) for name, array in drawn.items()})

    claim = renderers.get("native-f32").uncertainty(scene, Settings(), analysis(scene))
    double = Double(draw=lit, claim=claim)
    rule = next(rule for rule in court.mistakes(scene, Settings()) if rule.says == "casts no shadows")
    with mock.patch.object(double, "rules", return_value=[rule], create=True):
        assert find(double, scene, 0, 0).cause == cause


def test_what_is_asked_about_one_pixel_has_one_budget() -> None:
    """Pixels of equal hits, by symmetry: the court asks for their signs many times."""
    scene = resized(tracer.load(Path(__file__).parents[2] / "scenes/spec/touching-spheres.txt"), (20, 20))
    judge = Court(scene, Settings(), analysis(scene))

    def off(of: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        drawn = doubles.faithful(of, passes, settings)
        return Passes({name: array + 0.01 * (name == "beauty") for name, array in drawn.items()})

    of = side(Double(draw=off), scene)
    spent = []
    for _ in range(2):
        truth = judge.prover.pixel(10, 10)
        judge.allowance.left = 0
        judge._found.clear()
        judge.find(truth, of, tuple(of.passes))
        spent.append(exact.BUDGET - judge.allowance.left)
    assert 0 < spent[0] < exact.BUDGET / 10
    assert spent[0] == spent[1], "the budget begins anew with a pixel"
    derived = judge.prover.forcing({}).with_numbers(judge.prover.numbers)
    before = judge.allowance.left
    derived.pixel(10, 10)
    assert judge.allowance.left < before


def broken(*_: Any) -> Any:
    raise KeyError("rule")


def no_follower(*_: Any) -> Any:
    return [court.Rule("fails", follower=type("Broken", (Follower,), {"begins": broken}))]


def no_choice(*_: Any) -> Any:
    return [court.Rule("fails", choices=broken)]


class Late(Follower):
    """A rule that fails only when it is asked for every blocker."""

    def hides(self, hit: Any, relative: Any, to_light: Any, i: int, j: int) -> bool:
        if self.every_blocker:
            broken()
        return super().hides(hit, relative, to_light, i, j)


def late(*_: Any) -> Any:
    return [court.Rule("fails late", follower=Late)]


def our_fault(*_: Any) -> Any:
    raise TypeError("a fault of ours")


def test_what_fails_in_our_own_code_is_not_blamed_on_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a renderer that has rules, which leave some of our code as it is."""
    double = Double(draw=with_scene(moved))
    judge, of = Court(full(), Settings(), analysis(full())), side(double, full())
    off = np.abs(of.passes["beauty"] - drawn(full())["beauty"]).max(axis=-1)
    y, x = (int(index) for index in np.unravel_index(off.argmax(), off.shape))
    truth = judge.truth(x, y)
    monkeypatch.setattr(Follower, "begins", our_fault)
    with (
        mock.patch.object(double, "rules", return_value=[court.Rule("does as it should")], create=True),
        pytest.raises(TypeError, match="a fault of ours"),
    ):
        judge.find(truth, of, tuple(of.passes))


@pytest.mark.parametrize("rules", [broken, no_follower, no_choice, late])
def test_rules_that_fail_are_the_renderers_failure(rules: Callable[..., Any]) -> None:
    """The comparisons are kept, the program ends with status 3."""
    double = Double(draw=with_scene(moved))
    with mock.patch.object(double, "rules", rules, create=True):
        result = validate({"scene": full()}, double, "native-f64")
    assert [(note.renderer, note.message) for note in result.failures] == [
        ("double", "its rules failed: KeyError: 'rule'")
    ]
    assert result.comparisons
    assert result.status == 3


# ---- several decisions at once

#: Two spheres 1e-9 apart: a mirror's ray goes to and fro between them, or leaves.
NEARLY_EQUAL = """NEAR 1\nLEFT 1.21290323\nRIGHT 1.3\nBOTTOM -0.9\nTOP -0.806451613\nRES 1 1
SPHERE s0 16.25 -8.5 -9.5 9.35443548 9.35443548 9.35443548 1 1 1 0 0 0 1 1
SPHERE s1 {x} -8.5 -9.5 9.35443548 9.35443549 9.354435483870967 1 1 1 1 0 1 1 1
BACK 0 0 0\nAMBIENT 0 0.1 0\nOUTPUT nearly-equal.ppm\n"""

#: Three of them, which the ray all but touches.
NEARLY_THREE = """NEAR 2\nLEFT -0.110416667\nRIGHT 0\nBOTTOM -0.7\nTOP -0.625\nRES 1 1
SPHERE s3 -0.999999998999999 -4 -8.75 1.3903615774738882 1.3903615760835253 1.3903615774738882 1 1 1 1 0 0 1 1
SPHERE s0 -1 -4 -8.75 1.3903615774738882 1.3903615774738882 1.3903615774738882 1 1 1 0 1 0 1 2
SPHERE s2 -0.999999999 -4 -8.75 1.3903615774738882 1.3903615760835266 1.3903615774738882 1 1 1 0 1 0 0 1
BACK 0 0 0\nAMBIENT 1 0 0\nOUTPUT nearly-three.ppm\n"""

#: The ray all but touches the near sphere, goes on to the far one, and the light, at the eye, is seen past the first.
THERE_AND_BACK = """NEAR 0.01\nLEFT -0.0025000000000000005\nRIGHT -0.002083333333333333
BOTTOM 0.0029166666666666664\nTOP 0.003333333333333333\nRES 1 1
SPHERE far 0 0.02 -0.06 0.02 0.02 0.02 0.5 0.5 1 0 1 0 1 0.5347004937615092
SPHERE near -0.005 0 -0.015 0.005 0.005 0.005 0.5 0.4098641839652898 0 1 0.6 0.2 0.5 0.5
LIGHT eye 0 0 0 1 1 1\nBACK 0 0 0\nAMBIENT 0 0 0\nOUTPUT back.ppm\n"""

#: The ray of column 4, row 3 touches, and there N.L = 0 and R.V = 0.
TOUCHING_LIT = """NEAR 1\nLEFT 0.125\nRIGHT 0.40625\nBOTTOM 0\nTOP 0.5\nRES 9 9
SPHERE ball 0 1 -4 1 1 1 1 1 1 0 0 1 0 0.01
LIGHT sun 0 4 -3 1 1 1\nBACK 0 0 0\nAMBIENT 0 0 0\nOUTPUT lit.ppm\n"""

#: Four spheres that the middle ray touches, seen from the light.
FOUR_TANGENTS = """NEAR 0.01\nLEFT 0\nRIGHT 0.02\nBOTTOM -0.02\nTOP 0\nRES 1 1
SPHERE s0 0 0.02 -0.06 0.02 0.02 0.02 0.5 0.5 1 0 0.5 0.5 1 1
SPHERE s1 0.005 0 -0.03 0.005 0.005 0.005 1 0.5 0 1 0.5 0.1 0.5 1
SPHERE s2 0 0.005 -0.06 0.005 0.005 0.005 0.7 0 0.5 0.3 0.5 1 1 2
SPHERE s3 -0.005 0 -0.015 0.005 0.005 0.005 0.5 0.4 0 1 0.6 0.2 0.5 1
LIGHT eye 0 0 0 0.9 0.1 0.5\nBACK 0 0.6 0.3\nAMBIENT 0.1 0.5 1\nOUTPUT four.ppm\n"""


def meets(bounce: int, light: int, sphere: int) -> Key:
    """The decision."""
    return Key("meets", bounce, light, sphere)


def taking(forced: Mapping[Key, int], off: float = 0.0) -> planted.Draw:
    """Draw a scene of one pixel with decisions taken otherwise; `off`: what mirrors show besides."""

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        made = Prover(scene, settings, follower=Follower).pixel(0, 0, forced=forced, ties=False).values
        arrays = dict(doubles.faithful(scene, passes, settings))
        for name in passes:
            value = np.array([ball.value for ball in made[name]], arrays[name].dtype)
            arrays[name] = value.reshape(arrays[name].shape) + off * (name in ("reflection.1", "reflection", "beauty"))
        return Passes(arrays)

    return draw


class Several(NamedTuple):
    """A scene of one pixel, and decisions that lie within the claim of float32."""

    scene: str
    forced: Mapping[Key, int]


SEVERAL = {
    # It enters the other sphere, and stays there.
    "to and fro": Several(NEARLY_EQUAL.format(x="16.250000016250002"), {Key("start", 1, -1, 1): -1}),
    "the last is first": Several(
        NEARLY_THREE, {Key("order", 0, -1, 1, 0): 1, Key("order", 0, -1, 2, 0): 1, Key("start", 1, -1, 1): -1}
    ),
    # The light is hidden where it was passed so narrowly before.
    "not back": Several(THERE_AND_BACK, {meets(1, 0, 1): 0}),
    # Past two of them and to the third; the light is before the surface, and no sphere before the light.
    "past four": Several(
        FOUR_TANGENTS,
        {
            meets(0, -1, 3): -1,
            meets(0, -1, 1): -1,
            meets(0, -1, 2): -1,
            Key("faces", 0, 0, 0): 1,
            meets(0, 0, 1): -1,
            meets(0, 0, 2): -1,
            meets(0, 0, 3): -1,
            Key("start", 1, -1, 2): -1,
        },
    ),
}


@pytest.mark.parametrize("name", SEVERAL)
def test_any_number_of_decisions_may_be_taken_otherwise_within_the_claim(name: str) -> None:
    text, forced = SEVERAL[name]
    scene = tracer.loads(text)
    claim = renderers.get("native-f32").uncertainty(scene, Settings(), analysis(scene))
    finding = find(Double(draw=taking(forced), claim=claim), scene, 0, 0)
    assert finding.errors
    assert finding.cause == "rounding", finding.because
    assert finding.change is not None
    assert finding.change <= claim.silhouette
    # What mirrors show is not what any of them makes.
    wrong = find(Double(draw=taking(forced, 0.01), claim=claim), scene, 0, 0)
    assert wrong.cause == "unexplained", wrong.because


@pytest.mark.parametrize("name", ["native-f32", "numpy-f32", "native-f64", "numpy-f64"])
@pytest.mark.parametrize("scene", [NEARLY_EQUAL.format(x="16.250000016250002"), NEARLY_THREE, THERE_AND_BACK])
def test_renderers_that_take_several_otherwise_are_explained(scene: str, name: str) -> None:
    finding = find(renderers.get(name), tracer.loads(scene), 0, 0)
    assert finding.right or finding.cause == "rounding", finding.because


def shining(share: float, of: str = "specular") -> Callable[[tracer.Scene, Sequence[str], Settings], Passes]:
    """What the light gives at pixel 0 4 is that share of all that it can give, 1."""

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: np.array(array) for name, array in doubles.faithful(scene, passes, settings).items()}
        for name in (of, "direct", "beauty"):
            arrays[name][4, 0] += share
        return Passes(arrays)

    return draw


def test_a_light_at_the_point_itself_may_shine_from_anywhere(root: Path) -> None:
    """For rounding: it gives a share of all that it can give, but no more, and no term that there is not."""
    scene = tracer.load(root / "scenes" / "hard" / "light-at-the-point.txt")
    for share in (1e-3, 0.5, 0.999):
        finding = find(Double(draw=shining(share)), scene, 0, 4)
        assert finding.cause == "rounding", finding.because
        assert "any direction to 'l0', which is at the point itself" in finding.because
    for draw in (shining(1.01), shining(-0.1), shining(0.5, of="diffuse")):
        assert find(Double(draw=draw), scene, 0, 4).cause == "unexplained"

    # Nor next to it.
    def beside(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        drawn = shining(0.5)(scene, passes, settings)
        return Passes({name: np.roll(drawn[name], 1, axis=0) if drawn[name].size else drawn[name] for name in drawn})

    assert find(Double(draw=beside), scene, 0, 5).cause != "rounding"


@pytest.mark.parametrize("color", [(8, 90, 25), (20, 100, 0), (2, 110, 30), (25, 84, 0), (10, 84, 20)])
def test_far_roots_next_to_outlines_excuse_no_color(root: Path, color: tuple[int, int, int]) -> None:
    """Levels of a pixel where many decisions are near: truth is 2, 84, 0."""
    scene = tracer.load(root / "scenes" / "hard" / "tangents-at-once.txt")

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: np.array(array) for name, array in doubles.faithful(scene, passes, settings).items()}
        arrays["beauty"][24, 24] = np.array(color) / 255
        return Passes(arrays)

    claim = renderers.get("native-f32").uncertainty(scene, Settings(), analysis(scene))
    judge = tangents(scene)
    of = Side(Double(draw=draw), draw(scene, ["beauty"], Settings()), claim)
    finding = judge.find(judge.prover.pixel(24, 24), of, ("beauty",))
    assert finding.cause == "unexplained", finding.because


@functools.cache
def tangents(scene: tracer.Scene) -> Court:
    """Its judge, who keeps what was proved for one color for the next."""
    return Court(scene, Settings(), analysis(scene))


def test_a_pixel_next_to_an_outline_has_no_bound_of_its_own(root: Path) -> None:
    """At an exact tangent slopes are what rounding makes of infinity: a white pixel is none of them."""
    scene = tracer.load(root / "scenes" / "hard" / "tangents-at-once.txt")

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: np.array(array) for name, array in doubles.faithful(scene, passes, settings).items()}
        if "beauty" in arrays:
            arrays["beauty"][12, 16] = 1
        return Passes(arrays)

    result = validate({"scene": scene}, Double(draw=draw), "native-f64", passes=["beauty"])
    assert result.status == 1
    (judged,) = only(result).verdicts
    assert (judged.x, judged.y, judged.renderer.cause) == (16, 12, "unexplained")


def test_a_light_beside_a_surface_takes_no_certainty_from_the_image() -> None:
    """On which side of the surface it is, by a rounding, matters in half of the pixels."""
    scene = tracer.loads(
        "NEAR 1\nLEFT -1\nRIGHT 1\nBOTTOM -1\nTOP 1\nRES 40 40\n"
        "SPHERE wall 0 0 -40 30 30 30 0.8 0.5 0.3 0.3 0.6 0.3 0 20\n"
        "SPHERE lamp 0.1 0.2 -4 0.6 0.6 0.6 0.3 0.6 0.9 0.3 0.6 0 0 0\n"
        "LIGHT l0 0.1 -0.28 -4.36 1 1 1\nBACK 0 0 0.2\nAMBIENT 0.5 0.5 0.5\nOUTPUT beside.ppm\n"
    )
    assert analysis(scene).beside.sum() > 800
    result = validate({"scene": scene}, ["native-f64", "native-f32"], "numpy-f64")
    assert [comparison.reasons for comparison in result.comparisons if not comparison.ok] == []
    # A light that is a little too bright is found out all the same, in these pixels too.
    bright = scene.replace(lights=[scene.lights[0].replace(intensity=(1.01, 1, 1))])
    wrong = Double(draw=with_scene(lambda _: bright))
    result = validate({"scene": scene}, wrong, "numpy-f64", passes=["diffuse"], verdicts=20)
    assert {judged.renderer.cause for judged in only(result).verdicts if judged.edge} == {"unexplained"}


def test_the_number_of_decisions_is_told() -> None:
    finding = find(renderers.get("native-f32"), tracer.loads(NEARLY_EQUAL.format(x="16.250000016250002")), 0, 0)
    taken = "truth with 4 decisions within its claim taken otherwise makes this pixel"
    assert finding.because == f"rounding: {taken}, and it may be off by 3.8e-06"


def test_decisions_beyond_the_claim_are_not_taken_otherwise() -> None:
    """The same picture of spheres that are 0.01 apart, and of spheres 1e-9 apart in float64."""
    near, far = (tracer.loads(NEARLY_EQUAL.format(x=x)) for x in ("16.250000016250002", "16.26"))
    picture = side(renderers.get("native-f32"), near).passes

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = dict(doubles.faithful(scene, passes, settings))
        arrays |= {name: picture[name] for name in passes if name == "beauty" or name.startswith("reflection")}
        return Passes(arrays)

    for scene, name in ((far, "native-f32"), (near, "native-f64")):
        claim = renderers.get(name).uncertainty(scene, Settings(), analysis(scene))
        finding = find(Double(draw=draw, claim=claim), scene, 0, 0)
        assert finding.cause == "unexplained", finding.because
        assert "reflection.1" in finding.errors


@pytest.mark.parametrize(("value", "cause"), [(0.698, "rounding"), (0.8, "rounding"), (0.9, "unexplained")])
def test_a_highlight_at_a_triple_tie_is_at_most_what_the_claim_makes_of_it(value: float, cause: str) -> None:
    """R.V is 0 where the light is exactly at the edge of what the surface faces: it may be anything up to 5e-14.

    The claim times all that R.V depends on, each at most a few times; to the power of 0.01 that is 0.74 to 0.87.
    """
    scene = tracer.loads(TOUCHING_LIT)
    assert {tie.key.what for tie in Prover(scene).pixel(4, 3).ties} == {"meets", "faces"}

    def draw(of: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: array.copy() for name, array in doubles.faithful(of, passes, settings).items()}
        for name in set(passes) & {"specular", "direct", "beauty"}:
            arrays[name][3, 4] = value
        return Passes(arrays)

    claim = renderers.get("native-f64").uncertainty(scene, Settings(), analysis(scene))
    assert find(Double(draw=draw, claim=claim), scene, 4, 3).cause == cause


def test_of_decisions_that_make_a_pixel_the_one_is_told_that_makes_its_shadow() -> None:
    """A light behind the surface is as dark as a hidden one; but that it is hidden is what the renderer says."""
    scene = tracer.loads(
        "NEAR 32\nLEFT 13.1\nRIGHT 14\nBOTTOM -30\nTOP -29\nRES 4 4\n"
        "SPHERE lit 192 -336 -288 90 90 90 1 1 1 0 1 0 0 0\nSPHERE ball -32 16 -192 144 144 144 1 1 1 0 0 0 0 1\n"
        "LIGHT sun -32 -132 -192 1 1 1\nBACK 0 0 0\nAMBIENT 0 0 0\nOUTPUT side.ppm\n"
    )
    finding = find(Double(draw=otherwise([(0, 0)], light=0, hidden=True)), scene, 0, 0)
    assert finding.cause == "unexplained"
    assert finding.decision is not None
    assert finding.decision.says.startswith("hides light 'sun' behind 'ball'")


# ---- every difference of the project's own scenes

#: Drawn larger, as there single pixels differ: at outlines, equal hits, roots in the image plane, flat chords.
LARGER = {
    "behind-eye",
    "beyond-light",
    "equal-hits",
    "exact-tangents",
    "lantern",
    "light-inside",
    "nested",
    "one-pixel",
    "planets",
    "touching-spheres",
}


def causes_of(references: Sequence[str], root: Path) -> Counter[str]:
    """Judge every pixel of the bundled scenes in which native-f64 and a reference differ; by cause how many."""
    paths = [path for path in scene_files([root / "scenes"]) if path.stem != "duplicate-spheres"]
    scenes = {path.stem: tracer.load(path) for path in paths}
    # Hard scenes are as large as they have to be.
    hard = {path.stem for path in paths if path.parent.name == "hard"}
    found: Counter[str] = Counter()
    for size, chosen in ((None, hard), ((100, 100), set(scenes) - LARGER - hard), ((200, 200), LARGER)):
        some = {name: scenes[name] for name in chosen}
        result = validate(some, "native-f64", references, size=size, verdicts=10**6)
        assert result.status == 0
        for verdicts in result.verdicts:
            for judged in verdicts.verdicts:
                assert judged.explained, (verdicts.scene, judged.x, judged.y, judged.findings)
                found.update(finding.cause for finding in judged.wrong)
    return found


def test_every_difference_is_explained(root: Path) -> None:
    causes = causes_of(["native-f32", "numpy-f64", "numpy-f32"], root)
    assert set(causes) == {"rounding"}
    assert causes["rounding"] >= 5


@pytest.mark.mitsuba
def test_every_difference_from_mitsuba_is_explained(root: Path, need: Need) -> None:
    mitsuba = renderers.get("mitsuba-spec@llvm")
    need(mitsuba.unavailable() is None, str(mitsuba.unavailable()))
    causes = causes_of([mitsuba.name], root)
    assert set(causes) == {"rounding", "rule"}
    assert min(causes.values()) >= 3


# ---- ties


def test_spheres_that_touch(root: Path) -> None:
    scene = resized(tracer.load(root / "scenes" / "spec" / "touching-spheres.txt"), (200, 200))
    truth = Prover(scene).pixel(100, 100)
    assert truth.ties
    for name in ("native-f64", "numpy-f64"):
        assert find(renderers.get(name), scene, 100, 100).right
    finding = find(renderers.get("native-f32"), scene, 100, 100)
    assert finding.right or finding.cause == "rounding"


def looking_back() -> tracer.Scene:
    """The middle pixel's ray comes back from a mirror, and hits two spheres behind the eye at the same place."""
    eye = doubles.FULL.splitlines()[:6]
    eye[5] = "RES 8 8"
    return tracer.loads(
        "\n".join(eye)
        + """
SPHERE mirror 0 0 -5 1 1 1 0.5 0.5 0.5 0.2 0.2 0 0.9 1
SPHERE small 0 0 3 1 1 1 0.9 0.1 0.1 0.5 0.5 0 0 1
SPHERE large 0 0 4 2 2 2 0.1 0.1 0.9 0.5 0.5 0 0 1
LIGHT lamp 3 5 0 1 1 1
BACK 0 0 0
AMBIENT 0.7 0.8 0.9
OUTPUT back.ppm
"""
    )


def test_a_tie_that_nothing_settles_has_two_right_answers() -> None:
    scene = looking_back()
    truth = Prover(scene).pixel(4, 4)
    (tie,) = truth.ties
    assert (tie.key.what, tie.key.bounce, tie.settled) == ("order", 1, "")
    assert len(tie.outcomes) == 2

    def other(of: tracer.Scene) -> tracer.Scene:
        mirror, small, large = of.spheres
        return of.replace(spheres=[mirror, large, small])

    double = Double(draw=with_scene(other), claim=Uncertainty(0, 0, 0, 0, 1e-15))
    result = validate({"scene": scene}, double, "native-f64", verdicts=100)
    tied = [judged for judged in only(result).verdicts if (judged.x, judged.y) == (4, 4)]
    (judged,) = tied
    assert judged.reference.right
    assert judged.renderer.cause == "tie"
    assert judged.explained
    assert judged.renderer.decision is not None
    assert judged.renderer.decision.says == "takes 'large', not 'small', of equal hits after 1 reflection at t = 6"
    assert judged.renderer.decision.t == 6

    def neither(of: tracer.Scene) -> tracer.Scene:
        mirror, _, large = of.spheres
        return of.replace(spheres=[mirror, large.replace(color=(0.5, 0.5, 0.5))])

    assert find(Double(draw=with_scene(neither)), scene, 4, 4).cause == "unexplained"


@pytest.mark.parametrize("name", ["native-f64", "numpy-f64", "native-f32", "numpy-f32"])
@pytest.mark.parametrize("scene", ["exact-tangents", "equal-hits", "light-inside", "touching-spheres"])
def test_where_the_specification_settles_a_tie_only_rounding_excuses(scene: str, name: str, root: Path) -> None:
    """Wherever truth is even: whoever keeps to the specification is right, or off by a rounding."""
    of = resized(tracer.load(root / "scenes" / "spec" / f"{scene}.txt"), (200, 200))
    judge, drawn_ = Court(of, Settings(), analysis(of)), side(renderers.get(name), of)
    even = np.min([analysis(of).margins[kind] for kind in analysis(of).margins], axis=0) == 0
    places = [(int(x), int(y)) for y, x in np.argwhere(even)]
    for x, y in random.Random(1).sample(places, min(6, len(places))):
        finding = judge.find(judge.prover.pixel(x, y), drawn_, tuple(drawn_.passes))
        assert finding.right or finding.cause == "rounding", (x, y, finding)


def test_a_tie_that_is_settled_excuses_no_other_outcome() -> None:
    """Of equal primary hits the sphere first in the file counts: who takes the other is wrong, at claims of 0."""
    scene = looking_back()
    small, large = (scene.spheres[k].replace(position=(0, 0, -z)) for k, z in ((1, 3), (2, 4)))
    ahead, swapped = scene.replace(spheres=[small, large]), scene.replace(spheres=[large, small])

    def other(of: tracer.Scene) -> tracer.Scene:
        del of
        return swapped

    truth = Prover(ahead).pixel(4, 4)
    assert [tie.key.what for tie in truth.ties] == ["order"]
    assert truth.id == 0
    sure = Uncertainty(-1, -1, -1, -1, 1e-15)
    of = Double(draw=with_scene(other), claim=sure)
    finding = find(of, ahead, 4, 4)
    assert finding.cause == "unexplained"


# ---- how it is told


def test_of_many_pixels_a_sample_is_judged(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = Double(draw=with_scene(brighter))
    result = validate({"scene": full()}, wrong, "native-f64", verdicts=5)
    verdicts = only(result)
    assert len(verdicts.verdicts) == 5
    assert verdicts.differ > 100
    places = [(judged.y, judged.x) for judged in verdicts.verdicts]
    assert places == sorted(places)
    again = only(validate({"scene": full()}, wrong, "native-f64", verdicts=5))
    assert [(judged.y, judged.x) for judged in again.verdicts] == places
    terminal.print_verdicts(verdicts)
    first = capsys.readouterr().out.splitlines()[0]
    assert first == f"scene (double, native-f64): {verdicts.differ} pixels differ, 5 of them judged, chosen at random"
    (none,) = validate({"scene": full()}, wrong, "native-f64", verdicts=0).verdicts
    assert (none.verdicts, none.differ) == ([], verdicts.differ)


def test_pixels_that_are_alike_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    result = validate(
        {"scene": cave()}, Double(draw=with_patch(hidden=planted.no_own_shadow)), "native-f64", verdicts=8
    )
    verdicts = only(result)
    (group,) = verdicts.groups()
    assert len(group.verdicts) == 8
    first = group.verdicts[0]
    assert group.sentence() == (
        f"8 pixels: double lets light 'moon' past 'cave' (e.g. at {first.x} {first.y}): "
        "truth makes this pixel if it lets no sphere shadow itself"
    )
    terminal.print_validation(result, verbose=False)
    out = capsys.readouterr().out
    assert f"  WRONG: {group.sentence()}" in out
    assert ", at least 8 pixels without an excuse" in out


def test_groups_come_with_the_worst_first() -> None:
    truth = Prover(full()).pixel(0, 0)

    def judged(x: int, finding: Finding) -> Verdict:
        return Verdict(x, 0, ("beauty",), truth, finding, Finding("b"), edge=True)

    def off(cause: str, says: str = "is off in beauty") -> Finding:
        decision = parting.Decision("value", f"{says} by 1", says)
        return Finding("a", {"beauty": 1.0}, decision, cause, f"because of {cause}")

    kinds = [off("rounding"), off("rounding"), off("rounding", "misses 'ball'"), off("unexplained"), Finding("a")]
    verdicts = Verdicts("scene", "a", "b", 9, [judged(x, finding) for x, finding in enumerate(kinds)])
    groups = verdicts.groups()
    assert [(group.finding.cause, len(group.verdicts)) for group in groups] == [
        ("unexplained", 1),
        ("rounding", 2),
        ("rounding", 1),
        ("", 1),
    ]
    assert not verdicts.explained
    assert groups[-1].sentence() == "1 pixel: neither is off by more than it claims (at 4 0)"
    assert groups[1].sentence() == "2 pixels: a is off in beauty (e.g. at 0 0): because of rounding"
    assert groups[0].sentence() == "1 pixel: a is off in beauty by 1 (at 3 0): because of unexplained"
    both = Verdicts("s", "a", "b", 1, [Verdict(0, 0, ("beauty",), truth, off("rule"), off("tie"), edge=True)])
    assert both.explained
    assert len(both.groups()) == 2


def test_the_record_is_strict_json() -> None:
    result = validate(
        {"scene": cut()}, Double(draw=with_patch(nearest=planted.no_near_plane)), "native-f64", verdicts=4
    )
    record = json.loads(json.dumps(result.record(), allow_nan=False))
    (entry,) = record["verdicts"]
    assert {**entry, "groups": None} == {
        "scene": "scene",
        "renderer": "double",
        "reference": "native-f64",
        "differ": only(result).differ,
        "judged": 4,
        "unproved": [],
        "explained": False,
        "groups": None,
    }
    (group,) = entry["groups"]
    assert set(group) == {"wrong", "cause", "because", "decision", "errors", "explained", "pixels"}
    assert (group["wrong"], group["cause"], group["explained"]) == ("double", "mistake", False)
    decision = group["decision"]
    assert {**decision, "t": None} == {
        "kind": "range",
        "says": "hits the outside of 'shell'",
        "bounce": 0,
        "light": None,
        "sphere": 0,
        "t": None,
    }
    x, y = group["pixels"][0]
    assert decision["t"] == pytest.approx(roots(cut(), 0, (0, 0, 0), ray(cut(), x, y))[0])
    assert group["errors"]["depth"] > 0.1
    endless = Finding("a", {"depth": math.inf}, parting.Decision("value", "x", "x"), "unexplained", "y")
    (recorded,) = Verdicts(
        "s", "a", "b", 1, [Verdict(0, 0, ("depth",), Prover(cut()).pixel(0, 0), endless, Finding("b"), edge=False)]
    ).record()["groups"]
    assert recorded["errors"] == {"depth": "inf"}


def test_a_pixel_without_truth_is_not_explained(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    proved = Prover.pixel

    def pixel(self: Prover, x: int, y: int, **options: Any) -> Any:
        if (x, y) == (5, 6):
            raise UnprovedError("pixel 5 6: 65536 bits are not enough")
        return proved(self, x, y, **options)

    def gray(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        arrays = {name: array.copy() for name, array in doubles.faithful(scene, passes, settings).items()}
        arrays["beauty"][6, 5] = 0.5
        return Passes(arrays)

    monkeypatch.setattr(Prover, "pixel", pixel)
    result = validate({"scene": full()}, Double(draw=gray), "native-f64")
    verdicts = only(result)
    assert (verdicts.verdicts, verdicts.unproved, verdicts.explained) == ([], [(5, 6)], False)
    assert verdicts.record()["unproved"] == [[5, 6]]
    assert result.status == 1
    terminal.print_validation(result, verbose=False)
    out = capsys.readouterr().out
    assert "UNEXPLAINED: 1 pixel: truth could not be had at any precision (at 5 6)" in out
    assert ", 1 pixel without an excuse" in out


def test_names_that_are_shared_are_told_apart() -> None:
    scene = full()
    same = scene.replace(
        spheres=[sphere.replace(name="s") for sphere in scene.spheres],
        lights=[light.replace(name="l") for light in scene.lights],
    )
    planting = lost_shadow()
    finding = find(Double(draw=planting.draw), same, *planting.place)
    assert finding.decision is not None
    assert finding.decision.pattern == "lets light 'l' (L0) past 's' (id 0)"


def test_a_difference_that_both_may_have_is_told_as_such() -> None:
    """Each within what it claims, but apart by more: neither is off."""
    honest = renderers.get("native-f64").uncertainty(full(), Settings())

    def off(sign: int) -> planted.Draw:
        def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
            arrays = {name: array.copy() for name, array in doubles.faithful(scene, passes, settings).items()}
            arrays["ambient"][10, 10] *= 1 + sign * 0.9 * honest.unit * 5
            return Passes(arrays)

        return draw

    first, second = Double("a", off(1)), Double("b", off(-1))
    result = validate({"scene": full()}, first, second)
    assert result.ok
    assert result.verdicts == []
