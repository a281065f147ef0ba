"""The published images of the assignment: every pixel, from the program and from Python, on every instruction set."""

from __future__ import annotations

import os
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tracer
import tracer.reference
from tracer.passes import quantise

NAMES = ("Ambient", "Background", "Diffuse", "Sample", "Shadow", "Specular")
RAYTRACE = Path(sysconfig.get_path("scripts")) / "raytrace"
INSTRUCTION_SETS = ("scalar", "sse2", "avx2", "avx512", "neon")


def key(keys: Path, name: str) -> np.ndarray:
    """The published image."""
    with Image.open(keys / f"key{name}.png") as image:
        return np.asarray(image.convert("RGB"))


def raytrace(scene: Path, *, isa: str | None = None) -> subprocess.CompletedProcess[bytes]:
    """The assignment's program, its image on stdout."""
    environment = {k: v for k, v in os.environ.items() if k != "WHITTED_ISA"}
    if isa:
        environment["WHITTED_ISA"] = isa
    return subprocess.run([RAYTRACE, scene, "-o", "-"], capture_output=True, env=environment, check=False)


def pixels(ppm: bytes) -> np.ndarray:
    """The pixels of a 600x600 PPM."""
    header = b"P6\n600 600\n255\n"
    assert ppm.startswith(header)
    return np.frombuffer(ppm[len(header) :], np.uint8).reshape(600, 600, 3)


@pytest.mark.parametrize("name", NAMES)
def test_the_program_draws_the_key(keys: Path, name: str) -> None:
    done = raytrace(keys / f"test{name}.txt")
    assert (done.returncode, done.stderr) == (0, b"")
    assert np.count_nonzero((pixels(done.stdout) != key(keys, name)).any(axis=-1)) == 0


@pytest.mark.parametrize("name", NAMES)
def test_python_draws_the_key(keys: Path, name: str) -> None:
    image = quantise(tracer.render(tracer.load(keys / f"test{name}.txt"))["beauty"])
    assert np.count_nonzero((image != key(keys, name)).any(axis=-1)) == 0


@pytest.mark.parametrize("name", NAMES)
def test_the_reference_draws_the_key(keys: Path, name: str) -> None:
    image = quantise(tracer.reference.render(tracer.load(keys / f"test{name}.txt"))["beauty"])
    assert np.count_nonzero((image != key(keys, name)).any(axis=-1)) == 0


@pytest.mark.parametrize("isa", INSTRUCTION_SETS)
def test_every_instruction_set_draws_the_same_bytes(keys: Path, isa: str) -> None:
    scenes = [keys / f"test{name}.txt" for name in NAMES]
    first = raytrace(scenes[0], isa=isa)
    if first.returncode == 2:
        # Not this processor's: said so in words, and nothing is drawn.
        assert isa != "scalar"
        assert isa.encode() in first.stderr
        assert first.stdout == b""
        return
    assert first.returncode == 0
    for scene, name in zip(scenes, NAMES, strict=True):
        assert np.array_equal(pixels(raytrace(scene, isa=isa).stdout), key(keys, name))
