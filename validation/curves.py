"""Draws how far renderers are off against how hard the scene is: a picture a ladder, and a page of all of them."""

from __future__ import annotations

import html
import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tracer.passes import write_beside
from validation.ladders import SIDE, names
from validation.stability import LEGEND
from validation.timing import duration

if TYPE_CHECKING:
    from validation.ladders import Ladder
    from validation.stability import Stability

#: How a page of ours begins: no other page is written over.
MARK = "<!-- whitted stability -->"
#: Errors below this are drawn there, 0 among them.
LEAST = 1e-17
MARKERS = "os^vD<>PX*"


def write_curves(result: Stability, folder: Path) -> Path:
    """A picture of each ladder, FOLDER/LADDER.svg, and FOLDER/index.html with all of them; returns that.

    Raises:
        OSError: a file cannot be written.
    """
    import matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    for name in names():  # of a run before
        (folder / f"{name}.svg").unlink(missing_ok=True)
    # The same bytes for the same results.
    with matplotlib.rc_context({"svg.hashsalt": "whitted", "svg.fonttype": "none", "font.size": 8}):
        for ladder in result.ladders:
            with write_beside(folder / f"{ladder.name}.svg") as temporary:
                _figure(result, ladder).savefig(temporary, format="svg", metadata={"Date": None})
    page = folder / "index.html"
    with write_beside(page) as temporary:
        temporary.write_text(_page(result), encoding="utf-8")
    return page


def ours(page: Path) -> bool:
    """Whether a page may be written over."""
    return not page.exists() or page.read_text(encoding="utf-8", errors="replace").startswith(MARK)


def _figure(result: Stability, ladder: Ladder) -> Any:
    from matplotlib.figure import Figure  # without pyplot: no window, no state

    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    error, wrong, held = figure.subplots(3, 1, sharex=True, height_ratios=(3, 1.5, 1))
    places = range(len(ladder.rungs))
    for at, name in enumerate(result.tested):
        steps = [step for _, step in result.steps(ladder, name)]
        style = {"marker": MARKERS[at % len(MARKERS)], "markersize": 3, "linewidth": 1, "color": f"C{at % 10}"}
        errors = [_shown(step.error) if step else math.nan for step in steps]
        error.plot(places, errors, label=name, **style)
        drawn = [step if step and step.own else None for step in steps]
        wrong.plot(places, [step.wrong if step else math.nan for step in drawn], **style)
        held.plot(places, [step.own.colors if step and step.own else math.nan for step in drawn], **style)
        if found := result.breaks(ladder, name):
            error.axvline(ladder.rungs.index(found[0]), color=style["color"], linewidth=0.8, linestyle=":")
    error.set_title(f"{ladder.name}: {ladder.about}")
    error.set_yscale("log")
    error.set_ylabel("largest error\n/ brightest")
    wrong.set_yscale("symlog", linthresh=1)
    wrong.set_ylim(0, 1.25 * SIDE * SIDE)
    wrong.set_ylabel("wrong\ndecisions")
    held.set_ylim(0, 1.05 * SIDE * SIDE)
    held.set_ylabel("pixels held")
    held.set_xticks(places, ladder.rungs)
    held.set_xlabel(ladder.parameter)
    for axes in (error, wrong, held):
        axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", frameon=False)
    return figure


def _shown(error: float | None) -> float:
    return math.nan if error is None or not math.isfinite(error) else max(error, LEAST)


def _page(result: Stability) -> str:
    lines = [MARK, "<!doctype html>", '<html lang="en">', '<meta charset="utf-8">', "<title>whitted stability</title>"]
    lines.append("<style>body{font:14px sans-serif;max-width:70em;margin:2em auto;padding:0 1em}img{max-width:100%}")
    lines.append(
        "table{border-collapse:collapse}td,th{padding:2px 10px;text-align:left}.bad{color:#b00;font-weight:bold}"
    )
    lines.append("</style><h1>Stability</h1>")
    facts = f"{result.date}, whitted {result.versions['whitted']}, {result.progress} in {duration(result.seconds)}"
    lines.append(f"<p>{html.escape(facts)}{', interrupted' * result.interrupted}</p>")
    lines.append(f"<p><code>{html.escape(shlex.join(result.command))}</code></p>" * bool(result.command))
    for standard, title in (("own", "Held to what each claims to tell"), ("careful", "Held to 64 roundings")):
        lines += [f"<h2>{title}: the rung on which it first breaks</h2>", "<table>"]
        lines.append(_row("th", [(text, False) for text in ("ladder", "to", *result.tested)]))
        for ladder in result.ladders:
            cells = [
                (result.cell(ladder, name, standard), bool(result.breaks(ladder, name, standard)))
                for name in result.tested
            ]
            lines.append(_row("td", [(ladder.name, False), (ladder.rungs[-1], False), *cells]))
        lines.append("</table>")
    lines.append(f"<p>{html.escape(LEGEND)}.</p>")
    if told := [*result.outlasted_says(), *result.notes, *result.failures]:
        texts = (note if isinstance(note, str) else ": ".join(filter(None, vars(note).values())) for note in told)
        lines.append("<h2>Notes</h2><ul>" + "".join(f"<li>{html.escape(text)}</li>" for text in texts) + "</ul>")
    for ladder in result.ladders:
        name = html.escape(ladder.name)
        lines.append(
            f'<h2 id="{name}">{name}</h2><p>{html.escape(ladder.about)}</p><img src="{name}.svg" alt="{name}">'
        )
    lines.append("<h2>Versions</h2><table>")
    lines += [_row("td", [(key, False), (value, False)]) for key, value in result.versions.items()]
    lines.append("</table>")
    return "\n".join([*lines, "</html>", ""])


def _row(tag: str, cells: Sequence[tuple[str, bool]]) -> str:
    marked = (f"<{tag}{' class=bad' * bad}>{html.escape(text)}</{tag}>" for text, bad in cells)
    return f"<tr>{''.join(marked)}</tr>"
