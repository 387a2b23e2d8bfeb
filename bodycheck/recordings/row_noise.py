"""White noise of the rows of a recording, and single rows that stand out of it.

Where each row is off by noise e(k) beside an error that changes slowly, the second differences of the errors
have the autocovariances 6, -4, 1 times the variance of e, and a wrong row is as far from both rows around it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, log_quaternion, normalised, quaternion_product
from bodycheck.reference_impl.trajectory import Trajectory

_FEWEST = 50  # rows
_FEW = 0.01  # of the rows
_MOST = 0.95  # of the rows, which are noise
_OUT = 4.0  # times what most of the rows are within: 14 deviations
_RESOLVED = 3.0  # times what the file resolves
_SAME = 0.1  # of the correlation of neighbours


@dataclass(frozen=True, eq=False)
class RowNoise:
    """The noise of a quantity: the standard deviation of a component, in SI units.

    off: the rows that stand out of it. apart (n,): the distance of each row from the middle of those around
    it.
    """

    deviation: float
    off: tuple[int, ...]
    apart: Array


def row_noise(quantity: str, path: Trajectory, truth: Trajectory, n: int, spacing: float) -> RowNoise | None:
    """Return the noise of a quantity in the first n rows; None where they are not off by white noise.

    truth: at the times of the recording. spacing: of the numbers of the quantity, which noise exceeds.
    """
    if n < _FEWEST:
        return None
    steps = _steps_of_error(quantity, path, truth, n)
    bends = np.diff(steps, axis=0)  # (n - 2, 3): second differences of the errors
    sizes = np.linalg.norm(bends, axis=-1)
    apart = np.minimum(np.linalg.norm(steps[1:], axis=-1), np.linalg.norm(steps[:-1], axis=-1))
    limit = max(_OUT * 0.5 * float(np.quantile(sizes, _MOST)), _RESOLVED * spacing)
    # the rows on either side are near to each other: what changes from one row on is no single row
    is_back = np.linalg.norm(steps[1:] + steps[:-1], axis=-1) < 0.5 * apart
    is_off = (apart > limit) & is_back
    off = 1 + np.flatnonzero(is_off)
    if len(off) > max(1.0, _FEW * n):
        return None
    is_noise = ~np.convolve(is_off, np.ones(5), mode="same").astype(bool)
    energy = float(np.mean(bends[is_noise] ** 2))
    both = is_noise[1:] & is_noise[:-1]
    neighbours = float(np.mean(bends[1:][both] * bends[:-1][both]))
    if abs(neighbours + 4.0 / 6.0 * energy) > _SAME * energy:
        return None
    return RowNoise(math.sqrt(energy / 6.0), tuple(off.tolist()), np.pad(0.5 * sizes, 1))


def _steps_of_error(quantity: str, path: Trajectory, truth: Trajectory, n: int) -> Array:
    """Return how an error changes from row to row (n - 1, 3), that of the attitude in world axes."""
    if quantity == "attitude":
        off = quaternion_product(normalised(path.attitude[:n]), conjugate(normalised(truth.attitude[:n])))
        return log_quaternion(quaternion_product(off[1:], conjugate(off[:-1])))
    name = {"omega": "omega_body", "position": "position_m", "velocity": "velocity_m_s"}[quantity]
    return np.asarray(np.diff(getattr(path, name)[:n] - getattr(truth, name)[:n], axis=0))
