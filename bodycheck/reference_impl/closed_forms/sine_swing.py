"""A sine torque about a fixed axis: w' = a sin(r t + p), theta' = w, from rest, in double-double."""

from __future__ import annotations

import math
from fractions import Fraction

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.double_double_functions import sine_and_cosine
from bodycheck.reference_impl.jit import exact_kernel
from bodycheck.reference_impl.paired import pair

_SERIES_BELOW = 0.5
_TERMS = 13  # 0.5^26 / 28! < 2^-123
_EVEN = tuple(pair(Fraction((-1) ** j, math.factorial(2 * j + 2))) for j in range(_TERMS + 1))
_ODD = tuple(pair(Fraction((-1) ** j, math.factorial(2 * j + 3))) for j in range(_TERMS + 1))


@exact_kernel
def _sine_means(z: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble]:
    """sin z / z, (1 - cos z) / z^2 and (z - sin z) / z^2, to some 2^-100 of their largest values near z."""
    square = dd.multiply(z, z)
    if abs(z[0]) < _SERIES_BELOW:
        even, odd = _EVEN[_TERMS], _ODD[_TERMS]
        for j in range(_TERMS - 1, -1, -1):
            even = dd.add(_EVEN[j], dd.multiply(square, even))
            odd = dd.add(_ODD[j], dd.multiply(square, odd))
        return dd.subtract(dd.ONE, dd.multiply(square, odd)), even, dd.multiply(z, odd)
    sine, cosine = sine_and_cosine(z)
    return (
        dd.divide(sine, z),
        dd.divide(dd.subtract(dd.ONE, cosine), square),
        dd.divide(dd.subtract(z, sine), square),
    )


@exact_kernel
def swing(amplitude: DoubleDouble, rate: float, phase: float, t: float) -> tuple[DoubleDouble, DoubleDouble]:
    """theta = a t^2 (sin p (1 - cos z) / z^2 + cos p (z - sin z) / z^2) and w, with z = r t.

    w = a t (sin p sin z / z + cos p (1 - cos z) / z).
    """
    sine, cosine = sine_and_cosine((phase, 0.0))
    z = dd.two_product(rate, t)
    mean0, mean1, mean2 = _sine_means(z)
    gained = dd.multiply(amplitude, (t, 0.0))
    w = dd.add(dd.multiply(sine, mean0), dd.multiply(cosine, dd.multiply(z, mean1)))
    angle = dd.add(dd.multiply(sine, mean1), dd.multiply(cosine, mean2))
    return dd.multiply(dd.multiply(gained, (t, 0.0)), angle), dd.multiply(gained, w)
