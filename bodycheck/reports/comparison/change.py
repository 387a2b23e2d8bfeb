"""What differs between two runs: verdicts and orders, accuracies, speeds and stable steps.

Each change has a status, and the threshold that decides it. An accuracy changes, in either direction, beyond
round-off only.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.measurement.measure_bounds import FLOOR_BOUNDS, TRUTH_BOUNDS, bound_of
from bodycheck.reports.measurement.measures import MEASURES, SIGNED, gain_word
from bodycheck.reports.measurement.verdicts import UNDECIDED, severity
from bodycheck.reports.run_files.run_tables import study_key

Kind: TypeAlias = Literal[
    "outcome", "verdict", "law", "order", "stability", "accuracy", "sign", "speed", "fingerprint", "case"
]
"""What changed, the most severe first."""
Status: TypeAlias = Literal["worse", "missing", "improved", "moved", "new"]

FAILING: tuple[Status, ...] = ("worse", "missing")
"""The statuses that fail a comparison or a nightly run."""

MAP_KINDS: tuple[Kind, ...] = ("fingerprint", "law")
"""Which map a method is, and the laws that it obeys: such a change never fails, whatever its size."""

NOT_MEASURED = ("not measured", "not-measured")
"""The fingerprint, and the verdict of a law, of a method for which there is none."""


class ChangeKey(NamedTuple):
    """What changed, whatever its values: the same in every nightly run."""

    kind: Kind
    scenario: str | None
    engine: str
    method: str
    quantity: str
    control: str | None
    fineness: float | None

    @property
    def of_verdict(self) -> ChangeKey | None:
        """The key of the verdict on an order; None for anything else."""
        if self.kind != "order":
            return None
        return self._replace(kind="verdict", quantity=f"verdict{self.quantity.removeprefix('order')}")

    @property
    def id(self) -> str:
        """Eight hexadecimal digits."""
        return hashlib.sha256(json.dumps(self).encode()).hexdigest()[:8]


@dataclass(frozen=True)
class Change:
    """One quantity of a case, or of a method on a scenario, before and after.

    quantity: the measure, or `outcome`, `verdict of <quantity>`, `order of <quantity>`, `dt_stable_s`,
    `stable step: search`, `relative_cpu`, `law <name>`; `case` for a case that only one run has. status:
    worse or improved beyond the threshold, moved by less, new or missing. control, fineness: the step or the
    tolerance; None for all of a method's. scenario: None for all scenarios. before, after: None if there is
    no value. decades: log10(after / before); None for a quantity without a size.
    """

    kind: Kind
    scenario: str | None
    engine: str
    method: str
    quantity: str
    before: float | str | None
    after: float | str | None
    status: Status
    control: str | None = None
    fineness: float | None = None
    decades: float | None = None

    @property
    def key(self) -> ChangeKey:
        """What changed, without its values and its status."""
        return ChangeKey(*(getattr(self, name) for name in ChangeKey._fields))

    @property
    def size(self) -> float:
        """The sort key of changes: the size in decades; infinite without a size, which sorts first."""
        return math.inf if self.decades is None else abs(self.decades)

    @property
    def relative(self) -> float | None:
        """The larger over the smaller value, minus 1; None without a size."""
        return None if self.decades is None else math.expm1(abs(self.decades) * math.log(10.0))


def by_rank(before: int, after: int) -> Status:
    """Return the status of a change from one rank to another; a higher rank is better."""
    return "moved" if before == after else "improved" if after > before else "worse"


_MIN_ORDER_CHANGE = 0.05

_Row: TypeAlias = Mapping[str, Any]


def verdict_change(before: _Row, after: _Row, errors: Sequence[Change]) -> Change | None:
    """Return the change of the verdict of one quantity; None if it did not change.

    A more severe verdict is worse. A change between sound and undecided counts only if an error of the
    quantity changed in the same direction, because with smaller errors or other steps an order may no longer
    be observable. before, after: rows of methods.csv without empty cells. errors: the changes of accuracy of
    the method on the scenario.
    """
    old, new = before["verdict"], after["verdict"]
    if old == new:
        return None
    status = by_rank(-severity(old), -severity(new))
    if max(severity(old), severity(new)) <= UNDECIDED:
        quantity = after["quantity"]
        of_it = {one.status for one in errors if one.quantity == quantity or quantity not in MEASURES}
        status = status if status in of_it else "moved"
    return _row_change("verdict", after, old, new, status)


def order_change(before: _Row, after: _Row, theory: float | None, thresholds: Thresholds) -> Change | None:
    """Return the change of the order of one quantity; None if the intervals overlap or it is negligible.

    An order is worse if its whole interval fell below theory by more than the threshold; an order that fell
    towards theory, or rose above it, moved. theory: the higher theoretical order of the two runs; if None,
    the higher of the two observed orders.
    """
    if "order" not in before or "order" not in after:
        return None
    up = after["order_low"] > before["order_high"]
    down = after["order_high"] < before["order_low"]
    old, new = before["order"], after["order"]
    if not (up or down) or abs(new - old) <= _MIN_ORDER_CHANGE:
        return None
    lower = before if up else after
    reference = max(old, new) if theory is None else min(theory, max(old, new))
    below = lower["order_high"] < reference - thresholds.of_order(after["quantity"])
    status: Status = "moved" if not below else "improved" if up else "worse"
    return _row_change("order", after, old, new, status)


def changed_judgements(
    before: Mapping[tuple[Any, ...], _Row],
    after: Mapping[tuple[Any, ...], _Row],
    theories: Mapping[tuple[str, str], float | None],
    errors: Sequence[Change],
    thresholds: Thresholds,
) -> Iterator[Change]:
    """Yield the changes of all verdicts and orders that both runs have.

    before, after: rows of methods.csv by scenario, engine, method and quantity. theories: the theoretical
    order by engine and method.
    """
    by_method: dict[tuple[Any, ...], list[Change]] = {}
    for one in errors:
        by_method.setdefault((one.scenario, one.engine, one.method), []).append(one)
    for key in after:
        if key not in before:
            continue
        scenario, engine, method, _ = key
        a, b = before[key], after[key]
        found = (
            verdict_change(a, b, by_method.get((scenario, engine, method), ())),
            order_change(a, b, theories.get((engine, method)), thresholds),
        )
        yield from (change for change in found if change is not None)


def _row_change(kind: Any, row: _Row, old: float | str, new: float | str, status: Status) -> Change:
    return Change(kind, *study_key(row), f"{kind} of {row['quantity']}", old, new, status)


_EPS = float(np.finfo(np.float64).eps)
_ROUND_OFFS = 8.0
_TWO_VALUES = 2.0  # each of the two compared values has this noise

_LARGEST_OF = {"orientation_error_final_rad": "orientation_error_rad"}
"""Error at one instant -> its maximum over time, because the former may pass through zero by chance."""

_UNRESOLVED = ("energy_balance",)
"""Empty where the samples cannot resolve it, so its absence means nothing; energy_drift is also present."""

Floors = Mapping[str, float]
"""Quantity -> floor, for one method on one scenario."""


def noise(measure: str, row: Mapping[str, Any], floors: Floors) -> float:
    """max(3 bound, floor, eps (8 + sqrt(steps)) max(1, value)): the noise of one value.

    row: a row of results.csv. floors: of its method on its scenario; they include the motion's sensitivity.
    """
    round_off = _EPS * (_ROUND_OFFS + math.sqrt(row.get("steps", 0))) * _size(measure, row)
    if measure not in TRUTH_BOUNDS:
        return round_off
    floor = floors.get(_LARGEST_OF.get(measure, measure), 0.0)
    return max(round_off, FLOOR_BOUNDS * bound_of(row, measure), floor)


def _drift_of_round_off(measure: str, row: Mapping[str, Any]) -> float:
    """eps steps max(1, value): the sum of roundings that all have the same sign.

    Another compiler may cause such a drift; a change of this size is not a fault of the method.
    """
    return _EPS * float(row.get("steps", 0)) * _size(measure, row)


def _size(measure: str, row: Mapping[str, Any]) -> float:
    return max(1.0, row.get(measure, 1.0))


def accuracy_changes(
    before: Mapping[str, Any],
    after: Mapping[str, Any],
    floors: tuple[Floors, Floors],
    thresholds: Thresholds,
) -> Iterator[Change]:
    """Yield the measures of one case that changed by more than the noise of both values.

    A change is worse or improved if the part beyond the noise and the drift of round-off exceeds the
    threshold, relative to the smaller value. A value below its noise counts as the noise. The smaller noise
    of the two is used, so that a risen floor cannot hide a change. before, after: rows of results.csv.
    floors: of their method in each run.
    """
    setting = after.get("dt_s"), after.get("tolerance")
    fineness = next((number for number in setting if number is not None), None)

    def changed(
        measure: str, old: float | None, new: float | None, status: Status, decades: float | None = None
    ) -> Change:
        return Change(
            "accuracy", *study_key(after), measure, old, new, status, after["control"], fineness, decades
        )

    for measure in _present(before, after):
        old, new = before.get(measure), after.get(measure)
        pure = measure.removesuffix("_abs")
        if old is None or new is None:
            if pure not in _UNRESOLVED:
                yield changed(measure, old, new, "new" if old is None else "missing")
            continue
        rows = before, after
        # without a scale of the scene: its own size, but at least 1 in SI units, whose round-off is no change
        scale = 1.0 if measure == pure else max(1.0, old, new)
        if abs(new - old) <= _TWO_VALUES * _EPS * _ROUND_OFFS * scale:  # within the least noise of any value
            continue
        floor = scale * min(noise(pure, *side) for side in zip(rows, floors, strict=True))
        drift = scale * min(_drift_of_round_off(pure, row) for row in rows)
        low, high = sorted((max(old, floor), max(new, floor)))
        if high - low > _TWO_VALUES * floor:
            decades = math.log10(high / low)
            excess = high - low - _TWO_VALUES * max(floor, drift)
            exceeds = excess > thresholds.of(measure) * _reference(measure, low, before, after)
            if new > old:
                yield changed(measure, old, new, "worse" if exceeds else "moved", decades)
            else:
                yield changed(measure, old, new, "improved" if exceeds else "moved", -decades)


def sign_changes(
    before: Mapping[str, Any], after: Mapping[str, Any], floors: tuple[Floors, Floors]
) -> Iterator[Change]:
    """Yield the measures of one case that gained before and lose now, or the reverse, beyond their noise.

    Arguments as for `accuracy_changes`.
    """
    setting = after.get("dt_s"), after.get("tolerance")
    fineness = next((number for number in setting if number is not None), None)
    for name, measure in MEASURES.items():
        column = f"{name}{SIGNED}"
        if not measure.signed or column not in before or column not in after:
            continue
        old, new = before[column], after[column]
        if old * new >= 0.0:
            continue
        rows = before, after
        floor = _TWO_VALUES * max(noise(name, *side) for side in zip(rows, floors, strict=True))
        if min(abs(old), abs(new)) > floor:
            before_text, after_text = (f"{gain_word(one)} {number(abs(one), 3)}" for one in (old, new))
            where = (*study_key(after), f"sign of {name}")
            yield Change("sign", *where, before_text, after_text, "moved", after["control"], fineness)


def _reference(measure: str, low: float, *rows: Mapping[str, Any]) -> float:
    """Return the reference of a relative change: the smaller value, or the error's maximum over time."""
    largest = _LARGEST_OF.get(measure, measure)
    return low if largest == measure else max(low, *(row.get(largest, 0.0) for row in rows))


