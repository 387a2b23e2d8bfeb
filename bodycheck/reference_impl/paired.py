"""Rational numbers rounded to double-doubles."""

from __future__ import annotations

from fractions import Fraction

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.rational import Vector, dot, fractions


def pair(x: Fraction) -> DoubleDouble:
    """Return the double-double nearest to a rational number."""
    high = float(x)
    return high, float(x - Fraction(high))


def unit_quaternion(q: Array) -> list[DoubleDouble]:
    """q / |q| of a quaternion of doubles (4,)."""
    return unit(fractions(q))


def unit(exact: Vector) -> list[DoubleDouble]:
    """v / |v|, of any number of components."""
    norm = dd.square_root(pair(dot(exact, exact)))
    return [dd.divide(pair(x), norm) for x in exact]
