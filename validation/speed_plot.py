"""The picture of speed against error, as SVG: who is both quicker and nearer to the truth than all others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tracer.passes import write_beside
from validation.terminal import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D


def family_of(renderer: str) -> str:
    """What has one look in a plot: the variants of a renderer, and the meshes of Mitsuba."""
    return "mitsuba-mesh" if renderer.startswith("mitsuba-mesh") else renderer.partition("@")[0]


@dataclass(frozen=True)
class Point:
    """One renderer: nanoseconds a pixel, error, its standard error, and how it is shown."""

    name: str
    family: str
    threads: int
    time: float
    error: float
    spread: float = 0.0


@dataclass(frozen=True)
class Panel:
    """One scene."""

    title: str
    points: Sequence[Point]


#: Markers and colours by family: each can be told without the other.
LOOKS = {
    "native-f64": ("o", "#0072b2"),
    "native-f32": ("s", "#0072b2"),
    "numpy-f64": ("^", "#009e73"),
    "numpy-f32": ("v", "#009e73"),
    "mitsuba-spec": ("D", "#d55e00"),
    "mitsuba-path": ("P", "#d55e00"),
    "mitsuba-stock": ("X", "#d55e00"),
    "mitsuba-mesh": ("<", "#cc79a7"),
    "povray": ("*", "#56b4e9"),
}
OTHERS = ("h", "#555555")
#: An error of 0 has no place on a logarithmic axis.
LEAST = 1e-18
#: Names run at this angle; so many pixels take a letter and a line; longer names, of commands, are cut.
ANGLE, LETTER, LINE, LONGEST = 35, 5.2, 10, 40


def front(points: Sequence[tuple[float, float]], spreads: Sequence[float] = ()) -> list[bool]:
    """Which of them are on the front: no other is as good in both numbers and better in one. Not finite: never.

    `spreads`: standard errors of the second numbers; two of these are told apart by twice that of their difference.
    """
    found = []
    own = [*spreads] or [0.0] * len(points)
    for (time, error), spread in zip(points, own, strict=True):
        beaten = any(
            t <= time and e <= error + 2 * math.hypot(s, spread) and (t < time or e < error)
            for (t, e), s in zip(points, own, strict=True)
        )
        found.append(math.isfinite(time) and math.isfinite(error) and not beaten)
    return found


def _front(points: Sequence[Point]) -> list[bool]:
    return front([(point.time, point.error) for point in points], [point.spread for point in points])


def write_plot(path: Path, panels: Sequence[Panel], caption: str = "") -> None:
    """Write the picture, a panel a scene."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    # Text stays text; the same results make the same file.
    options: dict[Any, Any] = {
        "svg.fonttype": "none",
        "svg.hashsalt": "whitted",
        "font.size": 9,
        "font.family": "sans-serif",
    }
    with mpl.rc_context(options):
        figure, axes = pyplot.subplots(len(panels), 1, figsize=(9, 5.6 * len(panels)), squeeze=False)
        try:
            for axis, panel in zip(axes[:, 0], panels, strict=True):
                _draw(axis, panel)
            if caption:
                figure.text(0.01, 0.005, caption, fontsize=7, color="#444444")
            figure.tight_layout(rect=(0, 0.025, 1, 1))
            for axis, panel in zip(axes[:, 0], panels, strict=True):
                _name(axis, panel.points, _front(panel.points))
            with write_beside(path) as temporary:
                figure.savefig(temporary, format="svg", metadata={"Date": None}, facecolor="white")
        finally:
            pyplot.close(figure)


def _draw(axis: Axes, panel: Panel) -> None:
    places = [(point.time, max(point.error, LEAST)) for point in panel.points]
    best = _front(panel.points)
    most = max((point.threads for point in panel.points), default=1)
    for point, place, on in zip(panel.points, places, best, strict=True):
        marker, color = LOOKS.get(point.family, OTHERS)
        filled = point.threads == most
        axis.plot(
            *place,
            linestyle="",
            marker=marker,
            markersize=8 if on else 6,
            markerfacecolor=color if filled else "white",
            markeredgecolor="black" if on else color,
            markeredgewidth=1.6 if on else 1.0,
            zorder=4 if on else 3,
        )
    chosen = sorted(place for place, on in zip(places, best, strict=True) if on)
    if chosen:
        # Steps: what can be had for a time is the error of the best that takes no longer.
        axis.step(
            [x for x, _ in chosen],
            [y for _, y in chosen],
            where="post",
            color="black",
            linewidth=1.2,
            linestyle="--",
            zorder=2,
        )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_title(panel.title, loc="left", fontsize=10)
    axis.set_xlabel("time a pixel, nanoseconds (median of warm pictures)")
    axis.set_ylabel("error: RMSE of random proved pixels")
    axis.grid(visible=True, which="major", color="#dddddd", linewidth=0.6)
    axis.margins(x=0.12, y=0.16)
    axis.set_axisbelow(True)
    axis.legend(
        handles=_legend({point.family for point in panel.points}),
        fontsize=8,
        loc="center left",
        bbox_to_anchor=(1.01, 0.5),
        title=f"filled: {most} threads\nhollow: fewer\nblack edge: on the front"
        if most > 1
        else "on the front: black edge",
        title_fontsize=8,
    )


def _legend(families: set[str]) -> list[Line2D]:
    """A marker of each family, and the line of the front."""
    from matplotlib.lines import Line2D

    found = []
    for family in (*LOOKS, *sorted(families - set(LOOKS))):
        if family in families:
            marker, color = LOOKS.get(family, OTHERS)
            found.append(Line2D([], [], linestyle="", marker=marker, color=color, markersize=6, label=family))
    return [*found, Line2D([], [], linestyle="--", color="black", linewidth=1.2, label="front")]


def _name(axis: Axes, points: Sequence[Point], best: Sequence[bool]) -> None:
    """Names beside the points, those of the front first; each in the direction where there is the most room."""
    places = [(point.time, max(point.error, LEAST)) for point in points]
    dots = axis.transData.transform(places)
    occupied = [(x, y) for x, y in dots]
    told: set[tuple[str, float]] = set()
    for k in sorted(range(len(points)), key=lambda k: (not best[k], points[k].time)):
        point = points[k]
        native = point.family.startswith("native")
        # The same code with another number of threads stands beside it.
        if native and (point.name, point.error) in told:
            continue
        told.add((point.name, point.error))
        label = point.name.partition("@")[2] if native and not best[k] else point.name
        if len(label) > LONGEST:
            label = label[: LONGEST - 1] + "…"
        if best[k]:
            label += f", {counted(point.threads, 'thread')}"
        x, y = dots[k]
        paths: list[tuple[int, int, int, list[tuple[float, float]]]] = []
        for angle in (ANGLE, -ANGLE, 180 - ANGLE, 180 + ANGLE):
            across, up = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            steps = range(12, 12 + int(len(label) * LETTER), 6)
            path = [(x + step * across, y + step * up) for step in steps]
            near = sum(math.dist(a, b) < LINE for a in path for b in occupied)
            outside = sum(not axis.bbox.contains(*a) for a in path)
            paths.append((near + outside, len(paths), angle, path))
        _, _, angle, path = min(paths)
        occupied += path
        left = 90 < angle < 270
        axis.annotate(
            label,
            places[k],
            xytext=(7 * math.cos(math.radians(angle)), 7 * math.sin(math.radians(angle))),
            textcoords="offset points",
            rotation=angle - 180 if left else angle,
            rotation_mode="anchor",
            ha="right" if left else "left",
            va="center",
            fontsize=7,
            fontweight="bold" if best[k] else "normal",
        )
