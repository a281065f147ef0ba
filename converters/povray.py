"""Scene -> POV-Ray 3.7: one text that its own program renders, or a picture of one thing of the scene alone.

POV-Ray's stock model is the specification's, so nothing is approximated:

- A sphere is a `sphere`; an ellipsoid is one about the origin, scaled and moved. Duplicates are left out.
- The camera's `direction`, `right` and `up` are the image plane. POV-Ray samples pixel centres: the sample position is
  a shift of the direction.
- The near plane limits primary rays alone: a sphere that crosses it is written twice, clipped for the camera, and whole
  for shadows and mirrors (`no_image`). One that lies before it has the second copy alone.
- `phong` is the specification's highlight, `reflection` its mirror, `ambient` times `ambient_light` its ambient term.
- The background is a large sphere that only primary rays see: `background` would show in mirrors, too.
- Colors are multiplied by `Gain`, a power of two, as POV-Ray's output ends at 1, and lengths by `Unit`, another one, as
  its epsilons are absolute lengths. Neither changes anything: the model is linear, and light does not fall off.
- POV-Ray's output ends at 0, too. So one text has either the positive parts of all intensities or the negative ones,
  with their sign changed: the picture is the difference of the two.

Not said is the shadow epsilon: POV-Ray's is a length of its own (see docs/tolerances.md).
"""

from __future__ import annotations

import math
import os
import re
import shlex
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from converters.mitsuba import window

if TYPE_CHECKING:
    from tracer import Scene, Sphere
    from tracer.passes import Sample

Term = Literal["ambient", "diffuse", "specular", "background"]
TERMS: tuple[Term, ...] = ("ambient", "diffuse", "specular", "background")

#: What a picture shows:
#: model     the terms that were asked for, and their reflections
#: lights    whether three lights are visible, as red, green and blue
#: id        the index of the sphere plus 1, in red, in steps of 16-bit output
#: position  the hit point in the box of `box`, 0 to 1
#: digits    what follows after that times DIGITS, without its integer part
#: normal    the positive components of the normal; opposite: the negative ones, with their sign changed
Show = Literal["model", "lights", "id", "position", "digits", "normal", "opposite"]

CHANNELS = ("<1, 0, 0>", "<0, 1, 0>", "<0, 0, 1>")

#: Of 16 bits.
STEPS = 65535
#: How much finer the second picture of a position is than the first: half a step of the first is an eighth of it.
DIGITS = 2.0**14
#: The smallest sphere is about this large, where the largest distance lets it: see `unit`.
SMALLEST = 2.0**10
#: POV-Ray finds nothing beyond MAX_DISTANCE = 1e7. Half of that is for the background.
FARTHEST = 2.0**22
#: POV-Ray's own limit of `max_trace_level`.
MOST_LEVELS = 256
#: POV-Ray gives up vectors of the camera that are shorter than this.
SHORTEST = 1e-10
#: Keeps a surface from counting as opaque, which changes no color: POV-Ray tries the last opaque sphere that hid a
#: light before any other, with other tolerances, so that a pixel would depend on those drawn before. Below 1e-10 it
#: does not notice.
TRANSMIT = 2.5e-10


class CannotSayError(ValueError):
    """A scene is beyond POV-Ray."""


def problems(scene: Scene, max_reflections: int = 3, sample: Sample = "corner") -> list[str]:
    """What keeps POV-Ray from drawing a scene, one clause each."""
    found = []
    if scene.distinct and unit(scene) * min(_scalings(scene)) < 1:
        found.append(f"its largest distance is more than {FARTHEST:g} times its smallest sphere")
    if len(scene.spheres) >= STEPS:
        found.append(f"it has more than {STEPS - 1} spheres")
    if max_reflections >= MOST_LEVELS and _mirrors(scene):
        found.append(f"more than {MOST_LEVELS - 1} reflections")
    vectors = _camera(scene, sample)
    if min(math.hypot(*vector) for vector in vectors) < 2 * SHORTEST:
        found.append("its image plane is too narrow")
    return found


