"""Number the principal axes by the momentum, and compute the constants of the motion along them."""

from __future__ import annotations

import math
from typing import NamedTuple

from bodycheck.reference_impl import elliptic
from bodycheck.reference_impl.free_rotation.principal_state import TumblingConstants, coefficients
from bodycheck.reference_impl.free_rotation.tensor_axes import PrincipalAxes, Triple
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel, inlined_kernel
from bodycheck.reference_impl.kernels.small_vectors import Mat


class Separation(NamedTuple):
    """d1 D2 d3 = +-size 2^exponent, exponent even; D2 = G^2 - 2E I2 is 0 on the separatrix.

    size has a relative error of 2^-100, and is exactly zero on the separatrix.
    """

    descending: bool
    """Whether D2 < 0: the axes are then numbered by descending moments."""
    size: DoubleDouble
    exponent: int


class NumberedAxes(NamedTuple):
    """The numbered principal axes, with the moments and the momentum along them."""

    moments: Triple
    gaps: Triple
    """|I2 - I1|, |I3 - I1|, |I3 - I2|."""
    momentum: Triple
    """L along the axes; the first component not negative, the third positive."""
    columns: Mat
    """The axes' directions in body axes, as columns of a proper rotation matrix."""
    side: float
    """s: +1 where the moments ascend, -1 where they descend."""


@inlined_kernel
def _gap(frame: PrincipalAxes, i: int, j: int) -> DoubleDouble:
    """I_j - I_i."""
    gap = frame.gaps[i + j - 1]
    return gap if i < j else (-gap[0], -gap[1])


@exact_kernel
def _order(frame: PrincipalAxes, descending: bool) -> tuple[int, int, int]:
    """Return the axes sorted by their moments; axes of equal moments keep their order."""
    sign = -1.0 if descending else 1.0
    a, b, c = 0, 1, 2
    if sign * _gap(frame, a, b)[0] < 0.0:
        a, b = b, a
    if sign * _gap(frame, b, c)[0] < 0.0:
        b, c = c, b
    if sign * _gap(frame, a, b)[0] < 0.0:
        a, b = b, a
    return a, b, c


@inlined_kernel
def _signed(x: DoubleDouble, sign: float) -> DoubleDouble:
    return sign * x[0], sign * x[1]


@exact_kernel
def numbered(frame: PrincipalAxes, descending: bool) -> NumberedAxes:
    """Number the axes by ascending or descending moments, and orient them by half turns."""
    a, b, c = _order(frame, descending)
    l1 = dd.multiply(frame.moments[a], frame.omega[a])
    l2 = dd.multiply(frame.moments[b], frame.omega[b])
    l3 = dd.multiply(frame.moments[c], frame.omega[c])
    sign1, sign3 = -1.0 if l1[0] < 0.0 else 1.0, -1.0 if l3[0] < 0.0 else 1.0
    parity = 1.0 if (b - a) % 3 == 1 else -1.0
    sign2 = parity * sign1 * sign3
    x, y, z = frame.axes[a], frame.axes[b], frame.axes[c]
    sign = -1.0 if descending else 1.0
    return NumberedAxes(
        (frame.moments[a], frame.moments[b], frame.moments[c]),
        (
            _signed(_gap(frame, a, b), sign),
            _signed(_gap(frame, a, c), sign),
            _signed(_gap(frame, b, c), sign),
        ),
        (_signed(l1, sign1), _signed(l2, sign2), _signed(l3, sign3)),
        (
            sign1 * x[0],
            sign2 * y[0],
            sign3 * z[0],
            sign1 * x[1],
            sign2 * y[1],
            sign3 * z[1],
            sign1 * x[2],
            sign2 * y[2],
            sign3 * z[2],
        ),
        sign,
    )


FOUR_PI: DoubleDouble = (4.0 * dd.PI[0], 4.0 * dd.PI[1])


