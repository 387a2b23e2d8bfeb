"""The Taylor coefficients of the motion, by the recurrences of the equations of motion.

series[i, k] is the k-th coefficient of the i-th quantity. Every product of two quantities is a sum over
n = 0..k of the n-th coefficient of one and the (k - n)-th of the other; a derivative is a factor k + 1.
The operations of generic_precision.py serve both doubles and double-doubles. Source: Jorba and Zou (2005),
A software package for the numerical integration of ODEs by means of high-order Taylor methods,
Experimental Mathematics 14, 99, section 2.
"""

from __future__ import annotations

from typing import Any

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    Three,
    add_product,
    by_double,
    entry,
    exactly,
    minus,
    nothing,
    over,
    over_double,
    phase,
    plus,
    put,
    renorm,
    sine_and_cosine,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import inlined_kernel, kernel
from bodycheck.reference_impl.taylor.forcing import (
    ACCELERATION_BODY,
    ACCELERATION_WORLD,
    DECAY,
    GRADIENT,
    INERTIA,
    INERTIA_INVERSE,
    MOMENT,
    ORBIT_RATE,
    TORQUE_BODY,
    TORQUE_WORLD,
)

Q, OMEGA, V, X, STATE = 0, 4, 7, 10, 13
"""Rows of the state: q, omega in body axes, v and x in world axes."""
L, R, T, U, IU, ORBIT, SINES = 13, 16, 25, 28, 31, 34, 36
"""Further rows: I omega, R, world torque, u and I u in body axes, sin and cos of n t, of each sine."""

# ----------------------------------------------------------------------------------- products of series


@kernel
def cauchy(series: Numbers, i: int, j: int, k: int) -> Any:
    """(a b)_k = sum of a_n b_(k-n), a and b in the rows i and j."""
    total = nothing(series)
    for n in range(k + 1):
        total = add_product(total, term(series, i, n), term(series, j, k - n))
    return renorm(total)


@kernel
def quotient(series: Numbers, i: int, j: int, row: int, k: int) -> Any:
    """f = a / b: f_k = (a_k - sum over n >= 1 of b_n f_(k-n)) / b_0; a, b and f in the rows i, j and row."""
    total = term(series, i, k)
    for n in range(1, k + 1):
        total = subtract_product(total, term(series, j, n), term(series, row, k - n))
    return over(renorm(total), term(series, j, 0))


@kernel
def _cross_product(series: Numbers, i: int, j: int, k: int) -> Three:
    """(a x b)_k, a and b in the rows starting at i and j."""
    x = y = z = nothing(series)
    for n in range(k + 1):
        a0, a1, a2 = term(series, i, n), term(series, i + 1, n), term(series, i + 2, n)
        b0, b1, b2 = term(series, j, k - n), term(series, j + 1, k - n), term(series, j + 2, k - n)
        x = subtract_product(add_product(x, a1, b2), a2, b1)
        y = subtract_product(add_product(y, a2, b0), a0, b2)
        z = subtract_product(add_product(z, a0, b1), a1, b0)
    return renorm(x), renorm(y), renorm(z)


@kernel
def rotated_to_body(series: Numbers, j: int, k: int) -> Three:
    """(R^T a)_k, a in the rows starting at j."""
    x = y = z = nothing(series)
    for n in range(k + 1):
        for row in range(3):
            a = term(series, j + row, k - n)
            x = add_product(x, term(series, R + 3 * row, n), a)
            y = add_product(y, term(series, R + 3 * row + 1, n), a)
            z = add_product(z, term(series, R + 3 * row + 2, n), a)
    return renorm(x), renorm(y), renorm(z)


@inlined_kernel
def row_times(numbers: Numbers, i: int, v: Three) -> Any:
    """m . v, m the three numbers starting at i."""
    total = add_product(nothing(numbers), entry(numbers, i), v[0])
    total = add_product(total, entry(numbers, i + 1), v[1])
    return renorm(add_product(total, entry(numbers, i + 2), v[2]))


