"""Programs that run beside a test, and never outlive it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


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
