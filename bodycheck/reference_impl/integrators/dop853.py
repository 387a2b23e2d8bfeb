"""The Runge-Kutta method of order 8 of Dormand and Prince, for the quaternion and Euler's equations.

y+ = y + h sum b_i k_i, k_i = f(t + c_i h, y + h sum a_ij k_j): the twelve stages of DOP853 without its error
estimate. The coefficients are from the code dop853.f, Hairer, Norsett and Wanner (1993), Solving ordinary
differential equations I, section II.5. They satisfy sum_j b_j a_ji = b_i (1 - c_i): an acceleration at c_i
changes the position in proportion to the rest of the step.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.facts import Tableau
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

RotationState: TypeAlias = tuple[float, float, float, float, float, float, float]
"""A stage in a kernel: the quaternion and omega in body axes, or their rates."""

NODES = (
    0.0,
    0.05260015195876773,
    0.0789002279381516,
    0.1183503419072274,
    0.2816496580927726,
    0.3333333333333333,
    0.25,
    0.3076923076923077,
    0.6512820512820513,
    0.6,
    0.8571428571428571,
    1.0,
)
"""c_i, as fractions of the step."""

ROWS: tuple[dict[int, float], ...] = (
    {},
    {1: 0.05260015195876773},
    {1: 0.0197250569845379, 2: 0.0591751709536137},
    {1: 0.02958758547680685, 3: 0.08876275643042054},
    {1: 0.2413651341592667, 3: -0.8845494793282861, 4: 0.924834003261792},
    {1: 0.037037037037037035, 4: 0.17082860872947386, 5: 0.12546768756682242},
    {1: 0.037109375, 4: 0.17025221101954405, 5: 0.06021653898045596, 6: -0.017578125},
    {
        1: 0.03709200011850479,
        4: 0.17038392571223998,
        5: 0.10726203044637328,
        6: -0.015319437748624402,
        7: 0.008273789163814023,
    },
    {
        1: 0.6241109587160757,
        4: -3.3608926294469414,
        5: -0.868219346841726,
        6: 27.59209969944671,
        7: 20.154067550477894,
        8: -43.48988418106996,
    },
    {
        1: 0.47766253643826434,
        4: -2.4881146199716677,
        5: -0.590290826836843,
        6: 21.230051448181193,
        7: 15.279233632882423,
        8: -33.28821096898486,
        9: -0.020331201708508627,
    },
    {
        1: -0.9371424300859873,
        4: 5.186372428844064,
        5: 1.0914373489967295,
        6: -8.149787010746927,
        7: -18.52006565999696,
        8: 22.739487099350505,
        9: 2.4936055526796523,
        10: -3.0467644718982196,
    },
    {
        1: 2.273310147516538,
        4: -10.53449546673725,
        5: -2.0008720582248625,
        6: -17.9589318631188,
        7: 27.94888452941996,
        8: -2.8589982771350235,
        9: -8.87285693353063,
        10: 12.360567175794303,
        11: 0.6433927460157636,
    },
)
"""a_ij for the stages i = 1 to 12, keyed by the earlier stage j; the others are 0."""

WEIGHTS = {
    1: 0.054293734116568765,
    6: 4.450312892752409,
    7: 1.8915178993145003,
    8: -5.801203960010585,
    9: 0.3111643669578199,
    10: -0.1521609496625161,
    11: 0.20136540080403034,
    12: 0.04471061572777259,
}
"""b_i keyed by the stage i; the others are 0."""

TABLEAU = Tableau(
    a=np.array([[row.get(j, 0.0) for j in range(1, 13)] for row in ROWS]),
    b=np.array([WEIGHTS.get(i, 0.0) for i in range(1, 13)]),
    c=np.array(NODES),
)

A = ((), *(tuple(row.values()) for row in ROWS))
"""For kernels: A[i] holds the non-zero coefficients of stage i, in order."""

B = tuple(WEIGHTS.values())
"""For kernels: the non-zero weights, in order."""

B_REMAINING = tuple(weight * (1.0 - NODES[stage - 1]) for stage, weight in WEIGHTS.items())
"""For kernels: b_i (1 - c_i), in the order of B."""


@inlined_kernel
def plus(y: RotationState, s: float, k: RotationState) -> RotationState:
    """y + s k."""
    return (
        y[0] + s * k[0],
        y[1] + s * k[1],
        y[2] + s * k[2],
        y[3] + s * k[3],
        y[4] + s * k[4],
        y[5] + s * k[5],
        y[6] + s * k[6],
    )


@inlined_kernel
def combined(
    y: RotationState, h: float, coefficients: tuple[float, ...], k: tuple[RotationState, ...]
) -> RotationState:
    """y + h sum a_j k_j. The number of terms is a constant, so the compiler unrolls the loop."""
    total = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for j in range(len(k)):
        total = plus(total, coefficients[j], k[j])
    return plus(y, h, total)


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
