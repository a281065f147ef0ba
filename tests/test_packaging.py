"""The wheel: what is in it, and that it works in a new environment outside the checkout."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import tomllib
import venv
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

pytestmark = pytest.mark.packaging

ROOT = Path(__file__).resolve().parent.parent
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]

CLIENT = '''\
"""A program that uses the package, with every type written down."""
import numpy as np
from numpy.typing import NDArray

import tracer
from tracer import Light, Passes, Scene, SceneError, Sphere, View, reference

view: View = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=8, rows=6)
ball: Sphere = Sphere(
    name="s", position=(0, 0, -3), scaling=(1, 1, 1), color=(1, 0, 0), ka=0.5, kd=0.5, ks=0.5, kr=0.5, exponent=9
)
lamp: Light = Light(name="l", position=(3, 3, 3), intensity=(1, 1, 1))
scene: Scene = Scene(view=view, spheres=(ball,), lights=(lamp,), background=(0, 0, 1))
again: Scene = tracer.loads(scene.text())
position: tuple[float, float, float] = again.spheres[0].position
passes: Passes = tracer.render(scene, ("beauty", "id", "shadow.L0"), precision="f32", threads=1, sample="center")
beauty: NDArray[np.float32] = passes["beauty"]
other: Passes = reference.render(scene, ("beauty",), precision="f32", sample="center")
passes.save("client.exr")
loaded: Passes = Passes.load("client.exr")
try:
    tracer.loads("NEAR x")
except SceneError as problem:
    lines: list[int] = [error.line for error in problem.errors]
version: str = tracer.version()
print(version, beauty.shape, lines[0], bool(np.allclose(beauty, other["beauty"], atol=1e-3)), scene == again)
'''


def call(*command: str | Path, cwd: Path, environment: Mapping[str, str] = os.environ) -> str:
    """The output of a command that has to succeed."""
    result = subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=dict(environment), check=False)
    assert result.returncode == 0, f"{' '.join(map(str, command))}\n{result.stdout}{result.stderr}"
    return result.stdout


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel, and with it and what it says it needs in a new environment.

    It is made once a run of pytest, by the first of pytest-xdist's workers; the folder of the build is kept between
    runs, so that only what changed is compiled again.
    """
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    folder = base / "packaging"
    with (base / "packaging.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            folder.mkdir()
            kept = f"-Cbuild-dir={ROOT / 'build' / 'packaging'}"
            build = ("-m", "build", "--wheel", "--no-isolation", kept, "--outdir", str(folder), str(ROOT))
            call(sys.executable, *build, cwd=folder)
            venv.create(folder / "environment", with_pip=True)
            pip = folder / "environment" / "bin" / "pip"
            call(pip, "install", "--quiet", "--disable-pip-version-check", *folder.glob("*.whl"), cwd=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(shared: Path) -> Path:
    """The wheel of the checkout."""
    (made,) = shared.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def environment(shared: Path) -> Path:
    """The folder of the programs of the new environment."""
    return shared / "environment" / "bin"


def test_contents(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {"tracer/__init__.py", "tracer/py.typed", "tracer/_native.pyi", "tracer/reference.py"} <= names
    assert {"converters/__init__.py", "converters/mitsuba.py", "validation/__init__.py", "validation/cli.py"} <= names
    assert any(name.startswith("tracer/_native.") and name.endswith(".so") for name in names)
    assert any(name.endswith(".data/scripts/raytrace") for name in names)
    sources = {path.relative_to(ROOT).as_posix() for path in ROOT.glob("validation/**/*") if path.is_file()}
    assert {name for name in sources if "__pycache__" not in name} <= names
    for unwanted in (".cpp", ".hpp", ".o", ".a", ".pyc"):
        assert not [name for name in names if name.endswith(unwanted)]
    top = {name.split("/")[0] for name in names}
    assert {name for name in top if not name.startswith("whitted-")} == {"tracer", "converters", "validation"}


def test_metadata(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = archive.read(name).decode()
        licences = [name for name in archive.namelist() if name.endswith(".dist-info/licenses/LICENSE")]
        assert archive.read(licences[0]).startswith(b"MIT License")
    assert f"\nVersion: {VERSION}\n" in metadata
    assert "\nLicense-Expression: MIT\n" in metadata


def test_raytrace(environment: Path, tmp_path: Path) -> None:
    scene = next((ROOT / "scenes" / "gallery").glob("*.txt"))
    (tmp_path / "scene.txt").write_text(scene.read_text())
    assert call(environment / "raytrace", "scene.txt", "-o", "image.ppm", cwd=tmp_path, environment={}) == ""
    assert (tmp_path / "image.ppm").read_bytes().startswith(b"P6\n")
    assert call(environment / "raytrace", "--version", cwd=tmp_path).startswith(f"raytrace {VERSION} (")


def test_whitted(environment: Path, tmp_path: Path) -> None:
    assert VERSION in call(environment / "whitted", "--version", cwd=tmp_path)
    listed = call(environment / "whitted", "renderers", cwd=tmp_path)
    for name in ("native-f64", "native-f32", "numpy-f64", "numpy-f32", "mitsuba-spec"):
        assert name in listed


def test_python(environment: Path, tmp_path: Path) -> None:
    """From outside the checkout, so that what is imported is what is installed."""
    (tmp_path / "client.py").write_text(CLIENT)
    assert (
        call(environment / "python", "-W", "error", "client.py", cwd=tmp_path) == f"{VERSION} (6, 8, 3) 1 True True\n"
    )
    script = "import tracer, converters.mitsuba, validation; print(tracer.__file__, validation.__file__)"
    for path in call(environment / "python", "-c", script, cwd=tmp_path).split():
        assert Path(path).is_relative_to(environment.parent)


def test_types(environment: Path, tmp_path: Path) -> None:
    """The stub and py.typed reach a user's type checker."""
    (tmp_path / "client.py").write_text(CLIENT)
    checker = (sys.executable, "-m", "mypy", "--strict", "--python-executable", str(environment / "python"))
    assert "Success" in call(*checker, "client.py", cwd=tmp_path)
    (tmp_path / "wrong.py").write_text("import tracer\nx: int = tracer.version()\ntracer.load(3)\n")
    result = subprocess.run([*checker, "wrong.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "wrong.py:2: error: " in result.stdout
    assert "wrong.py:3: error: " in result.stdout
