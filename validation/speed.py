"""Speed against error of all renderers on the same scenes, measured side by side; docs/speed.md says how."""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
import random
import re
import select
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from tracer.passes import Passes
from validation import records, renderers
from validation.certify import Proof, prove_scene
from validation.processes import deferred, end
from validation.records import Record
from validation.renderers import Settings
from validation.renderers.mitsuba.mesh import FAMILY, MOST_SUBDIVISIONS, SUBDIVISIONS
from validation.run import Note, resized, shrink, versions
from validation.speed_errors import Errors, measure
from validation.speed_plot import Panel, Point, family_of, front
from validation.terminal import counted
from validation.timing import now
from validation.truth import UnprovedError

if TYPE_CHECKING:
    from tracer import Scene
    from validation.speed_kernels import Kernels

Progress: TypeAlias = Callable[[str], None]

#: Scenes that are measured unless some are named: those of the first two that are there, else the third.
SCENES, OTHERWISE = ("scenes/gallery/fifth.txt", "scenes/gallery/full.txt"), "scenes/gallery/shadows.txt"
#: A scene is measured with about so many pixels, unless told.
PIXELS = 400 * 400
#: Proved pixels: chosen at random, and with the smallest margins.
RANDOM, EDGES = 400, 50
ROUNDS, SECONDS, LIMIT = 15, 1.0, 160.0
LATE = "the time was up: --limit gives more"
#: A picture within a round is drawn again and again for so long, so that the clock can tell it.
BURST, MOST_IN_BURST = 0.02, 20
#: Fewer pictures than that have no quartiles.
LEAST_RUNS = 3
#: Seconds that a first picture may take.
PATIENCE = 90.0
#: Renderers whose compiler keeps what it made in a folder of the user.
CACHED = "mitsuba-"
#: Instruction sets by processor, the plainest first.
INSTRUCTION_SETS = {"x86_64": ("scalar", "sse2", "avx2", "avx512"), "aarch64": ("scalar", "neon")}


class WorkerError(Exception):
    """A process that measures has failed; the text says how."""


class LateError(WorkerError):
    """It took too long, and was ended."""


@dataclass(frozen=True)
class Entry:
    """A renderer with its settings: `isa` is the instruction set of native code, "" where there is none to choose."""

    renderer: str
    isa: str
    threads: int
    #: What was typed, where that stands for several.
    group: str = field(default="", compare=False)

    @property
    def name(self) -> str:
        """As in the table."""
        return f"{self.renderer}@{self.isa}" if self.isa else self.renderer

    @property
    def family(self) -> str:
        """What has one look in the plot."""
        return "cmd" if self.renderer.startswith("cmd:") else family_of(self.renderer)


@dataclass(frozen=True)
class Spread:
    """Seconds of several runs."""

    runs: int
    median: float
    least: float
    lower: float
    upper: float

    @staticmethod
    def of(samples: Sequence[float]) -> Spread:
        """Median, minimum and quartiles."""
        lower, _, upper = statistics.quantiles(samples, n=4, method="inclusive") if len(samples) > 1 else [*samples] * 3
        return Spread(len(samples), statistics.median(samples), min(samples), lower, upper)


@dataclass(frozen=True)
class Measured:
    """One entry on one scene. Times in seconds, memory in bytes.

    `cold`: from the start of a process to its first picture; `warm`: a picture in a process that has drawn before;
    `busy`: the processor time of that, all processors together.
    """

    entry: Entry
    size: tuple[int, int]
    cold: float
    warm: Spread
    busy: Spread
    memory: int
    errors: Errors
    front: bool = False

    @property
    def per_pixel(self) -> float:
        """Nanoseconds, of a warm picture."""
        return self.warm.median * 1e9 / (self.size[0] * self.size[1])

    @property
    def rmse(self) -> float:
        """At the random pixels; infinite where there is none that the specification settles: that is no front."""
        return math.inf if self.errors.random_rmse is None else self.errors.random_rmse

    @property
    def spread(self) -> float:
        """The standard error of that."""
        return self.errors.random_spread or 0.0

    def record(self) -> Record:
        """For JSON."""
        return {
            "name": self.entry.name,
            "renderer": self.entry.renderer,
            "instruction_set": self.entry.isa or None,
            "threads": self.entry.threads,
            "size": self.size,
            "cold": self.cold,
            "warm": asdict(self.warm),
            "busy": asdict(self.busy),
            "ns_per_pixel": self.per_pixel,
            "memory": self.memory,
            "errors": asdict(self.errors),
            "front": self.front,
        }


