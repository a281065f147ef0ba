"""Every clause of docs/specification.md against values computed by hand, for each of our renderers.

Most tests look at one pixel. A view of one pixel whose top-left corner is (x, y) sends its ray exactly along
(x, y, -near), so the closed forms stand beside the numbers they come from.
"""

from __future__ import annotations

import math
import subprocess
import sysconfig
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tracer
import tracer.reference
from tracer import Light, Scene, Sphere, View
from tracer.passes import Passes, quantise

Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Renderer:
    """One of our renderers, with the largest error it may have against a closed form.

    The values below come from fewer than 64 rounded operations on numbers of magnitude about 1, none of which loses
    more than a factor 4 by cancellation: 256 unit roundoffs. A power n multiplies the relative error of its base by n.
    Where every number on the way is a small binary fraction, the tests ask for equality.
    """

    name: str
    draw: Callable[..., Passes]
    unit_roundoff: float

    def near(self, value: Any, *, power: float = 1) -> Any:
        """The expected value with its tolerance."""
        tolerance = 256 * self.unit_roundoff * max(power, 1)
        return pytest.approx(value, rel=tolerance, abs=tolerance)


def native(scene: Scene, passes: Sequence[str], **settings: Any) -> Passes:
    return tracer.render(scene, passes, **settings)


def native_f32(scene: Scene, passes: Sequence[str], **settings: Any) -> Passes:
    return tracer.render(scene, passes, precision="f32", **settings)


def reference(scene: Scene, passes: Sequence[str], **settings: Any) -> Passes:
    return tracer.reference.render(scene, passes, **settings)


@pytest.fixture(
    params=[
        Renderer("native-f64", native, 2.0**-53),
        Renderer("native-f32", native_f32, 2.0**-24),
        Renderer("numpy-f64", reference, 2.0**-53),
    ],
    ids=lambda renderer: renderer.name,
)
def renderer(request: pytest.FixtureRequest) -> Renderer:
    """Each renderer in turn."""
    found: Renderer = request.param
    return found


def ball(
    position: Vec3,
    scaling: float | Vec3 = 1,
    *,
    color: Vec3 = (1, 1, 1),
    ka: float = 0,
    kd: float = 0,
    ks: float = 0,
    kr: float = 0,
    exponent: float = 1,
    name: str = "s",
) -> Sphere:
    """A sphere or an ellipsoid; black unless a coefficient is given."""
    if not isinstance(scaling, tuple):
        scaling = (scaling,) * 3
    return Sphere(
        name=name, position=position, scaling=scaling, color=color, ka=ka, kd=kd, ks=ks, kr=kr, exponent=exponent
    )


def lamp(position: Vec3, intensity: float | Vec3 = 1) -> Light:
    """A light; white when its intensity is one number."""
    if not isinstance(intensity, tuple):
        intensity = (intensity,) * 3
    return Light(name="l", position=position, intensity=intensity)


def probe(
    renderer: Renderer,
    spheres: Sequence[Sphere],
    lights: Sequence[Light] = (),
    *,
    ray: Vec3 = (0, 0, -1),
    background: Vec3 = (0, 0, 0),
    ambient: Vec3 = (0, 0, 0),
    **settings: Any,
) -> dict[str, Any]:
    """Every pass of the single pixel whose ray has this direction."""
    x, y, z = ray
    scene = Scene(
        view=View(near=-z, left=x, right=x + 1, bottom=y - 1, top=y, columns=1, rows=1),
        spheres=spheres,
        lights=lights,
        background=background,
        ambient=ambient,
    )
    bounces = range(1, settings.get("max_reflections", 3) + 1)
    names = ["beauty", "ambient", "diffuse", "specular", "direct", "reflection", "depth", "position", "normal", "id"]
    names += [f"shadow.L{i}" for i in range(len(lights))] + [f"reflection.{k}" for k in bounces]
    drawn = renderer.draw(scene, names, **settings)
    return {name: drawn[name][0, 0].tolist() for name in names}


def grid(near: float = 1, size: float = 0.5) -> View:
    """33 x 33 pixels about the axis: enough for rounding to go both ways where it can."""
    return View(near=near, left=-size, right=size, bottom=-size, top=size, columns=33, rows=33)


BLACK = [0.0, 0.0, 0.0]
# The unit sphere whose nearest point to the eye is (0, 0, -4), with N = V = (0, 0, 1) there.
CENTRAL = (0.0, 0.0, -5.0)


# Camera


