"""Elliptic integrals: Carlson's R_F, and K and Bulirsch's cel in the complementary modulus kc = k'.

Near the separatrix of the free body kc^2 = 1 - m is the small quantity that matters, and m has lost it: no
integral here subtracts one from the other.
"""

from __future__ import annotations

import math

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.jit import exact_kernel, kernel

_RF_SPREAD = 2.5e-3  # series error spread^6 / 4, below 1e-16
_RF_SPREAD_DD = 4e-6  # the same, below 1e-32
_AGM_GAP_DD = 1e-16  # the mean is then off by gap^2


@kernel
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

    The roots are asked for because their squares may underflow. Relative error below 1e-30.
    Source: as :func:`carlson_rf`; the first duplication needs the roots only.
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

    c = cos phi, s = sin phi. For kc, p > 0 and a, b >= 0, where every operation is on numbers of one sign.
    Relative error below 1e-29.
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
