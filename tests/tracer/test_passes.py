"""Passes and their files: the table, quantisation, round trips, foreign and damaged files, no half files."""

from __future__ import annotations

import errno
import json
import os
import random
import re
import resource
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

import tracer
from tracer import Light, Passes, Scene, Sphere, View
from tracer.passes import MARGINS, TABLE, Precision, lookup, names, quantise, write_beside


def scene(columns: int = 21, rows: int = 13) -> Scene:
    """A mirror ball before a background, two lights."""
    ball: dict[str, Any] = {"color": (0.9, 0.5, 0.1), "ka": 0.3, "kd": 0.6, "ks": 0.4, "kr": 0.5, "exponent": 20}
    return Scene(
        view=View(near=1, left=-1, right=1, bottom=-1, top=1, columns=columns, rows=rows),
        spheres=(
            Sphere(name="a", position=(0, 0, -3), scaling=(1, 1, 1), **ball),
            Sphere(name="b", position=(1, 1, -3), scaling=(0.4, 0.5, 0.6), **ball),
        ),
        lights=tuple(Light(name="l", position=(4, y, 1), intensity=(0.9, 1.9, 0.7)) for y in (4, -4)),
        background=(0.1, 0.2, 1.5),
        ambient=(0.5, 0.5, 0.5),
    )


def every_pass(precision: Precision = "f64") -> Passes:
    """Of the renderer, and something for the margins."""
    wanted = list(names(2, margins=False))
    made = tracer.render(scene(), wanted, precision=precision)
    generator = np.random.default_rng(1)
    margins = {f"margin.{kind}": generator.exponential(size=made.shape) for kind in MARGINS}
    margins["margin.order"][0] = np.inf
    return Passes({**made, **margins}, {**made.metadata, "scene": '\u03bb "quoted"\n'})


def equal(a: Passes, b: Passes) -> None:
    assert list(a) == list(b)
    assert a.metadata == b.metadata
    for name in a:
        assert a[name].dtype == b[name].dtype, name
        assert np.array_equal(a[name], b[name]), name


class TestTable:
    def test_names(self) -> None:
        assert names(2, 1) == (
            *("beauty", "ambient", "diffuse", "specular", "direct", "shadow.L0", "shadow.L1", "reflection"),
            *("reflection.1", "depth", "position", "normal", "id"),
            *("margin.silhouette", "margin.range", "margin.order", "margin.terminator"),
        )
        assert names(2, 1, margins=False) == names(2, 1)[:-4]
        assert len(TABLE) == 13

    def test_lookup_finds_every_name(self) -> None:
        for name in names(7, 12):
            row = lookup(name)
            assert name.startswith(row.name.removesuffix("*"))
        assert lookup("shadow.L0").quantity == "visibility"
        assert lookup("reflection").channels == "RGB"
        assert lookup("depth").miss == float("inf")

    @pytest.mark.parametrize(
        ("wrong", "hint"),
        [
            ("beuaty", " (did you mean 'beauty'?)"),
            ("Beauty", " (did you mean 'beauty'?)"),
            ("normals", " (did you mean 'normal'?)"),
            ("shadow", " (did you mean 'shadow.L0'?)"),
            ("shadow.L*", " (did you mean 'shadow.L0'?)"),
            ("shadow.L01", " (did you mean 'shadow.L0'?)"),
            ("shadow.L-1", " (did you mean 'shadow.L0'?)"),
            ("shadow.L\u0661", " (did you mean 'shadow.L0'?)"),
            ("shadow.L0\n", " (did you mean 'shadow.L0'?)"),
            ("margin.ordre", " (did you mean 'margin.order'?)"),
            ("zzz", ""),
            ("", ""),
        ],
    )
    def test_lookup_of_what_is_not_there(self, wrong: str, hint: str) -> None:
        text = re.escape(f"unknown pass '{wrong}'{hint}")
        with pytest.raises(ValueError, match=f"^{text}$"):
            lookup(wrong)

    @pytest.mark.parametrize("wrong", ["reflection.0", "reflection.01", "reflection.x", "reflection.*", "reflection."])
    def test_bounces_count_from_one(self, wrong: str) -> None:
        with pytest.raises(ValueError, match=f"^unknown pass '{re.escape(wrong)}'"):
            lookup(wrong)


