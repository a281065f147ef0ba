"""Draws random scenes with all renderers, and keeps the smallest scenes that show what nothing explains."""

from __future__ import annotations

import contextlib
import functools
import re
import shlex
import time
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import click
import numpy as np

import tracer
from tracer import Scene
from tracer.passes import lookup, write_beside
from validation import certify, records, renderers
from validation.minimise import Pixel, Small, minimise, size
from validation.parting import SUMS
from validation.processes import Pool, Teller
from validation.random_scenes import Drawn, draw_scene
from validation.records import Record
from validation.renderers import Renderer, Settings
from validation.run import InputError, Note, Outcome, Rendered, RendererError, explain_command, validate, versions
from validation.terminal import TOO_MANY, colorful, console, counted, print_failures
from validation.timing import TimeLeft, duration
from validation.truth import UnprovedError

if TYPE_CHECKING:
    from validation.compare import Comparison
    from validation.court import Finding
    from validation.verdict import Verdict

Named: TypeAlias = str | Renderer

#: What all others are held against: it claims the least uncertainty, so that a pair's tolerance is all but the other's
#: own. Every pair of the others would be held to the sum of theirs, which finds nothing that these pairs do not.
REFERENCE = "native-f64"
#: The most pixels of a scene and pair that are judged.
MOST_JUDGED = 40
#: Pixels of the reference that are proved in each scene: random ones, and those of the smallest margins. What it has
#: in common with the others no comparison would show.
PROVED, HARDEST = 6, 12
#: Seconds that a scene may take, and those for making one smaller.
SCENE_SECONDS, SMALLER_SECONDS = 300.0, 60.0
#: So many scenes that show the same kind of failure are made smaller; the smallest stays.
TRIED_OF_A_KIND = 2
#: What differs from scene to scene in a sentence.
NUMBER = re.compile(r"\d+([.]\d+)?(e[+-]?\d+)?")
#: Failures of the renderer itself, not of what it drew.
BROKEN = ("failed", "crashed", "hangs")


