"""What tests of several commands share."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import doubles

#: Two renderers that are here always, and agree.
NATIVE = ("--renderer", "native-f64", "--against", "numpy-f64")


def one_pixel(arrays: doubles.Arrays) -> None:
    """Off at one pixel."""
    arrays["beauty"][20, 30, 1] += 0.25


def whitted(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    code = "from validation.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False, timeout=60, **options
    )


def far_away(tmp_path: Path) -> Path:
    """A scene that float32 does not hold."""
    path = tmp_path / "far.txt"
    path.write_text(doubles.CUT.replace("SPHERE shell 0.1 ", "SPHERE shell 1e20 "))
    return path
