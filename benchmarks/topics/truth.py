"""What the certified truth of a forced motion costs, how small its bound is, and the start of a process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.figures import Measured
from benchmarks.problems import FORCED
from benchmarks.solver import Task
from benchmarks.timing import Effort, Spread, interleaved
from bodycheck.reference_impl.truth.certification import solve_truth

_COMMAND = (sys.executable, "-m", "bodycheck", "truth", "intermediate-axis", "--at")

_TREE = Path(__file__).parents[2]  # python -m finds the package of this very tree there


def certified(effort: Effort) -> list[Measured]:
    """Solve for the end of each forced motion; the slowest and the least certain stand for all."""
    ends = [np.array([problem.scene.duration_s]) for problem in FORCED]
    tasks = [
        Task(partial(solve_truth, problem.scene, end)) for problem, end in zip(FORCED, ends, strict=True)
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


def start(effort: Effort) -> list[Measured]:
    """Measure a free truth from an empty folder, then others: at times whose answer is kept nowhere."""
    if effort.starts == 0:
        return [Measured(name, None, note="left out here") for name in ("start.first", "start.later")]
    with tempfile.TemporaryDirectory() as folder:
        first, *later = (_seconds(f"0,1,{10 + k}", folder) for k in range(1 + effort.starts))
    command = " ".join(("bodycheck", *_COMMAND[3:], "0,1,10"))
    return [
        Measured("start.first", first, note=command),
        Measured.of("start.later", Spread.of(np.array(later)), command),
    ]


def _seconds(at: str, kernels: str) -> float:
    begin = time.perf_counter()
    subprocess.run(
        (*_COMMAND, at),
        cwd=_TREE,
        env={**os.environ, "BODYCHECK_CACHE_DIR": kernels},
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return time.perf_counter() - begin
