"""Scene, View, Sphere and Light in Python: immutable values that follow the rules of scene files."""

from __future__ import annotations

import copy
import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import coordinates, lights, scenes, spheres, views

import tracer
from tracer import Light, Scene, SceneDiagnostic, SceneError, SceneWarning, Sphere, View, load, loads

VIEW = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=4, rows=3)
SPHERE = Sphere(
    name="s", position=(0, 0, -5), scaling=(1, 2, 3), color=(1, 0, 0.5), ka=0.1, kd=0.6, ks=0.3, kr=0, exponent=50
)
LIGHT = Light(name="l", position=(0, 5, 0), intensity=(1, 2, -3))
SCENE = Scene(view=VIEW, spheres=[SPHERE], lights=[LIGHT])
VALUES = (VIEW, SPHERE, LIGHT, SCENE, SceneDiagnostic(line=1, column=2, field="NEAR", message="m", hint="h"))


def ids(values: tuple[object, ...]) -> list[str]:
    return [type(value).__name__ for value in values]


def big() -> Scene:
    """A scene beyond the limits."""
    many = [SPHERE.replace(position=(i, 0, -5)) for i in range(7)]
    return Scene(view=VIEW.replace(columns=200_000), spheres=many, limits=False)


def test_attributes() -> None:
    assert (VIEW.near, VIEW.left, VIEW.right, VIEW.bottom, VIEW.top) == (1, -1, 1, -1, 1)
    assert (VIEW.columns, VIEW.rows) == (4, 3)
    assert (SPHERE.name, SPHERE.position, SPHERE.scaling) == ("s", (0, 0, -5), (1, 2, 3))
    assert (SPHERE.color, SPHERE.ka, SPHERE.kd, SPHERE.ks, SPHERE.kr) == ((1, 0, 0.5), 0.1, 0.6, 0.3, 0)
    assert SPHERE.exponent == 50
    assert (LIGHT.name, LIGHT.position, LIGHT.intensity) == ("l", (0, 5, 0), (1, 2, -3))
    assert (SCENE.view, SCENE.spheres, SCENE.lights) == (VIEW, (SPHERE,), (LIGHT,))
    assert (SCENE.background, SCENE.ambient, SCENE.output) == ((0, 0, 0), (0, 0, 0), "image.ppm")
    assert SCENE.distinct == (0,)


def test_numbers_are_floats_in_tuples() -> None:
    for vector in (SPHERE.position, SPHERE.scaling, SPHERE.color, LIGHT.position, LIGHT.intensity, SCENE.background):
        assert type(vector) is tuple
        assert all(type(value) is float for value in vector)
    assert type(VIEW.near) is float
    assert type(VIEW.columns) is int
    for sequence in (SCENE.spheres, SCENE.lights, SCENE.distinct):
        assert type(sequence) is tuple


def test_numpy_values_are_taken() -> None:
    view = VIEW.replace(near=np.float32(1), columns=np.int64(4))  # type: ignore[arg-type]
    assert view == VIEW
    light = Light(name="l", position=np.array([0.0, 5.0, 0.0]), intensity=np.array([1, 2, -3]))  # type: ignore[arg-type]
    assert light == LIGHT


@pytest.mark.parametrize("value", VALUES, ids=ids(VALUES))
def test_values_are_immutable(value: Any) -> None:
    for name in [name for name in dir(value) if not name.startswith("_")]:
        if not callable(getattr(value, name)):
            with pytest.raises(AttributeError):
                setattr(value, name, getattr(value, name))
    with pytest.raises(AttributeError):
        value.other = 1
    with pytest.raises(TypeError, match="prohibits subclassing"):
        type("Derived", (type(value),), {})