@pytest.mark.parametrize(
    ("sample", "xs", "ys"),
    [
        # left + (right - left) (c + ox) / columns with left = -1, right = 2; top - (top - bottom) (j + oy) / rows
        # with top = 1.5, bottom = -0.5.
        ("corner", [-1, -0.25, 0.5, 1.25], [1.5, 0.5]),
        ("center", [-0.625, 0.125, 0.875, 1.625], [1, 0]),
        ("bottom-left", [-1, -0.25, 0.5, 1.25], [0.5, -0.5]),
        ("top-right", [-0.25, 0.5, 1.25, 2], [1.5, 0.5]),
        ("inclusive", [-1, 0, 1, 2], [1.5, -0.5]),
    ],
)
def test_rays_of_every_sample_position(renderer: Renderer, sample: str, xs: list[float], ys: list[float]) -> None:
    # The eye stands at the centre of a sphere of radius 8: the hit is at 8 d / |d|, which tells d.
    view = View(near=2, left=-1, right=2, bottom=-0.5, top=1.5, columns=4, rows=2)
    drawn = renderer.draw(Scene(view=view, spheres=[ball((0, 0, 0), 8)]), ["position", "depth"], sample=sample)
    position = drawn["position"]
    directions = position * (-2 / position[..., 2:])
    expected = np.array([[(x, y, -2) for x in xs] for y in ys])
    assert np.allclose(directions, expected, rtol=0, atol=256 * renderer.unit_roundoff)
    assert np.allclose(drawn["depth"], 8, rtol=256 * renderer.unit_roundoff, atol=0)


@pytest.mark.parametrize(
    ("sample", "direction"),
    [
        ("corner", (0.25, 0.75)),
        ("center", (0.5, 0.375)),
        ("bottom-left", (0.25, 0)),
        ("top-right", (0.75, 0.75)),
        ("inclusive", (0.25, 0.75)),
    ],
)
def test_one_pixel_has_a_ray_in_every_sample_position(
    renderer: Renderer, sample: str, direction: tuple[float, float]
) -> None:
    view = View(near=1, left=0.25, right=0.75, bottom=0, top=0.75, columns=1, rows=1)
    drawn = renderer.draw(Scene(view=view, spheres=[ball((0, 0, 0), 8)]), ["position"], sample=sample)
    x, y, z = drawn["position"][0, 0].tolist()
    assert (x / -z, y / -z) == renderer.near(direction)


def test_row_0_is_the_top_and_column_0_the_left(renderer: Renderer) -> None:
    view = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=2, rows=2)
    up_left = ball((-4, 4, -4))
    assert renderer.draw(Scene(view=view, spheres=[up_left]), ["id"])["id"].tolist() == [[0, -1], [-1, -1]]


def test_depth_is_the_distance_from_the_eye(renderer: Renderer) -> None:
    # The ray (3, 0, -4) / 2 reaches the centre (6, 0, -8) at distance 10, the surface 5 before it.
    seen = probe(renderer, [ball((6, 0, -8), 5)], ray=(1.5, 0, -2))
    assert seen["depth"] == renderer.near(5)
    assert seen["position"] == renderer.near([3, 0, -4])
    assert seen["normal"] == renderer.near([-0.6, 0, 0.8])


# The near plane


def test_the_nearest_hit_is_seen(renderer: Renderer) -> None:
    seen = probe(renderer, [ball((0, 0, -9)), ball(CENTRAL)])
    assert (seen["id"], seen["depth"]) == (1, 4)


@pytest.mark.parametrize(
    ("near", "depth", "normal_z"),
    [
        (3.5, 4, 1),  # before the sphere, which spans z = -4 to -6
        (4, 6, 1),  # t = 1 on its nearest point does not count
        (4.5, 6, 1),  # cut: the far side is seen from inside, its normal flipped to the eye
        (6, math.inf, 0),  # t = 1 on its farthest point
        (7, math.inf, 0),
    ],
)
def test_only_hits_beyond_the_near_plane_are_seen(
    renderer: Renderer, near: float, depth: float, normal_z: float
) -> None:
    seen = probe(renderer, [ball(CENTRAL)], ray=(0, 0, -near))
    assert seen["depth"] == depth
    assert seen["id"] == (0 if depth < math.inf else -1)
    assert seen["normal"] == [0, 0, normal_z]


def test_a_sphere_behind_the_near_plane_shows_through_one_that_is_before_it(renderer: Renderer) -> None:
    seen = probe(renderer, [ball((0, 0, -2)), ball((0, 0, -9))], ray=(0, 0, -4))
    assert (seen["id"], seen["depth"]) == (1, 8)


def test_what_lies_before_the_near_plane_casts_shadows(renderer: Renderer) -> None:
    wall, unseen = ball((0, 0, -9), kd=1), ball((0, 0, -2))
    light = lamp((0, 0, 0))
    assert probe(renderer, [wall], [light], ray=(0, 0, -4))["diffuse"] == [1, 1, 1]
    seen = probe(renderer, [wall, unseen], [light], ray=(0, 0, -4))
    assert (seen["diffuse"], seen["shadow.L0"]) == (BLACK, 0)


