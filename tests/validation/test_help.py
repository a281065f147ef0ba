"""What `--help` says: every example in it runs, every option has its default, every exit status is there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import click
import doubles
import pytest
from command_line import NATIVE, whitted
from doubles import Double, with_arrays

from validation import cli, options
from validation.commands import outputs
from validation.commands.help import ALWAYS, GROUPS, Command

SCENES = Path(__file__).resolve().parents[2] / "scenes"
COMMANDS = [command for group in cli.GROUPS.values() for command in group]


def help_of(command: click.Command) -> str:
    return command.get_help(click.Context(command, info_name=f"whitted {command.name}", help_option_names=["--help"]))


def bash(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    path = f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path}
    return subprocess.run(
        ["bash", "-c", line], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_every_command_is_in_a_group() -> None:
    assert sorted(cli.whitted.commands) == sorted(command.name or "" for command in COMMANDS)
    text = whitted("--help").stdout
    for title, commands in cli.GROUPS.items():
        section = re.search(rf"^{title}:\n((?:  .*\n)+)", text, re.MULTILINE)
        assert section
        for command in commands:
            assert re.search(rf"^  {command.name} +\S.*[.]$", section[1], re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_the_help_is_whole(command: click.Command) -> None:
    assert isinstance(command, Command)
    assert command.examples
    text = help_of(command)
    for example in command.examples:
        assert f"\n  $ {example}\n" in text
    assert any(
        example.startswith(f"whitted {command.name} ") or example == f"whitted {command.name}"
        for example in command.examples
    )
    assert {0, *ALWAYS} <= set(command.statuses)
    for status in command.statuses:
        assert re.search(rf"^  {status} +\S", text.partition("Exit status:")[2], re.MULTILINE)
    for title in GROUPS:
        assert f"\n{title}:\n" in text or not any(option.name in GROUPS[title] for option in command.params)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_every_option_says_what_it_does_and_its_default(command: click.Command) -> None:
    for option in command.params:
        if not isinstance(option, click.Option):
            continue
        assert option.help, option.opts
        assert option.help.endswith((".", "?", ".ppm")), option.opts
        told = option.show_default or "default" in option.help.lower() or option.is_flag or option.required
        where_to = option.name in GROUPS["Results"]  # nowhere, unless told
        optional = where_to or option.multiple or option.help.startswith(("With --", "Only ", "Draw N "))
        assert told or optional, option.opts


@pytest.mark.mitsuba
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_every_example_runs(command: Command, tmp_path: Path) -> None:
    shutil.copytree(SCENES, tmp_path / "scenes")
    for example in command.examples:
        done = bash(example, tmp_path)
        assert (done.returncode, done.stderr) == (0, ""), f"$ {example}\n{done.stdout}"


@pytest.mark.mitsuba
def test_the_examples_of_the_program_run(tmp_path: Path) -> None:
    shutil.copytree(SCENES, tmp_path / "scenes")
    for example in cli.EXAMPLES:
        done = bash(example, tmp_path)
        assert (done.returncode, done.stderr) == (0, ""), f"$ {example}\n{done.stdout}"


@pytest.mark.parametrize("command", ["", *cli.whitted.commands])
def test_help_is_quick(command: str) -> None:
    """It imports nothing that takes time; a clock would tell how busy the machine is."""
    code = (
        "import sys\nfrom validation.cli import main\n"
        f"try:\n    main({[command, '--help'] if command else ['--help']!r})\n"
        "finally:\n    print('LOADED', *sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    heavy = {"numpy", "rich", "tracer", "flint", "mitsuba", "matplotlib", "jinja2", "multiprocessing"}
    assert not heavy & set(done.stderr.partition("LOADED")[2].split())


def test_quiet_is_the_last_line_alone(run: Any, scene: Path, registered: Any) -> None:
    loud, quiet = run("validate", scene, *NATIVE), run("validate", scene, *NATIVE, "--quiet")
    assert (quiet.status, quiet.out, quiet.err) == (0, "15 of 15 comparisons agree\n", "")
    assert loud.out.endswith(quiet.out)
    assert loud.out.count("\n") > 15
    registered(Double(draw=with_arrays(lambda arrays: arrays["depth"].fill(1))))
    differs = run("validate", scene, "--renderer", "double", "--against", "native-f64", "-q", "--verdicts", 0)
    assert (differs.status, differs.out) == (1, "14 of 15 comparisons agree\n")


def test_quiet_says_what_fails(run: Any, scene: Path, registered: Any) -> None:
    registered(Double(name="odd", draw=lambda *_: None))
    result = run("validate", scene, "--renderer", "odd", "--against", "native-f64", "--quiet")
    assert (result.status, result.out) == (3, "nothing was compared, 1 failure\n")
    assert "odd: failed" in result.err


def test_verbose_says_what_is_done_anywhere(run: Any, scene: Path) -> None:
    result = run("validate", scene, *NATIVE, "--verbose")
    assert re.fullmatch(rf" +0\.\d s  {re.escape(str(scene))}: native-f64 against numpy-f64\n", result.err)
    assert run("validate", scene, *NATIVE).err == ""


def test_compare_may_be_quiet(run: Any, scene: Path, tmp_path: Path) -> None:
    for name, more in (("a", ()), ("b", ("--max-reflections", "0"))):
        assert run("render", scene, "-o", tmp_path / f"{name}.npz", *more).status == 0
    assert run("compare", tmp_path / "a.npz", tmp_path / "a.npz", "-q").out == ""
    result = run("compare", tmp_path / "a.npz", tmp_path / "b.npz", "--quiet")
    assert (result.status, result.out, result.err) == (1, "", "")


def test_progress_counts_scenes_and_says_how_long_the_rest_takes(run: Any, tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.txt").write_text(doubles.FULL)
    lines = run("validate", tmp_path, *NATIVE, "--size", "16x12", "-v").err.splitlines()
    assert len(lines) == 3
    assert f"  scene 1 of 3: {tmp_path / 'a.txt'}: native-f64 against numpy-f64" in lines[0]
    assert "left" not in lines[0]
    assert re.search(r"  scene 3 of 3, \d+ s left: .*: native-f64 against numpy-f64$", lines[2])


def test_progress_is_shown_on_a_terminal_unless_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []

    class Terminal:
        width = 30

        def status(self, text: str) -> Any:
            del text
            return self

        def __enter__(self) -> Any:
            return self

        def __exit__(self, *_: object) -> None:
            return None

        def update(self, text: str) -> None:
            told.append(text)

    monkeypatch.setattr(outputs, "console", lambda **_: Terminal())
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with outputs.progressing() as progress:
        progress("cmd:./mine [bold]")
        progress("scene 1 of 3, 40 s left: some/long/path.txt")
    assert told == ["cmd:./mine \\[bold]", "scene 1 of 3, 40 s left: s…"]
    monkeypatch.setattr(outputs, "quiet", lambda: True)
    with outputs.progressing() as progress:
        progress("more")
    assert len(told) == 2


def test_open_opens_the_report(run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: not opened.append(address))  # type: ignore[func-returns-value]
    monkeypatch.chdir(tmp_path)
    result = run("validate", scene, *NATIVE, "--report", "my report", "--open", "--size", "16x12")
    assert (result.status, result.err) == (0, "")
    assert opened == [f"{tmp_path.as_uri()}/my%20report/index.html"]
    monkeypatch.setattr("webbrowser.open", lambda _: False)
    result = run("validate", scene, *NATIVE, "--report", "my report", "--open", "--size", "16x12")
    assert (result.status, result.err) == (0, "note: no browser could be started for my report/index.html\n")


def test_no_color(monkeypatch: pytest.MonkeyPatch) -> None:
    from validation import terminal

    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    assert terminal.colorful()
    assert terminal.console().color_system
    monkeypatch.setenv("NO_COLOR", "1")
    assert not terminal.colorful()
    assert terminal.console().no_color


def test_outside_of_a_command_nobody_is_quiet() -> None:
    assert not options.quiet()
    assert not options.verbose()
