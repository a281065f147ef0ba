"""What a name was meant to be that is none."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def near(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The nearest of the known names, whatever its capitals; "" if none is near."""
    lower: dict[str, str] = {}
    for entry in known:
        lower.setdefault(entry.lower(), entry)
    found = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=cutoff)
    return lower[found[0]] if found else ""
