"""What is missing is skipped on a developer's machine and fails in CI."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import need


def test_what_is_there_is_no_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "true")
    need(Path(), "a folder")
    need(True, "anything")


@pytest.mark.parametrize("value", ["true", "1", "TRUE"])
def test_in_ci_everything_is_required(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", value)
    with pytest.raises(pytest.fail.Exception, match="required in CI: no browser"):
        need(None, "no browser")


@pytest.mark.parametrize("value", ["", "false"])
def test_elsewhere_the_reason_is_given(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", value)
    with pytest.raises(pytest.skip.Exception, match="no browser"):
        need(None, "no browser")
