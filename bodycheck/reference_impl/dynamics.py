"""Energy, momentum and inertia of one rigid body. SI units; axes as named; leading batch dimensions."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import hat


def point_positions(rotation: Array, position: Array, points: Array) -> Array:
    """x = R x0 + xc: world positions of body-fixed points.

    Shapes: rotation (3, 3); position (3,), world axes, m; points (n, 3), from the centre of mass in
    body axes, m -> (n, 3), m.
    """
    return points @ rotation.T + position


def point_velocities(rotation: Array, velocity: Array, omega_world: Array, points: Array) -> Array:
    """v = omega x r + vc with r = R x0: world velocities of body-fixed points.

    Shapes: rotation (3, 3); velocity (3,) and omega_world (3,), world axes; points (n, 3), from the
    centre of mass in body axes, m -> (n, 3), m/s, world axes.
    """
    return np.cross(omega_world, points @ rotation.T) + velocity


def inertia_world(rotation: Array, inertia: Array) -> Array:
    """I(t) = R I0 R^T.

    Shapes: (..., 3, 3), (3, 3) in body axes -> (..., 3, 3) in world axes, kg m^2.
    """
    return rotation @ inertia @ np.swapaxes(rotation, -1, -2)


def rotational_energy(inertia: Array, omega_body: Array) -> Array:
    """1/2 omega . I omega.

    Shapes: (3, 3) in kg m^2, (..., 3) in rad/s, both in body axes -> (...), J.
    """
    return 0.5 * np.sum(omega_body * (omega_body @ inertia.T), axis=-1)


def translational_energy(mass: float, velocity: Array) -> Array:
    """1/2 m |v|^2.

    Shapes: mass in kg, velocity (..., 3) in m/s -> (...), J.
    """
    return 0.5 * mass * np.sum(velocity * velocity, axis=-1)


def gravity_potential(mass: float, gravity: Array, displacement: Array) -> Array:
    """U = -m g . (x - x(0)).

    Shapes: mass in kg, gravity (3,) in m/s^2, displacement (..., 3) in m, world axes -> (...), J.
    """
    return -mass * (displacement @ gravity)


def linear_momentum(mass: float, velocity: Array) -> Array:
    """P = m v.

    Shapes: mass in kg, velocity (..., 3) in m/s -> (..., 3), kg m/s, world axes.
    """
    return mass * velocity


def angular_momentum(rotation: Array, inertia: Array, omega_body: Array) -> Array:
    """L = R I0 omega_body = I(t) omega_world, about the centre of mass.

    Shapes: rotation (..., 3, 3); inertia (3, 3) in kg m^2 and omega_body (..., 3) in rad/s, body axes
    -> (..., 3), kg m^2/s, world axes.
    """
    return np.einsum("...ij,...j->...i", rotation, omega_body @ inertia.T)


def angular_acceleration(inertia: Array, omega_body: Array, torque_body: Array) -> Array:
    """omega' = I^-1 (tau - omega x I omega) (Euler 1758), all in body axes.

    Shapes: (3, 3) in kg m^2, (..., 3) in rad/s, (..., 3) in N m -> (..., 3), rad/s^2. Raises
    numpy.linalg.LinAlgError for a singular inertia.
    """
    right = torque_body - np.cross(omega_body, omega_body @ inertia.T)
    return np.asarray(np.linalg.solve(inertia, right[..., None])[..., 0], dtype=np.float64)


def force_and_torque(rotation: Array, points: Array, forces: Array) -> tuple[Array, Array]:
    """F = sum f_i, tau = sum (R x_i) x f_i: resultant force and torque of forces at body points.

    Shapes: rotation (3, 3); points (n, 3), from the centre of mass in body axes, m; forces (n, 3), world
    axes, N -> force (3,) in N and torque (3,) about the centre of mass in N m, world axes.
    """
    return forces.sum(axis=0), np.cross(points @ rotation.T, forces).sum(axis=0)


def inertia_of_points(masses: Array, points: Array) -> Array:
    """I = sum m (|x|^2 E - x x^T) = -sum m [x]x^2, about the origin.

    Shapes: (n,) in kg, (n, 3) in m -> (3, 3), kg m^2, with I_xy = -sum m x y.
    """
    crosses = hat(points)
    return -np.einsum("n,nij,njk->ik", masses, crosses, crosses)


def parallel_axis_tensor(place: Array) -> Array:
    """|d|^2 1 - d d^T: what a unit mass at d adds to a tensor (Huygens and Steiner).

    Shapes: (3,) in m -> (3, 3) in m^2.
    """
    return np.dot(place, place) * np.eye(3) - np.outer(place, place)


def principal_axes(inertia: Array) -> tuple[Array, Array]:
    """I = A diag(J) A^T, det A = +1: ascending principal moments J and the axes, the columns of A.

    Shapes: (3, 3) symmetric -> (3,) in kg m^2, (3, 3). Where two moments are equal, their axes are
    arbitrary within the plane that they span: compare A diag(J) A^T, not the axes.
    """
    moments, axes = np.linalg.eigh(inertia)
    handed = axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
    return np.asarray(moments, dtype=np.float64), handed


def diagonalised(inertia: Array) -> tuple[Array, Array]:
    """I = A diag(J) A^T, with A the identity where I is already diagonal.

    Shapes: (3, 3) symmetric -> (3,) in any order, kg m^2, and (3, 3) with det A = +1.
    """
    moments = np.diagonal(inertia)
    if np.array_equal(inertia, np.diag(moments)):
        return moments.copy(), np.eye(3)
    return principal_axes(inertia)


def gyration_radius(mass: float, inertia: Array) -> float:
    """sqrt(trace(I) / (2 m)): the root mean square distance of the mass from its centre, m.

    Shapes: mass in kg, inertia (3, 3) in kg m^2, in any axes -> m.
    """
    return float(np.sqrt(np.trace(inertia) / (2.0 * mass)))
