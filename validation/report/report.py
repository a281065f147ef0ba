"""Builds the report: one page without any other file, written beside its place and renamed."""

from __future__ import annotations

import datetime
import importlib.metadata
import math
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from tracer.passes import TABLE, lookup
from validation import pairs
from validation.compare import without_maps
from validation.pages import environment, write_text
from validation.report import pictures
from validation.report.data import VIEWER, Data, modules
from validation.report.verdicts import CAUSES, ROWS, SHAPES, VerdictsView, unexcused
from validation.report.verdicts import view as view_verdicts
from validation.terminal import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tracer.passes import Passes
    from validation.compare import Comparison, Maps
    from validation.report.included import Included
    from validation.report.verdicts import Line, Row
    from validation.run import Note, Rendered, Validation
    from validation.verdict import Verdicts

#: A small picture is enlarged to at most that many pixels, by a whole number; three such stand side by side.
WIDTH = 400

#: Lines at the top that say why pixels differ; the rest can be opened.
LINES = 12

#: Begins the tag by which a page of ours is known.
MARK = '<meta name="generator" content="whitted '

#: A picture seen before is stored once; below this many characters that is not worth a reference.
SHARE_FROM = 1000


@dataclass
class Shown:
    """A picture on the page: with its data the first time, later with the id of the one that has it."""

    key: str
    uri: str
    picture: pictures.Picture


@dataclass
class PassView:
    """One comparison as the page shows it."""

    anchor: str
    comparison: Comparison
    a: Shown | None = None
    b: Shown | None = None
    shared: bool = False
    identical: bool = False
    heat: Shown | None = None
    flip: Shown | None = None
    heatmap: pictures.Heatmap | None = None
    edges: str = ""
    zoom: int = 1
    worst_on_edge: bool = False
    largest_on_edge: bool = False
    nearest: tuple[int, int] | None = None
    worst_tolerance: float | None = None
    worst_row: Row | None = None

    @property
    def tabled(self) -> bool:
        """Whether its numbers are all there is to show without a script."""
        return self.comparison.ok and self.a is None

    @property
    def count(self) -> int:
        """Pictures that the page shows of it."""
        return sum(shown is not None for shown in (self.a, self.b, self.heat, self.flip))

    def pictures(self) -> dict[str, Any]:
        """Where the viewer finds them: their id, or where they have none their address."""
        found: dict[str, Any] = {}
        for name, shown in (
            ("a", self.a),
            ("b", self.a if self.shared else self.b),
            ("heat", self.heat),
            ("flip", self.flip),
        ):
            if shown:
                found[f"picture_{name}"] = shown.key or shown.uri
                found["how"] = self.a.picture.how if self.a else ""
        if self.heatmap:
            found["ticks"] = [[place, text] for place, text in self.heatmap.ticks]
        return found


