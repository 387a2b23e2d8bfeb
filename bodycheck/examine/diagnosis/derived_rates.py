"""Angular velocity of a recording that has attitudes alone, by their derivative, and how far it is known.

About sample k the rotation vectors log(q_k* q_j) are fitted by polynomials of the time; their slope at t_k is
omega in body axes. A wider window leaves less of the rounding of the attitudes, and more of what the
polynomial does not follow, which the difference of two degrees shows; the best window of both is taken.

Source: Savitzky and Golay (1964), Analytical Chemistry 36, 1627.
"""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, log_quaternion, normalised, quaternion_product

_HALF_WIDTHS = (2, 3, 4, 6, 8, 12, 16, 24, 32)  # samples on each side
_DEGREES = (4, 6)
_LARGEST_TURN_RAD = 2.5  # within a window: beyond pi, rotation vectors are ambiguous
_FEWEST = 3
_DECIMALS = 12


def derived_rates(t_s: Array, attitude: Array, resolution_rad: float) -> tuple[Array, float] | None:
    """Return omega (n, 3) in body axes, rad/s, of attitudes (n, 4), and the spacing of its components.

    resolution_rad: the spacing of the attitudes. None for fewer than three samples.
    """
    n, q = len(t_s), normalised(attitude)
    if n < _FEWEST:
        return None
    best: tuple[Array, float] | None = None
    for half in _HALF_WIDTHS:
        width = min(2 * half + 1, n)
        first = np.clip(np.arange(n) - half, 0, n - width)
        window = first[:, None] + np.arange(width)
        turned = log_quaternion(quaternion_product(conjugate(q)[:, None], q[window]))
        if best is not None and np.max(np.linalg.norm(turned, axis=-1)) > _LARGEST_TURN_RAD:
            break
        away_s = t_s[window] - t_s[:, None]
        low, high = (min(degree, width - 2 + index) for index, degree in enumerate(_DEGREES))
        weights = _slope_weights(away_s, low)
        coarser = np.einsum("nw,nwi->ni", weights, turned)
        finer = np.einsum("nw,nwi->ni", _slope_weights(away_s, high), turned)
        rounding = resolution_rad * np.linalg.norm(weights, axis=-1)
        missed = math.sqrt(12.0) * np.max(np.abs(finer - coarser), axis=-1)
        spacing = float(np.max(np.hypot(rounding, missed)))
        if best is None or spacing < best[1]:
            best = coarser, spacing
        if width == n:
            break
    return best


def _slope_weights(away_s: Array, degree: int) -> Array:
    """Return the weights (n, w) with which values at times (n, w) from 0 give their slope at 0."""
    scale = np.max(np.abs(away_s), axis=-1, keepdims=True)
    # where stamps are even, most windows are the same
    windows, which = np.unique(np.round(away_s / scale, _DECIMALS), axis=0, return_inverse=True)
    slopes = np.linalg.pinv(windows[..., None] ** np.arange(degree + 1))[:, 1]
    return np.asarray(slopes[which.ravel()] / scale)
