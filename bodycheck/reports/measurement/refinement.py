"""Choose the next step so that an order becomes visible: finer where errors are large, else coarser."""

from __future__ import annotations

from collections.abc import Sequence

from bodycheck.reports.measurement.convergence import (
    LARGEST_ERROR,
    Judged,
    Point,
    convergence_of,
    round_off_floor,
    usable,
)
from bodycheck.reports.measurement.order import LEAST_POINTS

_LEADING = (1, 2, 5)
_MOST_STEPS = 200_000  # of one case
_SPAN = 100.0  # ratio of the coarsest requested step to the finest one tried
_FLAT_SPREAD = 2.0


def next_step_size(
    points: Sequence[Point],
    how: Judged,
    listed: Sequence[float],
    interval_s: float,
    duration_s: float,
    *,
    needs_order: bool = True,
) -> float | None:
    """Return a further step in s that divides the sampling interval, or None if none is needed.

    points: the errors of one quantity so far. how: how it is judged. listed: the requested steps.
    needs_order: whether an order must be found even if only coarser steps have an error above the floor.
    """
    found = convergence_of(points, how)
    decided = found.verdict in ("does-not-converge", "chaotic") or found.order is not None
    if decided or (not needs_order and found.is_decided):
        return None
    floor = round_off_floor(points, how.floor)
    strides = sorted(round(interval_s / p.dt_s) for p in points)
    reached = found.verdict == "at-precision-floor"
    if _too_fine(points, floor, reached=reached):
        coarser = [n for n in _round_numbers(strides[0]) if n < strides[0]]
        return interval_s / max(coarser) if needs_order and coarser else None
    if reached:
        return None
    finest = min(points, key=lambda p: p.dt_s)
    if finest.error is not None and finest.error <= floor:
        return None
    finer = min(n for n in _round_numbers(20 * strides[-1]) if n > strides[-1])
    too_many = finer * duration_s / interval_s > _MOST_STEPS
    too_fine = max(listed) * finer / interval_s > _SPAN * (1.0 + 1e-9)
    return None if too_many or too_fine else interval_s / finer


def _too_fine(points: Sequence[Point], floor: float, *, reached: bool) -> bool:
    """Whether the coarsest step is so accurate that the missing points must be coarser.

    reached: whether finer steps have reached the floor of the method's arithmetic.
    """
    coarsest = max(points, key=lambda p: p.dt_s)
    small = coarsest.error is not None and coarsest.error < LARGEST_ERROR
    flat = not reached and _is_flat(points, floor)
    return small and len(usable(points, floor)) < LEAST_POINTS and not flat


def _is_flat(points: Sequence[Point], floor: float) -> bool:
    """Whether the errors are well above the floor and hardly shrink from the coarsest to the finest step."""
    ended = [p for p in sorted(points, key=lambda p: -p.dt_s) if p.error is not None]
    errors = [p.error for p in ended if p.error is not None]
    above = all(p.is_above(floor) for p in ended)
    return len(errors) > 1 and above and errors[0] < _FLAT_SPREAD * errors[-1]


def _round_numbers(limit: int) -> list[int]:
    """Return 1, 2, 5, 10, 20, 50, ... up to limit."""
    numbers, decade = [], 1
    while decade <= limit:
        numbers += [digit * decade for digit in _LEADING if digit * decade <= limit]
        decade *= 10
    return numbers
