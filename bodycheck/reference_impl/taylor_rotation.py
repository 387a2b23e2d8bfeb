"""The Taylor integrator of a rotation in doubles, along the principal axes: the fast one.

There Euler's equations need three products of series instead of nine, a world vector seen from the body obeys
y' = y x omega, three rows instead of a rotation matrix's nine, and rows of four doubles fill a register. The
state is carried in two parts, so that adding the steps up loses nothing; steps end on a coarse binary grid.
Good to a few eps times the motion's sensitivity. Springs, drag of the centre of mass and double-doubles are
taylor.py's, whose recurrences are the general ones. Sources: as there.

series (rows, order + 1, 4) has a row for q, and three for each vector: itself, its components shifted by one
place and by two; a vector that swings is followed by its partner, a quarter period ahead. body (1, BODY, 4)
and loads (m, LOAD, 4) are packed by principal_forcing.py; loads is None where nothing turns the body.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl import lanes
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import borrowing_inline, borrowing_kernel, exact_kernel
from bodycheck.reference_impl.lanes import Lanes
from bodycheck.reference_impl.registers import Mat, Quat, matrix_of, quaternion_times, transposed_times
from bodycheck.reference_impl.taylor import next_time

Q, OMEGA, U, LOADS = 0, 1, 4, 10
"""Rows: q, omega, the way down to the orbit's centre and its partner, where those of the loads begin."""
_TURNED_ONCE, _TURNED_TWICE, _PARTNER, _LOAD_ROWS = 1, 2, 3, 6
"""Rows of a vector, counted from its first: (y1, y2, y0), (y2, y0, y1), the partner; those of a load."""

# what lies in a body's constants: (I2 - I3) / I1 .., I^-1 tau, -3 n^2 (I2 - I3) / I1 .., the columns of
# -I^-1 C, the quaternion from body to principal axes, (is there drag, n)
EULER, TORQUE, GRADIENT, DAMPING, FRAME, FACTS, BODY = 0, 1, 2, 3, 6, 7, 8
DAMPED, ORBIT_RATE = 0, 1
# and in a load's: y = SINE sin(rate t + phase) + COSINE cos(rate t + phase), in world axes if it turns and in
# principal ones if not; the columns of I^-1 tau / y; (rate, phase, does it turn, does it swing)
SINE, COSINE, ANGULAR, PHASES, LOAD = 0, 1, 2, 5, 6
RATE, PHASE, TURNS, SWINGS = 0, 1, 2, 3

_LINE = 64  # bytes

_Parts: TypeAlias = tuple[Lanes, Lanes, Lanes]


# ------------------------------------------------------------------------------------- products of series
#
# The newest coefficients are added last: what does not wait for them is worked out ahead.


@borrowing_inline
def _put_vector(series: Array, row: int, k: int, x: Lanes) -> None:
    """Set the k-th coefficients of a vector."""
    lanes.store(series, row, k, x)
    lanes.store(series, row + _TURNED_ONCE, k, lanes.rotated(x))
    lanes.store(series, row + _TURNED_TWICE, k, lanes.rotated(lanes.rotated(x)))


@borrowing_inline
def _add_square(total: Lanes, series: Array, row: int, n: int, m: int) -> Lanes:
    """(y2 z3, y3 z1, y1 z2) of y_n and z = y_m, added."""
    return lanes.add_product(
        total, lanes.load(series, row + _TURNED_ONCE, n), lanes.load(series, row + _TURNED_TWICE, m)
    )


@borrowing_inline
def _add_turned(halves: tuple[Lanes, Lanes], series: Array, row: int, n: int, m: int) -> tuple[Lanes, Lanes]:
    """The two halves of y_n x omega_m, added."""
    ahead, behind = lanes.load(series, row + _TURNED_ONCE, n), lanes.load(series, row + _TURNED_TWICE, n)
    return (
        lanes.add_product(halves[0], ahead, lanes.load(series, OMEGA + _TURNED_TWICE, m)),
        lanes.add_product(halves[1], behind, lanes.load(series, OMEGA + _TURNED_ONCE, m)),
    )


