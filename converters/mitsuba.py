"""Scene -> Mitsuba 3: a dictionary for `mitsuba.load_dict`, or an XML file.

What becomes of a scene:

- A sphere with three equal scalings is a stock `sphere`; an ellipsoid is an `instance` of a `shapegroup` whose sphere
  has the smallest scaling as radius. Both are named `sphere_<index in the file>`. Duplicates are left out.
- Surfaces are lit on both sides. Where no sphere has a specular term and none mirrors, the BSDF is stock: `twosided`
  around `diffuse`. Else it is our `whitted_phong`, with those lobes alone that the sphere has.
- A light is our `whitted_point`, in Mitsuba's unit pi times its intensity. With `stock_only` it is the stock `point`,
  whose light falls off: multiply the image by pi d^2, d the distance from the light, to get the specification's.
- Square pixels: stock `perspective`; others: our `whitted_frustum`. The sample position is part of the frustum, as the
  `stratified` sampler without jitter takes exactly the pixel centre.
- The integrator is stock: `direct` without BSDF samples, or `path` where something mirrors and `max_reflections` is not
  0. Both pick one light at random for a sample: with one light the image has no noise.
- Stock plugins alone say what mirrors show where a sphere either mirrors or reflects light, and nothing shines:
  `chain_dict`. Mirrors are `conductor`s then.
- The background is a stock `constant` that lights nothing. It is left out where something mirrors: there reflected rays
  would see it too.
- The ambient term lights nothing and is hidden by nothing: Mitsuba has no such light. Every sphere that has it carries
  Ka times its colour as the shape attribute `ambient`; multiplied by the scene's ambient intensity it is the term.
  Where nothing reflects light at all, the reflectance of the `diffuse` says it too, and so does the AOV `albedo`.
  `ambient_dict` is the scene with this term alone, by plugins of ours, in mirrors, too.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

from converters.mitsuba_plugins import AMBIENT, EVERYWHERE, FRUSTUM, LIGHT_SCALE, PHONG, POINT, variant
from tracer.passes import OFFSETS

if TYPE_CHECKING:
    from tracer import Scene, Sphere, View
    from tracer.passes import Sample

#: AOV names are short and stable, for scripts that read the image file.
STOCK_AOVS = "albedo:albedo,position:position,normal:sh_normal,shape:shape_index"


#: What the surfaces are that a chain of mirrors ends on: lit by one light, as they are; or shining, with the ambient
#: term for an ambient light of 1, with their index, or with the place of each point.
Show = Literal["light", "ambient", "index", "place"]
#: A sphere's index as a color, which holds it exactly; and what a mirror leaves of its channels, exact as well.
CODE = 2.0**-20
COUNTING = (1.0, 0.5, 1.0)

#: How a file with our plugins becomes an image, as typed into Python.
RECIPE = (
    "import mitsuba; from converters import mitsuba_plugins; mitsuba.set_variant('scalar_rgb'); "
    "mitsuba_plugins.register(); image = mitsuba.render(mitsuba.load_file('FILE'))"
)


class StockError(ValueError):
    """A scene needs what stock Mitsuba cannot say; `reasons` has one sentence each."""

    def __init__(self, reasons: Sequence[str]) -> None:
        """Join the reasons into one message."""
        super().__init__("stock Mitsuba cannot say this scene: " + "; ".join(reasons))
        self.reasons = tuple(reasons)


@dataclasses.dataclass(frozen=True)
class Window:
    """The part of the image plane whose pixel centres are the sample points."""

    left: float
    right: float
    bottom: float
    top: float


def window(view: View, sample: Sample = "corner") -> Window:
    """The frustum that has the sample points of `view` at its pixel centres.

    Every sample position is a shift of the pixel centre; `inclusive` also stretches the pixels.
    """
    width, height = view.right - view.left, view.top - view.bottom
    ox, oy = OFFSETS[sample]
    if sample == "inclusive":
        dx, dy = width / max(view.columns - 1, 1), height / max(view.rows - 1, 1)
    else:
        dx, dy = width / view.columns, height / view.rows
    left, top = view.left + (ox - 0.5) * dx, view.top - (oy - 0.5) * dy
    return Window(left, left + view.columns * dx, top - view.rows * dy, top)


def _rgb(values: Sequence[float], scale: float = 1.0) -> dict[str, Any]:
    return {"type": "rgb", "value": [scale * value for value in values]}


def _black(values: Sequence[float]) -> bool:
    return not any(values)


def lit(scene: Scene) -> bool:
    """Whether any sphere reflects light: else no light is needed."""
    return any(_diffuse(scene.spheres[i]) or scene.spheres[i].ks for i in scene.distinct)


def _diffuse(sphere: Sphere) -> bool:
    return sphere.kd != 0 and not _black(sphere.color)


def _mirrors(scene: Scene, max_reflections: int) -> bool:
    return max_reflections > 0 and any(scene.spheres[i].kr for i in scene.distinct)


def _stock_bsdfs(scene: Scene, max_reflections: int) -> bool:
    """Whether `diffuse` will do: a `path` integrator would also carry light from one `diffuse` to the next."""
    return not _mirrors(scene, max_reflections) and not any(scene.spheres[i].ks for i in scene.distinct)


def stock_mirrors(scene: Scene) -> bool:
    """Whether stock plugins can say what the mirrors show, with `chain_dict`.

    Nothing that reflects light mirrors, so a chain of mirrors ends on the first sphere that does: there is no other way
    for light than the chain, and one light at its end. What ends chains has to shine, which no instance can.
    """
    for index in scene.distinct:
        sphere = scene.spheres[index]
        plain = sphere.ka == sphere.kd == 0 or _black(sphere.color)
        uniform = len({abs(value) for value in sphere.scaling}) == 1
        if (sphere.ks and scene.lights) or not (plain if sphere.kr else uniform):
            return False
    return True


def _bsdf(sphere: Sphere, stock: bool, needs_light: bool, max_reflections: int) -> dict[str, Any]:
    if stock:
        # Nothing reflects light: the reflectance is free to say the ambient term, as the AOV `albedo`.
        k = sphere.kd if needs_light else sphere.ka
        return {
            "type": "twosided",
            "surface": {"type": "diffuse", "reflectance": _rgb(sphere.color, k)},
        }
    bsdf: dict[str, Any] = {"type": PHONG}
    if _diffuse(sphere):
        bsdf["diffuse"] = _rgb(sphere.color, sphere.kd)
    if sphere.ks:
        bsdf["specular"] = sphere.ks
        bsdf["exponent"] = sphere.exponent
    if sphere.kr and max_reflections > 0:
        bsdf["mirror"] = sphere.kr
    return bsdf


def geometry(scene: Scene, *, max_reflections: int = 3) -> dict[str, Any]:
    """The shapes of the scene with their BSDFs, by name: `sphere_<index>`, and `group_<index>` for ellipsoids."""
    stock, needs_light = _stock_bsdfs(scene, max_reflections), lit(scene)
    shapes: dict[str, Any] = {}
    for index in scene.distinct:
        sphere = scene.spheres[index]
        surface: dict[str, Any] = {"type": "sphere", "bsdf": _bsdf(sphere, stock, needs_light, max_reflections)}
        if sphere.ka and not _black(sphere.color) and not _black(scene.ambient):
            # A nested texture becomes an attribute of the shape.
            surface["ambient"] = {"type": "srgb", "color": _rgb(sphere.color, sphere.ka)}
        scaling = [abs(value) for value in sphere.scaling]
        radius = min(scaling)
        if radius == max(scaling):
            shapes[f"sphere_{index}"] = surface | {"center": list(sphere.position), "radius": radius}
            continue
        # Of all radii that of the smallest scaling is intersected most precisely: see docs/tolerances.md.
        shapes[f"group_{index}"] = {"type": "shapegroup", "surface": surface | {"radius": radius}}
        shapes[f"sphere_{index}"] = {
            "type": "instance",
            "group": {"type": "ref", "id": f"group_{index}"},
            "to_world": placed(sphere.position, [value / radius for value in scaling]),
        }
    return shapes


def placed(position: Sequence[float], scaling: Sequence[float]) -> Any:
    """Scaled along the axes, then moved."""
    import mitsuba as mi
    import numpy as np

    matrix = np.diag([*scaling, 1.0])
    matrix[:3, 3] = position
    return mi.ScalarTransform4f(matrix)


def _extent(scene: Scene) -> float:
    """A distance from the eye that nothing of the scene reaches."""
    reach = [math.dist(s.position, (0, 0, 0)) + max(map(abs, s.scaling)) for s in scene.spheres]
    view = scene.view
    corner = math.dist((max(-view.left, view.right), max(-view.bottom, view.top), view.near), (0, 0, 0))
    return 4 * max([*reach, corner])


def square_pixels(view: View, sample: Sample = "corner") -> bool:
    """Whether the pixels are squares as far as float32, Mitsuba's precision, can tell."""
    frame = window(view, sample)
    dx, dy = (frame.right - frame.left) / view.columns, (frame.top - frame.bottom) / view.rows
    return abs(dx - dy) <= 2.0**-24 * dx


