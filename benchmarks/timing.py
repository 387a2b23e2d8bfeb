"""How much is measured, and interleaved timing, so that disturbances of the machine affect all tasks."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.solver import Task
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.precompile import without_garbage_collection

_MAX_RUNS = 2000  # of one task in one round


@dataclass(frozen=True)
class Effort:
    """Sizes and repeats.

    rounds: of interleaved timing. seconds: time per task and round. targets: the errors of the work-precision
    curves. orbits, steps: of the long-term drift. bodies: per batch. subdivisions: n of the icosahedron of
    20 x 4^n triangles whose mass properties are computed. starts: the number of separate processes.
    """

    rounds: int
    seconds: float
    targets: tuple[float, ...]
    orbits: int
    steps: int
    bodies: int
    subdivisions: int
    starts: int


FULL = Effort(
    rounds=11,
    seconds=0.02,
    targets=tuple(10.0**-k for k in range(3, 14)),
    orbits=8,
    steps=1_000_000,
    bodies=100_000,
    subdivisions=6,
    starts=5,
)

QUICK = Effort(
    rounds=3,
    seconds=0.0,
    targets=(1e-3, 1e-9, 1e-11, 1e-12),
    orbits=2,
    steps=1_000,
    bodies=1_000,
    subdivisions=1,
    starts=0,
)


@dataclass(frozen=True)
class Spread:
    """A median and its quartiles."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Array) -> Spread:
        """Return the spread of values (n,)."""
        low, median, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
        return cls(median, low, high)

    def scaled(self, factor: float) -> Spread:
        """Return the spread times a factor > 0."""
        return Spread(factor * self.median, factor * self.low, factor * self.high)


def interleaved(tasks: Sequence[Task], effort: Effort) -> Array:
    """Time the tasks round-robin: (tasks, rounds) in s, each the median of the runs of its round.

    Each round begins with a different task. Times are wall-clock times, with the garbage collector off and
    without resets. The first run of each task, which may compile or fill caches, is not counted.
    """
    repeats = [_repeats(task, effort.seconds) for task in tasks]
    seconds = np.empty((len(tasks), effort.rounds))
    with without_garbage_collection():
        for k in range(effort.rounds):
            for place in range(len(tasks)):
                i = (k + place) % len(tasks)
                seconds[i, k] = np.median([_once(tasks[i]) for _ in range(repeats[i])])
    return seconds


def ratio(slower: Array, faster: Array) -> Spread:
    """The ratio of the medians, with the quartiles of the ratios per round; slower, faster: (rounds,)."""
    rounds = Spread.of(slower / faster)
    return Spread(float(np.median(slower) / np.median(faster)), rounds.low, rounds.high)


def _once(task: Task) -> float:
    task.reset()
    begin = time.perf_counter_ns()
    task.run()
    return 1e-9 * (time.perf_counter_ns() - begin)


def _repeats(task: Task, seconds: float) -> int:
    _once(task)
    return min(max(math.ceil(seconds / max(_once(task), 1e-9)), 1), _MAX_RUNS)
