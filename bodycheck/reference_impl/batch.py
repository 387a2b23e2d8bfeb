"""Step many free bodies at once, each with its principal moments and an optional torque in body axes.

The state is one array (13, n) with one row per quantity, so that one instruction steps several bodies. A
block of bodies makes all its steps before the next block is fetched from memory. Numba's threads share the
blocks (numba.set_num_threads); the results do not depend on the number of threads. The kernels release the
GIL, so several threads may also call `advance_batch` at the same time, each with a batch of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
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
_FLAT = 1e-12  # relative: by how much rounding may raise a plate's largest moment above the sum of the others


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
def _advance_m1(
    state: Array, moments: Array, torque: Array, dt: float, steps: int, first: int, end: int
) -> None:
    """Make the steps in place, of the blocks from first to end."""
    for k in range(first, end):
        block = _gathered(state, moments, torque, k * WIDTH)
        _m1_block(block, dt, steps)
        _scatter(block, state, k * WIDTH, dt * steps)


@long_kernel
def _advance_rk4(
    state: Array, moments: Array, torque: Array, dt: float, steps: int, first: int, end: int
) -> None:
    """Make the steps in place, of the blocks from first to end."""
    for k in range(first, end):
        block = _gathered(state, moments, torque, k * WIDTH)
        _rk4_block(block, dt, steps)
        _scatter(block, state, k * WIDTH, dt * steps)


@long_kernel
def _advance_dop853(
    state: Array, moments: Array, torque: Array, dt: float, steps: int, first: int, end: int
) -> None:
    """Make the steps in place, of the blocks from first to end."""
    for k in range(first, end):
        block = _gathered(state, moments, torque, k * WIDTH)
        _dop853_block(block, dt, steps)
        _scatter(block, state, k * WIDTH, dt * steps)


_ADVANCE: dict[str, Callable[[Array, Array, Array, float, int, int, int], None]] = {
    "m1": _advance_m1,
    "rk4": _advance_rk4,
    "dop853": _advance_dop853,
}


def advance_batch(
    state: Array,
    moments: Array,
    dt: float,
    steps: int,
    method: BatchMethod = "rk4",
    torque: Array | None = None,
    threads: int | None = None,
) -> None:
    """Make `steps` steps of dt seconds for n bodies, in place.

    state (13, n), C-contiguous doubles: position and velocity in world axes, omega in body axes,
    quaternion (w, x, y, z); each column is laid out as in the single-body kernels. Body axes are principal
    axes. Quaternions are not renormalised. moments (3, n): the principal moments, kg m^2. torque (3, n):
    constant in body axes, N m; None for free bodies. method: "m1", the map of most engines, of order 1;
    "rk4", the classical Runge-Kutta method of order 4; "dop853", that of Dormand and Prince of order 8
    (integrators/explicit_gyro.py, rk4.py, dop853.py), whose steps these equal up to the order of the sums:
    some 16 ulp per step. threads: [default: numba.get_num_threads()].

    Raises ValueError, naming the value, for a state of another shape or dtype, numbers that are not finite,
    dt <= 0, steps < 0, an unknown method, and moments that no body can have.
    """
    if method not in _ADVANCE:
        raise ValueError(f"method must be one of {', '.join(_ADVANCE)}, got {method!r}")
    if not 0.0 < dt < math.inf:
        raise ValueError(f"dt must be a positive number of seconds, got {dt!r}")
    if steps != int(steps) or steps < 0:
        raise ValueError(f"steps must be a number of steps, 0 or more, got {steps!r}")
    if state.ndim != 2 or len(state) != 13:
        raise ValueError(f"state must have shape (13, n), got {state.shape}")
    if state.dtype != np.float64 or not state.flags.c_contiguous or not state.flags.writeable:
        raise ValueError(f"state must be writeable C-contiguous float64, got {state.dtype}, {state.strides}")
    n = state.shape[1]
    torques = _checked("torque", np.zeros((3, n)) if torque is None else torque, n)
    moments = _checked("moments", moments, n)
    _check_finite("state", state)
    _check_bodies(moments)
    advance_checked(state, moments, torques, float(dt), int(steps), method, threads or _threads())


def advance_checked(
    state: Array, moments: Array, torque: Array, dt: float, steps: int, method: BatchMethod, threads: int
) -> None:
    """Make the steps of `advance_batch`, which has checked its arguments; a state that diverged may go on."""
    blocks, advance = (state.shape[1] + WIDTH - 1) // WIDTH, _ADVANCE[method]
    threads = min(threads, blocks)
    if threads <= 1:
        advance(state, moments, torque, dt, steps, 0, blocks)
        return
    ends = [blocks * k // threads for k in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        done = [pool.submit(advance, state, moments, torque, dt, steps, *part) for part in pairwise(ends)]
        for one in done:
            one.result()


def _threads() -> int:
    import numba  # imported here: it takes a second

    return int(numba.get_num_threads())


def _checked(name: str, value: Array, n: int) -> Array:
    """Return a (3, n) array of finite numbers as C-contiguous doubles, or raise ValueError."""
    if np.shape(value) != (3, n):
        raise ValueError(f"{name} must have shape (3, {n}) as the state has, got {np.shape(value)}")
    array = np.ascontiguousarray(value, dtype=np.float64)
    _check_finite(name, array)
    return array


def _check_finite(name: str, array: Array) -> None:
    finite = np.isfinite(array)
    if not finite.all():
        row, body = (int(i) for i in np.argwhere(~finite)[0])
        raise ValueError(f"{name} must be finite, got {array[row, body]} in row {row} of body {body}")


def _check_bodies(moments: Array) -> None:
    """Check J > 0 and J1 + J2 >= J3 for each body, up to round-off for flat bodies."""
    largest = moments.max(axis=0)
    bad = (moments.min(axis=0) <= 0.0) | (moments.sum(axis=0) - largest < largest * (1.0 - _FLAT))
    if bad.any():
        body = int(np.argmax(bad))
        raise ValueError(f"no body has the principal moments {moments[:, body].tolist()} of body {body}")
