"""Whether the accuracy of a case changed: two-sided, by more than round-off could."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from bodycheck.reports.bounds import FLOOR_BOUNDS, TRUTH_BOUNDS
from bodycheck.reports.comparison.change import Change, Direction
from bodycheck.reports.tables import ABSOLUTE, MEASURES

_EPS = float(np.finfo(np.float64).eps)
_ROUND_OFFS = 8.0

_FLOORS = {
    "orientation_error_final_rad": "orientation_error_rad",
    "velocity_error": "omega_error",
    "energy_balance": "energy_drift",
    "rotational_energy_drift": "energy_drift",
    "linear_momentum_drift": "angular_momentum_drift",
    "invariant_drift": "angular_momentum_drift",
}
"""Measure -> the quantity of methods.csv whose floor is its own, where that is another."""

Floors = Mapping[str, float]
"""Quantity -> floor, of one method on one scenario."""


def noise(measure: str, row: Mapping[str, Any], floors: Floors) -> float:
    """max(3 bound, floor, eps (8 + sqrt(steps))): what a measure may change by when nothing has changed.

    row: of results.csv. floors: of its method on its scenario; they know the motion's sensitivity.
    """
    least = _EPS * (_ROUND_OFFS + math.sqrt(row.get("steps", 0)))
    if measure not in TRUTH_BOUNDS:
        return least
    bound, floor = row.get(TRUTH_BOUNDS[measure], 0.0), floors.get(_FLOORS.get(measure, measure), 0.0)
    limited = max(FLOOR_BOUNDS * bound, floor)
    if measure == "rotational_energy_drift" and (own := row["rotational_energy_scale_j"]):
        limited *= row["energy_scale_j"] / own  # over its own scale, where bound and floor are over the whole
    return max(least, limited)


def accuracy_changes(
    before: Mapping[str, Any], after: Mapping[str, Any], floors: tuple[Floors, Floors]
) -> Iterator[Change]:
    """Yield the measures of one case that changed by more than the noise; what is beneath it counts as that.

    before, after: rows of results.csv; floors: of their method in either run. The smaller noise of the two
    counts: a method whose floor rose does not hide behind that.
    """
    setting = after.get("dt_s"), after.get("tolerance")
    fineness = next((number for number in setting if number is not None), None)

    def changed(
        old: float | None, new: float | None, measure: str, direction: Direction, decades: float | None = None
    ) -> Change:
        who = after["scenario"], after["engine"], after["method"]
        return Change("accuracy", *who, measure, old, new, direction, after["control"], fineness, decades)

    for measure in _present(before, after):
        old, new = before.get(measure), after.get(measure)
        if old is None or new is None:
            yield changed(old, new, measure, "other")
            continue
        pure = measure.removesuffix("_abs")
        sides = zip((before, after), floors, strict=True)
        least = min(noise(pure, row, known) for row, known in sides)
        if measure != pure:  # it has no scale of the scene's: it is measured by its own size
            least *= max(old, new)
        low, high = max(old, least), max(new, least)
        if abs(high - low) > least:
            decades = math.log10(max(high, low) / min(high, low))
            if high > low:
                yield changed(old, new, measure, "worse", decades)
            else:
                yield changed(old, new, measure, "better", -decades)


def _present(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """Yield the measures that either row has; where it has no scale, as `_abs`."""
    for measure in MEASURES:
        if measure in before or measure in after:
            yield measure
        elif measure in ABSOLUTE and (f"{measure}_abs" in before or f"{measure}_abs" in after):
            yield f"{measure}_abs"
