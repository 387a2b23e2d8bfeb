"""The Taylor coefficients of a rotation along the principal axes, four doubles at a time.

In principal axes, Euler's equations need three products of series instead of nine. A world vector in these
axes obeys y' = y x omega, which needs three rows instead of the nine of a rotation matrix. A row of four
doubles fills a register.

series (rows, order + 1, 4) has one row for q and three for each vector: the vector, and its components
shifted by one and by two. An oscillating vector is followed by its partner, a quarter period ahead.
body (1, BODY, 4) and loads (m, LOAD, 4) are packed by principal_frame.py; loads is None if no torque acts.
The constant torques in world axes are one vector. Its products are summed in the loop over those of omega,
because the changing trip count of a separate loop defeats branch prediction. Source: Jorba and Zou (2005),
Experimental Mathematics 14, 99, section 2.
"""

from __future__ import annotations

from typing import TypeAlias

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import simd4
from bodycheck.reference_impl.kernels.jit import borrowing_inline, borrowing_kernel
from bodycheck.reference_impl.kernels.simd4 import Lanes

Q, OMEGA, TORQUE_ROWS, U, LOADS = 0, 1, 4, 7, 13
"""First rows: q, omega, the constant torque in world axes, the direction down to the centre of the orbit with
its partner, the loads."""
_SHIFTED_ONCE, _SHIFTED_TWICE, PARTNER, LOAD_ROWS = 1, 2, 3, 6
"""Rows relative to the first of a vector: (y1, y2, y0), (y2, y0, y1), the partner; rows per load."""

# layout of the constants of a body: (I2 - I3) / I1 .., I^-1 tau, -3 n^2 (I2 - I3) / I1 .., the columns of
# -I^-1 C, the quaternion from body to principal axes, (has drag, n, has a constant torque in world axes),
# that torque in world axes, 1 / I
EULER, TORQUE, GRADIENT, DAMPING, FRAME, FACTS, TORQUE_WORLD, INVERSE, BODY = 0, 1, 2, 3, 6, 7, 8, 9, 10
DAMPED, ORBIT_RATE, HAS_TORQUE_WORLD = 0, 1, 2
# layout of the constants of a load: y = SINE sin(rate t + phase) + COSINE cos(rate t + phase), in world axes
# if IN_WORLD, else in principal axes; the columns of I^-1 tau / y; (rate, phase, IN_WORLD, OSCILLATES)
SINE, COSINE, ANGULAR, PHASES, LOAD = 0, 1, 2, 5, 6
RATE, PHASE, IN_WORLD, OSCILLATES = 0, 1, 2, 3


_Parts: TypeAlias = tuple[Lanes, Lanes, Lanes]


# ------------------------------------------------------------------------------------- products of series
#
# The newest coefficients are added last, so that the other terms can be computed in advance.


@borrowing_inline
def put_vector(series: Array, row: int, k: int, x: Lanes) -> None:
    """Set the k-th coefficients of a vector."""
    simd4.store(series, row, k, x)
    simd4.store(series, row + _SHIFTED_ONCE, k, simd4.rotated(x))
    simd4.store(series, row + _SHIFTED_TWICE, k, simd4.rotated(simd4.rotated(x)))


@borrowing_inline
def _add_square(total: Lanes, series: Array, row: int, n: int, m: int) -> Lanes:
    """Total + (y2 z3, y3 z1, y1 z2), y = y_n and z = y_m."""
    return simd4.add_product(
        total, simd4.load(series, row + _SHIFTED_ONCE, n), simd4.load(series, row + _SHIFTED_TWICE, m)
    )


@borrowing_inline
def _add_cross_omega(
    halves: tuple[Lanes, Lanes], series: Array, row: int, n: int, m: int
) -> tuple[Lanes, Lanes]:
    """Halves + the two halves of y_n x omega_m."""
    ahead, behind = simd4.load(series, row + _SHIFTED_ONCE, n), simd4.load(series, row + _SHIFTED_TWICE, n)
    return (
        simd4.add_product(halves[0], ahead, simd4.load(series, OMEGA + _SHIFTED_TWICE, m)),
        simd4.add_product(halves[1], behind, simd4.load(series, OMEGA + _SHIFTED_ONCE, m)),
    )


@borrowing_inline
def _cross_omega(series: Array, row: int, k: int) -> Lanes:
    """(y x omega)_k."""
    halves = (simd4.nothing(), simd4.nothing())
    for n in range(1, k + 1):
        halves = _add_cross_omega(halves, series, row, n, k - n)
    halves = _add_cross_omega(halves, series, row, 0, k)
    return simd4.minus(halves[0], halves[1])


@borrowing_inline
def _add_times_omega(parts: _Parts, series: Array, n: int, m: int) -> _Parts:
    """Parts + q_n times each component of omega_m."""
    q = simd4.load(series, Q, n)
    return (
        simd4.add_scaled(parts[0], q, simd4.lane_of(series, OMEGA, m, 0)),
        simd4.add_scaled(parts[1], q, simd4.lane_of(series, OMEGA, m, 1)),
        simd4.add_scaled(parts[2], q, simd4.lane_of(series, OMEGA, m, 2)),
    )


@borrowing_inline
def _quaternion_product(parts: _Parts, factor: float) -> Lanes:
    """Factor q (0, a, b, c), from the parts q a, q b, q c."""
    s = factor
    total = simd4.times(simd4.neighbours_swapped(parts[0]), simd4.lanes(-s, s, s, -s))
    total = simd4.add_product(total, simd4.halves_swapped(parts[1]), simd4.lanes(-s, -s, s, s))
    return simd4.add_product(total, simd4.backwards(parts[2]), simd4.lanes(-s, s, -s, s))


