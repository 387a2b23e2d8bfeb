"""Which of the truth's bounds limits which measure, both over the same scale of the scene, and its floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

BOUND_KINDS = {
    "orientation_error_rad": "rad",
    "orientation_error_final_rad": "rad",
    "position_error": "rad",
    "omega_error": "momentum",
    "velocity_error": "momentum",
    "energy_drift": "energy",
    "energy_balance": "energy",
    "rotational_energy_drift": "energy",
    "angular_momentum_drift": "momentum",
    "linear_momentum_drift": "momentum",
    "invariant_drift": "momentum",
}
"""Measure -> bound and round-off of the truth; norms of an engine's own matrix and quaternion need none."""

TRUTH_BOUNDS = {measure: f"truth_bound_{kind}" for measure, kind in BOUND_KINDS.items()}
"""Measure -> column of results.csv."""

FLOOR_BOUNDS = 3.0
"""How many bounds of the truth an error has to exceed to be told from another."""


def floor_of(columns: Mapping[str, Any], measure: str) -> float:
    """3 bound: an error below it is neither better nor worse than another.

    columns: of results.csv, those of a case or those that all cases of a scenario share.
    """
    return float(FLOOR_BOUNDS * columns[TRUTH_BOUNDS[measure]])
