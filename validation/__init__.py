"""Renderers side by side: `validate`, `compare_passes` and what they return, loaded when first used."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from validation.compare import Comparison as Comparison
    from validation.compare import Judge as Judge
    from validation.compare import compare_passes as compare_passes
    from validation.compare import compare_plain as compare_plain
    from validation.renderers import Settings as Settings
    from validation.renderers import Uncertainty as Uncertainty
    from validation.run import Validation as Validation
    from validation.run import validate as validate

# NumPy and the renderers take longer to load than `whitted --help` may take.
_HOMES = {
    "Comparison": "compare",
    "Judge": "compare",
    "compare_passes": "compare",
    "compare_plain": "compare",
    "Settings": "renderers",
    "Uncertainty": "renderers",
    "Validation": "run",
    "validate": "run",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'validation' has no attribute '{name}'")
    return getattr(importlib.import_module(f"validation.{_HOMES[name]}"), name)
