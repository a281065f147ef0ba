"""Margins and sensitivities of the NumPy reference against truth, which differentiates along each pixel's exact path.

Truth shares no code with the reference: its derivatives are differences of proved quantities, number by number. What is
asserted here are the figures of docs/tolerances.md, section 5.
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from flint import arb, fmpq

import tracer
from tracer import Scene
from tracer.margins import Analysis, analyse
from tracer.motion import NEAR
from tracer.passes import MARGINS
from validation.flips import Flip, changed, flips, sensitivity
from validation.follow import Key, rational
from validation.truth import Prover, Truth

sys.path.append(str(Path(__file__).resolve().parents[1] / "tracer"))
import scene_zoo as zoo

FOLDER = Path(__file__).resolve().parents[2] / "scenes"
NAMES = [
    f"gallery/{name}" for name in ("hall", "lantern", "mirrors", "nested", "planets", "plates", "shadows", "sunset")
]
NAMES += [f"spec/{name}" for name in ("equal-hits", "exponent-half", "eye-inside", "light-inside", "touching-spheres")]
NAMES += ["eye-inside", "plate", "cut", "crossing", "mutual", "corridor", "n-half", "far-off-axis", "light-on-surface"]
NAMES += [f"{kind}-{seed}" for kind in ("ordinary", "wild") for seed in range(6)]
SIZE = 40
#: First order is held against margins up to this.
SMALL = 1e-3
#: Below this the margins of ties are rounded to.
TIE = 1e-11


@functools.cache
def scene(name: str) -> Scene:
    """A scene of the zoo, or a bundled one, with few pixels."""
    kind, _, seed = name.partition("-")
    if "/" in name:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tracer.errors.SceneWarning)
            found = tracer.load(FOLDER / f"{name}.txt")
    elif kind in ("ordinary", "wild"):
        found = (zoo.ordinary if kind == "ordinary" else zoo.wild)(int(seed))
    else:
        found = zoo.hard()[name]
    return found.replace(view=found.view.replace(columns=SIZE, rows=SIZE))


@functools.cache
def analysis(name: str) -> Analysis:
    """The margins of a scene."""
    return analyse(scene(name))


def near(name: str, kind: str, count: int, below: float) -> Iterator[tuple[int, int]]:
    """Some pixels (column, row) whose margins of a kind are below a bound, ties excepted."""
    margin = analysis(name).margins[kind]
    order = np.argsort(margin, axis=None, kind="stable")
    places = [int(place) for place in order if TIE < margin.flat[place] < below]
    for place in places[:: max(1, len(places) // count)][:count]:
        row, column = divmod(place, margin.shape[1])
        yield column, row


class Outcome(NamedTuple):
    """What a pixel's decisions come to."""

    hits: tuple[tuple[int, bool], ...]  # sphere, inside
    lights: dict[tuple[int, int], bool]  # by bounce and light, where N.L > 0: whether it is visible


def outcome(prover: Prover, x: int, y: int) -> Outcome:
    """The decisions of a pixel that show."""
    hits, _ = prover.examine(x, y)
    lights = {(hit.bounce, s.light): not s.blockers for hit in hits for s in hit.sights if s.faces > 0}
    return Outcome(tuple((hit.sphere, hit.inside) for hit in hits), lights)


def differ(a: Outcome, b: Outcome) -> bool:
    """Whether any decision is different; a light that one of the two does not face counts for nothing."""
    return a.hits != b.hits or any(a.lights[key] != b.lights[key] for key in a.lights.keys() & b.lights.keys())


def shaken(prover: Prover, x: int, y: int, delta: float, random: np.random.Generator) -> Prover:
    """Every number off by delta, up or down, and the ray by delta of its length."""
    step = rational(delta)
    signs = {name: int(random.choice((-1, 1))) * step for name in prover.numbers.of}
    direction = np.array([float(arb(component)) for component in prover.direction(x, y)])
    turn = random.normal(size=3)
    turn *= delta * np.linalg.norm(direction) / np.linalg.norm(turn)
    a, b, c = (rational(float(component)) for component in turn)
    return prover.with_numbers(prover.numbers.changed(signs), (a, b, c))


def unmoved(prover: Prover, x: int, y: int, delta: float) -> None:
    """No change of all numbers by delta changes a decision: neither one that heads for a flip, nor any other."""
    random = np.random.default_rng(7)
    before = outcome(prover, x, y)
    directed = [changed(prover, x, y, flip, delta) for flip in flips(prover, x, y)[:4] if flip.margin > 0]
    for other in [*directed, *(shaken(prover, x, y, delta, random) for _ in range(3))]:
        assert not differ(before, outcome(other, x, y)), f"pixel {x} {y} changes at {delta:.3e}"


