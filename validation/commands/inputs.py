"""What commands do with their options: scenes, sizes, renderers and passes, read and checked."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from validation.commands.errors import FAILED, CommandError, blaming

if TYPE_CHECKING:
    from tracer import Scene
    from validation.renderers import Renderer, Settings

PASS_FILES, IMAGES = (".exr", ".npz"), (".png", ".ppm")
#: As the scene format limits columns and rows.
LONGEST_SIDE = 100_000


def settings_of(options: Mapping[str, Any]) -> Settings:
    """How to draw, from the options that `raytrace` has too."""
    from validation.renderers import Settings

    return Settings(options["sample"], options["shadow_epsilon"], options["max_reflections"], options["threads"])


def load_scene(path: Path, *, no_limits: bool) -> Scene:
    """One scene file, or standard input."""
    from validation.run import SceneFilesError, load_scenes

    if path.is_dir():
        raise SceneFilesError([f"{path}: error: this is a folder, expected a scene file"])
    (scene,) = load_scenes([path], limits=not no_limits).values()
    return scene


def check_size(size: tuple[int, int] | None, *, no_limits: bool) -> None:
    """Whether the scene format allows that size."""
    if size and not no_limits and max(size) > LONGEST_SIDE:
        message = f"--size {size[0]}x{size[1]}: at most {LONGEST_SIDE} columns and rows"
        raise CommandError(message, "--no-limits allows more")


def check_flip(*, wanted: bool) -> None:
    """Whether FLIP can be measured here."""
    if wanted and not importlib.util.find_spec("flip_evaluator"):
        raise CommandError("--flip needs flip-evaluator, which is not installed", "pip install 'whitted[flip]'")


def check_pairs(tested: Sequence[str], references: Sequence[str]) -> None:
    """Whether there is anything to compare."""
    from validation import renderers

    names = {renderers.get(name).name for name in (*tested, *references)}
    if len(names) == 1:
        hint = "--against with another name; see `whitted renderers`"
        raise CommandError(f"a renderer is not compared with itself: {names.pop()}", hint)


def check_pass_names(asked: Sequence[str]) -> None:
    """Whether there are passes of these names to compare."""
    from validation.run import check_passes

    try:
        check_passes(asked)
    except ValueError as error:
        message, _, meant = str(error).partition(" (did you mean ")
        hint = f"did you mean {meant.rstrip(')')}" if meant else f"the passes are {', '.join(_every_pass())}"
        raise CommandError(message, hint) from error


def _every_pass() -> list[str]:
    """The passes that there are to compare, families such as `shadow.L*` once."""
    from tracer.passes import TABLE

    return [row.name for row in TABLE if row.quantity != "margin"]


def usable(name: str) -> Renderer:
    """A renderer that can run here."""
    from validation import renderers

    renderer = renderers.get(name)
    with blaming(renderer):
        reason = renderer.unavailable()
    if reason:
        raise CommandError(f"{renderer.name} cannot run here: {reason}", "see `whitted renderers`", FAILED)
    return renderer


def refuse_pass(name: str, program: str, delivers: Sequence[str], known: Sequence[str]) -> NoReturn:
    """Say that there is no such pass, and which one is near."""
    from tracer.near import near

    # Another light or bounce is not what a number beyond the last was meant to be.
    meant = "" if _is_pass(name) else near(name, delivers)
    hint = f"did you mean '{meant}'?" if meant else f"it has {', '.join(delivers)}"
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


def check_pixels(scenes: Mapping[str, Scene], at: tuple[tuple[int, int], ...], output: Path | None) -> None:
    """Whether every scene has the pixels that are named."""
    if output and len(scenes) > 1:
        raise CommandError(f"{output} holds one image, but there are {len(scenes)} scenes", "name one scene")
    for label, scene in scenes.items():
        columns, rows = scene.view.columns, scene.view.rows
        for x, y in at:
            if x >= columns or y >= rows:
                hint = f"columns are 0 to {columns - 1} from the left, rows 0 to {rows - 1} from the top"
                raise CommandError(f"{label} has no pixel {x} {y}", hint)
