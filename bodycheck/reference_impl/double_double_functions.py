"""Sums of products, sine and cosine in double-double arithmetic."""

from __future__ import annotations

import math

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.jit import exact_kernel

_HALF_PI_HIGH, _HALF_PI_LOW = 0.5 * dd.PI[0], 0.5 * dd.PI[1]
_TERMS = 15  # (pi/4)^31 / 31! < 2^-119


@exact_kernel
def add_product(total: DoubleDouble, x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return total + x y, for a sum that `settled` ends: the low part just gathers what is lost.

    n products are summed to about n 2^-105 of the largest partial sum (the Dot2 of Ogita, Rump & Oishi 2005,
    Accurate sum and dot product, with operands of two parts), at two thirds of the cost of `add`.
    """
    p, e = dd.two_product(x[0], y[0])
    s, f = dd.two_sum(total[0], p)
    return s, total[1] + (f + (e + (x[0] * y[1] + x[1] * y[0])))


@exact_kernel
def subtract_product(total: DoubleDouble, x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return total - x y, like `add_product`."""
    return add_product(total, (-x[0], -x[1]), y)


@exact_kernel
def settled(total: DoubleDouble) -> DoubleDouble:
    """Return the sum with its low part below half an ulp of its high part."""
    return dd.two_sum(total[0], total[1])


@exact_kernel
def times_double(x: DoubleDouble, y: float) -> DoubleDouble:
    """Return x y to 3 * 2^-106."""
    p, e = dd.two_product(x[0], y)
    return dd.quick_two_sum(p, e + x[1] * y)


@exact_kernel
def _sine_and_cosine_series(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """sum of (-1)^j x^(2j+1) / (2j+1)! and of (-1)^j x^2j / (2j)!, for |x| <= pi/4."""
    square = dd.multiply(x, x)
    sine, cosine = x, dd.ONE
    sine_term, cosine_term = x, dd.ONE
    for j in range(1, _TERMS + 1):
        cosine_term = dd.divide(dd.multiply(cosine_term, square), (-(2.0 * j - 1.0) * (2.0 * j), 0.0))
        sine_term = dd.divide(dd.multiply(sine_term, square), (-(2.0 * j) * (2.0 * j + 1.0), 0.0))
        cosine, sine = dd.add(cosine, cosine_term), dd.add(sine, sine_term)
    return sine, cosine


@exact_kernel
def sine_and_cosine(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Return sin x and cos x to (1 + |x|) 2^-103, absolute, for |x| up to 2^50."""
    quarters = math.floor(x[0] / _HALF_PI_HIGH + 0.5)
    # the constant's own error, times the quarters taken, is that of x itself
    high, low = dd.two_product(quarters, _HALF_PI_HIGH)
    rest = dd.subtract(x, (high, low))
    rest = dd.subtract(rest, dd.two_product(quarters, _HALF_PI_LOW))
    sine, cosine = _sine_and_cosine_series(rest)
    turn = int(quarters) % 4
    if turn == 1:
        return cosine, (-sine[0], -sine[1])
    if turn == 2:
        return (-sine[0], -sine[1]), (-cosine[0], -cosine[1])
    if turn == 3:
        return (-cosine[0], -cosine[1]), sine
    return sine, cosine
