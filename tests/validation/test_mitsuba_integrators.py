"""Mitsuba's own integrators as references, stock and with our plugins: what they claim, refuse, draw and may miss."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from converters import mitsuba as converter
from tracer import Light, Scene, Sphere, View, margins, reference
from tracer.passes import MARGINS, SAMPLES, Passes, Sample, names
from validation import compare_passes
from validation.compare import Judge
from validation.ladders import get as get_ladder
from validation.renderers import Renderer, Settings, Uncertainty, get
from validation.renderers.mitsuba import MitsubaSpec, epsilons, path, precision, stock, variants
from validation.renderers.mitsuba.epsilons import RAY_EPSILON
from validation.renderers.mitsuba.path import MitsubaPath
from validation.renderers.mitsuba.stock import MitsubaStock
from validation.rules import Rule
from validation.run import validate
from validation.stability import measure, prove_rung
from validation.truth import Prover

pytestmark = pytest.mark.mitsuba

Need = Callable[[object, str], None]


def sphere(position: tuple[float, float, float], *scaling: float, **changes: Any) -> Sphere:
    sizes = scaling * 3 if len(scaling) == 1 else scaling
    plain: dict[str, Any] = {"name": "s", "color": (0.8, 0.6, 0.3), "ka": 0.3, "kd": 0.6, "ks": 0.0, "kr": 0.0}
    return Sphere(**{**plain, "position": position, "scaling": sizes, "exponent": 12, **changes})


def light(*position: float, intensity: tuple[float, float, float] = (0.9, 0.7, 0.4)) -> Light:
    return Light(name="lamp", position=position, intensity=intensity)


def view(columns: int = 40, rows: int = 40, near: float = 1, half: float = 1) -> View:
    return View(near=near, left=-half, right=half, bottom=-half, top=half, columns=columns, rows=rows)


def scene(spheres: Sequence[Sphere], lights: Sequence[Light], frame: View | None = None) -> Scene:
    return Scene(
        view=frame or view(), spheres=spheres, lights=lights, background=(0.2, 0.3, 0.5), ambient=(0.4, 0.3, 0.2)
    )


BALL = sphere((0, 0.3, -4), 0.8)
MATTE = scene(
    [BALL, sphere((0.3, -1.2, -5), 3, 0.4, 2), sphere((-1.3, 0.2, -3.5), 0.3, 0.6, 0.4)],
    [light(2, 5, 0), light(-4, 1, -1)],
)
MIRRORS = scene(
    [
        sphere((-1.1, 0, -4), 1, kr=0.9, ks=0.4),
        sphere((1.1, 0, -4), 1, kr=0.8),
        sphere((0, 1.8, -5), 1.5, 0.7, 1, kr=0.5, ks=0.5),
        sphere((0, -1.5, -5), 4, 0.3, 3, ks=0.2),
    ],
    [light(2, 5, 0), light(-4, 0, -1)],
)
CUT = scene([sphere((0.2, 0, -1.6), 1.2, 1, 0.9), sphere((1, 1, -4), 1)], [light(0.1, 0.2, -1.5), light(3, 4, 2)])


def mirror(position: tuple[float, float, float], *scaling: float, kr: float = 0.9) -> Sphere:
    """One that is nothing but that."""
    return sphere(position, *scaling, ka=0, kd=0, kr=kr)


#: Two mirrors with balls between them, on a large one.
PURE = scene(
    [
        mirror((-1.2, 0, -5), 1.1),
        mirror((1.3, 0.2, -5.2), 1.1, 1.4, 0.9, kr=0.7),
        sphere((0, -0.6, -3.4), 0.45),
        sphere((0.2, 1.3, -5.5), 0.6, color=(0.2, 0.7, 0.9), ka=0),
        sphere((0, -42, -5), 40, ka=0.1),
    ],
    [light(3, 5, 0), light(-4, 3, -1, intensity=(0.2, -0.3, 0.6))],
    view(half=0.6),
)
#: Chains that end on an inside; mirrors seen from inside.
ROOM = scene(
    [sphere((0, 0, 0), 8), mirror((0.5, 0, -3), 0.8), mirror((-1.5, 0.3, -4), 0.9, 0.5, 0.7)],
    [light(1, 2, 1), light(-3, 2, -3)],
)
HALL = scene(
    [mirror((0, 0, 0), 8, 6, 7, kr=0.8), sphere((0.5, 0, -3), 0.8), sphere((-1.5, 0.3, -4), 0.9)], [light(1, 2, 1)]
)
DULL = scene([BALL, sphere((0.8, -0.4, -3), 0.3, kd=0)], [light(2, 5, 0)])
NEGATIVE = scene([BALL], [light(3, 3, -1), light(0, 1, 0, intensity=(-0.5, 0.2, 0))])
FAR = scene([sphere((0, 0, -1000), 80), sphere((60, 30, -990), 50, 20, 50)], [light(300, 500, -700)], view(half=0.1))

STOCK = {
    "matte": MATTE,
    "cut by the near plane, a light inside": CUT,
    "a surface without diffuse term": DULL,
    "negative light": NEGATIVE,
    "far, and lights farther": FAR,
    "no lights": MATTE.replace(lights=[]),
    "no spheres": scene([], [light(0, 0, 0)]),
    "one pixel": scene([sphere((-1, 1, -1.5), 1)], [light(0, 0, 0)], view(1, 1)),
    "pure mirrors": PURE,
    "pure mirrors, no lights": PURE.replace(lights=[]),
    "pure mirrors alone": PURE.replace(spheres=PURE.spheres[:2]),
    "pure mirrors in a room": ROOM,
    "a mirror around the eye": HALL,
}
PATH = STOCK | {
    "mirrors": MIRRORS,
    "mirrors without lights": MIRRORS.replace(lights=[]),
    "oblong pixels": MIRRORS.replace(view=view(40, 30)),
    "eye inside, mirrors": scene(
        [sphere((0, 0, 0), 6, 5, 7, kr=0.8), sphere((0.5, 0, -3), 0.8, kr=0.5, ks=0.3)], [light(1, 2, 1)]
    ),
    "exponent 0": scene([sphere((0, 0, -4), 1.5, exponent=0, ks=0.4)], [light(3, 3, -1)]),
}


def ready(renderer: Any, need: Need) -> Any:
    need(renderer.unavailable() is None, str(renderer.unavailable()))
    return renderer


@pytest.fixture(params=["scalar", "llvm"])
def stocked(request: pytest.FixtureRequest, need: Need) -> MitsubaStock:
    made: MitsubaStock = ready(MitsubaStock(request.param), need)
    return made


@pytest.fixture(params=["llvm", "scalar"])
def paths(request: pytest.FixtureRequest, need: Need) -> MitsubaPath:
    made: MitsubaPath = ready(MitsubaPath(request.param), need)
    return made


def agree(renderer: Renderer, drawn: Scene, settings: Settings | None = None) -> Passes:
    """Every pass that is claimed, within the derived tolerance, interior and edges as validation counts them."""
    settings = settings or Settings()
    asked = renderer.passes(drawn, settings)
    keywords: dict[str, Any] = {
        "sample": settings.sample,
        "shadow_epsilon": settings.shadow_epsilon,
        "max_reflections": settings.max_reflections,
    }
    expected = reference.render(drawn, asked, **keywords)
    found = renderer.render(drawn, asked, settings)
    assert tuple(found) == asked
    analysis = margins.analyse(drawn, **keywords)
    exact = get("numpy-f64").uncertainty(drawn, settings, analysis)
    judge = Judge(drawn, settings, analysis, exact, renderer.uncertainty(drawn, settings, analysis))
    comparisons = list(compare_passes(expected, found, asked, judge))
    wrong = {comparison.pass_name: comparison.reasons for comparison in comparisons if not comparison.ok}
    assert not wrong
    return found


# ---- what they draw


@pytest.mark.parametrize("name", STOCK)
def test_stock_agrees_with_the_reference(stocked: MitsubaStock, name: str) -> None:
    every = names(len(STOCK[name].lights), margins=False)
    assert tuple(agree(stocked, STOCK[name])) == every


@pytest.mark.parametrize("name", PATH)
def test_path_agrees_with_the_reference(paths: MitsubaPath, name: str) -> None:
    drawn = PATH[name] if paths.backend == "llvm" else PATH[name].replace(view=view(20, 20))
    assert tuple(agree(paths, drawn)) == names(len(drawn.lights), margins=False)


@pytest.mark.parametrize("bounces", [0, 1, 2, 5])
def test_stock_adds_nothing_behind_the_last_mirror(stocked: MitsubaStock, bounces: int) -> None:
    """In a mirror around the eye there is always one mirror more."""
    found = agree(stocked, HALL, Settings(max_reflections=bounces))
    assert f"reflection.{bounces + 1}" not in found
    for k in {1, 3} & {*range(bounces + 1)}:
        assert np.count_nonzero(found[f"reflection.{k}"].any(axis=-1)) > 50


def test_chains_end_where_the_reference_has_it(stocked: MitsubaStock) -> None:
    """As many mirrors, and the point within what is claimed of it: there the AOV is Mitsuba's own."""
    settings = Settings()
    for drawn in (PURE, ROOM, HALL):
        with stocked.ready():
            count, position = stock._ends(drawn, settings)
            seen = stock.surfaces(drawn, settings)
        passes = reference.render(drawn, [f"reflection.{k}" for k in (1, 2, 3)])
        for k in (1, 2, 3):
            # Where nothing is lit nothing shows.
            assert np.mean(passes[f"reflection.{k}"].any(axis=-1) & (count != k)) < 2e-3
        ids = np.asarray(seen["id"])
        ends = np.isin(ids, [i for i, entry in enumerate(drawn.spheres) if not entry.kr])
        assert ends.sum() > 50
        assert not count[ends].any()
        centers = np.array([entry.position for entry in drawn.spheres])[ids]
        radii = np.array([entry.scaling[0] for entry in drawn.spheres])[ids][..., None]
        known = epsilons.LOOKUP * precision.UNIT_ROUNDOFF * (np.abs(seen["position"]) + np.abs(centers) + 4 * radii)
        off = np.abs(position - seen["position"])
        assert np.all(off[ends] <= known[ends])
        assert (off / known)[ends].max() > 0.02