@pytest.mark.parametrize("value", VALUES, ids=ids(VALUES))
def test_equality_repr_pickle_and_copy(value: Any) -> None:
    text = repr(value)
    assert text.startswith(type(value).__name__ + "(")
    again = eval(text, vars(tracer).copy())
    unpickled = [pickle.loads(pickle.dumps(value, protocol)) for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1)]
    for other in (again, *unpickled, copy.copy(value), copy.deepcopy(value)):
        assert other == value
        assert (other != value) is False
        assert hash(other) == hash(value)
        assert repr(other) == text
    assert value != text
    assert value != None  # noqa: E711
    assert len({value, again}) == 1


@given(scenes() | scenes(extreme=True))
def test_every_scene_has_an_evaluable_repr_and_pickles(scene: Scene) -> None:
    assert eval(repr(scene), vars(tracer).copy()) == scene
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert scene.replace() == scene


@given(views(), views())
def test_equal_views_have_equal_attributes(a: View, b: View) -> None:
    names = ("near", "left", "right", "bottom", "top", "columns", "rows")
    same = all(getattr(a, name) == getattr(b, name) for name in names)
    assert (a == b) is same
    if same:
        assert hash(a) == hash(b)


DIFFERENT: dict[Any, dict[str, Any]] = {
    VIEW: {"near": 2, "left": -3, "right": 2, "bottom": -3, "top": 2, "columns": 5, "rows": 4},
    SPHERE: {
        "name": "other",
        "position": (0, 1, -5),
        "scaling": (1, 2, 4),
        "color": (0, 0, 0),
        "ka": 0.2,
        "kd": 0.2,
        "ks": 0.2,
        "kr": 0.2,
        "exponent": 2,
    },
    LIGHT: {"name": "other", "position": (1, 5, 0), "intensity": (0, 0, 0)},
    SCENE: {
        "view": VIEW.replace(near=3),
        "spheres": (),
        "lights": (LIGHT, LIGHT),
        "background": (0, 0, 1),
        "ambient": (0, 1, 0),
        "output": "other.ppm",
    },
}


@pytest.mark.parametrize("value", VALUES[:4], ids=ids(VALUES[:4]))
def test_replace_changes_one_attribute_and_equality_sees_it(value: Any) -> None:
    for name, new in DIFFERENT[value].items():
        changed = value.replace(**{name: new})
        assert getattr(changed, name) == new
        assert changed != value
        assert hash(changed) != hash(value)
        assert changed.replace(**{name: getattr(value, name)}) == value
    with pytest.raises(TypeError, match=f"{type(value).__name__} has no attribute 'nonsense'"):
        value.replace(nonsense=1)


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: View(near=1), TypeError),  # type: ignore[call-arg]
        (lambda: View(1, -1, 1, -1, 1, 4, 3), TypeError),  # type: ignore[call-arg]
        (lambda: VIEW.replace(near="1"), TypeError),  # type: ignore[arg-type]
        (lambda: VIEW.replace(columns=4.0), TypeError),  # type: ignore[arg-type]
        (lambda: VIEW.replace(columns=2**63), OverflowError),
        (lambda: LIGHT.replace(position=(1, 2)), TypeError),
        (lambda: LIGHT.replace(position=(1, 2, 3, 4)), TypeError),
        (lambda: LIGHT.replace(position="123"), TypeError),  # type: ignore[arg-type]
        (lambda: LIGHT.replace(name=b"l"), TypeError),  # type: ignore[arg-type]
        (lambda: SCENE.replace(spheres=[LIGHT]), TypeError),  # type: ignore[list-item]
        (lambda: SCENE.replace(view=None), TypeError),  # type: ignore[arg-type]
        (lambda: loads(5), TypeError),  # type: ignore[arg-type]
        (lambda: loads(SCENE.text(), True), TypeError),  # type: ignore[call-arg]
    ],
)
def test_wrong_types(make: Callable[[], object], error: type[Exception]) -> None:
    with pytest.raises(error):
        make()


