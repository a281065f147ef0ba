"""POV-Ray as a reference: what it draws, how far it can be trusted, and what happens when its program goes wrong."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import validation
from converters import povray as converter
from tracer import Light, Scene, Sphere, View, margins, reference
from tracer.passes import SAMPLES, Passes, Sample, names
from validation import compare_passes
from validation.compare import Judge
from validation.renderers import Renderer, Settings, get
from validation.renderers.povray import Povray, precision, program
from validation.renderers.povray.pictures import Recipes
from validation.renderers.povray.program import PovrayError, read_ppm

pytestmark = pytest.mark.povray

Need = Callable[[object, str], None]


@pytest.fixture
def renderer(need: Need) -> Povray:
    made = Povray(seconds=60)
    need(made.unavailable() is None, str(made.unavailable()))
    return made


def sphere(position: tuple[float, float, float], *scaling: float, **changes: Any) -> Sphere:
    sizes = scaling * 3 if len(scaling) == 1 else scaling
    plain: dict[str, Any] = {"name": "s", "color": (0.8, 0.6, 0.3), "ka": 0.3, "kd": 0.6, "ks": 0.4, "kr": 0.0}
    return Sphere(**{**plain, "position": position, "scaling": sizes, "exponent": 12, **changes})


def light(*position: float, intensity: tuple[float, float, float] = (0.9, 0.7, 0.4)) -> Light:
    return Light(name="l", position=position, intensity=intensity)


def view(columns: int = 40, rows: int = 40, near: float = 1, half: float = 1) -> View:
    return View(near=near, left=-half, right=half, bottom=-half, top=half, columns=columns, rows=rows)


def scene(spheres: list[Sphere], lights: list[Light], frame: View | None = None, **changes: Any) -> Scene:
    plain: dict[str, Any] = {"background": (0.2, 0.3, 0.5), "ambient": (0.4, 0.3, 0.2)}
    return Scene(view=frame or view(), spheres=spheres, lights=lights, **{**plain, **changes})


def scaled(one: Scene, factor: float) -> Scene:
    """The same picture of a scene of another size."""
    frame = {side: factor * getattr(one.view, side) for side in ("near", "left", "right", "bottom", "top")}
    spheres = [
        s.replace(position=[factor * v for v in s.position], scaling=[factor * v for v in s.scaling])
        for s in one.spheres
    ]
    lights = [p.replace(position=[factor * v for v in p.position]) for p in one.lights]
    return one.replace(view=one.view.replace(**frame), spheres=spheres, lights=lights)


MIRRORS = scene(
    [
        sphere((-1.1, 0, -4), 1, kr=0.9),
        sphere((1.1, 0, -4), 1, kr=0.8, ks=0),
        sphere((0, 1.8, -5), 1.5, 0.7, 1, kr=0.5),
    ],
    [light(2, 5, 0), light(-4, 0, -1)],
)
CUT = scene([sphere((0.2, 0, -1.6), 1.2, 1, 0.9), sphere((1, 1, -4), 1)], [light(0.1, 0.2, -1.5), light(3, 4, 2)])

SCENES = {
    "mirrors": MIRRORS,
    "cut by the near plane, a light inside": CUT,
    "eye inside, mirrors, four lights": scene(
        [sphere((0, 0, 0), 6, 5, 7, kr=0.8), sphere((0.5, 0, -3), 0.8, kr=0.5)],
        [light(1, 2, 1), light(9, 9, 0), light(-2, 0, -2), light(0, -3, 1)],
    ),
    "1:20 plate and needle": scene(
        [sphere((0, -1, -5), 4, 0.2, 4), sphere((0, 0.5, -5), 0.1, 2, 2, kr=0.9)], [light(3, 4, 0), light(-4, 5, -5)]
    ),
    "negative lights, ambient and background": scene(
        [sphere((0, 0, -4), 1, kr=0.5), sphere((2, 1, -5), 1, 2, 1)],
        [light(2, 5, 0), light(-4, 0, -1, intensity=(-0.5, 0.2, -3))],
        ambient=(0.2, -0.3, 0.1),
        background=(-0.4, 0.2, 0),
    ),
    "much light": scene([sphere((0, 0, -4), 1, kr=1)], [light(2, 5, 0, intensity=(4e6, 3e5, 2e4))]),
    "exponents 0, 1/2 and 1000": scene(
        [sphere((k - 1.0, 0, -4), 0.9, exponent=n, ks=1) for k, n in enumerate((0, 0.5, 1000))], [light(2, 3, 3)]
    ),
    "a light on a surface": scene([sphere((0, 0, -4), 1), sphere((-1.5, 0, -5), 1)], [light(1, 0, -4)]),
    "small": scaled(MIRRORS, 2.0**-30),
    "large, cut": scaled(CUT, 3e20),
    "a floor of 4000": scene([sphere((0, -4001, -6), 4000, kr=0.3), sphere((0, 0, -5), 1)], [light(3, 9, -2)]),
    "nothing": scene([], []),
}


def agree(made: Povray, one: Scene, settings: Settings | None = None, most_edges: float = 0.1) -> Passes:
    """Every pass against the reference, under the tolerance that is claimed."""
    chosen = settings or Settings()
    options: dict[str, Any] = {"shadow_epsilon": chosen.shadow_epsilon, "max_reflections": chosen.max_reflections}
    wanted = made.passes(one, chosen)
    assert wanted == names(len(one.lights), chosen.max_reflections, margins=False)
    drawn = made.render(one, wanted, chosen)
    exact = reference.render(one, wanted, sample=chosen.sample, **options)
    analysis = margins.analyse(one, sample=chosen.sample, **options)
    claims = made.uncertainty(one, chosen, analysis), get("numpy-f64").uncertainty(one, chosen, analysis)
    for comparison in compare_passes(drawn, exact, wanted, Judge(one, chosen, analysis, *claims)):
        assert comparison.ok, (comparison.pass_name, comparison.reasons, comparison.worst)
        assert comparison.edge <= most_edges * one.view.columns * one.view.rows, comparison.pass_name
        assert comparison.edge_over <= 2, comparison
    return drawn


@pytest.mark.parametrize("name", SCENES)
def test_agrees_with_the_reference(renderer: Povray, name: str) -> None:
    agree(renderer, SCENES[name])


@pytest.mark.parametrize("seed", range(4))
def test_agrees_on_random_scenes(renderer: Povray, seed: int) -> None:
    chance = random.Random(seed)
    spheres = []
    for _ in range(chance.randint(2, 5)):
        depth, size = chance.uniform(1, 10), chance.uniform(0.2, 2)
        place = (chance.uniform(-depth, depth), chance.uniform(-depth, depth), 0.5 - depth)
        sizes = [size * chance.uniform(0.2, 1.5) for _ in range(3)] if chance.random() < 0.6 else [size]
        spheres.append(sphere(place, *sizes, kr=chance.choice((0, 0.5, 1)), exponent=chance.choice((0, 0.5, 3, 80))))
    lights = [light(*(chance.uniform(-8, 8) for _ in range(3))) for _ in range(chance.randint(0, 4))]
    agree(renderer, scene(spheres, lights, view(chance.randint(20, 40), chance.randint(20, 40))))


@pytest.mark.parametrize("sample", SAMPLES)
def test_sample_positions_and_oblong_pixels(renderer: Povray, sample: Sample) -> None:
    frame = View(near=1, left=-0.4, right=1.1, bottom=-0.9, top=0.5, columns=40, rows=17)
    both = scene([sphere((1, 0, -4), 1.2), sphere((0, -1, -5), 2, 0.5, 1)], [light(0, 5, 0)], frame)
    agree(renderer, both, Settings(sample))


@pytest.mark.parametrize("bounces", [0, 1, 5])
def test_bounces(renderer: Povray, bounces: int) -> None:
    found = agree(renderer, MIRRORS, Settings(max_reflections=bounces))
    assert (found["reflection"].max() > 0) == (bounces > 0)


def test_near_plane_limits_primary_rays_only(renderer: Povray) -> None:
    """A sphere before the near plane is not seen, but shades and is seen in a mirror."""
    ball, mirror = sphere((0, 0, -1), 0.5), sphere((0.013, 0.021, -6), 2, kr=1)
    found = agree(renderer, scene([ball, mirror], [light(0, 0, 5)], view(near=2)))
    assert not (found["id"] == 0).any()
    assert (found["shadow.L0"][found["id"] == 1] == 0).any()
    assert found["reflection.1"].max() == pytest.approx(0.4 * 0.3 * 0.8, abs=1e-4)


@pytest.mark.filterwarnings("ignore::tracer.SceneWarning")
def test_duplicates_and_ids(renderer: Povray) -> None:
    first, second = sphere((-1.03, 0.02, -4), 1), sphere((1.5, 0, -4), 1, 0.5, 1)
    found = agree(renderer, scene([first, first.replace(color=(0, 1, 0)), second], [light(0, 5, 0)]))
    assert set(np.unique(found["id"])) == {-1, 0, 2}


def test_many_ids(renderer: Povray) -> None:
    """Each index is a step of the output."""
    balls = [sphere((-3.9 + 0.2 * (k % 40), 3.9 - 0.2 * (k // 40), -4), 0.09) for k in range(1600)]
    many = Scene(view=view(), spheres=balls, lights=[], limits=False)
    found = renderer.render(many, ["id"], Settings(sample="center"))["id"]
    assert np.array_equal(found, np.arange(1600).reshape(40, 40))


def test_shadow_epsilon_is_its_own_and_explained(renderer: Povray) -> None:
    """A disc close to a wall, lit from the side: a shadow for POV-Ray, for any epsilon of the specification's."""
    wall, disc = sphere((0, 0, -1006), 1000), sphere((0, 0, -5.9), 0.5, 0.5, 0.01)
    both = scene([wall, disc], [light(20, 0, -2)], view(24, 24, half=0.2))
    settings = Settings(shadow_epsilon=0.05)
    result = validation.validate({"disc": both}, "numpy-f64", renderer, settings=settings, verdicts=5)
    (verdicts,) = result.verdicts
    assert verdicts.explained
    (group,) = verdicts.groups()
    assert group.finding.renderer == "povray"
    assert "as documented, it counts what hides a light from" in group.finding.because
    # The claim says so of each of these pixels, and of no other.
    (shadow,) = [entry for entry in result.comparisons if entry.pass_name == "shadow.L0"]
    assert shadow.interior_over == 0
    assert shadow.edge_over > 20
    assert shadow.edge - shadow.edge_over < 40


