"""The right-hand sides that the fixed-step kernels share, and the layout of their arguments.

load (21,): force_body, force_world including the weight, torque_body, torque_world, moment (3, 3), as
Wrench.packed returns it. body (19,): mass, inertia, inverse inertia, as `packed_body` returns it.
"""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Vec,
    add,
    cross,
    times,
    transposed_times,
    vector_at,
)
from bodycheck.reference_impl.scene import RigidBody


def packed_body(body: RigidBody) -> Array:
    """(19,): mass, the nine elements of I, the nine elements of I^-1."""
    return np.concatenate([[body.mass], body.inertia.ravel(), np.linalg.inv(body.inertia).ravel()])


@kernel
def body_torque(rotation: Mat, load: Array) -> Vec:
    """tau = tau_b + R^T tau_w + sum a x R^T F, in body axes, N m; load (21,) as above."""
    direct_torque = add(vector_at(load, 6), transposed_times(rotation, vector_at(load, 9)))
    # (moment R)_bc; each world force F at the point a gives tau_a = eps_abc a_b (R^T F)_c
    row0 = transposed_times(rotation, vector_at(load, 12))
    row1 = transposed_times(rotation, vector_at(load, 15))
    row2 = transposed_times(rotation, vector_at(load, 18))
    return add(direct_torque, (row1[2] - row2[1], row2[0] - row0[2], row0[1] - row1[0]))


@kernel
def acceleration(rotation: Mat, load: Array, mass: float) -> Vec:
    """v' = (R F_b + F_w) / m, in world axes, m/s^2; load (21,) as above."""
    force = add(times(rotation, vector_at(load, 0)), vector_at(load, 3))
    return force[0] / mass, force[1] / mass, force[2] / mass


@kernel
def gyroscopic(inertia: Mat, omega_body: Vec) -> Vec:
    """omega x I omega, in body axes, N m."""
    return cross(omega_body, times(inertia, omega_body))
