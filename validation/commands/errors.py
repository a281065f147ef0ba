"""Exit statuses of `whitted`, and what is wrong with its input in one sentence and a hint."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from validation.renderers import Renderer

DIFFERENT, WRONG, FAILED, INTERRUPTED, PIPE_CLOSED, TERMINATED = 1, 2, 3, 130, 128 + 13, 128 + 15
#: Errors of one scene file that are shown.
MOST_ERRORS = 20
#: How a pixel is named.
AT = "a column and a row, from 0 at the top left: --at X Y"


class ReaderGoneError(Exception):
    """Nobody reads our output any more. No OSError: click would end with status 1, which means a difference."""


class CommandError(click.ClickException):
    """One sentence of what is wrong, and what to do."""

    def __init__(self, message: str, hint: str = "", status: int = WRONG) -> None:
        """`message` may be several complete diagnostics; then there is no `hint`."""
        super().__init__(message)
        self.hint = hint
        self.status = status


class StoppedError(KeyboardInterrupt):
    """Ctrl-C, or what ends the program like it, and what was kept of what was done."""

    def __init__(self, kept: str) -> None:
        """`kept`: a clause; "" where there was nothing to keep."""
        super().__init__(kept)
        self.kept = kept


def kept(paths: Iterable[Path | None], done: str) -> StoppedError:
    """Ended early, and some of it was written; `done`: what there is of what there was to be."""
    *some, last = [str(path) for path in paths if path] or [""]
    files = f"{', '.join(some)} and {last}" if some else last
    return StoppedError(f"kept {files} with {done}" if last else f"{done} were finished")


@contextmanager
def nothing_kept(*files: object) -> Iterator[None]:
    """Ctrl-C in here, which nothing in it has kept anything of, says so where there were to be files."""
    try:
        yield
    except StoppedError:
        raise
    except KeyboardInterrupt as error:
        raise StoppedError("nothing was finished, nothing was written" if any(files) else "") from error


def sentence(error: click.ClickException) -> tuple[str, str]:
    """What click finds wrong, and a hint, in our words."""
    from tracer.near import near

    context = getattr(error, "ctx", None)
    path = context.command_path if context else "whitted"
    message, hint = error.format_message().rstrip("."), getattr(error, "hint", "") or f"see `{path} --help`"
    if isinstance(error, click.NoSuchOption):
        message = f"no such option '{error.option_name}'"
        # Without the dashes, which all have in common.
        known = [option for parameter in context.command.params for option in parameter.opts] if context else []
        options = {option.lstrip("-"): option for option in known}
        if meant := near(error.option_name.lstrip("-"), options):
            hint = f"did you mean '{options[meant]}'?"
    elif isinstance(error, click.BadOptionUsage) and error.option_name == "--at":
        message, hint = "--at: found fewer than two numbers", AT
    elif isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter) and error.param:
        name = error.param.human_readable_name
        if isinstance(error.param, click.Option):
            name = max(error.param.opts, key=len)
        return f"error: {name}: {error.message.rstrip('.')}", hint
    return f"error: {message[:1].lower()}{message[1:]}", hint


@contextmanager
def errors(done: str = "compared") -> Iterator[None]:
    """What is wrong with the input, as an error of the command; warnings go to stderr in the same style.

    `done`: what was not done where a scene is wrong.
    """
    import tracer
    from validation.renderers import RendererNameError
    from validation.run import InputError, RendererError, SceneFilesError

    try:
        tracer.instruction_set()
    except ValueError as error:
        raise CommandError(str(error), "unset WHITTED_ISA to use the best one") from error

    def show(message: Warning | str, category: type[Warning], *_: object) -> None:
        del category
        # Those of scene files say `warning:` after the place.
        click.echo(f"{message}" if ": warning: " in str(message) else f"warning: {message}", err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = show  # type: ignore[assignment]
        try:
            yield
        except SceneFilesError as error:
            text = "\n".join(map(_first_errors, error.messages))
            wrong = len(error.messages)
            count = f"\nnothing was {done}: {wrong} of {error.files} files {'is' if wrong == 1 else 'are'} wrong"
            raise CommandError(text + count * (error.files > 1)) from error
        except InputError as error:
            raise CommandError(str(error)) from error
        except RendererError as error:
            raise CommandError(str(error), "", FAILED) from error
        except BrokenPipeError:
            raise
        except RendererNameError as error:
            raise CommandError(str(error), error.hint) from error
        except OSError as error:
            if error.errno and error.filename is None:
                raise  # standard output: files have names
            place = f"{os.fsdecode(error.filename)}: " if error.filename else ""
            hint = "name a file in another folder" if isinstance(error, PermissionError) else ""
            raise CommandError(f"{place}{error.strerror or error}", hint) from error


def _first_errors(message: str) -> str:
    """What is wrong with a scene file; of a file that is none the beginning, and a count."""
    entries = re.split(r"\n(?! )", message)  # a hint is indented
    if len(entries) <= MOST_ERRORS:
        return message
    rest = len(entries) - MOST_ERRORS
    # The parser stops counting one by one at some number.
    if last := re.fullmatch(r".*: error: and (\d+) more", entries[-1]):
        rest += int(last[1]) - 1
    # The name of the file may have the same words in it.
    placed = re.match(r"(.*?)(:\d+)+: error: ", entries[0]) or re.match(r"(.*?): error: ", entries[0])
    place = placed[1] if placed else ""
    return "\n".join([*entries[:MOST_ERRORS], f"{place}: error: and {rest} more"])


@contextmanager
def blaming(renderer: Renderer) -> Iterator[None]:
    """What a renderer raises is said with its name."""
    from validation.run import RendererError, blaming

    try:
        with blaming():
            yield
    except RendererError as error:
        raise CommandError(f"{renderer.name} {error}", "", FAILED) from error
