"""Mitsuba with no plugin of ours, `mitsuba-stock`: a reference that shares no line with us but the scene's numbers.

Camera, shapes, BSDFs, light, integrators and AOVs are Mitsuba's own, put together by `converters.mitsuba` as for a file
that its own program renders. What is ours is arithmetic on the images: the falloff of the stock light is undone with
the position AOV, terms are multiplied by the intensity of the ambient light, and sums are added up.

No AOV tells what a mirror shows. Where mirrors are nothing but mirrors, a pixel's chain of them ends on the first
sphere that is none. With those spheres shining, `path` shows which that is, behind how many mirrors, and where it is
hit; so the falloff is undone there too. An image with just as much depth as a pixel has mirrors shows there no light
that came another way. Other mirrors, and the Phong term, which stock Mitsuba has not, are left out where the scene has
them. Rays that leave surfaces are Mitsuba's, with its epsilons: `epsilons.py` says what follows.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from converters.mitsuba import CODE, COUNTING
from tracer.passes import Passes, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.mitsuba import epsilons
from validation.renderers.mitsuba.precision import RANGE, UNIT_ROUNDOFF, fits_float32
from validation.renderers.mitsuba.variants import Variant

if TYPE_CHECKING:
    from tracer import Light, Scene, Sphere
    from tracer.margins import Analysis
    from validation.rules import Rule

Image = NDArray[np.float64]

#: Of the passes that do not depend on a light.
SURFACES = ("depth", "position", "normal", "id")
#: Half the field of view is off by so many u: below that the camera may look backwards. docs/tolerances.md derives it.
ANGLE = 5
#: The edge of a texture about a sphere is below this: Mitsuba inverts its matrix by the determinant, in float32.
LARGEST_CUBE = 2.0 ** (128 / 3)
#: The most mirrors in a chain: what COUNTING leaves of a color after them is still a normal number.
DEEPEST = 100


class MitsubaStock(Variant):
    """Stock Mitsuba behind the face of a renderer, in one variant."""

    family = "mitsuba-stock"

    def refusal(self, scene: Scene) -> str:
        """Why it has no pass for a scene."""
        return refusal(scene, self.backend) or too_wide(scene) or "pixels that are not square need a camera of ours"

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """What stock plugins can say of this scene exactly."""
        square = converter.square_pixels(scene.view, settings.sample)
        if refusal(scene, self.backend) or too_wide(scene) or not square:
            return ()
        spheres = [scene.spheres[i] for i in scene.distinct]
        found = {*SURFACES, "ambient"}
        if not scene.lights or epsilons.too_small(scene, settings) is None:
            found |= {"diffuse", *(f"shadow.L{i}" for i in range(len(scene.lights)))}
            if not scene.lights or not any(sphere.ks for sphere in spheres):
                found |= {"specular", "direct"}
        if not mirrors(scene, settings) or _reflects(scene, settings):
            found |= {"reflection", *(f"reflection.{k}" for k in range(1, settings.max_reflections + 1))}
            if "direct" in found:
                found.add("beauty")
        return tuple(
            name for name in names(len(scene.lights), settings.max_reflections, margins=False) if name in found
        )

    def sources(self, scene: Scene, settings: Settings) -> Mapping[str, str]:
        """Images of stock Mitsuba, or sums of them; what is 0 in a scene is not drawn."""
        drawn = {*SURFACES[1:], "ambient", "diffuse"}
        families = ("shadow.", "reflection.") if mirrors(scene, settings) else ("shadow.",)
        return {
            name: "stock" if name in drawn or name.startswith(families) else "derived"
            for name in self.passes(scene, settings)
        }

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """What float32 and the epsilons of shadow rays allow."""
        return epsilons.uncertainty(
            scene,
            settings,
            analysis,
            float32_roots=self.backend != "scalar",
            mirrors=_reflects(scene, settings),
            shadows=epsilons.too_small(scene, settings) is None,
            falloff=True,
        )

    def rules(self, scene: Scene, settings: Settings) -> Sequence[Rule]:
        """Where its rays start and end."""
        return epsilons.rules(scene, settings, float32_roots=self.backend != "scalar")

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """It is quick."""
        del scene, passes
        return None

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


def refusal(scene: Scene, backend: str) -> str | None:
    """Why Mitsuba's integrators cannot draw a scene, whatever its camera; None if they can."""
    if not fits_float32(scene):
        return f"it has numbers outside {RANGE[0]:g} to {RANGE[1]:g}, which float32 does not hold with their squares"
    if backend == "cuda" and any(len({abs(v) for v in scene.spheres[i].scaling}) > 1 for i in scene.distinct):
        return "it has ellipsoids, whose instances Mitsuba's sphere routine for GPUs misses at an angle"
    return None


