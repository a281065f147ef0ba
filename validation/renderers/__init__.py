"""The one face of every renderer, and the registry that finds them through entry points."""

from __future__ import annotations

import functools
import importlib.metadata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tracer.near import near

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from tracer.passes import Passes, Sample

ENTRY_POINTS = "whitted.renderers"

#: One number for the whole image, or one a pixel: an array of shape (rows, columns).
PerPixel: TypeAlias = float | NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """What is rendered beyond the scene itself; every renderer of one comparison gets the same.

    Raises:
        ValueError: no renderer can draw with that; the text says what is expected.
    """

    sample: Sample = "corner"
    shadow_epsilon: float = 1e-4
    max_reflections: int = 3
    threads: int = 0

    def __post_init__(self) -> None:
        """Refuse here what not every renderer would refuse."""
        from tracer.passes import SAMPLES

        if self.sample not in SAMPLES:
            raise ValueError(f"sample is {self.sample!r}, expected one of {', '.join(map(repr, SAMPLES))}")
        if not 0 <= self.shadow_epsilon < 1:
            raise ValueError(f"shadow_epsilon is {self.shadow_epsilon}, expected 0 <= shadow_epsilon < 1")
        for name in ("max_reflections", "threads"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected 0 or more")


@dataclass(frozen=True)
class Uncertainty:
    """How far a renderer may be off, derived from its precision and its documented epsilons.

    `silhouette`, `range`, `order`, `terminator`: a decision of that kind whose margin is below this number may go
    either way in this renderer (relative, as the margins are).
    `unit`: multiplies `Analysis.sensitivity`, so that `unit * sensitivity` bounds the error of a value of an interior
    pixel.
    `absolute`: further absolute error by quantity of the table of passes ("color", "length", "position", "normal"),
    each derived and documented in the renderer's module. A key that is a name of that table ("beauty", "reflection",
    "reflection.*") is for that pass or family alone, in place of its quantity's.
    """

    silhouette: PerPixel
    range: PerPixel
    order: PerPixel
    terminator: PerPixel
    unit: PerPixel
    absolute: Mapping[str, PerPixel] = field(default_factory=lambda: MappingProxyType({}))

    def absolute_of(self, name: str) -> PerPixel:
        """The absolute error of a pass."""
        from tracer.passes import lookup

        row = lookup(name)
        return self.absolute.get(row.name, self.absolute.get(row.quantity, 0.0))


@runtime_checkable
class Renderer(Protocol):
    """A program that turns a Scene into Passes; nothing outside its module knows how.

    What follows is optional. `refusal(scene)`: why it has no pass for a scene. `rules(scene, settings)`: where it
    decides by rules of its own, for the judge: see `validation.rules`. `precision`: "f64", "f32", "16-bit" or "8-bit".
    `sources(scene, settings)`: by pass how it is made, "stock" by the program itself, "plugin" by code of ours in it,
    or "derived" from what it draws. `encoding`: of one that draws levels, an image file's: how they stand for colours;
    its passes then hold levels over their number, which their metadata name as "levels".
    """

    @property
    def name(self) -> str:
        """For example `native-f64`; `mitsuba-spec@llvm` for one variant of several."""

    def version(self) -> str:
        """The program's own version, one line."""

    def versions(self) -> Mapping[str, str]:
        """Everything that decides about its results, by name: goes into every result file."""

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """The passes that it can deliver for this scene; empty if it cannot carry the scene."""

    def unavailable(self) -> str | None:
        """None, or one sentence that says why it cannot run here, with the command that mends it."""

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """What it may be off by on this scene. `analysis` is there for those whose error depends on the pixel."""

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for."""

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """None: any size. Else a scene of more pixels takes too long, and validation draws it smaller and says so."""


class RendererNameError(ValueError):
    """What cannot be the name of a renderer; `hint` says what to type instead."""

    hint = ""


class UnknownRendererError(RendererNameError):
    """A name that no renderer has."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        """Look for the nearest of the known names."""
        names = sorted({alias for entry in known for alias in (entry, entry.partition("@")[0])})
        meant = near(name, names)
        super().__init__(f"unknown renderer '{name}'")
        self.hint = f"did you mean '{meant}'?" if meant else f"known renderers: {', '.join(names)}"


@dataclass(frozen=True)
class Registry:
    """The renderers that were found, by name, and why the others could not be loaded."""

    renderers: Mapping[str, Renderer]
    failures: Mapping[str, str]


def _group() -> Sequence[importlib.metadata.EntryPoint]:
    found = importlib.metadata.entry_points(group=ENTRY_POINTS)
    # Our own come first, so that a third party cannot take one of their names.
    return sorted(found, key=lambda point: not point.value.startswith("validation.renderers."))


@functools.cache
def registry() -> Registry:
    """Load every entry point of the group once; one that fails is reported in `failures`, not raised."""
    renderers: dict[str, Renderer] = {}
    failures: dict[str, str] = {}
    for point in _group():
        try:
            made: Sequence[Any] = list(point.load()())
        except Exception as error:  # a third party's code: whatever it raises must not stop the others
            failures[point.name] = f"{point.value}: {type(error).__name__}: {error}"
            continue
        for renderer in made:
            if not isinstance(renderer, Renderer):
                failures[point.name] = f"{point.value}: {renderer!r} lacks what a renderer has"
            elif renderer.name in renderers:
                failures[point.name] = f"{point.value}: the name '{renderer.name}' is taken"
            else:
                renderers[renderer.name] = renderer
    return Registry(MappingProxyType(renderers), MappingProxyType(failures))


def all() -> tuple[Renderer, ...]:
    """Every renderer that could be loaded, whether it can run here or not."""
    return tuple(registry().renderers.values())


def available() -> tuple[Renderer, ...]:
    """The renderers that can run here."""
    return tuple(renderer for renderer in all() if renderer.unavailable() is None)


def best() -> tuple[Renderer, ...]:
    """Of every renderer that can run here its best variant."""
    names = dict.fromkeys(renderer.name.partition("@")[0] for renderer in available())
    return tuple(get(name) for name in names)


def get(name: str) -> Renderer:
    """The renderer of that name.

    A name without `@` that has variants (`mitsuba-spec`) means the first variant that can run here, in the order its
    entry point lists them: best first. When none can run, the first variant, whose `unavailable()` says why.
    `cmd:./mine {scene}` is any program: see `validation.renderers.command`.

    Raises:
        UnknownRendererError: there is none.
        command.TemplateError: what follows `cmd:` is no command.
    """
    if name.startswith("cmd:"):
        from validation.renderers.command import Command

        return Command(name)
    renderers = registry().renderers
    if name in renderers:
        return renderers[name]
    variants = [renderer for full, renderer in renderers.items() if full.partition("@")[0] == name]
    if not variants:
        raise UnknownRendererError(name, renderers)
    return next((renderer for renderer in variants if renderer.unavailable() is None), variants[0])
