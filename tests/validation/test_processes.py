"""Processes that take tasks: what is told of one that does not answer, and that none of a group is left."""

from __future__ import annotations

import os
import time

import pytest

from validation.processes import Pool, Teller


def work(task: str, teller: Teller) -> None:
    if task == "slow":
        teller.doing("something", 0.25)
        time.sleep(60)
    os._exit(7)


def only(pool: Pool[str], task: str) -> list[tuple[str, object]]:
    tasks = iter([task])
    return [(what, value) for _, what, value in pool.run(lambda: next(tasks, None))]


def test_the_seconds_that_are_told_are_those_of_the_task() -> None:
    assert only(Pool(work, 1, 30), "slow") == [("hangs", "no answer in 0.25 seconds")]


def test_a_group_is_ended_before_its_head_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    killed: list[bool] = []
    real = os.killpg

    def killpg(pid: int, number: int) -> None:
        # Raises where the process has been waited for: from then on the number may be another's.
        killed.append(os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None)
        real(pid, number)

    monkeypatch.setattr(os, "killpg", killpg)
    assert only(Pool(work, 1, 30), "crash") == [("crashed", "its process ended with status 7")]
    assert killed == [True]
