"""The same bits in every way to draw: bits.cpp draws the scenes of the project and random ones in all of them."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from programs import ROOT, build, installation


@pytest.fixture(scope="module")
def bits(need: Callable[[object, str], None]) -> Path:
    """The program, linked with what the extension was linked with."""
    folder = installation(need)
    build(folder, "bits", need=need)
    return folder / "bits"


def run(*arguments: str | Path) -> str:
    result = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, ""), result.stdout[-3000:] + result.stderr
    return result.stdout


def counts(out: str) -> tuple[int, int]:
    """How many images were drawn, of how many scenes in a precision."""
    images, _, _, scenes, *_ = out.split()
    return int(images), int(scenes)


@pytest.mark.parametrize("folder", ["gallery", "hard", "spec"])
def test_the_scenes_of_the_project(bits: Path, folder: str) -> None:
    """All passes, in both precisions: every instruction set, 1, 2, 3 and 7 threads, several bands and pieces."""
    scenes = sorted((ROOT / "scenes" / folder).glob("*.txt"))
    images, count = counts(run(bits, *scenes))
    assert count >= 2 * len(scenes) - 2  # float32 cannot carry all
    assert images >= 2 * 17 * 3 * count  # instruction sets, divisions of the image, groups of passes


def test_random_scenes(bits: Path) -> None:
    """By hand, after a change of the kernels or of what they leave out: `build/*/bits random 0 30000`."""
    assert counts(run(bits, "random", "0", "300"))[1] > 500
