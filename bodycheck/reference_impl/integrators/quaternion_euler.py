"""Forward Euler for the quaternion, not normalised, and Euler's equations: q+ = q + dt/2 q omega."""

from __future__ import annotations

import math

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.evaluated_loads import with_zero_order_hold
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque, gyroscopic
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    matrix_at,
    matrix_of,
    quaternion_times,
    scaled_add,
    store,
    times,
    vector_at,
)


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place.

    state (13,): x, v, omega in body axes, q; body (19,) and load (21,) as in right_hand_sides.py.
    """
    inertia, inertia_inverse = matrix_at(body, 1), matrix_at(body, 10)
    position, velocity, omega = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    for _ in range(steps):
        rotation = matrix_of(q)
        torque = scaled_add(body_torque(rotation, load), -1.0, gyroscopic(inertia, omega))
        rate = quaternion_times(q, (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2]))
        position = scaled_add(position, dt, velocity)
        velocity = scaled_add(velocity, dt, acceleration(rotation, load, body[0]))
        omega = scaled_add(omega, dt, times(inertia_inverse, torque))
        q = (q[0] + dt * rate[0], q[1] + dt * rate[1], q[2] + dt * rate[2], q[3] + dt * rate[3])
    store(state, 0, position)
    store(state, 3, velocity)
    store(state, 6, omega)
    state[9], state[10], state[11], state[12] = q


METHOD = Integrator(
    name="quaternion-euler",
    formula="q+ = q + dt/2 q omega, omega+ = omega + dt I^-1 (tau - omega x I omega)",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="nothing; |q| grows by (dt omega)^2 / 8 per step",
    preserves=frozenset(),
    source="Euler (1768), Institutiones calculi integralis, on q' = q omega / 2",
    step_angle=lambda x: 2.0 * math.atan(0.5 * x),
    position_weight=0.0,
    attitude="quaternion",
    spin="omega_body",
    advance=advance,
    advance_forced=with_zero_order_hold(advance, "omega_body"),
)
