"""A run judged only up to a horizon: its measures, orders and verdicts until that time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Method
from bodycheck.reports.measurement.case import CaseResult, measured_by
from bodycheck.reports.measurement.measures import Motion
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.study import method_rows
from bodycheck.reports.run_files.run_tables import Run, cases_by_method
from bodycheck.reports.run_files.tables import METHOD_COLUMNS, as_table

_SAME = 1e-9  # relative difference of two times that count as equal


def until(run: Run, horizon_s: float) -> Run:
    """Return a run with the errors, orders and verdicts of its motions up to a time in s.

    Scales and speeds are those of the whole scenario. Raises InputError where a scenario has no sample up to
    the horizon besides the first.
    """
    problems = {problem.scenario.name: _cut(problem, horizon_s) for problem in run.problems}
    cases = tuple(_measured_until(case, problems[case.columns["scenario"]]) for case in run.cases)
    rows = ({"run_id": run.run_id, **row} for row in _rows(run, cases, problems))
    return replace(
        run, cases=cases, methods=as_table(rows, METHOD_COLUMNS), problems=tuple(problems.values())
    )


def check_horizon(horizon_s: float, scenario: str, interval_s: float) -> None:
    """Raise InputError where a horizon is shorter than the sampling interval of a scenario, both in s."""
    if interval_s > horizon_s * (1.0 + _SAME):
        raise InputError(f"--horizon-s {horizon_s!r}: the first sample of {scenario} is at {interval_s!r} s")


def _cut(problem: Problem, horizon_s: float) -> Problem:
    check_horizon(horizon_s, problem.scenario.name, float(problem.times[1]))
    until = int(np.count_nonzero(problem.times <= horizon_s * (1.0 + _SAME)))
    return replace(problem, compared=until)


def _measured_until(case: CaseResult, problem: Problem) -> CaseResult:
    if not case.ok or case.trajectory is None:
        return case
    motion = Motion.of(problem.scenario.scene, case.trajectory)
    measured, moved = measured_by(problem, case.trajectory, motion)
    return CaseResult(case.columns | problem.columns | measured, moved)


def _rows(run: Run, cases: tuple[CaseResult, ...], problems: dict[str, Problem]) -> Iterator[dict[str, Any]]:
    for scenario, methods in cases_by_method(cases).items():
        for (engine, name), own in methods.items():
            facts = run.manifest["engines"][engine]["methods"][name]
            coarsest_first = sorted(own, key=lambda case: -(case.setting.fineness or 0.0))
            yield from method_rows(coarsest_first, problems[scenario], Method.of(facts))
