"""Real renderers with one wrong decision planted, and the functions of the reference that plant it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from doubles import reference as drawn_by_reference
from doubles import with_patch

import tracer
from tracer import reference
from tracer.margins import Analysis
from tracer.passes import Passes
from validation.renderers import Renderer, Settings, Uncertainty

Draw = Callable[[tracer.Scene, Sequence[str], Settings], Passes]

# Mistakes all over the image. `original` is the function of the reference that each replaces.


def unchanged(original: Any, *arguments: Any, **options: Any) -> Any:
    """No defect: what holds a patch together does no harm of its own."""
    return original(*arguments, **options)


def wrong_normals(original: Any, tables: Any, rays: Any, hits: Any) -> Any:
    """The outward gradient is divided by s once, not twice: right for spheres, wrong for ellipsoids."""
    at = original(tables, rays, hits)
    outward, _ = reference.unit(hits.point)
    return turned(at, rays, np.where(hits.inside, -outward, outward))


def never_flipped(original: Any, tables: Any, rays: Any, hits: Any) -> Any:
    """The inside of a sphere keeps the outward normal."""
    at = original(tables, rays, hits)
    return turned(at, rays, np.where(hits.inside, -at.normal, at.normal))


def turned(at: Any, rays: Any, normal: Any) -> Any:
    """A surface with another normal, and the reflected rays that follow from it."""
    reflected = rays.direction - 2 * reference.dot(rays.direction, normal) * normal
    return dataclasses.replace(at, normal=normal, x=dataclasses.replace(at.x, direction=reflected))


def blinn(original: Any, tables: Any, at: Any, light: int) -> Any:
    """N.H in the place of R.V."""
    seen = original(tables, at, light)
    H, _ = reference.unit(seen.L + at.viewer)
    return dataclasses.replace(seen, RV=reference.dot(at.normal, H))


def clamped(original: Any, tables: Any, at: Any, epsilon: float, *, every_shadow: bool) -> Any:
    """What a mirror shows is clamped to 1 before Kr."""
    ambient, diffuse, specular, shadows = original(tables, at, epsilon, every_shadow=every_shadow)
    if not every_shadow:
        excess = np.maximum(ambient + diffuse + specular - 1, 0)
        ambient = ambient - excess
    return ambient, diffuse, specular, shadows


def squared(original: Any, tables: Any, at: Any, epsilon: float, *, every_shadow: bool) -> Any:
    """Light falls off with the square of the distance, in a scene with one light."""
    ambient, diffuse, specular, shadows = original(tables, at, epsilon, every_shadow=every_shadow)
    to_light = reference.incidence(tables, at, 0).to_light
    fall = reference.dot(to_light, to_light)
    return ambient, diffuse / fall, specular / fall, shadows


def colored_highlight(original: Any, tables: Any, at: Any, epsilon: float, *, every_shadow: bool) -> Any:
    """The highlight takes the surface's colour."""
    ambient, diffuse, specular, shadows = original(tables, at, epsilon, every_shadow=every_shadow)
    return ambient, diffuse, specular * reference.pick(tables.color, at.x.start), shadows


def fading_highlight(original: Any, tables: Any, at: Any, epsilon: float, *, every_shadow: bool) -> Any:
    """The highlight is multiplied by N.L, in a scene with one light."""
    ambient, diffuse, specular, shadows = original(tables, at, epsilon, every_shadow=every_shadow)
    NL = reference.incidence(tables, at, 0).NL
    return ambient, diffuse, specular * np.maximum(NL, 0), shadows


def sphere_normals(original: Any, tables: Any, rays: Any, hits: Any) -> Any:
    """The normal of every ellipsoid is x - p."""
    at = original(tables, rays, hits)
    outward, _ = reference.unit(at.x.offset)
    return turned(at, rays, np.where(hits.inside, -outward, outward))


def no_near_plane(original: Any, tables: Any, rays: Any, after: float) -> Any:
    """Primary hits from t > 0 on."""
    del after
    return original(tables, rays, 0)