def too_wide(scene: Scene) -> str | None:
    """Why Mitsuba's own camera cannot show a window, None if it can: what float32 leaves of angles near 180 degrees."""
    view = scene.view
    width = view.right - view.left
    if not converter.square_pixels(view) or view.near >= ANGLE * UNIT_ROUNDOFF * width:
        return None
    return f"its window is {width / view.near:.2g} times as wide as it is near, which is 180 degrees in float32"


def mirrors(scene: Scene, settings: Settings) -> bool:
    """Whether anything shows in a mirror."""
    return settings.max_reflections > 0 and any(scene.spheres[i].kr for i in scene.distinct)


def _reflects(scene: Scene, settings: Settings) -> bool:
    """Whether there are mirrors of which stock Mitsuba tells everything."""
    return (
        mirrors(scene, settings)
        and converter.stock_mirrors(scene)
        and settings.max_reflections <= DEEPEST
        and all(sphere.kr or 4 * abs(sphere.scaling[0]) < LARGEST_CUBE for sphere in scene.spheres)
        and epsilons.too_small(scene, settings) is None
    )


def _draw(scene: Scene, wanted: frozenset[str], settings: Settings) -> dict[str, Image]:
    """Every pass that is wanted, and what it is made of."""
    shape = (scene.view.rows, scene.view.columns)
    black = np.zeros((*shape, 3))
    images = surfaces(scene, settings)
    hit = images["id"] >= 0
    images["ambient"] = black
    if wanted & {"ambient", "beauty"}:
        images["ambient"] = albedo(with_surfaces(scene, kd=0.0), settings) * np.array(scene.ambient)
    needs_diffuse = bool(wanted & {"diffuse", "direct", "beauty"})
    images["diffuse"] = black.copy()
    for i in range(len(scene.lights)):
        if needs_diffuse or f"shadow.L{i}" in wanted:
            diffuse, images[f"shadow.L{i}"] = light(scene, i, settings, images["position"], hit, diffuse=needs_diffuse)
            images["diffuse"] += diffuse
    # Only where the scene has no such term.
    images["specular"] = black
    images["direct"] = images["diffuse"]
    reflected = dict.fromkeys(range(1, settings.max_reflections + 1), black)
    if _reflects(scene, settings) and any(name == "beauty" or name.startswith("reflection") for name in wanted):
        reflected |= reflections(scene, settings)
    images |= {f"reflection.{k}": image for k, image in reflected.items()}
    images["reflection"] = sum(reflected.values(), black)
    beauty = images["ambient"] + images["direct"] + images["reflection"]
    images["beauty"] = np.where(hit[..., None], beauty, np.array(scene.background))
    return images


