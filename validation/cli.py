"""The command `whitted`: validate, check, explain, truth, stability, speed, render, convert, compare, renderers."""

# Everything but click is imported where it is used: `whitted --help` answers at once.
from __future__ import annotations

import difflib
import importlib.metadata
import itertools
import json
import os
import re
import shlex
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click
from click.core import ParameterSource
from click.exceptions import NoArgsIsHelpError

from validation.options import (
    NO_LIMITS,
    SAMPLES,
    Count,
    Place,
    Size,
    Threads,
    Whole,
    drawing_options,
    json_option,
    names_option,
    positive,
    results_options,
    settings_options,
)
from validation.terminal import complain, console, print_comparisons, print_validation

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.passes import Passes
    from validation.fuzz import Campaign
    from validation.renderers import Renderer, Settings
    from validation.report.report import Report
    from validation.stability import Stability

PASS_FILES, IMAGES = (".exr", ".npz"), (".png", ".ppm")
DIFFERENT, WRONG, FAILED, INTERRUPTED, PIPE_CLOSED, TERMINATED = 1, 2, 3, 130, 128 + 13, 128 + 15
#: As the scene format limits columns and rows.
LONGEST_SIDE = 100_000
#: Errors of one scene file that are shown.
MOST_ERRORS = 20
#: How a pixel is named.
AT = "a column and a row, from 0 at the top left: --at X Y"
XY = "one scene, then a column and a row, from 0 at the top left: whitted explain SCENE X Y"

#: Set by SIGTERM, where it ends the program as Ctrl-C does.
_terminated = threading.Event()


class ReaderGoneError(Exception):
    """Nobody reads our output any more. No OSError: click would end with status 1, which means a difference."""


class CommandError(click.ClickException):
    """One sentence of what is wrong, and what to do."""

    def __init__(self, message: str, hint: str = "", status: int = WRONG) -> None:
        """`message` may be several complete diagnostics; then there is no `hint`."""
        super().__init__(message)
        self.hint = hint
        self.status = status


class Commands(click.Group):
    """A group that knows what a mistyped command was meant to be."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, or say which one is near."""
        if args and self.get_command(ctx, args[0]) is None:
            near = difflib.get_close_matches(args[0], self.list_commands(ctx), n=1)
            hint = f"did you mean '{near[0]}'?" if near else "see `whitted --help`"
            raise CommandError(f"unknown command '{args[0]}'", hint)
        return super().resolve_command(ctx, args)

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
        with _ending():
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
        complain(*_sentence(error))
    except (click.Abort, KeyboardInterrupt):
        status = TERMINATED if _terminated.is_set() else INTERRUPTED
        if status == INTERRUPTED:
            complain("interrupted")
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


