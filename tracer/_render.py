"""render(): the checked face of the C++ renderer."""

from __future__ import annotations

import operator
import os
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from .passes import SAMPLES, Passes, Precision, Sample, lookup


def render(
    scene: _native.Scene,
    passes: Sequence[str] = ("beauty",),
    *,
    precision: Precision = "f64",
    threads: int = 0,
    sample: Sample = "corner",
    shadow_epsilon: float = 1e-4,
    max_reflections: int = 3,
) -> Passes:
    """Render passes of a scene; the interpreter is not locked meanwhile, and Ctrl-C stops it.

    Args:
        scene: what to render.
        passes: names of the table in `tracer.passes`; not the margins, which `tracer.reference` computes.
        precision: "f64" or "f32", also of the arrays that come back.
        threads: 0 takes as many as there are processors.
        sample: where in a pixel its ray goes through.
        shadow_epsilon: shadow rays count hits with shadow_epsilon < t < 1, in units of the way to the light.
        max_reflections: mirror bounces followed for a pixel.

    Raises:
        TypeError: an argument of another kind.
        ValueError: a pass, or a setting, that there is not.
        SceneError: a magnitude that float32 cannot carry.
        MemoryError: the passes need more memory than this machine has.
    """
    if not isinstance(scene, _native.Scene):
        raise TypeError(f"scene is {scene!r}, expected a Scene: tracer.load(path) reads one from a file")
    threads, max_reflections = _integer("threads", threads), _integer("max_reflections", max_reflections)
    if not isinstance(shadow_epsilon, Real):
        raise TypeError(f"shadow_epsilon is {shadow_epsilon!r}, expected a number")
    names = (passes,) if isinstance(passes, str) else tuple(dict.fromkeys(passes))
    if strange := [name for name in names if not isinstance(name, str)]:
        raise TypeError(f"passes holds {strange[0]!r}, expected names of passes")
    if precision not in ("f64", "f32"):
        raise ValueError(f"precision is {precision!r}, expected 'f64' or 'f32'")
    if sample not in SAMPLES:
        raise ValueError(f"sample is {sample!r}, expected one of {', '.join(map(repr, SAMPLES))}")
    if not 0 <= threads <= _native.MOST_THREADS:
        raise ValueError(f"threads is {threads}, expected 0 to {_native.MOST_THREADS}")
    if not 0 <= shadow_epsilon < 1:
        raise ValueError(f"shadow_epsilon is {shadow_epsilon}, expected 0 <= shadow_epsilon < 1")
    if not 0 <= max_reflections <= _native.MOST_REFLECTIONS:
        raise ValueError(f"max_reflections is {max_reflections}, expected 0 to {_native.MOST_REFLECTIONS}")

    dtype = np.dtype(np.float64 if precision == "f64" else np.float32)
    targets = [(name, *_member(scene, name)) for name in names]
    view = scene.view
    check_memory(names, view.columns, view.rows, dtype)

    arrays: dict[str, NDArray[Any]] = {}
    filled = []
    for name, kind, member in targets:
        channels = lookup(name).channels
        shape = (view.rows, view.columns, len(channels)) if channels else (view.rows, view.columns)
        arrays[name] = np.zeros(shape, np.int32 if kind == "id" else dtype)
        if kind != "reflection.*" or member <= max_reflections:
            filled.append((kind, member, arrays[name]))
    _native.render_into(scene, filled, precision, threads, sample, shadow_epsilon, max_reflections)
    settings = {"sample": sample, "shadow_epsilon": repr(shadow_epsilon), "max_reflections": str(max_reflections)}
    made_by = {"renderer": f"native-{precision}", "instruction_set": _native.instruction_set()}
    return Passes(arrays, made_by | settings)


def check_memory(names: Sequence[str], columns: int, rows: int, dtype: np.dtype[Any]) -> None:
    """Raise MemoryError for passes of an image that need more memory than this machine has."""
    needed = sum(rows * columns * _pixel_size(name, dtype) for name in names)
    installed = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > installed:
        passes = "1 pass" if len(names) == 1 else f"{len(names)} passes"
        needs = f"need{'s' * (len(names) == 1)} {needed} bytes"
        raise MemoryError(f"{passes} of {columns}x{rows} pixels {needs}, this machine has {installed}")


def _integer(name: str, value: object) -> int:
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise TypeError(f"{name} is {value!r}, expected an integer") from None


def _member(scene: _native.Scene, name: str) -> tuple[str, int]:
    """The row of the table that a pass belongs to, and which light or bounce of it."""
    row = lookup(name)
    if row.quantity == "margin":
        raise ValueError(f"pass '{name}' is not a pass of the renderer: tracer.reference computes margins")
    member = int(name.removeprefix(row.name.removesuffix("*"))) if row.family else 0
    if row.quantity == "visibility" and member >= len(scene.lights):
        raise ValueError(f"pass '{name}' asks for light {member}, but the scene has {len(scene.lights)}, from 0")
    return row.name, member


def _pixel_size(name: str, dtype: np.dtype[Any]) -> int:
    return (len(lookup(name).channels) or 1) * dtype.itemsize
