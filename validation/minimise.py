"""Makes a scene smaller while it goes on showing something: fewer pixels, spheres, lights, terms and digits."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import tracer
from tracer import Scene

Pixel: TypeAlias = tuple[int, int]
#: Where a scene shows what is looked for: a pixel, or None where it does not show it.
Shows: TypeAlias = Callable[[Scene], Pixel | None]
#: Scenes that may be taken in the place of one, the smallest first.
Edit: TypeAlias = Callable[[Scene], Iterable[Scene]]

#: Significant digits that numbers are tried with.
DIGITS = (1, 2, 3, 4, 6, 9)
#: Columns and rows around the pixel that are tried, the smallest first.
FRAMES = (1, 2, 3, 5, 9, 17)


@dataclass(frozen=True)
class Small:
    """The smallest scene that was found, where it shows what it does, and how many scenes were tried for it."""

    scene: Scene
    at: Pixel
    tried: int
    finished: bool  # no smaller one among all that are tried; else the time was over


def size(scene: Scene) -> tuple[int, int, int]:
    """What makes one scene smaller than another: fewer things, then fewer pixels, then a shorter text."""
    return len(scene.spheres) + len(scene.lights), scene.view.columns * scene.view.rows, len(scene.text())


def minimise(scene: Scene, at: Pixel, shows: Shows, seconds: float) -> Small:
    """The smallest scene that `shows` still finds a pixel in, as far as the time allows; `at`: that of `scene`."""
    end = time.monotonic() + seconds
    tried = 0
    seen = {scene.text()}

    def better(other: Scene) -> Pixel | None:
        nonlocal tried
        text = other.text()
        if text in seen or not size(other) < size(scene):
            return None
        seen.add(text)
        tried += 1
        return shows(other)

    changed = True
    while changed:
        changed = False
        # First what makes all the rest quicker. What an edit finds the next one starts from.
        for edits in (_cropped, _fewer, _plainer, _rounded, _shorter):
            for edit in edits(scene, at):
                for other in edit(scene):
                    if time.monotonic() > end:
                        return Small(scene, at, tried, finished=False)
                    place = better(other)
                    if place is not None:
                        scene, at, changed = other, place, True
                        break
    return Small(scene, at, tried, finished=True)


def _with(scene: Scene, **changes: Any) -> Iterator[Scene]:
    """The scene changed, where it is one."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tracer.SceneWarning)  # copies of spheres
            other = scene.replace(**changes)
    except tracer.SceneError:
        return
    yield other


