"""Results as a summary in Markdown, for the page of a job in CI: what came out, what differs, and why."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from validation.pages import write_text
from validation.report.report import headline
from validation.terminal import number, worst_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from validation.compare import Comparison
    from validation.run import Validation

#: Rows and lines of a kind that are shown: such a page takes no more than 1 MiB, and nobody reads it.
MOST = 50

#: The variable in which GitHub names the file of the page of a job, to which every step adds its own.
STEP = "GITHUB_STEP_SUMMARY"


def write_markdown(path: Path, result: Validation) -> bool:
    """Write the summary; to the page of a job on GitHub it is added, when all is done. Whether anything was written."""
    text = markdown(result)
    if _of_step(path):
        if result.unfinished:
            return False
        with path.open("a", encoding="utf-8", errors="replace") as file:
            file.write(text)
        return True
    write_text(path, text)
    return True


def _of_step(path: Path) -> bool:
    """Whether that is the page of a job on GitHub, by whatever path."""
    page = os.environ.get(STEP)
    if not page:
        return False
    # It may be that the page is not there yet.
    return os.path.realpath(page) == os.path.realpath(path) or (
        path.exists() and Path(page).exists() and path.samefile(page)
    )


def markdown(result: Validation) -> str:
    """The text."""
    return "\n".join(_lines(result)) + "\n"


def _lines(result: Validation) -> Iterator[str]:
    yield f"## {'✅' if result.ok else '❌'} {escaped(headline(result))}"
    for line in result.about:
        yield f"- {escaped(line.strip())}"
    differ = [comparison for comparison in result.comparisons if not comparison.ok]
    if differ:
        yield from ("", "### What differs", "", "| scene | pass | renderer | against | why |", "|---|---|---|---|---|")
        for comparison in differ[:MOST]:
            why = "; ".join(comparison.reasons) + worst_of(comparison)
            names = (comparison.scene, comparison.pass_name, comparison.renderer, comparison.reference, why)
            yield f"| {' | '.join(map(escaped, names))} |"
        yield from _more(len(differ), "comparisons")
    groups = [(verdicts, group) for verdicts in result.verdicts for group in verdicts.groups()]
    # What nothing excuses first.
    groups.sort(key=lambda entry: entry[1].explained)
    if groups:
        yield from ("", "### Why", "")
        for verdicts, group in groups[:MOST]:
            what = "not explained" if group.finding.cause == "unexplained" else "wrong"
            mark = "" if group.explained else f"**{what}** "
            yield f"- {mark}{escaped(f'{verdicts.scene}: {group.sentence()}')}"
        yield from _more(len(groups), "kinds of differences")
    if result.failures:
        yield from ("", "### What failed", "")
        for note in result.failures[:MOST]:
            yield f"- {escaped(': '.join(filter(None, vars(note).values())))}"
        yield from _more(len(result.failures), "failures")
    pairs: dict[tuple[str, str], list[Comparison]] = {}
    for comparison in result.comparisons:
        pairs.setdefault((comparison.renderer, comparison.reference), []).append(comparison)
    if pairs:
        yield from ("", "### All comparisons", "")
        yield from ("| renderer | against | scenes | agree | largest error of beauty |", "|---|---|--:|--:|--:|")
        for pair, several in pairs.items():
            agree = f"{sum(comparison.ok for comparison in several)} of {len(several)}"
            errors = [comparison.max for comparison in several if comparison.pass_name == "beauty"]
            largest = number(max((error for error in errors if error is not None), default=None))
            scenes = len({comparison.scene for comparison in several})
            yield f"| {' | '.join(map(escaped, pair))} | {scenes} | {agree} | {largest} |"
    if result.notes:
        yield from ("", f"<details><summary>{len(result.notes)} notes</summary>", "")
        for note in result.notes[:MOST]:
            yield f"- {escaped(': '.join(filter(None, vars(note).values())))}"
        yield from _more(len(result.notes), "notes")
        yield from ("", "</details>")
    if result.command:
        yield from ("", "Repeat it:", "", *(f"    {line}" for line in shlex.join(result.command).splitlines()))


def _more(count: int, what: str) -> Iterator[str]:
    if count > MOST:
        yield from ("", f"and {count - MOST} more {what}")


def escaped(text: str) -> str:
    """Text that Markdown takes as it is, in one line."""
    return re.sub(r"([\\`*_{}\[\]<>#|~$&])", r"\\\1", text).replace("\n", " ")
