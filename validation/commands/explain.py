"""`whitted explain`: the story of one pixel."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from validation import records
from validation.commands.errors import FAILED, CommandError, errors
from validation.commands.help import Command
from validation.commands.inputs import check_pixels, check_size, load_scene, settings_of
from validation.commands.outputs import command_line, progressing, writable
from validation.options import QUANTISATIONS, Place, Size, json_option, loudness_options, names_option, settings_options

#: How a pixel is named.
XY = "one scene, then a column and a row, from 0 at the top left: whitted explain SCENE X Y"


class OnePixel(Command):
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


@click.command(
    cls=OnePixel,
    short_help="Tell the story of one pixel.",
    examples=[
        "whitted explain scenes/gallery/mirrors.txt 200 250 --renderer native-f64,native-f32",
        "whitted explain scenes/spec/mirror-corridor.txt 180 205 --renderer numpy-f64 --json pixel.json",
    ],
    statuses={0: "explained", 3: "a renderer failed, or none of those asked for draws the scene"},
)
@click.argument("scene", type=click.Path(path_type=Path))
@click.argument("x", type=Place(hint=XY))
@click.argument("y", type=Place(hint=XY))
@click.argument("more", nargs=-1, metavar="", callback=_nothing_more, expose_value=False)
@names_option(
    "--renderer",
    help="Renderers to hold against truth; default: all. Those that cannot draw the scene, or not soon enough at its "
    "size, are listed as not drawn.",
)
@click.option("--size", type=Size(), help="Columns and rows; default: the scene's own.")
@click.option(
    "--quantisation",
    type=click.Choice(QUANTISATIONS),
    default="truncate",
    show_default=True,
    help="How programs (cmd:...) make a colour a byte, as `whitted check` finds it.",
)
@click.option("--flipped", is_flag=True, help="The first row of the images of programs is the lowest.")
@settings_options
@json_option
@loudness_options(quieter="No progress.")
@click.pass_context
def explain(
    ctx: click.Context,
    /,
    scene: Path,
    x: int,
    y: int,
    renderer: tuple[str, ...] | None,
    size: tuple[int, int] | None,
    quantisation: str,
    flipped: bool,
    json_file: Path | None,
    **options: Any,
) -> None:
    """Explain one pixel: column X, row Y of SCENE, from 0 at the top left.

    What its ray hits bounce by bounce, which lights reach that and what hides the others, what each term adds: proved,
    not rounded. Then where each renderer first differs from it.
    """
    from validation import renderers
    from validation.explain import explain as run
    from validation.explain import small_enough, too_large
    from validation.explain_text import print_explanation
    from validation.renderers.command import Command as Program
    from validation.run import resized
    from validation.truth import NOWHERE

    with errors():
        chosen = [renderers.get(name) for name in renderer] if renderer else list(renderers.all())
        for one in chosen:
            if isinstance(one, Program):
                one.encoding, one.flipped = replace(one.encoding, quantisation=quantisation), flipped
        check_size(size, no_limits=options["no_limits"])
        loaded = load_scene(scene, no_limits=options["no_limits"])
        loaded = resized(loaded, size, limits=False) if size else loaded
        label = "<stdin>" if str(scene) == "-" else str(scene)
        check_pixels({label: loaded}, ((x, y),), None)
        if json_file:
            writable(json_file)
        try:
            with progressing() as progress:
                told = run(
                    loaded,
                    x,
                    y,
                    settings_of(options),
                    list(dict.fromkeys(chosen)),
                    label=label,
                    progress=progress,
                    command=command_line(),
                )
        except NOWHERE as error:
            raise CommandError(f"truth could not be had: {error}", "whitted explain another pixel", FAILED) from error
        # That nothing could be drawn is said at the end, once.
        print_explanation(replace(told, notes=()) if renderer and not told.drawn else told)
        if json_file:
            records.write(json_file, told.record())
        if renderer and not told.failed and all(entry.reason for entry in told.drawn):
            reasons = [f"{entry.renderer} {entry.reason}" for entry in told.drawn]
            hint = next((entry.hint for entry in told.drawn if entry.hint), "see `whitted renderers`")
            if not told.drawn:
                reasons, hint = [too_large(loaded)], small_enough(loaded, settings_of(options), chosen)
            raise CommandError("; ".join(reasons), hint, FAILED)
    ctx.exit(FAILED if told.failed else 0)