@borrowing_inline
def _turned(series: Array, row: int, k: int) -> Lanes:
    """(y x omega)_k."""
    halves = (lanes.nothing(), lanes.nothing())
    for n in range(1, k + 1):
        halves = _add_turned(halves, series, row, n, k - n)
    halves = _add_turned(halves, series, row, 0, k)
    return lanes.minus(halves[0], halves[1])


@borrowing_inline
def _add_times_omega(parts: _Parts, series: Array, n: int, m: int) -> _Parts:
    """q_n times each component of omega_m, added."""
    q = lanes.load(series, Q, n)
    return (
        lanes.add_scaled(parts[0], q, lanes.lane_of(series, OMEGA, m, 0)),
        lanes.add_scaled(parts[1], q, lanes.lane_of(series, OMEGA, m, 1)),
        lanes.add_scaled(parts[2], q, lanes.lane_of(series, OMEGA, m, 2)),
    )


@borrowing_inline
def _quaternion_product(parts: _Parts, factor: float) -> Lanes:
    """Factor q (0, a, b, c), of the parts q a, q b, q c."""
    s = factor
    total = lanes.times(lanes.neighbours_swapped(parts[0]), lanes.lanes(-s, s, s, -s))
    total = lanes.add_product(total, lanes.halves_swapped(parts[1]), lanes.lanes(-s, -s, s, s))
    return lanes.add_product(total, lanes.backwards(parts[2]), lanes.lanes(-s, s, -s, s))


@borrowing_inline
def _add_columns(
    total: Lanes, constants: Array, i: int, first: int, series: Array, row: int, k: int
) -> Lanes:
    """Total + M y_k, M's columns the constants from first on."""
    for column in range(3):
        y = lanes.lane_of(series, row, k, column)
        total = lanes.add_scaled(total, lanes.load(constants, i, first + column), y)
    return total


# --------------------------------------------------------------------------------- the equations of motion


@borrowing_inline
def _put_swing(series: Array, row: int, k: int, rate: float, share: float, y: Lanes, z: Lanes) -> None:
    """y' = (y given) + rate z, z' = (z given) - rate y: the coefficients k + 1 = 1 / share."""
    y = lanes.add_scaled(y, lanes.load(series, row + _PARTNER, k), rate)
    z = lanes.add_scaled(z, lanes.load(series, row, k), -rate)
    _put_vector(series, row, k + 1, lanes.scaled(y, share))
    _put_vector(series, row + _PARTNER, k + 1, lanes.scaled(z, share))


@borrowing_inline
def _gradient(series: Array, rate: float, k: int, share: float) -> Lanes:
    """(u2 u3, u3 u1, u1 u2)_k; moves u to k + 1: u' = u x omega + n z."""
    products = lanes.nothing()
    y = z = (products, products)
    for n in range(1, k + 1):
        products = _add_square(products, series, U, n, k - n)
        y = _add_turned(y, series, U, n, k - n)
        z = _add_turned(z, series, U + _PARTNER, n, k - n)
    products = _add_square(products, series, U, 0, k)
    y = _add_turned(y, series, U, 0, k)
    z = _add_turned(z, series, U + _PARTNER, 0, k)
    _put_swing(series, U, k, rate, share, lanes.minus(y[0], y[1]), lanes.minus(z[0], z[1]))
    return products


@borrowing_inline
def _add_load(total: Lanes, series: Array, loads: Array, j: int, k: int, share: float) -> Lanes:
    """Total + I^-1 tau_k of a load; moves its vectors to k + 1."""
    row = LOADS + _LOAD_ROWS * j
    total = _add_columns(total, loads, j, ANGULAR, series, row, k)
    y = z = lanes.nothing()
    swings = lanes.lane_of(loads, j, PHASES, SWINGS) != 0.0
    if lanes.lane_of(loads, j, PHASES, TURNS) != 0.0:
        y = _turned(series, row, k)
        if swings:
            z = _turned(series, row + _PARTNER, k)
    if swings:
        _put_swing(series, row, k, lanes.lane_of(loads, j, PHASES, RATE), share, y, z)
    else:
        _put_vector(series, row, k + 1, lanes.scaled(y, share))
    return total


