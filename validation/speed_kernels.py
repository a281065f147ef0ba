"""Speed of our own kernels alone: by instruction set, precision, size, spheres, lights, reflections and threads."""

from __future__ import annotations

import math
import os
import random
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tracer import Light, Scene, Sphere, View
from validation.records import Record
from validation.renderers import Settings
from validation.run import resized
from validation.speed import LATE, LIMIT, Process, Spread, WorkerError, instruction_sets, process, processors

if TYPE_CHECKING:
    from tracer.passes import Precision

SIZES = (100, 200, 400, 1000, 2000, 4000, 8000)
COUNTS = (1, 2, 5, 10, 20, 50, 100)
REFLECTIONS = (0, 1, 2, 3, 5, 8)
#: Columns and rows of the scenes of our own making; of those that instruction sets are compared on.
EDGE, STANDARD = 256, 2000
#: Side of the square picture whose bytes are written.
WRITTEN = 4000
#: The line is no line if a time is off it by more than this share.
STRAIGHT = 0.2
ROUNDS, LEAST_RUNS, BURST, MOST_IN_BURST = 7, 3, 0.03, 10
#: Seconds for a kind of measurement; seconds of a round for what the machine can do.
SECONDS, LIMITS = 7.0, 0.12
#: Of the memory that is free, this share may be taken by a picture.
SHARE = 0.4

PRECISIONS: tuple[Precision, ...] = ("f64", "f32")


@dataclass(frozen=True)
class Row:
    """One measurement. `value`: what is varied; `ratio`: pixels a second over those of the first of its group and
    precision, round by round. `busy`: processor time, all processors together.
    """

    group: str
    value: int | str
    isa: str
    precision: str
    threads: int
    size: tuple[int, int]
    warm: Spread
    busy: Spread
    ratio: Spread | None = None

    @property
    def speed(self) -> float:
        """Pixels a second."""
        return self.size[0] * self.size[1] / self.warm.median

    def record(self) -> Record:
        """For JSON."""
        ratio = asdict(self.ratio) if self.ratio else None
        return asdict(self) | {"ratio": ratio, "pixels_per_second": self.speed}


@dataclass(frozen=True)
class Limit:
    """What one thread can do in a second at most, and what a pixel of the kernels costs in such operations."""

    isa: str
    precision: str
    multiply_adds: float
    square_roots: float
    divisions: float
    pixels: float

    def cost(self, operation: str) -> float:
        """The time of a pixel, in operations of one kind."""
        return float(getattr(self, operation)) / self.pixels

    def record(self) -> Record:
        """For JSON."""
        kinds = ("multiply_adds", "square_roots", "divisions")
        return asdict(self) | {"pixel_costs": {kind: self.cost(kind) for kind in kinds}}


@dataclass(frozen=True)
class Fit:
    """Time = constant + each * number. `off`: the largest difference, as a share of the time; `exponent`: of the number
    where it is largest, if time were a power of it.
    """

    constant: float
    each: float
    off: float
    exponent: float

    @property
    def linear(self) -> bool:
        """Whether a line says it."""
        return self.each > 0 and self.off <= STRAIGHT

    def says(self, what: str) -> str:
        """A sentence."""
        if self.linear:
            text = f"linear: {self.constant * 1e3:.2g} ms and {self.each * 1e3:.2g} ms a {what}"
            return f"{text}; off by {self.off:.0%} at most"
        return f"not linear, off a line by {self.off:.0%}: at the end it grows as the number to the {self.exponent:.2f}"


@dataclass
class Kernels:
    """Everything that was measured of the kernels, and what was left out."""

    scene: str
    rows: list[Row] = field(default_factory=list)
    limits: list[Limit] = field(default_factory=list)
    fits: dict[str, Fit] = field(default_factory=dict)
    #: Bytes written in so many seconds, and the seconds that it took to draw them.
    written: tuple[int, Spread, Spread] | None = None
    left_out: list[str] = field(default_factory=list)
    seconds: float = 0.0
    interrupted: bool = False

    def record(self) -> Record:
        """For JSON."""
        written = None
        if self.written:
            size, wrote, drew = self.written
            written = {"bytes": size, "write": asdict(wrote), "draw": asdict(drew)}
            written["bytes_per_second"] = size / wrote.median
        return {
            "scene": self.scene,
            "rows": [row.record() for row in self.rows],
            "limits": [limit.record() for limit in self.limits],
            "fits": {what: asdict(fit) | {"linear": fit.linear} for what, fit in self.fits.items()},
            "written": written,
            "left_out": self.left_out,
            "seconds": self.seconds,
        }


