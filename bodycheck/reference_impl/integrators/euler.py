"""Forward Euler on the rotation matrix: R+ = R + dt [omega]x R, which leaves SO(3) in the first step."""

from __future__ import annotations

import math

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.evaluated_loads import with_zero_order_hold
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    cross,
    matrix_at,
    scaled_add,
    store,
    times,
    transposed_times,
    vector_at,
)


@kernel
def step(state: Array, body: Array, load: Array, dt: float) -> None:
    """x+ = x + dt v, v+ = v + dt a, L+ = L + dt tau, R+ = R + dt [omega]x R; omega = R I0^-1 R^T L.

    state (18,): x, v, L and R in row-major order, updated in place; body (19,) and load (21,) as in
    right_hand_sides.py.
    """
    velocity, momentum, rotation = vector_at(state, 3), vector_at(state, 6), matrix_at(state, 9)
    torque_world = times(rotation, body_torque(rotation, load))
    omega = times(rotation, times(matrix_at(body, 10), transposed_times(rotation, momentum)))
    store(state, 3, scaled_add(velocity, dt, acceleration(rotation, load, body[0])))
    store(state, 0, scaled_add(vector_at(state, 0), dt, velocity))
    store(state, 6, scaled_add(momentum, dt, torque_world))
    for column in range(3):
        axis = (rotation[column], rotation[3 + column], rotation[6 + column])
        advanced = scaled_add(axis, dt, cross(omega, axis))
        state[9 + column], state[12 + column], state[15 + column] = advanced


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place: state (18,), body (19,), load (21,), as for `step`."""
    for _ in range(steps):
        step(state, body, load, dt)


METHOD = Integrator(
    name="euler",
    formula="R+ = R + dt [omega]x R, L+ = L + dt tau",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="the L that it carries, where no torque acts; not R in SO(3), nor I(R) omega with it",
    preserves=frozenset(),
    source="Baraff and Witkin (1997), Physically based modeling: rigid body simulation, part 1",
    step_angle=math.atan,
    position_weight=0.0,
    attitude="matrix",
    spin="angular_momentum",
    advance=advance,
    advance_forced=with_zero_order_hold(advance, "angular_momentum"),
)
