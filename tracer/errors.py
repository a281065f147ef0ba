"""What is raised and warned about scenes; the parser in C++ fills it in."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ._native import SceneDiagnostic


class SceneError(ValueError):
    """A scene breaks the rules of the format. Its text lists everything that is wrong, with hints."""

    errors: tuple[SceneDiagnostic, ...]
    """What is wrong, in the order of the file; after a hundred the last one counts the rest."""

    def __init__(self, text: str, errors: tuple[SceneDiagnostic, ...] = ()) -> None:
        """`text` is the whole message."""
        super().__init__(text)
        self.errors = errors


class SceneWarning(UserWarning):
    """A scene says something that has no effect: a sphere that lies exactly on an earlier one."""
