"""Plants one defect at a time in a renderer and demands that the comparison names the passes that show it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import doubles
import numpy as np
import pytest
from doubles import Arrays, Double, with_arrays, with_patch, with_scene, with_settings
from planted import (
    beyond_the_light,
    blinn,
    clamped,
    near_plane_everywhere,
    never_flipped,
    no_near_plane,
    no_own_shadow,
    no_shadows,
    squared,
    unchanged,
    wrong_normals,
)

import tracer
from tracer.passes import Passes
from validation import Settings, Validation, validate
from validation.renderers.native import Native

PRIMARY = {"id", "depth", "position", "normal", "ambient"}
REFLECTED = {"reflection", "reflection.1", "reflection.2", "reflection.3"}
LIT = {"diffuse", "specular", "direct"}
SHADOWS = {"shadow.L0", "shadow.L1"}


def failing(draw: Callable[..., Passes], scene: tracer.Scene, settings: Settings | None = None) -> set[str]:
    """The passes in which a renderer that draws so differs from the native one."""
    result = validate({"scene": scene}, Double(draw=draw), "native-f64", settings=settings, verdicts=0)
    assert not result.failures
    assert not result.notes
    compared = {comparison.pass_name for comparison in result.comparisons}
    assert compared == set(Native("f64").passes(scene, result.settings)), "a pass was left out"
    return {comparison.pass_name for comparison in result.comparisons if not comparison.ok}


# What the defects do that are not among `planted`.


def swapped_lights(scene: tracer.Scene) -> tracer.Scene:
    """Lights in another order: the same image, other shadow passes."""
    return scene.replace(lights=scene.lights[::-1])


def dimmer(scene: tracer.Scene) -> tracer.Scene:
    """One colour of one sphere off in the seventh digit."""
    ball, *others = scene.spheres
    return scene.replace(spheres=(ball.replace(color=(0.5 + 5e-8, 0.2, 0.9)), *others))


def nudged(scene: tracer.Scene) -> tracer.Scene:
    """One sphere a millionth off its place."""
    ball, *others = scene.spheres
    return scene.replace(spheres=(ball.replace(position=(1e-6, 0, -10)), *others))


def depth_along_z(arrays: Arrays) -> None:
    """The distance to the eye's plane, not to the eye."""
    hit = arrays["id"] >= 0
    arrays["depth"][hit] = -arrays["position"][hit][:, 2]


def depth_off(arrays: Arrays) -> None:
    """A factor a little off 1."""
    arrays["depth"] *= 1 + 1e-9


def channels_swapped(arrays: Arrays) -> None:
    """Blue, green, red."""
    arrays["beauty"] = arrays["beauty"][..., ::-1].copy()


def row_off(arrays: Arrays) -> None:
    """The first row is lost, the last drawn twice."""
    for name, array in arrays.items():
        arrays[name] = np.concatenate([array[1:], array[-1:]])


def upside_down(arrays: Arrays) -> None:
    """The last row first."""
    for name, array in arrays.items():
        arrays[name] = array[::-1].copy()


def single_precision(arrays: Arrays) -> None:
    """Computed in float64, stored in float32."""
    for name, array in arrays.items():
        if array.dtype == np.float64:
            arrays[name] = array.astype(np.float32).astype(np.float64)


def interior(arrays: Arrays) -> tuple[int, int]:
    """A pixel of the floor in which every colour pass has a value."""
    colors = [arrays[name].all(axis=-1) for name in ("ambient", "diffuse", "specular", "reflection.3")]
    y, x = np.argwhere(np.all(colors, axis=0) & (arrays["id"] == 2))[0]
    return int(y), int(x)


def one_pixel(arrays: Arrays) -> None:
    """One value of one pixel off by a ten-thousandth."""
    arrays["beauty"][(*interior(arrays), 1)] += 1e-4


def one_id(arrays: Arrays) -> None:
    """One pixel belongs to another sphere."""
    arrays["id"][interior(arrays)] = 1


