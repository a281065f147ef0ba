"""What becomes of each clause of a scene in POV-Ray, and that its own program, typed as the file says, draws it."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from converters import povray as converter
from tests import strategies
from tracer import Light, Scene, Sphere, View, reference
from tracer.passes import OFFSETS, SAMPLES, Sample

Need = Callable[[object, str], None]


def sphere(**changes: Any) -> Sphere:
    plain: dict[str, Any] = {"name": "s", "position": (0, 0, -6), "scaling": (1, 1, 1), "color": (0.8, 0.5, 0.25)}
    return Sphere(**{**plain, "ka": 0.5, "kd": 0.5, "ks": 0, "kr": 0, "exponent": 10, **changes})


def scene(*spheres: Sphere, lights: tuple[Light, ...] = (), **changes: Any) -> Scene:
    view = View(near=2, left=-1, right=1, bottom=-1, top=1, columns=40, rows=40)
    return Scene(**{"view": view, "spheres": spheres, "lights": lights, "background": (0.1, 0.2, 0.3), **changes})


LAMP = Light(name="lamp", position=(3, 4, -1), intensity=(0.9, 0.6, 0.3))


def numbers(text: str, word: str) -> list[float]:
    """The numbers of the first vector after a word."""
    found = re.search(rf"\b{word}\b[^<]*<([^>]*)>", text)
    assert found, word
    return [float(number) for number in found[1].split(",")]


def declared(text: str, name: str) -> str:
    """A declaration, up to the brace that closes it at the start of a line."""
    found = re.search(rf"#declare {name} = .*?\n}}", text, re.DOTALL)
    assert found, name
    return found[0]


# ---- the text


def test_text_reads_as_a_scene() -> None:
    text = converter.to_pov(scene(sphere(), lights=(LAMP,), ambient=(0.5, 0.25, 0.125)))
    order = ("global_settings", "camera", "---- lights", "---- surfaces", "---- spheres", "---- background")
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert text.count("{") == text.count("}")
    assert "ambient_light rgb <0.5, 0.25, 0.125>*Gain" in text
    assert "assumed_gamma 1\n" in text
    assert "adc_bailout 0 " in text


def test_sphere_has_the_numbers_of_the_scene() -> None:
    third = 1 / 3
    text = converter.to_pov(scene(sphere(position=(third, -0.1, -6), scaling=(-third, third, third))))
    assert f"sphere {{ <{third!r}, -0.1, -6.0>*Unit, {third!r}*Unit\n" in text
    assert "scale" not in text


def test_ellipsoid_is_scaled_from_a_sphere_of_its_smallest_size() -> None:
    one = scene(sphere(scaling=(2, -4, 0.5)))
    text = converter.to_pov(one)
    # 2048 = 2^10 / 0.5: the smallest scaling becomes 2^10, which is the radius.
    assert converter.unit(one) == 2048
    assert (
        "sphere { <0, 0, 0>, 1024.0\n    scale <2.0, 4.0, 0.5>*Unit/1024.0\n    translate <0.0, 0.0, -6.0>*Unit\n"
        in text
    )


def test_surface_has_only_what_it_needs() -> None:
    def surface(**changes: Any) -> str:
        lit = scene(sphere(**changes), lights=(LAMP,), ambient=(1, 1, 1))
        return declared(converter.to_pov(lit), "Surface_0")

    assert "finish { ambient 0.5 diffuse 0.5 }" in surface()
    assert "finish { diffuse 0.5 phong 0.25 phong_size 0.5 }" in surface(ka=0, ks=0.25, exponent=0.5)
    assert "finish { ambient 0.5 reflection 0.75 }" in surface(kd=0, kr=0.75)
    assert "pigment { color rgbt <0.8, 0.5, 0.25, 2.5e-10> }" in surface()


def test_terms_and_lights_can_be_left_out() -> None:
    one = scene(sphere(ks=0.5, kr=0.5), lights=(LAMP, LAMP.replace(name="other")))
    text = converter.to_pov(one, terms=["specular"], max_reflections=0, light=1)
    assert "finish { phong 0.5 phong_size 10.0 }" in text
    assert "background" not in text
    assert "max_trace_level 1 " in text
    assert "// light 1: other" in text
    assert "// light 0" not in text
    assert "light_source" not in converter.to_pov(one, terms=("ambient", "background"))
    with pytest.raises(IndexError, match="no light 2: the scene has 2, counted from 0"):
        converter.to_pov(one, light=2)


@pytest.mark.parametrize("bounces", [0, 1, 3, 7])
def test_levels_are_the_reflections_and_one(bounces: int) -> None:
    assert f"max_trace_level {bounces + 1} " in converter.to_pov(scene(sphere(kr=1)), max_reflections=bounces)
    assert "max_trace_level 1 " in converter.to_pov(scene(sphere(kr=0)), max_reflections=bounces)


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("size", [(4, 3), (1, 1), (1, 5)])
def test_camera_has_the_samples_at_its_pixel_centres(sample: Sample, size: tuple[int, int]) -> None:
    """POV-Ray's ray: direction + right ((c + 1/2) / columns - 1/2) + up (1/2 - (j + 1/2) / rows)."""
    columns, rows = size
    view = View(near=1.5, left=-1, right=3, bottom=-2, top=1, columns=columns, rows=rows)
    text = converter.to_pov(scene(view=view), sample=sample)
    direction, right, up = (np.array(numbers(text, word)) for word in ("direction", "right", "up"))
    scale = direction[2] / -1.5
    ox, oy = OFFSETS[sample]
    across = max(columns - 1, 1) if sample == "inclusive" else columns
    down = max(rows - 1, 1) if sample == "inclusive" else rows
    for c in range(columns):
        for j in range(rows):
            ray = (direction + right * ((c + 0.5) / columns - 0.5) + up * (0.5 - (j + 0.5) / rows)) / scale
            expected = (-1 + 4 * (c + ox) / across, 1 - 3 * (j + oy) / down, -1.5)
            assert ray == pytest.approx(expected, abs=1e-14)


