"""Any program as a renderer: what it may write and where, and that each way to go wrong is told apart."""

from __future__ import annotations

import os
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import doubles
import numpy as np
import pytest

import tracer
from tracer import Passes, Scene
from tracer.passes import quantise
from validation import Settings, renderers
from validation.renderers.command import MEBIBYTE, Command, Limits, TemplateError
from validation.run import RendererError, draw

COLUMNS, ROWS = 3, 2
LEVELS = np.arange(3 * COLUMNS * ROWS).reshape(ROWS, COLUMNS, 3)

#: What the programs of these tests begin with.
BEGIN = """
import os, signal, subprocess, sys, time
from pathlib import Path
scene = next(Path(word) for word in sys.argv[1:] if word.endswith("scene.txt"))
output = next(line.split()[1] for line in scene.read_text().splitlines() if line.startswith("OUTPUT"))
image = b"P6 3 2 255\\n" + bytes(range(18))
"""
WRITE = "Path(output).write_bytes(image)\n"

Draw = Callable[..., Passes]
Fail = Callable[..., str]


@pytest.fixture
def scene() -> Scene:
    view = tracer.View(near=1, left=-1, right=1, bottom=-1, top=1, columns=COLUMNS, rows=ROWS)
    return Scene(view=view, output="some/where/picture.ppm")


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of temporary folders: empty again after every test."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


@pytest.fixture
def command(tmp_path: Path) -> Callable[..., Command]:
    """A program in Python behind the face of a renderer."""

    def make(body: str, words: str = "{scene}", limits: Limits | None = None, name: str = "mine.py") -> Command:
        path = tmp_path / name
        path.write_text(BEGIN + body)
        return Command(f"cmd:{sys.executable} -I -S {shlex.quote(str(path))} {words}", limits)

    return make


@pytest.fixture
def drawn(command: Callable[..., Command], scene: Scene, temporary: Path) -> Draw:
    """What a program in Python draws."""
    del temporary

    def run(body: str, *arguments: object, **options: object) -> Passes:
        return draw(command(body, *arguments, **options), "scene", scene, ("beauty",), Settings())

    return run


@pytest.fixture
def finding(drawn: Draw) -> Fail:
    """What is said about a program that goes wrong."""

    def run(body: str, *arguments: object, **options: object) -> str:
        with pytest.raises(RendererError) as caught:
            drawn(body, *arguments, **options)
        return str(caught.value)

    return run


def right(passes: Passes, steps: int = 255) -> None:
    assert list(passes) == ["beauty"]
    assert passes["beauty"].dtype == np.float64
    assert np.array_equal(np.rint(passes["beauty"] * steps), LEVELS)


def wait_for(path: Path) -> str:
    """The content of a file that another process will write."""
    deadline = time.monotonic() + 20
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return path.read_text()


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended, and nobody has asked how, does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


def ends(pid: int) -> bool:
    deadline = time.monotonic() + 5
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not alive(pid)


