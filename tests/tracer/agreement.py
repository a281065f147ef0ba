"""How far two renderings of a scene are apart, in units of what the analysis allows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tracer import Passes, Scene
from tracer.margins import Analysis
from tracer.passes import lookup, names

Draw = Callable[[Scene, tuple[str, ...]], Passes]


def all_passes(scene: Scene) -> tuple[str, ...]:
    """Every pass but the margins."""
    return names(len(scene.lights), margins=False)


@dataclass
class Agreement:
    """What `compare` found."""

    worst: float  # largest error of an interior pixel over delta * sensitivity
    where: str  # its pass
    flipped: float  # largest margin over delta of a pixel whose id or visibility differs, edges included
    edges: int


def compare(image: Passes, truth: Passes, analysis: Analysis, delta: float, edge: float) -> Agreement:
    """Hold an image against the truth where every margin is at least edge * delta; decisions everywhere."""
    margin = np.min(list(analysis.margins.values()), axis=0)
    interior = margin >= edge * delta
    worst, where = 0.0, ""
    flips = np.zeros(margin.shape, bool)
    for name in truth:
        row = lookup(name)
        if row.quantity == "id":
            flips |= image[name] != truth[name]
            continue
        if row.quantity == "visibility":
            flips |= (image[name] != truth[name]) & analysis.lit[int(name.removeprefix("shadow.L"))]
            continue
        a, b = image[name].astype(np.float64), truth[name].astype(np.float64)
        difference = np.where(a == b, 0, np.abs(a - np.where(np.isinf(b), 0, b)))
        # An angle: the chord of two unit vectors is the angle to first order. Of colours the largest channel.
        if row.quantity == "normal":
            difference = np.sqrt((difference**2).sum(axis=-1))
        elif row.channels:
            difference = difference.max(axis=-1)
        allowed = delta * analysis.sensitivity[name]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(interior & (difference > 0), difference / allowed, 0).max(initial=0)
        if not share <= worst:
            worst, where = float(share), name
    return Agreement(worst, where, float((margin[flips] / delta).max(initial=0)), int((~interior).sum()))