def _cropped(scene: Scene, at: Pixel) -> Iterator[Edit]:
    """The window around the pixel: the same rays, but for rounding."""
    del scene

    def cropped(scene: Scene) -> Iterator[Scene]:
        view = scene.view
        for frame in FRAMES:
            columns, rows = min(frame, view.columns), min(frame, view.rows)
            if (columns, rows) == (view.columns, view.rows):
                return
            x, y = (
                max(0, min(at[0] - frame // 2, view.columns - frame)),
                max(0, min(at[1] - frame // 2, view.rows - frame)),
            )
            width, height = view.right - view.left, view.top - view.bottom
            left, right = (view.left + width * column / view.columns for column in (x, x + columns))
            top, bottom = (view.top - height * row / view.rows for row in (y, y + rows))
            try:
                window = view.replace(left=left, right=right, bottom=bottom, top=top, columns=columns, rows=rows)
            except tracer.SceneError:
                continue
            yield from _with(scene, view=window)

    yield cropped


def _fewer(scene: Scene, at: Pixel) -> Iterator[Edit]:
    """One sphere or light less."""
    del at
    for name in ("lights", "spheres"):
        for k in reversed(range(len(getattr(scene, name)))):
            yield partial(_without, name, k)


def _without(name: str, k: int, scene: Scene) -> Iterator[Scene]:
    entries = getattr(scene, name)
    yield from _with(scene, **{name: [*entries[:k], *entries[k + 1 :]]})


def _plainer(scene: Scene, at: Pixel) -> Iterator[Edit]:
    """Terms and numbers that may not matter as 0 or 1."""
    del at
    yield partial(_with, ambient=(0, 0, 0))
    yield partial(_with, background=(0, 0, 0))
    for k in range(len(scene.lights)):
        for light in ({"intensity": (1, 1, 1)}, {"intensity": (1, 0, 0)}):
            yield partial(_changed, "lights", k, light)
    for k, entry in enumerate(scene.spheres):
        x, y, z = (abs(value) for value in entry.scaling)
        for sphere in (
            {"ka": 0},
            {"kr": 0},
            {"ks": 0},
            {"kd": 0},
            {"kd": 1},
            {"ks": 1},
            {"kr": 1},
            {"ka": 1},
            {"exponent": 1},
            {"color": (1, 1, 1)},
            {"scaling": (x, y, z)},
            {"scaling": (1, 1, 1)},
            *({"scaling": (value, value, value)} for value in (x, y, z)),
        ):
            yield partial(_changed, "spheres", k, sphere)


def _changed(name: str, k: int, changes: Any, scene: Scene) -> Iterator[Scene]:
    entries = getattr(scene, name)
    yield from _with(scene, **{name: [*entries[:k], entries[k].replace(**changes), *entries[k + 1 :]]})


def _rounded(scene: Scene, at: Pixel) -> Iterator[Edit]:
    """All numbers with fewer digits."""
    del at
    places = range(len(list(_numbers(scene))))
    yield partial(_to_digits, places, DIGITS)


def _shorter(scene: Scene, at: Pixel) -> Iterator[Edit]:
    """One number as 0 or with fewer digits."""
    del at
    for place, value in enumerate(_numbers(scene)):
        if value not in (0, 1):
            yield partial(_to_digits, (place,), (0, *DIGITS))


def _to_digits(places: Iterable[int], tried: Iterable[int], scene: Scene) -> Iterator[Scene]:
    for digits in tried:
        yield from _at(scene, dict.fromkeys(places, digits))


def _numbers(scene: Scene) -> Iterator[float]:
    """Every number that may have fewer digits, in an order of its own."""
    view = scene.view
    yield from (view.near, view.left, view.right, view.bottom, view.top)
    yield from (*scene.background, *scene.ambient)
    for sphere in scene.spheres:
        yield from (*sphere.position, *sphere.scaling, *sphere.color)
        yield from (sphere.ka, sphere.kd, sphere.ks, sphere.kr, sphere.exponent)
    for light in scene.lights:
        yield from (*light.position, *light.intensity)


def _at(scene: Scene, digits: dict[int, int]) -> Iterator[Scene]:
    """The numbers of those places with that many digits; 0: as 0."""
    numbers = iter(
        [
            value if place not in digits else float(f"{value:.{digits[place]}g}") if digits[place] else 0.0
            for place, value in enumerate(_numbers(scene))
        ]
    )

    def take(count: int) -> tuple[float, ...]:
        return tuple(next(numbers) for _ in range(count))

    try:
        near, left, right, bottom, top = take(5)
        view = scene.view.replace(near=near, left=left, right=right, bottom=bottom, top=top)
        changes: dict[str, Any] = {"view": view, "background": take(3), "ambient": take(3)}
        spheres, lights = [], []
        for sphere in scene.spheres:
            place, sizes, color, (ka, kd, ks, kr, n) = take(3), take(3), take(3), take(5)
            spheres.append(
                sphere.replace(position=place, scaling=sizes, color=color, ka=ka, kd=kd, ks=ks, kr=kr, exponent=n)
            )
        for light in scene.lights:
            place, intensity = take(3), take(3)
            lights.append(light.replace(position=place, intensity=intensity))
    except tracer.SceneError:  # no sphere has the size 0
        return
    yield from _with(scene, spheres=spheres, lights=lights, **changes)
