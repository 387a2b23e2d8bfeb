"""The steps of the Taylor integrator of one rigid body, in doubles or double-doubles, with dense output.

The step size follows from the last two coefficients. Every step ends on a coarse binary grid, so that time is
exact and rounding is unbiased. The state is a double-double, so that summing the steps loses no precision.
Sources: Jorba and Zou (2005), Experimental Mathematics 14, 99, sections 3.2 and 3.3; Biscani
and Izzo (2021), MNRAS 504, 2614.
"""

from __future__ import annotations

import math
from typing import Any

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    as_pair,
    by_double,
    entry,
    exactly,
    high_part,
    is_paired,
    like,
    nothing,
    over_double,
    plus,
    put,
    term,
)
from bodycheck.reference_impl.kernels.jit import inlined_kernel, kernel, long_kernel, unspecialised_kernel
from bodycheck.reference_impl.taylor.forcing import ACCELERATION_WORLD, ORBIT_RATE, RADIUS
from bodycheck.reference_impl.taylor.recorded_terms import may_vanish, recorded_share, start_time
from bodycheck.reference_impl.taylor.spring_terms import (
    is_at_anchor,
    passes_anchor,
    passes_half_turn,
    springs_share,
    torsion_torque,
)
from bodycheck.reference_impl.taylor.taylor_terms import (
    OMEGA,
    ORBIT,
    SINES,
    STATE,
    V,
    X,
    acceleration,
    added,
    angular_rate,
    gradient_torque,
    moment_torque,
    own_torque,
    put_rate,
    rotated_acceleration,
    rotation_matrix,
    sine_torque,
    start_sine,
    vector_terms,
    world_torque,
)

LOST_AT_ANCHOR, LOST_AT_HALF_TURN, LOST_AT_ZERO = -1, -2, -3
"""Returned instead of the number of steps: a load is not smooth there."""

_HALF_TURN = 1e-3  # the cosine of half the angle, below which the angle counts as pi
_AT_ZERO = 2.0**-26  # of the time: closer to a zero of a formula the highest terms overflow
EPS = 2.0**-52
_GRID_BITS = 6  # a step ends on a multiple of about 2^-6 of its length
SMALLER = 1e14  # times the tolerance: for terms below this, rounding to doubles is far below the tolerance


@unspecialised_kernel
def _expand(
    series: Numbers,
    rotational: Numbers,
    damping: Numbers | None,
    body_sines: Array | None,
    world: Numbers,
    world_sines: Array | None,
    orbit: Numbers | None,
    translational: Numbers | None,
    springs: Array | None,
    torsion: Numbers | None,
    recorded: Array | None,
    rows: tuple[int, int, int, int],
    first: int,
    last: int,
) -> None:
    """Fill the coefficients first + 1 .. last of the rows of the state, given the earlier ones."""
    for k in range(first, last):
        share = over_double(exactly(series, 1.0), k + 1.0)
        torque = own_torque(series, rotational, damping, body_sines, k, share)
        rotation_matrix(series, k)
        torque = added(torque, added(world_torque(series, world, k), moment_torque(series, world, k)))
        if world_sines is not None:
            torque = added(torque, sine_torque(series, world_sines, rows[0], k))
        if orbit is not None:
            torque = added(torque, gradient_torque(series, rotational, orbit, k))
        if torsion is not None:
            torque = added(torque, torsion_torque(series, torsion, rows[2], k))
        if translational is not None:
            rate = acceleration(series, translational, k)
            rate = added(rate, rotated_acceleration(series, translational, k))
            if springs is not None:
                couple, push = springs_share(series, springs, translational, rows[1], k)
                torque, rate = added(torque, couple), added(rate, push)
            if recorded is not None:
                couple, push = recorded_share(series, recorded, translational, rows[3], k)
                torque, rate = added(torque, couple), added(rate, push)
            put_rate(series, V, k, rate, share)
            put_rate(series, X, k, vector_terms(series, V, k), share)
        angular_rate(series, rotational, torque, k, share)


@inlined_kernel
def _start_sines(series: Numbers, sines: Array, row: int, t: float) -> None:
    """Set the zeroth coefficients of the sines at time t."""
    for i in range(len(sines)):
        start_sine(series, row + 2 * i, exactly(series, sines[i, 3]), sines[i, 4], t)


