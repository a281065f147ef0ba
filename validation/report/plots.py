"""Plots as SVG in a page, without a script: every point has a `title` that names it where the pointer rests."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from validation.speed_plot import LOOKS, OTHERS

#: Around the origin, as wide as 2; the letters are those of matplotlib, as in `LOOKS`.
SHAPES = {
    "o": "M-1 0a1 1 0 1 0 2 0a1 1 0 1 0-2 0Z",
    "s": "M-.9-.9H.9V.9H-.9Z",
    "^": "M0-1.1L1.1.9H-1.1Z",
    "v": "M0 1.1L1.1-.9H-1.1Z",
    "<": "M-1.1 0L.9-1.1V1.1Z",
    ">": "M1.1 0L-.9-1.1V1.1Z",
    "D": "M0-1.2L1.2 0L0 1.2L-1.2 0Z",
    "P": "M-.4-1.1H.4V-.4H1.1V.4H.4V1.1H-.4V.4H-1.1V-.4H-.4Z",
    "X": "M0-.55L.55-1.1L1.1-.55L.55 0L1.1.55L.55 1.1L0 .55L-.55 1.1L-1.1 .55L-.55 0L-1.1-.55L-.55-1.1Z",
    "*": "M0-1.3L.35-.4L1.25-.4L.55.2L.8 1.1L0 .55L-.8 1.1L-.55.2L-1.25-.4L-.35-.4Z",
    "h": "M0-1.1L.95-.55V.55L0 1.1L-.95.55V-.55Z",
    "p": "M0-1.1L1.05-.34L.65.9H-.65L-1.05-.34Z",
    "d": "M0-1.3L.75 0L0 1.3L-.75 0Z",
    "8": "M-.45-1.1H.45L1.1-.45V.45L.45 1.1H-.45L-1.1.45V-.45Z",
}
#: For what has no look of its own, or not the only one of it.
SPARE = (OTHERS[0], ">", "p", "d", "8")
RADIUS, REACH = 4.2, 9.0
#: So many labels along an axis at most.
LABELS = 9
LEFT, RIGHT, TOP, BETWEEN, BOTTOM = 66, 14, 10, 16, 44


@dataclass(frozen=True)
class Look:
    """Told apart by its shape as well as by its colour; `dashed`: another line has that colour."""

    shape: str
    color: str
    dashed: bool = False

    @property
    def line(self) -> str:
        """Attributes of a line."""
        return f'class="line{" dashed" * self.dashed}" style="--series:{self.color}"'

    def svg(self, *, hollow: bool = False, line: bool = False) -> Markup:
        """For a legend, with its line where it has one."""
        kind = ' class="hollow"' if hollow else ""
        path_of_line = f'<path {self.line} d="M-13 0H13"/>' if line else ""
        path = f'<path{kind} d="{SHAPES[self.shape]}" transform="scale({RADIUS})"/>'
        return Markup(
            f'<svg class="plot sign" viewBox="-13 -8 26 16" aria-hidden="true">'
            f'{path_of_line}<g style="--series:{self.color}">{path}</g></svg>'
        )


def looks(families: Iterable[tuple[str, str]]) -> dict[str, Look]:
    """One for each name; of a second name of a family the colour stays and the shape is another."""
    found: dict[str, Look] = {}
    spare = 0
    for name, family in families:
        shape, color = LOOKS.get(family, OTHERS)
        if any(look.shape == shape for look in found.values()):
            shape, spare = SPARE[spare % len(SPARE)], spare + 1
        found[name] = Look(shape, color, any(look.color == color for look in found.values()))
    return found


@dataclass(frozen=True)
class Point:
    """A place, in the units of its axes, and what it says."""

    x: float
    y: float
    says: str
    hollow: bool = False
    ring: bool = False
    label: str = ""


@dataclass(frozen=True)
class Series:
    """Points with one look; `joined`: by a line, which ends where a point is missing."""

    name: str
    look: Look
    points: Sequence[Point | None]
    joined: bool = False


@dataclass(frozen=True)
class Axis:
    """From values to a share of the axis: the ends, and labels at values."""

    title: str
    low: float
    high: float
    ticks: Sequence[tuple[float, str]]
    logarithmic: bool = False

    def share(self, value: float) -> float:
        """From 0 to 1; on a logarithmic axis 0 is at its low end."""
        if self.logarithmic:
            value = math.log10(value) if value > 0 else self.low
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Panel:
    """Series over one axis; panels stand above each other."""

    axis: Axis
    series: Sequence[Series]
    height: int
    steps: Sequence[tuple[float, float]] = field(default=())


def decades(title: str, values: Iterable[float], *, zero: bool = False) -> Axis:
    """A logarithmic axis; `zero`: its low end stands for 0."""
    found = [value for value in values if math.isfinite(value)]
    above = [math.log10(value) for value in found if value > 0] or [0.0]
    low, high = math.floor(min(above) - 0.15), math.ceil(max(above) + 0.15)
    zero = zero and 0 in found
    step = max(1, math.ceil((high - low) / LABELS))
    ticks = [(10.0**place, power(place)) for place in range(high, low - 1, -step)]
    if zero:
        low -= max(1, step)
        ticks.append((0.0, "0"))
    return Axis(title, low, high, ticks, logarithmic=True)


def power(exponent: int) -> str:
    """Of ten, as people write it."""
    return f"{10.0**exponent:g}" if -2 <= exponent <= 3 else f"1e{exponent}"


def places(title: str, names: Sequence[str]) -> Axis:
    """One place for each name."""
    every = max(1, math.ceil(len(names) / 14))
    ticks = [(float(at), name) for at, name in enumerate(names) if at % every == 0]
    return Axis(title, -0.5, max(len(names), 1) - 0.5, ticks)


def plot(x: Axis, panels: Sequence[Panel], about: str, width: int = 560) -> Markup:
    """The picture; `about`: for those who do not see it."""
    wide = width - LEFT - RIGHT
    height = TOP + sum(panel.height for panel in panels) + BETWEEN * (len(panels) - 1) + BOTTOM
    parts = [f'<svg class="plot" viewBox="0 0 {width} {height}" role="img" aria-label="{html.escape(about)}">']
    top = TOP
    for panel in panels:
        parts.append(_panel(x, panel, top, wide, last=panel is panels[-1]))
        top += panel.height + BETWEEN
    parts.append(f'<text class="axis" x="{LEFT + wide / 2:.0f}" y="{height - 6}">{html.escape(x.title)}</text></svg>')
    return Markup("".join(parts))


def _panel(x: Axis, panel: Panel, top: int, wide: int, *, last: bool) -> str:
    axis, high = panel.axis, panel.height

    def at(point: tuple[float, float]) -> tuple[float, float]:
        return LEFT + x.share(point[0]) * wide, top + (1 - axis.share(point[1])) * high

    parts = [f'<rect class="ground" x="{LEFT}" y="{top}" width="{wide}" height="{high}"/>']
    for value, text in axis.ticks:
        y = at((1, value))[1]
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}h{wide}"/>')
        parts.append(f'<text class="tick end" x="{LEFT - 6}" y="{y + 3.5:.1f}">{html.escape(text)}</text>')
    middle = top + high / 2
    parts.append(
        f'<text class="axis" transform="translate(13 {middle:.0f}) rotate(-90)">{html.escape(axis.title)}</text>'
    )
    for value, text in x.ticks:
        left = at((value, axis.low))[0]
        parts.append(f'<path class="grid" d="M{left:.1f} {top}v{high}"/>')
        if last:
            parts.append(f'<text class="tick" x="{left:.1f}" y="{top + high + 15}">{html.escape(text)}</text>')
    if panel.steps:
        path = "".join(
            f"M{px:.1f} {py:.1f}" if not k else f"H{px:.1f}V{py:.1f}" for k, (px, py) in enumerate(map(at, panel.steps))
        )
        parts.append(f'<path class="front" d="{path}"/>')
    drawn = [(series, [at((p.x, p.y)) if p else None for p in series.points]) for series in panel.series]
    for series, spots in drawn:
        if series.joined:
            parts.append(_line(series, spots))
    for series, spots in drawn:
        parts.append(f'<g style="--series:{series.look.color}">')
        for point, spot in zip(series.points, spots, strict=True):
            if point and spot:
                parts.append(_point(point, spot, series.look))
        parts.append("</g>")
    parts += _labels(drawn, (LEFT, top, LEFT + wide, top + high))
    return "".join(parts)


def _line(series: Series, spots: Sequence[tuple[float, float] | None]) -> str:
    path, pen = "", "M"
    for spot in spots:
        path += f"{pen}{spot[0]:.1f} {spot[1]:.1f}" if spot else ""
        pen = "L" if spot else "M"
    return f'<path {series.look.line} d="{path}"/>'


def _point(point: Point, spot: tuple[float, float], look: Look) -> str:
    hollow = ' class="hollow"' if point.hollow else ""
    ring = f'<circle class="ring" r="{RADIUS + 3.5}"/>' if point.ring else ""
    return (
        f'<g class="point" transform="translate({spot[0]:.1f} {spot[1]:.1f})"><title>{html.escape(point.says)}</title>'
        f'<circle class="reach" r="{REACH}"/>{ring}'
        f'<path{hollow} d="{SHAPES[look.shape]}" transform="scale({RADIUS})"/></g>'
    )


def _labels(
    drawn: Sequence[tuple[Series, Sequence[tuple[float, float] | None]]], box: tuple[float, float, float, float]
) -> list[str]:
    """Names beside some points, where they cover the least."""
    taken = [(x - 6, y - 6, x + 6, y + 6) for _, spots in drawn for x, y in filter(None, spots)]
    parts = []
    for series, spots in drawn:
        for point, spot in zip(series.points, spots, strict=True):
            if not point or not spot or not point.label:
                continue
            x, y = spot
            long = 6.1 * len(point.label)
            choices = []
            for rank, (dx, dy) in enumerate(
                ((10, 0), (8, -13), (8, 13), (-10 - long, 0), (-8 - long, -13), (-8 - long, 13))
            ):
                area = (x + dx, y + dy - 7, x + dx + long, y + dy + 7)
                outside = area[0] < box[0] or area[2] > box[2] or area[1] < box[1] or area[3] > box[3]
                hits = sum(a < area[2] and c > area[0] and b < area[3] and d > area[1] for a, b, c, d in taken)
                choices.append((hits + 10 * outside, rank, area))
            _, _, area = min(choices)
            taken.append(area)
            parts.append(
                f'<text class="name" x="{area[0]:.1f}" y="{area[1] + 11:.1f}">{html.escape(point.label)}</text>'
            )
    return parts
