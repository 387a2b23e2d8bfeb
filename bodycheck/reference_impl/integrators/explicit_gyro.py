"""Map M1, used by most engines: the explicit gyroscopic term, then the pose from the new velocity."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.evaluated_loads import with_zero_order_hold
from bodycheck.reference_impl.integrators.facts import Integrator, exact_step_angle
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque, gyroscopic
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    matrix_at,
    matrix_of,
    quaternion_exp,
    quaternion_times,
    scaled_add,
    store,
    times,
    vector_at,
)


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place. omega is in body axes."""
    inertia, inertia_inverse = matrix_at(body, 1), matrix_at(body, 10)
    position, velocity, omega = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    for _ in range(steps):
        rotation = matrix_of(q)
        torque = scaled_add(body_torque(rotation, load), -1.0, gyroscopic(inertia, omega))
        omega = scaled_add(omega, dt, times(inertia_inverse, torque))
        velocity = scaled_add(velocity, dt, acceleration(rotation, load, body[0]))
        position = scaled_add(position, dt, velocity)
        q = quaternion_times(q, quaternion_exp((dt * omega[0], dt * omega[1], dt * omega[2])))
    store(state, 0, position)
    store(state, 3, velocity)
    store(state, 6, omega)
    state[9], state[10], state[11], state[12] = q


METHOD = Integrator(
    name="m1",
    formula="omega+ = omega + dt I^-1 (tau - omega x I omega), q+ = q exp(dt omega+ / 2)",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| to round-off",
    preserves=frozenset({"rotation group"}),
    source="measured to be the map of MuJoCo Euler, Bullet's btMultiBody and DART",
    step_angle=exact_step_angle,
    position_weight=1.0,
    attitude="quaternion",
    spin="omega_body",
    advance=advance,
    advance_forced=with_zero_order_hold(advance, "omega_body"),
)