@kernel
def _start(
    series: Numbers,
    state: tuple[Array, Array],
    body_sines: Array | None,
    world_sines: Array | None,
    orbit: Numbers | None,
    recorded: Array | None,
    rows: tuple[int, int, int, int],
    t: float,
) -> None:
    """Set the zeroth coefficients of the state and of the time-dependent loads at time t."""
    for i in range(STATE):
        put(series, i, 0, like(nothing(series), (state[0][i], state[1][i])))
    if body_sines is not None:
        _start_sines(series, body_sines, SINES, t)
    if world_sines is not None:
        _start_sines(series, world_sines, rows[0], t)
    if orbit is not None:
        start_sine(series, ORBIT, entry(orbit, ORBIT_RATE), 0.0, t)
    if recorded is not None:
        start_time(series, rows[3], t)


@unspecialised_kernel
def _largest(high: Array, first: int, last: int, k: int) -> float:
    """max |c_k| over the rows first .. last - 1; infinite if one is NaN."""
    largest = 0.0
    for i in range(first, last):
        size = abs(high[i, k])
        if not size <= math.inf:
            return math.inf
        largest = max(largest, size)
    return largest


@inlined_kernel
def reach(rate: float, start: float, k: int, tolerance: float) -> float:
    """The longer of the steps h at which |c_k| h^k = tolerance start, or |c_k| h^(k+1) = tolerance.

    At the first, the k-th term of a rate is small relative to its start value; at the second, its integral is
    small, because a rate may pass through 0. The first is longer if h start >= 1.
    """
    if rate == 0.0:
        return math.inf
    step = (tolerance * start / rate) ** (1.0 / k)
    if step * start < 1.0:
        step = (tolerance / rate) ** (1.0 / (k + 1))
    return step


@kernel
def _step_size(high: Array, order: int, tolerance: float, length: float) -> float:
    """The step at which the last two terms of q, omega and, if length > 0, v / length reach the tolerance."""
    step = math.inf
    spin, speed = _largest(high, OMEGA, V, 0), _largest(high, V, X, 0)
    for k in (order - 1, order):
        size = _largest(high, 0, OMEGA, k)
        if size != 0.0:
            step = min(step, (tolerance / size) ** (1.0 / k))
        step = min(step, reach(_largest(high, OMEGA, V, k), spin, k, tolerance))
        if length > 0.0:
            step = min(step, reach(_largest(high, V, X, k) / length, speed / length, k, tolerance))
    return step


@inlined_kernel
def next_time(t: float, step: float, end: float) -> float:
    """t + step, rounded down to a multiple of about step / 2^_GRID_BITS, or the end."""
    if not t + step < end:
        return end
    grid = math.ldexp(1.0, math.frexp(step)[1] - _GRID_BITS)
    return math.floor((t + step) / grid) * grid


@kernel
def _halved(t: float, after: float, end: float) -> float:
    """The time halfway to after, or t if no double lies between."""
    shorter = next_time(t, 0.5 * (after - t), end)
    return shorter if shorter < after else t


@kernel
def series_change(series: Numbers, i: int, order: int, h: float) -> Any:
    """series_i(h) - series_i(0) by Horner's rule."""
    total = term(series, i, order)
    for k in range(order - 1, 0, -1):
        total = plus(by_double(total, h), term(series, i, k))
    return by_double(total, h)


@inlined_kernel
def _advanced(state: tuple[Array, Array], i: int, change: Any) -> DoubleDouble:
    """state_i + change."""
    return dd.add((state[0][i], state[1][i]), as_pair(change))


@kernel
def _written(
    out: tuple[Array, Array], state: tuple[Array, Array], times: Array, due: int, last: float
) -> int:
    """Write the state at the times from index due up to the last; return the next index."""
    while due < len(times) and times[due] <= last:
        for i in range(STATE):
            out[0][due, i], out[1][due, i] = state[0][i], state[1][i]
        due += 1
    return due


@unspecialised_kernel
def _stepped(
    state: tuple[Array, Array],
    series: Numbers,
    rows: int,
    t: float,
    after: float,
    times: Array,
    due: int,
    out: tuple[Array, Array],
) -> int:
    """Advance these rows of the state to `after`, write it at the times before; return the next index."""
    order = high_part(series).shape[1] - 1
    while due < len(times) and times[due] < after:
        for i in range(rows):
            out[0][due, i], out[1][due, i] = _advanced(
                state, i, series_change(series, i, order, times[due] - t)
            )
        due += 1
    for i in range(rows):
        state[0][i], state[1][i] = _advanced(state, i, series_change(series, i, order, after - t))
    return due


