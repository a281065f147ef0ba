"""What all commands have in common: the words of their errors, exit statuses, pipes, signals and standard input."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import doubles
import pytest
from command_line import NATIVE, far_away, whitted
from doubles import Double

import validation.__main__ as program
from tracer import _native
from tracer.passes import SAMPLES, Passes
from validation import options
from validation.commands import errors, inputs
from validation.encoding import QUANTISATIONS
from validation.run import MOST_VERDICTS


def test_of_a_file_that_is_no_scene_the_beginning_is_told(run: Any, tmp_path: Path) -> None:
    text = tmp_path / "novel.txt"
    for lines in (30, 150):  # the parser itself counts no further than 100
        text.write_text("once upon a time\n" * lines)
        result = run("validate", text, *NATIVE)
        assert result.status == 2
        assert result.err.count(": error: found 'once'") == errors.MOST_ERRORS
        counted = result.err.splitlines()[-1]
        assert counted.startswith(f"{text}: error: and ")
        assert int(counted.split()[-2]) > lines - errors.MOST_ERRORS, "what is missing is counted, too"


#: The command line (SCENE stands for a scene file), what its error says, and what its hint says.
WRONG = {
    "no command": ("bogus", "unknown command 'bogus'", "see `whitted --help`"),
    "near command": ("validat", "unknown command 'validat'", "did you mean 'validate'?"),
    "option": ("validate SCENE --repor x", "no such option '--repor'", "did you mean '--report'?"),
    "no scene": ("validate", "missing argument 'SCENE_OR_FOLDER...'", "see `whitted validate --help`"),
    "renderer": ("validate SCENE --renderer nativ-f64", "unknown renderer 'nativ-f64'", "did you mean 'native-f64'?"),
    "against": ("validate SCENE --against numpy-f46", "unknown renderer 'numpy-f46'", "did you mean 'numpy-f64'?"),
    "pass": ("validate SCENE --passes beuaty", "unknown pass 'beuaty'", "did you mean 'beauty'?"),
    "margin": ("validate SCENE --passes margin.order", "'margin.order' is not compared", "the passes are beauty, "),
    "no pass": ("validate SCENE --passes foo", "unknown pass 'foo'", "the passes are beauty, ambient, "),
    "far option": ("validate SCENE --zzz", "no such option '--zzz'", "see `whitted validate --help`"),
    "empty size": ("validate SCENE --size 0x10", "'0x10' is not a size: at least 1x1", "see `whitted"),
    "long size": ("validate SCENE --size 9999999999x10", "'9999999999x10' is too large", "see `whitted"),
    "memory of validate": (
        "validate SCENE --size 100000x100000 --against numpy-f64",
        "full.txt: error: 15 passes of 100000x100000 pixels need 2960000000000 bytes",
        "a smaller --size, or fewer --passes",
    ),
    "memory of numpy": (
        "render SCENE -o x.npz --passes id --renderer numpy-f64 --no-limits --size 9000000x9000000",
        "1 pass of 9000000x9000000 pixels needs 648000000000000 bytes",
        "a smaller --size",
    ),
    "empty name": ("validate SCENE --passes beauty,,id", "has an empty name", "see `whitted validate --help`"),
    "size": ("validate SCENE --size 400", "'400' is not a size such as 400x300", "see `whitted"),
    "zero size": ("validate SCENE --size 0x5", "'0x5' is not a size", "see `whitted"),
    "sample": ("validate SCENE --sample middle", "'middle' is not one of", "see `whitted"),
    "epsilon": ("validate SCENE --shadow-epsilon nan", "nan", "see `whitted"),
    "epsilon of one": ("validate SCENE --shadow-epsilon 1", "1.0 is not a number from 0 to below 1", "see `whitted"),
    "reflections": ("validate SCENE --max-reflections -1", "'-1' is not a whole number from 0 to 100", "see `whitted"),
    "threads": ("validate SCENE --threads 1025", "'1025' is not a whole number from 0 to 1024", "see `whitted"),
    "threads of render": ("render SCENE -o x.npz --threads 5000", "'5000' is not a whole number", "see `whitted"),
    "wide": ("validate SCENE --size 100001x1", "--size 100001x1: at most 100000 columns", "--no-limits allows more"),
    "wide render": ("render SCENE -o x.npz --size 1x100001", "at most 100000 columns", "--no-limits allows more"),
    "itself": (
        "validate SCENE --renderer numpy-f64 --against numpy-f64",
        "a renderer is not compared with itself: numpy-f64",
        "--against with another name",
    ),
    "verdicts": ("validate SCENE --verdicts x", "--verdicts: 'x' is not a whole number from 0 on", "--verdicts 500"),
    "negative verdicts": ("validate SCENE --verdicts -1", "'-1' is not a whole number", "--verdicts 0 none"),
    "part of a verdict": ("validate SCENE --verdicts 1.5", "--verdicts: '1.5' is not a whole number", "--verdicts 500"),
    "report to a file": ("validate SCENE --report SCENE", "full.txt is a file, expected a folder", "name a folder"),
    "report in a file": ("validate SCENE --report SCENE/x", "full.txt/x: Not a directory", "name another folder"),
    "report to sysfs": ("validate SCENE --report /sys/x/y", "--report: /sys/x/y: ", "name another folder"),
    "json to -": ("validate SCENE --json -", "'-' is not the name of a file to write", "name a file"),
    "json to sysfs": ("validate SCENE --json /sys/x.json", "/sys/x.json: ", "name a file in another folder"),
    "render to sysfs": ("render SCENE -o /sys/x.exr", "/sys/x.exr: ", "name a file in another folder"),
    "memory": (
        "render SCENE -o x.npz --no-limits --size 90000000x90000000",
        "15 passes of 90000000x90000000 pixels need",
        "a smaller --size, or fewer --passes",
    ),
    "no file": ("validate nowhere.txt", "nowhere.txt: error: no such file or folder", ""),
    "near file": ("validate ful.txt", "ful.txt: error: no such file or folder", "did you mean 'full.txt'?"),
    "capitals in a file": ("validate FULL.TXT", "FULL.TXT: error: no such file or folder", "did you mean 'full.txt'?"),
    "capitals in a renderer": (
        "validate SCENE --renderer NATIVE-F32",
        "unknown renderer 'NATIVE-F32'",
        "did you mean 'native-f32'?",
    ),
    "capitals in a command": ("VALIDATE SCENE", "unknown command 'VALIDATE'", "did you mean 'validate'?"),
    "capitals in an option": ("validate SCENE --Size 3x3", "no such option '--Size'", "did you mean '--size'?"),
    "capitals in a pass": ("render SCENE -o x.npz --passes DEPTH", "unknown pass 'DEPTH'", "did you mean 'depth'?"),
    "no ending": ("validate full", "full: error: no such file or folder", "did you mean 'full.txt'?"),
    "in another folder": ("validate scenes/full.txt", "scenes/full.txt: error: no such", ""),
    "quiet and verbose": ("validate SCENE -q -v", "--quiet and --verbose exclude each other", "see `whitted"),
    "nothing to open": ("validate SCENE --open", "--open opens a report, and there is none", "--report DIR --open"),
    "no curves to open": ("stability --open", "--open opens a report, and there is none", "--report DIR --open"),
    "JUnit to -": ("validate SCENE --junit -", "'-' is not the name of a file to write", "name a file"),
    "Markdown folder": ("check SCENE --image x.ppm --markdown no/x.md", "there is no folder no", "mkdir -p no"),
    "json folder": ("validate SCENE --json no/where.json", "there is no folder no", "mkdir -p no"),
    "render ending": ("render SCENE -o x.jpg", "unknown file ending '.jpg'", "expected .exr, .npz, .png or .ppm"),
    "render folder": ("render SCENE -o no/x.png", "there is no folder no", "mkdir -p no"),
    "render scene": ("render nowhere.txt -o x.png", "nowhere.txt: error: no such file or folder", ""),
    "render pass": ("render SCENE -o x.npz --passes dephth", "unknown pass 'dephth'", "did you mean 'depth'?"),
    "render light": (
        "render SCENE -o x.npz --passes shadow.L7",
        "native-f64 has no pass 'shadow.L7'",
        "shadow.L0, shadow.L1",
    ),
    "render no beauty": ("render SCENE -o x.png --passes depth", "would hold the pass 'beauty'", "write .exr or .npz"),
    "render no renderer": (
        "render SCENE -o x.npz --renderer numpy",
        "unknown renderer 'numpy'",
        "did you mean 'numpy-f",
    ),
    "render no output": ("render SCENE", "missing option '-o' / '--output'", "see `whitted render --help`"),
    "convert target": ("convert SCENE --to blender -o x", "'blender' is not", "see `whitted convert --help`"),
    "compare no file": ("compare a.npz b.npz", "a.npz: no such file", ""),
    "compare ending": ("compare SCENE SCENE", "unknown file ending '.txt'", "expected .exr, .npz, .png or .ppm"),
    "tolerance": ("compare a.npz b.npz --tolerance -1", "-1.0 is not a finite number from 0 on", "see `whitted"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_in_one_sentence_with_a_hint(
    case: str, run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words, message, hint = WRONG[case]
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    result = run(*words.replace("SCENE", str(scene)).split())
    assert (result.status, result.out) == (2, "")
    lines = result.err.rstrip("\n").split("\n")
    assert message in lines[0]
    assert "error: " in lines[0]
    assert len(lines) == (2 if hint else 1)
    if hint:
        assert lines[1].startswith("  hint: ")
        assert hint in lines[1]
    assert sorted(tmp_path.rglob("*")) == before, "nothing is written"


@pytest.mark.parametrize(
    "words", ["validate SCENE", "render SCENE -o x.npz", "renderers", "convert SCENE --to mitsuba -o x.xml"]
)
def test_an_instruction_set_that_is_not_there(
    words: str, run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WHITTED_ISA", "mmx")
    result = run(*[scene if word == "SCENE" else word for word in words.split()])
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("error: WHITTED_ISA is 'mmx', but here it can be one of ")
    assert result.err.endswith("\n  hint: unset WHITTED_ISA to use the best one\n")


def test_the_samples_are_those_of_the_renderers() -> None:
    assert options.SAMPLES == SAMPLES
    assert tuple(QUANTISATIONS) == options.QUANTISATIONS
    assert options.MOST_THREADS == _native.MOST_THREADS
    assert f"more than {inputs.LONGEST_SIDE} columns" in options.NO_LIMITS
    assert options.MOST_VERDICTS == MOST_VERDICTS


def test_help_and_version_import_nothing_heavy() -> None:
    code = (
        "import sys\nfrom validation.cli import main\n"
        "try:\n    main({arguments})\nfinally:\n    print('LOADED', *sys.modules, file=sys.stderr)"
    )
    for arguments in (["--help"], ["--version"], ["validate", "--help"]):
        done = subprocess.run(
            [sys.executable, "-c", code.format(arguments=arguments)],
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        loaded = set(done.stderr.partition("LOADED")[2].split())
        assert "click" in loaded
        heavy = {"numpy", "rich", "jinja2", "matplotlib", "PIL", "colour", "scipy", "mitsuba", "tracer", "OpenEXR"}
        assert not heavy & loaded


def test_help_names_every_command() -> None:
    done = whitted("--help")
    assert done.returncode == 0
    for command in ("validate", "renderers", "render", "convert", "compare"):
        assert f"  {command} " in done.stdout


def test_version() -> None:
    assert whitted("--version").stdout == f"whitted {importlib.metadata.version('whitted')}\n"


@pytest.fixture
def endless(tmp_path: Path) -> Path:
    """A scene that takes minutes to draw and to compare."""
    path = tmp_path / "endless.txt"
    path.write_text(doubles.FULL.replace("RES 64 48", "RES 4000 3000"))
    return path


def test_interrupted_it_ends_with_130_and_no_traceback(endless: Path, tmp_path: Path) -> None:
    code = "import sys; from validation.cli import main; print('started', flush=True); main()"
    words = ["validate", str(endless), "--renderer", "numpy-f64", "--against", "numpy-f32", "--no-limits"]
    words += ["--json", str(tmp_path / "r.json")]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        time.sleep(2)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.strip() == "interrupted: nothing was finished, nothing was written"
    assert not (tmp_path / "r.json").exists()


def test_a_closed_pipe_is_no_error(scene: Path) -> None:
    code = "from validation.cli import main; main()"
    words = f"{sys.executable} -c '{code}' validate {scene} --renderer native-f64 --against numpy-f64 | true"
    done = subprocess.run(["bash", "-c", words], capture_output=True, text=True, check=False, timeout=60)
    assert done.stderr == ""


@pytest.mark.parametrize("words", ["validate {} --renderer native-f32 --against numpy-f64", "render {} -o x.npz"])
def test_a_scene_that_float32_does_not_hold_is_wrong_input(
    words: str, run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    far = far_away(tmp_path)
    extra = () if "validate" in words else ("--renderer", "native-f32")
    result = run(*words.format(far).split(), *extra)
    assert result.status == 2
    assert result.err == (
        f"{far}: error: SPHERE: found '1e+20' for 'pos x' of spheres[0], expected a magnitude from 1e-15 to 1e15 "
        "in float32\n  hint: render it in float64\n"
    )


@pytest.mark.mitsuba
def test_why_a_renderer_cannot_carry_a_scene(run: Any, tmp_path: Path, need: Any) -> None:
    need(importlib.util.find_spec("mitsuba"), "no Mitsuba: pip install mitsuba")
    far = far_away(tmp_path)
    validated = run("validate", far, "--against", "mitsuba-spec@scalar")
    assert validated.status == 3
    assert "cannot carry this scene (it has numbers outside 1e-15 to 1e+15" in validated.out
    assert "nothing was compared" in validated.out
    rendered = run("render", far, "-o", tmp_path / "x.npz", "--renderer", "mitsuba-spec@scalar")
    assert rendered.status == 3
    assert f"cannot carry the scene {far}: it has numbers outside 1e-15 to 1e+15" in rendered.err


def leaves(*_: Any) -> Passes:
    sys.exit(0)


@pytest.mark.parametrize(
    ("draw", "reason"),
    [(lambda *_: None, "it returned NoneType, expected Passes"), (leaves, "SystemExit: 0")],
    ids=["nothing", "the end"],
)
def test_a_renderer_that_returns_nothing_or_ends_the_program(
    draw: Any, reason: str, run: Any, scene: Path, tmp_path: Path, registered: Any
) -> None:
    registered(Double(name="odd", draw=draw))
    validated = run("validate", scene, "--renderer", "native-f64", "--against", "odd")
    assert (validated.status, validated.err) == (3, f"error: {scene}: odd: failed: {reason}\n")
    assert "nothing was compared, 1 failure" in validated.out
    rendered = run("render", scene, "-o", tmp_path / "x.npz", "--renderer", "odd")
    assert (rendered.status, rendered.err) == (3, f"error: odd failed: {reason}\n")


def test_without_a_command_the_help_is_shown(run: Any) -> None:
    result = run()
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("Usage: whitted [OPTIONS] COMMAND")


@pytest.mark.parametrize("words", ["validate {} --size 8x6 --renderer native-f64 --against numpy-f64", "renderers"])
def test_a_reader_that_has_gone_is_no_difference(words: str, scene: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "validation", *words.format(scene).split()],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=60,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (128 + 13, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    "words", ["validate {} --size 8x6 --renderer native-f64 --against numpy-f64", "renderers", "--help"]
)
def test_output_that_cannot_be_written(words: str, scene: Path) -> None:
    command = f"{sys.executable} -m validation {words.format(scene)}"
    expected = {
        ">/dev/full": "error: standard output: No space left on device\n  hint: send it elsewhere\n",
        ">&-": "error: standard output is closed\n  hint: send it to a file or to /dev/null\n",
    }
    for redirection, message in expected.items():
        done = subprocess.run(
            ["bash", "-c", command + redirection], stderr=subprocess.PIPE, text=True, check=False, timeout=60
        )
        assert (done.returncode, done.stderr) == (2, message)


def test_interrupted_while_it_is_imported(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    class Interrupted:
        def __getattr__(self, name: str) -> Any:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "validation.cli", Interrupted())
    with pytest.raises(SystemExit) as exit_info:
        program.main()
    assert exit_info.value.code == 130
    assert capfd.readouterr().err == "interrupted\n"


@pytest.mark.parametrize(
    "words",
    [
        "validate - --renderer native-f64 --against numpy-f64 --size 8x6",
        "render - -o x.npz --size 8x6",
        pytest.param("convert - --to mitsuba -o x.xml", marks=pytest.mark.mitsuba),
    ],
)
def test_a_scene_from_standard_input(words: str, tmp_path: Path) -> None:
    if "convert" in words:
        pytest.importorskip("mitsuba")
    done = whitted(*words.split(), input=doubles.FULL, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "validate" not in words or "<stdin> 8x6" in done.stdout
    wrong = whitted(*words.split(), input="NEAR x", cwd=tmp_path)
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("<stdin>:1:6: error: NEAR: found 'x'")


def test_the_place_of_errors_is_the_file_whatever_its_name(run: Any, tmp_path: Path) -> None:
    text = tmp_path / "odd: error: name.txt"
    text.write_text("once upon a time\n" * 30)
    result = run("validate", text, *NATIVE)
    assert result.err.splitlines()[-1].startswith(f"{text}: error: and ")


def test_a_scene_with_a_duplicate_warns_on_stderr_once(run: Any, tmp_path: Path) -> None:
    ball = "SPHERE shell 0.1 0.2 -3 1.5 1.5 1.5 0.9 0.7 0.2 0.3 0.7 0.2 0 5\n"
    twice = tmp_path / "twice.txt"
    twice.write_text(doubles.CUT.replace(ball, ball * 2))
    result = run("validate", twice, *NATIVE)
    assert result.status == 0
    assert result.err.startswith(f"{twice}:8:1: warning: ")
    assert result.err.count("warning: ") == 1
    assert "Warning" not in result.err, "in words, not as Python prints it"
