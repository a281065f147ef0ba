"""Why two renderers differ: of every pixel who is off by how much, on which decision they parted, and the cause."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from validation.acne import acne, scattered
from validation.court import EXPLAINED, Court, Finding, RulesError, Side
from validation.parting import Decision
from validation.records import Record, json_value
from validation.renderers import Settings
from validation.timing import Pulse, TimeLeft
from validation.truth import NOWHERE, Truth

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.compare import Comparison

__all__ = [
    "EXPLAINED",
    "Court",
    "Decision",
    "Finding",
    "Group",
    "RulesError",
    "Side",
    "Verdict",
    "Verdicts",
    "differing",
    "judge",
    "together",
]


@dataclass(frozen=True)
class Verdict:
    """One pixel at which two renderers differ: column x, row y, the passes, and what truth says about either."""

    x: int
    y: int
    passes: tuple[str, ...]
    truth: Truth
    renderer: Finding
    reference: Finding
    edge: bool

    @property
    def findings(self) -> tuple[Finding, Finding]:
        """Both sides."""
        return self.renderer, self.reference

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """Whoever is off."""
        return tuple(finding for finding in self.findings if not finding.right)

    @property
    def explained(self) -> bool:
        """Whether no side did what nothing explains."""
        return all(finding.explained for finding in self.findings)


@dataclass
class Group:
    """Pixels with the same wrong renderer, cause and decision; of a mistake whatever it makes of decisions."""

    verdicts: list[Verdict]
    finding: Finding  # of the first

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Who is wrong, the cause, the decision but for a mistake's, and why: what all its pixels have in common."""
        return _key(self.finding)

    @property
    def explained(self) -> bool:
        """Whether the cause explains it."""
        return self.finding.explained

    @property
    def ways(self) -> int:
        """In how many ways a mistake shows in its pixels; 1 of everything else."""
        if self.finding.cause != "mistake":
            return 1
        every = (finding for verdict in self.verdicts for finding in verdict.wrong)
        return len({finding.decision.pattern for finding in every if _key(finding) == self.key and finding.decision})

    def what(self, count: int) -> str:
        """What that many pixels have in common, as a clause that follows the renderer's name."""
        decision = self.finding.decision
        if decision is None:
            return ""
        if (ways := self.ways) > 1:
            return f"parts from truth in {ways} ways, for example it {decision.pattern}"
        return decision.says if count == 1 else decision.pattern

    def sentence(self) -> str:
        """One line."""
        finding, first = self.finding, self.verdicts[0]
        count = len(self.verdicts)
        pixels = "1 pixel" if count == 1 else f"{count} pixels"
        place = f"{'at' if count == 1 else 'e.g. at'} {first.x} {first.y}"
        if finding.right:
            return f"{pixels}: neither is off by more than it claims ({place})"
        return f"{pixels}: {finding.renderer} {self.what(count)} ({place}): {finding.because}"

    def record(self) -> Record:
        """For the result file."""
        finding, right = self.finding, self.finding.right
        decision = finding.decision
        errors: dict[str, float] = {}
        for verdict in self.verdicts:
            for other in () if right else verdict.wrong:
                if other.renderer == finding.renderer:
                    errors |= {name: max(error, errors.get(name, 0.0)) for name, error in other.errors.items()}
        entry: Record = {
            "wrong": None if right else finding.renderer,
            "cause": finding.cause or None,
            "because": finding.because,
            "decision": None
            if decision is None
            else {
                "kind": decision.kind,
                "says": decision.pattern,
                "bounce": decision.bounce,
                "light": decision.light,
                "sphere": decision.sphere,
                "t": decision.t,
            },
            "errors": errors,
            "explained": self.explained,
            "pixels": [[verdict.x, verdict.y] for verdict in self.verdicts],
        }
        strict: Record = json_value(entry)
        return strict


