"""Mitsuba as a reference: what it draws, how far it can be trusted, and what it does when it cannot run."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tracer import Light, Scene, Sphere, View, margins, reference
from tracer.passes import SAMPLES, Passes, Sample, names
from validation import compare_passes
from validation.compare import Judge
from validation.renderers import Settings, get
from validation.renderers import mitsuba as module
from validation.renderers.mitsuba import MitsubaSpec, llvm
from validation.renderers.mitsuba.driver import RETRIES, Driver, Start
from validation.renderers.mitsuba.engines import Arrays, Hits, Loop
from validation.renderers.mitsuba.precision import SLACK, UNIT_ROUNDOFF
from validation.run import validate
from validation.truth import Prover

pytestmark = pytest.mark.mitsuba

Need = Callable[[object, str], None]


@pytest.fixture(params=["llvm", "scalar"])
def renderer(request: pytest.FixtureRequest, need: Need) -> MitsubaSpec:
    made = MitsubaSpec(request.param)
    need(made.unavailable() is None, str(made.unavailable()))
    return made


def sphere(position: tuple[float, float, float], *scaling: float, **changes: Any) -> Sphere:
    sizes = scaling * 3 if len(scaling) == 1 else scaling
    plain: dict[str, Any] = {"name": "s", "color": (0.8, 0.6, 0.3), "ka": 0.3, "kd": 0.6, "ks": 0.4, "kr": 0.0}
    return Sphere(**{**plain, "position": position, "scaling": sizes, "exponent": 12, **changes})


def light(*position: float, intensity: tuple[float, float, float] = (0.9, 0.7, 0.4)) -> Light:
    return Light(name="l", position=position, intensity=intensity)


def view(columns: int = 48, rows: int = 48, near: float = 1, half: float = 1) -> View:
    return View(near=near, left=-half, right=half, bottom=-half, top=half, columns=columns, rows=rows)


def scene(spheres: list[Sphere], lights: list[Light], frame: View | None = None) -> Scene:
    return Scene(
        view=frame or view(), spheres=spheres, lights=lights, background=(0.2, 0.3, 0.5), ambient=(0.4, 0.3, 0.2)
    )


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
    "1:20 plate and needle": scene(
        [sphere((0, -1, -5), 4, 0.2, 4), sphere((0, 0.5, -5), 0.1, 2, 2, kr=0.9)], [light(3, 4, 0), light(-4, 5, -5)]
    ),
    "eye inside, mirrors": scene(
        [sphere((0, 0, 0), 6, 5, 7, kr=0.8), sphere((0.5, 0, -3), 0.8, kr=0.5)], [light(1, 2, 1), light(9, 9, 0)]
    ),
    "far": scene([sphere((0, 0, -1000), 8), sphere((12, 3, -990), 5, 2, 5)], [light(300, 500, -700)], view(half=0.02)),
    "small": scene(
        [sphere((0, 0, -0.004), 0.001), sphere((0.001, 0.001, -0.003), 0.0004)],
        [light(1, 1, 0)],
        view(near=1e-3, half=1e-3),
    ),
    "lights on surfaces": scene([sphere((0, 0, -4), 1), sphere((2, 0, -4), 0.9)], [light(1, 0, -4), light(0, 1, -4)]),
    "touching and crossing": scene(
        [sphere((-1, 0, -4), 1, kr=0.9), sphere((1, 0, -4), 1, kr=0.9), sphere((0, 0.8, -4), 0.7)], [light(0, 4, -2)]
    ),
    "exponent 0": scene([sphere((0, 0, -4), 1.5, exponent=0)], [light(3, 3, -1), light(-4, 1, -6)]),
    "exponent 1000": scene([sphere((0, 0, -4), 1.5, exponent=1000)], [light(3, 3, -1), light(0, 1, 0)]),
    "negative light": scene([sphere((0, 0, -4), 1.5)], [light(3, 3, -1), light(0, 1, 0, intensity=(-0.5, 0.2, -2))]),
    "behind the eye": scene([sphere((0, 0, 4), 1), sphere((0, 0, -4), 1)], [light(0, 0, 9), light(3, 0, 3)]),
    "no spheres": scene([], [light(0, 0, 0)]),
    "no lights": scene([sphere((0, 0, -4), 1, kr=0.5), sphere((1.5, 0, -4), 1)], []),
    "black": scene([sphere((0, 0, -4), 1, ka=0, kd=0, ks=0)], [light(0, 0, 0)]),
    "one pixel": scene([sphere((-1, 1, -1.5), 1)], [light(0, 0, 0)], view(1, 1)),
    "one column": scene([sphere((0, 0, -4), 2)], [light(0, 0, 0)], view(1, 30)),
}


def every(scene: Scene, settings: Settings) -> tuple[str, ...]:
    return names(len(scene.lights), settings.max_reflections, margins=False)


def agree(renderer: MitsubaSpec, scene: Scene, settings: Settings | None = None) -> Passes:
    """Every pass within the derived tolerance, interior and edges as validation counts them."""
    settings = settings or Settings()
    asked = every(scene, settings)
    keywords: dict[str, Any] = {
        "sample": settings.sample,
        "shadow_epsilon": settings.shadow_epsilon,
        "max_reflections": settings.max_reflections,
    }
    expected = reference.render(scene, asked, **keywords)
    found = renderer.render(scene, asked, settings)
    assert tuple(found) == asked
    analysis = margins.analyse(scene, **keywords)
    exact = get("numpy-f64").uncertainty(scene, settings, analysis)
    judge = Judge(scene, settings, analysis, exact, renderer.uncertainty(scene, settings, analysis))
    comparisons = list(compare_passes(expected, found, asked, judge))
    wrong = {comparison.pass_name: comparison.reasons for comparison in comparisons if not comparison.ok}
    assert not wrong
    return found


@pytest.mark.parametrize("name", SCENES)
def test_agrees_with_the_reference(renderer: MitsubaSpec, name: str) -> None:
    agree(renderer, SCENES[name])


@pytest.mark.parametrize("seed", range(12))
def test_agrees_on_random_scenes(renderer: MitsubaSpec, seed: int) -> None:
    chance = random.Random(seed)
    spheres = []
    for _ in range(chance.randint(1, 5)):
        depth, size = chance.uniform(1, 10), chance.uniform(0.2, 2)
        place = (chance.uniform(-depth, depth), chance.uniform(-depth, depth), 0.5 - depth)
        sizes = [size * chance.uniform(0.2, 1.5) for _ in range(3)] if chance.random() < 0.6 else [size]
        spheres.append(sphere(place, *sizes, kr=chance.choice((0, 0.5, 1)), exponent=chance.choice((0, 0.5, 3, 80))))
    lights = [light(*(chance.uniform(-8, 8) for _ in range(3))) for _ in range(chance.randint(0, 4))]
    agree(renderer, scene(spheres, lights, view(chance.randint(20, 40), chance.randint(20, 40))))


@pytest.mark.parametrize("sample", SAMPLES)
def test_sample_positions_and_oblong_pixels(renderer: MitsubaSpec, sample: Sample) -> None:
    frame = View(near=1, left=-0.4, right=1.1, bottom=-0.9, top=0.5, columns=40, rows=17)
    agree(
        renderer,
        scene([sphere((1, 0, -4), 1.2), sphere((0, -1, -5), 2, 0.5, 1)], [light(0, 5, 0)], frame),
        Settings(sample),
    )


def test_shadow_epsilon_is_the_specifications(renderer: MitsubaSpec) -> None:
    """A disc 0.005 of the way to the light hides it at 0.001 and not at 0.01."""
    floor, disc = sphere((0, -1, -5), 3, 0.5, 3), sphere((0, -0.45, -5), 1.5, 0.001, 1.5)
    both = scene([floor, disc], [light(0, 9.5, -5)], view(24, 24))
    hidden = [agree(renderer, both, Settings(shadow_epsilon=epsilon))["shadow.L0"].sum() for epsilon in (1e-3, 1e-2, 0)]
    assert hidden[0] < hidden[1]
    assert hidden[0] == hidden[2]


@pytest.mark.parametrize("bounces", [0, 1, 5])
def test_bounces(renderer: MitsubaSpec, bounces: int) -> None:
    found = agree(renderer, MIRRORS, Settings(max_reflections=bounces))
    assert f"reflection.{bounces + 1}" not in found
    assert (found["reflection"].max() > 0) == (bounces > 0)


def test_near_plane_limits_primary_rays_only(renderer: MitsubaSpec) -> None:
    """A sphere before the near plane is not seen, but shades and is seen in a mirror."""
    ball, mirror = sphere((0, 0, -1), 0.5), sphere((0, 0, -6), 2, kr=1)
    found = agree(renderer, scene([ball, mirror], [light(0, 0, 5)], view(near=2)))
    assert not (found["id"] == 0).any()
    assert (found["shadow.L0"][found["id"] == 1] == 0).any()
    # What the mirror shows of it is turned away from the light: the ambient term.
    assert found["reflection.1"].max() == pytest.approx(0.4 * 0.3 * 0.8)


@pytest.mark.filterwarnings("ignore::tracer.SceneWarning")
def test_duplicates_and_ids(renderer: MitsubaSpec) -> None:
    first, second = sphere((-1, 0, -4), 1), sphere((1.5, 0, -4), 1, 0.5, 1)
    found = agree(renderer, scene([first, first.replace(color=(0, 1, 0)), second], [light(0, 5, 0)]))
    assert set(np.unique(found["id"])) == {-1, 0, 2}


def test_pole_of_a_sphere(renderer: MitsubaSpec) -> None:
    """Where Mitsuba's parametrisation degenerates: along z through the centre."""
    frame = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=2, rows=2)
    found = agree(renderer, scene([sphere((0, 0, -4), 1, ks=0.5)], [light(0, 0, 0)], frame))
    assert found["id"][1, 1] == 0
    assert found["direct"][1, 1] == pytest.approx((0.9 * 0.98, 0.7 * 0.86, 0.4 * 0.68), abs=1e-5)


