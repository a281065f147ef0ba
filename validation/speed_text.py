"""What `whitted speed` prints, and the page that it writes."""

from __future__ import annotations

import html
import importlib.metadata
import shlex
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from validation.pages import write_text
from validation.report.report import MARK
from validation.speed import Measured, SceneSpeed, Speed, caption, panels, threads
from validation.speed_plot import write_plot
from validation.terminal import NARROW, complain, console, counted, number
from validation.timing import duration

if TYPE_CHECKING:
    from validation.run import Note
    from validation.speed import Spread
    from validation.speed_kernels import Kernels, Row

MEBIBYTE = 1 << 20
#: Headings, and whether a narrow terminal has them too.
HEADINGS = {
    "front": True,
    "renderer": True,
    "threads": True,
    "size": False,
    "n": False,
    "warm ms": True,
    "quartiles": False,
    "min": False,
    "cpu ms": False,
    "ns/pixel": True,
    "cold s": True,
    "MiB": False,
    "max": False,
    "RMSE": True,
    "edge max": False,
    "edge RMSE": False,
    "wrong": True,
    "levels": False,
}
LEGEND = (
    "front: nobody else is both quicker and nearer to the truth (RMSE)",
    "warm: a picture in a process that has drawn before, median of n; cold: a new process with its first picture",
    "cpu: processor time of a warm picture, of all processors: less than warm where others kept them busy",
    "max, RMSE: error of beauty at random proved pixels; edge: at those nearest to a decision",
    "wrong: of all of these pixels, those with another primary hit or shadow",
    "levels: random pixels with another byte, and by how much at most",
)


def times(seconds: float) -> str:
    """Milliseconds, three digits."""
    return plain(seconds * 1e3)


def plain(value: float) -> str:
    """A large number with three digits, without an exponent."""
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 100 else f"{value:.3g}"


def cells(one: Measured) -> list[str]:
    """A row of the table."""
    warm, errors = one.warm, one.errors
    levels = f"{errors.levels_off}/{errors.random}" + (f", {errors.levels_max}" if errors.levels_off else "")
    return [
        "*" if one.front else "",
        one.entry.name,
        str(one.entry.threads),
        f"{one.size[0]}x{one.size[1]}",
        str(warm.runs),
        times(warm.median),
        f"{times(warm.lower)}-{times(warm.upper)}",
        times(warm.least),
        times(one.busy.median),
        plain(one.per_pixel),
        f"{one.cold:.2f}",
        f"{one.memory / MEBIBYTE:.0f}",
        number(errors.random_max),
        number(errors.random_rmse),
        number(errors.edge_max),
        number(errors.edge_rmse),
        number(errors.wrong) if errors.wrong is None else str(errors.wrong),
        levels,
    ]


def print_speed(result: Speed) -> None:
    """A table for every scene, what was left out, the kernels, and the machine."""
    for scene in result.scenes:
        _print_scene(scene)
    if result.kernels:
        _print_kernels(result.kernels)
    for line in left_out(result):
        click.echo(f"left out: {line}")
    if any(scene.measured for scene in result.scenes):
        for line in LEGEND:
            click.echo(line)
    for note in result.failures:
        complain(f"error: {_place(note)}{note.message}")
    click.echo(f"{caption(result)}; {duration(result.seconds)}")


def left_out(result: Speed) -> Iterator[str]:
    """What was not measured, or not as asked, those with the same reason together."""
    together: dict[tuple[str, str], list[str]] = {}
    for note in result.left_out:
        together.setdefault((note.scene, note.message), []).append(note.renderer)
    for (scene, message), names in together.items():
        who = ", ".join(filter(None, names))
        yield ": ".join(filter(None, (scene, who, message)))


def _place(note: Note) -> str:
    return "".join(f"{part}: " for part in (note.scene, note.renderer) if part)


def _title(scene: SceneSpeed) -> str:
    size = f"{scene.size[0]}x{scene.size[1]}"
    return f"{scene.label} {size}: {counted(scene.spheres, 'sphere')}, {counted(scene.lights, 'light')}"


def _print_scene(scene: SceneSpeed) -> None:
    from rich.table import Table

    out = console()
    out.print(_title(scene), style="bold", markup=False)
    if not scene.measured:
        out.print("nothing could be measured")
        return
    shown = [place for place, narrow in enumerate(HEADINGS.values()) if narrow or out.width >= NARROW]
    if all(one.size == scene.size for one in scene.measured):
        shown = [place for place in shown if list(HEADINGS)[place] != "size"]
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 1, 0, 0))
    for place in shown:
        heading = list(HEADINGS)[place]
        if heading == "renderer":
            table.add_column(heading, overflow="fold", min_width=21, max_width=40)
        else:
            table.add_column(heading, justify="left" if heading == "front" else "right", no_wrap=True)
    for one in scene.measured:
        row = cells(one)
        table.add_row(*(row[place] for place in shown))
    out.print(table, markup=False)
    out.print()


def _spread(spread: Spread | None) -> str:
    return f"{spread.median:.2f} ({spread.lower:.2f}-{spread.upper:.2f})" if spread else "-"


def kernel_rows(rows: Sequence[Row]) -> list[list[str]]:
    """The rows of a table of the kernels."""
    return [
        [
            str(row.value),
            row.isa,
            row.precision,
            str(row.threads),
            f"{row.size[0]}x{row.size[1]}",
            times(row.warm.median),
            f"{times(row.warm.lower)}-{times(row.warm.upper)}",
            f"{row.speed / 1e6:.3g}",
            _spread(row.ratio),
        ]
        for row in rows
    ]