@pytest.mark.parametrize("z", [-2, 5], ids=["before the near plane", "behind the eye"])
def test_what_is_not_in_the_view_shows_in_reflections(renderer: Renderer, z: float) -> None:
    mirror, unseen = ball((0, 0, -9), kr=0.5), ball((0, 0, z), ka=0.5)
    seen = probe(renderer, [mirror, unseen], ray=(0, 0, -4), ambient=(1, 0.5, 0.25))
    assert (seen["id"], seen["reflection"]) == (0, [0.25, 0.125, 0.0625])


def test_the_eye_inside_a_sphere_sees_its_inside(renderer: Renderer) -> None:
    seen = probe(renderer, [ball((0, 0, 0), (2, 3, 4), kd=0.5)], [lamp((0, 0, -1))])
    assert (seen["depth"], seen["normal"], seen["diffuse"]) == (4, [0, 0, 1], [0.5, 0.5, 0.5])


# Which of two hits


@pytest.mark.parametrize("order", [1, -1], ids=["small first", "large first"])
@pytest.mark.parametrize("tangent", ["inside", "outside"])
def test_of_equal_hits_the_first_in_the_file_is_seen(renderer: Renderer, order: int, tangent: str) -> None:
    # Spheres that touch each other at (0, 0, -4), which the ray meets at t = 4 on both.
    if tangent == "inside":
        spheres = [ball((0, 0, -5), 1, ka=0.25), ball((0, 0, -6), 2, ka=0.5)][::order]
        seen = probe(renderer, spheres, ambient=(1, 1, 1))
    else:  # the eye is inside the nearer one
        spheres = [ball((0, 0, -5), 1, ka=0.25), ball((0, 0, -2), 2, ka=0.5)][::order]
        seen = probe(renderer, spheres, ambient=(1, 1, 1))
    assert (seen["id"], seen["depth"], seen["ambient"][0]) == (0, 4, spheres[0].ka)


def test_duplicates_do_not_exist(renderer: Renderer) -> None:
    first, duplicate = ball(CENTRAL, (1, 2, 1), ka=0.5), ball(CENTRAL, (-1, 2, 1), ka=1, kr=1)
    spheres = [first, duplicate, ball((4, 0, -4))]
    with pytest.warns(tracer.SceneWarning):
        seen = probe(renderer, spheres, ambient=(1, 1, 1))
    assert (seen["id"], seen["beauty"]) == (0, [0.5, 0.5, 0.5])
    # A mirror does not meet its duplicate.
    with pytest.warns(tracer.SceneWarning):
        scene = Scene(view=grid(), spheres=[ball((0, 0, -5), 3, kr=1), ball((0, 0, -5), -3, ka=1)], ambient=(1, 1, 1))
    drawn = renderer.draw(scene, ["id", "reflection"])
    assert (drawn["id"] == 0).any()
    assert not drawn["reflection"].any()
    # The index of `id` counts every sphere of the file.
    with pytest.warns(tracer.SceneWarning):
        assert probe(renderer, spheres, ray=(1, 0, -1))["id"] == 2


# Surface


def test_normals_of_an_ellipsoid(renderer: Renderer) -> None:
    # The point 0.6, 0.8 of the unit circle, scaled by (2, 1, 1): x = p + (1.2, 0, 0.8), N ~ (0.6 / 2, 0, 0.8 / 1).
    seen = probe(renderer, [ball(CENTRAL, (2, 1, 1))], ray=(0.6, 0, -2.1))
    assert seen["position"] == renderer.near([1.2, 0, -4.2])
    length = math.sqrt(0.3**2 + 0.8**2)
    assert seen["normal"] == renderer.near([0.3 / length, 0, 0.8 / length])


@pytest.mark.parametrize("signs", [(-1, 1, 1), (1, -1, -1), (-1, -1, -1)])
def test_signs_of_scalings_have_no_effect(renderer: Renderer, signs: Vec3) -> None:
    light = lamp((3, 4, 0))
    flipped = (2 * signs[0], 3 * signs[1], signs[2])
    plain = probe(renderer, [ball(CENTRAL, (2, 3, 1), kd=0.5, ks=0.5)], [light], ray=(0.25, 0.125, -1))
    assert probe(renderer, [ball(CENTRAL, flipped, kd=0.5, ks=0.5)], [light], ray=(0.25, 0.125, -1)) == plain


@pytest.mark.parametrize(("x", "touches"), [(1, True), (1 - 2.0**-10, True), (1 + 2.0**-10, False)])
def test_a_ray_that_touches_hits(renderer: Renderer, x: float, touches: bool) -> None:
    seen = probe(renderer, [ball((x, 0, -5))])
    assert seen["id"] == (0 if touches else -1)


