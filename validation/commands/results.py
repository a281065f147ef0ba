"""Where the results of a command go: files that are whole at any time, and what is kept of what ends early.

They are written again after a scene as long as that takes no more than a tenth of the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from validation import records
from validation.commands.errors import kept, nothing_kept
from validation.commands.outputs import check_included, check_open, open_page, page_in, writable
from validation.pages import write_text

if TYPE_CHECKING:
    from validation.report.report import Report
    from validation.run import Validation

#: Between scenes no more than this share of the time goes into writing files that are written again.
SHARE = 0.1


@dataclass(frozen=True)
class Outputs:
    """What `results_options` were told."""

    report: Path | None
    small: bool
    include: tuple[Path, ...]
    open_report: bool
    json_file: Path | None
    junit: Path | None
    markdown: Path | None

    @classmethod
    def of(cls, options: dict[str, Any]) -> Outputs:
        """Take them from the options of a command."""
        return cls(**{field.name: options.pop(field.name) for field in fields(cls)})

    @property
    def files(self) -> list[Path]:
        """Besides the report."""
        return [file for file in (self.json_file, self.junit, self.markdown) if file]


class Results:
    """The files of one run. Each is written beside its place and renamed: what is there is always whole."""

    def __init__(self, ctx: click.Context, command: Sequence[str], outputs: Outputs) -> None:
        """See first whether they can be written."""
        check_open(outputs.report, wanted=outputs.open_report)
        check_included(outputs.report, outputs.include)
        for file in outputs.files:
            writable(file)
        self._command, self._outputs = command, outputs
        self.page: Report | None = None
        if outputs.report:
            self.page = page_in(ctx, outputs.report, small=outputs.small, include=outputs.include)
        self.kept: Validation | None = None
        self._record: Callable[[], Mapping[str, Any]] | None = None
        self._written, self._took = -float("inf"), 0.0

    def scene(self, result: Validation, record: Callable[[], Mapping[str, Any]] | None = None) -> None:
        """One more scene is finished; `record`: makes what the JSON has, where that is not the record of the result."""
        result.command = self._command
        self.kept, self._record = result.snapshot(), record
        if self.kept.unfinished and time.monotonic() - self._written >= self._took / SHARE:
            self._write_kept(self.kept, between=True)

    def _write_kept(self, kept: Validation, *, between: bool = False) -> list[Path]:
        record = self._record() if self._record and self._outputs.json_file else None
        return self.write(kept, record, between=between)

    def write(
        self, result: Validation, record: Mapping[str, Any] | None = None, *, between: bool = False
    ) -> list[Path]:
        """Write all files, and return their paths; `record`: what the JSON has, None: that of the result.

        `between`: more is to come, so only files that can be replaced are written. What goes to a pipe cannot be taken
        back.
        """
        from tracer.passes import replaceable

        start, to = time.monotonic(), self._outputs
        paths: list[Path] = []

        def due(file: Path | None) -> bool:
            return file is not None and (not between or replaceable(file))

        if to.json_file and due(to.json_file):
            record = result.record() if record is None else record
            records.write(to.json_file, record)
            paths.append(to.json_file)
        if to.junit and due(to.junit):
            from validation.junit import junit

            write_text(to.junit, junit(result))
            paths.append(to.junit)
        if to.markdown and due(to.markdown):
            from validation.markdown import write_markdown

            if write_markdown(to.markdown, result):
                paths.append(to.markdown)
        if self.page and to.report:
            paths.append(self.page.write(to.report, result))
        self._written = time.monotonic()
        self._took = self._written - start
        return paths

    def finish(
        self, result: Validation, tell: Callable[[Validation], None], record: Mapping[str, Any] | None = None
    ) -> None:
        """All is done: write, tell it, and say where the report is.

        Written first: who reads what is told may have gone, which ends the program.
        """
        self.write(result, record)
        tell(result)
        if self._outputs.report:
            page = self._outputs.report / "index.html"
            click.echo(page)
            if self._outputs.open_report:
                open_page(page)

    @contextmanager
    def keeping(self, tell: Callable[[Validation], None]) -> Iterator[None]:
        """Ctrl-C in here: what is finished is told and goes into the files, and the error says so."""
        try:
            with nothing_kept(*self._outputs.files, self.page):
                yield
        except KeyboardInterrupt as error:
            if self.kept is None:
                raise
            paths = self._write_kept(self.kept)
            tell(self.kept)
            every = len(self.kept.scenes)
            done = f"{every - len(self.kept.unfinished)} of {every} {self.kept.parts}s"
            raise kept(paths, done) from error
