"""e^x, and the means of a decay that exponential motions are made of, in double-double arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.jit import exact_kernel
from bodycheck.reference_impl.paired import pair

_LN2: DoubleDouble = (0.6931471805599453, 2.3190468138462996e-17)
_LARGEST, _SMALLEST = 709.0, -745.0  # beyond which e^x leaves the range of doubles
_SERIES_BELOW = 0.5
_TERMS = 26  # 0.5^26 / 26! < 2^-114
_RECIPROCAL_FACTORIALS = tuple(pair(Fraction(1, math.factorial(j))) for j in range(_TERMS + 1))


@exact_kernel
def exponential(x: DoubleDouble) -> DoubleDouble:
    """Return e^x to (1 + |x|) 2^-102 of itself; infinite above 709, zero below -745."""
    if x[0] > _LARGEST:
        return math.inf, 0.0
    if x[0] < _SMALLEST:
        return 0.0, 0.0
    n = np.rint(x[0] / _LN2[0])
    rest = dd.subtract(x, dd.two_product(n, _LN2[0]))
    rest = dd.subtract(rest, dd.two_product(n, _LN2[1]))
    total = _RECIPROCAL_FACTORIALS[_TERMS]
    for j in range(_TERMS - 1, -1, -1):
        total = dd.add(dd.multiply(rest, total), _RECIPROCAL_FACTORIALS[j])
    return math.ldexp(total[0], int(n)), math.ldexp(total[1], int(n))


@exact_kernel
def decay_means(z: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble]:
    """Return e^-z, (1 - e^-z) / z and (z - 1 + e^-z) / z^2, each to some 2^-100 of itself, for any z.

    The second is the mean of e^-s over s in [0, z], the third that of the second, weighted by s.
    """
    if z[0] == 0.0:
        return dd.ONE, dd.ONE, (0.5, 0.0)
    if abs(z[0]) < _SERIES_BELOW:
        mean2 = _RECIPROCAL_FACTORIALS[_TERMS]
        for j in range(_TERMS - 1, 1, -1):
            mean2 = dd.subtract(_RECIPROCAL_FACTORIALS[j], dd.multiply(z, mean2))
        mean1 = dd.subtract(dd.ONE, dd.multiply(z, mean2))
        return dd.subtract(dd.ONE, dd.multiply(z, mean1)), mean1, mean2
    decayed = exponential((-z[0], -z[1]))
    mean1 = dd.divide(dd.subtract(dd.ONE, decayed), z)
    return decayed, mean1, dd.divide(dd.subtract(dd.ONE, mean1), z)