def test_tangents_are_explained(renderer: Povray, root: Path) -> None:
    """The exact tangents of a bundled scene: POV-Ray misses some of them."""
    import tracer

    exact = tracer.load(root / "scenes" / "spec" / "exact-tangents.txt")
    result = validation.validate({"t": exact}, "native-f64", renderer, passes=["id"], verdicts=20)
    assert result.status == 0
    (verdicts,) = result.verdicts
    causes = {group.finding.because for group in verdicts.groups()}
    assert causes == {"as documented, it misses a sphere that a ray only touches"}


def test_light_on_a_surface_does_not_depend_on_other_pixels(renderer: Povray) -> None:
    """The root at the light is off by rounding: an opaque sphere that POV-Ray remembers would hide half the light."""
    # Exactly on it: (-2, 1, 2) / 3 of the scaling.
    center, size = np.array((0.3125, 0.125, -4)), np.array((0.9375, 1.125, 0.75))
    place = center + size / 3 * (-2, 1, 2)
    ball, floor = sphere(tuple(center.tolist()), *size.tolist()), sphere((0, -51.5, -4), 50)
    one = scene([ball, floor], [light(*place.tolist())], view(60, 60, half=0.8))
    drawn = renderer.render(one, ["shadow.L0"], Settings())["shadow.L0"]
    exact = reference.render(one, ("shadow.L0",))["shadow.L0"]
    lit = margins.analyse(one).lit[0]
    assert 100 < exact[lit].sum() < lit.sum() - 100
    assert np.array_equal(drawn[lit], exact[lit])