@dataclass
class SceneSpeed:
    """One scene with all that were measured on it, the quickest first."""

    label: str
    size: tuple[int, int]
    spheres: int
    lights: int
    measured: list[Measured] = field(default_factory=list)
    unproved: int = 0

    def record(self) -> Record:
        """For JSON."""
        return {
            "scene": self.label,
            "size": self.size,
            "spheres": self.spheres,
            "lights": self.lights,
            "unproved": self.unproved,
            "entries": [entry.record() for entry in self.measured],
            "front": [f"{m.entry.name}, {threads(m.entry.threads)}" for m in self.measured if m.front],
        }


@dataclass
class Speed:
    """What was measured, what was left out and why, and the machine."""

    settings: Settings
    options: dict[str, Any]
    scenes: list[SceneSpeed] = field(default_factory=list)
    left_out: list[Note] = field(default_factory=list)
    failures: list[Note] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)
    kernels: Kernels | None = None
    command: Sequence[str] = ()
    seconds: float = 0.0
    interrupted: bool = False

    @property
    def status(self) -> int:
        """The exit status: 0 done, 3 a renderer failed or nothing could be measured."""
        measured = any(scene.measured for scene in self.scenes) or self.kernels
        return 0 if measured and not self.failures else 3

    @property
    def progress(self) -> str:
        """How far it went."""
        return counted(sum(len(scene.measured) for scene in self.scenes), "measurement")

    def record(self) -> Record:
        """Everything as strictly valid JSON."""
        return records.result(
            "speed",
            {
                "ok": self.status == 0 and not self.interrupted,
                "interrupted": self.interrupted,
                "command": list(self.command),
                "machine": self.machine,
                "versions": self.versions,
                "settings": vars(self.settings).copy(),
                "options": dict(self.options),
                "seconds": self.seconds,
                "scenes": [scene.record() for scene in self.scenes],
                "left_out": [vars(note).copy() for note in self.left_out],
                "failures": [vars(note).copy() for note in self.failures],
                "kernels": self.kernels.record() if self.kernels else None,
            },
        )


def threads(count: int) -> str:
    """In words."""
    return counted(count, "thread")


# ---- the machine