@borrowing_inline
def _add_forcing(total: Lanes, series: Array, body: Array, loads: Array, k: int, share: float) -> Lanes:
    """Total + I^-1 torque_k; moves the vectors that it depends on to k + 1."""
    if k == 0:
        total = lanes.plus(total, lanes.load(body, 0, TORQUE))
    if lanes.lane_of(body, 0, FACTS, DAMPED) != 0.0:
        total = _add_columns(total, body, 0, DAMPING, series, OMEGA, k)
    orbit_rate = lanes.lane_of(body, 0, FACTS, ORBIT_RATE)
    if orbit_rate != 0.0:
        products = _gradient(series, orbit_rate, k, share)
        total = lanes.add_product(total, products, lanes.load(body, 0, GRADIENT))
    for j in range(len(loads)):
        total = _add_load(total, series, loads, j, k, share)
    return total


@borrowing_kernel
def _expand(series: Array, body: Array, loads: Array | None) -> None:
    """Fill the coefficients 1 .. order of all rows, the first being there.

    I1 omega1' = (I2 - I3) omega2 omega3 + torque1, and so on in turn; q' = q omega / 2.
    """
    none = lanes.nothing()
    for k in range(series.shape[1] - 1):
        products, parts = none, (none, none, none)
        for n in range(1, k + 1):
            products = _add_square(products, series, OMEGA, n, k - n)
            parts = _add_times_omega(parts, series, n, k - n)
        products = _add_square(products, series, OMEGA, 0, k)
        parts = _add_times_omega(parts, series, 0, k)
        share = 1.0 / (k + 1.0)
        rate = lanes.times(products, lanes.load(body, 0, EULER))
        if loads is not None:
            rate = _add_forcing(rate, series, body, loads, k, share)
        _put_vector(series, OMEGA, k + 1, lanes.scaled(rate, share))
        lanes.store(series, Q, k + 1, _quaternion_product(parts, 0.5 * share))


# ------------------------------------------------------------------------------------------------- a step


@borrowing_kernel
def _in_axes(to_world: Mat, x: Lanes) -> Lanes:
    """R^T x."""
    a, b, c, _ = lanes.unpacked(x)
    x0, x1, x2 = transposed_times(to_world, (a, b, c))
    return lanes.lanes(x0, x1, x2, 0.0)


@borrowing_kernel
def _start_load(series: Array, loads: Array, j: int, to_world: Mat, t: float) -> None:
    """Set a load's first coefficients at time t."""
    row = LOADS + _LOAD_ROWS * j
    y, z = lanes.load(loads, j, COSINE), lanes.load(loads, j, SINE)
    turns = lanes.lane_of(loads, j, PHASES, TURNS) != 0.0
    if lanes.lane_of(loads, j, PHASES, SWINGS) != 0.0:
        angle = lanes.lane_of(loads, j, PHASES, RATE) * t + lanes.lane_of(loads, j, PHASES, PHASE)
        sine, cosine = math.sin(angle), math.cos(angle)
        partner = lanes.add_scaled(lanes.scaled(z, cosine), y, -sine)
        y = lanes.add_scaled(lanes.scaled(y, cosine), z, sine)
        _put_vector(series, row + _PARTNER, 0, _in_axes(to_world, partner) if turns else partner)
    _put_vector(series, row, 0, _in_axes(to_world, y) if turns else y)


@borrowing_kernel
def _start_forcing(series: Array, body: Array, loads: Array, q: Lanes, t: float) -> None:
    """Set the first coefficients of all that the forcing depends on at time t."""
    to_world = matrix_of(lanes.unpacked(q))
    rate = lanes.lane_of(body, 0, FACTS, ORBIT_RATE)
    if rate != 0.0:
        sine, cosine = math.sin(rate * t), math.cos(rate * t)
        _put_vector(series, U, 0, _in_axes(to_world, lanes.lanes(-sine, 0.0, -cosine, 0.0)))
        _put_vector(series, U + _PARTNER, 0, _in_axes(to_world, lanes.lanes(-cosine, 0.0, sine, 0.0)))
    for j in range(len(loads)):
        _start_load(series, loads, j, to_world, t)


@borrowing_kernel
def _largest(series: Array, row: int, k: int) -> float:
    """max |c_k| of a row; infinite where one is NaN."""
    a, b, c, d = lanes.unpacked(lanes.load(series, row, k))
    size = max(max(abs(a), abs(b)), max(abs(c), abs(d)))
    return size if not math.isnan(a + b + c + d) else math.inf


