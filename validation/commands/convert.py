"""`whitted convert`: scenes of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from validation.commands.errors import CommandError, errors
from validation.commands.help import Command
from validation.commands.inputs import load_scene
from validation.commands.outputs import writable
from validation.options import NO_LIMITS, SAMPLES, Whole


@click.command(
    cls=Command,
    short_help="Write a scene for Mitsuba or POV-Ray.",
    examples=[
        "whitted convert scenes/spec/diffuse-only.txt --to mitsuba -o diffuse-only.xml",
        "whitted convert scenes/gallery/mirrors.txt --to povray -o mirrors.pov --light 0",
    ],
    statuses={0: "the file was written"},
)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--to", "target", type=click.Choice(["mitsuba", "povray"]), required=True, help="The other program.")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE", help="The scene to write."
)
@click.option(
    "--sample",
    type=click.Choice(SAMPLES),
    default="corner",
    show_default=True,
    help="Where in its pixel a ray goes through.",
)
@click.option(
    "--max-reflections",
    type=Whole(0, 100),
    default=3,
    show_default=True,
    metavar="N",
    help="Reflected rays in a chain.",
)
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
    with errors():
        writable(output)
        loaded = load_scene(scene, no_limits=no_limits)
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