def test_the_normal_where_a_ray_touches_is_the_outward_one(renderer: Renderer) -> None:
    # N = (-1, 0, 0) and V = (0, 0, 1) are perpendicular: flipping has no meaning there. The light is at the left.
    seen = probe(renderer, [ball((1, 0, -5), kd=0.5, ks=1)], [lamp((-3, 0, -5))])
    assert (seen["depth"], seen["normal"]) == (5, [-1, 0, 0])
    assert (seen["shadow.L0"], seen["diffuse"]) == (1, [0.5, 0.5, 0.5])
    # R = L = (-1, 0, 0), so R.V = 0.
    assert seen["specular"] == BLACK


# Terms


def test_ambient(renderer: Renderer) -> None:
    seen = probe(renderer, [ball(CENTRAL, color=(1, 0.5, 0.25), ka=0.5)], ambient=(0.5, -1, 3))
    assert seen["ambient"] == [0.25, -0.25, 0.375]
    assert seen["beauty"] == seen["ambient"]


def test_diffuse(renderer: Renderer) -> None:
    # L = (3, 0, 4) / 5, N.L = 0.8
    seen = probe(renderer, [ball(CENTRAL, color=(1, 0.5, 0.25), kd=0.5)], [lamp((3, 0, 0), (1, 0.5, -2))])
    assert seen["diffuse"] == renderer.near([0.4, 0.1, -0.2])
    assert seen["beauty"] == seen["diffuse"]


@pytest.mark.parametrize("exponent", [0, 0.5, 1, 2, 10, 37.5, 1000])
def test_specular_is_phongs_and_not_times_the_color(renderer: Renderer, exponent: float) -> None:
    # R = 2 (N.L) N - L = (-3, 0, 4) / 5, R.V = 0.8. Blinn's N.H would be cos(atan(3 / 4) / 2) = 0.95.
    sphere = ball(CENTRAL, color=(0, 0, 0), ks=0.5, exponent=exponent)
    seen = probe(renderer, [sphere], [lamp((3, 0, 0), (1, 0.5, -2))])
    power = 0.8**exponent
    assert seen["specular"] == renderer.near([0.5 * power, 0.25 * power, -power], power=exponent)
    assert seen["diffuse"] == BLACK


@pytest.mark.parametrize("exponent", [0, 0.5, 1, 1000])
def test_a_highlight_seen_along_r_has_full_strength(renderer: Renderer, exponent: float) -> None:
    # A light in the eye: N = L = R = V.
    seen = probe(renderer, [ball(CENTRAL, ks=0.5, exponent=exponent)], [lamp((0, 0, 0))])
    assert seen["specular"] == [0.5, 0.5, 0.5]


@pytest.mark.parametrize("exponent", [0, 0.5, 3])
def test_no_specular_where_r_points_away_from_the_viewer(renderer: Renderer, exponent: float) -> None:
    # N = (0.8, 0, 0.6) at x = (0.8, 0, -4.4); the light in the eye: L = V, R.V = 2 (N.V)^2 - 1 = 2 * 4 / 20 - 1 < 0.
    sphere = ball(CENTRAL, kd=1, ks=1, exponent=exponent)
    seen = probe(renderer, [sphere], [lamp((0, 0, 0))], ray=(0.4, 0, -2.2))
    assert seen["diffuse"] == renderer.near([2 / math.sqrt(20)] * 3)
    assert seen["specular"] == BLACK


@pytest.mark.parametrize("exponent", [0, 0.5, 3])
def test_no_light_from_below_the_surface(renderer: Renderer, exponent: float) -> None:
    # The front pole (-4, 0, -8) of an ellipsoid, N = (0, 0, 1), seen along V = (1, 0, 2) / sqrt 5. The light is on the
    # other side of the tangent plane by so little that the surface blocks it before t = 1e-3 only: it is visible,
    # R.V > 0, and still nothing is added.
    sphere = ball((-4, 0, -10), (1, 1, 2), kd=1, ks=1, exponent=exponent)
    light = lamp((-9, 0, -8.01))
    seen = probe(renderer, [sphere], [light], ray=(-0.5, 0, -1), shadow_epsilon=1e-2)
    assert (seen["shadow.L0"], seen["direct"]) == (1, BLACK)
    # Above the tangent plane by as much it is lit.
    above = probe(renderer, [sphere], [lamp((-9, 0, -7.99))], ray=(-0.5, 0, -1), shadow_epsilon=1e-2)
    assert above["specular"][0] > 0
    assert above["diffuse"][0] > 0