class TestPasses:
    @pytest.mark.parametrize(
        ("arrays", "text"),
        [
            ({"beauty": np.zeros((2, 3))}, "pass 'beauty' has shape (2, 3), expected (rows, columns, 3)"),
            ({"beauty": np.zeros((2, 3, 4))}, "pass 'beauty' has shape (2, 3, 4), expected (rows, columns, 3)"),
            ({"depth": np.zeros((2, 3, 1))}, "pass 'depth' has shape (2, 3, 1), expected (rows, columns)"),
            ({"depth": 1.0}, "pass 'depth' has shape (), expected (rows, columns)"),
            (
                {"depth": np.zeros((2, 3)), "normal": np.zeros((3, 2, 3))},
                "pass 'normal' has size (3, 2), the others (2, 3)",
            ),
            ({"depth": np.array([["a"]])}, "pass 'depth' holds <U1, expected numbers"),
            ({"depth": np.array([[None]])}, "pass 'depth' holds object, expected numbers"),
            ({"depth": np.zeros((1, 1), complex)}, "pass 'depth' holds complex128, expected numbers"),
            ({"deep": np.zeros((1, 1))}, "unknown pass 'deep' (did you mean 'depth'?)"),
        ],
        ids=lambda value: value if isinstance(value, str) else "",
    )
    def test_what_does_not_fit(self, arrays: dict[str, Any], text: str) -> None:
        with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
            Passes(arrays)

    def test_is_a_mapping_with_a_size(self) -> None:
        passes = every_pass()
        assert passes.shape == (13, 21)
        assert "beauty" in passes
        assert "beuaty" not in passes
        assert len(passes) == len(list(passes)) == len(names(2))
        assert repr(Passes({"depth": np.zeros((2, 3))})) == "Passes(3x2: depth)"
        with pytest.raises(KeyError):
            passes["beuaty"]


class TestQuantise:
    @pytest.mark.parametrize("real", [np.float32, np.float64])
    def test_the_ends(self, real: type[np.floating[Any]]) -> None:
        below_one = np.nextafter(real(1), real(0))
        smallest = np.finfo(real).smallest_subnormal
        values = [np.nan, np.inf, -np.inf, 0.0, -0.0, smallest, -smallest, below_one, 1.0, 1.5, 1e30, -1.0]
        expected = [0, 255, 0, 0, 0, 0, 0, 254, 255, 255, 255, 0]
        assert quantise(np.array(values, real)).tolist() == expected

    @pytest.mark.parametrize("real", [np.float32, np.float64])
    def test_where_levels_begin(self, real: type[np.floating[Any]]) -> None:
        """k/255 rounded to a float, times 255 and rounded, is k again or just below: the formula decides, as in C++."""
        levels = np.arange(256)
        values = levels.astype(real) / real(255)
        for step in (-2, -1, 0, 1, 2):
            moved = values
            for _ in range(abs(step)):
                moved = np.nextafter(moved, real(np.sign(step) * 9))
            expected = np.array([int(min(max(v, real(0)), real(1)) * real(255)) for v in moved])
            assert np.array_equal(quantise(moved), expected)
        assert (np.abs(quantise(values).astype(int) - levels) <= 1).all()

    @given(st.floats(width=32) | st.floats())
    def test_any_number(self, value: float) -> None:
        level = int(quantise(np.array([value]))[0])
        assert level == (int(min(value, 1.0) * 255.0) if value > 0 else 0)


def in_c(values: NDArray[Any]) -> NDArray[np.uint8]:
    """The levels that raytrace makes of the background colours, three values an image."""
    program = Path(sys.executable).parent / "raytrace"
    levels = []
    for triple in values.reshape(-1, 3).tolist():
        black = scene(1, 1).replace(spheres=(), background=tuple(triple))
        result = subprocess.run([program, "-", "-o-"], input=black.text().encode(), capture_output=True, check=True)
        levels += list(result.stdout[-3:])
    return np.array(levels, np.uint8)


def test_quantised_alike_in_c_and_in_python() -> None:
    values = np.array([0.0, 1.0, np.nextafter(1, 0), 5e-324, -1.0, 1e99, *(k / 255 for k in range(1, 255, 7))][:36])
    values = np.concatenate([values, np.nextafter(values, 0)])
    assert np.array_equal(in_c(values), quantise(values))