def _present(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """Yield the measures that either row has; those without a scale as `_abs`."""
    for measure in MEASURES:
        if measure in before or measure in after:
            yield measure
        elif MEASURES[measure].unit and (f"{measure}_abs" in before or f"{measure}_abs" in after):
            yield f"{measure}_abs"


_QUARTILES = (0.25, 0.75)  # three quarters of the cases must have changed in one direction
_NOISES_OF_A_SCENARIO = 3.0  # its few cases are timed in sequence, so one disturbance affects all


@dataclass(frozen=True)
class Ratio:
    """The change of a case's time: log10(after / before), and the part that the quartiles make certain."""

    scenario: str
    engine: str
    method: str
    decades: float
    sure: float


def ratio(before: Mapping[str, Any], after: Mapping[str, Any], *, same_machine: bool) -> Ratio | None:
    """Return the change of relative_cpu between two rows, or of cpu_s on the same machine.

    Returns None if neither can be compared, or if a case was too fast for the clock.
    """
    if not min(before.get("cpu_s_low", 0.0), after.get("cpu_s_low", 0.0)) > 0.0:
        return None
    if min(before.get("relative_cpu", 0.0), after.get("relative_cpu", 0.0)) > 0.0:
        scales = [row["relative_cpu"] / row["cpu_s"] for row in (before, after)]
    elif same_machine:
        scales = [1.0, 1.0]
    else:
        return None
    (low_a, mid_a, high_a), (low_b, mid_b, high_b) = (
        [math.log10(scale * row[name]) for name in ("cpu_s_low", "cpu_s", "cpu_s_high")]
        for scale, row in zip(scales, (before, after), strict=True)
    )
    smallest, largest = low_b - high_a, high_b - low_a
    return Ratio(*study_key(after), mid_b - mid_a, max(smallest, 0.0) + min(largest, 0.0))


def speed_changes(ratios: Iterable[Ratio], noises: tuple[float, float], threshold: float) -> Iterator[Change]:
    """Yield the methods of which at least three quarters of the cases became slower or faster than the noise.

    A method is judged by all its cases; if they disagree, by those of each scenario, beyond three times the
    noise. noises: the interquartile range of the reference measurement over its median, in each run.
    threshold: the relative change below which a method beyond the noise has moved.
    """
    slack = math.log10(1.0 + sum(noises))
    ordered = sorted(ratios, key=lambda one: (one.engine, one.method, one.scenario))
    for _, of_method in groupby(ordered, key=lambda one: (one.engine, one.method)):
        cases = list(of_method)
        if (found := _judged(cases, slack, threshold, None)) is not None:
            yield found
            continue
        for scenario, of_scenario in groupby(cases, key=lambda one: one.scenario):
            one = _judged(list(of_scenario), _NOISES_OF_A_SCENARIO * slack, threshold, scenario)
            if one is not None:
                yield one


def _judged(cases: list[Ratio], slack: float, threshold: float, scenario: str | None) -> Change | None:
    low, high = np.quantile([case.sure for case in cases], _QUARTILES).tolist()
    if low <= slack and high >= -slack:
        return None
    decades = float(np.median([case.decades for case in cases]))
    status: Status = "worse" if low > slack else "improved"
    if abs(decades) <= math.log10(1.0 + threshold):
        status = "moved"
    engine, method = cases[0].engine, cases[0].method
    return Change("speed", scenario, engine, method, "relative_cpu", None, None, status, decades=decades)


def stability_change(before: Mapping[str, Any], after: Mapping[str, Any], threshold: float) -> Change | None:
    """Return the change of the largest stable step of one method on one scenario; None if there is none.

    The limit lies between the last stable and the first unstable step; if these intervals overlap, the limits
    may be equal. before, after: rows of stability.csv without empty cells. threshold: the relative change of
    the last stable step above which it is worse or improved.
    """
    old, new = before["outcome"], after["outcome"]
    if old != new:
        return _stability_change(after, "stable step: search", old, new, by_rank(old == "ok", new == "ok"))
    if old != "ok":
        return None
    (low_a, high_a), (low_b, high_b) = _span(before), _span(after)
    if low_b >= high_a or high_b <= low_a:
        up = low_b >= high_a
        decades = math.log10(max(low_a, low_b) / min(low_a, low_b)) if low_a and low_b else None
        exceeds = decades is None or decades > math.log10(1.0 + threshold)
        status: Status = "moved" if not exceeds else "improved" if up else "worse"
        signed = decades if decades is None or up else -decades
        texts = (before.get("dt_stable_s", "none"), after.get("dt_stable_s", "none"))
        return _stability_change(after, "dt_stable_s", *texts, status, signed)
    return None


def _stability_change(
    row: Mapping[str, Any],
    quantity: str,
    before: float | str,
    after: float | str,
    status: Status,
    decades: float | None = None,
) -> Change:
    return Change("stability", *study_key(row), quantity, before, after, status, decades=decades)


def _span(row: Mapping[str, Any]) -> tuple[float, float]:
    """Return the last stable step and the first unstable one; 0 and infinity if there is none."""
    return row.get("dt_stable_s", 0.0), row.get("dt_unstable_s", math.inf)
