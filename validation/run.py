"""Draws scenes with several renderers, compares them, and keeps what came out."""

from __future__ import annotations

import importlib.metadata
import math
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase as fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tracer
import tracer.margins
from tracer.passes import TABLE, Passes, lookup, names
from validation import renderers
from validation.compare import Comparison, Judge, Record, compare_passes, json_value
from validation.renderers import Renderer, Settings

if TYPE_CHECKING:
    from tracer import Scene

#: Packages whose version goes into every result.
PACKAGES = ("numpy", "scipy", "colour-science", "matplotlib", "pillow", "openexr")

#: The margins hold every ray of an image at once; a larger scene is compared at a smaller size.
ANALYSIS_MAX_PIXELS = 4_000_000


@dataclass(frozen=True)
class Note:
    """Something that was not compared, or not as asked, and why."""

    scene: str
    renderer: str
    message: str


@dataclass(frozen=True)
class Rendered:
    """Both renderings behind the comparisons of one scene and one pair: for the report."""

    scene: Scene
    label: str
    settings: Settings
    renderer: Passes
    reference: Passes
    comparisons: Sequence[Comparison]


@dataclass
class Validation:
    """What `validate` found: comparisons, what was left out, what failed, and the versions of everything involved."""

    settings: Settings
    comparisons: list[Comparison] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    failures: list[Note] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    command: Sequence[str] = ()

    @property
    def ok(self) -> bool:
        """Whether something was compared, everything agrees and no renderer failed."""
        return self.status == 0

    @property
    def status(self) -> int:
        """The exit status: 0 all agree, 1 some differ, 3 a renderer failed or nothing could be compared."""
        if self.failures or not self.comparisons:
            return 3
        return 0 if all(comparison.ok for comparison in self.comparisons) else 1

    def record(self) -> Record:
        """Everything as strictly valid JSON."""
        entry: Record = {
            "ok": self.ok,
            "command": list(self.command),
            "settings": vars(self.settings).copy(),
            "versions": self.versions,
            "comparisons": [comparison.record() for comparison in self.comparisons],
            "notes": [vars(note).copy() for note in self.notes],
            "failures": [vars(note).copy() for note in self.failures],
        }
        strict: Record = json_value(entry)
        return strict


class SceneFilesError(ValueError):
    """Scenes that could not be read: all of them, each with everything that is wrong with it."""

    def __init__(self, messages: Sequence[str]) -> None:
        """`messages` are complete, with file, line and hint."""
        super().__init__("\n".join(messages))
        self.messages = tuple(messages)


def scene_files(paths: Iterable[str | Path]) -> list[Path]:
    """The files named, and of a folder every `*.txt` below it, in the order of their names.

    Raises:
        SceneFilesError: a path that is not there, or a folder without scenes.
    """
    files: list[Path] = []
    wrong: list[str] = []
    for path in map(Path, paths):
        if path.is_dir():
            found = sorted(path.rglob("*.txt"))
            files += found
            if not found:
                wrong.append(f"{path}: error: no scene in this folder\n  hint: scenes are files that end in .txt")
        elif path.exists():
            files.append(path)
        else:
            wrong.append(f"{path}: error: no such file or folder")
    if wrong:
        raise SceneFilesError(wrong)
    return list(dict.fromkeys(files))


def load_scenes(paths: Iterable[str | Path], *, limits: bool = True) -> dict[str, Scene]:
    """Every scene of these files and folders by its path.

    Raises:
        SceneFilesError: with the errors of all files.
    """
    scenes: dict[str, Scene] = {}
    wrong: list[str] = []
    for path in scene_files(paths):
        try:
            scenes[str(path)] = tracer.load(path, limits=limits)
        except tracer.SceneError as error:
            wrong.append(str(error))
        except OSError as error:
            wrong.append(f"{path}: error: {error.strerror or error}")
    if wrong:
        raise SceneFilesError(wrong)
    return scenes


def versions(used: Iterable[Renderer]) -> dict[str, str]:
    """Versions of everything that decides about the results."""
    found = {"whitted": tracer.version(), "python": platform.python_version(), "platform": platform.platform()}
    found |= {"compiler": tracer.compiler(), "instruction set": tracer.instruction_set()}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    for renderer in used:
        for key, value in renderer.versions().items():
            # Two variants of one program may differ in the same entry; each then carries its name.
            found[key if found.get(key, value) == value else f"{renderer.name}: {key}"] = value
    return found