def test_lights_have_no_falloff(renderer: Renderer) -> None:
    sphere = ball(CENTRAL, kd=0.5, ks=0.5, exponent=2)
    near, far = lamp((0, 0, -3)), lamp((0, 0, 60))
    assert probe(renderer, [sphere], [near])["direct"] == probe(renderer, [sphere], [far])["direct"] == [1, 1, 1]


def test_lights_add(renderer: Renderer) -> None:
    sphere = ball(CENTRAL, kd=0.5)
    lights = [lamp((0, 0, 0), (1, 0, 0.5)), lamp((3, 0, 0), (0, 1, -0.25))]
    assert probe(renderer, [sphere], lights)["diffuse"] == renderer.near([0.5, 0.4, 0.15])


def test_nothing_is_clamped_in_the_passes(renderer: Renderer) -> None:
    mirror, bright = ball(CENTRAL, ka=1, kd=1, ks=1, kr=0.5), ball((0, 0, 5), ka=1)
    seen = probe(renderer, [mirror, bright], [lamp((0, 0, 0), (8, -8, 0))], ambient=(4, -4, 0.5), background=(9, 9, 9))
    assert seen["ambient"] == [4, -4, 0.5]
    assert seen["diffuse"] == seen["specular"] == [8, -8, 0]
    # Reflected light is not clamped before Kr either: 0.5 * 4.
    assert seen["reflection.1"] == [2, -2, 0.25]
    assert seen["beauty"] == [22, -22, 0.75]


# Shadows


def test_the_outside_of_a_sphere_hides_what_is_behind_it(renderer: Renderer) -> None:
    seen = probe(renderer, [ball(CENTRAL, kd=1, ks=1, exponent=0)], [lamp((0, 0, -9))])
    assert (seen["shadow.L0"], seen["direct"]) == (0, BLACK)


def test_a_sphere_hides_lights_outside_from_its_own_inside(renderer: Renderer) -> None:
    # The near plane cuts the sphere open towards the light, yet its missing part still blocks.
    sphere = ball(CENTRAL, kd=1)
    outside = probe(renderer, [sphere], [lamp((0, 0, 0))], ray=(0, 0, -4.5))
    assert (outside["normal"], outside["shadow.L0"], outside["diffuse"]) == ([0, 0, 1], 0, BLACK)
    within = probe(renderer, [sphere], [lamp((0, 0, -4.25))], ray=(0, 0, -4.5))
    assert (within["shadow.L0"], within["diffuse"]) == (1, [1, 1, 1])


def test_a_light_inside_a_sphere_does_not_light_the_outside(renderer: Renderer) -> None:
    lantern, other = ball(CENTRAL, kd=1), ball((3, 0, -5), kd=1)
    light = lamp((0.25, 0, -5))
    # From the outside of the lantern the light is on the other side of the tangent plane.
    assert probe(renderer, [lantern, other], [light])["diffuse"] == BLACK
    seen = probe(renderer, [lantern, other], [light], ray=(0.5, 0, -1))
    assert (seen["id"], seen["shadow.L0"], seen["diffuse"]) == (1, 0, BLACK)
    assert probe(renderer, [other], [light], ray=(0.5, 0, -1))["diffuse"][0] > 0


@pytest.mark.parametrize(
    ("position", "radius", "visible"),
    [
        ((1.5, 0, -2), 0.5, 0),  # half way
        ((1.5, 2, -2), 0.5, 1),  # beside the way
        ((3, 0, 0), 0.5, 0),  # the light is inside the blocker
        ((4.5, 0, 2), 0.5, 1),  # beyond the light
        ((-1.5, 0, -6), 0.75, 1),  # behind the point
    ],
)
def test_shadows_of_another_sphere(renderer: Renderer, position: Vec3, radius: float, visible: int) -> None:
    # From x = (0, 0, -4) to the light at (3, 0, 0).
    seen = probe(renderer, [ball(CENTRAL, kd=1), ball(position, radius)], [lamp((3, 0, 0))], ray=(0, 0, -3.9))
    assert seen["id"] == 0
    assert (seen["shadow.L0"], seen["diffuse"]) == (visible, renderer.near([0.8 * visible] * 3))


@pytest.mark.parametrize(
    ("light_z", "settings"),
    [(996, {}), (0, {"shadow_epsilon": 0.025})],
    ids=["1e-4 by default", "as set"],
)
@pytest.mark.parametrize(
    ("gap", "radius", "visible"),
    # The blocker spans gap - radius to gap + radius from x; the epsilon is 0.1 from x in both settings.
    [(0.0625, 0.03125, 1), (0.0625, 0.046875, 0), (0.25, 0.125, 0)],
    ids=["before the epsilon", "across the epsilon", "after the epsilon"],
)
def test_shadows_begin_at_the_epsilon(
    renderer: Renderer, light_z: float, settings: dict[str, Any], gap: float, radius: float, visible: int
) -> None:
    # From x = (0, 0, -4) up to the light; the near plane at 3.984375 = 4 - 2^-6 hides the blocker from the eye.
    blocker = ball((0, 0, -4 + gap), radius)
    seen = probe(renderer, [ball(CENTRAL), blocker], [lamp((0, 0, light_z))], ray=(0, 0, -3.984375), **settings)
    assert (seen["id"], seen["depth"], seen["shadow.L0"]) == (0, 4, visible)


