"""Climbs ladders with renderers, and finds the rung on which each first says something wrong that it claims to tell."""

from __future__ import annotations

import functools
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import click
import numpy as np

import tracer
from tracer.passes import lookup, write_beside
from validation import certify, encoding, records, renderers
from validation.certify import PROVED, Miss, Proof, prove_scene
from validation.compare import Judge, Mask
from validation.ladders import LADDERS, SIDE, Ladder, get
from validation.metrics import Array
from validation.processes import Pool, Teller
from validation.records import Record
from validation.renderers import Renderer, Settings
from validation.renderers.floats import UNIT_ROUNDOFF, uncertainty
from validation.run import (
    InputError,
    Note,
    Outcome,
    RendererError,
    blaming,
    draw,
    encoding_of,
    explain_command,
    versions,
    why_not,
)
from validation.terminal import colorful, console, counted, number, print_failures
from validation.timing import TimeLeft, duration, now
from validation.truth import UnprovedError

if TYPE_CHECKING:
    from tracer.passes import Precision

Named: TypeAlias = str | Renderer

#: Seconds that one renderer may take for a rung, and truth for all of its pixels.
SECONDS = 120.0
#: What a cell of the table means.
LEGEND = (
    "-: holds to the end; (RUNG): from there on its claim excuses every pixel, or it refuses the scene; refused: all "
    "of them; !RUNG: it failed there, and is not asked again"
)
#: So many breaks are told in words.
TOLD = 12


@dataclass(frozen=True, kw_only=True)
class Standard:
    """What is wrong with what a renderer drew of a rung, held to one claim.

    `held`: proved pixels with a pass that the claim does not excuse; `colors`: with `beauty`. `wrong`: proved pixels
    with a wrong decision that it does not excuse. `ratio`: the largest error of `beauty` over its tolerance where held,
    None where nothing is. `worst`: the pixel with the least excuse.
    """

    held: int
    colors: int
    wrong: int
    ratio: float | None
    worst: Miss | None

    @property
    def broken(self) -> bool:
        """Whether the claim does not hold."""
        return self.wrong > 0 or (self.ratio is not None and not self.ratio <= 1)


@dataclass(frozen=True, kw_only=True)
class Step:
    """A renderer on a rung.

    `own`: held to what it claims; `careful`: to what a careful renderer of its format tells, which is every decision
    with a margin of 64 roundings; the tolerance of `beauty` enters there only for float formats. `wrong`: pixels with a
    wrong decision, excused or not. `error`: the largest error of `beauty` where its own claim holds it to something,
    over the brightest exact value. `not_numbers`: pixels of the image with NaN or Inf in any pass. `refused`: why it
    does not draw this. `failed`: what went wrong.
    """

    renderer: str
    own: Standard | None = None
    careful: Standard | None = None
    wrong: int = 0
    error: float | None = None
    not_numbers: int = 0
    seconds: float = 0.0
    refused: str = ""
    failed: str = ""

    def of(self, standard: str) -> Standard | None:
        """`own` or `careful`."""
        return self.own if standard == "own" else self.careful

    def broken(self, standard: str) -> bool:
        """Whether it drew something wrong."""
        found = self.of(standard)
        return self.not_numbers > 0 or (found is not None and found.broken)

    def silent(self, standard: str) -> bool:
        """Whether there is no pixel of `beauty` to hold it to."""
        found = self.of(standard)
        return not self.failed and (found is None or found.colors == 0)

    def says(self, standard: str) -> str:
        """What is wrong, in words."""
        found, words = self.of(standard), []
        if self.failed:
            words.append(self.failed)
        if self.not_numbers:
            words.append(f"{self.not_numbers} pixels of NaN or Inf")
        if found and found.wrong:
            words.append(counted(found.wrong, "wrong decision"))
        if found and found.ratio is not None and not found.ratio <= 1:
            words.append(f"colours off by {number(found.ratio)} tolerances")
        return ", ".join(words)


@dataclass(frozen=True, kw_only=True)
class Rung:
    """What came of one scene: how many of its pixels are proved, how many the specification leaves open."""

    ladder: str
    rung: str
    proved: int = 0
    exempt: int = 0
    unproved: int = 0
    seconds: float = 0.0
    steps: Mapping[str, Step] = field(default_factory=dict)