@exact_kernel
def hypotenuse(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """sqrt(x^2 + y^2), even where the squares leave the range of doubles."""
    exponent = math.frexp(max(abs(x[0]), abs(y[0])))[1]
    down = math.ldexp(1.0, -exponent)
    x, y = dd.scale(x, down), dd.scale(y, down)
    root = dd.square_root(dd.add(dd.multiply(x, x), dd.multiply(y, y)))
    return dd.scale(root, math.ldexp(1.0, exponent))


@exact_kernel
def _root_of_ratio(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    return dd.square_root(dd.divide(x, y))


@exact_kernel
def _complementary_modulus(
    root1: DoubleDouble, root3: DoubleDouble, shape: DoubleDouble, separation: Separation
) -> DoubleDouble:
    """k' = sqrt(|d1 D2 d3|) shape / (root1^2 root3), scaled so that no step underflows."""
    exponent1, exponent3 = math.frexp(root1[0])[1], math.frexp(root3[0])[1]
    root1 = dd.scale(root1, math.ldexp(1.0, -exponent1))
    root3 = dd.scale(root3, math.ldexp(1.0, -exponent3))
    ratio = dd.divide(dd.square_root(separation.size), dd.multiply(dd.multiply(root1, root1), root3))
    return dd.scale(
        dd.multiply(ratio, shape), math.ldexp(1.0, separation.exponent // 2 - 2 * exponent1 - exponent3)
    )


@exact_kernel
def _mean_turn_rate(
    slow: DoubleDouble,
    fast: DoubleDouble,
    weight: DoubleDouble,
    phase_change: DoubleDouble,
    kc: DoubleDouble,
    quarter_period: DoubleDouble,
) -> DoubleDouble:
    """Omega / 4 pi, Omega = <precession> - phase_change / K.

    The precession, (fast A1^2 cn^2 + slow A2^2 sn^2) / (A1^2 cn^2 + A2^2 sn^2) with fast = G/I1, slow = G/I2
    and weight = (A2/A1)^2, is averaged over a half period; on the separatrix its mean is `slow`.
    """
    if kc[0] == 0.0:
        return dd.divide(slow, FOUR_PI)
    total = elliptic.complete_integral(kc, weight, fast, dd.multiply(weight, slow))
    return dd.divide(dd.subtract(total, phase_change), dd.multiply(quarter_period, FOUR_PI))


@exact_kernel
def tumbling_constants(axes: NumberedAxes, separation: Separation) -> TumblingConstants:
    """Set up the motion along the numbered axes by products, quotients and sums of numbers of one sign.

    With d1 = G^2 - 2E I1 = L2^2 (I2-I1)/I2 + L3^2 (I3-I1)/I3 and d3 = 2E I3 - G^2 likewise, up to sign:
    lambda^2 = d1 (I3-I2) / I1 I2 I3, m = d3 (I2-I1) / d1 (I3-I2), m1 = D2 (I3-I1) / d1 (I3-I2),
    A1^2 = d3 I1/(I3-I1), A2^2 = d3 I2/(I3-I2), A3^2 = d1 I3/(I3-I1).
    """
    (i1, i2, i3), (gap21, gap31, gap32), (l1, l2, l3) = axes.moments, axes.gaps, axes.momentum
    side = axes.side
    root1 = hypotenuse(dd.multiply(l2, _root_of_ratio(gap21, i2)), dd.multiply(l3, _root_of_ratio(gap31, i3)))
    root3 = hypotenuse(dd.multiply(l1, _root_of_ratio(gap31, i1)), dd.multiply(l2, _root_of_ratio(gap32, i2)))
    amplitude1 = dd.multiply(root3, _root_of_ratio(i1, gap31))
    amplitude2 = dd.multiply(root3, _root_of_ratio(i2, gap32))
    amplitude3 = dd.multiply(root1, _root_of_ratio(i3, gap31))
    norm = hypotenuse(hypotenuse(l1, l2), l3)
    rate = dd.multiply(root1, _root_of_ratio(gap32, dd.multiply(dd.multiply(i1, i2), i3)))

    k = dd.multiply(_root_of_ratio(gap21, gap32), dd.divide(root3, root1))
    kc = _complementary_modulus(root1, root3, _root_of_ratio(gap31, gap32), separation)
    functions = elliptic.quotients(kc, k)
    sn, cn, dn = dd.divide(l2, amplitude2), dd.divide(l1, amplitude1), dd.divide(l3, amplitude3)
    start = dd.scale(dd.multiply(sn, elliptic.carlson_rf_of_squares(cn, dn, dd.ONE)), side)

    weight = dd.divide(dd.multiply(i2, gap31), dd.multiply(i1, gap32))
    phase_change = dd.scale(dd.multiply(dd.PI, rate), 0.5 * side)
    turn_rate = _mean_turn_rate(
        dd.divide(norm, i2), dd.divide(norm, i1), weight, phase_change, kc, functions.quarter_period
    )
    # a = F(atan(1 / sqrt(kappa)) | m1), since 1 + kappa sn(i a)^2 = 0
    kappa = i3[0] * gap21[0] / (i1[0] * gap32[0])
    a = elliptic.carlson_rf(kappa, kappa + k[0] * k[0], kappa + 1.0)
    tilt = amplitude1[0] / (norm[0] + amplitude3[0])
    return TumblingConstants(
        functions,
        start,
        rate,
        turn_rate,
        coefficients(functions, a, tilt, side),
        (
            amplitude1[0] / i1[0],
            side * amplitude2[0] / i2[0],
            amplitude3[0] / i3[0],
        ),
    )