def test_the_own_sphere_too_hides_from_the_epsilon_on(renderer: Renderer) -> None:
    # Inside at x = (0, 0, -6) the other root towards (0, 0, 0) is (0, 0, -4), at t = 1 / 3.
    for epsilon, visible in ((0.3, 0), (0.4, 1)):
        seen = probe(renderer, [ball(CENTRAL)], [lamp((0, 0, 0))], ray=(0, 0, -4.5), shadow_epsilon=epsilon)
        assert seen["shadow.L0"] == visible


@pytest.mark.parametrize(
    ("blocker", "radius", "visible"),
    # The way from (0, 0, -4) to the light at (0, 0, -1) meets the blocker's surface at the light, t = 1.
    [(0, 1, 1), (0.5, 1.5, 1), (-1.5, 0.5, 0)],
    ids=["the light is on the near side", "of a larger one too", "the light is on the far side"],
)
def test_a_light_on_a_surface_is_not_hidden_by_that_surface(
    renderer: Renderer, blocker: float, radius: float, visible: int
) -> None:
    seen = probe(renderer, [ball(CENTRAL, kd=1), ball((0, 0, blocker), radius)], [lamp((0, 0, -1))], ray=(0, 0, -3.5))
    assert (seen["shadow.L0"], seen["diffuse"]) == (visible, renderer.near([visible] * 3))


def test_a_light_on_the_own_surface_lights_the_inside(renderer: Renderer) -> None:
    seen = probe(renderer, [ball(CENTRAL, kd=1)], [lamp((0, 0, -4))], ray=(0, 0, -4.5))
    assert (seen["shadow.L0"], seen["diffuse"]) == (1, [1, 1, 1])
    # From the back (0, 0, -6) to the side (1, 0, -5): L = (1, 0, 1) / sqrt 2.
    seen = probe(renderer, [ball(CENTRAL, kd=1)], [lamp((1, 0, -5))], ray=(0, 0, -4.5))
    assert (seen["shadow.L0"], seen["diffuse"]) == (1, renderer.near([math.sqrt(0.5)] * 3))


def test_a_light_on_a_surface_is_seen_whatever_the_rounding(renderer: Renderer) -> None:
    # A light at p + (3, 0, 4) of a sphere of radius 5, then one at p - (3, 0, 4): t = 1, up to rounding.
    room = Scene(view=grid(near=9, size=4), spheres=[ball((0, 0, -10), 5)], lights=[lamp((3, 0, -6))])
    drawn = renderer.draw(room, ["id", "shadow.L0"])
    assert np.count_nonzero(drawn["id"] == 0) > 500
    assert (drawn["shadow.L0"][drawn["id"] == 0] == 1).all()
    beyond = ball((6, 4, 4), 5)
    wall = Scene(view=grid(near=1, size=0.25), spheres=[ball((0, 0, -10), 4, kd=1), beyond], lights=[lamp((3, 4, 0))])
    drawn = renderer.draw(wall, ["diffuse", "shadow.L0"])
    without = renderer.draw(wall.replace(spheres=[wall.spheres[0]]), ["diffuse", "shadow.L0"])
    assert (without["diffuse"] > 0).sum() > 500
    assert (drawn["diffuse"] == without["diffuse"]).all()


