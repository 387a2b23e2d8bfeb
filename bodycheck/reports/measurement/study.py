"""One method on one scenario: its cases over all steps, their joint verdicts, its largest stable step."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from hashlib import blake2b
from typing import Any, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Build, Engine, Method, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import StableStep, StableStepSearch, kinetic_limit
from bodycheck.adapters.workers.protocol import packed, unpacked
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reports.measurement.case import (
    SWITCH_NOTE,
    CaseResult,
    MeasuredMotion,
    RunCase,
    origin_of,
    run_case,
)
from bodycheck.reports.measurement.convergence import (
    ABOVE_FLOOR,
    LARGEST_ERROR,
    Convergence,
    Criteria,
    Point,
    best_of,
    convergence_of,
    next_step_size,
    reaches_round_off,
    stepless_verdict,
    tolerance_convergence,
)
from bodycheck.reports.measurement.growth import Growth, growth_of
from bodycheck.reports.measurement.measure_bounds import floor_of, relative
from bodycheck.reports.measurement.measures import IDENTITY, MEASURES, ORIENTATION, QUANTITIES, scale_of
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.round_off import RoundOff, fitted

_VERDICTS = {"dt": convergence_of, "tolerance": tolerance_convergence, "none": stepless_verdict}


@dataclass(frozen=True, eq=False)
class Study:
    """The cases of one method on one scenario, coarsest step first, and the rows derived from them.

    method_rows: rows of methods.csv, one per quantity. stability_row: row of stability.csv, if requested.
    """

    cases: tuple[CaseResult, ...]
    method_rows: tuple[dict[str, Any], ...]
    stability_row: dict[str, Any] | None = None


def study(
    problem: Problem,
    engine: Engine,
    method: Method,
    settings: Sequence[Setting],
    *,
    adaptive: bool,
    ask: RunCase,
    search: Searching | None,
    case_done: Callable[[], None],
) -> Study:
    """Run the requested settings and, if adaptive, further steps until every quantity is judged.

    search: if adaptive, used to search for the largest stable step; None to skip that search.
    """
    cases: list[CaseResult] = []
    stepped = adaptive and method.control == "dt"
    searching = search if stepped else None

    def make(setting: Setting) -> CaseResult:
        case = run_case(problem, engine, method, setting, ask)
        _insert(cases, case)
        case_done()
        return case

    for setting in settings:
        if make(setting).columns["outcome"] == "unsupported":
            # whether a scene can be represented does not depend on the step
            return _with_stability(problem, engine, method, cases, (), searching)
    requested = [setting.dt_s for setting in settings if setting.dt_s is not None]
    while stepped and (step := _further_step(cases, problem, method, requested)) is not None:
        make(Setting(dt_s=step))
    rows = tuple(method_rows(cases, problem, method))
    return _with_stability(problem, engine, method, cases, rows, searching)


def _with_stability(
    problem: Problem,
    engine: Engine,
    method: Method,
    cases: Sequence[CaseResult],
    rows: Sequence[dict[str, Any]],
    search: Searching | None,
) -> Study:
    found = None if search is None else stability_row(problem, engine, method, cases, search)
    return Study(tuple(cases), tuple(rows), found)


class _PackedSeries(Mapping[str, Array]):
    """Packed measures over time, each unpacked when it is needed: a report draws few of them."""

    def __init__(self, packed: Mapping[str, Any]) -> None:
        self._packed = packed

    def __getitem__(self, name: str) -> Array:
        return unpacked(self._packed[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._packed)

    def __len__(self) -> int:
        return len(self._packed)


def stored_form(study: Study) -> dict[str, Any]:
    """Return all of a study but its motions, of which it has hashes, as plain data."""
    cases = [
        {
            "columns": case.columns,
            "motion": _hash_of(case.trajectory),
            "series": {name: packed(values) for name, values in case.series.items()},
        }
        for case in study.cases
    ]
    return {"cases": cases, "method_rows": list(study.method_rows)}


def restored(
    stored: Mapping[str, Any],
    problem: Problem,
    engine: Engine,
    method: Method,
    *,
    adaptive: bool,
    ask: RunCase,
    search: Searching | None,
    case_done: Callable[[], None],
) -> Study | None:
    """Return the study with this stored form, without measuring; None where a motion is another one now.

    The other parameters: as for `study`.
    """
    cases = []
    for one in stored["cases"]:
        columns = one["columns"]
        setting = Setting(columns["dt_s"], columns["tolerance"])
        answer = ask(engine, Case(problem.scenario.scene, method.name, setting))
        if _hash_of(answer.trajectory) != one["motion"]:
            return None
        columns = {**columns, **origin_of(answer)}
        motion = MeasuredMotion(answer.trajectory, _PackedSeries(one["series"]))
        cases.append(CaseResult(columns, motion, answer.read_back))
        case_done()
    searching = search if adaptive and method.control == "dt" else None
    return _with_stability(problem, engine, method, cases, stored["method_rows"], searching)


def _hash_of(motion: Trajectory | None) -> str:
    """Return a hash of the states of a motion; "" for none."""
    if motion is None:
        return ""
    found = blake2b(digest_size=16)
    for stored in fields(motion):
        if (values := getattr(motion, stored.name)) is not None:
            found.update(stored.name.encode() + values.tobytes())
    return found.hexdigest()


def _further_step(
    cases: Sequence[CaseResult], problem: Problem, method: Method, requested: Sequence[float]
) -> float | None:
    """Return the step needed by the first undecided quantity, starting with the orientation."""
    scene = problem.scenario.scene
    for quantity in QUANTITIES:
        points = _points(tuple(cases), problem, method, quantity)
        criteria = _criteria(cases, problem, method, quantity)
        needs_order = quantity == ORIENTATION
        if not needs_order and not any(quantity in case.departures for case in cases):
            continue
        step = next_step_size(
            points, criteria, requested, scene.sample_interval_s, scene.duration_s, needs_order=needs_order
        )
        if step is not None:
            return step
    return None


def limit(problem: Problem, quantity: str) -> float:
    """max(3 bound, eps sensitivity): a smaller error is at the floor, in rad or of the scale."""
    return max(floor_of(problem.columns, quantity), _round_off(problem, quantity))


def _round_off(problem: Problem, quantity: str) -> float:
    """Return eps x sensitivity over the scale of the quantity; 0 for a quantity that needs no truth."""
    kind = MEASURES[quantity].bound
    if kind is None:
        return 0.0
    round_off = problem.largest(getattr(problem.truth, f"round_off_{kind}"))
    return relative(round_off, problem.columns, quantity)


def _criteria(cases: Sequence[CaseResult], problem: Problem, method: Method, quantity: str) -> Criteria:
    """Return how a quantity of these cases is judged."""
    ended = [case for case in cases if case.ok]
    steps = max((case.columns.get("steps") or 0 for case in ended), default=0)
    floors = [limit(problem, quantity), *(case.floors.get(quantity, 0.0) for case in ended)]
    arithmetic = 0.0
    if ended and (method.precision != "float64" or method.control == "dt"):
        arithmetic = _arithmetic(problem, quantity, method).at(problem.scenario.duration_s / max(steps, 1))
    if method.control != "dt":
        floors.append(arithmetic)
    # a quantity too small to be measured in the finest case did not stop shrinking at the coarser ones
    unmeasured = bool(ended) and quantity not in ended[-1].columns
    return Criteria(
        floor=max(floors),
        growing=_round_off(problem, quantity) * math.sqrt(steps),
        arithmetic=arithmetic,
        extrapolated=not any(SWITCH_NOTE in case.columns["message"] for case in ended),
        judged="property" if problem.is_chaotic or unmeasured else MEASURES[quantity].judged or "property",
    )


def _insert(cases: list[CaseResult], case: CaseResult) -> None:
    """Insert a case, coarsest first, and update the successive differences of it and the next finer case."""
    index = bisect_right(cases, -_fineness(case), key=lambda other: -_fineness(other))
    cases.insert(index, case)
    for finer in range(max(index, 1), min(index + 2, len(cases))):
        cases[finer] = _with_step_change(cases[finer - 1], cases[finer])


def _fineness(case: CaseResult) -> float:
    return case.setting.fineness or 0.0


def _with_step_change(coarser: CaseResult, case: CaseResult) -> CaseResult:
    """Return the case with its largest angle to the next coarser case, where both ended well."""
    columns = {name: value for name, value in case.columns.items() if name != "successive_difference_rad"}
    if case.ok and coarser.ok and case.trajectory is not None and coarser.trajectory is not None:
        change = geodesic_angle(coarser.trajectory.attitude, case.trajectory.attitude)
        columns["successive_difference_rad"] = float(np.max(change))
    return replace(case, columns=columns)


def _arithmetic(problem: Problem, quantity: str, method: Method) -> RoundOff:
    """Return what predicts the error of a quantity from the arithmetic of a method."""
    return RoundOff.of(problem, quantity, method.precision, method.rounding_bias)


@lru_cache(maxsize=64)  # the refinement computes them first, then the rows need them again
def _points(
    cases: tuple[CaseResult, ...], problem: Problem, method: Method, quantity: str
) -> tuple[Point, ...]:
    """Return the cases as points of error against step; the error is None where one did not end well.

    The motions of bodies on joints depend on all attitudes, so that none of their errors shows an order
    where an attitude is far off.
    """
    coupled = isinstance(problem.scenario.scene, TreeScene)
    points = tuple(
        Point(
            _fineness(case),
            case.columns.get(quantity) if case.ok else None,
            case.departures.get(quantity),
            is_far=coupled and (case.columns.get(ORIENTATION) or 0.0) >= LARGEST_ERROR,
        )
        for case in cases
    )
    if method.precision == "float64" or method.control != "dt":
        return points
    round_off = _arithmetic(problem, quantity, method)
    return tuple(replace(point, round_off=round_off.at(point.dt_s)) for point in points)


def method_rows(cases: Sequence[CaseResult], problem: Problem, method: Method) -> Iterator[dict[str, Any]]:
    """Yield the rows of methods.csv, one per quantity; cases: of one method, coarsest step first."""
    identity = {name: cases[0].columns[name] for name in IDENTITY}
    expected = _expected_order(cases, problem, method)
    for quantity in QUANTITIES:
        if not _is_judged(cases, quantity):
            continue
        points = _points(tuple(cases), problem, method, quantity)
        found: Convergence = _VERDICTS[method.control](points, _criteria(cases, problem, method, quantity))
        growth = _growth(cases, problem, quantity, found.floor)
        finest = _finest(cases, quantity)
        yield {
            **identity,
            "quantity": quantity,
            "expected_order": expected,
            **finest,
            **_best(points, problem, method, quantity, found.order or expected),
            **vars(found),
            **vars(growth),
        }


def _expected_order(cases: Sequence[CaseResult], problem: Problem, method: Method) -> int | None:
    """Return the lowest theoretical order over all quantities; None for a method without one.

    Loads held constant over the step (zero-order hold), and steps that apply the mean of a load that switches
    inside them, reduce any method to order 1.
    """
    if method.order is None or method.control != "dt":
        return None
    scene = problem.scenario.scene
    zero_order_hold = (scene.continuous_loads and method.continuous_loads == "zero-order hold") or (
        scene.loads and method.torque == "zero-order hold"
    )
    switched = any(SWITCH_NOTE in case.columns["message"] for case in cases)
    return min(method.order, 1) if zero_order_hold or switched else method.order


def _best(
    points: Sequence[Point], problem: Problem, method: Method, quantity: str, order: float | None
) -> dict[str, float]:
    """Return the best step, its error, and the floor there: predicted, and measured where it was reached.

    Empty for a method that chooses its own steps. order: of the errors above the floor; 2 where it is not
    known, which matters for the measured floor only.
    """
    if method.control != "dt":
        return {}
    round_off = _arithmetic(problem, quantity, method)
    predicted = [replace(point, round_off=round_off.at(point.dt_s)) for point in points]
    best = best_of(predicted)
    if best is None or best.error is None:
        return {}
    found = {"best_dt_s": best.dt_s, "least_error": best.error, "predicted_floor": best.round_off}
    measured = [p for p in predicted if p.error is not None and 0.0 < p.error < LARGEST_ERROR]
    if measured and reaches_round_off(predicted):
        errors = [p.error for p in measured if p.error is not None]
        branches = fitted([p.dt_s for p in measured], errors, [p.round_off for p in measured], order or 2.0)
        found["measured_floor"] = branches.level * best.round_off
    return found


def _finest(cases: Sequence[CaseResult], quantity: str) -> dict[str, float | None]:
    """Return the step or tolerance and the error of the finest case that ended well."""
    case = next((case for case in reversed(cases) if case.ok and quantity in case.columns), None)
    if case is None:
        return {}
    return {
        "finest_dt_s": case.dt_s,
        "finest_tolerance": case.setting.tolerance,
        "finest_error": case.columns[quantity],
    }


def _is_judged(cases: Sequence[CaseResult], quantity: str) -> bool:
    """Whether a quantity has a row; a method that was unstable everywhere has one for the orientation."""
    if any(quantity in case.columns for case in cases):
        return True
    return quantity == ORIENTATION and any(case.columns["outcome"] == "unstable" for case in cases)


def _growth(cases: Sequence[CaseResult], problem: Problem, quantity: str, floor: float) -> Growth:
    """Return how a quantity grows in the finest case that is well above its floor, or else in the finest."""
    valid = [case for case in cases if case.ok and case.columns.get(quantity, 1.0) < LARGEST_ERROR]
    if not valid:
        return Growth()
    above_floor = [case for case in valid if case.columns[quantity] > ABOVE_FLOOR * floor]
    case = (above_floor or valid)[-1]
    relative = case.series[quantity] / scale_of(problem.columns, quantity)
    return growth_of(problem.times, relative, floor_of(problem.columns, quantity))


Searching: TypeAlias = Callable[[Engine, StableStepSearch], StableStep]
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


def _search(problem: Problem, method: Method, cases: Sequence[CaseResult]) -> StableStepSearch:
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
    return StableStepSearch(
        case=Case(scene, method.name, Setting(dt_s=start)),
        lowest_s=finest / _FINER,
        highest_s=max(min(period_s, scene.duration_s / _MIN_STEPS), start),
        kinetic_limit_j=kinetic_limit(problem.motion.kinetic),
    )
