"""Every block of every document does what it shows, in order; links, options and files that documents name exist.

In a document, in the order of its blocks:

- `console`: each `$ command` is run, and prints what is shown; `...` stands for anything. A command that fails is
  followed by `$ echo $?` and its status; what it says on stderr may then be part of what is shown.
- `python`: is run, and every `print(...)  # this` prints this.
- A block below `<!-- file: NAME -->` is written to that file; a `diff` block below it is applied to that file.
- `toml`, `xml`: can be parsed. `text`, `yaml`: are only shown, or written to a file.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import click
import pytest

from validation import renderers
from validation.cli import whitted
from validation.rules import ACNE, MISTAKES

ROOT = Path(__file__).resolve().parent.parent
#: Not what a reader has made beside them.
OURS = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
DOCUMENTS = [
    str(path.relative_to(ROOT)) for path in (*OURS, *sorted(ROOT.glob("docs/**/*.md")), *ROOT.glob("scenes/*.md"))
]
TEXTS = {name: (ROOT / name).read_text(encoding="utf-8") for name in DOCUMENTS}

LANGUAGES = {"console", "python", "diff", "text", "toml", "yaml", "xml"}

#: Commands that are not run here, and why; by document and the beginning of the command.
NOT_RUN = {
    ("README.md", "make demo"): "builds everything and draws all scenes: .ci/run and the tests of its parts do that",
    ("README.md", "make test"): "is this",
    ("docs/tutorial.md", "sudo apt-get"): "installs system packages",
    ("docs/tutorial.md", "make install"): "was done before any test",
    ("docs/tutorial.md", ". .venv/bin/activate"): "was done before any test",
    ("CONTRIBUTING.md", "cmake"): "needs a compiler and an emulator for another processor",
    ("CONTRIBUTING.md", "qemu-aarch64"): "needs a compiler and an emulator for another processor",
    ("docs/stability.md", "whitted stability   "): "all ladders and renderers: some minutes",
    ("docs/stability.md", "whitted stability --json"): "all ladders and renderers: some minutes",
    ("docs/speed.md", "whitted speed -o"): "all renderers at full size: some minutes",
    ("docs/speed.md", "whitted speed --kernels"): "the kernels at all sizes: some minutes",
}

#: Columns of the terminal, where they are not 160.
WIDTHS = {"docs/known-differences.md": 100, "docs/tutorial.md": 100}

#: Documents whose blocks have nothing to do with each other: each is a test of its own, as they take long together.
APART = {"docs/known-differences.md"}

FENCE = re.compile(
    r"^(?:<!-- file: (?P<file>\S+) -->\n+)?^```(?P<language>[^\n]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True)
class Block:
    """A fenced block; `file`: what it is written to, if anything."""

    language: str
    text: str
    file: str | None
    line: int

    def commands(self) -> Iterator[tuple[str, str]]:
        """Each command, its continued lines with it, and the output shown below it."""
        for part in re.split(r"^\$ ", self.text, flags=re.MULTILINE)[1:]:
            found = re.match(r"((?:.*\\\n)*.*)\n?", part)
            assert found
            yield found[1], part[found.end() :]


def blocks(document: str) -> list[Block]:
    text = TEXTS[document]
    return [
        Block(found["language"], found["text"], found["file"], text.count("\n", 0, found.start("language")) + 1)
        for found in FENCE.finditer(text)
    ]


def parts() -> Iterator[tuple[str, tuple[Block, ...]]]:
    """What is run in a folder of its own: the blocks of a document, or one of them."""
    for document in DOCUMENTS:
        found = blocks(document)
        if document in APART:
            yield from ((document, (block,)) for block in found)
        elif found:
            yield document, tuple(found)


def named(part: tuple[str, tuple[Block, ...]]) -> str:
    document, (first, *_) = part
    return f"{document}:{first.line}" if document in APART else document


def matches(shown: str, printed: str) -> bool:
    """Whether the output is as shown, `...` standing for anything."""
    pattern = ".*".join(re.escape(part) for part in shown.split("..."))
    return re.fullmatch(pattern, printed, re.DOTALL) is not None


class Workplace:
    """A folder like the root of a clone: the scenes, and the examples of the documents."""

    def __init__(self, folder: Path, document: str, need: Callable[[object, str], None]) -> None:
        self.folder, self.document, self.need = folder, document, need
        shutil.copytree(ROOT / "scenes", folder / "scenes")
        shutil.copytree(ROOT / "docs" / "examples", folder / "docs" / "examples")
        path = f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}"
        columns = str(WIDTHS.get(document, 160))
        self.environment = os.environ | {"PATH": path, "COLUMNS": columns, "NO_COLOR": "1"}
        self.environment.pop("PYTEST_ADDOPTS", None)
        self.status = 0

    def do(self, block: Block) -> None:
        match block.language:
            case "console":
                self.console(block)
            case "diff":
                assert block.file, "which file?"
                self.edit(self.folder / block.file, block.text)
            case _ if block.file:
                (self.folder / block.file).write_text(block.text)
                if block.file == "pyproject.toml":
                    self.install(block.text)
            case "python":
                self.python(block.text)
            case "toml":
                tomllib.loads(block.text)
            case "xml":
                ElementTree.fromstring(block.text)

    def console(self, block: Block) -> None:
        commands = list(block.commands())
        assert commands, f"{self.document}:{block.line}: no command"
        for place, (command, shown) in enumerate(commands):
            if any(self.document == name and command.startswith(words) for name, words in NOT_RUN):
                continue
            self.needs(command)
            # `$ echo $?` speaks about the command before it.
            done = subprocess.run(
                ["bash", "-c", f"(exit {self.status}); {command}"],
                cwd=self.folder,
                env=self.environment,
                capture_output=True,
                text=True,
                check=False,
            )
            self.status = done.returncode
            told = f"{self.document}:{block.line}\n$ {command}\n{done.stdout}{done.stderr}"
            said = place + 1 < len(commands) and commands[place + 1][0] == "echo $?"
            assert said or self.status == 0, told
            # On stderr is what goes on, and what is missing here; of what fails it may be the point.
            told_why = self.status != 0 and matches(shown, done.stdout + done.stderr)
            assert told_why or matches(shown, done.stdout), told

    def needs(self, command: str) -> None:
        """Skip where a renderer is missing that not every machine has."""
        for name in ("mitsuba-spec@llvm", "povray"):
            if re.search(rf"--(renderer|against)[ =]\S*\b{name}|^{name} ", command):
                missing = renderers.get(name).unavailable()
                self.need(missing is None, f"{command}: {missing}")

    def python(self, text: str) -> None:
        shown = [line.partition("  # ")[2] for line in text.splitlines() if line.lstrip().startswith("print(")]
        assert all(shown), "every print says what it prints"
        done = subprocess.run(
            [sys.executable, "-c", text],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, ""), text
        assert matches("".join(f"{line}\n" for line in shown), done.stdout), done.stdout

    def edit(self, path: Path, diff: str) -> None:
        """Apply a diff without line numbers: the lines with ' ' and '-' stand in the file once, one after the other."""
        lines = diff.splitlines()
        assert all(line[:1] in ("+", "-", " ") for line in lines), diff
        old, new = ("".join(f"{line[1:]}\n" for line in lines if line[0] != sign) for sign in "+-")
        text = path.read_text()
        assert text.count(old) == 1, f"{path.name} does not have once\n{old}"
        path.write_text(text.replace(old, new))

    def install(self, project: str) -> None:
        """As pip would: the entry points of the modules in the folder."""
        (group, points), *_ = tomllib.loads(project)["project"]["entry-points"].items()
        lines = [f"[{group}]", *(f"{name} = {target}" for name, target in points.items())]
        installed = self.folder / "example-1.0.dist-info"
        installed.mkdir()
        (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: example\nVersion: 1.0\n")
        (installed / "entry_points.txt").write_text("\n".join(lines) + "\n")
        self.environment["PYTHONPATH"] = str(self.folder)


@pytest.mark.mitsuba
@pytest.mark.parametrize("part", [*parts()], ids=named)
def test_every_block_does_what_it_shows(part: tuple[str, tuple[Block, ...]], tmp_path: Path, need) -> None:
    document, found = part
    workplace = Workplace(tmp_path, document, need)
    for block in found:
        workplace.do(block)


def test_the_diagrams_are_those_that_make_docs_draws(tmp_path: Path) -> None:
    code = f"import sys, pathlib, diagrams; diagrams.main(pathlib.Path({str(tmp_path)!r}))"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT / "docs", check=True)
    drawn = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert len(drawn) == 6
    assert drawn == {name: (ROOT / "docs" / "figures" / name).read_text() for name in drawn}


def test_nothing_that_looks_like_a_command_is_only_shown() -> None:
    for document in DOCUMENTS:
        for block in blocks(document):
            shows = re.search(r"^\$ ", block.text, re.MULTILINE)
            assert block.language == "console" or not shows, f"{document}:{block.line}"


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_block_is_one_that_the_tests_know(document: str) -> None:
    found = blocks(document)
    assert {block.language for block in found} <= LANGUAGES
    # Blocks in lists, or with other marks, would go unseen.
    assert len(re.findall(r"^\s*(?:```|~~~)", TEXTS[document], re.MULTILINE)) == 2 * len(found)


def test_what_is_not_run_is_in_the_documents() -> None:
    shown = [(name, command) for name in DOCUMENTS for block in blocks(name) for command, _ in block.commands()]
    for document, words in NOT_RUN:
        assert any(name == document and command.startswith(words) for name, command in shown), words


@pytest.mark.parametrize(
    ("shown", "printed", "same"),
    [("a ... c\n", "a b\nb c\n", True), ("a ... c\n", "a b\n", False), ("", "a\n", False), ("a\n", "a\n", True)],
)
def test_what_is_shown_counts(shown: str, printed: str, same: bool) -> None:
    assert matches(shown, printed) is same


# What documents name.


def prose(document: str) -> str:
    """A document without its fenced blocks."""
    return re.sub(r"^```.*?^```$", "", TEXTS[document], flags=re.MULTILINE | re.DOTALL)


def anchors(document: str) -> set[str]:
    """Those that forges make of headings."""
    found: set[str] = set()
    for title in re.findall(r"^#+ (.*)$", prose(document), re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).strip().lower()
        slug = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        number, name = 0, slug
        while name in found:
            number += 1
            name = f"{slug}-{number}"
        found.add(name)
    return found


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_lead_somewhere(document: str) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(document)):
        if target.startswith("https://"):
            continue
        file, _, anchor = target.partition("#")
        path = ((ROOT / document).parent / file).resolve() if file else ROOT / document
        assert path.exists(), target
        if anchor:
            assert anchor in anchors(str(path.relative_to(ROOT))), target


def test_the_index_leads_to_every_document() -> None:
    seen, new = set(), {"README.md"}
    while new:
        document = new.pop()
        seen.add(document)
        links = re.findall(r"\]\(([^)#\s]+\.md)[^)]*\)", prose(document))
        paths = [((ROOT / document).parent / link).resolve() for link in links if not link.startswith("https:")]
        new |= {str(path.relative_to(ROOT)) for path in paths} - seen
    assert seen >= set(DOCUMENTS)


def test_every_picture_is_shown_and_small() -> None:
    pictures = {path for path in (ROOT / "docs").rglob("*") if path.suffix in (".svg", ".png")}
    shown = {
        ((ROOT / name).parent / target).resolve()
        for name in DOCUMENTS
        for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+)\)", TEXTS[name])
    }
    assert shown == pictures
    sizes = {path.name: path.stat().st_size for path in pictures}
    assert max(sizes.values()) < 100_000, sizes
    assert sum(sizes.values()) < 400_000, sizes
    for path in pictures:
        assert path.suffix != ".svg" or ElementTree.parse(path)


#: Options of other programs.
OTHERS = {"--strict", "--no-build-isolation", "--no-deps", "--hypothesis-profile", "--whitted-report"}


def options() -> set[str]:
    found = {name for command in whitted.commands.values() for option in command.params for name in option.opts}
    found |= {
        name for command in whitted.commands.values() for option in command.params for name in option.secondary_opts
    }
    assert all(isinstance(command, click.Command) for command in whitted.commands.values())
    helped = subprocess.run(["raytrace", "--help"], capture_output=True, text=True, check=True, env=_with_programs())
    return found | set(re.findall(r"--[a-z][a-z-]*", helped.stdout)) | OTHERS | {"--help", "--version"}


def _with_programs() -> dict[str, str]:
    return os.environ | {"PATH": f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}"}


def test_every_option_exists() -> None:
    known = options()
    for document in DOCUMENTS:
        for code in re.findall(r"`([^`\n]+)`", prose(document)):
            for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", code):
                assert option in known, f"{document}: {code}"


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_file_of_ours_exists(document: str) -> None:
    for code in re.findall(r"`([^`\n]+)`", prose(document)):
        for path in re.findall(r"(?<![\w./-])(?:tracer|converters|validation|tests|docs|scenes)/[\w./*-]*", code):
            assert [*ROOT.glob(path.rstrip("/."))], f"{document}: {code}"


def test_the_system_packages_are_those_that_make_asks_for() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = re.search(r"^PACKAGES := (.*)$", makefile, re.MULTILINE)
    assert found
    for document in ("README.md", "CONTRIBUTING.md"):
        assert f"sudo apt-get install {found[1]}`" in TEXTS[document]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_target_of_make_exists(document: str) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"(?:`|^\$ )make ([a-z]+)", TEXTS[document], re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_every_known_mistake_is_told() -> None:
    for mistake in (*MISTAKES, ACNE):
        assert f"| {mistake.says} |" in TEXTS["docs/known-differences.md"]


def test_the_scene_in_the_specification_is_one(tmp_path: Path) -> None:
    (scene,) = (block.text for block in blocks("docs/specification.md") if block.language == "text")
    done = subprocess.run(
        ["raytrace", "-", "-o", "-"],
        input=scene.encode(),
        cwd=tmp_path,
        env=_with_programs(),
        capture_output=True,
        check=True,
    )
    assert done.stdout.startswith(b"P6\n400 400\n255\n")