@pytest.mark.parametrize("name", NAMES)
def test_no_decision_changes_below_half_its_margin(name: str) -> None:
    margins = np.min(list(analysis(name).margins.values()), axis=0)
    for x, y in {pixel for kind in MARGINS for pixel in near(name, kind, 4, SMALL)}:
        if margins[y, x] > TIE:
            # Half, for the second order: after three mirrors it tells at margins of 1e-4.
            unmoved(Prover(scene(name)), x, y, 0.5 * float(margins[y, x]))


# ---- one step before a decision changes, where only the first order is left


def cropped(scene: Scene, x: int, y: int) -> Scene:
    """A scene of that pixel alone."""
    view = scene.view
    left = view.left + (view.right - view.left) * x / view.columns
    top = view.top - (view.top - view.bottom) * y / view.rows
    frame = view.replace(left=left, right=left + 1, top=top, bottom=top - 1, columns=1, rows=1)
    return scene.replace(view=frame)


def towards(prover: Prover, flip: Flip, delta: float) -> Prover:
    """All numbers off by delta, the way that flips a decision; the ray moves with the view alone."""
    step = rational(delta)
    return prover.with_numbers(prover.numbers.changed({n: rational(s) * step for n, s in flip.signs.items()}))


def as_scene(prover: Prover) -> Scene:
    """The scene of a prover's numbers, as far as they are lengths."""

    def number(name: str) -> float:
        value = prover.numbers.of[name]
        return int(value.p) / int(value.q)

    def vector(name: str) -> tuple[float, float, float]:
        return number(f"{name}.0"), number(f"{name}.1"), number(f"{name}.2")

    old = prover.scene
    edges = {side: number(f"view.{side}") for side in ("near", "left", "right", "bottom", "top")}
    spheres = [
        s.replace(position=vector(f"s{j}.position"), scaling=vector(f"s{j}.scaling")) for j, s in enumerate(old.spheres)
    ]
    lights = [light.replace(position=vector(f"l{i}.position")) for i, light in enumerate(old.lights)]
    return old.replace(view=old.view.replace(**edges), spheres=spheres, lights=lights)


def turning_point(prover: Prover, flip: Flip) -> tuple[float, float] | None:
    """The changes of all numbers between which the quantity of a decision changes its sign; None if it does not."""

    def sign(delta: float) -> bool | None:
        found = towards(prover, flip, delta).examine(0, 0)[1].get(flip.key)
        return None if found is None else bool(found > 0)

    start, low, high = sign(0.0), 0.0, flip.margin
    for _ in range(6):
        if (found := sign(high)) is None:
            return None
        if found != start:
            break
        low, high = high, 1.5 * high
    else:
        return None
    for _ in range(24):
        middle = (low + high) / 2
        if (found := sign(middle)) is None:
            return None
        low, high = (middle, high) if found == start else (low, middle)
    return low, high


def jumps(a: Prover, b: Prover, key: Key) -> bool:
    """Whether what is compared jumps between two nearly equal scenes, on both sides of a decision."""
    first, second = a.pixel(0, 0, ties=False), b.pixel(0, 0, ties=False)
    faces = [{k.light for k, g in p.examine(0, 0)[1].items() if k[:2] == ("faces", 0) and g > 0} for p in (a, b)]
    if key[:2] == ("faces", 0):
        # Where N.L > 0 the pass `shadow` is compared.
        side = first if key.light in faces[0] else second
        return side.values[f"shadow.L{key.light}"][0].value == 1
    return first.id != second.id or any(
        jump(name, first, second, faces[0] & faces[1]) for name in first.values if name != "id"
    )


def jump(name: str, a: Truth, b: Truth, lit: set[int]) -> bool:
    """Whether a pass is not nearly equal."""
    if name.startswith("shadow.L"):
        return int(name.removeprefix("shadow.L")) in lit and a.values[name] != b.values[name]
    pairs = [(p.value, q.value) for p, q in zip(a.values[name], b.values[name], strict=True)]
    return any(p != q and abs(p - q) > 1e-4 * max(1.0, abs(p)) for p, q in pairs)


class Step(NamedTuple):
    """A scene of one pixel, just before a decision changes that shows."""

    scene: Scene
    flip: Flip
    margins: dict[str, float]
    place: str


@functools.cache
def steps(kind: str) -> list[Step]:
    """Some of a kind, of all scenes."""
    # A light that lies on a surface does so by the exact numbers only.
    names = [name for name in NAMES if name != "light-on-surface"]
    count = 4 if kind in ("silhouette", "terminator") else 16
    pixels = [(name, x, y) for name in names for x, y in near(name, kind, count, NEAR)]
    return [step for name, x, y in pixels for step in steps_of(name, x, y, kind)]


