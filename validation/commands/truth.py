"""`whitted truth`: proved pixels, and renderers held against them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from validation import records
from validation.commands.errors import AT, FAILED, CommandError, errors, kept, nothing_kept
from validation.commands.help import Command
from validation.commands.inputs import IMAGES, PASS_FILES, check_pixels, check_size, settings_of
from validation.commands.outputs import command_line, progressing, summing, writable
from validation.options import Count, Place, Size, Whole, json_option, loudness_options, names_option, settings_options

if TYPE_CHECKING:
    from tracer import Scene
    from validation.renderers import Settings


@click.command(
    cls=Command,
    short_help="Prove pixels, and hold renderers against them.",
    examples=[
        "whitted truth scenes/gallery/mirrors.txt --at 200 150",
        "whitted truth scenes/spec/one-pixel.txt --pixels all -o proved.npz",
        "whitted truth scenes/spec/touching-spheres.txt --renderer native-f64,native-f32 --pixels 200 --edges 50",
    ],
    statuses={
        0: "proved; with --renderer: all hold what they claim",
        1: "a renderer does not hold what it claims",
        3: "a renderer failed, or truth could not be had",
    },
)
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
@click.option("--size", type=Size(), help="Columns and rows; default: the scene's own.")
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
@loudness_options(quieter="No progress; with --renderer, of the results the last line alone.")
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
    """Prove what single pixels of scenes are, and hold renderers against that."""
    from validation.certify import EDGES, PIXELS, certify_scenes, print_certification
    from validation.proofs import PROVED, tell
    from validation.run import load_scenes, resized
    from validation.truth import NOWHERE

    command, at = command_line(), tuple(dict.fromkeys(at))
    with errors("certified" if renderer else "proved"):
        _check_truth(scenes, pixels, at, renderer, edges, output)
        check_size(size, no_limits=options["no_limits"])
        loaded = load_scenes(scenes, limits=not options["no_limits"])
        if size:
            loaded = {label: resized(scene, size, limits=False) for label, scene in loaded.items()}
        check_pixels(loaded, at, output)
        _check_memory(loaded, pixels, settings_of(options), output)
        for file in filter(None, (json_file, output)):
            writable(file)
        settings, status = settings_of(options), 0
        try:
            with nothing_kept(json_file, output), progressing() as progress:
                common: dict[str, Any] = {"seed": seed, "jobs": jobs, "progress": progress}
                if renderer:
                    common |= {"pixels": pixels or PIXELS, "edges": EDGES if edges is None else edges}
                    result = certify_scenes(loaded, renderer, settings, **common)
                else:
                    common |= {"json_file": json_file, "output": output, "command": command}
                    told = tell(loaded, at or pixels or PROVED, settings, **common)
        except NOWHERE as error:
            raise CommandError(f"truth could not be had: {error}", "--at proves other pixels", FAILED) from error
        # On a terminal what is printed beside the progress would go where the progress goes.
        if renderer:
            result.command, status = command, result.status
            # Written before anything is printed: who reads that may have gone, which ends the program.
            if json_file:
                records.write(json_file, result.record())
            with summing():
                print_certification(result)
            if result.interrupted:
                raise kept([json_file], result.progress)
        else:
            for line in told.lines:
                click.echo(line)
            if told.interrupted:
                lost = f"; {output} is not written, as it would lack the others" if output else ""
                raise kept(told.files, told.progress + lost)
            if output:
                click.echo(output)
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


def _check_memory(scenes: Mapping[str, Scene], pixels: int | None, settings: Settings, output: Path | None) -> None:
    """Whether so many pixels, and the image that they become, fit into the memory."""
    from tracer.passes import names
    from validation.run import check_memory

    for label, scene in scenes.items():
        # Of a large share the random choice takes memory for every pixel.
        if output or (pixels and pixels > scene.view.columns * scene.view.rows / 50):
            every = names(len(scene.lights), settings.max_reflections, margins=False)
            check_memory(label, scene, every, fewer="--pixels")