def fit(numbers: Sequence[float], times: Sequence[float]) -> Fit:
    """The line through times with the smallest differences, each as a share of the time."""
    n, t = np.array(numbers, float), np.array(times, float)
    table = np.stack([np.ones_like(n), n], axis=1) / t[:, None]
    (constant, each), *_ = np.linalg.lstsq(table, np.ones_like(t), rcond=None)
    off = np.abs(constant + each * n - t) / t
    last = slice(-min(3, len(n)), None)
    exponent = np.polyfit(np.log(n[last]), np.log(t[last]), 1)[0] if len(n) > 1 else math.nan
    return Fit(float(constant), float(each), float(off.max()), float(exponent))


# ---- scenes of our own making: as much of the picture is covered whatever the number


def _view() -> View:
    return View(near=1, left=-1, right=1, bottom=-1, top=1, columns=EDGE, rows=EDGE)


def _sphere(k: int, count: int, kr: float = 0.0) -> Sphere:
    """One of `count` along a spiral, a little behind one another; together they have always the same area."""
    radius, angle = 8 * math.sqrt((k + 0.5) / count), k * math.pi * (3 - math.sqrt(5))
    size = _short(8.0 / math.sqrt(count))
    return Sphere(
        name=f"s{k}",
        position=(_short(radius * math.cos(angle)), _short(radius * math.sin(angle)), _short(-12 - 3 * (k % 7) / 7)),
        scaling=(size, _short(0.8 * size), size),
        color=(0.9, 0.6, 0.3),
        ka=0.2,
        kd=0.6,
        ks=0.3,
        kr=kr,
        exponent=20,
    )


def _light(k: int, count: int) -> Light:
    angle = 2 * math.pi * k / count
    position = (_short(9 * math.cos(angle)), _short(9 * math.sin(angle)), 2)
    return Light(name=f"l{k}", position=position, intensity=(1 / count,) * 3)


def _short(value: float) -> float:
    # Nothing that float32 has no room for.
    return round(value, 6)


def made(spheres: int = 5, lights: int = 3) -> Scene:
    """A scene with so many of them."""
    return Scene(
        view=_view(),
        spheres=[_sphere(k, spheres) for k in range(spheres)],
        lights=[_light(k, lights) for k in range(lights)],
        background=(0.1, 0.1, 0.2),
        ambient=(0.3, 0.3, 0.3),
        output="speed.ppm",
        limits=False,
    )


def mirrors() -> Scene:
    """Mirrors that face each other all around: hardly a chain ends before it has to."""
    far = 1004.0
    walls = [(far, 0, -12), (-far, 0, -12), (0, far, -12), (0, -far, -12), (0, 0, -12 - far)]
    spheres = [
        _sphere(0, 1, 0.9).replace(name=f"w{k}", position=place, scaling=(1000.0,) * 3) for k, place in enumerate(walls)
    ]
    lights = [Light(name="l", position=(1.0, 2.0, -3.0), intensity=(0.8, 0.8, 0.8))]
    return made().replace(spheres=spheres, lights=lights)


# ---- measuring


@dataclass(frozen=True)
class _Task:
    """One row before it is measured."""

    group: str
    value: int | str
    isa: str
    precision: str
    threads: int
    scene: Scene
    settings: Settings = field(default_factory=Settings)

    @property
    def key(self) -> str:
        return f"{self.group}/{self.value}/{self.isa}/{self.precision}/{self.threads}"

    def request(self) -> dict[str, Any]:
        settings = vars(self.settings) | {"threads": self.threads}
        return {
            "key": self.key,
            "renderer": f"native-{self.precision}",
            "kernel": True,
            "scene": self.scene.text(),
            "settings": settings,
        }

    @property
    def size(self) -> tuple[int, int]:
        return self.scene.view.columns, self.scene.view.rows

    @property
    def pixels(self) -> int:
        return self.size[0] * self.size[1]

    @property
    def bytes(self) -> int:
        return self.pixels * 3


