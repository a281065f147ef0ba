"""Random scenes: the same for the same seed, hard in every way they claim; planted defects are found and made small."""

from __future__ import annotations

import collections
import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from conftest import strict
from doubles import Double, with_arrays, with_patch
from planted import no_shadows, unchanged, wrong_normals

import tracer
from tracer import Light, Scene, Sphere
from tracer.passes import Passes
from validation import Settings, fuzz, validate
from validation.fuzz import Campaign, Kind
from validation.minimise import minimise, size
from validation.random_scenes import THEMES, TWISTS, Drawn, draw_scene

MANY = [draw_scene(0, index) for index in range(30 * len(THEMES))]


def of(theme: str) -> list[Scene]:
    """All scenes of a theme that no twist has changed."""
    return [drawn.scene for drawn in MANY if drawn.theme == theme and not drawn.twists]


def surface(light: Light, sphere: Sphere) -> Fraction:
    """0 for a light on the surface, -1 at the centre: exactly."""
    terms = zip(light.position, sphere.position, sphere.scaling, strict=True)
    return sum((((Fraction(p) - Fraction(c)) / Fraction(s)) ** 2 for p, c, s in terms), Fraction(-1))


# ---- the scenes


def test_a_scene_follows_from_its_seed_and_index_alone() -> None:
    assert [draw_scene(0, index) for index in (17, 3)] == [MANY[17], MANY[3]]
    assert draw_scene(1, 17).scene != MANY[17].scene
    texts = {drawn.scene.text() for drawn in MANY}
    assert len(texts) == len(MANY)
    code = "from validation.random_scenes import draw_scene; print(draw_scene(0, 17).scene.text(), end='')"
    for hashes in ("1", "2"):
        environment = os.environ | {"PYTHONHASHSEED": hashes}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout == MANY[17].scene.text()


def test_scenes_keep_to_the_format() -> None:
    for drawn in MANY:
        scene = drawn.scene
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tracer.SceneWarning)
            assert tracer.loads(scene.text()) == scene
        assert 1 <= len(scene.spheres) <= 5
        assert len(scene.lights) <= 5
        assert 24 <= scene.view.columns <= 64
        assert 24 <= scene.view.rows <= 64
        lengths = [abs(value) for sphere in scene.spheres for value in (*sphere.position, *sphere.scaling)]
        assert max(lengths) <= 5000 * 5
        assert min(abs(value) for sphere in scene.spheres for value in sphere.scaling) > 1e-5


def test_every_theme_and_twist_comes() -> None:
    themes = collections.Counter(drawn.theme for drawn in MANY)
    assert set(themes.values()) == {30}
    assert set(themes) == set(THEMES)
    twists = collections.Counter(twist for drawn in MANY for twist in drawn.twists)
    for twist, share in TWISTS.items():
        assert 0.5 * share < twists[twist.__name__] / len(MANY) < 1.6 * share
    assert {drawn.theme for drawn in (draw_scene(4, index) for index in range(40, 40 + len(THEMES)))} == set(THEMES)


def test_themes_are_what_they_claim() -> None:
    def shares(theme: str, holds: Any) -> float:
        scenes = of(theme)
        return sum(map(holds, scenes)) / len(scenes)

    def cut(scene: Scene) -> bool:
        return any(abs(sphere.position[2] + scene.view.near) < sphere.scaling[2] for sphere in scene.spheres)

    def around_the_eye(scene: Scene) -> bool:
        eye = Light(name="eye", position=(0, 0, 0), intensity=(1, 1, 1))
        return any(surface(eye, sphere) < 0 for sphere in scene.spheres)

    def on_surfaces(scene: Scene) -> bool:
        return any(abs(surface(light, sphere)) < 1e-12 for light in scene.lights for sphere in scene.spheres)

    def touch(scene: Scene) -> bool:
        pairs = [(a, b) for a in scene.spheres for b in scene.spheres if a is not b]
        gaps = [np.linalg.norm(np.subtract(a.position, b.position)) for a, b in pairs]
        sums = [(a.scaling[0] + b.scaling[0], abs(a.scaling[0] - b.scaling[0])) for a, b in pairs]
        return any(min(abs(gap - each) for each in both) < 1e-12 for gap, both in zip(gaps, sums, strict=True))

    def thin(scene: Scene) -> bool:
        return any(max(sphere.scaling) >= 9 * min(sphere.scaling) for sphere in scene.spheres)

    assert shares("cut", cut) > 0.8
    assert shares("inside", around_the_eye) > 0.8
    assert shares("lamps", on_surfaces) > 0.3
    assert shares("touching", touch) == 1
    assert shares("flat", thin) == 1
    assert shares("giant", lambda scene: max(sphere.scaling[0] for sphere in scene.spheres) >= 30) == 1
    assert shares("corridor", lambda scene: sum(sphere.kr > 0 for sphere in scene.spheres) >= 2) == 1
    assert any(len(scene.distinct) < len(scene.spheres) for scene in of("copies"))
    assert not any(len(scene.distinct) < len(scene.spheres) for scene in of("apart"))