def distinct(scene: Scene) -> list[Sphere]:
    """The spheres that exist."""
    # A scene makes the tuple of its spheres anew each time it is asked.
    spheres = scene.spheres
    return [spheres[i] for i in scene.distinct]


def unit(scene: Scene) -> float:
    """By how much lengths are multiplied: a power of two that keeps them off POV-Ray's absolute epsilons."""
    far = _reach(scene)
    most = 2.0 ** math.floor(math.log2(FARTHEST / far))
    if not scene.distinct:
        return most
    return min(most, 2.0 ** math.floor(math.log2(SMALLEST / min(_scalings(scene))) + 0.5))


def gain(scene: Scene, terms: Collection[str] = TERMS, max_reflections: int = 3, sign: int = 1) -> float:
    """By how much colors are multiplied: the largest power of two with which no pixel can be above 1."""
    most = brightest(scene, terms, max_reflections, sign)
    if most == 0:
        return 1.0
    mantissa, exponent = math.frexp(most)
    return math.ldexp(1.0, 1 - exponent if mantissa == 0.5 else -exponent)


def brightest(scene: Scene, terms: Collection[str] = TERMS, max_reflections: int = 3, sign: int = 1) -> float:
    """A bound of every color of a picture: every light shines fully everywhere, every mirror shows the brightest."""
    spheres = distinct(scene)
    largest = max(_part(scene.background, sign)) if "background" in terms else 0.0
    for channel in range(3):
        lights = sum(_part(light.intensity, sign)[channel] for light in scene.lights)
        own = [
            ("ambient" in terms) * s.ka * s.color[channel] * _part(scene.ambient, sign)[channel]
            + ("diffuse" in terms) * s.kd * s.color[channel] * lights
            + ("specular" in terms) * s.ks * lights
            for s in spheres
        ]
        seen = 0.0
        for _ in range(max_reflections + 1):
            seen = max((value + s.kr * seen for value, s in zip(own, spheres, strict=True)), default=0.0)
        largest = max(largest, seen)
    # The sums above are rounded.
    return largest * (1 + 2.0**-40)


def box(scene: Scene) -> tuple[tuple[float, float, float], float]:
    """The corner and the edge of a cube, in units of the scene, that has all spheres well inside."""
    spheres = distinct(scene)
    if not spheres:
        return (0.0, 0.0, 0.0), 1.0
    low = [min(s.position[k] - abs(s.scaling[k]) for s in spheres) for k in range(3)]
    high = [max(s.position[k] + abs(s.scaling[k]) for s in spheres) for k in range(3)]
    edge = 2.0 ** math.ceil(math.log2(1.125 * max(b - a for a, b in zip(low, high, strict=True))))
    x, y, z = ((a + b) / 2 - edge / 2 for a, b in zip(low, high, strict=True))
    return (x, y, z), edge


def ball(sphere: Sphere, unit: float) -> float:
    """The radius of the sphere that is scaled to an ellipsoid: the power of two next to its smallest scaling.

    Near it, POV-Ray's lengths are those of the scene, and do not reach its limits.
    """
    return 2.0 ** math.floor(math.log2(unit * min(map(abs, sphere.scaling))) + 0.5)


def uniform(sphere: Sphere) -> bool:
    """Whether a sphere is no ellipsoid."""
    return len({abs(value) for value in sphere.scaling}) == 1


def before_near(scene: Scene, sphere: Sphere) -> bool:
    """Whether some of a sphere lies before the near plane, as far as rounding can tell."""
    top = sphere.position[2] + abs(sphere.scaling[2])
    return top >= -scene.view.near - 2.0**-50 * (abs(top) + scene.view.near + abs(sphere.scaling[2]))


