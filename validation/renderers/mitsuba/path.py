"""Our surfaces and lights in Mitsuba's own `path` integrator, with its own epsilons: `mitsuba-path`.

Mitsuba traces the rays, finds the hits, decides what hides a light and goes on into the mirrors; our plugins say what a
surface reflects and where a ray through a pixel goes. The integrator picks one light at random, so each light is an
image of its own, and so is the ambient term; the sum is the model. What a mirror shows is the difference of an image
with one reflection more and one without.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from tracer import reference
from tracer.passes import Passes, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.mitsuba import epsilons, stock
from validation.renderers.mitsuba.precision import UNIT_ROUNDOFF
from validation.renderers.mitsuba.variants import Variant

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.rules import Rule

Image = NDArray[np.float64]

#: How long a picture may take in scalar mode, in seconds, and what a call of a plugin takes on a machine of 2024.
BUDGET, CALL = 2.5, 6e-6
#: The edge of the picture that tells how much work a scene is, in pixels.
PROBE = 32


class MitsubaPath(Variant):
    """Mitsuba's `path` behind the face of a renderer, in one variant."""

    family = "mitsuba-path"

    def refusal(self, scene: Scene) -> str:
        """Why it has no pass for a scene."""
        return stock.refusal(scene, self.backend) or stock.too_wide(scene) or "nothing"

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Every pass; those of the primary hit alone where its rays start too far beside a small sphere."""
        if stock.refusal(scene, self.backend) or stock.too_wide(scene):
            return ()
        every = names(len(scene.lights), settings.max_reflections, margins=False)
        small = epsilons.too_small(scene, settings) is not None
        if small and (scene.lights or stock.mirrors(scene, settings)):
            return tuple(name for name in every if name in {*stock.SURFACES, "ambient"})
        return every

    def sources(self, scene: Scene, settings: Settings) -> Mapping[str, str]:
        """Images of our plugins in Mitsuba, AOVs of stock ones, differences of images."""
        derived = {"depth", "reflection", *(f"reflection.{k}" for k in range(1, settings.max_reflections + 1))}
        return {
            name: "derived" if name in derived else "stock" if name in stock.SURFACES else "plugin"
            for name in self.passes(scene, settings)
        }

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """What float32 and the epsilons allow; a difference of two images has a rounding of either."""
        found = epsilons.uncertainty(
            scene,
            settings,
            analysis,
            float32_roots=self.backend != "scalar",
            mirrors=True,
            shadows=epsilons.too_small(scene, settings) is None,
        )
        if not stock.mirrors(scene, settings):
            return found
        rounded = 2 * (settings.max_reflections + 1) * UNIT_ROUNDOFF * brightest(scene, settings)
        return dataclasses.replace(found, absolute=epsilons.with_mirrors(found, rounded))

    def rules(self, scene: Scene, settings: Settings) -> Sequence[Rule]:
        """Where its rays start and end."""
        return epsilons.rules(scene, settings, float32_roots=self.backend != "scalar")

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """In scalar mode as many as it can do in BUDGET seconds: every term of every hit is a call of Python.

        Counted, not timed, so that the same scene is always drawn at the same size.
        """
        view = scene.view
        if self.backend != "scalar" or view.columns * view.rows <= PROBE * PROBE:
            return None
        calls = _calls(scene, frozenset(passes))
        return max(PROBE * PROBE, int(BUDGET / (CALL * calls))) if calls else None

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for.

        Raises:
            ValueError: a pass that it does not have for this scene.
            RuntimeError: this variant cannot run here, or is a version of Mitsuba with other epsilons.
        """
        if unknown := [name for name in passes if name not in self.passes(scene, settings)]:
            raise ValueError(f"{self.name} has no pass '{unknown[0]}' for this scene")
        with self.ready():
            epsilons.check()
            images = _draw(scene, frozenset(passes), settings)
        return Passes({name: images[name] for name in passes}, self.versions())


def brightest(scene: Scene, settings: Settings) -> float:
    """No pixel adds up to more: the largest terms of any sphere in all lights, as often as mirrors show them."""
    term = 0.0
    for i in scene.distinct:
        sphere = scene.spheres[i]
        lights = sum(max(map(abs, source.intensity)) for source in scene.lights)
        ambient = max(map(abs, scene.ambient))
        term = max(term, sphere.ka * ambient + (sphere.kd + sphere.ks) * lights)
    return term * (settings.max_reflections + 1)


