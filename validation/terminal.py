"""What the command `whitted` prints: tables of comparisons and of renderers."""

# Rich is imported where it is used: `whitted --help` answers at once.
from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from validation.compare import Comparison
    from validation.run import Validation


def complain(message: str, hint: str = "") -> None:
    """A sentence on stderr, and what to do."""
    click.echo(message + (f"\n  hint: {hint}" if hint else ""), err=True)


def console(*, stderr: bool = False) -> Console:
    """Where tables go."""
    from rich.console import Console

    # A file or a pipe has no width of its own; 80 would break names.
    wide = None if (sys.stderr if stderr else sys.stdout).isatty() else 160
    return Console(stderr=stderr, highlight=False, width=wide)


def colorful() -> bool:
    """Whether stdout is a terminal that wants colours."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR")


def _verdict(ok: bool) -> Text:
    from rich.text import Text

    return Text("agree", style="green") if ok else Text("DIFFER", style="bold red")


def number(value: float | None) -> str:
    """A measured number as people read it."""
    return "-" if value is None else "0" if value == 0 else f"{value:.2g}"


def print_validation(result: Validation, *, verbose: bool) -> None:
    """A table for each pair of renderers, then what differs, what was not compared, and the sum."""
    out = console()
    pairs: dict[tuple[str, str], dict[str, list[Comparison]]] = {}
    for comparison in result.comparisons:
        scenes = pairs.setdefault((comparison.renderer, comparison.reference), {})
        scenes.setdefault(comparison.scene, []).append(comparison)
    for (renderer, reference), scenes in pairs.items():
        out.print(f"{renderer} against {reference}", style="bold", markup=False)
        out.print(_table(scenes, verbose=verbose))
        out.print()
    for comparison in result.comparisons:
        if not comparison.ok:
            where = f"{comparison.scene}: {comparison.pass_name} ({comparison.renderer}, {comparison.reference})"
            click.secho(f"{where}: {'; '.join(comparison.reasons)}{_worst(comparison)}", fg="red", color=colorful())
    for note in result.notes:
        click.echo(f"note: {': '.join(filter(None, vars(note).values()))}")
    if result.comparisons:
        click.echo("interior, edge: pixels over tolerance / all; only interior ones have to agree")
    for failure in result.failures:
        click.echo(f"error: {': '.join(filter(None, vars(failure).values()))}", err=True)
    agree = sum(comparison.ok for comparison in result.comparisons)
    click.echo(
        f"{agree} of {len(result.comparisons)} comparisons agree"
        + (f", {len(result.failures)} failure{'s'[: len(result.failures) > 1]}" if result.failures else "")
    )


def _table(scenes: Mapping[str, Sequence[Comparison]], *, verbose: bool) -> Table:
    """A row a scene that agrees, a row for every pass that does not; `verbose`: a row for every pass.

    `interior` and `edge` count pixels over tolerance of all such pixels.
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("scene", overflow="fold", min_width=16)
    table.add_column("pass", overflow="fold", min_width=10)
    for header in ("max error", "/tolerance", "interior", "edge"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("result", no_wrap=True)
    for scene, group in scenes.items():
        rows = [(entry.pass_name, entry) for entry in group if verbose or not entry.ok]
        if not rows:
            nearest = max(group, key=lambda entry: entry.ratio or 0)
            rows = [(f"all {len(group)}, worst {nearest.pass_name}", nearest)]
        for place, (label, entry) in enumerate(rows):
            table.add_row(
                f"{scene} {entry.size[0]}x{entry.size[1]}" if place == 0 else "",
                label,
                number(entry.max),
                number(entry.ratio),
                f"{entry.interior_over}/{entry.interior}",
                f"{entry.edge_over}/{entry.edge}",
                _verdict(entry.ok),
            )
    return table


def _worst(comparison: Comparison) -> str:
    worst = comparison.worst
    if worst is None:
        return ""
    channel = f" {worst.channel}" if worst.channel else ""
    return f"; worst pixel x {worst.x}, y {worst.y}{channel}: {worst.a!r} and {worst.b!r}"


def print_renderers(entries: Sequence[Mapping[str, Any]], failures: Mapping[str, str]) -> None:
    """A row for each renderer, and on stderr the entry points that could not be loaded."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in ("name", "version", "available"):
        table.add_column(header, no_wrap=True)
    table.add_column("passes, or what to do", overflow="fold")
    for entry in entries:
        usable = entry["available"]
        table.add_row(
            entry["name"],
            entry["version"] or "-",
            Text("yes", style="green") if usable else Text("no", style="yellow"),
            Text(", ".join(entry["passes"]) if usable else entry["reason"]),
        )
    console().print(table)
    sys.stdout.flush()
    for name, reason in failures.items():
        complain(f"warning: the renderers of entry point '{name}' could not be loaded: {reason}")


def print_comparisons(found: Sequence[Comparison]) -> None:
    """A row for each pass of two files."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("pass")
    for header in ("max error", "rmse", "p99.9", "pixels over"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for comparison in found:
        if not comparison.ok:
            verdict = Text("DIFFERENT", style="bold red")
        else:
            verdict = Text("equal" if comparison.max == 0 else "equal within the tolerance", style="green")
        numbers = (number(value) for value in (comparison.max, comparison.rmse, comparison.p999))
        table.add_row(comparison.pass_name, *numbers, str(comparison.interior_over), verdict)
    console().print(table)
    for comparison in found:
        # Without a scene every pixel is an interior one: the worst says it all, but for what is no number or not there.
        structural = comparison.max is None
        reasons = [reason for reason in comparison.reasons if structural or "NaN" in reason]
        if not comparison.ok:
            click.echo(
                f"{comparison.pass_name}: " + "; ".join(reasons) + _worst(comparison).removeprefix("; " * (not reasons))
            )
