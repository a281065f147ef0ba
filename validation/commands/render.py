"""`whitted render`: the passes of one renderer in a file."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click

from validation.commands.errors import FAILED, CommandError, blaming, errors
from validation.commands.help import Command
from validation.commands.inputs import IMAGES, PASS_FILES, check_size, load_scene, refuse_pass, settings_of, usable
from validation.commands.outputs import command_line, progressing, writable
from validation.options import Size, loudness_options, names_option, settings_options


@click.command(
    cls=Command,
    short_help="Draw passes with one renderer into a file.",
    examples=[
        "whitted render scenes/gallery/lantern.txt -o lantern.png",
        "whitted render scenes/gallery/lantern.txt -o lantern.exr --passes 'beauty,depth,reflection*'",
        "whitted render scenes/gallery/lantern.txt -o numpy.npz --renderer numpy-f64 --size 100x100",
    ],
    statuses={0: "the file was written", 3: "the renderer failed, or cannot draw the scene"},
)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE", help=".exr, .npz, .png or .ppm"
)
@click.option(
    "--renderer", default="native-f64", show_default=True, metavar="NAME", help="What draws; see `whitted renderers`."
)
@names_option("--passes", help="Passes to draw; default: beauty for an image, else all.")
@click.option("--size", type=Size(), help="Columns and rows; default: the scene's own.")
@settings_options
@loudness_options(quieter="No progress.")
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
    with errors():
        if ending not in (*PASS_FILES, *IMAGES):
            raise CommandError(f"unknown file ending '{ending}' of {output}", "expected .exr, .npz, .png or .ppm")
        writable(output)
        check_size(size, no_limits=options["no_limits"])
        loaded = load_scene(scene, no_limits=options["no_limits"])
        program = usable(renderer)
        settings = settings_of(options)
        loaded = resized(loaded, size, limits=False) if size else loaded
        with blaming(program):
            delivers = tuple(program.passes(loaded, settings))
        if not delivers:
            why = f": {why_not(program, loaded)}".removesuffix(": ")
            raise CommandError(f"{program.name} cannot carry the scene {scene}{why}", "see `whitted renderers`", FAILED)
        picture = ending in IMAGES
        wanted = passes or (("beauty",) if picture else delivers)
        for name in wanted:
            if "*" not in name and name not in delivers:
                refuse_pass(name, program.name, delivers, names(len(loaded.lights), settings.max_reflections))
        chosen = [name for name in delivers if any(fnmatchcase(name, pattern) for pattern in wanted)]
        if not chosen:
            raise CommandError(f"{scene} has none of the passes {', '.join(wanted)}", f"it has {', '.join(delivers)}")
        if picture and "beauty" not in chosen:
            raise CommandError(f"{output} would hold the pass 'beauty', which is not asked for", "write .exr or .npz")
        label = "<stdin>" if str(scene) == "-" else str(scene)
        with progressing() as progress, blaming(program):
            progress(f"{label}: {program.name}")
            drawn = draw(program, label, loaded, chosen, settings)
            versions = dict(program.versions())
        drawn.metadata |= {"renderer": program.name, "scene": loaded.text(), "command": shlex.join(command_line())}
        drawn.metadata |= {f"version of {key}": value for key, value in versions.items()}
        drawn.save(output)
