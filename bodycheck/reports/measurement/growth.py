"""How a drift grows with time: bounded, as sqrt(t), linear, quadratic or exponential.

The exponent is the slope of log M against log t over the last two decades of time, where M(t) is the largest
drift up to t. The energy error of a symplectic method is bounded (Hairer, Lubich and Wanner 2006, Geometric
Numerical Integration, IX.8), unbiased round-off grows as sqrt(t) (Brouwer 1937, Astron. J. 46, 149), and the
secular error of a method is linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array

_DECADES = 2.0  # of time that are fitted
_MIN_DECADES = 1.5
_MIN_SAMPLES = 100
_PIECES = 4  # of these decades, whose slopes give the interval
_POINTS = 40  # of the fit
_STUDENT = 3.182446305284263  # quantile for 3 degrees of freedom, two-sided 95 %
_STEADY_BANDS = {"linear": (0.85, 1.2), "quadratic": (1.75, 2.3)}
_STEADY_SLACK = 0.1  # by which the last decade alone may leave the band
_ROOT_BAND = (0.25, 0.75)
_ROOT_LATE = 0.2  # smallest slope over the last decade: extremes of pure noise grow more slowly
_FLAT = 0.1  # a smaller slope over the last decade counts as zero
_LARGEST_BOUNDED = 0.25  # overall slope, which includes the first oscillation
_RAMP = 0.85  # a steeper first slope is an oscillation that has not turned back yet, not sqrt(t)
_STEEPEST = 1.5  # slope of a random walk; a steeper one is a jump
_MIN_EXPONENTIAL = 1.5  # slope at the end
_EXPONENTIAL_GAIN = 3.0  # ratio of the misfits in log t and t: a random walk may end steeply too


@dataclass(frozen=True)
class Growth:
    """The kind of growth and its exponent with a 95 % interval; None where undetermined."""

    growth: str | None = None
    growth_exponent: float | None = None
    growth_exponent_low: float | None = None
    growth_exponent_high: float | None = None


def growth_of(t_s: Array, drift: Array, floor: float) -> Growth:
    """Return how a drift >= 0 (n,) grows over the times t_s (n,), ascending from 0.

    floor: smallest meaningful drift, in the unit of the drift. The kind is None where the drift is above the
    floor for fewer than 1.5 decades of time, or where the series fits no kind.
    """
    largest = np.maximum.accumulate(drift)
    above = (t_s >= t_s[-1] / 10.0**_DECADES) & (largest > floor)
    if np.count_nonzero(above) < _MIN_SAMPLES or t_s[-1] < t_s[above][0] * 10.0**_MIN_DECADES:
        return Growth()
    t, m = t_s[above], largest[above]
    x = np.linspace(np.log(t[0]), np.log(t[-1]), _POINTS)
    y = np.interp(x, np.log(t), np.log(m))
    exponent, misfit = _line(x, y)
    cuts = np.linspace(x[0], x[-1], _PIECES + 1)
    levels = np.interp(cuts, x, y)
    slopes = np.diff(levels) / np.diff(cuts)
    half_width = _STUDENT * float(np.std(slopes, ddof=1)) / math.sqrt(_PIECES)
    late, _ = _line(*_last_decade(x, y))
    kind = (
        _power_law(exponent, late)
        or _random_walk_like(exponent, late, slopes)
        or _exponential(x, y, slopes, misfit)
    )
    return Growth(kind, exponent, exponent - half_width, exponent + half_width)


def _last_decade(x: Array, y: Array) -> tuple[Array, Array]:
    last = x >= x[-1] - np.log(10.0)
    return x[last], y[last]


def _power_law(exponent: float, late: float) -> str | None:
    """Return the power of t on which the whole series and its last decade agree."""
    for kind, (low, high) in _STEADY_BANDS.items():
        if low <= exponent <= high and low - _STEADY_SLACK <= late <= high + _STEADY_SLACK:
            return kind
    return None


def _random_walk_like(exponent: float, late: float, slopes: Array) -> str | None:
    """Return "bounded" for no growth at the end, "sqrt" for the irregular growth of a random walk."""
    if exponent < _LARGEST_BOUNDED and late < _FLAT:
        return "bounded"
    low, high = _ROOT_BAND
    irregular = slopes[0] < _RAMP and slopes[-1] > _FLAT and float(np.max(slopes)) < _STEEPEST
    return "sqrt" if low <= exponent <= high and late > _ROOT_LATE and irregular else None


def _exponential(x: Array, y: Array, slopes: Array, misfit: float) -> str | None:
    """Return "exponential" where log M is much closer to a line in t than in log t."""
    if slopes[-1] < _MIN_EXPONENTIAL or not np.all(np.diff(slopes[1:]) > 0.0):
        return None
    _, misfit_in_time = _line(np.exp(x), y)
    return "exponential" if misfit_in_time * _EXPONENTIAL_GAIN < misfit else None


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Return the least-squares slope of y against x, and the root mean square of the residual."""
    deviation = x - x.mean()
    slope = float(deviation @ y) / float(deviation @ deviation)
    residual = y - y.mean() - slope * deviation
    return slope, float(np.sqrt(np.mean(residual * residual)))
