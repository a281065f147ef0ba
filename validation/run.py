"""Draws scenes with several renderers, compares them, and keeps what came out."""

from __future__ import annotations

import functools
import importlib.metadata
import itertools
import math
import platform
import shlex
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase as fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import tracer
import tracer.margins
from tracer._render import check_memory as room_for
from tracer.near import near
from tracer.passes import TABLE, Passes, lookup, names
from validation import pairs, records, renderers
from validation.compare import Comparison, Judge, compare_passes, without_maps
from validation.encoding import Encoding, Encodings
from validation.records import Record
from validation.renderers import Renderer, Settings, Uncertainty
from validation.timing import TimeLeft

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.verdict import Court, Verdicts

#: Packages whose version goes into every result.
PACKAGES = ("numpy", "scipy", "colour-science", "matplotlib", "pillow", "openexr", "python-flint", "flip-evaluator")

#: As a path it stands for standard input.
STDIN = Path("-")

#: The most pixels of a scene and pair that are judged, unless told otherwise: a few seconds of work, or a minute where
#: nothing explains them.
MOST_VERDICTS = 100

#: A larger scene is compared at a smaller size: 4 million pixels take the margins 2 GB and most of a minute.
ANALYSIS_MAX_PIXELS = 4_000_000


@dataclass(frozen=True)
class Note:
    """Something that was not compared, or not as asked, and why."""

    scene: str
    renderer: str
    message: str


class Amount(NamedTuple):
    """How many pixels of a scene and pair are judged; `first`: no more, if so many of them all come to the same."""

    most: int
    first: int = 0


@dataclass(frozen=True)
class Rendered:
    """Both renderings behind the comparisons of one scene and one pair: for the report."""

    scene: Scene
    label: str
    settings: Settings
    renderer: Passes
    reference: Passes
    comparisons: Sequence[Comparison]
    verdicts: Verdicts | None = None
    analysis: Analysis | None = None
    #: How the levels of either one's `beauty` stand for colours; None: it holds colours.
    encodings: Encodings = (None, None)
    #: Where the scene is, if a report shows it by another name.
    path: str = ""

    @property
    def convention(self) -> str:
        """Options by which `whitted explain` knows how a program made its image."""
        return self.renderer.metadata.get("explain", "") or self.reference.metadata.get("explain", "")


@dataclass(kw_only=True)
class Outcome:
    """What was left out, what failed, and the versions of everything involved."""

    settings: Settings
    notes: list[Note] = field(default_factory=list)
    failures: list[Note] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    command: Sequence[str] = ()
    #: What a reader has to know first, a line each; indented: about the line before.
    about: Sequence[str] = ()
    #: How many of the failures are faults of a scene or a size, not of a renderer.
    wrong_input: int = 0

    def fail(self, note: Note, *, wrong_input: bool = False) -> None:
        """Keep a failure; a renderer of several pairs fails the same way in each."""
        if note not in self.failures:
            self.failures.append(note)
            self.wrong_input += wrong_input

    @contextmanager
    def trying(self, label: str, renderer: Renderer) -> Iterator[None]:
        """What goes wrong with a renderer on a scene is kept; the others go on."""
        try:
            yield
        except RendererError as error:
            self.fail(Note(label, renderer.name, str(error)))
        except InputError as error:
            self.fail(Note("", "", str(error)), wrong_input=True)

    def usable(self, asked: Iterable[Renderer]) -> list[Renderer]:
        """Those of them that can run here; that the others cannot is a failure."""
        found = []
        for renderer in asked:
            with self.trying("", renderer), blaming():
                reason = renderer.unavailable()
                if reason is None:
                    found.append(renderer)
                else:
                    self.fail(Note("", renderer.name, reason))
        return found

    def trouble(self, *, anything: bool) -> int:
        """The exit status where something went wrong, else 0; `anything`: whether anything could be done."""
        if len(self.failures) > self.wrong_input or not (anything or self.failures):
            return 3
        return 2 if self.failures else 0