def test_more_depth_would_add_light_between_matt_surfaces(stocked: MitsubaStock) -> None:
    """So each pixel is taken from the image with just its depth."""
    with stocked.ready():
        count, _ = stock._ends(ROOM, Settings())
        images = stock.paths(converter.chain_dict(ROOM.replace(background=(0, 0, 0)), "light"), [3, 4, 5])
    for k in (1, 2):
        alone, more = images[k - 1][count == k], images[k][count == k]
        assert np.all(more >= alone)
        assert (more > 1.001 * alone).any(axis=-1).mean() > 0.1


def test_the_ids_of_stock_are_exact_and_its_values_close_to_native(stocked: MitsubaStock) -> None:
    found = stocked.render(MATTE, ("id", "ambient", "diffuse"), Settings())
    native = get("native-f64").render(MATTE, ("id", "ambient", "diffuse"), Settings())
    assert np.array_equal(found["id"], native["id"])
    assert {*np.unique(found["id"])} == {-1, 0, 1, 2}
    assert np.abs(found["ambient"] - native["ambient"]).max() < 1e-6
    off = np.abs(found["diffuse"] - native["diffuse"]).max(axis=-1)
    assert np.quantile(off, 0.99) < 5e-6


@pytest.mark.parametrize("sample", SAMPLES)
def test_sample_positions(stocked: MitsubaStock, sample: Sample) -> None:
    frame = View(near=1, left=-0.4, right=1.1, bottom=-0.9, top=0.6, columns=30, rows=30)
    agree(stocked, MATTE.replace(view=frame), Settings(sample))


@pytest.mark.parametrize("bounces", [0, 1, 5])
def test_bounces(paths: MitsubaPath, bounces: int) -> None:
    found = agree(paths, MIRRORS.replace(view=view(20, 20)), Settings(max_reflections=bounces))
    assert f"reflection.{bounces + 1}" not in found
    assert (found["reflection"].max() > 0) == (bounces > 0)


@pytest.mark.parametrize("epsilon", [1e-3, 1e-2, 0])
def test_another_shadow_epsilon_is_claimed(stocked: MitsubaStock, epsilon: float) -> None:
    """Mitsuba's is its own: what the specification's is, says where they may differ."""
    floor, disc = sphere((0, -1, -5), 3, 0.5, 3), sphere((0, -0.4, -5), 1.5, 0.05, 1.5)
    agree(stocked, scene([floor, disc], [light(0, 9.5, -5)], view(24, 24)), Settings(shadow_epsilon=epsilon))


