"""tracer.render: passes, settings and errors; the same bits everywhere; what must hold of every image."""

from __future__ import annotations

import ctypes
import hashlib
import itertools
import math
import platform
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import strategies
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from programs import started

import tracer
from tracer import Light, Scene, Sphere, View, reference
from tracer._render import Precision
from tracer.margins import EDGE_ROUNDINGS, VALUE_ROUNDINGS, Analysis, analyse
from tracer.passes import SAMPLES, Passes, Sample, lookup, names
from validation.truth import Prover

ROOT = Path(__file__).resolve().parents[2]
UNIT = {"f64": 2.0**-53, "f32": 2.0**-24}
PRECISIONS: tuple[Precision, ...] = ("f64", "f32")
ISAS = ("scalar", "sse2", "avx2", "avx512", "neon")


def rendered(scene: Scene, max_reflections: int = 3) -> tuple[str, ...]:
    """Every pass of a scene but the margins."""
    return names(len(scene.lights), max_reflections, margins=False)


def resized(scene: Scene, columns: int, rows: int) -> Scene:
    return scene.replace(view=scene.view.replace(columns=columns, rows=rows))


def same(a: Passes, b: Passes) -> None:
    """The same passes, bit for bit."""
    assert list(a) == list(b)
    for name in a:
        assert a[name].dtype == b[name].dtype
        assert a[name].tobytes() == b[name].tobytes(), name


def ball(x: float, y: float, z: float, size: tuple[float, float, float] | float = 1.0, **changes: Any) -> Sphere:
    scaling = size if isinstance(size, tuple) else (size, size, size)
    values: dict[str, Any] = {"color": (0.9, 0.5, 0.1), "ka": 0.3, "kd": 0.6, "ks": 0.4, "kr": 0.5, "exponent": 20}
    return Sphere(name="s", position=(x, y, z), scaling=scaling, **values | changes)


def light(x: float, y: float, z: float, intensity: tuple[float, float, float] = (0.9, 0.8, 0.7)) -> Light:
    return Light(name="l", position=(x, y, z), intensity=intensity)


def some_scene(columns: int = 40, rows: int = 30) -> Scene:
    """Mirrors, a sphere cut by the near plane, an ellipsoid, two lights and some background."""
    return Scene(
        view=View(near=1, left=-1, right=1, bottom=-0.8, top=0.7, columns=columns, rows=rows),
        spheres=(
            ball(-0.6, 0, -3),
            ball(1, 0.5, -1.5, (0.8, 0.6, 0.7), exponent=7.5, color=(0.1, 0.5, 0.9)),
            ball(0.2, -1.6, -4, (2, 0.5, 1.3), kr=0.9, exponent=0.5),
        ),
        lights=(light(3, 4, 1), light(-2, 5, -2, (0.2, -0.1, 0.6))),
        background=(0.1, 0.2, 0.3),
        ambient=(0.4, 0.4, 0.5),
    )


def inside_a_mirror(columns: int, rows: int) -> Scene:
    """Every ray goes on for as many bounces as are asked for."""
    view = View(near=1, left=-1, right=1, bottom=-1, top=1, columns=columns, rows=rows)
    return Scene(view=view, spheres=(ball(0, 0, 0, (5, 4, 6), kr=1), ball(1, 1, -3)), lights=(light(0, 1, 0),))


class TestArrays:
    @pytest.mark.parametrize("precision", PRECISIONS)
    def test_shapes_and_types(self, precision: Precision) -> None:
        scene = some_scene()
        passes = tracer.render(scene, rendered(scene), precision=precision)
        assert tuple(passes) == rendered(scene)
        assert passes.shape == (30, 40)
        for name, array in passes.items():
            row = lookup(name)
            assert array.shape == ((30, 40, 3) if row.channels else (30, 40))
            assert array.dtype == (np.int32 if name == "id" else {"f64": np.float64, "f32": np.float32}[precision])
            assert array.flags.c_contiguous
        assert set(np.unique(passes["id"])) == {-1, 0, 1, 2}
        assert set(np.unique(passes["shadow.L0"])) == {0, 1}

    def test_default_is_the_beauty_in_float64(self) -> None:
        passes = tracer.render(some_scene())
        assert list(passes) == ["beauty"]
        assert passes["beauty"].dtype == np.float64
        assert passes.metadata["renderer"] == "native-f64"

    def test_one_name_repeated_names_and_none(self) -> None:
        scene = some_scene()
        same(tracer.render(scene, "depth"), tracer.render(scene, ("depth", "depth")))
        assert tracer.render(scene, ()).shape == (0, 0)

    def test_a_pass_does_not_depend_on_the_others_asked_for(self) -> None:
        scene = some_scene()
        every = tracer.render(scene, rendered(scene))
        for name in every:
            same(tracer.render(scene, (name,)), Passes({name: every[name]}))
        for pair in itertools.combinations(("shadow.L1", "reflection.2", "beauty", "id"), 2):
            for name, array in tracer.render(scene, pair).items():
                assert np.array_equal(array, every[name])

    def test_where_the_primary_ray_misses(self) -> None:
        scene = some_scene()
        passes = tracer.render(scene, rendered(scene))
        missed = passes["id"] < 0
        assert 0 < missed.sum() < missed.size
        for name, array in passes.items():
            row = lookup(name)
            expected: Any = scene.background if row.miss is None else row.miss
            assert (array[missed] == expected).all(), name
        assert np.isfinite(passes["depth"][~missed]).all()

    def test_a_pass_that_the_scene_does_not_need_is_zero(self) -> None:
        scene = some_scene()
        scene = scene.replace(spheres=tuple(sphere.replace(kr=0.0, ks=0.0) for sphere in scene.spheres))
        passes = tracer.render(scene, rendered(scene))
        for name in ("specular", "reflection", "reflection.1", "reflection.3"):
            assert not passes[name].any()

    def test_ids_count_the_spheres_of_the_file(self) -> None:
        """A sphere that is ignored as a duplicate keeps its number."""
        a, b = ball(-1, 0, -3), ball(1, 0, -3)
        with pytest.warns(tracer.SceneWarning):
            scene = some_scene().replace(spheres=(a, a.replace(color=(1.0, 1.0, 1.0)), b))
        assert scene.distinct == (0, 2)
        assert set(np.unique(tracer.render(scene, "id")["id"])) == {-1, 0, 2}