@dataclass(kw_only=True)
class Validation(Outcome):
    """What `validate` found."""

    comparisons: list[Comparison] = field(default_factory=list)
    verdicts: list[Verdicts] = field(default_factory=list)
    #: What is wrong besides, that no comparison shows, a clause each: how a program lays its image out.
    wrong: tuple[str, ...] = ()
    #: What was asked for and not compared, as a renderer lacks it: scene, renderer, pass.
    lacking: set[tuple[str, str, str]] = field(default_factory=set)
    #: The scenes that were asked for, and those of them that are not done yet: of what ended early.
    scenes: tuple[str, ...] = ()
    unfinished: tuple[str, ...] = ()
    #: What these are: scenes, or programs that drew them all.
    parts: str = "scene"

    @property
    def ok(self) -> bool:
        """Whether something was compared, everything agrees, no renderer failed, and nothing is missing."""
        return self.status == 0 and not self.unfinished

    def snapshot(self) -> Validation:
        """What is there now; the lists of this one go on."""
        return replace(
            self,
            comparisons=[*self.comparisons],
            verdicts=[*self.verdicts],
            notes=[*self.notes],
            failures=[*self.failures],
            lacking={*self.lacking},
        )

    @property
    def status(self) -> int:
        """The exit status: 0 all agree, 1 some differ or a difference is not explained, 2 a scene or a size is wrong,
        3 a renderer failed or nothing could be compared.
        """
        if trouble := self.trouble(anything=bool(self.comparisons)):
            return trouble
        agree = not self.wrong and all(comparison.ok for comparison in self.comparisons)
        return 0 if agree and all(verdicts.explained for verdicts in self.verdicts) else 1

    def counts(self) -> dict[str, dict[str, dict[str, int]]]:
        """By renderer and pass: comparisons made, those that agree, and scenes of which the renderer lacks the pass."""
        found: dict[str, dict[str, dict[str, int]]] = {}

        def entry(renderer: str, name: str) -> dict[str, int]:
            return found.setdefault(renderer, {}).setdefault(name, {"compared": 0, "agree": 0, "lacking": 0})

        for comparison in self.comparisons:
            if comparison.max is None:
                continue  # nothing could be compared
            for renderer in (comparison.renderer, comparison.reference):
                of = entry(renderer, comparison.pass_name)
                of["compared"] += 1
                of["agree"] += comparison.ok
        for _, renderer, name in self.lacking:
            entry(renderer, name)["lacking"] += 1
        return {renderer: dict(sorted(passes.items())) for renderer, passes in sorted(found.items())}

    def record(self) -> Record:
        """Everything as strictly valid JSON."""
        fields: Record = {
            "ok": self.ok,
            "command": list(self.command),
            "settings": vars(self.settings).copy(),
            "versions": self.versions,
            "counts": self.counts(),
            "pairs": pairs.record(self.comparisons),
            "comparisons": [comparison.record() for comparison in self.comparisons],
            "verdicts": [verdicts.record() for verdicts in self.verdicts],
            "notes": [vars(note).copy() for note in self.notes],
            "failures": [vars(note).copy() for note in self.failures],
            "unfinished": list(self.unfinished),
        }
        return records.result("validate", fields)


class SceneFilesError(ValueError):
    """Scenes that could not be read: all of them, each with everything that is wrong with it."""

    def __init__(self, messages: Sequence[str], files: int = 0) -> None:
        """`messages` are complete, with file, line and hint; `files`: how many there were to read, if it is known."""
        super().__init__("\n".join(messages))
        self.messages = tuple(messages)
        self.files = files


class InputError(ValueError):
    """A scene or a size that a renderer cannot be asked to draw: complete messages."""


class RendererError(Exception):
    """A renderer did what no renderer may do; the text says what, without its name."""


@contextmanager
def blaming() -> Iterator[None]:
    """Whatever a renderer raises is its failure, even if it wants to end the program.

    Raises:
        RendererError: it raised something.
    """
    try:
        yield
    except (InputError, RendererError):
        raise
    except (Exception, SystemExit) as error:
        raise RendererError(f"failed: {type(error).__name__}: {error}") from error


