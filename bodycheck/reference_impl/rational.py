"""Rational arithmetic: vectors and matrices of exact doubles, without rounding, and as double-doubles."""

from __future__ import annotations

from fractions import Fraction
from operator import mul
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.scene import State

Vector: TypeAlias = list[Fraction]


def fractions(values: Array) -> Vector:
    """Return doubles as exact rational numbers, in row-major order."""
    return [Fraction(float(x)) for x in np.ravel(values)]


def added(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return [x + y for x, y in zip(a, b, strict=True)]


def dot(a: Vector, b: Vector) -> Fraction:
    """a . b."""
    return sum(map(mul, a, b), Fraction(0))


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def times(m: Vector, v: Vector) -> Vector:
    """m v."""
    return [dot(m[3 * i : 3 * i + 3], v) for i in range(3)]


def transposed(m: Vector) -> Vector:
    """m^T."""
    return [m[3 * i + j] for j in range(3) for i in range(3)]


def inverse(m: Vector) -> Vector:
    """m^-1, by cofactors."""
    columns = [cross(m[3:6], m[6:9]), cross(m[6:9], m[0:3]), cross(m[0:3], m[3:6])]
    determinant = dot(m[0:3], columns[0])
    return [columns[j][i] / determinant for i in range(3) for j in range(3)]


def rotation_of(q: Vector) -> Vector:
    """R(q / |q|), which depends on the norm only through its square."""
    w, x, y, z = q
    s = 2 / (w * w + x * x + y * y + z * z)
    return [
        *(1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
        *(s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)),
        *(s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)),
    ]


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
