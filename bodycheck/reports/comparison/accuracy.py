"""Detect changes of accuracy beyond round-off, in both directions, and apply the threshold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from bodycheck.reports.comparison.change import Change, Status
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.measurement.measure_bounds import FLOOR_BOUNDS, TRUTH_BOUNDS, bound_of
from bodycheck.reports.measurement.measures import MEASURES

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
    least = _EPS * (_ROUND_OFFS + math.sqrt(row.get("steps", 0))) * _size(measure, row)
    if measure not in TRUTH_BOUNDS:
        return least
    floor = floors.get(_LARGEST_OF.get(measure, measure), 0.0)
    return max(least, FLOOR_BOUNDS * bound_of(row, measure), floor)


def _drift_of_round_off(measure: str, row: Mapping[str, Any]) -> float:
    """eps steps max(1, value): the sum of roundings that all have the same sign.

    Another compiler may cause such a drift; a change of this size is not a fault of the method.
    """
    return _EPS * float(row.get("steps", 0)) * _size(measure, row)


def _size(measure: str, row: Mapping[str, Any]) -> float:
    return max(1.0, row.get(measure) or 0.0)


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
        who = after["scenario"], after["engine"], after["method"]
        return Change("accuracy", *who, measure, old, new, status, after["control"], fineness, decades)

    for measure in _present(before, after):
        old, new = before.get(measure), after.get(measure)
        pure = measure.removesuffix("_abs")
        if old is None or new is None:
            if pure not in _UNRESOLVED:
                yield changed(measure, old, new, "new" if old is None else "missing")
            continue
        rows = before, after
        scale = 1.0 if measure == pure else max(old, new)  # no scale of the scene: use its own size
        least = scale * min(noise(pure, *side) for side in zip(rows, floors, strict=True))
        drift = scale * min(_drift_of_round_off(pure, row) for row in rows)
        low, high = sorted((max(old, least), max(new, least)))
        if high - low > _TWO_VALUES * least:
            decades = math.log10(high / low)
            beyond = high - low - _TWO_VALUES * max(least, drift)
            matters = beyond > thresholds.of(measure) * _reference(measure, low, before, after)
            if new > old:
                yield changed(measure, old, new, "worse" if matters else "moved", decades)
            else:
                yield changed(measure, old, new, "improved" if matters else "moved", -decades)


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
