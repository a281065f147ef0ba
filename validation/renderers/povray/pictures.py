"""Which pictures of POV-Ray make a pass, and how: as they are, or by differences."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import povray as converter
from converters.povray import DIGITS, STEPS, TERMS, Show, Term

if TYPE_CHECKING:
    from tracer import Scene
    from validation.renderers import Settings
    from validation.renderers.povray.program import Image

#: The terms of each pass that one picture shows, without mirrors.
PLAIN: Mapping[str, tuple[Term, ...]] = {
    "ambient": ("ambient",),
    "diffuse": ("diffuse",),
    "specular": ("specular",),
    "direct": ("diffuse", "specular"),
}


@dataclass(frozen=True)
class Model:
    """A picture of the model: some terms, with reflections up to a number."""

    terms: tuple[Term, ...]
    bounces: int

    def gain(self, scene: Scene, settings: Settings, sign: int) -> float:
        """What its colors are multiplied by: of all depths of reflection the same, so that what is equal cancels."""
        bounces = settings.max_reflections if "background" in self.terms else self.bounces
        return converter.gain(scene, self.terms, bounces, sign)

    def text(self, scene: Scene, settings: Settings, sign: int) -> str | None:
        """The text of one sign; None: all of it is black."""
        if converter.brightest(scene, self.terms, self.bounces, sign) == 0:
            return None
        return converter.to_pov(
            scene,
            sample=settings.sample,
            max_reflections=self.bounces,
            terms=self.terms,
            sign=sign,
            gain_of=self.gain(scene, settings, sign),
        )


class Recipes:
    """How the passes of one scene are made, and of which texts."""

    def __init__(self, scene: Scene, settings: Settings) -> None:
        """With the settings that all of them share."""
        self.scene, self.settings = scene, settings

    def texts(self, passes: Collection[str]) -> list[str]:
        """What has to be drawn."""
        found: dict[str, None] = {}

        def ask(text: str) -> Image:
            found[text] = None
            return np.zeros((1, 1, 3), np.uint16)

        for name in passes:
            self.make(name, ask)
        return list(found)

    def images(self, passes: Collection[str], drawn: Mapping[str, Image]) -> dict[str, NDArray[Any]]:
        """The passes of what was drawn."""
        return {name: self.make(name, drawn.__getitem__) for name in passes}

    def make(self, name: str, drawn: Callable[[str], Image]) -> NDArray[Any]:
        """One pass; `drawn`: the picture of a text."""
        depth = self.settings.max_reflections
        if name in PLAIN:
            return self.model(Model(PLAIN[name], 0), drawn)
        if name == "beauty":
            return self.model(Model(TERMS, depth), drawn)
        if name == "reflection":
            return self.model(Model(TERMS, depth), drawn) - self.model(Model(TERMS, 0), drawn)
        if name.startswith("reflection."):
            bounce = int(name.removeprefix("reflection."))
            return self.model(Model(TERMS, bounce), drawn) - self.model(Model(TERMS, bounce - 1), drawn)
        if name.startswith("shadow.L"):
            light = int(name.removeprefix("shadow.L"))
            first = light - light % 3
            # All or nothing, so any threshold will do.
            visible: NDArray[Any] = (drawn(self.show("lights", first))[..., light - first] > STEPS // 2).astype(float)
            return visible
        if name == "id":
            return self.ids(drawn)
        if name == "normal":
            return self.share(drawn(self.show("normal"))) - self.share(drawn(self.show("opposite")))
        hit = self.ids(drawn) >= 0
        position = self.position(drawn)
        if name == "depth":
            return np.where(hit, np.sqrt((position**2).sum(axis=-1)), np.inf)
        assert name == "position"
        return np.where(hit[..., None], position, 0.0)

    def model(self, picture: Model, drawn: Callable[[str], Image]) -> NDArray[np.float64]:
        """The colors of a picture: what is positive less what is negative."""
        view = self.scene.view
        colors = np.zeros((view.rows, view.columns, 3))
        for sign in (1, -1):
            text = picture.text(self.scene, self.settings, sign)
            if text is not None:
                gain = picture.gain(self.scene, self.settings, sign)
                colors = colors + sign * self.share(drawn(text)) / gain
        return colors

    def ids(self, drawn: Callable[[str], Image]) -> NDArray[np.int32]:
        """The index of the sphere, -1 where there is none."""
        return drawn(self.show("id"))[..., 0].astype(np.int32) - np.int32(1)

    def position(self, drawn: Callable[[str], Image]) -> NDArray[np.float64]:
        """The hit point, from its coarse and its fine picture."""
        corner, edge = converter.box(self.scene)
        coarse, fine = self.share(drawn(self.show("position"))), self.share(drawn(self.show("digits")))
        # The coarse one only has to tell which whole number the fine one belongs to.
        share = (np.round(coarse * DIGITS - fine) + fine) / DIGITS
        return corner + edge * share

    def show(self, what: Show, first: int = 0) -> str:
        """The text of another picture than the model."""
        return converter.to_pov(self.scene, sample=self.settings.sample, show=what, first=first)

    @staticmethod
    def share(image: Image) -> NDArray[np.float64]:
        """0 to 1."""
        return image.astype(np.float64) / STEPS