@pytest.mark.parametrize("seed", range(6))
def test_path_agrees_on_random_scenes(need: Need, seed: int) -> None:
    chance = random.Random(seed)
    spheres = []
    for _ in range(chance.randint(2, 5)):
        depth, size = chance.uniform(2, 10), chance.uniform(0.3, 2)
        place = (chance.uniform(-depth, depth), chance.uniform(-depth, depth), -depth)
        sizes = [size * chance.uniform(0.3, 1.5) for _ in range(3)] if chance.random() < 0.6 else [size]
        exponent = chance.choice((0, 0.5, 3, 80))
        spheres.append(
            sphere(place, *sizes, kr=chance.choice((0, 0.5, 1)), ks=chance.choice((0, 0.5)), exponent=exponent)
        )
    lights = [light(*(chance.uniform(-8, 8) for _ in range(3))) for _ in range(chance.randint(1, 2))]
    agree(
        ready(MitsubaPath("llvm"), need), scene(spheres, lights, view(chance.randint(20, 40), chance.randint(20, 40)))
    )


def test_light_at_the_hit_itself_is_no_number_but_no_light(stocked: MitsubaStock) -> None:
    """The falloff is undone with 0 there, and the stock light infinite."""
    drawn = scene([sphere((0, 0, -4), 1)], [light(0, 0, -3)], view(2, 2))
    position, hit = np.broadcast_to([0.0, 0.0, -3.0], (2, 2, 3)), np.ones((2, 2), bool)
    with stocked.ready():
        diffuse, visible = stock.light(drawn, 0, Settings(), position, hit, diffuse=True)
    assert not diffuse.any()
    assert visible.all()
    assert np.isfinite(stocked.render(drawn, ("diffuse",), Settings())["diffuse"]).all()


def test_only_the_passes_asked_for(stocked: MitsubaStock, need: Need) -> None:
    for renderer in (stocked, ready(MitsubaPath("llvm"), need)):
        assert tuple(renderer.render(MATTE, ["id", "shadow.L1"], Settings())) == ("id", "shadow.L1")
        with pytest.raises(ValueError, match=r"has no pass 'shadow\.L2' for this scene"):
            renderer.render(MATTE, ["shadow.L2"], Settings())


def test_parts_add_up_whatever_is_asked_for(need: Need) -> None:
    """Each reflection is the difference of two images, of which there are only those that are needed."""
    renderer = ready(MitsubaPath("llvm"), need)
    every = renderer.render(MIRRORS, names(2, margins=False), Settings())
    for name in ("reflection.2", "reflection", "beauty", "direct", "ambient", "specular"):
        alone = renderer.render(MIRRORS, (name,), Settings())
        assert np.array_equal(alone[name], every[name])
    assert np.abs(sum(every[f"reflection.{k}"] for k in (1, 2, 3)) - every["reflection"]).max() < 1e-12


# ---- what they claim and refuse


LIT = {"diffuse", "shadow.L0", "shadow.L1"}
BARE = {"ambient", "depth", "position", "normal", "id"}
MIRRORED = {"reflection", "reflection.1", "reflection.2", "reflection.3"}
TINY = sphere((0.5, 0.5, -3), 1e-3, 1, 1)


@pytest.mark.parametrize(
    ("drawn", "lacks"),
    [
        (MATTE, set()),
        (MATTE.replace(spheres=[*MATTE.spheres, sphere((2, 2, -6), 1, ks=0.1)]), {"specular", "direct", "beauty"}),
        (MATTE.replace(spheres=[*MATTE.spheres, sphere((2, 2, -6), 1, kr=0.1)]), MIRRORED | {"beauty"}),
        (MATTE.replace(spheres=[*MATTE.spheres, TINY]), {*LIT, "specular", "direct", "beauty"}),
        (MIRRORS, MIRRORED | {"specular", "direct", "beauty"}),
        (PURE, set()),
        # A mirror with a term of its own, an end that is an ellipsoid, a highlight, a mirror that is too small.
        (PURE.replace(spheres=[*PURE.spheres[1:], sphere((2, 2, -6), 1, kr=0.1)]), MIRRORED | {"beauty"}),
        (PURE.replace(spheres=[*PURE.spheres[1:], sphere((2, 2, -6), 1, 2, 1)]), MIRRORED | {"beauty"}),
        (
            PURE.replace(spheres=[*PURE.spheres[1:], sphere((2, 2, -6), 1, ks=0.1)]),
            MIRRORED | {"specular", "direct", "beauty"},
        ),
        (
            PURE.replace(spheres=[*PURE.spheres[1:], mirror((0.5, 0.5, -3), 1e-3)]),
            MIRRORED | LIT | {"specular", "direct", "beauty"},
        ),
        # Black is no term.
        (PURE.replace(spheres=[*PURE.spheres[1:], sphere((2, 2, -6), 1, kr=0.1, color=(0, 0, 0))]), set()),
    ],
)
def test_stock_claims_what_it_can_say(drawn: Scene, lacks: set[str]) -> None:
    for backend in ("scalar", "llvm"):
        renderer = MitsubaStock(backend)
        assert set(names(2, margins=False)) - set(renderer.passes(drawn, Settings())) == lacks
        assert renderer.sources(drawn, Settings()).keys() == set(renderer.passes(drawn, Settings()))
        assert renderer.precision == "f32"


def test_what_is_absent_is_no_hindrance() -> None:
    """Neither highlights nor small spheres matter without lights, nor mirrors without reflections."""
    shiny = scene([sphere((0, 0, -4), 1, ks=0.5), TINY], [])
    assert set(MitsubaStock("scalar").passes(shiny, Settings())) == set(names(0, margins=False))
    assert "reflection" in MitsubaStock("scalar").passes(MIRRORS, Settings(max_reflections=0))
    for most, reflects in ((stock.DEEPEST, True), (stock.DEEPEST + 1, False)):
        assert ("beauty" in MitsubaStock("scalar").passes(PURE, Settings(max_reflections=most))) == reflects
    assert MitsubaStock("scalar").sources(PURE, Settings())["reflection.1"] == "stock"
    assert MitsubaStock("scalar").sources(MATTE, Settings())["reflection.1"] == "derived"
    assert set(MitsubaPath("llvm").passes(shiny, Settings())) == set(names(0, margins=False))