def processors() -> list[int]:
    """Those that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def machine() -> dict[str, Any]:
    """What decides about times beside the programs."""
    return {
        "date": now(),
        "processor": processor(),
        "processors": len(processors()),
        "memory": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "load": {"before": load()},
    }


def processor() -> str:
    """Its name, as the system tells it."""
    with contextlib.suppress(OSError):
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
        if found:
            return found[1]
    return platform.processor() or platform.machine()


def load() -> float:
    """How many processes wanted to run during the last minute."""
    return os.getloadavg()[0]


def instruction_sets() -> tuple[str, ...]:
    """Those that the kernels may be compiled for on such a processor."""
    kind = platform.machine().lower().replace("amd64", "x86_64").replace("arm64", "aarch64")
    return INSTRUCTION_SETS.get(kind, ("scalar",))


# ---- what is measured


def entries(names: Sequence[str] | None, counts: Sequence[int] | None) -> list[Entry]:
    """Renderers by their names, each with its instruction sets, variants and numbers of threads.

    `names` None: all that there are, the most telling first. `counts`: threads, 0 for all processors; None: one and
    all for native code, all for the others.

    Raises:
        renderers.UnknownRendererError: there is no such renderer.
    """
    every = len(processors())
    several = tuple(dict.fromkeys(min(count, every) or every for count in counts or (1, 0)))
    found: list[Entry] = []
    for name in names if names is not None else _all_names():
        variants = _variants(name)
        group = name if len(variants) > 1 else ""
        for renderer, isa in variants:
            if renderer.startswith("numpy-"):
                own: Sequence[int] = (1,)
            else:
                own = several if counts or renderer.startswith("native-") else (every,)
            found += [Entry(renderer, isa, count, group) for count in own]
    return list(dict.fromkeys(found))


def _all_names() -> list[str]:
    known = [entry.name for entry in renderers.all()]
    mesh = [f"{FAMILY}-{n}" for n in SUBDIVISIONS]
    # What takes seconds a picture comes last: it is what may be left out.
    return sorted([*known, *mesh], key=lambda name: (name.endswith("@scalar"), name.endswith("@cuda")))


def _variants(name: str) -> list[tuple[str, str]]:
    """The renderers and instruction sets that a name stands for."""
    base, _, variant = name.partition("@") if not name.startswith("cmd:") else (name, "", "")
    if base.startswith("native-"):
        renderers.get(base)
        sets = instruction_sets()
        if variant and variant not in sets:
            raise renderers.UnknownRendererError(name, [f"{base}@{isa}" for isa in sets])
        return [(base, isa) for isa in ([variant] if variant else reversed(sets))]
    if base == FAMILY or base.startswith(f"{FAMILY}-"):
        # One ray after the other says nothing about triangles that all rays at once do not say.
        backends = [variant] if variant else ["llvm", "cuda"]
        count = base.removeprefix(FAMILY).removeprefix("-")
        known = [f"{FAMILY}-{n}@{backend}" for n in SUBDIVISIONS for backend in ("llvm", "scalar", "cuda")]
        wrong = count and not (count.isdecimal() and int(count) <= MOST_SUBDIVISIONS)
        if wrong or (variant and variant not in ("llvm", "scalar", "cuda")):
            raise renderers.UnknownRendererError(name, known)
        counts = [int(count)] if count else SUBDIVISIONS
        return [(f"{FAMILY}-{n}@{backend}", "") for n in counts for backend in backends]
    found = [entry.name for entry in renderers.all() if entry.name.partition("@")[0] == name]
    return [(full, "") for full in found] or [(renderers.get(name).name, "")]


def default_scenes() -> list[Path]:
    """The scenes that are measured where none is named; empty where they are not here."""
    found = [Path(name) for name in SCENES if Path(name).is_file()]
    return found or [Path(OTHERWISE)] * Path(OTHERWISE).is_file()


# ---- processes


class Process:
    """One process that draws, and what it is asked."""

    def __init__(self, folder: Path, isa: str = "", cpus: Sequence[int] = (), *, compiles: bool = False) -> None:
        """Start it. `folder`: empty, for all that it leaves; `cpus`: those that it may use, none: all.

        One that `compiles` finds nothing that was compiled before.
        """
        environment = {key: value for key, value in os.environ.items() if key != "WHITTED_ISA"}
        environment["TMPDIR"] = str(folder)
        if isa:
            environment["WHITTED_ISA"] = isa
        if compiles:
            environment["HOME"] = str(folder)
        words = [sys.executable, "-P", "-m", "validation.speed_worker", ",".join(map(str, cpus))]
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        self._started = time.perf_counter()
        self._process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=environment,
            # What it starts ends with it.
            start_new_session=True,
        )
        self._unread = b""
        self._asked = False

    @property
    def age(self) -> float:
        """Seconds since its start."""
        return time.perf_counter() - self._started

    def ask(self, do: str, patience: float = PATIENCE, **request: Any) -> Record:
        """One answer.

        Raises:
            LateError: it took longer than `patience` seconds.
            WorkerError: it failed, or the process has ended.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **request}).encode() + b"\n")
            self._process.stdin.flush()
        except OSError as error:
            raise WorkerError(self._end()) from error
        self._asked = True
        line = self._line(patience)
        self._asked = False
        answer: Record = json.loads(line)
        if "error" in answer:
            raise WorkerError(answer["error"])
        return answer

    def _line(self, patience: float) -> bytes:
        assert self._process.stdout is not None
        end = time.perf_counter() + patience
        pipe = self._process.stdout.fileno()
        while b"\n" not in self._unread:
            if not select.select([pipe], [], [], max(0.0, end - time.perf_counter()))[0]:
                raise LateError(f"no answer within {patience:.0f} seconds")
            more = os.read(pipe, 1 << 16)
            if not more:
                raise WorkerError(self._end())
            self._unread += more
        line, self._unread = self._unread.split(b"\n", 1)
        return line

    def _end(self) -> str:
        status = self._process.wait()
        self._errors.seek(0)
        told = self._errors.read().decode(errors="replace").strip().splitlines()
        how = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"
        return f"its process {how}" + (f": {told[-1]}" if told else "")

    def close(self) -> None:
        """End it, and all that it has started; one that is at work gets a moment to end a program."""
        pid = self._process.pid
        with deferred():
            end([pid], [pid] if self._asked and self._process.poll() is None else [])
            self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            if stream:
                with contextlib.suppress(OSError):  # what was not sent
                    stream.close()