def steps_of(name: str, x: int, y: int, kind: str) -> Iterator[Step]:
    """That of the decision of a pixel that changes first."""
    prover = Prover(cropped(scene(name), x, y))
    for flip in [flip for flip in flips(prover, 0, 0) if flip.kind == kind and 0 < flip.margin < 2 * NEAR][:4]:
        if (between := turning_point(prover, flip)) is None:
            continue
        before, after = (towards(prover, flip, delta) for delta in between)
        close = as_scene(before)
        # The first that changes there, or else something else changed on the way.
        first = flips(Prover(close), 0, 0)[0]
        if first.key == flip.key and TIE < first.margin < 1e-6 and jumps(before, after, flip.key):
            margins = {k: float(m[0, 0]) for k, m in analyse(close).margins.items()}
            yield Step(close, first, margins, f"{name} {x} {y} {flip.key}")
            return


@pytest.mark.parametrize("kind", MARGINS)
def test_margins_are_those_of_truth(kind: str) -> None:
    found = sorted((step.margins[kind] / step.flip.margin, step.place) for step in steps(kind))
    shares = [share for share, _ in found]
    assert len(shares) >= 10
    # What is missing is what roundings take, more of it after each mirror.
    assert found[-1][0] <= 1, found[-1]
    assert found[0][0] >= 0.3, found[0]
    assert np.quantile(shares, 0.1) >= 0.5
    assert np.median(shares) >= 0.6


def decided_otherwise(prover: Prover, flip: Flip, delta: float) -> bool:
    """Whether a change of all numbers and of the ray by delta changes a decision."""
    found = changed(prover, 0, 0, flip, delta).examine(0, 0)[1].get(flip.key)
    return found is None or bool(found > 0) != (flip.sign > 0)


@pytest.mark.parametrize("kind", MARGINS)
def test_nothing_changes_just_below_a_margin_and_something_a_little_above(kind: str) -> None:
    above = {2.1: 0, 3.4: 0}
    for step in steps(kind):
        prover = Prover(step.scene)
        unmoved(prover, 0, 0, 0.999 * min(step.margins.values()))
        for factor in above:
            above[factor] += decided_otherwise(prover, step.flip, factor * step.margins[kind])
    assert above[2.1] >= 0.9 * len(steps(kind))
    assert above[3.4] == len(steps(kind))


# ---- values


@functools.cache
def sensitivities(name: str) -> list[tuple[str, float, float]]:
    """Of some pixels and all passes: the place, how far truth's largest channel moves, and our sensitivity."""
    prover, found = Prover(scene(name)), analysis(name)
    margins = np.min(list(found.margins.values()), axis=0)
    rows, columns = np.nonzero((found.ids >= 0) & (margins > TIE))
    chosen = np.random.default_rng(5).choice(rows.size, min(8, rows.size), replace=False)
    return [
        (f"{pass_name} {x} {y}", max(exact), float(found.sensitivity[pass_name][y, x]))
        for x, y in ((int(columns[place]), int(rows[place])) for place in chosen)
        for pass_name, exact in sensitivity(prover, x, y).items()
    ]


@pytest.mark.parametrize("name", NAMES)
def test_sensitivities_are_no_less_than_truths(name: str) -> None:
    for place, exact, ours in sensitivities(name):
        assert exact <= 1.0001 * ours, place


def test_sensitivities_are_not_much_more_than_truths() -> None:
    # Passes that depend on the surface alone, and those that depend on everything.
    for start, middle, low in (("ambient", 0.99, 0.99), ("depth", 0.45, 0.25), ("beauty", 0.55, 0.15)):
        entries = [entry for name in NAMES for entry in sensitivities(name) if entry[0].startswith(f"{start} ")]
        shares = [exact / ours for _, exact, ours in entries]
        assert np.median(shares) >= middle
        assert np.quantile(shares, 0.05) >= low


@pytest.mark.parametrize("name", NAMES)
def test_values_move_no_more_than_their_sensitivity(name: str) -> None:
    prover, found = Prover(scene(name)), analysis(name)
    random = np.random.default_rng(6)
    margins = np.min(list(found.margins.values()), axis=0)
    delta = 1e-11
    rows, columns = np.nonzero((found.ids >= 0) & (margins > 1e4 * delta))
    for place in random.choice(rows.size, min(8, rows.size), replace=False):
        x, y = int(columns[place]), int(rows[place])
        before, after = prover.pixel(x, y, ties=False), shaken(prover, x, y, delta, random).pixel(x, y, ties=False)
        for name_, balls in before.values.items():
            if name_ == "id" or name_.startswith("shadow"):
                assert balls == after.values[name_]
                continue
            moved = [
                abs(float(arb(fmpq(a.middle() - b.middle())))) for a, b in zip(balls, after.values[name_], strict=True)
            ]
            assert max(moved) <= 1.001 * delta * found.sensitivity[name_][y, x], f"{name_} at {x} {y}"