def test_only_the_passes_asked_for(renderer: MitsubaSpec) -> None:
    assert tuple(renderer.render(MIRRORS, ["id", "shadow.L1"], Settings())) == ("id", "shadow.L1")
    with pytest.raises(ValueError, match=r"has no pass 'shadow\.L2' for this scene"):
        renderer.render(MIRRORS, ["shadow.L2"], Settings())


@pytest.mark.parametrize("number", [1e16, 1e-16])
def test_refuses_what_float32_does_not_hold(renderer: MitsubaSpec, number: float) -> None:
    assert renderer.passes(MIRRORS, Settings())
    assert not renderer.passes(scene([sphere((0, 0, -4), 1), sphere((number, 0, -4), 1)], []), Settings())
    assert not renderer.passes(scene([], [light(0, 0, 0, intensity=(number, 0, 0))]), Settings())


def test_other_variant_is_left_alone_and_nothing_is_printed(
    renderer: MitsubaSpec, capfd: pytest.CaptureFixture[str]
) -> None:
    import mitsuba as mi

    mi.set_variant("scalar_spectral")
    renderer.render(SCENES["negative light"], ("beauty",), Settings())
    assert mi.variant() == "scalar_spectral"
    assert capfd.readouterr() == ("", "")


def test_versions(renderer: MitsubaSpec) -> None:
    import drjit
    import mitsuba as mi

    versions = renderer.versions()
    assert versions["mitsuba"] == mi.__version__
    assert versions["drjit"] == drjit.__version__
    assert versions["mitsuba variant"].startswith(renderer.backend)
    assert ("LLVM" in versions) == (renderer.backend == "llvm")
    assert renderer.render(CUT, ("id",), Settings()).metadata == versions