def test_path_claims_everything_but_what_small_spheres_shade() -> None:
    renderer = MitsubaPath("llvm")
    assert renderer.passes(MIRRORS, Settings()) == names(2, margins=False)
    small = MIRRORS.replace(spheres=[*MIRRORS.spheres, TINY])
    assert set(renderer.passes(small, Settings())) == BARE
    sources = renderer.sources(MIRRORS, Settings())
    assert (sources["beauty"], sources["reflection.1"], sources["id"]) == ("plugin", "derived", "stock")


def test_scenes_a_thousand_times_smaller_keep_their_surfaces_alone(stocked: MitsubaStock) -> None:
    """The step beside a surface does not shrink with the scene."""
    small = scene(
        [sphere((0, 0, -0.004), 0.0005), sphere((0.001, 0.001, -0.003), 0.0004)],
        [light(1, 1, 0)],
        view(near=1e-3, half=1e-3),
    )
    assert epsilons.too_small(small, Settings()) == 1
    assert set(agree(stocked, small)) == BARE | MIRRORED | {"ambient"}


def test_how_small_is_too_small() -> None:
    """Against the step at the farthest point, and the shadow epsilon as far as the farthest light."""
    reach = RAY_EPSILON * (1 + 5) + 1e-4 * (5 + 10)
    for part, expected in ((0.99, 0), (1.01, None)):
        scaling = 8 * reach * part
        drawn = scene([sphere((0, 0, -5 + scaling), scaling)], [light(0, 10, 0)])
        assert epsilons.reach(drawn, Settings()) == pytest.approx(reach)
        assert epsilons.too_small(drawn, Settings()) == expected


def test_refusals() -> None:
    wide = MATTE.replace(view=view(40, 30))
    huge = MATTE.replace(lights=[light(1e16, 0, 0)])
    assert MitsubaStock("scalar").passes(wide, Settings()) == ()
    assert MitsubaStock("scalar").refusal(wide) == "pixels that are not square need a camera of ours"
    assert MitsubaPath("llvm").passes(wide, Settings())
    for renderer in (MitsubaStock("scalar"), MitsubaPath("llvm"), MitsubaSpec("llvm")):
        assert renderer.passes(huge, Settings()) == ()
        assert renderer.refusal(huge).startswith("it has numbers outside 1e-15 to 1e+15")
    balls = MATTE.replace(spheres=[BALL])
    for gpu in (MitsubaStock("cuda"), MitsubaPath("cuda"), MitsubaSpec("cuda")):
        assert gpu.passes(MATTE, Settings()) == ()
        assert gpu.refusal(MATTE).startswith("it has ellipsoids")
        assert gpu.passes(balls, Settings())


def test_a_missing_gpu_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    gpu = MitsubaPath("cuda")
    try:
        monkeypatch.setattr(variants, "DRIVER", str(tmp_path / "version"))
        variants.cuda.cache_clear()
        reason = gpu.unavailable()
        assert str(reason).startswith("no NVIDIA driver was found: the variant cuda needs an NVIDIA GPU")
        assert gpu.versions()["CUDA"] == "none"
        with pytest.raises(RuntimeError, match=r"mitsuba-path@cuda cannot run: no NVIDIA driver"):
            gpu.render(scene([BALL], []), ("id",), Settings())
        (tmp_path / "version").touch()
        monkeypatch.setattr(variants, "_PROBE", "import os; os.abort()")
        variants.cuda.cache_clear()
        assert str(gpu.unavailable()).startswith("Mitsuba does not work with the NVIDIA driver")
        monkeypatch.setattr(variants, "_PROBE", "print('12.4')")
        variants.cuda.cache_clear()
        assert gpu.unavailable() is None
        assert gpu.versions()["CUDA"] == "12.4"
    finally:
        variants.cuda.cache_clear()


def test_path_in_scalar_draws_what_it_can_in_time() -> None:
    """The limit is a count: larger for less work, and none for small pictures."""
    scalar, large = MitsubaPath("scalar"), MIRRORS.replace(view=view(2000, 2000))
    beauty, direct, id = (scalar.max_pixels(large, (name,)) for name in ("beauty", "direct", "id"))
    assert beauty is not None
    assert direct is not None
    assert 32 * 32 <= beauty < direct < 2000 * 2000
    assert id is None
    assert scalar.max_pixels(large.replace(view=view(2000, 1000)), ("id",)) is not None
    assert scalar.max_pixels(MIRRORS.replace(view=view(8, 8)), ("beauty",)) is None
    for quick in (MitsubaPath("llvm"), MitsubaStock("scalar"), MitsubaStock("llvm")):
        assert quick.max_pixels(large, ("beauty",)) is None


# ---- their epsilons


def judged(renderer: Renderer, drawn: Scene, passes: Sequence[str] | None = None) -> Any:
    return validate({"scene": drawn}, "native-f64", renderer, passes=passes, verdicts=8)


#: A light 0.008 inside a ball, 12 above the floor: the ball begins at t = 0.9993, and Mitsuba's shadow rays end before.
LATE = scene([sphere((0, -3, -6), 4, 1, 4), sphere((0, 11.992, -6), 2)], [light(0, 10, -6)], view(24, 24, half=0.8))
#: A ball in the floor: near the seam their distance is below the step.
SEAM = scene([sphere((0, -3, -6), 4, 1, 4), sphere((0, -1.3, -6), 0.7)], [light(5, 3, -3)], view(60, 60, half=0.5))


def test_a_ball_beside_the_light_hides_it_and_the_rule_says_why_mitsuba_lets_it_past(stocked: MitsubaStock) -> None:
    found = stocked.render(LATE, ("shadow.L0", "id"), Settings())
    native = get("native-f64").render(LATE, ("shadow.L0", "id"), Settings())
    floor = (native["id"] == 0) & (found["id"] == 0)
    differ = floor & (native["shadow.L0"] != found["shadow.L0"])
    assert differ.sum() > 100
    (rule, *_) = stocked.rules(LATE, Settings())
    assert "8.94e-05 beside surfaces" in rule.says
    assert "t = 0.9991" in rule.says
    followed = Prover(LATE, follower=rule.follower)
    for y, x in list(zip(*np.nonzero(differ), strict=True))[::20]:
        assert followed.pixel(int(x), int(y)).values["shadow.L0"][0].value == found["shadow.L0"][y, x]


