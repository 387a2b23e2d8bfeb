"""Which of the truth's bounds limits which measure: both over the same scale of the scene."""

from __future__ import annotations

TRUTH_BOUNDS = {
    "orientation_error_rad": "truth_bound_rad",
    "orientation_error_final_rad": "truth_bound_rad",
    "position_error": "truth_bound_rad",
    "omega_error": "truth_bound_momentum",
    "velocity_error": "truth_bound_momentum",
    "energy_drift": "truth_bound_energy",
    "energy_balance": "truth_bound_energy",
    "rotational_energy_drift": "truth_bound_energy",
    "angular_momentum_drift": "truth_bound_momentum",
    "linear_momentum_drift": "truth_bound_momentum",
    "invariant_drift": "truth_bound_momentum",
}
"""Measure -> column of results.csv; the norms of an engine's own matrix and quaternion need no truth."""