def test_names() -> None:
    assert [made.name for made in module.renderers()] == [
        *("mitsuba-spec@llvm", "mitsuba-spec@scalar", "mitsuba-spec@cuda"),
        *("mitsuba-stock@scalar", "mitsuba-stock@llvm", "mitsuba-stock@cuda"),
        *("mitsuba-path@llvm", "mitsuba-path@scalar", "mitsuba-path@cuda"),
    ]
    for family in ("mitsuba-spec", "mitsuba-stock", "mitsuba-path"):
        assert get(family).unavailable() is None


def test_scalar_draws_what_it_can_in_time() -> None:
    """The limit is a count: larger for less work, the same each time, and none for small pictures."""
    scalar, llvm = MitsubaSpec("scalar"), MitsubaSpec("llvm")
    large = MIRRORS.replace(view=view(2000, 2000))
    beauty, ambient = scalar.max_pixels(large, ("beauty",)), scalar.max_pixels(large, ("ambient",))
    assert beauty is not None
    assert ambient is not None
    assert 32 * 32 < beauty < ambient < 2000 * 2000
    module._loop_pixels.cache_clear()
    assert scalar.max_pixels(large, ("beauty",)) == beauty
    assert scalar.max_pixels(MIRRORS.replace(view=view(8, 8)), ("beauty",)) is None
    assert llvm.max_pixels(large, ("beauty",)) is None