def encoding_of(renderer: Renderer, passes: Passes) -> Encoding | None:
    """How levels stand for colours in what a renderer drew; None: it drew colours."""
    encoding: Encoding | None = getattr(renderer, "encoding", None)
    return replace(encoding, steps=int(passes.metadata["levels"])) if encoding else None


def why_not(renderer: Renderer, scene: Scene) -> str:
    """Why a renderer cannot carry a scene; "" where it gives no reason, as it does not have to."""
    refusal = getattr(renderer, "refusal", None)
    return str(refusal(scene)) if refusal else ""


def check_memory(
    label: str, scene: Scene, passes: Sequence[str], *, precision: str = "f64", fewer: str = "--passes"
) -> None:
    """Whether passes of a scene fit into the memory; `fewer`: the option that asks for less.

    Raises:
        InputError: they do not.
    """
    try:
        room_for(passes, scene.view.columns, scene.view.rows, np.dtype("f8" if "64" in precision else "f4"))
    except MemoryError as error:
        raise InputError(f"{label}: error: {error}\n  hint: a smaller --size, or fewer {fewer}") from error


def analyse(scene: Scene, settings: Settings) -> Analysis:
    """Margins and sensitivities of every pixel, drawn with these settings."""
    return tracer.margins.analyse(
        scene,
        sample=settings.sample,
        shadow_epsilon=settings.shadow_epsilon,
        max_reflections=settings.max_reflections,
    )


