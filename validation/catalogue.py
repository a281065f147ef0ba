"""The renderers there are: which can run here, and which pass each delivers, how and at which precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import tracer
from tracer.passes import lookup
from validation import renderers as registry
from validation.renderers import Settings

if TYPE_CHECKING:
    from tracer import Scene
    from validation.renderers import Renderer

#: As people write it.
PRECISIONS = {"f64": "float64", "f32": "float32"}


def examples() -> list[Scene]:
    """Scenes that ask for everything, and for less: what some renderers deliver depends on the scene."""
    terms = {"ka": 0.5, "kd": 0.5, "ks": 0.5, "kr": 0.5, "exponent": 1}

    def scene(right: float = 1, **changed: float) -> Scene:
        ball = tracer.Sphere(name="s", position=(0, 0, -5), scaling=(1, 1, 1), color=(1, 1, 1), **(terms | changed))
        light = tracer.Light(name="l", position=(5, 5, 0), intensity=(1, 1, 1))
        view = tracer.View(near=1, left=-1, right=right, bottom=-1, top=1, columns=2, rows=2)
        return tracer.Scene(view=view, spheres=(ball,), lights=(light,), ambient=(1, 1, 1))

    return [
        scene(),
        scene(right=2),
        scene(ks=0, kr=0),
        scene(ka=0, kd=0, ks=0, kr=1),
        scene(kd=0, ks=0, kr=0),
    ]


def renderers() -> tuple[list[dict[str, Any]], dict[str, str]]:
    """One entry a renderer, strictly valid JSON; and by entry point why its renderers could not be loaded."""
    scenes = examples()
    return [_entry(renderer, scenes) for renderer in registry.all()], dict(registry.registry().failures)


def _entry(renderer: Renderer, scenes: list[Scene]) -> dict[str, Any]:
    reason = renderer.unavailable()
    settings = Settings()
    delivers = [renderer.passes(scene, settings) if reason is None else () for scene in scenes]
    sources = getattr(renderer, "sources", None)
    how: dict[str, str] = {}
    for scene, names in zip(scenes, delivers, strict=True):
        told = sources(scene, settings) if sources and names else {}
        how |= {lookup(name).name: told.get(name, "stock") for name in names}
    always = [{lookup(name).name for name in names} for names in delivers]
    # In the order of the table of passes.
    families = sorted(how, key=lambda family: [row.name for row in tracer.passes.TABLE].index(family))
    precision = getattr(renderer, "precision", None)
    return {
        "name": renderer.name,
        "available": reason is None,
        "reason": reason,
        "version": renderer.version() if reason is None else None,
        "precision": PRECISIONS.get(precision or "", precision),
        "passes": families,
        "sources": {family: {"how": how[family], "always": all(family in of for of in always)} for family in families},
    }
