"""Principal moments, their gaps and principal axes of a tensor, more accurate than double-double.

Source: Ogita, Rump & Oishi 2005, Accurate sum and dot product, SIAM J. Sci. Comput. 26, 1955.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel, inlined_kernel
from bodycheck.reference_impl.kernels.small_vectors import Mat, Quat, Vec, principal_frame

Split: TypeAlias = tuple[float, DoubleDouble]
"""A number as a double and a small rest, so that differences of nearly equal numbers stay accurate."""


@exact_kernel
def summed(terms: Array) -> Split:
    """Return the sum of terms (n,) to some 2^-155 of the sum of their magnitudes.

    The rounding error of each addition is itself a double; these errors are added in double-double.
    """
    total, rest = 0.0, dd.ZERO
    for term in terms:
        total, lost = dd.two_sum(total, term)
        rest = dd.add(rest, (lost, 0.0))
    base, low = dd.two_sum(total, rest[0])
    return base, dd.two_sum(low, rest[1])


@exact_kernel
def divided(x: Split, divisor: float) -> Split:
    """Return x divided by a double, its rest to 2^-104."""
    base = x[0] / divisor
    product, low = dd.two_product(base, divisor)
    missing = dd.add(dd.two_sum(x[0] - product, -low), x[1])
    return base, dd.divide(missing, (divisor, 0.0))


@exact_kernel
def difference(x: Split, y: Split) -> DoubleDouble:
    """x - y, with the rests subtracted separately."""
    return dd.add(dd.two_sum(x[0], -y[0]), dd.subtract(x[1], y[1]))


@exact_kernel
def rounded(x: Split) -> DoubleDouble:
    """Return x as a double-double."""
    return dd.add((x[0], 0.0), x[1])


@exact_kernel
def put_product(terms: Array, i: int, a: float, b: float) -> None:
    """Write the exact product a b into terms[i] and terms[i + 1]."""
    terms[i], terms[i + 1] = dd.two_product(a, b)


Triple: TypeAlias = tuple[DoubleDouble, DoubleDouble, DoubleDouble]

_ROTATION_BITS = (
    25  # of the rotation's quaternion: the elements of its matrix are sums of products, of 52 bits
)
_NEGLIGIBLE = 2.0**-158  # of the largest moment: smaller off-diagonal elements count as zero
_SWEEPS = 6  # from 2^-25: 2^-50, 2^-100, and one more; equal moments take another


class PrincipalAxes(NamedTuple):
    """I = A diag(moments) A^T."""

    moments: Triple
    gaps: Triple
    """I2 - I1, I3 - I1, I3 - I2, of either sign."""
    omega: Triple
    """A^T omega."""
    axes: tuple[Vec, Vec, Vec]
    """The columns of A, a proper rotation, rounded to doubles."""


@exact_kernel
def quaternion_of(m: Mat) -> Quat:
    """Return q with R(q) = m, up to a factor, from its largest component (Shepperd 1978)."""
    w, x = 1.0 + m[0] + m[4] + m[8], 1.0 + m[0] - m[4] - m[8]
    y, z = 1.0 - m[0] + m[4] - m[8], 1.0 - m[0] - m[4] + m[8]
    largest = max(w, x, y, z)
    if w == largest:
        return w, m[7] - m[5], m[2] - m[6], m[3] - m[1]
    if x == largest:
        return m[7] - m[5], x, m[1] + m[3], m[2] + m[6]
    if y == largest:
        return m[2] - m[6], m[1] + m[3], y, m[5] + m[7]
    return m[3] - m[1], m[2] + m[6], m[5] + m[7], z


@exact_kernel
def _short_rotation(inertia: Mat) -> tuple[Mat, float]:
    """Return (|q|^2 R(q), |q|^2), without rounding, for a rotation q within 2^-25 of the principal axes."""
    q = quaternion_of(principal_frame(inertia)[1])
    size = max(abs(q[0]), abs(q[1]), abs(q[2]), abs(q[3]))
    grid = math.ldexp(1.0, math.frexp(size)[1] - _ROTATION_BITS)
    back = math.ldexp(1.0, 1 - _ROTATION_BITS)
    w, x, y, z = (
        np.rint(q[0] / grid) * back,
        np.rint(q[1] / grid) * back,
        np.rint(q[2] / grid) * back,
        np.rint(q[3] / grid) * back,
    )
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    rotation = (
        ww + xx - yy - zz,
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        ww - xx + yy - zz,
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        ww - xx - yy + zz,
    )
    return rotation, ww + xx + yy + zz


@exact_kernel
def _congruence(inertia: Mat, rotation: Mat, i: int, j: int) -> Split:
    """(rotation^T inertia rotation)_ij."""
    row, terms = np.empty(6), np.empty(18)
    for k in range(3):
        for n in range(3):
            put_product(row, 2 * n, inertia[3 * k + n], rotation[3 * n + j])
        base, rest = summed(row)
        put_product(terms, 6 * k, rotation[3 * k + i], base)
        put_product(terms, 6 * k + 2, rotation[3 * k + i], rest[0])
        put_product(terms, 6 * k + 4, rotation[3 * k + i], rest[1])
    return summed(terms)


@exact_kernel
def _rotated_component(rotation: Mat, omega: Vec, rest: Vec, i: int) -> DoubleDouble:
    """(rotation^T (omega + rest))_i."""
    terms = np.empty(12)
    for k in range(3):
        put_product(terms, 4 * k, rotation[3 * k + i], omega[k])
        put_product(terms, 4 * k + 2, rotation[3 * k + i], rest[k])
    return rounded(summed(terms))


@exact_kernel
def _tangent(off: DoubleDouble, gap: DoubleDouble) -> DoubleDouble:
    """2 off / (gap +- sqrt(gap^2 + 4 off^2)): tan of the smaller angle that diagonalises a 2 x 2 matrix."""
    twice = dd.scale(off, 2.0)
    root = dd.square_root(dd.add(dd.multiply(gap, gap), dd.multiply(twice, twice)))
    return dd.divide(twice, dd.add(gap, root) if gap[0] >= 0.0 else dd.subtract(gap, root))


@exact_kernel
def _rotated(
    c: DoubleDouble, s: DoubleDouble, x: DoubleDouble, y: DoubleDouble
) -> tuple[DoubleDouble, DoubleDouble]:
    """(c x - s y, s x + c y)."""
    return (
        dd.subtract(dd.multiply(c, x), dd.multiply(s, y)),
        dd.add(dd.multiply(s, x), dd.multiply(c, y)),
    )


@inlined_kernel
def _pair(values: Array) -> DoubleDouble:
    return values[0], values[1]


@inlined_kernel
def _put(values: Array, x: DoubleDouble) -> None:
    values[0], values[1] = x


@exact_kernel
def _rotate_pairs(c: DoubleDouble, s: DoubleDouble, x: Array, y: Array) -> None:
    """(x, y) -> (c x - s y, s x + c y)."""
    new_x, new_y = _rotated(c, s, _pair(x), _pair(y))
    _put(x, new_x)
    _put(y, new_y)


@exact_kernel
def _nearly_diagonal(
    inertia: Mat, omega: Vec, rest: Vec, bases: Array, rests: Array, offs: Array, spin: Array, axes: Array
) -> None:
    """Fill the work arrays of `principal` with the state after the short rotation."""
    rotation, norm = _short_rotation(inertia)
    for i in range(3):
        bases[i], remainder = divided(divided(_congruence(inertia, rotation, i, i), norm), norm)
        _put(rests[i], remainder)
        off = rounded(_congruence(inertia, rotation, (i + 1) % 3, (i + 2) % 3))
        _put(offs[i], dd.divide(dd.divide(off, (norm, 0.0)), (norm, 0.0)))
        _put(spin[i], dd.divide(_rotated_component(rotation, omega, rest, i), (norm, 0.0)))
        for k in range(3):
            _put(axes[i, k], dd.divide((rotation[3 * k + i], 0.0), (norm, 0.0)))


@exact_kernel
def _rotate_away(r: int, bases: Array, rests: Array, offs: Array, spin: Array, axes: Array) -> None:
    """Rotate about the axis r so that the other two axes are no longer coupled."""
    p, q = (r + 1) % 3, (r + 2) % 3
    off, rest_p, rest_q = _pair(offs[r]), _pair(rests[p]), _pair(rests[q])
    tangent = _tangent(off, difference((bases[q], rest_q), (bases[p], rest_p)))
    c = dd.divide(dd.ONE, dd.square_root(dd.add(dd.ONE, dd.multiply(tangent, tangent))))
    s = dd.multiply(tangent, c)
    shift = dd.multiply(tangent, off)
    _put(rests[p], dd.subtract(rest_p, shift))
    _put(rests[q], dd.add(rest_q, shift))
    _put(offs[r], dd.ZERO)
    _rotate_pairs(c, s, offs[q], offs[p])  # the axis r is coupled to p by offs[q], to q by offs[p]
    _rotate_pairs(c, s, spin[p], spin[q])
    for k in range(3):
        _rotate_pairs(c, s, axes[p, k], axes[q, k])


@exact_kernel
def _already_principal(inertia: Mat, omega: Vec, rest: Vec) -> PrincipalAxes:
    """Return the frame of a diagonal tensor: its axes are the body axes."""
    first, second, third = inertia[0], inertia[4], inertia[8]
    return PrincipalAxes(
        ((first, 0.0), (second, 0.0), (third, 0.0)),
        (dd.two_sum(second, -first), dd.two_sum(third, -first), dd.two_sum(third, -second)),
        (dd.two_sum(omega[0], rest[0]), dd.two_sum(omega[1], rest[1]), dd.two_sum(omega[2], rest[2])),
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    )


@exact_kernel
def principal(inertia: Mat, omega: Vec, rest: Vec) -> PrincipalAxes:
    """Diagonalise a symmetric tensor whose largest element is of ordinary size, by cyclic Jacobi rotations.

    The error of the moments' rests is some 2^-150 of the largest moment, that of omega 2^-128 of itself. A
    diagonal tensor is returned exactly. rest: the low part of omega. Source: Golub & Van Loan 2013, Matrix
    computations, 8.5.
    """
    if inertia[1] == 0.0 and inertia[2] == 0.0 and inertia[5] == 0.0:
        return _already_principal(inertia, omega, rest)
    # a moment is a base and a rest; offs[r] couples the two axes other than r; an axis is a row
    bases, rests, offs = np.empty(3), np.empty((3, 2)), np.empty((3, 2))
    spin, axes = np.empty((3, 2)), np.empty((3, 3, 2))
    _nearly_diagonal(inertia, omega, rest, bases, rests, offs, spin, axes)
    negligible = _NEGLIGIBLE * max(abs(bases[0]), abs(bases[1]), abs(bases[2]))
    for _ in range(_SWEEPS):
        for r in range(3):
            if abs(offs[r, 0]) > negligible:
                _rotate_away(r, bases, rests, offs, spin, axes)
    first, second, third = (
        (bases[0], _pair(rests[0])),
        (bases[1], _pair(rests[1])),
        (bases[2], _pair(rests[2])),
    )
    return PrincipalAxes(
        (rounded(first), rounded(second), rounded(third)),
        (difference(second, first), difference(third, first), difference(third, second)),
        (_pair(spin[0]), _pair(spin[1]), _pair(spin[2])),
        (
            (axes[0, 0, 0], axes[0, 1, 0], axes[0, 2, 0]),
            (axes[1, 0, 0], axes[1, 1, 0], axes[1, 2, 0]),
            (axes[2, 0, 0], axes[2, 1, 0], axes[2, 2, 0]),
        ),
    )
