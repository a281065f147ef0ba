"""The assignment's renderer, the C++ one, in float64 and float32."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import tracer
from validation.renderers.floats import FloatRenderer

if TYPE_CHECKING:
    from tracer import Passes, Scene
    from validation.renderers import Settings


class Native(FloatRenderer):
    """`tracer.render` behind the face of a renderer."""

    program = "native"

    def parts(self) -> Mapping[str, str]:
        """The compiler that built it and the instruction set in use."""
        return {"compiler": tracer.compiler(), "instruction set": tracer.instruction_set()}

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for."""
        return tracer.render(
            scene,
            tuple(passes),
            precision=self.precision,
            threads=settings.threads,
            sample=settings.sample,
            shadow_epsilon=settings.shadow_epsilon,
            max_reflections=settings.max_reflections,
        )


def renderers() -> list[Native]:
    """The entry point."""
    return [Native("f64"), Native("f32")]
