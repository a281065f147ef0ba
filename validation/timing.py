"""How long something takes, in words: what progress says about the rest."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable


def now() -> str:
    """Date and time, as ISO 8601 has it."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def duration(seconds: float) -> str:
    """A length of time as people say it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Pulse:
    """What goes on quickly is told once a second, not always."""

    def __init__(self, seconds: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        """First when so many seconds are over."""
        self._seconds, self._clock, self._last = seconds, clock, clock()

    def due(self) -> bool:
        """Whether it is time to tell."""
        now = self._clock()
        if now - self._last < self._seconds:
            return False
        self._last = now
        return True


class TimeLeft:
    """How long the rest of so many equal parts takes, if it goes on as it began."""

    def __init__(self, parts: int, clock: Callable[[], float] = time.monotonic) -> None:
        """The time begins now."""
        self._parts, self._clock, self._start = parts, clock, clock()

    def says(self, done: int) -> str:
        """Such as ", 40 s left"; nothing before there is something to go by, and nothing of what is one part alone."""
        if not 0 < done <= self._parts or self._parts < 2:
            return ""
        return f", {duration((self._clock() - self._start) / done * (self._parts - done))} left"
