"""Rational numbers rounded to double-doubles: unit vectors, quaternions and the start of a motion."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.rational import Vector, dot, fractions, rotation_of, times, transposed
from bodycheck.reference_impl.scene import State


def pair(x: Fraction) -> DoubleDouble:
    """Return the double-double nearest to a rational number."""
    high = float(x)
    return high, float(x - Fraction(high))


def unit_quaternion(q: Array) -> list[DoubleDouble]:
    """q / |q| for a quaternion of doubles (4,)."""
    return unit(fractions(q))


def start_omega(start: State) -> Vector:
    """Return omega in body axes without rounding: omega_body, or R^T exact_omega_world if given."""
    if start.exact_omega_world is None:
        return fractions(start.omega_body)
    to_body = transposed(rotation_of(fractions(start.quaternion)))
    return times(to_body, fractions(start.exact_omega_world))


def paired_omega(start: State) -> tuple[Array, Array]:
    """Return `start_omega` as high and low parts, (3,) and (3,)."""
    high, low = np.array([pair(x) for x in start_omega(start)], dtype=np.float64).T
    return np.ascontiguousarray(high), np.ascontiguousarray(low)


def unit(exact: Vector) -> list[DoubleDouble]:
    """v / |v| for any number of components."""
    norm = dd.square_root(pair(dot(exact, exact)))
    return [dd.divide(pair(x), norm) for x in exact]
