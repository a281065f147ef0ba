"""What the viewer in the page knows: scenes, comparisons and verdicts as JSON, float arrays as blocks of text."""

from __future__ import annotations

import base64
import itertools
import json
import shlex
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tracer.passes import MARGINS, TABLE
from validation import encoding
from validation.records import json_value
from validation.renderers import Settings
from validation.report import floats
from validation.report.verdicts import CAUSES
from validation.run import explain_options

if TYPE_CHECKING:
    from collections.abc import Container

    from numpy.typing import NDArray

    from tracer.passes import Passes
    from validation.compare import Maps
    from validation.encoding import Encoding
    from validation.report.verdicts import Row, VerdictsView
    from validation.run import Rendered

#: As many characters the float data of a page take at most: 60 MB less what pictures and words need.
MOST = 54_000_000

#: The bits of a pixel in the map of a comparison; those of the kinds of margin follow.
COMPARED, OVER, EDGE = 1, 2, 4
KINDS = {kind: 8 << place for place, kind in enumerate(MARGINS)}

VIEWER = Path(__file__).with_name("viewer")

Json = dict[str, Any]


class Place(NamedTuple):
    """What has to be the same where renderers share values of a scene: one name draws the same then."""

    label: str
    size: tuple[int, int]
    text: str
    settings: Settings
    convention: str

    @classmethod
    def of(cls, rendered: Rendered) -> Place:
        """That of one pair."""
        settings = replace(rendered.settings, threads=Settings.threads)
        size = rendered.comparisons[0].size
        return cls(rendered.label, size, rendered.scene.text(), settings, rendered.convention)

    @property
    def says(self) -> str:
        """How it was drawn, in a few words: "center, round"."""
        told, plain = self.settings, Settings()
        words: list[str] = [told.sample]
        if told.shadow_epsilon != plain.shadow_epsilon:
            words.append(f"epsilon {told.shadow_epsilon:g}")
        if told.max_reflections != plain.max_reflections:
            words.append(f"reflections {told.max_reflections}")
        # Of options such as `--quantisation round --flipped` what they say.
        words += [word.removeprefix("--") for word in shlex.split(self.convention) if word != "--quantisation"]
        return ", ".join(words)


@dataclass
class Drawn:
    """One renderer on one scene: its passes, compressed."""

    name: str
    stored: dict[str, floats.Stored] = field(default_factory=dict)
    encoding: Encoding | None = None  # of its `beauty`
    exact: Json = field(default_factory=dict)  # by pixel and pass the float64 values of those that are looked at most


@dataclass
class SceneData:
    """One scene at one size with the same settings, and every pair that drew it."""

    key: str
    size: tuple[int, int]
    entry: Json
    guide: floats.Guide
    margins: str = ""
    drawn: list[Drawn] = field(default_factory=list)
    source: floats.Source | None = None
    closed: bool = False
    pairs: list[Json] = field(default_factory=list)
    truths: Json = field(default_factory=dict)
    signed: dict[str, str] = field(default_factory=dict)  # errors of pairs of which one side is levels

    def stored(self, tier: int) -> dict[str, str]:
        """Blocks of text by id. 0: what every picture needs; 1: how float64 renderers differ; 2: their last digits."""
        found: dict[str, str] = {}
        if tier == 0 and self.margins:
            found[f"m{self.key}"] = self.margins
        if tier == 0:
            found |= {pair["signed"]: self.signed[pair["signed"]] for pair in self.pairs if pair["signed"]}
        for place, drawn in enumerate(self.drawn):
            for name, stored in drawn.stored.items():
                if tier == 0:
                    found[f"d{self.key}-{place}-{name}"] = stored.base
                elif stored.rest and (tier == 1) == stored.based:
                    found[f"x{self.key}-{place}-{name}"] = stored.rest
        return found

    @property
    def ok(self) -> bool:
        """Whether every pair agrees."""
        return all(pair["ok"] for pair in self.pairs)


