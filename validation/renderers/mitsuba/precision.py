"""What Mitsuba may be off by, in float32 and with `SLACK`, pixel by pixel; docs/tolerances.md derives it."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from tracer import reference
from validation.renderers import PerPixel, Settings, Uncertainty, floats

if TYPE_CHECKING:
    from tracer import Scene

UNIT_ROUNDOFF = floats.UNIT_ROUNDOFF["f32"]
#: Mitsuba's roots are off by up to this times the largest coordinate; docs/tolerances.md counts it.
SLACK = 16 * UNIT_ROUNDOFF
#: Magnitudes that float32 holds together with their squares.
RANGE = (1e-15, 1e15)
#: Roundings on the way to a decision or a value, each a relative change by at most the unit roundoff of the ray or of a
#: scene number, as margins count them; how much the sphere routine adds in an oblique instance, times h^2; and how the
#: discriminant of a chord moves with such a change. docs/tolerances.md lists them.
SPHERE_ROUNDINGS = 21
INSTANCE_ROUNDINGS = 8
GROWTH = 2
CHORD = 8


def uncertainty(scene: Scene, settings: Settings, *, float32_roots: bool) -> Uncertainty:
    """How far any picture of this scene may be off; `float32_roots`: whether the sphere routine works in float32."""
    roundings = SPHERE_ROUNDINGS
    ellipsoids = any(len({abs(value) for value in scene.spheres[i].scaling}) > 1 for i in scene.distinct)
    if ellipsoids:
        roundings += INSTANCE_ROUNDINGS
    relative: PerPixel = roundings * UNIT_ROUNDOFF
    terminator, unit = relative, relative
    oblique = ellipsoids and float32_roots
    if oblique or _window_inside(scene, settings):
        losses = _losses(scene, settings, roundings)
        if oblique:
            relative = (roundings + GROWTH * losses.oblique) * UNIT_ROUNDOFF
        # 1: above the margin of any terminator.
        terminator = np.where(losses.undecided, 1.0, relative)
        unit = relative * losses.slope
    return Uncertainty(
        silhouette=relative,
        range=relative + SLACK,
        order=relative,
        terminator=terminator,
        unit=unit,
        absolute=floats.uncertainty("f32", scene, settings).absolute,
    )


def _window_inside(scene: Scene, settings: Settings) -> bool:
    """Whether any primary ray starts inside a sphere: no others ever come to see an inside."""
    frame = converter.window(scene.view, settings.sample)
    for i in scene.distinct:
        (x, y, z), scaling = scene.spheres[i].position, scene.spheres[i].scaling
        nearest = (min(max(x, frame.left), frame.right), min(max(y, frame.bottom), frame.top), -scene.view.near)
        if sum(((a - b) / c) ** 2 for a, b, c in zip(nearest, (x, y, z), scaling, strict=True)) < 1:
            return True
    return False


@dataclasses.dataclass
class Losses:
    """Where Mitsuba's sphere routine loses digits, by pixel; the worst over the chain of rays of each."""

    oblique: NDArray[np.float64]  # h^2, see `_oblique`
    undecided: NDArray[np.bool_]  # a shadow ray inside a sphere whose other root float32 cannot tell
    slope: NDArray[np.float64]  # by how much the errors of roots grow where rays stay inside a sphere; inf: lost


def _losses(scene: Scene, settings: Settings, roundings: float) -> Losses:
    """Follow every ray of the picture, in NumPy, and look at how it meets what it may meet."""
    view, tables = scene.view, reference.Tables(scene, np.float64)
    eye = np.append(np.array([s.position for s in scene.spheres]).reshape(-1, 3).T, np.zeros((3, 1)), axis=1)
    lights = [np.array(light.position)[:, None] for light in scene.lights]
    parts = []
    for rows in reference.bands(view):
        count = len(rows) * view.columns
        part = Losses(np.zeros(count), np.zeros(count, dtype=bool), np.ones(count))
        with np.errstate(all="ignore"):
            primary = reference.eye_rays(tables, view, settings.sample, rows)
            for rays, _, at in reference.trace(tables, primary, settings.max_reflections):
                _oblique(scene, part, rays.pixel, eye[:, rays.start] + rays.offset, rays.direction)
                x = at.x
                position = eye[:, x.start] + x.offset
                facing = [np.flatnonzero((at.normal * (light - position)).sum(axis=0) > 0) for light in lights]
                for light, lit in zip(lights, facing, strict=True):
                    _oblique(scene, part, x.pixel[lit], position[:, lit], (light - position)[:, lit])
                # The discriminant of a chord is c^2; it moves by this times the size of what is between its ends.
                scaling = tables.scaling[:, x.start]
                error = CHORD * (roundings + GROWTH * part.oblique[x.pixel]) * UNIT_ROUNDOFF / scaling.min(axis=0)
                size = np.linalg.norm(position, axis=0)
                for light, lit in zip(lights, facing, strict=True):
                    c = _cosine(x.point, (light - position) / scaling)
                    lost = x.inside & (c**2 < error * (size + np.linalg.norm(light)))
                    part.undecided[x.pixel[lit]] |= lost[lit]
                c = _cosine(x.point, x.direction / scaling)
                steep = np.where(c**2 < error * size, np.inf, 1 / c)
                mirrors = np.flatnonzero(x.inside & (tables.kr[x.start] > 0))
                part.slope[x.pixel[mirrors]] = np.maximum(part.slope[x.pixel], steep)[mirrors]
        parts.append(part)
    shape = (view.rows, view.columns)
    return Losses(
        np.concatenate([part.oblique for part in parts]).reshape(shape),
        np.concatenate([part.undecided for part in parts]).reshape(shape),
        np.concatenate([part.slope for part in parts]).reshape(shape),
    )


def _oblique(scene: Scene, part: Losses, pixel: NDArray[np.intp], origin: Any, direction: Any) -> None:
    """How far a ray still is from the point closest to an ellipsoid's centre when Mitsuba sets up the quadratic.

    In the ellipsoid's space, its radius 1. The routine first walks along the ray to that point, to keep the digits of
    the discriminant, but divides by |d| where |d|^2 is due: in an instance, where |d| < 1, it stops h short of it.
    """
    direction = direction / np.linalg.norm(direction, axis=0)
    for i in scene.distinct:
        scaling = np.abs(np.array(scene.spheres[i].scaling))[:, None]
        to_center = (np.array(scene.spheres[i].position)[:, None] - origin) / scaling
        local = direction * (scaling.min() / scaling)
        speed = np.linalg.norm(local, axis=0)
        along = (to_center * local).sum(axis=0) / speed
        beside = (to_center**2).sum(axis=0) - along**2
        # Far from the outline no error of the discriminant decides anything.
        h = np.where(beside < 4, along * (1 - speed), 0)
        part.oblique[pixel] = np.maximum(part.oblique[pixel], h**2)


def _cosine(normal: Any, direction: Any) -> Any:
    """|n.d| / |d| for columns, |n| = 1."""
    return np.abs((normal * direction).sum(axis=0)) / np.linalg.norm(direction, axis=0)


def fits_float32(scene: Scene) -> bool:
    """Whether every number of the scene lies in RANGE, or is 0."""
    view = scene.view
    numbers = [view.near, view.left, view.right, view.bottom, view.top, *scene.background, *scene.ambient]
    for sphere in scene.spheres:
        numbers += [*sphere.position, *sphere.scaling]
    for light in scene.lights:
        numbers += [*light.position, *light.intensity]
    return all(number == 0 or RANGE[0] <= abs(number) <= RANGE[1] for number in numbers)
