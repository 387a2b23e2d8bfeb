"""Map points of a unit cube to rigid bodies and their initial states, uniformly over a stated distribution.

The map is the inverse of the distribution, so that uniform points give an ensemble, and an optimiser searches
the same space.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import long_exact_kernel

COORDINATES = (
    *("moments_1", "moments_2", "trace", "attitude_1", "attitude_2", "attitude_3"),
    *("spin_1", "spin_2", "spin", "torque_1", "torque_2", "torque"),
)
"""The axes of the unit cube, in order."""


@dataclass(frozen=True)
class Distribution:
    """The ranges (low, high) of the three sizes, each log-uniform; equal ends fix a size.

    trace_kg_m2: I1 + I2 + I3. spin_rad_s: |omega|. torque_n_m: a constant torque in body axes; (0, 0): none.
    Principal moments are uniform in the triangle of possible ones, attitudes uniform on the rotation group,
    the directions of omega and of the torque uniform on the sphere in body axes.
    """

    trace_kg_m2: tuple[float, float]
    spin_rad_s: tuple[float, float]
    torque_n_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Bodies:
    """m bodies with their initial states, in principal axes.

    moments (m, 3) in kg m^2, quaternion (m, 4), omega_body (m, 3) in rad/s, torque_body (m, 3) in N m.
    """

    moments: Array
    quaternion: Array
    omega_body: Array
    torque_body: Array

    def __len__(self) -> int:
        return len(self.moments)

    @property
    def inertia(self) -> Array:
        """The tensors (m, 3, 3)."""
        tensors = np.zeros((len(self), 3, 3))
        tensors[:, range(3), range(3)] = self.moments
        return tensors

    @property
    def separatrix_distance(self) -> Array:
        """|2 E I2 / L^2 - 1| (m,), I2 the middle moment: 0 on the separatrix; NaN at rest."""
        momentum = self.moments * self.omega_body
        twice_energy = np.sum(momentum * self.omega_body, axis=1)
        middle = np.sort(self.moments, axis=1)[:, 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.abs(twice_energy / np.sum(momentum * momentum, axis=1) * middle - 1.0)

    def __getitem__(self, rows: slice | Array | NDArray[np.int_]) -> Bodies:
        return Bodies(
            self.moments[rows], self.quaternion[rows], self.omega_body[rows], self.torque_body[rows]
        )


def bodies_at(distribution: Distribution, points: Array) -> Bodies:
    """Return the bodies at points of the unit cube (m, 12): one axis for each of COORDINATES.

    Only the arithmetic of one body enters its numbers, so that a body is the same in any batch.
    """
    m = len(points)
    found = Bodies(np.empty((m, 3)), np.empty((m, 4)), np.empty((m, 3)), np.empty((m, 3)))
    _fill(
        np.ascontiguousarray(points, dtype=np.float64),
        np.array([distribution.trace_kg_m2, distribution.spin_rad_s, distribution.torque_n_m]),
        *(found.moments, found.quaternion, found.omega_body, found.torque_body),
    )
    return found


@long_exact_kernel
def _size(low: float, high: float, u: float) -> float:
    """low (high / low)^u, exactly low where both are equal."""
    return low if low == high else math.exp((1.0 - u) * math.log(low) + u * math.log(high))


@long_exact_kernel
def _direction(u: float, v: float) -> tuple[float, float, float]:
    """Return a uniform point on the unit sphere (Archimedes: its height is uniform)."""
    across = 2.0 * math.sqrt(u * (1.0 - u))
    return across * math.cos(2.0 * math.pi * v), across * math.sin(2.0 * math.pi * v), 2.0 * u - 1.0


@long_exact_kernel
def _fill(
    points: Array, sizes: Array, moments: Array, quaternion: Array, omega: Array, torque: Array
) -> None:
    """Source of the attitude: Shoemake (1992), Uniform random rotations, Graphics Gems III, 124.

    J_i = trace (1 - s_i) / 2, where (s_1, s_2, s_3), the shares of the second moments, are uniform on the
    simplex: the triangle inequality J_i <= J_j + J_k is s_i >= 0.
    """
    for k in range(len(points)):
        u = points[k]
        root = math.sqrt(u[0])
        half = 0.5 * _size(sizes[0, 0], sizes[0, 1], u[2])
        first, second = root * (1.0 - u[1]), root * u[1]
        moments[k, 0] = half * (first + second)
        moments[k, 1] = half * ((1.0 - root) + second)
        moments[k, 2] = half * ((1.0 - root) + first)
        low, high = math.sqrt(1.0 - u[3]), math.sqrt(u[3])
        quaternion[k, 0] = high * math.cos(2.0 * math.pi * u[5])
        quaternion[k, 1] = low * math.sin(2.0 * math.pi * u[4])
        quaternion[k, 2] = low * math.cos(2.0 * math.pi * u[4])
        quaternion[k, 3] = high * math.sin(2.0 * math.pi * u[5])
        spin, couple = _size(sizes[1, 0], sizes[1, 1], u[8]), _size(sizes[2, 0], sizes[2, 1], u[11])
        x, y, z = _direction(u[6], u[7])
        omega[k, 0], omega[k, 1], omega[k, 2] = spin * x, spin * y, spin * z
        x, y, z = _direction(u[9], u[10])
        torque[k, 0], torque[k, 1], torque[k, 2] = couple * x, couple * y, couple * z
