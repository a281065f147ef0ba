"""The page of `whitted stability`: where each renderer breaks, and curves of how far off it is as scenes get hard."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from validation.pages import environment, write_text
from validation.report.included import stability
from validation.report.report import MARK, ours
from validation.stability import LEGEND
from validation.timing import duration

if TYPE_CHECKING:
    from validation.stability import Stability

__all__ = ["ours", "write_curves"]

STANDARDS = {"own": "Held to what each claims to tell", "careful": "Held to 64 roundings"}


def write_curves(result: Stability, folder: Path) -> Path:
    """FOLDER/index.html with the tables and the curves of all ladders; returns its path.

    Raises:
        OSError: the file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    templates = environment()
    text = templates.get_template("curves.html.j2").render(
        mark=Markup(MARK) + importlib.metadata.version("whitted"),
        style=Markup(Path(__file__).with_name("report").joinpath("style.css").read_text(encoding="utf-8")),
        names=result.tested,
        legend=LEGEND,
        notes=[
            note if isinstance(note, str) else ": ".join(filter(None, vars(note).values()))
            for note in (*result.outlasted_says(), *result.notes, *result.failures)
        ],
        progress=f"{result.progress} in {duration(result.seconds)}{', interrupted' * result.interrupted}",
        tables=[
            (
                title,
                [
                    (
                        ladder,
                        [
                            (result.cell(ladder, name, standard), bool(result.breaks(ladder, name, standard)))
                            for name in result.tested
                        ],
                    )
                    for ladder in result.ladders
                ],
            )
            for standard, title in STANDARDS.items()
        ],
        one=stability(result.record()),
    )
    page = folder / "index.html"
    write_text(page, text)
    return page
