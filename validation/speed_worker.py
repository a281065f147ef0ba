"""A process of its own that draws scenes and says how long it took: the other end of `validation.speed`.

Requests and answers are lines of JSON. The first argument names the processors that it may use, none: all. Nothing is
imported before it is needed, as the first picture is timed with all that it takes.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeAlias

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.passes import Passes
    from validation.renderers import Renderer, Settings

Answer: TypeAlias = dict[str, Any]

#: Where our own renderers are: one alone is imported, not all of them.
HOMES = ("native", "numpy", "mitsuba", "povray")
MESH = "mitsuba-mesh-"
MEBIBYTE = 1 << 20


def renderer(name: str) -> Renderer:
    """The renderer of that name; meshes, which take part in no comparison, too."""
    import importlib

    if name.startswith(MESH):
        from validation.renderers.mitsuba.mesh import MitsubaMesh

        subdivisions, _, backend = name.removeprefix(MESH).partition("@")
        return MitsubaMesh(int(subdivisions), backend)
    home = name.partition("-")[0]
    if home in HOMES:
        for found in importlib.import_module(f"validation.renderers.{home}").renderers():
            if found.name == name:
                chosen: Renderer = found
                return chosen
    from validation.renderers import get

    return get(name)


class Job:
    """A renderer, and what it draws."""

    def __init__(self, request: Mapping[str, Any]) -> None:
        """Everything is read; nothing is drawn."""
        import tracer
        from validation.renderers import Settings

        self.program = renderer(request["renderer"])
        self.scene: Scene = tracer.loads(request["scene"], limits=False)
        self.settings: Settings = Settings(**request["settings"])
        self.last: Passes | None = None

    def draw(self) -> tuple[float, float]:
        """One picture; the seconds that it took, and those of processor time, all processors together."""
        self.last = None  # the memory of two pictures is not needed
        busy, start = _busy(), time.perf_counter()
        self.last = self.program.render(self.scene, ("beauty",), self.settings)
        return time.perf_counter() - start, _busy() - busy

    def survey(self) -> Answer:
        """What can be said before anything is measured: whether and at which size the renderer draws the scene."""
        from validation.run import shrink, why_not

        if reason := self.program.unavailable():
            return {"unavailable": reason}
        versions = dict(self.program.versions())
        delivers = self.program.passes(self.scene, self.settings)
        if "beauty" not in delivers:
            why = why_not(self.program, self.scene)
            if delivers:
                return {"refused": "it cannot draw all of this scene, only some of its passes"}
            return {"refused": "it cannot draw this scene" + (f": {why}" if why not in ("", "nothing") else "")}
        size = self.scene.view.columns, self.scene.view.rows
        most = self.program.max_pixels(self.scene, ("beauty",))
        if most is not None:
            size = shrink(*size, most)
        return {"size": size, "versions": versions, "precision": getattr(self.program, "precision", "")}


class KernelJob(Job):
    """Our own kernels alone: the bytes of an image, drawn into memory that is there already."""

    def __init__(self, request: Mapping[str, Any]) -> None:
        """Everything is read; nothing is drawn."""
        import numpy as np

        super().__init__(request)
        view = self.scene.view
        self.levels = np.zeros((view.rows, view.columns, 3), np.uint8)

    def draw(self) -> tuple[float, float]:
        """As a Job does."""
        from tracer import _native

        s, target = self.settings, [("beauty8", 0, self.levels)]
        precision = self.program.name.removeprefix("native-")
        busy, start = _busy(), time.perf_counter()
        _native.render_into(self.scene, target, precision, s.threads, s.sample, s.shadow_epsilon, s.max_reflections)
        return time.perf_counter() - start, _busy() - busy


class Worker:
    """The requests, a method each."""

    def __init__(self) -> None:
        """No jobs."""
        self.jobs: dict[str, Job] = {}

    def survey(self, request: Mapping[str, Any]) -> Answer:
        """See Job.survey; `isa`: an instruction set that native code is asked to use."""
        if isa := request.get("isa"):
            import tracer

            os.environ["WHITTED_ISA"] = isa
            try:
                tracer.instruction_set()
            except ValueError as error:
                return {"unavailable": str(error).replace(f"WHITTED_ISA is '{isa}', but here it", "here it")}
            finally:
                del os.environ["WHITTED_ISA"]
        return Job(request).survey()

    def first(self, request: Mapping[str, Any]) -> Answer:
        """A new job, drawn once. `probing`: seconds that were spent to find out whether the renderer can run.

        `kernel`: nothing but bytes is asked of our own kernels.
        """
        job = KernelJob(request) if request.get("kernel") else Job(request)
        start = time.perf_counter()
        if reason := job.program.unavailable():
            return {"error": reason}
        probing = time.perf_counter() - start
        took, _ = job.draw()
        self.jobs[request["key"]] = job
        return {"probing": probing, "seconds": took}

    def draw(self, request: Mapping[str, Any]) -> Answer:
        """Draw until so many seconds are over, but no more than so often."""
        job = self.jobs[request["key"]]
        took: list[float] = []
        busy: list[float] = []
        while not took or (sum(took) < request["seconds"] and len(took) < request["most"]):
            wall, cpu = job.draw()
            took.append(wall)
            busy.append(cpu)
        return {"seconds": took, "busy": busy}

    def forget(self, request: Mapping[str, Any]) -> Answer:
        """Give back the memory of a job."""
        del self.jobs[request["key"]]
        return {}

    def save(self, request: Mapping[str, Any]) -> Answer:
        """Write the picture that was drawn last, and those passes that show decisions, to a file."""
        from tracer.passes import Passes

        job = self.jobs[request["key"]]
        assert job.last is not None
        delivers = job.program.passes(job.scene, job.settings)
        more = [name for name in delivers if name == "id" or name.startswith("shadow.L")]
        arrays, metadata = dict(job.last), dict(job.last.metadata)
        if more:
            arrays |= dict(job.program.render(job.scene, more, job.settings))
        encoding = getattr(job.program, "encoding", None)
        if encoding:
            metadata["quantisation"] = encoding.quantisation
        Passes(arrays, metadata).save(Path(request["path"]))
        return {}

    def write(self, request: Mapping[str, Any]) -> Answer:
        """Seconds to write the last picture of a kernel into a new file."""
        job = self.jobs[request["key"]]
        assert isinstance(job, KernelJob)
        rows, columns, _ = job.levels.shape
        data = b"P6\n%d %d\n255\n" % (columns, rows) + job.levels.tobytes()
        found, path = [], Path(request["path"])
        for _ in range(request["most"]):
            start = time.perf_counter()
            path.write_bytes(data)
            found.append(time.perf_counter() - start)
            path.unlink()
        return {"seconds": found, "bytes": len(data)}

    def limits(self, request: Mapping[str, Any]) -> Answer:
        """What one thread of this machine can do in a second."""
        from tracer import _native

        return {"limits": _native.limits(request["seconds"])}

    def memory(self, _: Mapping[str, Any]) -> Answer:
        """The most memory that this process had, or one that it started, whichever had more."""
        return {"bytes": max(_own_peak(), _peak(resource.RUSAGE_CHILDREN))}


def _busy() -> float:
    """Seconds of processor time of this process, and of those that it has waited for."""
    return time.process_time() + sum(os.times()[2:4])


def _peak(who: int) -> int:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(who).ru_maxrss * unit


def _own_peak() -> int:
    # What the kernel counts for getrusage begins with the process that started this one.
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    return _peak(resource.RUSAGE_SELF)


def main() -> None:
    """Answer until nobody asks any more."""
    if len(sys.argv) > 1 and sys.argv[1] and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {int(cpu) for cpu in sys.argv[1].split(",")})
    # What renderers print must not get between the answers.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    # A program is in a group of its own: who is ended while one runs ends it.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        _answer(Worker(), answers)


def _answer(worker: Worker, answers: TextIO) -> None:
    for line in sys.stdin:
        request = json.loads(line)
        handler: Callable[[Mapping[str, Any]], Answer] = getattr(worker, request["do"])
        try:
            answer = handler(request)
        except Exception as error:  # whatever a renderer raises
            answer = {"error": _words(error)}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _words(error: Exception) -> str:
    """What a renderer says for people as it is, anything else with its kind."""
    from validation.run import InputError, RendererError

    if isinstance(error, InputError | RendererError):
        return str(error).splitlines()[0]
    return f"{type(error).__name__}: {error}".removesuffix(": ")


if __name__ == "__main__":
    main()
