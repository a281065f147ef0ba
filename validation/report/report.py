"""Builds the report: one page without any other file, written beside its place and renamed."""

from __future__ import annotations

import datetime
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tracer.passes import TABLE, lookup, write_beside
from validation.report import pictures

if TYPE_CHECKING:
    from tracer.passes import Passes
    from validation.compare import Comparison
    from validation.run import Rendered, Validation

#: A small picture is enlarged to about that many pixels, by a whole number.
WIDTH = 400

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
    heatmap: pictures.Heatmap | None = None
    edges: str = ""
    zoom: int = 1


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


class Report:
    """Collects pictures while scenes are compared, so that no arrays need to be kept, and writes the page."""

    def __init__(self) -> None:
        """Empty."""
        self._scenes: list[SceneView] = []
        self._stored: dict[str, str] = {}

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
        for comparison in rendered.comparisons:
            scene.passes.append(self._view(scene, comparison, rendered.renderer, rendered.reference))
        self._scenes.append(scene)

    def _view(self, scene: SceneView, comparison: Comparison, a: Passes, b: Passes) -> PassView:
        view = PassView(
            f"{scene.anchor}-{comparison.pass_name}", comparison, zoom=max(1, round(WIDTH / max(scene.size)))
        )
        maps = comparison.maps
        if maps is None:
            return view
        name, everywhere = comparison.pass_name, np.ones(maps.edge.shape, dtype=bool)
        hits = tuple(np.asarray(side["id"]) >= 0 if "id" in side else everywhere for side in (a, b))
        drawn = pictures.pair(lookup(name), a[name], b[name], (hits[0], hits[1]))
        view.heatmap = pictures.heatmap(maps.error, maps.compared, maps.edge)
        view.identical = view.heatmap is None
        view.shared = view.identical and drawn[0].uri == drawn[1].uri
        view.a = self._store(drawn[0])
        view.b = None if view.shared else self._store(drawn[1])
        if name == "beauty":
            scene.thumbnail = view.a
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
        environment = Environment(
            loader=PackageLoader("validation.report", "."),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters |= {"short": short, "exact": exact, "cell": cell, "breakable": breakable}
        style = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
        page = environment.get_template("report.html.j2").render(
            result=result,
            style=Markup(style),
            scenes=self._ordered(),
            summary=self._summary(),
            command=shlex.join(result.command),
            made=datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        )
        path = folder / "index.html"
        with write_beside(path) as temporary:
            temporary.write_text(page, encoding="utf-8")
        return path

    def _ordered(self) -> list[SceneView]:
        """Failures first; the stored pictures keep their order of appearance, as references go by id."""
        return sorted(self._scenes, key=lambda scene: scene.failed == 0)

    def _summary(self) -> list[dict[str, Any]]:
        """One table a pair of renderers: scenes by passes."""
        pairs = dict.fromkeys((scene.renderer, scene.reference) for scene in self._scenes)
        tables = []
        for pair in pairs:
            scenes = [scene for scene in self._ordered() if (scene.renderer, scene.reference) == pair]
            found = {view.comparison.pass_name for scene in scenes for view in scene.passes}
            columns = sorted(found, key=_order)
            rows = [
                (scene, [next((v for v in scene.passes if v.comparison.pass_name == name), None) for name in columns])
                for scene in scenes
            ]
            failed = sum(scene.failed for scene in scenes)
            total = sum(len(scene.passes) for scene in scenes)
            tables.append({"pair": pair, "columns": columns, "rows": rows, "failed": failed, "total": total})
        return tables


def _order(name: str) -> tuple[int, int]:
    """The place of a pass in the table of passes."""
    row = lookup(name)
    digits = "".join(filter(str.isdigit, name))
    return TABLE.index(row), int(digits or 0)


def short(value: float | None) -> str:
    """A measured number as people read it."""
    return "–" if value is None else "0" if value == 0 else f"{value:.2g}"


def cell(ratio: float | None) -> str:
    """An error over its tolerance, short enough for a table of many columns."""
    if ratio is None or ratio == 0:
        return "–" if ratio is None else "0"
    return (
        "<0.01" if ratio < 0.01 else f"{ratio:.2f}" if ratio < 1 else f"{ratio:.3g}" if ratio < 1000 else f"{ratio:.0e}"
    )


def breakable(name: str) -> Markup:
    """A path or a pass name that a narrow column may break behind a slash or a hyphen, or before a pass's number."""
    return Markup("<wbr>").join(re.split(r"(?<=[/-])|(?<=\.)(?=L?\d)", name))


def exact(value: float) -> str:
    """A value with every digit."""
    return repr(float(value))
