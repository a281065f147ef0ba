"""What the command `whitted` prints: tables of comparisons and of renderers."""

# Rich is imported where it is used: `whitted --help` answers at once.
from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from validation.check import Checked
    from validation.compare import Comparison
    from validation.run import Outcome, Validation
    from validation.verdict import Group, Verdicts


#: A terminal of fewer columns gets a smaller table, and of fewer than the second number one that is smaller still.
NARROW, NARROWEST = 100, 72
#: Columns that the first column of a table has at least.
MIN_ROOM = 16

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


def counted(count: int, what: str) -> str:
    """Such as "1 pixel" and "2 pixels"."""
    return f"{count} {what}{'s'[: count != 1]}"


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
        out.print(_table(scenes, verbose=verbose, width=out.width))
        out.print()
    for alike in _alike(comparison for comparison in result.comparisons if not comparison.ok):
        most = max(alike, key=lambda comparison: comparison.edge)
        names = ", ".join(comparison.pass_name for comparison in alike)
        where = f"{most.scene}: {names} ({most.renderer}, {most.reference})"
        worst = worst_of(most) if len(alike) == 1 else ""
        click.secho(f"{where}: {'; '.join(most.reasons)}{worst}", fg="red", color=colorful())
    undecided = {c.reference for c in result.comparisons for reason in c.reasons if reason.startswith(TOO_MANY)}
    if undecided - {"numpy-f64"}:
        click.echo("  hint: where there are too many edge pixels, --against numpy-f64 may decide more")
    by_scene: dict[str, list[Verdicts]] = {}
    for verdicts in result.verdicts:
        by_scene.setdefault(verdicts.scene, []).append(verdicts)
    for several in by_scene.values():
        if len(several) == 1:
            print_verdicts(several[0])
        else:
            _print_together(several)
    _print_pairs(result)
    print_notes(result)
    if result.comparisons:
        groups = [group for scenes in pairs.values() for group in scenes.values()]
        for line in _legend(groups, verbose=verbose, width=out.width):
            click.echo(line)
    print_failures(result)
    unexplained = sum(
        sum(not verdict.explained for verdict in verdicts.verdicts) + len(verdicts.unproved)
        for verdicts in result.verdicts
    )
    missing = len(result.unfinished)
    # Of a sample that has some, there may be more.
    least = "at least " * any(len(v.verdicts) + len(v.unproved) < v.differ for v in result.verdicts)
    agree = sum(comparison.ok for comparison in result.comparisons)
    total = f"{agree} of {len(result.comparisons)} comparisons agree" if result.comparisons else "nothing was compared"
    if not (result.comparisons or result.notes or result.failures):
        total += ": there is no scene, or no pair of two different renderers"
    click.echo(
        total
        + (f", {least}{counted(unexplained, 'pixel')} without an excuse" if unexplained else "")
        + (f", {counted(len(result.failures), 'failure')}" if result.failures else "")
        + (f", {missing} of {len(result.scenes)} {result.parts}s are missing" if missing else "")
    )


def _print_together(several: Sequence[Verdicts]) -> None:
    """The same of several pairs of one scene, what is the same once."""
    from validation.verdict import together

    judged = {(verdict.x, verdict.y) for verdicts in several for verdict in verdicts.verdicts}
    sampled = any(len(verdicts.verdicts) + len(verdicts.unproved) < verdicts.differ for verdicts in several)
    pixels = "1 pixel differs" if len(judged) == 1 else f"{len(judged)} pixels differ"
    sample = ", of a random sample that was judged" if sampled else ""
    click.echo(f"{several[0].scene} ({len(several)} pairs): {pixels}{sample}")
    _print_groups(together(several))
    _print_unproved(several)


def _print_groups(groups: Sequence[Group]) -> None:
    for group in groups[:MOST_GROUPS]:
        mark = "" if group.explained else "UNEXPLAINED: " if group.finding.cause == "unexplained" else "WRONG: "
        text = f"  {mark}{group.sentence()}"
        click.secho(text, fg=None if group.explained else "red", color=colorful())
    if len(groups) > MOST_GROUPS:
        click.echo(f"  and {len(groups) - MOST_GROUPS} more kinds: --report and --json have them all")