# ----------------------------------------------------------------------------------------------------------------------
# Scenes made in code follow the rules of files

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"view": VIEW.replace(near=0)}, ["NEAR: found '0' for 'n', expected a number above 0"]),
        ({"view": VIEW.replace(near=NAN)}, ["NEAR: found 'nan' for 'n', expected a number above 0"]),
        ({"view": VIEW.replace(near=INF)}, ["NEAR: found 'inf' for 'n', expected a magnitude from 1e-100 to 1e100"]),
        (
            {"view": VIEW.replace(left=NAN, top=-INF)},
            [
                "LEFT: found 'nan' for 'l', expected 0 or a magnitude from 1e-100 to 1e100",
                "TOP: found '-inf' for 't', expected 0 or a magnitude from 1e-100 to 1e100",
            ],
        ),
        (
            {"view": VIEW.replace(left=1, top=-1.5)},
            [
                "LEFT is 1 and RIGHT is 1, expected LEFT < RIGHT",
                "BOTTOM is -1 and TOP is -1.5, expected BOTTOM < TOP",
            ],
        ),
        (
            {"view": VIEW.replace(columns=0, rows=-(2**63))},
            [
                "RES: found '0' for 'columns', expected an integer of at least 1",
                "RES: found '-9223372036854775808' for 'rows', expected an integer of at least 1",
            ],
        ),
        ({"view": VIEW.replace(rows=100_001)}, ["RES: found '100001' for 'rows', expected at most 100000"]),
        (
            {"view": VIEW.replace(columns=2**63 - 1), "limits": False},
            ["RES: found '9223372036854775807' for 'columns', expected an integer below 2^63 - 1"],
        ),
        (
            {"view": VIEW.replace(columns=2**32, rows=2**31), "limits": False},
            ["RES: found 4294967296 x 2147483648 pixels, expected a number of pixels that 64 bits can count"],
        ),
        ({"lights": [LIGHT] * 6}, ["found 6 lights, expected at most 5"]),
        (
            {"spheres": [SPHERE, SPHERE.replace(name="", position=(0, 1e-101, NAN))]},
            [
                "SPHERE: found '' for 'name' of spheres[1], expected printable characters without blanks",
                "SPHERE: found '1e-101' for 'pos y' of spheres[1], expected 0 or a magnitude from 1e-100 to 1e100",
                "SPHERE: found 'nan' for 'pos z' of spheres[1], expected 0 or a magnitude from 1e-100 to 1e100",
            ],
        ),
        (
            {"spheres": [SPHERE.replace(scaling=(0, -0.0, 1e101))]},
            [
                "SPHERE: found '0' for 'scl x' of spheres[0], expected a number other than 0",
                "SPHERE: found '0' for 'scl y' of spheres[0], expected a number other than 0",
                "SPHERE: found '1e+101' for 'scl z' of spheres[0], expected a magnitude from 1e-100 to 1e100",
            ],
        ),
        (
            {"spheres": [SPHERE.replace(color=(NAN, -1, 2), ka=NAN, kd=1.5, ks=-1, kr=INF, exponent=NAN)]},
            [
                "SPHERE: found 'nan' for 'r' of spheres[0], expected a number from 0 to 1",
                "SPHERE: found '-1' for 'g' of spheres[0], expected a number from 0 to 1",
                "SPHERE: found '2' for 'b' of spheres[0], expected a number from 0 to 1",
                "SPHERE: found 'nan' for 'Ka' of spheres[0], expected a number from 0 to 1",
                "SPHERE: found '1.5' for 'Kd' of spheres[0], expected a number from 0 to 1",
                "SPHERE: found '-1' for 'Ks' of spheres[0], expected a number from 0 to 1",
                "SPHERE: found 'inf' for 'Kr' of spheres[0], expected a number from 0 to 1",
                "SPHERE: found 'nan' for 'n' of spheres[0], expected a finite number of at least 0",
            ],
        ),
        (
            {"lights": [LIGHT, LIGHT.replace(name="two words", position=(INF, 0, 0), intensity=(0, 0, NAN))]},
            [
                "LIGHT: found 'two words' for 'name' of lights[1], expected printable characters without blanks",
                "LIGHT: found 'inf' for 'pos x' of lights[1], expected 0 or a magnitude from 1e-100 to 1e100",
                "LIGHT: found 'nan' for 'Ib' of lights[1], expected 0 or a magnitude from 1e-100 to 1e100",
            ],
        ),
        (
            {"background": (NAN, 0, INF), "ambient": (0, NAN, 0), "output": "a\nb"},
            [
                "BACK: found 'nan' for 'r', expected a finite number",
                "BACK: found 'inf' for 'b', expected a finite number",
                "AMBIENT: found 'nan' for 'Ig', expected 0 or a magnitude from 1e-100 to 1e100",
                "OUTPUT: found 'a\\x0ab' for 'file name', expected printable characters without blanks",
            ],
        ),
        ({"output": ""}, ["OUTPUT: found '' for 'file name', expected printable characters without blanks"]),
        (
            {"lights": [LIGHT.replace(name="x" * 21)]},
            [f"LIGHT: found '{'x' * 21}' (21 bytes) for 'name' of lights[0], expected at most 20 bytes"],
        ),
    ],
)
def test_wrong_scenes(changes: dict[str, Any], expected: list[str]) -> None:
    with pytest.raises(SceneError) as caught:
        SCENE.replace(**changes)
    assert [error.message for error in caught.value.errors] == expected
    assert {(error.line, error.column) for error in caught.value.errors} == {(0, 0)}
    assert str(caught.value).startswith(f"Scene: error: {expected[0]}")


