"""SIGTERM and SIGHUP end what is done as Ctrl-C does."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from validation.commands.errors import INTERRUPTED, TERMINATED

#: Set by SIGTERM, where it ends the program as Ctrl-C does.
terminated = threading.Event()


def ended() -> int:
    """The exit status of what was ended early."""
    return TERMINATED if terminated.is_set() else INTERRUPTED


@contextmanager
def ending() -> Iterator[None]:
    """SIGTERM and SIGHUP end what is done here as Ctrl-C does: other processes first, and nothing is left behind."""

    def end(*_: object) -> None:
        terminated.set()
        if not callable(signal.getsignal(signal.SIGINT)):  # a script may have it ignored
            signal.signal(signal.SIGINT, signal.default_int_handler)
        # Put off like Ctrl-C where that is: so it goes to this thread.
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    ends = (signal.SIGTERM, signal.SIGHUP) if hasattr(signal, "SIGHUP") else (signal.SIGTERM,)
    before = {number: signal.getsignal(number) for number in ends}
    if threading.current_thread() is threading.main_thread():
        for number, handler in before.items():
            if handler == signal.SIG_DFL:  # a script, or nohup, may have it ignored
                signal.signal(number, end)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                signal.signal(number, handler)
