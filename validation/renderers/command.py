"""Any program that reads a scene file and writes an image, as a renderer: `cmd:./mine {scene}`.

No sandbox: the program runs as the user, with all that the user may read, write and reach. The limits below are against
mistakes, such as an endless loop or a leak, not against malice. What it moves to a session of its own goes on running.

The words of the command are split as a shell does, but no shell runs: no variables, no pipes. `{scene}` stands for the
path of the scene file, `{output}` for the path where the image is wanted. The program runs in a temporary folder of its
own; so the program, if its name has a slash, and every word that names a file or folder from where the user is, are
made absolute, `~/` included. Its image is taken from `{output}`; without that from the file in that folder that the
scene's OUTPUT names, else from stdout. PPM and PNG are read. Its environment is the user's; its stdin is empty.

Sample place, shadow epsilon and number of reflections cannot be told to the program: it draws as it draws.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import resource
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tracer.passes import Passes
from validation import images
from validation.encoding import Encoding
from validation.processes import deferred, end, ends
from validation.renderers import RendererNameError, Settings, Uncertainty, floats
from validation.run import RendererError

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis

PREFIX = "cmd:"
SCENE, OUTPUT = "{scene}", "{output}"
SCENE_FILE = "scene.txt"

MEBIBYTE = 1 << 20
#: A file may have so many bytes a pixel: several times what a PPM of 16 bits as text takes.
BYTES_A_PIXEL = 64
LEAST_FILE = 64 * MEBIBYTE

#: How much is told of what a program wrote: lines of stderr, their length, all of them; names of files.
MOST_LINES, LONGEST_LINE, MOST_BYTES, MOST_FILES = 8, 200, 1 << 14, 10

#: A process can set its limits only itself, and our own has threads, which nothing but exec may follow: so this small
#: program does both. What keeps it from starting the other one goes into a file.
LAUNCHER = """
import os, resource, signal, sys
memory, size, report, *words = sys.argv[1:]
for kind, most in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_FSIZE, size), (resource.RLIMIT_CORE, 0)):
    hard = resource.getrlimit(kind)[1]
    most = int(most) if hard == resource.RLIM_INFINITY else min(int(most), hard)
    resource.setrlimit(kind, (most, most))
for number in (signal.SIGPIPE, signal.SIGXFSZ):
    signal.signal(number, signal.SIG_DFL)
try:
    os.execv(words[0], words)
except OSError as error:
    with open(report, "w") as file:
        file.write(str(error.errno))
    os._exit(127)