@given(views(), st.lists(spheres(), max_size=7), st.lists(lights(), max_size=7), coordinates())
@pytest.mark.filterwarnings("ignore::tracer.SceneWarning")
def test_code_and_text_are_judged_alike(view: View, many: list[Sphere], several: list[Light], odd: float) -> None:
    scene = Scene(view=view, spheres=many, lights=several, background=(odd, odd, odd), limits=False)
    try:
        scene.replace(limits=True)
        in_code = []
    except SceneError as error:
        in_code = [found.message for found in error.errors]
    try:
        loads(scene.text())
        in_text = []
    except SceneError as error:
        in_text = [found.message for found in error.errors]
    assert in_code == in_text
    assert len(in_code) == (len(many) > 5) + (len(several) > 5)


def test_scenes_beyond_the_limits() -> None:
    scene = big()
    assert loads(scene.text(), limits=False) == scene
    assert pickle.loads(pickle.dumps(scene)) == copy.deepcopy(scene) == scene
    assert repr(scene).endswith(", limits=False)")
    assert eval(repr(scene), vars(tracer).copy()) == scene
    # A copy has to keep what the original keeps.
    assert scene.replace(output="b.ppm").output == "b.ppm"
    with pytest.raises(SceneError, match="found 7 spheres, expected at most 5"):
        scene.replace(limits=True)
    with pytest.raises(SceneError, match="found 7 spheres, expected at most 5"):
        SCENE.replace(spheres=scene.spheres)
    assert SCENE.replace(spheres=scene.spheres, limits=False).spheres == scene.spheres


def test_duplicates_in_code_warn() -> None:
    with pytest.warns(SceneWarning) as caught:
        scene = SCENE.replace(spheres=[SPHERE, SPHERE.replace(name="t")])
    expected = "Scene: warning: 't' has the centre and the scaling of spheres[0] and is ignored"
    assert [str(warning.message) for warning in caught] == [expected]
    assert scene.distinct == (0,)
    # Neither of these makes a new scene out of what a person wrote.
    assert pickle.loads(pickle.dumps(scene)) == copy.copy(scene) == scene
    assert scene.replace(output="b.ppm").distinct == (0,)


def test_zeros_have_no_sign() -> None:
    light = Light(name="l", position=(-0.0, 0, 0), intensity=(0, -0.0, 0))
    scene = SCENE.replace(lights=[light], background=(-0.0, 0, 0), view=VIEW.replace(left=-0.0))
    for value in (light.position[0], light.intensity[1], scene.background[0], scene.view.left):
        assert math.copysign(1, value) == 1
    assert "-0" not in scene.text()


