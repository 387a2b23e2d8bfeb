"""Sums of many products of doubles to three doubles' worth of bits, by error-free transformations.

Source: Ogita, Rump & Oishi 2005, Accurate sum and dot product, SIAM J. Sci. Comput. 26, 1955.
"""

from __future__ import annotations

from typing import TypeAlias

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.jit import exact_kernel

Split: TypeAlias = tuple[float, DoubleDouble]
"""A number as a double and a small rest: of two that are nearly equal, the difference is not lost."""


@exact_kernel
def summed(terms: Array) -> Split:
    """Return the sum of terms (n,) to some 2^-155 of the sum of their magnitudes.

    What each addition loses is itself a double, and the losses are added in double-double arithmetic.
    """
    total, rest = 0.0, dd.ZERO
    for term in terms:
        total, lost = dd.two_sum(total, term)
        rest = dd.add(rest, (lost, 0.0))
    base, low = dd.two_sum(total, rest[0])
    return base, dd.two_sum(low, rest[1])


@exact_kernel
def divided(x: Split, divisor: float) -> Split:
    """Return x over a double, its rest to 2^-104."""
    base = x[0] / divisor
    product, low = dd.two_product(base, divisor)
    missing = dd.add(dd.two_sum(x[0] - product, -low), x[1])
    return base, dd.divide(missing, (divisor, 0.0))


@exact_kernel
def difference(x: Split, y: Split) -> DoubleDouble:
    """x - y, the rests apart."""
    return dd.add(dd.two_sum(x[0], -y[0]), dd.subtract(x[1], y[1]))


@exact_kernel
def rounded(x: Split) -> DoubleDouble:
    """Return x as a double-double."""
    return dd.add((x[0], 0.0), x[1])


@exact_kernel
def put_product(terms: Array, i: int, a: float, b: float) -> None:
    """Write a b, exactly, into terms[i] and terms[i + 1]."""
    terms[i], terms[i + 1] = dd.two_product(a, b)
