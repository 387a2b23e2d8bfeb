"""The classical Runge-Kutta method for the quaternion, not normalised, and Euler's equations."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.facts import Tableau
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque, gyroscopic
from bodycheck.reference_impl.integrators.runge_kutta import runge_kutta
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Quat,
    Vec,
    add,
    matrix_at,
    matrix_of,
    quaternion_times,
    scaled_add,
    store,
    times,
    vector_at,
)

_TABLEAU = Tableau(
    a=np.array([[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
    b=np.array([1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0]),
    c=np.array([0.0, 0.5, 0.5, 1.0]),
)


@kernel
def _rates(q: Quat, omega: Vec, body: Array, load: Array) -> tuple[Quat, Vec, Vec]:
    """q' = q omega / 2, omega' = I^-1 (tau - omega x I omega), v' = F / m."""
    inertia: Mat = matrix_at(body, 1)
    rotation = matrix_of(q)
    torque = scaled_add(body_torque(rotation, load), -1.0, gyroscopic(inertia, omega))
    return (
        quaternion_times(q, (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2])),
        times(matrix_at(body, 10), torque),
        acceleration(rotation, load, body[0]),
    )


@kernel
def _advanced(q: Quat, s: float, rate: Quat) -> Quat:
    """q + s q'."""
    return q[0] + s * rate[0], q[1] + s * rate[1], q[2] + s * rate[2], q[3] + s * rate[3]


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place. omega is in body axes."""
    position, velocity, omega = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    half, sixth = 0.5 * dt, dt / 6.0
    for _ in range(steps):
        q1, w1, a1 = _rates(q, omega, body, load)
        q2, w2, a2 = _rates(_advanced(q, half, q1), scaled_add(omega, half, w1), body, load)
        q3, w3, a3 = _rates(_advanced(q, half, q2), scaled_add(omega, half, w2), body, load)
        q4, w4, a4 = _rates(_advanced(q, dt, q3), scaled_add(omega, dt, w3), body, load)
        # sum the increments before adding them: a large state rounds once per step, not four times
        middle = add(a2, a3)
        # x'' depends on q alone: sum the stage velocities v, v + dt/2 a1, v + dt/2 a2, v + dt a3
        position = scaled_add(position, dt, scaled_add(velocity, sixth, add(a1, middle)))
        velocity = scaled_add(velocity, sixth, scaled_add(add(a1, a4), 2.0, middle))
        omega = scaled_add(omega, sixth, scaled_add(add(w1, w4), 2.0, add(w2, w3)))
        q = _advanced(q, sixth, _advanced(_advanced(q1, 1.0, q4), 2.0, _advanced(q2, 1.0, q3)))
    store(state, 0, position)
    store(state, 3, velocity)
    store(state, 6, omega)
    state[9], state[10], state[11], state[12] = q


METHOD = runge_kutta(
    name="rk4",
    formula="y+ = y + dt/6 (k1 + 2 k2 + 2 k3 + k4), y = (x, v, omega, q)",
    order=4,
    tableau=_TABLEAU,
    conserves="nothing exactly; |q| to order 5",
    source="Kutta (1901); Hairer, Norsett and Wanner (1993), Solving ODEs I, table II.1.2",
    advance=advance,
)