@dataclass
class Verdicts:
    """Everything that was judged of one scene and pair."""

    scene: str
    renderer: str
    reference: str
    differ: int  # pixels in which some pass differs
    verdicts: list[Verdict]
    unproved: list[tuple[int, int]] = field(default_factory=list)  # where no precision was enough for truth
    #: Whether no more were judged than the first few, as these came to the same.
    stopped: bool = False
    #: Whether no more were judged than there was time for.
    late: bool = False

    @property
    def explained(self) -> bool:
        """Whether every pixel that was judged is explained."""
        return not self.unproved and all(verdict.explained for verdict in self.verdicts)

    def groups(self) -> list[Group]:
        """Pixels in groups; those that nothing explains first, then the largest."""
        found: dict[tuple[str, ...], Group] = {}
        for verdict in self.verdicts:
            for finding in verdict.wrong or (verdict.renderer,):
                found.setdefault(_key(finding), Group([], finding)).verdicts.append(verdict)
        return _worst_first(found.values())

    def record(self) -> Record:
        """For the result file."""
        return {
            "scene": self.scene,
            "renderer": self.renderer,
            "reference": self.reference,
            "differ": self.differ,
            "judged": len(self.verdicts),
            "unproved": [list(place) for place in self.unproved],
            "explained": self.explained,
            "groups": [group.record() for group in self.groups()],
            **({"stopped": True} if self.stopped else {}),
            **({"late": True} if self.late else {}),
        }


def _key(finding: Finding) -> tuple[str, str, str, str]:
    # One mistake makes many decisions wrong.
    pattern = finding.decision.pattern if finding.decision and finding.cause != "mistake" else ""
    # What these say has numbers of the pixel in it.
    because = "" if finding.cause in ("rounding", "unexplained") else finding.because
    return "" if finding.right else finding.renderer, finding.cause, pattern, because


def _worst_first(groups: Iterable[Group]) -> list[Group]:
    return sorted(groups, key=lambda group: (group.explained, -len(group.verdicts)))


def together(several: Sequence[Verdicts]) -> list[Group]:
    """The groups of several pairs of one scene: what is found of a renderer in several of them is there once."""
    found: dict[tuple[str, ...], dict[tuple[int, int], Verdict]] = {}
    first: dict[tuple[str, ...], Finding] = {}
    for verdicts in several:
        for group in verdicts.groups():
            first.setdefault(group.key, group.finding)
            pixels = found.setdefault(group.key, {})
            for verdict in group.verdicts:
                pixels.setdefault((verdict.x, verdict.y), verdict)
    return _worst_first(Group(list(pixels.values()), first[key]) for key, pixels in found.items())


# ---- which pixels


class Pace(Protocol):
    """How much is judged where time is short; a renderer under test may have one, as `pace`."""

    def through(self, places: Sequence[tuple[int, int]], verdicts: Sequence[Verdict]) -> Iterator[tuple[int, int]]:
        """As many of the places as there is time for; `verdicts`: those that there are, which grows."""


def differing(comparisons: Iterable[Comparison]) -> dict[tuple[int, int], list[str]]:
    """The pixels (column, row) of comparisons of one pair that are over tolerance, each with the passes."""
    pixels: dict[tuple[int, int], list[str]] = {}
    for comparison in comparisons:
        if comparison.maps is None:
            continue
        for y, x in np.argwhere(comparison.maps.over):
            pixels.setdefault((int(x), int(y)), []).append(comparison.pass_name)
    return pixels