class Data:
    """Collects what the viewer shows, scene after scene, compressed at once; `small`: without the float arrays."""

    def __init__(self, *, small: bool = False) -> None:
        """Empty."""
        self.small = small
        self._scenes: dict[Place, SceneData] = {}
        self._flags: dict[str, str] = {}

    def add(self, rendered: Rendered, anchor: str, verdicts: VerdictsView | None, pictures: Json, *, ok: bool) -> None:
        """One more pair; `pictures`: by pass what the page shows of it."""
        size = rendered.comparisons[0].size
        place = Place.of(rendered)
        if place not in self._scenes:
            # The arrays of the scene before are not needed any more.
            for other in self._scenes.values():
                other.source, other.closed = None, True
            self._scenes[place] = self._new(rendered, size)
        scene = self._scenes[place]
        first = rendered.comparisons[0]
        sides = [
            self._draw(scene, name, passes, encoding)
            for name, passes, encoding in zip(
                (first.renderer, first.reference),
                (rendered.renderer, rendered.reference),
                rendered.encodings,
                strict=True,
            )
        ]
        rows = verdicts.rows if verdicts else []
        looked_at = {(row.verdict.x, row.verdict.y) for row in rows}
        looked_at |= {(c.worst.x, c.worst.y) for c in rendered.comparisons if c.worst}
        for side, passes in zip(sides, (rendered.renderer, rendered.reference), strict=True):
            self._keep(scene.drawn[side], passes, looked_at)
        for row in rows:
            values = {name: [ball.value for ball in balls] for name, balls in row.verdict.truth.values.items()}
            scene.truths[f"{row.verdict.x},{row.verdict.y}"] = values
        judged = verdicts.verdicts if verdicts else rendered.verdicts
        scene.pairs.append(
            {
                "a": sides[0],
                "b": sides[1],
                "anchor": anchor,
                "ok": ok,
                "signed": self._signed(scene, rendered),
                "passes": {
                    c.pass_name: {
                        **{key: value for key, value in c.record().items() if key not in LEFT_OUT},
                        "flags": "" if c.maps is None or self.small else self._flag(c.maps),
                        **pictures.get(c.pass_name, {}),
                    }
                    for c in rendered.comparisons
                },
                "differ": judged.differ if judged else 0,
                "verdicts": [_verdict(row, rendered) for row in rows],
                "unproved": [list(pixel) for pixel in judged.unproved] if judged else [],
            }
        )

    def _new(self, rendered: Rendered, size: tuple[int, int]) -> SceneData:
        analysis = rendered.analysis
        key = f"{len(self._scenes)}"
        guide = floats.Guide.of(rendered.scene, rendered.settings)
        entry: Json = {
            "key": key,
            "label": rendered.label,
            "size": list(size),
            "text": rendered.scene.text(),
            "spheres": [sphere.name for sphere in rendered.scene.spheres],
            "lights": [light.name for light in rendered.scene.lights],
            "path": rendered.path or rendered.label,
            "options": explain_options(
                rendered.path or rendered.label, rendered.scene, rendered.settings, rendered.convention
            ),
            "rays": guide.rays,
            "surfaces": guide.spheres,
            "margins": list(analysis.margins) if analysis and not self.small else [],
        }
        data = SceneData(key, size, entry, guide)
        if analysis and not self.small:
            data.margins = floats.store_margins(analysis.margins)
        return data

    def _signed(self, scene: SceneData, rendered: Rendered) -> str:
        """The block with the error of `beauty` that was measured, positive where A is larger; "": there is none.

        Of levels the viewer cannot tell it: how far a colour is from those that a level stands for.
        """
        found = next((c.maps for c in rendered.comparisons if c.pass_name == "beauty"), None)
        if found is None or self.small or not any(rendered.encodings):
            return ""
        a, b = (np.asarray(side["beauty"], np.float64) for side in (rendered.renderer, rendered.reference))
        apart = encoding.difference(a, b, rendered.encodings)
        largest = np.where(np.isnan(apart), np.inf, apart).argmax(axis=-1)[..., None]
        sign = np.take_along_axis(encoding.signs(a, b, rendered.encodings), largest, axis=-1)[..., 0]
        key = f"e{scene.key}-{len(scene.pairs)}"
        scene.signed[key] = floats.store_plane(np.where(found.error == 0, 0.0, sign * found.error))
        return key

    def _draw(self, scene: SceneData, name: str, passes: Passes, encoding: Encoding | None) -> int:
        """The place of a renderer among those of the scene; what it drew is stored the first time."""
        for place, drawn in enumerate(scene.drawn):
            if drawn.name == name:
                return place
        drawn = Drawn(name, encoding=encoding)
        if not self.small:
            # The viewer knows one size: a pass of another was not compared either.
            shape = scene.size[1], scene.size[0]
            fitting = {key: array for key, array in passes.items() if array.shape[:2] == shape}
            drawn.stored, own = floats.store(fitting, scene.source, scene.guide)
            # Of a scene that comes again after others the first renderer's arrays are gone.
            scene.source = None if scene.closed else scene.source or own
        scene.drawn.append(drawn)
        return len(scene.drawn) - 1

    def _keep(self, drawn: Drawn, passes: Passes, pixels: set[tuple[int, int]]) -> None:
        for x, y in sorted(pixels):
            for name, stored in drawn.stored.items():
                if stored.wide:
                    values = np.atleast_1d(passes[name][y, x]).astype(np.float64).tolist()
                    drawn.exact.setdefault(f"{x},{y}", {})[name] = values

    def _flag(self, maps: Maps) -> str:
        flags: NDArray[np.uint8] = maps.compared * np.uint8(COMPARED) + maps.over * np.uint8(OVER)
        flags = flags + maps.edge * np.uint8(EDGE)
        for kind, mask in maps.kinds.items():
            flags = flags + mask * np.uint8(KINDS[kind])
        text = floats.store_bytes(flags.astype(np.uint8))
        return self._flags.setdefault(text, f"f{len(self._flags)}")

    def variants(self) -> dict[str, str]:
        """By pair, by its anchor, what tells its scene from others with the same name and size; "": there are none."""
        found: dict[str, str] = {}
        taken = set()
        alike = Counter((place.label, place.size) for place in self._scenes)
        for place, scene in self._scenes.items():
            says = place.says if alike[place.label, place.size] > 1 else ""
            candidates = itertools.chain([says], (f"{says} {number}" for number in itertools.count(2)))
            variant = next(name for name in candidates if (place.label, place.size, name) not in taken)
            taken.add((place.label, place.size, variant))
            found |= {pair["anchor"]: variant for pair in scene.pairs}
        return found

    def page(self, about: Json, finished: Container[str]) -> tuple[str, list[tuple[str, str]]]:
        """The JSON of all scenes, and the blocks of text by id; what does not fit is left out, failures last.

        `finished`: the pairs, by anchor, that are in the page.
        """
        left = MOST - sum(map(len, self._flags))
        blocks = {key: text for text, key in self._flags.items()}
        scenes = [
            replace(scene, pairs=[pair for pair in scene.pairs if pair["anchor"] in finished])
            for scene in self._scenes.values()
        ]
        ordered = sorted((scene for scene in scenes if scene.pairs), key=lambda scene: scene.ok)
        tiers = {scene.key: 0 for scene in ordered}  # how many of them are in the page
        for tier in () if self.small else range(3):
            for scene in ordered:
                stored = scene.stored(tier)
                need = sum(map(len, stored.values()))
                if tiers[scene.key] == tier and need <= left:
                    tiers[scene.key] += 1
                    left -= need
                    blocks |= stored
        variants = self.variants()
        entries = [
            {**self._entry(scene, tiers[scene.key]), "as": variants[scene.pairs[0]["anchor"]]} for scene in ordered
        ]
        record = {
            **about,
            "small": self.small,
            "causes": CAUSES,
            "kinds": KINDS,
            "table": [{"name": row.name, "channels": row.channels, "quantity": row.quantity} for row in TABLE],
            "scenes": entries,
        }
        return json.dumps(json_value(record), ensure_ascii=False).replace("<", "\\u003c"), [*blocks.items()]

    def _entry(self, scene: SceneData, tiers: int) -> Json:
        whole = tiers == 3
        return {
            **scene.entry,
            "floats": tiers > 0,
            "whole": whole,
            "renderers": [
                {
                    "name": drawn.name,
                    "encoding": drawn.encoding
                    and {
                        "quantisation": drawn.encoding.quantisation,
                        "steps": drawn.encoding.steps,
                        "says": drawn.encoding.says,
                    },
                    "passes": {
                        name: {
                            "channels": stored.channels,
                            "prediction": stored.prediction,
                            "parts": list(stored.parts),
                            "guides": list(stored.guides),
                            "wide": stored.wide,
                            "based": stored.based,
                            "rest": bool(stored.rest) and tiers > (1 if stored.based else 2),
                        }
                        for name, stored in drawn.stored.items()
                    }
                    if tiers
                    else {},
                    "exact": {} if whole else drawn.exact,
                }
                for drawn in scene.drawn
            ],
            "pairs": scene.pairs,
            "truths": scene.truths,
        }


