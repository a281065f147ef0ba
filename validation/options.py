"""Options and types of parameters that several commands of `whitted` share."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

Function = TypeVar("Function", bound=Callable[..., Any])

#: Those of tracer.passes, which takes longer to import than help may take; a test holds them together.
SAMPLES = ("corner", "center", "bottom-left", "top-right", "inclusive")
#: Those of validation.encoding, as above.
QUANTISATIONS = ("truncate", "round", "255.9", "256", "srgb", "srgb-truncate", "gamma", "gamma-truncate")
#: As tracer limits them.
MOST_THREADS = 1024
#: That of validation.run, which takes longer to import than help may take; a test holds them together.
MOST_VERDICTS = 100
#: A file to write.
FILE = click.Path(path_type=Path, dir_okay=False)
#: A whole number of more digits than any of ours.
TOO_LONG = re.compile("0*[1-9][0-9]{18,}")
#: What --no-limits allows; a test holds the number to that of the command line.
NO_LIMITS = "Allow more than five spheres and lights, and more than 100000 columns or rows."


class BadValueError(click.BadParameter):
    """A value that an option cannot have, and what to type instead."""

    hint = ""


class Whole(click.ParamType[int]):
    """A whole number from `least` to `most`, None: as large as you like; `hint`: what it means."""

    name = "N"

    def __init__(self, least: int = 0, most: int | None = None, hint: str = "") -> None:
        """Both ends count."""
        self.least, self.most, self.hint = least, most, hint

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """As a number."""
        if isinstance(value, int):
            return value
        if self.most is None and TOO_LONG.fullmatch(value):
            self.refuse(f"'{value}' is too large", param, ctx)
        if not re.fullmatch("0*[0-9]{1,18}", value) or not self.least <= int(value) <= (self.most or sys.maxsize):
            upward = "on" if self.most is None else f"to {self.most}"
            self.refuse(f"'{value}' is not a whole number from {self.least} {upward}", param, ctx)
        return int(value)

    def refuse(self, message: str, param: click.Parameter | None, ctx: click.Context | None) -> NoReturn:
        """Say what is wrong, and the hint."""
        error = BadValueError(message, ctx, param)
        error.hint = self.hint
        raise error


class Place(Whole):
    """A column or row of an image."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """As a number."""
        if not re.fullmatch("[0-9]{1,18}", str(value)):
            self.refuse(f"'{value}' is no column or row of an image", param, ctx)
        return int(value)


class Names(click.ParamType[tuple[str, ...]]):
    """A list of names with commas between them; `cmd:` and all that follows is one."""

    name = "NAME[,NAME...]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Split at the commas."""
        if isinstance(value, tuple):
            return value
        # A command may have commas of its own.
        names, *command = re.split(r"(?:^|,)\s*(?=cmd:)", value, maxsplit=1)
        parts = tuple(part.strip() for part in (*(names.split(",") if names or not command else ()), *command))
        if not all(parts):
            self.fail(f"'{value}' has an empty name", param, ctx)
        return tuple(dict.fromkeys(parts))


def _together(_: click.Context, __: click.Parameter, values: tuple[tuple[str, ...], ...]) -> tuple[str, ...] | None:
    names = tuple(dict.fromkeys(name for value in values for name in value))
    return names or None


def names_option(flag: str, **attributes: Any) -> Callable[[Function], Function]:
    """A list of names; the option may be repeated, and all of its names count. None where there is none."""
    return click.option(flag, type=Names(), multiple=True, callback=_together, **attributes)