@inlined_kernel
def matrix_times(numbers: Numbers, i: int, v: Three) -> Three:
    """M v, M the nine numbers starting at i."""
    return row_times(numbers, i, v), row_times(numbers, i + 3, v), row_times(numbers, i + 6, v)


@inlined_kernel
def vector_terms(series: Numbers, i: int, k: int) -> Three:
    """The k-th coefficients of the rows i, i + 1, i + 2."""
    return term(series, i, k), term(series, i + 1, k), term(series, i + 2, k)


@inlined_kernel
def put_vector(series: Numbers, i: int, k: int, v: Three) -> None:
    """Set the k-th coefficients of the rows i, i + 1, i + 2."""
    put(series, i, k, v[0])
    put(series, i + 1, k, v[1])
    put(series, i + 2, k, v[2])


@inlined_kernel
def added(a: Three, b: Three) -> Three:
    """a + b."""
    return plus(a[0], b[0]), plus(a[1], b[1]), plus(a[2], b[2])


@inlined_kernel
def subtracted(a: Three, b: Three) -> Three:
    """a - b."""
    return minus(a[0], b[0]), minus(a[1], b[1]), minus(a[2], b[2])


@inlined_kernel
def put_rate(series: Numbers, i: int, k: int, v: Three, share: Any) -> None:
    """a' = v: the coefficients k + 1 = 1 / share of the rows i, i + 1, i + 2."""
    put(series, i, k + 1, times(share, v[0]))
    put(series, i + 1, k + 1, times(share, v[1]))
    put(series, i + 2, k + 1, times(share, v[2]))


# --------------------------------------------------------------------------------------------- rotation


@kernel
def _spin(series: Numbers, k: int, share: Any) -> Three:
    """q' = q omega / 2, the coefficient k + 1 = 1 / share; return (I omega x omega)_k.

    Both sums use the coefficients of omega, in one loop, which is most of the cost of a free rotation.
    """
    w = x = y = z = tx = ty = tz = nothing(series)
    for n in range(k + 1):
        a, b, c = term(series, OMEGA, k - n), term(series, OMEGA + 1, k - n), term(series, OMEGA + 2, k - n)
        lx, ly, lz = term(series, L, n), term(series, L + 1, n), term(series, L + 2, n)
        tx = subtract_product(add_product(tx, ly, c), lz, b)
        ty = subtract_product(add_product(ty, lz, a), lx, c)
        tz = subtract_product(add_product(tz, lx, b), ly, a)
        qw, qx, qy, qz = term(series, 0, n), term(series, 1, n), term(series, 2, n), term(series, 3, n)
        w = subtract_product(subtract_product(subtract_product(w, qx, a), qy, b), qz, c)
        x = subtract_product(add_product(add_product(x, qw, a), qy, c), qz, b)
        y = subtract_product(add_product(add_product(y, qw, b), qz, a), qx, c)
        z = subtract_product(add_product(add_product(z, qw, c), qx, b), qy, a)
    half = by_double(share, 0.5)
    put(series, 0, k + 1, times(half, renorm(w)))
    put_vector(
        series,
        1,
        k + 1,
        (times(half, renorm(x)), times(half, renorm(y)), times(half, renorm(z))),
    )
    return renorm(tx), renorm(ty), renorm(tz)


@kernel
def own_torque(
    series: Numbers, rotational: Numbers, damping: Numbers | None, sines: Array | None, k: int, share: Any
) -> Three:
    """(tau - C omega + I omega x omega)_k, tau given in body axes; extends q and the sines to k + 1."""
    omega = vector_terms(series, OMEGA, k)
    put_vector(series, L, k, matrix_times(rotational, INERTIA, omega))
    torque = _spin(series, k, share)
    if damping is not None:
        torque = subtracted(torque, matrix_times(damping, 0, omega))
    if k == 0:
        constant = (
            entry(rotational, TORQUE_BODY),
            entry(rotational, TORQUE_BODY + 1),
            entry(rotational, TORQUE_BODY + 2),
        )
        torque = added(torque, constant)
    if sines is not None:
        torque = _added_sines(series, torque, sines, SINES, k)
    return torque


