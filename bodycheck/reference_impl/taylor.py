"""Taylor-series integration of one rigid body under a constant wrench, with dense output.

The series of q, omega, v and x come from recurrences (automatic differentiation of the equations of
motion); the step follows from the last two coefficients and is cut to a short mantissa, so that time
is exact and rounding has no preferred sign. Sources: Jorba and Zou (2005), Experimental Mathematics
14, 99, sections 3.2 and 3.3; Biscani and Izzo (2021), MNRAS 504, 2614.
"""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import kernel

_Q, _OMEGA, _V, _X, _STATE = 0, 4, 7, 10, 13


@kernel
def _convolution(series: Array, i: int, j: int, k: int) -> float:
    """sum over n of series[i, n] series[j, k - n]."""
    total = 0.0
    for n in range(k + 1):
        total += series[i, n] * series[j, k - n]
    return total


@kernel
def _rotation_coefficient(series: Array, k: int, r: Array) -> None:
    """The k-th coefficient of R(q), quadratic in q, into r (9,)."""
    ww, xx = _convolution(series, 0, 0, k), _convolution(series, 1, 1, k)
    yy, zz = _convolution(series, 2, 2, k), _convolution(series, 3, 3, k)
    xy, wz = _convolution(series, 1, 2, k), _convolution(series, 0, 3, k)
    xz, wy = _convolution(series, 1, 3, k), _convolution(series, 0, 2, k)
    yz, wx = _convolution(series, 2, 3, k), _convolution(series, 0, 1, k)
    r[0], r[1], r[2] = ww + xx - yy - zz, 2.0 * (xy - wz), 2.0 * (xz + wy)
    r[3], r[4], r[5] = 2.0 * (xy + wz), ww - xx + yy - zz, 2.0 * (yz - wx)
    r[6], r[7], r[8] = 2.0 * (xz - wy), 2.0 * (yz + wx), ww - xx - yy + zz


@kernel
def _expand(
    series: Array, momentum: Array, body: Array, load: Array, order: int, turns_loads: bool, r: Array
) -> None:
    """Fill series (13, order + 1) from its first column, and momentum (3, order) with I omega.

    turns_loads tells whether any load has to be turned between body and world axes.
    """
    torque, force = np.zeros(3), np.zeros(3)
    for k in range(order):
        for a in range(3):
            force[a] = load[3 + a] if k == 0 else 0.0
            torque[a] = load[6 + a] if k == 0 else 0.0
            momentum[a, k] = (
                body[1 + 3 * a] * series[4, k]
                + body[2 + 3 * a] * series[5, k]
                + body[3 + 3 * a] * series[6, k]
            )
        if turns_loads:
            _rotation_coefficient(series, k, r)
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                for d in range(3):
                    force[a] += r[3 * a + d] * load[d]
                    torque[a] += r[3 * d + a] * load[9 + d]
                    torque[a] += load[12 + 3 * b + d] * r[3 * d + c] - load[12 + 3 * c + d] * r[3 * d + b]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            for n in range(k + 1):
                torque[a] -= series[_OMEGA + b, n] * momentum[c, k - n]
                torque[a] += series[_OMEGA + c, n] * momentum[b, k - n]
        next_order = 1.0 / (k + 1)
        for a in range(3):
            series[_OMEGA + a, k + 1] = next_order * (
                body[10 + 3 * a] * torque[0] + body[11 + 3 * a] * torque[1] + body[12 + 3 * a] * torque[2]
            )
            series[_V + a, k + 1] = next_order * force[a] / body[0]
            series[_X + a, k + 1] = next_order * series[_V + a, k]
        half = 0.5 * next_order
        w = x = y = z = 0.0
        for n in range(k + 1):
            qw, qx, qy, qz = series[0, n], series[1, n], series[2, n], series[3, n]
            ox, oy, oz = series[4, k - n], series[5, k - n], series[6, k - n]
            w -= qx * ox + qy * oy + qz * oz
            x += qw * ox + qy * oz - qz * oy
            y += qw * oy + qz * ox - qx * oz
            z += qw * oz + qx * oy - qy * ox
        series[0, k + 1], series[1, k + 1] = half * w, half * x
        series[2, k + 1], series[3, k + 1] = half * y, half * z


@kernel
def _step_size(series: Array, order: int, tolerance: float) -> float:
    """The step at which the last two terms of q and omega reach the tolerance, to 6 bits."""
    # omega may pass through 0 while its rate does not: then the rate sets the scale
    omega_scale = 0.0
    for i in range(_OMEGA, _V):
        omega_scale = max(omega_scale, abs(series[i, 0]), math.sqrt(abs(series[i, 1])))
    step = math.inf
    for k in (order - 1, order):
        largest = 0.0
        for i in range(_OMEGA):
            largest = max(largest, abs(series[i, k]))
        if omega_scale > 0.0:
            for i in range(_OMEGA, _V):
                largest = max(largest, abs(series[i, k]) / omega_scale)
        if largest > 0.0:
            step = min(step, (tolerance / largest) ** (1.0 / k))
    if step == math.inf:
        return step
    mantissa, exponent = math.frexp(step)
    return math.ldexp(math.floor(mantissa * 64.0) / 64.0, exponent)


@kernel
def _evaluate(series: Array, order: int, h: float, out: Array) -> None:
    """series(h) - series(0) by Horner's rule into out (13,)."""
    for i in range(_STATE):
        total = series[i, order]
        for k in range(order - 1, 0, -1):
            total = total * h + series[i, k]
        out[i] = total * h


@kernel
def integrate_taylor(
    state: Array, body: Array, load: Array, times: Array, end: float, order: int, tolerance: float
) -> tuple[Array, int]:
    """The states at times (n,) within [0, end], ascending, and the number of steps; state ends at `end`.

    state (13,) holds q, omega_body, v, x at time 0 and is moved to time `end` in place. body (19,) and
    load (21,) are packed as in equations.py. Returns ((n, 13), steps).
    """
    series, momentum = np.zeros((_STATE, order + 1)), np.zeros((3, order))
    change, lost, r = np.zeros(_STATE), np.zeros(_STATE), np.zeros(9)
    turns_loads = np.any(load[0:3] != 0.0) or np.any(load[9:21] != 0.0)
    out = np.empty((len(times), _STATE))
    t, due, steps = 0.0, 0, 0
    while due < len(times) and times[due] == 0.0:
        out[due] = state
        due += 1
    while t < end:
        series[:, 0] = state
        _expand(series, momentum, body, load, order, turns_loads, r)
        h = _step_size(series, order, tolerance)
        if not h > 0.0:
            state[:] = np.nan
            out[due:] = np.nan
            return out, steps
        h = min(h, end - t)
        while due < len(times) and times[due] <= t + h:
            _evaluate(series, order, times[due] - t, change)
            for i in range(_STATE):
                out[due, i] = state[i] + (change[i] - lost[i])
            due += 1
        _evaluate(series, order, h, change)
        for i in range(_STATE):
            # Kahan's summation: what the sum cannot hold is handed to the next step
            addend = change[i] - lost[i]
            total = state[i] + addend
            lost[i] = (total - state[i]) - addend
            state[i] = total
        t += h
        steps += 1
    return out, steps
