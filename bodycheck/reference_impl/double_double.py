"""Double-double arithmetic: a number is the exact sum (high, low) of two doubles, 106 bits in all.

Errors are relative, for operands and results whose parts stay normal (roughly 1e-290 to 1e290 for the
sum; splitting overflows above 2^996). Every kernel is compiled without fusing products and sums, and
none relies on a fused multiply-add, so that the plain Python run gives the same bits.

Sources: Dekker 1971, A floating-point technique for extending the available precision; Knuth, TAOCP 2,
4.2.2; Hida, Li & Bailey 2001, Algorithms for quad-double precision floating point arithmetic; bounds in
Joldes, Muller & Popescu 2017, Tight and rigorous error bounds for basic building blocks of double-word
arithmetic.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from bodycheck.reference_impl.jit import exact_kernel

DoubleDouble: TypeAlias = tuple[float, float]

ZERO: DoubleDouble = (0.0, 0.0)
ONE: DoubleDouble = (1.0, 0.0)
PI: DoubleDouble = (3.141592653589793, 1.2246467991473532e-16)

_SPLITTER = 134217729.0  # 2^27 + 1


@exact_kernel
def two_sum(a: float, b: float) -> DoubleDouble:
    """Return (s, e) with s = fl(a + b) and s + e = a + b exactly (Knuth)."""
    s = a + b
    b_seen = s - a
    return s, (a - (s - b_seen)) + (b - b_seen)


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
    """Return x + y to 3 * 2^-106, also where the high parts cancel."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    s, e = quick_two_sum(s, e + t)
    return quick_two_sum(s, e + f)


@exact_kernel
def subtract(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x - y to 3 * 2^-106, also where the high parts cancel."""
    return add(x, (-y[0], -y[1]))


@exact_kernel
def multiply(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x y to 5 * 2^-106."""
    p, e = two_product(x[0], y[0])
    return quick_two_sum(p, e + (x[0] * y[1] + x[1] * y[0]))


@exact_kernel
def scale(x: DoubleDouble, factor: float) -> DoubleDouble:
    """Return x times a power of two, exactly unless it leaves the range of doubles."""
    return x[0] * factor, x[1] * factor


@exact_kernel
def divide(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x / y to 10 * 2^-106, y not zero (Joldes et al., algorithm 17)."""
    quotient = x[0] / y[0]
    product, low = two_product(quotient, y[0])
    rest = ((x[0] - product) - low) + (x[1] - quotient * y[1])
    return quick_two_sum(quotient, rest / y[0])


@exact_kernel
def square_root(x: DoubleDouble) -> DoubleDouble:
    """Return the root of x >= 0 to 4 * 2^-106: one Newton step from the root of its high part."""
    if x[0] <= 0.0:
        return 0.0, 0.0
    root = math.sqrt(x[0])
    square, square_low = two_product(root, root)
    return quick_two_sum(root, ((x[0] - square) - square_low + x[1]) / (2.0 * root))
