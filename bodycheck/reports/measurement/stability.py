"""The stability map: the largest stable step of each method on each scenario, one row per pair."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from bodycheck.adapters.contract import Build, Engine, Method, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import Search, StableStep, kinetic_limit
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measures import IDENTITY
from bodycheck.reports.measurement.problem import Problem

Searching: TypeAlias = Callable[[Engine, Search], StableStep]
"""A function that answers a search, from the engine or from a stored answer."""

_FINER = 5.0  # the search goes down to the finest requested step over this
_MIN_STEPS = 4  # of a trial: fewer steps say nothing about stability
_MAX_STEPS = 20_000  # of the first trial, which is the longest
_SEARCHED = ("ok", "unstable")


def stability_row(
    problem: Problem, engine: Engine, method: Method, cases: Sequence[CaseResult], search: Searching
) -> dict[str, Any]:
    """Return a row of stability.csv without run_id: the result of a search, or why there was none.

    cases: all cases of this method on this scenario, in any order. The search starts at the coarsest step for
    which this step and all finer ones were stable.
    """
    row = {name: cases[0].columns[name] for name in IDENTITY}
    for case in cases:
        if case.columns["outcome"] not in _SEARCHED:
            return {**row, "outcome": case.columns["outcome"], "message": case.columns["message"]}
    found = search(engine, _search(problem, method, cases))
    return {
        **row,
        "dt_stable_s": found.stable_s,
        "dt_unstable_s": found.unstable_s,
        "reason": found.reason,
        "outcome": found.outcome,
        "message": found.message,
        "reused": found.reused,
        "build": Build(found.build).short,
    }


def _search(problem: Problem, method: Method, cases: Sequence[CaseResult]) -> Search:
    """Search from the coarsest step known to be stable up to one turn, or a quarter of the duration."""
    scene = problem.scenario.scene
    finest_first = sorted((case.dt_s or 0.0, case.ok) for case in cases)
    finest = start = finest_first[0][0]
    for step, stable in finest_first:
        if not stable:
            break
        start = step
    omega = problem.scales.omega_scale_rad_s
    period_s = 2.0 * math.pi / omega if omega > 0.0 else math.inf
    start = max(start, scene.duration_s / _MAX_STEPS)
    return Search(
        case=Case(scene, method.name, Setting(dt_s=start)),
        lowest_s=finest / _FINER,
        highest_s=max(min(period_s, scene.duration_s / _MIN_STEPS), start),
        kinetic_limit_j=kinetic_limit(problem.motion.kinetic),
    )
