"""The gallery is drawn with the same bytes as ever, here as everywhere."""

from __future__ import annotations

import subprocess
from pathlib import Path

import golden
import pytest

HINT = "if that is meant to be: .venv/bin/python tests/golden.py --write, and say in the commit why bits change"


def test_the_bytes_of_the_gallery() -> None:
    found = golden.digests()
    scenes = len(list((golden.ROOT / "scenes" / "gallery").glob("*.txt")))
    assert len(found) == 2 * 4 * scenes
    differing = golden.differing(found)
    assert not differing, f"{len(differing)} of {len(found)} differ from tests/golden.sha256; {HINT}"


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_file_and_a_pipe_get_the_same_bytes(precision: str, tmp_path: Path) -> None:
    """Written by all threads anywhere, and in order by one."""
    for path in sorted((golden.ROOT / "scenes" / "gallery").glob("*.txt")):
        command: list[str | Path] = [golden.RAYTRACE, path, "--precision", precision, "--threads=3"]
        pipe = subprocess.run([*command, "-o-"], check=True, capture_output=True).stdout
        subprocess.run([*command, "-o", tmp_path / "image.ppm"], check=True)
        assert (tmp_path / "image.ppm").read_bytes() == pipe, path.stem