def _sensor(scene: Scene, sample: Sample) -> dict[str, Any]:
    view, frame = scene.view, window(scene.view, sample)
    width, height = frame.right - frame.left, frame.top - frame.bottom
    shared = {
        "film": {
            "type": "hdrfilm",
            "width": view.columns,
            "height": view.rows,
            "component_format": "float32",
            "filter": {"type": "box"},
        },
        "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
    }
    if not square_pixels(view, sample):
        return {"type": FRUSTUM, "near": view.near, **dataclasses.asdict(frame), **shared}
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": math.degrees(2 * math.atan2(width / 2, view.near)),
        "fov_axis": "x",
        "principal_point_offset_x": (frame.left + frame.right) / 2 / width,
        "principal_point_offset_y": -(frame.bottom + frame.top) / 2 / height,
        "near_clip": view.near,
        "far_clip": max(_extent(scene), 4 * view.near),
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, -1], up=[0, 1, 0]),
        **shared,
    }


def _stock_problems(scene: Scene, sample: Sample, max_reflections: int, light: int | None) -> list[str]:
    """What keeps stock Mitsuba from saying the scene, one sentence each."""
    spheres = [scene.spheres[i] for i in scene.distinct]
    problems = [f"the specular term of sphere '{s.name}'" for s in spheres if s.ks]
    if max_reflections > 0:
        problems += [f"the mirror term of sphere '{s.name}'" for s in spheres if s.kr]
    if not square_pixels(scene.view, sample):
        problems.append("pixels that are not square")
    if lit(scene) and scene.lights and light is None:
        problems.append("lights that do not fall off (light=INDEX leaves one in, to be multiplied by pi d^2)")
    return problems


