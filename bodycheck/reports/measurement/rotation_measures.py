"""The measures of rotation of many bodies at once, each as `measures.py` has it for one case."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle, rotate

ROTATION_MEASURES = (
    "orientation_error_rad",
    "omega_error",
    "rotational_energy_drift",
    "angular_momentum_drift",
)
"""The measures of ensembles: those of a rotation that need no load."""

_MAX_ENERGY = 100.0  # times the largest true kinetic energy: unstable above, as in stable_step.py


@dataclass(frozen=True, eq=False)
class RotationMeasures:
    """The measures of m bodies (m,) by name, infinite where unstable, and which bodies are unstable (m,)."""

    values: dict[str, Array]
    unstable: NDArray[np.bool_]


def rotation_measures(
    inertia: Array, true: tuple[Array, Array], found: tuple[Array, Array]
) -> RotationMeasures:
    """Return the maxima over n samples, relative to the maxima of the truth.

    inertia (m, 3, 3) about the centre of mass or the pivot, in body axes; true and found: quaternion
    (m, n, 4) and omega_body (m, n, 3). A motion that is not finite, or whose energy exceeds a hundred times
    that of the truth, is unstable.
    """
    (q_true, omega_true), (q, omega) = true, found
    with np.errstate(over="ignore", invalid="ignore"):
        about_true, about = _momentum(inertia, omega_true), _momentum(inertia, omega)
        energy_true, energy = (
            0.5 * np.sum(rate * momentum, axis=-1)
            for rate, momentum in ((omega_true, about_true), (omega, about))
        )
        energy_scale = np.max(energy_true, axis=1)
        finite = np.isfinite(q).all(axis=(1, 2)) & np.isfinite(omega).all(axis=(1, 2))
        finite &= np.all(np.max(np.abs(q), axis=-1) > 0.0, axis=1)
        limit = np.where(energy_scale > 0.0, _MAX_ENERGY * energy_scale, np.inf)
        unstable = ~(finite & (np.max(energy, axis=1) <= limit))
        q = np.where(unstable[:, None, None], q_true, q)
        departures = {
            "orientation_error_rad": np.max(geodesic_angle(q_true, q), axis=1),
            "omega_error": _largest(omega - omega_true) / _scale(_largest(omega_true)),
            "rotational_energy_drift": np.max(np.abs(energy - energy_true), axis=1) / _scale(energy_scale),
            "angular_momentum_drift": _largest(rotate(q, about) - rotate(q_true, about_true))
            / _scale(_largest(about_true)),
        }
    values = {name: np.where(unstable, np.inf, measured) for name, measured in departures.items()}
    return RotationMeasures(values, unstable)


def _momentum(inertia: Array, omega: Array) -> Array:
    """I omega of each body at each sample (m, n, 3), in body axes."""
    return np.asarray(omega @ inertia.transpose(0, 2, 1))


def _largest(vectors: Array) -> Array:
    return np.asarray(np.max(np.linalg.norm(vectors, axis=-1), axis=1))


def _scale(sizes: Array) -> Array:
    """Return what to divide by: 1 where nothing moves."""
    return np.where(sizes > 0.0, sizes, 1.0)
