"""Exact motions and small rotations, with numpy alone: no engine and no bodycheck."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TOP = np.array([2.0, 2.0, 1.0])
"""Principal moments of a symmetric top in kg m^2."""
SPIN = np.array([0.6, 0.0, 3.0])
"""Its omega at the start in rad/s, in body axes, which are the world's at the start."""


def rotation(vector: Array) -> Array:
    """R = exp([vector]x) by Rodrigues' formula; the vector in rad, the result (3, 3)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def of_quaternion(w: float, x: float, y: float, z: float) -> Array:
    """R of a quaternion, scalar first, of any length."""
    n = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def angle(first: Array, second: Array) -> float:
    """Angle of first^T second in rad, accurate near 0."""
    turn = first.T @ second
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return math.atan2(float(np.linalg.norm(axis)), float(np.trace(turn)) - 1.0)


def top(t: float) -> Array:
    """Attitude of the free symmetric top after t s: R = exp(t L / I1) exp(t omega_3 (1 - I3 / I1) e_z)."""
    momentum = TOP * SPIN
    nutation = rotation(t * momentum / TOP[0])
    return nutation @ rotation(np.array([0.0, 0.0, t * SPIN[2] * (1.0 - TOP[2] / TOP[0])]))


def order(coarse: float, fine: float, ratio: float = 2.0) -> float:
    """Order of an error that falls from coarse to fine as the step is divided by ratio."""
    return math.log(coarse / fine) / math.log(ratio)
