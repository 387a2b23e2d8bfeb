"""Tune a contender: find the cheapest setting that meets each target error.

All contenders are tuned by the same search, over grids of the same spacing.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from benchmarks.contenders.contender import Contender, Solver
from benchmarks.problems import Problem


@dataclass(frozen=True, eq=False)
class Tried:
    """One setting, the solver prepared for it, the time of the preparation, and the error."""

    setting: float
    solver: Solver
    prepare_s: float
    error: float


def tried(contender: Contender, problem: Problem, hardest: float) -> list[Tried]:
    """Try the settings, cheapest first, up to the first whose error is at most `hardest`."""
    found: list[Tried] = []
    for setting in contender.settings:
        begin = time.perf_counter()
        solver = contender.prepare(problem, setting)
        prepared = time.perf_counter() - begin
        solver.reset()
        solver.run()
        found.append(Tried(setting, solver, prepared, problem.error(solver.end())))
        if found[-1].error <= hardest:
            break
    return found


def cheapest(found: Iterable[Tried], target: float) -> Tried | None:
    """Return the first, and so the cheapest, whose error is at most the target, or None."""
    return next((one for one in found if one.error <= target), None)


def most_accurate(found: Sequence[Tried]) -> Tried:
    """Return the one with the smallest error; of equal errors, the cheapest."""
    return min(found, key=lambda one: one.error)