def to_dict(
    scene: Scene,
    *,
    sample: Sample = "corner",
    max_reflections: int = 3,
    light: int | None = None,
    stock_only: bool = False,
    aovs: str = "",
) -> dict[str, Any]:
    """The scene for `mitsuba.load_dict`; the module's docstring says what becomes of what.

    A variant of Mitsuba must be set, and the plugins registered (`mitsuba_plugins.register`) if the scene needs them.

    Args:
        sample: where in a pixel its ray goes.
        max_reflections: reflected rays in a chain; 0 leaves the mirrors out.
        light: the index of the only light to put in; None for all.
        stock_only: use no plugin of ours. A light is then the stock one, which falls off.
        aovs: Mitsuba's description of AOVs, for example "p:position"; they come after the image's own channels.

    Raises:
        StockError: `stock_only`, and stock plugins cannot say the scene.
        IndexError: there is no such light.
    """
    if light is not None and not 0 <= light < len(scene.lights):
        raise IndexError(f"no light {light}: the scene has {len(scene.lights)}, counted from 0")
    if stock_only and (problems := _stock_problems(scene, sample, max_reflections, light)):
        raise StockError(problems)
    mirrors = _mirrors(scene, max_reflections)
    emitters: dict[str, Any] = {}
    if lit(scene):
        for index, source in enumerate(scene.lights):
            if light in (None, index) and not _black(source.intensity):
                emitters[f"light_{index}"] = {
                    "type": "point" if stock_only else POINT,
                    "position": list(source.position),
                    # The stock light's intensity has no factor: the image times pi d^2 is the specification's.
                    "intensity": _rgb(source.intensity, 1.0 if stock_only else LIGHT_SCALE),
                }
    if mirrors and emitters:
        integrator = {"type": "path", "max_depth": max_reflections + 2, "rr_depth": max_reflections + 3}
    elif emitters:
        integrator = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    else:
        # Nothing but what a camera ray sees.
        integrator = {"type": "path", "max_depth": 1}
    if aovs:
        integrator = {"type": "aov", "aovs": aovs, "image": integrator}
    if not _black(scene.background) and not mirrors:
        emitters["background"] = {"type": "constant", "radiance": _rgb(scene.background)}
        if len(emitters) > 1:
            # Never chosen as a light. Alone it must not have this weight, and need not: nothing asks for lights then.
            emitters["background"]["sampling_weight"] = 0.0
    return {
        "type": "scene",
        "integrator": integrator,
        "sensor": _sensor(scene, sample),
        **geometry(scene, max_reflections=max_reflections),
        **emitters,
    }