def beside(sphere: Sphere, seed: int) -> list[tuple[Vec3, int]]:
    """Lights that lie on a sphere but for the rounding of their coordinates, and their exact sides: 1 outside."""
    way = np.random.default_rng(seed).normal(size=3)
    place = np.array(sphere.position) + np.array(sphere.scaling) * way / np.linalg.norm(way)
    found = []
    for steps in (-2, 0, 2):
        light = place + steps * np.spacing(np.abs(place)) * np.sign(way)
        numbers = zip(light.tolist(), sphere.position, sphere.scaling, strict=True)
        form = sum(((Fraction(p) - Fraction(c)) / Fraction(s)) ** 2 for p, c, s in numbers) - 1
        found.append((tuple(light.tolist()), (form > 0) - (form < 0)))
    assert {-1, 1} <= {side for _, side in found}
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_light_beside_a_surface_is_where_its_numbers_say(renderer: Renderer, seed: int) -> None:
    # From all of the inside of a room a light is hidden that is outside, if only by a rounding.
    room = ball((0.1, 0.3, -10.1), (5.3, 4.9, 5.1))
    for light, side in beside(room, seed):
        drawn = renderer.draw(Scene(view=grid(near=9, size=2), spheres=[room], lights=[lamp(light)]), ["shadow.L0"])
        assert (drawn["shadow.L0"] == (side <= 0)).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_sphere_hides_a_light_just_inside_it(renderer: Renderer, seed: int) -> None:
    # From before the light's tangent plane the way enters the sphere there: so it hides a light that is inside.
    wall, lantern = ball((0, 0, -26.1), 20), ball((0.3, 0.2, 0.1), (0.7, 0.9, 0.8))
    for light, side in beside(lantern, seed):
        scene = Scene(view=grid(), spheres=[wall, lantern], lights=[lamp(light)])
        drawn = renderer.draw(scene, ["position", "shadow.L0"])
        without = renderer.draw(scene.replace(spheres=[wall]), ["shadow.L0"])["shadow.L0"]
        gradient = (np.array(light) - lantern.position) / np.array(lantern.scaling) ** 2
        before = (drawn["position"].astype(float) - light) @ gradient
        clear = np.abs(before) > 1e-3
        assert clear.sum() > 500
        assert (drawn["shadow.L0"] == without * (before > 0) * (side >= 0))[clear].all()


def test_a_light_at_the_hit_adds_nothing_and_counts_as_visible(renderer: Renderer) -> None:
    sphere = ball(CENTRAL, ka=0.5, kd=1, ks=1, exponent=0)
    seen = probe(renderer, [sphere], [lamp((0, 0, -4))], ambient=(1, 1, 1))
    assert (seen["shadow.L0"], seen["direct"], seen["beauty"]) == (1, BLACK, [0.5, 0.5, 0.5])


def test_shadow_passes_are_numbered_in_file_order(renderer: Renderer) -> None:
    seen = probe(renderer, [ball(CENTRAL)], [lamp((0, 0, -9)), lamp((0, 0, 0)), lamp((0, 0, -9))])
    assert [seen[f"shadow.L{i}"] for i in range(3)] == [0, 1, 0]


# Reflection


@pytest.mark.parametrize("bounces", [0, 1, 2, 3, 4])
def test_reflections_along_the_axis(renderer: Renderer, bounces: int) -> None:
    # Two mirrors that face each other, the eye and the light between: N.L = R.V = 1 at every hit.
    # A local term of the first is (1/2, 1/4, 1/8), of the second (1/4, 1/4, 1/4).
    front = ball((0, 0, -5), color=(1, 0.5, 0.25), kd=0.5, kr=0.5)
    back = ball((0, 0, 5), ks=0.25, kr=0.25)
    seen = probe(renderer, [front, back], [lamp((0, 0, 0))], max_reflections=bounces)
    a, b = np.array([0.5, 0.25, 0.125]), np.array([0.25, 0.25, 0.25])
    expected = [0.5 * b, 0.5 * 0.25 * a, 0.5 * 0.25 * 0.5 * b, (0.5 * 0.25) ** 2 * a][:bounces]
    for k, term in enumerate(expected, start=1):
        assert seen[f"reflection.{k}"] == term.tolist()
    assert seen["reflection"] == sum(expected, np.zeros(3)).tolist()
    assert seen["beauty"] == (a + sum(expected, np.zeros(3))).tolist()


def test_three_reflections_by_default(renderer: Renderer) -> None:
    front, back = ball((0, 0, -5), ka=1, kr=1), ball((0, 0, 5), ka=1, kr=1)
    assert probe(renderer, [front, back], ambient=(1, 1, 1))["beauty"] == [4, 4, 4]


def test_the_reflected_direction(renderer: Renderer) -> None:
    # At x = (0, 0, -4) with N = (0.6, 0, 0.8): d - 2 (d.N) N = (0, 0, -1) + 1.6 N = (0.96, 0, 0.28). Ten units along it
    # lies the target, so small that no other direction finds it.
    mirror = ball((-0.6, 0, -4.8), ka=0.125, kr=0.5)
    target = ball((9.6, 0, -1.2), 0.01, ka=0.5)
    seen = probe(renderer, [mirror, target], ambient=(1, 1, 1))
    assert seen["normal"] == renderer.near([0.6, 0, 0.8])
    assert seen["reflection"] == [0.25, 0.25, 0.25]


def test_a_reflected_ray_that_misses_adds_black(renderer: Renderer) -> None:
    seen = probe(renderer, [ball(CENTRAL, ka=0.25, kr=1)], ambient=(1, 1, 1), background=(1, 1, 1))
    assert (seen["reflection"], seen["beauty"]) == (BLACK, [0.25, 0.25, 0.25])