@kernel
def rotation_matrix(series: Numbers, k: int) -> None:
    """R_k, quadratic in q."""
    ww = xx = yy = zz = nothing(series)
    xy = xz = yz = wx = wy = wz = nothing(series)
    for n in range(k + 1):
        w, x, y, z = term(series, 0, n), term(series, 1, n), term(series, 2, n), term(series, 3, n)
        a, b = term(series, 0, k - n), term(series, 1, k - n)
        c, d = term(series, 2, k - n), term(series, 3, k - n)
        ww, xx = add_product(ww, w, a), add_product(xx, x, b)
        yy, zz = add_product(yy, y, c), add_product(zz, z, d)
        xy, xz, yz = add_product(xy, x, c), add_product(xz, x, d), add_product(yz, y, d)
        wx, wy, wz = add_product(wx, w, b), add_product(wy, w, c), add_product(wz, w, d)
    ww, xx, yy, zz = renorm(ww), renorm(xx), renorm(yy), renorm(zz)
    xy, xz, yz, wx, wy, wz = (
        renorm(xy),
        renorm(xz),
        renorm(yz),
        renorm(wx),
        renorm(wy),
        renorm(wz),
    )
    across, along = minus(ww, zz), minus(xx, yy)
    put(series, R, k, plus(across, along))
    put(series, R + 4, k, minus(across, along))
    put(series, R + 8, k, minus(plus(ww, zz), plus(xx, yy)))
    put(series, R + 1, k, by_double(minus(xy, wz), 2.0))
    put(series, R + 2, k, by_double(plus(xz, wy), 2.0))
    put(series, R + 3, k, by_double(plus(xy, wz), 2.0))
    put(series, R + 5, k, by_double(minus(yz, wx), 2.0))
    put(series, R + 6, k, by_double(minus(xz, wy), 2.0))
    put(series, R + 7, k, by_double(plus(yz, wx), 2.0))


# ----------------------------------------------------------------------------------- torques in world axes


@kernel
def moment_torque(series: Numbers, world: Numbers, k: int) -> Three:
    """tau_a = eps_abc (M R)_bc at order k, M = sum of at F^T over the world forces."""
    x = y = z = nothing(series)
    for d in range(3):
        r0, r1, r2 = vector_terms(series, R + 3 * d, k)
        m0, m1, m2 = entry(world, MOMENT + d), entry(world, MOMENT + 3 + d), entry(world, MOMENT + 6 + d)
        x = subtract_product(add_product(x, m1, r2), m2, r1)
        y = subtract_product(add_product(y, m2, r0), m0, r2)
        z = subtract_product(add_product(z, m0, r1), m1, r0)
    return renorm(x), renorm(y), renorm(z)


@inlined_kernel
def world_torque(series: Numbers, world: Numbers, k: int) -> Three:
    """(R^T tau)_k, tau constant in world axes."""
    x = y = z = nothing(series)
    for d in range(3):
        r0, r1, r2 = vector_terms(series, R + 3 * d, k)
        tau = entry(world, TORQUE_WORLD + d)
        x, y, z = add_product(x, r0, tau), add_product(y, r1, tau), add_product(z, r2, tau)
    return renorm(x), renorm(y), renorm(z)


@kernel
def sine_torque(series: Numbers, sines: Array, first_row: int, k: int) -> Three:
    """(R^T sum of amplitude sin(rate t + phase))_k, amplitudes in world axes."""
    none = nothing(series)
    put_vector(series, T, k, _added_sines(series, (none, none, none), sines, first_row, k))
    return rotated_to_body(series, T, k)