"""

#: What programs say on stderr when memory has run out, and when a file grew too large.
NO_MEMORY = re.compile(
    rb"bad_alloc|bad_array_new|MemoryError|[Oo]ut of memory|annot allocate|ailed to allocate|ulimit -v|OutOfMemory"
)
FILE_TOO_LARGE = os.strerror(errno.EFBIG).encode()


CRASHES = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGTRAP, signal.SIGSYS)


#: What only a shell understands.
SHELL = ("|", "||", "&&", "&", ";", ">", ">>", "<", "2>", "2>&1")


class TemplateError(RendererNameError):
    """A command that cannot be one."""

    def __init__(self, message: str, hint: str) -> None:
        """Both are shown."""
        super().__init__(message)
        self.hint = hint


class WholeImageError(RendererError):
    """The program did not end well, though its image is whole: `ending` is a clause, `image` what was drawn."""

    def __init__(self, message: str, ending: str, image: Passes) -> None:
        super().__init__(message)
        self.ending, self.image = ending, image


@dataclass(frozen=True)
class Limits:
    """What the program may use. `memory`: bytes of address space; `file`: bytes of any file, None: by the image."""

    seconds: float = 60.0
    memory: int = 4096 * MEBIBYTE
    file: int | None = None

    def size(self, scene: Scene) -> int:
        """Bytes of the largest file that it may write."""
        return self.file or max(LEAST_FILE, BYTES_A_PIXEL * scene.view.columns * scene.view.rows)


class Command:
    """Any program behind the face of a renderer: it draws `beauty`, in the levels of an image file."""

    precision = "8-bit"

    def __init__(self, name: str, limits: Limits | None = None) -> None:
        """`name` is `cmd:` and the command.

        Raises:
            TemplateError: the command has no program or no {scene}, or an unknown placeholder, or a quote is open.
        """
        self.name = name
        self.template = name.removeprefix(PREFIX).strip()
        self.limits = limits or Limits()
        #: How its levels stand for colours, as the specification has it; how many there are is said with the passes.
        self.encoding = Encoding("truncate", 255)
        #: Whether the first row of its images is the lowest.
        self.flipped = False
        self._words = _split(self.template)
        self._folder = Path.cwd()

    def version(self) -> str:
        """The beginning of its file's SHA-256: nothing else is known about it."""
        return self.versions().get("sha256", "unknown")

    def versions(self) -> Mapping[str, str]:
        """The command, and the files that it names: the program itself, and what an interpreter is given."""
        found = {"command": self.template}
        places = [("sha256", self._program())] + [(f"sha256 of {word}", self._place(word)) for word in self._words[1:]]
        for key, path in places:
            # One that may be run cannot always be read.
            with suppress(OSError):
                if path and path.is_file():
                    with path.open("rb") as file:
                        found[key] = hashlib.file_digest(file, "sha256").hexdigest()[:16]
        return found

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """An image is all that is known of it."""
        del scene, settings
        return ("beauty",)

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """Any size: nothing is known about its speed but the limit of time."""
        del scene, passes
        return None

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """That of a careful program in float32; what a level stands for is known to the comparison."""
        del analysis
        return floats.uncertainty("f32", scene, settings)

    def sources(self, scene: Scene, settings: Settings) -> Mapping[str, str]:
        """The program draws all by itself."""
        del scene, settings
        return {"beauty": "stock"}

    def unavailable(self) -> str | None:
        """Why there is no such program, or it cannot be run."""
        word, path = self._words[0], self._program()
        if path is None:
            here = f": ./{word} is the one in this folder" if self._place(word) else ""
            return f"there is no program '{word}' on the PATH{here}"
        if not _exists(path):
            where = "" if Path(_expanded(word)).is_absolute() else f" in {self._folder}"
            return f"there is no program '{word}'{where}"
        if path.is_dir():
            return f"'{word}' is a folder, not a program"
        return None if os.access(path, os.X_OK) else f"'{word}' is not executable: chmod +x {shlex.quote(word)}"

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """The image that the program writes, as levels over the largest level.

        Raises:
            RendererError: the program did anything else than writing one right image and ending well.
        """
        del settings
        if unknown := [name for name in passes if name != "beauty"]:
            raise RendererError(f"it draws the image alone, no pass '{unknown[0]}'")
        if reason := self.unavailable():
            raise RendererError(f"cannot be started: {reason}")
        with _temporary() as folder:
            return self._draw(scene, folder, passes)

    def _draw(self, scene: Scene, folder: Path, passes: Sequence[str]) -> Passes:
        """Run the program below that folder, and read its image."""
        # What is ours stands beside the folder of the program, out of its way.
        work = folder / "work"
        work.mkdir()
        output = work / _output_name(scene)
        (work / SCENE_FILE).write_bytes(scene.replace(output=output.name).text().encode())
        words = [str(self._program())]
        for word in self._words[1:]:
            place = self._place(word)
            words.append(
                str(place) if place else word.replace(SCENE, str(work / SCENE_FILE)).replace(OUTPUT, str(output))
            )
        size = self.limits.size(scene)
        end = _run(words, folder, self.limits, size)
        finding, drawn, ending = _start(folder) or _too_much(end, folder, size), None, ""
        if finding is None:
            finding = _ending(end, folder, self.limits)
            named = any(OUTPUT in word for word in self._words)
            try:
                image = _image(folder, output, named, (scene.view.columns, scene.view.rows), size)
            except _FindingError as error:
                finding = finding or error
            else:
                beauty = (image.levels[::-1] if self.flipped else image.levels) / np.float64(image.steps)
                told = {"renderer": self.name, "levels": str(image.steps), **self.versions()}
                drawn = Passes(dict.fromkeys(passes, beauty), told)
                if finding is None:
                    return drawn
                ending = str(finding)
                finding = _FindingError(f"{finding}, though its image is whole", finding.hint)
        lines = "".join(f"\n  stderr: {line}" for line in _last_lines(folder))
        message = f"{finding}{lines}" + (f"\n  hint: {finding.hint}" if finding.hint else "")
        raise WholeImageError(message, ending, drawn) if drawn else RendererError(message)

    def _program(self) -> Path | None:
        """Where the program is, or would be; None where it is looked for on the PATH and is not there."""
        word = _expanded(self._words[0])
        found = word if "/" in word else shutil.which(word)
        return self._folder / found if found else None

    def _place(self, word: str) -> Path | None:
        """The file or folder that a word names from where the user is."""
        path = self._folder / _expanded(word)
        return path if word and _exists(path) else None


def _expanded(word: str) -> str:
    """A word with the user's home for `~`."""
    return os.path.expanduser(word)  # noqa: PTH111 - a Path loses the ./ of a program, and may raise


def _exists(path: Path) -> bool:
    """Whether there is such a file or folder; what is too long for a name is none."""
    try:
        return path.exists()
    except OSError:
        return False


