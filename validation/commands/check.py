"""`whitted check`: the image of somebody's ray tracer."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from validation import records
from validation.commands.errors import CommandError, errors
from validation.commands.help import Command
from validation.commands.inputs import check_size, settings_of
from validation.commands.outputs import command_line, progressing, summing
from validation.commands.results import Outputs, Results
from validation.options import Size, Whole, drawing_options, loudness_options, results_options

if TYPE_CHECKING:
    from validation.check import Checked
    from validation.run import Validation


@click.command(
    cls=Command,
    short_help="Check the image that your own ray tracer made.",
    examples=[
        "raytrace scenes/gallery/shadows.txt -o mine.ppm --sample center",
        "whitted check scenes/gallery/shadows.txt --image mine.ppm",
        "whitted check scenes/spec/diffuse-only.txt --command 'raytrace {scene}' --report report",
        "whitted check scenes/spec/one-pixel.txt scenes/spec/diffuse-only.txt --command 'raytrace {scene} -o {output}'",
    ],
    statuses={
        0: "nothing is left, every pixel is explained",
        1: "something is left, or a program did not end well",
        3: "a program failed",
    },
)
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
@results_options(
    "each image",
    " Default: 100; 24 where these come to nothing that is known, 12 where all to one mistake, or what 20 s allow.",
)
@loudness_options()
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
    verdicts: int,
    **options: Any,
) -> None:
    """Check the image that your ray tracer made of a scene: fit its conventions, and judge what is left.

    Programs differ in where a ray goes through its pixel, in what becomes of a colour on its way to a byte, and in the
    order of rows. The convention that explains the most pixels is found first and is no fault; what is left is
    compared, and judged pixel by pixel.

    With --command your program is run for every scene: {scene} is the path of the scene file, {output} the path where
    the image is wanted; without it the file of the field OUTPUT is taken, or else what is printed.
    """
    from validation import renderers
    from validation.check import check, draw_pictures, read_pictures
    from validation.renderers.command import MEBIBYTE, PREFIX, Limits
    from validation.run import load_scenes, resized
    from validation.terminal import print_check, print_checks

    command, outputs, templates = command_line(), Outputs.of(options), tuple(dict.fromkeys(templates))
    with errors("checked"):
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
        check_size(size, no_limits=options["no_limits"])
        # Not folders: images belong to scenes by their order.
        if images and (folder := next((path for path in scenes if path.is_dir()), None)):
            raise CommandError(f"{folder} is a folder, expected a scene file", "name the scenes of the images")
        for template in templates:
            try:
                renderers.get(f"{PREFIX}{template}")
            except renderers.RendererNameError as error:
                raise CommandError(f"--command: {error}", error.hint.replace(PREFIX, "")) from error
        loaded = load_scenes(scenes, limits=not options["no_limits"])
        if size:
            loaded = {label: resized(scene, size) for label, scene in loaded.items()}
        settings = settings_of(options | {"sample": "corner"})
        files = Results(ctx, command, outputs)
        results: dict[str, Checked] = {}

        def tell(_: Validation) -> None:
            with summing():
                if len(results) > 1:
                    print_checks(results)
                else:
                    print_check(*results.values())

        def so_far(checked: Checked) -> None:
            results[name] = checked
            files.scene(checked.validation, checked.record)

        with files.keeping(tell), progressing() as progress:
            common: dict[str, Any] = {
                "settings": settings,
                "verdicts": None if ctx.get_parameter_source("verdicts") is ParameterSource.DEFAULT else verdicts,
                "on_rendered": files.page.add if files.page else None,
                "progress": progress,
                # Of several programs each is a part.
                "on_scene": so_far if len(templates) < 2 else None,
            }
            if images:
                pictures = read_pictures(images, loaded)
                name = f"image:{images[0].name}" if len(images) == 1 else "image"
                results[name] = check(pictures, name=name, **common)
            limits = Limits(seconds=time_limit, memory=memory * MEBIBYTE)
            for place, template in enumerate(templates):
                drawn, failures = draw_pictures(loaded, template, settings, limits=limits, progress=progress)
                name = f"{PREFIX}{template}"
                results[name] = check(drawn, name=name, failures=failures, **common)
                if len(templates) > 1:
                    result, record = _together(results, command, templates[place + 1 :])
                    files.scene(result, functools.partial(dict, record))
        result, record = _together(results, command)
        files.finish(result, tell, record)
    ctx.exit(max(entry.status for entry in results.values()))


def _together(
    results: Mapping[str, Checked], command: Sequence[str], unfinished: Sequence[str] = ()
) -> tuple[Validation, dict[str, Any]]:
    """What came out of all programs: for the report, and for the result file; `unfinished`: those to come."""
    from validation.check import together

    (first, *others) = results.values()
    if not others and not unfinished:
        first.validation.command = command
        return first.validation, first.record()
    result = together(results)
    result.command, result.parts = command, "program"
    result.unfinished = tuple(unfinished)
    result.scenes = (*results, *unfinished)
    programs = [{"program": name, **entry.record()} for name, entry in results.items()]
    fields = {"ok": result.ok, "command": command, "programs": programs, "unfinished": unfinished}
    return result, records.result("checks", fields)