@borrowing_kernel
def _log2(x: float) -> float:
    """log2 x to 0.09: between powers of two the mantissa stands for it; a step is its power 1 / order."""
    mantissa, exponent = math.frexp(x)
    return exponent + 2.0 * mantissa - 2.0


@borrowing_kernel
def _step_size(series: Array, tolerance: float) -> float:
    """The step at which the last two terms of q and omega reach the tolerance; the rule of taylor.py."""
    order = series.shape[1] - 1
    allowed, spin = _log2(tolerance), _largest(series, OMEGA, 0)
    step = math.inf
    for k in (order - 1, order):
        turned, rate = _largest(series, Q, k), _largest(series, OMEGA, k)
        if turned > 0.0:
            step = min(step, (allowed - _log2(turned)) / k)
        if rate > 0.0:
            wanted = allowed - _log2(rate)
            reach = wanted / (k + 1.0)
            if spin > 0.0:
                beside = (wanted + _log2(spin)) / k
                if beside + _log2(spin) >= 0.0:
                    reach = beside
            step = min(step, reach)
    return 2.0**step


@borrowing_kernel
def _change(series: Array, row: int, h: float) -> Lanes:
    """series(h) - series(0) by Horner's rule."""
    order = series.shape[1] - 1
    total = lanes.load(series, row, order)
    for k in range(order - 1, 0, -1):
        total = lanes.add_scaled(lanes.load(series, row, k), total, h)
    return lanes.scaled(total, h)


@exact_kernel
def _added(high: Lanes, low: Lanes, change: Lanes) -> tuple[Lanes, Lanes]:
    """high + low + change, in two parts (Knuth's and Dekker's sums)."""
    total = lanes.plus(high, change)
    seen = lanes.minus(total, high)
    lost = lanes.plus(lanes.minus(high, lanes.minus(total, seen)), lanes.minus(change, seen))
    rest = lanes.plus(lost, low)
    high = lanes.plus(total, rest)
    return high, lanes.minus(rest, lanes.minus(high, total))


@borrowing_kernel
def _write(out: Array, row: int, body: Array, q: Lanes, omega: Lanes) -> None:
    """Store q and omega along the body axes."""
    from_body: Quat = lanes.unpacked(lanes.load(body, 0, FRAME))
    a, b, c, _ = lanes.unpacked(omega)
    out[row, 0], out[row, 1], out[row, 2], out[row, 3] = quaternion_times(lanes.unpacked(q), from_body)
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
    """Move the state from time begin to end; return how many times are written now, and the steps made.

    state (2, 2, 4): high parts of q and of omega along the principal axes, low parts. times (n,), ascending,
    those before index `due` written; q and omega_body go into out (n, 7 at least), for times up to the end.
    NaN from where the motion cannot be followed on.
    """
    q, omega = lanes.load(state, 0, 0), lanes.load(state, 0, 1)
    q_low, omega_low = lanes.load(state, 1, 0), lanes.load(state, 1, 1)
    t, steps = begin, 0
    while due < len(times) and times[due] == begin:
        _write(out, due, body, q, omega)
        due += 1
    while t < end:
        lanes.store(series, Q, 0, q)
        _put_vector(series, OMEGA, 0, omega)
        if loads is not None:
            _start_forcing(series, body, loads, q, t)
        _expand(series, body, loads)
        after = next_time(t, _step_size(series, tolerance), end)
        if not after > t:
            q = lanes.lanes(math.nan, math.nan, math.nan, math.nan)
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
    lanes.store(state, 0, 0, q)
    lanes.store(state, 0, 1, omega)
    lanes.store(state, 1, 0, q_low)
    lanes.store(state, 1, 1, omega_low)
    return due, steps


def working_space(loads: Array | None, order: int) -> Array:
    """Return zeroed series for the loads, on the boundary of a cache line: what straddles one is slow."""
    rows = U if loads is None else LOADS + _LOAD_ROWS * len(loads)
    size = rows * (order + 1) * 4
    room = np.zeros(size + _LINE // 8)
    first = -room.ctypes.data % _LINE // 8
    return room[first : first + size].reshape(rows, order + 1, 4)
