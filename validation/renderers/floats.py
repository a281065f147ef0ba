"""Renderers that keep to the specification in plain floating point: what they may be off by, and what ours share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import tracer
from tracer.margins import EDGE_ROUNDINGS, VALUE_ROUNDINGS
from tracer.passes import Passes, Precision, names
from validation.renderers import Settings, Uncertainty

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis

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
    # VALUE_ROUNDINGS is for three reflections; each one more is a root more, whose slope may grow.
    growth = (4 / 3) ** (max(settings.max_reflections - 3, 0) / 2)
    return Uncertainty(
        silhouette=decision,
        range=decision,
        order=decision,
        terminator=decision,
        unit=VALUE_ROUNDINGS * unit * growth,
        absolute={
            "color": color,
            "length": length,
            "position": length,
            "normal": tiny,
        },
    )


class FloatRenderer(ABC):
    """One of our own renderers in one precision; a subclass says what draws, and with what."""

    program: ClassVar[str]
    #: Whether it has the passes `margin.*` too.
    margins: ClassVar[bool] = False
    #: The largest image that it draws; None: any.
    most_pixels: ClassVar[int | None] = None

    def __init__(self, precision: Precision) -> None:
        """One a precision."""
        self.precision: Precision = precision
        self.name = f"{self.program}-{precision}"

    def version(self) -> str:
        """The version of the package that carries it."""
        return tracer.version()

    def versions(self) -> Mapping[str, str]:
        """The package, and what it is made with."""
        return {"whitted": tracer.version(), **self.parts()}

    @abstractmethod
    def parts(self) -> Mapping[str, str]:
        """What else decides about its results, with versions."""

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Every pass of the scene; the margins only where it has them."""
        return names(len(scene.lights), settings.max_reflections, margins=self.margins)

    def unavailable(self) -> str | None:
        """None: it comes with the package."""
        return None

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """That of its format."""
        del analysis
        return uncertainty(self.precision, scene, settings)

    @abstractmethod
    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for."""

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """The same for every scene."""
        del scene, passes
        return self.most_pixels
