"""`whitted truth`: proved pixels and what is told of them, and renderers held against them."""

from __future__ import annotations

import functools
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from conftest import Result, strict
from doubles import Double, with_arrays, with_settings
from flint import fmpq

import tracer
import tracer.margins
from tracer.margins import EDGE_ROUNDINGS
from tracer.passes import Passes, names
from validation import certify, proofs, renderers
from validation.certify import Certificate, Proof, certify_scenes, hardest, prove_scene
from validation.compare import Judge
from validation.follow import Key
from validation.proofs import ALL, at_most, block, choose, decimals, pixel_record, proved, proved_or_not, split, words
from validation.renderers import Settings, Uncertainty
from validation.truth import Ball, Prover, Tie, Truth, UnprovedError, prove

FOLDER = Path(__file__).resolve().parents[2] / "scenes"
FILES = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.glob("*/*.txt"))


@pytest.mark.filterwarnings("ignore::tracer.SceneWarning")
@pytest.mark.parametrize("name", FILES)
def test_our_renderers_hold_what_they_claim(name: str) -> None:
    scene = tracer.load(FOLDER / name)
    proof = prove_scene(scene, pixels=150, edges=50, jobs=1)
    for renderer in ("native-f64", "native-f32"):
        found = certify.certify(scene, renderer, proof=proof, label=name)
        assert found.ok, found.misses
        assert found.ratio < 0.5, "tolerances are several times what is needed"
        assert found.random == min(150, scene.view.columns * scene.view.rows)
        assert not found.missing


# ---- planted mistakes


@pytest.fixture(scope="module")
def proof() -> Proof:
    """The scene with every pass."""
    return prove_scene(doubles.full(), pixels=400, edges=50, jobs=1)


def held(proof: Proof, draw: Any = doubles.faithful, **options: Any) -> Certificate:
    return certify.certify(proof.scene, Double(draw=draw, **options), proof=proof)


def entry(certificate: Certificate, name: str) -> certify.PassCertificate:
    (found,) = [entry for entry in certificate.passes if entry.pass_name == name]
    return found


def quiet(proof: Proof, name: str, where: Callable[[int], bool] = lambda _: True) -> tuple[int, int, int]:
    """A proved pixel that hits, far from every edge: its place, row and column."""
    claim = doubles.Double().uncertainty(proof.scene, proof.settings)
    edge = Judge(proof.scene, proof.settings, proof.analysis, claim, certify.PROVED).edge(name)
    found = [k for k in range(len(proof.x)) if not edge[proof.y[k], proof.x[k]] and proof.value["id"][k, 0] >= 0]
    place = next(k for k in found if where(k))
    return place, int(proof.y[place]), int(proof.x[place])


def test_a_faithful_renderer_holds(proof: Proof) -> None:
    found = held(proof)
    assert found.ok
    assert (found.wrong, found.wrong_margin, found.wrong_claim, found.misses) == (0, None, None, ())
    assert [entry.pass_name for entry in found.passes] == list(names(2, margins=False))
    assert (found.random, found.edge) == (400, 50)
    assert 400 <= found.proved <= 450
    assert 0 < found.ratio < 0.5
    assert found.error is not None
    assert 0 < found.error < 1e-12
    assert entry(found, "beauty").interior + entry(found, "beauty").edge == found.proved


@pytest.mark.parametrize("name", [name for name in names(2, margins=False) if not name.startswith("shadow")])
def test_one_wrong_value_is_caught(name: str, proof: Proof) -> None:
    place, y, x = quiet(proof, name)
    judge = Judge(
        proof.scene, proof.settings, proof.analysis, Double().uncertainty(proof.scene, proof.settings), certify.PROVED
    )
    allowed = float(judge.tolerance(name)[y, x])

    def plant(size: float) -> Callable[[doubles.Arrays], None]:
        def change(arrays: doubles.Arrays) -> None:
            value = arrays[name][y, x]
            arrays[name][y, x] = value + (1 if name == "id" else np.sign(value + 0.5) * size)

        return change

    found = held(proof, with_arrays(plant((0.8 if name == "normal" else 1.3) * allowed)))
    assert not found.ok
    assert found.over >= 1
    assert found.wrong == 1
    miss = found.misses[0]
    assert (miss.x, miss.y) == (x, y)
    assert miss.pass_name == name
    assert miss.claim >= 1
    assert miss.error > miss.tolerance
    assert miss.exact == proof.value[name][place].max() or name != "id"
    if name != "id":
        # An allowed error is measured, not caught. Of a normal the three channels' count together.
        near = held(proof, with_arrays(plant(0.45 * allowed)))
        assert near.ok
        assert 0.4 < entry(near, name).ratio < 1


def test_a_wrong_shadow_is_caught_where_it_is_compared(proof: Proof) -> None:
    def flip(y: int, x: int) -> Callable[[doubles.Arrays], None]:
        def change(arrays: doubles.Arrays) -> None:
            arrays["shadow.L1"][y, x] = 1 - arrays["shadow.L1"][y, x]

        return change

    _, y, x = quiet(proof, "shadow.L1", lambda k: bool(proof.lit[1][k]))
    found = held(proof, with_arrays(flip(y, x)))
    assert not found.ok
    assert (found.wrong, found.misses[0].pass_name) == (1, "shadow.L1")
    _, y, x = quiet(proof, "shadow.L1", lambda k: not proof.lit[1][k])
    assert held(proof, with_arrays(flip(y, x))).ok


