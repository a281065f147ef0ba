"""What all pairs of several renderers say together: who agrees with whom, and who stands alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from validation.compare import Comparison
    from validation.records import Record


@dataclass(frozen=True)
class Cell:
    """The comparisons of one pair."""

    agree: int
    made: int


@dataclass(frozen=True)
class Alone:
    """A renderer that differs from all others in a pass of a scene, where these agree with one another."""

    scene: str
    pass_name: str
    renderer: str
    others: int

    def sentence(self) -> str:
        """One line."""
        return f"{self.scene}: {self.pass_name}: {self.renderer} stands alone against {self.others} that agree"


def names(comparisons: Iterable[Comparison]) -> list[str]:
    """The renderers that were compared, in the order in which they come."""
    return list(dict.fromkeys(name for entry in comparisons for name in (entry.renderer, entry.reference)))


def measured(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Those in which something could be compared: a renderer that lacks a pass says nothing about it."""
    return [entry for entry in comparisons if entry.max is not None]


def several(comparisons: Sequence[Comparison]) -> bool:
    """Whether there is more to say than how one renderer compares with the others."""
    every = names(comparisons)
    return len(every) > 2 and len(matrix(comparisons)) > 2 * (len(every) - 1)


def matrix(comparisons: Sequence[Comparison]) -> dict[tuple[str, str], Cell]:
    """By pair, in either order, how many comparisons agree."""
    found: dict[tuple[str, str], Cell] = {}
    for entry in measured(comparisons):
        for pair in ((entry.renderer, entry.reference), (entry.reference, entry.renderer)):
            cell = found.get(pair, Cell(0, 0))
            found[pair] = Cell(cell.agree + entry.ok, cell.made + 1)
    return found


def alone(comparisons: Sequence[Comparison]) -> list[Alone]:
    """Who stands alone: two others at least, all of which agree with one another and differ from it."""
    groups: dict[tuple[str, tuple[int, int], str], list[Comparison]] = {}
    for entry in measured(comparisons):
        groups.setdefault((entry.scene, entry.size, entry.pass_name), []).append(entry)
    found = []
    for (scene, _, name), group in groups.items():
        ok = {frozenset((entry.renderer, entry.reference)): entry.ok for entry in group}
        every = names(group)
        for renderer in every:
            others = [other for other in every if other != renderer]
            among = [ok.get(frozenset(pair)) for pair in itertools.combinations(others, 2)]
            against = [ok.get(frozenset((renderer, other))) for other in others]
            if among and all(among) and not any(against) and None not in against:
                found.append(Alone(scene, name, renderer, len(others)))
    return found


def record(comparisons: Sequence[Comparison]) -> Record:
    """Both for the result file."""
    return {
        "matrix": [
            {"renderer": pair[0], "reference": pair[1], "agree": cell.agree, "made": cell.made}
            for pair, cell in matrix(comparisons).items()
        ],
        "alone": [vars(entry).copy() for entry in alone(comparisons)],
    }