def command(size: tuple[int, int], file: str = "scene.pov") -> list[str]:
    """What to type to have a text rendered: columns and rows, 16 bits, linear, no antialiasing, no window.

    Without bounding (`-MB`), as POV-Ray's boxes are in float32 and cut off outlines.
    """
    columns, rows = size
    files = (file, str(Path(file).with_suffix(".ppm")))
    # POV-Ray splits its options at blanks, unless they are quoted for itself.
    scene, picture = (f'"{name}"' if " " in name else name for name in files)
    words = ["povray", f"+I{scene}", f"+O{picture}", f"+W{columns}", f"+H{rows}"]
    return [*words, "+FP16", "File_Gamma=1.0", "-A", "-D", "-P", "-MB"]


def to_pov(
    scene: Scene,
    *,
    sample: Sample = "corner",
    max_reflections: int = 3,
    terms: Collection[Term] = TERMS,
    light: int | None = None,
    sign: int = 1,
    show: Show = "model",
    first: int = 0,
    gain_of: float | None = None,
    file: str = "scene.pov",
) -> str:
    """The scene as a text for POV-Ray; the module's docstring says what becomes of what.

    Args:
        sample: where in a pixel its ray goes.
        max_reflections: reflected rays in a chain.
        terms: what a surface shows; the background is one, too.
        light: the index of the only light to put in; None for all.
        sign: 1: the positive parts of all intensities; -1: the negative ones, with their sign changed.
        show: another picture than that of the model; the other arguments but `sample` do not matter then.
        first: of the pictures `lights` the first light, in red.
        gain_of: by what colors are multiplied; None: the result of `gain`.
        file: what the command at its head calls it.

    Raises:
        IndexError: there is no such light.
    """
    if light is not None and not 0 <= light < len(scene.lights):
        raise IndexError(f"no light {light}: the scene has {len(scene.lights)}, counted from 0")
    if gain_of is None:
        gain_of = gain(scene, terms, max_reflections, sign) if show == "model" else 1.0
    scale, spheres = unit(scene), list(zip(scene.distinct, distinct(scene), strict=True))
    levels = 1 + (max_reflections if show == "model" and _mirrors(scene) else 0)
    ambient = _part(scene.ambient, sign) if show == "model" and "ambient" in terms else (0.0, 0.0, 0.0)
    negative = any(value < 0 for value in _intensities(scene))
    lines = [
        "// A scene of the ray tracing assignment; every number is exact. Rendered with",
        "//     " + shlex.join(command((scene.view.columns, scene.view.rows), file)),
        *_about(show, sign, negative),
        "#version 3.7;",
        "",
        "// Lengths are multiplied by this, and colors: POV-Ray's epsilons are absolute, and its output ends at 1.",
        f"#declare Unit = {scale!r};",
        f"#declare Gain = {gain_of!r};",
        "",
        "global_settings {",
        "    assumed_gamma 1",
        f"    max_trace_level {levels}  // the primary ray and the reflected ones",
        "    adc_bailout 0  // no reflection is too dark to count",
        f"    ambient_light rgb {_vector(ambient)}*Gain",
        "}",
        "#default { finish { ambient 0 diffuse 0 phong 0 specular 0 reflection 0 emission 0 } }",
        "",
        "// ---- camera: the image plane lies at z = -near",
        *_camera_lines(scene, sample),
        "",
        "// ---- lights",
        *_lights(scene, show, terms, sign, first, light),
        "",
        "// ---- surfaces; the least transmission keeps POV-Ray's shadow cache, which has other epsilons, from use",
        *(line for i, sphere in spheres for line in _surface(scene, i, sphere, show, terms, levels > 1)),
        "",
        "// ---- spheres",
        *(line for i, sphere in spheres for line in _sphere(scene, i, sphere, scale)),
    ]
    background = _part(scene.background, sign)
    if show == "model" and "background" in terms and any(background):
        lines += [
            "",
            "// ---- background: no mirror shows it",
            f"sphere {{ <0, 0, 0>, {FARTHEST!r}",
            f"    pigment {{ color rgb {_vector(background)}*Gain }} finish {{ emission 1 }}",
            "    hollow no_shadow no_reflection",
            "}",
        ]
    return "\n".join(lines) + "\n"