class _Bench:
    """A process for every instruction set, and what they measured."""

    def __init__(
        self, stack: ExitStack, result: Kernels, say: Callable[[str], None], seconds: float, end: float
    ) -> None:
        self.result, self.say, self.seconds, self.end = result, say, seconds, end
        self.processes: dict[str, Process] = {}
        for isa in instruction_sets():
            opened = stack.enter_context(process(isa))
            try:
                # One small picture: is it there?
                opened.ask("first", **_Task("", 0, isa, "f64", 1, resized(made(1, 1), (8, 8), limits=False)).request())
                self.processes[isa] = opened
            except WorkerError as error:
                result.left_out.append(f"{isa}: {str(error).removeprefix('ValueError: ')}")

    @property
    def best(self) -> str:
        """The last that there is: the widest."""
        return list(self.processes)[-1]

    def measure(self, tasks: Sequence[_Task], between: Callable[[], None] | None = None) -> list[Row]:
        """Pictures in turns, in another order every round; `between`: what else is done in each."""
        if self.late(tasks[0].group):
            return []
        ready = [task for task in tasks if self._open(task)]
        samples: dict[_Task, list[Record]] = {task: [] for task in ready}
        end, shuffled = time.perf_counter() + self.seconds, random.Random(0)
        for turn in range(ROUNDS):
            if turn >= LEAST_RUNS and time.perf_counter() > end:
                break
            for task in shuffled.sample(ready, len(ready)):
                # What takes seconds is drawn less often.
                if sum(map(_seconds, samples[task])) < self.seconds / 4:
                    burst = {"seconds": BURST, "most": MOST_IN_BURST}
                    samples[task].append(self.processes[task.isa].ask("draw", key=task.key, **burst))
            if between:
                between()
        for task in ready:
            self.processes[task.isa].ask("forget", key=task.key)
        rows = []
        for task in ready:
            # Of scalar kernels, or of the first of the row's kind: side by side, round by round.
            first = next(other for other in ready if other.precision == task.precision)
            more = task.pixels / first.pixels
            pairs = zip(samples[first], samples[task], strict=False)
            ratios = [more * min(a["seconds"]) / min(b["seconds"]) for a, b in pairs]
            warm, busy = (
                Spread.of([value for burst in samples[task] for value in burst[kind]]) for kind in ("seconds", "busy")
            )
            same = (task.group, task.value, task.isa, task.precision, task.threads, task.size)
            rows.append(Row(*same, warm, busy, Spread.of(ratios)))
        self.result.rows += rows
        return rows

    def late(self, group: str) -> bool:
        """Whether the time is up; what does not begin any more is left out."""
        up = time.perf_counter() > self.end
        if up:
            self.result.left_out.append(f"kernels by {group}: {LATE}")
        return up

    def _open(self, task: _Task) -> bool:
        free = _free_memory()
        if task.bytes > SHARE * free:
            self.result.left_out.append(
                f"{task.group} {task.value}, {task.precision}: {task.bytes >> 20} MiB, {free >> 20} MiB are free"
            )
            return False
        self.say(f"kernels: {task.group} {task.value}, {task.isa}, {task.precision}")
        try:
            self.processes[task.isa].ask("first", **task.request())
        except WorkerError as error:
            self.result.left_out.append(f"{task.group} {task.value}, {task.isa}, {task.precision}: {error}")
            return False
        return True


def _seconds(answer: Record) -> float:
    return float(sum(answer["seconds"]))


def _free_memory() -> int:
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2


def kernels(
    scenes: Mapping[str, Scene],
    settings: Settings | None = None,
    *,
    size: tuple[int, int] | None = None,
    sizes: Sequence[int] = SIZES,
    counts: Sequence[int] = COUNTS,
    edge: int = 1000,
    seconds: float = SECONDS,
    limit: float = LIMIT,
    progress: Callable[[str], None] | None = None,
) -> Kernels:
    """Measure the kernels on scenes, all but the instruction sets on the first, and with many spheres and lights.

    `size`: where instruction sets are compared; `edge`: columns and rows where threads are; `seconds`: for each kind,
    about; `limit`: for all, what would begin later is left out. Ctrl-C ends it with what there is.
    """
    start, result = time.perf_counter(), Kernels(next(iter(scenes)))
    try:
        with ExitStack() as stack:
            bench = _Bench(stack, result, progress or (lambda _: None), seconds, start + limit)
            if bench.processes:
                _measure(bench, scenes, settings or Settings(), size, sizes, counts, edge)
    except KeyboardInterrupt:
        result.interrupted = True
    result.seconds = time.perf_counter() - start
    return result


