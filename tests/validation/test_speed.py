"""`whitted speed`: what is measured and what is told of it; no time is asserted."""

from __future__ import annotations

import contextlib
import math
import os
import re
import signal
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest
from conftest import Result, strict

import tracer
from tracer import _native
from validation import renderers, speed, speed_kernels, speed_text
from validation.certify import Proof, prove_scene
from validation.renderers import Settings
from validation.renderers.mitsuba.mesh import MitsubaMesh, icosphere, write_ply
from validation.run import resized
from validation.speed import Entry, LateError, Spread, WorkerError, entries, instruction_sets, process
from validation.speed_errors import measure
from validation.speed_plot import Panel, Point, front, write_plot

Run = Callable[..., Result]

HERE = Path(__file__).resolve().parent


def here() -> list[str]:
    """The instruction sets that can be used here."""
    found = []
    for isa in instruction_sets():
        with process() as worker:
            asked = {"renderer": "native-f64", "scene": doubles.FULL, "settings": {}, "key": ""}
            if "size" in worker.ask("survey", isa=isa, **asked):
                found.append(isa)
    return found


# ---- the front


def test_the_front_is_who_is_beaten_by_nobody() -> None:
    points = [(1, 9), (2, 5), (2, 6), (3, 5), (4, 1), (9, 1), (5, 2)]
    assert front(points) == [True, True, False, False, True, False, False]


def test_equals_share_the_front() -> None:
    assert front([(1, 1), (1, 1), (1, 2)]) == [True, True, False]
    assert front([]) == []


def test_errors_that_chance_may_have_made_are_no_better() -> None:
    points = [(1.0, 1.1), (2.0, 1.0), (3.0, 0.5)]
    assert front(points, [0.01, 0.01, 0.01]) == [True, True, True]
    assert front(points, [0.04, 0.04, 0.04]) == [True, False, True]


def test_what_is_no_number_is_never_on_the_front() -> None:
    assert front([(1, math.inf), (math.inf, 0), (2, math.nan), (3, 4)]) == [False, False, False, True]


def test_the_plot_names_the_front_and_marks_it(tmp_path: Path) -> None:
    points = [
        Point("native-f32@avx2", "native-f32", 2, 10.0, 1e-7),
        Point("native-f64@avx2", "native-f64", 2, 20.0, 0.0),
        Point("povray", "povray", 2, 4000.0, 1e-5),
        Point("cmd:" + "x" * 80, "cmd", 1, 4000.0, 1e-2),
    ]
    for name in ("a.svg", "b.svg"):
        write_plot(tmp_path / name, [Panel("one", points), Panel("two", points[:1])], "when and where")
    text = (tmp_path / "a.svg").read_text()
    assert text == (tmp_path / "b.svg").read_text(), "the same results make the same file"
    assert "native-f32@avx2, 2 threads" in text
    assert ">povray<" in text
    assert "x" * 80 not in text
    assert text.count("when and where") == 1


# ---- numbers


def test_a_spread_is_median_minimum_and_quartiles() -> None:
    assert Spread.of([5.0, 1.0, 2.0, 4.0, 3.0]) == Spread(5, 3.0, 1.0, 2.0, 4.0)
    assert Spread.of([2.0]) == Spread(1, 2.0, 2.0, 2.0, 2.0)


def test_a_line_is_told_from_what_is_none() -> None:
    numbers = [1.0, 2, 5, 10, 20, 50, 100]
    line = speed_kernels.fit(numbers, [0.5 + 0.25 * n for n in numbers])
    assert line.linear
    assert (line.constant, line.each) == (pytest.approx(0.5), pytest.approx(0.25))
    assert line.says("light").startswith("linear: 5e+02 ms and 2.5e+02 ms a light")
    square = speed_kernels.fit(numbers, [0.25 * n**2 for n in numbers])
    assert not square.linear
    assert square.exponent == pytest.approx(2)
    assert not speed_kernels.fit(numbers, [1 / n for n in numbers]).linear