# ---- what is claimed


def test_claims_follow_from_the_output() -> None:
    """Half a step, divided by the gain; as much again where a pass is a difference, or has a negative part."""
    one = scene([sphere((0, 0, -4), 1)], [light(2, 5, 0)])
    step = 1 / 65535 / converter.gain(one)

    def claimed(drawn: Scene, settings: Settings | None = None) -> Callable[[str], float]:
        claim = precision.uncertainty(drawn, settings or Settings())
        return lambda name: float(claim.absolute_of(name))

    plain = claimed(one)("beauty")
    assert 0.5 * step < plain < 0.6 * step
    # One mirror hit more may be as bright as the first, so the gain may fall, by a factor of two.
    mirror = one.replace(spheres=[sphere((0, 0, -4), 1, kr=0.5)])
    unit = 65535 * converter.gain(mirror, max_reflections=3)
    assert 0.5 < claimed(mirror)("beauty") * unit < 0.8
    assert claimed(mirror)("reflection") == claimed(mirror)("reflection.3") == 2 * claimed(mirror)("beauty")
    # What mirrors show takes nothing from the passes without them.
    for name in ("ambient", "diffuse", "specular", "direct"):
        assert 0.5 * step / 64 < claimed(mirror)(name) == claimed(one)(name) <= plain
    signs = one.replace(background=(-0.5, 0.3, 0.5))
    assert claimed(signs)("beauty") > 1.4 * plain
    deep = Settings(max_reflections=100)
    assert claimed(mirror, deep)("reflection") * 65535 * converter.gain(mirror, max_reflections=100) > 2
    bright = one.replace(lights=[light(2, 5, 0, intensity=(1000, 1000, 1000))])
    assert claimed(bright)("beauty") > 100 * plain


