"""The assignment's renderer, the C++ one, in float64 and float32."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import tracer
from tracer.passes import Passes, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.floats import Precision, uncertainty

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis


class Native:
    """`tracer.render` behind the face of a renderer."""

    def __init__(self, precision: Precision) -> None:
        """One a precision."""
        self.precision = precision
        self.name = f"native-{precision}"

    def version(self) -> str:
        """The version of the package that carries it."""
        return tracer.version()

    def versions(self) -> Mapping[str, str]:
        """The package, the compiler that built it and the instruction set in use."""
        return {
            "whitted": tracer.version(),
            "compiler": tracer.compiler(),
            "instruction set": tracer.instruction_set(),
        }

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Every pass but the margins."""
        every = names(len(scene.lights), settings.max_reflections)
        return tuple(name for name in every if not name.startswith("margin."))

    def unavailable(self) -> str | None:
        """None: it comes with the package."""
        return None

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """That of its format."""
        del analysis
        return uncertainty(self.precision, scene, settings)

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

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """Any size."""
        del scene, passes
        return None


def renderers() -> list[Native]:
    """The entry point."""
    return [Native("f64"), Native("f32")]