def test_the_whole_format_is_there() -> None:
    scenes = [drawn.scene for drawn in MANY]
    spheres = [sphere for scene in scenes for sphere in scene.spheres]
    lights = [light for scene in scenes for light in scene.lights]
    assert {len(scene.spheres) for scene in scenes} == {1, 2, 3, 4, 5}
    assert {len(scene.lights) for scene in scenes} == {0, 1, 2, 3, 4, 5}
    for name in ("ka", "kd", "ks", "kr"):
        assert {0.0, 1.0} < {getattr(sphere, name) for sphere in spheres}
    exponents = {sphere.exponent for sphere in spheres}
    assert {0.0, 1.0, 1000.0} < exponents
    assert any(0 < n < 1 for n in exponents)
    assert any(n % 1 for n in exponents if n > 1)
    assert any(min(sphere.scaling) < 0 for sphere in spheres)
    assert any(light.intensity == (0, 0, 0) for light in lights)
    assert any(min(light.intensity) < 0 for light in lights)
    assert any(len(set(light.intensity)) == 3 for light in lights)
    assert any(light.position == sphere.position for scene in scenes for light in scene.lights for sphere in spheres)
    exact = [surface(light, sphere) for scene in scenes for light in scene.lights for sphere in scene.spheres]
    assert 0 in exact
    assert any(0 < abs(value) < 1e-14 for value in exact)
    views = [scene.view for scene in scenes]
    assert any(view.left > 0 or view.right < 0 for view in views)
    pixels = [(view.right - view.left) / view.columns / ((view.top - view.bottom) / view.rows) for view in views]
    assert any(abs(ratio - 1) > 0.2 for ratio in pixels)
    numbers = [value for sphere in spheres for value in sphere.position]
    assert 0.2 < sum(len(repr(abs(value))) < 7 for value in numbers) / len(numbers) < 0.95


# ---- made smaller


def test_a_scene_is_made_as_small_as_what_it_has_to_show() -> None:
    drawn = next(drawn for drawn in MANY if len(drawn.scene.spheres) == 5 and len(drawn.scene.lights) >= 3)
    scene, tried = drawn.scene, []

    def shows(other: Scene) -> tuple[int, int] | None:
        tried.append(other)
        far = any(abs(sphere.position[0]) > 0.25 and sphere.kd == 1 for sphere in other.spheres)
        return (other.view.columns - 1, 0) if far and other.lights else None

    sphere = scene.spheres[0].replace(kd=1, position=(0.5123456, 1.5123456, -3.5123456))
    scene = scene.replace(spheres=[sphere, *scene.spheres[1:]])
    small = minimise(scene, (scene.view.columns - 1, 0), shows, 60)
    assert small.finished
    assert small.tried == len(tried)
    assert (len(small.scene.spheres), len(small.scene.lights)) == (1, 1)
    assert (small.scene.view.columns, small.scene.view.rows) == (1, 1)
    left = small.scene.spheres[0]
    assert left.position == (0.5, 0, 0)
    assert (left.ka, left.kd, left.ks, left.kr) == (0, 1, 0, 0)
    assert small.scene.lights[0].position == (0, 0, 0)
    assert small.at == (0, 0)
    sizes = [size(other) for other in tried]
    assert max(sizes) < size(scene)


def test_without_time_a_scene_stays_as_it_is() -> None:
    scene = MANY[0].scene
    small = minimise(scene, (1, 2), lambda _: (0, 0), 0)
    assert (small.scene, small.at, small.finished) == (scene, (1, 2), False)


