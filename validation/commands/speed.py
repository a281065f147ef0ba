"""`whitted speed`: what a picture costs."""

from __future__ import annotations

from pathlib import Path

import click

from validation import records
from validation.commands.errors import CommandError, errors, kept, nothing_kept
from validation.commands.help import Command
from validation.commands.inputs import check_size
from validation.commands.outputs import (
    check_open,
    command_line,
    open_page,
    page_in,
    progressing,
    summing,
    writable,
)
from validation.options import (
    NO_LIMITS,
    Size,
    Threads,
    Whole,
    json_option,
    loudness_options,
    names_option,
    open_option,
    positive,
)
from validation.terminal import counted

#: Seconds that --kernels takes about: of --limit so much is kept for it, or half.
KERNELS = 60.0


@click.command(
    cls=Command,
    short_help="Measure what a picture costs.",
    examples=[
        "whitted speed scenes/gallery/shadows.txt --size 64x64 --renderer native-f64 --seconds 0.1 -o speed.svg",
        "whitted speed scenes/spec/diffuse-only.txt --size 64x64 --renderer native-f32 --seconds 0.1 --json speed.json",
    ],
    statuses={0: "measured", 3: "a renderer failed"},
)
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
@open_option
@json_option
@loudness_options()
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
    open_report: bool,
    json_file: Path | None,
) -> None:
    """Measure how quick the renderers are, and how near to the proved values, side by side.

    Without a scene those of the gallery that are meant for it. Times are medians with quartiles of pictures drawn in
    turns. docs/speed.md says how each number is made.
    """
    from validation import speed as module
    from validation.run import Note, load_scenes
    from validation.speed_text import print_speed, write_page

    command = command_line()
    with errors("measured"):
        check_open(report, wanted=open_report)
        chosen = module.entries(renderer, threads)
        check_size(size, no_limits=no_limits)
        files = list(scenes) or module.default_scenes()
        if not files:
            missing = ", ".join((*module.SCENES, module.OTHERWISE))
            raise CommandError(f"no scene is named, and here is none of {missing}", "whitted speed SCENE")
        loaded = load_scenes(files, limits=not no_limits)
        if plot and plot.suffix.lower() != ".svg":
            raise CommandError(f"unknown file ending '{plot.suffix}' of {plot}", "expected .svg")
        for file in filter(None, (plot, json_file)):
            writable(file)
        if report:
            page_in(ctx, report)
        with nothing_kept(json_file, plot, report), progressing() as progress:
            result = module.speed(
                loaded,
                chosen,
                named=renderer is not None,
                size=size,
                rounds=rounds,
                seconds=seconds,
                limit=limit - min(KERNELS, limit / 2) if kernels else limit,
                pixels=pixels,
                edges=edges,
                progress=progress,
            )
            result.options["limit"] = limit
            if kernels and not result.interrupted:
                from validation import speed_kernels

                rest = limit - result.seconds
                result.kernels = speed_kernels.kernels(loaded, size=size, limit=rest, progress=progress)
                result.interrupted = result.kernels.interrupted
        for count in threads or ():
            if count > (most := len(module.processors())):
                note = f"--threads {count}: here are {counted(most, 'processor')}, so {most} it is"
                result.left_out.append(Note("", "", note))
        result.command = command
        # Written before anything is printed: who reads that may have gone, which ends the program.
        if json_file:
            records.write(json_file, result.record())
        plotted, page = plot if module.panels(result) else None, None
        if plotted:
            from validation.speed_plot import write_plot

            write_plot(plotted, module.panels(result), module.caption(result))
        if report:
            page = write_page(report, result)
        with summing():
            print_speed(result)
        for path in filter(None, (plotted, page)):
            click.echo(path)
        if result.interrupted:
            raise kept((json_file, plotted, page), result.progress)
        if page and open_report:
            open_page(page)
    ctx.exit(result.status)