KERNEL_HEADINGS = ("set", "precision", "threads", "pixels", "ms", "quartiles", "Mpixel/s", "times the first")
LIMIT_HEADINGS = ("set", "precision", "multiply-adds", "square roots", "divisions", "as multiply-adds", "as roots")


def limit_rows(result: Kernels) -> list[list[str]]:
    """What the machine can do, in 10^9 a second, and what a pixel costs."""
    return [
        [
            limit.isa,
            limit.precision,
            *(f"{getattr(limit, kind) / 1e9:.3g}" for kind in ("multiply_adds", "square_roots", "divisions")),
            plain(limit.cost("multiply_adds")),
            plain(limit.cost("square_roots")),
        ]
        for limit in result.limits
    ]


def sentences(result: Kernels) -> Iterator[str]:
    """What the tables come to."""
    for group in dict.fromkeys(row.group for row in result.rows if row.group.startswith("instruction set")):
        speeds = {(row.isa, row.precision): row.speed for row in result.rows if row.group == group}
        ratios = [
            f"{isa} {speed / speeds[isa, 'f64']:.2f}"
            for (isa, precision), speed in speeds.items()
            if precision == "f32" and (isa, "f64") in speeds
        ]
        if ratios:
            yield f"float32 as many times as quick as float64, {group.partition(', ')[2]}: {', '.join(ratios)}"
    for what, fit in result.fits.items():
        name, precision = what.split(", ")
        yield f"{name}s, {precision}: {fit.says(name)}"
    if result.written:
        size, wrote, drew = result.written
        rate, ratio = size / wrote.median / 1e6, drew.median / wrote.median
        yield f"writing an image: {plain(rate)} MB/s; drawing it takes {ratio:.2g} times as long as writing it"
    yield from (f"left out: {line}" for line in result.left_out)


def _print_kernels(result: Kernels) -> None:
    from rich.table import Table

    out = console()

    def show(title: str, headings: Iterable[str], rows: Iterable[Sequence[str]]) -> None:
        table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
        for place, heading in enumerate(headings):
            table.add_column(heading, justify="right" if place else "left", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        out.print(table, markup=False)
        out.print()

    for group in dict.fromkeys(row.group for row in result.rows):
        rows = [row for row in result.rows if row.group == group]
        show(f"kernels by {group}", (group, *KERNEL_HEADINGS), kernel_rows(rows))
    show("one thread of this machine, 10^9 a second, and a pixel's time", LIMIT_HEADINGS, limit_rows(result))
    for line in sentences(result):
        click.echo(line)
    click.echo()


# ---- the page


def write_page(folder: Path, result: Speed) -> Path:
    """`index.html`: the plot, the tables and the rest, in one file."""
    from markupsafe import Markup

    parts: list[str] = []
    shown = panels(result)
    if shown:
        with tempfile.TemporaryDirectory() as place:
            drawing = Path(place) / "plot.svg"
            write_plot(drawing, shown, caption(result))
            svg = drawing.read_text(encoding="utf-8")
        parts.append(f"<figure>{svg[svg.index('<svg') :]}</figure>")
    for scene in result.scenes:
        parts.append(f"<h2>{html.escape(_title(scene))}</h2>")
        parts.append(_table(HEADINGS, [cells(one) for one in scene.measured]))
    parts += [f"<p>{html.escape(line)}</p>" for line in LEGEND]
    if result.kernels:
        for group in dict.fromkeys(row.group for row in result.kernels.rows):
            rows = [row for row in result.kernels.rows if row.group == group]
            parts.append(f"<h2>kernels by {html.escape(group)}</h2>")
            parts.append(_table((group, *KERNEL_HEADINGS), kernel_rows(rows)))
        parts.append("<h2>One thread of this machine, 10<sup>9</sup> a second, and a pixel's time</h2>")
        parts.append(_table(LIMIT_HEADINGS, limit_rows(result.kernels)))
        parts += [f"<p>{html.escape(line)}</p>" for line in sentences(result.kernels)]
    if lines := [*left_out(result), *(f"{_place(note)}{note.message}" for note in result.failures)]:
        parts.append("<h2>Left out</h2>")
        parts.append("<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in lines) + "</ul>")
    parts.append("<h2>Versions</h2>")
    parts.append(_table(("what", "version"), [[key, value] for key, value in result.versions.items()]))
    style = Path(__file__).with_name("report").joinpath("style.css").read_text(encoding="utf-8")
    extra = "td,th{padding:.15rem .6rem;text-align:right;white-space:nowrap}figure{overflow-x:auto;background:#fff}"
    title = f"whitted speed: {', '.join(scene.label for scene in result.scenes)}"
    page = (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">{Markup(MARK)}'
        f'{importlib.metadata.version("whitted")}">\n<title>{html.escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{style}{extra}</style></head>\n'
        f"<body><header><h1>{html.escape(title)}</h1><p>{html.escape(caption(result))}</p>"
        f"<p><code>{html.escape(shlex.join(result.command))}</code></p></header>\n<main>"
        + "\n".join(parts)
        + "</main></body></html>\n"
    )
    path = folder / "index.html"
    write_text(path, page)
    return path


def _table(headings: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{html.escape(heading)}</th>' for heading in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div style="overflow-x:auto"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


__all__ = ["cells", "left_out", "print_speed", "threads", "write_page"]