def with_surfaces(scene: Scene, **changes: Any) -> Scene:
    """The same scene, with no background, neither highlights nor mirrors, and other surfaces."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its reader has warned already
        spheres = [sphere.replace(**({"ks": 0.0, "kr": 0.0} | changes)) for sphere in scene.spheres]
        return scene.replace(spheres=spheres, background=(0, 0, 0), limits=False)


def rendered(described: Mapping[str, Any]) -> dict[str, Image]:
    """The channels of an image, by name. Robust: boxes around shapes are not missed by a rounding."""
    import mitsuba as mi

    scene = mi.load_dict({**described, "embree_use_robust_intersections": True})
    mi.render(scene, seed=0)
    return channels(scene)


def channels(scene: Any) -> dict[str, Image]:
    """What was rendered last; the film knows the names."""
    bitmap = scene.sensors()[0].film().bitmap()
    return dict(
        zip([field.name for field in bitmap.struct_()], np.moveaxis(np.array(bitmap, np.float64), -1, 0), strict=True)
    )


def stacked(images: Mapping[str, Image], stem: str = "", of: str = "RGB") -> Image:
    """Some channels as the last axis."""
    return np.stack([images[f"{stem}{name}"] for name in of], axis=-1)


def albedo(scene: Scene, settings: Settings) -> Image:
    """The reflectance of what a pixel shows: Ka times the colour."""
    described = converter.to_dict(scene, sample=settings.sample, stock_only=True, aovs="albedo:albedo")
    return stacked(rendered(described), "albedo.")


def surfaces(scene: Scene, settings: Settings) -> dict[str, Image]:
    """What the AOVs say of the primary hits: id, position, depth, and the normal on the side that is seen."""
    coded = with_surfaces(scene, kd=0.0, ka=1.0)
    # The number of a shape in a group cannot be asked for, and depends on the order of loading: albedos tell.
    spheres = [sphere.replace(color=((i + 1) * CODE,) * 3) for i, sphere in enumerate(coded.spheres)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        coded = coded.replace(spheres=spheres, limits=False)
    aovs = "albedo:albedo,position:position,normal:sh_normal"
    found = rendered(converter.to_dict(coded, sample=settings.sample, aovs=aovs))
    id = np.rint(found["albedo.R"] / CODE).astype(np.int32) - 1
    hit = id >= 0
    position = np.where(hit[..., None], stacked(found, "position.", "XYZ"), 0.0)
    normal = np.where(hit[..., None], stacked(found, "normal.", "XYZ"), 0.0)
    inside = _inside(scene, settings, id, position, normal)
    # Mitsuba's depth counts from the near plane.
    depth = np.where(hit, np.linalg.norm(position, axis=-1), np.inf)
    return {
        "id": id,
        "position": position,
        "normal": np.where(inside[..., None], -normal, normal),
        "depth": depth,
    }


def _inside(scene: Scene, settings: Settings, id: Any, position: Image, normal: Image) -> NDArray[np.bool_]:
    """Whether the inside of a sphere is seen: its ray starts in it.

    Not the angle of ray and normal, which rounding turns over at an outline, but where the image plane cuts the sphere:
    there the start is on the sphere as far as float32 knows.
    """
    if not scene.spheres:
        return np.zeros(id.shape, bool)
    view, frame = scene.view, converter.window(scene.view, settings.sample)
    x = frame.left + (frame.right - frame.left) * (np.arange(view.columns) + 0.5) / view.columns
    y = frame.top - (frame.top - frame.bottom) * (np.arange(view.rows) + 0.5) / view.rows
    start = np.stack([*np.meshgrid(x, y), np.full(id.shape, -view.near)], axis=-1)
    center = np.array([s.position for s in scene.spheres])[id]
    scaling = np.array([s.scaling for s in scene.spheres])[id]
    beside = (start - center) / scaling
    depth = (beside**2).sum(axis=-1) - 1
    moves = np.abs(beside / scaling) * (np.abs(start) + np.abs(center) + np.abs(start - center))
    on = np.abs(depth) <= 2 * UNIT_ROUNDOFF * moves.sum(axis=-1)
    found: NDArray[np.bool_] = np.where(on, (normal * position).sum(axis=-1) > 0, depth < 0)
    return found


def light(
    scene: Scene, i: int, settings: Settings, position: Image, hit: NDArray[np.bool_], *, diffuse: bool
) -> tuple[Image, Image]:
    """The diffuse term of one light, and where it is visible."""
    source = scene.lights[i]
    squared, scale = _squared(source, position, hit)

    def drawn(of: Scene, intensity: Sequence[float]) -> Image:
        """Without falloff."""
        lights = [entry.replace(intensity=intensity) for entry in of.lights]
        of = of.replace(lights=lights, limits=False)
        described = converter.to_dict(of, sample=settings.sample, stock_only=True, light=i)
        return _without_falloff(stacked(rendered(described)), squared, scale)

    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain = with_surfaces(scene)
        # Mitsuba has no light below 0.
        color = np.zeros((*hit.shape, 3))
        if diffuse:
            color = drawn(plain, [abs(value) * scale for value in source.intensity]) * np.sign(source.intensity)
        if diffuse and all(_shows(plain.spheres[j], source.intensity) for j in plain.distinct):
            lit = color
        else:
            lit = drawn(with_surfaces(scene, kd=1.0, color=(1, 1, 1)), [scale] * 3)
    return color, (hit & (lit.any(axis=-1) | (squared == 0))).astype(np.float64)


def _squared(source: Light, position: Image, hit: NDArray[np.bool_]) -> tuple[Image, float]:
    """The squared distances to a light as Mitsuba has it, and what to multiply its intensity by.

    That is a power of 4, which keeps the image far from underflow.
    """
    place = np.array(source.position, np.float32).astype(np.float64)
    squared = ((position - place) ** 2).sum(axis=-1)
    return squared, 4.0 ** round(np.log2(squared[hit].max(initial=1.0) or 1.0) / 2)


def _without_falloff(image: Image, squared: Image, scale: float) -> Image:
    """The light as the specification has it. At the light itself there is none, and no number either."""
    return np.where(squared[..., None] > 0, image * (np.pi * squared[..., None] / scale), 0.0)


def reflections(scene: Scene, settings: Settings) -> dict[int, Image]:
    """What mirrors show, by the number of mirrors on the way."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain = scene.replace(background=(0, 0, 0), limits=False)
        count, position = _ends(plain, settings)
        found = {}
        numbers = [int(k) for k in np.unique(count[count > 0])]
        ambient = _shining(plain, "ambient", settings) * np.array(scene.ambient)
        for k in numbers:
            found[k] = np.where((count == k)[..., None], ambient, 0.0)
        for source in scene.lights:
            if not numbers or not any(source.intensity):
                continue
            squared, scale = _squared(source, position, count > 0)
            # Mitsuba has no light below 0.
            bright = source.replace(intensity=[abs(value) * scale for value in source.intensity])
            of = plain.replace(lights=[bright], limits=False)
            described = converter.chain_dict(of, "light", sample=settings.sample)
            with np.errstate(invalid="ignore"):
                # Mirrors and the hit, and then its light.
                for k, image in zip(numbers, paths(described, [k + 2 for k in numbers]), strict=True):
                    color = _without_falloff(image, squared, scale) * np.sign(source.intensity)
                    found[k] += np.where((count == k)[..., None], color, 0.0)
    return found


