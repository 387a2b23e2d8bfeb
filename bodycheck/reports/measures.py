"""Drifts and errors of one case: first over time, then their maxima, as the columns of results.csv."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closeness import potential_energy
from bodycheck.reference_impl.dynamics import angular_momentum, linear_momentum
from bodycheck.reference_impl.pivot import kinetic_energies, turning_inertia
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.scales import Scales
from bodycheck.reports.work import work_done, working_loads


@dataclass(frozen=True, eq=False)
class Motion:
    """Energy and momentum along a trajectory: K, its rotational part and E (n,) in J, L and P (n, 3)."""

    kinetic: Array
    rotational: Array
    energy: Array
    angular_momentum: Array
    linear_momentum: Array

    @classmethod
    def of(cls, scene: Scene, trajectory: Trajectory) -> Motion:
        """E = K + U, U from gravity, zero at the start, and springs; L about the centre of mass, world axes.

        E and L of a body with a pivot are about that.
        """
        kinetic, rotational = kinetic_energies(scene, trajectory)
        inertia = turning_inertia(scene)
        return cls(
            kinetic=kinetic,
            rotational=rotational,
            energy=kinetic + potential_energy(scene, trajectory),
            angular_momentum=angular_momentum(trajectory.rotation_matrices, inertia, trajectory.omega_body),
            linear_momentum=linear_momentum(scene.body.mass, trajectory.velocity_m_s),
        )


SERIES_SCALES = {
    "energy_drift": "energy_scale_j",
    "rotational_energy_drift": "rotational_energy_scale_j",
    "energy_balance": "energy_scale_j",
    "angular_momentum_drift": "angular_momentum_scale_kg_m2_s",
    "linear_momentum_drift": "linear_momentum_scale_kg_m_s",
    "omega_error": "omega_scale_rad_s",
    "position_error": "length_scale_m",
    "velocity_error": "speed_scale_m_s",
}
"""The measures that have a scale: each stands twice, over its scale and as `_abs` in SI units."""


def scale_of(columns: Mapping[str, Any], measure: str) -> float:
    """Return what a measure over time is divided by: 1 where it needs no scale, 0 where nothing moves.

    columns: of results.csv, those of a case or those that all cases of a scenario share.
    """
    return float(columns[SERIES_SCALES[measure]]) if measure in SERIES_SCALES else 1.0


_PURE_SERIES = ("orientation_error_rad", "orthogonality", "determinant_error", "quaternion_norm_error")
"""The measures that need no scale."""


def error_series(
    scene: Scene, truth: Trajectory, true: Motion, trajectory: Trajectory, motion: Motion
) -> dict[str, Array]:
    """Return every measure over time (n,), in SI units, that this trajectory has: its max is the measure.

    The scene's own invariants are apart: see invariants.py.

    true, motion: the energy and momentum along the truth and along the trajectory.
    """
    series = {
        "energy_drift": np.abs(motion.energy - true.energy),
        "rotational_energy_drift": np.abs(motion.rotational - true.rotational),
        "angular_momentum_drift": _distance(motion.angular_momentum, true.angular_momentum),
        "linear_momentum_drift": _distance(motion.linear_momentum, true.linear_momentum),
        "orientation_error_rad": geodesic_angle(truth.attitude, trajectory.attitude),
        "omega_error": _distance(trajectory.omega_body, truth.omega_body),
        "position_error": _distance(trajectory.position_m, truth.position_m),
        "velocity_error": _distance(trajectory.velocity_m_s, truth.velocity_m_s),
    }
    balance = _energy_balance(scene, trajectory, motion)
    if balance is not None:
        series["energy_balance"] = balance
    if trajectory.rotation is not None:
        gram = np.swapaxes(trajectory.rotation, -1, -2) @ trajectory.rotation
        series["orthogonality"] = np.linalg.norm(gram - np.eye(3), axis=(-2, -1))
        series["determinant_error"] = np.abs(np.linalg.det(trajectory.rotation) - 1.0)
    if trajectory.quaternion is not None:
        series["quaternion_norm_error"] = np.abs(np.linalg.norm(trajectory.quaternion, axis=-1) - 1.0)
    return series


def reduced(series: dict[str, Array], scales: Scales) -> dict[str, float]:
    """Return the maxima over time: each over its scale, if that is not 0, and as `_abs` in SI units."""
    columns: dict[str, float] = {}
    for name, values in series.items():
        largest = float(np.max(values))
        if name in _PURE_SERIES:
            columns[name] = largest
            continue
        columns[f"{name}_abs"] = largest
        scale = getattr(scales, SERIES_SCALES[name])
        if scale > 0.0:
            columns[name] = largest / scale
    columns["orientation_error_final_rad"] = float(series["orientation_error_rad"][-1])
    return columns


def _energy_balance(scene: Scene, trajectory: Trajectory, motion: Motion) -> Array | None:
    """|E_k - E_0 - W_k|, or None where the samples resolve W no better than to a third of it."""
    if not scene.timed_loads and not working_loads(scene, 0.0, scene.duration_s):
        return np.abs(motion.energy - motion.energy[0])
    done = work_done(scene, trajectory)
    if done is None:
        return None
    work, error = done
    balance = np.abs(motion.energy - motion.energy[0] - work)
    return balance if error <= float(np.max(balance)) / 3.0 else None


def _distance(a: Array, b: Array) -> Array:
    return np.asarray(np.linalg.norm(a - b, axis=-1))