class Size(click.ParamType[tuple[int, int]]):
    """COLUMNSxROWS."""

    name = "WxH"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """Not in capitals, as the x is part of it."""
        del param, ctx
        return self.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Two positive integers."""
        if isinstance(value, tuple):
            return value
        found = re.fullmatch(r"0*([0-9]+)[xX]0*([0-9]+)", value)
        if not found:
            self.fail(f"'{value}' is not a size such as 400x300", param, ctx)
        if "0" in found.groups():
            self.fail(f"'{value}' is not a size: at least 1x1", param, ctx)
        if max(map(len, found.groups())) > 9:
            self.fail(f"'{value}' is too large", param, ctx)
        return int(found[1]), int(found[2])


class Count(Whole):
    """How many pixels: a number from 1 on, or `all`, which is more than any image has."""

    name = "N|all"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """As a number."""
        if isinstance(value, int):
            return value
        if value == "all":
            return sys.maxsize
        if TOO_LONG.fullmatch(value):
            self.refuse(f"'{value}' is too large", param, ctx)
        if not re.fullmatch(r"0*[1-9][0-9]{0,17}", value):
            self.refuse(f"'{value}' is not a number of pixels from 1 on, or 'all'", param, ctx)
        return int(value)


class Threads(click.ParamType[tuple[int, ...]]):
    """Numbers of threads with commas between them; 0: all processors."""

    name = "N[,N...]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        """As numbers."""
        if isinstance(value, tuple):
            return value
        whole = Whole(0, MOST_THREADS, hint="--threads 1,0 measures with one thread, and with all")
        return tuple(dict.fromkeys(whole.convert(part.strip(), param, ctx) for part in value.split(",")))


def positive(_: click.Context, parameter: click.Parameter, value: float) -> float:
    """A finite number from 0 on."""
    if not 0 <= value < float("inf"):
        raise click.BadParameter(f"{value} is not a finite number from 0 on", param=parameter)
    return value


def epsilon(_: click.Context, parameter: click.Parameter, value: float) -> float:
    """A number from 0 to below 1."""
    if not 0 <= value < 1:
        raise click.BadParameter(f"{value} is not a number from 0 to below 1", param=parameter)
    return value


def settings_options(function: Function) -> Function:
    """The options that `raytrace` has too."""
    sample = click.option(
        "--sample",
        type=click.Choice(SAMPLES),
        default="corner",
        show_default=True,
        help="Where in its pixel a ray goes through.",
    )
    return sample(drawing_options(function))


def drawing_options(function: Function) -> Function:
    """The same without --sample."""
    for option in reversed(
        (
            click.option(
                "--shadow-epsilon",
                type=float,
                default=1e-4,
                show_default=True,
                callback=epsilon,
                metavar="E",
                help="Blockers with t <= E cast no shadow.",
            ),
            click.option(
                "--max-reflections",
                type=Whole(0, 100),
                default=3,
                show_default=True,
                metavar="N",
                help="Reflected rays in a chain.",
            ),
            click.option(
                "--threads",
                type=Whole(0, MOST_THREADS),
                default=0,
                show_default=True,
                metavar="N",
                help="Threads that draw; 0: all.",
            ),
            click.option("--no-limits", is_flag=True, help=NO_LIMITS),
        )
    ):
        function = option(function)
    return function


def open_option(function: Function) -> Function:
    """--open."""
    return click.option("--open", "open_report", is_flag=True, help="Open the report in the browser.")(function)


def json_option(function: Function) -> Function:
    """--json FILE."""
    return click.option("--json", "json_file", type=FILE, metavar="FILE", help="Write the results as JSON.")(function)


def _remember(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    ctx.meta[f"whitted.{parameter.name}"] = value
    if quiet() and verbose():
        raise click.UsageError("--quiet and --verbose exclude each other", ctx)


def quiet() -> bool:
    """Whether the command that runs was told to be."""
    return _told("quiet")


def verbose() -> bool:
    """Whether the command that runs was told to say more."""
    return _told("verbose")


def _told(name: str) -> bool:
    ctx = click.get_current_context(silent=True)
    return bool(ctx and ctx.meta.get(f"whitted.{name}"))


def loudness_options(
    quieter: str = "No progress; of the results the last line alone.",
    louder: str = "Say on stderr what is being done, with times.",
) -> Callable[[Function], Function]:
    """--quiet and --verbose, in words where they do more; see `quiet` and `verbose`.

    `convert` and `renderers` have neither: they are done at once, and say nothing that was not asked for.
    """

    def decorate(function: Function) -> Function:
        extra: dict[str, Any] = {"is_flag": True, "expose_value": False, "callback": _remember}
        less = click.option("-q", "--quiet", help=quieter, **extra)
        more = click.option("-v", "--verbose", help=louder, **extra)
        return less(more(function))

    return decorate


def results_options(each: str, more: str = "") -> Callable[[Function], Function]:
    """Where the results go, and how many pixels are judged; `each`: of what, such as "each image"; `more`: about it."""

    def decorate(function: Function) -> Function:
        judged = click.option(
            "--verdicts",
            type=Whole(hint=f"--verdicts 500 judges 500 pixels of {each} at most, --verdicts 0 none"),
            default=MOST_VERDICTS,
            show_default=not more,
            metavar="N",
            help=f"Of {each} work out N differing pixels exactly: who is wrong, and why; a random sample where more "
            f"differ; 0: none.{more}",
        )
        report = click.option(
            "--report", type=click.Path(path_type=Path), metavar="DIR", help="Write DIR/index.html, a page to look at."
        )
        small = click.option(
            "--small", is_flag=True, help="A report without the float values of pixels: it then has pictures alone."
        )
        include = click.option(
            "--include",
            type=click.Path(path_type=Path, exists=True, dir_okay=False),
            multiple=True,
            metavar="FILE",
            help="Show in the report what whitted stability --json FILE or whitted speed --json FILE wrote.",
        )
        junit = click.option("--junit", type=FILE, metavar="FILE", help="Write the results as JUnit XML.")
        markdown = click.option(
            "--markdown",
            type=FILE,
            metavar="FILE",
            help='Write a summary in Markdown; for the page of a job on GitHub: "$GITHUB_STEP_SUMMARY".',
        )
        return report(open_option(small(include(json_option(junit(markdown(judged(function))))))))

    return decorate
