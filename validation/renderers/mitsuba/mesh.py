"""Ellipsoids as triangles, the usual way to bring them to a renderer: `mitsuba-mesh-N`, for `whitted speed`.

Every ellipsoid is the same icosahedron, its triangles split in four N times and its vertices put on the unit sphere,
then scaled and moved: 20 * 4^N triangles that lie inside the ellipsoid. Normals at the vertices are exact and linear in
between. All else is `mitsuba-spec`: the same rays, the same loop over lights and bounces, which counts hits as if the
surface were round. So what it is off by is what triangles cost, and no more than that.

It is no reference: it claims nothing about its errors, and takes part in no comparison.
"""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from converters import mitsuba as converter
from tracer.passes import Passes, names
from validation.renderers import Settings, Uncertainty
from validation.renderers.mitsuba import stock
from validation.renderers.mitsuba.driver import Driver
from validation.renderers.mitsuba.engines import Arrays, Engine, Loop
from validation.renderers.mitsuba.variants import Variant

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis

FAMILY = "mitsuba-mesh"
#: Those measured unless told, and the most: 5 million triangles a sphere.
SUBDIVISIONS, MOST_SUBDIVISIONS = (2, 4, 6), 9
#: In scalar mode a picture of one second: a ray there is a call of Python.
SCALAR_PIXELS = 32 * 32


@functools.lru_cache(maxsize=4)
def icosphere(subdivisions: int) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Vertices of length 1, and the triangles between them, counterclockwise from outside."""
    golden = (1 + math.sqrt(5)) / 2
    corners = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    vertices = np.array([corner[k:] + corner[:k] for k in (0, 2, 1) for corner in corners])
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    triangles = np.array(
        [
            *((0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11)),
            *((1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8)),
            *((3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9)),
            *((4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)),
        ]
    )
    for _ in range(subdivisions):
        sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        sides, place = np.unique(sides, axis=0, return_inverse=True)
        middle = vertices[sides].sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        ab, bc, ca = (len(vertices) + place.reshape(3, -1)).astype(np.intp)
        a, b, c = triangles.T
        vertices = np.concatenate([vertices, middle])
        split = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(three, axis=1) for three in split])
    return vertices, triangles


def write_ply(path: Path, subdivisions: int) -> None:
    """The sphere of radius 1 as a binary PLY file, with normals."""
    vertices, triangles = icosphere(subdivisions)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    head += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header", ""]
    faces = np.empty(len(triangles), np.dtype([("count", "u1"), ("index", "<i4", 3)]))
    faces["count"], faces["index"] = 3, triangles
    with path.open("wb") as file:
        file.write("\n".join(head).encode())
        file.write(np.hstack([vertices, vertices]).astype("<f4").tobytes())
        file.write(faces.tobytes())


class MitsubaMesh(Variant):
    """Triangles behind the face of a renderer, in one variant of Mitsuba."""

    def __init__(self, subdivisions: int, backend: str) -> None:
        """20 * 4^subdivisions triangles a sphere."""
        self.subdivisions = subdivisions
        self.family = f"{FAMILY}-{subdivisions}"
        super().__init__(backend)
        self._loaded: tuple[Scene, Engine] | None = None

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """Those of mitsuba-spec."""
        if stock.refusal(scene, self.backend):
            return ()
        return names(len(scene.lights), settings.max_reflections, margins=False)

    def refusal(self, scene: Scene) -> str:
        """Why it has no pass for a scene."""
        return stock.refusal(scene, self.backend) or "nothing"

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """It claims nothing."""
        del scene, settings, analysis
        return Uncertainty(math.inf, math.inf, math.inf, math.inf, math.inf)

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """Any size where rays are traced all at once."""
        del scene, passes
        return SCALAR_PIXELS if self.backend == "scalar" else None

    def versions(self) -> Mapping[str, str]:
        """Mitsuba's, and the number of triangles."""
        return {**super().versions(), "triangles a sphere": str(20 * 4**self.subdivisions)}

    def shapes(self, scene: Scene, ply: Path) -> dict[str, Any]:
        """What is loaded of the scene: one mesh a sphere, with the surface that the converter gives it."""
        found: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": True}
        described = converter.geometry(scene)
        for index in scene.distinct:
            sphere, name = scene.spheres[index], f"sphere_{index}"
            group = described.get(f"group_{index}")
            surface = group["surface"] if group else described[name]
            kept = {key: value for key, value in surface.items() if key in ("bsdf", "ambient")}
            place = converter.placed(sphere.position, [abs(value) for value in sphere.scaling])
            found[name] = {"type": "ply", "filename": str(ply), "to_world": place, **kept}
        return found

    def engine(self, scene: Scene) -> Engine:
        """The scene's meshes in this variant, which is set; kept, as who renders meshes builds them once."""
        if self._loaded is None or self._loaded[0] != scene:
            self._loaded = scene, self._load(scene)
        return self._loaded[1]

    def _load(self, scene: Scene) -> Engine:
        with tempfile.TemporaryDirectory() as folder:
            ply = Path(folder) / "sphere.ply"
            write_ply(ply, self.subdivisions)
            shapes = self.shapes(scene, ply)
            return Loop(shapes, smooth=True) if self.backend == "scalar" else Arrays(shapes, smooth=True)

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """Exactly the passes asked for."""
        with self.ready():
            images = Driver(scene, settings, self.engine(scene)).render(passes)
        size = (scene.view.rows, scene.view.columns)
        return Passes({name: image.reshape(*size, *image.shape[1:]) for name, image in images.items()}, self.versions())