def _split(template: str) -> list[str]:
    """The words of a command.

    Raises:
        TemplateError: there is something wrong with it.
    """
    example = "for example 'cmd:./mine {scene}'"
    try:
        words = shlex.split(template)
    except ValueError as error:
        reason = str(error).lower()
        raise TemplateError(f"the command {template!r} cannot be split: {reason}", "quotes come in pairs") from error
    if not words or not words[0]:
        raise TemplateError("the command is empty", example)
    if "\0" in template:
        raise TemplateError("the command holds a zero byte", example)
    for found in re.findall(r"\{[^{}]*\}", " ".join(words)):
        if found not in (SCENE, OUTPUT):
            hint = f"the placeholders are {SCENE}, the scene file, and {OUTPUT}, the image"
            raise TemplateError(f"unknown placeholder '{found}' in the command", hint)
    # In quotes they are words like others.
    bare = re.sub(r"""'[^']*'|"(?:\\.|[^"\\])*\"""", "quoted", template).split()
    if shell := next((word for word in bare if word in SHELL or word.endswith(";")), ""):
        raise TemplateError(f"'{shell}' means nothing here: there is no shell", "name a script that does all of it")
    if SCENE in words[0] or OUTPUT in words[0]:
        raise TemplateError(f"the command begins with '{words[0]}', expected a program", example)
    if not any(SCENE in word for word in words):
        raise TemplateError(f"the command does not say where the scene goes: it lacks {SCENE}", example)
    return words


def _output_name(scene: Scene) -> str:
    """The name of the scene's image, if it is one that cannot be mistaken for anything else."""
    name = Path(scene.output).name
    return name if re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", name) and name != SCENE_FILE else "image.ppm"


# ---- running


@contextmanager
def _temporary() -> Iterator[Path]:
    """A folder that is gone afterwards, whatever was made in it."""
    folder = Path(tempfile.mkdtemp(prefix="whitted-"))
    try:
        yield folder
    finally:
        # Ctrl-C once more leaves nothing behind.
        with deferred():
            _remove(folder)


def _remove(folder: Path) -> None:
    # Processes that have just been killed may end a write first.
    deadline = time.monotonic() + 2
    while folder.exists() and time.monotonic() < deadline:
        # A folder that may not be read cannot be emptied.
        with suppress(OSError):
            folder.chmod(0o700)
            for path, folders, _ in os.walk(folder):
                for inside in (Path(path, name) for name in folders):
                    if not inside.is_symlink():
                        inside.chmod(0o700)
        shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True)
class _End:
    """How a program ended: its status, minus the number of a signal; whether its time was over; the most memory that
    a process of it had at once, in bytes, 0 if that is not known.
    """

    status: int
    late: bool
    peak: int


def _run(words: Sequence[str], folder: Path, limits: Limits, size: int) -> _End:
    """Run a program and everything that it starts to their end."""
    ours = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    launcher = [sys.executable, "-I", "-S", "-c", LAUNCHER, str(limits.memory), str(size), str(folder / "launch")]
    with (folder / "stdout").open("wb") as out, (folder / "stderr").open("wb") as err:
        process = None
        try:
            with deferred():
                process = subprocess.Popen(
                    [*launcher, *words],
                    cwd=folder / "work",
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                    start_new_session=True,
                )
            late = not ends(process.pid, limits.seconds)
        finally:
            if process:
                with deferred():
                    # Before it is waited for: until then its number, that of its group, cannot become another's.
                    end([process.pid])
                    _, status, usage = os.wait4(process.pid, 0)
                    process.returncode = os.waitstatus_to_exitcode(status)
    # A new process counts the memory of the one that it came from, ours.
    peak = usage.ru_maxrss * 1024 if usage.ru_maxrss > ours else 0
    return _End(process.returncode, late, peak)


# ---- what there is to say about it


