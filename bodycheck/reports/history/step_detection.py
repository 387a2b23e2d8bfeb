"""Detect steps and creep in noisy series online, each from the values known at the time.

A disturbed machine makes everything slower, never faster, in every tenth or even every second nightly run.
The level is therefore where most runs lie close together, and the fastest of several runs is the least
disturbed. A step is found from the runs just before it. A level that creeps moves with these, so that the
latest runs are also compared with the accepted level: that of the first runs, or of those after a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

MIN_BEFORE = 8
"""The number of nightly runs that establish a level before a step from it can be detected."""
MIN_AFTER = 5
"""The number of runs that a slower level needs: a few may be disturbed. A faster level needs only three."""
_MAX_BEFORE = 20
FIRST_RUNS = 20
"""The number of runs whose level is the accepted one, from which a speed may creep."""
_SIGMAS = 2.5
MIN_STEP = math.log10(1.08)
"""The smallest shift of a level that counts, in decades."""
_CREEP_RUNS = 15  # that are compared with the accepted level
_CREEP_SIGMAS = 2.0
_UNDISTURBED = 0.15  # quantile of a level whose slower half may be disturbed
_HALF_TO_SIGMA = 1.0 / 0.6745  # half of a normal distribution lies within 0.6745 sigma


@dataclass(frozen=True)
class Step:
    """A step to another level: its first run, the run in which it was detected, and its size in decades.

    creeps: whether the level crept there from the accepted one, which no single step explains.
    """

    first: int
    detected_at: int
    size: float
    creeps: bool = False


def detect_steps(series: Array) -> list[list[Step]]:
    """Return the steps of each column of series (runs, methods); NaN: not measured.

    Up if min(last five) - level(baseline) > T, down if min(baseline) - median(last five) > T, where the
    baseline is the m <= 20 runs before the last five, T = max(8 %, 2.5 sigma) and sigma is the median over
    the columns. Creep if |q(last 15) - q(first 20)| > max(8 %, 2 sigma) with the 15 % quantile q. After a
    step, the runs before it are ignored. The result for a run does not depend on later runs.
    """
    found: list[list[Step]] = [[] for _ in range(series.shape[1])]
    changes = np.diff(series, axis=0) / math.sqrt(2.0)  # creep does not widen these
    for run in range(MIN_BEFORE + MIN_AFTER - 1, len(series)):
        spread = pooled_spread(series[: run + 1], found)
        edge = max(MIN_STEP, _SIGMAS * spread)
        creep = max(MIN_STEP, _CREEP_SIGMAS * min(spread, pooled_spread(changes[:run], found)))
        for column, steps in zip(series.T, found, strict=True):
            if math.isnan(column[run]):
                continue
            (measured,) = np.nonzero(~np.isnan(column[: run + 1]))
            on_level = measured[measured >= _level_start(steps)]
            step = _step_detected(column, on_level, edge) or _creep_detected(column, on_level, creep)
            if step is not None:
                steps.append(step)
    return found


def pooled_spread(series: Array, steps: Sequence[Sequence[Step]]) -> float:
    """Return the median over the columns of sigma, each from the up to 20 runs before the last five.

    series: (runs, methods). steps: the detected steps of each column; runs before the last step are
    ignored. Returns 0 if no column has enough runs on its level.
    """
    before = series[:-MIN_AFTER]
    levels = (column[_level_start(moved) :] for column, moved in zip(before.T, steps, strict=True))
    measured = (level[~np.isnan(level)] for level in levels)
    spreads = [_shortest_half(values[-_MAX_BEFORE:])[1] for values in measured if len(values) >= MIN_BEFORE]
    return float(np.median(spreads)) if spreads else 0.0


def smallest_detectable_step(spread: float) -> float:
    """Return the smallest step that is certain to be detected by its fifth run, given the spread."""
    # the fastest of five runs lies up to 2.5 sigma low; the level before is known to half a sigma
    return max(MIN_STEP, _SIGMAS * spread) + 3.5 * spread


def _level_start(steps: Sequence[Step]) -> int:
    return steps[-1].first if steps else 0


def _step_detected(column: Array, measured: NDArray[np.intp], edge: float) -> Step | None:
    """Return the step of one column within the last five runs that measured it; None if there is none."""
    before, now = column[measured[:-MIN_AFTER][-_MAX_BEFORE:]], column[measured[-MIN_AFTER:]]
    if len(before) < MIN_BEFORE:
        return None
    level, _ = _shortest_half(before)
    slower = float(np.min(now)) - level > edge
    faster = float(np.min(before)) - float(np.median(now)) > edge
    if not slower and not faster:
        return None
    size = (_shortest_half(now)[0] if slower else float(np.median(now))) - level
    first = int(np.argmax((now - level) / size > 0.5))
    return Step(int(measured[-MIN_AFTER + first]), int(measured[-1]), size)


def _creep_detected(column: Array, measured: NDArray[np.intp], edge: float) -> Step | None:
    """Return the creep of one column from its accepted level; None if there is none.

    measured: the runs on the level. Half of the shift must precede the last five runs: otherwise it is a
    step, or no level yet.
    """
    before, now = column[measured[:-_CREEP_RUNS][:FIRST_RUNS]], column[measured[-_CREEP_RUNS:]]
    if len(before) < FIRST_RUNS:
        return None
    level = _undisturbed(before)
    size, earlier = _undisturbed(now) - level, _undisturbed(now[:-MIN_AFTER]) - level
    if abs(size) <= edge or earlier / size <= 0.5:
        return None
    return Step(int(measured[-_CREEP_RUNS]), int(measured[-1]), size, creeps=True)


def _undisturbed(values: Array) -> float:
    """Return the level of values (n,) of which the slower half may be disturbed: their 15 % quantile."""
    return float(np.quantile(values, _UNDISTURBED))


def _shortest_half(values: Array) -> tuple[float, float]:
    """Return median and sigma of the half of the values (n,) that lie closest together.

    Up to half of the values may be outliers. Source: the shortest half, Rousseeuw and Leroy (1987), with
    their factor 1 + 5 / (n - 1), because the shortest half of few values is too short.
    """
    ordered, half = np.sort(values), len(values) // 2 + 1
    widths = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
    first = int(np.argmin(widths))
    sigma = 0.5 * _HALF_TO_SIGMA * (1.0 + 5.0 / (len(values) - 1)) * float(widths[first])
    return float(np.median(ordered[first : first + half])), sigma


Key: TypeAlias = tuple[str, str]
"""Engine and method."""

CASE = ["engine", "method", "scenario", "control", "dt_s", "tolerance"]


@dataclass(frozen=True, eq=False)
class Series:
    """log10(x / median of x over the runs), (runs, methods); NaN if not measured.

    runs: names of the nightly runs, the oldest first.
    """

    runs: tuple[str, ...]
    methods: tuple[Key, ...]
    decades: Array

    @property
    def measured(self) -> int:
        """The number of nightly runs with any value."""
        return int(np.sum(~np.all(np.isnan(self.decades), axis=1))) if self.methods else 0


def series_of(
    runs: Sequence[str], cases: pd.DataFrame, measure: str, of_cases: Callable[[pd.Series], float]
) -> Series:
    """of_cases(log10(x / median of x over the runs)) for each method and run, with x the measure of a case.

    runs: names of the nightly runs, the oldest first. cases: one row per case and run, with `run` and the
    measure. of_cases: reduces the decades of a method's cases in one run to one number.
    """
    positive = cases[cases[measure] > 0.0]
    if positive.empty:
        return Series(tuple(runs), (), np.empty((len(runs), 0)))
    logs = positive.assign(log=np.log10(positive[measure]))
    logs["log"] -= logs.groupby(CASE, dropna=False)["log"].transform("median")
    table = logs.groupby(["run", "engine", "method"])["log"].agg(of_cases).unstack(["engine", "method"])
    table = table.reindex(list(runs)).sort_index(axis=1)
    methods = tuple(zip(*(table.columns.get_level_values(level) for level in (0, 1)), strict=True))
    return Series(tuple(runs), methods, table.to_numpy(dtype=np.float64))
