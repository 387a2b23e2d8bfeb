"""The Runge-Kutta method of order 8 of Dormand and Prince, for the quaternion and Euler's equations."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.dormand_prince import (
    B_REMAINING,
    TABLEAU,
    A,
    B,
    RotationState,
    combined,
)
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque, gyroscopic
from bodycheck.reference_impl.integrators.runge_kutta import runge_kutta
from bodycheck.reference_impl.kernels.jit import inlined_kernel, kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Vec,
    matrix_at,
    matrix_of,
    quaternion_times,
    scaled_add,
    store,
    times,
    vector_at,
)


@kernel
def _rates(y: RotationState, body: Array, load: Array) -> tuple[RotationState, Vec]:
    """q' = q omega / 2, omega' = I^-1 (tau - omega x I omega), v' = F / m."""
    q, omega = (y[0], y[1], y[2], y[3]), (y[4], y[5], y[6])
    rotation = matrix_of(q)
    attitude_rate = quaternion_times(q, (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2]))
    torque = scaled_add(body_torque(rotation, load), -1.0, gyroscopic(matrix_at(body, 1), omega))
    angular_acceleration = times(matrix_at(body, 10), torque)
    return attitude_rate + angular_acceleration, acceleration(rotation, load, body[0])


@inlined_kernel
def _weighted(weights: tuple[float, ...], a: tuple[Vec, ...]) -> Vec:
    """sum b_j a_j."""
    total = (0.0, 0.0, 0.0)
    for j in range(len(a)):
        total = scaled_add(total, weights[j], a[j])
    return total


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place. omega is in body axes."""
    x, v, omega = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    y = (state[9], state[10], state[11], state[12], omega[0], omega[1], omega[2])
    for _ in range(steps):
        k1, a1 = _rates(y, body, load)
        k2, _ = _rates(combined(y, dt, A[2], (k1,)), body, load)
        k3, _ = _rates(combined(y, dt, A[3], (k1, k2)), body, load)
        k4, _ = _rates(combined(y, dt, A[4], (k1, k3)), body, load)
        k5, _ = _rates(combined(y, dt, A[5], (k1, k3, k4)), body, load)
        k6, a6 = _rates(combined(y, dt, A[6], (k1, k4, k5)), body, load)
        k7, a7 = _rates(combined(y, dt, A[7], (k1, k4, k5, k6)), body, load)
        k8, a8 = _rates(combined(y, dt, A[8], (k1, k4, k5, k6, k7)), body, load)
        k9, a9 = _rates(combined(y, dt, A[9], (k1, k4, k5, k6, k7, k8)), body, load)
        k10, a10 = _rates(combined(y, dt, A[10], (k1, k4, k5, k6, k7, k8, k9)), body, load)
        k11, a11 = _rates(combined(y, dt, A[11], (k1, k4, k5, k6, k7, k8, k9, k10)), body, load)
        k12, a12 = _rates(combined(y, dt, A[12], (k1, k4, k5, k6, k7, k8, k9, k10, k11)), body, load)
        # x'' depends on q alone: x and v need no separate stages
        a = (a1, a6, a7, a8, a9, a10, a11, a12)
        x = scaled_add(scaled_add(x, dt, v), dt * dt, _weighted(B_REMAINING, a))
        v = scaled_add(v, dt, _weighted(B, a))
        y = combined(y, dt, B, (k1, k6, k7, k8, k9, k10, k11, k12))
    store(state, 0, x)
    store(state, 3, v)
    store(state, 6, (y[4], y[5], y[6]))
    state[9], state[10], state[11], state[12] = y[0], y[1], y[2], y[3]


METHOD = runge_kutta(
    name="dop853",
    formula="y+ = y + dt sum b_i k_i over 12 stages, y = (x, v, omega, q)",
    order=8,
    tableau=TABLEAU,
    conserves="nothing exactly; |q| to order 9",
    source="Dormand and Prince (1989); Hairer, Norsett and Wanner (1993), Solving ODEs I, II.5 and dop853.f",
    advance=advance,
)