# ---- one rung


def prove_rung(ladder: Ladder, rung: str, settings: Settings) -> Proof:
    """Every pixel of a rung's scene, proved.

    Raises:
        truth.UnprovedError: none could be.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tracer.SceneWarning)  # the second of two equal spheres
        return prove_scene(ladder.scene(rung), settings, pixels=SIDE * SIDE, edges=0, jobs=1)


def measure(proof: Proof, renderer: Renderer, label: str = "") -> Step:
    """Hold what a renderer draws against proved pixels.

    Raises:
        RendererError: it failed.
    """
    scene, settings, analysis = proof.scene, proof.settings, proof.analysis
    with blaming():
        delivers = tuple(renderer.passes(scene, settings))
    if not delivers:
        return Step(renderer=renderer.name, refused=why_not(renderer, scene) or "it cannot carry this scene")
    wanted = [name for name in _wanted(proof) if name in delivers]
    start = time.perf_counter()
    try:
        drawn = draw(renderer, label, scene, wanted, settings)
    except InputError as error:
        return Step(renderer=renderer.name, refused=str(error).splitlines()[0])
    seconds = time.perf_counter() - start
    for name in wanted:
        if name not in drawn or drawn[name].shape[:2] != analysis.ids.shape:
            raise RendererError(f"did not deliver the pass '{name}' in the size asked for")
    bad = np.zeros(analysis.ids.shape, bool)
    for name in wanted:
        array = np.asarray(drawn[name], dtype=np.float64)
        bad |= ~np.isfinite(array.reshape(*bad.shape, -1)).all(axis=-1)

    said = str(getattr(renderer, "precision", ""))
    precision: Precision = "f64" if said == "f64" else "f32"
    with blaming():
        own = Judge(scene, settings, analysis, renderer.uncertainty(scene, settings, analysis), PROVED)
    careful = Judge(scene, settings, analysis, uncertainty(precision, scene, settings), PROVED)
    values = {name: np.asarray(drawn[name], dtype=np.float64)[proof.y, proof.x] for name in wanted}
    values = {name: array.reshape(len(array), -1) for name, array in values.items()}
    differences = {name: certify.errors(values[name], proof, name) for name in wanted}
    if "beauty" in wanted and (levels := encoding_of(renderer, drawn)):
        found = encoding.difference(values["beauty"], proof.value["beauty"], (levels, None))
        differences["beauty"] = np.where(np.isnan(found), np.inf, found)
    wrong = {name: _wrong(name, values, differences, proof, own) for name in wanted if name != "beauty"}
    held = _interior(own, proof, "beauty") if "beauty" in wanted else np.zeros(len(proof.x), bool)
    apart = differences["beauty"].max(axis=-1)[held] if "beauty" in wanted else np.zeros(0)
    bench = _Bench(proof, values, differences, wrong)
    brightest = float(np.abs(proof.value["beauty"]).max(initial=0.0)) or 1.0
    return Step(
        renderer=renderer.name,
        own=bench.hold(own, colors=True),
        careful=bench.hold(careful, colors=said in UNIT_ROUNDOFF),
        wrong=int(np.logical_or.reduce(list(wrong.values()) or [np.zeros(1, bool)]).sum()),
        error=float(apart.max() / brightest) if apart.size else None,
        not_numbers=int(bad.sum()),
        seconds=seconds,
    )


def _wanted(proof: Proof) -> list[str]:
    """The passes that show decisions, and what comes of all: those of reflections only where something reflects."""
    mirrors = any(sphere.kr > 0 for sphere in proof.scene.spheres)
    return [
        name
        for name in proof.value
        if name in ("id", "beauty")
        or lookup(name).quantity == "visibility"
        or (name.startswith("reflection.") and mirrors)
    ]


def _interior(judge: Judge, proof: Proof, name: str) -> Mask:
    """Proved pixels that a claim does not excuse."""
    return ~proof.unsettled & ~judge.edge(name)[proof.y, proof.x]


def _wrong(
    name: str, values: Mapping[str, Array], differences: Mapping[str, Array], proof: Proof, judge: Judge
) -> Mask:
    """Where the decision that a pass shows is wrong: what is hit, whether a light is hidden, or a mirror empty."""
    drawn, exact = values[name], proof.value[name]
    if lookup(name).quantity == "color":
        # Black, or not; where the colours are so near that it makes no difference, none.
        apart = differences[name].max(axis=-1) > certify.bound(judge, name)[proof.y, proof.x]
        empty: Mask = (drawn == 0).all(axis=-1) != (exact == 0).all(axis=-1)
        empty &= ~proof.unsettled & apart
        return empty
    off: Mask = ~proof.unsettled & (drawn != exact)[:, 0]
    if name == "id":
        return off
    if "id" in values:
        off &= (values["id"][:, 0] >= 0) == (proof.value["id"][:, 0] >= 0)
    return off & proof.lit[int(name.removeprefix("shadow.L"))]


@dataclass
class _Bench:
    """What a renderer drew of proved pixels, and who is accused of what."""

    proof: Proof
    values: Mapping[str, Array]
    differences: Mapping[str, Array]
    wrong: Mapping[str, Mask]  # by pass: where the decision that it shows is not that of truth

    def hold(self, judge: Judge, *, colors: bool) -> Standard:
        """To a claim; `colors`: whether the errors of `beauty` count."""
        proof, at = self.proof, (self.proof.y, self.proof.x)
        accused: list[tuple[str, int]] = []  # those without an excuse, those of the least first
        wrong, held = np.zeros(len(proof.x), bool), np.zeros(len(proof.x), bool)
        for name, off in self.wrong.items():
            held |= _interior(judge, proof, name)
            claim = certify.margins(judge, name, at)[1]
            places = [int(place) for place in np.flatnonzero(off & (claim >= 1))]
            places.sort(key=lambda place: -claim[place])
            wrong[places] = True
            accused += [(name, place) for place in places[:1]]
        own, ratio = np.zeros(len(proof.x), bool), None
        if "beauty" in self.differences:
            own = _interior(judge, proof, "beauty")
        if own.any() and colors:
            error, tolerance = self.differences["beauty"].max(axis=-1), judge.tolerance("beauty")[at]
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = np.where(own & (error != 0), error / tolerance, 0.0)
            ratios = np.where(np.isnan(ratios), np.inf, ratios)
            places = [int(place) for place in np.flatnonzero(ratios > 1)]
            places.sort(key=lambda place: -ratios[place])
            ratio = float(ratios.max(initial=0.0))
            accused += [("beauty", place) for place in places[:1]]
        return Standard(
            held=int((held | own).sum()),
            colors=int(own.sum()),
            wrong=int(wrong.sum()),
            ratio=ratio,
            worst=self._miss(judge, *accused[0]) if accused else None,
        )

    def _miss(self, judge: Judge, name: str, place: int) -> Miss:
        """A pixel of a pass, in its worst channel."""
        margin, claim = (found[place] for found in certify.margins(judge, name, (self.proof.y, self.proof.x)))
        channel, channels = int(self.differences[name][place].argmax()), lookup(name).channels
        x, y = int(self.proof.x[place]), int(self.proof.y[place])
        return Miss(
            x,
            y,
            name,
            channels[channel] if channels else "",
            float(self.values[name][place, channel]),
            float(self.proof.value[name][place, channel]),
            float(self.differences[name][place, channel]),
            float(certify.bound(judge, name)[y, x]),
            float(margin),
            float(claim),
        )


# ---- many, in processes of their own


@dataclass(frozen=True)
class _Task:
    """A rung for a process; `failed`: renderers that are not to be asked, and what to tell of those."""

    ladder: Ladder | str
    rung: str
    failed: Mapping[str, str] = field(default_factory=dict)

    @property
    def found(self) -> Ladder:
        return get(self.ladder) if isinstance(self.ladder, str) else self.ladder


def climb(
    task: _Task, tested: Sequence[Named], settings: Settings, say: Callable[[str], None] | None = None
) -> tuple[Rung, list[str]]:
    """All renderers on one rung; and what went wrong in our own code, or with the truth."""
    ladder, start = task.found, time.monotonic()
    label = f"{ladder.name} {task.rung}"
    if say:
        say("")
    steps: dict[str, Step] = {}
    try:
        proof = prove_rung(ladder, task.rung, settings)
    except UnprovedError as error:
        return Rung(ladder=ladder.name, rung=task.rung), [f"{label}: {error}"]
    for entry in tested:
        renderer = renderers.get(entry) if isinstance(entry, str) else entry
        name = renderer.name
        if name in task.failed:
            if task.failed[name]:
                steps[name] = Step(renderer=name, failed=task.failed[name])
            continue
        if say:
            say(name)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", tracer.SceneWarning)
                steps[name] = measure(proof, renderer, label)
        except RendererError as error:
            steps[name] = Step(renderer=name, failed=str(error).splitlines()[0])
    return (
        Rung(
            ladder=ladder.name,
            rung=task.rung,
            proved=len(proof.x),
            exempt=int(proof.unsettled.sum()),
            unproved=len(proof.unproved),
            seconds=time.monotonic() - start,
            steps=steps,
        ),
        [],
    )


def _work(tested: Sequence[Named], settings: Settings, seconds: float, task: _Task, teller: Teller) -> None:
    """In another process: each renderer has so many seconds."""
    teller.found(climb(task, tested, settings, lambda name: teller.doing(name, seconds)))


Found: TypeAlias = tuple[Rung, list[str]]


@dataclass
class _Climbers:
    """The tasks that are left, and by ladder the renderers that have failed there: they are not asked again."""

    tasks: deque[_Task]
    out: dict[str, set[str]] = field(default_factory=dict)

    def following(self) -> _Task | None:
        """The next task, without those."""
        if not self.tasks:
            return None
        task = self.tasks.popleft()
        return replace(task, failed={**dict.fromkeys(self.out.get(task.found.name, ()), ""), **task.failed})

    def see(self, rung: Rung) -> None:
        """Who has failed on a rung."""
        self.out.setdefault(rung.ladder, set()).update(name for name, step in rung.steps.items() if step.failed)


def _here(tasks: deque[_Task], tested: tuple[Named, ...], settings: Settings) -> Generator[Found]:
    """In this process."""
    climbers = _Climbers(tasks)
    while task := climbers.following():
        found = climb(task, tested, settings)
        climbers.see(found[0])
        yield found


def _in_processes(
    tasks: deque[_Task], tested: tuple[Named, ...], settings: Settings, jobs: int, seconds: float
) -> Generator[Found]:
    """In others, which are ended where they take too long."""
    climbers = _Climbers(tasks)
    pool = Pool(functools.partial(_work, tested, settings, seconds), min(jobs, len(tasks)), seconds)
    with closing(pool.run(climbers.following)) as run:
        for worker, what, value in run:
            task = worker.task
            assert task is not None
            words = {"crashed": f"crashed: {value}", "hangs": f"hangs: {value}"}.get(what, value)
            if what == "found":
                climbers.see(value[0])
                yield value
            elif what != "fault" and worker.doing and not task.failed.get(worker.doing):
                # What it was doing is done again without the culprit.
                tasks.appendleft(replace(task, failed={**task.failed, worker.doing: words}))
            else:
                name, who = task.found.name, "" if what == "fault" else "the judge "
                yield Rung(ladder=name, rung=task.rung), [f"{name} {task.rung}: {who}{words}"]


# ---- all of them


@dataclass(kw_only=True)
class Stability(Outcome):
    """What `stability` found."""

    ladders: Sequence[Ladder]
    tested: tuple[str, ...] = ()
    precisions: Mapping[str, str] = field(default_factory=dict)
    rungs: dict[tuple[str, str], Rung] = field(default_factory=dict)
    files: Mapping[tuple[str, str], Path] = field(default_factory=dict)
    date: str = field(default_factory=now)
    seconds: float = 0.0
    interrupted: bool = False

    @property
    def progress(self) -> str:
        """How far it went."""
        return f"{len(self.rungs)} of {sum(len(ladder.rungs) for ladder in self.ladders)} rungs"

    def steps(self, ladder: Ladder, renderer: str) -> list[tuple[str, Step | None]]:
        """Of every rung; None where there is nothing."""
        found = [(rung, self.rungs.get((ladder.name, rung))) for rung in ladder.rungs]
        return [(rung, entry.steps.get(renderer) if entry else None) for rung, entry in found]

    def breaks(self, ladder: Ladder, renderer: str, standard: str = "own") -> tuple[str, Step] | None:
        """The first rung on which a renderer says something wrong, or fails."""
        for rung, step in self.steps(ladder, renderer):
            if step and (step.failed or step.broken(standard)):
                return rung, step
        return None

    def silent_from(self, ladder: Ladder, renderer: str, standard: str = "own") -> str | None:
        """The first of the rungs up to the last on which there is nothing to hold it to; None where there is."""
        first = None
        for rung, step in reversed(self.steps(ladder, renderer)):
            if step is None or not step.silent(standard):
                break
            first = rung
        return first

    def cell(self, ladder: Ladder, renderer: str, standard: str = "own") -> str:
        """Of the table: "-" holds, a rung breaks there, "!" fails there, "(...)" says nothing from there on."""
        if found := self.breaks(ladder, renderer, standard):
            return f"!{found[0]}" if found[1].failed else found[0]
        steps = [step for _, step in self.steps(ladder, renderer) if step]
        if not steps:
            return "?"
        if all(step.refused for step in steps):
            return "refused"
        silent = self.silent_from(ladder, renderer, standard)
        return f"({silent})" if silent else "-"

    def short(self, renderer: str) -> str:
        """A name without its variant, where no other variant takes part."""
        base = renderer.partition("@")[0]
        alone = sum(name.partition("@")[0] == base for name in self.tested) == 1
        return base if alone and not renderer.startswith("cmd:") else renderer

    def drawing(self, renderer: str) -> float:
        """The seconds that it took to draw all of it."""
        return sum(rung.steps[renderer].seconds for rung in self.rungs.values() if renderer in rung.steps)

    def end(self, ladder: Ladder, renderer: str) -> int:
        """How many rungs a renderer climbs: until it breaks, or no pixel is left to hold it to, as a careful one."""
        found, silent = self.breaks(ladder, renderer, "careful"), self.silent_from(ladder, renderer, "careful")
        ends = [ladder.rungs.index(rung) for rung in (found[0] if found else None, silent) if rung]
        return min(ends, default=len(ladder.rungs))

    def outlasted(self) -> Iterator[tuple[Ladder, str, str]]:
        """Our kernels, and who of the same format goes on where they end."""
        for ladder in self.ladders:
            for ours in self.tested:
                for other in self.tested:
                    same = self.precisions[other] == self.precisions[ours]
                    if ours.startswith("native-") and same and self.end(ladder, other) > self.end(ladder, ours):
                        yield ladder, ours, other

    def outlasted_says(self) -> Iterator[str]:
        """The same in words."""
        for ladder, ours, other in self.outlasted():
            end = ladder.rungs[self.end(ladder, ours)]
            refused = self.rungs[ladder.name, end].steps[ours].refused
            if (self.breaks(ladder, ours, "careful") or [""])[0] == end:
                how = "breaks"
            elif refused:
                how = f"refuses ({refused.partition('error: ')[2] or refused})"
            else:
                how = "says nothing"
            yield f"{ladder.name}: {other} goes on where {ours} {how}, at {end}"

    @property
    def status(self) -> int:
        """The exit status: 0 all hold, 1 one breaks, 3 a renderer failed or nothing was drawn."""
        if trouble := self.trouble(anything=bool(self.rungs) or self.interrupted):
            return trouble
        return int(any(self.breaks(ladder, name) for ladder in self.ladders for name in self.tested))

    def record(self) -> Record:
        """Everything as strictly valid JSON."""
        return records.result(
            "stability",
            {
                "ok": self.status == 0 and not self.interrupted,
                "command": list(self.command),
                "settings": vars(self.settings).copy(),
                "versions": self.versions,
                "interrupted": self.interrupted,
                "date": self.date,
                "seconds": self.seconds,
                "renderers": [
                    {"name": name, "precision": self.precisions[name], "seconds": self.drawing(name)}
                    for name in self.tested
                ],
                "ladders": [self._ladder(ladder) for ladder in self.ladders],
                "outlasted": [
                    {"ladder": ladder.name, "renderer": ours, "by": other} for ladder, ours, other in self.outlasted()
                ],
                "notes": [vars(note).copy() for note in self.notes],
                "failures": [vars(note).copy() for note in self.failures],
            },
        )

    def _ladder(self, ladder: Ladder) -> Record:
        def first(name: str, standard: str) -> str | None:
            found = self.breaks(ladder, name, standard)
            return found[0] if found else None

        return {
            "name": ladder.name,
            "about": ladder.about,
            "parameter": ladder.parameter,
            "breaks": {name: first(name, "own") for name in self.tested},
            "breaks_careful": {name: first(name, "careful") for name in self.tested},
            "silent_from": {name: self.silent_from(ladder, name) for name in self.tested},
            "silent_from_careful": {name: self.silent_from(ladder, name, "careful") for name in self.tested},
            "rungs": [self._rung(ladder, rung) for rung in ladder.rungs],
        }

    def _rung(self, ladder: Ladder, rung: str) -> Record:
        found = self.rungs.get((ladder.name, rung))
        path = self.files.get((ladder.name, rung))
        head: Record = {"rung": rung, "file": path and str(path)}
        if found is None:
            return head | {"steps": {}}
        counts = {name: getattr(found, name) for name in ("proved", "exempt", "unproved", "seconds")}
        return head | counts | {"steps": {name: _step(step) for name, step in found.steps.items()}}


def _step(step: Step) -> Record:
    entry = {name: value for name, value in vars(step).items() if name not in ("renderer", "own", "careful")}
    for standard in ("own", "careful"):
        held = step.of(standard)
        entry[standard] = held and {
            "held": held.held,
            "colors": held.colors,
            "wrong": held.wrong,
            "ratio": held.ratio,
            "worst": held.worst
            and {"pass" if name == "pass_name" else name: value for name, value in vars(held.worst).items()},
        }
    return entry


def stability(
    ladders: Sequence[Ladder | str] | None = None,
    tested: Sequence[Named] | None = None,
    *,
    settings: Settings | None = None,
    jobs: int = 1,
    write: Path | None = None,
    seconds: float = SECONDS,
    progress: Callable[[str], None] | None = None,
    command: Sequence[str] = (),
) -> Stability:
    """Climb ladders, all unless told, with renderers, all that can run here unless told.

    `jobs`: processes; 0: none but this one, where a renderer that hangs or crashes takes all with it. `write`: a folder
    for the scenes. `seconds`: that a renderer may take for a rung.

    Raises:
        KeyError: there is no such ladder.
        renderers.UnknownRendererError: no renderer has that name.
        OSError: a file cannot be written.
    """
    settings = settings or Settings(threads=1)  # small images
    chosen = [get(entry) if isinstance(entry, str) else entry for entry in (ladders or LADDERS)]
    # By name where they have one: what is found in every process need not be sent.
    named = tested or [entry.name for entry in renderers.best()]
    asked = {renderers.get(entry) if isinstance(entry, str) else entry: entry for entry in named}
    result = Stability(settings=settings, ladders=chosen, versions=versions(asked), command=command)
    usable = result.usable(asked)
    result.tested = tuple(entry.name for entry in usable)
    result.precisions = {entry.name: str(getattr(entry, "precision", "")) for entry in usable}
    if write:
        result.files = write_scenes(chosen, write)
    if not usable:
        return result
    sent = tuple(asked[entry] for entry in usable)
    # By name where it can be: a function without a name cannot be sent.
    known = {id(ladder) for ladder in LADDERS}
    tasks = deque(
        _Task(ladder.name if id(ladder) in known else ladder, rung) for ladder in chosen for rung in ladder.rungs
    )
    start, left = time.monotonic(), TimeLeft(len(tasks))

    def tell() -> None:
        if progress:
            progress(f"{result.progress}{left.says(len(result.rungs))}")

    tell()
    run = _in_processes(tasks, sent, settings, jobs, seconds) if jobs else _here(tasks, sent, settings)
    try:
        for found, trouble in run:
            result.rungs[found.ladder, found.rung] = found
            for text in trouble:
                result.fail(Note(f"{found.ladder} {found.rung}", "", text))
            for name, step in found.steps.items():
                if step.failed:
                    result.fail(Note(f"{found.ladder} {found.rung}", name, step.failed))
            tell()
    except KeyboardInterrupt:
        if not result.rungs:
            raise
        result.interrupted = True
    finally:
        run.close()
    result.seconds = time.monotonic() - start
    return result


def write_scenes(ladders: Sequence[Ladder], folder: Path) -> dict[tuple[str, str], Path]:
    """Every rung as a scene file: FOLDER/LADDER/00-1e1.txt and so on."""
    files: dict[tuple[str, str], Path] = {}
    for ladder in ladders:
        (folder / ladder.name).mkdir(parents=True, exist_ok=True)
        for place, rung in enumerate(ladder.rungs):
            path = folder / ladder.name / f"{place:02}-{rung}.txt"
            with write_beside(path) as temporary:
                temporary.write_text(ladder.scene(rung).text(), encoding="utf-8")
            files[ladder.name, rung] = path
    return files


# ---- printed


def print_stability(result: Stability) -> None:
    """Where each renderer breaks on each ladder: held to its own claims, then as a careful renderer of its format."""
    if result.rungs:
        _print_table(result, "own", "held to what each claims to tell: the rung on which it first breaks")
        _print_table(result, "careful", "held to 64 roundings u of its format: the rung on which it first breaks")
        click.echo(LEGEND)
        click.echo("breaks: a decision wrong above the margin, a colour off by more than its tolerance, NaN or Inf")
        click.echo("64 u: decisions above that margin; colours too where the format is float64 or float32 throughout")
        click.echo("seconds of drawing: " + ", ".join(f"{name} {result.drawing(name):.2g}" for name in result.tested))
    broken = [
        (ladder, name, found)
        for name in result.tested
        for ladder in result.ladders
        if (found := result.breaks(ladder, name)) and not found[1].failed
    ]
    for ladder, name, (rung, step) in broken[:TOLD]:
        click.secho(f"{name}: {ladder.name} {rung}: {step.says('own')}", fg="red", color=colorful())
        _print_worst(result, ladder, rung, step)
    if len(broken) > TOLD:
        click.echo(f"and {len(broken) - TOLD} more, which --json has")
    if broken and not result.files:
        click.echo("  hint: --write DIR keeps the scenes, for `whitted explain`")
    for line in result.outlasted_says():
        click.echo(f"note: {line}")
    print_failures(result)
    if not result.tested:
        click.echo("nothing was climbed")
        return
    holding = sum(all(not result.breaks(ladder, name) for ladder in result.ladders) for name in result.tested)
    rungs = result.progress if result.interrupted else counted(len(result.rungs), "rung")
    words = f"{holding} of {len(result.tested)} renderers hold"
    on = "as far as that goes" if result.interrupted else f"on all of {counted(len(result.ladders), 'ladder')}"
    click.echo(f"{rungs} in {duration(result.seconds)}: {words} {on}")


def _print_table(result: Stability, standard: str, title: str) -> None:
    from rich.table import Table
    from rich.text import Text

    out = console()
    out.print(title, style="bold", markup=False)
    cells = {
        result.short(name): [result.cell(ladder, name, standard) for ladder in result.ladders] for name in result.tested
    }
    first = (
        max(len(ladder.name) for ladder in result.ladders) + 2 + max(len(ladder.rungs[-1]) for ladder in result.ladders)
    )
    # As many columns side by side as there is room for.
    width = max((max(map(len, (name, *column))) + 2 for name, column in cells.items()), default=1)
    some = max(1, (out.width - first) // width)
    for begin in range(0, len(cells), some):
        table = Table(box=None, pad_edge=False, header_style="bold")
        for header in ("ladder", "to", *list(cells)[begin : begin + some]):
            table.add_column(header, no_wrap=True)
        for place, ladder in enumerate(result.ladders):
            texts = [column[place] for column in list(cells.values())[begin : begin + some]]
            bad = (Text(text, style="" if text[0] in "-(?r" else "bold red") for text in texts)
            table.add_row(ladder.name, ladder.rungs[-1], *bad)
        out.print(table)
        out.print()


def _print_worst(result: Stability, ladder: Ladder, rung: str, step: Step) -> None:
    worst = step.own.worst if step.own else None
    if worst is None:
        return
    channel = f" {worst.channel}" if worst.channel else ""
    click.echo(
        f"  {worst.pass_name} at x {worst.x}, y {worst.y}{channel}: {worst.drawn!r}, exact is {worst.exact!r}; "
        f"margin {number(worst.margin)}, {number(worst.claim)} of what it claims to tell"
    )
    path = result.files.get((ladder.name, rung))
    if path:
        scene = ladder.scene(rung)
        click.echo(f"  hint: {explain_command(str(path), scene, result.settings, worst.x, worst.y, [step.renderer])}")