class TestImages:
    @pytest.mark.parametrize("size", [(21, 13), (1, 1), (640, 3)])
    def test_the_image_is_the_program_s(self, tmp_path: Path, size: tuple[int, int]) -> None:
        """Bit for bit, header and all."""
        small = scene(*size).replace(output="program.ppm")
        (tmp_path / "scene.txt").write_text(small.text())
        subprocess.run([Path(sys.executable).parent / "raytrace", "scene.txt"], cwd=tmp_path, check=True)
        passes = tracer.render(small)
        passes.save(tmp_path / "python.ppm")
        passes.save(tmp_path / "python.PNG")
        assert (tmp_path / "python.ppm").read_bytes() == (tmp_path / "program.ppm").read_bytes()
        with Image.open(tmp_path / "python.PNG") as png, Image.open(tmp_path / "program.ppm") as ppm:
            assert (png.format, png.mode, ppm.format) == ("PNG", "RGB", "PPM")
            assert np.array_equal(np.asarray(png), np.asarray(ppm))
            assert np.array_equal(np.asarray(png), quantise(passes["beauty"]))

    @pytest.mark.parametrize("ending", ["png", "ppm"])
    def test_without_beauty(self, tmp_path: Path, ending: str) -> None:
        text = "an image file holds the pass 'beauty', which is not among the passes: render it too"
        with pytest.raises(ValueError, match=f"^{text}$"):
            tracer.render(scene(), "depth").save(tmp_path / f"x.{ending}")
        assert list(tmp_path.iterdir()) == []