def test_lit_is_where_the_light_is_above_the_surface(proof: Proof) -> None:
    for light, lit in zip(proof.scene.lights, proof.lit, strict=True):
        to_light = np.array(light.position) - proof.value["position"]
        facing = (to_light * proof.value["normal"]).sum(axis=1)
        hit = proof.value["id"][:, 0] >= 0
        assert (lit == (hit & (facing > 0))).all()


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["beauty", "depth", "normal"])
def test_what_is_no_number_is_caught(name: str, value: float, proof: Proof) -> None:
    _, y, x = quiet(proof, name)

    def plant(arrays: doubles.Arrays) -> None:
        arrays[name][y, x] = value

    found = held(proof, with_arrays(plant))
    assert not found.ok
    assert entry(found, name).error == math.inf
    json.dumps(found.record(), allow_nan=False)


@pytest.mark.parametrize(
    "draw",
    [
        with_settings(sample="center"),
        with_settings(max_reflections=1),
        doubles.with_scene(lambda scene: scene.replace(ambient=[1.001 * entry for entry in scene.ambient])),
        doubles.with_scene(lambda scene: scene.replace(spheres=scene.spheres[1:])),
    ],
    ids=["sample", "reflections", "ambient", "a sphere less"],
)
def test_another_picture_is_caught(draw: Any, proof: Proof) -> None:
    found = held(proof, draw)
    assert not found.ok
    assert found.wrong > 20
    assert found.wrong_claim is not None
    assert found.wrong_claim > 1e6
    assert len(found.misses) == certify.TOLD


def test_another_shadow_epsilon_is_caught() -> None:
    proof = prove_scene(doubles.contact(), pixels=1500, edges=50, jobs=1)
    found = held(proof, with_settings(shadow_epsilon=0.01))
    assert not found.ok
    assert entry(found, "shadow.L0").interior_over > 0
    assert entry(found, "id").interior_over == 0
    assert held(prove_scene(doubles.contact(), Settings(shadow_epsilon=0.01), pixels=300, edges=50, jobs=1)).ok


def test_a_wrong_decision_below_the_claim_is_counted_and_excused(proof: Proof) -> None:
    _, y, x = quiet(proof, "beauty")
    margin = min(float(kind[y, x]) for kind in proof.analysis.margins.values())

    def plant(arrays: doubles.Arrays) -> None:
        arrays["beauty"][y, x] += 0.5

    for factor, ok in ((1.5, True), (0.6, False)):
        claim = Uncertainty(*(4 * [factor * margin]), unit=1e-12)
        found = held(proof, with_arrays(plant), claim=claim)
        assert found.ok is ok
        assert found.wrong == 1
        assert found.wrong_margin == margin
        assert found.wrong_claim == pytest.approx(1 / factor)
        assert entry(found, "beauty").edge_over == int(ok)


def test_the_radius_of_a_proof_counts_as_error(proof: Proof) -> None:
    wide = replace(proof, radius={name: array + (name == "depth") for name, array in proof.radius.items()})
    found = held(wide)
    assert not found.ok
    assert {miss.pass_name for miss in found.misses} == {"depth"}
    assert entry(found, "depth").error == pytest.approx(1, abs=1e-9)


def test_where_only_one_hits_the_id_alone_is_wrong(proof: Proof) -> None:
    _, y, x = quiet(proof, "id")

    def plant(arrays: doubles.Arrays) -> None:
        arrays["id"][y, x], arrays["depth"][y, x], arrays["normal"][y, x] = -1, np.inf, 0

    found = held(proof, with_arrays(plant))
    assert [entry.pass_name for entry in found.passes if entry.interior_over] == ["id"]
    assert entry(found, "depth").interior == entry(held(proof), "depth").interior - 1


def test_no_decision_of_a_float_renderer_is_wrong_above_its_claim(proof: Proof) -> None:
    margins = {
        kind: np.full_like(array, 1.25 * EDGE_ROUNDINGS * 2.0**-53) for kind, array in proof.analysis.margins.items()
    }
    changed = replace(proof, analysis=replace(proof.analysis, margins=margins))
    native = renderers.get("native-f64")
    judge = Judge(
        proof.scene, proof.settings, changed.analysis, native.uncertainty(proof.scene, proof.settings), certify.PROVED
    )
    drawn = {name: array.copy() for name, array in native.render(proof.scene, ("beauty",), proof.settings).items()}
    assert certify.hold(Passes(drawn), native, changed, judge, ("beauty",), seed=0, label="").ok
    drawn["beauty"][proof.y[3], proof.x[3]] += 0.5
    found = certify.hold(Passes(drawn), native, changed, judge, ("beauty",), seed=0, label="")
    assert (found.over, found.wrong_claim, found.ok) == (1, 1.25, False)


