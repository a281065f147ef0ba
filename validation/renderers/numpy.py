"""The reference in NumPy, in float64 and float32."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy

import tracer.reference
from validation.renderers.floats import FloatRenderer

if TYPE_CHECKING:
    from tracer import Passes, Scene
    from validation.renderers import Settings


class Reference(FloatRenderer):
    """`tracer.reference.render` behind the face of a renderer."""

    program = "numpy"
    margins = True
    #: It keeps every pass of the whole image, asked for or not: some 400 bytes a pixel.
    most_pixels = 4_000_000

    def parts(self) -> Mapping[str, str]:
        """NumPy."""
        return {"numpy": numpy.__version__}

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


def renderers() -> list[Reference]:
    """The entry point."""
    return [Reference("f64"), Reference("f32")]
