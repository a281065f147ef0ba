"""Other processes: some that take one task after the other, and the end of all of them with what they have started."""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import resource
import signal
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

Task = TypeVar("Task")

#: Seconds that a process has to end what it has started.
MOMENT = 2.0
#: A process that has grown so large is replaced: Mitsuba keeps what it compiles.
LARGEST_BYTES = 3 << 30


# ---- the end of a process


@contextmanager
def deferred() -> Iterator[None]:
    """Ctrl-C and SIGTERM are heeded at the end of this, not within: what has just been started must not get lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    # What is ignored stays so, and what ends the program at once, too.
    handlers = {number: handler for number, handler in before.items() if callable(handler)}
    for number in handlers:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for late in dict.fromkeys(came):
            handlers[signal.Signals(late)](late, None)


def ends(pid: int, seconds: float) -> bool:
    """Whether a process ends in that time; it is not waited for yet, so its number cannot become another's."""
    deadline, pause = time.monotonic() + seconds, 0.001
    while os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is None:
        left = deadline - time.monotonic()
        if left <= 0:
            return False
        time.sleep(min(pause, left))
        pause = min(2 * pause, 0.02)
    return True


def _runs(pid: int) -> bool:
    """Whether a child has not ended; unlike `is_alive` this does not wait for it, see `ends`."""
    try:
        return not ends(pid, 0)
    except ChildProcessError:  # somebody has waited for it
        return False


def end(groups: Sequence[int], busy: Sequence[int] = ()) -> None:
    """End processes, each with its group; those that are `busy` first get a moment.

    A program that one of them runs is in a group of its own: SIGTERM, which is Ctrl-C there, ends it. They are still to
    be waited for.
    """
    for pid in busy:
        os.kill(pid, signal.SIGTERM)
    deadline = time.monotonic() + MOMENT
    for pid in busy:
        ends(pid, max(0.0, deadline - time.monotonic()))
    for pid in groups:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)


def lead() -> None:
    """Be a process that `end` can end: the head of a group, in which SIGTERM is what Ctrl-C is elsewhere."""
    # Ctrl-C of a terminal is for the parent.
    os.setsid()
    signal.signal(signal.SIGTERM, signal.default_int_handler)


# ---- a process that takes tasks


class Teller:
    """What a process tells about its task."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def doing(self, what: str, seconds: float | None = None) -> None:
        """What it begins, and how many seconds that may take; None: no more than was left."""
        self._connection.send(("doing", (what, seconds)))

    def found(self, value: Any) -> None:
        """Something that came out."""
        self._connection.send(("found", value))


Work: TypeAlias = Callable[[Task, Teller], None]


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    # What is drawn may be a program, which is in a group of its own.
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(MOMENT)
    os.killpg(0, signal.SIGKILL)


def _serve(connection: Connection, work: Work[Any]) -> None:
    """A process: do each task that comes."""
    lead()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # Mitsuba makes its own integrators anew whenever another of its variants draws.
    warnings.filterwarnings("ignore", message="The AST-transforming decorator")
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            task = connection.recv()
            try:
                work(task, Teller(connection))
            except Exception as error:  # a fault of ours, which is told; the other tasks go on
                where = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{Path(where.filename).name}:{where.lineno}"
                connection.send(("fault", f"{type(error).__name__} in {place}: {error}"))
            connection.send(("done", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024))


class Worker(Generic[Task]):
    """One process, its task (None: it has none), what it is doing, and until when it may."""

    def __init__(self, work: Work[Task]) -> None:
        """Start it."""
        context = multiprocessing.get_context("spawn")  # a fork of a process in which Mitsuba has threads may hang
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(theirs, work), daemon=True)
        self.process.start()
        theirs.close()
        self.task: Task | None = None
        self.doing = ""
        self.seconds = self.deadline = 0.0

    def give(self, task: Task, seconds: float) -> None:
        """Its next task."""
        self.task, self.doing = task, ""
        self.allow(seconds)
        with contextlib.suppress(BrokenPipeError):  # it has ended: what waits for its answer sees that
            self.connection.send(task)

    def allow(self, seconds: float) -> None:
        """So many from now until it has to tell more."""
        self.seconds, self.deadline = seconds, time.monotonic() + seconds


class Pool(Generic[Task]):
    """Processes that do tasks, with an end of each that takes too long; they end with `close`, or with the tasks."""

    def __init__(self, work: Work[Task], jobs: int, seconds: float) -> None:
        """`work` is called in another process, and must be known there by its name; `seconds`: until it tells more."""
        self._work, self._jobs, self._seconds = work, jobs, seconds
        self._workers: list[Worker[Task]] = []

    def run(self, following: Callable[[], Task | None]) -> Generator[tuple[Worker[Task], str, Any]]:
        """What comes of all tasks: a worker, what happened, and a value. `following`: the next task, None: no more.

        "found": a value that it tells; "fault": an exception, in words; "crashed" and "hangs": the process has
        ended, or is ended as it takes too long, in words. The task of the worker is the one that this is about.
        """
        try:
            for _ in range(self._jobs):
                self._start(following)
            while self._workers:
                yield from self._wait(following)
        finally:
            self.close()

    def close(self) -> None:
        """End all of them."""
        self._end(self._workers)
        self._workers.clear()

    def _start(self, following: Callable[[], Task | None]) -> None:
        task = following()
        if task is not None:
            with deferred():
                self._workers.append(Worker(self._work))
            self._workers[-1].give(task, self._seconds)

    def _remove(self, worker: Worker[Task]) -> None:
        self._end([worker])
        self._workers.remove(worker)

    @staticmethod
    def _end(workers: Sequence[Worker[Task]]) -> None:
        with deferred():
            pids = {worker: worker.process.pid or 0 for worker in workers}
            busy = [pid for worker, pid in pids.items() if worker.task is not None and _runs(pid)]
            end([pid for pid in pids.values() if pid], busy)
            for worker in workers:
                worker.process.kill()  # one that has no group of its own yet
                worker.process.join()
                worker.connection.close()

    def _wait(self, following: Callable[[], Task | None]) -> Iterator[tuple[Worker[Task], str, Any]]:
        least = min(worker.deadline for worker in self._workers) - time.monotonic()
        ready = multiprocessing.connection.wait([worker.connection for worker in self._workers], max(least, 0.0))
        for worker in tuple(self._workers):
            if worker.connection in ready:
                try:
                    what, value = worker.connection.recv()
                except (EOFError, OSError):
                    # Its group first: once it is waited for, its number may be another's.
                    self._remove(worker)
                    yield worker, "crashed", f"its process ended with status {worker.process.exitcode}"
                    self._start(following)
                    continue
                if what == "doing":
                    worker.doing, seconds = value
                    if seconds:
                        worker.allow(seconds)
                elif what == "done":
                    self._go_on(worker, following, large=value > LARGEST_BYTES)
                else:
                    yield worker, what, value
            elif time.monotonic() > worker.deadline:
                yield worker, "hangs", f"no answer in {worker.seconds:g} seconds"
                self._remove(worker)
                self._start(following)

    def _go_on(self, worker: Worker[Task], following: Callable[[], Task | None], *, large: bool) -> None:
        """It is done with its task; one that has grown too large is done with all."""
        worker.task = None
        if large:
            self._remove(worker)
            self._start(following)
        elif (task := following()) is not None:
            worker.give(task, self._seconds)
        else:
            self._remove(worker)