def test_what_mirrors_show_is_claimed_of_the_passes_that_show_it() -> None:
    analysis = margins.analyse(PURE)
    exact = precision.uncertainty(PURE, Settings(), float32_roots=True)
    claims = {kind: kind("llvm").uncertainty(PURE, Settings(), analysis) for kind in (MitsubaPath, MitsubaStock)}
    for claim in claims.values():
        for name in ("ambient", "diffuse", "specular", "direct"):
            assert claim.absolute_of(name) == exact.absolute_of(name)
        for name in ("beauty", "reflection", "reflection.2"):
            color = np.asarray(claim.absolute_of(name))
            assert 1e-4 < color[analysis.ids == 0].max() < 0.1
            if claim is claims[MitsubaStock]:
                assert np.all(color[analysis.ids > 1] == exact.absolute_of(name))
    # What is lost with the falloff of lights is stock's alone.
    rounded = 8 * precision.UNIT_ROUNDOFF * path.brightest(PURE, Settings())
    looked_up = np.asarray(claims[MitsubaStock].absolute_of("beauty"))
    plain = np.asarray(claims[MitsubaPath].absolute_of("beauty")) - rounded
    lit = (analysis.ids == 0) & (plain > 1e-9)
    assert np.all(looked_up[lit] > plain[lit])
    assert np.all(looked_up[lit] < plain[lit] + 1e-3)


@pytest.mark.parametrize("drawn", [LATE, MIRRORS], ids=["late", "mirrors"])
def test_differences_are_explained_by_the_rule_and_by_nothing_else(need: Need, drawn: Scene) -> None:
    renderer = ready(MitsubaPath("llvm"), need)
    if drawn is MIRRORS:
        drawn = drawn.replace(view=view(200, 200))
    found = judged(renderer, drawn)
    assert found.verdicts
    assert all(entry.explained for entry in found.verdicts)
    # Where a light shines through a ball on the whole floor, that is explained, but no check of the picture.
    assert found.ok == (drawn is not LATE)
    causes = [verdict.reference.cause for entry in found.verdicts for verdict in entry.verdicts]
    assert causes.count("rule") > 0

    class Silent(MitsubaPath):
        """The same without its documents: neither a rule, nor what that brings it to claim."""

        def rules(self, scene: Scene, settings: Settings) -> Sequence[Rule]:
            del scene, settings
            return ()

        def uncertainty(
            self, scene: Scene, settings: Settings, analysis: margins.Analysis | None = None
        ) -> Uncertainty:
            del analysis
            return precision.uncertainty(scene, settings, float32_roots=True)

    assert not all(entry.explained for entry in judged(Silent("llvm"), drawn).verdicts)


def changed(drawn: Scene, *, mirrors: bool = True) -> tuple[Any, Any, list[Any], list[Any]]:
    """Claims of `path@scalar`, margins, and both chains of all pixels."""
    settings = Settings()
    analysis = margins.analyse(drawn)
    tables = reference.Tables(drawn, np.float64)
    direction = reference.eye_rays(tables, drawn.view, "corner", range(drawn.view.rows)).direction
    with np.errstate(all="ignore"):
        chains = [list(epsilons.Chains(drawn, settings, moved=moved).follow(direction)) for moved in (False, True)]
    claims = epsilons.uncertainty(drawn, settings, analysis, float32_roots=False, mirrors=mirrors, shadows=True)
    return claims, analysis, chains[0], chains[1]


@pytest.mark.parametrize("drawn", [MATTE, MIRRORS, SEAM, CUT, PATH["eye inside, mirrors"]])
def test_the_chain_by_the_specification_is_the_reference(drawn: Scene) -> None:
    _, analysis, exact, _ = changed(drawn)
    expected = reference.render(drawn, ("ambient", "direct", *(f"reflection.{k}" for k in (1, 2, 3)), "shadow.L0"))
    assert np.array_equal(exact[0].sphere, analysis.ids.ravel())
    parts = [expected["ambient"] + expected["direct"], *(expected[f"reflection.{k}"] for k in (1, 2, 3))]
    for bounce, part in zip(exact, parts, strict=False):
        assert np.abs(bounce.color.T - np.asarray(part).reshape(-1, 3)).max() < 1e-9
    facing = exact[0].facing[0]
    assert np.array_equal(exact[0].visible[0][facing], expected["shadow.L0"].ravel()[facing] > 0)