def _measure(
    bench: _Bench,
    scenes: Mapping[str, Scene],
    settings: Settings,
    size: tuple[int, int] | None,
    sizes: Sequence[int],
    counts: Sequence[int],
    edge: int,
) -> None:
    """All groups of measurements, one after the other."""
    scene, every, best = next(iter(scenes.values())), len(processors()), bench.best
    for name, other in scenes.items():
        _instruction_sets(bench, name, resized(other, size or (STANDARD, STANDARD), limits=False), settings)

    def vary(group: str, tasks: Mapping[int, Scene], count: int = 1) -> list[Row]:
        return bench.measure(
            [
                _Task(group, value, best, precision, count, varied, settings)
                for precision in PRECISIONS
                for value, varied in tasks.items()
            ]
        )

    vary("size", {n: resized(scene, (n, n), limits=False) for n in sizes}, every)
    by_spheres = vary("spheres", {n: made(spheres=n) for n in counts})
    by_lights = vary("lights", {n: made(lights=n) for n in counts})
    for what, rows in (("sphere", by_spheres), ("light", by_lights)):
        for precision in PRECISIONS:
            of = [row for row in rows if row.precision == precision]
            if len(of) > 1:
                numbers = [float(row.value) for row in of]
                # The least processor time of each: what others do at the same time says nothing about the kernels.
                bench.result.fits[f"{what}, {precision}"] = fit(numbers, [row.busy.least for row in of])
    facing = mirrors()
    bench.measure(
        [
            _Task("reflections", n, best, precision, 1, facing, Settings(max_reflections=n))
            for precision in PRECISIONS
            for n in REFLECTIONS
        ]
    )
    use = dict.fromkeys([2**k for k in range(every.bit_length()) if 2**k <= every] + [every])
    bench.measure(
        [
            _Task("threads", n, best, precision, n, resized(scene, (edge, edge), limits=False), settings)
            for precision in PRECISIONS
            for n in use
        ]
    )
    _write(bench, scene, settings, min(WRITTEN, max(sizes)))


def _instruction_sets(bench: _Bench, label: str, scene: Scene, settings: Settings) -> None:
    """Every instruction set in both precisions; on the first scene, in the same rounds, what the machine can do."""
    most: dict[tuple[str, str], dict[str, float]] = {}

    def limits() -> None:
        for isa, opened in bench.processes.items():
            for precision, rates in opened.ask("limits", seconds=LIMITS)["limits"].items():
                known = most.setdefault((isa, precision), rates)
                most[isa, precision] = {kind: max(rate, known[kind]) for kind, rate in rates.items()}

    tasks = [
        _Task(f"instruction set, {label}", isa, isa, precision, 1, scene, settings)
        for precision in PRECISIONS
        for isa in bench.processes
    ]
    measured = bool(bench.result.limits)  # with the scene before
    for row in bench.measure(tasks, None if measured else limits):
        if not measured:
            bench.result.limits.append(Limit(row.isa, row.precision, pixels=row.speed, **most[row.isa, row.precision]))


def _write(bench: _Bench, scene: Scene, settings: Settings, edge: int) -> None:
    """The bytes of an image file, against the time to draw them."""
    task = _Task(
        "write", edge, bench.best, "f32", len(processors()), resized(scene, (edge, edge), limits=False), settings
    )
    opened = bench.processes[bench.best]
    if bench.late("writing"):
        return
    with tempfile.TemporaryDirectory(prefix="whitted-") as folder:
        try:
            opened.ask("first", **task.request())
            drew: list[float] = []
            wrote: list[float] = []
            for _ in range(LEAST_RUNS):
                drew += opened.ask("draw", key=task.key, seconds=0, most=1)["seconds"]
                answer = opened.ask("write", key=task.key, path=str(Path(folder) / "image.ppm"), most=1)
                wrote += answer["seconds"]
            opened.ask("forget", key=task.key)
            bench.result.written = int(answer["bytes"]), Spread.of(wrote), Spread.of(drew)
        except WorkerError as error:
            bench.result.left_out.append(f"writing {edge}x{edge} pixels: {error}")