def test_near_plane_makes_two_copies_or_a_ghost() -> None:
    behind, across, before = sphere(position=(0, 0, -6)), sphere(position=(0, 0, -2)), sphere(position=(0, 0, -0.5))
    text = converter.to_pov(scene(behind))
    assert "clipped_by" not in text
    assert "no_image" not in text
    text = converter.to_pov(scene(across))
    assert text.count("texture { Surface_0 }") == 2
    assert text.count("clipped_by { plane { z, -Near } } no_shadow no_reflection") == 1
    assert text.count("no_image") == 1
    assert "#declare Near = 2.0*Unit;" in text
    text = converter.to_pov(scene(before))
    assert text.count("texture { Surface_0 }") == text.count("no_image") == 1
    assert "clipped_by" not in text


@pytest.mark.filterwarnings("ignore::tracer.SceneWarning")
def test_duplicates_are_left_out() -> None:
    text = converter.to_pov(scene(sphere(), sphere(color=(1, 0, 0)), sphere(position=(1, 0, -6))))
    assert re.findall(r"// sphere (\d)", text) == ["0", "2"]


def test_negative_light_has_a_text_of_its_own() -> None:
    both = scene(sphere(), lights=(LAMP, LAMP.replace(intensity=(-0.5, 0.25, 0))), ambient=(-1, 1, 0))
    plus, minus = converter.to_pov(both), converter.to_pov(both, sign=-1)
    assert "rgb <0.0, 0.25, 0.0>*Gain" in plus
    assert "ambient_light rgb <0.0, 1.0, 0.0>*Gain" in plus
    assert "has to be subtracted" in plus
    assert "rgb <0.5, 0.0, 0.0>*Gain" in minus
    assert "// light 0" not in minus
    assert "ambient_light rgb <1.0, 0.0, 0.0>*Gain" in minus
    assert "subtract this picture" in minus
    assert "subtract" not in converter.to_pov(scene(sphere(), lights=(LAMP,)))


def test_background_is_seen_by_primary_rays_only() -> None:
    text = converter.to_pov(scene(sphere(kr=1)))
    tail = text[text.index("---- background") :]
    assert "rgb <0.1, 0.2, 0.3>*Gain" in tail
    assert "hollow no_shadow no_reflection" in tail
    assert "background {" not in text
    assert "---- background" not in converter.to_pov(scene(background=(0, 0, 0)))


def test_names_cannot_leave_their_comment() -> None:
    hostile = ["*/}", '"}#declare', "//\\", "é§", "/*"]
    spheres = [sphere(name=name, position=(k, 0, -6)) for k, name in enumerate(hostile)]
    plain = [sphere(name="x", position=(k, 0, -6)) for k in range(len(hostile))]

    def code(text: str) -> list[str]:
        return [line.partition("//")[0] for line in text.splitlines()]

    lights = tuple(LAMP.replace(name=name) for name in hostile)
    text = converter.to_pov(scene(*spheres, lights=lights))
    assert code(text) == code(converter.to_pov(scene(*plain, lights=(LAMP,) * 5)))
    assert text.isascii()
    assert '// sphere 1: "}#declare\n' in text


@given(strategies.scenes())
@settings(max_examples=50)
def test_lengths_and_colors_fit(any_scene: Scene) -> None:
    """Powers of two; the brightest color fits into 0 .. 1 and uses more than half of it."""
    unit, gain = converter.unit(any_scene), converter.gain(any_scene)
    assert np.frexp(unit)[0] == np.frexp(gain)[0] == 0.5
    brightest = converter.brightest(any_scene)
    assert brightest * gain <= 1
    assert brightest == 0 or brightest * gain > 0.5
    assert np.max(reference.render(any_scene, ("beauty",))["beauty"], initial=0) * gain <= 1


@pytest.mark.parametrize("scale", [1e-60, 1e-3, 1, 1e3, 1e60])
def test_lengths_are_multiplied_to_the_same_size(scale: float) -> None:
    ball = sphere(position=(0, 0, -6 * scale), scaling=(scale,) * 3)
    frame = View(near=2 * scale, left=-scale, right=scale, bottom=-scale, top=scale, columns=4, rows=4)
    one = scene(ball, view=frame)
    assert 512 <= converter.unit(one) * scale <= 2048
    assert not converter.problems(one)