class TestFiles:
    @pytest.mark.parametrize("precision", ["f64", "f32"])
    def test_npz_is_lossless(self, tmp_path: Path, precision: Precision) -> None:
        passes = every_pass(precision)
        passes.save(tmp_path / "x.npz")
        equal(Passes.load(tmp_path / "x.npz"), passes)

    def test_exr_keeps_float32(self, tmp_path: Path) -> None:
        passes = every_pass()
        passes.save(tmp_path / "x.exr")
        narrow = {name: array if name == "id" else array.astype(np.float32) for name, array in passes.items()}
        equal(Passes.load(str(tmp_path / "x.exr")), Passes(narrow, passes.metadata))

    def test_exr_channel_names(self, tmp_path: Path) -> None:
        passes = every_pass()
        passes.save(tmp_path / "x.exr")
        with OpenEXR.File(str(tmp_path / "x.exr"), separate_channels=True) as file:
            pixels = {name: channel.pixels for name, channel in file.channels().items()}
        colours = ("ambient", "diffuse", "specular", "direct", "reflection", "reflection.1", "reflection.3")
        expected = {"R", "G", "B", "shadow.L0", "shadow.L1", "depth.Z", "id", "margin.silhouette", "margin.order"}
        expected |= {f"{name}.{channel}" for name in colours for channel in "RGB"}
        expected |= {f"{name}.{channel}" for name in ("position", "normal") for channel in "XYZ"}
        assert expected < set(pixels)
        assert len(pixels) == sum(len(lookup(name).channels) or 1 for name in passes)
        assert pixels["id"].dtype == np.uint32
        assert pixels["id"].min() == 0  # nothing hit
        assert {plane.dtype for name, plane in pixels.items() if name != "id"} == {np.dtype(np.float32)}

    def test_exr_of_numbers_beyond_float32(self, tmp_path: Path) -> None:
        Passes({"depth": np.array([[1e300, 1.0]])}).save(tmp_path / "x.exr")
        assert Passes.load(tmp_path / "x.exr")["depth"].tolist() == [[np.inf, 1]]

    def test_exr_of_another_program(self, tmp_path: Path) -> None:
        """Known channel names are found; the rest is left alone."""
        planes = {name: np.full((4, 5), k, np.float32) for k, name in enumerate(("B", "G", "R", "A", "depth.Z", "q.X"))}
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, planes) as file:
            file.write(str(tmp_path / "x.exr"))
        passes = Passes.load(tmp_path / "x.exr")
        assert list(passes) == ["beauty", "depth"]
        assert passes["beauty"][0, 0].tolist() == [2, 1, 0]
        assert passes.metadata == {}

    @pytest.mark.parametrize(
        ("header", "text"),
        [
            (None, "no known pass among the channels q.X"),
            ({"passes": ["beauty"]}, "pass 'beauty' lacks the channel 'R'"),
            ({"passes": ["deep"]}, "unknown pass 'deep' (did you mean 'depth'?)"),
            ([1], ""),
            ("nonsense", ""),
        ],
        ids=str,
    )
    def test_exr_with_a_strange_header(self, tmp_path: Path, header: Any, text: str) -> None:
        described = {} if header is None else {"whitted": header if isinstance(header, str) else json.dumps(header)}
        with OpenEXR.File({"type": OpenEXR.scanlineimage, **described}, {"q.X": np.zeros((2, 2), np.float32)}) as file:
            file.write(str(tmp_path / "x.exr"))
        start = re.escape(f"{tmp_path / 'x.exr'}: not a readable .exr file (")
        with pytest.raises(ValueError, match=f"^{start}{re.escape(text)}.*\\)$"):
            Passes.load(tmp_path / "x.exr")

    @pytest.mark.parametrize(
        "content",
        [
            {"beauty": np.zeros((2, 2))},
            {"depth": np.array([["x"]])},
            {"depth": np.zeros((2, 2)), "metadata": np.array("[1")},
            {"depth": np.zeros((2, 2)), "metadata": np.array("[1]")},
            {"what": np.zeros((2, 2))},
        ],
        ids=["shape", "text", "metadata", "metadata list", "name"],
    )
    def test_npz_of_something_else(self, tmp_path: Path, content: dict[str, Any]) -> None:
        with (tmp_path / "x.npz").open("wb") as file:
            np.savez(file, allow_pickle=False, **content)
        with pytest.raises(ValueError, match=f"^{re.escape(str(tmp_path / 'x.npz'))}: not a readable .npz file "):
            Passes.load(tmp_path / "x.npz")

    def test_npz_never_runs_what_is_in_it(self, tmp_path: Path) -> None:
        class Harmful:
            def __reduce__(self) -> tuple[Any, ...]:
                return (os.mkdir, (str(tmp_path / "harm"),))

        for content in ({"depth": np.array([[Harmful()]], dtype=object)},):
            with (tmp_path / "x.npz").open("wb") as file:
                np.savez(file, allow_pickle=True, **content)
            with pytest.raises(ValueError, match=r"not a readable \.npz file"):
                Passes.load(tmp_path / "x.npz")
        np.save(tmp_path / "x.npy", np.zeros((2, 2)))
        (tmp_path / "x.npy").rename(tmp_path / "x.npz")
        with pytest.raises(ValueError, match=r"not a readable \.npz file"):
            Passes.load(tmp_path / "x.npz")
        assert not (tmp_path / "harm").exists()

    @pytest.mark.parametrize("ending", ["exr", "npz"])
    def test_damaged_files(self, tmp_path: Path, ending: str) -> None:
        """A ValueError, never another exception."""
        passes = tracer.render(scene(7, 5), ("beauty", "depth", "id", "shadow.L0"))
        path = tmp_path / f"x.{ending}"
        passes.save(path)
        whole = path.read_bytes()
        generator = random.Random(ending)
        lengths = sorted({0, 1, 4, 8, len(whole) // 2, len(whole) - 1, *generator.sample(range(len(whole)), 40)})
        for length in lengths:
            path.write_bytes(whole[:length])
            with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: not a readable .{ending} file "):
                Passes.load(path)
        refused = 0
        for _ in range(150):
            damaged = bytearray(whole)
            for _ in range(generator.randint(1, 4)):
                damaged[generator.randrange(len(damaged))] = generator.randrange(256)
            path.write_bytes(damaged)
            try:
                Passes.load(path)
            except ValueError as error:
                refused += str(error).startswith(f"{path}: not a readable .{ending} file ")
        assert refused > 100

    def test_endings(self, tmp_path: Path) -> None:
        passes = tracer.render(scene())
        for name in ("x.jpg", "x", ".exr"):
            ending = Path(name).suffix
            text = re.escape(f"unknown file ending '{ending}': expected .exr, .npz")
            with pytest.raises(ValueError, match=f"^{text}, .png or .ppm$"):
                passes.save(tmp_path / name)
            with pytest.raises(ValueError, match=re.escape(f"unknown file ending '{ending}': expected .exr or .npz")):
                Passes.load(tmp_path / name)
        with pytest.raises(ValueError, match=r"expected \.exr or \.npz"):
            Passes.load(tmp_path / "x.png")
        assert list(tmp_path.iterdir()) == []

    def test_no_such_file(self, tmp_path: Path) -> None:
        (tmp_path / "folder.npz").mkdir()
        for name in ("x.npz", "x.exr", "folder.npz"):
            with pytest.raises(FileNotFoundError, match=re.escape(f"no such file: {tmp_path / name}")):
                Passes.load(tmp_path / name)


@pytest.fixture
def small_files() -> Iterator[None]:
    """No file may grow beyond 2000 bytes, as if the disk were full."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


class TestNoHalfFiles:
    @pytest.mark.parametrize("ending", ["exr", "npz", "png", "ppm"])
    @pytest.mark.parametrize("before", [None, b"before"])
    @pytest.mark.usefixtures("small_files")
    def test_a_full_disk(self, tmp_path: Path, ending: str, before: bytes | None) -> None:
        path = tmp_path / f"x.{ending}"
        if before is not None:
            path.write_bytes(before)
        passes = tracer.render(scene(200, 200))
        with pytest.raises(OSError, match="File too large"):
            passes.save(path)
        assert {other.name: other.read_bytes() for other in tmp_path.iterdir()} == (
            {} if before is None else {path.name: before}
        )

    def test_an_error_midway(self, tmp_path: Path) -> None:
        path = tmp_path / "x.txt"
        path.write_text("before")

        def fail() -> None:
            with write_beside(path) as temporary:
                temporary.write_text("half")
                assert temporary.parent == path.parent
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fail()
        assert {other.name: other.read_text() for other in tmp_path.iterdir()} == {"x.txt": "before"}

    @pytest.mark.parametrize("place", ["mkstemp", "write"])
    def test_an_error_names_the_target(self, tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
        path = tmp_path / "x.txt"

        def full(*_: object, **__: object) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), None if place == "write" else "/other")

        def write() -> None:
            with write_beside(path) as temporary:
                assert temporary.exists()
                full()

        if place == "mkstemp":
            monkeypatch.setattr("tempfile.mkstemp", full)
        with pytest.raises(OSError, match="No space left") as caught:
            write()
        assert caught.value.filename == str(path)
        assert list(tmp_path.iterdir()) == []

    def test_a_pipe_is_written_and_stays_a_pipe(self, tmp_path: Path) -> None:
        """So does a device: who runs as root must not lose /dev/null."""
        path = tmp_path / "pipe"
        os.mkfifo(path)
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        with write_beside(path) as place:
            place.write_text("words")
        assert os.read(reader, 100) == b"words"
        os.close(reader)
        assert path.is_fifo()
        assert list(tmp_path.iterdir()) == [path]

    def test_readers_see_the_old_file_or_the_new_one(self, tmp_path: Path) -> None:
        path = tmp_path / "x.npz"
        images = [tracer.render(scene(60, 60), "beauty", max_reflections=k) for k in (0, 3)]
        images[0].save(path)
        done = threading.Event()

        def write() -> None:
            for k in range(60):
                images[k % 2].save(path)
            done.set()

        writer = threading.Thread(target=write)
        writer.start()
        seen = 0
        while not done.is_set():
            image = Passes.load(path)["beauty"]
            assert any(np.array_equal(image, one["beauty"]) for one in images)
            seen += 1
        writer.join()
        assert seen > 5

    def test_the_name_may_be_long_and_a_link(self, tmp_path: Path) -> None:
        passes = tracer.render(scene())
        long = tmp_path / ("x" * 250 + ".npz")
        passes.save(long)
        equal(Passes.load(long), passes)
        (tmp_path / "folder").mkdir()
        (tmp_path / "link.npz").symlink_to("folder/real.npz")
        passes.save(tmp_path / "link.npz")
        assert (tmp_path / "link.npz").is_symlink()
        equal(Passes.load(tmp_path / "folder" / "real.npz"), passes)

    def test_permissions_follow_the_umask(self, tmp_path: Path) -> None:
        mask = os.umask(0o027)
        try:
            tracer.render(scene()).save(tmp_path / "x.png")
        finally:
            os.umask(mask)
        assert stat.S_IMODE((tmp_path / "x.png").stat().st_mode) == 0o640

    def test_a_folder_that_is_not_there(self, tmp_path: Path) -> None:
        folder = tmp_path / "no"
        with pytest.raises(FileNotFoundError, match=re.escape(f"no such folder: '{folder}'")):
            tracer.render(scene()).save(folder / "x.png")
