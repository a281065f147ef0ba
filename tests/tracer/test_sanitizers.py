"""raytrace built with the address and undefined behaviour sanitizers: good scenes, broken ones, extreme ones."""

from __future__ import annotations

import random
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import strategies
from hypothesis import HealthCheck, given, settings
from programs import build, started

from tracer import Scene

ROOT = Path(__file__).resolve().parents[2]
SCENES = sorted(ROOT.glob("scenes/*/*.txt"))
ISAS = ("scalar", "sse2", "avx2", "avx512", "neon")
QUIET = {"ASAN_OPTIONS": "detect_leaks=1", "UBSAN_OPTIONS": "print_stacktrace=1"}

Run = Callable[..., subprocess.CompletedProcess[bytes]]


@pytest.fixture(scope="module")
def program(need: Callable[[object, str], None]) -> Path:
    """The program, built into a folder that is kept, so that only what changed is compiled again."""
    folder = ROOT / "build" / "sanitize"
    build(folder, "raytrace", need=need, configure=("-DWHITTED_PYTHON=OFF", "-DWHITTED_SANITIZE=address,undefined"))
    return folder / "raytrace"


@pytest.fixture(scope="module")
def run(program: Path) -> Run:
    """Runs the program, which has to end with 0 or 2 and without a word of a sanitizer."""

    def checked(*arguments: str | Path, stdin: bytes = b"", **environment: str) -> subprocess.CompletedProcess[bytes]:
        result = subprocess.run(
            [program, *arguments],
            input=stdin,
            capture_output=True,
            env=QUIET | environment,
            timeout=120,
            check=False,
        )
        assert result.returncode in (0, 2), (stdin, result.stderr.decode(errors="replace"))
        assert b"Sanitizer" not in result.stderr, result.stderr.decode(errors="replace")
        assert b"runtime error" not in result.stderr, result.stderr.decode(errors="replace")
        assert (result.returncode == 2) == (b"error: " in result.stderr)
        return result

    return checked


@pytest.fixture(scope="module")
def isas(run: Run) -> list[str]:
    """The instruction sets of this machine."""
    return [isa for isa in ISAS if run("--version", WHITTED_ISA=isa).returncode == 0]


def small(text: bytes, columns: int = 23, rows: int = 17) -> bytes:
    return re.sub(rb"((?:^|[\r\n])[ \t]*RES)[^\r\n]*", rb"\1 %d %d" % (columns, rows), text)


def test_the_sanitizers_are_there(program: Path) -> None:
    """Without them every other test here would pass as well."""
    names = subprocess.run(["ldd", program], capture_output=True, text=True, check=True).stdout
    assert "libasan" in names
    assert "libubsan" in names


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_scene(path: Path, run: Run, isas: list[str]) -> None:
    text = small(path.read_bytes())
    for k, isa in enumerate(isas):
        precision = "f64" if (k + SCENES.index(path)) % 2 else "f32"
        image = run("-", "-o-", "--threads=2", f"--precision={precision}", stdin=text, WHITTED_ISA=isa).stdout
        assert len(image) == len(b"P6\n23 17\n255\n") + 3 * 23 * 17


TOKENS = (
    *(b"NEAR", b"RES", b"SPHERE", b"LIGHT", b"OUTPUT", b"SPHRE", b"1e308", b"1e400", b"-1e-400", b"nan", b"inf", b"-0"),
    *(b"0x1p3", b"\xff\xfe", b"\x00", b"\r", b"\n\n", b"\t", b"9" * 400, b"a" * 300, b".", b"1e", b"+", b"\xc3\xa9"),
    *(b"-", b"1.5x", b"18446744073709551616", b"0." + b"0" * 400 + b"1", b" " * 70000),
)


