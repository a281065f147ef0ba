"""Every example of the documents runs and prints what it shows; every link in them leads somewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from validation import renderers
from validation.rules import ACNE, MISTAKES

llvm = renderers.get("mitsuba-spec@llvm")

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("scenes/*.md")])

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = BLOCK.findall(README)
DIFFERENCES = (ROOT / "docs" / "known-differences.md").read_text(encoding="utf-8")


def blocks(language: str, document: str = README) -> list[str]:
    return [text for name, text in BLOCK.findall(document) if name == language]


def examples(document: str = README) -> list[tuple[str, str]]:
    """Every command of the console blocks but make, in order, with the output shown below it."""
    found: list[tuple[str, str]] = []
    for text in blocks("console", document):
        for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
            command, _, output = part.partition("\n")
            if not command.startswith("make "):
                found.append((command, output))
    return found


def matches(shown: str, printed: str) -> bool:
    """Whether the output is as shown, `...` standing for anything."""
    pattern = ".*".join(re.escape(part) for part in shown.split("..."))
    return re.fullmatch(pattern, printed, re.DOTALL) is not None


@pytest.fixture
def workplace(tmp_path: Path) -> Path:
    """A folder with the scenes in it."""
    shutil.copytree(ROOT / "scenes", tmp_path / "scenes")
    return tmp_path


def environment() -> dict[str, str]:
    """That of the reader, who has the programs on the PATH, a wide terminal and no colors."""
    ours = {"PATH": f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "160"}
    return os.environ | ours | {"NO_COLOR": "1"}


def test_every_block_is_one_that_the_tests_know() -> None:
    assert {name for name, _ in BLOCKS} == {"console", "python"}


def test_the_pair_of_commands_exists() -> None:
    commands = [line.split()[:2] for line in re.findall(r"^\$ (make .*)$", README, re.MULTILINE)]
    assert commands == [["make", "demo"], ["make", "test"]]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for _, target in commands:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)


def test_the_system_packages_are_those_that_make_asks_for() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = re.search(r"^PACKAGES := (.*)$", makefile, re.MULTILINE)
    assert found
    assert f"sudo apt-get install {found[1]}`" in README


@pytest.mark.mitsuba
def test_every_command_prints_what_is_shown(workplace: Path) -> None:
    # One shell for all, so that `echo $?` speaks about the command before it.
    status = 0
    assert len(examples()) > 10
    for command, shown in examples():
        done = subprocess.run(
            ["bash", "-c", f"(exit {status}); {command}"],
            cwd=workplace,
            env=environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        # Only the examples of mistakes fail, and that of a scene file shows its errors on stderr. Elsewhere Mitsuba may
        # say there that it misses LLVM.
        status = done.returncode
        expected = 2 if "SPHRE" in command else 1 if "not right" in shown else 0
        assert status == expected, f"$ {command}\n{done.stderr}"
        printed = done.stdout + (done.stderr if status else "")
        assert matches(shown, printed), f"$ {command}\n{printed}"
    made = {"mirrors.ppm", "sunset.ppm", "results.json", "lantern.exr", "other.npz", "diffuse-only.xml"}
    assert made <= {path.name for path in workplace.iterdir()}
    assert (workplace / "report" / "index.html").stat().st_size > 0


@pytest.mark.mitsuba
@pytest.mark.parametrize(("command", "shown"), examples(DIFFERENCES), ids=lambda text: " ".join(text.split()[2:5]))
def test_every_known_difference_is_as_shown(command: str, shown: str, workplace: Path, need) -> None:
    need(llvm.unavailable() is None, str(llvm.unavailable()))
    done = subprocess.run(
        ["bash", "-c", command], cwd=workplace, env=environment() | {"COLUMNS": "100"}, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert matches(shown, done.stdout), done.stdout


def test_every_known_mistake_is_told() -> None:
    for mistake in (*MISTAKES, ACNE):
        assert f"| {mistake.says} |" in DIFFERENCES


def test_every_python_block_prints_what_is_shown(workplace: Path) -> None:
    (text,) = blocks("python")
    shown = [line.partition("  # ")[2] for line in text.splitlines() if line.lstrip().startswith("print(")]
    assert all(shown)
    done = subprocess.run(
        [sys.executable, "-c", text], cwd=workplace, env=environment(), capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == shown
    assert {"passes.exr", "mirrors.png"} <= {path.name for path in workplace.iterdir()}


def test_the_renderer_in_the_example_takes_part(workplace: Path) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (code,), (project,) = blocks("python", text), blocks("toml", text)
    (module, *_), points = re.findall(r'"(\w+):', project), project.replace("project.entry-points.", "")
    (workplace / f"{module}.py").write_text(code)
    installed = workplace / f"{module}-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text(points.replace('"', ""))
    (example,) = (command for command, _ in examples(text) if module in command)
    done = subprocess.run(
        ["bash", "-c", example],
        cwd=workplace,
        env=environment() | {"PYTHONPATH": str(workplace)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    assert done.stdout.endswith("\n2 of 2 comparisons agree\n")


def test_the_scene_in_the_specification_is_one(workplace: Path) -> None:
    text = (ROOT / "docs" / "specification.md").read_text(encoding="utf-8")
    (scene,) = (block for name, block in BLOCK.findall(text) if name == "text")
    done = subprocess.run(
        ["raytrace", "-", "-o", "-"],
        input=scene.encode(),
        cwd=workplace,
        env=environment(),
        capture_output=True,
        check=True,
    )
    assert done.stdout.startswith(b"P6\n400 400\n255\n")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not target.startswith("https://"):
            assert (document.parent / target.partition("#")[0]).exists(), target