def write_pov(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    sample: Sample = "corner",
    max_reflections: int = 3,
    terms: Collection[Term] = TERMS,
    light: int | None = None,
    sign: int = 1,
) -> None:
    """Write the text of `to_pov`. The command at its head renders it in its own folder; it may have to be renamed.

    Raises:
        CannotSayError: POV-Ray cannot draw the scene.
        IndexError: there is no such light.
        OSError: the file cannot be written.
    """
    from tracer.passes import write_beside

    if found := problems(scene, max_reflections, sample):
        raise CannotSayError("POV-Ray cannot draw this scene: " + "; ".join(found))
    # Other names POV-Ray's options, or a comment, may not take as they are.
    name = Path(path).name if re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_. -]*", Path(path).name) else "scene.pov"
    text = to_pov(scene, sample=sample, max_reflections=max_reflections, terms=terms, light=light, sign=sign, file=name)
    with write_beside(path) as temporary:
        temporary.write_text(text, encoding="ascii", errors="backslashreplace")


# ---- parts of the text


def _about(show: Show, sign: int, negative: bool) -> Iterator[str]:
    if show != "model":
        yield f"// Not the scene itself: the picture '{show}' of converters/povray.py."
    elif sign < 0:
        yield "// The negative parts of all intensities, with their sign changed: subtract this picture."
    elif negative:
        yield "// The positive parts of all intensities: the picture of the negative ones has to be subtracted."
    if show == "model":
        yield "// A value of the image, 0 to 1, divided by Gain is the color."


def _vector(values: Sequence[float]) -> str:
    # The sum makes 0 of -0, which reads better.
    return f"<{', '.join(repr(float(value) + 0.0) for value in values)}>"


def _part(values: Sequence[float], sign: int) -> tuple[float, float, float]:
    r, g, b = (max(sign * float(value), 0.0) for value in values)
    return r, g, b


def _intensities(scene: Scene) -> list[float]:
    return [*scene.ambient, *scene.background, *(value for light in scene.lights for value in light.intensity)]


def _scalings(scene: Scene) -> list[float]:
    return [abs(value) for sphere in distinct(scene) for value in sphere.scaling]


def _reach(scene: Scene) -> float:
    """A bound of the distance of any two points that a ray may go between."""
    spheres = distinct(scene)
    far = [math.hypot(*s.position) + max(map(abs, s.scaling)) for s in spheres]
    far += [math.hypot(*light.position) for light in scene.lights]
    return 2 * max([*far, scene.view.near])


def _mirrors(scene: Scene) -> bool:
    return any(sphere.kr > 0 for sphere in distinct(scene))


def _camera(scene: Scene, sample: Sample) -> tuple[tuple[float, float, float], ...]:
    """Direction, right and up of the camera; divided by a power of two, as POV-Ray rejects short ones."""
    view, frame = scene.view, window(scene.view, sample)
    width, height = frame.right - frame.left, frame.top - frame.bottom
    x, y = (frame.left + frame.right) / 2, (frame.bottom + frame.top) / 2
    size = 2.0 ** math.floor(math.log2(max(width, height, view.near, abs(x), abs(y))))
    return (x / size, y / size, -view.near / size), (width / size, 0.0, 0.0), (0.0, height / size, 0.0)


def _camera_lines(scene: Scene, sample: Sample) -> Iterator[str]:
    direction, right, up = _camera(scene, sample)
    yield f"#declare Near = {float(scene.view.near)!r}*Unit;"
    yield "camera {"
    yield "    location <0, 0, 0>"
    yield f"    direction {_vector(direction)}"
    yield f"    right {_vector(right)}"
    yield f"    up {_vector(up)}"
    yield "}"


