"""What a renderer that computes in plain floating point may be off by: one derivation for ours and for others'."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from tracer.margins import EDGE_ROUNDINGS, VALUE_ROUNDINGS
from validation.renderers import Settings, Uncertainty

if TYPE_CHECKING:
    from tracer import Scene

Precision = Literal["f64", "f32"]

#: Half the distance from 1 to the next number.
UNIT_ROUNDOFF: dict[Precision, float] = {"f64": 2.0**-53, "f32": 2.0**-24}


#: Below this a format rounds absolutely, or to zero: a first-order bound, which is relative, does not cover it.
UNDERFLOW: dict[Precision, float] = {"f64": 2.0**-1022, "f32": 2.0**-126}


def uncertainty(precision: Precision, scene: Scene, settings: Settings) -> Uncertainty:
    """The uncertainty of a renderer that keeps to the specification in that format; docs/tolerances.md derives it."""
    unit = UNIT_ROUNDOFF[precision]
    decision = EDGE_ROUNDINGS * unit
    tiny = VALUE_ROUNDINGS * UNDERFLOW[precision]
    # A factor that underflows, for example (R.V)^n, is off by UNDERFLOW and meets at most the light's intensity and
    # factors up to 1: three terms a light and hit, and the products with them, may each do so.
    light = 1 + max(map(abs, scene.ambient)) + sum(max(map(abs, entry.intensity)) for entry in scene.lights)
    color = tiny * (1 + settings.max_reflections) * light
    # A coordinate is a sum of products with numbers of the scene.
    view = scene.view
    far = max(
        [view.near, *map(abs, (view.left, view.right, view.bottom, view.top))]
        + [abs(number) for sphere in scene.spheres for number in (*sphere.position, *sphere.scaling)]
    )
    length = tiny * (1 + far)
    return Uncertainty(
        silhouette=decision,
        range=decision,
        order=decision,
        terminator=decision,
        unit=VALUE_ROUNDINGS * unit,
        absolute={
            "color": color,
            "length": length,
            "position": length,
            "normal": tiny,
        },
    )
