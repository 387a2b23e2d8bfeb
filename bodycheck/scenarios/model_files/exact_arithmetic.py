"""40-digit arithmetic for the mass properties of model files: rotations, frames and composites.

Vectors (3,) and matrices (3, 3) are NumPy arrays of mpmath numbers. Decimal numbers of a file are first
rounded to doubles, as every engine does.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeAlias

import numpy as np
from mpmath import MPContext
from numpy.typing import NDArray

from bodycheck._util.untrusted import number_of
from bodycheck.reference_impl.arrays import Array

Exact: TypeAlias = NDArray[np.object_]
"""An array of numbers of `mp`."""

mp: Any = MPContext()
mp.dps = 40

_AXES = "xyz"
_BLANK = re.compile(r"[ \t\r\n]+")


def exact(values: Any) -> Exact:
    """Return doubles as an array of the same shape of 40-digit numbers."""
    given = np.asarray(values, dtype=np.float64)
    return np.array([mp.mpf(float(x)) for x in given.flat], dtype=object).reshape(given.shape)


def doubles(values: Exact) -> Array:
    """Return the nearest doubles, in an array of the same shape."""
    return np.asarray(values, dtype=np.float64)


def identity() -> Exact:
    """Return 1 (3, 3)."""
    return _IDENTITY.copy()


_IDENTITY = exact(np.eye(3))


def norm(v: Exact) -> Any:
    """|v|."""
    return mp.sqrt(v @ v)


def rotation_about(axis: Exact, angle: Any) -> Exact:
    """1 + sin(a) [u] + (1 - cos(a)) [u]^2, u = axis / |axis| (Rodrigues)."""
    x, y, z = axis / norm(axis)
    zero = mp.mpf(0)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]], dtype=object)
    # numbers of mpmath come last in products: before an array they are slow
    return identity() + cross * mp.sin(angle) + (cross @ cross) * (1 - mp.cos(angle))


def rotation_of_rpy(rpy: Sequence[float]) -> Exact:
    """R_z(yaw) R_y(pitch) R_x(roll): fixed axes, as in URDF; radians."""
    if not any(rpy):
        return identity()
    (cr, sr), (cp, sp), (cy, sy) = (mp.cos_sin(mp.mpf(angle)) for angle in rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ],
        dtype=object,
    )


def rotation_of_euler(angles: Sequence[Any], sequence: str) -> Exact:
    """Return the product of three rotations about the axes of a sequence, in radians.

    Lower case: each about the rotated axis, R1 R2 R3; upper case: each about the fixed axis, R3 R2 R1.
    """
    found = identity()
    for angle, name in zip(angles, sequence, strict=True):
        axis = exact(np.eye(3)[_AXES.index(name.lower())])
        turn = rotation_about(axis, angle)
        found = found @ turn if name.islower() else turn @ found
    return found


def rotation_of_quaternion(quaternion: Sequence[float]) -> Exact:
    """R(q / |q|) for q = (w, x, y, z) of any non-zero norm."""
    w, x, y, z = exact(quaternion)
    s = 2 / (w * w + x * x + y * y + z * z)
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ],
        dtype=object,
    )


def rotation_of_axes(x: Exact, y: Exact) -> Exact:
    """Return the rotation whose first axis is along x and whose second is along y made normal to x."""
    first = x / norm(x)
    second = y - (first @ y) * first
    second = second / norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=1)


def rotation_to(z: Exact) -> Exact:
    """Return the smallest rotation that takes (0, 0, 1) to z / |z|."""
    target = z / norm(z)
    axis = np.array([-target[1], target[0], mp.mpf(0)], dtype=object)
    length = norm(axis)
    if length == 0:
        return identity() if target[2] > 0 else exact(np.diag([1.0, -1.0, -1.0]))
    return rotation_about(axis, mp.atan2(length, target[2]))


@dataclass(frozen=True, eq=False)
class Frame:
    """x_parent = R x + p: the pose of a frame in its parent."""

    rotation: Exact
    position: Exact

    @classmethod
    def of(cls, position: Sequence[float] = (0.0, 0.0, 0.0), rotation: Exact | None = None) -> Frame:
        """Return the frame at a position in m with a rotation [default: none]."""
        return cls(identity() if rotation is None else rotation, exact(position))

    def inverse(self) -> Frame:
        """Return the pose of the parent in this frame."""
        return Frame(self.rotation.T, -(self.rotation.T @ self.position))

    def __matmul__(self, inner: Frame) -> Frame:
        """Return the pose, in this frame's parent, of a frame given in this frame."""
        return Frame(self.rotation @ inner.rotation, self.rotation @ inner.position + self.position)


@dataclass(frozen=True, eq=False)
class ExactInertia:
    """Mass in kg, centre of mass (3,) in m and tensor (3, 3) about it in kg m^2, in the axes of one frame."""

    mass: Any
    centre: Exact
    tensor: Exact

    def placed(self, frame: Frame) -> ExactInertia:
        """c' = R c + p, I' = R I R^T: the same body in the parent of `frame`."""
        turned = frame.rotation @ self.tensor @ frame.rotation.T
        return ExactInertia(self.mass, frame.rotation @ self.centre + frame.position, turned)

    def steiner(self, arm: Exact) -> Exact:
        """m (|d|^2 1 - d d^T) for an arm d (3,)."""
        return (identity() * (arm @ arm) - np.outer(arm, arm)) * self.mass

    @property
    def moments(self) -> Array:
        """The principal moments (3,), ascending, correct to double precision."""
        return doubles(np.array(sorted(_eigenvalues(self.tensor)), dtype=object))


def _eigenvalues(tensor: Exact) -> list[Any]:
    return list(mp.eigsy(mp.matrix(tensor.tolist()), eigvals_only=True))


def composite(parts: Iterable[ExactInertia]) -> ExactInertia:
    """m = sum m_k, c = sum m_k c_k / m, I = sum I_k + m_k (|d_k|^2 1 - d_k d_k^T), d_k = c_k - c.

    All parts are in the same axes. The centre of a composite without mass is the origin.
    """
    bodies = list(parts)
    mass = sum((body.mass for body in bodies), mp.mpf(0))
    zero = exact(np.zeros(3))
    centre = reduce(lambda s, body: s + body.centre * body.mass, bodies, zero) / mass if mass else zero
    tensor = exact(np.zeros((3, 3)))
    for body in bodies:
        tensor = tensor + body.tensor + body.steiner(body.centre - centre)
    return ExactInertia(mass, centre, tensor)


def words_of(text: str) -> list[str]:
    """Return the words of an attribute; str.split() would also split at no-break spaces, unlike engines."""
    return [word for word in _BLANK.split(text) if word]


def finite(text: str, count: int | None = None) -> list[float]:
    """Return the numbers of an attribute; raises ValueError if they are not `count` finite numbers."""
    try:
        values = [number_of(word) for word in words_of(text)]
    except ValueError:
        values = [math.nan]
    if not all(math.isfinite(value) for value in values) or (count is not None and len(values) != count):
        amount = (
            "finite numbers"
            if count is None
            else "a finite number"
            if count == 1
            else f"{count} finite numbers"
        )
        raise ValueError(f"{text!r:.60} (expected {amount})")
    return values
