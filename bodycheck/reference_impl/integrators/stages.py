"""y+ = y + dt sum b_i k_i, k_i = f(t + c_i dt, y + dt sum a_ij k_j): any explicit tableau under any load.

The methods' own kernels leave the stages of x and v out, which only lasting loads need.
"""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.facts import AdvanceUnder
from bodycheck.reference_impl.integrators.right_hand_sides import (
    acceleration,
    body_torque,
    gyroscopic,
    matrix_at,
    store,
    vector_at,
)
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    add,
    matrix_of,
    quaternion_times,
    scaled_add,
    times,
    transposed_times,
)
from bodycheck.reference_impl.loads.continuous_loads import lasting_wrench


def stage_by_stage(a: Array, b: Array, c: Array) -> AdvanceUnder:
    """Return how the method of a tableau steps: a (s, s) strictly lower, b (s,), c (s,)."""

    def advance_forced(
        state: Array, body: Array, load: Array, lasting: Array, begin: float, dt: float, steps: int
    ) -> None:
        _advance(state, body, load, lasting, begin, dt, steps, a, b, c)

    return advance_forced


@kernel
def _rates(t: float, y: Array, body: Array, load: Array, lasting: Array, k: Array) -> None:
    """x' = v, v' = F / m, omega' = I^-1 (tau - omega x I omega), q' = q omega / 2, into k (13,)."""
    omega, q = vector_at(y, 6), (y[9], y[10], y[11], y[12])
    rotation = matrix_of(q)
    omega_world = times(rotation, omega)
    force, couple = lasting_wrench(t, vector_at(y, 0), rotation, vector_at(y, 3), omega_world, lasting)
    torque = add(body_torque(rotation, load), transposed_times(rotation, couple))
    turning = scaled_add(torque, -1.0, gyroscopic(matrix_at(body, 1), omega))
    store(k, 0, vector_at(y, 3))
    store(k, 3, scaled_add(acceleration(rotation, load, body[0]), 1.0 / body[0], force))
    store(k, 6, times(matrix_at(body, 10), turning))
    k[9], k[10], k[11], k[12] = quaternion_times(q, (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2]))


@kernel
def _advance(
    state: Array,
    body: Array,
    load: Array,
    lasting: Array,
    begin: float,
    dt: float,
    steps: int,
    a: Array,
    b: Array,
    c: Array,
) -> None:
    """Make the steps in place, omega in body axes."""
    stages, point = np.zeros((len(b), 13)), np.empty(13)
    for step in range(steps):
        t = begin + step * dt
        for i in range(len(b)):
            for n in range(13):
                moved = 0.0
                for j in range(i):
                    moved += a[i, j] * stages[j, n]
                point[n] = state[n] + dt * moved
            _rates(t + c[i] * dt, point, body, load, lasting, stages[i])
        for n in range(13):
            moved = 0.0
            for i in range(len(b)):
                moved += b[i] * stages[i, n]
            state[n] += dt * moved