def _print_unproved(several: Sequence[Verdicts]) -> None:
    unproved = list(dict.fromkeys(place for verdicts in several for place in verdicts.unproved))
    if unproved:
        x, y = unproved[0]
        some = "1 pixel" if len(unproved) == 1 else f"{len(unproved)} pixels"
        text = f"  UNEXPLAINED: {some}: truth could not be had at any precision (at {x} {y})"
        click.secho(text, fg="red", color=colorful())


def _print_pairs(result: Validation) -> None:
    """Where more than two renderers were compared: who agrees with whom, and who stands alone."""
    from rich.table import Table
    from rich.text import Text

    from validation import pairs

    if not pairs.several(result.comparisons):
        return
    names, matrix = pairs.names(result.comparisons), pairs.matrix(result.comparisons)
    click.echo("all pairs: comparisons that agree, of how many")
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for name in names:
        table.add_column(name, justify="right", overflow="fold")
    for name in names:
        cells = [matrix.get((name, other)) for other in names]
        table.add_row(
            name,
            *(
                Text(f"{cell.agree}/{cell.made}", style="" if cell.agree == cell.made else "bold red") if cell else "-"
                for cell in cells
            ),
        )
    console().print(table)
    for entry in pairs.alone(result.comparisons):
        click.secho(entry.sentence(), fg="red", color=colorful())
    click.echo()


def print_notes(result: Outcome) -> None:
    """What was left out."""
    for note in result.notes:
        click.echo(f"note: {': '.join(filter(None, vars(note).values()))}")


def print_failures(result: Outcome) -> None:
    """What failed."""
    for failure in result.failures:
        text = ": ".join(filter(None, vars(failure).values()))
        # Those of scene files say `error:` after the place.
        click.echo(text if ": error: " in text.partition("\n")[0] else f"error: {text}", err=True)


def print_verdicts(verdicts: Verdicts) -> None:
    """A line a group of pixels: who is off, on which decision, and why."""
    judged = len(verdicts.verdicts) + len(verdicts.unproved)
    sample = ""
    if verdicts.stopped:
        (finding,) = verdicts.verdicts[0].wrong
        same = "come to one mistake" if finding.cause == "mistake" else "are unexplained"
        sample = f"; the first {judged} judged, taken at random from every sphere, all {same}; --verdicts N judges more"
    elif verdicts.late:
        sample = (
            f"; {judged} of them judged, taken at random from every sphere, to keep it short; --verdicts N judges more"
        )
    elif judged < verdicts.differ:
        sample = f", {judged} of them judged, chosen at random" if judged else ", none of them judged"
    pixels = "1 pixel differs" if verdicts.differ == 1 else f"{verdicts.differ} pixels differ"
    click.echo(f"{verdicts.scene} ({verdicts.renderer}, {verdicts.reference}): {pixels}{sample}")
    _print_groups(verdicts.groups())
    both = sum(len(verdict.wrong) > 1 for verdict in verdicts.verdicts)
    if both:
        pixels = "1 pixel, at which both are off, is" if both == 1 else f"{both} pixels, at which both are off, are"
        click.echo(f"  ({pixels} in two of these lines)")
    _print_unproved([verdicts])


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


def paths(names: Iterable[str], room: int) -> dict[str, str]:
    """Paths for a column of that width: whole, else without their folders where that tells them apart.

    What is still too long goes on in the next line, behind a slash or a blank if it can.
    """
    shown = {name: name for name in names}
    if any(len(name) > room for name in shown):
        short = {name: name.rpartition("/")[2] for name in shown}
        shown = short if len(set(short.values())) == len(short) else shown
    for name, text in shown.items():
        lines = [""]
        for piece in re.findall("[^/ ]*[/ ]|[^/ ]+", text):
            if lines[-1] and len(lines[-1] + piece.rstrip()) > room:
                lines.append("")
            lines[-1] += piece
        shown[name] = "\n".join(line.rstrip() for line in lines)
    return shown


def fits(shown: Mapping[str, str], room: int) -> bool:
    """Whether every line of such paths is short enough."""
    return all(len(line) <= room for text in shown.values() for line in text.split("\n"))


def room_for_names(width: int, columns: Iterable[Iterable[str]]) -> int:
    """What is left of a line for the first column of a table; `columns`: what is in the others."""
    return max(MIN_ROOM, width - sum(2 + max(map(len, texts)) for texts in columns))