@dataclass
class SceneView:
    """One scene drawn by one pair."""

    anchor: str
    label: str
    text: str
    size: tuple[int, int]
    renderer: str
    reference: str
    passes: list[PassView] = field(default_factory=list)
    outlines: dict[str, str] = field(default_factory=dict)
    thumbnail: Shown | None = None
    verdicts: VerdictsView | None = None
    variant: str = ""  # what tells it from others with the same name and size

    @property
    def zoom(self) -> int:
        """How much its pictures are enlarged."""
        return max(1, WIDTH // max(self.size))

    @property
    def ok(self) -> bool:
        """Whether every pass agrees and every difference is explained."""
        return not self.failed and not (self.verdicts and self.verdicts.unexcused)

    @property
    def picture(self) -> Shown:
        """What lies under the map of verdicts: `beauty`, or the first pass that there is."""
        return self.thumbnail or next(view.a for view in self.passes if view.a)

    @property
    def pictured(self) -> list[PassView]:
        """Passes that the page shows pictures of, or tells why it has none."""
        return [view for view in self.passes if not view.tabled]

    @property
    def tabled(self) -> list[PassView]:
        """The others: a row of a table each."""
        return [view for view in self.passes if view.tabled]

    @property
    def failed(self) -> int:
        """Passes that differ."""
        return sum(not view.comparison.ok for view in self.passes)

    def reasons(self) -> list[tuple[tuple[str, ...], list[PassView]]]:
        """Why passes differ, those with the same reason together."""
        found: dict[tuple[str, ...], list[PassView]] = {}
        for view in self.passes:
            if not view.comparison.ok:
                found.setdefault(view.comparison.reasons, []).append(view)
        return list(found.items())


@dataclass
class Why:
    """Why pixels of one scene differ, in all pairs in which the finding is the same."""

    scenes: list[SceneView]
    lines: list[Line]

    def add(self, scene: SceneView, line: Line) -> None:
        """One more pair."""
        self.scenes.append(scene)
        self.lines.append(line)

    @property
    def line(self) -> Line:
        """That of the first pair."""
        return self.lines[0]

    @property
    def count(self) -> int:
        """How many pixels, each once."""
        return len({(verdict.x, verdict.y) for line in self.lines for verdict in line.group.verdicts})

    @property
    def says(self) -> str:
        """What was decided."""
        return self.line.group.what(self.count)


def ours(path: Path) -> bool:
    """Whether a page may be written there: nothing is there yet, or a page of an earlier run."""
    try:
        with path.open("rb") as stream:
            return MARK.encode() in stream.read(2048)
    except FileNotFoundError:
        return True


class Report:
    """Collects pictures while scenes are compared, so that no arrays need to be kept, and writes the page."""

    def __init__(self, *, small: bool = False, included: Sequence[Included] = ()) -> None:
        """Empty; `small`: without the float data, so that every pass has its pictures instead.

        `included`: results of other commands that the page shows, too.
        """
        self._included = included
        self._scenes: list[SceneView] = []
        self._stored: dict[str, str] = {}
        self._data = Data(small=small)
        self._finished: list[SceneView] = []

    def add(self, rendered: Rendered) -> None:
        """Make the pictures of one scene and one pair."""
        if not rendered.comparisons:
            return
        first = rendered.comparisons[0]
        scene = SceneView(
            f"s{len(self._scenes)}",
            rendered.label,
            rendered.scene.text(),
            first.size,
            first.renderer,
            first.reference,
        )
        scene.verdicts = view_verdicts(rendered, scene.anchor, scene.zoom)
        for comparison in rendered.comparisons:
            scene.passes.append(self._view(scene, comparison, rendered.renderer, rendered.reference))
        self._scenes.append(scene)
        shown = {view.comparison.pass_name: view.pictures() for view in scene.passes}
        self._data.add(rendered, scene.anchor, scene.verdicts, shown, ok=scene.ok)

    def _view(self, scene: SceneView, comparison: Comparison, a: Passes, b: Passes) -> PassView:
        anchor, maps = f"{scene.anchor}-{comparison.pass_name}", comparison.maps
        view = PassView(anchor, without_maps(comparison), zoom=scene.zoom)
        if maps is None:
            return view
        if worst := comparison.worst:
            view.worst_on_edge = bool(maps.edge[worst.y, worst.x])
            view.worst_tolerance = float(maps.tolerance[worst.y, worst.x])
            row = scene.verdicts.by_pixel.get((worst.x, worst.y)) if scene.verdicts else None
            if row and comparison.pass_name in row.verdict.passes:
                view.worst_row = row
        errors = np.where(maps.compared, maps.error, -1.0)
        view.largest_on_edge = bool(errors[maps.edge].max(initial=-1.0) > errors[~maps.edge].max(initial=-1.0))
        view.nearest = _nearest(comparison, maps)
        name, everywhere = comparison.pass_name, np.ones(maps.edge.shape, dtype=bool)
        hits = tuple(np.asarray(side["id"]) >= 0 if "id" in side else everywhere for side in (a, b))
        view.heatmap = pictures.heatmap(maps.error, maps.compared, maps.edge)
        view.identical = view.heatmap is None
        # What agrees is in the float data; the part that needs no script is the leaner for it.
        if comparison.ok and name != "beauty" and not self._data.small and any(other.a for other in scene.passes):
            view.heatmap = None
            return view
        drawn = pictures.pair(lookup(name), a[name], b[name], (hits[0], hits[1]))
        view.shared = view.identical and drawn[0].uri == drawn[1].uri
        view.a = self._store(drawn[0])
        view.b = None if view.shared else self._store(drawn[1])
        if name == "beauty":
            scene.thumbnail = view.a
        if comparison.flip and comparison.flip.max > 0:
            view.flip = self._store(pictures.flip(comparison.flip.map))
        if view.heatmap:
            view.heat = self._store(view.heatmap.picture)
            if path := pictures.outline(maps.edge & maps.compared):
                known = {drawn_path: key for key, drawn_path in scene.outlines.items()}
                view.edges = known.get(path) or f"{scene.anchor}-e{len(known)}"
                scene.outlines[view.edges] = path
        return view

    def _store(self, picture: pictures.Picture) -> Shown:
        if len(picture.uri) < SHARE_FROM:
            return Shown("", picture.uri, picture)
        if picture.uri in self._stored:
            return Shown(self._stored[picture.uri], "", picture)
        key = f"p{len(self._stored)}"
        self._stored[picture.uri] = key
        return Shown(key, picture.uri, picture)

    def write(self, folder: Path, result: Validation) -> Path:
        """Write `index.html` into the folder and return its path."""
        templates = environment()
        templates.filters |= {"short": short, "exact": exact, "cell": cell, "share": share, "number": counted}
        templates.filters |= {"breakable": breakable, "heading": heading, "bound": bound}
        templates.filters |= {"scaled": scaled}
        style = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
        style += (VIEWER / "viewer.css").read_text(encoding="utf-8")
        top = headline(result)
        # Of a run that ended early, one may be half done.
        pairs_done = {
            (comparison.scene, comparison.renderer, comparison.reference) for comparison in result.comparisons
        }
        self._finished = [
            scene
            for scene in self._scenes
            if not result.unfinished or (scene.label, scene.renderer, scene.reference) in pairs_done
        ]
        variants = self._data.variants()
        for scene in self._scenes:
            scene.variant = variants[scene.anchor]
        record, blocks = self._data.page(
            {"command": shlex.join(result.command), "versions": result.versions},
            {scene.anchor for scene in self._finished},
        )
        page = templates.get_template("report.html.j2").render(
            result=result,
            style=Markup(style),
            mark=Markup(MARK) + importlib.metadata.version("whitted"),
            headline=top,
            record=Markup(record),
            blocks=[(key, Markup(text)) for key, text in blocks],
            modules=Markup(modules()),
            scenes=self._ordered(),
            summary=self._summary(),
            names=pairs.names(result.comparisons),
            matrix=pairs.matrix(result.comparisons) if pairs.several(result.comparisons) else {},
            alone=pairs.alone(result.comparisons),
            judged=judged(result.verdicts),
            lines=self._lines(),
            lines_shown=LINES,
            small=self._data.small,
            uris={key: uri for uri, key in self._stored.items()},
            rows_shown=ROWS,
            causes=CAUSES,
            shapes=SHAPES,
            included=self._included,
            command=shlex.join(result.command),
            made=datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        )
        path = folder / "index.html"
        write_text(path, page)
        return path

    def _ordered(self) -> list[SceneView]:
        """Failures first; the stored pictures keep their order of appearance, as references go by id."""
        return sorted(self._finished, key=lambda scene: (scene.failed == 0, scene.ok))

    def _lines(self) -> list[Why]:
        """Why pixels differ, of all scenes; what nothing explains first, then in the order of the scenes.

        What is found of a renderer against one and against another is said once.
        """
        found: dict[tuple[object, ...], Why] = {}
        for scene in self._ordered():
            for line in scene.verdicts.lines if scene.verdicts else ():
                # That neither is off is about the pair.
                who = (scene.renderer, scene.reference) if line.finding.right else line.finding.renderer
                found.setdefault((scene.label, scene.size, who, *line.key), Why([], [])).add(scene, line)
        worth = {"unexplained": 0, "mistake": 1}
        return sorted(found.values(), key=lambda why: worth.get(why.line.finding.cause, 2))

    def _summary(self) -> list[dict[str, Any]]:
        """One table a pair of renderers: scenes by passes."""
        pairs = dict.fromkeys((scene.renderer, scene.reference) for scene in self._finished)
        tables = []
        for pair in pairs:
            scenes = [scene for scene in self._ordered() if (scene.renderer, scene.reference) == pair]
            found = {view.comparison.pass_name for scene in scenes for view in scene.passes}
            columns = sorted(found, key=_order)
            labels = [scene.label for scene in scenes]
            folder = shared_folder(labels)
            rows = [
                {
                    "scene": scene,
                    "label": scene.label[len(folder) :],
                    # A scene may have been drawn at two sizes, each with some of the passes.
                    "size": "{}×{}".format(*scene.size) if labels.count(scene.label) > 1 else "",
                    "cells": [
                        next((v for v in scene.passes if v.comparison.pass_name == name), None) for name in columns
                    ],
                }
                for scene in scenes
            ]
            failed = sum(scene.failed for scene in scenes)
            total = sum(len(scene.passes) for scene in scenes)
            table = {"pair": pair, "folder": folder, "columns": columns, "rows": rows}
            tables.append({**table, "failed": failed, "total": total})
        return tables


def _nearest(comparison: Comparison, maps: Maps) -> tuple[int, int] | None:
    """Column and row of the interior pixel that a comparison's ratio is about."""
    if comparison.interior_over and comparison.worst:
        return comparison.worst.x, comparison.worst.y
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = np.where(maps.error == 0, 0.0, maps.error / maps.tolerance)
    ratios = np.where(maps.compared & ~maps.edge, ratios, -1.0)
    y, x = (int(index) for index in np.unravel_index(int(ratios.argmax()), ratios.shape))
    return (x, y) if ratios[y, x] >= 0 else None


def _order(name: str) -> tuple[int, int]:
    """The place of a pass in the table of passes."""
    row = lookup(name)
    digits = "".join(filter(str.isdigit, name))
    return TABLE.index(row), int(digits or 0)


def headline(result: Validation) -> str:
    """What came out, in one line; that something failed, or is wrong besides, comes first."""
    wrong = f"Wrong: {'; '.join(result.wrong)}" if result.wrong else ""
    done = f"{len(result.scenes) - len(result.unfinished)} of {counted(len(result.scenes), result.parts)}"
    unfinished = f"Unfinished: {done}" if result.unfinished else ""
    # Of one program what is wrong with it.
    likely = " and ".join(line for line in result.about if line.startswith("most likely"))
    likely = likely[:1].upper() + likely[1:]
    return ". ".join(filter(None, (unfinished, failed(result.failures), wrong, likely, compared(result))))


def failed(failures: Sequence[Note]) -> str:
    """Who failed, and where."""
    names = list(dict.fromkeys(failure.renderer for failure in failures))
    if not names:
        return ""
    crashed = all(failure.message.startswith("crashed") for failure in failures)
    who = names[0] or "What was asked for" if len(names) == 1 else counted(len(names), "renderer")
    scenes = list(dict.fromkeys(failure.scene for failure in failures if failure.scene))
    where = f" on {scenes[0] if len(scenes) == 1 else counted(len(scenes), 'scene')}" * bool(scenes)
    return f"{who} {'crashed' if crashed else 'failed'}{where}"


def compared(result: Validation) -> str:
    """What came out of all that could be compared."""
    total = len(result.comparisons)
    if not total:
        return "Nothing was compared"
    failed = sum(not comparison.ok for comparison in result.comparisons)
    if failed:
        text = f"{failed} of {counted(total, 'comparison')} differ{'s' if total == 1 else ''}"
    else:
        text = "The only comparison agrees" if total == 1 else f"All {total} comparisons agree"
    clause = without_excuse(result.verdicts)
    if not failed and not clause:
        text += differing(result.verdicts)
    return text + f", {'and' if failed else 'but'} {clause}" * bool(clause)


def differing(several: Sequence[Verdicts]) -> str:
    """What to add where comparisons agree, though pixels at edges differ, none of them without an excuse."""
    differ, count = different(several)
    if not differ:
        return ""
    text = f" within tolerance; {counted(differ, 'edge pixel')} {'differs' if differ == 1 else 'differ'}"
    if (pairs := by_pair(several)) > 1:
        text += f" in {pairs} pairs"
    if not count or not all(of.explained for of in several):
        return text
    if count < differ:
        return f"{text}, the {count} judged {'is' if count == 1 else 'are'} explained"
    return f"{text} and {'is' if differ == 1 else 'are'} explained"


def by_pair(several: Sequence[Verdicts]) -> int:
    """1 where every pixel that differs is known, and counted once; else in how many pairs of renderers they differ."""
    sampled = any(len(of.verdicts) + len(of.unproved) < of.differ for of in several)
    return len({(of.renderer, of.reference) for of in several}) if sampled else 1


def different(several: Sequence[Verdicts]) -> tuple[int, int]:
    """How many pixels differ, and how many of them were judged: of all pairs each once, where all are known."""
    if by_pair(several) > 1:
        return sum(of.differ for of in several), sum(len(of.verdicts) for of in several)
    pairs: dict[tuple[str, str, str], list[Verdicts]] = {}
    for of in several:
        pairs.setdefault((of.scene, of.renderer, of.reference), []).append(of)
    # Of one pair there are several where a scene was drawn at several sizes: other pixels.
    if any(len(sizes) > 1 for sizes in pairs.values()) or len({pair[1:] for pair in pairs}) < 2:
        return sum(of.differ for of in several), sum(len(of.verdicts) for of in several)
    judged = {(of.scene, verdict.x, verdict.y) for of in several for verdict in of.verdicts}
    unproved = {(of.scene, *place) for of in several for place in of.unproved}
    return len(judged | unproved), len(judged)


def judged(several: Sequence[Verdicts]) -> dict[str, int | bool]:
    """How many pixels differ, in how many scenes, and how many of them were judged."""
    verdicts = [verdict for of in several for verdict in of.verdicts]
    differ, count = different(several)
    return {
        "differ": differ,
        "pairs": by_pair(several),
        "scenes": len({of.scene for of in several}),
        "count": count,
        "sampled": differ > count,
        "stopped": any(of.stopped for of in several),
        "both": sum(len(verdict.wrong) > 1 for verdict in verdicts),
        "all_on_edges": differ == count and all(verdict.edge for verdict in verdicts),
    }


def without_excuse(several: Sequence[Verdicts]) -> str:
    """How many pixels are unexplained and how many wrong, as a clause; "" where there are none."""
    found = unexcused(several)
    words = [word for word in ("unexplained", "wrong") if found[word]]
    if not words:
        return ""
    first, *others = words
    # Of a sample that has some, there may be more.
    least = "at least " * any(len(of.verdicts) < of.differ for of in several if not of.explained)
    text = f"{least}{counted(found[first], 'pixel')} {'is' if found[first] == 1 else 'are'} {first}"
    return text + "".join(f" and {found[word]} {word}" for word in others)


def shared_folder(labels: Sequence[str]) -> str:
    """The folders, with a slash at the end, that the names of all scenes begin with; empty if there are none."""
    shared = ""
    for folders in zip(*(label.split("/")[:-1] for label in labels), strict=False):
        if len(set(folders)) > 1:
            break
        shared += f"{folders[0]}/"
    return shared


def digits(value: float, form: str = ".2g") -> str:
    """A number without the filling of an exponent."""
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if form == ".2g" and 99.5 <= abs(value) < 1e5:
        form = ".0f"
    return re.sub(r"e\+?(-?)0*(?=\d)", r"e\1", format(value, form))


def short(value: float | None) -> str:
    """A measured number as people read it."""
    return "–" if value is None else digits(value)


def scaled(length: float, unit: float) -> str:
    """A length in units of the marks' size, to a hundredth of a pixel of the screen or so."""
    return f"{length / unit:.2f}".rstrip("0").rstrip(".")


def bound(tolerance: float) -> str:
    """A tolerance of one pixel; near a discontinuity it grows beyond every number."""
    return digits(tolerance) if math.isfinite(tolerance) else "none: the values have no bound"


def share(ratio: float) -> str:
    """An error over its tolerance, at most 1, in words."""
    return "0 %" if ratio == 0 else "less than 0.1 %" if ratio < 0.001 else f"{digits(100 * ratio)} %"


def cell(ratio: float | None) -> str:
    """An error over its tolerance, short enough for a table of many columns."""
    if ratio is None or ratio == 0:
        return "–" if ratio is None else "0"
    if ratio < 0.01:
        return "<.01"
    if ratio < 0.995:
        return f"{ratio:.2f}".removeprefix("0")
    if 0.995 <= ratio < 1.005 and ratio != 1:  # rounded, it would read as 1 on either side
        return "<1" if ratio < 1 else ">1"
    return digits(ratio, ".3g" if ratio < 999.5 else ".0e")


def heading(name: str) -> Markup:
    """The name of a pass in a column as narrow as its cells."""
    return Markup("&shy;").join(["reflec", breakable(name[6:])]) if name.startswith("reflec") else breakable(name)


def breakable(name: str) -> Markup:
    """A path or a pass name that a narrow column may break behind a slash or a hyphen, or before a pass's number."""
    return Markup("<wbr>").join(re.split(r"(?<=[/-])|(?<=\.)(?=L?\d)", name))


def exact(value: float) -> str:
    """A value with every digit."""
    return repr(float(value))