def one_hole(arrays: Arrays) -> None:
    """One pixel hits nothing."""
    place = interior(arrays)
    for name, array in arrays.items():
        array[place] = {"id": -1, "depth": np.inf}.get(name, 0)


def one_shadow(arrays: Arrays) -> None:
    """One lit pixel lies in the shadow."""
    y, x = np.argwhere((arrays["shadow.L0"] == 1) & (arrays["diffuse"][..., 0] > 0.3))[0]
    arrays["shadow.L0"][y, x] = 0


def not_a_number(arrays: Arrays) -> None:
    """NaN in one channel of one pixel."""
    arrays["specular"][(*interior(arrays), 2)] = np.nan


def infinite(arrays: Arrays) -> None:
    """Infinity in one channel of one pixel."""
    arrays["diffuse"][(*interior(arrays), 0)] = np.inf


def unnormalised(arrays: Arrays) -> None:
    """Normals of the right direction and the wrong length."""
    arrays["normal"] *= 1.001


def eight_bits(arrays: Arrays) -> None:
    """Colours rounded to 8 bits."""
    for name in ("beauty", "ambient"):
        arrays[name] = np.round(arrays[name] * 255) / 255


def background_in_mirrors(arrays: Arrays) -> None:
    """Reflected rays that hit nothing see the background."""
    lost = (arrays["reflection.1"] == 0).all(axis=-1) & (arrays["id"] >= 0)
    arrays["reflection.1"][lost] = 0.4 * np.array([0.3, 0.5, 0.8])


def specular_tinted(arrays: Arrays) -> None:
    """The highlight takes the surface's colour."""
    arrays["specular"] *= 0.5


class Defect(NamedTuple):
    """How it is drawn, on which scene, and exactly the passes that show it."""

    draw: Callable[..., Passes]
    shows: set[str]
    scene: Callable[[], tracer.Scene] = doubles.full
    settings: Settings = Settings()


EVERYTHING = {"beauty"} | PRIMARY | LIT | SHADOWS | REFLECTED