def _in_one_row(group: Sequence[Comparison]) -> tuple[str, Comparison, Comparison, Comparison]:
    """All passes of a scene in one row: what to call it, and the passes that its columns are about.

    That which comes nearest to its tolerance; that with the largest error to show, `beauty` if it was compared; that
    with the most edge pixels over tolerance.
    """
    nearest = max(group, key=lambda entry: entry.ratio or 0)
    seen = next((entry for entry in group if entry.pass_name == "beauty"), nearest)
    edges = max(group, key=lambda entry: (entry.edge_over, entry.edge))
    return (
        f"all {len(group)}, worst {nearest.pass_name}" + ", edges differ" * bool(edges.edge_over),
        nearest,
        seen,
        edges,
    )


def _one_row(group: Sequence[Comparison], *, verbose: bool) -> bool:
    """Whether a scene has one row for all of its passes."""
    return not verbose and all(entry.ok for entry in group)


def _table(scenes: Mapping[str, Sequence[Comparison]], *, verbose: bool, width: int) -> Table:
    """A row a scene and size that agrees, a row for every pass that does not; `verbose`: a row for every pass.

    `interior` and `edge` count pixels over tolerance of all such pixels.
    """
    from rich.table import Table

    wide, held = width >= NARROW, width >= NARROWEST
    headers = ["scene", "result", "pass", *["max error"] * wide, *["/tolerance"] * held, "interior", "edge"]
    rows: list[tuple[str, Text, list[str]]] = []
    for scene, group in scenes.items():
        told = [(entry.pass_name, entry, entry, entry) for entry in group if verbose or not entry.ok]
        if _one_row(group, verbose=verbose):
            told = [_in_one_row(group)]
        for place, (label, nearest, seen, edges) in enumerate(told):
            numbers = [*[number(nearest.ratio)] * held, f"{nearest.interior_over}/{nearest.interior}"]
            texts = [label, *[number(seen.max)] * wide, *numbers, f"{edges.edge_over}/{edges.edge}"]
            rows.append(("" if place else scene, _verdict(nearest.ok), texts))
    cells = [[header, *(texts[k] for *_, texts in rows)] for k, header in enumerate(headers[2:])]
    if not wide:
        cells[0] = [word for text in cells[0] for word in text.split()]
    room = room_for_names(width, [["result"], *cells])
    shown = paths(scenes, room)
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("scene", overflow="fold", no_wrap=fits(shown, room))
    table.add_column("result", no_wrap=True)
    table.add_column("pass", overflow="fold", min_width=10)
    for header in headers[3:]:
        table.add_column(header, justify="right", no_wrap=True)
    for scene, verdict, texts in rows:
        table.add_row(shown.get(scene, ""), verdict, *texts)
    return table


def _legend(groups: Iterable[Sequence[Comparison]], *, verbose: bool, width: int) -> Iterator[str]:
    """What the columns are that are shown."""
    wide, held = width >= NARROW, width >= NARROWEST
    yield "interior, edge: pixels over tolerance / all; only interior ones have to agree"
    if held:
        yield "max error: of all pixels, edges included; " * wide + "/tolerance: error over tolerance of interior ones"
    rows = [group for group in groups if _one_row(group, verbose=verbose)]
    if rows:
        beauty = all(any(entry.pass_name == "beauty" for entry in group) for group in rows)
        error = f"max error: of beauty{'' if beauty else ' or else of that pass'}; " * wide
        yield f"all: {'/tolerance and ' * held}interior of the worst pass; {error}edge: of that with most over"


def worst_of(comparison: Comparison, *, levels: bool = False) -> str:
    """The worst pixel and both values, as a clause behind what is wrong; "" where there is none."""
    worst = comparison.worst
    if worst is None:
        return ""
    channel = f" {worst.channel}" if worst.channel else ""
    a, b = (f"{value:.0f}" if levels else repr(value) for value in (worst.a, worst.b))
    return f"; worst pixel x {worst.x}, y {worst.y}{channel}: {a} and {b}"


def print_renderers(entries: Sequence[Mapping[str, Any]], failures: Mapping[str, str]) -> None:
    """A row for each renderer, and on stderr the entry points that could not be loaded."""
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    out = console()
    narrow = out.width < NARROW  # no room for passes beside the rest: below it
    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in () if narrow else ("name", "version", "available"):
        table.add_column(header, no_wrap=True)
    table.show_header = not narrow
    table.add_column("" if narrow else "passes, or what to do", overflow="fold")
    for entry in entries:
        usable = entry["available"]
        told = Text(", ".join(entry["passes"]) if usable else entry["reason"])
        if narrow:
            head = f"{entry['name']} {entry['version'] or 'cannot run here'}"
            table.add_row(Text(head, style="green" if usable else "yellow"))
            table.add_row(Padding(told, (0, 0, 0, 2)))
            continue
        table.add_row(
            entry["name"],
            entry["version"] or "-",
            Text("yes", style="green") if usable else Text("no", style="yellow"),
            told,
        )
    out.print(table)
    sys.stdout.flush()
    for name, reason in failures.items():
        complain(f"warning: the renderers of entry point '{name}' could not be loaded: {reason}")


