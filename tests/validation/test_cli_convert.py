"""`whitted convert`: what is written, and what it refuses."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import Result


@pytest.mark.mitsuba
def test_convert(run: Any, scene: Path, tmp_path: Path, need: Any) -> None:
    need(importlib.util.find_spec("mitsuba"), "no Mitsuba: pip install mitsuba")
    xml = tmp_path / "out.xml"
    assert run("convert", scene, "--to", "mitsuba", "-o", xml) == Result(0, "", "")
    assert "<scene" in xml.read_text()
    xml.unlink()
    refused = run("convert", scene, "--to", "mitsuba", "-o", xml, "--stock-only")
    assert refused.status == 2
    assert "stock Mitsuba cannot say this scene" in refused.err
    assert "hint: without --stock-only" in refused.err
    no_light = run("convert", scene, "--to", "mitsuba", "-o", xml, "--light", "2")
    assert (no_light.status, "has no light 2" in no_light.err) == (2, True)
    assert not xml.exists()


def test_standard_output_goes_on_where_it_is(scene: Path, tmp_path: Path) -> None:
    """A log is neither replaced nor written over; a pipe has no end to go to."""
    log = tmp_path / "log"
    log.write_text("before\n")
    words = f"{shlex.quote(sys.executable)} -m validation convert {shlex.quote(str(scene))} --to povray -o /dev/stdout"
    for redirected in (f">>{log}", f">>{log}", f"| cat >>{log}"):
        subprocess.run(f"{words} {redirected}", shell=True, check=True, timeout=60)
    subprocess.run(f"({words}; echo after) >{tmp_path / 'new'}", shell=True, check=True, timeout=60)
    text = log.read_text()
    assert text.startswith("before\n// ")
    assert text.count("#version") == 3
    assert (tmp_path / "new").read_text().endswith("after\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full.txt", "log", "new"]


@pytest.mark.mitsuba
def test_convert_names_its_own_options(run: Any, scene: Path, tmp_path: Path, need: Any) -> None:
    need(importlib.util.find_spec("mitsuba"), "no Mitsuba: pip install mitsuba")
    result = run("convert", scene, "--to", "mitsuba", "-o", tmp_path / "x.xml", "--stock-only")
    assert "--light INDEX" in result.err
    assert "light=" not in result.err