def near_plane_everywhere(original: Any, tables: Any, rays: Any, after: float) -> Any:
    """The near plane, t > 1, limits reflected rays too."""
    del after
    return original(tables, rays, 1)


def no_shadows(original: Any, tables: Any, x: Any, *_: Any) -> Any:
    """Every light reaches every point."""
    del original, tables
    return np.zeros(x.start.size, bool)


def no_own_shadow(original: Any, tables: Any, x: Any, to_light: Any, light: int, epsilon: float) -> Any:
    """A sphere casts no shadow on itself: the inside of a closed one is lit from outside."""
    found = np.zeros(x.start.size, bool)
    every = tables.distinct
    try:
        for j in every:
            tables.distinct = (j,)
            found |= (x.start != j) & original(tables, x, to_light, light, epsilon)
    finally:
        tables.distinct = every
    return found


def shadow_acne(original: Any, tables: Any, x: Any, to_light: Any, light: int, epsilon: float) -> Any:
    """Every t between 0 and 1 hides a light, in single precision: often that where the shadow ray starts."""
    found = original(tables, x, to_light, light, epsilon)
    for j in tables.distinct:
        o, d = (v.astype(np.float32) for v in reference.to_unit_space(tables, x, to_light, j))
        a, b, c = reference.dot(d, d), reference.dot(o, d), reference.dot(o, o) - np.float32(1)
        root = np.sqrt(np.maximum(b * b - a * c, 0))
        for t in ((-b - root) / a, (-b + root) / a):
            found |= (x.start == j) & (t > 0) & (t < 1)
    return found


def beyond_the_light(original: Any, tables: Any, x: Any, to_light: Any, light: int, epsilon: float) -> Any:
    """What stands behind a light hides it as well: t runs on."""
    del original, light
    found = np.zeros(x.start.size, bool)
    for j in tables.distinct:
        o, d = reference.to_unit_space(tables, x, to_light, j)
        line = reference.chord(o, d)
        found |= np.where(x.start == j, reference.other_root(x.point, d) > epsilon, line.meets & (line.far > epsilon))
    return found