#: What a comparison has that the viewer knows from elsewhere.
LEFT_OUT = ("scene", "size", "renderer", "reference", "pass")


def _verdict(row: Row, rendered: Rendered) -> Json:
    verdict = row.verdict
    tolerances = {
        comparison.pass_name: float(comparison.maps.tolerance[verdict.y, verdict.x])
        for comparison in rendered.comparisons
        if comparison.maps is not None and comparison.pass_name in verdict.passes
    }
    return {
        "x": verdict.x,
        "y": verdict.y,
        "edge": verdict.edge,
        "passes": list(verdict.passes),
        "tolerances": tolerances,
        "explained": verdict.explained,
        "findings": [
            {
                "renderer": finding.renderer,
                "right": finding.right,
                "cause": finding.cause,
                "explained": finding.explained,
                "says": finding.decision.says if finding.decision else "",
                "because": finding.because,
                "errors": dict(finding.errors),
            }
            for finding in verdict.findings
        ],
    }


def modules() -> str:
    """The import map of the viewer: every module as an address that holds it.

    Plain modules and an import map need no bundler, so that the package builds without Node; a page opened from a file
    may not import its neighbours, but may import addresses that hold their own text.
    """
    found = {
        f"viewer/{path.name}": "data:text/javascript;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
        for path in sorted(VIEWER.glob("*.js"))
    }
    return json.dumps({"imports": found})