def test_a_surrogate_is_no_name() -> None:
    with pytest.raises((TypeError, ValueError)):
        LIGHT.replace(name="\ud800")


# ----------------------------------------------------------------------------------------------------------------------
# Files


def test_load(tmp_path: Path) -> None:
    path = tmp_path / "sc\u00e8ne.txt"
    path.write_bytes(SCENE.text().encode())
    assert load(path) == load(str(path)) == SCENE
    path.write_bytes(big().text().encode())
    with pytest.raises(SceneError, match=r"sc\u00e8ne\.txt:6:5: error: RES: found '200000'"):
        load(path)
    assert load(path, limits=False) == big()


def test_load_with_a_name_that_is_not_text(tmp_path: Path) -> None:
    name = os.fsencode(tmp_path) + b"/\xff.txt"
    path = Path(os.fsdecode(name))
    path.write_bytes(b"")
    with pytest.raises(SceneError, match=r"/\\xff\.txt:1:1: error: the file is empty"):
        load(path)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="missing"):
        load(tmp_path / "missing")
    with pytest.raises(IsADirectoryError):
        load(tmp_path)


def test_scene_error_pickles() -> None:
    with pytest.raises(SceneError) as caught:
        loads("NEAR x")
    again = pickle.loads(pickle.dumps(caught.value))
    assert type(again) is SceneError
    assert issubclass(SceneError, ValueError)
    assert str(again) == str(caught.value)
    assert again.errors == caught.value.errors
    assert len(again.errors) == 2


def test_import_is_quick_and_loads_nothing_heavy() -> None:
    code = "import sys, tracer; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"mitsuba", "drjit", "scipy", "matplotlib", "PIL", "colour", "OpenEXR"} & set(done.stdout.split())


# ----------------------------------------------------------------------------------------------------------------------
# float32

FAR = "expected a magnitude from 1e-15 to 1e15 in float32"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"view": VIEW.replace(near=9e-16)}, [f"NEAR: found '9e-16' for 'n', {FAR}"]),
        (
            {"spheres": [SPHERE.replace(position=(1.1e15, 0, -5), scaling=(1, -1e-16, 1), exponent=1e16)]},
            [
                f"SPHERE: found '1.1e+15' for 'pos x' of spheres[0], {FAR}",
                f"SPHERE: found '-1e-16' for 'scl y' of spheres[0], {FAR}",
                "SPHERE: found '1e+16' for 'n' of spheres[0], expected a magnitude of at most 1e15 in float32",
            ],
        ),
        (
            {"lights": [LIGHT, LIGHT.replace(intensity=(1e-20, 0, -1e20))]},
            [
                f"LIGHT: found '1e-20' for 'Ir' of lights[1], {FAR}",
                f"LIGHT: found '-1e+20' for 'Ib' of lights[1], {FAR}",
            ],
        ),
        (
            {"background": (1e300, 1e-300, 0), "ambient": (1e16, 0, 0)},
            [
                "BACK: found '1e+300' for 'r', expected a magnitude of at most 1e15 in float32",
                f"AMBIENT: found '1e+16' for 'Ir', {FAR}",
            ],
        ),
    ],
    ids=["near", "sphere", "light", "colors"],
)
def test_what_float32_cannot_render(changes: dict[str, Any], expected: list[str]) -> None:
    scene = SCENE.replace(**changes)
    with pytest.raises(SceneError) as caught:
        tracer.render(scene, precision="f32")
    assert [error.message for error in caught.value.errors] == expected
    assert {error.hint for error in caught.value.errors} == {"render it in float64"}
    assert "beauty" in tracer.render(scene, precision="f64")


def test_float32_at_the_ends_of_its_range() -> None:
    sphere = SPHERE.replace(position=(1e15, 1e-15, -1e15), scaling=(1e-15, 1e15, 1), exponent=1e15)
    tracer.render(SCENE.replace(spheres=[sphere], view=VIEW.replace(near=1e-15)), precision="f32")
