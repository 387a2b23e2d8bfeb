"""The certified truth of a forced motion: what it costs, and how small its bound is."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Measured
from benchmarks.task import Call
from benchmarks.timing import Spread, interleaved
from benchmarks.topics.forced import FORCED
from bodycheck.reference_impl.truth.certification import solve_truth


def certified(effort: Effort) -> list[Measured]:
    """Solve for the end of each forced motion; the slowest and the least certain stand for all."""
    ends = [np.array([problem.scene.duration_s]) for problem in FORCED]
    tasks = [
        Call(partial(solve_truth, problem.scene, end)) for problem, end in zip(FORCED, ends, strict=True)
    ]
    spreads = [Spread.of(spent).scaled(1e3) for spent in interleaved(tasks, effort)]
    bounds = [
        float(solve_truth(problem.scene, end).bound_rad[0]) for problem, end in zip(FORCED, ends, strict=True)
    ]
    slowest = max(range(len(FORCED)), key=lambda i: spreads[i].median)
    loosest = max(range(len(FORCED)), key=lambda i: bounds[i])
    return [
        Measured.of("truth.time", spreads[slowest], FORCED[slowest].name),
        Measured("truth.bound", bounds[loosest], note=FORCED[loosest].name),
    ]
