"""Results of `whitted stability` and `whitted speed` as parts of a page: plots, tables, and how to repeat them."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from markupsafe import Markup

from validation.report.plots import Axis, Look, Panel, Point, Series, decades, looks, places, plot, power
from validation.speed_plot import family_of
from validation.terminal import counted

Record = Mapping[str, Any]

#: Errors below this are drawn there; 0 has a place of its own.
LEAST = 1e-18
#: What makes what can be included.
MAKES = "whitted stability --json FILE and whitted speed --json FILE write what can be included"


class IncludeError(ValueError):
    """A file that is no result of the two."""


@dataclass(frozen=True)
class Table:
    """What a plot shows, for those who do not see it: the first column are headings of the rows."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Figure:
    """One plot, what it comes to in words, and its numbers."""

    title: str
    about: str
    svg: Markup
    sums: Sequence[str]
    table: Table


@dataclass(frozen=True)
class Included:
    """One file."""

    kind: str
    title: str
    says: str
    command: str
    made: str
    versions: Mapping[str, str]
    legend: Sequence[tuple[Markup, str]]
    figures: Sequence[Figure] = field(default=())


def read(path: Path) -> Included:
    """A result file.

    Raises:
        OSError: it cannot be read.
        IncludeError: it is none of the two kinds.
    """
    try:
        text = path.read_text(encoding="utf-8")
        record = json.loads(text, parse_constant=_finite, parse_float=_finite, parse_int=_whole)
        json.dumps(record, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise IncludeError(f"{path} has text that is no Unicode") from error
    except RecursionError as error:
        raise IncludeError(f"{path} is nested too deeply for a result of whitted") from error
    except ValueError as error:
        raise IncludeError(f"{path} is no JSON: {error}") from error
    if not isinstance(record, dict):
        raise IncludeError(f"{path} is no result of whitted")
    try:
        if record.get("kind") == "stability":
            return stability(record)
        if record.get("kind") == "speed":
            return speed(record)
    except OverflowError as error:
        raise IncludeError(f"{path} has a number that is too large to draw") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise IncludeError(f"{path} is damaged, or of another version of whitted: {what}") from error
    raise IncludeError(f"{path} holds no stability curves and no speeds")


def _finite(text: str) -> float:
    """A number of the JSON itself, which has text for what is infinite or none."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text} is no finite number")
    return number


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def value(number: float | str | None) -> float:
    """A number of the JSON, where text stands for what is none."""
    return math.nan if number is None else float(number)


def three(number: float) -> str:
    """Three digits."""
    return "none" if math.isnan(number) else f"{number:.3g}"


def _about(record: Record) -> tuple[str, dict[str, str]]:
    told = record.get("machine", {})
    date = str(record.get("date") or told.get("date") or "")
    parts = [date[:16].replace("T", " ") + (" UTC" if date.endswith("+00:00") else "") if date else ""]
    if told:
        parts.append(f"{told['processor']}, {counted(int(told['processors']), 'processor')}")
    versions = {str(name): str(text) for name, text in record["versions"].items()}
    return "; ".join(filter(None, parts)), versions


# ---- stability


def stability(record: Record) -> Included:
    """Curves of every ladder."""
    names = [str(entry["name"]) for entry in record["renderers"]]
    shapes = looks((name, name.partition("@")[0]) for name in names)
    made, versions = _about(record)
    figures = [_ladder(ladder, names, shapes) for ladder in record["ladders"]]
    broken = sum(1 for ladder in record["ladders"] if any(ladder["breaks"].get(name) for name in names))
    sums = f"On {broken} of {counted(len(figures), 'ladder')} some renderer breaks what it claims."
    if not broken:
        where = "the only ladder" if len(figures) == 1 else f"all {len(figures)} ladders"
        sums = f"Every renderer keeps what it claims on {where}."
    return Included(
        kind="stability",
        title="Stability",
        says="On a ladder one number of a scene climbs from rung to rung, and every pixel is proved. "
        "A curve is the largest error of a pixel that the renderer's claim holds it to, over the brightest value; it "
        "ends where nothing is left that it claims to tell. Below it: pixels with a wrong decision, excused or not, "
        "and pixels that the claim holds the renderer to. " + sums,
        command=shlex.join(record["command"]),
        made=made,
        versions=versions,
        legend=[(shapes[name].svg(line=True), name) for name in names],
        figures=figures,
    )


def _ladder(ladder: Record, names: Sequence[str], shapes: Mapping[str, Look]) -> Figure:
    rungs = [str(entry["rung"]) for entry in ladder["rungs"]]
    most = max((int(entry.get("proved", 0)) for entry in ladder["rungs"]), default=0) or 1
    # Beside each other, as many renderers have the same error.
    room = min(0.6 / max(len(names) - 1, 1), 0.16)
    series: tuple[list[Series], list[Series], list[Series]] = ([], [], [])
    for place, name in enumerate(names):
        points: tuple[list[Point | None], ...] = ([], [], [])
        for at, entry in enumerate(ladder["rungs"]):
            step = entry["steps"].get(name)
            beside = at + (place - (len(names) - 1) / 2) * room
            says = _says(ladder, entry, name)
            first = ladder["breaks"].get(name) == entry["rung"]
            own, error = (step or {}).get("own"), value((step or {}).get("error"))
            shown = min(error, 1e18) if error == 0 else max(LEAST, min(error, 1e18))
            points[0].append(Point(beside, shown, says, ring=first) if not math.isnan(error) else None)
            points[1].append(Point(beside, math.log10(1 + step["wrong"]), says, ring=first) if own else None)
            points[2].append(Point(beside, own["colors"], says) if own else None)
        for found, own_points in zip(series, points, strict=True):
            found.append(Series(name, shapes[name], own_points, joined=True))
    errors = [point.y for one in series[0] for point in one.points if point]
    x = places(f"{ladder['parameter']}", rungs)
    top = math.log10(1 + most)
    powers = range(1, int(top) + 1)
    ticks = [(0.0, "0"), *((math.log10(1 + 10**k), power(k)) for k in powers)]
    wrong = Axis("wrong", -0.06 * top, 1.06 * top, ticks)
    held = Axis("held", -0.06 * most, 1.06 * most, [(0, "0"), (most, str(most))])
    panels = [
        Panel(decades("largest error", errors, zero=True), series[0], 170),
        Panel(wrong, series[1], 50),
        Panel(held, series[2], 40),
    ]
    breaks = {name: ladder["breaks"].get(name) for name in names}
    silent = {name: ladder["silent_from"].get(name) for name in names}
    sums = [f"{name} breaks at {rung}" for name, rung in breaks.items() if rung]
    quiet = [f"{name} from {rung}" for name, rung in silent.items() if rung and not breaks[name]]
    if quiet:
        sums.append(f"claims nothing more: {', '.join(quiet)}")
    rest = [name for name in names if not breaks[name] and not silent[name]]
    if rest:
        sums.append(f"{'hold' if len(rest) > 1 else 'holds'} to the end: {', '.join(rest)}")
    headings = [str(ladder["parameter"]), *names]
    rows = [[str(entry["rung"]), *(_cell(entry["steps"].get(name)) for name in names)] for entry in ladder["rungs"]]
    title = str(ladder["name"])
    about = f"largest error, wrong decisions, pixels held on the ladder {title}: {', '.join(names)}; {'; '.join(sums)}"
    return Figure(title, str(ladder["about"]), plot(x, panels, about), sums, Table(headings, rows))


def _says(ladder: Record, entry: Record, name: str) -> str:
    step = entry["steps"].get(name)
    head = f"{name}, {ladder['parameter']} {entry['rung']}: "
    if not step or not step["own"]:
        return head + (step["failed"] or step["refused"] if step else "not drawn")
    error, own = value(step["error"]), step["own"]
    parts = [f"largest error {three(error)}" if not math.isnan(error) else "no pixel that it claims to tell"]
    parts.append(counted(step["wrong"], "wrong decision"))
    parts.append(f"{own['colors']} of {entry['proved']} pixels held to its claim")
    if step["not_numbers"]:
        parts.append(f"{step['not_numbers']} pixels are no numbers")
    if ladder["breaks"].get(name) == entry["rung"]:
        parts.append("it first breaks here")
    return head + ", ".join(parts)


def _cell(step: Record | None) -> str:
    if not step:
        return "–"
    if not step["own"]:
        return str(step["failed"] or step["refused"] or "–")
    error = value(step["error"])
    wrong = f", {step['wrong']} wrong" if step["wrong"] else ""
    return ("claims nothing" if math.isnan(error) else three(error)) + wrong


# ---- speed


def speed(record: Record) -> Included:
    """A plot of every scene."""
    made, versions = _about(record)
    entries = [entry for scene in record["scenes"] for entry in scene["entries"]]
    families = list(dict.fromkeys(_family(entry) for entry in entries))
    shapes = looks((family, family) for family in families)
    most = max((int(entry["threads"]) for entry in entries), default=1)
    legend = [(shapes[family].svg(), family) for family in families]
    if most > 1:
        legend.append((Look("o", "currentColor").svg(hollow=True), f"hollow: fewer than {most} threads"))
    return Included(
        kind="speed",
        title="Speed against error",
        says="Left is quicker, low is nearer to the exact values: the time of a warm picture, and the error of beauty "
        "at random proved pixels. Ringed and joined by a dashed line is the front: nobody else is both quicker and "
        "nearer.",
        command=shlex.join(record["command"]),
        made=made,
        versions=versions,
        legend=legend,
        figures=[_scene(scene, shapes, most) for scene in record["scenes"] if scene["entries"]],
    )


def _family(entry: Record) -> str:
    """What has one look: programs keep their commands, by which the legend tells them apart."""
    renderer = str(entry["renderer"])
    return renderer if renderer.startswith("cmd:") else family_of(renderer)


def _scene(scene: Record, shapes: Mapping[str, Look], most: int) -> Figure:
    found: dict[str, list[Point]] = {}
    front: list[tuple[float, float]] = []
    rows = []
    for entry in scene["entries"]:
        x, error = value(entry["ns_per_pixel"]), value(entry["errors"]["random_rmse"])
        threads = counted(int(entry["threads"]), "thread")
        said = f"{entry['name']}, {threads}: {three(x)} ns/pixel, RMSE {three(error)}"
        on = bool(entry["front"])
        size = "{}×{}".format(*map(int, entry["size"]))
        rows.append(
            [
                str(entry["name"]),
                str(entry["threads"]),
                three(x),
                three(error),
                "yes" if on else "no",
                size,
            ]
        )
        if not (math.isfinite(x) and math.isfinite(error)):
            continue
        y = error if error == 0 else max(error, LEAST)
        point = Point(
            x,
            y,
            said + (", on the front" if on else ""),
            hollow=int(entry["threads"]) < most,
            ring=on,
            label=str(entry["name"])[:40] if on else "",
        )
        found.setdefault(_family(entry), []).append(point)
        if on:
            front.append((x, y))
    every = [point for points in found.values() for point in points]
    x_axis = decades("time a pixel, nanoseconds", [point.x for point in every])
    y_axis = decades("error: RMSE of proved pixels", [point.y for point in every], zero=True)
    series = [Series(family, shapes[family], points) for family, points in found.items()]
    columns, lines = map(int, scene["size"])
    title = f"{scene['scene']}, {columns}×{lines}"
    best = "; ".join(str(text) for text in scene["front"])
    about = f"time a pixel against error of {', '.join(found)} on {title}; on the front: {best}"
    return Figure(
        title,
        f"{counted(int(scene['spheres']), 'sphere')}, {counted(int(scene['lights']), 'light')}",
        plot(x_axis, [Panel(y_axis, series, 330, sorted(front))], about, width=760),
        [f"on the front: {best}"] if best else [],
        Table(["renderer", "threads", "ns/pixel", "RMSE", "front", "size"], rows),
    )
