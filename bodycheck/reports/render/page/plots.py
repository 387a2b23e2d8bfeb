"""The data of the report's plots, and groups of methods whose lines overlap."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.joint_errors import joint_heading
from bodycheck.reports.measurement.measure_bounds import floor_of
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION, scale_of
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.verdicts import FAULTS
from bodycheck.reports.render.page.cost_at_accuracy import ERRORS, Cost
from bodycheck.reports.render.page.downsampling import packed_line, rounded, thinned_maxima, thinned_times
from bodycheck.reports.render.styles import Style, heading, merged
from bodycheck.reports.run_files.run_tables import MethodKey, cases_by_method, key_of, shown_case


def overlapping_methods(problem: Problem, cases: Sequence[CaseResult]) -> list[list[MethodKey]]:
    """Return the groups of methods whose orientation errors are equal at every step: their lines overlap.

    Methods with fewer than two errors are ignored.
    """
    lines: dict[MethodKey, tuple[Array, Array]] = {}
    for key, own in cases_by_method(cases).get(problem.scenario.name, {}).items():
        points = [(c.dt_s, c.columns[ORIENTATION]) for c in own if c.ok and c.dt_s is not None]
        if len(points) > 1:
            steps, errors = np.array(points).T
            lines[key] = steps, errors
    return [group for group in merged(lines, floor_of(problem.columns, ORIENTATION)) if len(group) > 1]


_FIRST_MEASURES = ("energy_drift", "angular_momentum_drift", "orientation_error_rad")


def plot_data(
    problem: Problem,
    cases: Sequence[CaseResult],
    method_rows: Sequence[Mapping[str, Any]],
    drawn: Mapping[MethodKey, Style],
    at_s: float | None,
    *,
    with_drifts: bool = True,
) -> dict[str, Any]:
    """Return the data of the plots of one scenario, with values rounded to 4 digits or more.

    cases, method_rows: all of the scenario. drawn: the styles; their numbers are the values of "m". at_s: the
    step at which drifts are shown over time. with_drifts: whether they are; they need the motions.
    """
    index = {key: style.number for key, style in drawn.items()}
    by_method = cases_by_method(cases).get(problem.scenario.name, {})
    standing = ((index[key], shown_case(own, at_s)) for key, own in by_method.items())
    shown = {m: case for m, case in standing if case is not None}
    return {
        "errors": [
            {
                "name": error,
                "title": heading(error),
                "floor": rounded(floor_of(problem.columns, error)),
                "fits": _known(method_rows, error, index, "order", "floor"),
                "best": _known(method_rows, error, index, "best_dt_s", "least_error", "measured_floor"),
            }
            for error in ERRORS
        ],
        "dt": at_s,
        "t": [rounded(t) for t in thinned_times(problem.times)],
        "drifts": _drifts(problem, shown, _growths(method_rows, index)) if with_drifts else None,
        "missing": [_mark(m, case) for m, case in shown.items() if case.columns["outcome"] in FAULTS],
        "points": [_point(index[key_of(case.columns)], case) for case in cases if case.ok],
        "faults": [
            _mark(index[key_of(case.columns)], case) for case in cases if case.columns["outcome"] in FAULTS
        ],
    }


def _drifts(
    problem: Problem, shown: Mapping[int, CaseResult], growths: Mapping[str, Mapping[int, str]]
) -> list[dict[str, Any]]:
    """Return each judged measure, and the error of each joint, over time: name, a line per method, growth."""
    named = (name for case in shown.values() for name in case.series if _is_drawn(name))
    measures = dict.fromkeys((*_FIRST_MEASURES, *named))
    drifts = []
    for measure in measures:
        scale = scale_of(problem.columns, measure)
        name = measure if scale > 0.0 else f"{measure}_abs"
        lines = _packed_lines(
            {
                m: thinned_maxima(case.series[measure] / (scale or 1.0))
                for m, case in shown.items()
                if measure in case.series
            }
        )
        if lines:
            unit = "" if scale > 0.0 else f", {MEASURES[measure].unit}"
            title = joint_heading(measure) or heading(measure) + unit
            drifts.append({"name": name, "title": title, "lines": lines, "growth": growths.get(measure, {})})
    return drifts


def _is_drawn(name: str) -> bool:
    return bool(joint_heading(name)) or (name in MEASURES and MEASURES[name].judged is not None)


def _packed_lines(lines: Mapping[int, Array]) -> dict[int, str | float | list[int]]:
    """Return the lines as stored in the page: of equal ones only the first, the others as [its number]."""
    stored: dict[int, str | float | list[int]] = {}
    for first, *others in merged({m: (np.empty(0), values) for m, values in lines.items()}):
        stored[first] = packed_line(lines[first])
        stored |= {m: [first] for m in others}
    return stored


def _growths(rows: Iterable[Mapping[str, Any]], index: Mapping[MethodKey, int]) -> dict[str, dict[int, str]]:
    """Return the growth with time in words, by measure and method, where one was found."""
    growths: dict[str, dict[int, str]] = {}
    for row in rows:
        if growth := growth_text(row):
            growths.setdefault(row["quantity"], {})[index[key_of(row)]] = growth
    return growths


def growth_text(row: Mapping[str, Any]) -> str:
    """Return the kind of growth of a row of methods.csv and its exponent; "" if there is none."""
    if (kind := row.get("growth")) is None:
        return ""
    if kind in ("bounded", "exponential"):  # not powers of t
        return str(kind)
    return f"{kind}, t^{number(row.get('growth_exponent'), 3)}"


def _point(m: int, case: CaseResult) -> dict[str, Any]:
    columns = case.columns
    point: dict[str, Any] = {
        "m": m,
        "dt": case.dt_s,
        "errors": [rounded(columns[error]) if error in columns else None for error in ERRORS],
    }
    if case.setting.tolerance is not None:
        point["tolerance"] = case.setting.tolerance
    if "cpu_s" in columns:
        point["cpu"] = [rounded(columns[name]) for name in ("cpu_s_low", "cpu_s", "cpu_s_high")]
        point["stepping"] = columns["stepping"]
        if "ns_per_step" in columns:
            point["ns"] = rounded(columns["ns_per_step"])
    return point


def _known(
    rows: Iterable[Mapping[str, Any]], error: str, index: Mapping[MethodKey, int], *columns: str
) -> dict[int, list[float]]:
    """Return these columns of methods.csv for this error, of each method that has them all."""
    return {
        index[key_of(row)]: [rounded(row[name]) for name in columns]
        for row in rows
        if row["quantity"] == error and all(name in row for name in columns)
    }


def _mark(m: int, case: CaseResult) -> dict[str, Any]:
    return {
        "m": m,
        "dt": case.dt_s,
        "tolerance": case.setting.tolerance,
        "outcome": case.columns["outcome"],
        "message": case.columns["message"],
    }


def overall_data(
    found: Mapping[str, Mapping[MethodKey, Sequence[Cost]]], drawn: Mapping[MethodKey, Style]
) -> list[dict[str, Any]]:
    """Return the data of the plot over all scenarios: for each error, the costs of every method.

    found: error -> method -> its costs. drawn: the methods that some scenario supports. One that meets no
    tolerance in most of its scenarios has no line and is listed under "faults".
    """
    return [
        {
            "name": error,
            "title": heading(error),
            "points": [
                _cost_point(drawn[cost.key].number, cost) for own in of_error.values() for cost in own
            ],
            "faults": [
                {"m": style.number, "message": _why_missing(of_error.get(key, ()))}
                for key, style in drawn.items()
                if not any(math.isfinite(cost.median) for cost in of_error.get(key, ()))
            ],
        }
        for error, of_error in found.items()
    ]


def _cost_point(m: int, cost: Cost) -> dict[str, Any]:
    seconds = (cost.low, cost.median, cost.high)
    return {
        "m": m,
        "error": cost.target,
        "cost": [rounded(s) if math.isfinite(s) else None for s in seconds],
        "met": cost.met,
        "scenarios": cost.scenarios,
    }


def _why_missing(own: Sequence[Cost]) -> str:
    if not own:
        return "not measured: no case has outcome ok, or no error of this kind"
    coarsest = own[0]
    return f"meets {coarsest.target:g} in {coarsest.met} of {coarsest.scenarios} scenarios"