@pytest.mark.parametrize(("roundings", "ok"), [(EDGE_ROUNDINGS - 2, True), (EDGE_ROUNDINGS + 2, False)])
def test_without_a_bound_no_decision_is_wrong_above_the_claim(
    roundings: int, ok: bool, proof: Proof, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Pretend that all pixels lack a bound, so that they are edges whatever their margins, and that they may be.
    monkeypatch.setattr(Judge, "edge_cap", lambda judge: judge.analysis.ids.size)
    monkeypatch.setattr(Judge, "edge", lambda judge, _: np.ones(judge.analysis.ids.shape, bool))
    margin = roundings * 2.0**-53
    margins = {kind: np.full_like(array, margin) for kind, array in proof.analysis.margins.items()}
    changed = replace(proof, analysis=replace(proof.analysis, margins=margins))
    native = renderers.get("native-f64")
    judge = Judge(
        proof.scene, proof.settings, changed.analysis, native.uncertainty(proof.scene, proof.settings), certify.PROVED
    )
    drawn = {name: array.copy() for name, array in native.render(proof.scene, ("beauty",), proof.settings).items()}
    drawn["beauty"][proof.y[3], proof.x[3]] += 0.5
    found = certify.hold(Passes(drawn), native, changed, judge, ("beauty",), seed=0, label="")
    assert (found.unit, found.over, found.wrong, found.wrong_margin) == (2.0**-53, 0, 1, margin)
    assert found.ok is ok


#: Two balls behind the eye touch in a point that the mirror before it shows.
TWIN = """NEAR 1
LEFT -1
RIGHT 1
BOTTOM -1
TOP 1
RES 4 4
SPHERE mirror 0 0 -4 1 1 1 0.5 0.5 0.5 0.1 0.5 0 1 1
SPHERE small 0 0 10 1 1 1 0.9 0.1 0.1 1 0 0 0 1
SPHERE large 0 0 11 2 2 2 0.1 0.1 0.9 1 0 0 0 1
BACK 0 0 0
AMBIENT 1 1 1
OUTPUT twin.ppm
"""


def test_a_pixel_that_nothing_settles_is_left_out() -> None:
    scene = tracer.loads(TWIN)
    proof = prove_scene(scene, pixels=ALL, jobs=1)
    (place,) = np.flatnonzero(proof.unsettled)
    assert (proof.x[place], proof.y[place]) == (2, 2)

    def plant(arrays: doubles.Arrays) -> None:
        arrays["beauty"][2, 2] = 7
        arrays["id"][2, 2] = -1

    found = held(proof, with_arrays(plant))
    assert found.ok
    assert (found.exempt, found.wrong, found.proved) == (1, 0, 16)
    assert entry(found, "beauty").interior + entry(found, "beauty").edge == 15


# ---- the parts


def test_errors_are_those_of_the_balls(proof: Proof) -> None:
    drawn = renderers.get("native-f64").render(proof.scene, names(2, margins=False), proof.settings)
    prover = Prover(proof.scene)
    for name in ("beauty", "position", "specular", "depth", "id"):
        values = np.asarray(drawn[name], dtype=float)[proof.y, proof.x].reshape(len(proof.x), -1)
        errors = certify.errors(values, proof, name)
        for place in range(0, len(proof.x), 7):
            balls = prover.pixel(int(proof.x[place]), int(proof.y[place])).values[name]
            expected = [ball.error(float(value)) for ball, value in zip(balls, values[place], strict=True)]
            assert errors[place] == pytest.approx(expected, rel=1e-14, abs=0)


def test_a_ball_in_two_floats() -> None:
    for numerator, exponent in ((3**80, -90), (-(7**50), -200), (1 << 200, 3), (5, 2), (0, 0), (1, -1074)):
        ball = Ball(numerator, exponent, 0.0)
        value, rest = split(ball)
        assert value == ball.value
        exact = fmpq(numerator) * fmpq(2) ** exponent
        left = abs(exact - fmpq(*value.as_integer_ratio()) - fmpq(*rest.as_integer_ratio()))
        assert left <= abs(exact) * fmpq(1, 2**105)
    assert split(Ball(None, 0, 0.0)) == (math.inf, 0.0)


def test_decimals_and_how_far_they_are() -> None:
    assert decimals(Ball(1, -2, 0.0), 30) == ("0.25", 0.0)
    assert decimals(Ball(3, 2, 1e-9), 30) == ("12", 1e-9)
    text, error = decimals(Ball(3602879701896397, -55, 1e-40), 20)  # 0.1 as a float64
    assert text == "0.10000000000000000555"
    assert error == pytest.approx(5e-21)
    third = Ball((1 << 200) // 3, -200, 1e-60)
    text, error = decimals(third, 40)
    assert text == "0." + 40 * "3"
    assert abs(third.middle() - fmpq(int(40 * "3"), 10**40)) <= fmpq(*error.as_integer_ratio())
    assert decimals(Ball(None, 0, 0.0), 9) == ("inf", 0.0)
    assert [at_most(value) for value in (1.01e-31, 1.99e-31, 0.5)] == ["1.1e-31", "2.0e-31", "0.5"]


def test_random_pixels_are_uniform_different_and_repeatable() -> None:
    scene = doubles.full()
    assert choose(scene, 50) == choose(scene, 50, seed=0)
    assert choose(scene, 50) != choose(scene, 50, seed=1)
    every = choose(scene, ALL)
    assert len(every) == len(set(every)) == 64 * 48
    many = [pixel for seed in range(40) for pixel in choose(scene, 200, seed)]
    assert set(many) <= set(every)
    assert all(len(set(choose(scene, 3000, seed))) == 3000 for seed in range(3))
    x, y = np.array(many).T
    # The mean of 8000 uniform numbers, within five of its standard deviations.
    assert abs(x.mean() - 31.5) < 5 * 18.5 / math.sqrt(8000)
    assert abs(y.mean() - 23.5) < 5 * 13.9 / math.sqrt(8000)


def test_the_hardest_pixels_are_those_of_the_smallest_margins() -> None:
    scene = doubles.full()
    analysis = tracer.margins.analyse(scene)
    margin = np.minimum.reduce(list(analysis.margins.values()))
    chosen = hardest(analysis, 30)
    assert len(set(chosen)) == 30
    assert max(margin[y, x] for x, y in chosen) <= np.sort(margin, axis=None)[29]
    assert hardest(analysis, ALL) != []
    assert len(hardest(analysis, ALL)) == np.isfinite(margin).sum()
    analysis.margins["order"][5, 7] = math.nan
    assert hardest(analysis, 1) == [(7, 5)], "what is no number may be anything"
    assert hardest(tracer.margins.analyse(scene.replace(spheres=[])), 10) == []


def test_other_processes_prove_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = doubles.full()
    pixels = choose(scene, 150)
    alone = list(proved(scene, pixels, jobs=2))
    monkeypatch.setattr(proofs, "TRIED", 10)
    monkeypatch.setattr(proofs, "WORTH_SECONDS", 0.0)
    assert list(proved(scene, pixels, jobs=2)) == alone
    assert [(truth.x, truth.y) for truth in alone] == pixels


WORDS = {
    Key("meets", 0, -1, 1): "the primary ray touches sphere 1 'egg'",
    Key("start", 2, -1, 0): "reflected ray 2 meets sphere 0 'ball' just where it begins to count",
    Key("ahead", 0, -1, 0): "the primary ray touches sphere 0 'ball' just where it begins to count",
    Key("order", 1, -1, 2, 0): "reflected ray 1 hits sphere 2 'floor' and sphere 0 'ball' at the same t",
    Key("faces", 0, 1, 0): "N.L = 0 at the primary hit for light 1 'right'",
    Key("shines", 3, 0, 0): "R.V = 0 at hit 3 for light 0 'left'",
    Key("meets", 0, 0, 2): "the shadow ray from the primary hit to light 0 'left' touches sphere 2 'floor'",
    Key("end", 1, 1, 2): "the shadow ray from hit 1 to light 1 'right' meets sphere 2 'floor' at the light",
    Key("at", 0, 1, 2): "the shadow ray from the primary hit to light 1 'right' has no length",
}


@pytest.mark.parametrize("key", WORDS)
def test_ties_in_words(key: Key) -> None:
    assert words(key, doubles.full()) == WORDS[key]


def test_a_tie_that_is_not_settled_is_told_with_what_it_may_be() -> None:
    scene = tracer.loads(TWIN)
    (truth,) = prove(scene, [(2, 2)])
    told = list(block(truth, scene))
    assert told[-4].startswith("  tie     reflected ray 1 hits sphere 2 'large' and sphere 1 'small' at the same t: ")
    assert max(map(len, told)) <= 100
    assert told[-3] == "          specification does not settle this"
    # The mirror's own 0.1 * 0.5 and what it shows.
    assert told[-2].startswith("          beauty (0.95")
    assert told[-2].endswith(" or")
    assert told[-1].startswith("          beauty (0.15")
    (tie,) = pixel_record(truth, scene)["ties"]
    assert (tie["settled"], tie["proved"], tie["kind"], tie["what"]) == ("", True, "order", "order")
    odd = Truth(0, 0, -1, truth.values, (Tie(truth.ties[0].key, "", ((1.0, 0.2, 0.2),), proved=False),), 512)
    told = list(block(odd, scene))
    assert ", or almost: the specification does not settle this" in " ".join(" ".join(told).split())
    assert told[-1].endswith("makes no difference to beauty")


# ---- several scenes and renderers


def test_what_a_renderer_lacks_is_said() -> None:
    found = certify_scenes({"full": doubles.full()}, [Double(missing=("specular", "id"))], pixels=30, edges=5, jobs=1)
    assert found.status == 0
    assert found.certificates[0].missing == ("specular", "id")


def test_a_renderer_that_cannot_is_no_success() -> None:
    refuses = certify_scenes({"full": doubles.full()}, [Double(refuses=True)], pixels=3, edges=0, jobs=1)
    assert (refuses.status, refuses.certificates) == (3, [])
    assert "cannot carry this scene" in refuses.notes[0].message
    absent = certify_scenes({"full": doubles.full()}, [Double(absent="get it")], pixels=3, edges=0, jobs=1)
    assert (absent.status, absent.failures[0].message) == (3, "get it")


def small(scene: tracer.Scene, passes: Any, settings: Settings) -> Passes:
    return doubles.faithful(scene.replace(view=scene.view.replace(columns=5)), passes, settings)


def less(scene: tracer.Scene, passes: Any, settings: Settings) -> Passes:
    return doubles.faithful(scene, [name for name in passes if name != "depth"], settings)


def broken(*_: Any) -> Passes:
    raise RuntimeError("no luck")


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (small, "delivered 5x48 pixels, expected 64x48"),
        (less, "did not deliver the pass 'depth'"),
        (broken, "failed: RuntimeError: no luck"),
    ],
)
def test_a_renderer_that_fails(draw: Any, message: str) -> None:
    scenes = {"full": doubles.full(), "cut": doubles.cut()}
    found = certify_scenes(scenes, [Double(draw=draw), "native-f64"], pixels=5, edges=0, jobs=1)
    assert found.status == 3
    assert message in [note.message for note in found.failures]
    assert [entry.renderer for entry in found.certificates] == ["native-f64", "native-f64"]


