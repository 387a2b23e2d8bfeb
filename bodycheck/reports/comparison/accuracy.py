"""Whether the accuracy of a case changed: two-sided, by more than round-off could, and whether it matters."""

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
_TWO_VALUES = 2.0  # either of the two compared values may be off by the noise

_LARGEST_OF = {"orientation_error_final_rad": "orientation_error_rad"}
"""An error at one instant -> its maximum over time: the instant's may pass through zero by accident."""

_UNRESOLVED = ("energy_balance",)
"""Empty where the samples cannot resolve it, so that its absence says nothing; energy_drift is there too."""

Floors = Mapping[str, float]
"""Quantity -> floor, of one method on one scenario."""


def noise(measure: str, row: Mapping[str, Any], floors: Floors) -> float:
    """max(3 bound, floor, eps (8 + sqrt(steps)) max(1, value)): by how much one value may be off.

    row: of results.csv. floors: of its method on its scenario; they know the motion's sensitivity.
    """
    least = _EPS * (_ROUND_OFFS + math.sqrt(row.get("steps", 0))) * _size(measure, row)
    if measure not in TRUTH_BOUNDS:
        return least
    floor = floors.get(_LARGEST_OF.get(measure, measure), 0.0)
    return max(least, FLOOR_BOUNDS * bound_of(row, measure), floor)


def _drift_of_round_off(measure: str, row: Mapping[str, Any]) -> float:
    """eps steps max(1, value): what roundings that all fall the same way add up to.

    Another compiler may make them do so; a change within that is no fault of a method.
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

    A change is worse or improved where what exceeds the noise, and the drift of round-off, is more than the
    threshold, relative to the smaller value; a value below its noise counts as the noise. before, after: rows
    of results.csv; floors: of their method in either run. The smaller noise of the two counts: a method whose
    floor rose does not hide behind that.
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
        scale = 1.0 if measure == pure else max(old, new)  # without a scale of the scene's: its own size
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
    """Return what a change is relative to: the smaller value, or the maximum over time of its error."""
    largest = _LARGEST_OF.get(measure, measure)
    return low if largest == measure else max(low, *(row.get(largest, 0.0) for row in rows))


def _present(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """Yield the measures that either row has; where it has no scale, as `_abs`."""
    for measure in MEASURES:
        if measure in before or measure in after:
            yield measure
        elif MEASURES[measure].unit and (f"{measure}_abs" in before or f"{measure}_abs" in after):
            yield f"{measure}_abs"
