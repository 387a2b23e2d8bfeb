"""M1 and classical Runge-Kutta 4 with one right-hand side, each term of which can be made wrong.

The state (13,) is x, v (world axes), omega (body axes), q (scalar first). The load is that of Wrench.packed.
constants (23,): 1 / m, I^-1, I, the factor of the gyroscopic term, the dampings of v and omega, the middle
moment. switches (12,): the deviations of a step, at the indices named here.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Quat,
    Vec,
    add,
    cross,
    dot,
    matrix_at,
    matrix_of,
    quaternion_exp,
    quaternion_times,
    scaled_add,
    store,
    times,
    vector_at,
)

CLAMP, ANGLE, ADDITIVE, OLD_VELOCITY, WORLD_OMEGA, SINGLE, DRAG_ENERGY, BODY_VELOCITY, NORMALISED = range(9)
SPEED_CLAMP, ASLEEP, QUADRATIC = range(9, 12)

Rates: TypeAlias = tuple[Vec, Vec, Quat]


@kernel
def _single(v: Vec) -> Vec:
    """v rounded to single precision."""
    return (
        np.float64(np.float32(v[0])),
        np.float64(np.float32(v[1])),
        np.float64(np.float32(v[2])),
    )


@kernel
def _dragging(omega: Vec, inertia: Mat, inverse: Mat, middle: float) -> Vec:
    """I2 (E - L^2 / 2 I2) / E times I^-1 of minus omega's part normal to L.

    It keeps |L| and lowers E towards L^2 / 2 I2.
    """
    spin = times(inertia, omega)
    size, energy = dot(spin, spin), 0.5 * dot(omega, spin)
    if energy <= 0.0:
        return 0.0, 0.0, 0.0
    across = times(inverse, cross(spin, cross(spin, omega)))
    share = middle * (energy - 0.5 * size / middle) / (energy * size)
    return scaled_add((0.0, 0.0, 0.0), share, across)


@kernel
def _rates(v: Vec, omega: Vec, q: Quat, load: Array, constants: Array, switches: Array) -> Rates:
    """v' = F / m - c v, omega' = I^-1 (tau - g omega x I omega) - d omega, q' = q omega / 2."""
    if switches[SINGLE] > 0.0:
        omega = _single(omega)
    rotation: Mat = matrix_of(q)
    inverse, inertia = matrix_at(constants, 1), matrix_at(constants, 10)
    moved = scaled_add(acceleration(rotation, load, 1.0 / constants[0]), -constants[20], v)
    if switches[QUADRATIC] > 0.0:
        moved = scaled_add(moved, -switches[QUADRATIC] * np.sqrt(dot(v, v)), v)
    if switches[BODY_VELOCITY] > 0.0:
        moved = add(moved, cross(times(rotation, omega), v))
    torque = scaled_add(body_torque(rotation, load), -constants[19], cross(omega, times(inertia, omega)))
    spun = scaled_add(times(inverse, torque), -constants[21], omega)
    if switches[DRAG_ENERGY] > 0.0:
        spun = scaled_add(spun, switches[DRAG_ENERGY], _dragging(omega, inertia, inverse, constants[22]))
    turn = (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2])
    turned = quaternion_times(turn, q) if switches[WORLD_OMEGA] > 0.0 else quaternion_times(q, turn)
    return moved, spun, turned


@kernel
def _advanced(q: Quat, s: float, rate: Quat) -> Quat:
    """q + s q'."""
    return q[0] + s * rate[0], q[1] + s * rate[1], q[2] + s * rate[2], q[3] + s * rate[3]


@kernel
def _normalised(q: Quat) -> Quat:
    """q / |q|."""
    size = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / size, q[1] / size, q[2] / size, q[3] / size


@kernel
def _rotated(q: Quat, omega: Vec, dt: float, switches: Array) -> Quat:
    """q exp(h omega)."""
    angle = dt * np.sqrt(dot(omega, omega))
    share = dt
    if switches[ANGLE] > 0.0 and angle > switches[ANGLE]:
        share = dt * switches[ANGLE] / angle
    if switches[ADDITIVE] > 0.0:
        half = (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2])
        return _advanced(q, share, quaternion_times(q, half))
    by = quaternion_exp((share * omega[0], share * omega[1], share * omega[2]))
    return quaternion_times(by, q) if switches[WORLD_OMEGA] > 0.0 else quaternion_times(q, by)


@kernel
def _clamped(v: Vec, limit: float) -> Vec:
    return (
        min(max(v[0], -limit), limit),
        min(max(v[1], -limit), limit),
        min(max(v[2], -limit), limit),
    )


@kernel
def advance(
    state: Array, load: Array, constants: Array, switches: Array, dt: float, steps: int, order: int
) -> None:
    """Make the steps in place, by Runge-Kutta 4 if order is 4, else by M1."""
    x, v, w = vector_at(state, 0), vector_at(state, 3), vector_at(state, 6)
    q = (state[9], state[10], state[11], state[12])
    half, sixth = 0.5 * dt, dt / 6.0
    for _ in range(steps):
        if dot(v, v) < switches[ASLEEP] ** 2 and dot(w, w) < switches[ASLEEP] ** 2:
            continue
        old, old_w, old_q = v, w, q
        a1, b1, c1 = _rates(v, w, q, load, constants, switches)
        if order == 4:
            v2, w2, q2 = scaled_add(v, half, a1), scaled_add(w, half, b1), _advanced(q, half, c1)
            a2, b2, c2 = _rates(v2, w2, q2, load, constants, switches)
            v3, w3, q3 = scaled_add(v, half, a2), scaled_add(w, half, b2), _advanced(q, half, c2)
            a3, b3, c3 = _rates(v3, w3, q3, load, constants, switches)
            v4, w4, q4 = scaled_add(v, dt, a3), scaled_add(w, dt, b3), _advanced(q, dt, c3)
            a4, b4, c4 = _rates(v4, w4, q4, load, constants, switches)
            mean = scaled_add(scaled_add((0.0, 0.0, 0.0), 1.0 / 6.0, add(v, v4)), 1.0 / 3.0, add(v2, v3))
            v = scaled_add(v, sixth, scaled_add(add(a1, a4), 2.0, add(a2, a3)))
            w = scaled_add(w, sixth, scaled_add(add(b1, b4), 2.0, add(b2, b3)))
            q = _advanced(q, sixth, _advanced(_advanced(c1, 1.0, c4), 2.0, _advanced(c2, 1.0, c3)))
            if switches[ANGLE] > 0.0 and dt * np.sqrt(dot(old_w, old_w)) > switches[ANGLE]:
                q = _rotated(old_q, old_w, dt, switches)
        else:
            v, w = scaled_add(v, dt, a1), scaled_add(w, dt, b1)
            mean = v
            q = _rotated(q, w, dt, switches)
        x = scaled_add(x, dt, old if switches[OLD_VELOCITY] > 0.0 else mean)
        if switches[NORMALISED] > 0.0:
            q = _normalised(q)
        if switches[CLAMP] > 0.0:
            w = _clamped(w, switches[CLAMP])
        if switches[SPEED_CLAMP] > 0.0:
            v = _clamped(v, switches[SPEED_CLAMP])
    store(state, 0, x)
    store(state, 3, v)
    store(state, 6, w)
    state[9], state[10], state[11], state[12] = q