@pytest.fixture(scope="module")
def proof() -> Proof:
    return prove_scene(doubles.full(), pixels=300, edges=40, jobs=1)


@pytest.fixture(scope="module")
def drawn(proof: Proof) -> dict[str, Any]:
    wanted = ["beauty", "id", "shadow.L0", "shadow.L1"]
    return dict(tracer.render(proof.scene, wanted))


def place(proof: Proof, chosen: Any) -> tuple[int, int]:
    """Row and column of the first proved pixel of some."""
    k = int(np.flatnonzero(chosen)[0])
    return int(proof.y[k]), int(proof.x[k])


def test_a_right_picture_has_no_errors_but_rounding(proof: Proof, drawn: dict[str, Any]) -> None:
    found = measure(drawn, proof)
    assert 0 < found.random_rmse < found.random_max < 1e-12
    assert (found.wrong, found.levels_off, found.levels_max) == (0, 0, 0)
    assert (found.random, found.edge) == (300, 40)


def test_an_error_that_is_planted_is_measured(proof: Proof, drawn: dict[str, Any]) -> None:
    dark = proof.random & ~proof.edge & (proof.value["beauty"].max(axis=1) < 0.7)
    beauty = drawn["beauty"].copy()
    beauty[place(proof, dark)][1] += 0.25
    found = measure(drawn | {"beauty": beauty}, proof)
    assert found.random_max == pytest.approx(0.25)
    assert found.random_rmse == pytest.approx(0.25 / math.sqrt(3 * found.random))
    assert found.edge_max < 1e-12
    assert found.levels_off == 1
    assert found.levels_max in (63, 64)
    assert found.wrong == 0


def test_an_error_at_an_edge_is_no_error_elsewhere(proof: Proof, drawn: dict[str, Any]) -> None:
    beauty = drawn["beauty"].copy()
    beauty[place(proof, proof.edge & ~proof.random)][0] -= 0.5
    found = measure(drawn | {"beauty": beauty}, proof)
    assert found.edge_max == pytest.approx(0.5)
    assert found.random_max < 1e-12


@pytest.mark.parametrize("name", ["id", "shadow.L0"])
def test_wrong_decisions_are_counted(name: str, proof: Proof, drawn: dict[str, Any]) -> None:
    of = proof.lit[0] & (proof.value["id"][:, 0] >= 0)
    changed = drawn[name].copy()
    at = place(proof, of)
    changed[at] = 2 - changed[at] if name == "id" else 1 - changed[at]
    if name == "id" and changed[at] == drawn[name][at]:
        changed[at] = -1
    assert measure(drawn | {name: changed}, proof).wrong == 1


def test_a_shadow_that_no_light_could_fall_on_is_no_decision(proof: Proof, drawn: dict[str, Any]) -> None:
    of = ~proof.lit[0] & (proof.value["id"][:, 0] >= 0)
    changed = drawn["shadow.L0"].copy()
    at = place(proof, of)
    changed[at] = 1 - changed[at]
    assert measure(drawn | {"shadow.L0": changed}, proof).wrong == 0


def test_who_does_not_tell_decisions_has_none(proof: Proof, drawn: dict[str, Any]) -> None:
    assert measure({"beauty": drawn["beauty"]}, proof).wrong is None


def test_no_number_is_an_infinite_error(proof: Proof, drawn: dict[str, Any]) -> None:
    beauty = drawn["beauty"].copy()
    beauty[place(proof, proof.random)] = np.nan
    found = measure(drawn | {"beauty": beauty}, proof)
    assert found.random_max == found.random_rmse == math.inf


