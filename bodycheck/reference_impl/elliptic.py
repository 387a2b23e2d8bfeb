"""Elliptic integrals in the complementary modulus kc and Jacobi's elliptic functions in m1 = 1 - m.

Near the separatrix of the free body, kc^2 = 1 - m is the small quantity that matters, and a rounded m has
lost its digits. No integral here computes one from the other by subtraction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel

_RF_SPREAD = 2.5e-3  # series error spread^6 / 4, below 1e-16
_RF_SPREAD_DD = 4e-6  # as above, error below 1e-32
_AGM_GAP_DD = 1e-16  # the error of the mean is gap^2


@exact_kernel
def carlson_rf(x: float, y: float, z: float) -> float:
    """R_F(x, y, z) = 1/2 int_0^inf dt / sqrt((t + x)(t + y)(t + z)).

    For x, y, z >= 0 with at most one zero; infinite if two are zero. Relative error below 1e-15.
    Source: Carlson 1995, Numerical computation of real or complex elliptic integrals, algorithm 1;
    DLMF 19.36.1.
    """
    if (x == 0.0 and y == 0.0) or (y == 0.0 and z == 0.0) or (z == 0.0 and x == 0.0):
        return math.inf
    while True:
        mean = (x + y + z) / 3.0
        u, v = 1.0 - x / mean, 1.0 - y / mean
        w = -u - v
        if not max(abs(u), abs(v), abs(w)) >= _RF_SPREAD:
            break
        sx, sy, sz = math.sqrt(x), math.sqrt(y), math.sqrt(z)
        shift = sx * (sy + sz) + sy * sz
        x, y, z = 0.25 * (x + shift), 0.25 * (y + shift), 0.25 * (z + shift)
    e2, e3 = u * v - w * w, u * v * w
    return (1.0 + e2 * (e2 / 24.0 - 0.1 - 3.0 * e3 / 44.0) + e3 / 14.0) / math.sqrt(mean)


@exact_kernel
def carlson_rf_of_squares(x: DoubleDouble, y: DoubleDouble, z: DoubleDouble) -> DoubleDouble:
    """R_F(x^2, y^2, z^2) in double-double, for x, y >= 0, z > 0; infinite if x = y = 0.

    Takes the roots because their squares may underflow. Relative error below 1e-30.
    Source: as :func:`carlson_rf`; the first duplication step needs only the roots.
    """
    if x[0] == 0.0 and y[0] == 0.0:
        return math.inf, 0.0
    square_x, square_y, square_z = dd.multiply(x, x), dd.multiply(y, y), dd.multiply(z, z)
    while True:
        shift = dd.add(dd.multiply(x, dd.add(y, z)), dd.multiply(y, z))
        square_x = dd.scale(dd.add(square_x, shift), 0.25)
        square_y = dd.scale(dd.add(square_y, shift), 0.25)
        square_z = dd.scale(dd.add(square_z, shift), 0.25)
        mean = dd.divide(dd.add(dd.add(square_x, square_y), square_z), (3.0, 0.0))
        u = dd.divide(dd.subtract(mean, square_x), mean)
        v = dd.divide(dd.subtract(mean, square_y), mean)
        w = dd.subtract((-u[0], -u[1]), v)
        if not max(abs(u[0]), abs(v[0]), abs(w[0])) >= _RF_SPREAD_DD:
            break
        x, y, z = dd.square_root(square_x), dd.square_root(square_y), dd.square_root(square_z)
    e2 = dd.subtract(dd.multiply(u, v), dd.multiply(w, w))
    e3 = u[0] * v[0] * w[0]
    small = e2[0] * e2[0] / 24.0 + e3 / 14.0 - 3.0 * e2[0] * e3 / 44.0
    series = dd.subtract((1.0, small), dd.divide(e2, (10.0, 0.0)))
    return dd.divide(series, dd.square_root(mean))


@exact_kernel
def complete_k(kc: DoubleDouble) -> DoubleDouble:
    """K = int_0^(pi/2) dphi / sqrt(cos^2 phi + kc^2 sin^2 phi) = pi / (2 agm(1, kc)), for kc > 0.

    Infinite at kc = 0. Relative error below 1e-30. Source: DLMF 19.8.5.
    """
    if kc[0] == 0.0:
        return math.inf, 0.0
    a, g = dd.ONE, kc
    while abs(a[0] - g[0]) > _AGM_GAP_DD * a[0]:
        a, g = dd.scale(dd.add(a, g), 0.5), dd.square_root(dd.multiply(a, g))
    return dd.divide(dd.PI, dd.add(a, g))


@exact_kernel
def complete_integral(kc: DoubleDouble, p: DoubleDouble, a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """cel = int_0^(pi/2) (a c^2 + b s^2) / (c^2 + p s^2) dphi / sqrt(c^2 + kc^2 s^2).

    c = cos phi, s = sin phi. For kc, p > 0 and a, b >= 0: no operation then cancels, because all operands
    have the same sign. Relative error below 1e-29.
    Source: Bulirsch 1969, Numerical calculation of elliptic integrals and elliptic functions III, cel.
    """
    e, mean, k = kc, dd.ONE, kc
    root_p = dd.square_root(p)
    b = dd.divide(b, root_p)
    p = root_p
    while True:
        f, g = a, dd.divide(e, p)
        a = dd.add(a, dd.divide(b, p))
        b = dd.scale(dd.add(b, dd.multiply(f, g)), 2.0)
        p = dd.add(g, p)
        g = mean
        mean = dd.add(k, mean)
        if not abs(g[0] - k[0]) > _AGM_GAP_DD * g[0]:
            break
        k = dd.scale(dd.square_root(e), 2.0)
        e = dd.multiply(k, mean)
    numerator = dd.multiply(dd.scale(dd.PI, 0.5), dd.add(b, dd.multiply(a, mean)))
    return dd.divide(numerator, dd.multiply(mean, dd.add(mean, p)))


class Quotients(NamedTuple):
    """Constants of sn, cn and dn as theta quotients, which stay accurate relative to their size at zeros.

    For K <= 2 K' the theta series are trigonometric series in pi u / 2K with the nome q = exp(-pi K'/K).
    Otherwise Jacobi's imaginary transformation makes them exponential series with q' = exp(-pi K/K').
    """

    trigonometric: bool
    quarter_period: DoubleDouble
    """K; infinite on the separatrix."""
    rate: DoubleDouble
    """pi/2K where trigonometric, else pi/2K': the argument of the series per unit of u."""
    nome: float
    """q where trigonometric, else q'."""
    sn: float
    cn: float
    dn: float
    """The factors that make sn(K) = cn(0) = dn(0) = 1."""


@exact_kernel
def _trigonometric(nome: float, sin_x: float, cos_x: float) -> tuple[float, float, float]:
    """(theta1 / 2q^1/4, theta2 / 2q^1/4, theta3) / theta4 at x, for q <= exp(-pi/2) (DLMF 20.2)."""
    q2 = nome * nome
    q4 = q2 * q2
    q6, q8, q9 = q4 * q2, q4 * q4, q4 * q4 * nome
    q12, q16, q20 = q8 * q4, q8 * q8, q8 * q8 * q4
    c2 = (cos_x - sin_x) * (cos_x + sin_x)
    c4 = 2.0 * c2 * c2 - 1.0
    c6 = 2.0 * c2 * c4 - c2
    c8 = 2.0 * c2 * c6 - c4
    even, odd = 1.0 + 2.0 * (q4 * c4 + q16 * c8), 2.0 * (nome * c2 + q9 * c6)
    s3, s5 = 2.0 * c2 + 1.0, 2.0 * (c2 + c4) + 1.0  # sin(3x) / sin(x), sin(5x) / sin(x)
    s7, s9 = 2.0 * c6 + s5, 2.0 * (c6 + c8) + s5
    d3, d5 = 2.0 * c2 - 1.0, 2.0 * (c4 - c2) + 1.0  # cos(3x) / cos(x), cos(5x) / cos(x)
    d7, d9 = 2.0 * c6 - d5, 2.0 * (c8 - c6) + d5
    theta1 = sin_x * (1.0 - q2 * s3 + q6 * s5 - q12 * s7 + q20 * s9)
    theta2 = cos_x * (1.0 + q2 * d3 + q6 * d5 + q12 * d7 + q20 * d9)
    inverse = 1.0 / (even - odd)
    return theta1 * inverse, theta2 * inverse, (even + odd) * inverse


@exact_kernel
def _exponential(
    nome: float, decay: float, one_minus_decay2: float, rise: float, one_minus_rise2: float
) -> tuple[float, float, float]:
    """(theta1, e^-y theta4, e^-y theta3) / theta2 at i y, y >= 0, up to factors e^-y, q' <= exp(-2 pi).

    decay = e^-y and rise = sqrt(q') e^y, both at most 1. Evaluated as products (DLMF 20.5), whose factors
    1 - decay^2 and 1 - rise^2 carry the zeros of sn and cn.
    """
    q2 = nome * nome
    q3, q4 = q2 * nome, q2 * q2
    q5 = q4 * nome
    e, f = decay * decay, rise * rise
    theta1 = (
        one_minus_decay2
        * (1.0 - q2 * e)
        * (1.0 - q4 * e)
        * (1.0 - nome * f)
        * (1.0 - q3 * f)
        * (1.0 - q5 * f)
    )
    theta2 = (1.0 + e) * (1.0 + q2 * e) * (1.0 + q4 * e) * (1.0 + nome * f) * (1.0 + q3 * f) * (1.0 + q5 * f)
    theta3 = (1.0 + f) * (1.0 + q2 * f) * (1.0 + q4 * f) * (1.0 + nome * e) * (1.0 + q3 * e) * (1.0 + q5 * e)
    theta4 = (
        one_minus_rise2 * (1.0 - q2 * f) * (1.0 - q4 * f) * (1.0 - nome * e) * (1.0 - q3 * e) * (1.0 - q5 * e)
    )
    inverse = 1.0 / theta2
    return theta1 * inverse, decay * theta4 * inverse, decay * theta3 * inverse


@exact_kernel
def quotients(kc: DoubleDouble, k: DoubleDouble) -> Quotients:
    """Set up sn, cn, dn for the moduli kc = sqrt(m1) and k = sqrt(m); either may be zero."""
    quarter, other = complete_k(kc), complete_k(k)
    if quarter[0] <= 2.0 * other[0]:
        nome = math.exp(-dd.PI[0] * (other[0] / quarter[0]))
        rate = dd.divide(dd.scale(dd.PI, 0.5), quarter)
        sn = _trigonometric(nome, 1.0, 0.0)[0]
        _, cn, dn = _trigonometric(nome, 0.0, 1.0)
        return Quotients(True, quarter, rate, nome, 1.0 / sn, 1.0 / cn, 1.0 / dn)
    nome = math.exp(-dd.PI[0] * (quarter[0] / other[0]))
    rate = dd.divide(dd.scale(dd.PI, 0.5), other)
    root = math.sqrt(nome)
    sn = _exponential(nome, root, 1.0 - nome, 1.0, 0.0)[0]
    _, cn, dn = _exponential(nome, 1.0, 0.0, root, 1.0 - nome)
    return Quotients(False, quarter, rate, nome, 1.0 / sn, 1.0 / cn, 1.0 / dn)


@exact_kernel
def reduce_by_half_periods(u: DoubleDouble, quarter_period: DoubleDouble) -> tuple[DoubleDouble, float]:
    """Return (v, s) with u = v + 2 n K, |v| <= K up to rounding, and s = (-1)^n.

    sn, cn and dn of u are then s sn(v), s cn(v) and dn(v).
    """
    sign = 1.0
    if abs(u[0]) > quarter_period[0]:
        period = dd.scale(quarter_period, 2.0)
        n = np.rint(u[0] / period[0])
        u = dd.subtract(u, dd.multiply(period, (n, 0.0)))
        sign = 1.0 - 2.0 * abs(n - 2.0 * np.rint(0.5 * n))
    return u, sign


@exact_kernel
def circular_argument(v: DoubleDouble, rate: DoubleDouble) -> tuple[float, float]:
    """(sin x, cos x) of x = rate v, accurate relative to their size, including at their zeros."""
    x, x_low = dd.multiply(v, rate)
    s, c = math.sin(x), math.cos(x)
    return s + x_low * c, c - x_low * s


@exact_kernel
def _exponential_pair(y: float) -> tuple[float, float]:
    """(e^-y, 1 - e^-2y), both accurate relative to their size for small and large y >= 0."""
    if y < 0.5:
        less = math.expm1(-y)
        return 1.0 + less, -less * (2.0 + less)
    decay = math.exp(-y)
    return decay, 1.0 - decay * decay


@exact_kernel
def exponential_argument(
    v: DoubleDouble, rate: DoubleDouble, quarter_period: DoubleDouble
) -> tuple[float, float, float, float]:
    """(e^-y, 1 - e^-2y, e^(y-Y), 1 - e^(2y-2Y)) of y = rate |v| and Y = rate K."""
    distance = v if v[0] >= 0.0 else (-v[0], -v[1])
    gap = (quarter_period[0] - distance[0]) + (quarter_period[1] - distance[1])
    decay, one_minus_decay2 = _exponential_pair(rate[0] * distance[0])
    rise, one_minus_rise2 = _exponential_pair(rate[0] * gap)
    return decay, one_minus_decay2, rise, one_minus_rise2


@exact_kernel
def circular_functions(q: Quotients, sin_x: float, cos_x: float) -> tuple[float, float, float]:
    """(sn, cn, dn) from the sine and cosine of x = pi u / 2K."""
    sn, cn, dn = _trigonometric(q.nome, sin_x, cos_x)
    return q.sn * sn, q.cn * cn, q.dn * dn


@exact_kernel
def exponential_functions(
    q: Quotients, sign: float, argument: tuple[float, float, float, float]
) -> tuple[float, float, float]:
    """(sn, cn, dn) from the sign of u and the result of :func:`exponential_argument`."""
    decay, one_minus_decay2, rise, one_minus_rise2 = argument
    sn, cn, dn = _exponential(q.nome, decay, one_minus_decay2, rise, one_minus_rise2)
    return sign * q.sn * sn, q.cn * cn, q.dn * dn


@exact_kernel
def jacobi(u: float, m1: float) -> tuple[float, float, float]:
    """Return (sn, cn, dn)(u | m), m = 1 - m1, for any real u and 0 <= m1 <= 1.

    For |u| < 1e15 the error is below 2e-15, and below 4e-15 of the function itself near its zeros and in
    its tails, because u is reduced by a period of 106 bits. Raises ValueError for m1 outside [0, 1].
    Source: theta quotients, DLMF 22.2.4-6, 20.7.30-33.
    """
    if not 0.0 <= m1 <= 1.0:
        raise ValueError("m1 must be in [0, 1]")
    q = quotients(dd.square_root((m1, 0.0)), dd.square_root(dd.two_sum(1.0, -m1)))
    v, sign = reduce_by_half_periods((u, 0.0), q.quarter_period)
    if q.trigonometric:
        sin_x, cos_x = circular_argument(v, q.rate)
        sn, cn, dn = circular_functions(q, sin_x, cos_x)
    else:
        argument = exponential_argument(v, q.rate, q.quarter_period)
        sn, cn, dn = exponential_functions(q, math.copysign(1.0, v[0]), argument)
    return sign * sn, sign * cn, dn