def _ends(scene: Scene, settings: Settings) -> tuple[NDArray[np.intp], Image]:
    """Behind how many mirrors each pixel's chain ends on a sphere that is none, and where; 0 if on none."""
    index = _shining(scene, "index", settings)
    ends = index[..., 0] > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        count = np.where(ends, np.log2(index[..., 1] / index[..., 0]) / np.log2(COUNTING[1]), 0)
    sphere = np.where(ends, np.rint(index[..., 0] / CODE) - 1, 0).astype(np.intp)
    centers = np.array([s.position for s in scene.spheres])
    radii = np.array([abs(s.scaling[0]) for s in scene.spheres])
    place = (_shining(scene, "place", settings) - 0.5) * 2 * radii[sphere][..., None]
    return np.rint(count).astype(np.intp), np.where(ends[..., None], centers[sphere] + place, 0.0)


def _shining(scene: Scene, show: converter.Show, settings: Settings) -> Image:
    """What `path` sees of shining ends of chains, which are seen from one side at a time."""
    black = np.zeros((scene.view.rows, scene.view.columns, 3))
    sides = [converter.chain_dict(scene, show, sample=settings.sample, inside=inside) for inside in (False, True)]
    return sum((paths(side, [settings.max_reflections + 1])[0] for side in sides), black)


def paths(described: Mapping[str, Any], depths: Sequence[int]) -> list[Image]:
    """What `path` makes of a scene with so much depth each: 1 is the primary hit."""
    import mitsuba as mi

    scene = mi.load_dict({**described, "embree_use_robust_intersections": True})
    found = []
    for depth in depths:
        integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": depth + 1})
        mi.render(scene, integrator=integrator, seed=0)
        found.append(stacked(channels(scene)))
    return found


def _shows(sphere: Sphere, intensity: Sequence[float]) -> bool:
    """Whether a light's diffuse term is not 0 where the light is visible."""
    return sphere.kd > 0 and any(a * b for a, b in zip(sphere.color, intensity, strict=True))


def renderers() -> list[MitsubaStock]:
    """The best first: the scalar variant intersects spheres in float64."""
    return [MitsubaStock("scalar"), MitsubaStock("llvm"), MitsubaStock("cuda")]