def test_lights_next_to_a_surface_are_left_out() -> None:
    """One above a floor by less than POV-Ray's epsilon; on it is fine, and far above, too."""
    made, floor, ball = Povray(), sphere((0, -2, -6), 20, 0.5, 20), sphere((0, 0, -6), 1)
    every = names(2, 3, margins=False)

    def passes(height: float) -> tuple[str, ...]:
        return made.passes(scene([floor, ball], [light(0, -1.5 + height, -6), light(0, 4, -4)]), Settings())

    assert passes(0) == passes(1e-2) == passes(-1e-2) == every
    left = ("ambient", "shadow.L1", "depth", "position", "normal", "id")
    assert passes(1e-7) == passes(-1e-7) == left
    # 1024 is the scaling of the floor for POV-Ray.
    length = 1e-3 / 1024 * 0.5
    assert passes(1.9 * length) == left
    assert passes(2.1 * length) == every


def test_what_lies_between_the_epsilons_is_uncertain() -> None:
    """A disc close to a wall, 0.025 of the way to the light: uncertain where that is below the shadow epsilon."""
    wall, disc = sphere((0, 0, -1006), 1000), sphere((0, 0, -5.9), 0.5, 0.5, 0.01)
    both = scene([wall, disc], [light(20, 0, -2)], view(half=0.2))
    sure = precision.uncertainty(both, Settings(shadow_epsilon=1e-6))
    assert not np.isinf(sure.range).any()
    assert np.max(sure.silhouette) < 1e-8
    uncertain = np.isinf(precision.uncertainty(both, Settings(shadow_epsilon=0.05)).range)
    dark = reference.render(both, ("shadow.L0",), shadow_epsilon=0)["shadow.L0"] == 0
    facing = margins.analyse(both).lit[0]
    assert np.array_equal(uncertain, dark & facing)
    assert 50 < uncertain.sum() < 400