class Kind(NamedTuple):
    """What failures have in common, whatever the scene.

    `what`: "unexplained" or "mistake", a verdict; "unproved", a pixel that truth cannot say; "over tolerance", interior
    pixels off in spite of an explanation; "disproved", the reference against truth alone; "malformed", NaN and such;
    "failed", "crashed", "hangs". `decision`: the kind that the verdict names, or what is wrong in words.
    """

    renderer: str
    what: str
    decision: str = ""
    pass_name: str = ""

    def slug(self) -> str:
        """As part of the name of a file."""
        name = re.sub(r"\W+", "-", self.renderer).strip("-")[:40]
        return "-".join(filter(None, (name, self.what.replace(" ", "-"), self.pass_name.replace(".", "-").strip("-*"))))


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Something that no renderer may do, and the scene that shows it.

    `at`: a pixel (column, row), if it is about one; `drawn`: of its pass by renderer, and by "truth" the exact value.
    """

    kind: Kind
    renderer: str
    reference: str
    sentence: str
    scene: Scene
    at: Pixel | None = None
    pass_name: str = ""
    drawn: Mapping[str, Sequence[float]] = field(default_factory=dict)
    tolerance: float | None = None
    index: int = -1
    theme: str = ""
    found_in: Scene | None = None
    tried: int = 0
    finished: bool = False


@dataclass
class Tally:
    """What came of one renderer."""

    scenes: int = 0
    refused: int = 0  # scenes that it cannot carry
    compared: int = 0
    agree: int = 0
    undecided: int = 0  # comparisons with more edges than outlines explain
    causes: Counter[str] = field(default_factory=Counter)  # pixels that are off by cause
    rules: Counter[str] = field(default_factory=Counter)  # those of a documented rule, by its words

    def add(self, other: Tally) -> None:
        """Count both."""
        self.scenes += other.scenes
        self.refused += other.refused
        self.compared += other.compared
        self.agree += other.agree
        self.undecided += other.undecided
        self.causes.update(other.causes)
        self.rules.update(other.rules)


@dataclass
class Seen:
    """What came of one scene."""

    index: int
    theme: str
    twists: tuple[str, ...]
    tallies: dict[str, Tally] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)  # the first of each kind
    counts: Counter[Kind] = field(default_factory=Counter)
    seconds: float = 0.0


# ---- one scene


def examine(
    scene: Scene,
    tested: Sequence[Named],
    reference: Named,
    settings: Settings,
    *,
    proved: bool = True,
    progress: Callable[[str], None] | None = None,
) -> tuple[dict[str, Tally], list[Failure]]:
    """Draw a scene with all renderers and judge where they differ; failures in the order in which they are found."""
    tallies: dict[str, Tally] = {}
    failures: list[Failure] = []

    def tally(name: str) -> Tally:
        return tallies.setdefault(name, Tally())

    def add(rendered: Rendered) -> None:
        failures.extend(_judged(rendered, tally))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tracer.SceneWarning)  # copies of spheres
        found = validate(
            {"scene": scene},
            tested,
            reference,
            settings=settings,
            verdicts=MOST_JUDGED,
            on_rendered=add,
            progress=progress,
        )
        for failure in found.failures:
            words = failure.message.splitlines()[0]
            kind = Kind(failure.renderer, "failed", NUMBER.sub("...", words)[:80])
            other = _name(reference)
            side = failure.renderer or other
            failures.append(Failure(kind=kind, renderer=side, reference=other, sentence=words, scene=scene))
        pairs = {(comparison.renderer, comparison.reference) for comparison in found.comparisons}
        for name in {name for pair in pairs for name in pair}:
            tally(name).scenes += 1
        for comparison in found.comparisons:
            entry = tally(comparison.renderer)
            entry.compared += 1
            entry.agree += comparison.ok
            entry.undecided += any(reason.startswith(TOO_MANY) for reason in comparison.reasons)
        for note in found.notes:
            if "cannot carry this scene" in note.message:
                tally(note.renderer).refused += 1
        if proved:
            if progress:
                progress(f"scene: {_name(reference)} against truth")
            failures += _disproved(scene, reference, settings)
    return tallies, failures


def _name(renderer: Named) -> str:
    return renderers.get(renderer).name if isinstance(renderer, str) else renderer.name


def _judged(rendered: Rendered, tally: Callable[[str], Tally]) -> Iterator[Failure]:
    """Of a pair: count what is explained, and yield what is not."""
    verdicts = rendered.verdicts
    at: dict[Pixel, Verdict] = {}
    first = rendered.comparisons[0] if rendered.comparisons else None
    if first is None:
        return
    pair: dict[str, Any] = {"renderer": first.renderer, "reference": first.reference, "scene": rendered.scene}
    for verdict in verdicts.verdicts if verdicts else ():
        at[verdict.x, verdict.y] = verdict
        for finding in verdict.findings:
            if finding.right:
                continue
            tally(finding.renderer).causes[finding.cause] += 1
            if finding.cause == "rule":
                tally(finding.renderer).rules[NUMBER.sub("...", finding.because)] += 1
            if not finding.explained:
                yield _verdict(rendered, verdict, finding)
    for x, y in verdicts.unproved if verdicts else ():
        tally(first.renderer).causes["unproved"] += 1
        sentence = "truth could not be had at any precision"
        yield Failure(kind=Kind(first.renderer, "unproved"), sentence=sentence, at=(x, y), **pair)
    over = [_over(comparison, at, pair) for comparison in rendered.comparisons if comparison.interior_over]
    # The same pixels are off in sums of what is off.
    yield from sorted(filter(None, over), key=lambda failure: _rank(failure.pass_name))[:1]
    for comparison in rendered.comparisons:
        for reason in comparison.reasons:
            if not (reason.startswith(TOO_MANY) or "interior pixels over tolerance" in reason):
                side = next((name for name in (first.renderer, first.reference) if reason.startswith(name)), "")
                words = re.sub(r", first at.*|\d+", "", reason.removeprefix(side)).strip()
                kind = Kind(side or first.renderer, "malformed", words, _family(comparison.pass_name))
                place = re.search(r"first at x (\d+), y (\d+)", reason)
                where = (int(place[1]), int(place[2])) if place else None
                yield Failure(kind=kind, sentence=reason, at=where, pass_name=comparison.pass_name, **pair)


def _over(comparison: Comparison, at: Mapping[Pixel, Verdict], pair: Mapping[str, Any]) -> Failure | None:
    """Interior pixels over tolerance; None where a verdict has told of them."""
    worst = comparison.worst
    assert worst is not None
    told = at.get((worst.x, worst.y))
    # Where nothing explains it, there is a verdict that says so; of a sample another pixel's.
    for verdict in [told] if told else at.values():
        if not verdict.explained and _family(comparison.pass_name) in map(_family, verdict.passes):
            return None
    wrong = [finding for finding in (told.findings if told else ()) if not finding.right]
    return Failure(
        kind=Kind(
            comparison.renderer, "over tolerance", " ".join(f.cause for f in wrong), _family(comparison.pass_name)
        ),
        sentence="; ".join((*comparison.reasons, *(f"{finding.renderer}: {finding.because}" for finding in wrong))),
        at=(worst.x, worst.y),
        pass_name=comparison.pass_name,
        drawn={comparison.renderer: (worst.a,), comparison.reference: (worst.b,)},
        tolerance=comparison.tolerance,
        **pair,
    )


def _rank(name: str) -> tuple[bool, bool, bool]:
    """A part before the sums that it goes into."""
    return name != "id", not name.startswith("shadow"), name in SUMS


def _family(name: str) -> str:
    return lookup(name).name if name else ""


def _verdict(rendered: Rendered, verdict: Verdict, finding: Finding) -> Failure:
    """A pixel of which nothing explains what one side drew."""
    name = min(finding.errors, key=_rank)
    decision = finding.decision
    x, y = verdict.x, verdict.y
    drawn: dict[str, Sequence[float]] = {
        side.renderer: [float(value) for value in np.atleast_1d(passes[name][y, x])]
        for side, passes in zip(verdict.findings, (rendered.renderer, rendered.reference), strict=True)
        if name in passes
    }
    if name in verdict.truth.values:
        drawn["truth"] = [ball.value for ball in verdict.truth.values[name]]
    comparison = next((entry for entry in rendered.comparisons if entry.pass_name == name), None)
    says = f"{decision.says}: " if decision else ""
    return Failure(
        kind=Kind(finding.renderer, finding.cause, decision.kind if decision else "", _family(name)),
        renderer=rendered.comparisons[0].renderer,
        reference=rendered.comparisons[0].reference,
        sentence=f"{finding.renderer} {says}{finding.because}",
        scene=rendered.scene,
        at=(x, y),
        pass_name=name,
        drawn=drawn,
        tolerance=None if comparison is None or comparison.maps is None else float(comparison.maps.tolerance[y, x]),
    )


def _disproved(scene: Scene, reference: Named, settings: Settings) -> Iterator[Failure]:
    """Pixels of the reference that are not what truth says, though it claims to tell."""
    name = _name(reference)
    try:
        proof = certify.prove_scene(scene, settings, pixels=PROVED, edges=HARDEST, jobs=1)
        certificate = certify.certify(scene, reference, settings, proof=proof)
    except (UnprovedError, RendererError, InputError):
        return  # nothing to hold it against, or told already
    for miss in certificate.misses:
        if miss.claim >= 1:
            yield Failure(
                kind=Kind(name, "disproved"),
                renderer=name,
                reference=name,
                sentence=f"{name} is off by {miss.error:.3g} where {miss.tolerance:.3g} is allowed",
                scene=scene,
                at=(miss.x, miss.y),
                pass_name=miss.pass_name,
                drawn={name: (miss.drawn,), "truth": (miss.exact,)},
                tolerance=miss.tolerance,
            )


def smaller(failure: Failure, tested: Sequence[Named], reference: Named, settings: Settings, seconds: float) -> Failure:
    """The same kind of failure in the smallest scene that shows it, as far as the time allows."""
    named = [entry for entry in tested if _name(entry) in (failure.renderer, failure.kind.renderer)]
    proved = failure.kind.what == "disproved"
    latest: list[Failure] = [failure]

    def shows(scene: Scene) -> Pixel | None:
        _, found = examine(scene, named, reference, settings, proved=proved)
        for other in found:
            if other.kind == failure.kind:
                latest.append(other)
                return other.at or (0, 0)
        return None

    small: Small = minimise(failure.scene, failure.at or (0, 0), shows, seconds)
    return replace(
        latest[-1],
        index=failure.index,
        theme=failure.theme,
        found_in=failure.scene,
        tried=small.tried,
        finished=small.finished,
    )


def _see(
    drawn: Drawn,
    index: int,
    tested: Sequence[Named],
    reference: Named,
    settings: Settings,
    progress: Callable[[str], None] | None = None,
) -> Seen:
    """One scene of a campaign."""
    start = time.monotonic()
    tallies, failures = examine(drawn.scene, tested, reference, settings, progress=progress)
    seen = Seen(index, drawn.theme, drawn.twists, tallies)
    for failure in failures:
        if not seen.counts[failure.kind]:
            seen.failures.append(replace(failure, index=index, theme=drawn.theme))
        seen.counts[failure.kind] += 1
    seen.seconds = time.monotonic() - start
    return seen


# ---- many scenes, in processes of their own


@dataclass(frozen=True)
class _Order:
    """What a process is to do with every index that it gets."""

    seed: int
    tested: tuple[Named, ...]
    reference: Named
    settings: Settings
    scene_seconds: float
    seconds: float


@dataclass(frozen=True)
class _Task:
    """The scene of an index; failures of these kinds have been made smaller often enough."""

    index: int
    enough: frozenset[Kind]


def _work(order: _Order, task: _Task, teller: Teller) -> None:
    """In another process: say what came of a scene, then each failure in a smaller one."""

    def say(what: str) -> None:
        # A pixel that is judged is no news of the pair; "scene" is what the only one is called.
        teller.doing(what.partition("scene: ")[2])

    seen = _see(draw_scene(order.seed, task.index), task.index, order.tested, order.reference, order.settings, say)
    teller.found(seen)
    for failure in seen.failures:
        if failure.kind not in task.enough:
            teller.doing(f"{failure.renderer} against {failure.reference}", order.scene_seconds + order.seconds)
            teller.found(smaller(failure, order.tested, order.reference, order.settings, order.seconds))


# ---- a campaign


@dataclass
class Found:
    """Failures of one kind: how many pixels or comparisons, in how many scenes, and the smallest scene."""

    smallest: Failure
    count: int = 0
    scenes: int = 0
    made_smaller: int = 0
    kept: bool = False
    path: Path | None = None


@dataclass(kw_only=True)
class Campaign(Outcome):
    """What `fuzz` found."""

    seed: int
    first: int
    asked: int
    reference: str
    tested: tuple[str, ...] = ()
    done: int = 0
    seconds: float = 0.0
    interrupted: bool = False
    themes: Counter[str] = field(default_factory=Counter)
    twists: Counter[str] = field(default_factory=Counter)
    tallies: dict[str, Tally] = field(default_factory=dict)
    kinds: dict[Kind, Found] = field(default_factory=dict)
    slowest: tuple[float, int] = (0.0, -1)

    @property
    def status(self) -> int:
        """The exit status: 0 everything is explained, 1 something is not, 3 a renderer failed or nothing was drawn."""
        if any(kind.what in BROKEN for kind in self.kinds):
            return 3
        if trouble := self.trouble(anything=bool(self.done) or self.interrupted):
            return trouble
        return 1 if self.kinds else 0

    @property
    def progress(self) -> str:
        """How far it went."""
        return f"{self.done} of {self.asked} scenes"

    def add(self, seen: Seen, *, again: bool = False) -> None:
        """Count a scene; `again`: what came of it later."""
        if not again:
            self.done += 1
            self.themes[seen.theme] += 1
            self.twists.update(seen.twists)
        self.slowest = max(self.slowest, (seen.seconds, seen.index))
        for name, tally in seen.tallies.items():
            self.tallies.setdefault(name, Tally()).add(tally)
        for failure in seen.failures:
            found = self.kinds.setdefault(failure.kind, Found(failure))
            found.count += seen.counts[failure.kind]
            found.scenes += 1

    def record(self) -> Record:
        """Everything as strictly valid JSON."""
        return records.result(
            "fuzz",
            {
                "ok": self.status == 0 and not self.interrupted,
                "command": list(self.command),
                "settings": vars(self.settings).copy(),
                "versions": self.versions,
                "seed": self.seed,
                "first": self.first,
                "asked": self.asked,
                "done": self.done,
                "interrupted": self.interrupted,
                "seconds": self.seconds,
                "slowest": {"seconds": self.slowest[0], "index": self.slowest[1]},
                "reference": self.reference,
                "renderers": {name: vars(tally).copy() for name, tally in sorted(self.tallies.items())},
                "themes": dict(sorted(self.themes.items())),
                "twists": dict(sorted(self.twists.items())),
                "kinds": [
                    {
                        "count": found.count,
                        "scenes": found.scenes,
                        "file": found.path and str(found.path),
                        **_record(found.smallest, self.seed),
                    }
                    for found in self.kinds.values()
                ],
                "notes": [vars(note).copy() for note in self.notes],
                "failures": [vars(note).copy() for note in self.failures],
            },
        )


def best() -> list[str]:
    """Every renderer that can run here, the best variant of each, without the reference."""
    bases = dict.fromkeys(entry.name.partition("@")[0] for entry in renderers.all())
    found = [renderers.get(base) for base in bases]
    return [entry.name for entry in found if entry.name != REFERENCE and entry.unavailable() is None]


def fuzz(
    scenes: int,
    tested: Sequence[Named] | None = None,
    *,
    seed: int = 0,
    first: int = 0,
    reference: Named = REFERENCE,
    settings: Settings | None = None,
    jobs: int = 1,
    output: Path | None = None,
    scene_seconds: float = SCENE_SECONDS,
    smaller_seconds: float = SMALLER_SECONDS,
    progress: Callable[[str], None] | None = None,
    command: Sequence[str] = (),
) -> Campaign:
    """Draw that many random scenes with renderers, each held against the reference.

    `tested`: None: all that can run here. `jobs`: processes; 0: none but this one, where a renderer that hangs or
    crashes takes all with it. `output`: where the smallest scene of every kind of failure is kept.

    Raises:
        renderers.UnknownRendererError: no renderer has that name.
        OSError: a file cannot be written.
    """
    settings = settings or Settings(threads=1)  # small images
    # By name where they have one: what is found in every process need not be sent.
    asked = {renderers.get(entry) if isinstance(entry, str) else entry: entry for entry in (tested or best())}
    against = renderers.get(reference) if isinstance(reference, str) else reference
    sides = list(dict.fromkeys([*asked, against]))
    result = Campaign(
        settings=settings,
        seed=seed,
        first=first,
        asked=scenes,
        reference=against.name,
        versions=versions(sides),
        command=command,
    )
    usable = [entry for entry in result.usable(sides) if entry is not against]
    if not usable or any(failure.renderer == against.name for failure in result.failures):
        return result
    result.tested = tuple(entry.name for entry in usable)
    sent = tuple(asked[entry] for entry in usable)
    order = _Order(seed, sent, reference, settings, scene_seconds, smaller_seconds)
    start, left = time.monotonic(), TimeLeft(scenes)

    def tell() -> None:
        if progress:
            kinds = f"{counted(len(result.kinds), 'kind')} of failures"
            progress(f"{result.progress}, {kinds}{left.says(result.done)}")

    tell()
    indices = iter(range(first, first + scenes))
    try:
        run = _in_processes(result, order, indices, min(jobs, scenes)) if jobs else _here(order, indices)
        with contextlib.closing(run):
            for what, value in run:
                if what in ("seen", "again"):
                    result.add(value, again=what == "again")
                    for failure in value.failures:
                        _keep(result, failure, output, is_smaller=False)
                    tell()
                elif what == "smaller":
                    _keep(result, value, output, is_smaller=True)
                else:
                    result.fail(Note("", "", value))
    except KeyboardInterrupt:
        if not result.done:
            raise
        result.interrupted = True
    result.seconds = time.monotonic() - start
    return result


Event: TypeAlias = tuple[str, Any]


def _here(order: _Order, indices: Iterable[int]) -> Generator[Event]:
    """In this process."""
    counts: Counter[Kind] = Counter()
    for index in indices:
        seen = _see(draw_scene(order.seed, index), index, order.tested, order.reference, order.settings)
        yield "seen", seen
        for failure in seen.failures:
            if counts[failure.kind] < TRIED_OF_A_KIND:
                counts[failure.kind] += 1
                yield "smaller", smaller(failure, order.tested, order.reference, order.settings, order.seconds)


def _in_processes(result: Campaign, order: _Order, indices: Iterator[int], jobs: int) -> Generator[Event]:
    """In others, which are ended where they take too long."""

    def following() -> _Task | None:
        enough = frozenset(kind for kind, found in result.kinds.items() if found.made_smaller >= TRIED_OF_A_KIND)
        return next((_Task(index, enough) for index in indices), None)

    seen: set[int] = set()
    pool = Pool(functools.partial(_work, order), jobs, order.scene_seconds)
    with contextlib.closing(pool.run(following)) as run:
        for worker, what, value in run:
            assert worker.task is not None
            index = worker.task.index
            if what == "fault":
                yield what, f"scene {index}: {value}"
            elif what == "found" and isinstance(value, Failure):
                yield "smaller", value
            else:
                found = value if what == "found" else _broken(index, worker.doing, order, what, value)
                yield "again" if index in seen else "seen", found
                seen.add(index)


def _broken(index: int, doing: str, order: _Order, what: str, sentence: str) -> Seen:
    """A scene that ended its process, or that its process did not end."""
    drawn = draw_scene(order.seed, index)
    name, _, other = doing.partition(" against ")
    other = other if other not in ("", "truth") else _name(order.reference)
    kind = Kind(name or "unknown", what)
    failure = Failure(
        kind=kind,
        renderer=name,
        reference=other,
        sentence=sentence + (f" ({doing})" if doing else ""),
        scene=drawn.scene,
        index=index,
        theme=drawn.theme,
    )
    return Seen(index, drawn.theme, drawn.twists, {}, [failure], Counter([kind]))


# ---- what is kept


def _keep(result: Campaign, failure: Failure, output: Path | None, *, is_smaller: bool) -> None:
    """Save a failure where it is the smallest of its kind."""
    found = result.kinds[failure.kind]
    found.made_smaller += is_smaller
    # One that is not smaller may still be as small as it gets: that is known of it then.
    again = is_smaller and failure.index == found.smallest.index and failure.scene == found.smallest.scene
    if found.kept and not again and not size(failure.scene) < size(found.smallest.scene):
        return
    found.smallest, found.kept = failure, True
    if output is None:
        return
    before, found.path = found.path, _save(result, failure, output)
    if before and before != found.path:
        for path in (before, before.with_suffix(".json")):
            path.unlink(missing_ok=True)


def _save(result: Campaign, failure: Failure, output: Path) -> Path:
    output.mkdir(parents=True, exist_ok=True)
    # Kinds that differ in their decision alone have the same words; the pixel's scene has an index of its own.
    decision = re.sub(r"\W+", "-", failure.kind.decision).strip("-")[:24]
    path = output / f"{failure.kind.slug()}{'-' * bool(decision)}{decision}-{result.seed}-{failure.index}.txt"
    scene = failure.scene.replace(output=f"{path.stem}.ppm", limits=False)
    with write_beside(path) as temporary:
        temporary.write_text(scene.text(), encoding="utf-8")
    names = list(dict.fromkeys([failure.renderer, failure.reference]))
    x, y = failure.at or (0, 0)
    commands = [explain_command(str(path), scene, Settings(), x, y, names)] if failure.at else []
    if len(names) > 1:
        commands.append(shlex.join(["whitted", "validate", str(path), "--renderer", names[0], "--against", names[1]]))
    elif failure.kind.what == "disproved":
        commands.append(shlex.join(["whitted", "truth", str(path), "--renderer", names[0], "--pixels", "all"]))
    commands.append(repeat(result.seed, failure.index, names))
    fields = _record(failure, result.seed) | {"versions": result.versions, "commands": commands}
    records.write(path.with_suffix(".json"), records.result("failure", fields))
    return path


def repeat(seed: int, index: int, names: Sequence[str]) -> str:
    """What to type to have the scene of an index drawn again."""
    words = ["whitted", "stability", "--fuzz", "1", "--seed", str(seed), "--first", str(index)]
    tested, reference = names[0], names[-1]
    if tested == reference:  # any other will do
        tested = "numpy-f64" if reference != "numpy-f64" else REFERENCE
    words += ["--renderer", tested]
    return shlex.join([*words, *(("--against", reference) if reference != REFERENCE else ())])


def _record(failure: Failure, seed: int) -> Record:
    before = failure.found_in or failure.scene
    return {
        "renderer": failure.kind.renderer,
        "pair": [failure.renderer, failure.reference],
        "what": failure.kind.what,
        "decision": failure.kind.decision,
        "pass": failure.pass_name,
        "pixel": None if failure.at is None else list(failure.at),
        "values": {name: list(values) for name, values in failure.drawn.items()},
        "tolerance": failure.tolerance,
        "sentence": failure.sentence,
        "seed": seed,
        "index": failure.index,
        "theme": failure.theme,
        "scene": failure.scene.text(),
        "found_in": before.text(),
        "tried": failure.tried,
        "finished": failure.finished,
    }


# ---- printed


def print_campaign(result: Campaign) -> None:
    """A row for each renderer, the themes, and what nothing explains."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("renderer", no_wrap=True)
    headers = ("scenes", "refused", "comparisons", "agree", "undecided", "rounding", "rule", "tie", "unexplained")
    for header in headers:
        table.add_column(header, justify="right")
    for name in (*result.tested, result.reference):
        entry = result.tallies.get(name)
        if entry is None:
            continue
        bad = sum(count for cause, count in entry.causes.items() if cause not in ("rounding", "rule", "tie"))
        counts: list[int] = [entry.scenes, entry.refused, entry.compared, entry.agree, entry.undecided]
        counts += [entry.causes[cause] for cause in ("rounding", "rule", "tie")] + [bad]
        table.add_row(name, *(str(count) if count else "-" for count in counts))
    if table.row_count:
        console().print(table)
        click.echo("scenes, comparisons: numbers of; refused: scenes that it cannot carry")
        click.echo("undecided: comparisons with more edges than the outlines explain: too little is told of the scene")
        click.echo(f"rounding to unexplained: pixels that are off, {MOST_JUDGED} of a scene and pair at most, by cause")
    for what, counter in (("themes", result.themes), ("twists", result.twists)):
        if counter:
            click.echo(f"{what}: " + ", ".join(f"{name} {count}" for name, count in sorted(counter.items())))
    for kind, found in result.kinds.items():
        text = f"{kind.renderer}: {' '.join(filter(None, (kind.what, kind.pass_name, kind.decision)))}"
        scenes = counted(found.scenes, "scene")
        click.secho(f"{text}: {found.count} in {scenes}: {found.smallest.sentence}", fg="red", color=colorful())
        again = repeat(result.seed, found.smallest.index, (found.smallest.renderer, found.smallest.reference))
        click.echo(f"  {found.path or again}")
    print_failures(result)
    speed = f", {result.seconds / result.done:.2g} s a scene" if result.done else ""
    click.echo(
        f"{result.progress} of seed {result.seed} from index {result.first} in "
        f"{duration(result.seconds)}{speed}: "
        + (f"{counted(len(result.kinds), 'kind')} of failures" if result.kinds else "all explained")
    )
