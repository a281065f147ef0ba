"""What is printed: tables that fit the terminal, paths, and colours."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from command_line import NATIVE, whitted
from rich.console import Console

from validation import terminal
from validation.compare import Comparison
from validation.renderers import Settings
from validation.run import Validation


def test_colours_are_for_terminals(scene: Path) -> None:
    done = whitted("validate", str(scene), *NATIVE, env={**os.environ, "TERM": "xterm-256color"})
    assert "\x1b" not in done.stdout + done.stderr


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_column_is_lost_however_narrow_the_terminal(
    width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [
        Comparison("scenes/spec/diffuse-only.txt", (64, 64), "a", "b", name, max=1e-15, ratio=0.01, interior=4096)
        for name in ("beauty", "reflection.1")
    ]
    monkeypatch.setattr(terminal, "console", lambda: Console(width=width))
    result = Validation(settings=Settings(), versions={}, comparisons=found)
    terminal.print_validation(result, verbose=True)
    out = capsys.readouterr().out
    table = out[: out.index("interior, edge: pixels")]
    assert max(map(len, table.splitlines())) <= width
    for word in ("result", "pass", "interior", "edge", "0/4096", "0/0", "reflection.1"):
        assert word in table
    assert ("/tolerance" in out) == (width > 60), "nor is it explained where it is not"


def test_on_a_narrow_terminal_passes_have_lines_of_their_own(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    passes = [f"reflection.{k}" for k in range(8)]
    entries = [
        {"name": "mine", "version": "1.2", "available": True, "passes": passes, "reason": None},
        {"name": "other", "version": None, "available": False, "passes": [], "reason": "it is not here"},
    ]
    for width in (60, 160):
        monkeypatch.setattr(terminal, "console", lambda width=width: Console(width=width))
        terminal.print_renderers(entries, {})
        lines = capsys.readouterr().out.splitlines()
        assert max(map(len, lines)) <= width
        assert all(name in "".join(lines) for name in passes), "none is cut"
        assert any("it is not here" in line for line in lines)


def test_a_narrow_terminal_shows_the_result(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    agreeing = [
        Comparison(f"scenes/gallery/{name}.txt", (400, 400), "a", "b", "reflection.1", max=1e-15, ratio=0.01)
        for name in ("mirrors", "a-longer-name-of-a-scene")
    ]
    monkeypatch.setattr(terminal, "console", lambda: Console(width=72))
    terminal.print_validation(Validation(settings=Settings(), comparisons=agreeing), verbose=True)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[:4])) <= 72
    assert lines[1].split() == ["scene", "result", "pass", "/tolerance", "interior", "edge"]
    assert "max error" not in "".join(lines), "the legend is of what is shown"
    assert any(line.startswith("mirrors.txt 400x400 ") and " agree " in line for line in lines)


def summary(
    *found: Comparison, width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    monkeypatch.setattr(terminal, "console", lambda: Console(width=width))
    terminal.print_validation(Validation(settings=Settings(), comparisons=list(found)), verbose=False)
    return capsys.readouterr().out.splitlines()


def test_a_scene_in_one_row_says_what_differs_at_edges(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    edges = Comparison("s.txt", (9, 9), "a", "b", "beauty", max=0.338, ratio=0.01, interior=70, edge=11, edge_over=3)
    worst = Comparison("s.txt", (9, 9), "a", "b", "direct", max=1.4e-6, ratio=0.5, interior=80, edge=1)
    lines = summary(worst, edges, width=120, capsys=capsys, monkeypatch=monkeypatch)
    assert lines[2].split("  ")[-1].strip() == "3/11"
    assert " ".join(lines[2].split()) == "s.txt 9x9 agree all 2, worst direct, edges differ 0.34 0.5 0/80 3/11"
    told = "all: /tolerance and interior of the worst pass; max error: of beauty; edge: of that with most over"
    assert told in lines
    narrow = summary(worst, edges, width=80, capsys=capsys, monkeypatch=monkeypatch)
    assert " ".join(narrow[2].split()).startswith("s.txt 9x9 agree all 2, worst direct")
    assert narrow[2].endswith("3/11")
    assert max(map(len, narrow)) <= 80
    assert told.replace(" max error: of beauty;", "") in narrow
    without = summary(worst, width=120, capsys=capsys, monkeypatch=monkeypatch)
    assert " ".join(without[2].split()) == "s.txt 9x9 agree all 1, worst direct 1.4e-06 0.5 0/80 0/1"
    assert any("max error: of beauty or else of that pass" in line for line in without)


def test_paths_break_at_slashes() -> None:
    long, other = "scenes/a-folder/touching-spheres.txt 400x400", "scenes/other/touching-spheres.txt 400x400"
    assert terminal.paths([long], 60) == {long: long}
    assert terminal.paths([long], 30) == {long: "touching-spheres.txt 400x400"}
    assert terminal.paths([long], 20) == {long: "touching-spheres.txt\n400x400"}
    both = terminal.paths([long, other], 24)
    assert both[long] == "scenes/a-folder/\ntouching-spheres.txt\n400x400", "they are not the same without folders"
    assert both[other] == "scenes/other/\ntouching-spheres.txt\n400x400"
