"""What is tuned and timed, and the search for the cheapest setting that meets each target error.

All contenders are tuned by the same search, over grids of the same spacing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from benchmarks.problems import End, Problem

Knob: TypeAlias = Literal["steps", "tolerance", "none"]


@dataclass(frozen=True, eq=False)
class Task:
    """What can be timed again and again: run is timed, reset goes back to its start and is not."""

    run: Callable[[], Any]
    reset: Callable[[], object] = lambda: None


@dataclass(frozen=True, eq=False, kw_only=True)
class Solver(Task):
    """One problem, at one setting, made ready; end_of: what a run returned -> where it came to."""

    end_of: Callable[[Any], End]

    def end(self) -> End:
        """Go from the start to the end, and return the end."""
        self.reset()
        return self.end_of(self.run())


@dataclass(frozen=True)
class Contender:
    """A solver and the one knob by which it is tuned.

    settings: of the knob, the cheapest first. prepare: builds and compiles what a problem at a setting
    needs; timed apart from the running.
    """

    name: str
    version: str
    knob: Knob
    settings: tuple[float, ...]
    prepare: Callable[[Problem, float], Solver]


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


_FINENESS = 8  # settings to an octave of steps, or to a decade of tolerance


def step_counts(fewest: int, most: int) -> tuple[float, ...]:
    """round(fewest 2^(k/8)), up to the most: nine per cent apart."""
    last = math.floor(_FINENESS * math.log2(most / fewest))
    return tuple(sorted({float(round(fewest * 2.0 ** (k / _FINENESS))) for k in range(last + 1)}))


def tolerances(loosest: float, tightest: float) -> tuple[float, ...]:
    """Loosest 10^(-k/8), down to the tightest."""
    last = math.floor(_FINENESS * math.log10(loosest / tightest) + 1e-9)
    return tuple(loosest * 10.0 ** (-k / _FINENESS) for k in range(last + 1))