@pytest.mark.parametrize("intensity", [1e-60, 1e-3, 1, 1e3, 1e60])
def test_colors_are_multiplied_to_the_same_size(intensity: float) -> None:
    one = scene(sphere(), lights=(LAMP.replace(intensity=(intensity,) * 3),), background=(0, 0, 0))
    assert 0.2 < converter.gain(one) * intensity < 3


def test_problems() -> None:
    far = scene(sphere(), sphere(position=(0, 0, -1e8)))
    assert converter.problems(far) == ["its largest distance is more than 4.1943e+06 times its smallest sphere"]
    assert not converter.problems(scene(sphere(kr=0)), 256)
    assert converter.problems(scene(sphere(kr=1)), 256) == ["more than 255 reflections"]
    assert not converter.problems(scene(sphere(kr=1)), 255)
    slit = scene(view=scene().view.replace(left=0, right=1e-12))
    assert converter.problems(slit) == ["its image plane is too narrow"]


@pytest.mark.parametrize("name", ["\n.pov", 'a"b.pov', "$(x).pov", "-I.pov", "é.pov"])
def test_file_names_cannot_leave_the_command(name: str, tmp_path: Path) -> None:
    converter.write_pov(scene(), tmp_path / name)
    (written,) = tmp_path.iterdir()
    assert written.name == name
    assert written.read_text().splitlines()[1] == "//     " + shlex.join(converter.command((40, 40), "scene.pov"))


def test_refused_scene_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(converter.CannotSayError, match=r"^POV-Ray cannot draw this scene: its largest distance"):
        converter.write_pov(scene(sphere(position=(0, 0, -1e8))), tmp_path / "scene.pov")
    assert not list(tmp_path.iterdir())


def test_command_switches_off_what_would_change_the_picture() -> None:
    """Boxes in float32, antialiasing, a gamma, and a window and a key press that would wait for someone."""
    words = "povray +Ia.pov +Oa.ppm +W40 +H30 +FP16 File_Gamma=1.0 -A -D -P -MB"
    assert shlex.join(converter.command((40, 30), "a.pov")) == words


# ---- the picture


def program(need: Need) -> None:
    need(shutil.which("povray"), "no POV-Ray: sudo apt-get install povray")


def drawn(path: Path) -> np.ndarray[Any, Any]:
    """Render a file with the command at its head; values 0 to 1."""
    (line,) = [line for line in path.read_text().splitlines() if line.startswith("//     povray ")]
    done = subprocess.run(
        shlex.split(line.removeprefix("//")), cwd=path.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    data = path.with_suffix(".ppm").read_bytes()
    header = re.match(rb"P6\s(?:#.*\n)*(\d+) (\d+)\s65535\s", data)
    assert header
    columns, rows = map(int, header.groups())
    return np.frombuffer(data[header.end() :], ">u2").reshape(rows, columns, 3) / 65535


@pytest.mark.povray
def test_program_draws_the_scene_as_typed(tmp_path: Path, need: Need) -> None:
    """Cut, inside, mirrors, two lights, oblong pixels, a hostile name and a file with a blank in its name."""
    program(need)
    view = View(near=2, left=-1.2, right=0.9, bottom=-0.7, top=0.8, columns=45, rows=31)
    shapes = [
        sphere(name='*/"{', position=(-0.4, 0.3, -2), scaling=(0.9, 0.8, 0.5), kr=0.3),
        sphere(position=(0.8, -0.2, -5), ks=0.6, kr=0.5, exponent=7.5),
        sphere(position=(0, -31, -6), scaling=(30, 30, 30), color=(0.9, 0.9, 0.7)),
    ]
    lights = (LAMP, LAMP.replace(position=(-2, 1.5, -3), intensity=(7, 5, 9)))
    one = scene(*shapes, lights=lights, view=view, ambient=(0.3, 0.2, 0.4))
    path = tmp_path / "my scene.pov"
    converter.write_pov(one, path, sample="center", max_reflections=2)
    expected = reference.render(one, ("beauty",), sample="center", max_reflections=2)["beauty"]
    assert np.ptp(expected) > 3
    gain = converter.gain(one, max_reflections=2)
    assert np.abs(drawn(path) / gain - expected).max() <= 1 / 65535 / gain


@pytest.mark.povray
def test_program_draws_the_two_signs(tmp_path: Path, need: Need) -> None:
    program(need)
    one = scene(sphere(ks=0.4), lights=(LAMP, LAMP.replace(position=(-3, 1, 0), intensity=(-0.7, 0.2, -0.1))))
    total = np.zeros((40, 40, 3))
    for sign in (1, -1):
        path = tmp_path / f"sign{sign}.pov"
        converter.write_pov(one, path, sign=sign)
        total += sign * drawn(path) / converter.gain(one, sign=sign)
    expected = reference.render(one, ("beauty",))["beauty"]
    assert np.min(expected) < -0.1
    assert np.abs(total - expected).max() <= 2 / 65535 / converter.gain(one)