def test_the_inside_of_a_mirror_reflects_itself(renderer: Renderer) -> None:
    # From (0, 0, -2) to (0, 0, 2) and back, through the eye.
    seen = probe(renderer, [ball((0, 0, 0), 2, ka=1, kr=0.5)], ambient=(1, 1, 1))
    assert [seen[f"reflection.{k}"][0] for k in (1, 2, 3)] == [0.5, 0.25, 0.125]


def test_reflections_begin_at_the_surface(renderer: Renderer) -> None:
    # A speck hangs 2^-14 above the point of reflection (0, 0, -4), from t = 2^-16 to 2^-15: an epsilon would lose it.
    # The near plane passes through the gap.
    gap = 2.0**-14
    mirror, speck = ball(CENTRAL, kr=1), ball((0, 0, -4 + 1.5 * gap), gap / 2, ka=1)
    seen = probe(renderer, [mirror, speck], ray=(0, 0, -4 + gap / 2), ambient=(1, 1, 1))
    assert (seen["id"], seen["reflection.1"]) == (0, [1, 1, 1])


def test_hits_of_reflected_rays_have_shadows(renderer: Renderer) -> None:
    # The mirror sees (0, 0, 4) with N = (0, 0, -1); the light at (0, 3, 2): N.L = 2 / sqrt 13.
    mirror, seen_in_it, blocker = ball(CENTRAL, kr=1), ball((0, 0, 5), kd=1), ball((0, 1.5, 3), 0.5)
    lit = probe(renderer, [mirror, seen_in_it], [lamp((0, 3, 2))])
    assert lit["reflection"] == renderer.near([2 / math.sqrt(13)] * 3)
    assert probe(renderer, [mirror, seen_in_it, blocker], [lamp((0, 3, 2))])["reflection"] == BLACK


# Passes


def test_every_pass_where_the_ray_misses(renderer: Renderer) -> None:
    sphere = ball(CENTRAL, ka=1, kd=1, ks=1, kr=1)
    seen = probe(renderer, [sphere], [lamp((0, 0, 0))], ray=(2, 0, -1), ambient=(1, 1, 1), background=(0.5, -1, 2))
    expected: dict[str, Any] = dict.fromkeys(seen, BLACK)
    expected |= {"beauty": [0.5, -1, 2], "depth": math.inf, "id": -1, "shadow.L0": 0}
    assert seen == expected


def test_every_pass_of_an_empty_scene(renderer: Renderer) -> None:
    seen = probe(renderer, [], background=(0.25, 0.5, 0.75))
    expected: dict[str, Any] = dict.fromkeys(seen, BLACK)
    assert seen == expected | {"beauty": [0.25, 0.5, 0.75], "depth": math.inf, "id": -1}


def test_sums_of_passes(renderer: Renderer) -> None:
    front = ball(CENTRAL, color=(0.5, 0.25, 1), ka=0.5, kd=0.5, ks=0.25, kr=0.5)
    seen = probe(renderer, [front, ball((0, 0, 5), ka=0.5)], [lamp((0, 0, 0))], ambient=(1, 1, 1))
    assert seen["direct"] == [0.5, 0.375, 0.75]
    assert seen["beauty"] == [0.25 + 0.5 + 0.25, 0.125 + 0.375 + 0.25, 0.5 + 0.75 + 0.25]


def test_a_pass_that_the_scene_does_not_need_is_zero(renderer: Renderer) -> None:
    seen = probe(renderer, [ball(CENTRAL, ka=1)], ambient=(1, 1, 1))
    zero = ("diffuse", "specular", "direct", "reflection", "reflection.1", "reflection.2", "reflection.3")
    assert [seen[name] for name in zero] == [BLACK] * len(zero)


# The image


LEVELS = [
    (-1.0, 0),
    (0.0, 0),
    (0.00390625, 0),  # 255 / 256 is truncated
    (1 / 255, 1),
    (0.5, 127),  # 127.5 is truncated
    (0.99999, 254),
    (1.0, 255),
    (1e30, 255),
]


def test_levels_are_clamped_and_truncated() -> None:
    values = np.array([value for value, _ in LEVELS])
    assert quantise(values).tolist() == [level for _, level in LEVELS]


@pytest.mark.parametrize(("value", "level"), LEVELS)
def test_levels_of_the_program(tmp_path: Path, value: float, level: int) -> None:
    view = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=2, rows=1)
    path = tmp_path / "scene.txt"
    path.write_text(Scene(view=view, background=(value, 0, 1)).text())
    program = Path(sysconfig.get_path("scripts")) / "raytrace"
    done = subprocess.run([program, path, "-o", "-"], check=True, capture_output=True)
    assert done.stdout == b"P6\n2 1\n255\n" + bytes([level, 0, 255]) * 2