def _sentence(error: click.ClickException) -> tuple[str, str]:
    """What click finds wrong, and a hint, in our words."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "whitted"
    message, hint = error.format_message().rstrip("."), getattr(error, "hint", "") or f"see `{path} --help`"
    if isinstance(error, click.NoSuchOption):
        message = f"no such option '{error.option_name}'"
        # Without the dashes, which all have in common.
        options = {option.lstrip("-"): option for option in error.possibilities or ()}
        if near := difflib.get_close_matches(error.option_name.lstrip("-"), options, n=1):
            hint = f"did you mean '{options[near[0]]}'?"
    elif isinstance(error, click.BadOptionUsage) and error.option_name == "--at":
        message, hint = "--at: found fewer than two numbers", AT
    elif isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter) and error.param:
        name = error.param.human_readable_name
        if isinstance(error.param, click.Option):
            name = max(error.param.opts, key=len)
        return f"error: {name}: {error.message.rstrip('.')}", hint
    return f"error: {message[:1].lower()}{message[1:]}", hint


@contextmanager
def _errors(done: str = "compared") -> Iterator[None]:
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


def _settings(options: Mapping[str, Any]) -> Settings:
    from validation.renderers import Settings

    return Settings(options["sample"], options["shadow_epsilon"], options["max_reflections"], options["threads"])


def _load(path: Path, *, no_limits: bool) -> Scene:
    from validation.run import SceneFilesError, load_scenes

    if path.is_dir():
        raise SceneFilesError([f"{path}: error: this is a folder, expected a scene file"])
    (scene,) = load_scenes([path], limits=not no_limits).values()
    return scene


def _check_size(size: tuple[int, int] | None, *, no_limits: bool) -> None:
    if size and not no_limits and max(size) > LONGEST_SIDE:
        message = f"--size {size[0]}x{size[1]}: at most {LONGEST_SIDE} columns and rows"
        raise CommandError(message, "--no-limits allows more")


def _check_pairs(tested: Sequence[str], references: Sequence[str]) -> None:
    """Whether there is anything to compare."""
    from validation import renderers

    names = {renderers.get(name).name for name in (*tested, *references)}
    if len(names) == 1:
        hint = "--against with another name; see `whitted renderers`"
        raise CommandError(f"a renderer is not compared with itself: {names.pop()}", hint)


def _pass_names(asked: Sequence[str]) -> None:
    from validation.run import check_passes

    try:
        check_passes(asked)
    except ValueError as error:
        message, _, near = str(error).partition(" (did you mean ")
        hint = f"did you mean {near.rstrip(')')}" if near else f"the passes are {', '.join(_every_pass())}"
        raise CommandError(message, hint) from error


def _every_pass() -> list[str]:
    """The passes that there are to compare, families such as `shadow.L*` once."""
    from tracer.passes import TABLE

    return [row.name for row in TABLE if row.quantity != "margin"]


def _usable(name: str) -> Renderer:
    from validation import renderers

    renderer = renderers.get(name)
    with _blaming(renderer):
        reason = renderer.unavailable()
    if reason:
        raise CommandError(f"{renderer.name} cannot run here: {reason}", "see `whitted renderers`", FAILED)
    return renderer


@contextmanager
def _blaming(renderer: Renderer) -> Iterator[None]:
    """What a renderer raises is said with its name."""
    from validation.run import RendererError, blaming

    try:
        with blaming():
            yield
    except RendererError as error:
        raise CommandError(f"{renderer.name} {error}", "", FAILED) from error


def _parent(path: Path) -> None:
    """An output that cannot be written is said before the work, not after it."""
    if str(path) == "-":
        raise CommandError("'-' is not the name of a file to write", "name a file; /dev/stdout is standard output")
    if path.is_dir():
        raise CommandError(f"{path} is a folder, expected the name of a file")
    if not path.parent.is_dir():
        raise CommandError(f"{path}: there is no folder {path.parent}", f"mkdir -p {shlex.quote(str(path.parent))}")
    if path.exists() and not path.is_file():  # a pipe or a device
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
def _folder(path: Path) -> Iterator[None]:
    """A folder to write into; what had to be made for it goes again if nothing was written."""
    made: list[Path] = []
    try:
        try:
            if path.exists() and not path.is_dir():
                raise CommandError(f"--report: {path} is a file, expected a folder", "name a folder")
            missing = [folder for folder in (path, *path.parents) if not folder.exists()]
            for folder in reversed(missing):
                folder.mkdir(exist_ok=True)
                made.append(folder)
        except OSError as error:
            raise CommandError(f"--report: {path}: {error.strerror or error}", "name another folder") from error
        yield
    finally:
        for folder in reversed(made):
            with suppress(OSError):  # it has something in it
                folder.rmdir()


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(importlib.metadata.version("whitted"), message="%(prog)s %(version)s")
def whitted() -> None:
    """Draw a scene with several renderers, compare them pass by pass, and say where they differ."""


@whitted.command()
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE_OR_FOLDER...", type=click.Path(path_type=Path))
@names_option("--renderer", default=["native-f64"], show_default=True, help="What is under test.")
@names_option("--against", default=["mitsuba-spec"], show_default=True, help="What it is compared with.")
@click.option(
    "--all-pairs",
    is_flag=True,
    help="Compare every pair, of the renderers named or of all that can run here: who stands alone?",
)
@names_option("--passes", help="Passes to compare, for example beauty,shadow.L*; default: all.")
@click.option("--size", type=Size(), help="Columns and rows instead of the scene's own.")
@settings_options
@results_options("each scene and pair")
@click.option("-v", "--verbose", is_flag=True, help="A row for every pass, as a single scene has anyway.")
@click.pass_context
def validate(
    ctx: click.Context,
    /,
    scenes: tuple[Path, ...],
    renderer: tuple[str, ...],
    against: tuple[str, ...],
    all_pairs: bool,
    passes: tuple[str, ...] | None,
    size: tuple[int, int] | None,
    report: Path | None,
    small: bool,
    json_file: Path | None,
    verdicts: int,
    verbose: bool,
    **options: Any,
) -> None:
    """Compare renderers on scene files and on all scenes (*.txt) below folders, and judge where they differ.

    \b
    whitted validate scenes/gallery/mirrors.txt --report out
    whitted validate scenes --renderer native-f64 --against mitsuba-spec,numpy-f64 --size 100x100
    whitted validate scenes/gallery --all-pairs

    Exit status: 0 all agree, 1 some differ or a difference is not explained, 2 the input or the command is wrong, 3 a
    renderer failed.
    """  # noqa: D301 - click wants that character, not a backslash
    from validation import renderers
    from validation.run import load_scenes
    from validation.run import validate as run

    command = _command()
    with _errors():
        _pass_names(passes or ())
        if all_pairs:
            given = ctx.get_parameter_source
            named = [
                name
                for option, names in (("renderer", renderer), ("against", against))
                if given(option) is not ParameterSource.DEFAULT
                for name in names
            ]
            renderer, against = tuple(named or (entry.name for entry in renderers.best())), ()
            if len(renderer) == 1:
                raise CommandError(f"--all-pairs: {renderer[0]} alone makes no pair", "--renderer A,B names two")
        for name in (*renderer, *against):
            renderers.get(name)
        _check_pairs(renderer, against)
        _check_size(size, no_limits=options["no_limits"])
        loaded = load_scenes(scenes, limits=not options["no_limits"])
        if json_file:
            _parent(json_file)
        page = _page(ctx, report, small=small) if report else None
        with _progress() as progress:
            result = run(
                loaded,
                renderer,
                against,
                passes=passes,
                size=size,
                settings=_settings(options),
                limits=not options["no_limits"],
                verdicts=verdicts,
                on_rendered=page.add if page else None,
                progress=progress,
                all_pairs=all_pairs,
            )
        result.command = command
        print_validation(result, verbose=verbose or len(loaded) == 1)
        if json_file:
            _write_text(json_file, json.dumps(result.record(), indent=1, allow_nan=False) + "\n")
        if page and report:
            click.echo(page.write(report, result))
    ctx.exit(result.status)


def _page(ctx: click.Context, report: Path, *, small: bool = False) -> Report:
    """A report that can be written into that folder."""
    from validation.report.report import Report, ours

    ctx.with_resource(_folder(report))
    place = report / "index.html"
    _parent(place)
    if not ours(place):
        raise CommandError(f"{place} is no report of whitted", "name another folder, or remove that file")
    return Report(small=small)


def _command() -> list[str]:
    """The command as typed, without the folder of the program."""
    return ["whitted", *sys.argv[1:]]


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Show on a terminal what is being drawn."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with console(stderr=True).status("") as status:
        yield status.update


@contextmanager
def _ending() -> Iterator[None]:
    """SIGTERM and SIGHUP end what is done here as Ctrl-C does: other processes first, and nothing is left behind."""

    def end(*_: object) -> None:
        _terminated.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a script may have it ignored
        # Put off like Ctrl-C where that is: so it goes to this thread.
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    ends = (signal.SIGTERM, signal.SIGHUP) if hasattr(signal, "SIGHUP") else (signal.SIGTERM,)
    before = {number: signal.getsignal(number) for number in ends}
    if threading.current_thread() is threading.main_thread():
        for number, handler in before.items():
            if handler == signal.SIG_DFL:  # a script, or nohup, may have it ignored
                signal.signal(number, end)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                signal.signal(number, handler)


def _write_text(path: Path, text: str) -> None:
    from tracer.passes import write_beside

    with write_beside(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@whitted.command()
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...", type=click.Path(path_type=Path))
@click.option(
    "--image",
    "images",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The image (PPM or PNG) of the scene; of several scenes one each, in their order.",
)
@click.option(
    "--command",
    "templates",
    multiple=True,
    metavar="'CMD {scene}'",
    help="A program that draws the scenes: see above; of several each gets a line in a table.",
)
@click.option(
    "--time-limit",
    type=Whole(1, hint="in seconds"),
    default=60,
    show_default=True,
    metavar="S",
    help="Seconds that the program may take for a scene.",
)
@click.option(
    "--memory",
    type=Whole(1, hint="in MiB"),
    default=4096,
    show_default=True,
    metavar="M",
    help="MiB of memory that the program may take.",
)
@click.option("--size", type=Size(), help="With --command: columns and rows instead of the scene's own.")
@drawing_options
@results_options("each image", " Without it no more than 12 where these all come to the same, or than 20 s allow.")
@click.pass_context
def check(
    ctx: click.Context,
    /,
    scenes: tuple[Path, ...],
    images: tuple[Path, ...],
    templates: tuple[str, ...],
    time_limit: int,
    memory: int,
    size: tuple[int, int] | None,
    report: Path | None,
    small: bool,
    json_file: Path | None,
    verdicts: int,
    **options: Any,
) -> None:
    """Check the image that your ray tracer made of a scene: fit its conventions, and judge what is left.

    Programs differ in where a ray goes through its pixel, in what becomes of a colour on its way to a byte, and in the
    order of rows. The convention that explains the most pixels is found first and is no fault; what is left is
    compared, and judged pixel by pixel.

    With --command your program is run for every scene: {scene} is the path of the scene file, {output} the path where
    the image is wanted; without it the file of the field OUTPUT is taken, or else what is printed.

    \b
    whitted check scenes/gallery/shadows.txt --image shadows.ppm
    whitted check scenes/gallery/*.txt --command './mine {scene}' --report out
    whitted check scenes/spec/*.txt --command 'ann/mine {scene}' --command 'bob/mine {scene}' --json all.json

    Exit status: 0 nothing is left, 1 something is or a program did not end well, 2 the input or the command is wrong,
    3 a program failed.
    """  # noqa: D301 - click wants that character, not a backslash
    from validation import renderers
    from validation.check import check, draw_pictures, read_picture, together
    from validation.renderers.command import MEBIBYTE, PREFIX, Limits
    from validation.run import load_scenes, resized
    from validation.terminal import print_check, print_checks

    command, templates = _command(), tuple(dict.fromkeys(templates))
    with _errors("checked"):
        if bool(images) == bool(templates):
            hint = "whitted check SCENE --image FILE, or whitted check SCENE... --command './mine {scene}'"
            what = "--image and --command exclude each other" if images else "expected either --image or --command"
            raise CommandError(what, hint)
        if images and len(images) != len(scenes):
            counts = f"{len(scenes)} scenes" if len(scenes) > 1 else "1 scene"
            raise CommandError(
                f"expected {len(scenes)} --image for {counts}, found {len(images)}", "one each, in order"
            )
        if images and len(set(scenes)) < len(scenes):
            raise CommandError("a scene is named twice", "each scene once, with its image")
        if images and size:
            raise CommandError("--size: an image has the size that it has", "--size goes with --command")
        _check_size(size, no_limits=options["no_limits"])
        # Not folders: images belong to scenes by their order.
        if images and (folder := next((path for path in scenes if path.is_dir()), None)):
            raise CommandError(f"{folder} is a folder, expected a scene file", "name the scenes of the images")
        for template in templates:
            renderers.get(f"{PREFIX}{template}")
        loaded = load_scenes(scenes, limits=not options["no_limits"])
        if size:
            loaded = {label: resized(scene, size) for label, scene in loaded.items()}
        settings = _settings(options | {"sample": "corner"})
        if json_file:
            _parent(json_file)
        page = _page(ctx, report, small=small) if report else None
        with _progress() as progress:
            common: dict[str, Any] = {
                "settings": settings,
                "verdicts": None if ctx.get_parameter_source("verdicts") is ParameterSource.DEFAULT else verdicts,
                "on_rendered": page.add if page else None,
                "progress": progress,
            }
            if images:
                pictures = [
                    read_picture(path, label, scene)
                    for path, (label, scene) in zip(images, loaded.items(), strict=True)
                ]
                name = f"image:{images[0].name}" if len(images) == 1 else "image"
                results = {name: check(pictures, name=name, **common)}
            else:
                limits, results = Limits(seconds=time_limit, memory=memory * MEBIBYTE), {}
                try:
                    for template in templates:
                        drawn, failures = draw_pictures(loaded, template, settings, limits=limits, progress=progress)
                        name = f"{PREFIX}{template}"
                        results[name] = check(drawn, name=name, failures=failures, **common)
                except KeyboardInterrupt:
                    # What is finished is told.
                    if results:
                        print_checks(results)
                    raise
        (first, *others) = results.values()
        result = together(results) if others else first.validation
        result.command = command
        if others:
            print_checks(results)
        else:
            print_check(first)
        if json_file:
            programs = [{"program": name, **entry.record()} for name, entry in results.items()]
            record = {"ok": result.ok, "command": command, "programs": programs} if others else first.record()
            _write_text(json_file, json.dumps(record, indent=1, allow_nan=False) + "\n")
        if page and report:
            click.echo(page.write(report, result))
    ctx.exit(max(entry.status for entry in results.values()))


@whitted.command("renderers")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--missing", is_flag=True, help="Only those that cannot run here, a line each.")
@click.option("--passes", "by_pass", is_flag=True, help="Who delivers which pass, how, and at which precision.")
@click.pass_context
def list_renderers(ctx: click.Context, /, as_json: bool, missing: bool, by_pass: bool) -> None:
    """List the renderers: version, passes, and what to do for those that cannot run here.

    \b
    whitted renderers
    whitted renderers --passes
    """  # noqa: D301 - click wants that character, not a backslash
    from validation import catalogue
    from validation.terminal import print_passes, print_renderers

    with _errors():
        entries, failures = catalogue.renderers()
    if missing:
        entries = [entry for entry in entries if not entry["available"]]
    if as_json:
        click.echo(json.dumps({"renderers": entries, "failures": failures}, indent=1))
    elif by_pass:
        print_passes(entries, failures)
    elif missing:
        for entry in entries:
            click.echo(f"not available: {entry['name']}: {entry['reason']}")
    else:
        print_renderers(entries, failures)
    ctx.exit(0)


@whitted.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE", help=".exr, .npz, .png or .ppm"
)
@click.option("--renderer", default="native-f64", show_default=True, metavar="NAME")
@names_option("--passes", help="Passes to draw; default: beauty for an image, else all.")
@click.option("--size", type=Size(), help="Columns and rows instead of the scene's own.")
@settings_options
def render(
    scene: Path,
    output: Path,
    renderer: str,
    passes: tuple[str, ...] | None,
    size: tuple[int, int] | None,
    **options: Any,
) -> None:
    """Draw the passes of SCENE with one renderer and write them to a file."""
    from fnmatch import fnmatchcase

    from tracer.passes import names
    from validation.run import draw, resized, why_not

    ending = output.suffix.lower()
    with _errors():
        if ending not in (*PASS_FILES, *IMAGES):
            raise CommandError(f"unknown file ending '{ending}' of {output}", "expected .exr, .npz, .png or .ppm")
        _parent(output)
        _check_size(size, no_limits=options["no_limits"])
        loaded = _load(scene, no_limits=options["no_limits"])
        program = _usable(renderer)
        settings = _settings(options)
        loaded = resized(loaded, size, limits=False) if size else loaded
        with _blaming(program):
            delivers = tuple(program.passes(loaded, settings))
        if not delivers:
            why = f": {why_not(program, loaded)}".removesuffix(": ")
            raise CommandError(f"{program.name} cannot carry the scene {scene}{why}", "see `whitted renderers`", FAILED)
        picture = ending in IMAGES
        wanted = passes or (("beauty",) if picture else delivers)
        for name in wanted:
            if "*" not in name and name not in delivers:
                _refuse(name, program.name, delivers, names(len(loaded.lights), settings.max_reflections))
        chosen = [name for name in delivers if any(fnmatchcase(name, pattern) for pattern in wanted)]
        if not chosen:
            raise CommandError(f"{scene} has none of the passes {', '.join(wanted)}", f"it has {', '.join(delivers)}")
        if picture and "beauty" not in chosen:
            raise CommandError(f"{output} would hold the pass 'beauty', which is not asked for", "write .exr or .npz")
        with _blaming(program):
            drawn = draw(program, "<stdin>" if str(scene) == "-" else str(scene), loaded, chosen, settings)
            versions = dict(program.versions())
        drawn.metadata |= {"renderer": program.name, "scene": loaded.text(), "command": shlex.join(_command())}
        drawn.metadata |= {f"version of {key}": value for key, value in versions.items()}
        drawn.save(output)


def _refuse(name: str, program: str, delivers: Sequence[str], known: Sequence[str]) -> NoReturn:
    # Another light or bounce is not what a number beyond the last was meant to be.
    near = [] if _is_pass(name) else difflib.get_close_matches(name, delivers, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"it has {', '.join(delivers)}"
    what = f"{program} has no pass '{name}'" if name in known or _is_pass(name) else f"unknown pass '{name}'"
    raise CommandError(what, hint)


def _is_pass(name: str) -> bool:
    """Whether some scene has a pass of that name."""
    from tracer.passes import lookup

    try:
        lookup(name)
    except ValueError:
        return False
    return True


class OnePixel(click.Command):
    """A command whose negative numbers are pixels, not options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words."""
        for before, word in itertools.pairwise(["", *args]):
            if re.fullmatch(r"-[0-9.]+", word) and not before.startswith("--"):
                raise CommandError(f"'{word}' is no column or row of an image", XY)
        return super().parse_args(ctx, args)


def _nothing_more(_: click.Context, parameter: click.Parameter, value: tuple[str, ...]) -> None:
    del parameter
    if value:
        raise CommandError(f"'{value[0]}' is one word too many", "one pixel at a time: whitted explain SCENE X Y")


@whitted.command(cls=OnePixel)
@click.argument("scene", type=click.Path(path_type=Path))
@click.argument("x", type=Place(hint=XY))
@click.argument("y", type=Place(hint=XY))
@click.argument("more", nargs=-1, metavar="", callback=_nothing_more, expose_value=False)
@names_option(
    "--renderer",
    help="Renderers to hold against truth; default: all. Those that cannot draw the scene, or not soon enough at its "
    "size, are listed as not drawn.",
)
@click.option("--size", type=Size(), help="Columns and rows instead of the scene's own.")
@settings_options
@json_option
@click.pass_context
def explain(
    ctx: click.Context,
    /,
    scene: Path,
    x: int,
    y: int,
    renderer: tuple[str, ...] | None,
    size: tuple[int, int] | None,
    json_file: Path | None,
    **options: Any,
) -> None:
    """Explain one pixel: column X, row Y of SCENE, from 0 at the top left.

    What its ray hits bounce by bounce, which lights reach that and what hides the others, what each term adds: proved,
    not rounded. Then where each renderer first differs from it.

    \b
    whitted explain scenes/gallery/mirrors.txt 200 250
    whitted explain scenes/spec/equal-hits.txt 72 200 --renderer native-f64,mitsuba-spec

    Exit status: 0 explained, 2 the input or the command is wrong, 3 a renderer failed, or none of those asked for draws
    the scene.
    """  # noqa: D301 - click wants that character, not a backslash
    from validation import renderers
    from validation.explain import explain as run
    from validation.explain import small_enough, too_large
    from validation.explain_text import print_explanation
    from validation.run import resized
    from validation.truth import NOWHERE

    with _errors():
        chosen = [renderers.get(name) for name in renderer] if renderer else list(renderers.all())
        _check_size(size, no_limits=options["no_limits"])
        loaded = _load(scene, no_limits=options["no_limits"])
        loaded = resized(loaded, size, limits=False) if size else loaded
        label = "<stdin>" if str(scene) == "-" else str(scene)
        _check_pixels({label: loaded}, ((x, y),), None)
        if json_file:
            _parent(json_file)
        try:
            with _progress() as progress:
                told = run(
                    loaded, x, y, _settings(options), list(dict.fromkeys(chosen)), label=label, progress=progress
                )
        except NOWHERE as error:
            raise CommandError(f"truth could not be had: {error}", "whitted explain another pixel", FAILED) from error
        # That nothing could be drawn is said at the end, once.
        print_explanation(replace(told, notes=()) if renderer and not told.drawn else told)
        if json_file:
            _write_text(json_file, json.dumps(told.record(), indent=1, allow_nan=False) + "\n")
        if renderer and not told.failed and all(entry.reason for entry in told.drawn):
            reasons = [f"{entry.renderer} {entry.reason}" for entry in told.drawn]
            hint = next((entry.hint for entry in told.drawn if entry.hint), "see `whitted renderers`")
            if not told.drawn:
                reasons, hint = [too_large(loaded)], small_enough(loaded, _settings(options), chosen)
            raise CommandError("; ".join(reasons), hint, FAILED)
    ctx.exit(FAILED if told.failed else 0)


@whitted.command()
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE_OR_FOLDER...", type=click.Path(path_type=Path))
@click.option(
    "--pixels",
    type=Count(hint="--pixels 100 takes 100 random pixels of each scene, --pixels all every one"),
    metavar="N|all",
    help="Prove N random pixels of each scene, or all; default: 10, with --renderer 2000. Not with --at.",
)
@click.option(
    "--at",
    type=Place(hint=AT),
    nargs=2,
    multiple=True,
    metavar="X Y",
    help="Prove this pixel: column and row, from 0 at the top left; may be repeated. Not with --pixels or --renderer.",
)
@names_option(
    "--renderer",
    help="Renderers to hold against the proved values; default: none. Not with --at or -o.",
)
@click.option(
    "--edges", type=Whole(), metavar="N", help="With --renderer: N pixels nearest to a decision; default: 500."
)
@click.option("--seed", type=Whole(), default=0, show_default=True, metavar="S", help="Of the random pixels.")
@click.option("--size", type=Size(), help="Columns and rows instead of the scene's own.")
@settings_options
@click.option("--jobs", type=Whole(1, 1024), metavar="N", help="Processes that prove; default: one a core.")
@json_option
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="With --pixels all, not with --renderer: the proved image of one scene, .npz, .exr, .png or .ppm.",
)
@click.pass_context
def truth(
    ctx: click.Context,
    /,
    scenes: tuple[Path, ...],
    pixels: int | None,
    at: tuple[tuple[int, int], ...],
    renderer: tuple[str, ...] | None,
    edges: int | None,
    seed: int,
    size: tuple[int, int] | None,
    jobs: int | None,
    json_file: Path | None,
    output: Path | None,
    **options: Any,
) -> None:
    """Prove what single pixels of scenes are, and hold renderers against that.

    \b
    whitted truth scenes/gallery/mirrors.txt --at 200 150
    whitted truth scenes/spec/one-pixel.txt --pixels all -o proved.npz
    whitted truth scenes --renderer native-f64,native-f32 --pixels 2000 --edges 500

    With --renderer exit status 0 means that all renderers hold what they claim, 1 that some do not, 3 that one failed.
    """  # noqa: D301 - click wants that character, not a backslash
    from validation.certify import EDGES, PIXELS, certify_scenes, print_certification
    from validation.proofs import PROVED, tell
    from validation.run import load_scenes, resized
    from validation.truth import NOWHERE

    command, at = _command(), tuple(dict.fromkeys(at))
    with _errors("certified" if renderer else "proved"):
        _check_truth(scenes, pixels, at, renderer, edges, output)
        _check_size(size, no_limits=options["no_limits"])
        loaded = load_scenes(scenes, limits=not options["no_limits"])
        if size:
            loaded = {label: resized(scene, size, limits=False) for label, scene in loaded.items()}
        _check_pixels(loaded, at, output)
        _check_memory(loaded, pixels, _settings(options), output)
        for file in filter(None, (json_file, output)):
            _parent(file)
        settings, status = _settings(options), 0
        # On a terminal what is printed beside the progress would go where the progress goes.
        lines: Sequence[str] = ()
        try:
            with _progress() as progress:
                common: dict[str, Any] = {"seed": seed, "jobs": jobs, "progress": progress}
                if renderer:
                    common |= {"pixels": pixels or PIXELS, "edges": EDGES if edges is None else edges}
                    result = certify_scenes(loaded, renderer, settings, **common)
                else:
                    common |= {"json_file": json_file, "output": output, "command": command}
                    lines = tell(loaded, at or pixels or PROVED, settings, **common)
        except NOWHERE as error:
            raise CommandError(f"truth could not be had: {error}", "--at proves other pixels", FAILED) from error
        for line in lines:
            click.echo(line)
        if output:
            click.echo(output)
        if renderer:
            result.command, status = command, result.status
            print_certification(result)
            if json_file:
                _write_text(json_file, json.dumps(result.record(), indent=1, allow_nan=False) + "\n")
    ctx.exit(status)


def _check_truth(
    scenes: Sequence[Path],
    pixels: int | None,
    at: tuple[tuple[int, int], ...],
    renderer: tuple[str, ...] | None,
    edges: int | None,
    output: Path | None,
) -> None:
    """Whether the options of `truth` fit each other."""
    from validation import renderers
    from validation.proofs import ALL

    if at and pixels is not None:
        raise CommandError("--at and --pixels exclude each other", "--at names pixels, --pixels takes random ones")
    if renderer:
        if at:
            words = ["whitted", "explain", str(scenes[0]), *map(str, at[0]), "--renderer", ",".join(renderer)]
            raise CommandError("--at is for proving alone", shlex.join(words))
        if output:
            raise CommandError("--output is for proving alone", "leave out --renderer")
        for name in renderer:
            renderers.get(name)
    elif edges is not None:
        raise CommandError("--edges is for holding renderers against the proved values", "--renderer NAME")
    if output:
        if output.suffix.lower() not in (*PASS_FILES, *IMAGES):
            message = f"unknown file ending '{output.suffix.lower()}' of {output}"
            raise CommandError(message, "expected .exr, .npz, .png or .ppm")
        if pixels != ALL:
            raise CommandError(f"{output} would hold a whole image", "--pixels all proves every pixel")


def _check_pixels(scenes: Mapping[str, Scene], at: tuple[tuple[int, int], ...], output: Path | None) -> None:
    """Whether every scene has the pixels that are named."""
    if output and len(scenes) > 1:
        raise CommandError(f"{output} holds one image, but there are {len(scenes)} scenes", "name one scene")
    for label, scene in scenes.items():
        columns, rows = scene.view.columns, scene.view.rows
        for x, y in at:
            if x >= columns or y >= rows:
                hint = f"columns are 0 to {columns - 1} from the left, rows 0 to {rows - 1} from the top"
                raise CommandError(f"{label} has no pixel {x} {y}", hint)


def _check_memory(scenes: Mapping[str, Scene], pixels: int | None, settings: Settings, output: Path | None) -> None:
    """Whether so many pixels, and the image that they become, fit into the memory."""
    from tracer.passes import names
    from validation.run import check_memory

    for label, scene in scenes.items():
        # Of a large share the random choice takes memory for every pixel.
        if output or (pixels and pixels > scene.view.columns * scene.view.rows / 50):
            every = names(len(scene.lights), settings.max_reflections, margins=False)
            check_memory(label, scene, every, fewer="--pixels")


@whitted.command()
@names_option("--ladder", help="Climb these alone; default: all.")
@names_option("--renderer", help="What is under test; default: all that can run here.")
@click.option(
    "--report",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Write curves of error against difficulty: DIR/index.html.",
)
@click.option(
    "--write",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write the scenes of the ladders: DIR/LADDER/*.txt.",
)
@click.option("--fuzz", "scenes", type=Whole(1), metavar="N", help="Draw N random scenes instead.")
@click.option(
    "--seed", type=Whole(), default=0, show_default=True, metavar="S", help="Of --fuzz: the seed of the random scenes."
)
@click.option(
    "--first",
    type=Whole(),
    default=0,
    show_default=True,
    metavar="I",
    help="Of --fuzz: begin with scene I of the seed.",
)
@click.option(
    "--against",
    default="native-f64",
    show_default=True,
    metavar="NAME",
    help="Of --fuzz: what each renderer is compared with.",
)
@click.option(
    "--jobs",
    type=Whole(1, 1024),
    metavar="N",
    help="Processes that draw; default: with --fuzz one a core, else two, as some programs wait; no more than 8.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("fuzz-failures"),
    show_default=True,
    metavar="DIR",
    help="Of --fuzz: where the smallest scene of each kind of failure is kept.",
)
@json_option
@click.pass_context
def stability(
    ctx: click.Context,
    /,
    ladder: tuple[str, ...] | None,
    renderer: tuple[str, ...] | None,
    report: Path | None,
    write: Path | None,
    scenes: int | None,
    seed: int,
    first: int,
    against: str,
    jobs: int | None,
    output: Path,
    json_file: Path | None,
) -> None:
    """Find out how hard a scene may get before a renderer says something wrong that it claims to tell.

    On a ladder one number of a scene climbs by decades: a distance, a flatness, a gap. Every pixel of every rung is
    proved. Printed is the rung on which each renderer first takes a decision wrong above its margin, is off by more
    than its tolerance, or draws NaN or Inf; docs/stability.md says how.

    With --fuzz N, random scenes are drawn instead, each with a theme that is hard, and the smallest scenes are kept
    that show what nothing explains.

    \b
    whitted stability --json stability.json --report stability
    whitted stability --ladder ground,grazing --renderer native-f32 --write rungs
    whitted stability --fuzz 100
    whitted stability --fuzz 1 --seed 7 --first 12 --renderer native-f32,mitsuba-spec

    Exit status: 0 all hold, or everything is explained; 1 one breaks, or something is not; 2 the command is wrong; 3 a
    renderer failed.
    """  # noqa: D301 - click wants that character, not a backslash
    from validation import renderers

    command = _command()
    cores = os.cpu_count() or 1
    result: Campaign | Stability
    with _errors("drawn"):
        _check_parts(ctx, scenes is not None)
        for name in (*(renderer or ()), against):
            renderers.get(name)
        if json_file:
            _parent(json_file)
        if scenes is None:
            result = _climb(ctx, ladder, renderer, report, write, jobs or min(2 * cores, 8), command)
        else:
            result = _fuzz(scenes, seed, first, renderer, against, jobs or min(cores, 8), output, command)
        if json_file:
            _write_text(json_file, json.dumps(result.record(), indent=1, allow_nan=False) + "\n")
    if result.interrupted:
        ctx.exit(TERMINATED if _terminated.is_set() else INTERRUPTED)
    ctx.exit(result.status)


def _check_parts(ctx: click.Context, fuzz: bool) -> None:
    """Ladders and random scenes have options of their own."""
    flags = {"ladder": "--ladder", "report": "--report", "write": "--write"}
    if not fuzz:
        flags = {"seed": "--seed", "first": "--first", "against": "--against", "output": "--output"}
    for name, flag in flags.items():
        if ctx.get_parameter_source(name) is ParameterSource.DEFAULT:
            continue
        if fuzz:
            raise CommandError(f"{flag} is for ladders, --fuzz draws random scenes", f"leave out --fuzz, or {flag}")
        raise CommandError(f"{flag} is for random scenes, which --fuzz N draws", f"--fuzz 100 {flag} ...")


def _fuzz(
    scenes: int,
    seed: int,
    first: int,
    renderer: tuple[str, ...] | None,
    against: str,
    jobs: int,
    output: Path,
    command: Sequence[str],
) -> Campaign:
    """Random scenes."""
    from validation.fuzz import fuzz, print_campaign

    if renderer:
        _check_pairs(renderer, [against])
    if output.exists() and not os.access(output, os.W_OK):
        raise CommandError(f"{output}: cannot be written", "name another folder")
    with _progress() as progress:
        result = fuzz(
            scenes,
            renderer,
            seed=seed,
            first=first,
            reference=against,
            jobs=jobs,
            output=output,
            progress=progress,
            command=command,
        )
    print_campaign(result)
    return result


def _climb(
    ctx: click.Context,
    ladder: tuple[str, ...] | None,
    renderer: tuple[str, ...] | None,
    report: Path | None,
    write: Path | None,
    jobs: int,
    command: Sequence[str],
) -> Stability:
    """Ladders."""
    from validation import ladders
    from validation.curves import ours, write_curves
    from validation.stability import print_stability
    from validation.stability import stability as run

    every = ladders.names()
    for name in ladder or ():
        if name not in every:
            near = difflib.get_close_matches(name, every, n=1)
            hint = (f"did you mean '{near[0]}'? " if near else "") + f"the ladders are {', '.join(every)}"
            raise CommandError(f"unknown ladder '{name}'", hint)
    if report:
        ctx.with_resource(_folder(report))
        _parent(report / "index.html")
        if not ours(report / "index.html"):
            message = f"{report / 'index.html'} has not been written by whitted stability"
            raise CommandError(message, "name another folder, or remove that file")
    with _progress() as progress:
        result = run(ladder, renderer, jobs=jobs, write=write, progress=progress, command=command)
    print_stability(result)
    if report and result.rungs:
        click.echo(write_curves(result, report))
    if write:
        click.echo(write)
    return result


@whitted.command()
@click.argument("scenes", nargs=-1, metavar="[SCENE...]", type=click.Path(path_type=Path))
@names_option(
    "--renderer",
    help="What is measured: native-f64@avx2 (an instruction set), native-f64 (all of them), mitsuba-mesh-5 "
    "(triangles), 'cmd:./mine {scene}'; default: all that can run here.",
)
@click.option("--size", type=Size(), help="Columns and rows; default: the scene's own, but no more than about 400x400.")
@click.option("--threads", type=Threads(), help="0: all. Default: one and all for native code, all for the others.")
@click.option("--rounds", type=Whole(1, 10_000), default=15, show_default=True, metavar="N", help="Turns of pictures.")
@click.option(
    "--seconds",
    type=float,
    default=1.0,
    show_default=True,
    callback=positive,
    metavar="S",
    help="A renderer draws a scene no more (but three times) once its warm pictures have taken so long.",
)
@click.option(
    "--limit",
    type=float,
    default=160.0,
    show_default=True,
    callback=positive,
    metavar="S",
    help="What would begin after so many seconds, shared by the scenes, is left out.",
)
@click.option("--pixels", type=Whole(1), default=400, show_default=True, metavar="N", help="Random pixels to prove.")
@click.option("--edges", type=Whole(), default=50, show_default=True, metavar="N", help="Pixels nearest to a decision.")
@click.option("--kernels", is_flag=True, help="Measure the native kernels as well: about another minute.")
@click.option("-o", "--plot", type=click.Path(path_type=Path), metavar="FILE.svg", help="Write the plot.")
@click.option("--report", type=click.Path(path_type=Path), metavar="DIR", help="Write DIR/index.html.")
@click.option("--no-limits", is_flag=True, help=NO_LIMITS)
@json_option
@click.pass_context
def speed(
    ctx: click.Context,
    /,
    scenes: tuple[Path, ...],
    renderer: tuple[str, ...] | None,
    size: tuple[int, int] | None,
    threads: tuple[int, ...] | None,
    rounds: int,
    seconds: float,
    limit: float,
    pixels: int,
    edges: int,
    kernels: bool,
    plot: Path | None,
    report: Path | None,
    no_limits: bool,
    json_file: Path | None,
) -> None:
    """Measure how quick the renderers are, and how near to the proved values, side by side.

    Without a scene those of the gallery that are meant for it. Times are medians with quartiles of pictures drawn in
    turns. docs/speed.md says how each number is made.

    \b
    whitted speed -o speed.svg
    whitted speed scenes/gallery/mirrors.txt --renderer native-f64,mitsuba-mesh --json speed.json
    whitted speed --renderer native-f32 --kernels

    Exit status: 0 done, 2 the input or the command is wrong, 3 a renderer failed.
    """  # noqa: D301 - click wants that character, not a backslash
    from validation import speed as module
    from validation.run import load_scenes
    from validation.speed_text import print_speed, write_page

    command = _command()
    with _errors("measured"):
        chosen = module.entries(renderer, threads)
        _check_size(size, no_limits=no_limits)
        files = list(scenes) or module.default_scenes()
        if not files:
            missing = ", ".join((*module.SCENES, module.OTHERWISE))
            raise CommandError(f"no scene is named, and here is none of {missing}", "whitted speed SCENE")
        loaded = load_scenes(files, limits=not no_limits)
        if plot and plot.suffix.lower() != ".svg":
            raise CommandError(f"unknown file ending '{plot.suffix}' of {plot}", "expected .svg")
        for file in filter(None, (plot, json_file)):
            _parent(file)
        if report:
            _page(ctx, report)
        with _progress() as progress:
            result = module.speed(
                loaded,
                chosen,
                named=renderer is not None,
                size=size,
                rounds=rounds,
                seconds=seconds,
                limit=limit,
                pixels=pixels,
                edges=edges,
                progress=progress,
            )
            if kernels:
                from validation import speed_kernels

                result.kernels = speed_kernels.kernels(loaded, size=size, progress=progress)
        result.command = command
        print_speed(result)
        if json_file:
            _write_text(json_file, json.dumps(result.record(), indent=1, allow_nan=False) + "\n")
        if plot and module.panels(result):
            from validation.speed_plot import write_plot

            write_plot(plot, module.panels(result), module.caption(result))
            click.echo(plot)
        if report:
            click.echo(write_page(report, result))
    ctx.exit(result.status)


@whitted.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--to", "target", type=click.Choice(["mitsuba", "povray"]), required=True, help="The other program.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE")
@click.option("--sample", type=click.Choice(SAMPLES), default="corner", show_default=True)
@click.option("--max-reflections", type=Whole(0, 100), default=3, show_default=True, metavar="N")
@click.option("--light", type=Whole(), metavar="I", help="Only light I, from 0; default: all.")
@click.option("--stock-only", is_flag=True, help="Refuse a scene that needs plugins which Mitsuba does not come with.")
@click.option("--no-limits", is_flag=True, help=NO_LIMITS)
def convert(
    scene: Path,
    target: str,
    output: Path,
    sample: Any,
    max_reflections: int,
    light: int | None,
    stock_only: bool,
    no_limits: bool,
) -> None:
    """Write SCENE as a scene of another program. The head of the file says how to render it."""
    with _errors():
        _parent(output)
        loaded = _load(scene, no_limits=no_limits)
        if light is not None and light >= len(loaded.lights):
            raise CommandError(f"{scene} has no light {light}", f"it has {len(loaded.lights)}, counted from 0")
        if target == "povray":
            # All that it needs is stock.
            from converters.povray import CannotSayError, write_pov

            try:
                write_pov(loaded, output, sample=sample, max_reflections=max_reflections, light=light)
            except CannotSayError as error:
                raise CommandError(f"{scene}: {error}", "docs/tolerances.md says what POV-Ray's limits are") from error
            return
        from converters.mitsuba import StockError, write_xml

        options = {"sample": sample, "max_reflections": max_reflections, "light": light, "stock_only": stock_only}
        try:
            write_xml(loaded, output, **options)
        except StockError as error:
            message = str(error).replace("light=INDEX", "--light INDEX")
            raise CommandError(f"{scene}: {message}", "without --stock-only the file uses plugins of ours") from error


@whitted.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@names_option("--passes", help="Passes to compare; default: all that both files have.")
@click.option(
    "--tolerance",
    type=float,
    default=0.0,
    show_default=True,
    callback=positive,
    metavar="T",
    help="Largest difference that counts as equal.",
)
@json_option
@click.pass_context
def compare(
    ctx: click.Context, /, a: Path, b: Path, passes: tuple[str, ...] | None, tolerance: float, json_file: Path | None
) -> None:
    """Compare two files of passes (.exr, .npz) or two images (.png, .ppm; values are levels
    from 0 to the maximum of the file).

    Exit status: 0 equal, 1 different, 2 the input or the command is wrong.
    """
    from fnmatch import fnmatchcase

    from validation.compare import compare_plain

    with _errors():
        if json_file:
            _parent(json_file)
        first, second = _read(a), _read(b)
        images = [path.suffix.lower() in IMAGES for path in (a, b)]
        if images[0] != images[1]:
            hint = "compare two files of passes (.exr, .npz) or two images (.png, .ppm)"
            steps = first.metadata["levels"] if images[0] else second.metadata["levels"]
            image = "an 8-bit image" if steps == "255" else f"an image of levels up to {steps}"
            raise CommandError(f"{a} and {b}: one holds passes, the other is {image}", hint)
        most = [side.metadata["levels"] for side in (first, second) if images[0]]
        if len(set(most)) > 1:
            message = f"{a} has levels from 0 to {most[0]}, {b} from 0 to {most[1]}: they cannot be compared"
            raise CommandError(message, "write both with the same maximum, or compare float files (.exr, .npz)")
        both = [name for name in first if name in second]
        for name in passes or ():
            for path, side in ((a, first), (b, second)):
                if not any(fnmatchcase(have, name) for have in side):
                    _refuse(name, str(path), list(side), [*first, *second])
        if not both:
            raise CommandError(f"{a} and {b} have no pass in common", f"{', '.join(first)} and {', '.join(second)}")
        chosen = [name for name in both if not passes or any(fnmatchcase(name, wanted) for wanted in passes)]
        if not chosen:
            raise CommandError(f"{a} and {b} have none of {', '.join(passes or ())} in common", f"{', '.join(both)}")
        labels = {"renderer": str(a), "reference": str(b)}
        found = [compare_plain(first, second, name, tolerance, visual=not images[0], **labels) for name in chosen]
        equal = all(comparison.ok for comparison in found)
        if first.shape == second.shape:
            print_comparisons(found, levels=images[0])
        else:
            sizes = [f"{path} is {side.shape[1]}x{side.shape[0]}" for path, side in ((a, first), (b, second))]
            click.echo(f"DIFFERENT: {', '.join(sizes)} pixels: no pixel was compared")
        alone = [name for name in [*first, *second] if name not in both]
        if alone and not passes:
            click.echo(f"note: only in one of the two, not compared: {', '.join(alone)}")
        if json_file:
            record = {"ok": equal, "comparisons": [comparison.record() for comparison in found]}
            _write_text(json_file, json.dumps(record, indent=1, allow_nan=False) + "\n")
    ctx.exit(0 if equal else DIFFERENT)


def _read(path: Path) -> Passes:
    """A file of passes; an image becomes its levels under the name `beauty`, their number above 0 in the metadata."""
    import numpy as np

    from tracer.passes import Passes
    from validation.images import ImageError, decode, ppm_size

    ending = path.suffix.lower()
    try:
        if ending in PASS_FILES:
            return Passes.load(path)
        if ending not in IMAGES:
            raise CommandError(f"{path}: unknown file ending '{ending}'", "expected .exr, .npz, .png or .ppm")
        from PIL import Image

        deep = _bits(path)
        if deep > 8 and ending == ".ppm":
            data = path.read_bytes()
            found = decode(data, ppm_size(data))
            return Passes({"beauty": found.levels.astype(np.float64)}, {"levels": str(found.steps)})
        if deep > 8:
            hint = "compare float files (.exr, .npz), or convert it to a PPM or to 8 bits"
            raise CommandError(f"{path}: an image of {deep} bits a channel, expected 8", hint)
        with Image.open(path) as image:
            if image.mode not in ("RGB", "RGBA", "L", "P", "1", "LA"):
                raise CommandError(f"{path}: an image of mode {image.mode}, expected 8 bits a channel")
            levels = np.asarray(image.convert("RGB")).astype(np.float64)
            return Passes({"beauty": levels}, {"levels": "255"})
    except CommandError:
        raise
    except FileNotFoundError as error:
        raise CommandError(f"{path}: no such file") from error
    except ImageError as error:
        raise CommandError(f"{path}: {error.message}", error.hint) from error
    except (ValueError, SyntaxError) as error:
        text = str(error)
        raise CommandError(text if str(path) in text else f"{path}: {text}") from error
    except OSError as error:
        raise CommandError(f"{path}: {error.strerror or 'not a readable image'}") from error


def _bits(path: Path) -> int:
    """Bits a channel of a PNG or PPM file, which Pillow would reduce to 8 without a word; 0: neither."""
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return head[24] if len(head) > 24 else 0
    words = re.sub(rb"#[^\n]*", b"", head).split(maxsplit=4)
    if len(words) > 3 and re.fullmatch(rb"P[2356]", words[0]) and words[3].isdigit():
        return int(words[3][:9]).bit_length()
    return 0


if __name__ == "__main__":
    main()
