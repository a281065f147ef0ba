"""raytrace on a processor without AVX, which is emulated: it starts, takes SSE2, and draws the same bytes."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from programs import ROOT

RAYTRACE = Path(sys.executable).parent / "raytrace"
SCENES = ("gallery/mirrors", "gallery/full", "gallery/plates", "spec/exponent-half", "hard/tangents-at-once")

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="raytrace is not made for an x86-64 here")

Run = Callable[..., subprocess.CompletedProcess[bytes]]


@pytest.fixture(scope="module")
def emulated(need: Callable[[object, str], None]) -> Run:
    """Runs the program on an x86-64 processor of 2003 with no more than SSE3, or on the one that is named."""
    need(shutil.which("qemu-x86_64"), "qemu-x86_64 is not installed: apt-get install qemu-user")

    def run(
        *arguments: str, stdin: bytes = b"", cpu: str = "qemu64", **environment: str
    ) -> subprocess.CompletedProcess[bytes]:
        command = ["qemu-x86_64", "-cpu", cpu, str(RAYTRACE), *arguments]
        qemu = {"PATH": str(Path(shutil.which("qemu-x86_64") or "").parent)}
        return subprocess.run(command, input=stdin, capture_output=True, env=qemu | environment, check=False)

    return run


@pytest.mark.parametrize("cpu", ["qemu64", "Nehalem"])
def test_it_takes_sse2(emulated: Run, cpu: str) -> None:
    result = emulated("--version", cpu=cpu)
    assert (result.returncode, result.stderr) == (0, b"")
    assert re.fullmatch(rb"raytrace \S+ \(sse2, .+\)\n", result.stdout)


@pytest.mark.parametrize("isa", ["avx2", "avx512"])
@pytest.mark.parametrize("argument", ["--version", "-"])
def test_what_it_lacks_is_an_error(emulated: Run, isa: str, argument: str) -> None:
    result = emulated(argument, stdin=b"NEAR 1\n", WHITTED_ISA=isa)
    assert (result.returncode, result.stdout, result.stderr.decode()) == (
        2,
        b"",
        f"error: WHITTED_ISA asks for '{isa}', which this processor lacks\n"
        "  hint: unset WHITTED_ISA to use the best one\n",
    )


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("name", SCENES)
def test_the_same_bytes(emulated: Run, name: str, precision: str) -> None:
    scene = re.sub(rb"(?m)^RES .*", b"RES 131 67", (ROOT / "scenes" / f"{name}.txt").read_bytes())
    arguments = ("-", "-o-", "--precision", precision)
    native = subprocess.run([RAYTRACE, *arguments], input=scene, capture_output=True, check=True).stdout
    assert native.startswith(b"P6\n131 67\n255\n")
    for isa in ("", "scalar"):  # empty: the best that there is
        result = emulated(*arguments, stdin=scene, WHITTED_ISA=isa)
        assert (result.returncode, result.stderr) == (0, b"")
        assert result.stdout == native
