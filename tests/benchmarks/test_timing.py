"""Timing: the order of the runs and the arithmetic; no test depends on how long anything takes."""

from __future__ import annotations

import gc
from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.timing import QUICK, Spread, interleaved, ratio


@dataclass
class Noted:
    """A task that records when it is reset and run."""

    name: str
    log: list[str]

    def reset(self) -> None:
        """Record the reset."""
        self.log.append(f"reset {self.name}")

    def run(self) -> None:
        """Record the run, which must directly follow a reset."""
        assert self.log[-1] == f"reset {self.name}"
        self.log.append(self.name)


def test_rounds_rotate_the_order_of_tasks() -> None:
    """After the warm-up each round has each task once, in a rotated order, always from its start."""
    log: list[str] = []
    seconds = interleaved([Noted(name, log) for name in "abc"], replace(QUICK, rounds=4))
    runs = "".join(entry for entry in log if not entry.startswith("reset"))
    assert runs == "aabbcc" + "abc" + "bca" + "cab" + "abc"
    assert seconds.shape == (3, 4)
    assert (seconds >= 0.0).all()


def test_short_tasks_are_run_often_enough_to_fill_their_time() -> None:
    """A task much shorter than the seconds of a round is repeated in it."""
    log: list[str] = []
    interleaved([Noted("a", log)], replace(QUICK, rounds=1, seconds=1e-3))
    assert log.count("a") > 3


@pytest.mark.parametrize("was_on", [True, False])
def test_garbage_collection_is_restored(was_on: bool) -> None:
    """Garbage collection is off during the timing, and as before afterwards."""
    within: list[bool] = []

    class Looking(Noted):
        def run(self) -> None:
            within.append(gc.isenabled())

    before = gc.isenabled()
    (gc.enable if was_on else gc.disable)()
    try:
        interleaved([Looking("a", [])], QUICK)
        assert gc.isenabled() is was_on
    finally:
        (gc.enable if before else gc.disable)()
    assert not any(within[-QUICK.rounds :])


def test_paired_ratios_ignore_common_slowdowns() -> None:
    """A round that slows both tasks alike does not change the paired ratios."""
    fast = np.array([1.0, 1.0, 1.0, 5.0, 5.0])
    found = ratio(3.0 * fast, fast)
    assert (found.median, found.low, found.high) == (3.0, 3.0, 3.0)
    assert ratio(np.array([2.0, 4.0, 6.0]), np.array([1.0, 1.0, 2.0])).median == 4.0
    assert Spread.of(np.arange(5.0)).scaled(2.0) == Spread(4.0, 2.0, 6.0)
