"""Tuning: for each error that is wanted, the cheapest setting of a contender that keeps it.

Every contender is tuned by this one search, over a grid of the same fineness.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from benchmarks.contenders.contender import Contender, Solver
from benchmarks.problems import Problem


@dataclass(frozen=True, eq=False)
class Tried:
    """One setting, the solver made ready for it, what making it ready took, and its error."""

    setting: float
    solver: Solver
    prepare_s: float
    error: float


def tried(contender: Contender, problem: Problem, hardest: float) -> list[Tried]:
    """Try the settings in turn, the cheapest first, up to the first whose error is the hardest or less."""
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
    """Return the first, hence the cheapest, whose error is at most the target; None where none is."""
    return next((one for one in found if one.error <= target), None)


def most_accurate(found: Sequence[Tried]) -> Tried:
    """Return the one of the smallest error, the cheapest of equals."""
    return min(found, key=lambda one: one.error)