def ambient_dict(scene: Scene, *, sample: Sample = "corner", max_reflections: int = 3) -> dict[str, Any]:
    """The scene with its ambient term alone, at every hit of a chain of mirrors, for `path`.

    For `mitsuba.load_dict`, with a variant set and the plugins registered.
    """
    described = to_dict(scene, sample=sample, max_reflections=max_reflections, light=None)
    shapes: dict[str, Any] = {}
    for name, shape in geometry(scene, max_reflections=max_reflections).items():
        sphere = scene.spheres[int(name.partition("_")[2])]
        bsdf: dict[str, Any] = {"type": AMBIENT, "diffuse": _rgb(sphere.color, sphere.ka)}
        if sphere.kr and max_reflections > 0:
            bsdf["mirror"] = sphere.kr
        if "surface" in shape:
            shapes[name] = shape | {"surface": shape["surface"] | {"bsdf": bsdf}}
        else:
            shapes[name] = shape | ({} if shape["type"] == "instance" else {"bsdf": bsdf})
    light = {"type": EVERYWHERE, "intensity": _rgb(scene.ambient, LIGHT_SCALE)}
    integrator = {"type": "path", "max_depth": max_reflections + 2, "rr_depth": max_reflections + 3}
    return {"type": "scene", "integrator": integrator, "sensor": described["sensor"], **shapes, "light": light}


