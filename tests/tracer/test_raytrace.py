"""The program raytrace: options, errors, what it may write, signals, memory, and what it says on the terminal."""

from __future__ import annotations

import contextlib
import os
import pty
import resource
import select
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from programs import started

import tracer
from tracer._render import Precision
from tracer.passes import Sample, quantise

RAYTRACE = Path(sys.executable).parent / "raytrace"

SCENE = """\
NEAR 1
LEFT -1
RIGHT 1
BOTTOM -1
TOP 1
RES 40 30
SPHERE ball 0 0 -3 1 1 1 0.9 0.5 0.1 0.3 0.6 0.4 0.5 20
SPHERE cut 1 0.5 -1.5 0.8 0.6 0.7 0.1 0.5 0.9 0.3 0.6 0.4 0.5 7.5
LIGHT key 3 4 1 0.9 0.8 0.7
BACK 0.1 0.2 0.3
AMBIENT 0.4 0.4 0.5
OUTPUT image.ppm
"""
# From inside a mirror every ray goes on for as many bounces as are asked for: a small image that takes long.
ENDLESS = """\
NEAR 1
LEFT -1
RIGHT 1
BOTTOM -1
TOP 1
RES 2000 2000
SPHERE a 0 0 0 5 4 6 0.5 0.5 0.5 1 1 1 1 50
SPHERE b 1 1 -3 1 1 1 0.5 0.5 0.5 1 1 1 1 50
LIGHT l 0 1 0 1 1 1
BACK 0 0 0
AMBIENT 1 1 1
OUTPUT image.ppm
"""
SLOWLY = ("--max-reflections", "1000", "--threads", "1")
EMPTY = "NEAR 1\nLEFT -1\nRIGHT 1\nBOTTOM -1\nTOP 1\nRES {} {}\nBACK 0.1 0.2 0.3\nAMBIENT 0 0 0\nOUTPUT image.ppm\n"

Result = subprocess.CompletedProcess[bytes]


def raytrace(*arguments: str, folder: Path, stdin: bytes = b"", **environment: str) -> Result:
    """The program, run in a folder with nothing but its own environment."""
    return subprocess.run(
        [RAYTRACE, *arguments], cwd=folder, input=stdin, capture_output=True, timeout=60, env=environment, check=False
    )


def error(text: str) -> tuple[int, bytes, str]:
    """What a failing run leaves: the exit status, nothing on stdout, and the text."""
    return 2, b"", text


def outcome(result: Result) -> tuple[int, bytes, str]:
    return result.returncode, result.stdout, result.stderr.decode()


