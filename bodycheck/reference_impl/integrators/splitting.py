"""exp(h X) as a product of exact flows: rotations about L and principal axes, kicks by the loads; order 6.

With moments J1 <= J2 <= J3 and m = R^T L in principal axes, the rotational energy is split as

    sum m_i^2 / (2 J_i) = |L|^2 / (2 J2) + (1/J1 - 1/J2) m_1^2 / 2 + (1/J3 - 1/J2) m_3^2 / 2.

The flow of the first term rotates the body about L and commutes with the other two, each of which rotates it
about its own axis at a constant rate. The motion of a free body with two equal moments is therefore exact at
any step size. For other free bodies, the error is proportional to (J2 - J1) (J3 - J2).
"""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import continuous_wrench
from bodycheck.reference_impl.integrators.facts import Integrator, exact_step_angle
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Quat,
    Vec,
    matrix_at,
    matrix_of,
    principal_frame,
    quaternion_exp,
    quaternion_times,
    scaled_add,
    store,
    times,
    transposed_times,
    vector_at,
)
from bodycheck.reference_impl.scene import Drag

# S10 of order 6, Blanes and Moan (2002), J. Comput. Appl. Math. 142, 313: alternating kicks and drifts
_A = (0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780)
_B = (0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175)
KICKS = np.array([*_A, 1.0 - 2.0 * sum(_A), *_A[::-1]])
DRIFTS = np.array([*_B, 0.5 - sum(_B), 0.5 - sum(_B), *_B[::-1]])


def _first_parts() -> Array:
    """The part (10,) of each drift, which has two terms itself, that comes before its middle.

    A composition of two flows with such weights is a composition of exp(s X) exp(s Y) and its adjoint in
    alternation, with s1 = a1, s1 + s2 = b1, s2 + s3 = a2, ... It therefore has the same order for any number
    of flows (McLachlan 1995, SIAM J. Sci. Comput. 16, 151). The two parts of a drift must stay unequal.
    """
    parts, kicked = [], 0.0
    for kick, drift in zip(KICKS[:-1], DRIFTS, strict=True):
        parts.append(kick - kicked)
        kicked = drift - parts[-1]
    return np.array(parts)


FIRST_PARTS = _first_parts()

_NO_VELOCITY = (0.0, 0.0, 0.0)  # no load that this method supports depends on it


@kernel
def _about_first(p: Quat, m: Vec, angle: float) -> tuple[Quat, Vec]:
    """p exp(angle e1 / 2), and m = R^T L in the rotated axes."""
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    sine, half = 2.0 * s * c, 2.0 * s * s
    return (
        (c * p[0] - s * p[1], c * p[1] + s * p[0], c * p[2] + s * p[3], c * p[3] - s * p[2]),
        (m[0], m[1] - half * m[1] + sine * m[2], m[2] - half * m[2] - sine * m[1]),
    )


@kernel
def _about_last(p: Quat, m: Vec, angle: float) -> tuple[Quat, Vec]:
    """p exp(angle e3 / 2), and m = R^T L in the rotated axes."""
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    sine, half = 2.0 * s * c, 2.0 * s * s
    return (
        (c * p[0] - s * p[3], c * p[1] + s * p[2], c * p[2] - s * p[1], c * p[3] + s * p[0]),
        (m[0] - half * m[0] + sine * m[1], m[1] - half * m[1] - sine * m[0], m[2]),
    )


@kernel
def _rotated(q: Quat, m: Vec, excess: Vec, axes: Mat, whole: float, first: float) -> Quat:
    """q after a drift of `whole` seconds, of which `first` seconds lie before its middle.

    m = R^T L in principal axes; excess = (1/J1 - 1/J2, 1/J2, 1/J3 - 1/J2).
    """
    common = whole * excess[1]
    p = quaternion_exp((common * m[0], common * m[1], common * m[2]))
    p, m = _about_first(p, m, first * excess[0] * m[0])
    p, m = _about_last(p, m, whole * excess[2] * m[2])
    p, m = _about_first(p, m, (whole - first) * excess[0] * m[0])
    # q p = q + q (p - 1), with 1 - p_w from the vector part: the angles hardly change from step to step, so
    # the rounding error of p_w, just below 1, would change |q| by the same amount at every step
    square = p[1] * p[1] + p[2] * p[2] + p[3] * p[3]
    less = -square / (1.0 + p[0]) if p[0] > 0.0 else p[0] - 1.0
    x, y, z = times(axes, (p[1], p[2], p[3]))
    change = quaternion_times(q, (less, x, y, z))
    return q[0] + change[0], q[1] + change[1], q[2] + change[2], q[3] + change[3]


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
    """Advance the state by the steps, in place. Only the kicks change L, which is in world axes."""
    moments, axes = principal_frame(matrix_at(body, 1))
    middle = 1.0 / moments[1]
    excess = (
        (moments[1] - moments[0]) / (moments[0] * moments[1]),
        middle,
        (moments[1] - moments[2]) / (moments[2] * moments[1]),
    )
    position, velocity, momentum = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    rotation = matrix_of(q)
    for step in range(steps):
        t = begin + step * dt
        for i in range(len(KICKS)):
            kick = dt * KICKS[i]
            if continuous is not None:
                force, couple = continuous_wrench(
                    t, position, rotation, _NO_VELOCITY, _NO_VELOCITY, continuous
                )
                velocity = scaled_add(velocity, kick / body[0], force)
                momentum = scaled_add(momentum, kick, couple)
            velocity = scaled_add(velocity, kick, acceleration(rotation, load, body[0]))
            momentum = scaled_add(momentum, kick, times(rotation, body_torque(rotation, load)))
            if i < len(DRIFTS):
                m = transposed_times(axes, transposed_times(rotation, momentum))
                q = _rotated(q, m, excess, axes, dt * DRIFTS[i], dt * FIRST_PARTS[i])
                position = scaled_add(position, dt * DRIFTS[i], velocity)
                rotation = matrix_of(q)
                t += dt * DRIFTS[i]
    store(state, 0, position)
    store(state, 3, velocity)
    store(state, 6, momentum)
    state[9], state[10], state[11], state[12] = q


def advance_forced(
    state: Array, body: Array, load: Array, continuous: Array, begin: float, dt: float, steps: int
) -> None:
    """Advance the state by the steps, in place, with continuous loads. The drifts advance the time."""
    advance(state, body, load, dt, steps, continuous, begin)


METHOD = Integrator(
    name="splitting6",
    formula="exp(a11 K) exp(b10 D) ... exp(b1 D) exp(a1 K): loads kick, the free body drifts, itself split",
    order=6,
    evaluations=11,
    torque="every stage",
    conserves="L exactly where no torque acts; the symplectic form, so the energy error stays bounded; |q|",
    preserves=frozenset({"angular momentum", "rotation group", "symplectic form", "time reversal"}),
    source="Touma and Wisdom (1994), Astron. J. 107, 1189; Blanes and Moan (2002), method S10",
    step_angle=exact_step_angle,
    position_weight=0.5,
    attitude="quaternion",
    spin="angular_momentum",
    advance=advance,
    advance_forced=advance_forced,
    continuous="every stage",
    refused=(Drag,),  # a kick is exact only if the load does not depend on velocity or omega
)
