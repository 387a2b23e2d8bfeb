"""The fast Taylor integrator: the rotation along the principal axes, in doubles.

The state is stored in two parts, so that summing the steps loses no precision, and steps end on a coarse
binary grid. The error is a few eps times the sensitivity of the motion; over a million steps energy, momentum
and |q| drift by about 1e-13. Springs, drag of the centre of mass and double-doubles need the general
recurrences of taylor_steps.py, which lists the sources.
"""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import simd4
from bodycheck.reference_impl.kernels.jit import borrowing_kernel, exact_kernel
from bodycheck.reference_impl.kernels.simd4 import Lanes
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Quat,
    matrix_of,
    quaternion_times,
    transposed_times,
)
from bodycheck.reference_impl.taylor.principal_terms import (
    COSINE,
    FACTS,
    FRAME,
    HAS_TORQUE_WORLD,
    IN_WORLD,
    LOAD_ROWS,
    LOADS,
    OMEGA,
    ORBIT_RATE,
    OSCILLATES,
    PARTNER,
    PHASE,
    PHASES,
    RATE,
    SINE,
    TORQUE_ROWS,
    TORQUE_WORLD,
    Q,
    U,
    expand,
    put_vector,
)
from bodycheck.reference_impl.taylor.taylor_steps import next_time

_LINE = 64  # bytes in a cache line


@borrowing_kernel
def _in_axes(to_world: Mat, x: Lanes) -> Lanes:
    """R^T x."""
    a, b, c, _ = simd4.unpacked(x)
    x0, x1, x2 = transposed_times(to_world, (a, b, c))
    return simd4.lanes(x0, x1, x2, 0.0)


@borrowing_kernel
def _start_load(series: Array, loads: Array, j: int, to_world: Mat, t: float) -> None:
    """Set the zeroth coefficients of a load at time t."""
    row = LOADS + LOAD_ROWS * j
    y, z = simd4.load(loads, j, COSINE), simd4.load(loads, j, SINE)
    in_world = simd4.lane_of(loads, j, PHASES, IN_WORLD) != 0.0
    if simd4.lane_of(loads, j, PHASES, OSCILLATES) != 0.0:
        angle = simd4.lane_of(loads, j, PHASES, RATE) * t + simd4.lane_of(loads, j, PHASES, PHASE)
        sine, cosine = math.sin(angle), math.cos(angle)
        partner = simd4.add_scaled(simd4.scaled(z, cosine), y, -sine)
        y = simd4.add_scaled(simd4.scaled(y, cosine), z, sine)
        put_vector(series, row + PARTNER, 0, _in_axes(to_world, partner) if in_world else partner)
    put_vector(series, row, 0, _in_axes(to_world, y) if in_world else y)


@borrowing_kernel
def _start_forcing(series: Array, body: Array, loads: Array, q: Lanes, t: float) -> None:
    """Set the zeroth coefficients of all quantities that the forcing depends on, at time t."""
    to_world = matrix_of(simd4.unpacked(q))
    if simd4.lane_of(body, 0, FACTS, HAS_TORQUE_WORLD) != 0.0:
        put_vector(series, TORQUE_ROWS, 0, _in_axes(to_world, simd4.load(body, 0, TORQUE_WORLD)))
    rate = simd4.lane_of(body, 0, FACTS, ORBIT_RATE)
    if rate != 0.0:
        sine, cosine = math.sin(rate * t), math.cos(rate * t)
        put_vector(series, U, 0, _in_axes(to_world, simd4.lanes(-sine, 0.0, -cosine, 0.0)))
        put_vector(series, U + PARTNER, 0, _in_axes(to_world, simd4.lanes(-cosine, 0.0, sine, 0.0)))
    for j in range(len(loads)):
        _start_load(series, loads, j, to_world, t)


@borrowing_kernel
def _largest(series: Array, row: int, k: int) -> float:
    """max |c_k| of a row; infinite if one is NaN."""
    a, b, c, d = simd4.unpacked(simd4.load(series, row, k))
    size = max(max(abs(a), abs(b)), max(abs(c), abs(d)))
    return size if not math.isnan(a + b + c + d) else math.inf


@borrowing_kernel
def _log2(x: float) -> float:
    """log2 x to 0.09, linear between powers of two: a step takes only the 1 / order-th power."""
    mantissa, exponent = math.frexp(x)
    return exponent + 2.0 * mantissa - 2.0


