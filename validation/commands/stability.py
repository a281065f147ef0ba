"""`whitted stability`: ladders and random scenes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from validation import records
from validation.commands.errors import CommandError, errors, kept, nothing_kept
from validation.commands.help import Command
from validation.commands.inputs import check_pairs
from validation.commands.outputs import (
    check_open,
    command_line,
    folder,
    open_page,
    progressing,
    summing,
    writable,
)
from validation.options import Whole, json_option, loudness_options, names_option, open_option

if TYPE_CHECKING:
    from validation.fuzz import Campaign
    from validation.stability import Stability


@click.command(
    cls=Command,
    short_help="Find out how hard a scene may get.",
    examples=[
        "whitted stability --ladder speck,mirrors --renderer native-f64,native-f32 --report curves",
        "whitted stability --ladder speck --renderer native-f32 --write rungs --json stability.json",
        "whitted stability --fuzz 2 --renderer numpy-f64 --seed 6",
    ],
    statuses={
        0: "all hold, or everything is explained",
        1: "one breaks, or something is not explained",
        3: "a renderer failed",
    },
)
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
@open_option
@json_option
@loudness_options()
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
    open_report: bool,
    json_file: Path | None,
) -> None:
    """Find out how hard a scene may get before a renderer says something wrong that it claims to tell.

    On a ladder one number of a scene climbs by decades: a distance, a flatness, a gap. Every pixel of every rung is
    proved. Printed is the rung on which each renderer first takes a decision wrong above its margin, is off by more
    than its tolerance, or draws NaN or Inf; docs/stability.md says how.

    With --fuzz N, random scenes are drawn instead, each with a theme that is hard, and the smallest scenes are kept
    that show what nothing explains.
    """
    from validation import renderers

    command = command_line()
    cores = os.cpu_count() or 1
    result: Campaign | Stability
    with errors("drawn"):
        _check_parts(ctx, scenes is not None)
        for name in (*(renderer or ()), against):
            renderers.get(name)
        check_open(report, wanted=open_report)
        if json_file:
            writable(json_file)
        with nothing_kept(json_file, report):
            if scenes is None:
                result = _climb(ctx, ladder, renderer, report, write, jobs or min(2 * cores, 8), command)
            else:
                result = _fuzz(scenes, seed, first, renderer, against, jobs or min(cores, 8), output, command)
        if json_file:
            records.write(json_file, result.record())
    if result.interrupted:
        written = report / "index.html" if report else None
        raise kept((json_file, written), result.progress)
    if open_report and report:
        open_page(report / "index.html")
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
        check_pairs(renderer, [against])
    with folder(output, "--output"):  # it is made where there is something to keep
        pass
    with progressing() as progress:
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
    with summing():
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
    from tracer.near import near
    from validation import ladders
    from validation.curves import ours, write_curves
    from validation.stability import print_stability
    from validation.stability import stability as run

    every = ladders.names()
    for name in ladder or ():
        if name not in every:
            meant = near(name, every)
            hint = f"did you mean '{meant}'?" if meant else f"the ladders are {', '.join(every)}"
            raise CommandError(f"unknown ladder '{name}'", hint)
    if report:
        ctx.with_resource(folder(report))
        writable(report / "index.html")
        if not ours(report / "index.html"):
            message = f"{report / 'index.html'} has not been written by whitted stability"
            raise CommandError(message, "name another folder, or remove that file")
    with progressing() as progress:
        result = run(ladder, renderer, jobs=jobs, write=write, progress=progress, command=command)
    with summing():
        print_stability(result)
    if report and result.rungs:
        click.echo(write_curves(result, report))
    if write:
        click.echo(write)
    return result
