"""Arrays in the page come out as they went in: undone here by other means than the viewer's."""

from __future__ import annotations

import base64
import math
import zlib

import doubles
import numpy as np
import pytest

from tracer.passes import Passes
from validation import Settings
from validation.renderers.native import Native
from validation.renderers.numpy import Reference
from validation.report import floats
from validation.report.floats import IS_SUM, Guide, Stored


def words(text: str, count: int) -> tuple[list[int], bytes]:
    """The integers of a block one by one, and what stands behind them."""
    data = zlib.decompress(base64.b64decode(text))
    found = []
    for i in range(count):
        zigzag = sum(data[k * count + i] << (8 * k) for k in range(4))
        found.append(zigzag // 2 if zigzag % 2 == 0 else -(zigzag + 1) // 2)
    return found, data[4 * count :]


def wrapped(value: int) -> int:
    return (value + 2**31) % 2**32 - 2**31


def to_order(value: float) -> int:
    bits = int(np.float32(value).view(np.int32))
    return bits if bits >= 0 else -(2**31) - bits - 1


def from_order(order: int) -> float:
    bits = order if order >= 0 else -(2**31) - order - 1
    return float(np.int32(bits).view(np.float32))


def undo(stored: dict[str, Stored], name: str, shape: tuple[int, int], first: dict[str, Stored] | None) -> list[float]:
    """The values of a pass, channel after channel."""
    one = stored[name]
    rows, columns = shape
    pixels = rows * columns
    residual, _ = words(one.base, one.channels * pixels)
    parts = [undo(stored, part, shape, first) for part in one.parts]
    bases = [undo_base(stored, part, shape, first) for part in one.parts]
    base = undo_base(stored, name, shape, first)
    assert len(residual) == len(base)
    if not one.rest:
        return base
    rest, behind = words(one.rest, len(base))
    if one.based:
        assert first is not None
        above = undo(first, name, shape, None)
        below = undo_base(first, name, shape, None)
        rest = [wrapped(a + steps(value, near)) for a, value, near in zip(rest, above, below, strict=True)]
    found = []
    for i, (near, step) in enumerate(zip(base, rest, strict=True)):
        if step == IS_SUM and parts:
            found.append(sum_of([part[i] for part in parts]))
        else:
            found.append(float((np.float64(near).view(np.int64) + step).view(np.float64)))
    assert len(bases) == len(parts)
    count = len(behind) // 12
    places, values = np.frombuffer(behind[: 4 * count], "<u4"), np.frombuffer(behind[4 * count :], "<f8")
    for place, value in zip(places, values, strict=True):
        found[place] = float(value)
    return found


def sum_of(values: list[float]) -> float:
    total = values[0]
    for value in values[1:]:
        total += value
    return total


def steps(value: float, near: float) -> int:
    if np.signbit(value) != np.signbit(near) or np.isnan(value):
        return 0
    far = int(np.float64(value).view(np.int64)) - int(np.float64(near).view(np.int64))
    return far if abs(far) < 2**30 else 0


def undo_base(
    stored: dict[str, Stored], name: str, shape: tuple[int, int], first: dict[str, Stored] | None
) -> list[float]:
    one = stored[name]
    rows, columns = shape
    residual, _ = words(one.base, one.channels * rows * columns)
    if one.prediction == "first":
        assert first is not None
        near = [to_order(value) for value in undo_base(first, name, shape, None)]
        return [from_order(wrapped(a + b)) for a, b in zip(residual, near, strict=True)]
    if one.prediction == "sum":
        parts = [undo_base(stored, part, shape, first) for part in one.parts]
        sums = [to_order(float(np.float32(sum_of(list(values))))) for values in zip(*parts, strict=True)]
        return [from_order(wrapped(a + b)) for a, b in zip(residual, sums, strict=True)]
    if one.prediction in ("ray", "surface"):
        guides = [undo_base(stored, guide, shape, first) for guide in one.guides]
        near = on_rays(guides[0], shape) if one.prediction == "ray" else on_spheres(guides[0], guides[1])
        return [from_order(wrapped(a + to_order(b))) for a, b in zip(residual, near, strict=True)]
    order: list[int] = []
    for i, value in enumerate(residual):
        x, y = i % columns, i // columns % rows
        left = order[i - 1] if x else 0
        above = order[i - columns] if y else 0
        corner = order[i - columns - 1] if x and y else 0
        order.append(wrapped(value + (left + above - corner if x and y else left if x else above)))
    return [from_order(value) for value in order]


def on_rays(depth: list[float], shape: tuple[int, int]) -> list[float]:
    """Points on the rays of `small_scene`, x of all pixels first."""
    view = small_scene().view
    across, down = (view.right - view.left) / view.columns, (view.bottom - view.top) / view.rows
    found: list[list[float]] = [[], [], []]
    for i, far in enumerate(depth):
        d = (view.left + across * (i % shape[1]), view.top + down * (i // shape[1]), -view.near)
        length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        for axis in range(3):
            found[axis].append(d[axis] * (far / length) if math.isfinite(far) else 0.0)
    return [*found[0], *found[1], *found[2]]


def on_spheres(points: list[float], ids: list[float]) -> list[float]:
    """Normals of `small_scene` at points, towards the eye."""
    spheres, count = small_scene().spheres, len(ids)
    found = [0.0] * (3 * count)
    for i, id in enumerate(ids):
        if id < 0:
            continue
        sphere, p = spheres[int(id)], [points[axis * count + i] for axis in range(3)]
        n = [(p[k] - sphere.position[k]) / (sphere.scaling[k] * sphere.scaling[k]) for k in range(3)]
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if n[0] * p[0] + n[1] * p[1] + n[2] * p[2] > 0:
            length = -length
        for k in range(3):
            found[k * count + i] = n[k] / length
    return found


def flat(array: np.ndarray) -> np.ndarray:
    planes = np.asarray(array, np.float64)
    return (np.moveaxis(planes, 2, 0) if planes.ndim == 3 else planes).reshape(-1)


def same(found: list[float], array: np.ndarray) -> bool:
    """Bit by bit, but for what kind of NaN."""
    a, b = np.array(found), flat(array)
    return bool(((a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))).all())


def small_scene() -> doubles.tracer.Scene:
    scene = doubles.full()
    return scene.replace(view=scene.view.replace(columns=24, rows=18))


@pytest.mark.parametrize("guided", [True, False])
def test_every_pass_of_every_renderer_comes_out_exactly(guided: bool) -> None:
    scene = small_scene()
    guide = Guide.of(scene, Settings()) if guided else None
    first, source = None, None
    for renderer in (Native("f64"), Native("f32"), Reference("f64"), Reference("f32")):
        passes = renderer.render(scene, renderer.passes(scene, Settings()), Settings())
        stored, own = floats.store(passes, source, guide)
        for name, array in passes.items():
            assert same(undo(stored, name, passes.shape, first), array), (renderer.name, name)
        first, source = first or stored, source or own
    assert first
    assert first["beauty"].prediction == "sum"
    assert not first["beauty"].based
    assert (first["position"].prediction, first["normal"].prediction) == (
        ("ray", "surface") if guided else ("planar", "planar")
    )


def test_values_that_no_float32_is_near() -> None:
    odd = [0.0, -0.0, 1e-50, -1e-50, 1e300, -1e300, np.inf, -np.inf, np.nan, 1e-40, 3.5e38, 0.1]
    one = Passes({"depth": np.array([odd])})
    other = Passes({"depth": np.array([odd[::-1]])})
    stored, source = floats.store(one, None)
    assert same(undo(stored, "depth", one.shape, None), one["depth"])
    second, _ = floats.store(other, source)
    assert second["depth"].based
    assert same(undo(second, "depth", one.shape, stored), other["depth"])


@pytest.mark.parametrize("dtype", [np.int32, np.uint8, np.float32, np.bool_])
def test_other_numbers_need_no_rest(dtype: type) -> None:
    array = np.arange(12).reshape(3, 4).astype(dtype)
    stored, _ = floats.store(Passes({"id" if dtype is np.int32 else "depth": array}), None)
    (one,) = stored.values()
    assert one.rest == ""
    assert not one.wide


def test_without_the_first_rest_two_float64_still_differ_by_the_same() -> None:
    rng = np.random.default_rng(1)
    values = rng.uniform(0.5, 1, (6, 8))
    one, other = Passes({"depth": values}), Passes({"depth": values + 1e-12})
    stored, source = floats.store(one, None)
    second, _ = floats.store(other, source)
    cut = {"depth": Stored(1, "planar", stored["depth"].base, wide=True)}
    a, b = (np.array(undo(of, "depth", one.shape, cut)) for of in (cut, second))
    assert np.allclose(b - a, 1e-12, rtol=1e-3, atol=0)


def test_margins_keep_two_digits() -> None:
    margins = {"silhouette": np.array([[1e-9, 0.25], [np.inf, 3.3]]), "range": np.array([[0.0, 1e-300], [7, 8e-5]])}
    packed, _ = words(floats.store_margins(margins), 8)
    stored = {"margins": Stored(2, "planar", floats.store_margins(margins))}
    found = np.array(undo_base(stored, "margins", (2, 2), None)).reshape(2, 2, 2)
    assert len(packed) == 8
    assert np.allclose(found, np.stack([*margins.values()]), rtol=0.01, atol=1e-38)