def draw(renderer: Renderer, label: str, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """What a renderer draws of a scene, whose file or name is `label`.

    Raises:
        InputError: the scene has numbers that it cannot carry, or the size is too large for the memory.
        RendererError: it failed.
    """
    # What does not say its precision may be as small as float32.
    check_memory(label, scene, passes, precision=getattr(renderer, "precision", "f32"))
    with blaming():
        try:
            drawn = renderer.render(scene, tuple(passes), settings)
        except tracer.SceneError as error:
            # Without the place: the error is about a Scene, the user knows a file.
            entries = [f"{label}: error: {e.message}" + f"\n  hint: {e.hint}" * bool(e.hint) for e in error.errors]
            raise InputError("\n".join(entries) or f"{label}: error: {error}") from error
        except MemoryError as error:
            size = f"{scene.view.columns}x{scene.view.rows}"
            reason = str(error) or f"not enough memory for {size} pixels"
            raise InputError(
                f"{label}: error: {renderer.name}: {reason}\n  hint: a smaller --size, or fewer --passes"
            ) from error
    if not isinstance(drawn, Passes):
        raise RendererError(f"failed: it returned {type(drawn).__name__}, expected Passes")
    return drawn


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
        elif path.exists() or path == STDIN:
            files.append(path)
        else:
            meant = _near(path)
            wrong.append(f"{path}: error: no such file or folder" + f"\n  hint: did you mean '{meant}'?" * bool(meant))
    if wrong:
        raise SceneFilesError(wrong)
    return list(dict.fromkeys(files))


def _near(path: Path) -> Path | None:
    """The scene or folder that a path was meant to be, in the folder that it names."""
    try:
        names = {
            entry.stem if entry.suffix == ".txt" else entry.name: entry.name
            for entry in sorted(path.parent.iterdir())
            if entry.suffix == ".txt" or entry.is_dir()
        }
    except OSError:
        return None
    # Without the ending, which all have in common.
    meant = near(path.stem if path.suffix.lower() == ".txt" else path.name, names, cutoff=0.75)
    return path.parent / names[meant] if meant else None


def load_scenes(paths: Iterable[str | Path], *, limits: bool = True) -> dict[str, Scene]:
    """Every scene of these files and folders by its path; `-` is standard input.

    Raises:
        SceneFilesError: with the errors of all files.
    """
    scenes: dict[str, Scene] = {}
    wrong: list[str] = []
    files = scene_files(paths)
    for path in files:
        try:
            if path == STDIN:
                scenes["<stdin>"] = tracer.loads(sys.stdin.buffer.read(), limits=limits, source="<stdin>")
            else:
                scenes[str(path)] = tracer.load(path, limits=limits)
        except tracer.SceneError as error:
            wrong.append(str(error))
        except OSError as error:
            wrong.append(f"{path}: error: {error.strerror or error}")
    if wrong:
        raise SceneFilesError(wrong, len(files))
    return scenes


def explain_command(
    label: str, scene: Scene, settings: Settings, x: int, y: int, names: Iterable[str], more: str = ""
) -> str:
    """What to type to have a pixel of the scene, as it was drawn, explained; `names`: of renderers, or of images."""
    where = "-" if label == "<stdin>" else label
    known = [name for name in names if name.partition(":")[0] != "image"]
    words = ["whitted", "explain", where, str(x), str(y), *renderer_words(known)]
    return f"{shlex.join(words)} {explain_options(label, scene, settings, more)}".rstrip()


def renderer_words(names: Iterable[str]) -> list[str]:
    """Options that name these renderers: one for all, but of commands one each, as a comma may belong to a command."""
    unique = list(dict.fromkeys(names))
    plain = [name for name in unique if not name.startswith("cmd:")]
    lists = [",".join(plain)] * bool(plain) + [name for name in unique if name.startswith("cmd:")]
    return [word for one in lists for word in ("--renderer", one)]


def explain_options(label: str, scene: Scene, settings: Settings, more: str = "") -> str:
    """What such a command needs beside the pixel and the renderers: it is the same for every pixel; `more` of it."""
    words = shlex.split(more)
    if not _is_file(label, scene):
        words += ["--size", f"{scene.view.columns}x{scene.view.rows}"]
    for name in ("sample", "shadow_epsilon", "max_reflections"):
        if getattr(settings, name) != getattr(Settings(), name):
            words += [f"--{name.replace('_', '-')}", str(getattr(settings, name))]
    try:
        scene.replace(limits=True)
    except tracer.SceneError:
        words.append("--no-limits")
    return shlex.join(words)


def _is_file(label: str, scene: Scene) -> bool:
    """Whether a scene is drawn as its file has it, at the same size."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its reader has warned already
            return Path(label).is_file() and tracer.load(label, limits=False) == scene
    except (OSError, ValueError):
        return False


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
        try:
            with blaming():
                entries = dict(renderer.versions())
        except RendererError as error:
            entries = {renderer.name: str(error)}
        for key, value in entries.items():
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


def resized(scene: Scene, size: tuple[int, int], *, limits: bool | None = None) -> Scene:
    """The same scene with that many columns and rows; `limits` None: those that it keeps itself.

    Raises:
        SceneError: the size is beyond the limits.
    """
    if (scene.view.columns, scene.view.rows) == size:
        return scene
    return scene.replace(view=scene.view.replace(columns=size[0], rows=size[1]), limits=limits)


def validate(
    scenes: Mapping[str, Scene] | Iterable[str | Path],
    renderer: str | Renderer | Sequence[str | Renderer] = "native-f64",
    against: str | Renderer | Sequence[str | Renderer] = "mitsuba-spec",
    *,
    passes: Sequence[str] | None = None,
    size: tuple[int, int] | None = None,
    settings: Settings | None = None,
    limits: bool = True,
    verdicts: int = MOST_VERDICTS,
    first: int = 0,
    on_rendered: Callable[[Rendered], None] | None = None,
    progress: Callable[[str], None] | None = None,
    all_pairs: bool = False,
    on_scene: Callable[[Validation], None] | None = None,
    flip: bool = False,
) -> Validation:
    """Draw every scene with every renderer and every reference, and compare each pair pass by pass.

    `scenes`: Scene objects by name, or paths of files and folders. `passes`: None compares all that both have; one
    asked for that a renderer lacks is a failure. `size`: instead of the scene's own. Passes that a renderer cannot draw
    in time at this size are compared at a smaller one, and a note says so. `verdicts`: the most pixels of a scene and
    pair that are judged where they differ; of more a random sample. `first`: no more are judged than so many of them
    if these all come to the same mistake, or to none that is known; 0: all are. `all_pairs`: every pair of all of them,
    each drawn once. `on_scene`: called after every scene with what was found so far.
    `flip`: whether FLIP of `beauty` is measured, which takes flip-evaluator and a third of a second for 400x400 pixels.

    Raises:
        SceneFilesError: a scene cannot be read.
        renderers.UnknownRendererError: no renderer has that name.
        ValueError: no pass has that name.
        SceneError: the size is beyond the limits.
        InputError: the passes at that size do not fit into the memory.
    """
    settings = settings or Settings()
    check_passes(passes or ())
    if not isinstance(scenes, Mapping):
        scenes = load_scenes(scenes, limits=limits)
    at_sizes = {
        label: resized(scene, size, limits=None if limits else False) if size else scene
        for label, scene in scenes.items()
    }
    for label, scene in at_sizes.items():
        check_memory(label, scene, _asked(scene, settings, passes))
    tested, references = _renderers(renderer), _renderers(against)
    every = dict.fromkeys([*tested, *references])
    labels = tuple(at_sizes)
    result = Validation(settings=settings, versions=versions(every), scenes=labels, unfinished=labels)
    usable = result.usable(every)
    against_each = itertools.combinations(every, 2) if all_pairs else itertools.product(tested, references)
    chosen = [
        (one, other) for one, other in against_each if one.name != other.name and one in usable and other in usable
    ]
    left = TimeLeft(len(at_sizes) * len(chosen))
    for place, (label, at_size) in enumerate(at_sizes.items()):
        shared = _Shared(flip)
        for number, (one, other) in enumerate(chosen, place * len(chosen)):
            # First what must not be cut off.
            count = f"scene {place + 1} of {len(at_sizes)}" * (len(at_sizes) > 1)
            where = f"{count}{left.says(number)}".removeprefix(", ")
            say = functools.partial(_say, progress, where, f"{label}: {one.name} against {other.name}")
            say("")
            try:
                _pair(result, label, at_size, one, other, passes, Amount(verdicts, first), shared, on_rendered, say)
            except _PairError as error:
                result.fail(error.note)
        result.unfinished = labels[place + 1 :]
        if on_scene:
            on_scene(result)
    return result


def _say(progress: Callable[[str], None] | None, where: str, pair: str, what: str) -> None:
    """How far a pair is."""
    if progress:
        progress(": ".join(filter(None, (where, what, pair))))


def check_passes(wanted: Iterable[str]) -> None:
    """Raise ValueError for a name that no pass has, or that has nothing to compare; families such as `shadow.L*` are
    names too.
    """
    for name in wanted:
        row = next((row for row in TABLE if row.name == name), None) or lookup(name)
        if row.quantity == "margin":
            raise ValueError(f"'{name}' is not compared: margins say where edges are, no renderer under test has them")


def _asked(scene: Scene, settings: Settings, passes: Sequence[str] | None) -> list[str]:
    """The passes of a scene that are compared, where both sides have them; None: all."""
    every = names(len(scene.lights), settings.max_reflections, margins=False)
    return [name for name in every if passes is None or any(fnmatch(name, wanted) for wanted in passes)]


def _renderers(asked: str | Renderer | Sequence[str | Renderer]) -> list[Renderer]:
    several = [asked] if isinstance(asked, str | Renderer) else list(asked)
    return [renderers.get(entry) if isinstance(entry, str) else entry for entry in several]


class _PairError(Exception):
    """What keeps a pair from being compared."""

    def __init__(self, note: Note) -> None:
        super().__init__(note.message)
        self.note = note


@contextmanager
def _of(label: str, renderer: Renderer) -> Iterator[None]:
    """What a renderer raises ends the pair."""
    try:
        with blaming():
            yield
    except RendererError as error:
        raise _PairError(Note(label, renderer.name, str(error))) from error


@dataclass
class _Shared:
    """What pairs share of one scene, by its size and by renderer; `flip`: whether FLIP is measured."""

    flip: bool = False
    drawn: dict[tuple[str, tuple[int, int]], Passes | None] = field(default_factory=dict)
    analyses: dict[tuple[int, int], Analysis] = field(default_factory=dict)
    claims: dict[tuple[str, tuple[int, int]], Uncertainty] = field(default_factory=dict)
    courts: dict[tuple[int, int], Court] = field(default_factory=dict)


def _pair(
    result: Validation,
    label: str,
    scene: Scene,
    first: Renderer,
    second: Renderer,
    passes: Sequence[str] | None,
    verdicts: Amount,
    shared: _Shared,
    on_rendered: Callable[[Rendered], None] | None,
    say: Callable[[str], None],
) -> None:
    """Compare one pair on one scene; what is drawn once is kept for the next pair."""
    settings = result.settings
    every = names(len(scene.lights), settings.max_reflections, margins=False)
    asked = _asked(scene, settings, passes)
    delivers: dict[str, Sequence[str]] = {}
    for side in (first, second):
        with _of(label, side):
            delivers[side.name] = tuple(side.passes(scene, settings))
        if not delivers[side.name]:
            why = f" ({why_not(side, scene)})".removesuffix(" ()")
            note = Note(label, side.name, f"cannot carry this scene{why}: not compared")
            if note not in result.notes:  # that of another pair
                result.notes.append(note)
            result.lacking |= {(label, side.name, name) for name in asked}
            return
    # The same for every pair, so that what is drawn for one serves the next.
    drawing_of = {
        side: [name for name in dict.fromkeys([*asked, "id"]) if name in have] for side, have in delivers.items()
    }
    pair = f"{first.name} against {second.name}"
    missing = [name for name in asked if not all(name in have for have in delivers.values())]
    for side in (first, second):
        lacks = [name for name in missing if name not in delivers[side.name]]
        result.lacking |= {(label, side.name, name) for name in lacks}
        note = Note(label, side.name, f"not compared, as it does not deliver them: {', '.join(lacks)}")
        if lacks and passes is None and note not in result.notes:
            result.notes.append(note)
    if missing and passes is None:
        asked = [name for name in asked if name not in missing]
    if not asked:
        why = f"the scene has none of the passes asked for, but {', '.join(every)}"
        result.notes.append(Note(label, pair, f"not compared: {why}"))
        return
    columns, rows = scene.view.columns, scene.view.rows
    large = shrink(columns, rows, ANALYSIS_MAX_PIXELS)
    if large != (columns, rows):
        message = (
            f"compared at {large[0]}x{large[1]} instead of {columns}x{rows}: finding the edges would take too long"
        )
        result.notes.append(Note(label, pair, message))
    scene = resized(scene, large)
    # Where a renderer takes too long, what it draws in time keeps its size, and only the rest is drawn smaller.
    quick = {}
    for side in (first, second):
        with _of(label, side):
            quick[side.name] = _in_time(side, scene, drawing_of[side.name])
    whole = [name for name in asked if all(name in quick[side] or name not in drawing_of[side] for side in drawing_of)]
    rest = [name for name in asked if name not in whole]
    rounds = [(large, whole, quick)] if whole else []
    if rest:
        limits: dict[str, int | None] = {}
        for side in (first, second):
            with _of(label, side):
                limits[side.name] = side.max_pixels(scene, drawing_of[side.name])
        most, slowest = min((limit, name) for name, limit in limits.items() if limit is not None)
        small = shrink(*large, most)
        what = f"{', '.join(rest)} " if whole else ""
        message = f"{what}drawn at {small[0]}x{small[1]} instead of {columns}x{rows}: {slowest} would take too long"
        result.notes.append(Note(label, pair, message))
        rounds.append((small, rest, drawing_of))
    for size, compared, drawing in rounds:
        at_size = resized(scene, size)
        _compare(result, label, at_size, first, second, compared, verdicts, drawing, shared, on_rendered, say)


def _in_time(side: Renderer, scene: Scene, passes: Sequence[str]) -> list[str]:
    """Of these passes those that a renderer draws in time, all together, at the size of the scene."""

    def fits(some: Sequence[str]) -> bool:
        limit = side.max_pixels(scene, some)
        return limit is None or limit >= scene.view.columns * scene.view.rows

    if fits(passes):
        return list(passes)
    # `id` first: it says where there is something to compare.
    chosen: list[str] = []
    for name in sorted(passes, key=lambda name: name != "id"):
        if fits([*chosen, name]):
            chosen.append(name)
    return chosen if "id" in chosen else []


def _compare(
    result: Validation,
    label: str,
    scene: Scene,
    first: Renderer,
    second: Renderer,
    passes: Sequence[str],
    verdicts: Amount,
    draw: Mapping[str, Sequence[str]],
    shared: _Shared,
    on_rendered: Callable[[Rendered], None] | None,
    say: Callable[[str], None],
) -> None:
    """Compare passes of one pair at the size of the scene; `draw`: what either draws at this size."""
    settings, at = result.settings, (scene.view.columns, scene.view.rows)
    for side in (first, second):
        if (side.name, at) not in shared.drawn:
            shared.drawn[side.name, at] = _draw(result, label, scene, side, draw[side.name])
    a, b = shared.drawn[first.name, at], shared.drawn[second.name, at]
    if a is None or b is None:
        return
    if at not in shared.analyses:
        shared.analyses[at] = analyse(scene, settings)
    analysis = shared.analyses[at]
    claims: list[Uncertainty] = []
    for side in (first, second):
        with _of(label, side):
            if (side.name, at) not in shared.claims:
                shared.claims[side.name, at] = side.uncertainty(scene, settings, analysis)
            claims.append(shared.claims[side.name, at])
    encodings = (encoding_of(first, a), encoding_of(second, b))
    judge = Judge(scene, settings, analysis, claims[0], claims[1], encodings, shared.flip)
    found = list(compare_passes(a, b, passes, judge, scene=label, renderer=first.name, reference=second.name))
    for side, encoding in zip((first, second), encodings, strict=True):
        note = Note("", side.name, "an image is compared as the settings say: `whitted check` finds how it was made")
        asked = result.about or not encoding or all(comparison.ok for comparison in found)
        if not asked and side.name.startswith("cmd:") and note not in result.notes:
            result.notes.append(note)
    judged = None
    if any(comparison.maps is not None and comparison.maps.over.any() for comparison in found):
        # Only now: python-flint and what builds on it are for where there is something to judge.
        from validation import verdict

        sides = [
            verdict.Side(side, passes_of, claim, encoding)
            for side, passes_of, claim, encoding in zip((first, second), (a, b), claims, encodings, strict=True)
        ]
        try:
            if at not in shared.courts:
                shared.courts[at] = verdict.Court(scene, settings, analysis)
            court = shared.courts[at]
            pair = sides[0], sides[1]
            judged = verdict.judge(
                scene,
                label,
                settings,
                analysis,
                *pair,
                found,
                most=verdicts.most,
                first=verdicts.first,
                court=court,
                progress=say,
            )
        except verdict.RulesError as error:
            result.fail(Note(label, error.renderer, str(error)))
    if judged:
        result.verdicts.append(judged)
    if on_rendered:
        shown = judged if verdicts.most else None
        on_rendered(Rendered(scene, label, settings, a, b, found, shown, analysis, encodings))
    result.comparisons += [without_maps(comparison) for comparison in found]


def _draw(result: Validation, label: str, scene: Scene, side: Renderer, wanted: Sequence[str]) -> Passes | None:
    with result.trying(label, side):
        return draw(side, label, scene, wanted, result.settings)
    return None
