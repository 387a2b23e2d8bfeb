"""I = A diag(J) A^T by Jacobi's method, for kernels: LAPACK would take seconds to compile in."""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.registers import Mat, Vec, cross

_SWEEPS = 12  # convergence is quadratic: six are enough for any 3 x 3 matrix
_NEGLIGIBLE = 2.0**-54  # beside the geometric mean of the two diagonal elements


@kernel
def principal_frame(inertia: Mat) -> tuple[Vec, Mat]:
    """J1 <= J2 <= J3 and the axes as A's columns, det A = +1.

    inertia: symmetric and positive definite. A diagonal one gives moments and axes without rounding.
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
    second = cross(last, first)
    return (
        (a[low, low], a[middle, middle], a[high, high]),
        (first[0], second[0], last[0], first[1], second[1], last[1], first[2], second[2], last[2]),
    )
