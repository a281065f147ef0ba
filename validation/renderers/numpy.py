"""The reference in NumPy, in float64 and float32."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy

import tracer
import tracer.reference
from tracer.passes import Passes, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.floats import Precision, uncertainty

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis

#: The reference holds every ray of the image at once, some 200 float64 a pixel: 4 million pixels are 6 GB.
MAX_PIXELS = 4_000_000


class Reference:
    """`tracer.reference.render` behind the face of a renderer."""

    def __init__(self, precision: Precision) -> None:
        """One a precision."""
        self.precision = precision
        self.name = f"numpy-{precision}"

    def version(self) -> str:
        """The version of the package that carries it."""
        return tracer.version()

    def versions(self) -> Mapping[str, str]:
        """The package and NumPy."""
        return {"whitted": tracer.version(), "numpy": numpy.__version__}

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Every pass, margins too."""
        return names(len(scene.lights), settings.max_reflections)

    def unavailable(self) -> str | None:
        """None: it comes with the package."""
        return None

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """That of its format."""
        del analysis
        return uncertainty(self.precision, scene, settings)

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for."""
        return tracer.reference.render(
            scene,
            tuple(passes),
            precision=self.precision,
            sample=settings.sample,
            shadow_epsilon=settings.shadow_epsilon,
            max_reflections=settings.max_reflections,
        )

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """What memory holds."""
        del scene, passes
        return MAX_PIXELS


def renderers() -> list[Reference]:
    """The entry point."""
    return [Reference("f64"), Reference("f32")]
