"""`whitted compare`: files of passes, images, and what cannot be compared."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Result, strict
from PIL import Image

from tracer.passes import Passes


def test_render_and_compare(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b, c = tmp_path / "a.npz", tmp_path / "b.npz", tmp_path / "c.exr"
    assert run("render", scene, "-o", a) == Result(0, "", "")
    assert run("render", scene, "-o", b, "--threads", "1") == Result(0, "", "")
    assert run("render", scene, "-o", c, "--renderer", "native-f32") == Result(0, "", "")
    stored = Passes.load(a)
    assert len(stored) == 15
    assert stored.metadata["renderer"] == "native-f64"
    assert stored.metadata["command"].startswith("whitted render ")

    equal = run("compare", a, b)
    assert (equal.status, equal.err) == (0, "")
    assert equal.out.count("equal") == 15
    different = run("compare", a, c, "--json", tmp_path / "d.json")
    assert different.status == 1
    assert "DIFFERENT" in different.out
    assert "worst pixel x" in different.out
    record = strict((tmp_path / "d.json").read_text())
    assert record["ok"] is False
    assert len(record["comparisons"]) == 15
    loose = run("compare", a, c, "--passes", "beauty,ambient", "--tolerance", "1e-3")
    assert loose.status == 0
    assert "equal within the tolerance" in loose.out


def test_compare_says_what_only_one_has(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b = tmp_path / "a.npz", tmp_path / "b.npz"
    run("render", scene, "-o", a, "--passes", "beauty,depth")
    run("render", scene, "-o", b, "--passes", "beauty,id")
    result = run("compare", a, b)
    assert result.status == 0
    assert "only in one of the two, not compared: depth, id" in result.out
    missing = run("compare", a, b, "--passes", "depth")
    assert missing.status == 2
    assert f"{b} has no pass 'depth'" in missing.err
    Passes({"id": Passes.load(b)["id"]}).save(b)
    assert run("compare", a, b).status == 2


def test_compare_images(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b, c = tmp_path / "a.png", tmp_path / "b.ppm", tmp_path / "c.png"
    run("render", scene, "-o", a)
    run("render", scene, "-o", b, "--renderer", "numpy-f64")
    run("render", scene, "-o", c, "--sample", "center")
    assert run("compare", a, b).status == 0
    result = run("compare", a, c)
    assert result.status == 1
    assert "beauty" in result.out
    mixed = tmp_path / "a.npz"
    run("render", scene, "-o", mixed)
    assert "the other is an 8-bit image" in run("compare", a, mixed).err


def test_compare_different_sizes(run: Any, scene: Path, tmp_path: Path) -> None:
    a, b = tmp_path / "a.npz", tmp_path / "b.npz"
    run("render", scene, "-o", a, "--passes", "depth")
    run("render", scene, "-o", b, "--passes", "depth", "--size", "8x6")
    result = run("compare", a, b)
    assert result.status == 1
    assert result.out == f"DIFFERENT: {a} is 64x48, {b} is 8x6 pixels: no pixel was compared\n"


@pytest.mark.parametrize("ending", [".npz", ".exr", ".png", ".ppm"])
def test_compare_a_file_that_is_none(run: Any, tmp_path: Path, ending: str) -> None:
    bad = tmp_path / f"bad{ending}"
    bad.write_bytes(b"not this")
    result = run("compare", bad, bad)
    assert result.status == 2
    assert str(bad) in result.err
    assert len(result.err.splitlines()) == 1


def test_compare_takes_families(run: Any, scene: Path, tmp_path: Path) -> None:
    a = tmp_path / "a.npz"
    run("render", scene, "-o", a)
    result = run("compare", a, a, "--passes", "reflection*")
    assert result.status == 0
    assert result.out.count("equal") == 4
    none = run("compare", a, a, "--passes", "margin.*")
    assert (none.status, none.out) == (2, "")


def test_compare_shows_levels_as_integers(run: Any, tmp_path: Path) -> None:
    a, b = tmp_path / "a.png", tmp_path / "b.ppm"
    levels = np.full((2, 3, 3), 40, dtype=np.uint8)
    Image.fromarray(levels).save(a)
    levels[1, 2, 1] = 206
    Image.fromarray(levels).save(b)
    result = run("compare", a, b)
    assert result.status == 1
    assert " 166 " in result.out
    assert "worst pixel x 2, y 1 G: 40 and 206" in result.out


def ppm(path: Path, levels: Any, maximum: int) -> Path:
    """A file of two bytes a sample, the higher one first."""
    rows, columns, _ = np.shape(levels)
    path.write_bytes(f"P6 # a comment\n{columns} {rows}\n{maximum}\n".encode() + np.asarray(levels, ">u2").tobytes())
    return path


def test_compare_reads_all_of_16_bits(run: Any, tmp_path: Path) -> None:
    """Levels whose higher bytes are equal, and whose lower ones would be lost in 8 bits."""
    levels = np.full((2, 3, 3), 0x1234)
    a, same = ppm(tmp_path / "a.ppm", levels, 65535), ppm(tmp_path / "same.ppm", levels, 65535)
    levels[1, 2, 1] = 0x1201
    b = ppm(tmp_path / "b.ppm", levels, 65535)
    assert run("compare", a, same).status == 0
    result = run("compare", a, b, "--json", tmp_path / "d.json")
    assert result.status == 1
    assert f"worst pixel x 2, y 1 G: {0x1234} and {0x1201}" in result.out
    assert strict((tmp_path / "d.json").read_text())["comparisons"][0]["max"] == 0x33
    assert run("compare", a, b, "--tolerance", 0x33).status == 0


def test_compare_levels_of_two_kinds(run: Any, tmp_path: Path) -> None:
    levels = np.full((2, 3, 3), 100)
    a, b = ppm(tmp_path / "a.ppm", levels, 65535), ppm(tmp_path / "b.ppm", levels, 1023)
    Image.fromarray(levels.astype(np.uint8)).save(tmp_path / "c.png")
    for other, most in ((b, 1023), (tmp_path / "c.png", 255)):
        result = run("compare", a, other)
        assert (result.status, result.out) == (2, "")
        assert f"{a} has levels from 0 to 65535, {other} from 0 to {most}: they cannot be compared\n" in result.err
    Passes({"beauty": levels.astype(np.float64)}).save(tmp_path / "d.npz")
    assert "the other is an image of levels up to 65535\n" in run("compare", a, tmp_path / "d.npz").err


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"P6 2 1 65535\n" + bytes(11), "it ends after pixel 1 of 2"),
        (b"P6 1 1 65536\n" + bytes(6), "the maximum in its header is 65536, expected 1 to 65535"),
        (b"P3 99999999 99999999 65535 1 2 3", "it is too short for 99999999x99999999 pixels"),
        (b"P5 1 1 65535\n" + bytes(2), "it is PGM (P2 or P5, grey), expected PPM"),
    ],
)
def test_compare_a_deep_image_that_is_wrong(data: bytes, error: str, run: Any, tmp_path: Path) -> None:
    deep = tmp_path / "deep.ppm"
    deep.write_bytes(data)
    result = run("compare", deep, deep)
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith(f"error: {deep}: {error}\n")


def test_compare_does_not_reduce_a_png_of_16_bits(run: Any, tmp_path: Path) -> None:
    header = struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)
    png = tmp_path / "deep.png"
    png.write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + header)
    result = run("compare", png, png)
    assert (result.status, result.out) == (2, "")
    assert f"{png}: an image of 16 bits a channel, expected 8" in result.err
