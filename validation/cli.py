"""The command `whitted`: its group, its errors, and how it ends. The commands are in validation/commands."""

from __future__ import annotations

import importlib.metadata
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import click
from click.exceptions import NoArgsIsHelpError

from validation.commands.check import check
from validation.commands.compare import compare
from validation.commands.convert import convert
from validation.commands.errors import (
    INTERRUPTED,
    PIPE_CLOSED,
    TERMINATED,
    WRONG,
    CommandError,
    ReaderGoneError,
    StoppedError,
    sentence,
)
from validation.commands.explain import explain
from validation.commands.help import ALWAYS, write_examples, write_statuses
from validation.commands.render import render
from validation.commands.renderers import list_renderers
from validation.commands.signals import ended, ending
from validation.commands.speed import speed
from validation.commands.stability import stability
from validation.commands.truth import truth
from validation.commands.validate import validate
from validation.terminal import complain


class Commands(click.Group):
    """A group that knows what a mistyped command was meant to be."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, or say which one is near."""
        if args and self.get_command(ctx, args[0]) is None:
            from tracer.near import near

            meant = near(args[0], self.list_commands(ctx))
            hint = f"did you mean '{meant}'?" if meant else "see `whitted --help`"
            raise CommandError(f"unknown command '{args[0]}'", hint)
        return super().resolve_command(ctx, args)

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """What it is for, and examples."""
        super().format_help_text(ctx, formatter)
        write_examples(formatter, EXAMPLES)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The commands group by group, and the options."""
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(command.name or "", command.get_short_help_str(100)) for command in commands])
        click.Command.format_options(self, ctx, formatter)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Exit statuses, and variables of the environment."""
        write_statuses(formatter, dict(sorted({**ALWAYS, **STATUSES}.items())))
        with formatter.section("Environment"):
            formatter.write_dl([*VARIABLES.items()])
        formatter.write_paragraph()
        formatter.write_text("whitted COMMAND --help says more, with examples.")
        super().format_epilog(ctx, formatter)

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        """Parse the words; --help and --version print here."""
        with _pipe():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        with _pipe():
            return super().invoke(ctx)


@contextmanager
def _pipe() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError as error:
        raise ReaderGoneError from error


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line; every error is a sentence and a hint on stderr, never a traceback."""
    if sys.stdout is None:
        complain("error: standard output is closed", "send it to a file or to /dev/null")
        sys.exit(WRONG)
    try:
        with ending():
            status = whitted.main(args=arguments, prog_name="whitted", standalone_mode=False)
            sys.stdout.flush()
    except CommandError as error:
        status = error.status
        text = error.message
        # Diagnostics of scene files say `error:` after the place.
        complain(text if ": error: " in text.partition("\n")[0] else f"error: {text}", error.hint)
    except NoArgsIsHelpError as error:
        status = WRONG
        click.echo(error.format_message(), err=True)
    except click.ClickException as error:
        status = WRONG
        complain(*sentence(error))
    except (click.Abort, KeyboardInterrupt) as error:
        status = ended()
        cause = error.__cause__ or error  # click makes an Abort of it
        kept = cause.kept if isinstance(cause, StoppedError) else ""
        if kept or status == INTERRUPTED:
            complain(": ".join(filter(None, ("interrupted" if status == INTERRUPTED else "terminated", kept))))
    except (BrokenPipeError, ReaderGoneError):
        status = PIPE_CLOSED
    except OSError as error:
        status = WRONG
        complain(f"error: standard output: {error.strerror or error}", "send it elsewhere")
    try:
        sys.stdout.flush()
    except OSError:
        # Python must not complain about it again when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    waiting = any(not thread.daemon and thread is not threading.main_thread() for thread in threading.enumerate())
    if status in (INTERRUPTED, TERMINATED) and waiting:
        # A thread of a pool that was broken up may never end: see validation.truth.prove. All else is closed by now.
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status if isinstance(status, int) else 0)


#: The commands as `--help` lists them.
GROUPS: dict[str, tuple[click.Command, ...]] = {
    "Compare": (validate, check, compare),
    "Judge": (explain, truth, stability),
    "Measure": (speed,),
    "Renderers and files": (list_renderers, render, convert),
}

EXAMPLES = (
    "whitted validate scenes/gallery/mirrors.txt --size 100x100 --report report",
    "raytrace scenes/gallery/shadows.txt -o mine.ppm --sample center",
    "whitted check scenes/gallery/shadows.txt --image mine.ppm",
)

STATUSES = {
    0: "done; all comparisons agree, every difference that was judged is explained",
    1: "some differ, or one that was judged is not explained",
    3: "a renderer failed, or nothing could be compared",
}

VARIABLES = {
    "NO_COLOR": "if it is not empty, no colours",
    "WHITTED_ISA": "the instruction set of the native renderers: scalar, sse2, avx2, avx512, neon",
}


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(importlib.metadata.version("whitted"), message="%(prog)s %(version)s")
def whitted() -> None:
    """Draw a scene with several renderers, compare them pass by pass, and say where they differ."""


for group in GROUPS.values():
    for entry in group:
        whitted.add_command(entry)


if __name__ == "__main__":
    main()
