"""Vectors, matrices and quaternions as tuples of floats, so that kernels keep them in registers.

Vectors are (x, y, z), matrices nine numbers in row-major order, quaternions (w, x, y, z).
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import as_exact, borrowing_inline, exact_kernel, kernel

Vec: TypeAlias = tuple[float, float, float]
Quat: TypeAlias = tuple[float, float, float, float]
Mat: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]


@kernel
def add(a: Vec, b: Vec) -> Vec:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def scaled_add(a: Vec, s: float, b: Vec) -> Vec:
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@kernel
def dot(a: Vec, b: Vec) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Vec, b: Vec) -> Vec:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def times(m: Mat, v: Vec) -> Vec:
    """m v."""
    return (
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
        m[6] * v[0] + m[7] * v[1] + m[8] * v[2],
    )


@kernel
def transposed_times(m: Mat, v: Vec) -> Vec:
    """m^T v."""
    return (
        m[0] * v[0] + m[3] * v[1] + m[6] * v[2],
        m[1] * v[0] + m[4] * v[1] + m[7] * v[2],
        m[2] * v[0] + m[5] * v[1] + m[8] * v[2],
    )


@kernel
def product(a: Mat, b: Mat) -> Mat:
    """a b."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@kernel
def solve(m: Mat, b: Vec) -> Vec:
    """x with m x = b, by Cramer's rule."""
    column0, column1, column2 = (m[0], m[3], m[6]), (m[1], m[4], m[7]), (m[2], m[5], m[8])
    normal = cross(column1, column2)
    scale = 1.0 / (column0[0] * normal[0] + column0[1] * normal[1] + column0[2] * normal[2])
    other = cross(b, column0)
    return (
        scale * (b[0] * normal[0] + b[1] * normal[1] + b[2] * normal[2]),
        -scale * (column2[0] * other[0] + column2[1] * other[1] + column2[2] * other[2]),
        scale * (column1[0] * other[0] + column1[1] * other[1] + column1[2] * other[2]),
    )


@kernel
def quaternion_times(p: Quat, q: Quat) -> Quat:
    """p q (Hamilton)."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


exact_times, exact_quaternion_times = as_exact(times), as_exact(quaternion_times)
"""Without fused products, so that plain Python gives the same bits."""


@kernel
def matrix_of(q: Quat) -> Mat:
    """R(q) for q of any norm: R v = q v q^-1."""
    w, x, y, z = q
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        1.0 - s * (y * y + z * z),
        s * (x * y - w * z),
        s * (x * z + w * y),
        s * (x * y + w * z),
        1.0 - s * (x * x + z * z),
        s * (y * z - w * x),
        s * (x * z - w * y),
        s * (y * z + w * x),
        1.0 - s * (x * x + y * y),
    )


@kernel
def quaternion_exp(v: Vec) -> Quat:
    """exp(v / 2) = (cos(|v|/2), sin(|v|/2) v/|v|)."""
    half = 0.5 * math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    s = 0.5 * math.sin(half) / half if half > 0.0 else 0.5
    return math.cos(half), s * v[0], s * v[1], s * v[2]


_SWEEPS = 12  # convergence is quadratic: six suffice for any 3 x 3 matrix
_NEGLIGIBLE = 2.0**-54  # relative to the geometric mean of the two diagonal elements


exact_dot, exact_cross = as_exact(dot), as_exact(cross)


@exact_kernel
def principal_frame(inertia: Mat) -> tuple[Vec, Mat]:
    """J1 <= J2 <= J3, and the principal axes as the columns of A, det A = +1.

    inertia: symmetric and positive definite. For a diagonal one, moments and axes are exact.
    Source: Jacobi (1846); Golub and Van Loan (2013), Matrix computations, section 8.5.
    """
    a, v = np.empty((3, 3)), np.eye(3)
    for i in range(3):
        for j in range(3):
            a[i, j] = inertia[3 * i + j]
    for _ in range(_SWEEPS):
        for p in range(2):
            for q in range(p + 1, 3):
                if abs(a[p, q]) <= _NEGLIGIBLE * math.sqrt(a[p, p] * a[q, q]):
                    continue
                slope = 0.5 * (a[q, q] - a[p, p]) / a[p, q]
                tangent = math.copysign(1.0, slope) / (abs(slope) + math.sqrt(slope * slope + 1.0))
                cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for k in range(3):
                    a[k, p], a[k, q] = cosine * a[k, p] - sine * a[k, q], sine * a[k, p] + cosine * a[k, q]
                for k in range(3):
                    a[p, k], a[q, k] = cosine * a[p, k] - sine * a[q, k], sine * a[p, k] + cosine * a[q, k]
                    v[k, p], v[k, q] = cosine * v[k, p] - sine * v[k, q], sine * v[k, p] + cosine * v[k, q]
    low, high = 0, 2
    for i in range(3):
        if a[i, i] < a[low, low]:
            low = i
    for i in range(2, -1, -1):
        if a[i, i] > a[high, high]:
            high = i
    middle = 3 - low - high
    first, last = (v[0, low], v[1, low], v[2, low]), (v[0, high], v[1, high], v[2, high])
    second = exact_cross(last, first)
    return (
        (a[low, low], a[middle, middle], a[high, high]),
        (first[0], second[0], last[0], first[1], second[1], last[1], first[2], second[2], last[2]),
    )


@borrowing_inline
def vector_at(a: Array, i: int) -> Vec:
    """Three numbers starting at a[i], of an array (n,)."""
    return a[i], a[i + 1], a[i + 2]


@borrowing_inline
def matrix_at(a: Array, i: int) -> Mat:
    """Nine numbers starting at a[i], of an array (n,): a matrix in row-major order."""
    return a[i], a[i + 1], a[i + 2], a[i + 3], a[i + 4], a[i + 5], a[i + 6], a[i + 7], a[i + 8]


@borrowing_inline
def store(a: Array, i: int, v: Vec) -> None:
    """Write three numbers into an array (n,), starting at a[i]."""
    a[i], a[i + 1], a[i + 2] = v
