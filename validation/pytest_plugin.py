"""The plugin for pytest: the fixture `whitted_validate`, and `--whitted-report DIR`.

Everything but pytest is imported where it is used: who has this installed pays nothing for it in other tests.
"""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tracer import Scene
    from validation.renderers import Renderer
    from validation.report.report import Report
    from validation.run import Rendered, Validation

    Named = str | Renderer

#: Differences that the message of a failed test names.
MOST = 20


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--whitted-report DIR`."""
    group = parser.getgroup("whitted", "whitted: reference validation of ray tracers")
    group.addoption(
        "--whitted-report",
        metavar="DIR",
        help="write DIR/index.html: what all tests with the fixture whitted_validate compared; with pytest-xdist one "
        "folder in DIR for each worker",
    )


class WhittedValidate:
    """Compares renderers on scenes and fails the test where they differ: the fixture `whitted_validate`."""

    def __init__(self, collected: Collected | None, test: str = "") -> None:
        """`collected`: where the pictures for a report go; `test`: the name of the test."""
        self._collected, self._test = collected, test

    def __call__(
        self,
        scenes: str | Path | Scene | Mapping[str, Scene] | Sequence[str | Path],
        renderer: Named | Sequence[Named],
        against: Named | Sequence[Named] = "native-f64",
        *,
        fail: bool = True,
        **options: Any,
    ) -> Validation:
        """Compare, and return what was found.

        Args:
            scenes: one scene or several: files, folders, or `Scene` objects, of several by name.
            renderer: what is under test, such as "cmd:./mine {scene} -o {output}".
            against: what it is compared with.
            fail: whether the test fails where they differ, where a difference is not explained, or where one fails.
            options: those of `validation.validate`, such as `passes`, `size`, `settings` and `verdicts`.
        """
        __tracebackhide__ = True
        from tracer import Scene
        from validation.run import validate

        if isinstance(scenes, Scene):
            scenes = {"scene": scenes}
        elif isinstance(scenes, str | Path):
            scenes = [scenes]
        collected = self._collected
        if collected:
            collected.begin(self._test)
            options.setdefault("on_rendered", collected.picture)
        result = validate(scenes, renderer, against, **options)
        if collected:
            collected.add(result)
        if fail and not result.ok:
            pytest.fail(message(result, scenes, options), pytrace=False)
        return result


class Collected:
    """What all tests of a session compared, for one report."""

    def __init__(self, folder: Path) -> None:
        """`folder`: where the report goes."""
        from validation.report.report import Report

        self.folder = folder
        self._report: Report = Report()
        self._result: Validation | None = None
        #: By its label what a scene is called in the report; a test may have one that another test has, too.
        self._names: dict[str, str] = {}
        self._taken: set[str] = set()
        self._test = ""

    def begin(self, test: str) -> None:
        """What comes now is compared by this test."""
        self._test, self._names = test, {}

    def _name(self, label: str) -> str:
        if label not in self._names:
            own = f"{label} [{self._test}"
            candidates = itertools.chain([label, f"{own}]"], (f"{own} {number}]" for number in itertools.count(2)))
            self._names[label] = next(name for name in candidates if name not in self._taken)
            self._taken.add(self._names[label])
        return self._names[label]

    def picture(self, rendered: Rendered) -> None:
        """What one pair drew of one scene."""
        name = self._name(rendered.label)
        comparisons = [replace(comparison, scene=name) for comparison in rendered.comparisons]
        verdicts = rendered.verdicts and replace(rendered.verdicts, scene=name)
        self._report.add(replace(rendered, label=name, path=rendered.label, comparisons=comparisons, verdicts=verdicts))

    def add(self, result: Validation) -> None:
        """What one call compared."""
        if self._result is None:
            self._result = type(result)(settings=result.settings)
        all_of = self._result
        all_of.comparisons += [replace(entry, scene=self._name(entry.scene)) for entry in result.comparisons]
        all_of.verdicts += [replace(entry, scene=self._name(entry.scene)) for entry in result.verdicts]
        all_of.notes += [note for note in result.notes if note not in all_of.notes]
        for failure in result.failures:
            all_of.fail(failure)
        all_of.lacking |= result.lacking
        all_of.versions |= result.versions

    def write(self, command: Sequence[str]) -> Path | None:
        """Write the page; None where nothing was compared."""
        if self._result is None:
            return None
        self._result.command = command
        self.folder.mkdir(parents=True, exist_ok=True)
        return self._report.write(self.folder, self._result)


COLLECTED = pytest.StashKey[Collected]()
#: The pages that this run has written; of pytest-xdist those of the workers.
WRITTEN = pytest.StashKey[list[str]]()
#: Under which name a worker hands over its page.
PAGE = "whitted_report"


@pytest.fixture
def whitted_validate(request: pytest.FixtureRequest) -> WhittedValidate:
    """Compare renderers on scenes; the test fails where they differ, and says why.

    whitted_validate("scene.txt", "cmd:./mine {scene} -o {output}", "native-f64", passes=["beauty"])
    """
    return WhittedValidate(_collected(request.config), request.node.name)


def _collected(config: pytest.Config) -> Collected | None:
    asked = config.getoption("--whitted-report")
    if not asked:
        return None
    if COLLECTED not in config.stash:
        from validation.report.report import ours

        folder = Path(config.invocation_params.dir, asked)
        worker = getattr(config, "workerinput", None)
        folder = folder / worker["workerid"] if worker else folder
        if not ours(folder / "index.html"):
            pytest.fail(
                f"--whitted-report: {folder / 'index.html'} is no report of whitted: name another folder", False
            )
        config.stash[COLLECTED] = Collected(folder)
    return config.stash[COLLECTED]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the report, also after Ctrl-C."""
    config = session.config
    if COLLECTED in config.stash:
        path = config.stash[COLLECTED].write(["pytest", *map(str, config.invocation_params.args)])
        if path:
            config.stash[WRITTEN] = [str(path)]
            if hasattr(config, "workeroutput"):
                config.workeroutput[PAGE] = str(path)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """A worker of pytest-xdist has ended."""
    page = getattr(node, "workeroutput", {}).get(PAGE)
    if page:
        node.config.stash.setdefault(WRITTEN, []).append(page)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say where the report is."""
    pages: list[str] = config.stash.get(WRITTEN, [])
    for page in sorted(pages):
        terminalreporter.write_line(f"whitted report: {page}")


def _words(options: Mapping[str, Any]) -> list[str]:
    """Options of the command that compares as `validate` does with those."""
    from validation.renderers import Settings

    words = []
    if size := options.get("size"):
        words += ["--size", "{}x{}".format(*size)]
    if passes := options.get("passes"):
        words += ["--passes", ",".join(passes)]
    if "verdicts" in options:
        words += ["--verdicts", str(options["verdicts"])]
    for name, value in vars(options.get("settings") or Settings()).items():
        if value != getattr(Settings(), name):
            words += [f"--{name.replace('_', '-')}", str(value)]
    words += ["--flip"] * bool(options.get("flip"))
    return words + ["--no-limits"] * (not options.get("limits", True))


def message(result: Validation, scenes: object, options: Mapping[str, Any] | None = None) -> str:
    """Why a test fails: what differs, what is not explained, what failed, and the command that shows more."""
    from validation.terminal import worst_of

    differ = [comparison for comparison in result.comparisons if not comparison.ok]
    lines = [
        f"{comparison.scene}: {comparison.pass_name} ({comparison.renderer}, {comparison.reference}): "
        f"{'; '.join(comparison.reasons)}{worst_of(comparison)}"
        for comparison in differ
    ]
    lines += [
        f"{verdicts.scene}: {group.sentence()}"
        for verdicts in result.verdicts
        for group in verdicts.groups()
        if not group.explained
    ]
    lines += [": ".join(filter(None, vars(failure).values())) for failure in result.failures]
    lines += [": ".join(filter(None, vars(note).values())) for note in result.notes if not result.comparisons]
    if len(lines) > MOST:
        lines[MOST:] = [f"and {len(lines) - MOST} more"]
    total = len(result.comparisons)
    head = f"{len(differ)} of {total} comparisons differ" if total else "nothing was compared"
    if differ and not isinstance(scenes, Mapping):
        first = differ[0]
        words = ["whitted", "validate", first.scene, "--renderer", first.renderer, "--against", first.reference]
        words += _words(options or {})
        lines.append(f"hint: {shlex.join([*words, '--report', 'report'])}")
    return "\n  ".join([head, *lines])