@pytest.mark.parametrize("drawn", [MIRRORS, SEAM], ids=["mirrors", "seam"])
def test_the_chain_by_the_epsilons_is_the_rule(drawn: Scene) -> None:
    """The arrays that claims come from and the follower that verdicts come from are two writings of one thing."""
    _, _, _, moved = changed(drawn)
    rule, *_ = epsilons.rules(drawn, Settings(), float32_roots=False)
    prover = Prover(drawn, follower=rule.follower)
    chance = random.Random(1)
    columns = drawn.view.columns
    for pixel in chance.sample(range(columns * drawn.view.rows), 40):
        truth = prover.pixel(pixel % columns, pixel // columns, ties=False)
        assert truth.id == moved[0].sphere[pixel]
        for k, bounce in enumerate(moved[1:], 1):
            expected = [ball.value for ball in truth.values[f"reflection.{k}"]]
            assert bounce.color[:, pixel] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("drawn", [LATE, MIRRORS, SEAM, CUT, PATH["eye inside, mirrors"]])
def test_where_epsilons_decide_otherwise_is_an_edge_and_elsewhere_colours_are_claimed(drawn: Scene) -> None:
    drawn = drawn.replace(view=drawn.view.replace(columns=200, rows=200))
    claims, analysis, exact, moved = changed(drawn)
    edge = np.any([analysis.margins[kind] < getattr(claims, kind) for kind in MARGINS], axis=0).ravel()
    off = np.zeros(edge.size)
    parted = np.zeros(edge.size, bool)
    for a, b in zip(exact, moved, strict=False):
        parted |= (a.sphere != b.sphere) | ((a.visible != b.visible) & a.facing & b.facing).any(axis=0)
        off += 0 if a is exact[0] else np.abs(a.color - b.color).max(axis=0)
    assert edge[parted].all()
    assert parted.any()
    color = np.broadcast_to(claims.absolute_of("reflection"), analysis.ids.shape).ravel()
    assert np.all(off[~edge] <= color[~edge] * (1 + 1e-12))
    # No excuse for an image: few pixels claim more than roundings, but where the whole floor is dark by 0.0007.
    assert edge.mean() < 0.05 or drawn.lights == LATE.lights


def mirrors_apart(ambient: float, *, frame: View, **scalings: tuple[tuple[float, ...], ...]) -> Scene:
    """Mirrors that shine by themselves, each so much more than the one before."""
    spheres = [
        sphere((x, y, z), *sizes, ka=ambient * (k + 1), kd=0, kr=1, color=(1, 1, 1))
        for k, ((x, y, z), sizes) in enumerate(scalings.values())
    ]
    return scene(spheres, [], frame)


#: Thin lenses that cross, seen from inside: near their rims a ray goes to and fro, and a step grows a hundredfold.
LENSES = mirrors_apart(
    0.3,
    frame=View(near=0.02, left=-0.28, right=0.25, bottom=0.3, top=0.8, columns=40, rows=40),
    thin=((0, 0, 0), (1, 0.7, 0.02)),
    ball=((-1.25, 0, 0), (1.5, 1.5, 1.5)),
    thick=((0, 0.25, -0.04), (0.7, 1, 0.03)),
)
#: Of these, one of the pixels is shown a lens that lies behind its ray by the specification: no quantity is near 0.
RIMS = mirrors_apart(
    0.3,
    frame=View(near=1.28, left=-18, right=32, bottom=-2, top=48, columns=25, rows=25),
    wide=((-16, 0, 1.28), (62.72, 160, 2.56)),
    narrow=((0, 16, -2.56), (44.8, 64, 1.92)),
)


@pytest.mark.parametrize("drawn", [LENSES, RIMS], ids=["lenses", "rims"])
def test_steps_that_grow_from_mirror_to_mirror_are_claimed(paths: MitsubaPath, drawn: Scene) -> None:
    """As far as they come, and where no quantity says that two chains of rays part, the nearest decision does."""
    claims, analysis, exact, moved = changed(drawn)
    edge = np.any([analysis.margins[kind] < getattr(claims, kind) for kind in MARGINS], axis=0)
    parted = np.zeros(edge.size, bool)
    for a, b in zip(exact, moved, strict=False):
        parted |= a.sphere != b.sphere
    assert parted.sum() > 10
    assert edge.ravel()[parted].all()
    assert not edge.all()
    if drawn is LENSES:
        # Mostly it is another hit that is nearer, and that is what is claimed.
        assert np.mean((analysis.margins["order"] < claims.order).ravel()[parted]) > 0.9
    passes = ("beauty", "reflection.2", "reflection.3")
    expected, found = reference.render(drawn, passes), paths.render(drawn, passes, Settings())
    differ = np.any([np.abs(expected[name] - found[name]).max(axis=-1) > 0.01 for name in passes], axis=0)
    assert differ.sum() > 10
    assert edge[differ].all()


#: The ray in the middle touches the slim ball, exactly also in float32, and goes on to the inside of the other.
TOUCHED = scene(
    [
        sphere((0.25, 0, -0.75), 0.25, 0.65, 0.5, ka=0, kd=0.5, kr=0.5),
        sphere((0, -0.25, -0.5), 0.4, 0.8, 0.6, kd=0.5, kr=1),
    ],
    [light(0, 0, 0)],
    View(near=0.5, left=-2 / 3, right=2 / 3, bottom=-0.5, top=0.5, columns=40, rows=30),
)


def test_a_ray_that_touches_may_go_on_inside(need: Need) -> None:
    """The rounded normal of the touched point looks away: the mirrored ray starts a step within the ball."""
    renderer = ready(MitsubaPath("llvm"), need)
    passes = ("id", "normal", "diffuse", "reflection.1", "reflection.2", "reflection.3")
    found = renderer.render(TOUCHED, passes, Settings())
    beside, _, turned = renderer.rules(TOUCHED, Settings())
    assert turned.choices is not None

    def made(follower: Any) -> bool:
        values = Prover(TOUCHED, follower=follower).pixel(20, 15, ties=False).values
        return all(
            np.atleast_1d(found[name][15, 20]) == pytest.approx([ball.value for ball in values[name]], abs=1e-3)
            for name in passes
        )

    assert not made(beside.follower)
    (follower,) = turned.choices(20, 15)
    assert made(follower)
    # Beside an outline alone.
    assert not list(turned.choices(22, 15))
    (judgement,) = judged(renderer, TOUCHED).verdicts
    assert judgement.explained
    assert any("rounded normal" in entry.reference.because for entry in judgement.verdicts)


def test_a_ball_all_behind_the_end_of_shadow_rays_is_an_edge(stocked: MitsubaStock) -> None:
    """0.005 to 0.085 before a light 100 away, with no shadow epsilon: no quantity of the decision is near 0."""
    floor, settings = sphere((0, -50.5, -1.5), 1, 0.5, 1), Settings(shadow_epsilon=0)
    frame = View(near=0.015, left=-0.005, right=0.005, bottom=-0.505, top=-0.495, columns=30, rows=30)
    drawn = scene([floor, sphere((0, 49.955, -1.5), 0.04)], [light(0, 50, -1.5)], frame)
    exact = reference.render(drawn, ("shadow.L0",), shadow_epsilon=0)["shadow.L0"]
    found = stocked.render(drawn, ("shadow.L0", "id"), settings)
    assert np.all(found["id"] == 0)
    differ = exact != found["shadow.L0"]
    assert differ.any()
    analysis = margins.analyse(drawn, shadow_epsilon=0)
    claims = stocked.uncertainty(drawn, settings, analysis)
    edge = np.any([analysis.lighted[kind] < getattr(claims, kind) for kind in MARGINS], axis=0)
    assert edge[differ].all()


def test_a_light_just_inside_a_ball_is_hidden_by_it_for_us_alone(stocked: MitsubaStock) -> None:
    """Mitsuba's shadow rays end before they come to the ball; the margin of that knows no more than light and ball."""
    ball = sphere((-1, 0, -2.3), 0.5)
    drawn = scene([sphere((0, 0, 0), 14), ball], [light(-0.898, -0.459, -2.147)], view(24, 24))
    found = agree(stocked, drawn)
    exact = reference.render(drawn, ("shadow.L0",))["shadow.L0"]
    assert np.count_nonzero(exact != found["shadow.L0"]) > 20


@pytest.mark.parametrize(("radius", "lost"), [(50, 0), (1e5, 60)])
def test_a_step_smaller_than_roundings_is_an_edge(stocked: MitsubaStock, radius: float, lost: int) -> None:
    """A floor that is so large that its points in float32 lie below it, and so may hide all lights."""
    floor = mirror((0, -radius - 30, -70), radius, kr=0.9)
    drawn = scene([sphere((0, 0, 0), 400), floor], [light(-190, 200, -230)], view(30, 30))
    analysis = margins.analyse(drawn)
    claims = stocked.uncertainty(drawn, Settings(), analysis)
    edge = {name: Judge(drawn, Settings(), analysis, claims, claims).edge(name) for name in ("shadow.L0", "reflection")}
    assert np.count_nonzero(np.isinf(claims.absolute_of("reflection"))) >= lost
    assert np.isinf(claims.terminator).any() == (lost > 0)
    expected, found = (
        reference.render(drawn, ("shadow.L0", "reflection.1")),
        stocked.render(drawn, ("shadow.L0", "reflection.1"), Settings()),
    )
    differ = (expected["shadow.L0"] != found["shadow.L0"]) & analysis.lit[0]
    assert edge["shadow.L0"][differ].all()
    off = np.abs(expected["reflection.1"] - found["reflection.1"]).max(axis=-1) > 0.05
    assert edge["reflection"][off].all()
    assert off.any() == (lost > 0)


def test_pure_mirrors_differ_only_by_rules_and_roundings(stocked: MitsubaStock) -> None:
    """Shadows that mirrors show have the epsilons of Mitsuba, too."""
    found = judged(stocked, PURE.replace(view=view(160, 160)), ["beauty", "reflection"])
    assert found.ok
    assert found.verdicts[0].verdicts
    assert all(entry.explained for entry in found.verdicts)


def test_own_decisions_of_float32_are_a_rule_of_their_own() -> None:
    """A small ball far from the floor that it shades: the plain quadratic cannot tell its outline there."""
    ball = sphere((0, 30, -6), 0.05)
    drawn = scene([sphere((0, -3, -6), 4, 1, 4), ball], [light(0, 31, -6)], view(400, 400, half=0.8))
    scalar = [rule.says for rule in epsilons.rules(drawn, Settings(), float32_roots=False)]
    beside, blurred, turned = epsilons.rules(drawn, Settings(), float32_roots=True)
    assert scalar == [beside.says, turned.says]
    assert blurred.choices is not None
    exact = reference.render(drawn, ("shadow.L0", "id"))
    outline = (exact["id"] == 0) & (np.abs(np.diff(exact["shadow.L0"], axis=1, prepend=0)) > 0)
    places = np.argwhere(outline)
    assert len(places) > 20
    open_ones = 0
    for y, x in places[:: len(places) // 20]:
        before = Prover(drawn, follower=beside.follower).pixel(int(x), int(y)).values["shadow.L0"][0].value
        for follower in blurred.choices(int(x), int(y)):
            assert Prover(drawn, follower=follower).pixel(int(x), int(y)).values["shadow.L0"][0].value != before
            open_ones += 1
    assert open_ones
    assert not list(blurred.choices(1, 1))


def test_float32_claims_more_of_small_far_shades_only() -> None:
    ball = sphere((0, 30, -6), 0.05)
    drawn = scene([sphere((0, -3, -6), 4, 1, 4), ball], [light(0, 31, -6)], view(100, 100, half=0.8))
    analysis = margins.analyse(drawn)
    silhouette = {
        roots: epsilons.uncertainty(
            drawn, Settings(), analysis, float32_roots=roots, mirrors=False, shadows=True
        ).silhouette
        for roots in (False, True)
    }
    more = np.asarray(silhouette[True]) > 2 * np.asarray(silhouette[False])
    assert 0 < more.sum() < 0.2 * more.size


def test_oblique_ellipsoids_are_less_certain_in_float32_and_near_their_outline_only() -> None:
    # A ray (0, y, -1) touches the plate where B^2 = A C, a quadratic in y; the picture is about its far edge.
    wy, wz = 0.05**-2, 6.0**-2
    c = wy * 1.5**2 + wz * 100 - 1
    top = max(np.roots([wy**2 * 1.5**2 - wy * c, -2 * wy * wz * 15, wz**2 * 100 - wz * c]))
    frame = View(near=1, left=-1e-4, right=1e-4, bottom=top - 1e-4, top=top + 1e-4, columns=100, rows=100)
    drawn = scene([sphere((0, -1.5, -10), 6, 0.05, 6)], [], frame)
    analysis = margins.analyse(drawn)
    assert {*np.unique(analysis.ids)} == {-1, 0}
    scalar, llvm = (
        np.asarray(MitsubaPath(name).uncertainty(drawn, Settings(), analysis).silhouette) for name in ("scalar", "llvm")
    )
    less = llvm > 1.5 * scalar
    assert 0 < less.sum() < 0.5 * less.size
    assert np.all(analysis.margins["silhouette"][less] < 0.01)
    assert np.array_equal(llvm[~less].round(9), scalar[~less].round(9))


def test_the_brightest_pixel_is_not_brighter() -> None:
    drawn = reference.render(MIRRORS, ("beauty", "reflection.1"))
    hit = reference.render(MIRRORS, ("id",))["id"] >= 0
    assert drawn["beauty"][hit].max() <= path.brightest(MIRRORS, Settings())
    assert path.brightest(MIRRORS, Settings(max_reflections=0)) == pytest.approx(0.3 * 0.4 + (0.6 + 0.5) * 1.8)


def test_surfaces_know_the_inside(need: Need) -> None:
    """Beside an outline the angle of ray and normal does not tell; the start of the ray does."""
    renderer = ready(MitsubaStock("scalar"), need)
    found = renderer.render(CUT, ("normal", "position", "id"), Settings())
    expected = reference.render(CUT, ("normal", "id"))
    hit = found["id"] >= 0
    assert np.all((found["normal"] * expected["normal"]).sum(axis=-1)[hit] > 0.9)
    assert stock.SURFACES == ("depth", "position", "normal", "id")


# ---- the same by Mitsuba's own program


def by_program(drawn: Scene, folder: Path, **options: Any) -> dict[str, Any]:
    """The channels of what the command `mitsuba` makes of an XML file without plugins of ours."""
    converter.write_xml(drawn, folder / "scene.xml", stock_only=True, **options)
    return drawn_by_program(folder / "scene.xml")


def drawn_by_program(path: Path) -> dict[str, Any]:
    """The channels of its image of a file."""
    import OpenEXR

    image = path.with_suffix(".exr")
    command = [str(Path(sys.executable).parent / "mitsuba"), "-m", "scalar_rgb", str(path), "-o", str(image)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    with OpenEXR.File(str(image), separate_channels=True) as file:
        return {name: np.array(channel.pixels, dtype=np.float64) for name, channel in file.channels().items()}


def test_the_program_draws_what_the_renderer_does(tmp_path: Path) -> None:
    """One light of MATTE: the image times pi d^2 is the pass of the renderer, and of native within its tolerance."""
    renderer, settings = MitsubaStock("scalar"), Settings()
    one = MATTE.replace(lights=MATTE.lights[:1], background=(0, 0, 0))
    asked = ("diffuse", "position", "normal")
    found = renderer.render(one, asked, settings)
    channels = by_program(one, tmp_path, light=0)
    position = stock.stacked(channels, "position.", "XYZ")
    squared = ((position - one.lights[0].position) ** 2).sum(axis=-1)[..., None]
    image = stock.stacked(channels) * np.pi * squared
    assert position == pytest.approx(found["position"], abs=1e-12)
    assert image == pytest.approx(found["diffuse"], rel=2e-6, abs=1e-9)
    analysis = margins.analyse(one)
    exact = get("native-f64").uncertainty(one, settings, analysis)
    judge = Judge(one, settings, analysis, exact, renderer.uncertainty(one, settings, analysis))
    native = get("native-f64").render(one, (*asked, "id"), settings)
    program = Passes({"diffuse": image, "position": position, "normal": found["normal"], "id": native["id"]})
    comparisons = list(compare_passes(native, program, asked, judge))
    assert all(comparison.ok for comparison in comparisons)
    assert comparisons[0].interior > 0.9 * native["id"].size


def test_the_program_draws_the_ambient_term_of_the_renderer(tmp_path: Path) -> None:
    renderer = MitsubaStock("scalar")
    ambient = MATTE.replace(spheres=[entry.replace(kd=0) for entry in MATTE.spheres])
    channels = by_program(ambient, tmp_path)
    found = renderer.render(ambient, ("ambient",), Settings())["ambient"]
    assert found.max() > 0.05
    assert stock.stacked(channels, "albedo.") * ambient.ambient == pytest.approx(found, abs=1e-12)


def test_the_program_draws_what_a_mirror_shows(tmp_path: Path) -> None:
    """One light, and the pixels with one mirror; all that is ours is where its file leads."""
    import mitsuba as mi

    renderer, one = MitsubaStock("scalar"), PURE.replace(lights=PURE.lights[:1], background=(0, 0, 0))
    with renderer.ready():
        found = renderer.render(one, ("reflection.1", "ambient"), Settings())["reflection.1"]
        count, position = stock._ends(one, Settings())
        described = converter.chain_dict(one, "light") | {"integrator": {"type": "path", "max_depth": 3}}
        text = mi.parser.write_string(mi.parser.parse_dict(mi.parser.ParserConfig("scalar_rgb"), described))
        ambient = stock._shining(one, "ambient", Settings()) * np.array(one.ambient)
    assert "whitted_" not in text
    (tmp_path / "s.xml").write_text(text, encoding="utf-8")
    squared = ((position - one.lights[0].position) ** 2).sum(axis=-1)[..., None]
    image = stock.stacked(drawn_by_program(tmp_path / "s.xml")) * np.pi * squared + ambient
    assert np.count_nonzero(count == 1) > 100
    assert image[count == 1] == pytest.approx(found[count == 1], rel=2e-6, abs=1e-9)


def test_the_ambient_term_is_everywhere_and_hidden_by_nothing(need: Need) -> None:
    """Two balls that touch, in a shell: what stands in the way of no light is no shadow; seen from inside, too."""
    renderer = ready(MitsubaPath("llvm"), need)
    drawn = scene([sphere((0, 0, 0), 6, 5, 7, ka=0.5), sphere((-1, 0, -4), 1, ka=1), sphere((1, 0, -4), 1, ka=1)], [])
    found = renderer.render(drawn, ("ambient", "id"), Settings())
    color = np.array([0.8 * 0.4, 0.6 * 0.3, 0.3 * 0.2])
    expected = np.array([0.5, 1, 1])[found["id"]][..., None] * color
    assert {*np.unique(found["id"])} == {0, 1, 2}
    assert found["ambient"] == pytest.approx(expected, rel=1e-6)


# ---- what is too hard for float32


@pytest.mark.parametrize(
    ("ladder", "rung", "renderer"),
    [
        ("flat-along", "1e5", "mitsuba-spec@llvm"),
        ("flat-along", "1e5", "mitsuba-path@llvm"),
        ("flat-along", "1e8", "mitsuba-spec@llvm"),
        ("flat-across", "1e7", "mitsuba-spec@llvm"),
        ("flat-across", "1e8", "mitsuba-stock@scalar"),
        ("larger", "1e12", "mitsuba-stock@scalar"),
    ],
)
def test_it_keeps_its_claims_on_plates_of_no_thickness_and_far_out(
    ladder: str, rung: str, renderer: str, need: Need
) -> None:
    drawing = get(renderer)
    need(drawing.unavailable() is None, str(drawing.unavailable()))
    one = Settings(threads=1)
    step = measure(prove_rung(get_ladder(ladder), rung, one), drawing)
    assert step.wrong > 0 or ladder == "larger"
    assert step.own is not None
    assert not step.broken("own"), step.says("own")


def test_a_camera_of_180_degrees_is_refused() -> None:
    for rung, draws in (("1e6", True), ("1e7", False), ("1e12", False)):
        wide = get_ladder("wide").scene(rung)
        for renderer in (MitsubaStock("scalar"), MitsubaPath("llvm")):
            assert bool(renderer.passes(wide, Settings())) == draws
            assert draws or "180 degrees in float32" in renderer.refusal(wide)
        assert MitsubaSpec("llvm").passes(wide, Settings())


def test_the_place_behind_a_mirror_is_not_asked_for_where_its_matrix_has_no_determinant() -> None:
    # The floor's radius is 8: (4 x 8 x 2.18e11)^3 = 2^128.
    for scale, shows in ((1e11, True), (1e12, False)):
        large = get_ladder("larger").scene(f"{scale:.0e}".replace("+", ""))
        assert ("reflection" in MitsubaStock("scalar").passes(large, Settings())) == shows
