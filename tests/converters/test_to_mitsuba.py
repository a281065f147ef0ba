"""What becomes of each clause of a scene in Mitsuba, no more than it needs, and that Mitsuba draws it right."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from converters import mitsuba as converter
from converters import mitsuba_plugins
from tracer import Light, Scene, Sphere, View, margins, reference
from tracer.passes import SAMPLES, Passes, Sample

pytestmark = pytest.mark.mitsuba

#: Mitsuba's own integrators move the origins of rays by this times 1 + the largest coordinate, and end shadow rays by
#: ten times this too early (its documented RayEpsilon and ShadowEpsilon for float32).
RAY_EPSILON = 1500 * 2.0**-24
#: Roundings of float32 that a primary hit and its shading go through; docs/tolerances.md lists them for Mitsuba.
ROUNDINGS = 29 * 2.0**-24


def sphere(**changes: Any) -> Sphere:
    plain: dict[str, Any] = {"name": "s", "position": (0, 0, -6), "scaling": (1, 1, 1), "color": (0.8, 0.5, 0.25)}
    return Sphere(**{**plain, "ka": 0.5, "kd": 0.5, "ks": 0, "kr": 0, "exponent": 10, **changes})


def scene(*spheres: Sphere, lights: tuple[Light, ...] = (), **changes: Any) -> Scene:
    view = View(near=2, left=-1, right=1, bottom=-1, top=1, columns=40, rows=40)
    return Scene(**{"view": view, "spheres": spheres, "lights": lights, "background": (0.1, 0.2, 0.3), **changes})


LAMP = Light(name="lamp", position=(3, 4, -1), intensity=(0.9, 0.6, 0.3))


@pytest.fixture(autouse=True)
def _scalar() -> Iterator[None]:
    with mitsuba_plugins.variant("scalar_rgb"):
        yield


def test_import_is_quick() -> None:
    code = "import sys, converters, converters.mitsuba, converters.mitsuba_plugins; print('mitsuba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_uniform_scaling_is_a_plain_sphere() -> None:
    shapes = converter.geometry(scene(sphere(scaling=(2, -2, 2))))
    assert list(shapes) == ["sphere_0"]
    assert shapes["sphere_0"]["type"] == "sphere"
    assert shapes["sphere_0"]["radius"] == 2
    assert shapes["sphere_0"]["center"] == [0, 0, -6]


def test_ellipsoid_is_an_instance_with_the_smallest_radius() -> None:
    shapes = converter.geometry(scene(sphere(scaling=(2, -4, 0.5), position=(1, 2, -6))))
    assert list(shapes) == ["group_0", "sphere_0"]
    assert shapes["group_0"]["surface"]["radius"] == 0.5
    matrix = np.array(shapes["sphere_0"]["to_world"].matrix)
    assert matrix.tolist() == [[4, 0, 0, 1], [0, 8, 0, 2], [0, 0, 1, -6], [0, 0, 0, 1]]


@pytest.mark.filterwarnings("ignore::tracer.SceneWarning")
def test_duplicates_are_left_out() -> None:
    shapes = converter.geometry(scene(sphere(), sphere(color=(1, 0, 0)), sphere(position=(1, 0, -6))))
    assert list(shapes) == ["sphere_0", "sphere_2"]


def test_stock_bsdf_where_nothing_shines_or_mirrors() -> None:
    described = converter.geometry(scene(sphere(), lights=(LAMP,)))["sphere_0"]["bsdf"]
    assert described["type"] == "twosided"
    assert described["surface"]["type"] == "diffuse"
    assert described["surface"]["reflectance"]["value"] == [0.4, 0.25, 0.125]


@pytest.mark.parametrize(
    ("changes", "parameters"),
    [
        ({"ks": 0.5}, {"diffuse", "specular", "exponent"}),
        ({"kr": 0.5}, {"diffuse", "mirror"}),
        ({"kr": 0.5, "kd": 0}, {"mirror"}),
        ({"ks": 0.5, "kd": 0}, {"specular", "exponent"}),
        ({"ks": 0.5, "color": (0, 0, 0)}, {"specular", "exponent"}),
    ],
)
def test_phong_has_only_the_lobes_it_needs(changes: dict[str, Any], parameters: set[str]) -> None:
    described = converter.geometry(scene(sphere(**changes)))["sphere_0"]["bsdf"]
    assert described["type"] == mitsuba_plugins.PHONG
    assert described.keys() - {"type"} == parameters


def test_no_mirror_without_bounces() -> None:
    described = converter.to_dict(scene(sphere(kr=0.5), lights=(LAMP,)), max_reflections=0)
    assert described["sphere_0"]["bsdf"]["type"] == "twosided"
    assert described["integrator"]["type"] == "direct"


def test_ambient_is_an_attribute_where_there_is_any() -> None:
    lit = converter.geometry(scene(sphere(), sphere(ka=0, position=(3, 0, -6)), ambient=(0.5, 0.5, 0.5)))
    assert lit["sphere_0"]["ambient"]["color"]["value"] == [0.4, 0.25, 0.125]
    assert "ambient" not in lit["sphere_1"]
    assert "ambient" not in converter.geometry(scene(sphere()))["sphere_0"]


def test_no_light_where_nothing_reflects_it() -> None:
    assert "light_0" in converter.to_dict(scene(sphere(), lights=(LAMP,)))
    assert "light_0" not in converter.to_dict(scene(sphere(kd=0), lights=(LAMP,)))
    assert "light_0" not in converter.to_dict(scene(sphere(), lights=(LAMP.replace(intensity=(0, 0, 0)),)))


def test_lights_do_not_fall_off_and_one_can_be_chosen() -> None:
    both = scene(sphere(), lights=(LAMP, LAMP.replace(position=(0, 5, 0))))
    described = converter.to_dict(both)
    assert described["light_0"]["type"] == mitsuba_plugins.POINT
    assert described["light_0"]["intensity"]["value"] == [np.pi * value for value in LAMP.intensity]
    assert {name for name in converter.to_dict(both, light=1) if name.startswith("light")} == {"light_1"}
    with pytest.raises(IndexError, match="no light 2: the scene has 2, counted from 0"):
        converter.to_dict(both, light=2)


def test_the_ambient_term_alone_has_a_light_that_stands_nowhere_and_mirrors() -> None:
    both = scene(
        sphere(kr=0.5, ks=0.5), sphere(scaling=(1, 2, 1), position=(3, 0, -6)), lights=(LAMP,), ambient=(1, 2, 3)
    )
    described = converter.ambient_dict(both)
    assert {name for name in described if name.startswith("light")} == {"light"}
    assert described["light"]["type"] == mitsuba_plugins.EVERYWHERE
    assert described["light"]["intensity"]["value"] == [np.pi * value for value in (1, 2, 3)]
    ball, egg = described["sphere_0"]["bsdf"], described["group_1"]["surface"]["bsdf"]
    assert "bsdf" not in described["sphere_1"]
    assert (ball["type"], ball["diffuse"]["value"], ball["mirror"]) == (
        mitsuba_plugins.AMBIENT,
        [0.4, 0.25, 0.125],
        0.5,
    )
    assert "mirror" not in egg
    assert "mirror" not in converter.ambient_dict(both, max_reflections=0)["sphere_0"]["bsdf"]
    assert described["integrator"] == {"type": "path", "max_depth": 5, "rr_depth": 6}


def test_pure_mirrors_are_stock_conductors() -> None:
    """And what chains of them end on is lit, or shines from one side."""
    mirror = sphere(ka=0, kd=0, kr=0.5, scaling=(1, 2, 1))
    pair = scene(mirror, sphere(position=(3, 0, -6)), lights=(LAMP,), ambient=(1, 2, 3))
    assert converter.stock_mirrors(pair)
    lit = converter.chain_dict(pair, "light")
    assert not [plugin for plugin in types(lit) if plugin.startswith("whitted_")]
    assert lit["group_0"]["surface"]["bsdf"]["surface"] == {
        "type": "conductor",
        "material": "none",
        "specular_reflectance": {"type": "rgb", "value": [0.5] * 3},
    }
    assert "bsdf" not in lit["sphere_0"]
    assert lit["sphere_1"]["bsdf"]["surface"]["reflectance"]["value"] == [0.4, 0.25, 0.125]
    assert lit["light"]["intensity"]["value"] == list(LAMP.intensity)
    for show, radiance in (("ambient", [0.4, 0.25, 0.125]), ("index", [2 * converter.CODE] * 3)):
        for inside in (False, True):
            described = converter.chain_dict(pair, show, inside=inside)
            assert "light" not in described
            assert described["sphere_1"]["emitter"]["radiance"]["value"] == radiance
            assert described["sphere_1"]["flip_normals"] == inside
            assert described["sphere_1"]["bsdf"]["surface"]["specular_reflectance"]["value"] == [0, 0, 0]
            kept = described["group_0"]["surface"]["bsdf"]["surface"]["specular_reflectance"]["value"]
            assert kept == ([0.5] * 3 if show == "ambient" else list(converter.COUNTING))


def types(described: Any) -> list[str]:
    """The plugins of a dictionary."""
    if not isinstance(described, dict):
        return []
    return [described["type"], *(name for value in described.values() for name in types(value))]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, True),
        ({"kr": 0.5}, False),
        ({"kr": 0.5, "color": (0, 0, 0)}, True),
        ({"kr": 0.5, "ka": 0, "kd": 0, "scaling": (1, 2, 3)}, True),
        ({"scaling": (1, -1, 1)}, True),
        ({"scaling": (1, 2, 1)}, False),
        ({"ks": 0.5}, False),
    ],
)
def test_which_mirrors_stock_plugins_say(changes: dict[str, Any], says: bool) -> None:
    pair = scene(sphere(ka=0, kd=0, kr=0.5), sphere(position=(3, 0, -6), **changes), lights=(LAMP,))
    assert converter.stock_mirrors(pair) == says
    # Nothing shines without lights.
    assert converter.stock_mirrors(pair.replace(lights=[])) == (says or "ks" in changes)


def test_places_are_read_off_a_texture() -> None:
    """On the axes they are 0, 1/2 and 1; the texture is about the sphere, not about the scene."""
    import mitsuba as mi

    far = scene(sphere(position=(300, -200, -60), scaling=(4, -4, 4), color=(1, 1, 1)))
    texture = mi.load_dict(converter.chain_dict(far, "place")["sphere_0"]["emitter"]["radiance"])
    for axis in range(3):
        for side in (-1, 0, 1):
            si = mi.SurfaceInteraction3f()
            place = [300.0, -200.0, -60.0]
            place[axis] += 4 * side
            si.p = mi.Point3f(*place)
            expected = [0.5] * 3
            expected[axis] += side / 2
            assert list(texture.eval(si)) == pytest.approx(expected, abs=2e-5)


def test_background_is_for_primary_rays_only() -> None:
    described = converter.to_dict(scene(sphere(), lights=(LAMP,)))
    assert described["background"]["sampling_weight"] == 0
    assert "background" not in converter.to_dict(scene(sphere(kr=1), lights=(LAMP,)))
    assert "background" not in converter.to_dict(scene(sphere(), background=(0, 0, 0)))


def test_square_pixels_need_no_sensor_of_ours() -> None:
    square = converter.to_dict(scene(sphere()))["sensor"]
    assert square["type"] == "perspective"
    wide = converter.to_dict(scene(sphere(), view=scene().view.replace(columns=50)))["sensor"]
    assert wide["type"] == mitsuba_plugins.FRUSTUM


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("size", [(4, 3), (1, 1), (1, 5)])
def test_window_has_the_samples_at_its_pixel_centres(sample: Sample, size: tuple[int, int]) -> None:
    columns, rows = size
    view = View(near=1, left=-1, right=3, bottom=-2, top=1, columns=columns, rows=rows)
    frame = converter.window(view, sample)
    x = [frame.left + (frame.right - frame.left) * (c + 0.5) / columns for c in range(columns)]
    y = [frame.top - (frame.top - frame.bottom) * (j + 0.5) / rows for j in range(rows)]
    places = {"corner": (0, 0), "center": (0.5, 0.5), "bottom-left": (0, 1), "top-right": (1, 0), "inclusive": (0, 0)}
    ox, oy = places[sample]
    across = max(columns - 1, 1) if sample == "inclusive" else columns
    down = max(rows - 1, 1) if sample == "inclusive" else rows
    assert x == pytest.approx([-1 + 4 * (c + ox) / across for c in range(columns)], abs=1e-14)
    assert y == pytest.approx([1 - 3 * (j + oy) / down for j in range(rows)], abs=1e-14)


def drawn(described: dict[str, Any]) -> np.ndarray[Any, Any]:
    import mitsuba as mi

    return np.array(mi.render(mi.load_dict(described)), dtype=np.float64)[..., :3]


def agree(image: np.ndarray[Any, Any], passes: Passes, names: tuple[str, ...], of: Scene, sample: Sample) -> None:
    """Stock integrators draw the sum of passes, but where their documented epsilons decide."""
    analysis = margins.analyse(of, sample=sample)
    away = min(np.linalg.norm(s.position) - max(map(abs, s.scaling)) for s in of.spheres)
    epsilon = RAY_EPSILON * (1 + 1 / away)
    interior = np.all([analysis.margins[kind] > 10 * epsilon for kind in analysis.margins], axis=0)
    assert interior.mean() > 0.5
    expected = sum(np.asarray(passes[name]) for name in names)
    # The origin of a reflected ray is moved, a primary hit is not.
    unit = ROUNDINGS + (epsilon if "reflection" in names else 0)
    tolerance = unit * sum(analysis.sensitivity[name] for name in names) + 1e-37
    error = np.abs(image - expected).max(axis=-1)
    assert np.all(error[interior] <= tolerance[interior])
    assert error[interior].max() < 0.01
    assert np.abs(np.asarray(expected)).max() > 0.1


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("columns", [40, 56])
def test_direct_light_as_stock_mitsuba_draws_it(sample: Sample, columns: int) -> None:
    """Stock `direct` with one light: square pixels through `perspective`, others through our frustum."""
    view = View(near=2, left=-0.8, right=1.2, bottom=-1.1, top=0.9, columns=columns, rows=40)
    ball, egg = sphere(ks=0.5), sphere(position=(1.5, -0.5, -5), scaling=(0.4, 1, 0.3))
    both = scene(ball, egg, lights=(LAMP,), view=view, background=(0, 0, 0))
    passes = reference.render(both, ("direct",), sample=sample)
    agree(drawn(converter.to_dict(both, sample=sample)), passes, ("direct",), both, sample)


def test_inside_is_lit_and_the_near_plane_cuts() -> None:
    """A light inside a sphere that the near plane opens."""
    lamp = LAMP.replace(position=(0.2, 0.3, -3))
    cut = scene(sphere(position=(0, 0, -3), scaling=(1.2, 1.4, 1.3)), lights=(lamp,), background=(0, 0, 0))
    passes = reference.render(cut, ("direct",))
    agree(drawn(converter.to_dict(cut)), passes, ("direct",), cut, "corner")


def test_mirrors_as_stock_path_draws_them() -> None:
    pair = (sphere(position=(-1.1, 0, -6), kr=0.8), sphere(position=(1.1, 0, -6), kr=0.6, ks=0.4))
    both = scene(*pair, lights=(LAMP,), background=(0, 0, 0))
    described = converter.to_dict(both)
    assert described["integrator"] == {"type": "path", "max_depth": 5, "rr_depth": 6}
    passes = reference.render(both, ("direct", "reflection"))
    assert np.asarray(passes["reflection"]).max() > 0.1
    agree(drawn(described), passes, ("direct", "reflection"), both, "corner")


def test_background_fills_what_is_missed() -> None:
    image = drawn(converter.to_dict(scene(sphere(), lights=(LAMP,))))
    assert image[0, 0] == pytest.approx((0.1, 0.2, 0.3), rel=1e-6)
    assert drawn(converter.to_dict(scene()))[5, 5] == pytest.approx((0.1, 0.2, 0.3), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda s: s.replace(spheres=[sphere(ks=0.5, name="shiny")]), "the specular term of sphere 'shiny'"),
        (lambda s: s.replace(spheres=[sphere(kr=0.5, name="glass")]), "the mirror term of sphere 'glass'"),
        (lambda s: s.replace(view=s.view.replace(rows=41)), "pixels that are not square"),
        (lambda s: s.replace(lights=[LAMP]), "lights that do not fall off"),
    ],
)
def test_stock_only_names_what_stock_cannot_say(change: Callable[[Scene], Scene], reason: str, tmp_path: Path) -> None:
    plain = scene(sphere())
    converter.to_dict(plain, stock_only=True)
    with pytest.raises(converter.StockError, match=reason) as caught:
        converter.write_xml(change(plain), tmp_path / "scene.xml", stock_only=True)
    assert len(caught.value.reasons) == 1
    assert isinstance(caught.value, ValueError)
    assert not list(tmp_path.iterdir())


def test_stock_only_uses_no_plugin_of_ours(tmp_path: Path) -> None:
    converter.write_xml(scene(sphere(), lights=(LAMP,)), tmp_path / "scene.xml", stock_only=True, light=0)
    assert "whitted_" not in (tmp_path / "scene.xml").read_text()


def rendered_by_program(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    """The channels of what Mitsuba's own program makes of an XML file."""
    import OpenEXR

    program = Path(sys.executable).parent / "mitsuba"
    image = path.with_suffix(".exr")
    command = [str(program), "-m", "scalar_rgb", str(path), "-o", str(image)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    with OpenEXR.File(str(image), separate_channels=True) as file:
        return {name: np.array(channel.pixels, dtype=np.float64) for name, channel in file.channels().items()}


def stacked(channels: dict[str, np.ndarray[Any, Any]], stem: str, names: str = "RGB") -> np.ndarray[Any, Any]:
    return np.stack([channels[f"{stem}{name}"] for name in names], axis=-1)


def test_program_draws_the_ambient_term(tmp_path: Path) -> None:
    """Nothing reflects light: the albedo times the ambient intensity is the term, the image the background."""
    cut = sphere(position=(0.5, 0, -2.5), scaling=(1, 0.6, 0.8), kd=0, ka=0.7, color=(0.2, 0.4, 0.8))
    both = scene(sphere(kd=0), cut, ambient=(0.5, 0.25, 1), lights=(LAMP,))
    converter.write_xml(both, tmp_path / "ambient.xml", stock_only=True)
    channels = rendered_by_program(tmp_path / "ambient.xml")
    passes = reference.render(both, ("ambient", "id", "position"))
    hit = np.asarray(passes["id"]) >= 0
    assert 0 < hit.sum() < hit.size
    ambient = stacked(channels, "albedo.") * both.ambient
    assert np.where(hit[..., None], ambient, 0) == pytest.approx(np.asarray(passes["ambient"]), abs=1e-7)
    assert stacked(channels, "")[~hit] == pytest.approx(np.tile(both.background, ((~hit).sum(), 1)), rel=1e-6)
    position = stacked(channels, "position.", "XYZ")
    tolerance = ROUNDINGS * margins.analyse(both).sensitivity["position"]
    assert np.all(np.abs(position - passes["position"]).max(axis=-1)[hit] <= tolerance[hit])


def test_program_draws_one_light_that_falls_off(tmp_path: Path) -> None:
    """The image times pi d^2 is the diffuse term."""
    egg = sphere(position=(1.5, 0.5, -5), scaling=(0.4, 1, 0.3))
    both = scene(sphere(), egg, lights=(LAMP, LAMP.replace(position=(0, 0, 2))), background=(0, 0, 0))
    converter.write_xml(both, tmp_path / "light.xml", stock_only=True, light=0)
    channels = rendered_by_program(tmp_path / "light.xml")
    position = stacked(channels, "position.", "XYZ")
    squared = ((position - LAMP.position) ** 2).sum(axis=-1)[..., None]
    one = both.replace(lights=[LAMP])
    passes = reference.render(one, ("diffuse",))
    agree(stacked(channels, "") * np.pi * squared, passes, ("diffuse",), one, "corner")


def test_xml_with_our_plugins_says_the_same_as_the_dictionary(tmp_path: Path) -> None:
    import mitsuba as mi

    shiny = scene(sphere(ks=0.5, kr=0.5), lights=(LAMP,), view=scene().view.replace(columns=30))
    path = tmp_path / "shiny.xml"
    converter.write_xml(shiny, path, aovs="")
    text = path.read_text()
    assert f"Not for Mitsuba's own program: {mitsuba_plugins.PHONG}, {mitsuba_plugins.POINT}" in text
    assert np.array_equal(np.array(mi.render(mi.load_file(str(path))))[..., :3], drawn(converter.to_dict(shiny)))


def test_the_recipe_at_the_head_of_the_xml_works_as_written(tmp_path: Path) -> None:
    path = tmp_path / "shiny.xml"
    shiny = scene(sphere(ks=0.5, kr=0.5), lights=(LAMP,))
    converter.write_xml(shiny, path, aovs="")
    (line,) = [line for line in path.read_text().splitlines() if line.startswith("<!-- In Python: ")]
    recipe = line.removeprefix("<!-- In Python: ").removesuffix(" -->").replace("FILE", str(path))
    code = f"{recipe}\nimport numpy; numpy.save({str(tmp_path / 'image.npy')!r}, numpy.array(image))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert np.array_equal(np.load(tmp_path / "image.npy")[..., :3], drawn(converter.to_dict(shiny)))


def test_both_variants_in_one_process(need: Callable[[object, str], None]) -> None:
    """Plugins belong to the variant; the former one is set again."""
    import mitsuba as mi

    from validation.renderers import get

    llvm = get("mitsuba-spec@llvm")
    need(llvm.unavailable() is None, str(llvm.unavailable()))
    shiny = scene(sphere(ks=0.5), lights=(LAMP,), background=(0, 0, 0))
    first = drawn(converter.to_dict(shiny))
    with mitsuba_plugins.variant("llvm_ad_rgb"):
        assert mi.variant() == "llvm_ad_rgb"
        second = drawn(converter.to_dict(shiny))
    assert mi.variant() == "scalar_rgb"
    assert np.array_equal(first, drawn(converter.to_dict(shiny)))
    passes = reference.render(shiny, ("direct",))
    agree(second, passes, ("direct",), shiny, "corner")
