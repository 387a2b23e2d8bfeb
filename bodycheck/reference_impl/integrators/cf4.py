"""q+ = q exp(h (3k1 + 2k2 + 2k3 - k4) / 12) exp(h (-k1 + 2k2 + 2k3 + 3k4) / 12): commutator-free CF4."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import continuous_wrench
from bodycheck.reference_impl.integrators.facts import Integrator, exact_step_angle
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Quat,
    Vec,
    add,
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
def _rates(q: Quat, momentum: Vec, body: Array, load: Array) -> tuple[Vec, Vec, Vec]:
    """omega = I^-1 R^T L in body axes, L' = R tau and v' = F / m in world axes."""
    rotation = matrix_of(q)
    return (
        times(matrix_at(body, 10), transposed_times(rotation, momentum)),
        times(rotation, body_torque(rotation, load)),
        acceleration(rotation, load, body[0]),
    )


@kernel
def _with_continuous_loads(
    constant: tuple[Vec, Vec, Vec], t: float, x: Vec, v: Vec, q: Quat, mass: float, continuous: Array
) -> tuple[Vec, Vec, Vec]:
    """Add the continuous loads at a stage to its rates omega, L', v'."""
    omega, torque, linear_acceleration = constant
    rotation = matrix_of(q)
    force, couple = continuous_wrench(t, x, rotation, v, times(rotation, omega), continuous)
    return omega, add(torque, couple), scaled_add(linear_acceleration, 1.0 / mass, force)


@kernel
def _rotated(q: Quat, s: float, omega: Vec) -> Quat:
    """q exp(s omega / 2), omega in body axes."""
    return quaternion_times(q, quaternion_exp((s * omega[0], s * omega[1], s * omega[2])))


@kernel
def advance(
    state: Array,
    body: Array,
    load: Array,
    dt: float,
    steps: int,
    continuous: Array | None = None,
    begin: float = 0.0,
) -> None:
    """Advance the state by the steps, in place.

    The group is SO(3) for the attitude and R^3 for L, x and v. On R^3 the method is the classical
    Runge-Kutta method, so that only the torque changes L, which is in world axes.
    """
    x, v, momentum = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    half, sixth, third, twelfth = 0.5 * dt, dt / 6.0, dt / 3.0, dt / 12.0
    for step in range(steps):
        t = begin + step * dt
        k1 = _rates(q, momentum, body, load)
        if continuous is not None:
            k1 = _with_continuous_loads(k1, t, x, v, q, body[0], continuous)
        w1, t1, a1 = k1
        q2 = _rotated(q, half, w1)
        k2 = _rates(q2, scaled_add(momentum, half, t1), body, load)
        if continuous is not None:
            x2, v2 = scaled_add(x, half, v), scaled_add(v, half, a1)
            k2 = _with_continuous_loads(k2, t + half, x2, v2, q2, body[0], continuous)
        w2, t2, a2 = k2
        q3 = _rotated(q, half, w2)
        k3 = _rates(q3, scaled_add(momentum, half, t2), body, load)
        if continuous is not None:
            x3, v3 = scaled_add(x, half, v2), scaled_add(v, half, a2)
            k3 = _with_continuous_loads(k3, t + half, x3, v3, q3, body[0], continuous)
        w3, t3, a3 = k3
        # starts from the second stage, which is already rotated by dt/2 k1
        q4 = _rotated(q2, dt, scaled_add(w3, -0.5, w1))
        k4 = _rates(q4, scaled_add(momentum, dt, t3), body, load)
        if continuous is not None:
            x4, v4 = scaled_add(x, dt, v3), scaled_add(v, dt, a3)
            k4 = _with_continuous_loads(k4, t + dt, x4, v4, q4, body[0], continuous)
        w4, t4, a4 = k4
        middle = (2.0 * (w2[0] + w3[0]), 2.0 * (w2[1] + w3[1]), 2.0 * (w2[2] + w3[2]))
        q = _rotated(q, twelfth, scaled_add(scaled_add(middle, 3.0, w1), -1.0, w4))
        q = _rotated(q, twelfth, scaled_add(scaled_add(middle, 3.0, w4), -1.0, w1))
        # the weighted sum of the stage velocities v, v + dt/2 a1, v + dt/2 a2, v + dt a3
        x = scaled_add(x, dt, v)
        x = scaled_add(x, dt * sixth, a1)
        x = scaled_add(x, dt * sixth, a2)
        x = scaled_add(x, dt * sixth, a3)
        v = scaled_add(scaled_add(v, sixth, a1), third, a2)
        v = scaled_add(scaled_add(v, third, a3), sixth, a4)
        momentum = scaled_add(scaled_add(momentum, sixth, t1), third, t2)
        momentum = scaled_add(scaled_add(momentum, third, t3), sixth, t4)
    store(state, 0, x)
    store(state, 3, v)
    store(state, 6, momentum)
    state[9], state[10], state[11], state[12] = q


def advance_forced(
    state: Array, body: Array, load: Array, continuous: Array, begin: float, dt: float, steps: int
) -> None:
    """Advance the state by the steps, in place, with continuous loads."""
    advance(state, body, load, dt, steps, continuous, begin)


METHOD = Integrator(
    name="cf4",
    formula="q+ = q exp(dt (3k1 + 2k2 + 2k3 - k4) / 12) exp(dt (-k1 + 2k2 + 2k3 + 3k4) / 12), L+ by RK4",
    order=4,
    evaluations=4,
    torque="every stage",
    conserves="L exactly where no torque acts; |q| to round-off",
    preserves=frozenset({"angular momentum", "rotation group"}),
    source="Celledoni, Marthinsen and Owren (2003), Commutator-free Lie group methods, FGCS 19, 341",
    step_angle=exact_step_angle,
    position_weight=0.5,
    attitude="quaternion",
    spin="angular_momentum",
    advance=advance,
    advance_forced=advance_forced,
    continuous="every stage",
)
