"""The truth's error bound and the floor of each measure, relative to the measure's scale."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bodycheck.reports.measurement.measures import MEASURES

TRUTH_BOUNDS = {
    name: f"truth_bound_{measure.bound}" for name, measure in MEASURES.items() if measure.bound is not None
}
"""Measure -> column of results.csv; norms of an engine's own state need no bound."""

_SCALES = {"omega_rad_s": "omega_scale_rad_s", "m": "length_scale_m", "m_s": "speed_scale_m_s"}
"""Bounds in SI units -> the scale that they are divided by; other bounds are already relative."""

FLOOR_BOUNDS = 3.0
"""Two errors below this many bounds of the truth cannot be distinguished."""

_EPS = float(np.finfo(np.float64).eps)


def relative(value: float, columns: Mapping[str, Any], measure: str) -> float:
    """Return a bound or a round-off of the truth over the scale of the measure; 0 without a scale.

    columns: of results.csv, either of one case or those shared by all cases of a scenario.
    """
    kind, own = MEASURES[measure].bound, MEASURES[measure].scale
    scale = columns.get(_SCALES[kind], 0.0) if kind in _SCALES and own is not None else 1.0
    if kind == "energy" and own not in (None, "energy_scale_j"):  # the bound is relative to that scale
        energy_scale = columns.get("energy_scale_j", 0.0)
        scale = columns.get(own, 0.0) / energy_scale if energy_scale else 0.0
    return float(value / scale) if scale else 0.0


def bound_of(columns: Mapping[str, Any], measure: str) -> float:
    """Return the truth's bound of a measure over its scale; 0 where it needs none, or for an older run.

    columns: as for `relative`.
    """
    if measure not in TRUTH_BOUNDS:
        return 0.0
    return relative(columns.get(TRUTH_BOUNDS[measure], 0.0), columns, measure)


def floor_of(columns: Mapping[str, Any], measure: str) -> float:
    """3 max(bound, eps): two errors below it cannot be distinguished.

    columns: as for `relative`. A body at rest has a position bound of 0, but doubles resolve only eps.
    """
    return FLOOR_BOUNDS * max(bound_of(columns, measure), _EPS)