def test_oblique_ellipsoids_are_less_certain_in_float32_only() -> None:
    plate = scene([sphere((0, -1.5, -10), 6, 0.3, 6)], [])
    ball = scene([sphere((0, -1.5, -10), 2)], [])
    llvm, scalar = (np.max(MitsubaSpec(name).uncertainty(plate, Settings()).silhouette) for name in ("llvm", "scalar"))
    assert scalar == 64 * UNIT_ROUNDOFF
    assert llvm > 1.5 * scalar
    for name in ("llvm", "scalar"):
        certain = MitsubaSpec(name).uncertainty(ball, Settings())
        assert certain.silhouette == 32 * UNIT_ROUNDOFF
        assert certain.range == 32 * UNIT_ROUNDOFF + SLACK


def test_flat_rays_inside_a_sphere_are_uncertain(renderer: MitsubaSpec) -> None:
    """A light just outside the shell that the eye is in: near it, rays to it run along the shell, short chords."""
    shell = scene([sphere((0, 0, 0), 5)], [light(0.1, 0.05, -5.0001)], view(64, 64, half=0.1))
    uncertain = renderer.uncertainty(shell, Settings())
    assert uncertain.silhouette == 32 * UNIT_ROUNDOFF
    assert uncertain.unit == pytest.approx(np.full((64, 64), 8 * 2**0.5 * UNIT_ROUNDOFF))
    doubtful = np.asarray(uncertain.terminator) == 1
    assert 0 < doubtful.sum() < 100
    assert np.all(np.asarray(uncertain.terminator)[~doubtful] == 32 * UNIT_ROUNDOFF)
    agree(renderer, shell)


#: A light on the pole of the ball in the middle, and the ball beside it, near the plane that touches there.
POLE = scene(
    [sphere((0, 0, -4), 1), sphere((3, 1, -4), 1)],
    [light(0, 1, -4)],
    View(near=1, left=0.4995, right=0.5005, bottom=0.24, top=0.26, columns=10, rows=200),
)


def test_short_chords_at_a_light_are_uncertain(renderer: MitsubaSpec) -> None:
    """Seen so flatly all of the ball before the light is nearer to it than SLACK, across the surface."""
    found = agree(renderer, POLE)
    exact = reference.render(POLE, ("shadow.L0", "id"))
    assert np.all(exact["id"] == 1)
    differ = (exact["shadow.L0"] != found["shadow.L0"]) & margins.analyse(POLE).lit[0]
    assert differ.sum() > 20
    claims = renderer.uncertainty(POLE, Settings())
    either = np.isinf(np.asarray(claims.range))
    assert either[differ].all()
    assert either.mean() < 0.25
    assert np.isfinite(np.asarray(claims.range)[~either]).all()
    # Rounding is not what does it.
    for y, x in np.argwhere(differ)[::10]:
        rule = renderer.rules(POLE, Settings())[-1]
        assert rule.choices is not None
        seen = [
            Prover(POLE, follower=follower).pixel(int(x), int(y), ties=False).values["shadow.L0"][0].value
            for follower in rule.choices(int(x), int(y))
        ]
        assert seen == [found["shadow.L0"][y, x]]
    (judgement,) = validate({"pole": POLE}, "native-f64", renderer, passes=("shadow.L0",), verdicts=8).verdicts
    assert judgement.explained
    assert {entry.reference.cause for entry in judgement.verdicts} == {"rule"}


def test_lights_off_surfaces_are_certain() -> None:
    """Neither just beside one, nor on it where rays come in steeply."""
    beside = POLE.replace(lights=[light(0, 1.01, -4)])
    steep = scene([sphere((0, 0, -4), 1), sphere((0, 3, -4), 1)], list(POLE.lights))
    for drawn in (beside, steep):
        claims = MitsubaSpec("llvm").uncertainty(drawn, Settings())
        assert claims.range == 32 * UNIT_ROUNDOFF + SLACK
        assert claims.silhouette == 32 * UNIT_ROUNDOFF


def test_errors_grow_where_mirrors_are_flat_inside() -> None:
    """From bounce to bounce along the inside of a shell the chords stay as short as the first."""
    shell = scene([sphere((0, 0, 0), 5, kr=1)], [], view(16, 16, near=4.9, half=0.9))
    unit = np.asarray(MitsubaSpec("scalar").uncertainty(shell, Settings()).unit) / UNIT_ROUNDOFF
    # Three mirrors: four roots, each of which keeps half of its discriminant.
    assert unit.min() >= 0.999 * 32
    assert unit.max() == pytest.approx(32, rel=0.01)
    off = scene([sphere((0, 4, 0), 5, kr=1)], [], view(16, 16, near=0.5, half=4))
    unit = np.asarray(MitsubaSpec("scalar").uncertainty(off, Settings()).unit) / UNIT_ROUNDOFF
    assert unit.max() > 1.2 * 32