def mirrored_background(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """Reflected rays that hit nothing see BACK."""
    every = tracer.passes.names(len(scene.lights), settings.max_reflections, margins=False)
    arrays = {name: array.copy() for name, array in drawn_by_reference(scene, every, settings).items()}
    tables = reference.Tables(scene, np.float64)
    rays = reference.eye_rays(tables, scene.view, settings.sample, range(scene.view.rows))
    with np.errstate(all="ignore"):
        for bounce, (rays_, hits, _) in enumerate(reference.trace(tables, rays, settings.max_reflections)):
            lost = hits.sphere < 0
            if bounce:
                seen = (rays_.weight[lost] * tables.background).T
                for name in (f"reflection.{bounce}", "reflection", "beauty"):
                    arrays[name].reshape(-1, 3)[rays_.pixel[lost]] += seen
    return Passes({name: arrays[name] for name in passes})


# One decision of some pixels.


def otherwise(
    places: Sequence[tuple[int, int]],
    *,
    bounce: int = 0,
    misses: int | None = None,
    near_plane: bool = True,
    light: int | None = None,
    hidden: bool | None = None,
    faces: bool = True,
) -> Draw:
    """Draw with one decision of pixels (column, row) taken otherwise at that bounce.

    The ray misses a sphere, or ignores the near plane; a light is hidden, or not, or no longer faces the surface.
    """

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        pixels = [y * scene.view.columns + x for x, y in places]
        now = [0]

        def nearest(original: Any, tables: Any, rays: Any, after: float) -> Any:
            now[0] = 0 if after else now[0] + 1
            hits = original(tables, rays, after)
            if now[0] != bounce or (misses is None and near_plane):
                return hits
            every = tables.distinct
            try:
                tables.distinct = tuple(j for j in every if j != misses)
                other = original(tables, rays, after if near_plane else 0)
            finally:
                tables.distinct = every
            chosen = np.isin(rays.pixel, pixels)
            changed = {
                field.name: np.where(chosen, getattr(other, field.name), getattr(hits, field.name))
                for field in dataclasses.fields(hits)
            }
            return dataclasses.replace(hits, **changed)

        def shadow(original: Any, tables: Any, x: Any, to_light: Any, i: int, epsilon: float) -> Any:
            found = original(tables, x, to_light, i, epsilon)
            if now[0] != bounce or i != light or hidden is None:
                return found
            return np.where(np.isin(x.pixel, pixels), hidden, found)

        def incidence(original: Any, tables: Any, at: Any, i: int) -> Any:
            seen = original(tables, at, i)
            if now[0] != bounce or i != light or faces:
                return seen
            turned_away = np.isin(at.x.pixel, pixels)
            return dataclasses.replace(seen, NL=np.where(turned_away, -np.abs(seen.NL), seen.NL))

        return with_patch(nearest=nearest, hidden=shadow, incidence=incidence)(scene, passes, settings)

    return draw


# Into a real renderer.


@functools.lru_cache(maxsize=64)
def drawn(renderer: Renderer, scene: tracer.Scene, settings: Settings) -> Passes:
    """All that a real renderer draws; once."""
    every = [name for name in renderer.passes(scene, settings) if not name.startswith("margin.")]
    return renderer.render(scene, every, settings)


@dataclasses.dataclass(eq=False)
class Planted:
    """A real renderer, with its name, its claims and its rules, that draws something else.

    `wrong`: its pictures are those of a reference with a mistake, wherever that draws something else than the reference
    without it, in the format of the renderer. `scene`, `settings`: it draws another scene, or with other settings.
    """

    real: Renderer
    wrong: Draw | None = None
    scene: Callable[[tracer.Scene], tracer.Scene] = lambda scene: scene
    settings: Callable[[Settings], Settings] = lambda settings: settings
    claim: Uncertainty | None = None

    @property
    def name(self) -> str:
        """Its own."""
        return self.real.name

    def version(self) -> str:
        """Its own."""
        return self.real.version()

    def versions(self) -> Mapping[str, str]:
        """Its own."""
        return self.real.versions()

    def passes(self, scene: tracer.Scene, settings: Settings) -> tuple[str, ...]:
        """Its own."""
        return self.real.passes(scene, settings)

    def unavailable(self) -> str | None:
        """Its own."""
        return self.real.unavailable()

    def uncertainty(self, scene: tracer.Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """Its own, or as told."""
        return self.claim or self.real.uncertainty(scene, settings, analysis)

    def rules(self, scene: tracer.Scene, settings: Settings) -> Sequence[Any]:
        """Its own."""
        rules = getattr(self.real, "rules", None)
        return rules(scene, settings) if rules else ()

    def max_pixels(self, scene: tracer.Scene, passes: Sequence[str]) -> int | None:
        """Its own."""
        return self.real.max_pixels(scene, passes)

    def render(self, scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """With the defect."""
        arrays = dict(drawn(self.real, self.scene(scene), self.settings(settings)))
        if self.wrong is not None:
            right, wrong = drawn_by_reference(scene, passes, settings), self.wrong(scene, passes, settings)
            kind = arrays["depth"].dtype if "depth" in arrays else np.float64
            for name in passes:
                off = right[name] != wrong[name]
                off = off.any(axis=-1, keepdims=True) if off.ndim == 3 else off
                value = wrong[name].astype(arrays[name].dtype)
                if "f32" in self.name or "mitsuba" in self.name:
                    value = value.astype(np.float32).astype(kind) if name != "id" else value
                arrays[name] = np.where(off, value, arrays[name])
        # Passes that were not asked for with other settings, such as those of further bounces, are not there.
        blank = {name: np.zeros_like(arrays["beauty"]) for name in passes if name not in arrays}
        return Passes({name: (arrays | blank)[name] for name in passes})