DEFECTS = {
    "normals without inverse transpose": Defect(
        with_patch(surface=wrong_normals), {"normal", "beauty"} | LIT | REFLECTED
    ),
    "inside not flipped": Defect(
        with_patch(surface=never_flipped), {"normal", "beauty", "diffuse", "specular", "direct"}, doubles.cut
    ),
    "shadow epsilon 1e-2": Defect(with_settings(shadow_epsilon=1e-2), {"shadow.L0", "beauty"} | LIT, doubles.contact),
    "no shadows": Defect(with_patch(hidden=no_shadows), {"beauty"} | LIT | SHADOWS | REFLECTED),
    "no own shadow": Defect(
        with_patch(hidden=no_own_shadow), {"shadow.L0", "diffuse", "specular", "direct", "beauty"}, doubles.cave
    ),
    "shadows of what is behind the light": Defect(
        with_patch(hidden=beyond_the_light), {"shadow.L0", "beauty"} | LIT, doubles.cut
    ),
    "pixel centres": Defect(with_settings(sample="center"), EVERYTHING),
    "inclusive samples": Defect(with_settings(sample="inclusive"), EVERYTHING),
    "one bounce too few": Defect(with_settings(max_reflections=2), {"reflection.3", "reflection", "beauty"}),
    "bounces clamped": Defect(with_patch(illuminate=clamped), {"beauty"} | REFLECTED),
    "Blinn": Defect(with_patch(incidence=blinn), {"specular", "direct", "beauty"} | REFLECTED),
    "falloff": Defect(with_patch(illuminate=squared), {"beauty"} | LIT | REFLECTED),
    "lights swapped": Defect(with_scene(swapped_lights), SHADOWS),
    "no near plane": Defect(
        with_patch(nearest=no_near_plane), {"depth", "position", "normal", "beauty"} | LIT, doubles.cut
    ),
    "near plane for mirrors": Defect(with_patch(nearest=near_plane_everywhere), {"beauty"} | REFLECTED),
    "colour off by 1e-7": Defect(with_scene(dimmer), {"ambient", "diffuse", "direct", "beauty"} | REFLECTED),
    "sphere off by 1e-6": Defect(with_scene(nudged), {"depth", "position", "normal", "beauty"} | LIT | REFLECTED),
    "depth along z": Defect(with_arrays(depth_along_z), {"depth"}),
    "depth off by 1e-9": Defect(with_arrays(depth_off), {"depth"}),
    "channels swapped": Defect(with_arrays(channels_swapped), {"beauty"}),
    "one row off": Defect(with_arrays(row_off), EVERYTHING),
    "upside down": Defect(with_arrays(upside_down), EVERYTHING),
    "float32 stored": Defect(with_arrays(single_precision), EVERYTHING - {"id"} - SHADOWS),
    "one pixel": Defect(with_arrays(one_pixel), {"beauty"}),
    "one id": Defect(with_arrays(one_id), {"id"}),
    "one hole": Defect(with_arrays(one_hole), {"id", "ambient", "beauty"} | LIT | REFLECTED),
    "one shadow": Defect(with_arrays(one_shadow), {"shadow.L0"}),
    "NaN": Defect(with_arrays(not_a_number), {"specular"}),
    "infinity": Defect(with_arrays(infinite), {"diffuse"}),
    "normals of a wrong length": Defect(with_arrays(unnormalised), {"normal"}),
    "8 bits": Defect(with_arrays(eight_bits), {"beauty", "ambient"}),
    "background in mirrors": Defect(
        with_arrays(background_in_mirrors, recompose=True), {"reflection.1", "reflection", "beauty"}
    ),
    "tinted highlight": Defect(with_arrays(specular_tinted, recompose=True), {"specular", "direct", "beauty"}),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_is_found_in_exactly_the_passes_that_show_it(name: str) -> None:
    defect = DEFECTS[name]
    assert failing(defect.draw, defect.scene(), defect.settings) == defect.shows


FAITHFUL = [
    doubles.faithful,
    doubles.reference,
    with_patch(nearest=unchanged),
    with_arrays(lambda _: None, recompose=True),
]


@pytest.mark.parametrize("scene", [doubles.full, doubles.cut, doubles.contact, doubles.cave])
@pytest.mark.parametrize(
    "draw",
    FAITHFUL,
)
def test_without_a_defect_all_agree(scene: Callable[[], tracer.Scene], draw: Callable[..., Passes]) -> None:
    assert failing(draw, scene()) == set()


def test_the_worst_pixel_is_the_planted_one() -> None:
    every = Native("f64").passes(doubles.full(), Settings())
    place = interior(dict(doubles.faithful(doubles.full(), every, Settings())))
    double = Double(draw=with_arrays(one_pixel))
    result = validate({"scene": doubles.full()}, double, "native-f64", passes=["beauty"], verdicts=0)
    (comparison,) = result.comparisons
    assert comparison.interior_over == 1
    assert comparison.worst is not None
    assert (comparison.worst.y, comparison.worst.x, comparison.worst.channel) == (*place, "G")
    assert comparison.worst.a - comparison.worst.b == pytest.approx(1e-4)


def test_a_renderer_that_fails_is_a_failure() -> None:
    def broken(*_: Any) -> Passes:
        raise RuntimeError("out of paint")

    result = validate({"scene": doubles.full()}, Double(draw=broken), "native-f64")
    assert result.status == 3
    assert "out of paint" in result.failures[0].message


def test_a_renderer_that_excuses_every_pixel_is_found_out() -> None:
    honest = Native("f64").uncertainty(doubles.full(), Settings())
    for kind in ("silhouette", "range", "order", "terminator"):
        generous = dataclasses.replace(honest, **{kind: 0.5})
        double = Double(draw=with_scene(nudged), claim=generous)
        scenes = {"scene": doubles.full()}
        result: Validation = validate(scenes, double, "native-f64", passes=["diffuse"], verdicts=0)
        (comparison,) = result.comparisons
        assert not comparison.ok
        if kind != "order":  # here two hits are hardly ever near each other: the claim excuses next to nothing
            assert any("too many edge pixels" in reason for reason in comparison.reasons), kind
