"""Double-double arithmetic: a number is the exact sum of two doubles (high, low), 106 bits in total.

Error bounds are relative. They hold while both parts of operands and results are normal doubles (roughly
1e-290 to 1e290 for the sum; splitting overflows above 2^996). Kernels are compiled without contracting
products and sums, and do not use fused multiply-add: plain Python gives the same bits.

Sources: Dekker 1971, A floating-point technique for extending the available precision; Knuth, TAOCP 2,
4.2.2; Hida, Li & Bailey 2001, Algorithms for quad-double precision floating point arithmetic; bounds in
Joldes, Muller & Popescu 2017, Tight and rigorous error bounds for basic building blocks of double-word
arithmetic.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from bodycheck.reference_impl.kernels.jit import exact_kernel

DoubleDouble: TypeAlias = tuple[float, float]

ZERO: DoubleDouble = (0.0, 0.0)
ONE: DoubleDouble = (1.0, 0.0)
PI: DoubleDouble = (3.141592653589793, 1.2246467991473532e-16)

_SPLITTER = 134217729.0  # 2^27 + 1


@exact_kernel
def two_sum(a: float, b: float) -> DoubleDouble:
    """Return (s, e) with s = fl(a + b) and s + e = a + b exactly (Knuth)."""
    s = a + b
    b_virtual = s - a
    return s, (a - (s - b_virtual)) + (b - b_virtual)


@exact_kernel
def quick_two_sum(a: float, b: float) -> DoubleDouble:
    """Return (s, e) with s = fl(a + b) and s + e = a + b exactly, for |a| >= |b| or a = 0 (Dekker)."""
    s = a + b
    return s, b - (s - a)


@exact_kernel
def split(a: float) -> DoubleDouble:
    """Return a = head + tail, exactly, each of at most 26 bits, for |a| < 2^996 (Veltkamp)."""
    scaled = _SPLITTER * a
    head = scaled - (scaled - a)
    return head, a - head


@exact_kernel
def two_product(a: float, b: float) -> DoubleDouble:
    """Return (p, e) with p = fl(a b) and p + e = a b exactly, unless e underflows (Dekker)."""
    p = a * b
    a_head, a_tail = split(a)
    b_head, b_tail = split(b)
    return p, ((a_head * b_head - p) + a_head * b_tail + a_tail * b_head) + a_tail * b_tail


@exact_kernel
def add(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x + y to 3 * 2^-106, even if the high parts cancel."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    s, e = quick_two_sum(s, e + t)
    return quick_two_sum(s, e + f)


@exact_kernel
def subtract(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x - y to 3 * 2^-106, even if the high parts cancel."""
    return add(x, (-y[0], -y[1]))


@exact_kernel
def multiply(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x y to 5 * 2^-106."""
    p, e = two_product(x[0], y[0])
    return quick_two_sum(p, e + (x[0] * y[1] + x[1] * y[0]))


@exact_kernel
def scale(x: DoubleDouble, factor: float) -> DoubleDouble:
    """Return x times a power of two; exact unless it overflows or underflows."""
    return x[0] * factor, x[1] * factor


@exact_kernel
def divide(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x / y to 10 * 2^-106, for y != 0 (Joldes et al., algorithm 17)."""
    quotient = x[0] / y[0]
    product, low = two_product(quotient, y[0])
    rest = ((x[0] - product) - low) + (x[1] - quotient * y[1])
    return quick_two_sum(quotient, rest / y[0])


@exact_kernel
def square_root(x: DoubleDouble) -> DoubleDouble:
    """Return sqrt(x), x >= 0, to 4 * 2^-106: one Newton step from the square root of the high part."""
    if x[0] <= 0.0:
        return 0.0, 0.0
    root = math.sqrt(x[0])
    square, square_low = two_product(root, root)
    return quick_two_sum(root, ((x[0] - square) - square_low + x[1]) / (2.0 * root))


_HALF_PI_HIGH, _HALF_PI_LOW = 0.5 * PI[0], 0.5 * PI[1]
_TERMS = 15  # (pi/4)^31 / 31! < 2^-119


@exact_kernel
def add_product(total: DoubleDouble, x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return total + x y without normalising; call `renorm` on the final sum.

    The low part accumulates the rounding errors. The sum of n products has an error of about n 2^-105 times
    the largest partial sum, at two thirds of the cost of `add`. Source: Dot2 of Ogita, Rump & Oishi 2005,
    Accurate sum and dot product, with double-double operands.
    """
    p, e = two_product(x[0], y[0])
    s, f = two_sum(total[0], p)
    return s, total[1] + (f + (e + (x[0] * y[1] + x[1] * y[0])))


@exact_kernel
def subtract_product(total: DoubleDouble, x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return total - x y without normalising, as `add_product` does."""
    return add_product(total, (-x[0], -x[1]), y)


@exact_kernel
def renorm(total: DoubleDouble) -> DoubleDouble:
    """Return the sum normalised: the low part is at most half an ulp of the high part."""
    return two_sum(total[0], total[1])


@exact_kernel
def times_double(x: DoubleDouble, y: float) -> DoubleDouble:
    """Return x y to 3 * 2^-106."""
    p, e = two_product(x[0], y)
    return quick_two_sum(p, e + x[1] * y)


@exact_kernel
def _sine_and_cosine_series(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """sum of (-1)^j x^(2j+1) / (2j+1)! and of (-1)^j x^2j / (2j)!, for |x| <= pi/4."""
    square = multiply(x, x)
    sine, cosine = x, ONE
    sine_term, cosine_term = x, ONE
    for j in range(1, _TERMS + 1):
        cosine_term = divide(multiply(cosine_term, square), (-(2.0 * j - 1.0) * (2.0 * j), 0.0))
        sine_term = divide(multiply(sine_term, square), (-(2.0 * j) * (2.0 * j + 1.0), 0.0))
        cosine, sine = add(cosine, cosine_term), add(sine, sine_term)
    return sine, cosine


@exact_kernel
def sine_and_cosine(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Return sin x and cos x to an absolute error of (1 + |x|) 2^-103, for |x| <= 2^50."""
    quarters = math.floor(x[0] / _HALF_PI_HIGH + 0.5)
    # the error of pi / 2, times the number of quarters, is at the level of the rounding of x
    high, low = two_product(quarters, _HALF_PI_HIGH)
    rest = subtract(x, (high, low))
    rest = subtract(rest, two_product(quarters, _HALF_PI_LOW))
    sine, cosine = _sine_and_cosine_series(rest)
    turn = int(quarters) % 4
    if turn == 1:
        return cosine, (-sine[0], -sine[1])
    if turn == 2:
        return (-sine[0], -sine[1]), (-cosine[0], -cosine[1])
    if turn == 3:
        return (-cosine[0], -cosine[1]), sine
    return sine, cosine