def mutated(text: bytes, generator: random.Random) -> bytes:
    """One to six changes to a scene: bytes, tokens, lines, its end."""
    for _ in range(generator.choice((1, 1, 1, 2, 6))):
        at = generator.randrange(len(text) + 1)
        lines = text.split(b"\n")
        match generator.randrange(7):
            case 0:
                text = text[:at] + generator.randbytes(1) + text[at + 1 :]
            case 1:
                text = text[:at] + text[at + generator.randint(1, 8) :]
            case 2:
                text = text[:at] + generator.choice(TOKENS) + text[at:]
            case 3:
                text = text[:at]
            case 4:
                text = b"\n".join([*lines, generator.choice(lines)])
            case 5:
                generator.shuffle(lines)
                text = b"\n".join(lines)
            case _:
                words = text.split(b" ")
                words[generator.randrange(len(words))] = generator.choice(TOKENS)
                text = b" ".join(words)
    return text


def harmless(text: bytes) -> bool:
    """Whether no line could ask for an image that takes long."""
    return all(
        int(columns) * int(rows) < 20000 for columns, rows in re.findall(rb"RES[ \t]+\+?(\d+)[ \t]+\+?(\d+)", text)
    )


@pytest.mark.parametrize("seed", range(15))
def test_mutated_scenes(seed: int, run: Run, isas: list[str]) -> None:
    generator = random.Random(seed)
    statuses: list[int] = []
    while len(statuses) < 20:
        text = mutated(small(generator.choice(SCENES).read_bytes(), 9, 5), generator)
        if harmless(text):
            limits = ["--no-limits"] if generator.random() < 0.3 else []
            options = [f"--precision={generator.choice(('f64', 'f32'))}", "--threads=1", *limits]
            isa = generator.choice(isas)
            statuses.append(run("-", "-o/dev/null", *options, stdin=text, WHITTED_ISA=isa).returncode)
    assert 2 in statuses


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(scene=strategies.scenes(extreme=True, max_size=7))
def test_extreme_scenes(scene: Scene, run: Run, isas: list[str]) -> None:
    for k, precision in enumerate(("f64", "f32")):
        options = ("-o/dev/null", "--no-limits", "--threads=1", f"--precision={precision}")
        result = run("-", *options, stdin=scene.text().encode(), WHITTED_ISA=isas[(len(scene.spheres) + k) % len(isas)])
        assert precision == "f32" or result.returncode == 0


def test_the_command_line(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (
        *([], [""], ["-"], ["--"], ["--help"], ["--version"], ["-o"], ["-x"], ["--" + "x" * 5000], ["=", "="]),
        *(["--threads=" + "9" * 500, "-"], ["--shadow-epsilon=" + "0" * 5000, "-"], ["a" * 5000], ["/"], ["-o-", "-"]),
        *(["-", "-o", "/"], ["-", "-o", "no/such/folder"], ["-", "-o", "/dev/full"], ["-", f"-o{tmp_path}/x.ppm"]),
    ):
        run(*arguments, stdin=small(SCENES[0].read_bytes()))
    assert {path.name for path in tmp_path.iterdir()} == {"x.ppm", f"{SCENES[0].stem}.ppm"}


@pytest.mark.parametrize("threads", [1, 3])
def test_many_bounces_samples_and_a_signal(program: Path, run: Run, threads: int, tmp_path: Path) -> None:
    scene = next(path for path in SCENES if path.stem == "mirror-corridor").read_bytes()
    for sample in ("corner", "center", "bottom-left", "top-right", "inclusive"):
        run("-", "-o-", f"--sample={sample}", "--max-reflections=1000", f"--threads={threads}", stdin=small(scene))
    path = tmp_path / "scene.txt"
    path.write_bytes(small(scene, 9000, 9000))
    with started(
        [program, path, "-o", tmp_path / "x.ppm", f"--threads={threads}"], stderr=subprocess.PIPE, env=QUIET
    ) as process:
        while len(list(tmp_path.iterdir())) < 2:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        _, stderr = process.communicate(timeout=60)
        assert (process.returncode, stderr) == (143, b"stopped: nothing was written\n")
        assert list(tmp_path.iterdir()) == [path]
