"""I = A diag(J) A^T to some 2^-110, in rational arithmetic: the frame of the fast Taylor integrator."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TypeAlias

from bodycheck.reference_impl.rational import Vector

IntegerQuaternion: TypeAlias = tuple[int, int, int, int]

_SWEEPS = 12  # convergence is quadratic, from the third sweep on at the latest
_NEGLIGIBLE = Fraction(1, 2**220)  # squared, beside the product of the two diagonal elements
_KEPT_BITS = 256


def principal_quaternion(inertia: Vector) -> tuple[IntegerQuaternion, Vector]:
    """Return a quaternion of any length from principal to body axes, and the moments J.

    inertia: nine numbers, symmetric and positive definite. Jacobi's method: angles are rounded, but any
    quaternion of integers is a rotation exactly, and J is what the tensor is along its axes. A diagonal
    tensor keeps its axes. Source: Golub and Van Loan (2013), Matrix computations, section 8.5.
    """
    p: IntegerQuaternion = (1, 0, 0, 0)
    turned = inertia
    for _ in range(_SWEEPS):
        settled = True
        for i, j, axis in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            off, first, second = turned[3 * i + j], turned[4 * i], turned[4 * j]
            if off * off <= _NEGLIGIBLE * first * second:
                continue
            settled = False
            angle = 0.5 * math.atan(2 * off / (first - second)) if first != second else 0.25 * math.pi
            p = _turned_about(p, axis, math.tan(0.5 * angle))
            turned = in_axes_of(p, inertia)
        if settled:
            break
    return p, [turned[0], turned[4], turned[8]]


def _turned_about(p: IntegerQuaternion, axis: int, tangent: float) -> IntegerQuaternion:
    """p (1, tangent e), of the length that its kept bits give it."""
    above, below = tangent.as_integer_ratio()
    w, v = p[0], p[1:]
    e = [above if i == axis else 0 for i in range(3)]
    product = [
        w * below - sum(a * b for a, b in zip(v, e, strict=True)),
        *(w * e[i] + below * v[i] + v[i - 2] * e[i - 1] - v[i - 1] * e[i - 2] for i in range(3)),
    ]
    shift = max(0, max(abs(x) for x in product).bit_length() - _KEPT_BITS)
    a, b, c, d = (x >> shift for x in product)
    return a, b, c, d


def axes_of(p: IntegerQuaternion) -> Vector:
    """R(p) row by row, exactly: its columns are the principal axes in body axes."""
    w, x, y, z = p
    square = w * w + x * x + y * y + z * z
    rows = [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]
    return [Fraction(n, square) for n in rows]


def in_axes_of(p: IntegerQuaternion, m: Vector) -> Vector:
    """R(p)^T m R(p), of the nine numbers of a matrix."""
    r = axes_of(p)
    right = [
        sum((m[3 * i + k] * r[3 * k + j] for k in range(3)), Fraction(0)) for i in range(3) for j in range(3)
    ]
    return [
        sum((r[3 * k + i] * right[3 * k + j] for k in range(3)), Fraction(0))
        for i in range(3)
        for j in range(3)
    ]