def test_a_slow_renderer_is_certified_at_a_smaller_size() -> None:
    slow = Double(limit=768)
    found = certify_scenes({"full": doubles.full()}, [slow, "native-f64"], pixels=ALL, edges=3, jobs=1)
    assert slow.rendered == [(32, 24)]
    assert [(entry.size, entry.random) for entry in found.certificates] == [((32, 24), 768), ((64, 48), 3072)]
    assert "certified at 32x24 instead of 64x48" in found.notes[0].message


def test_where_no_pixel_can_be_proved_nothing_is_certified(unproved: Any) -> None:
    unproved(lambda *_: True)
    found = certify_scenes({"full": doubles.full()}, ["native-f64", "numpy-f64"], pixels=3, edges=0, jobs=1)
    assert (found.status, len(found.failures), found.failures[0].message) == (3, 1, "no pixel could be proved")
    assert not found.certificates


@pytest.fixture
def unproved(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Make some pixels ones of which truth cannot be had."""
    pixel = Prover.pixel

    def refusing(which: Callable[[int, int], bool]) -> None:
        def proves(prover: Prover, x: int, y: int, **options: Any) -> Truth:
            if which(x, y):
                raise UnprovedError(f"pixel {x} {y}: not enough")
            return pixel(prover, x, y, **options)

        monkeypatch.setattr(Prover, "pixel", proves)

    return refusing


def test_a_pixel_that_cannot_be_proved_is_left_out(unproved: Any, run: Any, scene: Path, tmp_path: Path) -> None:
    unproved(lambda x, y: (x, y) in [(3, 2), (4, 2), (63, 47)])
    file = tmp_path / "c.json"
    result = run(scene, "--renderer", "native-f64", "--pixels", "all", "--edges", "0", "--json", file)
    assert (result.status, result.err) == (0, "")
    assert "native-f64: 3 pixels could not be proved, for example 3 2\n" in result.out
    (entry,) = strict(file.read_text())["certificates"]
    assert entry["unproved"] == [[3, 2], [4, 2], [63, 47]]
    assert (entry["proved"], entry["random"]) == (64 * 48 - 3, 64 * 48 - 3)


def test_what_cannot_be_proved_by_other_processes(unproved: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, pixels = doubles.full(), choose(doubles.full(), 40)

    def together(scene: tracer.Scene, pixels: Any, settings: Any = None, *, jobs: Any = None) -> Any:
        # Ten at once, as other processes do: what comes before the one that fails is lost with it.
        del jobs
        for place in range(0, len(pixels), 10):
            yield from list(prove(scene, pixels[place : place + 10], settings, jobs=1))

    unproved(lambda x, y: (x, y) in [pixels[7], pixels[8], pixels[25], pixels[39]])
    monkeypatch.setattr(proofs, "prove", together)
    found = list(proved_or_not(scene, pixels))
    assert [k for k, truth in enumerate(found) if truth is None] == [7, 8, 25, 39]
    assert [(truth.x, truth.y) for truth in found if truth] == [p for k, p in enumerate(pixels) if found[k]]
    assert len(found) == 40


def test_who_claims_too_little_is_not_excused(run: Any, scene: Path, registered: Any, tmp_path: Path) -> None:
    def dark(arrays: doubles.Arrays) -> None:
        arrays["beauty"][:] = 0

    registered(Double(draw=with_arrays(dark), claim=Uncertainty(9.0, 9.0, 9.0, 9.0, 1e-9)))
    file = tmp_path / "c.json"
    result = run(scene, "--renderer", "double", "--pixels", "60", "--edges", "9", "--json", file)
    assert result.status == 1
    assert "full.txt (double): too many edge pixels: " in result.out
    assert f"\n  hint: whitted explain {scene} " in result.out
    (entry,) = strict(file.read_text())["certificates"]
    assert (entry["ok"], entry["over"]) == (False, 0)
    assert entry["edge_pixels"] > entry["edge_cap"]


# ---- the command


@pytest.fixture
def run(run: Any) -> Any:
    """Run `whitted truth` in this process."""
    return functools.partial(run, "truth")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene file."""
    path = tmp_path / "full.txt"
    path.write_text(doubles.FULL)
    return path


def test_pixels_one_by_one(run: Any, scene: Path) -> None:
    result = run(scene, "--at", "30", "20", "--at", "0", "0")
    assert (result.status, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[0] == f"{scene} 64x48"
    assert lines[1:3] == ["pixel 30 20", "  id      sphere 0 'ball'"]
    (truth,) = prove(doubles.full(), [(30, 20)])
    for line, ball in zip(lines[3:6], truth.values["beauty"], strict=True):
        number, error = line.split()[-3], float(line.split()[-1])
        assert len(number.lstrip("0.")) >= 25
        whole, _, part = number.partition(".")
        shown = fmpq(int(whole + part), 10 ** len(part))
        assert abs(shown - ball.middle()) + fmpq(*ball.radius.as_integer_ratio()) <= fmpq(*error.as_integer_ratio())
    assert lines[6].startswith("  bits    ")
    assert "pixel 0 0" in lines
    assert run(scene, "--at", "3", "4", "--at", "3", "4").out.count("pixel 3 4") == 1
    assert run(scene).out.count("pixel ") == 10


def test_a_tie_is_told(run: Any, tmp_path: Path) -> None:
    result = run(FOLDER / "spec" / "exact-tangents.txt", "--at", "96", "122")
    assert "  tie     the primary ray touches sphere 0 'needle': a ray that touches a sphere hits it\n" in result.out
    assert "          beauty (0.2, 0.25, 0.35)\n" in result.out
    twin = tmp_path / "twin.txt"
    twin.write_text(TWIN)
    assert "does not settle" in run(twin, "--at", "2", "2").out


def test_many_pixels_in_sum(run: Any, scene: Path) -> None:
    result = run(scene, "--pixels", "100", "--seed", "3")
    assert (result.status, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[1].startswith("  proved         100 pixels: ")
    hits = sum(truth.id >= 0 for truth in prove(doubles.full(), choose(doubles.full(), 100, 3)))
    assert f": {hits} hit, {100 - hits} background" in lines[1]
    assert "largest radius" in lines[2]
    assert "bits           128: " in lines[3]
    assert lines[5].endswith(" pixels a second a core")
    assert run(scene, "--pixels", "100", "--seed", "3").out.splitlines()[:5] == lines[:5]


def test_more_pixels_than_there_are(run: Any, scene: Path) -> None:
    assert run(scene, "--size", "4x3", "--pixels", "12").out.startswith(f"{scene} 4x3, every pixel\n")
    assert run(scene, "--size", "4x3", "--pixels", "99").out.count("pixel ") == 12
    assert run(scene, "--size", "4x3", "--pixels", "all").out.count("pixel ") == 12


@pytest.mark.parametrize("pixels", ["5", "30"])
def test_the_json_is_strict_and_has_every_pixel(pixels: str, run: Any, scene: Path, tmp_path: Path) -> None:
    (tmp_path / "cut.txt").write_text(doubles.CUT)
    file = tmp_path / "r.json"
    options = ("--sample", "center", "--max-reflections", "1", "--shadow-epsilon", "0.01")
    result = run(tmp_path, "--pixels", pixels, *options, "--json", file)
    assert result.status == 0
    record = strict(file.read_text())
    assert record["command"][:2] == ["whitted", "truth"]
    assert record["settings"] == {"sample": "center", "shadow_epsilon": 0.01, "max_reflections": 1, "threads": 0}
    assert "whitted" in record["versions"]
    assert [entry["scene"] for entry in record["scenes"]] == [str(tmp_path / "cut.txt"), str(scene)]
    settings = Settings("center", 0.01, 1)
    for entry, loaded in zip(record["scenes"], (doubles.cut(), doubles.full()), strict=True):
        assert entry["size"] == [loaded.view.columns, loaded.view.rows]
        assert entry["summary"]["pixels"] == len(entry["pixels"]) == int(pixels)
        wanted = choose(loaded, int(pixels))
        assert [(pixel["x"], pixel["y"]) for pixel in entry["pixels"]] == wanted
        for pixel, truth in zip(entry["pixels"], prove(loaded, wanted, settings), strict=True):
            assert pixel["id"] == truth.id
            assert list(pixel["values"]) == list(truth.values)
            assert [float(text) for text in pixel["beauty"]] == [ball.value for ball in truth.values["beauty"]]
            depth = pixel["values"]["depth"]["value"][0]
            assert float(depth) == truth.values["depth"][0].value
            assert pixel["values"]["beauty"]["radius"] == [ball.radius for ball in truth.values["beauty"]]


@pytest.mark.parametrize("ending", ["npz", "exr", "png", "ppm"])
def test_the_proved_image_is_one_to_compare(ending: str, run: Any, scene: Path, tmp_path: Path) -> None:
    file = tmp_path / f"proved.{ending}"
    result = run(scene, "--size", "24x18", "--pixels", "all", "-o", file, "--jobs", "1")
    assert (result.status, result.err) == (0, "")
    assert result.out.splitlines()[-1] == str(file)
    if ending in ("png", "ppm"):
        assert file.stat().st_size > 0
        return
    stored = Passes.load(file)
    assert list(stored) == list(names(2, margins=False))
    assert stored.metadata["renderer"] == "truth"
    drawn = renderers.get("native-f64").render(
        doubles.full().replace(view=doubles.full().view.replace(columns=24, rows=18)), tuple(stored), Settings()
    )
    limit = 1e-9 if ending == "npz" else 1e-4
    for name in stored:
        known = np.isfinite(drawn[name])
        assert (np.isfinite(stored[name]) == known).all()
        np.testing.assert_allclose(stored[name][known], drawn[name][known], rtol=0, atol=limit)


def test_renderers_held_against_the_truth(run: Any, scene: Path, tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    words = ("--renderer", "native-f64,native-f32", "--pixels", "60", "--edges", "9", "--json", file)
    result = run(scene, *words)
    assert (result.status, result.err) == (0, "")
    assert "native-f64 against proved values" in result.out
    assert "native-f32 against proved values" in result.out
    assert result.out.count(" holds ") == 2
    assert "2 of 2 certificates hold" in result.out
    record = strict(file.read_text())
    assert record["ok"] is True
    assert (record["pixels"], record["edges"], record["seed"]) == (60, 9, 0)
    assert [entry["renderer"] for entry in record["certificates"]] == ["native-f64", "native-f32"]
    first = record["certificates"][0]
    assert (first["random"], first["edge"], first["seed"], first["unit"]) == (60, 9, 0, 2.0**-53)
    assert {entry["pass"] for entry in first["passes"]} == set(names(2, margins=False))


def test_a_renderer_that_is_wrong(run: Any, scene: Path, tmp_path: Path, registered: Any) -> None:
    def plant(arrays: doubles.Arrays) -> None:
        arrays["depth"][20, 30] += 0.25
        arrays["beauty"][2, 2] = np.nan

    registered(Double(draw=with_arrays(plant)))
    file = tmp_path / "c.json"
    result = run(scene, "--renderer", "double,native-f64", "--pixels", "all", "--edges", "0", "--json", file)
    assert result.status == 1
    assert "WRONG" in result.out
    assert "depth (double): pixel x 30, y 20: " in result.out
    assert "beauty (double): pixel x 2, y 2 R: nan, exact is " in result.out
    assert "1 of 2 certificates hold" in result.out
    assert result.out.count(f"\n  hint: whitted explain {scene} ") == 1
    x, y = result.out.partition(f"  hint: whitted explain {scene} ")[2].split()[:2]
    assert (int(x), int(y)) in [(30, 20), (2, 2)]
    assert f"explain {scene} {x} {y} --renderer double\n" in result.out
    record = strict(file.read_text())
    assert [entry["ok"] for entry in record["certificates"]] == [False, True]
    assert len(record["certificates"][0]["misses"]) == 2


def test_scenes_that_cannot_be_drawn(run: Any, tmp_path: Path) -> None:
    far = tmp_path / "far.txt"
    far.write_text(doubles.CUT.replace("SPHERE shell 0.1 ", "SPHERE shell 1e20 "))
    result = run(far, "--renderer", "native-f32", "--pixels", "3", "--edges", "0")
    assert result.status == 2
    assert f"{far}: error: SPHERE: found '1e+20'" in result.err
    assert "hint: render it in float64" in result.err
    assert "nothing was certified, 1 failure" in result.out


#: The command line (SCENE stands for a scene file), what its error says, and what its hint says.
WRONG = {
    "no pixel": ("SCENE --pixels 0", "'0' is not a number of pixels from 1 on, or 'all'", "--pixels all every one"),
    "negative": ("SCENE --pixels -1", "'-1' is not a number of pixels from 1 on, or 'all'", "--pixels all every one"),
    "a word": ("SCENE --pixels x", "'x' is not a number of pixels", "--pixels all every one"),
    "a part": ("SCENE --pixels 1.5", "'1.5' is not a number of pixels", "--pixels all every one"),
    "digits": ("SCENE --pixels ٣", "'٣' is not a number of pixels", "--pixels all every one"),
    "edges": ("SCENE --edges 5", "--edges is for holding renderers", "--renderer NAME"),
    "negative edges": (
        "SCENE --renderer native-f64 --edges -5",
        "--edges: '-5' is not a whole number from 0 on",
        "see `whitted truth --help`",
    ),
    "seed": ("SCENE --seed -1", "'-1' is not a whole number from 0 on", "see `whitted truth --help`"),
    "jobs": ("SCENE --jobs 0", "'0' is not a whole number from 1 to 1024", "see `whitted truth --help`"),
    "renderer": ("SCENE --renderer nativ-f64", "unknown renderer 'nativ-f64'", "did you mean 'native-f64'?"),
    "no scene": ("", "missing argument 'SCENE_OR_FOLDER...'", "see `whitted truth --help`"),
    "no file": ("nowhere.txt", "nowhere.txt: error: no such file or folder", ""),
    "both": ("SCENE --at 1 1 --pixels 5", "--at and --pixels exclude each other", "--pixels takes random ones"),
    "at and renderer": (
        "SCENE --at 1 2 --renderer native-f64",
        "--at is for proving alone",
        "full.txt 1 2 --renderer native-f64",
    ),
    "too large a seed": ("SCENE --seed 99999999999999999999", "--seed: '99999999999999999999' is too large", "see"),
    "too many pixels": ("SCENE --pixels 99999999999999999999", "is too large", "--pixels all every one"),
    "memory": (
        "SCENE --size 100000x100000 --pixels all",
        "full.txt: error: 15 passes of 100000x100000 pixels need 2960000000000 bytes",
        "a smaller --size, or fewer --pixels",
    ),
    "output and renderer": ("SCENE -o x.npz --renderer native-f64", "--output is for proving alone", "leave out"),
    "no column": ("SCENE --at 64 0", "full.txt has no pixel 64 0", "columns are 0 to 63 from the left, rows 0 to 47"),
    "no row": ("SCENE --at 0 48", "full.txt has no pixel 0 48", "rows 0 to 47 from the top"),
    "negative column": ("SCENE --at -1 0", "'-1' is no column or row of an image", "--at X Y"),
    "two words": ("SCENE --at a b", "--at: 'a' is no column or row of an image", "from 0 at the top left: --at X Y"),
    "one number": ("SCENE --at 200", "--at: found fewer than two numbers", "a column and a row"),
    "one number, an option": ("SCENE --at 200 --jobs", "'--jobs' is no column or row of an image", "--at X Y"),
    "half an image": ("SCENE -o x.npz --pixels 5", "x.npz would hold a whole image", "--pixels all proves every pixel"),
    "ending": ("SCENE -o x.jpg --pixels all", "unknown file ending '.jpg'", "expected .exr, .npz, .png or .ppm"),
    "two scenes": ("SCENE OTHER -o x.npz --pixels all", "x.npz holds one image, but there are 2", "name one scene"),
    "json folder": ("SCENE --json no/where.json", "there is no folder no", "mkdir -p no"),
    "output folder": ("SCENE --pixels all -o no/x.npz", "there is no folder no", "mkdir -p no"),
    "wide": ("SCENE --size 100001x1", "--size 100001x1: at most 100000 columns", "--no-limits allows more"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_in_one_sentence_with_a_hint(
    case: str, run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words, message, hint = WRONG[case]
    other = tmp_path / "other.txt"
    other.write_text(doubles.CUT)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    files = {"SCENE": scene, "OTHER": other}
    result = run(*[files.get(word, word) for word in words.split()])
    assert (result.status, result.out) == (2, "")
    lines = result.err.rstrip("\n").split("\n")
    assert message in lines[0]
    assert "error: " in lines[0]
    assert len(lines) == (2 if hint else 1)
    if hint:
        assert lines[1].startswith("  hint: ")
        assert hint in lines[1]
    assert sorted(tmp_path.rglob("*")) == before, "nothing is written"


def test_a_pixel_that_cannot_be_proved(run: Any, scene: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise UnprovedError("pixel 1 2: 65536 bits are not enough")

    monkeypatch.setattr(proofs, "prove", refuse)
    result = run(scene, "--json", tmp_path / "x.json")
    assert (result.status, result.out) == (3, "")
    assert (
        result.err
        == "error: truth could not be had: pixel 1 2: 65536 bits are not enough\n  hint: --at proves other pixels\n"
    )
    assert not (tmp_path / "x.json").exists()


def test_help_shows_examples_and_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom validation.cli import main\n"
        "try:\n    main(['truth', '--help'])\nfinally:\n    print('LOADED', *sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert not {"numpy", "rich", "tracer", "flint", "mitsuba"} & set(done.stderr.partition("LOADED")[2].split())
    assert "\n  $ whitted truth scenes/gallery/mirrors.txt --at 200 150\n" in done.stdout
    assert "default: 10" in done.stdout


@pytest.mark.parametrize(("end", "group"), [(signal.SIGINT, True), (signal.SIGTERM, True), (signal.SIGTERM, False)])
def test_ended_from_outside_it_leaves_nothing(end: signal.Signals, group: bool, tmp_path: Path, need: Any) -> None:
    need(Path("/proc/self/task").exists(), "no /proc that names the children of a process")
    endless = tmp_path / "endless.txt"
    endless.write_text(doubles.FULL.replace("RES 64 48", "RES 1000 750"))
    words = ["truth", str(endless), "--pixels", "all", "--jobs", "2"]
    with subprocess.Popen(
        [sys.executable, "-m", "validation", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        deadline = time.monotonic() + 60
        while len(children.read_text().split()) < 3 and time.monotonic() < deadline:  # the tracker and two workers
            time.sleep(0.05)
        if group:
            os.killpg(process.pid, end)  # as a terminal does: to all of them
        else:
            process.send_signal(end)
        try:
            out, err = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    status, word = (130, "interrupted") if end == signal.SIGINT else (143, "terminated")
    assert process.returncode == status
    assert re.fullmatch(rf"{word}: \d+ of 750000 pixels were finished", err.strip())
    assert "  proved         " in out
    while time.monotonic() < deadline + 30:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("processes are left")


def test_interrupted_it_leaves_no_file(run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(proofs, "pixel_record", interrupt)
    assert run(scene, "--json", tmp_path / "r.json") == Result(
        130, "", "\ninterrupted: nothing was finished, nothing was written\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["full.txt"]


def test_wrong_pixels_of_a_renderer_that_holds_are_accounted_for(run: Any) -> None:
    words = ("--size", "60x60", "--pixels", "all", "--edges", "0")
    result = run(FOLDER / "spec" / "touching-spheres.txt", "--renderer", "native-f32", *words)
    assert result.status == 0
    assert " holds " in result.out
    told = (
        "holds though some are wrong: their decisions are nearer, below 64 u or 1 uncertainty, than it claims to tell"
    )
    assert f"\n{told}\n" in result.out
    other = run(FOLDER / "spec" / "touching-spheres.txt", "--renderer", "native-f64", *words)
    assert "though some are wrong" not in other.out


def test_interrupted_the_certificates_are_kept(
    run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, file = certify.certify, tmp_path / "r.json"

    def once(*arguments: Any, **more: Any) -> Any:
        if arguments[1].name == "numpy-f64":
            raise KeyboardInterrupt
        return real(*arguments, **more)

    monkeypatch.setattr(certify, "certify", once)
    words = ("--pixels", 20, "--edges", 5, "--jobs", 1, "--json", file)
    result = run(scene, "--renderer", "native-f64,numpy-f64", *words)
    assert result.status == 130
    assert result.out.endswith("\n1 of 1 certificates hold\n")
    assert result.err == f"\ninterrupted: kept {file} with 1 of 2 certificates\n"
    record = strict(file.read_text())
    assert (record["ok"], record["interrupted"]) == (False, True)
    assert [entry["renderer"] for entry in record["certificates"]] == ["native-f64"]
    file.unlink()
    assert run(scene, "--renderer", "numpy-f64", *words).out == ""
    assert not file.exists()
