"""The bundled scenes: every one loads and is listed, and every scene of scenes/spec really exercises its clause."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tracer
from tracer import Scene
from tracer.passes import quantise

SCENES = Path(__file__).resolve().parent.parent / "scenes"
GALLERY = sorted((SCENES / "gallery").glob("*.txt"))
SPEC = sorted((SCENES / "spec").glob("*.txt"))
HARD = sorted((SCENES / "hard").glob("*.txt"))

Check = Callable[[Scene], None]
CLAUSES: dict[str, Check] = {}


def clause(name: str) -> Callable[[Check], Check]:
    """Registers what has to hold for the scene of that name."""

    def register(check: Check) -> Check:
        assert name not in CLAUSES
        CLAUSES[name] = check
        return check

    return register


def load(path: Path) -> Scene:
    """The scene; only the one about duplicates warns."""
    if path.stem != "duplicate-spheres":
        return tracer.load(path)
    with pytest.warns(tracer.SceneWarning, match="ignored"):
        return tracer.load(path)


def draw(scene: Scene, name: str = "beauty", **settings: Any) -> NDArray[Any]:
    return tracer.render(scene, [name], **settings)[name]


def changed(a: NDArray[Any], b: NDArray[Any]) -> int:
    """The number of pixels that differ."""
    different = a != b
    return int(np.count_nonzero(different.any(axis=-1) if different.ndim == 3 else different))


def with_sphere(scene: Scene, index: int, **changes: Any) -> Scene:
    spheres = list(scene.spheres)
    spheres[index] = spheres[index].replace(**changes)
    return scene.replace(spheres=spheres)


def with_light(scene: Scene, index: int, **changes: Any) -> Scene:
    lights = list(scene.lights)
    lights[index] = lights[index].replace(**changes)
    return scene.replace(lights=lights)


def without_sphere(scene: Scene, index: int) -> Scene:
    return scene.replace(spheres=[sphere for i, sphere in enumerate(scene.spheres) if i != index])


def raw(name: str) -> bytes:
    return (SCENES / "spec" / f"{name}.txt").read_bytes()


# All scenes


@pytest.mark.parametrize("path", GALLERY + SPEC + HARD, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_loads_and_round_trips(path: Path) -> None:
    scene = load(path)
    assert scene.output == f"{path.stem}.ppm"
    if path.stem == "duplicate-spheres":
        with pytest.warns(tracer.SceneWarning):
            again = tracer.loads(scene.text())
    else:
        again = tracer.loads(scene.text())
    assert again == scene
    assert again.text() == scene.text()


@pytest.mark.parametrize("path", GALLERY + SPEC + HARD, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_keeps_to_the_limits_and_shows_something(path: Path) -> None:
    scene = load(path)
    assert len(scene.spheres) <= 5
    assert len(scene.lights) <= 5
    if path.stem not in ("no-spheres", "one-pixel"):
        image = draw(scene)
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 1


def test_the_readme_lists_every_scene_once() -> None:
    text = (SCENES / "README.md").read_text(encoding="utf-8")
    for folder, paths in (("gallery", GALLERY), ("spec", SPEC), ("hard", HARD)):
        listed = re.findall(rf"\(({folder}/[a-z0-9-]+\.txt)\)", text)
        assert sorted(listed) == [f"{folder}/{path.name}" for path in paths]


# The gallery


def test_gallery_scenes_are_drawn_in_color() -> None:
    assert len(GALLERY) >= 5
    for path in GALLERY:
        image = quantise(draw(load(path)))
        assert image.shape == (400, 400, 3)
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100, path.name


def test_gallery_mirrors_reflect_each_other_three_deep() -> None:
    third = draw(load(SCENES / "gallery" / "mirrors.txt"), "reflection.3")
    assert np.count_nonzero(third.any(axis=-1)) > 1000


def test_gallery_lantern_is_cut_by_the_near_plane_with_a_light_inside() -> None:
    scene = load(SCENES / "gallery" / "lantern.txt")
    bowl, flame = scene.spheres[0], scene.lights[0]
    assert bowl.position[2] + bowl.scaling[2] > -scene.view.near > bowl.position[2] - bowl.scaling[2]
    assert math.dist(flame.position, bowl.position) < bowl.scaling[0]


def test_gallery_plates_are_strongly_non_uniform() -> None:
    for sphere in load(SCENES / "gallery" / "plates.txt").spheres:
        assert max(sphere.scaling) >= 20 * min(sphere.scaling) * (1 - 2.0**-52)


# The clauses: the format


@clause("field-order")
def _(scene: Scene) -> None:
    data = raw("field-order")
    assert data.count(b"\r\n") == data.count(b"\n") == data.count(b"\r") > 0
    fields = [line.split()[0] for line in data.decode().split("\r\n") if line]
    assert fields[0] == "OUTPUT"
    assert fields[-1] == "NEAR"
    # Spheres and lights keep the order of the file.
    assert [sphere.name for sphere in scene.spheres] == ["second", "first"]
    assert [light.name for light in scene.lights] == ["below", "above"]


@clause("line-ends")
def _(scene: Scene) -> None:
    data = raw("line-ends")
    assert b"\n" not in data
    assert b"\r\r" in data
    assert b"\t" in data
    assert b" \t \r" in data
    assert not data.endswith(b"\r")
    assert tracer.loads(data.replace(b"\r", b"\n")) == scene


@clause("numbers")
def _(scene: Scene) -> None:
    assert scene.view == tracer.View(near=1, left=-0.5, right=0.5, bottom=-0.5, top=0.5, columns=400, rows=400)
    sphere = scene.spheres[0]
    assert (sphere.position, sphere.scaling) == ((0, 0, -8), (1.5, 1.5, 1.5))
    assert (sphere.color, sphere.exponent) == ((0.9, 0.6, 0.2), 10)
    assert (sphere.ka, sphere.kd, sphere.ks, sphere.kr) == (0.3, 0.7, 0.4, 0)
    assert (scene.lights[0].position, scene.lights[0].intensity) == ((-4, 5, -3), (0.8, 0.7, 0.6))


@clause("shared-name")
def _(scene: Scene) -> None:
    assert scene.spheres[0].name == scene.spheres[1].name
    assert scene.lights[0].name == scene.lights[1].name
    assert set(np.unique(draw(scene, "id"))) == {-1, 0, 1}
    for light in (0, 1):
        assert changed(draw(scene), draw(with_light(scene, light, intensity=(0, 0, 0)))) > 1000


@clause("duplicate-spheres")
def _(scene: Scene) -> None:
    assert scene.distinct == (0, 2)
    assert [abs(s) for s in scene.spheres[1].scaling] == list(scene.spheres[0].scaling)
    image, ids = draw(scene), draw(scene, "id")
    assert changed(image, draw(without_sphere(scene, 1))) == 0
    assert set(np.unique(ids)) == {-1, 0, 2}
    assert changed(image, draw(without_sphere(scene, 0))) > 1000


@clause("negative-scalings")
def _(scene: Scene) -> None:
    plain = scene
    for i, sphere in enumerate(scene.spheres):
        assert min(sphere.scaling) < 0
        plain = with_sphere(plain, i, scaling=[abs(s) for s in sphere.scaling])
    for name in ("beauty", "normal", "id"):
        assert changed(draw(scene, name), draw(plain, name)) == 0


@clause("no-spheres")
def _(scene: Scene) -> None:
    assert not scene.spheres
    assert scene.lights
    assert (draw(scene) == scene.background).all()


@clause("no-lights")
def _(scene: Scene) -> None:
    assert not scene.lights
    assert all(sphere.kd > 0 and sphere.ks > 0 for sphere in scene.spheres)
    assert not draw(scene, "direct").any()
    assert draw(scene, "ambient").any()
    assert draw(scene, "reflection").any()


@clause("one-pixel")
def _(scene: Scene) -> None:
    assert (scene.view.columns, scene.view.rows) == (1, 1)
    # The corner's ray is (0, 0, -1); the centre's misses.
    sphere = scene.spheres[0]
    expected = [o * (sphere.ka * i + sphere.kd) for o, i in zip(sphere.color, scene.ambient, strict=True)]
    assert draw(scene)[0, 0].tolist() == pytest.approx(expected, rel=2.0**-50)
    assert draw(scene, "id", sample="center").tolist() == [[-1]]


# The clauses: the camera


@clause("off-centre-frustum")
def _(scene: Scene) -> None:
    view = scene.view
    x, y = (view.left + view.right) / 2, (view.bottom + view.top) / 2
    assert x != 0
    assert y != 0
    centred = view.replace(left=view.left - x, right=view.right - x, bottom=view.bottom - y, top=view.top - y)
    assert changed(draw(scene, "id"), draw(scene.replace(view=centred), "id")) > 1000
    # The middle sphere's centre is straight ahead: column 400 * 1 / 1.5, row 400 * 1.125 / 1.5.
    columns, rows = np.nonzero(draw(scene, "id").T == 1)
    assert (columns.mean(), rows.mean()) == pytest.approx((266.67, 300), abs=1)


@clause("non-square-pixels")
def _(scene: Scene) -> None:
    view = scene.view
    assert (view.right - view.left) / view.columns == 2 * (view.top - view.bottom) / view.rows
    # The outline of a ball of radius r at distance D is a circle of radius r / sqrt(D^2 - r^2) on the plane z = -1.
    radius = 2 / math.sqrt(8**2 - 2**2)
    rows, columns = np.nonzero(draw(scene, "id") == 0)
    assert np.ptp(columns) == pytest.approx(2 * radius / 2 * 400, abs=2)
    assert np.ptp(rows) == pytest.approx(2 * radius / 1 * 400, abs=2)


@clause("wide-image")
def _(scene: Scene) -> None:
    assert (scene.view.columns, scene.view.rows) == (640, 160)
    assert draw(scene).shape == (160, 640, 3)
    assert set(np.unique(draw(scene, "id"))) == {-1, 0, 1, 2}


@clause("cut-by-near-plane")
def _(scene: Scene) -> None:
    nearer = scene.replace(view=scene.view.replace(near=1, left=-2 / 3, right=2 / 3, bottom=-2 / 3, top=2 / 3))
    assert changed(draw(scene, "depth"), draw(nearer, "depth")) > 10000
    seen = draw(scene, "id") == 0
    # The inside of the bowl: normals turned to the eye, and so to the middle.
    outward = draw(scene, "position")[seen] - np.array(scene.spheres[0].position)
    assert ((draw(scene, "normal")[seen] * outward).sum(axis=-1) < 0).all()
    assert draw(scene, "diffuse")[seen].all()


@clause("before-near-plane")
def _(scene: Scene) -> None:
    unseen = scene.spheres[1]
    assert unseen.position[2] - unseen.scaling[2] > -scene.view.near
    _casts_and_reflects(scene, 1)


@clause("behind-eye")
def _(scene: Scene) -> None:
    unseen = scene.spheres[2]
    assert unseen.position[2] - unseen.scaling[2] > 0
    _casts_and_reflects(scene, 2)


def _casts_and_reflects(scene: Scene, unseen: int) -> None:
    """The sphere is not seen, and still in its shadow and in reflections."""
    assert not (draw(scene, "id") == unseen).any()
    for name in ("shadow.L0", "reflection"):
        assert changed(draw(scene, name), draw(without_sphere(scene, unseen), name)) > 100


@clause("eye-inside")
def _(scene: Scene) -> None:
    room = scene.spheres[0]
    assert sum((p / s) ** 2 for p, s in zip(room.position, room.scaling, strict=True)) < 1
    alone = scene.replace(spheres=[room])
    assert (draw(scene, "id") >= 0).all()
    # Alone, the room reflects itself everywhere: the other root of its own sphere.
    assert (draw(alone, "reflection.3") > 0).all()


# The clauses: the surface


@clause("exact-tangents")
def _(scene: Scene) -> None:
    view, sphere = scene.view, scene.spheres[0]
    s, p = [Fraction(v) for v in sphere.scaling], [Fraction(v) for v in sphere.position]
    origin = [-p[k] / s[k] for k in range(3)]
    c = sum(o * o for o in origin) - 1
    # The outline is the circle of 130 pixels about (200, 200); further from it than two pixels there is no doubt.
    rows, columns = np.indices((view.rows, view.columns))
    distance = np.hypot(rows - 200, columns - 200) - 130
    ids = draw(scene, "id")
    assert (ids[distance < -2] == 0).all()
    assert (ids[distance > 2] == -1).all()
    tangents = 0
    for row, column in np.argwhere(abs(distance) <= 2).tolist():
        x = Fraction(view.left) + (Fraction(view.right) - Fraction(view.left)) * column / view.columns
        y = Fraction(view.top) - (Fraction(view.top) - Fraction(view.bottom)) * row / view.rows
        d = [x / s[0], y / s[1], -Fraction(view.near) / s[2]]
        h = sum(a * b for a, b in zip(origin, d, strict=True))
        discriminant = h * h - sum(v * v for v in d) * c
        assert (ids[row, column] == 0) == (discriminant >= 0)
        tangents += discriminant == 0
    # 130^2 is a sum of two squares in 36 ways.
    assert tangents == 36


@clause("equal-hits")
def _(scene: Scene) -> None:
    # The small ellipsoids touch the large ones from inside at (-3, 0, -6) and (3, 0, -6).
    columns = [round((x / 6 - scene.view.left) * 256) for x in (-3, 3)]
    ids = draw(scene, "id")
    assert ids[200, columns].tolist() == [0, 2]
    swapped = [scene.spheres[i] for i in (1, 0, 3, 2)]
    other = draw(scene.replace(spheres=swapped), "id")
    assert other[200, columns].tolist() == [0, 2]
    # Everywhere else the large ones are in front, whatever the order.
    assert np.count_nonzero(ids == 0) == np.count_nonzero(other == 2) == 1
    assert not (ids == 3).any()


@clause("touching-spheres")
def _(scene: Scene) -> None:
    first, second, third = scene.spheres
    for a, b in ((first, second), (second, third), (third, first)):
        assert math.dist(a.position, b.position) == a.scaling[0] + b.scaling[0]
    assert draw(scene, "reflection.3").any()


# The clauses: the terms


@clause("ambient-only")
def _(scene: Scene) -> None:
    assert scene.lights
    _only(scene, "ambient")


@clause("diffuse-only")
def _(scene: Scene) -> None:
    _only(scene, "diffuse")


@clause("specular-only")
def _(scene: Scene) -> None:
    _only(scene, "specular")


def _only(scene: Scene, name: str) -> None:
    """The picture consists of one term."""
    hit = draw(scene, "id") >= 0
    assert draw(scene, name).any()
    assert (draw(scene)[hit] == draw(scene, name)[hit]).all()


@clause("specular-not-times-colour")
def _(scene: Scene) -> None:
    assert scene.spheres[0].color == (0, 0, 0)
    specular = draw(scene, "specular")
    assert specular[draw(scene, "id") == 0].max() > 0.5
    white = with_sphere(with_sphere(scene, 0, color=(1, 1, 1)), 1, color=(1, 1, 1))
    assert changed(specular, draw(white, "specular")) == 0
    assert changed(draw(scene, "diffuse"), draw(white, "diffuse")) > 1000


@clause("exponent-0")
def _(scene: Scene) -> None:
    # Ks Ip or nothing for each of two lights: at most four values, with sharp borders.
    values = np.unique(draw(scene, "specular").reshape(-1, 3), axis=0)
    key, fill = (np.array(light.intensity) * scene.spheres[0].ks for light in scene.lights)
    expected = np.unique([np.zeros(3), key, fill, key + fill], axis=0)
    assert np.allclose(values, expected, rtol=2.0**-50, atol=0)


@clause("exponent-half")
def _(scene: Scene) -> None:
    for other in (0, 1):
        different = draw(with_sphere(scene, 0, exponent=other), "specular")
        assert changed(draw(scene, "specular"), different) > 1000


@clause("exponent-1000")
def _(scene: Scene) -> None:
    specular = draw(scene, "specular").max(axis=-1)
    # (R.V)^1000 is above 1/2 within acos(2^-0.001) = 2.1 degrees: a point for the eye, yet there.
    assert 0 < np.count_nonzero(specular > 0.5 * 0.9 * 0.8) < 100
    assert changed(draw(with_sphere(scene, 0, exponent=999)), draw(scene)) > 1000


@clause("over-range")
def _(scene: Scene) -> None:
    image = draw(scene)
    assert image.max() > 2
    assert quantise(image)[0, 0].tolist() == [255, 0, 127]
    assert quantise(image).max() == 255


@clause("negative-light")
def _(scene: Scene) -> None:
    assert max(scene.lights[1].intensity) < 0
    assert draw(scene).min() < 0
    assert changed(draw(scene), draw(scene.replace(lights=scene.lights[:1]))) > 1000


# The clauses: shadows


def _cosine(scene: Scene, light: int = 0) -> NDArray[Any]:
    """N.L of each pixel; nan where nothing is hit, or the light itself."""
    to_light = np.array(scene.lights[light].position) - draw(scene, "position")
    with np.errstate(invalid="ignore"):
        cosine: NDArray[Any] = (draw(scene, "normal") * to_light).sum(axis=-1) / np.linalg.norm(to_light, axis=-1)
    return np.where(draw(scene, "id") >= 0, cosine, np.nan)


@clause("own-shadow")
def _(scene: Scene) -> None:
    assert len(scene.spheres) == 1
    shadow, cosine = draw(scene, "shadow.L0"), _cosine(scene)
    assert np.count_nonzero(cosine > 0) > 100
    assert np.count_nonzero(cosine < 0) > 10000
    # Beyond the epsilon of 1e-4 the sphere hides exactly the side turned away.
    assert (shadow[cosine < -1e-3] == 0).all()
    assert (shadow[cosine > 1e-3] == 1).all()


@clause("own-shadow-inside")
def _(scene: Scene) -> None:
    # The inside faces the light through the opening, and yet its own missing part is in the way.
    hit = draw(scene, "id") == 0
    assert (_cosine(scene)[hit] > 0).all()
    assert not draw(scene, "shadow.L0").any()
    assert not draw(scene, "direct").any()


@clause("shadow-of-another")
def _(scene: Scene) -> None:
    lit = draw(without_sphere(scene, 1), "diffuse")
    floor = draw(scene, "id") == 0
    shadowed = floor & (draw(scene, "diffuse") == 0).all(axis=-1) & (lit > 0).all(axis=-1)
    assert np.count_nonzero(shadowed) > 1000


@clause("beyond-light")
def _(scene: Scene) -> None:
    floor = draw(scene, "id") == 0
    diffuse = draw(scene, "diffuse")
    assert changed(diffuse[floor], draw(without_sphere(scene, 1), "diffuse")[floor]) == 0
    x, _, z = scene.lights[0].position
    above = with_light(scene, 0, position=(x, 4, z))
    alone = without_sphere(above, 1)
    assert changed(draw(above, "diffuse")[floor], draw(alone, "diffuse")[floor]) > 1000


@clause("light-inside")
def _(scene: Scene) -> None:
    ids, diffuse = draw(scene, "id"), draw(scene, "diffuse")
    bowl = scene.spheres[0]
    assert math.dist(scene.lights[0].position, bowl.position) < bowl.scaling[0]
    outward = (draw(scene, "normal") * (draw(scene, "position") - np.array(bowl.position))).sum(axis=-1) > 0
    inside, outside = (ids == 0) & ~outward, (ids == 0) & outward
    assert min(np.count_nonzero(inside), np.count_nonzero(outside), np.count_nonzero(ids == 1)) > 1000
    assert (diffuse[inside] > 0).all()
    assert not diffuse[outside].any()
    assert not diffuse[ids == 1].any()
    # Without the bowl the other one is lit.
    assert draw(without_sphere(scene, 0), "diffuse").any()


@clause("light-at-centre")
def _(scene: Scene) -> None:
    # N.L = 1 on the whole inside: Kd Ip O everywhere.
    sphere, light = scene.spheres[0], scene.lights[0]
    assert light.position == sphere.position
    hit = draw(scene, "id") == 0
    expected = sphere.kd * np.array(light.intensity) * np.array(sphere.color)
    assert np.allclose(draw(scene, "diffuse")[hit], expected, rtol=2.0**-45, atol=0)


@clause("light-on-surface")
def _(scene: Scene) -> None:
    bowl, light = scene.spheres[0], scene.lights[0]
    assert math.dist(light.position, bowl.position) == bowl.scaling[0]
    ids, shadow = draw(scene, "id"), draw(scene, "shadow.L0")
    below = (ids == 1) & (_cosine(scene) > 0)
    assert np.count_nonzero(below) > 1000
    # Lit on both sides: inside the bowl, and the ceiling that sees the light over the bowl's tangent plane.
    assert (shadow[ids == 0] == 1).all()
    assert (shadow[below] == 1).all()
    moved = with_light(scene, 0, position=(0, 2.125, -4))
    facing = (ids == 0) & (_cosine(moved) > 0)
    assert np.count_nonzero(facing) > 10000
    assert not draw(moved, "shadow.L0")[facing].any()


@clause("light-before-near-plane")
def _(scene: Scene) -> None:
    assert 0 > scene.lights[0].position[2] > -scene.view.near
    assert changed(draw(scene), draw(scene.replace(lights=[]))) > 10000


@clause("shadow-epsilon")
def _(scene: Scene) -> None:
    images = [draw(scene, "shadow.L0", shadow_epsilon=epsilon) for epsilon in (0, 1e-4, 1e-3)]
    assert changed(images[0], images[1]) > 100
    assert changed(images[1], images[2]) > 100


# The clauses: reflection


@clause("mirror-corridor")
def _(scene: Scene) -> None:
    assert scene.spheres[0].kr == scene.spheres[1].kr == 1
    three = draw(scene)
    for bounces in (0, 1, 2, 4):
        assert changed(three, draw(scene, max_reflections=bounces)) > 1000


@clause("reflected-miss")
def _(scene: Scene) -> None:
    assert scene.background == (1, 1, 1)
    mirror = draw(scene, "id") == 0
    empty = mirror & (draw(scene, "reflection") == 0).all(axis=-1)
    assert np.count_nonzero(empty) > 10000
    dark = scene.replace(background=(0, 0, 0))
    assert changed(draw(scene)[mirror], draw(dark)[mirror]) == 0


@clause("pure-mirror")
def _(scene: Scene) -> None:
    id = draw(scene, "id")
    mirrors = [i for i, sphere in enumerate(scene.spheres) if sphere.kr]
    assert any(len(set(scene.spheres[i].scaling)) > 1 for i in mirrors)
    pure = np.isin(id, mirrors)
    assert np.count_nonzero(pure) > 10000
    for name in ("ambient", "diffuse", "specular"):
        assert not draw(scene, name)[pure].any()
    assert np.array_equal(draw(scene)[pure], draw(scene, "reflection")[pure])
    for i in mirrors:
        assert changed(draw(scene), draw(with_sphere(scene, i, color=(1, 0, 0)))) == 0
    assert np.count_nonzero(draw(scene, "reflection.2").any(axis=-1)) > 1000
    # Shadows of both lights show in the mirrors: hardly anything hides a light from so near to it.
    shadowless = draw(scene, "reflection", shadow_epsilon=1 - 2.0**-30)
    for light in (0, 1):
        lit = with_light(scene, light, intensity=(0, 0, 0))
        assert (
            changed(
                draw(scene, "reflection") - draw(lit, "reflection"),
                shadowless - draw(lit, "reflection", shadow_epsilon=1 - 2.0**-30),
            )
            > 1000
        )


@pytest.mark.parametrize("name", sorted(CLAUSES))
def test_spec_scene_exercises_its_clause(name: str) -> None:
    CLAUSES[name](load(SCENES / "spec" / f"{name}.txt"))


def test_every_spec_scene_has_a_check() -> None:
    assert sorted(CLAUSES) == sorted(path.stem for path in SPEC)
