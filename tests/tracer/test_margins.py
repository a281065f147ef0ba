"""Margins and sensitivities: against brute force, against the other precision, and where they can be told by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import scene_zoo as zoo
from agreement import all_passes, compare

from tracer import Scene, View, reference
from tracer.margins import EDGE_ROUNDINGS, VALUE_ROUNDINGS, analyse
from tracer.motion import NEAR, Beam, Gradient
from tracer.passes import MARGINS

UNIT = 2.0**-24
SCENES = {**zoo.hard(), **{f"ordinary-{seed}": zoo.ordinary(seed) for seed in range(30)}}
SCENES |= {f"wild-{seed}": zoo.wild(seed) for seed in range(30)}
# The structure of these is exact by the specification, whatever the numbers: a change of the numbers breaks it.
STRUCTURAL = ("light-on-surface",)


def shaken(scene: Scene, delta: float, random: np.random.Generator) -> Scene:
    """Every number of the scene off by delta, up or down."""

    def shake(value: float) -> float:
        return value * (1 + delta * float(random.choice((-1, 1))))

    def share(value: float) -> float:
        return min(1.0, shake(value))

    def vector(v: tuple[float, ...], move=shake) -> tuple[float, ...]:
        return tuple(move(c) for c in v)

    edges = {name: shake(getattr(scene.view, name)) for name in ("near", "left", "right", "bottom", "top")}
    return scene.replace(
        view=scene.view.replace(**edges),
        spheres=[
            s.replace(
                position=vector(s.position),
                scaling=vector(s.scaling),
                color=vector(s.color, share),
                ka=share(s.ka),
                kd=share(s.kd),
                ks=share(s.ks),
                kr=share(s.kr),
                exponent=shake(s.exponent),
            )
            for s in scene.spheres
        ],
        lights=[p.replace(position=vector(p.position), intensity=vector(p.intensity)) for p in scene.lights],
        background=vector(scene.background),
        ambient=vector(scene.ambient),
    )


@pytest.mark.parametrize("name", [name for name in SCENES if name not in STRUCTURAL])
def test_changed_numbers_change_no_more_than_foretold(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SCENES[name]
    analysis, truth = analyse(scene), reference.render(scene, all_passes(scene))
    random = np.random.default_rng(len(name))
    straight = reference.eye_rays

    def bent(*arguments) -> reference.Rays:
        rays = straight(*arguments)
        turn = random.normal(size=rays.direction.shape)
        rays.direction = (
            rays.direction + delta * np.sqrt((rays.direction**2).sum(axis=0) / (turn**2).sum(axis=0)) * turn
        )
        return rays

    # First order: delta times the growth of the errors has to be small; the huge ground makes 1e5 of it.
    for delta in (1e-9, 1e-10) if name == "ground" else (1e-6, 1e-7, 1e-8):
        for _ in range(2):
            monkeypatch.setattr(reference, "eye_rays", bent)
            monkeypatch.setattr("tracer.margins.eye_rays", straight)
            image = reference.render(shaken(scene, delta, random), all_passes(scene))
            found = compare(image, truth, analysis, delta, edge=4)
            # A decision flips only where its margin is below delta: to first order, and a square root's half away.
            assert found.flipped <= 1.5
            # The bounds hold as they are; 5 % for the second order.
            assert found.worst <= 1.05, found.where


@pytest.mark.parametrize("name", SCENES)
def test_float32_is_where_it_is_allowed_to_be(name: str) -> None:
    scene = SCENES[name]
    analysis, truth = analyse(scene), reference.render(scene, all_passes(scene))
    found = compare(reference.render(scene, all_passes(scene), precision="f32"), truth, analysis, UNIT, EDGE_ROUNDINGS)
    assert found.worst <= VALUE_ROUNDINGS, found.where
    assert found.flipped <= EDGE_ROUNDINGS


def test_margins_are_not_much_below_what_it_takes() -> None:
    # For the pixels next to an outline, some change of the numbers by 3 margins flips the decision.
    scene = zoo.scene([zoo.sphere((0.4, -0.3, -4), (1, 0.7, 1.2))], [])
    margin = analyse(scene).margins["silhouette"]
    ids = reference.render(scene, ("id",))["id"]
    near = np.argwhere(margin < 3e-3)
    assert len(near) >= 20
    for row, column in near:
        delta = 3 * margin[row, column]
        flips = False
        for x, y, s in itertools.product((-1, 1), repeat=3):
            sphere = scene.spheres[0]
            px, py, pz = sphere.position
            scaling = tuple(c * (1 + s * delta) for c in sphere.scaling)
            moved = sphere.replace(position=(px * (1 + x * delta), py * (1 + y * delta), pz), scaling=scaling)
            frustum = scene.view.replace(
                left=scene.view.left * (1 + x * delta),
                right=scene.view.right * (1 - x * delta),
                bottom=scene.view.bottom * (1 - y * delta),
                top=scene.view.top * (1 + y * delta),
            )
            image = reference.render(scene.replace(spheres=[moved], view=frustum), ("id",))
            flips |= image["id"][row, column] != ids[row, column]
        assert flips, f"nothing happens at ({column}, {row}) within 3 times its margin {margin[row, column]:.2e}"


def test_sensitivities_are_not_much_above_what_happens() -> None:
    # Over ten changes of all numbers, the worst pixel uses up a good part of what it is allowed.
    scene = zoo.ordinary(8)
    analysis, truth = analyse(scene), reference.render(scene, all_passes(scene))
    random = np.random.default_rng(8)
    used = dict.fromkeys(("depth", "normal", "diffuse"), 0.0)
    for _ in range(10):
        image = reference.render(shaken(scene, 1e-7, random), all_passes(scene))
        for name in used:
            part = reference.Passes({name: truth[name]})
            used[name] = max(used[name], compare(image, part, analysis, 1e-7, edge=4).worst)
    assert all(0.1 <= share <= 1.05 for share in used.values()), used


def test_few_pixels_of_ordinary_scenes_are_edges() -> None:
    for seed in range(6):
        scene = zoo.ordinary(seed)
        scene = scene.replace(view=scene.view.replace(columns=400, rows=400))
        found = analyse(scene)
        margin = np.min(list(found.margins.values()), axis=0)
        assert (margin < 1e-12).sum() <= 5
        # A line as long as the outlines and their pictures, a hundredth of a pixel wide on either side.
        assert (margin < 1e-5).sum() <= 10 + 0.05 * found.outline * (1 + len(scene.lights))


def test_a_scene_without_decisions_has_no_margins() -> None:
    empty = zoo.hard()["no-spheres"]
    found = analyse(empty)
    assert all(np.isinf(found.margins[kind]).all() for kind in MARGINS)
    assert found.outline == 0
    assert (found.ids == -1).all()
    assert found.sensitivity["beauty"].max() == max(empty.background)
    image = reference.render(empty, ("margin.order",), precision="f32")["margin.order"]
    assert image.dtype == np.float32
    assert np.isinf(image).all()


def axis(spheres: list, lights: list, **edges: float) -> dict[str, float]:
    """The margins of the ray along the axis."""
    frustum = View(near=edges.get("near", 1), left=0, right=1, bottom=-1, top=0, columns=1, rows=1)
    found = analyse(zoo.scene(spheres, lights, frustum))
    return {kind: float(found.margins[kind][0, 0]) for kind in MARGINS}


@pytest.mark.parametrize("gap", [1e-3, 1e-5, 1e-8])
def test_each_kind_sees_its_decision(gap: float) -> None:
    def about(margin: float) -> bool:
        # These rays reach 3 to 10 units far, and each unit of the way moves with its numbers.
        return gap / 60 <= margin <= gap

    plain = axis([zoo.sphere((0, 0, -4), kr=0)], [])
    assert plain["silhouette"] > 0.05
    assert plain["range"] > 0.05
    assert plain["order"] == plain["terminator"] == math.inf
    # Hit and miss of an outline.
    for x in (1 - gap, 1 + gap):
        assert about(axis([zoo.sphere((x, 0, -4), kr=0)], [])["silhouette"])
    # An outline behind a hit does not count, nor one before the near plane.
    behind = axis([zoo.sphere((0, 0, -4), kr=0), zoo.sphere((1 + gap, 0, -9), kr=0)], [])
    assert behind["silhouette"] > 0.01
    before = axis([zoo.sphere((0, 0, -9), kr=0), zoo.sphere((1 + gap, 0, -2), kr=0)], [], near=3)
    assert before["silhouette"] > 0.01
    # The near plane, from both sides.
    for z in (-2 - gap, -2 + gap):
        assert about(axis([zoo.sphere((0, 0, z), kr=0)], [])["range"])
    # Which of two is nearer.
    assert about(axis([zoo.sphere((0, 0, -4), kr=0), zoo.sphere((0, 0, -5 - gap), 2, kr=0)], [])["order"])
    # The light at the horizon of the hit (0, 0, -3).
    for z in (-3 - gap, -3 + gap):
        assert about(axis([zoo.sphere((0, 0, -4), kr=0)], [zoo.light(5, 0, z)])["terminator"])
    # Something that just hides, or just does not hide, the light; unless the light is out of sight anyway.
    for x in (1 - gap, 1 + gap):
        spheres = [zoo.sphere((0, 0, -4), kr=0), zoo.sphere((x, 0, 5), kr=0)]
        assert about(axis(spheres, [zoo.light(0, 0, 9)])["silhouette"])
        assert axis(spheres, [zoo.light(0, 0, 2)])["silhouette"] > 0.01
        hidden = [*spheres, zoo.sphere((0, 0, 2), 0.5, kr=0)]
        assert axis(hidden, [zoo.light(0, 0, 9)])["silhouette"] > 0.01
    # The light's end: a light just before and just behind a surface.
    for z in (4 - gap, 4 + gap):
        assert about(axis([zoo.sphere((0, 0, -4), kr=0), zoo.sphere((0, 0, 5), kr=0)], [zoo.light(0, 0, z)])["range"])
    # The shadow epsilon: the far side of a small sphere before the near plane, at t = 1e-4 (1 + gap) of 1000.
    for far in (0.1 * (1 - gap), 0.1 * (1 + gap)):
        small = zoo.sphere((0, 0, -3 + far - 0.02), 0.02, kr=0)
        margin = axis([zoo.sphere((0, 0, -4), kr=0), small], [zoo.light(0, 0, 997)], near=2.99)["range"]
        assert margin <= gap
    # R.V, where n < 1 makes a jump of its sign, and nowhere else. V mirrored is (0.96, 0, 0.28) at (0, 0, -2.2).
    for step in (-gap, gap):
        light = zoo.light(-0.28 + 0.96 * step, 0, -2.2 + 0.96 + 0.28 * step)
        assert about(axis([zoo.sphere((-0.6, 0, -3), n=0.5, kr=0)], [light])["terminator"])
        assert axis([zoo.sphere((-0.6, 0, -3), n=2, kr=0)], [light])["terminator"] > 0.01


@pytest.mark.parametrize("radius", [1e-3, 1e-5, 1e-8])
def test_the_middle_of_a_speck_is_as_near_to_its_outline_as_it_is_small(radius: float) -> None:
    """The discriminant is at its largest there, and does not move to first order."""

    def about(margin: float) -> bool:
        return radius / 60 <= margin <= 3 * radius

    off_axis = View(near=1, left=-0.75, right=0.25, bottom=-0.25, top=0.75, columns=1, rows=1)
    for frustum, place in ((None, (0, 0, -4)), (off_axis, (-3, 3, -4))):
        speck = zoo.sphere(place, radius, kr=0)
        found = analyse(
            zoo.scene([speck], [], frustum or View(near=1, left=0, right=1, bottom=-1, top=0, columns=1, rows=1))
        )
        assert about(float(found.margins["silhouette"][0, 0]))
    # On the image plane: whether the ray starts within it. In a mirror, and before a light.
    assert about(axis([zoo.sphere((0, 0, -1), radius, kr=0)], [])["range"])
    mirror = zoo.sphere((0, 0, -4), kr=0.5)
    assert radius / 200 <= axis([mirror, zoo.sphere((0, 0, 5), radius, kr=0)], [])["silhouette"] <= radius
    matt = zoo.sphere((0, 0, -4), kr=0)
    assert about(axis([matt, zoo.sphere((0, 0, 2), radius, kr=0)], [zoo.light(0, 0, 9)])["silhouette"])
    # Around a light.
    assert about(axis([matt, zoo.sphere((0, 0, 2), radius, kr=0)], [zoo.light(0, 0, 2)])["range"])
    # A plate of that thickness that fills the view has its outline far away.
    assert axis([zoo.sphere((0, 0, -4), (1, 1, radius), kr=0)], [])["silhouette"] > 0.05
    floor = View(near=1, left=0, right=0.2, bottom=-0.2, top=0, columns=1, rows=1)
    plate = zoo.scene([zoo.sphere((0, -0.5, -4), (2, radius, 2), kr=0)], [], floor)
    assert analyse(plate).margins["silhouette"][0, 0] > 0.01


@pytest.mark.parametrize("gap", [1e-3, 1e-5, 1e-8])
def test_a_light_straight_above_a_surface_is_as_near_to_it_as_it_is(gap: float) -> None:
    """N.L is at its largest or smallest there, and does not move to first order; R.V likewise."""
    for height in (gap, -gap):
        light = zoo.light(0, 0, -3 + height)
        assert gap / 60 <= axis([zoo.sphere((0, 0, -4), kr=0)], [light])["terminator"] <= gap
    sharp = axis([zoo.sphere((0, 0, -4), n=0.5, kr=0)], [zoo.light(0, 0, -3 + gap)])
    assert gap / 60 <= sharp["terminator"] <= gap
    # So a colour may be anything, as far as a change of that size goes.
    frustum = View(near=1, left=0, right=1, bottom=-1, top=0, columns=1, rows=1)
    found = analyse(zoo.scene([zoo.sphere((0, 0, -4), kr=0)], [zoo.light(0, 0, -3 + gap)], frustum))
    assert found.sensitivity["diffuse"][0, 0] * 64 * UNIT >= 0.1 * min(1, (64 * UNIT / gap) ** 2)


def test_reflections_count_where_they_are_seen() -> None:
    # The mirror at the axis sends the ray back past the eye; a sphere behind the eye is just hit or missed.
    def margin(kr: float) -> float:
        return axis([zoo.sphere((0, 0, -4), kr=kr), zoo.sphere((1 + 1e-6, 0, 5), kr=0)], [])["silhouette"]

    assert margin(0) > 0.01
    assert 1e-9 < margin(0.5) < 1e-6


def test_the_terminator_of_a_reflected_hit_counts_where_the_highlight_jumps() -> None:
    # The mirror sends the ray from (0, 0, -3) to (0, 0, 4) on a sphere behind the eye; the light is at its horizon.
    def margin(ks: float, x: float) -> float:
        spheres = [zoo.sphere((0, 0, -4), kr=0.5), zoo.sphere((-0.6, 0, 4.8), kr=0, ks=ks)]
        # N = (0.6, 0, -0.8), the ray's mirror direction is (0.96, 0, -0.28), L along (0.8, 0, 0.6) is at the horizon.
        return axis(spheres, [zoo.light(0.8 * x, 1e-6 * x, 4 + 0.6 * x)])["terminator"]

    assert margin(0.5, 1e-3) < 1e-3
    assert margin(0.5, 7) < 1e-6
    assert margin(0, 7) > 1e-3


def test_a_light_at_the_surface_that_the_eye_is_inside() -> None:
    # Just outside it is hidden, just inside it shines: its range margin is its distance, on either side.
    for gap in (1e-4, -1e-4, 1e-7):
        margin = axis([zoo.sphere((0, 0, 0), 5, kr=0)], [zoo.light(3 * (1 + gap), 4 * (1 + gap), 0)])["range"]
        assert abs(gap) / 60 <= margin <= abs(gap)
    assert axis([zoo.sphere((0, 0, 0), 5, kr=0)], [zoo.light(3, 4, 0)])["range"] > 1e-4


@pytest.mark.parametrize("name", ["mutual", "eye-inside", "crossing", "n-half", "light-on-surface", "wild-3"])
def test_decisions_that_are_passed_over_change_no_small_margin(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    quick = analyse(SCENES[name])

    def useless(_: Beam, of: Gradient) -> reference.Real:
        return np.full_like(of.rest, np.inf)

    monkeypatch.setattr(Beam, "bound", useless)
    slow = analyse(SCENES[name])
    for kind in MARGINS:
        small = np.minimum(quick.margins[kind], slow.margins[kind]) < NEAR
        assert np.allclose(quick.margins[kind][small], slow.margins[kind][small], rtol=1e-12)


def test_lit_is_where_the_light_is_on_the_seen_side() -> None:
    scene = zoo.scene([zoo.sphere((0, 0, -4), 1, kr=0)], [zoo.light(0, 9, -4), zoo.light(0, 0, 9)])
    found = analyse(scene)
    normal = reference.render(scene, ("normal", "position"))
    toward = np.array([0, 9, -4]) - normal["position"]
    facing = (normal["normal"] * toward).sum(axis=-1) > 0
    assert np.array_equal(found.lit[0], facing & (found.ids >= 0))
    assert found.lit[1].sum() > found.lit[0].sum()


def test_the_outline_is_as_long_as_the_ellipse() -> None:
    # The cone about a unit sphere at distance 5 cuts the image plane in a circle of radius 1 / sqrt(24).
    frustum = zoo.view(size=400)
    circle = 2 * math.pi / math.sqrt(24) * 200
    assert analyse(zoo.scene([zoo.sphere((0, 0, -5))], [], frustum)).outline == pytest.approx(circle, rel=1e-3)
    # Half of it lies in the image; a part of the pixels is twice as high as wide; the eye is inside; behind the eye.
    half = View(near=1, left=0, right=2, bottom=-1, top=1, columns=400, rows=400)
    assert analyse(zoo.scene([zoo.sphere((0, 0, -5))], [], half)).outline == pytest.approx(circle / 2, rel=2e-3)
    assert analyse(zoo.scene([zoo.sphere((0, 0, 0), 5)], [], frustum)).outline == 0
    assert analyse(zoo.scene([zoo.sphere((0, 0, 5))], [], frustum)).outline == 0
    # The horizon of a huge sphere under the eye is a nearly straight line across the image.
    ground = zoo.scene([zoo.sphere((0, -1e5 - 1, 0), 1e5)], [], frustum)
    assert analyse(ground).outline == pytest.approx(400, rel=1e-2)
    # An outline of an ellipsoid off the axis, against the pixels that it separates.
    aside = zoo.scene([zoo.sphere((2, 1, -4), (0.5, 1.5, 1))], [], frustum)
    seen = reference.render(aside, ("id",))["id"] >= 0
    steps = (seen[1:] != seen[:-1]).sum() + (seen[:, 1:] != seen[:, :-1]).sum()
    # A digital curve is up to sqrt(2) longer than the curve, and never shorter.
    assert steps / math.sqrt(2) * 0.98 <= analyse(aside).outline <= steps * 1.02
