"""Rotations: vectors, quaternions (w, x, y, z) and matrices, all mapping body axes to world axes.

Every function takes leading batch dimensions. There is no small-angle switch: each formula is free of
cancellation down to the zero angle, the only special case.
"""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array


def hat(v: Array) -> Array:
    """[v]x, the matrix with [v]x u = v x u.

    Shapes: (..., 3) -> (..., 3, 3).
    """
    v = np.asarray(v, dtype=np.float64)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0] = x, y, z
    matrix[..., 1, 2], matrix[..., 2, 0], matrix[..., 0, 1] = -x, -y, -z
    return matrix


def vee(m: Array) -> Array:
    """v with [v]x = (m - m^T) / 2, the inverse of hat for skew-symmetric matrices.

    Shapes: (..., 3, 3) -> (..., 3).
    """
    return 0.5 * np.stack(
        [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1
    )


def _sin_over(angle: Array) -> Array:
    """sin(a) / a, 1 at a = 0."""
    return np.where(angle == 0.0, 1.0, np.sin(angle) / np.where(angle == 0.0, 1.0, angle))


def _norm(v: Array) -> Array:
    """|v| over the last axis, which is kept, without underflow or overflow of the squares."""
    scale = np.max(np.abs(v), axis=-1, keepdims=True)
    safe = np.where(scale == 0.0, 1.0, scale)
    return scale * np.sqrt(np.sum((v / safe) ** 2, axis=-1, keepdims=True))


def normalised(v: Array) -> Array:
    """v / |v| over the last axis.

    Shapes: (..., k) -> (..., k). A zero vector gives NaN.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return v / _norm(v)


def exp_matrix(rotation_vector: Array) -> Array:
    """exp([a u]x) = I + sin(a) [u]x + 2 sin^2(a/2) [u]x^2 (Rodrigues 1840).

    Shapes: (..., 3) rotation vector a u in rad -> (..., 3, 3).
    """
    angle = _norm(rotation_vector)[..., None]
    k = hat(rotation_vector)
    half_sinc = _sin_over(0.5 * angle)
    return np.eye(3) + _sin_over(angle) * k + 0.5 * half_sinc**2 * (k @ k)


def exp_quaternion(rotation_vector: Array) -> Array:
    """exp(a u / 2) = (cos(a/2), sin(a/2) u).

    Shapes: (..., 3) rotation vector a u in rad -> (..., 4).
    """
    half = 0.5 * _norm(rotation_vector)
    return np.concatenate([np.cos(half), 0.5 * _sin_over(half) * rotation_vector], axis=-1)


def log_quaternion(q: Array) -> Array:
    """a u with exp(a u / 2) = q or -q, angle 0 <= a <= pi: a = 2 atan2(|q_vec|, |q_w|).

    Shapes: (..., 4), of any non-zero norm -> (..., 3) rotation vector in rad.
    """
    w, vector = q[..., :1], q[..., 1:]
    vector = np.where(w < 0.0, -vector, vector)
    w = np.abs(w)
    sine = _norm(vector)
    safe = np.where(sine == 0.0, 1.0, sine)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(sine == 0.0, 2.0 / w, 2.0 * np.arctan2(sine, w) / safe)
    return factor * vector


def log_matrix(rotation: Array) -> Array:
    """a u with exp([a u]x) = R, angle 0 <= a <= pi.

    Shapes: (..., 3, 3) rotation matrix -> (..., 3) rotation vector in rad. At a = pi either sign of u.
    """
    return log_quaternion(matrix_to_quaternion(rotation))


def quaternion_product(p: Array, q: Array) -> Array:
    """p q (Hamilton): the rotation by q followed by the rotation by p.

    Shapes: (..., 4), (..., 4) -> (..., 4).
    """
    pw, px, py, pz = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    qw, qx, qy, qz = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    product = np.empty(np.broadcast_shapes(p.shape, q.shape))
    product[..., 0] = pw * qw - px * qx - py * qy - pz * qz
    product[..., 1] = pw * qx + px * qw + py * qz - pz * qy
    product[..., 2] = pw * qy - px * qz + py * qw + pz * qx
    product[..., 3] = pw * qz + px * qy - py * qx + pz * qw
    return product


def right_factor(q: Array) -> Array:
    """M with p q = M p: the matrix of right multiplication by q, to be applied to many p.

    Shapes: (4,) -> (4, 4).
    """
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


def conjugate(q: Array) -> Array:
    """(w, -x, -y, -z), the inverse of a unit quaternion.

    Shapes: (..., 4) -> (..., 4).
    """
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def quaternion_to_matrix(q: Array) -> Array:
    """R with R v = q v q^-1, for q of any non-zero norm.

    Shapes: (..., 4) -> (..., 3, 3).
    """
    unit = normalised(np.asarray(q, dtype=np.float64))
    w, x, y, z = unit[..., 0], unit[..., 1], unit[..., 2], unit[..., 3]
    matrix = np.empty((*unit.shape[:-1], 3, 3))
    matrix[..., 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    matrix[..., 0, 1] = 2.0 * (x * y - w * z)
    matrix[..., 0, 2] = 2.0 * (x * z + w * y)
    matrix[..., 1, 0] = 2.0 * (x * y + w * z)
    matrix[..., 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    matrix[..., 1, 2] = 2.0 * (y * z - w * x)
    matrix[..., 2, 0] = 2.0 * (x * z - w * y)
    matrix[..., 2, 1] = 2.0 * (y * z + w * x)
    matrix[..., 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return matrix


def matrix_to_quaternion(rotation: Array) -> Array:
    """q with R v = q v q^-1 and its largest component positive (Shepperd 1978).

    Shapes: (..., 3, 3) rotation matrix -> (..., 4) unit quaternion.
    """
    r = np.asarray(rotation, dtype=np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    skew = 2.0 * vee(r)
    # rows of 4 q q^T; the row of the largest component is free of cancellation
    outer = np.empty((*r.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1.0 + trace
    outer[..., 0, 1:] = outer[..., 1:, 0] = skew
    outer[..., 1:, 1:] = r + np.swapaxes(r, -1, -2)
    for i in range(3):
        outer[..., i + 1, i + 1] = 1.0 + 2.0 * diagonal[..., i] - trace
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    return normalised(row)


def rotate(q: Array, v: Array) -> Array:
    """R(q) v: components in body axes to components in world axes.

    Shapes: (..., 4), (..., 3) -> (..., 3).
    """
    return np.einsum("...ij,...j->...i", quaternion_to_matrix(q), v)


def quaternion_rate(q: Array, omega_world: Array) -> Array:
    """q' = 1/2 omega q, omega in world axes as a pure quaternion.

    Shapes: (..., 4), (..., 3) in rad/s -> (..., 4) in 1/s.
    """
    pure = np.concatenate([np.zeros_like(omega_world[..., :1]), omega_world], axis=-1)
    return 0.5 * quaternion_product(pure, q)


def rotation_rate(rotation: Array, omega_world: Array) -> Array:
    """R' = [omega]x R, omega in world axes.

    Shapes: (..., 3, 3), (..., 3) in rad/s -> (..., 3, 3) in 1/s.
    """
    return hat(omega_world) @ rotation


def geodesic_angle(p: Array, q: Array) -> Array:
    """2 atan2(|v|, |p . q|), v the vector part of p^-1 q, computed from d = q - p or q + p.

    v = p_w d_v - d_w p_v - p_v x d_v. The difference of nearby quaternions is exact, and an error of a norm
    lies along p and drops out. Angles of 1e-16 are therefore resolved, without loss of accuracy at pi. p and
    q may have any non-zero norms; q and -q are equivalent.

    Shapes: (..., 4), (..., 4) -> (...) in rad, 0 to pi.
    """
    p, q = _of_ordinary_size(p), _of_ordinary_size(q)
    dot = np.sum(p * q, axis=-1)
    d = np.where(dot[..., None] < 0.0, -q, q) - p
    vector = p[..., :1] * d[..., 1:] - d[..., :1] * p[..., 1:] - cross(p[..., 1:], d[..., 1:])
    return 2.0 * np.arctan2(_norm(vector)[..., 0], np.abs(dot))


def cross(a: Array, b: Array) -> Array:
    """a x b (..., 3), the same numbers as numpy.cross in half the time."""
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def _of_ordinary_size(q: Array) -> Array:
    """Return q, scaled by a power of 2 where its norm is far from 1."""
    size = np.max(np.abs(q), axis=-1, keepdims=True)
    if np.all((size >= 0.125) & (size < 4.0)):
        return q
    _, exponent = np.frexp(size)
    return np.ldexp(q, np.where(np.abs(exponent) > 2, -exponent, 0))


def project_to_so3(matrix: Array) -> Array:
    """U diag(1, 1, det(U V^T)) V^T of the SVD U S V^T: the nearest rotation in the Frobenius norm.

    Shapes: (..., 3, 3) -> (..., 3, 3) with det = +1; NaN for a matrix that is not finite. Source: Kabsch
    (1978); Higham (1986).
    """
    finite = np.isfinite(matrix).all(axis=(-2, -1))
    if not finite.all():  # the SVD of LAPACK may fail, or never end
        nearest = np.full(np.shape(matrix), np.nan)
        nearest[finite] = project_to_so3(matrix[finite])
        return nearest
    u, _, vt = np.linalg.svd(matrix)
    u = u.copy()
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt
