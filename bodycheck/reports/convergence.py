"""What the cases of one method say together: the observed order, the round-off floor, the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

LARGEST_ERROR = 0.3  # rad, or of the scale: beyond it an error says nothing about the order
LEAST_POINTS = 4
ABOVE_FLOOR = 10.0
LARGEST_LIMIT = LARGEST_ERROR / 100.0  # where even the truth, or round-off, is that far off, nothing shows
_PLATEAU_DECADES = 2.0
_PLATEAU_SPREAD = 2.0
_SETTLED = 0.1  # of the error: two steps whose motions agree this well have converged to something
_WIDEST_ORDERS = (0.05, 0.1, 0.25)  # half-widths of its interval at which an order is settled, best first
_LEAST_ORDER = 0.5
LARGEST_ROUND_OFF = 1e-9  # an error above it that stops shrinking is no round-off in double precision


@dataclass(frozen=True)
class Point:
    """One case of a method: its step, its error, and how far it moved from the next coarser step.

    settling is the largest angle to that coarser case over the orientation error; None without one.
    error is None where the case did not end well.
    """

    dt_s: float
    error: float | None
    settling: float | None = None


@dataclass(frozen=True)
class Convergence:
    """The observed order with its 95 % interval, the points it rests on, the floor, and the verdict."""

    verdict: str
    points: int
    floor: float
    order: float | None = None
    order_low: float | None = None
    order_high: float | None = None


def usable(points: list[Point], floor: float) -> list[Point]:
    """Return the points that an order can rest on, coarsest first: 10 floor < error < 0.3."""
    return [
        p
        for p in sorted(points, key=lambda p: -p.dt_s)
        if p.error is not None and ABOVE_FLOOR * floor < p.error < LARGEST_ERROR
    ]


def round_off_floor(points: list[Point], limit: float) -> float:
    """Return the limit, or the error at which finer steps stopped helping, if that is small as round-off.

    limit: the larger of 3 times the truth's bound and eps times the motion's sensitivity.

    Where a finer step gains less than order 1/2 would, on errors that round-off can make, both errors
    lie on the floor.
    """
    floor = limit
    errors = [(p.dt_s, p.error) for p in sorted(points, key=lambda p: p.dt_s) if p.error is not None]
    for (fine_dt, finer), (coarse_dt, coarser) in pairwise(errors):
        if coarser < min(finer * math.sqrt(coarse_dt / fine_dt), LARGEST_ROUND_OFF):
            floor = max(floor, finer, coarser)
    return floor


def convergence_of(points: list[Point], limit: float) -> Convergence:
    """Return order and verdict of one quantity from the cases of one method on one scenario.

    points in any order; limit as for round_off_floor.
    """
    if limit > LARGEST_LIMIT:
        return Convergence("chaotic", 0, limit)
    ended = [p for p in points if p.error is not None]
    if not ended:
        return Convergence("unstable", 0, limit)
    floor = round_off_floor(points, limit)
    fit = usable(points, floor)
    count = len(fit)
    if found := _settled_order(fit):
        points_used, order, half_width = found
        return Convergence("converges", points_used, floor, order, order - half_width, order + half_width)
    if all(p.error <= ABOVE_FLOOR * floor for p in ended if p.error is not None):
        return Convergence("at-floor", count, floor)
    if _is_plateau(ended, floor):
        return Convergence("does-not-converge", count, floor)
    saturated = any(p.error >= LARGEST_ERROR for p in ended if p.error is not None)
    if count >= LEAST_POINTS or saturated or len(ended) < len(points):
        return Convergence("pre-asymptotic", count, floor)
    return Convergence("too-few-points", count, floor)


def obedience_of(points: list[Point], limit: float) -> Convergence:
    """Return the verdict on a method told a tolerance: its errors are to fall with it, down to the floor.

    points: dt_s is the tolerance; limit as for round_off_floor. An order in the step is not to be had.
    """
    if limit > LARGEST_LIMIT:
        return Convergence("chaotic", 0, limit)
    ended = sorted((p.dt_s, p.error) for p in points if p.error is not None)
    if not ended:
        return Convergence("unstable", 0, limit)
    count = len(usable(points, limit))
    (finest, least), (coarsest, largest) = ended[0], ended[-1]
    if largest <= ABOVE_FLOOR * limit:
        return Convergence("at-floor", count, limit)
    if least <= ABOVE_FLOOR * limit or least < largest * (finest / coarsest) ** _LEAST_ORDER:
        return Convergence("converges", count, limit)
    few = math.log10(coarsest / finest) < _PLATEAU_DECADES
    return Convergence("too-few-points" if few else "does-not-converge", count, limit)


def is_flat(points: list[Point], floor: float) -> bool:
    """Whether the errors, well above the floor, hardly shrink from the coarsest to the finest step."""
    ended = [p for p in sorted(points, key=lambda p: -p.dt_s) if p.error is not None]
    if len(ended) < 2:
        return False
    errors = [p.error for p in ended if p.error is not None]
    return min(errors) > ABOVE_FLOOR * floor and errors[0] < _PLATEAU_SPREAD * errors[-1]


def decades(points: list[Point]) -> float:
    """Return log10 of the coarsest over the finest step."""
    steps = [p.dt_s for p in points]
    return math.log10(max(steps) / min(steps))


def _is_plateau(ended: list[Point], floor: float) -> bool:
    """Whether errors stay flat over two decades of step while the motion itself has settled.

    An error that is merely saturated is flat too, but there finer steps still change the motion.
    """
    finest = min(ended, key=lambda p: p.dt_s)
    return (
        decades(ended) >= _PLATEAU_DECADES - 1e-6
        and is_flat(ended, floor)
        and finest.settling is not None
        and finest.settling <= _SETTLED
    )


def _settled_order(points: list[Point]) -> tuple[int, float, float] | None:
    """Return number of points, order and half-width of the longest run of steps that agree on an order.

    The coarsest steps may not be asymptotic yet and the finest may feel round-off: of runs of the same
    length the finer is taken, and a tighter interval goes before a longer run.
    """
    runs = [
        points[first : first + length]
        for length in range(len(points), LEAST_POINTS - 1, -1)
        for first in range(len(points) - length, -1, -1)
    ]
    slopes = [(len(run), *_slope(run)) for run in runs]
    for widest in _WIDEST_ORDERS:
        for found in slopes:
            if found[2] <= widest and found[1] >= max(_LEAST_ORDER, found[2]):
                return found
    return None


def _slope(points: list[Point]) -> tuple[float, float]:
    """Return d log(error) / d log(dt) by least squares, and the half-width of its 95 % interval."""
    x = np.log([p.dt_s for p in points])
    y = np.log(np.array([p.error for p in points], dtype=np.float64))
    deviation = x - x.mean()
    spread = float(deviation @ deviation)
    slope = float(deviation @ y) / spread
    residual = y - y.mean() - slope * deviation
    freedom = len(points) - 2
    error = math.sqrt(float(residual @ residual) / freedom / spread)
    return slope, _student(freedom) * error


@cache
def _student(freedom: int) -> float:
    """Return what Student's t exceeds, in size, in one of twenty cases."""
    from scipy.special import stdtrit  # late: half a second

    return float(stdtrit(freedom, 0.975))
