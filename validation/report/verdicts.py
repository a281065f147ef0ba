"""Verdicts as the report shows them: who is off at which pixel, by how much and why, and where in the picture."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from tracer.passes import lookup
from validation.run import explain_command

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tracer import Scene
    from validation.run import Rendered
    from validation.truth import Ball
    from validation.verdict import Finding, Group, Verdict, Verdicts

#: Rows of a table that are in sight; the rest can be opened.
ROWS = 10

#: Passes that a row names beside the one whose values it shows.
NAMED = 3

#: What a cause is called.
CAUSES = {
    "rounding": "rounding",
    "rule": "documented rule",
    "tie": "tie",
    "mistake": "wrong",
    "unexplained": "unexplained",
    "": "within both claims",
}

#: What the marks of the map mean, in the order of the legend; {} are the two renderers.
MARKS = {
    "cross": "unexplained or wrong",
    "square": "{0} is off",
    "circle": "{1} is off",
    "both": "both are off",
    "dot": "neither is off by more than it claims",
}

#: Their outlines, from -1 to 1.
SHAPES = {
    "cross": "M-1 -1L1 1M-1 1L1 -1",
    "square": "M-1 -1H1V1H-1Z",
    "circle": "M-1 0a1 1 0 1 0 2 0a1 1 0 1 0 -2 0Z",
    "both": "M-1 -1H1V1H-1ZM-1 0a1 1 0 1 0 2 0a1 1 0 1 0 -2 0Z",
    "dot": "M-.3 0a.3 .3 0 1 0 .6 0a.3 .3 0 1 0 -.6 0Z",
}

#: How large a mark is: this share of a pixel, but at least so many pixels of the screen from its middle to its side.
OF_A_PIXEL, ON_SCREEN = 0.35, 4.5


def mark(verdict: Verdict) -> str:
    """The mark of a pixel."""
    if not verdict.explained:
        return "cross"
    a, b = verdict.findings
    return {(False, True): "square", (True, False): "circle", (False, False): "both"}.get((a.right, b.right), "dot")


@dataclass(frozen=True)
class Value:
    """What one side drew: the value, its error, and whether that is more than it claims."""

    text: str
    error: str
    off: bool


@dataclass(frozen=True)
class Row:
    """One pixel in the table: the channel of a pass that differs most, and the verdict."""

    anchor: str
    verdict: Verdict
    mark: str
    pass_name: str
    channel: str
    truth: str
    sides: tuple[Value, Value]
    command: str

    @property
    def others(self) -> str:
        """The other passes that differ, a few of them by name."""
        names = [name for name in self.verdict.passes if name != self.pass_name]
        more = len(names) - NAMED
        if more > 1:
            return f"{', '.join(names[:NAMED])} and {more} more"
        return ", ".join(names)

    @property
    def sentences(self) -> tuple[Finding, ...]:
        """Whoever is off."""
        return self.verdict.wrong


@dataclass(frozen=True)
class Line:
    """A group of pixels with the same wrong renderer, decision and cause, as one line."""

    group: Group
    anchor: str  # of the row of its first pixel

    @property
    def finding(self) -> Finding:
        """Of the first pixel."""
        return self.group.finding

    @property
    def key(self) -> tuple[str, str, str]:
        """Cause and decision, without the numbers of its pixels and who is wrong."""
        _, *key = self.group.key
        return key[0], key[1], key[2]

    @property
    def count(self) -> int:
        """How many pixels."""
        return len(self.group.verdicts)

    @property
    def says(self) -> str:
        """What was decided."""
        return self.group.what(self.count)


@dataclass
class VerdictsView:
    """All that was judged of one scene and pair."""

    verdicts: Verdicts
    lines: list[Line]
    rows: list[Row]
    legend: list[tuple[str, str, int]]  # mark, what it means, how many pixels
    scale: float = 1.0  # of the marks, in pixels of the picture
    by_pixel: dict[tuple[int, int], Row] = field(default_factory=dict)

    @property
    def unexcused(self) -> Counter[str]:
        """Pixels that are "unexplained" or "wrong"."""
        return unexcused([self.verdicts])

    @property
    def sampled(self) -> bool:
        """Whether more pixels differ than were judged."""
        return self.verdicts.differ > len(self.verdicts.verdicts)


def unexcused(several: Sequence[Verdicts]) -> Counter[str]:
    """How many pixels are "unexplained" and how many "wrong"; one that is both counts as unexplained.

    One that differs in several pairs of renderers counts once.
    """
    found: dict[tuple[object, ...], str] = {}
    one_pair = len({(of.renderer, of.reference) for of in several}) < 2
    for number, of in enumerate(several):
        for place, verdict in enumerate(of.verdicts):
            if not verdict.explained:
                key = (number, place) if one_pair else (of.scene, verdict.x, verdict.y)
                causes = {finding.cause for finding in verdict.findings}
                if "unexplained" in causes or key not in found:
                    found[key] = "unexplained" if "unexplained" in causes else "wrong"
    return Counter(found.values())


def view(rendered: Rendered, scene: str, zoom: int) -> VerdictsView | None:
    """What the page shows; `scene`: the anchor of the scene, `zoom`: how much its pictures are enlarged."""
    verdicts = rendered.verdicts
    if verdicts is None or not verdicts.verdicts:
        return None
    groups = verdicts.groups()
    pair = verdicts.renderer, verdicts.reference
    rows = {id(verdict): _row(verdict, scene, pair, rendered) for verdict in verdicts.verdicts}
    marks = Counter(row.mark for row in rows.values())
    return VerdictsView(
        verdicts,
        [Line(group, rows[id(group.verdicts[0])].anchor) for group in groups],
        [rows[id(verdict)] for verdict in _ordered(groups)],
        [(name, text.format(*pair), marks[name]) for name, text in MARKS.items() if marks[name]],
        max(OF_A_PIXEL, ON_SCREEN / zoom),
        {(row.verdict.x, row.verdict.y): row for row in rows.values()},
    )


def _ordered(groups: Sequence[Group]) -> list[Verdict]:
    """Each pixel once: the first of every group, then the second of every one; without an excuse before all others."""
    places: dict[int, tuple[bool, int, int, Verdict]] = {}
    for number, group in enumerate(groups):
        for place, verdict in enumerate(group.verdicts):
            places.setdefault(id(verdict), (verdict.explained, place, number, verdict))
    return [verdict for *_, verdict in sorted(places.values(), key=lambda entry: entry[:3])]


def _row(verdict: Verdict, scene: str, pair: tuple[str, str], rendered: Rendered) -> Row:
    """One pixel; the arrays are not needed any more."""
    of, drawn = rendered.scene, (rendered.renderer, rendered.reference)
    name = "beauty" if "beauty" in verdict.passes else verdict.passes[0]
    balls = verdict.truth.values[name]
    sides = [np.atleast_1d(passes[name][verdict.y, verdict.x]).astype(np.float64).tolist() for passes in drawn]
    # NaN is as far off as can be.
    apart = [abs(a - b) if a == a and b == b else math.inf for a, b in zip(*sides, strict=True)]
    channel = apart.index(max(apart))
    values = [
        _value(name, side[channel], balls[channel], of, off=name in finding.errors)
        for side, finding in zip(sides, verdict.findings, strict=True)
    ]
    return Row(
        f"{scene}-x{verdict.x}-y{verdict.y}",
        verdict,
        mark(verdict),
        name,
        lookup(name).channels[channel : channel + 1],
        _text(name, balls[channel].value, of),
        (values[0], values[1]),
        explain_command(
            rendered.path or rendered.label, of, rendered.settings, verdict.x, verdict.y, pair, rendered.convention
        ),
    )


def _text(name: str, value: float, scene: Scene) -> str:
    """A value with every digit, of an id the sphere's name."""
    quantity = lookup(name).quantity
    if quantity == "id" and math.isfinite(value) and value == int(value):
        number = int(value)
        if 0 <= number < len(scene.spheres):
            return f"{number}, '{scene.spheres[number].name}'"
        return f"{number}, nothing" if number == -1 else str(number)
    if quantity == "visibility" and value in (0, 1):
        return "1, visible" if value else "0, hidden"
    return "not a number" if math.isnan(value) else "∞" if value == math.inf else repr(float(value))


def _value(name: str, value: float, exact: Ball, scene: Scene, *, off: bool) -> Value:
    """One side's value; `exact` is exact to more digits than can be shown, so the bound of the error is the error."""
    error = exact.error(value)
    if error == 0:
        told = "exact"
    elif lookup(name).quantity in ("id", "visibility"):
        told = "wrong"
    elif not math.isfinite(error):
        told = "off"
    else:
        told = f"{'off by' if off else 'error'} {error:.2g}"
    return Value(_text(name, value, scene), told, off)