def print_passes(entries: Sequence[Mapping[str, Any]], failures: Mapping[str, str]) -> None:
    """A row for each pass, a column for each renderer."""
    from rich.table import Table
    from rich.text import Text

    out = console()
    every = list(dict.fromkeys(name for entry in entries for name in entry["sources"]))
    width = max((len(name) for name in every), default=0)
    # As many columns side by side as there is room for.
    side_by_side = max(1, (out.width - width) // max((len(entry["name"]) + 2 for entry in entries), default=1))
    for first in range(0, len(entries), side_by_side):
        some = entries[first : first + side_by_side]
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column("pass", no_wrap=True)
        for entry in some:
            table.add_column(entry["name"], no_wrap=True)
        for name in every:
            cells = [entry["sources"].get(name) for entry in some]
            told = [f"{cell['how']}{'' if cell['always'] else ' *'}" if cell else "-" for cell in cells]
            table.add_row(name, *told)
        table.add_row(Text("precision", style="italic"), *(entry["precision"] or "-" for entry in some))
        table.add_row(Text("here", style="italic"), *("yes" if entry["available"] else "no" for entry in some))
        out.print(table)
        out.print()
    click.echo("stock: by the program itself; plugin: with code of ours in it; derived: from other pictures it draws")
    click.echo("*: only of scenes that it can say so; which of them it tells in a note")
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
                + worst_of(comparison, levels=levels).removeprefix("; " * (not reasons))
            )


def print_check(result: Checked) -> None:
    """The convention of images, what it explains, what is left, and why."""
    from validation.rules import ACNE

    for line in result.about():
        click.echo(line)
    for line, says in zip(result.diagnosis(), result.likely(), strict=True):
        click.secho(line, fg="red", color=colorful())
        if says == ACNE.says:
            click.echo(f"  hint: {ACNE.hint}")
    for verdicts in result.validation.verdicts:
        print_verdicts(verdicts)
    print_notes(result.validation)
    print_failures(result.validation)
    if failed := len(result.validation.failures):
        click.echo(f"{failed} of {failed + len(result.left)} scenes failed")
    elif result.validation.comparisons:
        click.echo(result.says)


def print_checks(results: Mapping[str, Checked]) -> None:
    """A row for each program: whether it is right, its convention, what is left, and the likeliest reason."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("program", overflow="fold")
    table.add_column("result", no_wrap=True)
    table.add_column("convention", no_wrap=True)
    table.add_column("left", justify="right", no_wrap=True)
    table.add_column("max error", justify="right", no_wrap=True)
    table.add_column("most likely", overflow="fold")
    for name, result in results.items():
        fit, failures = result.fit, result.validation.failures
        of = len(failures) + len(result.left)
        reasons = (
            [f"failed in {len(failures)} of {of} scenes: {failures[0].message.partition(chr(10))[0]}"]
            if failures
            else []
        )
        reasons += [f"it {result.ending}"] if result.ending else []
        reasons += [fit.convention.fault] if fit and fit.convention.fault else []
        reasons += [f"it {says}" for says in result.likely()]
        largest = max((comparison.max or 0.0 for comparison in result.validation.comparisons), default=None)
        table.add_row(
            Text(name.removeprefix("cmd:")),
            Text(
                "not right" if result.status == 1 else result.says.partition(" but")[0],
                style="bold red" if result.status else "green",
            ),
            fit.convention.short if fit else "-",
            f"{sum(entry.off for entry in result.left)}/{sum(entry.pixels for entry in result.left)}",
            number(largest),
            Text("; ".join(reasons) or ("unexplained" if result.judged else "-")),
        )
    console().print(table)
    click.echo("left: pixels that the convention does not explain / all; max error: of colours in [0, 1]")
    right = sum(result.status == 0 for result in results.values())
    click.echo(f"{right} of {len(results)} programs are right")
