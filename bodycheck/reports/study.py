"""One method on one scenario: its cases from step to step, and what they say together."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reports.bounds import BOUND_KINDS, floor_of
from bodycheck.reports.case import Asking, CaseResult, run_case
from bodycheck.reports.convergence import ABOVE_FLOOR, LARGEST_ERROR, Point, convergence_of, obedience_of
from bodycheck.reports.growth import Growth, growth_of
from bodycheck.reports.ladder import next_step
from bodycheck.reports.measures import scale_of
from bodycheck.reports.stability import Searching, stability_row
from bodycheck.reports.subject import Subject
from bodycheck.reports.tables import WHO

_ORIENTATION = "orientation_error_rad"
_EPS = float(np.finfo(np.float64).eps)
QUANTITIES = (_ORIENTATION, "omega_error", "energy_drift", "angular_momentum_drift", "position_error")
"""The measures of which an order is fitted."""


@dataclass(frozen=True, eq=False)
class Study:
    """The cases of one method on one scenario, coarsest step first, and what they say together.

    method_rows: one a quantity of methods.csv. stability_row: of stability.csv, where that was asked for.
    """

    cases: tuple[CaseResult, ...]
    method_rows: tuple[dict[str, Any], ...]
    stability_row: dict[str, Any] | None = None


def study(
    subject: Subject,
    engine: Engine,
    method: Method,
    settings: Sequence[Setting],
    *,
    adaptive: bool,
    ask: Asking,
    search: Searching | None,
    case_done: Callable[[], None],
) -> Study:
    """Run the settings asked for and, if adaptive, more steps until an order shows or the budget ends.

    If adaptive, the largest stable step is looked for too; search: how, None where nobody wants to know.
    """
    cases: list[CaseResult] = []
    stepped = adaptive and method.control == "dt"

    def make(setting: Setting) -> CaseResult:
        case = run_case(subject, engine, method, setting, ask)
        _insert(cases, case)
        case_done()
        return case

    def stable_step() -> dict[str, Any] | None:
        if not stepped or search is None:
            return None
        return stability_row(subject, engine, method, cases, search)

    for setting in settings:
        if make(setting).columns["outcome"] == "unsupported":
            # a scene that cannot be represented is so at every step
            return Study(tuple(cases), (), stable_step())
    if method.control == "none":
        return Study(tuple(cases), ())
    scene = subject.scenario.scene
    asked = [setting.dt_s for setting in settings if setting.dt_s is not None]
    while stepped:
        points = _points(cases, _ORIENTATION)
        step = next_step(
            points, limit(subject, _ORIENTATION), asked, scene.sample_interval_s, scene.duration_s
        )
        if step is None:
            break
        make(Setting(dt_s=step))
    return Study(tuple(cases), tuple(_method_rows(cases, subject, method)), stable_step())


def limit(subject: Subject, quantity: str) -> float:
    """max(3 bound, eps sensitivity): an error below it is at the floor, in rad or of the scale."""
    truth = subject.truth
    round_off = subject.largest(getattr(truth, f"round_off_{BOUND_KINDS[quantity]}"))
    least = max(floor_of(subject.columns, quantity), round_off)
    if quantity == "position_error":
        # far from the origin a position is no better than its own last digit
        farthest = float(np.max(np.abs(truth.trajectory.position_m)))
        least = max(least, 3.0 * _EPS * farthest / subject.scales.length_scale_m)
    return least


def _insert(cases: list[CaseResult], case: CaseResult) -> None:
    """Put a case among the others, coarsest first; the step changes of it and of the next finer follow."""
    place = bisect_right(cases, -_fineness(case), key=lambda other: -_fineness(other))
    cases.insert(place, case)
    for finer in range(max(place, 1), min(place + 2, len(cases))):
        cases[finer] = _with_step_change(cases[finer - 1], cases[finer])


def _fineness(case: CaseResult) -> float:
    return case.setting.fineness or 0.0


def _with_step_change(coarser: CaseResult, case: CaseResult) -> CaseResult:
    """Return the case with its largest angle to the next coarser one, where both ended well."""
    columns = {name: value for name, value in case.columns.items() if name != "step_change_rad"}
    if case.ok and coarser.ok and case.trajectory is not None and coarser.trajectory is not None:
        change = geodesic_angle(coarser.trajectory.attitude, case.trajectory.attitude)
        columns["step_change_rad"] = float(np.max(change))
    return replace(case, columns=columns)


def _points(cases: Sequence[CaseResult], quantity: str) -> list[Point]:
    """Return the cases as points of error against step; without an error where one did not end well."""
    points = []
    for case in cases:
        fineness = case.setting.fineness
        assert fineness is not None
        change, error = case.columns.get("step_change_rad"), case.columns.get(_ORIENTATION)
        settling = change / error if change is not None and error else None
        points.append(Point(fineness, case.columns.get(quantity) if case.ok else None, settling))
    return points


def _method_rows(cases: Sequence[CaseResult], subject: Subject, method: Method) -> Iterator[dict[str, Any]]:
    who = {name: cases[0].columns[name] for name in WHO}
    judged = convergence_of if method.control == "dt" else obedience_of
    for quantity in QUANTITIES:
        measured = any(quantity in case.columns for case in cases)
        if measured or any(case.columns["outcome"] == "unstable" for case in cases):
            found = judged(_points(cases, quantity), limit(subject, quantity))
            growth = _growth(cases, subject, quantity, found.floor)
            yield {**who, "quantity": quantity, **vars(found), **vars(growth)}


def _growth(cases: Sequence[CaseResult], subject: Subject, quantity: str, floor: float) -> Growth:
    """Return how a quantity grows in the finest case well above its floor, else in the finest."""
    sound = [case for case in cases if case.ok and case.columns.get(quantity, 1.0) < LARGEST_ERROR]
    if not sound:
        return Growth()
    telling = [case for case in sound if case.columns[quantity] > ABOVE_FLOOR * floor]
    case = (telling or sound)[-1]
    relative = case.series[quantity] / scale_of(subject.columns, quantity)
    return growth_of(subject.times, relative, floor_of(subject.columns, quantity))