def test_sources_and_precision() -> None:
    made = Povray()
    assert made.precision == "16-bit"
    sources = made.sources(MIRRORS, Settings())
    assert tuple(sources) == made.passes(MIRRORS, Settings())
    assert sources["beauty"] == sources["id"] == sources["shadow.L1"] == "stock"
    assert sources["reflection"] == sources["position"] == "derived"
    assert made.sources(SCENES["negative lights, ambient and background"], Settings())["diffuse"] == "derived"


def test_refuses_what_it_cannot_draw() -> None:
    made, deep = Povray(), Settings(max_reflections=256)
    far = scene([sphere((0, 0, -1e8), 1)], [])
    assert made.passes(far, Settings()) == ()
    assert "its largest distance" in made.refusal(far)
    assert made.passes(MIRRORS, deep) == ()
    assert made.refusal(MIRRORS) == "more reflections than POV-Ray follows"
    assert made.passes(CUT, deep)
    assert isinstance(made, Renderer)
    assert made.max_pixels(CUT, ["id"]) == 1_000_000


# ---- which pictures are drawn


def test_only_what_is_asked_for_is_drawn_and_nothing_twice() -> None:
    recipes = Recipes(MIRRORS, Settings())
    assert len(recipes.texts(["ambient"])) == 1
    assert len(recipes.texts(["beauty"])) == 1
    assert len(recipes.texts(["reflection"])) == 2
    assert len(recipes.texts(["beauty", "reflection"])) == 2
    assert len(recipes.texts(["reflection", "reflection.1", "reflection.2", "reflection.3", "beauty"])) == 4
    assert len(recipes.texts(["shadow.L0", "shadow.L1"])) == 1
    assert len(recipes.texts(["depth", "position", "id"])) == 3
    # Without mirrors all depths are one picture, and their differences exactly nothing.
    flat = Recipes(CUT, Settings())
    assert len(flat.texts(["reflection", "reflection.1", "reflection.2", "beauty"])) == 1
    four = Recipes(SCENES["eye inside, mirrors, four lights"], Settings())
    assert len(four.texts([f"shadow.L{i}" for i in range(4)])) == 2
    # Nothing is lit: no picture at all.
    assert Recipes(SCENES["nothing"], Settings()).texts(["diffuse", "specular"]) == []


def test_only_the_passes_asked_for(renderer: Povray) -> None:
    found = renderer.render(MIRRORS, ["id", "shadow.L1"], Settings())
    assert tuple(found) == ("id", "shadow.L1")
    assert found.metadata == {"povray": renderer.version()}
    with pytest.raises(ValueError, match=r"povray has no pass 'shadow\.L2' for this scene"):
        renderer.render(MIRRORS, ["shadow.L2"], Settings())


def test_threads_do_not_matter(renderer: Povray) -> None:
    images = [renderer.render(MIRRORS, ["beauty", "position"], Settings(threads=count)) for count in (1, 2, 7)]
    for image in images[1:]:
        for name in image:
            assert np.array_equal(image[name], images[0][name])


def test_export_draws_the_same(renderer: Povray, tmp_path: Path) -> None:
    """The text that `whitted convert` writes, drawn as its head says."""
    converter.write_pov(CUT, tmp_path / "cut.pov")
    subprocess.run(converter.command((40, 40), "cut.pov"), cwd=tmp_path, capture_output=True, check=True)
    image = read_ppm((tmp_path / "cut.ppm").read_bytes(), (40, 40)).astype(float)
    beauty = renderer.render(CUT, ["beauty"], Settings())["beauty"]
    assert np.array_equal(image / 65535 / converter.gain(CUT), beauty)


