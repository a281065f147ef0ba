"""What commands write: files beside their place, folders, reports, and progress on a terminal."""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from validation.commands.errors import CommandError
from validation.options import quiet, verbose
from validation.terminal import console

if TYPE_CHECKING:
    from validation.report.report import Report


def writable(path: Path) -> None:
    """An output that cannot be written is said before the work, not after it."""
    if str(path) == "-":
        raise CommandError("'-' is not the name of a file to write", "name a file; /dev/stdout is standard output")
    if path.is_dir():
        raise CommandError(f"{path} is a folder, expected the name of a file")
    if not path.parent.is_dir():
        raise CommandError(f"{path}: there is no folder {path.parent}", f"mkdir -p {shlex.quote(str(path.parent))}")
    if path.exists() and (not path.is_file() or str(path).startswith("/dev/")):  # a pipe, a device, what is open
        if not os.access(path, os.W_OK):
            raise CommandError(f"{path}: cannot be written", "name another file")
        return
    try:
        # The permission bits do not say it all, and the file behind a link is replaced.
        with tempfile.TemporaryFile(dir=Path(os.path.realpath(path)).parent):
            pass
    except OSError as error:
        raise CommandError(f"{path}: {error.strerror or error}", "name a file in another folder") from error


@contextmanager
def folder(path: Path, option: str = "--report") -> Iterator[None]:
    """A folder to write into; what had to be made for it goes again if nothing was written."""
    made: list[Path] = []
    try:
        try:
            if path.exists() and not path.is_dir():
                raise CommandError(f"{option}: {path} is a file, expected a folder", "name a folder")
            missing = [folder for folder in (path, *path.parents) if not folder.exists()]
            for folder in reversed(missing):
                folder.mkdir(exist_ok=True)
                made.append(folder)
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as error:
            raise CommandError(f"{option}: {path}: {error.strerror or error}", "name another folder") from error
        yield
    finally:
        for folder in reversed(made):
            with suppress(OSError):  # it has something in it
                folder.rmdir()


def page_in(ctx: click.Context, report: Path, *, small: bool = False, include: Sequence[Path] = ()) -> Report:
    """A report that can be written into that folder; `include`: results of other commands for it."""
    from validation.report.included import MAKES, IncludeError, read
    from validation.report.report import Report, ours

    try:
        included = [read(path) for path in include]
    except IncludeError as error:
        raise CommandError(f"--include: {error}", MAKES) from error
    ctx.with_resource(folder(report))
    place = report / "index.html"
    writable(place)
    if not ours(place):
        raise CommandError(f"{place} is no report of whitted", "name another folder, or remove that file")
    return Report(small=small, included=included)


def command_line() -> list[str]:
    """The command as typed, without the folder of the program."""
    return ["whitted", *sys.argv[1:]]


@contextmanager
def progressing() -> Iterator[Callable[[str], None]]:
    """Show on a terminal what is being done; with --verbose a line each, anywhere; with --quiet nothing."""
    start = time.monotonic()

    def say(text: str) -> None:
        click.echo(f"{time.monotonic() - start:7.1f} s  {text}", err=True)

    if verbose():
        yield say
    elif quiet() or not sys.stderr.isatty():
        yield lambda _: None
    else:
        from rich import markup

        terminal = console(stderr=True)
        with terminal.status("") as status:

            def show(text: str) -> None:
                room = terminal.width - 3  # beside what turns
                line = text if len(text) <= room else f"{text[: room - 1]}…"
                status.update(markup.escape(line))  # what is in brackets is no markup: a command may have some

            yield show


@contextmanager
def summing() -> Iterator[None]:
    """With --quiet the last line alone of what is printed in here, which is the sum."""
    if not quiet():
        yield
        return
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        yield
    for line in text.getvalue().splitlines()[-1:]:
        click.echo(line)


def open_page(path: Path) -> None:
    """Open a page in the browser."""
    import webbrowser

    if not webbrowser.open(path.resolve().as_uri()):
        click.echo(f"note: no browser could be started for {path}", err=True)


def check_open(report: Path | None, *, wanted: bool) -> None:
    """Whether there is something to open."""
    if wanted and not report:
        raise CommandError("--open opens a report, and there is none", "--report DIR --open")


def check_included(report: Path | None, include: Sequence[Path]) -> None:
    """Whether there is a report for them."""
    if include and not report:
        raise CommandError("--include is about a report, and there is none", "--report DIR --include FILE")