def _name(name: str) -> str:
    """A name as part of a comment that ends with its line."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in name)


def _lights(scene: Scene, show: Show, terms: Collection[str], sign: int, first: int, only: int | None) -> Iterator[str]:
    if show in ("normal", "opposite"):
        side = 1 if show == "normal" else -1
        for k, color in enumerate(CHANNELS):
            place = [0.0, 0.0, 0.0]
            place[k] = side * FARTHEST
            yield f"light_source {{ {_vector(place)}, rgb {color} parallel point_at <0, 0, 0> shadowless }}"
        return
    if show not in ("model", "lights") or not {"diffuse", "specular"} & set(terms):
        return
    for index, light in enumerate(scene.lights):
        color = _vector(_part(light.intensity, sign)) + "*Gain"
        if show == "lights":
            if not first <= index < first + 3:
                continue
            color = CHANNELS[index - first]
        elif only not in (None, index) or not any(_part(light.intensity, sign)):
            continue
        yield f"// light {index}: {_name(light.name)}"
        yield f"light_source {{ {_vector(light.position)}*Unit, rgb {color} }}"


def _surface(
    scene: Scene, index: int, sphere: Sphere, show: Show, terms: Collection[str], mirrors: bool
) -> Iterator[str]:
    color, finish, pigment = "<1, 1, 1>", "diffuse 1", ""
    if show == "model":
        color = _vector(sphere.color)
        parts = [f"ambient {sphere.ka!r}"] if "ambient" in terms and sphere.ka else []
        parts += [f"diffuse {sphere.kd!r}"] if "diffuse" in terms and sphere.kd else []
        parts += [f"phong {sphere.ks!r} phong_size {sphere.exponent!r}"] if "specular" in terms and sphere.ks else []
        parts += [f"reflection {sphere.kr!r}"] if mirrors and sphere.kr else []
        finish = " ".join(parts)
    elif show == "lights":
        # The cosine to the power of 0: 1 wherever light comes from the front and nothing hides it.
        finish = "diffuse 1 brilliance 0"
    elif show == "id":
        color, finish = f"<{index + 1}/{STEPS}, 0, 0>", "emission 1"
    elif show in ("position", "digits"):
        finish, pigment = "emission 1", " ".join(_place(scene, show))
    if not pigment:
        pigment = f"color rgbt <{color[1:-1]}, {TRANSMIT!r}>"
    yield f"#declare Surface_{index} = texture {{"
    yield f"    pigment {{ {pigment} }}"
    yield f"    finish {{ {finish} }}"
    yield "}"


def _place(scene: Scene, show: Show) -> Iterator[str]:
    """A pigment that shows the three coordinates of a point as red, green and blue."""
    corner, edge = box(scene)
    yield "average pigment_map {"
    for k, axis in enumerate("xyz"):
        share = f"({axis}/Unit - ({corner[k]!r}))/{edge!r}"
        if show == "digits":
            share = f"{share}*{DIGITS!r} - floor({share}*{DIGITS!r})"
        # Of three pigments in equal parts each counts a third.
        yield f"[1 function {{ {share} }} color_map {{ [0 rgb 0] [1 rgb 3*{CHANNELS[k]}] }}]"
    yield "}"


def _sphere(scene: Scene, index: int, sphere: Sphere, scale: float) -> Iterator[str]:
    yield f"// sphere {index}: {_name(sphere.name)}"
    if uniform(sphere):
        body = f"sphere {{ {_vector(sphere.position)}*Unit, {abs(sphere.scaling[0])!r}*Unit"
    else:
        radius = ball(sphere, scale)
        body = f"sphere {{ <0, 0, 0>, {radius!r}\n    scale {_vector([abs(s) for s in sphere.scaling])}*Unit/{radius!r}"
        body += f"\n    translate {_vector(sphere.position)}*Unit"
    texture = f"    texture {{ Surface_{index} }}"
    if not before_near(scene, sphere):
        yield from (body, texture, "}")
        return
    if sphere.position[2] - abs(sphere.scaling[2]) < -scene.view.near:
        yield "// what the camera sees of it, behind the near plane"
        yield from (body, texture, "    clipped_by { plane { z, -Near } } no_shadow no_reflection", "}")
    yield "// what shadows and mirrors see of it"
    yield from (body, texture, "    no_image", "}")
