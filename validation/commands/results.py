"""Where the results of a command go: files that are whole after every scene, and what is kept of what ends early."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from validation.commands.errors import StoppedError
from validation.commands.outputs import page_in, writable, write_text

if TYPE_CHECKING:
    from validation.run import Validation

#: Between scenes no more than this share of the time goes into writing files that are written again.
SHARE = 0.1


class Results:
    """The files of one run. Each is written beside its place and renamed: what is there is always whole."""

    def __init__(
        self, ctx: click.Context, command: list[str], *, report: Path | None, small: bool, json_file: Path | None
    ) -> None:
        """See first whether they can be written."""
        if json_file:
            writable(json_file)
        self._command, self._json, self._folder = command, json_file, report
        self.page = page_in(ctx, report, small=small) if report else None
        self.kept: Validation | None = None
        self._written, self._took = -float("inf"), 0.0

    def scene(self, result: Validation) -> None:
        """One more scene is finished."""
        result.command = self._command
        self.kept = result.snapshot()
        if self.kept.unfinished and time.monotonic() - self._written >= self._took / SHARE:
            self.write(self.kept)

    def write(self, result: Validation) -> list[Path]:
        """Write all files, and return their paths."""
        start = time.monotonic()
        paths = []
        if self._json:
            write_text(self._json, json.dumps(result.record(), indent=1, allow_nan=False) + "\n")
            paths.append(self._json)
        if self.page and self._folder:
            paths.append(self.page.write(self._folder, result))
        self._written = time.monotonic()
        self._took = self._written - start
        return paths

    def finish(self, result: Validation) -> None:
        """All is done: write, and say where the report is."""
        self.write(result)
        if self._folder:
            click.echo(self._folder / "index.html")

    @contextmanager
    def keeping(self, tell: Callable[[Validation], None]) -> Iterator[None]:
        """Ctrl-C in here: what is finished is told and goes into the files, and the error says so."""
        try:
            yield
        except KeyboardInterrupt as error:
            if self.kept is None:
                asked = self._json or self.page
                raise StoppedError("no scene was finished, nothing was written" if asked else "") from error
            tell(self.kept)
            paths = self.write(self.kept)
            every = len(self.kept.scenes)
            done = f"{every - len(self.kept.unfinished)} of {every} scenes"
            files = " and ".join(map(str, paths))
            kept = f"kept {files} with {done}" if paths else f"{done} were finished"
            raise StoppedError(kept) from error