def test_levels_of_a_file_are_taken_as_they_are(proof: Proof, drawn: dict[str, Any]) -> None:
    levels = tracer.passes.quantise(drawn["beauty"]).astype(np.float64)
    found = measure({"beauty": levels / 255}, proof, steps=255)
    assert found.levels_off == 0
    # Black and white end what a file holds: no error.
    assert proof.value["beauty"].max() > 1
    assert found.random_max <= 1 / 255 + 1e-12
    assert measure({"beauty": (levels + (levels < 255)) / 255}, proof, steps=255).levels_max == 1


def test_a_picture_of_another_size_is_refused(proof: Proof, drawn: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"delivered 64x47 pixels, expected 64x48"):
        measure({"beauty": drawn["beauty"][1:]}, proof)


# ---- what is measured


def test_of_a_family_those_that_can_run_are_measured(run: Any, scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who names one that cannot run here is told that it failed; who names the family is not."""
    other = "neon" if "sse2" in instruction_sets() else "avx2"
    monkeypatch.setattr(speed, "instruction_sets", lambda: ("scalar", other))
    words = ("--size", "16X12", "--seconds", 0.01, "--rounds", 3, "--pixels", 4, "--edges", 0, "--threads", 999)
    found = run("speed", scene, "--renderer", "native-f32", *words)
    assert (found.status, found.err) == (0, "")
    assert f"native-f32@{other}: cannot run here" in found.out
    count = len(speed.processors())
    assert f"left out: --threads 999: here are {count} processor" in found.out
    assert found.out.splitlines()[0].endswith("3 spheres, 2 lights")
    alone = run("speed", scene, "--renderer", f"native-f32@{other},native-f32@scalar", *words)
    assert (alone.status, "cannot run here" in alone.err) == (3, True)


def test_names_stand_for_instruction_sets_and_threads() -> None:
    found = entries(["native-f64"], (1,))
    assert [entry.isa for entry in found] == list(reversed(instruction_sets()))
    assert {entry.threads for entry in found} == {1}
    (one,) = entries(["native-f64@scalar"], (0,))
    assert one == Entry("native-f64", "scalar", len(speed.processors()))
    assert entries(["numpy-f32"], None) == [Entry("numpy-f32", "", 1)]
    assert [entry.name for entry in entries(["mitsuba-mesh-3@scalar"], (1,))] == ["mitsuba-mesh-3@scalar"]
    assert {entry.family for entry in entries(["mitsuba-mesh"], None)} == {"mitsuba-mesh"}
    assert {entry.name for entry in entries(["mitsuba-spec"], (1,))} == {
        f"mitsuba-spec@{backend}" for backend in ("llvm", "scalar", "cuda")
    }


def test_by_default_all_renderers_are_measured() -> None:
    found = {entry.renderer for entry in entries(None, None)}
    assert {entry.name for entry in renderers.all()} <= found
    assert {f"mitsuba-mesh-{n}@llvm" for n in (2, 4, 6)} <= found


@pytest.mark.parametrize(
    "name", ["native-f64@avx1024", "mitsuba-mesh-x", "mitsuba-mesh-99", "mitsuba-mesh-2@gpu", "nativ"]
)
def test_a_name_that_there_is_not_is_an_error(name: str, run: Run, scene: Path) -> None:
    found = run("speed", scene, "--renderer", name)
    assert found.status == 2
    assert f"unknown renderer '{name}'" in found.err
    assert "hint:" in found.err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--threads", "1,x"), "'x' is not a whole number"),
        (("--seconds", "-1"), "is not a finite number from 0 on"),
        (("-o", "plot.png"), "expected .svg"),
        (("--json", "missing/speed.json"), "there is no folder missing"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_measured(
    words: tuple[str, ...], told: str, run: Run, scene: Path
) -> None:
    found = run("speed", scene, *words)
    assert found.status == 2
    assert told in found.err


def test_without_a_scene_in_sight_one_has_to_be_named(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = run("speed")
    assert found.status == 2
    assert "no scene is named" in found.err


def test_the_default_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes" / "gallery").mkdir(parents=True)
    (tmp_path / speed.OTHERWISE).touch()
    assert speed.default_scenes() == [Path(speed.OTHERWISE)]
    (tmp_path / speed.SCENES[1]).touch()
    assert speed.default_scenes() == [Path(speed.SCENES[1])]


# ---- the command

#: Quick, and enough for every number.
QUICK = ("--rounds", 4, "--seconds", 0.2, "--pixels", 60, "--edges", 10, "--threads", 1)

NUMBERS = {"name", "renderer", "instruction_set", "threads", "size", "cold", "warm", "busy", "ns_per_pixel"}
NUMBERS |= {"memory", "errors", "front"}


def test_everything_is_in_the_results(run: Run, scene: Path, tmp_path: Path) -> None:
    # This one draws the right picture, but for a quarter that it adds to red.
    program = tmp_path / "brighter.py"
    program.write_text(
        "import sys, tracer\n"
        "from PIL import Image\n"
        "from tracer.passes import quantise\n"
        "beauty = tracer.render(tracer.load(sys.argv[1]))['beauty']\n"
        "beauty[..., 0] += 0.25\n"
        "Image.fromarray(quantise(beauty)).save(sys.argv[2])\n"
    )
    command = f"cmd:{sys.executable} {program} {{scene}} {{output}}"
    missing = "cmd:./there-is-none {scene}"
    names = ["--renderer", "native-f64@scalar,native-f32@scalar", "--renderer", command, "--renderer", missing]
    results, plot, report = tmp_path / "speed.json", tmp_path / "speed.svg", tmp_path / "report"
    found = run("speed", scene, *names, *QUICK, "--json", results, "-o", plot, "--report", report)
    assert found.status == 3, "one of those asked for cannot run"
    assert "cannot run here: there is no program './there-is-none'" in found.err
    record = strict(results.read_text())
    assert record["failures"][0]["renderer"].startswith(missing)
    assert record["options"] == {"rounds": 4, "seconds": 0.2, "limit": 160.0, "pixels": 60, "edges": 10, "seed": 0}
    assert {"date", "processor", "processors", "load", "memory"} <= record["machine"].keys()
    assert record["machine"]["load"].keys() == {"before", "after"}
    assert {"whitted", "python", "compiler"} <= record["versions"].keys()
    (of,) = record["scenes"]
    assert (of["scene"], of["size"], of["spheres"], of["lights"]) == (str(scene), [64, 48], 3, 2)
    by_name = {entry["name"]: entry for entry in of["entries"]}
    assert by_name.keys() == {"native-f64@scalar", "native-f32@scalar", command}
    for entry in of["entries"]:
        assert entry.keys() == NUMBERS
        assert entry["warm"]["runs"] >= 1
        assert 0 < entry["warm"]["least"] <= entry["warm"]["lower"] <= entry["warm"]["median"] <= entry["warm"]["upper"]
        assert entry["cold"] > 0
        assert entry["memory"] > 1 << 20
        assert entry["ns_per_pixel"] == pytest.approx(entry["warm"]["median"] * 1e9 / (64 * 48))
    exact, single, brighter = (by_name[name]["errors"] for name in ("native-f64@scalar", "native-f32@scalar", command))
    assert exact["random_max"] < 1e-12 < single["random_max"] < 1e-4
    assert 0.25 - 1 / 255 < brighter["random_max"] <= 0.25
    assert brighter["levels_max"] in (63, 64)
    assert (exact["wrong"], single["wrong"], brighter["wrong"]) == (0, 0, None)
    times = [entry["ns_per_pixel"] for entry in of["entries"]]
    assert times == sorted(times)
    points = [(entry["ns_per_pixel"], entry["errors"]["random_rmse"]) for entry in of["entries"]]
    assert [entry["front"] for entry in of["entries"]] == front(points)
    assert not by_name[command]["front"]
    for text in (found.out, (report / "index.html").read_text()):
        assert "native-f64@scalar" in text
        assert "ns/pixel" in text
    assert "<svg" in plot.read_text()
    assert "<svg" in (report / "index.html").read_text()


def test_a_page_of_someone_else_is_not_written_over(run: Run, scene: Path, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("mine")
    found = run("speed", scene, "--renderer", "native-f64", *QUICK, "--report", tmp_path)
    assert found.status == 2
    assert (tmp_path / "index.html").read_text() == "mine"


def test_who_cannot_run_is_listed_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    # A variant that needs a library that is not there, and an instruction set that the processor lacks.
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nonexistent/libLLVM.so")
    other = "neon" if "sse2" in instruction_sets() else "avx2"
    chosen = [Entry("mitsuba-spec@llvm", "", 1), Entry("native-f64", other, 1), Entry("native-f64", "scalar", 1)]
    quick: dict[str, Any] = {"rounds": 1, "seconds": 0.0, "pixels": 20, "edges": 5}
    result = speed.speed({"full": doubles.full()}, chosen, **quick)
    reasons = {note.renderer: note.message for note in result.left_out}
    assert reasons["mitsuba-spec@llvm"].startswith("cannot run here: Mitsuba does not work with /nonexistent")
    assert re.match(r"cannot run here: here it can be one of .*scalar", reasons[f"native-f64@{other}"])
    assert not result.failures
    assert result.status == 0
    assert [entry.entry.name for entry in result.scenes[0].measured] == ["native-f64@scalar"]
    named = speed.speed({"full": doubles.full()}, chosen[:1], named=True, **quick)
    assert named.status == 3
    assert named.failures


@pytest.mark.mitsuba
def test_who_cannot_draw_the_scene_is_left_out_with_the_reason() -> None:
    wide = doubles.full().replace(view=doubles.full().view.replace(columns=100))
    quick: dict[str, Any] = {"rounds": 1, "seconds": 0.0, "pixels": 20, "edges": 5, "named": True}
    for scene, reason in (
        (wide, "it cannot draw this scene: pixels that are not square need a camera of ours"),
        (doubles.full(), "it cannot draw all of this scene, only some of its passes"),
    ):
        result = speed.speed({"full": scene}, [Entry("mitsuba-stock@scalar", "", 1)], **quick)
        assert [(note.renderer, note.message) for note in result.left_out] == [("mitsuba-stock@scalar", reason)]
        assert not result.scenes[0].measured


def test_when_the_time_is_up_the_rest_is_left_out() -> None:
    chosen = entries(["native-f64@scalar", "native-f32@scalar"], (1,))
    result = speed.speed({"full": doubles.full()}, chosen, limit=0.0, rounds=3, pixels=20, edges=5)
    assert [entry.entry.renderer for entry in result.scenes[0].measured] == ["native-f64"]
    reasons = [note.message for note in result.left_out if note.renderer == "native-f32@scalar"]
    assert reasons == ["the time was up: --limit gives more"]
    assert "native-f32@scalar: the time was up" in "\n".join(speed_text.left_out(result))


def test_a_program_that_fails_is_a_failure_and_the_others_go_on() -> None:
    chosen = entries(["cmd:false {scene}", "native-f64@scalar"], (1,))
    result = speed.speed({"full": doubles.full()}, chosen, rounds=2, seconds=0.1, pixels=20, edges=5)
    assert [note.renderer for note in result.failures] == ["cmd:false {scene}, 1 thread"]
    assert [entry.entry.renderer for entry in result.scenes[0].measured] == ["native-f64"]
    assert result.status == 3


# ---- processes


def test_a_process_that_hangs_is_ended() -> None:
    with process() as worker:
        with pytest.raises(LateError, match="no answer within 0 seconds"):
            worker.ask("limits", patience=0.01, seconds=5)
        pid = worker._process.pid
    assert not Path(f"/proc/{pid}").exists() or sys.platform != "linux"


def test_a_process_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Of a program that is ended while it draws, the folder it draws in would be left.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    started, program = tmp_path / "started", tmp_path / "slow.py"
    program.write_text(f"import pathlib, time\npathlib.Path({str(started)!r}).touch()\ntime.sleep(60)\n")
    command = f"cmd:{sys.executable} {program} {{scene}}"
    with process() as worker:
        with pytest.raises(LateError):
            worker.ask("first", patience=3, renderer=command, scene=doubles.FULL, settings={}, key="")
        (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
        assert started.exists()
        assert list(folder.iterdir()), "the folder that the program runs in"
    assert {path.name for path in tmp_path.iterdir()} == {"started", "slow.py"}


def test_a_process_that_dies_says_how() -> None:
    with process() as worker:
        worker.ask("memory")
        os.kill(worker._process.pid, signal.SIGKILL)
        with pytest.raises(WorkerError, match="was ended by SIGKILL"):
            worker.ask("memory")


def test_the_memory_is_that_of_the_process_and_not_of_ours() -> None:
    ballast = np.ones(1 << 26)  # half a GiB
    with process() as worker:
        assert 1 << 20 < worker.ask("memory")["bytes"] < 200 << 20
    assert ballast.nbytes == 1 << 29


def test_a_renderer_of_others_may_print_what_it_likes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "loud.py").write_text(
        "import os\n"
        "from validation.renderers.native import Native\n"
        "class Loud(Native):\n"
        "    def render(self, *words):\n"
        '        print(\'{"error": "none"}\', flush=True)\n'
        "        os.write(1, b'{}\\n')\n"
        "        return super().render(*words)\n"
        "def renderers():\n"
        "    found = Loud('f64')\n"
        "    found.name = 'loud'\n"
        "    return [found]\n"
    )
    installed = tmp_path / "loud-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: loud\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text("[whitted.renderers]\nloud = loud:renderers\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with process() as worker:
        first = worker.ask("first", key="picture", renderer="loud", scene=doubles.FULL, settings={})
        assert first.keys() == {"probing", "seconds"}
        assert worker.ask("memory").keys() == {"bytes"}


def test_a_program_that_fails_is_told_with_its_status(tmp_path: Path) -> None:
    program = tmp_path / "failing.py"
    program.write_text("import sys\nsys.exit(3)\n")
    asked = {"renderer": f"cmd:{sys.executable} {program} {{scene}} {{output}}", "scene": doubles.FULL, "settings": {}}
    with process() as worker:
        with pytest.raises(WorkerError, match="status 3"):
            worker.ask("first", key="picture", **asked)
        assert worker.ask("memory")["bytes"] > 0


def test_native_code_uses_the_instruction_set_that_is_asked_for() -> None:
    for isa in here():
        with process(isa) as worker:
            limits = worker.ask("limits", seconds=0.01)["limits"]
            asked = {"renderer": "native-f64", "scene": doubles.FULL, "settings": {}, "key": ""}
            assert worker.ask("survey", **asked)["versions"]["instruction set"] == isa
        assert limits.keys() == {"f64", "f32"}
        for rates in limits.values():
            assert rates.keys() == {"multiply_adds", "square_roots", "divisions"}
            assert all(rate > 1e6 for rate in rates.values())


def test_limits_are_those_of_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WHITTED_ISA", "nothing")
    with pytest.raises(ValueError, match="WHITTED_ISA is 'nothing'"):
        _native.limits(0.01)


# ---- meshes


def test_a_mesh_is_closed_round_and_looks_outwards(tmp_path: Path) -> None:
    for n in (0, 1, 3):
        vertices, triangles = icosphere(n)
        assert (len(vertices), len(triangles)) == (10 * 4**n + 2, 20 * 4**n)
        assert np.allclose(np.linalg.norm(vertices, axis=1), 1)
        assert len(np.unique(vertices.round(9), axis=0)) == len(vertices)
        a, b, c = vertices[triangles].transpose(1, 0, 2)
        assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0).all()
        sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        forth, back = {tuple(side) for side in sides.tolist()}, {(q, p) for p, q in sides.tolist()}
        assert len(forth) == len(sides)
        assert forth == back
        write_ply(tmp_path / "sphere.ply", n)
        head, _, body = (tmp_path / "sphere.ply").read_bytes().partition(b"end_header\n")
        assert f"element face {len(triangles)}".encode() in head
        assert len(body) == 24 * len(vertices) + 13 * len(triangles)


@pytest.mark.mitsuba
@pytest.mark.parametrize("backend", ["llvm", "scalar"])
def test_the_error_of_a_mesh_falls_with_its_triangles(backend: str, need: Any) -> None:
    reason = MitsubaMesh(0, backend).unavailable()
    need(reason is None, str(reason))
    scene = resized(doubles.full(), (32, 24))
    proof = prove_scene(scene, pixels=32 * 24, edges=0, jobs=1)
    drawn = {}
    for n in (1, 3, 5):
        drawn[n] = measure(dict(MitsubaMesh(n, backend).render(scene, ("beauty", "id"), Settings())), proof)
    errors = [drawn[n].random_rmse for n in (1, 3, 5)]
    assert errors[0] > 2 * errors[1] > 4 * errors[2], errors
    assert drawn[1].wrong is not None
    assert drawn[1].wrong > 10 * (drawn[5].wrong or 0)
    exact = measure(dict(renderers.get(f"mitsuba-spec@{backend}").render(scene, ("beauty",), Settings())), proof)
    assert exact.random_rmse < errors[2]


@pytest.mark.mitsuba
def test_a_mesh_is_no_renderer_to_compare_with() -> None:
    assert not any("mesh" in entry.name for entry in renderers.all())
    claim = MitsubaMesh(2, "scalar").uncertainty(doubles.full(), Settings())
    assert claim.silhouette == math.inf


# ---- the kernels


@pytest.fixture(scope="module")
def kernels() -> speed_kernels.Kernels:
    """Measured in a hurry."""
    return speed_kernels.kernels(
        {"full": doubles.full(), "again": doubles.full()},
        size=(64, 48),
        sizes=(16, 32),
        counts=(1, 3, 9),
        seconds=0.01,
        edge=32,
    )


def test_the_kernels_are_measured_in_every_way(kernels: speed_kernels.Kernels) -> None:
    groups = {row.group for row in kernels.rows}
    of_sets = {"instruction set, full", "instruction set, again"}
    assert groups == of_sets | {"size", "spheres", "lights", "reflections", "threads"}
    for group in of_sets:
        sets = {(row.value, row.precision) for row in kernels.rows if row.group == group}
        assert sets == {(isa, precision) for isa in here() for precision in ("f64", "f32")}
    assert len(kernels.limits) == 2 * len(here())
    for row in kernels.rows:
        assert row.speed == pytest.approx(row.size[0] * row.size[1] / row.warm.median)
        assert row.ratio is not None
    for limit in kernels.limits:
        assert limit.cost("divisions") == pytest.approx(limit.divisions / limit.pixels)
    assert kernels.fits.keys() == {
        f"{what}, {precision}" for what in ("sphere", "light") for precision in ("f64", "f32")
    }
    assert kernels.written is not None
    assert kernels.written[0] == 32 * 32 * 3 + len(b"P6\n32 32\n255\n")
    record = kernels.record()
    assert record["written"]["bytes_per_second"] > 0
    assert len(record["rows"]) == len(kernels.rows)


class Timed:
    """A process whose pictures take a nanosecond a pixel in float64, half of it in float32, and twice that in scalar
    code.
    """

    def __init__(self, isa: str) -> None:
        self.slow, self.jobs = 2 if isa == "scalar" else 1, {}

    def ask(self, do: str, **request: Any) -> dict[str, Any]:
        if do == "first":
            view = tracer.loads(request["scene"], limits=False).view
            each = self.slow * (1e-9 if request["renderer"] == "native-f64" else 0.5e-9)
            self.jobs[request["key"]] = view.columns * view.rows * each
        if do == "draw":
            return {"seconds": [self.jobs[request["key"]]] * 2, "busy": [self.jobs[request["key"]]] * 2}
        if do == "limits":
            rates = {"multiply_adds": 1e12, "square_roots": 4e9, "divisions": 8e9}
            return {"limits": {"f64": rates, "f32": rates}}
        return {"seconds": [1e-6], "bytes": 1000}


def test_ratios_are_of_pixels_a_second_and_to_the_first_of_their_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed_kernels, "process", lambda isa: contextlib.nullcontext(Timed(isa)))
    monkeypatch.setattr(speed_kernels, "instruction_sets", lambda: ("scalar", "sse2"))
    found = speed_kernels.kernels({"full": doubles.full()}, sizes=(16, 64), counts=(1, 9), edge=32)
    for row in found.rows:
        assert row.ratio is not None
        assert row.ratio.median == pytest.approx(2 if row.value == "sse2" else 1), row
        assert row.speed == pytest.approx((0.5e9 if row.isa == "scalar" else 1e9) * (1 + (row.precision == "f32")))
    double = [limit for limit in found.limits if limit.precision == "f64"]
    costs = {limit.isa: (limit.cost("multiply_adds"), limit.cost("square_roots")) for limit in double}
    assert costs == {"scalar": pytest.approx((2000, 8)), "sse2": pytest.approx((1000, 4))}
    assert found.written is not None
    assert found.record()["written"]["bytes_per_second"] == pytest.approx(1e9)
    assert next(speed_text.sentences(found)).endswith("full: scalar 2.00, sse2 2.00")


def test_a_picture_that_does_not_fit_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed_kernels, "_free_memory", lambda: 100_000)
    found = speed_kernels.kernels(
        {"full": doubles.full()}, size=(16, 16), sizes=(16, 128), counts=(1,), seconds=0.01, edge=16
    )
    assert any(re.match(r"size 128, f64: 0 MiB, 0 MiB are free", line) for line in found.left_out)
    assert not any(row.value == 128 for row in found.rows)


@pytest.mark.parametrize("count", [1, 9, 100])
def test_scenes_of_many_spheres_and_lights_are_what_they_say(count: int) -> None:
    assert len(speed_kernels.made(spheres=count).distinct) == count
    many = speed_kernels.made(lights=count)
    assert len(many.lights) == count
    # Light and float32 have room for it.
    beauty = tracer.render(many, precision="f32")["beauty"]
    assert np.isfinite(beauty).all()
    seen = tracer.render(speed_kernels.made(spheres=count), ["id"])["id"]
    assert len(np.unique(seen)) > count / 2
    assert 0.15 < (seen >= 0).mean() < 0.6


def test_mirrors_that_face_each_other_show_every_reflection() -> None:
    passes = tracer.render(speed_kernels.mirrors(), ["reflection.3", "reflection.8"], max_reflections=8)
    assert (passes["reflection.3"].max(axis=-1) > 0).mean() > 0.9
    assert (passes["reflection.8"].max(axis=-1) > 0).mean() > 0.5


def test_the_kernels_are_in_the_results(
    run: Run, scene: Path, tmp_path: Path, kernels: speed_kernels.Kernels, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speed_kernels, "kernels", lambda *_, **__: kernels)
    results = tmp_path / "speed.json"
    words = ("--renderer", "native-f32@scalar", *QUICK, "--kernels", "--json", results, "--report", tmp_path / "page")
    found = run("speed", scene, *words)
    assert found.status == 0
    assert "kernels by instruction set, full" in found.out
    assert "spheres, f64: " in found.out
    assert "kernels by threads" in (tmp_path / "page" / "index.html").read_text()
    assert strict(results.read_text())["kernels"]["rows"]
