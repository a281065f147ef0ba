"""POV-Ray 3.7 as a reference: `povray`, its own program with its stock features, a picture for each term.

What is POV-Ray's: everything that a pixel shows. It reads the scene as a text (converters/povray.py) and writes 16-bit
images. What is ours is what is said about them: `ambient`, `diffuse`, `specular`, `direct`, `beauty`, `shadow.L<i>` and
`id` are such images; the reflections are differences of images with one reflection more; a normal is the light of three
parallel lights less that of the opposite ones; a position is a pigment by coordinates, in two images for its digits.

docs/tolerances.md derives what follows from 16 bits and from POV-Ray's epsilons.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from converters import povray as converter
from tracer.passes import Passes, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.povray import precision, program
from validation.renderers.povray.pictures import Recipes

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.rules import Rule

#: More than this takes minutes: a scene is about fifteen pictures of some microseconds a pixel.
MOST_PIXELS = 1_000_000


class Povray:
    """POV-Ray behind the face of a renderer."""

    name = "povray"
    #: The output, which is what limits it: it computes in float64, and colors in float32.
    precision = "16-bit"

    def __init__(self, seconds: float = 600.0) -> None:
        """`seconds`: how long one picture may take."""
        self.seconds = seconds

    def version(self) -> str:
        """The program's own version."""
        return program.version() or "not installed"

    def versions(self) -> Mapping[str, str]:
        """The program."""
        return {"povray": self.version()}

    def unavailable(self) -> str | None:
        """It has to be installed, in a version whose epsilons are known."""
        found = program.version()
        if found is None:
            return "the program povray was not found: sudo apt-get install povray"
        if not found.startswith(program.KNOWN):
            where = shutil.which(program.PROGRAM)
            return f"{where} is version {found}, expected {program.KNOWN}x: sudo apt-get install povray"
        return None

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Every pass but the margins; none where POV-Ray cannot draw the scene.

        A light that it cannot tell from a surface leaves those without light, and the shadows of the others.
        """
        if converter.problems(scene, settings.max_reflections, settings.sample):
            return ()
        every = names(len(scene.lights), settings.max_reflections, margins=False)
        if not (untold := precision.untold(scene)):
            return every
        lit = {"beauty", "diffuse", "specular", "direct", "reflection", *(f"shadow.L{i}" for i in untold)}
        return tuple(name for name in every if name not in lit and not name.startswith("reflection."))

    def refusal(self, scene: Scene) -> str:
        """Why it has no pass for a scene."""
        return "; ".join(converter.problems(scene)) or "more reflections than POV-Ray follows"

    def sources(self, scene: Scene, settings: Settings) -> Mapping[str, str]:
        """By pass whether it is a picture as it is, or made of several."""
        lights = [scene.ambient, scene.background, *(light.intensity for light in scene.lights)]
        negative = min(map(min, lights)) < 0
        plain = "derived" if negative else "stock"
        made = {"ambient", "diffuse", "specular", "direct", "beauty"}
        return {
            name: plain if name in made else "stock" if name == "id" or name.startswith("shadow.") else "derived"
            for name in self.passes(scene, settings)
        }

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """What 16 bits, float32 colors and POV-Ray's epsilons allow."""
        return precision.uncertainty(scene, settings, analysis)

    def rules(self, scene: Scene, settings: Settings) -> Sequence[Rule]:
        """Its epsilons."""
        del settings
        return precision.rules(scene)

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for.

        Raises:
            ValueError: a pass that it does not have for this scene.
            RuntimeError: POV-Ray cannot run here, or failed.
        """
        if unknown := [name for name in passes if name not in self.passes(scene, settings)]:
            raise ValueError(f"{self.name} has no pass '{unknown[0]}' for this scene")
        if reason := self.unavailable():
            raise RuntimeError(f"{self.name} cannot run: {reason}")
        recipes, size = Recipes(scene, settings), (scene.view.columns, scene.view.rows)
        drawn = program.draw(recipes.texts(passes), size, threads=settings.threads, seconds=self.seconds)
        return Passes(recipes.images(passes, drawn), self.versions())

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """The same for every scene."""
        del scene, passes
        return MOST_PIXELS


def renderers() -> list[Povray]:
    """The entry point."""
    return [Povray()]
