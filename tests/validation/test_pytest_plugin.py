"""The plugin for pytest, in a project of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from typing import Any

import doubles
import pytest

from validation.compare import Comparison
from validation.pytest_plugin import message
from validation.renderers import Settings
from validation.run import Validation

TESTS = """
import tracer

def test_agree(whitted_validate):
    result = whitted_validate("scene.txt", "native-f64", "numpy-f64")
    assert result.ok
    assert len(result.comparisons) == 15

def test_differ(whitted_validate):
    whitted_validate("scene.txt", "cmd:raytrace {scene} -o {output} --max-reflections 0", passes=["beauty"])

def test_may_differ(whitted_validate):
    result = whitted_validate(
        "scene.txt", "cmd:raytrace {scene} -o {output} --max-reflections 0", passes=["beauty"], fail=False
    )
    assert not result.ok

def test_objects(whitted_validate):
    scene = tracer.load("scene.txt")
    whitted_validate(scene, "native-f32", size=(16, 12))
    whitted_validate({"a": scene, "b": scene}, "native-f32", size=(16, 12))

def test_failing(whitted_validate):
    whitted_validate(tracer.load("scene.txt"), "cmd:false {scene}", passes=["beauty"])
"""


@pytest.fixture
def project(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A project with a scene and tests."""
    monkeypatch.setenv("PATH", sysconfig.get_path("scripts"), prepend=os.pathsep)
    (pytester.path / "scene.txt").write_text(doubles.FULL)
    pytester.makepyfile(TESTS)
    return pytester


def test_a_test_fails_where_renderers_differ(project: pytest.Pytester) -> None:
    result = project.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, failed=2)
    result.stdout.fnmatch_lines(
        [
            "1 of 1 comparisons differ",
            "  scene.txt: beauty (cmd:raytrace {scene} -o {output} --max-reflections 0, native-f64): * over tolerance*"
            "worst pixel x *",
            "  scene.txt: * it reflects 0 times, not 3*",
            "  hint: whitted validate scene.txt --renderer 'cmd:raytrace {scene} -o {output} --max-reflections 0' "
            "--against native-f64 --passes beauty --report report",
            "nothing was compared",
            "  scene: cmd:false {scene}: *",
        ]
    )
    assert "pytest_plugin.py" not in result.stdout.str(), "the reader's own code is what is shown"
    assert "whitted report" not in result.stdout.str()


def test_the_report_has_what_all_tests_compared(project: pytest.Pytester) -> None:
    result = project.runpytest_subprocess("--whitted-report", "out/deep")
    result.assert_outcomes(passed=3, failed=2)
    page = project.path / "out" / "deep" / "index.html"
    result.stdout.fnmatch_lines([f"*whitted report: {page}*"])
    text = page.read_text()
    assert " --whitted-report out/deep" in text
    for renderer in ("numpy-f64", "native-f32", "max-reflections 0"):
        assert renderer in text
    assert "cmd:false {scene} failed" in text
    assert "scene.txt [test_differ]" in text, "another test has compared passes of that scene before"
    assert "whitted explain scene.txt " in text
    assert '"path": "scene.txt"' in text
    assert "whitted explain &#39;scene.txt [" not in text


def test_each_worker_of_xdist_has_a_report(project: pytest.Pytester) -> None:
    result = project.runpytest_subprocess("--whitted-report", "out", "-n", "2", "--dist", "load")
    result.assert_outcomes(passed=3, failed=2)
    pages = sorted((project.path / "out").glob("*/index.html"))
    assert {page.parent.name for page in pages} <= {"gw0", "gw1"}
    assert pages
    result.stdout.fnmatch_lines([f"*whitted report: {page}*" for page in pages])


def test_a_page_of_an_earlier_run_is_not_announced(project: pytest.Pytester) -> None:
    earlier = project.path / "out" / "gw7" / "index.html"
    earlier.parent.mkdir(parents=True)
    earlier.write_text("earlier")
    result = project.runpytest_subprocess("--whitted-report", "out", "-n", "1", "-k", "agree")
    result.stdout.fnmatch_lines([f"*whitted report: {project.path / 'out' / 'gw0' / 'index.html'}*"])
    assert "gw7" not in result.stdout.str()


def test_the_hint_repeats_the_comparison() -> None:
    settings = Settings(sample="center", max_reflections=1)
    scenes = ["scenes/spec/diffuse-only.txt"]
    options = {"size": (16, 12), "passes": ["beauty", "depth"], "settings": settings, "verdicts": 3}
    result = Validation(
        settings=settings, comparisons=[Comparison(scenes[0], (16, 12), "a", "b", "beauty", reasons=("x",))]
    )
    assert message(result, scenes, options).endswith(
        "--renderer a --against b --size 16x12 --passes beauty,depth --verdicts 3 --sample center --max-reflections 1 "
        "--report report"
    )


def test_a_page_of_somebody_else_is_kept(project: pytest.Pytester) -> None:
    (project.path / "out").mkdir()
    (project.path / "out" / "index.html").write_text("mine")
    result = project.runpytest_subprocess("--whitted-report", "out", "-k", "agree")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*is no report of whitted: name another folder"])
    assert (project.path / "out" / "index.html").read_text() == "mine"


def test_it_is_found_and_costs_nothing_where_it_is_not_used(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test(): pass")
    pytester.makeconftest(
        "import sys\n"
        "def pytest_sessionfinish():\n"
        "    print('LOADED', 'validation.pytest_plugin' in sys.modules, 'numpy' in sys.modules,\n"
        "          'tracer' in sys.modules, 'click' in sys.modules)\n"
    )
    result = pytester.runpytest_subprocess("-s")
    result.stdout.fnmatch_lines(["*LOADED True False False False"])
    assert "whitted_validate" in pytester.runpytest_subprocess("--fixtures").stdout.str()
    assert "--whitted-report=DIR" in pytester.runpytest_subprocess("--help").stdout.str()


def test_what_it_imports() -> None:
    code = "import sys, pytest; old = set(sys.modules); import validation.pytest_plugin; print(*set(sys.modules) - old)"
    done: Any = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= {"validation", "validation.pytest_plugin", "shlex"}