def _draw(scene: Scene, wanted: frozenset[str], settings: Settings) -> dict[str, Image]:
    """Every pass that is wanted, and what it is made of."""
    black = np.zeros((scene.view.rows, scene.view.columns, 3))
    bounces = settings.max_reflections if stock.mirrors(scene, settings) else 0
    images: dict[str, Image] = {}
    surfaces = stock.surfaces(scene, settings)
    hit = surfaces["id"] >= 0
    images |= surfaces
    for name, changes in (("diffuse", {"ks": 0.0}), ("specular", {"kd": 0.0})):
        if name in wanted:
            of = _only(scene, kr=0.0, **changes)
            images[name] = sum((_light(of, i, settings, [0])[0] for i in range(len(scene.lights))), black)
    for i in range(len(scene.lights)):
        if f"shadow.L{i}" in wanted:
            white = _only(scene, kr=0.0, ks=0.0, kd=1.0, color=(1, 1, 1))
            lights = [source.replace(intensity=(1, 1, 1)) for source in scene.lights]
            lit = _light(white.replace(lights=lights, limits=False), i, settings, [0])[0].any(axis=-1)
            images[f"shadow.L{i}"] = (hit & lit).astype(np.float64)
    # The sum over the lights with so many reflections, and the ambient term of the same hits.
    reflects = any(name == "beauty" or name.startswith("reflection") for name in wanted)
    depths = [0] if not bounces else [k for k in range(bounces + 1) if k in (0, bounces) or _asks(wanted, k)]
    if not reflects:
        depths = [0]
    lighted = dict.fromkeys(depths, black)
    ambient = dict.fromkeys(depths, black)
    if reflects or "direct" in wanted:
        of = _only(scene)
        for i in range(len(scene.lights)):
            for k, image in zip(depths, _light(of, i, settings, depths), strict=True):
                lighted[k] = lighted[k] + image
    if (reflects or "ambient" in wanted) and scene.spheres:
        described = converter.ambient_dict(_only(scene), sample=settings.sample, max_reflections=bounces)
        ambient = dict(zip(depths, _paths(described, depths), strict=True))
    images["ambient"], images["direct"] = ambient[0], lighted[0]
    total = {k: lighted[k] + ambient[k] for k in depths}
    images["beauty"] = np.where(hit[..., None], total[depths[-1]], np.array(scene.background))
    images["reflection"] = total[depths[-1]] - total[0]
    for k in range(1, settings.max_reflections + 1):
        images[f"reflection.{k}"] = total[k] - total[k - 1] if k in total and k - 1 in total else black
    return images


def _asks(wanted: frozenset[str], k: int) -> bool:
    """Whether the image with k reflections is part of a difference."""
    return f"reflection.{k}" in wanted or f"reflection.{k + 1}" in wanted


def _only(scene: Scene, **changes: Any) -> Scene:
    """The same without the background, and with other surfaces."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its reader has warned already
        return scene.replace(
            spheres=[sphere.replace(**changes) for sphere in scene.spheres], background=(0, 0, 0), limits=False
        )


def _light(scene: Scene, i: int, settings: Settings, depths: Sequence[int]) -> list[Image]:
    """The images of one light with so many reflections each."""
    black = np.zeros((scene.view.rows, scene.view.columns, 3))
    if not converter.lit(scene) or not any(scene.lights[i].intensity):
        return [black] * len(depths)
    return _paths(converter.to_dict(scene, sample=settings.sample, max_reflections=max(depths), light=i), depths)


def _paths(described: Mapping[str, Any], depths: Sequence[int]) -> list[Image]:
    """The same with so many reflections: the primary hit is depth 1, its light depth 2."""
    return stock.paths(described, [k + 2 for k in depths])


def _calls(scene: Scene, passes: frozenset[str]) -> float:
    """How often a plugin is called for a pixel, about: a ray of ours, and for each hit a light, a term and a mirror."""
    small = scene.replace(view=scene.view.replace(columns=PROBE, rows=PROBE), limits=False)
    settings = Settings()
    hits = [0] * (settings.max_reflections + 1)
    with np.errstate(all="ignore"):
        tables = reference.Tables(small, np.float64)
        rays = reference.eye_rays(tables, small.view, settings.sample, range(PROBE))
        for bounce, (_, found, _) in enumerate(reference.trace(tables, rays, settings.max_reflections)):
            hits[bounce] = int((found.sphere >= 0).sum())
    lights = len(scene.lights)
    first, every = hits[0], sum(hits)
    ray = 0 if converter.square_pixels(scene.view, settings.sample) else PROBE * PROBE
    calls = 0.0
    if passes & set(stock.SURFACES):
        calls += ray
    calls += sum(name in passes for name in ("diffuse", "specular")) * lights * (ray + 4 * first)
    calls += sum(name.startswith("shadow.") for name in passes) * (ray + 4 * first)
    deep = sum(name == "beauty" or name.startswith("reflection") for name in passes)
    if deep:
        calls += (lights + 1) * min(deep + 1, len(hits)) * (ray + 4 * every)
    else:
        calls += (("direct" in passes) * lights + ("ambient" in passes)) * (ray + 4 * first)
    return calls / PROBE**2


def renderers() -> list[MitsubaPath]:
    """The best first."""
    return [MitsubaPath("llvm"), MitsubaPath("scalar"), MitsubaPath("cuda")]
