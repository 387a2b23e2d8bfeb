"""Which of the truth's bounds limits which measure, over the measure's scale, and the measure's floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bodycheck.reports.measurement.measures import MEASURES

BOUND_KINDS = {name: measure.bound for name, measure in MEASURES.items() if measure.bound is not None}
"""Measure -> bound and round-off of the truth; norms of an engine's own matrix and quaternion need none."""

TRUTH_BOUNDS = {measure: f"truth_bound_{kind}" for measure, kind in BOUND_KINDS.items()}
"""Measure -> column of results.csv."""

_SCALES = {"omega_rad_s": "omega_scale_rad_s", "m": "length_scale_m", "m_s": "speed_scale_m_s"}
"""Bounds in SI units -> the scale that their measures are divided by; the others are relative already."""

FLOOR_BOUNDS = 3.0
"""How many bounds of the truth an error has to exceed to be told from another."""

_EPS = float(np.finfo(np.float64).eps)


def relative(value: float, columns: Mapping[str, Any], measure: str) -> float:
    """Return a bound or a round-off of the truth over the scale of the measure that it limits; 0 without one.

    columns: of results.csv, those of a case or those that all cases of a scenario share.
    """
    kind = BOUND_KINDS[measure]
    scale = columns.get(_SCALES[kind], 0.0) if kind in _SCALES else 1.0
    if measure == "rotational_energy_drift":  # the truth's bound is over the energy of the whole
        scale = (
            columns["rotational_energy_scale_j"] / columns["energy_scale_j"]
            if columns["energy_scale_j"]
            else 0.0
        )
    return float(value / scale) if scale else 0.0


def bound_of(columns: Mapping[str, Any], measure: str) -> float:
    """Return the truth's bound of a measure over its scale; 0 where it needs none, or in an older run.

    columns: as for `relative`.
    """
    if measure not in TRUTH_BOUNDS:
        return 0.0
    return relative(columns.get(TRUTH_BOUNDS[measure], 0.0), columns, measure)


def floor_of(columns: Mapping[str, Any], measure: str) -> float:
    """3 max(bound, eps): an error below it is neither better nor worse than another.

    columns: as for `relative`. A place at rest has a bound of nothing, but doubles tell no more than eps.
    """
    return FLOOR_BOUNDS * max(bound_of(columns, measure), _EPS)