class TestImages:
    @pytest.mark.parametrize(
        ("body", "words"),
        [
            (WRITE, "{scene}"),
            ("scene.with_name(output).write_bytes(image)", "{scene}"),
            ("print('drawing'); " + WRITE, "{scene}"),
            ("sys.stdout.buffer.write(image)", "{scene}"),
            ("Path(sys.argv[2]).write_bytes(image)", "{scene} {output}"),
            ("Path(sys.argv[1].removeprefix('-o')).write_bytes(image)", "-o{output} {scene}"),
            ("Path(sys.argv[2]).write_bytes(image); sys.stdout.buffer.write(b'P6 1 1 255 ...')", "{scene} {output}"),
            (WRITE + "sys.stdout.buffer.write(image)", "{scene}"),
        ],
    )
    def test_wherever_it_is_written(self, drawn: Draw, body: str, words: str) -> None:
        right(drawn(body, words))

    def test_ppm_as_text(self, drawn: Draw) -> None:
        right(drawn("Path(output).write_text('P3\\n3 2\\n255\\n' + ' '.join(map(str, range(18))))"))

    def test_png(self, drawn: Draw, tmp_path: Path) -> None:
        Passes({"beauty": (LEVELS + 0.5) / 255}).save(tmp_path / "drawn.png")
        right(drawn(f"import shutil; shutil.copy({str(tmp_path / 'drawn.png')!r}, output)"))

    def test_the_number_of_levels_is_that_of_the_image(
        self, command: Callable[..., Command], scene: Scene, temporary: Path
    ) -> None:
        del temporary
        deep = "bytes(byte for level in range(18) for byte in (0, level))"
        renderer = command(f"Path(output).write_bytes(b'P6 3 2 65535 ' + {deep})")
        assert (renderer.encoding.quantisation, renderer.encoding.steps) == ("truncate", 255)
        passes = draw(renderer, "", scene, ("beauty",), Settings())
        right(passes, 65535)
        # Said with the passes, as one renderer may draw several images.
        assert passes.metadata["levels"] == "65535"

    @pytest.mark.parametrize(
        ("name", "plain"),
        [("/tmp/a/b.ppm", "b.ppm"), ("../b.png", "b.png"), ("test-1_2.ppm", "test-1_2.ppm")]
        + [(name, "image.ppm") for name in ("-", "..", "/", "scene.txt", "a;b", "\u7403.ppm", "x" * 200, "-o", ".b")],
    )
    def test_the_scene_names_a_plain_file(
        self, command: Callable[..., Command], scene: Scene, temporary: Path, name: str, plain: str
    ) -> None:
        del temporary
        renderer = command(f"assert output == {plain!r}, output\n{WRITE}")
        right(draw(renderer, "", scene.replace(output=name), ("beauty",), Settings()))

    def test_the_scene_is_the_one_to_draw(self, drawn: Draw, scene: Scene, tmp_path: Path) -> None:
        right(drawn(f"{WRITE}Path({str(tmp_path / 'copy')!r}).write_text(scene.read_text())"))
        assert tracer.loads((tmp_path / "copy").read_text()) == scene.replace(output="picture.ppm")

    def test_our_own_program(self, root: Path, temporary: Path) -> None:
        del temporary
        scene = tracer.load(root / "scenes" / "gallery" / "mirrors.txt")
        program = Command(f"cmd:{Path(sys.executable).parent / 'raytrace'} {{scene}}")
        beauty = draw(program, "", scene, ("beauty",), Settings())["beauty"]
        native = renderers.get("native-f64").render(scene, ("beauty",), Settings())["beauty"]
        assert np.array_equal(np.rint(beauty * 255), quantise(native))
        assert np.array_equal(np.rint(beauty * 255), program.encoding.encode(native))

    def test_where_it_runs(
        self, drawn: Draw, temporary: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
    ) -> None:
        monkeypatch.setenv("OF_THE_USER", "kept")
        # What the user types is not for the program.
        typed, types = os.pipe()
        os.write(types, b"typed")
        os.close(types)
        ours = os.dup(0)
        os.dup2(typed, 0)
        os.close(typed)
        request.addfinalizer(lambda: os.close(ours))
        request.addfinalizer(lambda: os.dup2(ours, 0))
        right(
            drawn(f"""
assert Path.cwd().is_relative_to({str(temporary)!r}) and os.listdir() == ["scene.txt"]
assert os.environ["OF_THE_USER"] == "kept" and sys.stdin.read() == ""
assert os.getsid(0) == os.getpgid(0) == os.getpid()
assert sorted(os.listdir("/proc/self/fd"), key=int)[:-1] == ["0", "1", "2"]
{WRITE}""")
        )

    def test_signals_are_as_they_were(self, scene: Scene, temporary: Path) -> None:
        # Python ignores two, which a program that it becomes would inherit.
        del temporary
        shell = Command("cmd:/bin/sh -c 'grep SigIgn /proc/self/status >&2; exit 1' {scene}")
        with pytest.raises(RendererError) as caught:
            draw(shell, "", scene, ("beauty",), Settings())
        ignored = int(str(caught.value).split("SigIgn:")[1].split()[0], 16)
        assert not ignored & (1 << signal.SIGPIPE - 1 | 1 << signal.SIGXFSZ - 1)


