"""Scenes, and renderers made of the real ones for tests: faithful, or with one planted defect."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from unittest import mock

import numpy as np

import tracer
import tracer.reference
from tracer.margins import Analysis
from tracer.passes import Passes, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.native import Native
from validation.renderers.numpy import Reference

Arrays = dict[str, Any]

#: What every record of a comparison has, in any result file.
KEYS = {"scene", "size", "renderer", "reference", "pass", "max", "rmse", "p999", "interior", "interior_over"}
KEYS |= {"edge", "edge_over", "edge_cap", "tolerance", "ratio", "worst", "ok"}

#: Every pass has something to show: three mirrors, one of them an ellipsoid and one a floor, two coloured lights,
#: a highlight, a shadow, and light brighter than 1.
FULL = """NEAR 1
LEFT -1
RIGHT 1
BOTTOM -0.75
TOP 0.75
RES 64 48
SPHERE ball 0 0 -10 2.1 2.1 2.1 0.5 0.2 0.9 0.2 0.6 0.5 0.4 30
SPHERE egg 3 1 -8 0.9 2 1.1 0.1 0.5 0.7 0.2 0.6 0.4 0.9 7
SPHERE floor 0 -42 -12 40 39 41 0.6 0.6 0.5 0.2 0.7 0.1 0.9 12
LIGHT left -6 8 -2 2.6 1.2 0.9
LIGHT right 6 4 -4 0.3 0.4 0.9
BACK 0.3 0.5 0.8
AMBIENT 0.6 0.5 0.4
OUTPUT full.ppm
"""

#: A sphere cut by the near plane, with a light that shines through the opening.
CUT = """NEAR 2
LEFT -1
RIGHT 1
BOTTOM -1
TOP 1
RES 48 48
SPHERE shell 0.1 0.2 -3 1.5 1.5 1.5 0.9 0.7 0.2 0.3 0.7 0.2 0 5
LIGHT lamp 0.1 0.3 -2.6 0.9 0.9 0.9
BACK 0 0 0.2
AMBIENT 0.3 0.3 0.3
OUTPUT cut.ppm
"""

#: A blocker that touches the floor: some shadows begin within a hundredth of the way to the light.
CONTACT = """NEAR 1
LEFT -0.12
RIGHT 0.12
BOTTOM -0.27
TOP -0.03
RES 64 64
SPHERE floor 0 -51 -8 50 50 50 0.8 0.8 0.8 0.1 0.8 0.2 0 1
SPHERE drop 0 -0.93 -6 0.3 0.07 0.3 0.9 0.1 0.1 0.1 0.8 0 0 1
LIGHT sun 60 80 10 1 1 1
BACK 0 0 0
AMBIENT 1 1 1
OUTPUT contact.ppm
"""


#: A sphere around the eye, cut by nothing, and the light outside it: all inside is dark.
CAVE = """NEAR 1
LEFT -1
RIGHT 1
BOTTOM -1
TOP 1
RES 32 32
SPHERE cave 0 0 -2 5 5 6 0.7 0.8 0.9 0.2 0.6 0.4 0 3
SPHERE pearl 0 0 -5 1 1 1 0.9 0.9 0.9 0.2 0.6 0.4 0 9
LIGHT moon 0 30 -5 1 1 1
LIGHT candle 1 2 -2 0.5 0.4 0.3
BACK 0 0 0
AMBIENT 0.5 0.5 0.5
OUTPUT cave.ppm
"""


def cave() -> tracer.Scene:
    """The scene inside a sphere."""
    return tracer.loads(CAVE)


def full() -> tracer.Scene:
    """The scene with every pass."""
    return tracer.loads(FULL)


def cut() -> tracer.Scene:
    """The scene with the near plane."""
    return tracer.loads(CUT)


def contact() -> tracer.Scene:
    """The scene with the shadow that begins at its blocker."""
    return tracer.loads(CONTACT)


def faithful(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """The native renderer."""
    return Native("f64").render(scene, passes, settings)


@dataclass(eq=False)
class Double:
    """A renderer with the native one's uncertainty; `draw` is what it draws."""

    name: str = "double"
    draw: Callable[[tracer.Scene, Sequence[str], Settings], Passes] = faithful
    claim: Uncertainty | None = None
    missing: Sequence[str] = ()
    refuses: bool = False
    absent: str | None = None
    limit: int | None = None
    quick: Sequence[str] = ()
    rendered: list[tuple[int, int]] = field(default_factory=list)

    def version(self) -> str:
        """Any."""
        return "1"

    def versions(self) -> Mapping[str, str]:
        """One entry."""
        return {"double": "1"}

    def passes(self, scene: tracer.Scene, settings: Settings) -> tuple[str, ...]:
        """The native renderer's, less `missing`."""
        if self.refuses:
            return ()
        every = Native("f64").passes(scene, settings)
        return tuple(name for name in every if name not in self.missing)

    def unavailable(self) -> str | None:
        """As told."""
        return self.absent

    def uncertainty(self, scene: tracer.Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """The native renderer's, or as told."""
        return self.claim or Native("f64").uncertainty(scene, settings, analysis)

    def render(self, scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """What `draw` draws."""
        self.rendered.append((scene.view.columns, scene.view.rows))
        return self.draw(scene, passes, settings)

    def max_pixels(self, scene: tracer.Scene, passes: Sequence[str]) -> int | None:
        """As told; any size where all that is wanted is quick."""
        del scene
        return None if set(passes) <= set(self.quick) else self.limit


def reference(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
    """The NumPy reference."""
    return Reference("f64").render(scene, passes, settings)


def with_patch(**changed: Callable[..., Any]) -> Callable[..., Passes]:
    """Draw with the NumPy reference in which functions are replaced; each gets the original as its first argument."""

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        originals = {name: getattr(tracer.reference, name) for name in changed}
        replacements = {name: functools.partial(function, originals[name]) for name, function in changed.items()}
        with mock.patch.multiple(tracer.reference, **replacements):
            return reference(scene, passes, settings)

    return draw


def with_settings(**changes: Any) -> Callable[..., Passes]:
    """Draw with other settings than asked for."""

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        return faithful(scene, passes, replace(settings, **changes))

    return draw


def with_scene(change: Callable[[tracer.Scene], tracer.Scene]) -> Callable[..., Passes]:
    """Draw another scene than asked for."""

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        return faithful(change(scene), passes, settings)

    return draw


def with_arrays(change: Callable[[Arrays], None], *, recompose: bool = False) -> Callable[..., Passes]:
    """Draw every pass, then change some; `recompose`: sums follow from their parts, as in a renderer."""

    def draw(scene: tracer.Scene, passes: Sequence[str], settings: Settings) -> Passes:
        every = names(len(scene.lights), settings.max_reflections, margins=False)
        arrays: Arrays = {name: array.copy() for name, array in faithful(scene, every, settings).items()}
        change(arrays)
        if recompose:
            arrays["direct"] = arrays["diffuse"] + arrays["specular"]
            bounces = [array for name, array in arrays.items() if name.startswith("reflection.")]
            arrays["reflection"] = sum(bounces, np.zeros_like(arrays["direct"]))
            hit = (arrays["id"] >= 0)[..., None]
            seen = arrays["ambient"] + arrays["direct"] + arrays["reflection"]
            arrays["beauty"] = np.where(hit, seen, arrays["beauty"])
        return Passes({name: arrays[name] for name in passes})

    return draw


#: Elements below SELECTOR whose text has less contrast to its ground than WCAG asks for, 4.5 to 1.
POOR = """selector => {
    const parse = text => text.match(/[\\d.]+/g).map(Number);
    const light = ([r, g, b]) => {
        const linear = v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
        const [x, y, z] = [r, g, b].map(v => linear(v / 255));
        return 0.2126 * x + 0.7152 * y + 0.0722 * z;
    };
    const ground = element => {
        for (let at = element; at; at = at.parentElement) {
            const color = parse(getComputedStyle(at).backgroundColor);
            if (color.length === 3 || color[3] > 0) return color;
        }
        return [255, 255, 255];
    };
    const poor = [];
    let seen = 0;
    for (const element of document.querySelectorAll(selector)) {
        const drawn = element instanceof SVGTextElement;
        const text = drawn ? element.textContent : element.innerText;
        if (!text?.trim() || !element.checkVisibility() || element.disabled) continue;
        if (element instanceof SVGElement && !drawn) continue;
        const both = [parse(getComputedStyle(element)[drawn ? "fill" : "color"]), ground(element)];
        const [a, b] = both.map(light).sort((x, y) => y - x);
        seen += 1;
        if ((a + 0.05) / (b + 0.05) < 4.5) poor.push(`${element.tagName}.${element.className} ${text.slice(0, 20)}`);
    }
    return [seen, [...new Set(poor)]];
}"""