def judge(
    scene: Scene,
    label: str,
    settings: Settings,
    analysis: Analysis,
    renderer: Side,
    reference: Side,
    comparisons: Sequence[Comparison],
    *,
    most: int,
    first: int = 0,
    court: Court | None = None,
    progress: Callable[[str], None] | None = None,
) -> Verdicts | None:
    """Judge the pixels in which comparisons of a pair differ, of more than `most` a random sample; None: none does.

    `first`: no more are judged than so many of them, taken from all spheres, if these all come to one mistake, or than
    twice as many if nothing explains any; 0: all are. `court`: that of other pairs of the same scene, settings and
    analysis. `progress`: called with how many are judged.

    Raises:
        RulesError: the documented rules of one of them failed.
    """
    pixels = differing(comparisons)
    if not pixels:
        return None
    chosen = sorted(pixels, key=lambda place: (place[1], place[0]))
    if len(chosen) > most:
        # The same sample for the same picture.
        chosen = random.Random(0).sample(chosen, most)
    edges = {
        (x, y): any(
            bool(comparison.maps.edge[y, x])
            for comparison in comparisons
            if comparison.maps is not None and comparison.pass_name in pixels[x, y]
        )
        for x, y in chosen
    }
    if first:
        chosen = _varied(chosen, lambda place: (int(analysis.ids[place[1], place[0]]), edges[place]))
    else:
        chosen.sort(key=lambda place: (place[1], place[0]))
    court = court or Court(scene, settings, analysis)
    compared = tuple(comparison.pass_name for comparison in comparisons if comparison.maps is not None)
    sides = renderer, reference
    verdicts: list[Verdict] = []
    unproved: list[tuple[int, int]] = []
    pace: Pace | None = getattr(renderer.renderer, "pace", None)
    left, pulse = TimeLeft(len(chosen)), Pulse()
    for done, (x, y) in enumerate(pace.through(chosen, verdicts) if pace else chosen):
        if progress and pulse.due():
            progress(f"{done} of {len(chosen)} pixels judged{left.says(done)}")
        try:
            truth = court.truth(x, y)
            found = [court.find(truth, side, compared) for side in sides]
        except NOWHERE:
            unproved.append((x, y))
            continue
        verdicts.append(Verdict(x, y, tuple(pixels[x, y]), truth, found[0], found[1], edges[x, y]))
        # What nothing explains may hide a mistake that is less frequent: of that twice as many.
        if len(verdicts) in (first, 2 * first) and len(verdicts) < len(chosen) and not unproved:
            few = speckles(court, verdicts, sides, compared, pixels)
            if _same(few) and (len(few) > first or few[0].wrong[0].cause == "mistake"):
                return Verdicts(label, *_names(sides), len(pixels), _in_order(few), stopped=True)
    verdicts = speckles(court, verdicts, sides, compared, pixels)
    unproved.sort(key=lambda place: (place[1], place[0]))
    late = len(verdicts) + len(unproved) < len(chosen)
    return Verdicts(label, *_names(sides), len(pixels), _in_order(verdicts), unproved, late=late)


def _names(sides: tuple[Side, Side]) -> tuple[str, str]:
    return sides[0].renderer.name, sides[1].renderer.name


def _in_order(verdicts: Iterable[Verdict]) -> list[Verdict]:
    return sorted(verdicts, key=lambda verdict: (verdict.y, verdict.x))


def _varied(places: Sequence[tuple[int, int]], kind: Callable[[tuple[int, int]], object]) -> list[tuple[int, int]]:
    """In random order, the first of every kind before the second of any."""
    kinds: dict[object, list[tuple[int, int]]] = {}
    for place in random.Random(0).sample(places, len(places)):
        kinds.setdefault(kind(place), []).append(place)
    turns = itertools.zip_longest(*kinds.values())
    return [place for turn in turns for place in turn if place is not None]


def _same(verdicts: Sequence[Verdict]) -> bool:
    """Whether all come to one mistake of one renderer, or to nothing that explains what it did."""
    found = {(finding.renderer, finding.cause, _mistake(finding)) for of in verdicts for finding in of.wrong}
    return len(found) == 1 and all(not verdict.explained for verdict in verdicts)


def _mistake(finding: Finding) -> str:
    return finding.because if finding.cause == "mistake" else ""


def speckles(
    court: Court,
    verdicts: Sequence[Verdict],
    sides: tuple[Side, Side],
    compared: Sequence[str],
    differ: Collection[tuple[int, int]],
) -> list[Verdict]:
    """The same verdicts, of pixels that nothing explains with shadow acne where it does; `differ`: all that differ."""
    told = list(verdicts)
    ids = court.analysis.ids
    over = np.zeros(ids.shape, dtype=bool)
    for x, y in differ:
        over[y, x] = True
    for place, side in enumerate(sides):
        found = {}
        for k, verdict in enumerate(told):
            unexplained = verdict.findings[place].cause == "unexplained"
            if unexplained and (one := acne(court, verdict.truth, side, compared)):
                found[k] = one
        if scattered([(told[k].x, told[k].y) for k in found], over, ids):
            for k, one in found.items():
                told[k] = replace(told[k], reference=one) if place else replace(told[k], renderer=one)
    return told