def test_validate_points_to_check_where_conventions_may_differ(run: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.txt"
    path.write_text(doubles.FULL, encoding="utf-8")
    command = f"cmd:{shlex.quote(str(Path(sys.executable).parent / 'raytrace'))} {{scene}} --sample center"
    arguments = ("validate", path, "--renderer", command, "--against", "native-f64", "--passes", "beauty")
    told = run(*arguments, "--verdicts", "0")
    assert told.status == 1
    assert "`whitted check` finds how it was made" in told.out
    assert "whitted check" not in run(*arguments, "--sample", "center").out


class TestCommands:
    @pytest.mark.parametrize(
        ("template", "message", "hint"),
        [
            ("", "is empty", "for example"),
            ("  ", "is empty", "for example"),
            ("'' {scene}", "is empty", "for example"),
            ("./mine", "lacks {scene}", "for example"),
            ("./mine {output}", "lacks {scene}", "for example"),
            ("./mine {scene} '", "no closing quotation", "quotes come in pairs"),
            ("./mine {scene} \\", "no escaped character", "quotes come in pairs"),
            ("./mine {scene} {image}", "unknown placeholder '{image}'", "{output}, the image"),
            ("./mine { scene }", "unknown placeholder '{ scene }'", "{scene}, the scene file"),
            ("{scene} {output}", "begins with '{scene}', expected a program", "for example"),
            ("./mine {scene} \0", "zero byte", "for example"),
        ],
    )
    def test_those_that_cannot_be(self, template: str, message: str, hint: str) -> None:
        with pytest.raises(TemplateError) as caught:
            Command(f"cmd:{template}")
        assert message in str(caught.value)
        assert hint in caught.value.hint
        assert isinstance(caught.value, ValueError)

    def test_no_shell(self, drawn: Draw, tmp_path: Path) -> None:
        told = tmp_path / "told"
        words = "{scene} '$HOME' '*' ';' '|' 'two words' \"it's\" '' ~nobody-of-that-name {"
        right(drawn(f"Path({str(told)!r}).write_text(repr(sys.argv[2:]));{WRITE}", words))
        expected = ["$HOME", "*", ";", "|", "two words", "it's", "", "~nobody-of-that-name", "{"]
        assert told.read_text() == repr(expected)

    @pytest.mark.parametrize("shell", ["cd a; ./mine {scene}", "./mine {scene} > {output}", "./mine {scene} | cat"])
    def test_what_only_a_shell_understands_is_refused(self, shell: str) -> None:
        with pytest.raises(TemplateError, match="means nothing here: there is no shell") as raised:
            Command(f"cmd:{shell}")
        assert raised.value.hint == "name a script that does all of it"

    def test_names_with_blanks_and_quotes(
        self, scene: Scene, tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        del temporary
        folder = tmp_path / "my programs"
        folder.mkdir()
        program = folder / 'it\'s "mine"'
        program.write_text(f"#!{sys.executable}\n{BEGIN}{WRITE}")
        program.chmod(0o755)
        monkeypatch.chdir(folder)
        for words in (str(program), f"./{program.name}", f"../my programs/{program.name}"):
            right(draw(Command(f"cmd:{shlex.quote(words)} {{scene}}"), "", scene, ("beauty",), Settings()))
        monkeypatch.setenv("HOME", str(folder))
        right(draw(Command("cmd:~/it\\'s\\ '\"mine\"' {scene}"), "", scene, ("beauty",), Settings()))

    def test_words_that_name_files_from_where_the_user_is(
        self,
        command: Callable[..., Command],
        scene: Scene,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        temporary: Path,
    ) -> None:
        del temporary
        (tmp_path / "data").mkdir()
        (tmp_path / "data" / "colours").write_text("")
        monkeypatch.chdir(tmp_path)
        body = f"Path({str(tmp_path / 'told')!r}).write_text(repr(sys.argv[2:]))\n{WRITE}"
        renderer = command(body, f"{{scene}} data data/colours nothing {'x' * 300} --in=data ~")
        monkeypatch.chdir("/")
        monkeypatch.setenv("HOME", str(tmp_path))
        right(draw(renderer, "", scene, ("beauty",), Settings()))
        places = [str(tmp_path / "data"), str(tmp_path / "data" / "colours")]
        told = (tmp_path / "told").read_text()
        assert told == repr([*places, "nothing", "x" * 300, "--in=data", str(tmp_path)])

    def test_on_the_path(self, scene: Scene, tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        del temporary
        program = tmp_path / "a-tracer"
        program.write_text(f"#!{sys.executable}\n{BEGIN}{WRITE}")
        program.chmod(0o755)
        monkeypatch.chdir(tmp_path)
        renderer = Command("cmd:a-tracer {scene}")
        assert (
            renderer.unavailable() == "there is no program 'a-tracer' on the PATH: ./a-tracer is the one in this folder"
        )
        for path in (str(tmp_path), "."):
            monkeypatch.setenv("PATH", f"/nowhere:{path}:{os.environ['PATH']}")
            assert renderer.unavailable() is None
            right(draw(renderer, "", scene, ("beauty",), Settings()))

    def test_what_it_says_of_itself(self, command: Callable[..., Command], scene: Scene, tmp_path: Path) -> None:
        renderer = command(WRITE)
        assert isinstance(renderer, renderers.Renderer)
        assert renderer.passes(scene, Settings()) == ("beauty",)
        assert renderer.max_pixels(scene, ("beauty",)) is None
        assert (
            renderer.uncertainty(scene, Settings()).unit
            == renderers.get("native-f32").uncertainty(scene, Settings()).unit
        )
        before = renderer.versions()
        assert before["command"] == renderer.template
        assert renderer.version() == before["sha256"]
        assert len(before["sha256"]) == 16
        (tmp_path / "mine.py").write_text("")
        after = renderer.versions()
        assert {key for key in after if after[key] != before[key]} == {f"sha256 of {tmp_path / 'mine.py'}"}
        assert Command("cmd:no-such-program {scene}").version() == "unknown"

    def test_no_other_pass(self, command: Callable[..., Command], scene: Scene) -> None:
        with pytest.raises(RendererError, match="no pass 'depth'"):
            command(WRITE).render(scene, ("beauty", "depth"), Settings())


class TestStart:
    def start(self, scene: Scene, name: str) -> str:
        renderer = Command(f"cmd:{shlex.quote(name)} {{scene}}")
        with pytest.raises(RendererError) as caught:
            draw(renderer, "", scene, ("beauty",), Settings())
        if reason := renderer.unavailable():
            assert str(caught.value) == f"cannot be started: {reason}"
        return str(caught.value)

    def test_there_is_none(self, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        assert self.start(scene, "./mine").endswith(f"there is no program './mine' in {tmp_path}")
        assert self.start(scene, "/no/such").endswith("there is no program '/no/such'")
        assert self.start(scene, "no-such").endswith("there is no program 'no-such' on the PATH")
        assert self.start(scene, f"./{'x' * 300}").endswith(f" in {tmp_path}")
        assert self.start(scene, "../").endswith("'../' is a folder, not a program")

    def test_it_cannot_be_run(
        self, scene: Scene, tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        del temporary
        monkeypatch.chdir(tmp_path)
        program = tmp_path / "my tracer"
        program.write_text("print()")
        assert self.start(scene, "./my tracer").endswith("'./my tracer' is not executable: chmod +x './my tracer'")
        program.chmod(0o755)
        assert "its file is no program for this machine" in self.start(scene, "./my tracer")
        program.write_text("#!/no/such/interpreter\n")
        assert "what its file needs to run is not there" in self.start(scene, "./my tracer")


class TestEnd:
    @pytest.mark.parametrize(
        ("number", "text"),
        [
            (signal.SIGSEGV, "crashed: SIGSEGV (segmentation fault)"),
            (signal.SIGABRT, "crashed: SIGABRT (aborted)"),
            (signal.SIGFPE, "crashed: SIGFPE (floating point exception)"),
            (signal.SIGKILL, "was ended by SIGKILL (killed)"),
            (signal.SIGPIPE, "was ended by SIGPIPE (broken pipe)"),
            (signal.SIGRTMIN + 3, f"was ended by signal {signal.SIGRTMIN + 3}"),
        ],
    )
    def test_by_a_signal(self, finding: Fail, number: int, text: str) -> None:
        body = f"signal.signal({number}, signal.SIG_DFL) if {number} != 9 else 0; os.kill(os.getpid(), {number})"
        told = finding(f"print('row 7', file=sys.stderr, flush=True)\n{body}")
        assert told.startswith(f"{text}\n  stderr: row 7")
        assert "memory" not in told
        assert finding(WRITE + body).startswith(f"{text}, though its image is whole")

    def test_by_a_status(self, finding: Fail) -> None:
        assert finding("sys.exit(3)").startswith("ended with exit status 3\n  hint: ")
        assert finding(WRITE + "sys.exit(1)").startswith("ended with exit status 1, though its image is whole\n")
        assert "exit status 139, which a shell returns for SIGSEGV (segmentation fault)" in finding("os._exit(139)")
        assert "which a shell" not in finding("os._exit(255)")

    def test_the_last_lines_of_stderr(self, finding: Fail) -> None:
        told = finding("""
for k in range(100_000):
    print("line", k, file=sys.stderr)
print("\\033[31mred\\a\\t" + "x" * 1000, file=sys.stderr)
sys.stderr.flush()
sys.stderr.buffer.write(b"\\xff\\n\\n")
sys.exit(1)
""")
        lines = told.splitlines()
        assert lines[0] == "ended with exit status 1"
        assert lines[1:7] == [f"  stderr: line {k}" for k in range(99_994, 100_000)]
        assert lines[7].startswith("  stderr: ?[31mred? xxx")
        assert len(lines[7]) < 250
        assert lines[8] == "  stderr: \ufffd"
        assert lines[9].startswith("  hint: ")

    def test_too_late_with_all_that_it_started(self, finding: Fail, tmp_path: Path) -> None:
        began = time.monotonic()
        told = finding(
            f"""
signal.signal(signal.SIGTERM, signal.SIG_IGN)
if os.fork() == 0:
    Path({str(tmp_path / "pid")!r}).write_text(str(os.getpid()))
    while True:
        time.sleep(0.01)
        try:
            Path("more").write_bytes(b"more")
        except OSError:
            continue
{WRITE}
time.sleep(100)
""",
            limits=Limits(seconds=0.5),
        )
        assert told.startswith("took longer than 0.5 s, though its image is whole\n")
        assert time.monotonic() - began < 10
        assert ends(int((tmp_path / "pid").read_text()))

    def test_what_it_leaves_running_is_ended(self, drawn: Draw, tmp_path: Path) -> None:
        right(
            drawn(f"""
if os.fork() == 0:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    Path({str(tmp_path / "pid")!r}).write_text(str(os.getpid()))
    time.sleep(100)
while not Path({str(tmp_path / "pid")!r}).exists():
    time.sleep(0.01)
{WRITE}""")
        )
        assert ends(int((tmp_path / "pid").read_text()))

    def test_memory(self, finding: Fail) -> None:
        limits = Limits(memory=256 * MEBIBYTE)
        told = finding("hog = bytes(1 << 30)", limits=limits)
        assert told.startswith(
            "ended with exit status 1, probably for want of memory: the limit is 256 MiB\n  stderr: Traceback"
        )
        assert "  stderr: MemoryError" in told
        # Where it fits, nothing is said.
        assert "memory" not in finding("hog = bytes(1 << 27); sys.exit(1)", limits=limits)

    def test_memory_without_a_word(self, scene: Scene, tmp_path: Path) -> None:
        # A new process counts the memory of the one that started it: so that one has to be small, and is: a shell.
        (tmp_path / "hog.py").write_text("hog = bytearray(b'x') * (520 << 20)\nimport os\nos.abort()\n")
        (tmp_path / "scene.txt").write_text(scene.text())
        code = f"""
import tracer
from validation import Settings
from validation.renderers.command import Command, Limits
mine = Command("cmd:{sys.executable} -I -S hog.py {{scene}}", Limits(memory=600 << 20))
mine.render(tracer.load("scene.txt"), ("beauty",), Settings())
"""
        words = ["sh", "-c", '"$0" -c "$1"; true', sys.executable, code]
        ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert "crashed: SIGABRT (aborted), probably for want of memory: the limit is 600 MiB" in ended.stderr

    @pytest.mark.parametrize("default", [False, True])
    @pytest.mark.parametrize(
        ("where", "body"),
        [
            ("its stdout", "signal.signal(signal.SIGXFSZ, signal.SIG_DFL)\nwhile True: os.write(1, bytes(1 << 20))"),
            ("its stderr", "while True: os.write(2, b'x' * (1 << 20))"),
            ("picture.ppm", "open(output, 'wb').write(bytes(1 << 28))"),
            ("picture.ppm", "open(output, 'wb').truncate(1 << 40)"),
        ],
    )
    def test_too_much(self, finding: Fail, where: str, body: str, default: bool) -> None:
        limits = None if default else Limits(file=MEBIBYTE)
        told = finding(body, limits=limits)
        place = "a file" if "truncate" in body else where
        limit = "64 MiB" if default else "1 MiB"
        assert told.startswith(f"wrote too much: {place} reached the limit of {limit}")

    def test_no_core_is_dumped(self, finding: Fail) -> None:
        before = resource.getrlimit(resource.RLIMIT_CORE)
        resource.setrlimit(resource.RLIMIT_CORE, (before[1], before[1]))
        try:
            told = finding("import resource; print(resource.getrlimit(resource.RLIMIT_CORE)); ")
        finally:
            resource.setrlimit(resource.RLIMIT_CORE, before)
        assert "stdout begins with '(0, 0) '" in told

    def test_the_limit_grows_with_the_image(self, scene: Scene) -> None:
        assert Limits().size(scene) == 64 * MEBIBYTE
        large = scene.replace(view=scene.view.replace(columns=4000, rows=3000))
        assert Limits().size(large) > 4 * len("65535 ") * 3 * 4000 * 3000 // 2
        assert Limits(file=7).size(large) == 7


class TestNoImage:
    def test_none(self, finding: Fail) -> None:
        assert finding("").startswith(
            "wrote no image: no picture.ppm, as OUTPUT says, and none to stdout\n"
            "  hint: it has to write the file that OUTPUT names"
        )
        assert finding("", "{scene} {output}").startswith("wrote no image: no picture.ppm, as {output} says\n")

    def test_others_are_named(self, finding: Fail) -> None:
        told = finding(
            "os.mkdir('out'); Path('out/a\\033.ppm').write_bytes(image); Path('z').touch(); print('Done\\a')"
        )
        assert "; it wrote z (0 bytes), out/a?.ppm (29 bytes); its stdout begins with 'Done? '" in told
        told = finding("for k in range(15): Path(f'{k:02}.ppm').touch()")
        assert "09.ppm (0 bytes) and 5 more\n" in told

    def test_elsewhere_than_asked(self, finding: Fail) -> None:
        told = finding("sys.stdout.buffer.write(image)", "{scene} {output}")
        assert told.endswith("hint: leave out {output}, and the image is taken from stdout")

    def test_two(self, finding: Fail) -> None:
        told = finding(WRITE + "sys.stdout.buffer.write(image[:-1] + b'x')")
        assert told.startswith("wrote two different images, picture.ppm and one to stdout\n  hint: {output}")

    def test_one_that_is_wrong(self, finding: Fail) -> None:
        told = finding("Path(output).write_bytes(b'P6 2 3 255 ' + bytes(18))")
        assert told == (
            "picture.ppm: the image is 2x3, the scene asks for 3x2\n"
            "  hint: columns and rows are swapped: columns come first"
        )
        told = finding("sys.stdout.buffer.write(image[:-1]); print('careful', file=sys.stderr)")
        assert told.startswith("stdout: it ends after pixel 5 of 6\n  stderr: careful\n  hint: ")
        assert finding("sys.stdout.buffer.write(b'BM' + bytes(70))").startswith("stdout: it is BMP")
        assert finding("Path(output).touch()").startswith("picture.ppm: it is empty")

    @pytest.mark.parametrize(
        ("body", "text"),
        [
            ("os.mkdir(output)", "picture.ppm is no regular file"),
            ("os.mkfifo(output)", "picture.ppm is no regular file"),
            ("os.symlink('/dev/zero', output)", "picture.ppm is no regular file"),
            ("os.symlink(output, output)", "picture.ppm cannot be read: too many levels of symbolic links"),
        ],
    )
    def test_no_file(self, finding: Fail, body: str, text: str) -> None:
        assert finding(body).startswith(text)


class TestAfterwards:
    """The fixture `temporary` sees that nothing is left."""

    def test_folders_that_cannot_be_entered(self, drawn: Draw) -> None:
        right(drawn(f"{WRITE}os.makedirs('a/b/c'); os.symlink('/', 'root'); os.chmod('a/b', 0); os.chmod('a', 0)"))

    def test_interrupted(self, scene: Scene, tmp_path: Path, temporary: Path) -> None:
        pids = tmp_path / "pids"
        (tmp_path / "slow.py").write_text(
            "import os, pathlib, signal, time\n"
            "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
            "child = os.fork()\n"
            f"child and pathlib.Path({str(pids)!r}).write_text(f'{{os.getpid()}} {{child}}')\n"
            "time.sleep(100)\n"
        )
        (tmp_path / "scene.txt").write_text(scene.text())
        code = f"""
import tracer
from validation import Settings
from validation.renderers.command import Command
mine = Command("cmd:{sys.executable} -I -S slow.py {{scene}}")
mine.render(tracer.load("scene.txt"), ("beauty",), Settings())
"""
        environment = {**os.environ, "TMPDIR": str(temporary)}
        ours = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, env=environment, stderr=subprocess.PIPE)
        program, child = map(int, wait_for(pids).split())
        assert len(list(temporary.iterdir())) == 1
        ours.send_signal(signal.SIGINT)
        assert b"KeyboardInterrupt" in ours.communicate(timeout=20)[1]
        assert ends(program)
        assert ends(child)

    @pytest.mark.parametrize(
        "words",
        [
            "validate scene.txt --against native-f64 --renderer",
            "explain scene.txt 1 1 --renderer",
            "stability --ladder speck --jobs 1 --renderer",
            "stability --fuzz 9 --jobs 1 --renderer",
            "speed scene.txt --size 8x8 --pixels 4 --edges 1 --renderer",
            "truth scene.txt --size 8x8 --pixels 4 --edges 1 --renderer",
            "render scene.txt -o x.ppm --renderer",
            "check scene.txt --command",
        ],
    )
    @pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
    def test_a_program_ends_with_every_command(
        self, words: str, number: signal.Signals, status: int, scene: Scene, tmp_path: Path
    ) -> None:
        """Even with Ctrl-C again and again, as people do."""
        temporary, pids = tmp_path / "temporary", tmp_path / "pids"
        temporary.mkdir()
        (tmp_path / "scene.txt").write_text(scene.text())
        (tmp_path / "slow.py").write_text(
            f"import os, time\nopen({str(pids)!r}, 'w').write(f'{{os.getpid()}}\\n')\ntime.sleep(600)\n"
        )
        mine = f"{sys.executable} -I -S slow.py {{scene}}"
        code = "from validation.cli import main; main()"
        ours = subprocess.Popen(
            [sys.executable, "-c", code, *words.split(), mine if "check" in words else f"cmd:{mine}"],
            cwd=tmp_path,
            env={**os.environ, "TMPDIR": str(temporary)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        program = int(wait_for(pids))
        for _ in range(3):
            ours.send_signal(number)
        err = ours.communicate(timeout=30)[1].decode()
        assert (ours.returncode, "Traceback" in err) == (status, False), err
        assert ends(program)
        assert not list(temporary.iterdir())

    def test_two_at_the_same_time(
        self, command: Callable[..., Command], scene: Scene, tmp_path: Path, temporary: Path
    ) -> None:
        del temporary
        body = f"""
here, there = (Path({str(tmp_path)!r}, name) for name in sys.argv[2:])
here.touch()
while not there.exists():
    time.sleep(0.01)
{WRITE}"""
        both = [command(body, words) for words in ("{scene} a b", "{scene} b a")]
        with ThreadPoolExecutor(2) as pool:
            for passes in pool.map(lambda one: draw(one, "", scene, ("beauty",), Settings()), both):
                right(passes)
