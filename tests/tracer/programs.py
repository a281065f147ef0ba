"""Programs that run beside a test, and never outlive it, and those that are built for a test."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def started(*arguments: Any, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """subprocess.Popen; however the block is left, the program has ended then and its pipes are closed."""
    program = subprocess.Popen(*arguments, **options)
    try:
        yield program
    finally:
        # Left running by a test that failed, a program that takes hours would have the processor for as long.
        program.kill()
        program.wait()
        for stream in (program.stdin, program.stdout, program.stderr):
            if stream is not None:
                stream.close()


def installation(need: Callable[[object, str], None]) -> Path:
    """The folder that the installed extension and raytrace were built in."""
    libraries = sorted(ROOT.glob("build/*/libwhitted_core.a"), key=lambda path: path.stat().st_mtime)
    folders = [path.parent for path in libraries if "SKBUILD:" in (path.parent / "CMakeCache.txt").read_text()]
    need(folders, "the extension was not built here: make install")
    return folders[-1]


def build(folder: Path, *targets: str, need: Callable[[object, str], None], configure: tuple[str, ...] = ()) -> None:
    """Build targets in a folder that is kept, so that only what changed is compiled again; `configure`: anew with."""
    tools = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    cmake, ninja = (shutil.which(tool, path=tools) for tool in ("cmake", "ninja"))
    need(cmake and ninja, "cmake and ninja are not installed: pip install --group dev")
    assert cmake is not None
    commands = [[cmake, "--build", str(folder), "--target", *targets]]
    if configure:
        options = ["--fresh", "-S", str(ROOT), "-B", str(folder), "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={ninja}"]
        commands.insert(0, [cmake, *options, *configure])
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:  # two workers of pytest must not build at once
        fcntl.flock(lock, fcntl.LOCK_EX)
        for command in commands:
            result = subprocess.run(command, capture_output=True, text=True, check=False)
            assert result.returncode == 0, result.stdout + result.stderr
