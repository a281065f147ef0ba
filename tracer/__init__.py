"""The assignment's renderer: scenes in, images out, pass by pass."""

from ._native import (
    Light,
    Scene,
    SceneDiagnostic,
    Sphere,
    View,
    compiler,
    instruction_set,
    load,
    loads,
    version,
)
from ._render import render
from .errors import SceneError, SceneWarning
from .passes import Passes

__all__ = [
    "Light",
    "Passes",
    "Scene",
    "SceneDiagnostic",
    "SceneError",
    "SceneWarning",
    "Sphere",
    "View",
    "compiler",
    "instruction_set",
    "load",
    "loads",
    "render",
    "version",
]