class Fake:
    """An engine whose first answers are roots at the start of the rays."""

    def __init__(self, start: Start, false: int) -> None:
        self.start, self.false, self.origins = start, false, list[float]()

    def hit(self, origin: Any, direction: Any, until: Any) -> Hits:
        assert until is None
        self.origins.append(float(origin[0, 2]))
        if len(self.origins) <= self.false or self.false > 8:
            return Hits(np.array([0]), np.array([0]), np.array([1e-7]), origin, self.start.outward, None)
        return Hits(np.array([0]), np.array([1]), np.array([2.0]), origin, -direction, None)

    def take(self, hits: Hits, wanted: Any) -> Hits:
        return Hits(hits.ray[wanted], hits.sphere[wanted], hits.t[wanted], hits.position, hits.normal, None)


def leave(false: int) -> tuple[Hits, list[float]]:
    start = Start(np.array([[0.0, 0.0, 1.0]]), np.array([0]), np.array([[0.0, 0.0, 1.0]]), np.array([False]))
    engine = Fake(start, false)
    driver = Driver(SCENES["no lights"], Settings(), engine)  # type: ignore[arg-type]
    return driver.leave(start, start.point, np.array([[0.0, 0.0, 1.0]])), engine.origins


def test_ray_goes_on_behind_the_root_it_starts_from() -> None:
    hits, origins = leave(0)
    assert origins == [1.0]
    hits, origins = leave(1)
    assert hits.sphere.tolist() == [1]
    assert origins == pytest.approx([1, 1 + 1e-7 + SLACK, 1 + 1e-7 + SLACK], abs=1e-12)
    assert hits.t == pytest.approx([2 + 1e-7 + SLACK], abs=1e-12)
    hits, origins = leave(99)
    assert hits.ray.size == 0
    assert len(origins) == RETRIES + 2


def test_hits_can_be_taken_apart(renderer: MitsubaSpec) -> None:
    """The records of Mitsuba stay with their hits."""
    with renderer.ready():
        engine = renderer.engine(MIRRORS)
        assert isinstance(engine, Arrays | Loop)
        directions = np.array([[0, 0, -1.0], [-0.265, 0, -0.964], [0.265, 0, -0.964]])
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        hits = engine.hit(np.zeros((3, 3)), directions)
        assert hits.sphere.tolist() == [0, 1]
        last = engine.take(hits, np.array([1]))
        assert last.sphere.tolist() == [1]
        only = np.array([0])
        assert np.array_equal(engine.ambient(last, only), engine.ambient(hits, np.array([1])))
        assert engine.ambient(last, only)[0] == pytest.approx([0.24, 0.18, 0.09])


@pytest.fixture
def _fresh_probe() -> Iterator[None]:
    llvm.find.cache_clear()
    yield
    llvm.find.cache_clear()


@pytest.mark.usefixtures("_fresh_probe")
def test_missing_llvm_is_one_sentence_with_the_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    wanted = MitsubaSpec("llvm")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so"))
    reason = f"Mitsuba does not work with {tmp_path / 'libLLVM.so'}: apt-get install libllvm19"
    assert wanted.unavailable() == reason
    assert wanted.versions()["LLVM"] == "none"
    with pytest.raises(RuntimeError, match=r"mitsuba-spec@llvm cannot run: .*apt-get install libllvm19"):
        wanted.render(CUT, ("id",), Settings())
    assert get("mitsuba-spec").name == "mitsuba-spec@scalar"


@pytest.mark.usefixtures("_fresh_probe")
def test_no_llvm_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(llvm, "_libraries", list)
    assert MitsubaSpec("llvm").unavailable() == "no LLVM library was found: apt-get install libllvm19"


def test_libraries_newest_first_without_those_that_abort(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in (
        "libLLVM-14.so.1",
        "libLLVM-15.so",
        "libLLVM-16.so.1",
        "libLLVM-17.so.1",
        "libLLVM.so.19.1",
        "libLLVM-18.so",
    ):
        (tmp_path / name).touch()
    monkeypatch.setattr(llvm, "FOLDERS", (str(tmp_path),))
    assert [Path(path).name for path in llvm._libraries()] == ["libLLVM.so.19.1", "libLLVM-18.so", "libLLVM-17.so.1"]


def test_import_and_listing_do_not_load_mitsuba() -> None:
    code = "import sys; from validation.renderers import mitsuba; mitsuba.renderers(); print('drjit' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