@borrowing_kernel
def _step_size(series: Array, tolerance: float) -> float:
    """The step at which the last two terms of q and omega reach the tolerance, as in taylor_steps."""
    order = series.shape[1] - 1
    allowed, spin = _log2(tolerance), _largest(series, OMEGA, 0)
    step = math.inf
    for k in (order - 1, order):
        q_size, rate = _largest(series, Q, k), _largest(series, OMEGA, k)
        if q_size > 0.0:
            step = min(step, (allowed - _log2(q_size)) / k)
        if rate > 0.0:
            margin = allowed - _log2(rate)
            reach = margin / (k + 1.0)
            if spin > 0.0:
                relative = (margin + _log2(spin)) / k
                if relative + _log2(spin) >= 0.0:
                    reach = relative
            step = min(step, reach)
    return 2.0**step


@borrowing_kernel
def _change(series: Array, row: int, h: float) -> Lanes:
    """series(h) - series(0) by Horner's rule."""
    order = series.shape[1] - 1
    total = simd4.load(series, row, order)
    for k in range(order - 1, 0, -1):
        total = simd4.add_scaled(simd4.load(series, row, k), total, h)
    return simd4.scaled(total, h)


@exact_kernel
def _added(high: Lanes, low: Lanes, change: Lanes) -> tuple[Lanes, Lanes]:
    """high + low + change, in two parts (sums of Knuth and Dekker)."""
    total = simd4.plus(high, change)
    virtual = simd4.minus(total, high)
    lost = simd4.plus(simd4.minus(high, simd4.minus(total, virtual)), simd4.minus(change, virtual))
    rest = simd4.plus(lost, low)
    high = simd4.plus(total, rest)
    return high, simd4.minus(rest, simd4.minus(high, total))


@borrowing_kernel
def _write(out: Array, row: int, body: Array, q: Lanes, omega: Lanes) -> None:
    """Write q and omega in body axes."""
    from_body: Quat = simd4.unpacked(simd4.load(body, 0, FRAME))
    a, b, c, _ = simd4.unpacked(omega)
    out[row, 0], out[row, 1], out[row, 2], out[row, 3] = quaternion_times(simd4.unpacked(q), from_body)
    out[row, 4], out[row, 5], out[row, 6] = transposed_times(matrix_of(from_body), (a, b, c))


@borrowing_kernel
def follow(
    state: Array,
    series: Array,
    body: Array,
    loads: Array | None,
    times: Array,
    due: int,
    begin: float,
    end: float,
    tolerance: float,
    out: Array,
) -> tuple[int, int]:
    """Advance the state from time begin to end; return the number of times written so far, and of steps.

    state (2, 2, 4): the high parts of q and omega along the principal axes, then the low parts. times (n,):
    ascending; those before index `due` are already written. q and omega_body are written to out, (n, 7) or
    wider, for times up to the end. The values are NaN from the point where the integration fails.
    """
    q, omega = simd4.load(state, 0, 0), simd4.load(state, 0, 1)
    q_low, omega_low = simd4.load(state, 1, 0), simd4.load(state, 1, 1)
    t, steps = begin, 0
    while due < len(times) and times[due] == begin:
        _write(out, due, body, q, omega)
        due += 1
    while t < end:
        simd4.store(series, Q, 0, q)
        put_vector(series, OMEGA, 0, omega)
        if loads is not None:
            _start_forcing(series, body, loads, q, t)
        expand(series, body, loads)
        after = next_time(t, _step_size(series, tolerance), end)
        if not after > t:
            q = simd4.lanes(math.nan, math.nan, math.nan, math.nan)
            omega = q
            for lost in range(due, len(times)):
                _write(out, lost, body, q, omega)
            due = len(times)
            break
        while due < len(times) and times[due] < after:
            h = times[due] - t
            q_then, _ = _added(q, q_low, _change(series, Q, h))
            omega_then, _ = _added(omega, omega_low, _change(series, OMEGA, h))
            _write(out, due, body, q_then, omega_then)
            due += 1
        q, q_low = _added(q, q_low, _change(series, Q, after - t))
        omega, omega_low = _added(omega, omega_low, _change(series, OMEGA, after - t))
        while due < len(times) and times[due] == after:
            _write(out, due, body, q, omega)
            due += 1
        t = after
        steps += 1
    simd4.store(state, 0, 0, q)
    simd4.store(state, 0, 1, omega)
    simd4.store(state, 1, 0, q_low)
    simd4.store(state, 1, 1, omega_low)
    return due, steps


def working_space(loads: Array | None, order: int) -> Array:
    """Return zeroed series for the loads, aligned to a cache line, because unaligned access is slow."""
    rows = TORQUE_ROWS if loads is None else LOADS + LOAD_ROWS * len(loads)
    size = rows * (order + 1) * 4
    buffer = np.zeros(size + _LINE // 8)
    first = -buffer.ctypes.data % _LINE // 8
    return buffer[first : first + size].reshape(rows, order + 1, 4)