@kernel
def gradient_torque(series: Numbers, rotational: Numbers, orbit: Numbers, k: int) -> Three:
    """(3 n^2 u x I u)_k, u = R^T (-sin n t, 0, -cos n t) in body axes."""
    x = y = z = nothing(series)
    for n in range(k + 1):
        sine, cosine = term(series, ORBIT, k - n), term(series, ORBIT + 1, k - n)
        a, b, c = vector_terms(series, R, n)
        x, y, z = subtract_product(x, a, sine), subtract_product(y, b, sine), subtract_product(z, c, sine)
        a, b, c = vector_terms(series, R + 6, n)
        x, y, z = (
            subtract_product(x, a, cosine),
            subtract_product(y, b, cosine),
            subtract_product(z, c, cosine),
        )
    u = (renorm(x), renorm(y), renorm(z))
    put_vector(series, U, k, u)
    put_vector(series, IU, k, matrix_times(rotational, INERTIA, u))
    _move_sine(series, ORBIT, entry(orbit, ORBIT_RATE), k)
    a, b, c = _cross_product(series, U, IU, k)
    factor = entry(orbit, GRADIENT)
    return times(factor, a), times(factor, b), times(factor, c)


# ------------------------------------------------------------------------------------------------ sines


@inlined_kernel
def start_sine(series: Numbers, row: int, rate: Any, offset: float, t: float) -> None:
    """sin and cos of rate t + offset: the zeroth coefficients of row and row + 1."""
    sine, cosine = sine_and_cosine(phase(rate, t, offset))
    put(series, row, 0, sine)
    put(series, row + 1, 0, cosine)


@inlined_kernel
def _move_sine(series: Numbers, row: int, rate: Any, k: int) -> None:
    """s' = rate c, c' = -rate s: the coefficients k + 1 of row and row + 1."""
    step = over_double(rate, k + 1.0)
    put(series, row, k + 1, times(step, term(series, row + 1, k)))
    put(series, row + 1, k + 1, by_double(times(step, term(series, row, k)), -1.0))


@kernel
def _added_sines(series: Numbers, torque: Three, sines: Array, first_row: int, k: int) -> Three:
    """torque + the sum of amplitude s_k; extends the sines to k + 1."""
    for i in range(len(sines)):
        row, rate = first_row + 2 * i, exactly(series, sines[i, 3])
        s = term(series, row, k)
        share = (by_double(s, sines[i, 0]), by_double(s, sines[i, 1]), by_double(s, sines[i, 2]))
        torque = added(torque, share)
        _move_sine(series, row, rate, k)
    return torque


# ------------------------------------------------------------------------------------------ translation


@inlined_kernel
def acceleration(series: Numbers, translational: Numbers, k: int) -> Three:
    """(a_w - (c / m) v)_k, a_w = F_w / m."""
    decay = entry(translational, DECAY)
    a, b, c = vector_terms(series, V, k)
    drag = (times(decay, a), times(decay, b), times(decay, c))
    none = nothing(series)
    if k == 0:
        constant = (
            entry(translational, ACCELERATION_WORLD),
            entry(translational, ACCELERATION_WORLD + 1),
            entry(translational, ACCELERATION_WORLD + 2),
        )
        return subtracted(constant, drag)
    return subtracted((none, none, none), drag)


@kernel
def rotated_acceleration(series: Numbers, translational: Numbers, k: int) -> Three:
    """(R a_b)_k, a_b = F_b / m."""
    constant = (
        entry(translational, ACCELERATION_BODY),
        entry(translational, ACCELERATION_BODY + 1),
        entry(translational, ACCELERATION_BODY + 2),
    )
    total = nothing(series)
    x, y, z = total, total, total
    for d in range(3):
        x = add_product(x, term(series, R + d, k), constant[d])
        y = add_product(y, term(series, R + 3 + d, k), constant[d])
        z = add_product(z, term(series, R + 6 + d, k), constant[d])
    return renorm(x), renorm(y), renorm(z)


@inlined_kernel
def angular_rate(series: Numbers, rotational: Numbers, torque: Three, k: int, share: Any) -> None:
    """omega' = I^-1 torque: the coefficient k + 1 = 1 / share of omega."""
    put_rate(series, OMEGA, k, matrix_times(rotational, INERTIA_INVERSE, torque), share)
