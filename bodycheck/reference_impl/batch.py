"""Step many free bodies at once, each with its principal moments and an optional torque in body axes.

The state is one array (13, n) with one row per quantity, so that one instruction steps several bodies. A
block of bodies makes all its steps before the next block is fetched from memory. The kernels release the GIL,
so several threads may call `advance_batch` at the same time, each with a batch of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.dop853 import A, B, RotationState, combined, plus
from bodycheck.reference_impl.kernels.jit import inlined_kernel, kernel, long_kernel

BatchMethod: TypeAlias = Literal["m1", "rk4", "dop853"]
_Six: TypeAlias = tuple[float, float, float, float, float, float]

WIDTH = 64
"""Bodies per block. A block takes 7 kB and fits into a first-level cache."""

# A block is one array: the compiler sees that its rows do not overlap only if their offsets are constants.
_Q, _HALF_SPIN, _ABOUT, _ROWS = 0, 4, 7, 13  # rows: q, omega / 2, the constants `about` of `_rates`
_LINE = 64  # bytes
_SERIES = 0.25  # of (h |omega| / 2)^2: up to it, the series below have all bits of the sine and the cosine


@inlined_kernel
def _rates(y: RotationState, about: _Six) -> RotationState:
    """q' = q s; s_1' = 2 (J2 - J3) / J1 s_2 s_3 + tau_1 / (2 J1) and cyclic permutations, s = omega / 2.

    about: the three factors of the products, then the three accelerations due to the torque.
    """
    a, b, c = y[4], y[5], y[6]
    return (
        -y[1] * a - y[2] * b - y[3] * c,
        y[0] * a + y[2] * c - y[3] * b,
        y[0] * b + y[3] * a - y[1] * c,
        y[0] * c + y[1] * b - y[2] * a,
        about[0] * (b * c) + about[3],
        about[1] * (c * a) + about[4],
        about[2] * (a * b) + about[5],
    )


@inlined_kernel
def _rk4_step(y: RotationState, h: float, about: _Six) -> RotationState:
    """y + h/6 (k1 + 2 k2 + 2 k3 + k4)."""
    k1 = _rates(y, about)
    k2 = _rates(plus(y, 0.5 * h, k1), about)
    k3 = _rates(plus(y, 0.5 * h, k2), about)
    k4 = _rates(plus(y, h, k3), about)
    return combined(y, h / 6.0, (1.0, 2.0, 2.0, 1.0), (k1, k2, k3, k4))


@inlined_kernel
def _dop853_step(y: RotationState, h: float, about: _Six) -> RotationState:
    """y + h sum b_i k_i over the twelve stages."""
    k1 = _rates(y, about)
    k2 = _rates(combined(y, h, A[2], (k1,)), about)
    k3 = _rates(combined(y, h, A[3], (k1, k2)), about)
    k4 = _rates(combined(y, h, A[4], (k1, k3)), about)
    k5 = _rates(combined(y, h, A[5], (k1, k3, k4)), about)
    k6 = _rates(combined(y, h, A[6], (k1, k4, k5)), about)
    k7 = _rates(combined(y, h, A[7], (k1, k4, k5, k6)), about)
    k8 = _rates(combined(y, h, A[8], (k1, k4, k5, k6, k7)), about)
    k9 = _rates(combined(y, h, A[9], (k1, k4, k5, k6, k7, k8)), about)
    k10 = _rates(combined(y, h, A[10], (k1, k4, k5, k6, k7, k8, k9)), about)
    k11 = _rates(combined(y, h, A[11], (k1, k4, k5, k6, k7, k8, k9, k10)), about)
    k12 = _rates(combined(y, h, A[12], (k1, k4, k5, k6, k7, k8, k9, k10, k11)), about)
    return combined(y, h, B, (k1, k6, k7, k8, k9, k10, k11, k12))


@inlined_kernel
def _cosine(y: float) -> float:
    """cos sqrt(y) by its Taylor series, for 0 <= y <= 1/4."""
    high = 1.0 / 40320.0 - y * (1.0 / 3628800.0 - y * (1.0 / 479001600.0 - y * (1.0 / 87178291200.0)))
    return 1.0 - y * (0.5 - y * (1.0 / 24.0 - y * (1.0 / 720.0 - y * high)))


@inlined_kernel
def _sine_over_angle(y: float) -> float:
    """sin sqrt(y) / sqrt(y) by its Taylor series, for 0 <= y <= 1/4."""
    high = 1.0 / 362880.0 - y * (1.0 / 39916800.0 - y * (1.0 / 6227020800.0 - y * (1.0 / 1307674368000.0)))
    return 1.0 - y * (1.0 / 6.0 - y * (1.0 / 120.0 - y * (1.0 / 5040.0 - y * high)))


@inlined_kernel
def _accelerated(y: RotationState, h: float, about: _Six) -> tuple[float, float, float]:
    """s + h s', s = omega / 2, as `_rates` has s'."""
    a, b, c = y[4], y[5], y[6]
    return (
        a + h * (about[0] * (b * c) + about[3]),
        b + h * (about[1] * (c * a) + about[4]),
        c + h * (about[2] * (a * b) + about[5]),
    )


@inlined_kernel
def _rotated(y: RotationState, h: float, cosine: float, ratio: float) -> RotationState:
    """q exp(h s), with cosine = cos(h |s|) and ratio = sin(h |s|) / (h |s|)."""
    a, b, c = h * ratio * y[4], h * ratio * y[5], h * ratio * y[6]
    return (
        y[0] * cosine - y[1] * a - y[2] * b - y[3] * c,
        y[1] * cosine + y[0] * a + y[2] * c - y[3] * b,
        y[2] * cosine + y[0] * b + y[3] * a - y[1] * c,
        y[3] * cosine + y[0] * c + y[1] * b - y[2] * a,
        y[4],
        y[5],
        y[6],
    )


@inlined_kernel
def _lane(block: Array, i: int) -> tuple[RotationState, _Six]:
    """Return q and omega / 2 of body i of a block, and the six constants of its motion."""
    at = _ABOUT * WIDTH + i
    return (
        (
            block[i],
            block[WIDTH + i],
            block[2 * WIDTH + i],
            block[3 * WIDTH + i],
            block[4 * WIDTH + i],
            block[5 * WIDTH + i],
            block[6 * WIDTH + i],
        ),
        (
            block[at],
            block[at + WIDTH],
            block[at + 2 * WIDTH],
            block[at + 3 * WIDTH],
            block[at + 4 * WIDTH],
            block[at + 5 * WIDTH],
        ),
    )


@inlined_kernel
def _store_lane(block: Array, i: int, y: RotationState) -> None:
    """Write q and omega / 2 of body i."""
    block[i], block[WIDTH + i], block[2 * WIDTH + i], block[3 * WIDTH + i] = y[0], y[1], y[2], y[3]
    block[4 * WIDTH + i], block[5 * WIDTH + i], block[6 * WIDTH + i] = y[4], y[5], y[6]


@kernel
def _m1_block(block: Array, dt: float, steps: int) -> None:
    """Make all steps of a block by map M1; only a body that rotates far in one step leaves the fast loops."""
    cosines, ratios, squares = np.empty(WIDTH), np.empty(WIDTH), np.empty(WIDTH)
    for _ in range(steps):
        largest = 0.0
        for i in range(WIDTH):
            y, about = _lane(block, i)
            a, b, c = _accelerated(y, dt, about)
            block[_HALF_SPIN * WIDTH + i] = a
            block[(_HALF_SPIN + 1) * WIDTH + i] = b
            block[(_HALF_SPIN + 2) * WIDTH + i] = c
            square = dt * dt * (a * a + b * b + c * c)
            squares[i], cosines[i], ratios[i] = square, _cosine(square), _sine_over_angle(square)
            largest = max(largest, square)
        if not largest <= _SERIES:
            for i in range(WIDTH):
                if not squares[i] <= _SERIES:
                    angle = math.sqrt(squares[i])
                    cosines[i], ratios[i] = math.cos(angle), math.sin(angle) / angle
        for i in range(WIDTH):
            y, about = _lane(block, i)
            _store_lane(block, i, _rotated(y, dt, cosines[i], ratios[i]))


@kernel
def _rk4_block(block: Array, dt: float, steps: int) -> None:
    """Make all steps of a block by the classical Runge-Kutta method."""
    for _ in range(steps):
        for i in range(WIDTH):
            y, about = _lane(block, i)
            _store_lane(block, i, _rk4_step(y, dt, about))


@kernel
def _dop853_block(block: Array, dt: float, steps: int) -> None:
    """Make all steps of a block by the method of Dormand and Prince."""
    for _ in range(steps):
        for i in range(WIDTH):
            y, about = _lane(block, i)
            _store_lane(block, i, _dop853_step(y, dt, about))


@kernel
def _gathered(state: Array, moments: Array, torque: Array, begin: int) -> Array:
    """Return q, omega / 2 and the six constants of the bodies from `begin` on, row by row: (13 WIDTH,).

    Copies of the last body pad the block, so that every loop over a block has the same known length.
    """
    buffer = np.empty(_ROWS * WIDTH + _LINE // 8)
    first = -buffer.ctypes.data % _LINE // 8  # accesses that straddle two cache lines are slow
    block = buffer[first : first + _ROWS * WIDTH]
    last = state.shape[1] - 1
    for i in range(WIDTH):
        j = min(begin + i, last)
        for k in range(4):
            block[(_Q + k) * WIDTH + i] = state[9 + k, j]
        for k in range(3):
            own, next_, other = moments[k, j], moments[(k + 1) % 3, j], moments[(k + 2) % 3, j]
            block[(_HALF_SPIN + k) * WIDTH + i] = 0.5 * state[6 + k, j]
            block[(_ABOUT + k) * WIDTH + i] = 2.0 * ((next_ - other) / own)
            block[(_ABOUT + 3 + k) * WIDTH + i] = 0.5 * (torque[k, j] / own)
    return block


@kernel
def _scatter(block: Array, state: Array, begin: int, duration: float) -> None:
    """Write a block back and move its bodies by v times the duration."""
    for i in range(min(WIDTH, state.shape[1] - begin)):
        j = begin + i
        for k in range(4):
            state[9 + k, j] = block[(_Q + k) * WIDTH + i]
        for k in range(3):
            state[6 + k, j] = 2.0 * block[(_HALF_SPIN + k) * WIDTH + i]
            state[k, j] += duration * state[3 + k, j]


@long_kernel
def _advance_m1(state: Array, moments: Array, torque: Array, dt: float, steps: int) -> None:
    """Make the steps in place, block by block."""
    for begin in range(0, state.shape[1], WIDTH):
        block = _gathered(state, moments, torque, begin)
        _m1_block(block, dt, steps)
        _scatter(block, state, begin, dt * steps)


@long_kernel
def _advance_rk4(state: Array, moments: Array, torque: Array, dt: float, steps: int) -> None:
    """Make the steps in place, block by block."""
    for begin in range(0, state.shape[1], WIDTH):
        block = _gathered(state, moments, torque, begin)
        _rk4_block(block, dt, steps)
        _scatter(block, state, begin, dt * steps)


@long_kernel
def _advance_dop853(state: Array, moments: Array, torque: Array, dt: float, steps: int) -> None:
    """Make the steps in place, block by block."""
    for begin in range(0, state.shape[1], WIDTH):
        block = _gathered(state, moments, torque, begin)
        _dop853_block(block, dt, steps)
        _scatter(block, state, begin, dt * steps)


_ADVANCE: dict[BatchMethod, Callable[[Array, Array, Array, float, int], None]] = {
    "m1": _advance_m1,
    "rk4": _advance_rk4,
    "dop853": _advance_dop853,
}


def advance_batch(
    state: Array, moments: Array, torque: Array, dt: float, steps: int, method: BatchMethod
) -> None:
    """Make `steps` steps of dt seconds for n bodies, in place.

    state (13, n), C-contiguous doubles: position and velocity in world axes, omega in body axes,
    quaternion (w, x, y, z); each column is laid out as in the single-body kernels. Body axes are principal
    axes. Quaternions are not renormalised. moments (3, n): the principal moments, kg m^2. torque (3, n):
    constant in body axes, N m. method: "m1", the map of most engines, of order 1; "rk4", the classical
    Runge-Kutta method of order 4; "dop853", that of Dormand and Prince of order 8
    (integrators/explicit_gyro.py, rk4.py, dop853.py), whose steps these equal up to the order of the sums:
    some 16 ulp per step. Nothing is checked: a state that diverged may go on.
    """
    _ADVANCE[method](state, moments, torque, dt, steps)