def test_the_window_around_a_pixel_has_the_same_rays() -> None:
    scene = next(drawn.scene for drawn in MANY if drawn.theme == "apart")
    whole = tracer.render(scene, ["position", "id"])
    y, x = (int(place) for place in np.argwhere(whole["id"] >= 0)[40])

    def shows(other: Scene) -> tuple[int, int] | None:
        if (other.view.columns, other.view.rows) != (1, 1):
            return None
        part = tracer.render(other, ["position", "id"])
        near = np.allclose(part["position"][0, 0], whole["position"][y, x], rtol=1e-9, atol=0)
        return (0, 0) if near and part["id"][0, 0] == whole["id"][y, x] else None

    small = minimise(scene, (x, y), shows, 1).scene
    assert (small.view.columns, small.view.rows) == (1, 1)


# ---- defects


def campaign(scenes: int, double: Double, tmp_path: Path, **options: Any) -> Campaign:
    """In this process: what a test makes up cannot be sent."""
    options = {"seed": 0, "jobs": 0, "smaller_seconds": 4.0, "output": tmp_path / "found"} | options
    return fuzz.fuzz(scenes, [double], **options)


FLAT = next(index for index, drawn in enumerate(MANY) if drawn.theme == "flat" and len(drawn.scene.spheres) > 1)


def flat_normals(original: Any, tables: Any, rays: Any, hits: Any) -> Any:
    """Wrong normals, but only of ellipsoids that are flat: no other scene shows them."""
    scaling = tables.scaling
    if not (scaling.max(axis=0) > 8 * scaling.min(axis=0)).any():
        return original(tables, rays, hits)
    return wrong_normals(original, tables, rays, hits)


#: The defect, the indices of the scenes, the passes that show it, and the most spheres that this takes.
PLANTED = {
    "no shadows": (with_patch(hidden=no_shadows), (0, 2), {"shadow.L*"}, 2),
    "normals of flat ellipsoids": (with_patch(surface=flat_normals), (FLAT, 1), {"normal"}, 1),
}


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_defect_is_found_and_made_small(name: str, tmp_path: Path, registered: Any) -> None:
    draw, (first, count), shown_in, most = PLANTED[name]
    double = Double(draw=draw)
    registered(double)
    result = campaign(count, double, tmp_path, first=first)
    assert result.status == 1
    kinds = [kind for kind in result.kinds if kind.renderer == "double" and kind.pass_name in shown_in]
    assert kinds
    assert result.tallies["double"].agree < result.tallies["double"].compared
    for kind in kinds:
        found = result.kinds[kind]
        assert found.path is not None
        small = tracer.load(found.path)
        assert len(small.spheres) <= most
        assert (small.view.columns, small.view.rows) == (1, 1)
        again = validate([found.path], double, "native-f64")
        assert again.status == 1
        assert not again.failures
        record = strict(found.path.with_suffix(".json").read_text())
        before = tracer.loads(record["found_in"])
        assert before == draw_scene(0, record["index"]).scene
        assert size(small) < size(before)
        assert (record["renderer"], record["pixel"]) == ("double", [0, 0])
        assert set(record["values"]) == {"double", "native-f64", "truth"}
        assert record["values"]["double"] != record["values"]["truth"]
        assert record["sentence"].startswith("double ")
        assert record["versions"]["whitted"] == tracer.version()
        assert f"whitted explain {found.path} 0 0 --renderer double,native-f64" in record["commands"]
        assert f"whitted validate {found.path} --renderer double --against native-f64" in record["commands"]
        repeat = f"whitted stability --fuzz 1 --seed 0 --first {record['index']} --renderer double"
        assert repeat in record["commands"]
    # Every kind once, however often it was found, and nothing beside it.
    files = sorted(path.name for path in (tmp_path / "found").iterdir())
    assert len(files) == 2 * len(result.kinds)


def test_no_defect_is_found_where_there_is_none(tmp_path: Path) -> None:
    result = campaign(4, Double(draw=with_patch(hidden=unchanged)), tmp_path)
    assert (result.status, result.kinds, result.failures) == (0, {}, [])
    assert not (tmp_path / "found").exists()