@long_kernel
def integrate(
    state: tuple[Array, Array],
    series: Numbers,
    rotational: Numbers,
    damping: Numbers | None,
    body_sines: Array | None,
    world: Numbers,
    world_sines: Array | None,
    orbit: Numbers | None,
    translational: Numbers | None,
    springs: Array | None,
    torsion: Numbers | None,
    recorded: Array | None,
    rows: tuple[int, int, int, int],
    times: Array,
    begin: float,
    end: float,
    tolerance: float,
    paired_orders: int,
    max_steps: int,
    out: tuple[Array, Array],
) -> tuple[int, float]:
    """Advance the state from time begin to end, write it at the times into out; return steps and last time.

    After max_steps it returns early; the next call, from the returned time, continues bit for bit.

    state ((13,), (13,)): the high and low parts of q, omega_body, v, x; without `translational`, v and x
    are left unchanged. series (n, order + 1): workspace in the desired precision; rows: the first rows of the
    sines in world axes, the springs, the torsion spring and the recorded loads. Coefficients beyond the
    paired orders are computed in doubles, because they are small. times (n,): ascending, in [begin, end]. out
    ((n, 13), (n, 13)): NaN from the point where the integration fails. The result is then negative if the
    reason is known (LOST_AT_ANCHOR, LOST_AT_HALF_TURN, LOST_AT_ZERO).
    """
    high = high_part(series)
    order = high.shape[1] - 1
    full = min(paired_orders, order) if is_paired(series) else order
    last = STATE if translational is not None else V
    length = high_part(translational)[RADIUS] if translational is not None else 0.0
    t, due, steps = begin, _written(out, state, times, 0, begin), 0
    while t < end and steps < max_steps:
        _start(series, state, body_sines, world_sines, orbit, recorded, rows, t)
        _expand(
            series,
            rotational,
            damping,
            body_sines,
            world,
            world_sines,
            orbit,
            translational,
            springs,
            torsion,
            recorded,
            rows,
            0,
            full,
        )
        _expand(
            high,
            high_part(rotational),
            high_part(damping),
            body_sines,
            high_part(world),
            world_sines,
            high_part(orbit),
            high_part(translational),
            springs,
            high_part(torsion),
            recorded,
            rows,
            full,
            order,
        )
        step = _step_size(high, order, tolerance, length)
        if tolerance * SMALLER < EPS:
            step = min(step, _step_size(high, full, tolerance * SMALLER, length))
        after = next_time(t, step, end)
        if springs is not None:
            while after > t and passes_anchor(high, springs, rows[1], after - t):
                after = _halved(t, after, end)
        if torsion is not None:
            while after > t and passes_half_turn(high, rows[2], after - t):
                after = _halved(t, after, end)
        if recorded is not None:
            while after > t and may_vanish(high, recorded, rows[3], after - t, order):
                after = _halved(t, after, end)
        if not after > t:
            for i in range(last):  # beyond last, the centre of mass is integrated separately
                state[0][i] = math.nan
            _written(out, state, times, due, end)
            if springs is not None and is_at_anchor(high, springs, rows[1]):
                return LOST_AT_ANCHOR, end
            if torsion is not None and high[rows[2], 0] < _HALF_TURN:
                return LOST_AT_HALF_TURN, end
            if recorded is not None and may_vanish(high, recorded, rows[3], _AT_ZERO * t, 2):
                return LOST_AT_ZERO, end
            return steps, end
        due = _stepped(state, series, last, t, after, times, due, out)
        due = _written(out, state, times, due, after)
        t = after
        steps += 1
    return steps, t


@kernel
def follow_parabola(
    state: tuple[Array, Array],
    translational: Numbers,
    times: Array,
    begin: float,
    end: float,
    out: tuple[Array, Array],
) -> None:
    """v = v0 + a t, x = x0 + t (v0 + a t / 2): as `integrate`, for the centre of mass only.

    state and out are ((13,), (13,)) and ((n, 13), (n, 13)); times (n,) in s, ascending within (begin, end).
    """
    for due in range(len(times) + 1):
        t = dd.two_sum(times[due] if due < len(times) else end, -begin)
        for i in range(3):
            a = as_pair(entry(translational, ACCELERATION_WORLD + i))
            v, x = (state[0][V + i], state[1][V + i]), (state[0][X + i], state[1][X + i])
            gained = dd.multiply(a, t)
            displacement = dd.multiply(t, dd.add(v, dd.scale(gained, 0.5)))
            v, x = dd.add(v, gained), dd.add(x, displacement)
            if due < len(times):
                out[0][due, V + i], out[1][due, V + i] = v
                out[0][due, X + i], out[1][due, X + i] = x
            else:
                state[0][V + i], state[1][V + i] = v
                state[0][X + i], state[1][X + i] = x
