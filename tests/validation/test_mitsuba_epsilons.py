"""What docs/tolerances.md, section 7, says of the epsilons of Mitsuba's own integrators, for Mitsuba 3.9."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from validation.renderers.mitsuba import VARIANTS, MitsubaSpec, epsilons

pytestmark = pytest.mark.mitsuba

#: Half the distance from 1 to the next number, in float32: Dr.Jit's Epsilon.
UNIT = 2.0**-24
RAY = 1500 * UNIT
SHADOW = 10 * RAY


@pytest.fixture(params=["llvm", "scalar"])
def mi(request: pytest.FixtureRequest, need: Callable[[object, str], None]) -> Any:
    """Mitsuba in a float32 variant."""
    unavailable = MitsubaSpec(request.param).unavailable()
    need(unavailable is None, str(unavailable))
    import mitsuba

    mitsuba.set_variant(VARIANTS[request.param])
    return mitsuba


def surface(mi: Any, point: tuple[float, float, float]) -> Any:
    """A point of a surface that looks along +z."""
    found = mi.SurfaceInteraction3f()
    found.p, found.n = mi.Point3f(*point), mi.Normal3f(0, 0, 1)
    return found


def numbers(value: Any) -> Any:
    """A value of any variant."""
    return np.array(value, dtype=np.float64).ravel()


def test_the_epsilons(mi: Any) -> None:
    derived = f"derived for Mitsuba 3.9, this is {mi.__version__}"
    assert mi.math.RayEpsilon == pytest.approx(RAY, rel=1e-6), derived
    assert mi.math.ShadowEpsilon == pytest.approx(SHADOW, rel=1e-6), derived
    assert pytest.approx((8.94e-5, 8.94e-4), rel=1e-3) == (RAY, SHADOW)
    assert (epsilons.RAY_EPSILON, epsilons.SHADOW_EPSILON) == (RAY, SHADOW)
    epsilons.check()


def test_a_mitsuba_with_other_epsilons_is_refused(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    del mi
    monkeypatch.setattr(epsilons, "SHADOW_EPSILON", 1e-3)
    with pytest.raises(RuntimeError, match=r"ShadowEpsilon is 0\.000894 in Mitsuba .*, and 0\.001 in those known"):
        epsilons.check()


@pytest.mark.parametrize("point", [(3.0, -7.0, 2.0), (0.0, 0.0, 0.0), (0.1, 100.0, -0.2)])
def test_rays_start_beside_the_surface(mi: Any, point: tuple[float, float, float]) -> None:
    step = (1 + max(map(abs, point))) * RAY
    for z, side in ((0.8, 1), (-0.8, -1)):
        ray = surface(mi, point).spawn_ray(mi.Vector3f(0.6, 0, z))
        moved = numbers(ray.o) - point
        assert moved[:2] == pytest.approx([0, 0], abs=1e-5)
        assert moved[2] == pytest.approx(side * step, abs=2 * UNIT * (step + abs(point[2])))


def test_rays_to_a_light_end_before_it(mi: Any) -> None:
    start = 2 + 8 * RAY
    ray = surface(mi, (3, -7, 2)).spawn_ray_to(mi.Point3f(3, -7, 12))
    assert numbers(ray.o)[2] == pytest.approx(start, abs=1e-6)
    assert numbers(ray.maxt) == pytest.approx((12 - start) * (1 - SHADOW), rel=1e-6)


def test_ray_test_decides_on_a_float32_discriminant_in_the_variant_llvm(mi: Any) -> None:
    # A unit sphere b = 3000 away: D = 1 - |l|^2 is the difference of numbers of the size b^2, which is 9e6 u = 0.5 off.
    random = np.random.default_rng(1)
    angle, aside = random.uniform(0, 2 * np.pi, 100), random.uniform(0.95, 1.05, 100)
    ball = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "center": [0, 0, -3000], "radius": 1.0}})
    wrong = {"ray_test": 0, "nearest": 0}
    for x, y in zip(aside * np.cos(angle), aside * np.sin(angle), strict=True):
        length = float(np.hypot(np.hypot(x, y), 3000))
        ray = mi.Ray3f(mi.Point3f(0, 0, 0), mi.Vector3f(float(x) / length, float(y) / length, -3000 / length))
        direction, center = numbers(ray.d), np.array([0, 0, -3000.0])
        closest = center - direction * (center @ direction) / (direction @ direction)
        meets = bool(closest @ closest < 1)
        wrong["ray_test"] += bool(numbers(ball.ray_test(ray))[0]) != meets
        wrong["nearest"] += bool(numbers(ball.ray_intersect_preliminary(ray).is_valid())[0]) != meets
    assert wrong["nearest"] == 0
    assert (wrong["ray_test"] > 20) == mi.variant().startswith("llvm"), f"Mitsuba {mi.__version__}: {wrong}"