class TestErrors:
    @pytest.mark.parametrize(
        ("arguments", "text"),
        [
            ({"precision": "f16"}, "precision is 'f16', expected 'f64' or 'f32'"),
            (
                {"sample": "centre"},
                "sample is 'centre', expected one of 'corner', 'center', 'bottom-left', 'top-right', 'inclusive'",
            ),
            ({"threads": -1}, "threads is -1, expected 0 to 1024"),
            ({"threads": 1025}, "threads is 1025, expected 0 to 1024"),
            ({"shadow_epsilon": -0.5}, "shadow_epsilon is -0.5, expected 0 <= shadow_epsilon < 1"),
            ({"shadow_epsilon": 1.0}, "shadow_epsilon is 1.0, expected 0 <= shadow_epsilon < 1"),
            ({"shadow_epsilon": float("nan")}, "shadow_epsilon is nan, expected 0 <= shadow_epsilon < 1"),
            ({"max_reflections": -1}, "max_reflections is -1, expected 0 to 1000"),
            ({"max_reflections": 1001}, "max_reflections is 1001, expected 0 to 1000"),
            ({"passes": ("beuaty",)}, "unknown pass 'beuaty' (did you mean 'beauty'?)"),
            ({"passes": ("qqq",)}, "unknown pass 'qqq'"),
            ({"passes": ("reflection.0",)}, "unknown pass 'reflection.0' (did you mean 'reflection.3'?)"),
            (
                {"passes": ("margin.order",)},
                "pass 'margin.order' is not a pass of the renderer: tracer.reference computes margins",
            ),
            ({"passes": ("shadow.L2",)}, "pass 'shadow.L2' asks for light 2, but the scene has 2, from 0"),
        ],
        ids=lambda value: value if isinstance(value, str) else None,
    )
    def test_settings(self, arguments: dict[str, Any], text: str) -> None:
        with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
            tracer.render(some_scene(), **arguments)

    @pytest.mark.parametrize(
        ("arguments", "text"),
        [
            ({"scene": "file.txt"}, "scene is 'file.txt', expected a Scene: tracer.load(path) reads one from a file"),
            ({"threads": 1.5}, "threads is 1.5, expected an integer"),
            ({"max_reflections": "3"}, "max_reflections is '3', expected an integer"),
            ({"shadow_epsilon": "0"}, "shadow_epsilon is '0', expected a number"),
            ({"passes": (1,)}, "passes holds 1, expected names of passes"),
        ],
        ids=lambda value: value if isinstance(value, str) else None,
    )
    def test_arguments_of_another_kind(self, arguments: dict[str, Any], text: str) -> None:
        with pytest.raises(TypeError, match=f"^{re.escape(text)}$"):
            tracer.render(**({"scene": some_scene()} | arguments))
        tracer.render(some_scene(), threads=np.int64(1), shadow_epsilon=np.float32(0))

    def test_no_lights(self) -> None:
        with pytest.raises(ValueError, match=r"^pass 'shadow\.L0' asks for light 0, but the scene has 0, from 0$"):
            tracer.render(some_scene().replace(lights=()), "shadow.L0")

    def test_what_float32_cannot_carry(self) -> None:
        scene = some_scene().replace(spheres=(ball(0, 0, -1e20),))
        tracer.render(scene)
        with pytest.raises(tracer.SceneError, match="float32") as caught:
            tracer.render(scene, precision="f32")
        assert [error.field for error in caught.value.errors] == ["SPHERE"]

    def test_an_instruction_set_that_is_not_there(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("WHITTED_ISA", "mmx")
        with pytest.raises(ValueError, match=r"^WHITTED_ISA is 'mmx', but here it can be one of .*scalar$"):
            tracer.render(some_scene())
        with pytest.raises(ValueError, match=r"^WHITTED_ISA is 'mmx'"):
            tracer.instruction_set()
        foreign = "neon" if platform.machine() == "x86_64" else "avx2"
        monkeypatch.setenv("WHITTED_ISA", foreign)
        with pytest.raises(ValueError, match=rf"^WHITTED_ISA is '{foreign}'"):
            tracer.render(some_scene())

    @pytest.mark.parametrize("size", [(1 << 31, 1 << 31), (1 << 24, 1 << 24)])
    def test_an_image_that_no_machine_holds(self, size: tuple[int, int]) -> None:
        view = some_scene().view.replace(columns=size[0], rows=size[1])
        scene = Scene(view=view, limits=False)
        text = f"2 passes of {size[0]}x{size[1]} pixels need {32 * size[0] * size[1]} bytes, this machine has "
        with pytest.raises(MemoryError, match=f"^{text}[0-9]+$"):
            tracer.render(scene, ("beauty", "depth"))

    def test_the_extension_checks_what_it_is_given(self) -> None:
        """It is private, but must not write where nothing is."""
        from tracer import _native

        scene = resized(some_scene(), 4, 4)
        settings_ = ("f64", 1, "corner", 1e-4, 3)
        for kind, member in (("shadow.L*", 2), ("shadow.L*", -1), ("reflection.*", 0), ("reflection.*", 4), ("id", 1)):
            shape = (4, 4, 3) if kind == "reflection.*" else (4, 4)
            array = np.zeros(shape, np.int32 if kind == "id" else np.float64)
            with pytest.raises(ValueError, match=rf"has no member {member}$"):
                _native.render_into(scene, [(kind, member, array)], *settings_)
        with pytest.raises(ValueError, match="wrong size"):
            _native.render_into(scene, [("depth", 0, np.zeros((4, 3)))], *settings_)
        with pytest.raises(ValueError, match="unknown pass 'x'"):
            _native.render_into(scene, [("x", 0, np.zeros((4, 4)))], *settings_)


def supported(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The instruction sets of this machine."""
    found = []
    for isa in ISAS:
        monkeypatch.setenv("WHITTED_ISA", isa)
        try:
            assert tracer.instruction_set() == isa
            found.append(isa)
        except ValueError:
            continue
    return found


class TestTheSameBits:
    @pytest.mark.parametrize("precision", PRECISIONS)
    def test_on_every_instruction_set(self, precision: Precision, monkeypatch: pytest.MonkeyPatch) -> None:
        """Bounces without end, and everything at once; test_bits.py has all scenes."""
        digests: dict[str, dict[str, str]] = {}
        for isa in supported(monkeypatch):
            monkeypatch.setenv("WHITTED_ISA", isa)
            for name, scene in {"mirror": inside_a_mirror(19, 17), "some": some_scene()}.items():
                bounces = 12 if name == "mirror" else 3
                passes = tracer.render(scene, rendered(scene, bounces), precision=precision, max_reflections=bounces)
                for pass_name, array in passes.items():
                    digests.setdefault(f"{name} {pass_name}", {})[isa] = hashlib.sha256(array.tobytes()).hexdigest()
        assert all(len(set(by_isa.values())) == 1 for by_isa in digests.values()), [
            name for name, by_isa in digests.items() if len(set(by_isa.values())) > 1
        ]
        assert len(next(iter(digests.values()))) >= 2  # scalar and one with packets, at least

    @settings(max_examples=60, deadline=None)
    @given(strategies.scenes(), st.sampled_from(PRECISIONS), st.sampled_from(SAMPLES))
    def test_on_every_instruction_set_for_any_scene(self, scene: Scene, precision: Precision, sample: Sample) -> None:
        with pytest.MonkeyPatch.context() as patch:
            images = []
            for isa in supported(patch):
                patch.setenv("WHITTED_ISA", isa)
                images.append(tracer.render(scene, rendered(scene), precision=precision, sample=sample))
        for image in images[1:]:
            same(image, images[0])

    @pytest.mark.parametrize("precision", PRECISIONS)
    def test_for_any_number_of_threads(self, precision: Precision) -> None:
        scene = some_scene(397, 211)
        images = [
            tracer.render(scene, rendered(scene), precision=precision, threads=threads)
            for threads in (1, 0, 2, 3, 7, 64)
        ]
        for image in images[1:]:
            same(image, images[0])

    def test_wherever_a_pixel_lies_in_its_packet(self) -> None:
        """Narrow images cut and pad every packet differently; 2^-k of the width is exact, so the rays are the same."""
        scene = some_scene(64, 5)
        whole = tracer.render(scene, rendered(scene))
        view = scene.view
        for columns in range(1, 64):
            # x = left + (right - left) c/columns: the same for a width in proportion, -1 and 2 c/64 being exact.
            part = view.replace(right=view.left + columns / 32, columns=columns)
            image = tracer.render(scene.replace(view=part), rendered(scene))
            for name in image:
                assert np.array_equal(image[name], whole[name][:, :columns]), (name, columns)


@contextmanager
def environment_of_floats(x86_flags: int = 0, rounding: int | None = None) -> Iterator[ctypes.CDLL]:
    """Other rounding or denormal modes for a while, set as a caller of the extension could."""
    libm = ctypes.CDLL("libm.so.6")
    saved = ctypes.create_string_buffer(64)
    libm.fegetenv(saved)
    try:
        if rounding is not None:
            assert libm.fesetround(rounding) == 0
        if x86_flags:
            changed = ctypes.create_string_buffer(saved.raw, 64)
            ctypes.c_uint32.from_buffer(changed, 28).value |= x86_flags
            libm.fesetenv(changed)
        yield libm
    finally:
        libm.fesetenv(saved)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="sets the modes of x86")
class TestModesOfTheProcessor:
    FLUSH_TO_ZERO, DENORMALS_ARE_ZERO = 0x8000, 0x0040
    DOWNWARD, UPWARD, TOWARD_ZERO = 0x400, 0x800, 0xC00

    def scene(self) -> Scene:
        """Its colours have products that are no normal numbers, and its constants are rounded."""
        scene = some_scene(150, 130)
        faint = ball(0, 0.6, -2, 0.4, color=(1e-310, 3e-42, 0.7))
        return scene.replace(spheres=(*scene.spheres, faint))

    @pytest.mark.parametrize("precision", PRECISIONS)
    @pytest.mark.parametrize("threads", [1, 2])
    @pytest.mark.parametrize("rounding", [DOWNWARD, UPWARD, TOWARD_ZERO])
    def test_rounding(self, precision: Precision, threads: int, rounding: int) -> None:
        scene = self.scene()
        expected = tracer.render(scene, rendered(scene), precision=precision, threads=1)
        with environment_of_floats(rounding=rounding) as libm:
            image = tracer.render(scene, rendered(scene), precision=precision, threads=threads)
            after = libm.fegetround()
        assert after == rounding
        same(image, expected)

    @pytest.mark.parametrize("precision", PRECISIONS)
    @pytest.mark.parametrize("threads", [1, 2])
    def test_denormals(self, precision: Precision, threads: int) -> None:
        scene = self.scene()
        expected = tracer.render(scene, rendered(scene), precision=precision, threads=1)
        tiny = np.finfo(expected["ambient"].dtype).tiny
        assert ((expected["ambient"] > 0) & (expected["ambient"] < tiny)).any()
        modes = self.FLUSH_TO_ZERO | self.DENORMALS_ARE_ZERO
        with environment_of_floats(x86_flags=modes) as libm:
            image = tracer.render(scene, rendered(scene), precision=precision, threads=threads)
            after = ctypes.create_string_buffer(64)
            libm.fegetenv(after)
        assert int.from_bytes(after.raw[28:32], "little") & modes == modes
        same(image, expected)


class TestTheInterpreter:
    def test_is_not_locked(self) -> None:
        """Another thread of Python goes on while one renders."""
        scene = inside_a_mirror(64, 64)
        ticks: list[float] = []
        done = threading.Event()

        def tick() -> None:
            while not done.wait(0.001):
                ticks.append(time.monotonic())

        thread = threading.Thread(target=tick)
        thread.start()
        start = time.monotonic()
        bounces = 100
        while True:  # until it takes long enough to tell
            start = time.monotonic()
            tracer.render(scene, max_reflections=min(bounces, 1000), threads=1)
            end = time.monotonic()
            if end - start > 0.4:
                break
            if bounces < 1000:
                bounces *= 3
            else:
                scene = resized(scene, 2 * scene.view.columns, 64)
        done.set()
        thread.join()
        middle = [tick for tick in ticks if start + 0.02 < tick < end - 0.02]
        assert middle

    def test_two_threads_render_at_once(self) -> None:
        scene = some_scene(200, 150)
        expected = tracer.render(scene, rendered(scene))
        results: list[Passes] = []
        threads = [
            threading.Thread(target=lambda: results.append(tracer.render(scene, rendered(scene)))) for _ in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(results) == 4
        for result in results:
            same(result, expected)

    @pytest.mark.parametrize("threads", [1, 2])
    def test_ctrl_c(self, threads: int) -> None:
        script = (
            "import sys; sys.path.insert(0, 'tests'); sys.path.insert(0, 'tests/tracer')\n"
            "import time, test_render, tracer\n"
            "scene = test_render.inside_a_mirror(20000, 20000)\n"
            "print('go', flush=True)\n"
            "try:\n"
            f"    tracer.render(scene, 'id', max_reflections=1000, threads={threads})\n"
            "except KeyboardInterrupt:\n"
            "    print(time.monotonic())\n"
        )
        with started([sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            assert program.stdout.readline() == "go\n"
            time.sleep(0.3)
            assert program.poll() is None
            start = time.monotonic()
            program.send_signal(signal.SIGINT)
            rest, _ = program.communicate(timeout=20)
            assert program.returncode == 0
            assert float(rest) - start < 10  # the picture takes hours


class TestReflections:
    def test_each_number_of_bounces(self) -> None:
        scene = inside_a_mirror(16, 16)
        full = tracer.render(scene, rendered(scene, 5), max_reflections=5)
        for bounces in range(6):
            image = tracer.render(scene, rendered(scene, 5), max_reflections=bounces)
            total = np.zeros_like(full["beauty"])
            for k in range(1, 6):
                expected = full[f"reflection.{k}"] if k <= bounces else np.zeros_like(total)
                assert np.array_equal(image[f"reflection.{k}"], expected)
                total = total + expected
            assert np.array_equal(image["reflection"], total)
            assert full[f"reflection.{max(bounces, 1)}"].any()

    def test_a_thousand(self) -> None:
        scene = inside_a_mirror(9, 7)
        wanted = ("reflection", "reflection.1", "reflection.500", "reflection.1000")
        image = tracer.render(scene, wanted, max_reflections=1000)
        assert image["reflection.1000"].any()
        every = tracer.render(scene, rendered(scene, 1000), max_reflections=1000)
        total = np.zeros_like(every["reflection"])
        for k in range(1, 1001):
            total = total + every[f"reflection.{k}"]
        assert np.array_equal(total, every["reflection"])
        for name in wanted:
            assert np.array_equal(image[name], every[name])


class TestSamples:
    """Sample positions are corners of other grids; all the fractions of the image here are the same floats."""

    SCENE = some_scene(16, 8)

    def corners(self, columns: int, rows: int) -> NDArray[Any]:
        return tracer.render(resized(self.SCENE, columns, rows))["beauty"]

    def image(self, sample: Sample) -> NDArray[Any]:
        return tracer.render(self.SCENE, sample=sample)["beauty"]

    def test_corner(self) -> None:
        assert np.array_equal(self.image("corner"), self.corners(32, 16)[::2, ::2])

    def test_center(self) -> None:
        assert np.array_equal(self.image("center"), self.corners(32, 16)[1::2, 1::2])

    def test_bottom_left(self) -> None:
        assert np.array_equal(self.image("bottom-left")[:-1], self.corners(16, 8)[1:])

    def test_top_right(self) -> None:
        assert np.array_equal(self.image("top-right")[:, :-1], self.corners(16, 8)[:, 1:])

    def test_inclusive(self) -> None:
        assert np.array_equal(self.image("inclusive")[:-1, :-1], self.corners(15, 7))
        one = tracer.render(resized(self.SCENE, 1, 1), sample="inclusive")
        assert np.array_equal(one["beauty"], tracer.render(resized(self.SCENE, 1, 1))["beauty"])

    def test_the_bottom_row(self) -> None:
        """Only these two reach the lower edge: y = bottom."""
        view = self.SCENE.view
        moved = self.SCENE.replace(view=view.replace(top=view.bottom, bottom=2 * view.bottom - view.top))
        below = tracer.render(moved)["beauty"][0]
        assert np.array_equal(self.image("bottom-left")[-1], below)
        assert np.array_equal(self.image("inclusive")[-1, 0], below[0])


def interior(analysis: Analysis, precision: Precision) -> NDArray[np.bool_]:
    """Where no decision can go another way by rounding."""
    margins = np.minimum.reduce(list(analysis.margins.values()))
    inside: NDArray[np.bool_] = margins > EDGE_ROUNDINGS * UNIT[precision]
    return inside


def agree(a: Passes, b: Passes, analysis: Analysis, precision: Precision) -> int:
    """Two careful renderings agree within their roundings on the interior pixels, whose number comes back."""
    inside = interior(analysis, precision)
    for name in a:
        if name in ("id",) or name.startswith("shadow"):
            lit = analysis.lit[int(name[8:])] if name != "id" else True
            assert np.array_equal(a[name][inside & lit], b[name][inside & lit]), name
        else:  # the distance of two unit normals is at most the angle between them
            x, y = (image[name].astype(float) for image in (a, b))
            bound = 2 * VALUE_ROUNDINGS * UNIT[precision] * analysis.sensitivity[name]
            off = np.where(x == y, 0, np.abs(np.where(x == y, 0, x) - np.where(x == y, 0, y)))
            worst = np.linalg.norm(off, axis=-1) if name == "normal" else off.max(axis=-1) if off.ndim == 3 else off
            assert (worst <= bound)[inside].all(), (name, float((worst / bound)[inside].max()))
    return int(inside.sum())


class TestProperties:
    @settings(max_examples=150, deadline=None)
    @given(strategies.scenes(), st.sampled_from(PRECISIONS), st.integers(-40, 40))
    def test_scaling_the_world_by_powers_of_two(self, scene: Scene, precision: Precision, power: int) -> None:
        factor = 2.0**power

        def scaled(vector: tuple[float, float, float]) -> tuple[float, float, float]:
            return (vector[0] * factor, vector[1] * factor, vector[2] * factor)

        view = scene.view
        larger = scene.replace(
            view=view.replace(
                near=view.near * factor,
                left=view.left * factor,
                right=view.right * factor,
                bottom=view.bottom * factor,
                top=view.top * factor,
            ),
            spheres=tuple(s.replace(position=scaled(s.position), scaling=scaled(s.scaling)) for s in scene.spheres),
            lights=tuple(one.replace(position=scaled(one.position)) for one in scene.lights),
        )
        image = tracer.render(scene, rendered(scene), precision=precision)
        other = tracer.render(larger, rendered(scene), precision=precision)
        for name in image:
            times = image[name].dtype.type(factor if name in ("depth", "position") else 1)
            assert np.array_equal(image[name] * times, other[name]), name

    @settings(max_examples=100, deadline=None)
    @given(strategies.scenes(), st.sampled_from(PRECISIONS))
    def test_the_beauty_is_the_sum_of_its_parts(self, scene: Scene, precision: Precision) -> None:
        image = tracer.render(scene, rendered(scene), precision=precision)
        hit = image["id"] >= 0
        direct = image["diffuse"] + image["specular"]
        assert np.array_equal(image["direct"], direct)
        reflection = (image["reflection.1"] + image["reflection.2"]) + image["reflection.3"]
        assert np.array_equal(image["reflection"], reflection)
        assert np.array_equal(image["beauty"][hit], ((image["ambient"] + direct) + reflection)[hit])
        background = np.array(scene.background).astype(image["beauty"].dtype)
        assert (image["beauty"][~hit] == background).all()

    @settings(max_examples=100, deadline=None)
    @given(strategies.scenes(max_lights=4), st.sampled_from(PRECISIONS))
    def test_linear_in_the_lights(self, scene: Scene, precision: Precision) -> None:
        """The terms of several lights are the sums of the terms of each, in the order of the file, to the last bit."""
        image = tracer.render(scene, rendered(scene), precision=precision)
        sums = {name: np.zeros_like(image[name]) for name in ("diffuse", "specular")}
        for k, one in enumerate(scene.lights):
            alone = tracer.render(
                scene.replace(lights=(one,)), ("diffuse", "specular", "shadow.L0"), precision=precision
            )
            assert np.array_equal(alone["shadow.L0"], image[f"shadow.L{k}"])
            for name in sums:
                sums[name] = sums[name] + alone[name]
        for name, total in sums.items():
            assert np.array_equal(total, image[name])

        def doubled(vector: tuple[float, float, float]) -> tuple[float, float, float]:
            return (2 * vector[0], 2 * vector[1], 2 * vector[2])

        brighter = scene.replace(
            lights=tuple(one.replace(intensity=doubled(one.intensity)) for one in scene.lights),
            ambient=doubled(scene.ambient),
            background=doubled(scene.background),
        )
        twice = tracer.render(brighter, rendered(scene), precision=precision)
        # Exact but for what underflows: up to 4 terms of up to 8 roundings, for each of 4 lights and 4 hits, of half a
        # smallest number each; later factors are at most 1.
        underflow = 4 * 8 * 4 * 4 / 2 * float(np.finfo(image["beauty"].dtype).smallest_subnormal)
        for name in image:
            if lookup(name).quantity == "color":
                assert (np.abs(2 * image[name].astype(float) - twice[name]) <= underflow).all(), name

    @settings(max_examples=60, deadline=None)
    @given(strategies.scenes(), st.sampled_from(PRECISIONS), st.data())
    def test_the_order_of_the_objects(self, scene: Scene, precision: Precision, data: st.DataObject) -> None:
        """Spheres: the same bits wherever no two are hit at once. Lights: the same within the rounding of the sums."""
        spheres = data.draw(st.permutations(range(len(scene.spheres))))
        lights = data.draw(st.permutations(range(len(scene.lights))))
        analysis = analyse(scene)
        inside = interior(analysis, precision)
        image = tracer.render(scene, rendered(scene), precision=precision)

        moved = tracer.render(
            scene.replace(spheres=tuple(scene.spheres[k] for k in spheres)), rendered(scene), precision=precision
        )
        number = np.array([*spheres, -1], dtype=np.int32)
        for name in image:
            other = number[moved[name]] if name == "id" else moved[name]
            assert np.array_equal(image[name][inside], other[inside]), name

        moved = tracer.render(
            scene.replace(lights=tuple(scene.lights[k] for k in lights)), rendered(scene), precision=precision
        )
        back = {f"shadow.L{old}": moved[f"shadow.L{new}"] for new, old in enumerate(lights)}
        agree(image, Passes({**moved, **back}), analysis, precision)

    @settings(max_examples=30, deadline=None)
    @given(strategies.scenes(), st.randoms(use_true_random=False))
    def test_the_order_of_the_fields(self, scene: Scene, random: Any) -> None:
        """Of fields of different kinds: spheres and lights keep their own order."""
        lines = scene.text().splitlines()
        kinds = [line.split()[0] for line in lines]
        shuffled = kinds.copy()
        random.shuffle(shuffled)
        queues = {kind: iter([line for line in lines if line.startswith(f"{kind} ")]) for kind in kinds}
        other = tracer.loads("\n".join(next(queues[kind]) for kind in shuffled))
        same(tracer.render(other, rendered(scene)), tracer.render(scene, rendered(scene)))

    @settings(max_examples=200, deadline=None)
    @given(strategies.scenes(extreme=True, max_size=6))
    def test_no_number_is_ever_out_of_bounds(self, scene: Scene) -> None:
        """Whatever the format allows: finite values, unit normals, infinite depth exactly where nothing is hit."""
        for precision in PRECISIONS:
            try:
                image = tracer.render(scene, rendered(scene), precision=precision)
            except tracer.SceneError:
                assert precision == "f32"
                continue
            hit = image["id"] >= 0
            assert np.array_equal(np.isfinite(image["depth"]), hit)
            for name in image:
                assert name == "depth" or np.isfinite(image[name]).all(), name
            lengths = np.linalg.norm(image["normal"].astype(float), axis=-1)
            assert np.all(np.abs(lengths[hit] - 1) < 1e-5)


def grid_ties(seed: int) -> tuple[Scene, list[tuple[int, int]]]:
    """A sphere that meets the image plane exactly at some pixels (column, row), which are all of them.

    Positions and scalings are whole multiples of five pixels, so that most of the rays are no binary fractions.
    """
    random = np.random.default_rng(seed)
    while True:
        size = int(random.choice((50, 100, 200)))
        unit = 1 / int(random.choice((1, 2, 4, 8)))  # of five pixels
        scaling = random.integers(1, 20, 3) if random.random() < 0.5 else np.full(3, random.integers(1, 20))
        x, y = random.integers(-size // 10, size // 10 + 1, 2)
        depth, near = int(random.integers(-scaling[2], scaling[2] + 1)), int(random.integers(1, 20))
        # |(d - p) / s|^2 = 1 in whole numbers.
        i, j = np.arange(size) - size // 2 - 5 * x, size // 2 - np.arange(size) - 5 * y
        a, b, c = (int(s) for s in scaling)
        power = (i[None, :] * b * c) ** 2 + (j[:, None] * a * c) ** 2 + (5 * depth * a * b) ** 2
        tied = [(int(column), int(row)) for row, column in np.argwhere(power == (5 * a * b * c) ** 2)]
        if tied:
            break
    half = size * unit / 10
    view = View(near=near * unit, left=-half, right=half, bottom=-half, top=half, columns=size, rows=size)
    place = (x * unit, y * unit, -(near + depth) * unit)
    return Scene(view=view, spheres=(ball(*place, (a * unit, b * unit, c * unit)),)), tied


def beyond_the_plane(scene: Scene, column: int, row: int) -> float:
    """The depth of the only sphere, behind t = 1, for a ray with a root exactly there."""
    view, sphere = scene.view, scene.spheres[0]
    left, right, bottom, top = (Fraction(side) for side in (view.left, view.right, view.bottom, view.top))
    across = left + (right - left) * column / view.columns
    world = (across, top - (top - bottom) * row / view.rows, Fraction(-view.near))
    d = [a / Fraction(s) for a, s in zip(world, sphere.scaling, strict=True)]
    y = [a - Fraction(p) / Fraction(s) for a, p, s in zip(d, sphere.position, sphere.scaling, strict=True)]
    assert sum(a * a for a in y) == 1
    # The sum of both roots is -2 o.d / d.d, and o = y - d.
    other = 1 - 2 * sum(a * b for a, b in zip(y, d, strict=True)) / sum(b * b for b in d)
    return float(other) * math.sqrt(sum(a * a for a in world)) if other > 1 else math.inf


def drawn(scene: Scene, passes: tuple[str, ...], precision: Precision) -> Iterator[tuple[str, Passes]]:
    """The scene from the renderer on every instruction set, and from the reference."""
    with pytest.MonkeyPatch.context() as patch:
        for isa in supported(patch):
            patch.setenv("WHITTED_ISA", isa)
            yield isa, tracer.render(scene, passes, precision=precision)
    yield "numpy", reference.render(scene, passes, precision=precision)


@pytest.mark.parametrize("precision", PRECISIONS)
class TestARootOnTheImagePlane:
    """t = 1 itself does not count, though rounding may bring it above."""

    def test_where_a_bowl_is_cut(self, precision: Precision) -> None:
        """The proof of every pixel that ties: (column - 140)^2 + (row - 200)^2 = 18000."""
        scene = tracer.load(ROOT / "scenes/spec/light-inside.txt")
        prover = Prover(scene)
        columns, rows = np.meshgrid(np.arange(400), np.arange(400))
        tied = np.argwhere((columns - 140) ** 2 + (rows - 200) ** 2 == 18000)
        assert len(tied) == 16
        for name, image in drawn(scene, ("beauty", "id", "depth"), precision):
            for row, column in tied.tolist():
                truth = prover.pixel(column, row)
                assert [tie.key.what for tie in truth.ties] == ["start"]
                assert image["id"][row, column] == truth.id == 0, name
                for passed in ("beauty", "depth"):
                    exact = [ball.value for ball in truth.values[passed]]
                    found = np.atleast_1d(image[passed][row, column])
                    assert found == pytest.approx(exact, rel=64 * UNIT[precision], abs=64 * UNIT[precision]), name

    def test_any_tie(self, precision: Precision) -> None:
        """The far side is seen where the ray enters there, nothing where it leaves or touches."""
        short = {"f64": 1e-10, "f32": 1e-3}[precision]  # chords may be, and that costs digits
        seen = []
        for seed in range(150):
            scene, tied = grid_ties(seed)
            exact = {at: beyond_the_plane(scene, *at) for at in tied}
            seen += [math.isfinite(depth) for depth in exact.values()]
            for name, image in drawn(scene, ("id", "depth"), precision):
                for (column, row), depth in exact.items():
                    assert image["id"][row, column] == (0 if math.isfinite(depth) else -1), (seed, name)
                    assert image["depth"][row, column] == pytest.approx(depth, rel=short), (seed, name)
        assert min(sum(seen), len(seen) - sum(seen)) > 100

    def test_leaves_or_touches_there(self, precision: Precision) -> None:
        view = View(near=4, left=3, right=4, bottom=-1, top=0, columns=1, rows=1)  # its ray is (3, 0, -4)
        for position, scaling in (
            ((1.5, 0.0, -2.0), 2.5),  # from the eye to t = 1, along the ray
            ((3.0, 0.0, -3.0), 1.0),  # the far side along the axis
            ((-1.0, 0.0, -7.0), 5.0),  # touches at t = 1: y = (4, 0, 3) / 5, across the ray
            ((0.6, 0.0, -5.8), 3.0),  # the same, but for the rounding of the numbers
        ):
            scene = Scene(view=view, spheres=(ball(*position, scaling),))
            for name, image in drawn(scene, ("id",), precision):
                assert image["id"].tolist() == [[-1]], (position, name)

    def test_a_near_miss_is_none(self, precision: Precision) -> None:
        """A little before or behind the plane, the hit is where it is."""
        gap = {"f64": 1e-6, "f32": 1e-4}[precision]
        view = View(near=3, left=0, right=1, bottom=-1, top=0, columns=1, rows=1)  # its ray is the axis
        for z, depth in (
            (-5 - gap, 3 + gap),  # the near side behind the plane
            (-5.0, 7),
            (-5 + gap, 7 - gap),
            (-1 - gap, 3 + gap),  # the far side behind the plane
            (-1.0, math.inf),
            (-1 + gap, math.inf),
        ):
            for name, image in drawn(Scene(view=view, spheres=(ball(0, 0, z, 2),)), ("depth",), precision):
                assert image["depth"][0, 0] == pytest.approx(depth, rel=8 * UNIT[precision], abs=0), (z, name)


def test_a_small_sphere_far_away_keeps_its_shape() -> None:
    """Seen through its middle it is no tangent, however far it is: there is a normal."""
    view = View(near=1, left=0, right=1, bottom=-1, top=0, columns=1, rows=1)
    for distance in (1e6, 1e12, 1e15, 1e16, 1e60, 1e99):
        for precision in PRECISIONS:
            if precision == "f32" and distance > 1e15:
                continue
            scene = Scene(view=view, spheres=(ball(0, 0, -distance),))
            image = tracer.render(scene, ("normal", "depth"), precision=precision)
            assert image["normal"].tolist() == [[[0, 0, 1]]]
            assert image["depth"][0, 0] == pytest.approx(distance, rel=1e-5)


def test_many_spheres_and_lights() -> None:
    """Far beyond the limits, against the reference."""
    random = np.random.default_rng(7)
    spheres = []
    for _ in range(200):
        x, y, z = random.uniform((-5, -5, -14), (5, 5, -4))
        size = tuple(random.uniform(0.1, 0.6, 3).tolist())
        color = tuple(random.uniform(0, 1, 3).tolist())
        spheres.append(
            ball(x, y, z, size, color=color, kr=0.6, exponent=float(random.integers(0, 60)), ks=0.05, kd=0.1)
        )
    lights = [light(*random.uniform(-12, 12, 3).tolist()) for _ in range(20)]
    scene = some_scene(32, 24).replace(spheres=tuple(spheres), lights=tuple(lights), limits=False)
    passes = rendered(scene)
    pixels = agree(tracer.render(scene, passes), reference.render(scene, passes), analyse(scene), "f64")
    assert pixels > 0.99 * 32 * 24


def highlight(exponent: float, columns: int = 128) -> Scene:
    """A highlight that fills the image for its exponent."""
    half = min(0.2, 0.7 / max(exponent, 1) ** 0.5)
    view = View(near=1, left=-half, right=half, bottom=-half, top=half, columns=columns, rows=columns)
    sphere = ball(0, 0, -3, kd=0.0, ka=0.0, kr=0.0, ks=1.0, exponent=exponent)
    return Scene(view=view, spheres=(sphere,), lights=(light(0.02, 0.01, 0.05, (1, 1, 1)),))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("exponent", [0.5, 1, 1.5, 2, 7, 33.3, 1000, 1024, 1025, 1e5, 1e-9, 4e4 + 0.3])
def test_powers(exponent: float, precision: Precision) -> None:
    """(R.V)^n to 8 roundings, and what the rounding of R.V itself does to it."""
    scene = highlight(exponent)
    image = tracer.render(scene, ("specular", "normal", "position", "shadow.L0"), precision=precision)
    N, x = image["normal"].astype(float), image["position"].astype(float)
    V = -x / np.linalg.norm(x, axis=-1, keepdims=True)
    to_light = np.array(scene.lights[0].position) - x
    L = to_light / np.linalg.norm(to_light, axis=-1, keepdims=True)
    NL = (N * L).sum(-1)
    RV = np.minimum(2 * NL * (N * V).sum(-1) - (L * V).sum(-1), 1)
    seen = (image["shadow.L0"] == 1) & (RV > 0.01)
    value = np.power(RV, exponent, where=seen, out=np.zeros_like(RV))
    # L, V and N are each off by some u, and enter R.V twice: in the renderer and again here, from its rounded passes.
    u = UNIT[precision]
    slope = exponent * np.power(RV, exponent - 1, where=seen, out=np.zeros_like(RV))
    # n multiplied out: each of at most 2 log2 n products doubles what was there; as much as n roundings of R.V.
    bound = 8 * u + slope * 40 * u
    off = np.abs(image["specular"][..., 0] - value)
    assert (off <= bound)[seen].all(), float((off / bound)[seen].max())
    assert seen.sum() > 1000
    if exponent >= 1:
        assert ((value > 0.05) & (value < 0.95) & seen).sum() > 1000
