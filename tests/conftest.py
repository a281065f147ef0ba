"""What tests share: the folder of the keys, and one way to say what is missing."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parent.parent

# Machines that do several things at once are slow now and then, which says nothing about the code.
settings.register_profile("whitted", deadline=None, derandomize=True)
settings.load_profile("whitted")
# Other examples at every run, to look for new ones: pytest --hypothesis-profile=random
settings.register_profile("random", deadline=None)

# A shell that starts the tests in the background has them ignore Ctrl-C, and what they start would ignore it too.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

Need = Callable[[object, str], None]


def need(present: object, reason: str) -> None:
    """Skip a test on a developer's machine that lacks something optional; in CI everything has to be there."""
    if present:
        return
    if os.environ.get("CI", "").lower() in ("1", "true", "yes"):
        pytest.fail(f"required in CI: {reason}", pytrace=False)
    pytest.skip(reason)


@pytest.fixture(name="need", scope="session")
def need_fixture() -> Need:
    """`need(condition, reason)`: skip where the condition does not hold, fail there in CI."""
    return need


@pytest.fixture(scope="session")
def keys() -> Path:
    """The folder with the published images of the assignment and their scenes."""
    folder = Path(os.environ.get("WHITTED_KEYS", ROOT.parent / "shared" / "keys"))
    need(folder.is_dir(), f"the keys are not at {folder}: set WHITTED_KEYS to the folder that has them")
    return folder


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the repository."""
    return ROOT