class _FindingError(Exception):
    """Something that is wrong, and a hint or ""."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


def _start(folder: Path) -> _FindingError | None:
    """Why the program could not be started."""
    try:
        number = int((folder / "launch").read_text() or 0)
    except FileNotFoundError:
        return None
    reasons = {
        errno.ENOENT: ("what its file needs to run is not there", "its first line (#!...), or ldd, says what that is"),
        errno.ENOEXEC: (
            "its file is no program for this machine",
            "a script begins with a line such as #!/usr/bin/env python3; anything else has to be compiled here",
        ),
    }
    reason, hint = reasons.get(number, (os.strerror(number).lower(), ""))
    return _FindingError(f"cannot be started: {reason}", hint)


def _too_much(end: _End, folder: Path, size: int) -> _FindingError | None:
    """Whether a file became too large."""
    large = next((name for name, length in _files(folder) if length >= size), "")
    where = {"": "a file", "stdout": "its stdout", "stderr": "its stderr"}.get(large, large.removeprefix("work/"))
    if large or end.status == -signal.SIGXFSZ or (end.status and FILE_TOO_LARGE in _tail(folder)):
        return _FindingError(f"wrote too much: {where} reached the limit of {_mebibytes(size)}")
    return None


def _ending(end: _End, folder: Path, limits: Limits) -> _FindingError | None:
    """What is wrong with how it ended."""
    if end.late:
        hint = "does it wait for input, or for a window? `whitted check` has --time-limit"
        return _FindingError(f"took longer than {limits.seconds:g} s", hint)
    if end.status == 0:
        return None
    if end.status > 0:
        name = _signal(end.status - 128) if end.status > 128 else ""
        sentence = f"ended with exit status {end.status}" + (f", which a shell returns for {name}" if name else "")
        hint = "a program that has written its image ends with status 0"
    elif -end.status in CRASHES:
        sentence, hint = f"crashed: {_signal(-end.status)}", "gdb, or -fsanitize=address,undefined, says where"
    else:
        sentence, hint = f"was ended by {_signal(-end.status) or f'signal {-end.status}'}", ""
    tail = _tail(folder)
    if NO_MEMORY.search(tail) or end.peak > limits.memory / 2:
        sentence += f", probably for want of memory: the limit is {_mebibytes(limits.memory)}"
        hint = "build it without sanitizers, which reserve more than any limit" if b"Sanitizer" in tail else ""
    return _FindingError(sentence, hint)


def _signal(number: int) -> str:
    """A signal in words, or "" where there is none of that number."""
    try:
        return f"{signal.Signals(number).name} ({(signal.strsignal(number) or '').lower()})"
    except ValueError:
        return ""


def _image(folder: Path, output: Path, named: bool, size: tuple[int, int], most: int) -> images.Image:
    """The one image that the program wrote; `named`: the command says where.

    Raises:
        _FindingError: there is none, or it is wrong.
    """
    written, printed = _content(output, most), _content(folder / "stdout", most) or b""
    if written is None and (named or not images.kind(printed)):
        raise _no_image(folder, output, named, printed)
    if written is not None and not named and images.kind(printed) in images.READ and printed != written:
        raise _FindingError(
            f"wrote two different images, {output.name} and one to stdout",
            f"{OUTPUT} in the command makes the file count",
        )
    try:
        return images.decode(printed if written is None else written, size)
    except images.ImageError as error:
        place = "stdout" if written is None else output.name
        raise _FindingError(f"{place}: {error.message}", error.hint) from error


def _no_image(folder: Path, output: Path, named: bool, printed: bytes) -> _FindingError:
    """What was looked for, and what there is instead."""
    text = f"wrote no image: no {output.name}, as {OUTPUT if named else 'OUTPUT'} says"
    text += "" if named else ", and none to stdout"
    others = [
        f"{_printable(name.removeprefix('work/'))} ({length} bytes)"
        for name, length in _files(folder)
        if name.startswith("work/") and name != f"work/{SCENE_FILE}"
    ]
    if others:
        more = len(others) - MOST_FILES
        text += f"; it wrote {', '.join(others[:MOST_FILES])}" + f" and {more} more" * (more > 0)
    if printed:
        text += f"; its stdout begins with {_printable(printed[:40].decode(errors='replace'))!r}"
    hint = f"it has to write the file that OUTPUT names, where it runs, or {OUTPUT}, the path of that file"
    if named and images.kind(printed):
        hint = f"leave out {OUTPUT}, and the image is taken from stdout"
    return _FindingError(text, hint)


def _content(path: Path, most: int) -> bytes | None:
    """The bytes of a file; None if there is none.

    Raises:
        _FindingError: it is no file, or a larger one than the program may have written.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise _FindingError(f"{path.name} is no regular file")
        if found.st_size > most:
            raise _FindingError(f"{path.name} is larger than {_mebibytes(most)}")
        with path.open("rb") as file:
            return file.read(most)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _FindingError(f"{path.name} cannot be read: {(error.strerror or '').lower()}") from error


def _files(folder: Path) -> Iterator[tuple[str, int]]:
    """The files below a folder and their sizes."""
    for path, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            with suppress(OSError):
                found = Path(path, name).lstat()
                if stat.S_ISREG(found.st_mode):
                    yield str(Path(path, name).relative_to(folder)), found.st_size


def _tail(folder: Path) -> bytes:
    """The end of stderr."""
    with (folder / "stderr").open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - MOST_BYTES))
        return file.read(MOST_BYTES)


def _last_lines(folder: Path) -> list[str]:
    """The last lines of stderr, fit for a terminal."""
    lines = [_printable(line).rstrip() for line in _tail(folder).decode(errors="replace").splitlines()]
    shown = [line for line in lines if line][-MOST_LINES:]
    return [line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}..." for line in shown]


def _printable(text: str) -> str:
    """Without what moves the cursor or changes colours."""
    return "".join(letter if letter.isprintable() else " " if letter.isspace() else "?" for letter in text)


def _mebibytes(size: int) -> str:
    return f"{size / MEBIBYTE:g} MiB"
