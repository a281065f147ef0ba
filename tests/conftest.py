"""What tests share: running `whitted`, the folder of the keys, and one way to say what is missing."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
def browser() -> Iterator[Any]:
    """Chromium, from WHITTED_CHROMIUM or where distributions put it."""
    found = os.environ.get("WHITTED_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    need(found and Path(found).exists(), "no Chromium: apt-get install chromium, or set WHITTED_CHROMIUM")
    need(importlib.util.find_spec("playwright"), "no Playwright: pip install playwright")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the repository."""
    return ROOT


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene file that has something of everything."""
    from doubles import FULL  # beside the tests of validation

    path = tmp_path / "full.txt"
    path.write_text(FULL)
    return path


@dataclass(frozen=True)
class Result:
    """What a command left."""

    status: int
    out: str
    err: str


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Run `whitted` in this process."""
    from validation import cli

    def runs(*arguments: object) -> Result:
        words = [str(argument) for argument in arguments]
        monkeypatch.setattr(sys, "argv", ["whitted", *words])
        capfd.readouterr()
        with pytest.raises(SystemExit) as exit_info:
            cli.main(words)
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        assert isinstance(exit_info.value.code, int)
        return Result(exit_info.value.code, out, err)

    return runs


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Add renderers to those that there are; `alone`: to none."""
    from validation import renderers

    def register(*extra: Any, failures: dict[str, str] | None = None, alone: bool = False) -> None:
        found = {} if alone else renderers.registry().renderers
        names = {**found, **{entry.name: entry for entry in extra}}
        monkeypatch.setattr(renderers, "registry", lambda: renderers.Registry(names, failures or {}))

    return register


def strict(text: str) -> Any:
    """JSON without the tokens that JSON does not have."""

    def refuse(token: str) -> None:
        raise AssertionError(f"{token} is not JSON")

    return json.loads(text, parse_constant=refuse)
