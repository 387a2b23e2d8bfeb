"""Update R first: R+ = exp(dt [omega]x) R, then omega+ = I(R+)^-1 (I(R) omega + dt tau)."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.evaluated_loads import with_zero_order_hold
from bodycheck.reference_impl.integrators.facts import Integrator, exact_step_angle
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    matrix_at,
    matrix_of,
    quaternion_exp,
    quaternion_times,
    scaled_add,
    store,
    times,
    transposed_times,
    vector_at,
)


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place.

    The state holds the momentum I(R) omega, which avoids the rounding of solving for omega and multiplying
    back. It holds R as a unit quaternion, whose products drift from SO(3) most slowly.
    """
    inertia_inverse = matrix_at(body, 10)
    position, velocity, momentum = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    for _ in range(steps):
        rotation = matrix_of(q)
        omega = times(rotation, times(inertia_inverse, transposed_times(rotation, momentum)))
        momentum = scaled_add(momentum, dt, times(rotation, body_torque(rotation, load)))
        position = scaled_add(position, dt, velocity)
        velocity = scaled_add(velocity, dt, acceleration(rotation, load, body[0]))
        q = quaternion_times(quaternion_exp((dt * omega[0], dt * omega[1], dt * omega[2])), q)
    store(state, 0, position)
    store(state, 3, velocity)
    store(state, 6, momentum)
    state[9], state[10], state[11], state[12] = q


METHOD = Integrator(
    name="lie-euler",
    formula="R+ = exp(dt [omega]x) R, omega+ = I(R+)^-1 (I(R) omega + dt tau)",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="L to round-off where no torque acts; orthogonality of R",
    preserves=frozenset({"angular momentum", "rotation group"}),
    source="Buss (2000), Accurate and efficient simulation of rigid-body rotations",
    step_angle=exact_step_angle,
    position_weight=0.0,
    attitude="quaternion",
    spin="angular_momentum",
    advance=advance,
    advance_forced=with_zero_order_hold(advance, "angular_momentum"),
)
