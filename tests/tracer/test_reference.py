"""The NumPy reference against hand-computed values, the published images, and itself in the other precision."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scene_zoo as zoo

import tracer
from tracer import Light, Passes, Scene, Sphere, View, reference
from tracer.passes import SAMPLES, lookup, names, quantise

EVERY = names(2, margins=False)
ONE = View(near=1, left=0, right=1, bottom=-1, top=0, columns=1, rows=1)  # its corner ray is (0, 0, -1)


def one(spheres: list[Sphere], lights: list[Light], **settings: Any) -> Passes:
    """The pixel of a view whose only ray is the axis."""
    scene = Scene(view=ONE, spheres=spheres, lights=lights, background=(0.1, 0.2, 0.3), ambient=(0.5, 0.25, 0.125))
    wanted = names(len(lights), settings.get("max_reflections", 3), margins=False)
    return reference.render(scene, wanted, **settings)


def ball(z: float = -3, size: float = 1, **changes: Any) -> Sphere:
    """A round sphere on the axis."""
    plain = Sphere(
        name="b",
        position=(0, 0, z),
        scaling=(size, size, size),
        color=(1, 0.5, 0.25),
        ka=0.5,
        kd=0.5,
        ks=0.25,
        kr=0,
        exponent=2,
    )
    return plain.replace(**changes)


def lamp(x: float, y: float, z: float, intensity: float = 1) -> Light:
    """A white light."""
    return Light(name="l", position=(x, y, z), intensity=(intensity, intensity, intensity))


def pixel(image: Passes, name: str) -> list[float]:
    """The values of the only pixel."""
    return np.atleast_1d(image[name][0, 0]).tolist()


def test_keys_pixel_for_pixel(keys: Path) -> None:
    from PIL import Image

    scenes = sorted(keys.glob("test*.txt"))
    assert len(scenes) == 6
    for path in scenes:
        with Image.open(keys / f"{path.stem.replace('test', 'key')}.png") as image:
            key = np.asarray(image.convert("RGB"))
        drawn = quantise(reference.render(tracer.load(path))["beauty"])
        assert np.array_equal(drawn, key), f"{path.name}: {(drawn != key).any(axis=-1).sum()} pixels differ"


class Watched(np.ndarray):  # type: ignore[type-arg]
    """An array that refuses to become float64, in any operation."""

    seen = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **kwargs: Any) -> Any:
        plain = [np.asarray(value) if isinstance(value, Watched) else value for value in inputs]
        out = kwargs.pop("out", None)
        if out is not None:
            kwargs["out"] = tuple(np.asarray(value) for value in out)
        return self.checked(getattr(ufunc, method)(*plain, **kwargs))

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return self.checked(super().__array_function__(function, types, args, kwargs))

    @classmethod
    def checked(cls, result: Any) -> Any:
        if isinstance(result, np.ndarray | np.generic) and np.issubdtype(result.dtype, np.floating):
            assert result.dtype == np.float32, "an intermediate result is float64"
            cls.seen += 1
            return np.asarray(result).view(cls)
        return result


def test_float32_stays_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    rays, tables = reference.eye_rays, reference.Tables

    def watch(holder: Any) -> Any:
        for name, value in vars(holder).items():
            if isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.floating):
                setattr(holder, name, value.view(Watched))
            if isinstance(value, list):
                setattr(holder, name, [entry.view(Watched) for entry in value])
        return holder

    monkeypatch.setattr(reference, "eye_rays", lambda *arguments: watch(rays(*arguments)))
    monkeypatch.setattr(reference, "Tables", lambda *arguments: watch(tables(*arguments)))
    Watched.seen = 0
    for name in ("eye-inside", "light-on-surface", "mutual", "n-half"):
        scene = zoo.hard()[name]
        image = reference.render(scene, names(len(scene.lights), margins=False), precision="f32")
        assert {image[p].dtype for p in image if p != "id"} == {np.dtype(np.float32)}
        assert image["id"].dtype == np.int32
    assert Watched.seen > 5_000
    # The watch would have noticed: a float64 scalar promotes what it touches.
    monkeypatch.setattr(reference, "TANGENT", np.float64(16))
    with pytest.raises(AssertionError, match="float64"):
        reference.render(zoo.hard()["mutual"], precision="f32")


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_every_pass_has_its_shape_and_type(precision: reference.Precision) -> None:
    scene = zoo.hard()["mutual"].replace(view=View(near=1, left=-1, right=1, bottom=-1, top=1, columns=5, rows=3))
    image = reference.render(scene, names(2), precision=precision)
    assert tuple(image) == names(2)
    for name in names(2):
        assert image[name].shape == ((3, 5, 3) if lookup(name).channels else (3, 5))
        expected = np.int32 if name == "id" else np.float32 if precision == "f32" else np.float64
        assert image[name].dtype == expected
        assert image[name].flags.c_contiguous


def test_a_lit_sphere_by_hand() -> None:
    # Hit at (0, 0, -2), N = (0, 0, 1) = V. The light at (3, 0, 2): L = (0.6, 0, 0.8), N.L = 0.8, R = (-0.6, 0, 0.8).
    image = one([ball()], [lamp(3, 0, 2, 2)])
    assert pixel(image, "id") == [0]
    assert pixel(image, "depth") == [2]
    assert pixel(image, "position") == [0, 0, -2]
    assert pixel(image, "normal") == [0, 0, 1]
    assert pixel(image, "ambient") == [0.25, 0.0625, 0.015625]
    assert pixel(image, "diffuse") == pytest.approx([0.8, 0.4, 0.2], rel=1e-15)
    assert pixel(image, "specular") == pytest.approx([0.32] * 3, rel=1e-15)
    assert pixel(image, "shadow.L0") == [1]
    assert pixel(image, "reflection") == [0, 0, 0]
    assert pixel(image, "beauty") == pytest.approx([1.37, 0.7825, 0.535625], rel=1e-15)


def test_an_ellipsoid_has_its_own_normals() -> None:
    # The ray (0, 0, -1) meets |(x - 1)/2, y, z + 3| = 1 where z + 3 = sqrt(3)/2; the normal is along (-1/4, 0, z + 3).
    image = one([ball(position=(1, 0, -3), scaling=(2, 1, -1))], [])
    root = math.sqrt(0.75)
    assert pixel(image, "position") == pytest.approx([0, 0, -3 + root], rel=1e-15)
    length = math.hypot(0.25, root)
    assert pixel(image, "normal") == pytest.approx([-0.25 / length, 0, root / length], rel=1e-14)


def test_a_miss() -> None:
    image = one([ball(position=(5, 0, -3))], [lamp(0, 0, 0)])
    assert pixel(image, "beauty") == [0.1, 0.2, 0.3]
    assert pixel(image, "id") == [-1]
    assert pixel(image, "depth") == [math.inf]
    for name in (
        "ambient",
        "diffuse",
        "specular",
        "direct",
        "reflection",
        "reflection.2",
        "position",
        "normal",
        "shadow.L0",
    ):
        assert not np.any(image[name])


def test_the_near_plane_cuts_primary_rays_only() -> None:
    # A sphere from z = 0 to -2: t = 1 cuts it, its inside shows at t = 2, with the normal turned to the eye.
    image = one([ball(z=-1)], [lamp(0, 0, -1)])
    assert pixel(image, "depth") == [2]
    assert pixel(image, "normal") == [0, 0, 1]
    assert pixel(image, "diffuse") == [0.5, 0.25, 0.125]
    # t = 1 itself is no hit: the front of this one lies on the near plane.
    assert pixel(one([ball(z=-2)], []), "depth") == [3]
    # A sphere wholly before the near plane is not seen, but hides the light at the eye and shows in a mirror.
    small = ball(z=-0.5, size=0.25, color=(1, 1, 1), ka=1)
    image = one([ball(kr=1), small], [lamp(0, 0, 0)])
    assert pixel(image, "id") == [0]
    assert pixel(image, "shadow.L0") == [0]
    assert pixel(image, "reflection.1") == [0.5, 0.25, 0.125]


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize(
    ("position", "scaling"),
    [((1, 0, -3), (1, 1, 1)), ((0, -2, -4), (3, 2, 1)), ((0.1, 0, -10), (0.1, 7, 3)), ((3, 4, -9), (5, 5, 2))],
)
def test_an_exact_tangent_is_a_hit_with_the_outward_normal(
    precision: reference.Precision, position: tuple[float, float, float], scaling: tuple[float, float, float]
) -> None:
    sphere = ball(position=position, scaling=scaling)
    image = one([sphere], [], precision=precision)
    assert pixel(image, "id") == [0]
    assert pixel(image, "depth") == pytest.approx([-position[2]], rel=1e-5)
    outward = np.array([-position[0] / scaling[0] ** 2, -position[1] / scaling[1] ** 2, 0])
    assert pixel(image, "normal") == pytest.approx((outward / np.linalg.norm(outward)).tolist(), abs=1e-5)
    # A little farther off it misses.
    moved = tuple(c * (1 + 1e-4) for c in position[:2])
    assert pixel(one([sphere.replace(position=(*moved, position[2]))], [], precision=precision), "id") == [-1]


def exact_tangents() -> list[tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]]:
    """Integer directions, centres and scalings of spheres that the ray touches: |p x d| = r |d|, then stretched."""
    random = np.random.default_rng(1)
    found = []
    while len(found) < 300:
        d = np.array([(1, 2, -2), (2, 3, -6), (1, 4, -8), (4, 4, -7), (2, 6, -9)][random.integers(5)])
        p = random.integers(-60, 60, 3)
        cross = int((np.cross(p, d) ** 2).sum())
        length = math.isqrt(int(d @ d))
        root = math.isqrt(cross)
        # In front of the near plane, not round the eye, and exactly at a whole distance.
        if root * root != cross or root == 0 or root % length or p @ d <= 2 * d @ d:
            continue
        stretch = random.integers(1, 50, 3)
        found.append((tuple(d * stretch), tuple(p * stretch), tuple(root // length * stretch)))
    return found


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_three_hundred_exact_tangents_are_hits(precision: reference.Precision) -> None:
    missed = []
    for d, p, s in exact_tangents():
        view = View(near=-d[2], left=d[0], right=d[0] + 1, bottom=d[1] - 1, top=d[1], columns=1, rows=1)
        scene = Scene(view=view, spheres=[ball(position=p, scaling=s)])
        if reference.render(scene, ("id",), precision=precision)["id"][0, 0] < 0:
            missed.append((d, p, s))
    assert not missed


def test_of_equal_hits_the_first_in_the_file_is_seen() -> None:
    assert pixel(one([ball(), ball(-4, 2)], []), "id") == [0]
    assert pixel(one([ball(-4, 2), ball()], []), "id") == [0]


def test_duplicates_do_not_exist() -> None:
    first, second = ball(), ball(color=(0, 0, 0), scaling=(1, -1, 1))
    with pytest.warns(tracer.errors.SceneWarning):
        scene = tracer.loads(Scene(view=ONE, spheres=[first, second]).text())
    image = reference.render(scene, ("id", "ambient"))
    assert pixel(image, "id") == [0]


def test_the_inside_is_lit_from_within_and_shadowed_from_without() -> None:
    around = ball(z=0, size=4)
    inner, outer = one([around], [lamp(0, 0, -1)]), one([around], [lamp(0, 0, 9)])
    assert pixel(inner, "normal") == [0, 0, 1]
    assert pixel(inner, "shadow.L0") == [1]
    assert pixel(inner, "diffuse") == [0.5, 0.25, 0.125]
    assert pixel(outer, "shadow.L0") == [0]
    assert pixel(outer, "diffuse") == [0, 0, 0]


def test_a_light_on_a_surface_is_not_hidden_by_it() -> None:
    # On the sphere's own front, on its side, and on another sphere's near and far side.
    assert pixel(one([ball(z=0, size=4)], [lamp(0, 0, 4)]), "shadow.L0") == [1]
    assert pixel(one([ball(z=0, size=4)], [lamp(4, 0, 0)]), "shadow.L0") == [1]
    beyond = ball(z=2, size=1)
    assert pixel(one([ball(), beyond], [lamp(0, 0, 1)]), "shadow.L0") == [1]
    assert pixel(one([ball(), beyond], [lamp(0, 0, 3)]), "shadow.L0") == [0]


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_a_light_on_a_surface_is_seen_from_everywhere_before_it(precision: reference.Precision) -> None:
    # |(3, 4, 0) / 5| = 1 and |(0, 0.6, -0.8) 0.7 / 0.7| = 1, neither of them in binary numbers.
    inside = Scene(view=zoo.view(), spheres=[ball(z=0, size=5)], lights=[lamp(3, 4, 0)])
    image = reference.render(inside, ("id", "shadow.L0"), precision=precision)
    assert (image["id"] == 0).all()
    assert (image["shadow.L0"] == 1).all()
    other = ball(z=-3, size=0.7, position=(0.2, 2, -3))
    place = tuple(c + 0.7 * n for c, n in zip(other.position, (0, -0.6, -0.8), strict=True))
    ground = ball(position=(0, -2, -5), scaling=(3, 1, 3))
    both = Scene(view=zoo.view(), spheres=[other, ground], lights=[lamp(*place)])
    image = reference.render(both, ("id", "position", "shadow.L0"), precision=precision)
    side = (image["position"].astype(float) - place) @ np.array([0, -0.6, -0.8])
    # Behind the tangent plane of the light, `other` itself stands before it.
    ground_before = (image["id"] == 1) & (side > 1e-4)
    assert ground_before.sum() > 500
    lit = reference.render(both.replace(spheres=[ground]), ("shadow.L0",))["shadow.L0"]
    assert np.array_equal(image["shadow.L0"][ground_before], lit[ground_before])


def test_a_light_at_the_hit_itself_is_visible_and_adds_nothing() -> None:
    image = one([ball(), ball(z=9)], [lamp(0, 0, -2)])
    assert pixel(image, "shadow.L0") == [1]
    assert pixel(image, "diffuse") == [0, 0, 0]
    assert pixel(image, "specular") == [0, 0, 0]


def test_the_shadow_epsilon_is_in_units_of_the_way_to_the_light() -> None:
    # A small sphere stands from 0.01 to 0.03 before the hit at z = -2, wholly before the near plane; the light is 10
    # away: t = 0.001 and 0.003. The larger root hides the light until the epsilon passes it.
    view = ONE.replace(near=1.995)
    scene = Scene(view=view, spheres=[ball(), ball(z=-1.98, size=0.01)], lights=[lamp(0, 0, 8)])
    for epsilon, visible in ((0.0, 0), (1e-4, 0), (0.002, 0), (0.0029, 0), (0.0031, 1)):
        image = reference.render(scene, ("id", "shadow.L0"), shadow_epsilon=epsilon)
        assert pixel(image, "id") == [0]
        assert pixel(image, "shadow.L0") == [visible]


def test_own_shadow_needs_the_epsilon_too() -> None:
    # The shadow is computed where N.L <= 0, and there the sphere itself hides the light.
    image = one([ball()], [lamp(0, 0, -9)])
    assert pixel(image, "shadow.L0") == [0]
    # From (0, 0, -2) to (100, 0, -2 - h), t = 2 h / (h^2 + 100^2) is the other root.
    for h, visible in ((0.4, 1), (0.6, 0)):
        assert pixel(one([ball()], [lamp(100, 0, -2 - h)]), "shadow.L0") == [visible]


def test_specular_of_exponent_zero_is_one_where_it_shines() -> None:
    # Hit at (0, 0, -2.2), N = (0.6, 0, 0.8), V mirrored (0.96, 0, 0.28): R.V changes sign across L = (-0.28, 0, 0.96).
    sphere = ball(position=(-0.6, 0, -3), exponent=0)
    for step, shines in ((0.05, 0.25), (-0.05, 0.0)):
        light = lamp(-0.28 + 0.96 * step, 0, -2.2 + 0.96 + 0.28 * step)
        image = one([sphere], [light])
        assert pixel(image, "diffuse")[0] == pytest.approx(0.5 * (0.6 + step * 0.8) / math.hypot(1, step), rel=1e-12)
        assert pixel(image, "specular") == [shines] * 3


def test_colours_are_not_clamped_and_lights_may_be_negative() -> None:
    bright = pixel(one([ball()], [lamp(0, 0, 0, 10)]), "beauty")
    assert bright[0] == 0.25 + 5 + 2.5
    dark = pixel(one([ball()], [lamp(0, 0, 0, -10)]), "beauty")
    assert dark[0] == 0.25 - 5 - 2.5
    assert quantise(np.array(bright)).tolist()[0] == 255
    assert quantise(np.array(dark)).tolist()[0] == 0


@pytest.mark.parametrize("bounces", [0, 1, 2, 3, 6])
def test_a_corridor_of_mirrors(bounces: int) -> None:
    # The ray goes to and fro on the axis between the spheres at z = -3 and z = 3; it is lit by ambient light only.
    front = ball(kr=0.5, color=(1, 1, 1), ka=1)
    back = ball(z=3, kr=0.25, color=(0.5, 0.5, 0.5), ka=1)
    image = one([front, back], [], max_reflections=bounces)
    weight, total = 1.0, 0.0
    for bounce in range(1, bounces + 1):
        weight *= 0.5 if bounce % 2 else 0.25
        seen = weight * 0.5 * (0.5 if bounce % 2 else 1)
        assert pixel(image, f"reflection.{bounce}")[0] == seen
        total += seen
    assert pixel(image, "reflection")[0] == total
    assert pixel(image, "beauty")[0] == 0.5 + total


def test_a_reflection_inside_a_sphere_meets_its_other_root() -> None:
    # From the eye at the centre the ray runs to and fro along the axis; the first hit is at t = 4, the second at -8.
    image = one([ball(z=0, size=4, kr=0.5, color=(1, 1, 1), ka=1)], [])
    assert pixel(image, "reflection.1")[0] == 0.25
    assert pixel(image, "reflection.3")[0] == 0.0625
    # From outside the sphere does not see itself: nothing else is there, and a reflected miss is black.
    assert pixel(one([ball(kr=1)], []), "reflection") == [0, 0, 0]


def test_sample_positions() -> None:
    view = View(near=2, left=-1, right=3, bottom=-2, top=1, columns=4, rows=3)
    tables = reference.Tables(Scene(view=view), np.float64)
    first = {"corner": (-1, 1), "center": (-0.5, 0.5), "bottom-left": (-1, 0), "top-right": (0, 1)}
    last = {"corner": (2, -1), "center": (2.5, -1.5), "bottom-left": (2, -2), "top-right": (3, -1)}
    first["inclusive"], last["inclusive"] = (-1, 1), (3, -2)
    for sample in SAMPLES:
        direction = reference.eye_rays(tables, view, sample, range(3)).direction
        assert direction[:, 0].tolist() == [*first[sample], -2]
        assert direction[:, -1].tolist() == [*last[sample], -2]
    column = reference.eye_rays(tables, view.replace(columns=1), "inclusive", range(3)).direction
    assert column[0].tolist() == [-1, -1, -1]


def test_bands_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = zoo.hard()["mutual"]
    whole = reference.render(scene, EVERY)
    monkeypatch.setattr(reference, "BAND", 1)
    assert all(np.array_equal(reference.render(scene, EVERY)[name], whole[name]) for name in EVERY)


def scaled(scene: Scene, factor: float) -> Scene:
    """The same scene, all lengths times a factor."""

    def times(v: tuple[float, float, float]) -> tuple[float, float, float]:
        return (v[0] * factor, v[1] * factor, v[2] * factor)

    edges = {name: getattr(scene.view, name) * factor for name in ("near", "left", "right", "bottom", "top")}
    return scene.replace(
        view=scene.view.replace(**edges),
        spheres=[s.replace(position=times(s.position), scaling=times(s.scaling)) for s in scene.spheres],
        lights=[p.replace(position=times(p.position)) for p in scene.lights],
    )


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_scaling_the_world_by_a_power_of_two_gives_the_same_bits(precision: reference.Precision) -> None:
    for seed in range(10):
        scene = zoo.wild(seed)
        passes = names(3, margins=False)
        plain = reference.render(scene, passes, precision=precision)
        large = reference.render(scaled(scene, 2.0**12), passes, precision=precision)
        for name in passes:
            factor = 2**12 if name in ("depth", "position") else 1
            assert np.array_equal(plain[name] * factor, large[name])


def test_beauty_is_the_sum_of_its_parts_to_the_bit() -> None:
    for seed in range(10):
        scene = zoo.ordinary(seed)
        image = reference.render(scene, ("beauty", "ambient", "diffuse", "specular", "direct", "reflection", "id"))
        assert np.array_equal(image["direct"], image["diffuse"] + image["specular"])
        total = (image["ambient"] + image["direct"]) + image["reflection"]
        assert np.array_equal(image["beauty"][image["id"] >= 0], total[image["id"] >= 0])


def test_magnitudes_at_the_limits_stay_finite() -> None:
    for factor in (1e-98, 1e98):
        scene = scaled(zoo.hard()["mutual"], factor)
        image = reference.render(scene, EVERY)
        near = reference.render(zoo.hard()["mutual"], EVERY)
        assert all(np.isfinite(image[name]).all() for name in EVERY if name != "depth")
        assert (image["id"] != near["id"]).sum() <= 2
    # One ray through spheres of 1e-100 and 1e100.
    image = one([ball(z=-3, size=1e-100), ball(z=-1e100, size=0.5e100)], [lamp(0, 1e100, 0)])
    assert pixel(image, "id") == [0]
    image = one([ball(z=-1e100, size=0.5e100, kr=1)], [lamp(0, 1e100, 0), lamp(1e-100, 0, 0)])
    assert pixel(image, "depth") == pytest.approx([0.5e100])
    assert np.isfinite(pixel(image, "beauty")).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"precision": "f16"}, "unknown precision 'f16': expected f32 or f64"),
        (
            {"sample": "middle"},
            "unknown sample 'middle': expected one of corner, center, bottom-left, top-right, inclusive",
        ),
        ({"shadow_epsilon": 1}, "shadow_epsilon is 1: expected a number from 0 to below 1"),
        ({"shadow_epsilon": math.nan}, "shadow_epsilon is nan: expected a number from 0 to below 1"),
        ({"max_reflections": -1}, "max_reflections is -1: expected 0 or more"),
        ({"passes": ("beuty",)}, "unknown pass 'beuty' (did you mean 'beauty'?)"),
        ({"passes": ("shadow.L1",)}, "pass 'shadow.L1' asks for a light that is not there: the scene has 1, from 0"),
    ],
)
def test_settings_that_cannot_be(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        reference.render(Scene(view=ONE, lights=[lamp(0, 0, 0)]), **settings)


def test_passes_of_bounces_that_are_not_traced_are_zero() -> None:
    scene = zoo.hard()["mutual"]
    image = reference.render(scene, ("reflection.1", "reflection.2"), max_reflections=1)
    assert image["reflection.1"].any()
    assert not image["reflection.2"].any()
    assert image["reflection.2"].shape == image["reflection.1"].shape