@borrowing_inline
def _add_columns(
    total: Lanes, constants: Array, i: int, first: int, series: Array, row: int, k: int
) -> Lanes:
    """Total + M y_k; the columns of M are the constants starting at first."""
    for column in range(3):
        y = simd4.lane_of(series, row, k, column)
        total = simd4.add_scaled(total, simd4.load(constants, i, first + column), y)
    return total


# --------------------------------------------------------------------------------- the equations of motion


@borrowing_inline
def _put_oscillation(series: Array, row: int, k: int, rate: float, share: float, y: Lanes, z: Lanes) -> None:
    """y' = (y given) + rate z, z' = (z given) - rate y: the coefficients k + 1 = 1 / share."""
    y = simd4.add_scaled(y, simd4.load(series, row + PARTNER, k), rate)
    z = simd4.add_scaled(z, simd4.load(series, row, k), -rate)
    put_vector(series, row, k + 1, simd4.scaled(y, share))
    put_vector(series, row + PARTNER, k + 1, simd4.scaled(z, share))


@borrowing_inline
def _gradient(series: Array, rate: float, k: int, share: float) -> Lanes:
    """(u2 u3, u3 u1, u1 u2)_k; extends u to k + 1: u' = u x omega + n z."""
    products = simd4.nothing()
    y = z = (products, products)
    for n in range(1, k + 1):
        products = _add_square(products, series, U, n, k - n)
        y = _add_cross_omega(y, series, U, n, k - n)
        z = _add_cross_omega(z, series, U + PARTNER, n, k - n)
    products = _add_square(products, series, U, 0, k)
    y = _add_cross_omega(y, series, U, 0, k)
    z = _add_cross_omega(z, series, U + PARTNER, 0, k)
    _put_oscillation(series, U, k, rate, share, simd4.minus(y[0], y[1]), simd4.minus(z[0], z[1]))
    return products


@borrowing_inline
def _add_load(total: Lanes, series: Array, loads: Array, j: int, k: int, share: float) -> Lanes:
    """Total + I^-1 tau_k of a load; extends its vectors to k + 1."""
    row = LOADS + LOAD_ROWS * j
    total = _add_columns(total, loads, j, ANGULAR, series, row, k)
    y = z = simd4.nothing()
    oscillates = simd4.lane_of(loads, j, PHASES, OSCILLATES) != 0.0
    if simd4.lane_of(loads, j, PHASES, IN_WORLD) != 0.0:
        y = _cross_omega(series, row, k)
        if oscillates:
            z = _cross_omega(series, row + PARTNER, k)
    if oscillates:
        _put_oscillation(series, row, k, simd4.lane_of(loads, j, PHASES, RATE), share, y, z)
    else:
        put_vector(series, row, k + 1, simd4.scaled(y, share))
    return total


@borrowing_inline
def _add_forcing(total: Lanes, series: Array, body: Array, loads: Array, k: int, share: float) -> Lanes:
    """Total + I^-1 torque_k; extends the vectors that it depends on to k + 1."""
    if k == 0:
        total = simd4.plus(total, simd4.load(body, 0, TORQUE))
    if simd4.lane_of(body, 0, FACTS, DAMPED) != 0.0:
        total = _add_columns(total, body, 0, DAMPING, series, OMEGA, k)
    orbit_rate = simd4.lane_of(body, 0, FACTS, ORBIT_RATE)
    if orbit_rate != 0.0:
        products = _gradient(series, orbit_rate, k, share)
        total = simd4.add_product(total, products, simd4.load(body, 0, GRADIENT))
    for j in range(len(loads)):
        total = _add_load(total, series, loads, j, k, share)
    return total


@borrowing_kernel
def expand(series: Array, body: Array, loads: Array | None) -> None:
    """Fill the coefficients 1 .. order of all rows, given the coefficients 0.

    I1 omega1' = (I2 - I3) omega2 omega3 + torque1, and cyclic permutations; q' = q omega / 2.
    """
    none, has_torque_world = simd4.nothing(), False
    if loads is not None:
        has_torque_world = simd4.lane_of(body, 0, FACTS, HAS_TORQUE_WORLD) != 0.0
    for k in range(series.shape[1] - 1):
        products, parts, torque_rate = none, (none, none, none), (none, none)
        if has_torque_world:
            for n in range(1, k + 1):
                products = _add_square(products, series, OMEGA, n, k - n)
                parts = _add_times_omega(parts, series, n, k - n)
                torque_rate = _add_cross_omega(torque_rate, series, TORQUE_ROWS, n, k - n)
            torque_rate = _add_cross_omega(torque_rate, series, TORQUE_ROWS, 0, k)
        else:
            for n in range(1, k + 1):
                products = _add_square(products, series, OMEGA, n, k - n)
                parts = _add_times_omega(parts, series, n, k - n)
        products = _add_square(products, series, OMEGA, 0, k)
        parts = _add_times_omega(parts, series, 0, k)
        share = 1.0 / (k + 1.0)
        rate = simd4.times(products, simd4.load(body, 0, EULER))
        if loads is not None:
            if has_torque_world:
                rate = simd4.add_product(
                    rate, simd4.load(series, TORQUE_ROWS, k), simd4.load(body, 0, INVERSE)
                )
                put_vector(
                    series,
                    TORQUE_ROWS,
                    k + 1,
                    simd4.scaled(simd4.minus(torque_rate[0], torque_rate[1]), share),
                )
            rate = _add_forcing(rate, series, body, loads, k, share)
        put_vector(series, OMEGA, k + 1, simd4.scaled(rate, share))
        simd4.store(series, Q, k + 1, _quaternion_product(parts, 0.5 * share))