def test_what_all_renderers_have_wrong_truth_finds(tmp_path: Path) -> None:
    wrong = Double(draw=with_patch(hidden=no_shadows))
    other = Double(name="other", draw=wrong.draw)
    result = fuzz.fuzz(
        4, [other], reference=wrong, jobs=0, output=tmp_path, smaller_seconds=2, settings=Settings(threads=1)
    )
    assert {(kind.renderer, kind.what) for kind in result.kinds} == {("double", "disproved")}
    assert result.tallies["other"].agree == result.tallies["other"].compared > 0
    (file, *_) = sorted(tmp_path.glob("*.json"))
    assert "whitted truth " in strict(file.read_text())["commands"][1]


def test_what_is_no_number_is_told(tmp_path: Path) -> None:
    def plant(arrays: doubles.Arrays) -> None:
        arrays["beauty"][3, 5] = np.nan

    result = campaign(2, Double(draw=with_arrays(plant)), tmp_path)
    assert result.status == 1
    told = [found.smallest for kind, found in result.kinds.items() if kind.what == "malformed"]
    assert [failure.at for failure in told] == [(5, 3)]
    assert "double delivered NaN" in told[0].sentence


def test_a_renderer_that_raises_is_told_once(tmp_path: Path) -> None:
    def refuse(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        del passes, settings
        if scene.lights:
            raise RuntimeError(f"{len(scene.spheres)} spheres are too many for me")
        return doubles.faithful(scene, ["id"], Settings())

    result = campaign(4, Double(draw=refuse), tmp_path)
    assert result.status == 3
    broken = {kind: found for kind, found in result.kinds.items() if kind.what == "failed"}
    ((kind, found),) = broken.items()
    assert kind == Kind("double", "failed", "failed: RuntimeError: ... spheres are too many for me")
    assert found.scenes > 1
    small = tracer.load(found.path or "")
    assert (len(small.spheres), len(small.lights)) == (0, 1)


def hang(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """Two spheres take for ever."""
    if len(scene.spheres) > 1:
        time.sleep(1000)
    return doubles.faithful(scene, passes, settings)


def crash(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """Two spheres end the process."""
    if len(scene.spheres) > 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return doubles.faithful(scene, passes, settings)


@pytest.mark.parametrize(("draw", "what"), [(hang, "hangs"), (crash, "crashed")])
def test_a_renderer_that_does_not_come_back(draw: Any, what: str, tmp_path: Path) -> None:
    first = next(k for k in range(99) if len(MANY[k].scene.spheres) > 1 and len(MANY[k + 1].scene.spheres) == 1)
    result = fuzz.fuzz(2, [Double(draw=draw)], first=first, jobs=1, output=tmp_path, scene_seconds=6.0)
    assert (result.status, result.done) == (3, 2)
    ((kind, found),) = result.kinds.items()
    assert kind == Kind("double", what)
    assert found.smallest.index == first
    assert tracer.load(found.path or "").spheres == MANY[first].scene.spheres
    assert result.tallies["double"].scenes == 1, "the other scene was drawn all the same"


def crash_when_small(scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """Wrong in a scene, and the end of the process in a smaller one."""
    if scene != MANY[0].scene:
        os.kill(os.getpid(), signal.SIGKILL)
    drawn = dict(doubles.faithful(scene, passes, settings))
    return Passes(drawn | {"beauty": np.full_like(drawn["beauty"], np.nan)})


def test_a_crash_in_a_smaller_scene_is_of_the_same_scene(tmp_path: Path) -> None:
    result = fuzz.fuzz(1, [Double(draw=crash_when_small)], jobs=1, output=tmp_path)
    assert (result.status, result.done) == (3, 1)
    assert {"malformed", "crashed"} < {kind.what for kind in result.kinds}
    assert sum(result.themes.values()) == 1


# ---- renderers that are right


def test_native_and_numpy_are_one_on_random_scenes(tmp_path: Path) -> None:
    result = fuzz.fuzz(10, ["numpy-f64", "native-f32"], seed=6, jobs=1, output=tmp_path / "found")
    assert (result.status, result.kinds, result.done) == (0, {}, 10)
    for name in ("numpy-f64", "native-f32"):
        tally = result.tallies[name]
        assert tally.scenes == 10
        assert tally.compared == tally.agree > 100
    assert sum(result.themes.values()) == 10
    assert not (tmp_path / "found").exists()


# ---- the command


def test_the_command(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "r.json"
    result = run("stability", "--fuzz", 3, "--renderer", "numpy-f64", "-o", tmp_path / "found", "--json", file)
    assert (result.status, result.err) == (0, "")
    assert "numpy-f64" in result.out
    assert "3 of 3 scenes of seed 0 from index 0" in result.out
    assert result.out.rstrip().endswith("all explained")
    record = strict(file.read_text())
    assert (record["ok"], record["asked"], record["done"], record["interrupted"]) == (True, 3, 3, False)
    assert record["renderers"]["numpy-f64"]["agree"] == record["renderers"]["numpy-f64"]["compared"]
    assert sum(record["themes"].values()) == 3
    assert record["versions"]["whitted"] == tracer.version()


#: The command line, what its error says, and what its hint says.
WRONG = {
    "none": ("--fuzz 0", "'0' is not a whole number from 1 on", "see `whitted stability --help`"),
    "seed": ("--fuzz 1 --seed x", "'x' is not a whole number from 0 on", "see `whitted stability --help`"),
    "renderer": ("--fuzz 1 --renderer nativ-f32", "unknown renderer 'nativ-f32'", "did you mean 'native-f32'?"),
    "itself": ("--fuzz 1 --renderer native-f64", "a renderer is not compared with itself", "--against"),
    "json": ("--fuzz 1 --json no/where.json", "there is no folder no", "mkdir -p no"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_with_a_hint(case: str, run: Any, tmp_path: Path, monkeypatch: Any) -> None:
    words, message, hint = WRONG[case]
    monkeypatch.chdir(tmp_path)
    result = run("stability", *words.split())
    assert (result.status, result.out) == (2, "")
    assert message in result.err
    assert f"\n  hint: {hint}" in result.err or hint in result.err.partition("  hint: ")[2]
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_keeps_what_was_found(run: Any, tmp_path: Path, monkeypatch: Any) -> None:
    def interrupted(*_: Any) -> Any:
        yield "seen", fuzz._see(draw_scene(0, 0), 0, ["numpy-f64"], "native-f64", Settings(threads=1))
        raise KeyboardInterrupt

    monkeypatch.setattr(fuzz, "_in_processes", interrupted)
    file = tmp_path / "r.json"
    result = run("stability", "--fuzz", 99, "--renderer", "numpy-f64", "-o", tmp_path / "found", "--json", file)
    assert result.status == 130
    assert "\n1 of 99 scenes" in result.out
    assert result.err == f"\ninterrupted: kept {file} with 1 of 99 scenes\n"
    assert strict(file.read_text())["interrupted"] is True


def test_ended_from_outside_nothing_is_left(tmp_path: Path, need: Any) -> None:
    need(Path("/proc/self/task").exists(), "no /proc that names the children of a process")
    words = ["stability", "--fuzz", "100000", "--renderer", "numpy-f64", "--jobs", "2", "-o", str(tmp_path / "found")]
    file = tmp_path / "r.json"
    with subprocess.Popen(
        [sys.executable, "-m", "validation", *words, "--json", str(file)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        deadline = time.monotonic() + 60
        while len(children.read_text().split()) < 3 and time.monotonic() < deadline:  # the tracker and two workers
            time.sleep(0.05)
        workers = [int(child) for child in children.read_text().split()]
        time.sleep(2)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM
    assert re.fullmatch(rf"\nterminated: kept {re.escape(str(file))} with \d+ of 100000 scenes\n", err)
    assert " of 100000 scenes of seed 0" in out
    assert json.loads(file.read_text())["interrupted"] is True
    while time.monotonic() < deadline + 30 and any(Path(f"/proc/{worker}").exists() for worker in workers):
        time.sleep(0.1)
    assert not any(Path(f"/proc/{worker}").exists() for worker in workers)


def test_help_shows_examples_and_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom validation.cli import main\n"
        "try:\n    main(['stability', '--help'])\nfinally:\n    print('LOADED', *sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert not {"numpy", "rich", "tracer", "flint", "mitsuba"} & set(done.stderr.partition("LOADED")[2].split())
    assert "\n  $ whitted stability --fuzz 2 --renderer numpy-f64 --seed 6\n" in done.stdout


def test_a_drawn_scene_is_a_value() -> None:
    assert isinstance(MANY[0], Drawn)
    assert draw_scene(0, 0) == MANY[0]
