"""Mitsuba 3 as a reference that keeps to the specification's ray ranges, `mitsuba-spec`, and the list of all others.

What is Mitsuba's: which shape a ray meets first and where (its acceleration structure, its sphere routine, its instance
transforms), the hit point, its normal, the identity of the shape, the ambient colour (a shape attribute), and the value
of the BSDF for a direction to the viewer and one to a light.

What is ours: the rays (their origins and directions are worked out in float64 from Mitsuba's float32 hit points), the
loop over lights and bounces, and the rules of the specification about which hits count. A ray that leaves a sphere has
a root at its start. Exactly it is 0 and does not count; in float32 Mitsuba may find it a little later. So on the sphere
that a ray starts on, a hit counts only if it can be the other root: from the inside, and on the way out. Any other hit
of that sphere is passed over, and the ray goes on behind it. No origin is moved off a surface.

Mitsuba's own integrators, those of `stock.py` and `path.py`, move origins by 1e-4 of the scene; here nothing is moved,
and the only lengths of ours are `SLACK`, one step for rays that go on and one for a light that lies on a surface.
docs/tolerances.md derives what follows from float32.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from converters import mitsuba as converter
from tracer.passes import Passes, names
from validation.renderers import Renderer, Settings, Uncertainty
from validation.renderers.mitsuba import llvm, path, stock
from validation.renderers.mitsuba.driver import Driver
from validation.renderers.mitsuba.engines import Arrays, Engine, Loop
from validation.renderers.mitsuba.precision import at_lights, flat_chords, passed_over, uncertainty
from validation.renderers.mitsuba.variants import VARIANTS, Variant

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.rules import Rule

__all__ = ["VARIANTS", "MitsubaSpec", "llvm", "renderers"]

#: How long a picture may take in scalar mode, in seconds, and what a piece of work takes on a machine of 2024. A scene
#: may need two: one of its own size with the passes that are quick, and a smaller one with the others.
BUDGET = 2.5
COST = {"ray": 1.5e-6, "hit": 3e-6, "stock": 1.5e-6, "phong": 7e-6}
#: The edge of the picture that tells how much work a scene is, in pixels.
PROBE = 32


class MitsubaSpec(Variant):
    """Mitsuba behind the face of a renderer, in one variant."""

    family = "mitsuba-spec"

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Every pass but the margins; none where float32 does not hold the scene."""
        if stock.refusal(scene, self.backend):
            return ()
        return names(len(scene.lights), settings.max_reflections, margins=False)

    def refusal(self, scene: Scene) -> str:
        """Why it has no pass for a scene."""
        return stock.refusal(scene, self.backend) or "nothing"

    def sources(self, scene: Scene, settings: Settings) -> Mapping[str, str]:
        """Our loop on Mitsuba's hits and the values of its BSDFs, or of our plugins where something shines."""
        derived = ("depth", "beauty", "direct", "reflection")
        return {name: "derived" if name in derived else "plugin" for name in self.passes(scene, settings)}

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """What float32 allows; only the variant that compiles intersects in it too."""
        del analysis
        float32_roots = self.backend != "scalar"
        found = uncertainty(scene, settings, float32_roots=float32_roots)
        either = at_lights(scene, settings, float32_roots=float32_roots)
        if not either.any():
            return found
        # Of the decisions about such a light one is near; which, depends on the side that it is on.
        return dataclasses.replace(
            found, silhouette=np.where(either, np.inf, found.silhouette), range=np.where(either, np.inf, found.range)
        )

    def rules(self, scene: Scene, settings: Settings) -> Sequence[Rule]:
        """How it decides otherwise than the specification, where rounding alone does not say it."""
        float32_roots = self.backend != "scalar"
        return [
            *flat_chords(scene, settings, float32_roots=float32_roots),
            *passed_over(scene, settings, float32_roots=float32_roots),
        ]

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for.

        Raises:
            ValueError: a pass that it does not have for this scene.
            RuntimeError: this variant cannot run here.
        """
        if unknown := [name for name in passes if name not in self.passes(scene, settings)]:
            raise ValueError(f"{self.name} has no pass '{unknown[0]}' for this scene")
        with self.ready():
            driver = Driver(scene, settings, self.engine(scene))
            images = driver.render(passes)
        size = (scene.view.rows, scene.view.columns)
        return Passes({name: image.reshape(*size, *image.shape[1:]) for name, image in images.items()}, self.versions())

    def shapes(self, scene: Scene) -> dict[str, Any]:
        """What is loaded of the scene. Robust: boxes around shapes are not missed by a rounding."""
        return {"type": "scene", "embree_use_robust_intersections": True, **converter.geometry(scene)}

    def engine(self, scene: Scene) -> Engine:
        """The scene's shapes in this variant, which is set."""
        return Loop(self.shapes(scene)) if self.backend == "scalar" else Arrays(self.shapes(scene))

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """For the loop, as many as it can do in BUDGET seconds: the work of a small picture tells.

        Counted, not timed, so that the same scene is always drawn at the same size.
        """
        if self.backend != "scalar":
            return None
        return _loop_pixels(scene, tuple(passes))


@functools.lru_cache(maxsize=256)
def _loop_pixels(scene: Scene, passes: tuple[str, ...]) -> int | None:
    view = scene.view
    if view.columns * view.rows <= PROBE * PROBE:
        return None
    small = scene.replace(view=view.replace(columns=PROBE, rows=PROBE))
    scalar = MitsubaSpec("scalar")
    with scalar.ready():
        engine = Loop(scalar.shapes(small))
        Driver(small, Settings(), engine).render(passes)
    seconds = sum(COST[kind] * count for kind, count in engine.work.items())
    return max(PROBE * PROBE, int(BUDGET / seconds * PROBE * PROBE))


def renderers() -> list[Renderer]:
    """The entry point: of each family the best first."""
    spec = [MitsubaSpec(backend) for backend in ("llvm", "scalar", "cuda")]
    return [*spec, *stock.renderers(), *path.renderers()]
