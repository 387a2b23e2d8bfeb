"""Map M2: gyroscopic term and torque in one linearised implicit solve, then the pose."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.evaluated_loads import with_zero_order_hold
from bodycheck.reference_impl.integrators.facts import Integrator, exact_step_angle
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque, gyroscopic
from bodycheck.reference_impl.kernels.jit import kernel, merged_kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Vec,
    matrix_at,
    matrix_of,
    quaternion_exp,
    quaternion_times,
    scaled_add,
    solve,
    store,
    times,
    vector_at,
)


@kernel
def _newton_matrix(inertia: Mat, omega: Vec, dt: float) -> Mat:
    """I + dt D, D = [omega]x I - [I omega]x, the derivative of omega x I omega."""
    i, (x, y, z) = inertia, omega
    lx, ly, lz = times(inertia, omega)
    return (
        i[0] + dt * (y * i[6] - z * i[3]),
        i[1] + dt * (y * i[7] - z * i[4] + lz),
        i[2] + dt * (y * i[8] - z * i[5] - ly),
        i[3] + dt * (z * i[0] - x * i[6] - lz),
        i[4] + dt * (z * i[1] - x * i[7]),
        i[5] + dt * (z * i[2] - x * i[8] + lx),
        i[6] + dt * (x * i[3] - y * i[0] + ly),
        i[7] + dt * (x * i[4] - y * i[1] - lx),
        i[8] + dt * (x * i[5] - y * i[2]),
    )


@merged_kernel
def advance_linearised(
    state: Array, body: Array, load: Array, dt: float, steps: int, torque_inside: bool
) -> None:
    """Advance the state by the steps, in place, with the torque inside the linear solve (M2) or not (M3).

    omega is in body axes.
    """
    inertia, inertia_inverse = matrix_at(body, 1), matrix_at(body, 10)
    position, velocity, omega = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    for _ in range(steps):
        rotation = matrix_of(q)
        matrix = _newton_matrix(inertia, omega, dt)
        torque, gyroscopic_torque = body_torque(rotation, load), gyroscopic(inertia, omega)
        if torque_inside:
            omega = scaled_add(omega, dt, solve(matrix, scaled_add(torque, -1.0, gyroscopic_torque)))
        else:
            omega = scaled_add(omega, -dt, solve(matrix, gyroscopic_torque))
            omega = scaled_add(omega, dt, times(inertia_inverse, torque))
        velocity = scaled_add(velocity, dt, acceleration(rotation, load, body[0]))
        position = scaled_add(position, dt, velocity)
        q = quaternion_times(q, quaternion_exp((dt * omega[0], dt * omega[1], dt * omega[2])))
    store(state, 0, position)
    store(state, 3, velocity)
    store(state, 6, omega)
    state[9], state[10], state[11], state[12] = q


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place. omega is in body axes."""
    advance_linearised(state, body, load, dt, steps, True)


METHOD = Integrator(
    name="m2",
    formula="omega+ = omega + (I + dt D)^-1 dt (tau - omega x I omega), q+ = q exp(dt omega+ / 2)",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| to round-off",
    preserves=frozenset({"rotation group"}),
    source="measured to be the map of MuJoCo implicit, implicitfast, discrete; D = [omega]x I - [I omega]x",
    step_angle=exact_step_angle,
    position_weight=1.0,
    attitude="quaternion",
    spin="omega_body",
    advance=advance,
    advance_forced=with_zero_order_hold(advance, "omega_body"),
)
