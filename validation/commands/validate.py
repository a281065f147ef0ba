"""`whitted validate`: renderers side by side on scenes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from validation.commands.errors import CommandError, errors
from validation.commands.help import Command
from validation.commands.inputs import check_flip, check_pairs, check_pass_names, check_size, settings_of
from validation.commands.outputs import command_line, progressing, summing
from validation.commands.results import Outputs, Results
from validation.options import Size, loudness_options, names_option, results_options, settings_options, verbose
from validation.terminal import print_validation

if TYPE_CHECKING:
    from validation.run import Validation


@click.command(
    cls=Command,
    short_help="Compare renderers on scenes, and judge where they differ.",
    examples=[
        "whitted validate scenes/gallery/mirrors.txt --size 100x100 --report report",
        "whitted validate scenes/gallery --size 40x40 --renderer native-f64,native-f32 --against numpy-f64",
        "whitted validate scenes/gallery/shadows.txt --size 50x50 --all-pairs --renderer native-f64,numpy-f64",
        "whitted validate scenes/spec/one-pixel.txt --against numpy-f64 -q --junit junit.xml --markdown summary.md",
    ],
    statuses={
        0: "all agree",
        1: "some differ, or a difference is not explained",
        3: "a renderer failed, or nothing could be compared",
    },
)
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE_OR_FOLDER...", type=click.Path(path_type=Path))
@names_option("--renderer", default=["native-f64"], show_default=True, help="What is under test.")
@names_option("--against", default=["mitsuba-spec"], show_default=True, help="What it is compared with.")
@click.option(
    "--all-pairs",
    is_flag=True,
    help="Compare every pair, of the renderers named or of all that can run here: who stands alone?",
)
@names_option("--passes", help="Passes to compare, for example beauty,shadow.L*; default: all.")
@click.option("--flip", is_flag=True, help="Measure FLIP of beauty, and show it: pip install 'whitted[flip]'.")
@click.option("--size", type=Size(), help="Columns and rows; default: the scene's own.")
@settings_options
@results_options("each scene and pair")
@loudness_options(louder="A row for every pass, as a single scene has anyway; on stderr what is being done.")
@click.pass_context
def validate(
    ctx: click.Context,
    /,
    scenes: tuple[Path, ...],
    renderer: tuple[str, ...],
    against: tuple[str, ...],
    all_pairs: bool,
    passes: tuple[str, ...] | None,
    flip: bool,
    size: tuple[int, int] | None,
    verdicts: int,
    **options: Any,
) -> None:
    """Compare renderers on scene files and on all scenes (*.txt) below folders, and judge where they differ."""
    from validation import renderers
    from validation.run import load_scenes
    from validation.run import validate as run

    command, outputs = command_line(), Outputs.of(options)
    with errors():
        check_flip(wanted=flip)
        check_pass_names(passes or ())
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
        check_pairs(renderer, against)
        check_size(size, no_limits=options["no_limits"])
        loaded = load_scenes(scenes, limits=not options["no_limits"])
        results = Results(ctx, command, outputs)

        def tell(result: Validation) -> None:
            with summing():
                print_validation(result, verbose=verbose() or len(loaded) == 1)

        with results.keeping(tell), progressing() as progress:
            result = run(
                loaded,
                renderer,
                against,
                passes=passes,
                size=size,
                settings=settings_of(options),
                limits=not options["no_limits"],
                verdicts=verdicts,
                on_rendered=results.page.add if results.page else None,
                progress=progress,
                all_pairs=all_pairs,
                on_scene=results.scene,
                flip=flip,
            )
        result.command = command
        results.finish(result, tell)
    ctx.exit(result.status)
