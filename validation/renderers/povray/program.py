"""Runs POV-Ray's own program, several pictures at a time, and reads its 16-bit images."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from converters.povray import STEPS, command

PROGRAM = command((1, 1))[0]
#: How its versions begin whose epsilons we know.
KNOWN = "3.7."
#: What it says when it goes wrong, of many lines.
TROUBLE = re.compile(r"error|cannot|failed|not permitted|fatal|denied|out of memory", re.IGNORECASE)
#: Warnings that are there when nothing is wrong.
USUAL = re.compile(r"configuration file|I/O restrictions", re.IGNORECASE)

#: Of a second that a small picture takes, POV-Ray sleeps nearly all: so many pictures keep a core at work.
IDLE = 4

Image: TypeAlias = NDArray[np.uint16]


class PovrayError(RuntimeError):
    """POV-Ray did not make a picture: one sentence, and what it said itself."""


@functools.cache
def _asked(path: str) -> str:
    try:
        done = subprocess.run([path, "--version"], capture_output=True, timeout=30, check=False, text=True)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"unknown ({error})"
    found = re.search(r"POV-Ray (\S+)", done.stdout + done.stderr)
    return found[1] if found else "unknown"


def version() -> str | None:
    """The version of the program on the search path; None: there is none."""
    path = shutil.which(PROGRAM)
    return _asked(path) if path else None


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Runs:
    """The programs that run for one call; when it ends, for whatever reason, none of them runs on."""

    def __init__(self, seconds: float) -> None:
        """`seconds`: how long one picture may take."""
        self.seconds = seconds
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock, self._ended = threading.Lock(), False

    def end(self) -> None:
        """Kill what runs, and start nothing more."""
        with self._lock:
            self._ended = True
            for process in self._running:
                _kill(process)

    @contextlib.contextmanager
    def _started(self, words: list[str], folder: Path, said: Path) -> Iterator[subprocess.Popen[bytes]]:
        # Nothing of the user's settings: they could change the size, the quality or the gamma.
        settings = folder / ".povray" / "3.7"
        settings.mkdir(parents=True)
        for name in ("povray.ini", "povray.conf"):
            (settings / name).touch()
        environment = {name: value for name, value in os.environ.items() if not name.startswith("POV")}
        environment |= {"HOME": str(folder), "POVINI": str(settings / "povray.ini"), "LC_ALL": "C"}
        with said.open("wb") as output:
            with self._lock:
                if self._ended:
                    raise PovrayError("POV-Ray was not started: another picture failed")
                process = subprocess.Popen(
                    words,
                    cwd=folder,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=output,
                    start_new_session=True,
                )
                self._running.add(process)
            try:
                yield process
            finally:
                _kill(process)
                process.wait()
                with self._lock:
                    self._running.discard(process)

    def draw(self, text: str, size: tuple[int, int], threads: int) -> Image:
        """The picture of one text, (rows, columns, 3).

        Raises:
            PovrayError: there is none, with what POV-Ray says.
        """
        columns, rows = size
        with tempfile.TemporaryDirectory(prefix="whitted-povray-") as name:
            folder = Path(name)
            (folder / "scene.pov").write_text(text, encoding="ascii")
            said = folder / "said.txt"
            try:
                with self._started([*command(size), f"+WT{threads}"], folder, said) as process:
                    status = process.wait(self.seconds)
            except subprocess.TimeoutExpired:
                raise PovrayError(
                    f"POV-Ray took more than {self.seconds:g} s for a picture of {columns}x{rows} and was ended"
                ) from None
            except OSError as error:
                raise PovrayError(f"POV-Ray could not be started: {error}") from error
            if status:
                how = f"ended with exit status {status}" if status > 0 else f"was killed by signal {-status}"
                raise PovrayError(f"POV-Ray {how}{_trouble(said)}")
            image = folder / "scene.ppm"
            if not image.is_file():
                raise PovrayError(f"POV-Ray wrote no image{_trouble(said)}")
            return read_ppm(image.read_bytes(), size)


def _kill(process: subprocess.Popen[bytes]) -> None:
    """With everything that it started. A process that was waited for has a number that may be another's."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)


def _trouble(said: Path) -> str:
    lines = said.read_text(encoding="utf-8", errors="replace").splitlines()
    lines = [line.strip() for line in lines if line.strip() and not USUAL.search(line)]
    telling = [line for line in lines if TROUBLE.search(line)] or lines[-3:]
    return "".join(f"\n    {line}" for line in telling[:8])


class _ToldToEndError(BaseException):
    """A signal whose default is the end of this process."""


@contextlib.contextmanager
def _told_to_end() -> Iterator[None]:
    """Such a signal ends this process as it would, but after what runs for it and its folders are gone."""
    told: list[int] = []

    def tell(number: int, _: object) -> None:
        told.append(number)
        raise _ToldToEndError

    signals = [signal.SIGTERM, signal.SIGHUP] if threading.current_thread() is threading.main_thread() else []
    # Whoever handles them already sees to it that this ends.
    ours = [number for number in signals if signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, tell)
    try:
        yield
    except _ToldToEndError:
        pass
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)
    if told:
        os.kill(os.getpid(), told[0])


def draw(texts: Iterable[str], size: tuple[int, int], *, threads: int = 0, seconds: float = 600.0) -> dict[str, Image]:
    """The picture of each text; `threads`: at most so many at work together, 0: what is quickest.

    Raises:
        PovrayError: one of them could not be drawn; the others are ended.
    """
    wanted = list(dict.fromkeys(texts))
    if not wanted:
        return {}
    together = min(threads or IDLE * cores(), len(wanted))
    each = max(1, (threads or cores()) // together)
    runs = Runs(seconds)
    with _told_to_end(), ThreadPoolExecutor(together) as pool:
        try:
            tasks = {text: pool.submit(runs.draw, text, size, each) for text in wanted}
            done, _ = wait(tasks.values(), return_when=FIRST_EXCEPTION)
            for task in done:
                task.result()
            return {text: task.result() for text, task in tasks.items()}
        except BaseException:
            runs.end()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def read_ppm(data: bytes, size: tuple[int, int]) -> Image:
    """A binary PPM of 16 bits, (rows, columns, 3).

    Raises:
        PovrayError: it is none, or has another size.
    """
    header = re.match(rb"P6\s+(?:#[^\n]*\n\s*)*(\d+)\s+(?:#[^\n]*\n\s*)*(\d+)\s+(?:#[^\n]*\n\s*)*(\d+)\s", data)
    if not header:
        raise PovrayError("POV-Ray wrote an image that is no binary PPM")
    columns, rows, steps = map(int, header.groups())
    if steps != STEPS:
        raise PovrayError(f"POV-Ray wrote an image of {steps + 1} levels, expected {STEPS + 1}")
    if (columns, rows) != size:
        raise PovrayError(f"POV-Ray wrote an image of {columns}x{rows}, expected {size[0]}x{size[1]}")
    content = data[header.end() :]
    if len(content) != 6 * columns * rows:
        raise PovrayError(f"POV-Ray wrote {len(content)} bytes of pixels, expected {6 * columns * rows}")
    return np.frombuffer(content, ">u2").reshape(rows, columns, 3).astype(np.uint16)
