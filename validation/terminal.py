"""What the command `whitted` prints: tables of comparisons and of renderers."""

# Rich is imported where it is used: `whitted --help` answers at once.
from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from validation.compare import Comparison
    from validation.run import Outcome, Validation
    from validation.verdict import Verdicts


#: A terminal of fewer columns gets a smaller table.
NARROW = 100

#: Kinds of verdicts of one scene and pair that are printed, the worst first.
MOST_GROUPS = 12

#: How the reason begins that Judge.edge_cap gives.
TOO_MANY = "too many edge pixels"


def complain(message: str, hint: str = "") -> None:
    """A sentence on stderr, and what to do."""
    click.echo(message + (f"\n  hint: {hint}" if hint else ""), err=True)


def console(*, stderr: bool = False) -> Console:
    """Where tables go."""
    from rich.console import Console

    class Out(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError  # Rich's own way out is status 1

    # A file or a pipe has no width of its own; 80 would break names.
    wide = None if (sys.stderr if stderr else sys.stdout).isatty() else 160
    return Out(stderr=stderr, highlight=False, width=wide)


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
        at_size = f"{comparison.scene} {comparison.size[0]}x{comparison.size[1]}"
        scenes.setdefault(at_size, []).append(comparison)
    for (renderer, reference), scenes in pairs.items():
        out.print(f"{renderer} against {reference}", style="bold", markup=False)
        out.print(_table(scenes, verbose=verbose, narrow=out.width < NARROW))
        out.print()
    for alike in _alike(comparison for comparison in result.comparisons if not comparison.ok):
        most = max(alike, key=lambda comparison: comparison.edge)
        names = ", ".join(comparison.pass_name for comparison in alike)
        where = f"{most.scene}: {names} ({most.renderer}, {most.reference})"
        worst = _worst(most) if len(alike) == 1 else ""
        click.secho(f"{where}: {'; '.join(most.reasons)}{worst}", fg="red", color=colorful())
    undecided = {c.reference for c in result.comparisons for reason in c.reasons if reason.startswith(TOO_MANY)}
    if undecided - {"numpy-f64"}:
        click.echo("  hint: where there are too many edge pixels, --against numpy-f64 may decide more")
    for verdicts in result.verdicts:
        print_verdicts(verdicts)
    print_notes(result)
    if result.comparisons:
        click.echo("interior, edge: pixels over tolerance / all; only interior ones have to agree")
        click.echo("max error: of all pixels; /tolerance: error over tolerance of interior ones")
    print_failures(result)
    unexplained = sum(
        sum(not verdict.explained for verdict in verdicts.verdicts) + len(verdicts.unproved)
        for verdicts in result.verdicts
    )
    # Of a sample that has some, there may be more.
    least = "at least " * any(len(v.verdicts) + len(v.unproved) < v.differ for v in result.verdicts)
    agree = sum(comparison.ok for comparison in result.comparisons)
    total = f"{agree} of {len(result.comparisons)} comparisons agree" if result.comparisons else "nothing was compared"
    if not (result.comparisons or result.notes or result.failures):
        total += ": there is no scene, or no pair of two different renderers"
    click.echo(
        total
        + (f", {least}{unexplained} pixel{'s'[: unexplained > 1]} without an excuse" if unexplained else "")
        + (f", {len(result.failures)} failure{'s'[: len(result.failures) > 1]}" if result.failures else "")
    )


def print_notes(result: Outcome) -> None:
    """What was left out."""
    for note in result.notes:
        click.echo(f"note: {': '.join(filter(None, vars(note).values()))}")


def print_failures(result: Outcome) -> None:
    """What failed."""
    for failure in result.failures:
        text = ": ".join(filter(None, vars(failure).values()))
        # Those of scene files say `error:` after the place.
        click.echo(text if ": error: " in text else f"error: {text}", err=True)


def print_verdicts(verdicts: Verdicts) -> None:
    """A line a group of pixels: who is off, on which decision, and why."""
    judged = len(verdicts.verdicts) + len(verdicts.unproved)
    sample = ""
    if judged < verdicts.differ:
        sample = f", {judged} of them judged, chosen at random" if judged else ", none of them judged"
    pixels = "1 pixel differs" if verdicts.differ == 1 else f"{verdicts.differ} pixels differ"
    click.echo(f"{verdicts.scene} ({verdicts.renderer}, {verdicts.reference}): {pixels}{sample}")
    groups = verdicts.groups()
    for group in groups[:MOST_GROUPS]:
        mark = "" if group.explained else "UNEXPLAINED: " if group.finding.cause == "unexplained" else "WRONG: "
        text = f"  {mark}{group.sentence()}"
        click.secho(text, fg=None if group.explained else "red", color=colorful())
    if len(groups) > MOST_GROUPS:
        click.echo(f"  and {len(groups) - MOST_GROUPS} more kinds: --report and --json have them all")
    both = sum(len(verdict.wrong) > 1 for verdict in verdicts.verdicts)
    if both:
        pixels = "1 pixel, at which both are off, is" if both == 1 else f"{both} pixels, at which both are off, are"
        click.echo(f"  ({pixels} in two of these lines)")
    if verdicts.unproved:
        x, y = verdicts.unproved[0]
        some = "1 pixel" if len(verdicts.unproved) == 1 else f"{len(verdicts.unproved)} pixels"
        text = f"  UNEXPLAINED: {some}: truth could not be had at any precision (at {x} {y})"
        click.secho(text, fg="red", color=colorful())


def _alike(failed: Iterable[Comparison]) -> list[list[Comparison]]:
    """Passes of one scene and pair that fail for the same reason, whose numbers may differ, together.

    A pass with pixels over tolerance stands alone, as each has a worst pixel of its own.
    """
    groups: dict[tuple[object, ...], list[Comparison]] = {}
    for comparison in failed:
        own = comparison.pass_name if comparison.interior_over else ""
        reasons = re.sub(r"\d+", "", "; ".join(comparison.reasons).replace(f"'{comparison.pass_name}'", ""))
        key = (comparison.scene, comparison.size, comparison.renderer, comparison.reference, own, reasons)
        groups.setdefault(key, []).append(comparison)
    return list(groups.values())


def _table(scenes: Mapping[str, Sequence[Comparison]], *, verbose: bool, narrow: bool = False) -> Table:
    """A row a scene and size that agrees, a row for every pass that does not; `verbose`: a row for every pass.

    `interior` and `edge` count pixels over tolerance of all such pixels.
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("scene", overflow="fold", min_width=16)
    table.add_column("result", no_wrap=True)
    table.add_column("pass", overflow="fold", min_width=10)
    for header in ("/tolerance", "interior") if narrow else ("max error", "/tolerance", "interior", "edge"):
        table.add_column(header, justify="right", no_wrap=True)
    short = {scene: scene.rpartition("/")[2] for scene in scenes}
    shorten = narrow and len(set(short.values())) == len(short)
    for scene, group in scenes.items():
        rows = [(entry.pass_name, entry) for entry in group if verbose or not entry.ok]
        if not rows:
            nearest = max(group, key=lambda entry: entry.ratio or 0)
            rows = [(f"all {len(group)}, worst {nearest.pass_name}", nearest)]
        for place, (label, entry) in enumerate(rows):
            numbers = [number(entry.ratio), f"{entry.interior_over}/{entry.interior}"]
            if not narrow:
                numbers = [number(entry.max), *numbers, f"{entry.edge_over}/{entry.edge}"]
            shown = short[scene] if shorten else scene
            table.add_row(shown if place == 0 else "", _verdict(entry.ok), label, *numbers)
    return table


def _worst(comparison: Comparison, *, levels: bool = False) -> str:
    worst = comparison.worst
    if worst is None:
        return ""
    channel = f" {worst.channel}" if worst.channel else ""
    a, b = (f"{value:.0f}" if levels else repr(value) for value in (worst.a, worst.b))
    return f"; worst pixel x {worst.x}, y {worst.y}{channel}: {a} and {b}"


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


def print_comparisons(found: Sequence[Comparison], *, levels: bool = False) -> None:
    """A row for each pass of two files; `levels`: of two 8-bit images."""
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
        numbers = [number(value) for value in (comparison.max, comparison.rmse, comparison.p999)]
        if levels and comparison.max is not None:
            numbers[0] = f"{comparison.max:.0f}"
        table.add_row(comparison.pass_name, *numbers, str(comparison.interior_over), verdict)
    console().print(table)
    for comparison in found:
        # Without a scene every pixel is an interior one: the worst says it all, but for what is no number or not there.
        structural = comparison.max is None
        reasons = [reason for reason in comparison.reasons if structural or "NaN" in reason]
        if not comparison.ok:
            click.echo(
                f"{comparison.pass_name}: "
                + "; ".join(reasons)
                + _worst(comparison, levels=levels).removeprefix("; " * (not reasons))
            )
