"""Detect that a method broke down: invalid states, or far more energy than the true motion has."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory

_MOST_ENERGY = 100.0  # times the largest true kinetic energy


def invalid_state(trajectory: Trajectory) -> str | None:
    """Return why a trajectory is invalid: not finite, det R <= 0, or a zero quaternion; None if valid."""
    if lost := _first_not_finite(trajectory):
        sample, name = lost
        return f"{name} is not finite from t = {trajectory.t_s[sample]:.6g} s on"
    if trajectory.rotation is not None and np.any(np.linalg.det(trajectory.rotation) <= 0.0):
        return "det R <= 0"
    if trajectory.quaternion is not None and np.any(np.linalg.norm(trajectory.quaternion, axis=-1) == 0.0):
        return "the quaternion is zero"
    return None


def kinetic_limit(true_kinetic: Array) -> float:
    """100 max K*, in J: the kinetic energy above which a case is unstable; infinite if nothing moves.

    true_kinetic (n,): kinetic energy of the truth, in J.
    """
    largest = float(true_kinetic.max())
    return _MOST_ENERGY * largest if largest > 0.0 else np.inf


def energy_blowup(kinetic: Array, limit: float, t_s: Array) -> str | None:
    """Return from which time on K exceeds its limit; None if it never does.

    kinetic (n,) and limit in J, at the times t_s (n,).
    """
    above = ~(kinetic <= limit)  # also true for NaN, into which an energy may overflow
    if not np.any(above):
        return None
    return f"kinetic energy above 100 times the true maximum from t = {t_s[np.argmax(above)]:.6g} s on"


def _first_not_finite(trajectory: Trajectory) -> tuple[int, str] | None:
    """Return the first sample with a NaN or an infinity, and the name of its array."""
    found = []
    for name in (
        "omega_body_rad_s",
        "omega_world_rad_s",
        "quaternion",
        "rotation",
        "velocity_m_s",
        "position_m",
    ):
        value = getattr(trajectory, name)
        if value is not None and not np.all(np.isfinite(value)):
            finite = np.isfinite(value.reshape(len(value), -1)).all(axis=1)
            found.append((int(np.argmin(finite)), name))
    return min(found, key=lambda lost: lost[0], default=None)