def test_settings_of_the_user_do_not_matter(renderer: Povray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Antialiasing, another size, no shadows and gamma, wherever POV-Ray looks for such things."""
    before = renderer.render(MIRRORS, ["beauty"], Settings())["beauty"]
    bad = "Antialias=on\nWidth=7\nQuality=1\nFile_Gamma=2.2\nStart_Row=3\nBounding=off\n"
    folder = tmp_path / ".povray" / "3.7"
    folder.mkdir(parents=True)
    for path in (folder / "povray.ini", tmp_path / "povray.ini", tmp_path / "povini"):
        path.write_text(bad)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("POVINI", str(tmp_path / "povini"))
    monkeypatch.chdir(tmp_path)
    assert np.array_equal(renderer.render(MIRRORS, ["beauty"], Settings())["beauty"], before)


def test_convert_writes_the_text(tmp_path: Path, root: Path) -> None:
    from click.testing import CliRunner

    import tracer
    from validation.cli import whitted

    source, path = root / "scenes" / "spec" / "diffuse-only.txt", tmp_path / "out.pov"
    words = ["convert", str(source), "--to", "povray", "-o", str(path)]
    result = CliRunner().invoke(whitted, words)
    assert (result.exit_code, result.output) == (0, "")
    assert path.read_text() == converter.to_pov(tracer.load(source), file="out.pov")
    CliRunner().invoke(whitted, [*words, "--sample", "center", "--max-reflections", "1", "--light", "0"])
    loaded = tracer.load(source)
    options: dict[str, Any] = {"sample": "center", "max_reflections": 1, "light": 0, "file": "out.pov"}
    assert path.read_text() == converter.to_pov(loaded, **options)
    source = tmp_path / "far.txt"
    source.write_text(scene([sphere((0, 0, -1e9), 1)], []).text())
    words = [
        str(Path(sys.executable).parent / "whitted"),
        "convert",
        str(source),
        "--to",
        "povray",
        "-o",
        str(tmp_path / "no.pov"),
    ]
    refused = subprocess.run(words, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert "POV-Ray cannot draw this scene: its largest distance is more than" in refused.stderr
    assert not (tmp_path / "no.pov").exists()


# ---- a program that goes wrong


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary folders go, so that the test sees what is left of them."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


Fake = Callable[[str], None]


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    """Puts a program `povray` in the place of the real one; it tells a version and then does what it is told."""

    def make(script: str) -> None:
        folder = tmp_path / "bin"
        folder.mkdir(exist_ok=True)
        path = folder / "povray"
        path.write_text(f'#!/bin/sh\n[ "$1" = --version ] && {{ echo POV-Ray 3.7.9.fake >&2; exit; }}\n{script}\n')
        path.chmod(0o755)
        monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
        program._asked.cache_clear()

    return make


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (
            "echo 'Parse Error: no such thing' >&2; echo chatter >&2; exit 3",
            "ended with exit status 3\n    Parse Error",
        ),
        ("kill -SEGV $$", "was killed by signal 11"),
        ("exit 0", "wrote no image"),
        ("printf 'P6\\n2 2\\n255\\n' > scene.ppm", "wrote an image of 256 levels, expected 65536"),
        ("printf 'P6\\n2 2\\n65535\\n' > scene.ppm", "wrote an image of 2x2, expected 40x40"),
        ("printf 'P6\\n40 40\\n65535\\nxyz' > scene.ppm", "wrote 3 bytes of pixels, expected 9600"),
        ("echo hello > scene.ppm", "wrote an image that is no binary PPM"),
    ],
)
def test_failures_are_told_and_leave_nothing(fake: Fake, scratch: Path, script: str, message: str) -> None:
    fake(script)
    with pytest.raises(PovrayError) as caught:
        Povray().render(MIRRORS, ["beauty", "ambient", "id"], Settings(threads=2))
    assert message in str(caught.value)
    assert "chatter" not in str(caught.value)
    assert not list(scratch.iterdir())


def test_hanging_program_is_ended_with_its_children(fake: Fake, scratch: Path, tmp_path: Path) -> None:
    fake(f"sleep 60 & echo $! >> {tmp_path}/child; wait")
    begun = time.monotonic()
    with pytest.raises(PovrayError, match=r"took more than 0\.3 s for a picture of 40x40 and was ended"):
        Povray(seconds=0.3).render(MIRRORS, ["beauty", "ambient", "id"], Settings(threads=3))
    assert time.monotonic() - begun < 20
    assert not list(scratch.iterdir())
    for child in (tmp_path / "child").read_text().split():
        gone(int(child))


def gone(process: int) -> None:
    """Wait until a process is no more, or only waits for its parent to notice."""
    for _ in range(100):
        try:
            state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return
        if state == "Z":
            return
        time.sleep(0.05)
    pytest.fail(f"process {process} runs on")


def test_first_failure_ends_the_others(fake: Fake, scratch: Path) -> None:
    """One picture fails, the others would take a minute."""
    fake("grep -q \"picture 'id'\" scene.pov && exit 5; sleep 60")
    begun = time.monotonic()
    with pytest.raises(PovrayError, match="exit status 5"):
        Povray().render(MIRRORS, ["beauty", "ambient", "id", "diffuse"], Settings(threads=4))
    assert time.monotonic() - begun < 20
    assert not list(scratch.iterdir())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_everything(fake: Fake, scratch: Path, tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C, a kill, or a terminal that is closed, while pictures are drawn."""
    fake(f"echo $$ >> {tmp_path}/started; sleep 60")
    code = (
        "import tempfile, tracer; from validation.renderers import Settings\n"
        f"tempfile.tempdir = {str(scratch)!r}\n"
        "from validation.renderers.povray import Povray\n"
        f"Povray().render(tracer.loads({MIRRORS.text()!r}), ['beauty', 'id'], Settings(threads=2))\n"
    )
    started = tmp_path / "started"
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True) as process:
        for _ in range(600):
            if started.exists() and len(started.read_text().split()) == 2:
                break
            time.sleep(0.05)
        process.send_signal(number)
        _, said = process.communicate(timeout=30)
    assert process.returncode == -number
    assert ("KeyboardInterrupt" in said) == (number == signal.SIGINT)
    assert not list(scratch.iterdir())
    for child in started.read_text().split():
        gone(int(child))


def test_missing_program_is_one_sentence_with_the_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    made = Povray()
    assert made.unavailable() == "the program povray was not found: sudo apt-get install povray"
    assert made.version() == "not installed"
    with pytest.raises(RuntimeError, match="povray cannot run: the program povray was not found"):
        made.render(CUT, ["id"], Settings())


def test_unknown_version_is_refused(fake: Fake) -> None:
    fake("exit 0")
    assert Povray().unavailable() is None
    assert Povray().versions() == {"povray": "3.7.9.fake"}
    path = Path(str(shutil.which("povray")))
    path.write_text("#!/bin/sh\necho POV-Ray 3.8.0\n")
    program._asked.cache_clear()
    assert Povray().unavailable() == (f"{path} is version 3.8.0, expected 3.7.x: sudo apt-get install povray")


def test_ppm_is_read_to_the_last_bit() -> None:
    values = np.random.default_rng(0).integers(0, 65536, (2, 3, 3)).astype(">u2")
    head = b"P6\n# POV-Ray\n# 12 34\n3 2\n65535\n"
    assert np.array_equal(read_ppm(head + values.tobytes(), (3, 2)), values)


def test_found_by_name() -> None:
    assert get("povray").name == "povray"