@contextmanager
def process(isa: str = "", cpus: Sequence[int] = (), *, compiles: bool = False) -> Iterator[Process]:
    """A process that ends with the block, and all that it has left with it; see Process."""
    folder = Path(tempfile.mkdtemp(prefix="whitted-"))
    try:
        opened = None
        try:
            with deferred():
                opened = Process(folder, isa, cpus, compiles=compiles)
            yield opened
        finally:
            if opened:
                opened.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


# ---- measuring


@dataclass
class _Running:
    """An entry while it is measured."""

    entry: Entry
    scene: Scene
    process: Process
    cold: float
    first: float
    picture: Passes
    samples: list[float] = field(default_factory=list)
    busy: list[float] = field(default_factory=list)
    memory: int = 0


def speed(
    scenes: Mapping[str, Scene],
    chosen: Sequence[Entry],
    settings: Settings | None = None,
    *,
    named: bool = False,
    size: tuple[int, int] | None = None,
    rounds: int = ROUNDS,
    seconds: float = SECONDS,
    limit: float = LIMIT,
    pixels: int = RANDOM,
    edges: int = EDGES,
    seed: int = 0,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Speed:
    """Measure every entry on every scene.

    `named`: someone asked for these entries, so one that cannot run is a failure. `rounds`: pictures of each, taken in
    turns, fewer where they take longer than `seconds`. `limit`: seconds for all scenes; what would begin later is left
    out. `pixels`, `edges`: how many are proved. Ctrl-C ends it with what there is.
    """
    start, settings = time.perf_counter(), settings or Settings()
    say = progress or (lambda _: None)
    options = {"rounds": rounds, "seconds": seconds, "limit": limit, "pixels": pixels, "edges": edges, "seed": seed}
    result = Speed(settings, options, versions=versions(()), machine=machine())
    result.versions.pop("instruction set")  # each entry has its own
    for place, (label, scene) in enumerate(scenes.items()):
        # Every scene has its share of what is left.
        now = time.perf_counter()
        end = now + (start + limit - now) / (len(scenes) - place)
        at_size = resized(scene, size or shrink(scene.view.columns, scene.view.rows, PIXELS), limits=False)
        if not size and at_size is not scene:
            told = f"{at_size.view.columns}x{at_size.view.rows} instead of {scene.view.columns}x{scene.view.rows}"
            result.left_out.append(Note(label, "", f"measured at {told} pixels: --size asks for another size"))
        run = _SceneRun(result, label, at_size, named=named, end=end, say=say)
        try:
            run.measure(chosen, rounds=rounds, seconds=seconds, pixels=pixels, edges=edges, seed=seed, jobs=jobs)
        except UnprovedError as error:
            result.failures.append(Note(label, "", str(error)))
        except KeyboardInterrupt:
            if not any(other.measured for other in result.scenes):
                raise
            result.interrupted = True
        if result.interrupted:
            break
    result.machine["load"]["after"] = load()
    result.seconds = time.perf_counter() - start
    return result


class _SceneRun:
    """The work on one scene."""

    def __init__(self, result: Speed, label: str, scene: Scene, *, named: bool, end: float, say: Progress) -> None:
        self.result, self.label, self.scene, self.named, self.end, self.say = result, label, scene, named, end, say
        self.settings = result.settings

    def measure(
        self,
        chosen: Sequence[Entry],
        *,
        rounds: int,
        seconds: float,
        pixels: int,
        edges: int,
        seed: int,
        jobs: int | None,
    ) -> None:
        """Start every process, then draw in turns, then hold the pictures against what is proved."""
        scene, view = self.scene, self.scene.view
        found = SceneSpeed(self.label, (view.columns, view.rows), len(scene.distinct), len(scene.lights))
        self.result.scenes.append(found)
        surveyed = self.survey(chosen)
        if not surveyed:
            return
        proofs: dict[tuple[int, int], Proof] = {}
        with ExitStack() as stack:
            running: list[_Running] = []
            for place, (entry, asked, at) in enumerate(surveyed):
                # The warm pictures of those that run already need their time as well, hardly more than the first took.
                reserve = sum(max(LEAST_RUNS * one.first, min(seconds, rounds * BURST)) for one in running)
                if running and time.perf_counter() + reserve > self.end:
                    for late, _, _ in surveyed[place:]:
                        self.leave_out(late, LATE)
                    break
                if at not in proofs:
                    self.say(f"{self.label}: proving pixels at {at[0]}x{at[1]}")
                    small = resized(scene, at)
                    proofs[at] = prove_scene(small, self.settings, pixels=pixels, edges=edges, seed=seed, jobs=jobs)
                    found.unproved += len(proofs[at].unproved)
                self.say(f"{self.label}: {entry.name}, {threads(entry.threads)}: first picture")
                if opened := self.start(stack, entry, asked, at):
                    running.append(opened)
            try:
                self.warm(running, rounds, seconds)
            except KeyboardInterrupt:
                self.result.interrupted = True  # what has been drawn counts
        for one in running:
            steps = one.picture.metadata.get("levels")
            try:
                size = one.scene.view.columns, one.scene.view.rows
                off = measure(one.picture, proofs[size], steps=int(steps) if steps else None)
            except (ValueError, KeyError) as error:
                self.fail(one.entry, str(error))
                continue
            if one.samples:
                warm, busy = Spread.of(one.samples), Spread.of(one.busy)
                found.measured.append(Measured(one.entry, size, one.cold, warm, busy, one.memory, off))
        best = front([(m.per_pixel, m.rmse) for m in found.measured], [m.spread for m in found.measured])
        marked = [replace(m, front=on) for m, on in zip(found.measured, best, strict=True)]
        found.measured = sorted(marked, key=lambda m: m.per_pixel)

    def leave_out(self, entry: Entry, reason: str) -> None:
        """Not measured, and why; said once where it is the same for all threads."""
        note = Note(self.label, entry.name, reason)
        if note not in self.result.left_out:
            self.result.left_out.append(note)

    def fail(self, entry: Entry, reason: str) -> None:
        """It was to be measured and could not be."""
        self.result.failures.append(Note(self.label, f"{entry.name}, {threads(entry.threads)}", reason))

    def survey(self, chosen: Sequence[Entry]) -> list[tuple[Entry, dict[str, Any], tuple[int, int]]]:
        """The entries that can draw the scene, what is asked of them, and at which size."""
        found, told = [], {}
        absent: list[tuple[Entry, str]] = []
        with ExitStack() as stack:
            surveyor = stack.enter_context(process())
            for entry in chosen:
                self.say(f"{self.label}: {entry.name}")
                asked = self.request(entry, self.scene)
                try:
                    if (entry.renderer, entry.isa) not in told:
                        told[entry.renderer, entry.isa] = surveyor.ask("survey", isa=entry.isa, **asked)
                    answer = told[entry.renderer, entry.isa]
                except WorkerError as error:
                    told[entry.renderer, entry.isa] = {"failed": True}
                    self.fail(entry, str(error))
                    surveyor = stack.enter_context(process())  # the other may have ended
                    continue
                if reason := answer.get("unavailable"):
                    absent.append((entry, f"cannot run here: {reason}"))
                elif reason := answer.get("refused"):
                    self.leave_out(entry, reason)
                elif "size" in answer:
                    for key, value in answer["versions"].items():
                        known = self.result.versions
                        if key != "instruction set":
                            known[key if known.get(key, value) == value else f"{entry.renderer}: {key}"] = value
                    at: tuple[int, int] = tuple(answer["size"])
                    found.append((entry, self.request(entry, resized(self.scene, at)), at))
        here = {entry.group for entry, _, _ in found}
        for entry, reason in absent:
            # Of a family that was asked for, one has to be here.
            (self.fail if self.named and not (entry.group and entry.group in here) else self.leave_out)(entry, reason)
        return found

    def request(self, entry: Entry, scene: Scene) -> dict[str, Any]:
        """What a process is told to draw."""
        settings = vars(self.settings) | {"threads": entry.threads}
        return {"renderer": entry.renderer, "scene": scene.text(), "settings": settings, "key": "picture"}

    def start(self, stack: ExitStack, entry: Entry, asked: Mapping[str, Any], at: tuple[int, int]) -> _Running | None:
        """A new process, its first picture, and that in a file."""
        every = processors()
        cpus = every[: entry.threads] if entry.threads < len(every) else []
        compiles = entry.renderer.startswith(CACHED)
        opened = stack.enter_context(process(entry.isa, cpus, compiles=compiles))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="whitted-")))
        try:
            first = opened.ask("first", **asked)
            cold = opened.age - first["probing"]
            opened.ask("save", key="picture", path=str(folder / "picture.npz"))
        except LateError as error:
            self.leave_out(entry, f"its first picture: {error}")
            return None
        except WorkerError as error:
            self.fail(entry, str(error))
            return None
        return _Running(
            entry, resized(self.scene, at), opened, cold, first["seconds"], Passes.load(folder / "picture.npz")
        )

    def warm(self, running: list[_Running], rounds: int, seconds: float) -> None:
        """Pictures in turns, in another order every round."""
        shuffled = random.Random(0)
        for turn in range(rounds):
            self.say(f"{self.label}: round {turn + 1} of {rounds}")
            for one in shuffled.sample(running, len(running)):
                spent, late = sum(one.samples), time.perf_counter() > self.end
                if len(one.samples) >= LEAST_RUNS and (spent > seconds or late):
                    continue
                if one.samples and late:
                    continue
                try:
                    burst = min(BURST, seconds / rounds)
                    answer = one.process.ask("draw", key="picture", seconds=burst, most=MOST_IN_BURST)
                    one.samples += answer["seconds"]
                    one.busy += answer["busy"]
                    one.memory = int(one.process.ask("memory")["bytes"])
                except WorkerError as error:
                    self.fail(one.entry, str(error))
                    running.remove(one)
        for one in running:
            if 0 < len(one.samples) < LEAST_RUNS:
                reason = f"fewer than {LEAST_RUNS} warm pictures, so no quartiles: --rounds or --limit gives more"
                self.leave_out(one.entry, reason)


def panels(result: Speed) -> list[Panel]:
    """What the plot shows."""
    return [
        Panel(
            f"{scene.label}, {scene.size[0]}x{scene.size[1]}: "
            f"{counted(scene.spheres, 'sphere')}, {counted(scene.lights, 'light')}",
            [
                Point(
                    m.entry.name,
                    m.entry.family,
                    m.entry.threads,
                    m.per_pixel,
                    m.rmse,
                    m.spread,
                )
                for m in scene.measured
            ],
        )
        for scene in result.scenes
        if scene.measured
    ]


def caption(result: Speed) -> str:
    """Where and when."""
    told = result.machine
    return (
        f"{told['date'][:10]}, {told['processor']}, {told['processors']} processors, load "
        f"{told['load']['before']:.1f} to {told['load'].get('after', 0):.1f}; whitted {result.versions['whitted']}"
    )
