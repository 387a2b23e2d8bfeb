"""Single rows of a recording that stand out of its white noise.

Where each row is off by noise e(k) beside an error that changes slowly, the second differences of the errors
have the autocovariances 6, -4, 1 times the variance of e, and a wrong row is as far from both rows beside it.
"""

from __future__ import annotations

import math

import numpy as np

from bodycheck.recordings.judged_motion import JudgedMotion
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, log_quaternion, normalised, quaternion_product
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.measures import ORIENTATION

_FEWEST = 50  # rows
_FEW = 0.01  # of the rows
_MOST = 0.95  # of the rows, which are noise
_OUT = 4.0  # times what most of the rows are within: 14 deviations
_RESOLVED = 3.0  # times what the file resolves
_SAME = 0.1  # of the correlation of neighbours


def rows_out_of_noise(motion: JudgedMotion, measure: str) -> tuple[tuple[int, ...], Array, float] | None:
    """Return the rows that stand out, the distance (n,) of all from those beside it, and the noise.

    The standard deviation of the noise is that of a component, in SI units. None where there is no noise, or
    where no row, or more than a few, stand out.
    """
    quantity, resolution = _QUANTITY[measure], motion.resolution
    n = motion.problem.compared
    if n < _FEWEST or motion.case.trajectory is None:
        return None
    steps = _steps_of_error(quantity, motion.case.trajectory, motion.problem.truth.trajectory)[: n - 1]
    bends = np.diff(steps, axis=0)  # (n - 2, 3): second differences of the errors
    sizes = np.linalg.norm(bends, axis=-1)
    apart = np.minimum(np.linalg.norm(steps[1:], axis=-1), np.linalg.norm(steps[:-1], axis=-1))
    limit = max(_OUT * 0.5 * float(np.quantile(sizes, _MOST)), _RESOLVED * getattr(resolution, quantity))
    is_off = (apart > limit) & (np.sum(steps[1:] * steps[:-1], axis=-1) < 0.0)
    off = 1 + np.flatnonzero(is_off)
    if not 0 < len(off) <= max(1.0, _FEW * n):
        return None
    is_noise = ~np.convolve(is_off, np.ones(5), mode="same").astype(bool)
    energy = float(np.mean(bends[is_noise] ** 2))
    both = is_noise[1:] & is_noise[:-1]
    neighbours = float(np.mean(bends[1:][both] * bends[:-1][both]))
    if abs(neighbours + 4.0 / 6.0 * energy) > _SAME * energy:
        return None
    return tuple(off.tolist()), np.pad(0.5 * sizes, 1), math.sqrt(energy / 6.0)


_QUANTITY = {
    ORIENTATION: "attitude",
    "omega_error": "omega",
    "position_error": "position",
    "velocity_error": "velocity",
}


def _steps_of_error(quantity: str, path: Trajectory, truth: Trajectory) -> Array:
    """Return how an error changes from row to row (n - 1, 3), that of the attitude in world axes."""
    if quantity == "attitude":
        off = quaternion_product(normalised(path.attitude), conjugate(normalised(truth.attitude)))
        return log_quaternion(quaternion_product(off[1:], conjugate(off[:-1])))
    name = {"omega": "omega_body", "position": "position_m", "velocity": "velocity_m_s"}[quantity]
    return np.asarray(np.diff(getattr(path, name) - getattr(truth, name), axis=0))