def shrink(columns: int, rows: int, pixels: int) -> tuple[int, int]:
    """The largest size of about the same aspect with at most that many pixels; the size itself if it fits."""
    if columns * rows <= pixels:
        return columns, rows
    factor = math.sqrt(pixels / (columns * rows))
    small = max(1, math.floor(columns * factor)), max(1, math.floor(rows * factor))
    # A strip one pixel high or wide leaves all of its share to the other side.
    return min(small[0], max(1, pixels // small[1])), min(small[1], max(1, pixels // small[0]))


def resized(scene: Scene, size: tuple[int, int]) -> Scene:
    """The same scene with that many columns and rows."""
    if (scene.view.columns, scene.view.rows) == size:
        return scene
    return scene.replace(view=scene.view.replace(columns=size[0], rows=size[1]))


def validate(
    scenes: Mapping[str, Scene] | Iterable[str | Path],
    renderer: str | Renderer | Sequence[str | Renderer] = "native-f64",
    against: str | Renderer | Sequence[str | Renderer] = "mitsuba-spec",
    *,
    passes: Sequence[str] | None = None,
    size: tuple[int, int] | None = None,
    settings: Settings | None = None,
    limits: bool = True,
    on_rendered: Callable[[Rendered], None] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Validation:
    """Draw every scene with every renderer and every reference, and compare each pair pass by pass.

    `scenes`: Scene objects by name, or paths of files and folders. `passes`: None compares all that both have; one
    asked for that a renderer lacks is a failure. `size`: instead of the scene's own.

    Raises:
        SceneFilesError: a scene cannot be read.
        renderers.UnknownRendererError: no renderer has that name.
        ValueError: no pass has that name.
    """
    settings = settings or Settings()
    check_passes(passes or ())
    if not isinstance(scenes, Mapping):
        scenes = load_scenes(scenes, limits=limits)
    tested, references = _renderers(renderer), _renderers(against)
    result = Validation(settings, versions=versions(dict.fromkeys([*tested, *references])))
    usable = {}
    for candidate in dict.fromkeys([*tested, *references]):
        usable[candidate.name] = (reason := candidate.unavailable()) is None
        if reason is not None:
            result.failures.append(Note("", candidate.name, reason))
    pairs = [
        (first, second)
        for first in tested
        for second in references
        if first.name != second.name and usable[first.name] and usable[second.name]
    ]
    for label, scene in scenes.items():
        drawn: dict[tuple[str, tuple[int, int]], Passes | None] = {}
        analyses: dict[tuple[int, int], Any] = {}
        at_size = resized(scene, size) if size else scene
        for first, second in pairs:
            if progress:
                progress(f"{label}: {first.name} against {second.name}")
            _pair(result, label, at_size, first, second, passes, drawn, analyses, on_rendered)
    return result


def check_passes(wanted: Iterable[str]) -> None:
    """Raise ValueError for a name that no pass has, or that has nothing to compare; families such as `shadow.L*` are
    names too.
    """
    for name in wanted:
        row = next((row for row in TABLE if row.name == name), None) or lookup(name)
        if row.quantity == "margin":
            raise ValueError(f"'{name}' is not compared: margins say where edges are, no renderer under test has them")


def _renderers(asked: str | Renderer | Sequence[str | Renderer]) -> list[Renderer]:
    several = [asked] if isinstance(asked, str | Renderer) else list(asked)
    return [renderers.get(entry) if isinstance(entry, str) else entry for entry in several]


def _pair(
    result: Validation,
    label: str,
    scene: Scene,
    first: Renderer,
    second: Renderer,
    passes: Sequence[str] | None,
    drawn: dict[tuple[str, tuple[int, int]], Passes | None],
    analyses: dict[tuple[int, int], Any],
    on_rendered: Callable[[Rendered], None] | None,
) -> None:
    """Compare one pair on one scene; what is drawn once is kept for the next pair."""
    settings = result.settings
    every = names(len(scene.lights), settings.max_reflections)
    asked = [
        name
        for name in every
        if lookup(name).quantity != "margin" and (passes is None or any(fnmatch(name, wanted) for wanted in passes))
    ]
    delivers = {side.name: side.passes(scene, settings) for side in (first, second)}
    for side in (first, second):
        if not delivers[side.name]:
            result.notes.append(Note(label, side.name, "cannot carry this scene: not compared"))
            return
    # The same for every pair, so that what is drawn for one serves the next.
    draw = {side: [name for name in dict.fromkeys([*asked, "id"]) if name in have] for side, have in delivers.items()}
    pair = f"{first.name} against {second.name}"
    missing = [name for name in asked if not all(name in have for have in delivers.values())]
    if missing and passes is None:
        result.notes.append(Note(label, pair, f"not compared, as one of them lacks them: {', '.join(missing)}"))
        asked = [name for name in asked if name not in missing]
    if not asked:
        result.notes.append(Note(label, pair, "not compared: the scene has none of the passes asked for"))
        return
    columns, rows = scene.view.columns, scene.view.rows
    limits = {side.name: side.max_pixels(scene, draw[side.name]) for side in (first, second)}
    limits["the analysis of edges"] = ANALYSIS_MAX_PIXELS
    slowest, most = min(
        ((name, limit) for name, limit in limits.items() if limit is not None), key=lambda entry: entry[1]
    )
    at = shrink(columns, rows, most)
    if at != (columns, rows):
        message = f"drawn at {at[0]}x{at[1]} instead of {columns}x{rows}: {slowest} would take too long"
        result.notes.append(Note(label, pair, message))
    scene = resized(scene, at)
    for side in (first, second):
        if (side.name, at) not in drawn:
            drawn[side.name, at] = _draw(result, label, scene, side, draw[side.name])
    a, b = drawn[first.name, at], drawn[second.name, at]
    if a is None or b is None:
        return
    if at not in analyses:
        analyses[at] = tracer.margins.analyse(
            scene,
            sample=settings.sample,
            shadow_epsilon=settings.shadow_epsilon,
            max_reflections=settings.max_reflections,
        )
    analysis = analyses[at]
    judge = Judge(
        scene,
        settings,
        analysis,
        first.uncertainty(scene, settings, analysis),
        second.uncertainty(scene, settings, analysis),
    )
    found = list(compare_passes(a, b, asked, judge, scene=label, renderer=first.name, reference=second.name))
    if on_rendered:
        on_rendered(Rendered(scene, label, settings, a, b, found))
    result.comparisons += [replace(comparison, maps=None) for comparison in found]


def _draw(result: Validation, label: str, scene: Scene, side: Renderer, wanted: Sequence[str]) -> Passes | None:
    try:
        return side.render(scene, tuple(wanted), result.settings)
    except Exception as error:  # whatever a renderer raises is its failure, and the others go on
        result.failures.append(Note(label, side.name, f"failed: {type(error).__name__}: {error}"))
        return None