def chain_dict(scene: Scene, show: Show, *, sample: Sample = "corner", inside: bool = False) -> dict[str, Any]:
    """The scene by stock plugins, mirrors included, if `stock_mirrors`; for `path`, with a variant set.

    The light of "light" is the scene's first; it falls off. `inside`: what shines does so to its inside. With "index"
    mirrors reflect COUNTING, with "place" all, else Kr. A place is a point from the centre over twice the radius, +1/2.
    The largest depth is up to the caller: with k + 2 for "light" a pixel is right whose chain has k mirrors.
    """
    shapes: dict[str, Any] = {}
    for name, shape in geometry(scene).items():
        index = int(name.partition("_")[2])
        sphere, bsdf = scene.spheres[index], _conductor((0, 0, 0))
        emitter: dict[str, Any] = {}
        if sphere.kr:
            bsdf = _conductor({"index": COUNTING, "place": (1, 1, 1)}.get(show, (sphere.kr,) * 3))
        elif show == "light":
            bsdf = _bsdf(sphere, stock=True, needs_light=True, max_reflections=0)
        else:
            if show == "place":
                radiance = _place(sphere)
            elif show == "ambient":
                radiance = _rgb(sphere.color, sphere.ka)
            else:
                radiance = _rgb((1, 1, 1), (index + 1) * CODE)
            emitter = {"flip_normals": inside, "emitter": {"type": "area", "radiance": radiance}}
        if "surface" in shape:
            shapes[name] = shape | {"surface": shape["surface"] | {"bsdf": bsdf}}
        else:
            shapes[name] = shape | ({} if shape["type"] == "instance" else {"bsdf": bsdf} | emitter)
    if show == "light":
        source = scene.lights[0]
        shapes["light"] = {"type": "point", "position": list(source.position), "intensity": _rgb(source.intensity)}
    return {"type": "scene", "integrator": {"type": "path"}, "sensor": _sensor(scene, sample), **shapes}


def _conductor(reflectance: Sequence[float]) -> dict[str, Any]:
    """A mirror on both sides. Where it reflects nothing, it ends a chain, and asks for no light."""
    mirror = {"type": "conductor", "material": "none", "specular_reflectance": _rgb(reflectance)}
    return {"type": "twosided", "surface": mirror}


def _place(sphere: Sphere) -> dict[str, Any]:
    """A texture that is linear in the place: 0 to 1 across the sphere, between the centres of 2 x 2 x 2 cells."""
    import mitsuba as mi
    import numpy as np

    ends = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3, indexing="ij")[::-1], axis=-1).astype(np.float32)
    radius = abs(sphere.scaling[0])
    corner = [value - 2 * radius for value in sphere.position]
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(ends), "raw": True, "accel": False, "wrap_mode": "clamp"}
    return {"type": "volume", "volume": grid | {"to_world": placed(corner, [4 * radius] * 3)}}


def write_xml(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    sample: Sample = "corner",
    max_reflections: int = 3,
    light: int | None = None,
    stock_only: bool = False,
    aovs: str = STOCK_AOVS,
) -> None:
    """Write the scene of `to_dict` as an XML file that needs no other file.

    A file without plugins of ours renders with Mitsuba's own program: `mitsuba -m scalar_rgb FILE`. Any other needs
    Python: `mitsuba.set_variant(...)`, `mitsuba_plugins.register()`, then `mitsuba.load_file(FILE)`. A comment at its
    top says which it is.

    Raises:
        StockError: `stock_only`, and stock plugins cannot say the scene.
        IndexError: there is no such light.
        OSError: the file cannot be written.
    """
    import mitsuba as mi

    from tracer.passes import write_beside

    with variant("scalar_rgb"):
        described = to_dict(
            scene, sample=sample, max_reflections=max_reflections, light=light, stock_only=stock_only, aovs=aovs
        )
        text: str = mi.parser.write_string(mi.parser.parse_dict(mi.parser.ParserConfig("scalar_rgb"), described))
    ours = [name for name in (PHONG, POINT, FRUSTUM) if f'type="{name}"' in text]
    comments = ["Colours are linear. The ambient term is the attribute `ambient` of the shapes times the intensity"]
    comments[0] += f" {' '.join(map(repr, scene.ambient))}."
    if light is not None:
        comments.append(f"Light {light} alone.")
    if 'type="point"' in text:
        comments.append("The light falls off: multiply the image by pi d^2, d the distance from the light.")
    if ours:
        comments.append(f"Not for Mitsuba's own program: {', '.join(ours)} are plugins of the package `converters`.")
        comments.append(f"In Python: {RECIPE}")
    else:
        comments.append("Renders with Mitsuba's own program: mitsuba -m scalar_rgb FILE")
    head = "".join(f"<!-- {comment} -->\n" for comment in comments)
    with write_beside(path) as temporary:
        temporary.write_text(head + text, encoding="utf-8")