def pixels(data: bytes, columns: int = 40, rows: int = 30) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    header = f"P6\n{columns} {rows}\n255\n".encode()
    assert data.startswith(header)
    return np.frombuffer(data[len(header) :], np.uint8).reshape(rows, columns, 3)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a scene in it."""
    here = tmp_path / "here"
    here.mkdir()
    (here / "scene.txt").write_text(SCENE)
    (here / "endless.txt").write_text(ENDLESS)
    return here


def names(folder: Path) -> set[str]:
    """What is in the folder besides the scenes."""
    return {path.name for path in folder.iterdir()} - {"scene.txt", "endless.txt"}


class TestImage:
    def test_writes_what_output_names_and_says_nothing(self, folder: Path) -> None:
        assert outcome(raytrace("scene.txt", folder=folder)) == (0, b"", "")
        expected = quantise(tracer.render(tracer.loads(SCENE))["beauty"])
        assert np.array_equal(pixels((folder / "image.ppm").read_bytes()), expected)
        assert names(folder) == {"image.ppm"}

    def test_needs_no_python(self, folder: Path, tmp_path: Path) -> None:
        """The program copied somewhere else runs in an empty environment."""
        copy = tmp_path / "program"
        shutil.copy(RAYTRACE, copy)
        subprocess.run([copy, "scene.txt"], cwd=folder, env={}, check=True)
        assert names(folder) == {"image.ppm"}
        libraries = subprocess.run(["ldd", copy], capture_output=True, text=True, check=False).stdout
        assert "python" not in libraries

    @pytest.mark.parametrize(
        "option",
        [("-o", "x.ppm"), ("-ox.ppm",), ("--output", "x.ppm"), ("--output=x.ppm",)],
        ids=lambda option: " ".join(option),
    )
    def test_output_option(self, folder: Path, option: tuple[str, ...]) -> None:
        assert outcome(raytrace(*option, "scene.txt", folder=folder)) == (0, b"", "")
        assert names(folder) == {"x.ppm"}

    def test_stdin_and_stdout(self, folder: Path) -> None:
        result = raytrace("-", "-o", "-", folder=folder, stdin=SCENE.encode())
        assert (result.returncode, result.stderr) == (0, b"")
        raytrace("scene.txt", folder=folder)
        assert (folder / "image.ppm").read_bytes() == result.stdout

    def test_a_scene_that_is_called_like_an_option(self, folder: Path) -> None:
        (folder / "-x").write_text(SCENE)
        assert outcome(raytrace("--", "-x", folder=folder)) == (0, b"", "")

    def test_output_called_dash_is_a_file(self, folder: Path) -> None:
        text = SCENE.replace("image.ppm", "-")
        assert outcome(raytrace("-", folder=folder, stdin=text.encode())) == (0, b"", "")
        assert names(folder) == {"-"}

    @pytest.mark.parametrize("sample", ["corner", "center", "bottom-left", "top-right", "inclusive"])
    @pytest.mark.parametrize("precision", ["f64", "f32"])
    def test_settings_reach_the_renderer(self, folder: Path, sample: Sample, precision: Precision) -> None:
        result = raytrace(
            *("scene.txt", "-o-", f"--sample={sample}", "--precision", precision, "--threads", "2"),
            *("--shadow-epsilon", "0.25", "--max-reflections=1"),
            folder=folder,
        )
        expected = tracer.render(
            tracer.loads(SCENE), precision=precision, sample=sample, shadow_epsilon=0.25, max_reflections=1
        )
        assert np.array_equal(pixels(result.stdout), quantise(expected["beauty"]))

    def test_each_setting_changes_the_image(self, folder: Path) -> None:
        """So that the test above can tell whether a setting was read at all."""
        settings = ["--sample=center", "--sample=bottom-left", "--sample=inclusive", "--shadow-epsilon=0.25"]
        settings += ["--max-reflections=0", "--max-reflections=1"]
        images = [raytrace("scene.txt", "-o-", setting, folder=folder).stdout for setting in settings]
        assert len({*images, raytrace("scene.txt", "-o-", folder=folder).stdout}) == len(settings) + 1

    def test_the_last_of_repeated_options_counts(self, folder: Path) -> None:
        once = raytrace("scene.txt", "-o-", "--sample=center", folder=folder)
        twice = raytrace("scene.txt", "-o-", "--sample=corner", "--sample=center", folder=folder)
        assert once.stdout == twice.stdout

    def test_no_limits(self, folder: Path) -> None:
        sphere = next(line for line in SCENE.splitlines() if line.startswith("SPHERE ball"))
        many = SCENE + "".join(sphere.replace("0 0 -3", f"{k} 0 -9") + "\n" for k in range(8))
        refused = raytrace("-", folder=folder, stdin=many.encode())
        assert refused.returncode == 2
        assert "--no-limits" in refused.stderr.decode()
        assert outcome(raytrace("-", "--no-limits", folder=folder, stdin=many.encode())) == (0, b"", "")

    def test_duplicates_are_a_warning(self, folder: Path) -> None:
        sphere = next(line for line in SCENE.splitlines() if line.startswith("SPHERE ball"))
        result = raytrace("-", "-o-", folder=folder, stdin=f"{SCENE}{sphere.replace('0.9', '0.1')}\n".encode())
        assert result.returncode == 0
        assert result.stdout == raytrace("scene.txt", "-o-", folder=folder).stdout
        assert result.stderr.decode().startswith("<stdin>:13:1: warning: 'ball' ")

    @pytest.mark.parametrize("locale", ["de_DE.UTF-8", "tr_TR.UTF-8", "C", "no_SUCH"])
    def test_the_locale_has_no_effect(self, folder: Path, locale: str) -> None:
        plain = raytrace("scene.txt", "-o-", folder=folder)
        assert raytrace("scene.txt", "-o-", folder=folder, LC_ALL=locale, LANG=locale).stdout == plain.stdout

    @pytest.mark.parametrize("threads", ["0", "1", "3", "1024"])
    def test_threads(self, folder: Path, threads: str) -> None:
        (folder / "large.txt").write_text(SCENE.replace("RES 40 30", "RES 700 500"))
        one = raytrace("large.txt", "-o-", "--threads=1", folder=folder)
        assert raytrace("large.txt", "-o-", "--threads", threads, folder=folder).stdout == one.stdout

    def test_a_row_longer_than_a_band(self, folder: Path) -> None:
        """Bands are of pixels, not of rows."""
        result = raytrace("-", "-o-", "--no-limits", folder=folder, stdin=EMPTY.format(3_000_001, 1).encode())
        image = pixels(result.stdout, 3_000_001, 1)
        assert (image == (25, 51, 76)).all()


class TestMessages:
    def test_help(self, folder: Path) -> None:
        for option in ("--help", "-h"):
            result = raytrace(option, folder=folder)
            assert (result.returncode, result.stderr) == (0, b"")
            assert result.stdout.startswith(b"Usage: raytrace [OPTIONS] SCENE\n")
        for option in ("--output", "--precision", "--threads", "--sample", "--shadow-epsilon", "--max-reflections"):
            assert option in result.stdout.decode()

    def test_version(self, folder: Path) -> None:
        expected = f"raytrace {tracer.version()} (scalar, {tracer.compiler()})\n"
        assert outcome(raytrace("--version", folder=folder, WHITTED_ISA="scalar")) == (0, expected.encode(), "")

    COMMAND_ERRORS = (
        ([], "error: no scene is given\n  hint: raytrace SCENE, or raytrace --help\n"),
        ([""], "error: no scene is given\n  hint: raytrace SCENE, or raytrace --help\n"),
        (["scene.txt", "b.txt"], "error: a second scene, 'b.txt'\n  hint: raytrace renders one scene at a time\n"),
        (["--"], "error: no scene is given\n  hint: raytrace SCENE, or raytrace --help\n"),
        (["scene.txt", "--ouput", "x"], "error: unknown option '--ouput'\n  hint: did you mean '--output'?\n"),
        (["scene.txt", "--thread=2"], "error: unknown option '--thread'\n  hint: did you mean '--threads'?\n"),
        (["scene.txt", "-x"], "error: unknown option '-x'\n  hint: raytrace --help lists the options\n"),
        (["scene.txt", "--zzz"], "error: unknown option '--zzz'\n  hint: raytrace --help lists the options\n"),
        (["scene.txt", "-o"], "error: the option -o needs a value\n  hint: raytrace --help says which\n"),
        (["scene.txt", "--sample"], "error: the option --sample needs a value\n  hint: raytrace --help says which\n"),
        (["scene.txt", "--output="], "error: the file name after --output is empty\n  hint: name a file\n"),
        (["scene.txt", "-o", ""], "error: the file name after -o is empty\n  hint: name a file\n"),
        (
            ["scene.txt", "--no-limits=1"],
            "error: the option --no-limits takes no value\n  hint: leave out what stands after the '='\n",
        ),
        (["--help=x"], "error: the option --help takes no value\n  hint: leave out what stands after the '='\n"),
        (
            ["scene.txt", "--precision", "f16"],
            "error: 'f16' is not a value of --precision\n  hint: expected f64 or f32\n",
        ),
        *(
            (
                ["scene.txt", f"--threads={wrong}"],
                f"error: '{wrong}' is not a value of --threads\n  hint: expected an integer from 0 to 1024\n",
            )
            for wrong in ("-1", "1025", "two", "1.5", "", " 1", "99999999999999999999")
        ),
        (
            ["scene.txt", "--sample", "centre"],
            "error: 'centre' is not a value of --sample\n"
            "  hint: expected corner, center, bottom-left, top-right or inclusive\n",
        ),
        *(
            (
                ["scene.txt", "--shadow-epsilon", wrong],
                f"error: '{wrong}' is not a value of --shadow-epsilon\n"
                "  hint: expected a number from 0 up to, but not including, 1\n",
            )
            for wrong in ("1", "-0.1", "nan", "0x1p-3", "1e-4x", "")
        ),
        *(
            (
                ["scene.txt", "--max-reflections", wrong],
                f"error: '{wrong}' is not a value of --max-reflections\n  hint: expected an integer from 0 to 1000\n",
            )
            for wrong in ("-1", "1001", "3.0")
        ),
        (
            ["missing.txt"],
            "error: cannot read 'missing.txt': No such file or directory\n  hint: check the name of the scene file\n",
        ),
        (["."], "error: '.' is a folder, not a scene file\n"),
    )

    @pytest.mark.parametrize(("arguments", "text"), COMMAND_ERRORS, ids=[" ".join(a) for a, _ in COMMAND_ERRORS])
    def test_command_errors(self, folder: Path, arguments: list[str], text: str) -> None:
        assert outcome(raytrace(*arguments, folder=folder)) == error(text)
        assert names(folder) == set()

    def test_scene_errors_are_all_reported_with_their_place(self, folder: Path) -> None:
        (folder / "scene.txt").write_text(SCENE.replace("SPHERE cut", "SPHRE cut").replace("RES 40 30", "RES 40 0"))
        result = raytrace("scene.txt", folder=folder)
        assert (result.returncode, result.stdout) == (2, b"")
        lines = result.stderr.decode().splitlines()
        assert [line.split(" ")[:2] for line in lines if line.startswith("scene.txt:")] == [
            ["scene.txt:6:8:", "error:"],
            ["scene.txt:8:1:", "error:"],
        ]
        assert any(line.startswith("  hint: ") and "SPHERE" in line for line in lines)
        assert names(folder) == set()

    def test_what_float32_cannot_carry(self, folder: Path) -> None:
        text = SCENE.replace("0 0 -3", "0 0 -3e20").encode()
        assert outcome(raytrace("-", "-o-", folder=folder, stdin=text))[0] == 0
        result = raytrace("-", "-o-", "--precision=f32", folder=folder, stdin=text)
        assert (result.returncode, result.stdout) == (2, b"")
        assert "float32" in result.stderr.decode()
        assert "hint: render it in float64" in result.stderr.decode()

    def test_an_instruction_set_that_is_not_there(self, folder: Path) -> None:
        result = raytrace("scene.txt", folder=folder, WHITTED_ISA="mmx")
        assert result.returncode == 2
        text = result.stderr.decode()
        assert text.startswith("error: WHITTED_ISA is 'mmx', but here it can be one of ")
        assert "scalar" in text
        assert text.endswith("\n  hint: unset WHITTED_ISA to use the best one\n")
        foreign = "neon" if "sse2" in text else "sse2"
        assert raytrace("scene.txt", folder=folder, WHITTED_ISA=foreign).returncode == 2
        assert raytrace("scene.txt", folder=folder, WHITTED_ISA="").returncode == 0

    def test_a_file_that_is_no_scene_is_not_read_to_its_end(self, folder: Path) -> None:
        assert outcome(raytrace("/dev/zero", folder=folder)) == error(
            "error: '/dev/zero' is larger than 67108864 bytes, which no scene needs\n"
            "  hint: check the name of the scene file\n"
        )

    @pytest.mark.parametrize("name", ["x.png", "x.JPEG"])
    def test_a_ppm_under_another_name(self, folder: Path, name: str) -> None:
        status, out, err = outcome(raytrace("scene.txt", "-o", name, folder=folder))
        assert (status, out) == (0, b"")
        assert f"warning: '{name}' becomes a PPM file, whatever {Path(name).suffix.lower()} says\n" in str(err)
        assert (folder / name).read_bytes().startswith(b"P6")

    def test_a_scene_that_is_there_but_cannot_be_read(self, folder: Path) -> None:
        """The name is right: no hint to check it. A loop, because root may read any file."""
        (folder / "loop.txt").symlink_to("loop.txt")
        text = "error: cannot read 'loop.txt': Too many levels of symbolic links\n"
        assert outcome(raytrace("loop.txt", folder=folder)) == error(text)

    def test_a_full_stdout(self, folder: Path) -> None:
        for arguments in (["--help"], ["--version"], ["scene.txt", "-o", "-"]):
            with Path("/dev/full").open("wb") as full:
                result = subprocess.run(
                    [RAYTRACE, *arguments], cwd=folder, stdout=full, stderr=subprocess.PIPE, env={}, check=False
                )
            assert result.returncode == 2
            assert result.stderr == b"error: cannot write to stdout: No space left on device\n"


class TestWhatMayBeWritten:
    """OUTPUT comes from a file that somebody else may have written."""

    HINT = "  hint: name the file yourself: raytrace SCENE -o FILE\n"

    def refused(self, folder: Path, output: str) -> str:
        """The message without the hint, which is always the same."""
        before = {path: path.lstat().st_mtime_ns for path in folder.parent.rglob("*")}
        result = raytrace("-", folder=folder, stdin=SCENE.replace("image.ppm", output).encode())
        assert (result.returncode, result.stdout) == (2, b"")
        assert {path: path.lstat().st_mtime_ns for path in folder.parent.rglob("*")} == before
        text = result.stderr.decode()
        assert text.endswith(self.HINT)
        return text.removesuffix(self.HINT)

    def test_absolute(self, folder: Path) -> None:
        inside = f"{folder}/x.ppm"
        assert self.refused(folder, inside) == (
            f"error: OUTPUT '{inside}' is an absolute path, which a scene may not write\n"
        )

    @pytest.mark.parametrize("output", ["..", "../x.ppm", "a/../x.ppm", "a/..", "a/../../x.ppm"])
    def test_dot_dot(self, folder: Path, output: str) -> None:
        (folder / "a").mkdir()
        assert self.refused(folder, output) == (
            f"error: OUTPUT '{output}' contains '..', which leads out of the current folder\n"
        )

    @pytest.mark.parametrize("target", ["existing", "dangling", "folder", "twice", "sibling"])
    def test_symbolic_links_out(self, folder: Path, tmp_path: Path, target: str) -> None:
        outside = tmp_path / "outside"
        outside.mkdir()
        (outside / "file").write_text("precious")
        sibling = tmp_path / "here-too"  # its name begins with the folder's name
        sibling.mkdir()
        links = {
            "existing": (outside / "file", "link"),
            "dangling": (outside / "new", "link"),
            "folder": (outside, "link/x.ppm"),
            "twice": (Path("second"), "link"),
            "sibling": (Path("../here-too/x"), "link"),
        }
        to, output = links[target]
        (folder / "second").symlink_to(outside / "new")
        (folder / "link").symlink_to(to)
        assert self.refused(folder, output) == (
            f"error: OUTPUT '{output}' leads out of the current folder through a symbolic link\n"
        )
        assert (outside / "file").read_text() == "precious"

    def test_links_that_go_in_circles(self, folder: Path) -> None:
        (folder / "link").symlink_to("link")
        assert self.refused(folder, "link").startswith("error: OUTPUT 'link' cannot be followed: ")

    @pytest.mark.parametrize("kind", ["fifo", "socket"])
    def test_neither_pipes_nor_devices(self, folder: Path, kind: str) -> None:
        if kind == "fifo":
            os.mkfifo(folder / "it")
        else:
            with contextlib.chdir(folder), socket.socket(socket.AF_UNIX) as made:
                made.bind("it")
        assert self.refused(folder, "it") == "error: OUTPUT 'it' is not a regular file\n"

    @pytest.mark.parametrize("target", ["inside", "dangling", "folder"])
    def test_links_that_stay_inside_are_followed(self, folder: Path, target: str) -> None:
        (folder / "sub").mkdir()
        (folder / "sub" / "old").write_text("old")
        to, output, written = {
            "inside": ("sub/old", "link", "sub/old"),
            "dangling": ("sub/new", "link", "sub/new"),
            "folder": ("sub", "link/x", "sub/x"),
        }[target]
        (folder / "link").symlink_to(to)
        result = raytrace("-", folder=folder, stdin=SCENE.replace("image.ppm", output).encode())
        assert outcome(result) == (0, b"", "")
        assert (folder / "link").is_symlink()
        pixels((folder / written).read_bytes())

    def test_below_the_current_folder(self, folder: Path) -> None:
        (folder / "a" / "b").mkdir(parents=True)
        for output in ("a/x.ppm", "./a/b/x.ppm", "a//y.ppm", "..x", "x..ppm", ".hidden"):
            result = raytrace("-", folder=folder, stdin=SCENE.replace("image.ppm", output).encode())
            assert outcome(result) == (0, b"", "")
            pixels((folder / output).read_bytes())

    @pytest.mark.parametrize("how", ["name", "link", "hard link", "-o", "-o on stdin"])
    def test_never_the_scene_itself(self, folder: Path, how: str) -> None:
        output = "other" if "link" in how else "scene.txt"
        text = SCENE.replace("image.ppm", output)
        (folder / "scene.txt").write_text(text)
        if how == "link":
            (folder / "other").symlink_to("scene.txt")
        if how == "hard link":
            (folder / "other").hardlink_to(folder / "scene.txt")
        with (folder / "scene.txt").open("rb") as stdin:
            result = subprocess.run(
                [RAYTRACE, "-" if "stdin" in how else "scene.txt", *(["-o", "scene.txt"] if "-o" in how else [])],
                cwd=folder,
                stdin=stdin,
                capture_output=True,
                env={},
                check=False,
            )
        assert outcome(result) == error(
            f"error: '{output}' is the scene file itself, which is not overwritten\n"
            "  hint: choose another file with -o\n"
        )
        assert (folder / "scene.txt").read_text() == text

    def test_a_folder_is_no_file(self, folder: Path) -> None:
        (folder / "sub").mkdir()
        for arguments in (["-o", "sub"], ["-o", "sub/"], ["-o", "."]):
            result = raytrace("scene.txt", *arguments, folder=folder)
            assert outcome(result) == error(f"error: '{arguments[1]}' is a folder\n  hint: name a file with -o\n")
        result = raytrace("-", folder=folder, stdin=SCENE.replace("image.ppm", "sub").encode())
        assert outcome(result) == error("error: 'sub' is a folder\n  hint: name a file with -o\n")

    @pytest.mark.parametrize("made_by", ["option", "field"])
    def test_a_folder_that_is_not_there(self, folder: Path, made_by: str) -> None:
        text = SCENE if made_by == "option" else SCENE.replace("image.ppm", "no/x.ppm")
        arguments = ["-o", "no/x.ppm"] if made_by == "option" else []
        assert outcome(raytrace("-", *arguments, folder=folder, stdin=text.encode())) == error(
            "error: cannot write 'no/x.ppm': No such file or directory\n"
            "  hint: create the folder, or name another file with -o\n"
        )
        assert names(folder) == set()

    def test_a_folder_where_nothing_can_be_made(self, folder: Path) -> None:
        result = raytrace("scene.txt", "-o", "/proc/x.ppm", folder=folder)
        assert result.returncode == 2
        assert result.stderr.decode().startswith("error: cannot write into the folder '/proc': ")

    def test_the_option_may_name_what_the_field_may_not(self, folder: Path, tmp_path: Path) -> None:
        (folder / "link").symlink_to(tmp_path / "elsewhere")
        for name in (str(tmp_path / "absolute.ppm"), "../up.ppm", "link"):
            assert outcome(raytrace("scene.txt", "-o", name, folder=folder)) == (0, b"", "")
        assert {path.name for path in tmp_path.iterdir()} == {"here", "absolute.ppm", "up.ppm", "elsewhere"}

    def test_a_pipe_by_name(self, folder: Path) -> None:
        os.mkfifo(folder / "pipe")
        received: list[bytes] = []
        reader = threading.Thread(target=lambda: received.append((folder / "pipe").read_bytes()))
        reader.start()
        assert outcome(raytrace("scene.txt", "-o", "pipe", folder=folder)) == (0, b"", "")
        reader.join(10)
        pixels(received[0])
        assert stat.S_ISFIFO((folder / "pipe").stat().st_mode)

    def test_permissions_follow_the_umask(self, folder: Path) -> None:
        subprocess.run([RAYTRACE, "scene.txt"], cwd=folder, env={}, umask=0o027, check=True)
        assert stat.S_IMODE((folder / "image.ppm").stat().st_mode) == 0o640

    def test_closed_standard_streams(self, folder: Path) -> None:
        """The file must not take the number of a closed stderr and receive its warnings."""
        for closed in ("<&-", ">&-", "2>&-", "<&- >&- 2>&-"):
            subprocess.run(["/bin/sh", "-c", f"'{RAYTRACE}' scene.txt {closed}"], cwd=folder, env={}, check=True)
            pixels((folder / "image.ppm").read_bytes())
        written = subprocess.run(
            ["/bin/sh", "-c", f"'{RAYTRACE}' scene.txt -o - >&-"], cwd=folder, env={}, capture_output=True, check=False
        )
        assert (written.returncode, written.stderr) == (2, b"error: cannot write to stdout: Bad file descriptor\n")


def wait_for(condition: Callable[[], object], seconds: float = 20) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.005)


class TestNoHalfFiles:
    @pytest.mark.parametrize("kill", ["INT", "TERM", "HUP", "KILL"])
    def test_signals(self, folder: Path, kill: str) -> None:
        """While it renders there is a temporary file beside; what was there before stays until the new one is whole."""
        (folder / "image.ppm").write_bytes(b"before")
        number = getattr(signal, f"SIG{kill}")
        with started([RAYTRACE, "endless.txt", *SLOWLY], cwd=folder, stderr=subprocess.PIPE, env={}) as program:
            wait_for(lambda: len(names(folder)) == 2)
            program.send_signal(number)
            _, stderr = program.communicate(timeout=20)
            assert (folder / "image.ppm").read_bytes() == b"before"
            if kill == "KILL":  # nobody can tidy up then, but the name stays clean
                assert program.returncode == -number
            else:
                assert (program.returncode, stderr) == (128 + number, b"stopped: nothing was written\n")
                assert names(folder) == {"image.ppm"}

    def test_a_signal_that_is_ignored_stays_ignored(self, folder: Path) -> None:
        """As under nohup."""
        (folder / "large.txt").write_text(EMPTY.format(4000, 4000))
        command = f"trap '' HUP; exec '{RAYTRACE}' large.txt --threads 1"
        with started(["/bin/sh", "-c", command], cwd=folder, env={"WHITTED_ISA": "scalar"}) as program:
            wait_for(lambda: any(name.startswith(".raytrace-") for name in names(folder)))
            program.send_signal(signal.SIGHUP)
            assert program.wait(30) == 0
            assert names(folder) == {"image.ppm", "large.txt"}

    @pytest.mark.parametrize("output", ["pipe", "stdout"])
    def test_interrupt_while_nobody_reads(self, folder: Path, output: str) -> None:
        """Waiting for the reader of a pipe ends with the signal, too."""
        (folder / "large.txt").write_text(EMPTY.format(1000, 1000))
        os.mkfifo(folder / "pipe")
        with started(
            [RAYTRACE, "large.txt", "-o", "pipe" if output == "pipe" else "-"],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={},
        ) as program:
            wait_for(lambda: Path(f"/proc/{program.pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "S")
            time.sleep(0.05)
            program.send_signal(signal.SIGINT)
            assert program.wait(20) == 130
            assert program.stdout is not None
            assert program.stderr is not None
            assert program.stderr.read() == (
                b"stopped: nothing was written\n" if output == "pipe" else b"stopped: the image is incomplete\n"
            )
            program.stdout.close()
            program.stderr.close()

    def test_interrupt_while_the_scene_is_awaited(self, folder: Path) -> None:
        with started([RAYTRACE, "-"], cwd=folder, stdin=subprocess.PIPE, stderr=subprocess.PIPE, env={}) as program:
            wait_for(lambda: Path(f"/proc/{program.pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "S")
            program.send_signal(signal.SIGINT)
            assert program.wait(20) == 130
            for stream in (program.stdin, program.stderr):
                assert stream is not None
                stream.close()

    def test_a_broken_pipe(self, folder: Path) -> None:
        (folder / "large.txt").write_text(EMPTY.format(1000, 1000))
        read, write = os.pipe()
        os.close(read)
        result = subprocess.run(
            [RAYTRACE, "large.txt", "-o", "-"], cwd=folder, stdout=write, stderr=subprocess.PIPE, env={}, check=False
        )
        os.close(write)
        assert (result.returncode, result.stderr) == (2, b"error: cannot write to stdout: Broken pipe\n")

    def test_a_full_device(self, folder: Path) -> None:
        assert outcome(raytrace("scene.txt", "-o", "/dev/full", folder=folder)) == error(
            "error: cannot write '/dev/full': No space left on device\n"
        )

    def test_a_file_that_may_not_grow(self, folder: Path) -> None:
        def small_files() -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_DFL)  # Python ignores it, and its children would, too
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

        result = subprocess.run(
            [RAYTRACE, "scene.txt"],
            cwd=folder,
            capture_output=True,
            env={},
            check=False,
            preexec_fn=small_files,
        )
        assert outcome(result) == error(f"error: cannot write '{folder / 'image.ppm'}': File too large\n")
        assert names(folder) == set()

    def test_an_image_that_no_disk_holds(self, folder: Path) -> None:
        result = raytrace("-", "--no-limits", folder=folder, stdin=EMPTY.format(1 << 30, 1 << 29).encode())
        text = result.stderr.decode()
        assert (result.returncode, result.stdout) == (2, b"")
        assert text.startswith(f"error: the image needs {(3 << 59) + 28} bytes, but the disk has room for ")
        assert text.endswith("\n  hint: lower RES, or write to another disk or a pipe with -o\n")
        result = raytrace("-", "--no-limits", "-o-", folder=folder, stdin=EMPTY.format(1 << 31, 1 << 31).encode())
        assert outcome(result) == error(
            "error: an image of 2147483648 x 2147483648 pixels is larger than any file can be\n  hint: lower RES\n"
        )
        assert names(folder) == set()


def peak_memory(folder: Path, size: int) -> int:
    """Bytes that a run had resident at most when it is about to write the end of the image.

    Not what wait4 says: that counts the memory of the process that started the program as well.
    """
    (folder / "large.txt").write_text(EMPTY.format(size, size))
    with started([RAYTRACE, "large.txt", "-o", "-"], cwd=folder, stdout=subprocess.PIPE, env={}) as program:
        assert program.stdout is not None
        left = len(f"P6\n{size} {size}\n255\n") + 3 * size**2
        while left > 1 << 20:  # more than a pipe holds, so that the program still waits for us
            left -= len(os.read(program.stdout.fileno(), 1 << 16))
        status = Path(f"/proc/{program.pid}/status").read_text()
        assert len(program.communicate(timeout=20)[0]) == left
        assert program.returncode == 0
        return 1024 * int(status.split("VmHWM:")[1].split()[0])


def test_memory_does_not_grow_with_the_image(folder: Path) -> None:
    small, large = (peak_memory(folder, size) for size in (3000, 12000))
    # The larger image is 432 MB; a band of 2^20 pixels has 3 MB.
    assert large < small + (4 << 20)
    assert large < 32 << 20


class TestProgress:
    def on_a_terminal(self, folder: Path, arguments: list[str], interrupt: bool = False) -> tuple[int, str]:
        """The exit status, and what a terminal as stderr shows."""
        controller, terminal = pty.openpty()
        with started([RAYTRACE, *arguments], cwd=folder, stderr=terminal, stdout=subprocess.PIPE, env={}) as program:
            os.close(terminal)
            shown = b""
            while True:
                ready, _, _ = select.select([controller], [], [], 30)
                assert ready
                try:
                    data = os.read(controller, 4096)
                except OSError:  # the other end is closed
                    break
                shown += data
                if interrupt and shown.count(b"rendering") > 2:
                    program.send_signal(signal.SIGINT)
                    interrupt = False
            os.close(controller)
            stdout, _ = program.communicate(timeout=20)
            assert stdout == b""
            return program.returncode, shown.decode()

    def test_after_a_second(self, folder: Path) -> None:
        text = ENDLESS.replace("RES 2000 2000", "RES 100 100")
        for columns in (200, 600, 1800, 5400):  # until it takes long enough on this machine
            (folder / "slow.txt").write_text(text.replace("RES 100", f"RES {columns}"))
            code, shown = self.on_a_terminal(folder, ["slow.txt", *SLOWLY])
            if shown:
                break
        assert code == 0
        parts = shown.split("\r")
        assert parts[0] == ""
        assert len(parts) > 2
        assert parts[-1] == "\x1b[K"
        percents = []
        for part in parts[1:-1]:
            percent, left = part.removeprefix("rendering: ").split(" %, ")
            percents.append(int(percent))
            assert int(left.removesuffix(" s left ")) >= 0
        assert percents == sorted(percents)
        assert percents[-1] <= 100

    def test_not_before(self, folder: Path) -> None:
        assert self.on_a_terminal(folder, ["scene.txt"]) == (0, "")

    def test_gone_before_the_last_words(self, folder: Path) -> None:
        code, shown = self.on_a_terminal(folder, ["endless.txt", *SLOWLY], interrupt=True)
        assert code == 130
        assert shown.endswith(" s left \r\x1b[Kstopped: nothing was written\r\n")

    def test_only_on_a_terminal(self, folder: Path) -> None:
        with started([RAYTRACE, "endless.txt", *SLOWLY], cwd=folder, stderr=subprocess.PIPE, env={}) as program:
            time.sleep(1.3)
            assert program.stderr is not None
            assert select.select([program.stderr], [], [], 0)[0] == []
            program.terminate()
            program.communicate()
