"""Observed order, round-off floor and verdict from the cases of one method; which step shows the order."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, count, dropwhile, pairwise, takewhile

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.limits import Limit, limit_of
from bodycheck.reports.measurement.measures import Judgement
from bodycheck.reports.measurement.order import MIN_POINTS, Order, predicted_error, settled_order
from bodycheck.reports.measurement.outliers import FACTOR, Outlier, exclusion_of

LARGEST_ERROR = 0.3  # rad, or of the scale: a larger error carries no information about the order
ABOVE_FLOOR = 10.0
LARGEST_LIMIT = LARGEST_ERROR / 100.0  # largest truth bound or round-off at which a verdict is possible
LARGEST_ROUND_OFF = 1e-9  # a larger error that stops shrinking is not round-off in double precision
_MIN_CERTAIN = 1e-12
_MIN_LIMIT_POINTS = 3  # usable points, where the limit alone shows convergence
_MIN_FALL = 0.4  # power of the tolerance with which errors must fall; of a first-order method it is 1/2
_PLATEAU = 0.1  # power of the tolerance below which errors stay the same
_PLATEAU_RATIO = 100.0  # of the tolerances over which they must fall: the finest ones
_RISING_POINTS = 3  # errors that increase up to the finest step
_RISING_PAIRS = 0.75  # share of the pairs of these in which the finer step has the larger error
_GROWS = 2.0  # ratio of an error to that of a coarser step, above which finer steps do not reduce it
_TURNED = 100.0  # round-offs, below which an error that finer steps increase is round-off


@dataclass(frozen=True, eq=False)
class Point:
    """One case of a method: its step or tolerance, its error, and its signed departure from the truth.

    error: None where the case did not end well. motion (samples, k): the departure over the scale [default:
    the error itself, which serves as the motion while it is small]. round_off: the error that the method's
    arithmetic alone is predicted to make at this step, where that is coarser than double precision. is_far:
    whether the whole motion is so far from the truth that no error of it shows an order.
    """

    dt_s: float
    error: float | None
    motion: Array | None = None
    round_off: float = 0.0
    is_far: bool = False

    @property
    def is_saturated(self) -> bool:
        """Whether the error is too large to show an order."""
        return self.is_far or (self.error is not None and self.error >= LARGEST_ERROR)

    def is_above(self, floor: float) -> bool:
        """Whether the error is well above the floor and above round-off."""
        return self.error is not None and self.error > ABOVE_FLOOR * max(floor, self.round_off)


@dataclass(frozen=True)
class Criteria:
    """How a quantity is judged.

    floor: of the scale; a smaller error carries no information. growing: round-off as it grows with the
    number of steps of the finest case. arithmetic: the error predicted from the method's arithmetic there.
    extrapolated: False where errors do not follow a power of the step. judged: by its limit, or as a
    property.
    """

    floor: float
    growing: float = 0.0
    arithmetic: float = 0.0
    extrapolated: bool = True
    judged: Judgement = "limit"


@dataclass(frozen=True)
class Convergence:
    """The order with its 95 % interval, the number of points used, the floor, the limit and the verdict.

    limit_distance, limit_uncertainty: distance from the truth of the limit under step refinement, and its
    uncertainty, as root mean squares over the samples. usable_dt_s: the step above which errors exceed those
    of the order; None where they do not. excluded_dt_s, excluded_error, excluded_ratio: a step at which the
    error is larger than the others predict, its error, and the ratio of the two.
    """

    verdict: str
    points: int
    floor: float
    order: float | None = None
    order_low: float | None = None
    order_high: float | None = None
    limit_distance: float | None = None
    limit_uncertainty: float | None = None
    usable_dt_s: float | None = None
    excluded_dt_s: float | None = None
    excluded_error: float | None = None
    excluded_ratio: float | None = None

    @property
    def is_decided(self) -> bool:
        """Whether finer steps would not change the verdict."""
        return self.verdict in (
            "converges",
            "does-not-converge",
            "at-floor",
            "at-precision-floor",
            "chaotic",
        )


def usable(points: Sequence[Point], floor: float) -> list[Point]:
    """Return the points usable for an order, coarsest first: 10 floor < error < 0.3, not far.

    Where the arithmetic is coarser than double precision, steps finer than the best one are not usable.
    """
    best = best_of(points)
    return [
        p
        for p in sorted(points, key=lambda p: -p.dt_s)
        if p.error is not None
        and p.is_above(floor)
        and not p.is_saturated
        and (p.round_off == 0.0 or best is None or p.dt_s >= best.dt_s)
    ]


def best_of(points: Sequence[Point]) -> Point | None:
    """Return the point with the least error, the coarsest of equal ones; None where no case ended well."""
    ended = [(p.error, -p.dt_s, p) for p in points if p.error is not None]
    return min(ended, key=lambda one: one[:2])[2] if ended else None


def reaches_round_off(points: Sequence[Point]) -> bool:
    """Whether the least error is the round-off that is predicted, or finer steps increase it near there."""
    best = best_of(points)
    if best is None or best.error is None or best.round_off == 0.0:
        return False
    is_finest = best.dt_s == min(p.dt_s for p in points)
    return best.error <= (ABOVE_FLOOR if is_finest else _TURNED) * best.round_off


def round_off_floor(points: Sequence[Point], min_floor: float) -> float:
    """Return `min_floor`, or the error at which finer steps stopped helping, if it is as small as round-off.

    Where a finer step, or tolerance, reduces the error by less than order 1/2 would, and both errors are
    small enough to be round-off, which may grow with the number of steps, both are on the floor. Round-off
    does not fall below a hundredth of that at even finer steps.
    """
    floor = min_floor
    errors = [(p.dt_s, p.error) for p in sorted(points, key=lambda p: -p.dt_s) if p.error is not None]
    for place, ((coarse_dt, coarser), (fine_dt, finer)) in enumerate(pairwise(errors)):
        stalls = coarser < min(finer * math.sqrt(coarse_dt / fine_dt), LARGEST_ROUND_OFF)
        stays = min(error for _, error in errors[place + 1 :]) >= finer / _TURNED
        if stalls and stays and finer < _TURNED * LARGEST_ROUND_OFF:
            floor = max(floor, finer, coarser)
    return floor


def convergence_of(points: Sequence[Point], criteria: Criteria) -> Convergence:
    """Return order, limit and verdict of one quantity from the cases of one method on one scenario.

    points: in any order.
    """
    return _convergence_of(tuple(points), criteria)


@lru_cache(maxsize=64)  # the refinement computes it first, then the row needs it again
def _convergence_of(points: tuple[Point, ...], criteria: Criteria) -> Convergence:
    if criteria.floor > LARGEST_LIMIT:
        return Convergence("chaotic", 0, criteria.floor)
    ended = sorted((p for p in points if p.error is not None), key=lambda p: -p.dt_s)
    if not ended:
        return Convergence("unstable", 0, criteria.floor)
    floor = round_off_floor(ended, criteria.floor)
    shown_floor = max(floor, *(p.round_off for p in ended))
    errors = [p.error for p in ended if p.error is not None]
    if max(errors) <= ABOVE_FLOOR * floor:
        return Convergence("at-floor", 0, shown_floor)
    if not any(p.is_above(floor) for p in ended):
        return Convergence("at-precision-floor", 0, shown_floor)
    fit = usable(ended, floor)
    order = settled_order(
        tuple(p.dt_s for p in fit), tuple(p.error for p in fit if p.error is not None), floor
    )
    limit = _limit(ended, criteria)
    found = Convergence("pre-asymptotic", len(fit), shown_floor)
    if criteria.judged == "limit" and (excluded := _excluded(ended, floor, criteria)) is not None:
        point, outlier = excluded
        ratio = outlier.error / outlier.predicted
        found = replace(found, excluded_dt_s=point.dt_s, excluded_error=point.error, excluded_ratio=ratio)
        return replace(found, verdict="does-not-converge")
    if limit is not None:
        found = replace(found, limit_distance=limit.distance, limit_uncertainty=limit.uncertainty)
        if limit.is_off and errors[-1] > LARGEST_ROUND_OFF and criteria.judged == "limit":
            return replace(found, verdict="does-not-converge")
    if order is not None and not _is_contradicted(order, fit, limit, criteria):
        interval = {"order": order.order, "order_low": order.low, "order_high": order.high}
        usable_dt_s = _usable_step(order, points, fit, floor)
        return replace(found, verdict="converges", points=order.points, usable_dt_s=usable_dt_s, **interval)
    if _grows(ended, floor, criteria) and not reaches_round_off(ended):
        return replace(found, verdict="error-grows")
    if limit is not None and limit.is_truth and len(fit) >= _MIN_LIMIT_POINTS:
        return replace(found, verdict="converges")
    if reaches_round_off(ended):
        return replace(found, verdict="at-precision-floor")
    all_usable = len(ended) == len(points) and not any(p.is_saturated for p in ended)
    return replace(found, verdict="too-few-points") if all_usable and len(fit) < MIN_POINTS else found


def _excluded(ended: Sequence[Point], floor: float, criteria: Criteria) -> tuple[Point, Outlier] | None:
    """Return the point that is farthest above the error that the others predict; None where none is.

    The round-off of a finest step could explain its error; finer steps that fit exclude that.
    """
    above = [p for p in ended if p.is_above(floor)]
    series = list(dropwhile(lambda p: p.is_saturated, above))
    found = exclusion_of(
        tuple(p.dt_s for p in series), tuple(p.error for p in series if p.error is not None), floor
    )
    round_off = max(LARGEST_ROUND_OFF, ABOVE_FLOOR * max(criteria.growing, criteria.arithmetic))
    outliers = () if found is None else found.outliers
    certain = (one for one in outliers if one.is_above and (not one.is_finest or one.error > round_off))
    worst = max(certain, key=lambda one: one.error / one.predicted, default=None)
    return None if worst is None else (series[worst.place], worst)


def _grows(ended: Sequence[Point], floor: float, criteria: Criteria) -> bool:
    """Whether errors rise from the smallest one to that of the finest step, to more than any round-off.

    Errors that accumulate are irregular: most pairs of them must rise, and the finest must be far above.
    """
    errors = [p.error for p in ended if p.error is not None and not p.is_saturated]
    rising = errors[int(np.argmin(errors)) if errors else 0 :]
    rising = [error for error in rising if error > ABOVE_FLOOR * floor]
    if criteria.judged != "limit" or len(rising) < _RISING_POINTS:
        return False
    pairs = [finer > coarser for coarser, finer in combinations(rising, 2)]
    largest = ABOVE_FLOOR * max(floor, criteria.growing, criteria.arithmetic, LARGEST_ROUND_OFF)
    return sum(pairs) >= _RISING_PAIRS * len(pairs) and rising[-1] > max(_GROWS * rising[0], largest)


def _usable_step(order: Order, points: Sequence[Point], fit: Sequence[Point], floor: float) -> float | None:
    """Return the coarsest step of the order, if a coarser case has a larger error than it predicts."""
    used = fit[order.first : order.first + order.points]
    errors = [p.error for p in used if p.error is not None]
    for point in points:
        if point.dt_s <= used[0].dt_s:
            continue
        if point.error is None or point.is_saturated:
            return used[0].dt_s
        expected = predicted_error([p.dt_s for p in used], errors, floor, point.dt_s)
        if point.error > FACTOR * expected.high:
            return used[0].dt_s
    return None


def _is_contradicted(order: Order, fit: Sequence[Point], limit: Limit | None, criteria: Criteria) -> bool:
    """Whether the limit differs from the truth, or errors at finer steps than those of the order are larger.

    fit: the usable points, coarsest first, from which the order was fitted.
    """
    errors = [p.error for p in fit[order.first + order.points - 1 :] if p.error is not None]
    grows = max(errors) > max(_GROWS * errors[0], ABOVE_FLOOR * criteria.growing)
    doubtful = limit is not None and limit.is_doubtful and criteria.judged == "limit"
    return grows or (doubtful and errors[-1] > LARGEST_ROUND_OFF)


def _limit(ended: Sequence[Point], criteria: Criteria) -> Limit | None:
    """Return the limit of the motions, from the finest case up to the first without one.

    Where the arithmetic is coarser than double precision, the finest steps are left out as far as that makes
    the limit more certain. ended: the cases that ended well, coarsest step first.
    """
    fine_first = takewhile(lambda pair: pair[1] is not None, ((p, _motion_of(p)) for p in reversed(ended)))
    known = [(point, motion) for point, motion in fine_first if motion is not None][::-1]
    if len(known) < _MIN_LIMIT_POINTS:
        return None
    rounded = any(point.round_off for point, _ in known)
    limits = []
    for number in range(_MIN_LIMIT_POINTS if rounded else len(known), len(known) + 1):
        points, motions = [point for point, _ in known[:number]], [motion for _, motion in known[:number]]
        round_off = ABOVE_FLOOR * max(p.round_off for p in points)  # predicted within that
        certain = max(criteria.floor, criteria.growing, round_off, _MIN_CERTAIN)
        limits.append(
            limit_of([p.dt_s for p in points], motions, certain, extrapolated=criteria.extrapolated)
        )
    found = (limit for limit in limits if limit is not None)
    return min(found, key=lambda limit: limit.uncertainty, default=None)


def _motion_of(point: Point) -> Array | None:
    """Return the motion of a case, or else its error, unless that is saturated and so cannot change."""
    if point.motion is None and point.error is not None and not point.is_saturated:
        return np.array([[point.error]])
    return None if point.is_far else point.motion


def tolerance_convergence(points: Sequence[Point], criteria: Criteria) -> Convergence:
    """Return the verdict on a method controlled by a tolerance: errors must fall with it, down to the floor.

    points: dt_s is the tolerance. There is no order in the step.
    """
    if criteria.floor > LARGEST_LIMIT:
        return Convergence("chaotic", 0, criteria.floor)
    ended = sorted((p.dt_s, p.error) for p in points if p.error is not None)
    if not ended:
        return Convergence("unstable", 0, criteria.floor)
    floor = round_off_floor(points, criteria.floor)
    found = Convergence("converges", len(usable(points, floor)), floor)
    smallest = ended[0][1]
    if max(error for _, error in ended) <= ABOVE_FLOOR * floor:
        return replace(found, verdict="at-floor")
    if smallest <= ABOVE_FLOOR * floor:
        return found
    # a large error at a coarse tolerance says nothing about the fine ones
    begin = next((i for i, (tolerance, _) in enumerate(ended) if _is_far(ended[0][0], tolerance)), None)
    last = len(ended) - 1 if begin is None else begin
    falls, ends_flat = _power(ended[0], ended[last]), last > 1 and _power(ended[0], ended[1]) < _PLATEAU
    if falls >= _MIN_FALL and not ends_flat:
        return found
    if begin is None:
        return replace(found, verdict="too-few-points")
    is_flat = falls < _PLATEAU and smallest > LARGEST_ROUND_OFF and criteria.judged == "limit"
    return replace(found, verdict="does-not-converge" if is_flat else "pre-asymptotic")


def _is_far(finest: float, tolerance: float) -> bool:
    return tolerance >= _PLATEAU_RATIO * finest * (1.0 - _SAME)


def _power(fine: tuple[float, float], coarse: tuple[float, float]) -> float:
    """log(e / e') / log(t / t') of two pairs of tolerance and error; 0 for the same pair."""
    if fine[0] == coarse[0] or coarse[1] == 0.0:
        return 0.0
    return math.log(coarse[1] / fine[1]) / math.log(coarse[0] / fine[0])


def stepless_verdict(points: Sequence[Point], criteria: Criteria) -> Convergence:
    """Return the verdict on a method without step or tolerance: exact or off."""
    error = points[0].error
    if criteria.floor > LARGEST_LIMIT or error is None:
        return Convergence("unstable" if error is None else "chaotic", 0, criteria.floor)
    return Convergence("exact" if error <= ABOVE_FLOOR * criteria.floor else "off", 0, criteria.floor)


_LEADING = (1, 2, 5)
_MAX_STEPS = 200_000  # of one case
_SPAN = 100.0  # ratio of the coarsest requested step to the finest one tried
_FLAT_SPREAD = 2.0
_SAME = 1e-9  # relative difference below which errors, and steps, count as the same
_FINER = 2  # steps below the listed ones that a method must ignore before it is said to ignore all


def next_step_size(
    points: Sequence[Point],
    criteria: Criteria,
    listed: Sequence[float],
    interval_s: float,
    duration_s: float,
    *,
    needs_order: bool = True,
) -> float | None:
    """Return a further step in s that divides the sampling interval, or None if none is needed.

    points: the errors of one quantity so far. criteria: how it is judged. listed: the requested steps.
    needs_order: whether an order must be found even if only coarser steps have an error above the floor.
    """
    found = convergence_of(points, criteria)
    decided = found.verdict in ("does-not-converge", "chaotic") or found.order is not None
    decided = decided and not _may_ignore_the_step(points, listed)
    if decided or (not needs_order and found.is_decided):
        return None
    floor = round_off_floor(points, criteria.floor)
    strides = sorted(round(interval_s / p.dt_s) for p in points)
    reached = found.verdict == "at-precision-floor"
    if _too_fine(points, floor, reached=reached):
        coarser = list(takewhile(lambda n: n < strides[0], _round_numbers()))
        return interval_s / coarser[-1] if needs_order and coarser else None
    if reached:
        return None
    finest = min(points, key=lambda p: p.dt_s)
    if finest.error is not None and finest.error <= floor:
        return None
    finer = next(n for n in _round_numbers() if n > strides[-1])
    too_many = finer * duration_s / interval_s > _MAX_STEPS
    too_fine = max(listed) * finer / interval_s > _SPAN * (1.0 + 1e-9)
    return None if too_many or too_fine else interval_s / finer


def _may_ignore_the_step(points: Sequence[Point], listed: Sequence[float]) -> bool:
    """Whether all motions are the same, as those of a method that makes shorter steps of its own.

    Two steps finer than the listed ones show whether it does so at any step.
    """
    errors = [p.error for p in points if p.error is not None]
    finer = sum(p.dt_s < min(listed) * (1.0 - _SAME) for p in points)
    return len(errors) > 1 and finer < _FINER and max(errors) - min(errors) <= _SAME * max(errors)


def _too_fine(points: Sequence[Point], floor: float, *, reached: bool) -> bool:
    """Whether the coarsest step is so accurate that the missing points must be coarser.

    reached: whether finer steps have reached the floor of the method's arithmetic.
    """
    coarsest = max(points, key=lambda p: p.dt_s)
    small = coarsest.error is not None and not coarsest.is_saturated
    flat = not reached and _is_flat(points, floor)
    return small and len(usable(points, floor)) < MIN_POINTS and not flat


def _is_flat(points: Sequence[Point], floor: float) -> bool:
    """Whether the errors are well above the floor and hardly shrink from the coarsest to the finest step."""
    ended = [p for p in sorted(points, key=lambda p: -p.dt_s) if p.error is not None]
    errors = [p.error for p in ended if p.error is not None]
    above = all(p.is_above(floor) for p in ended)
    return len(errors) > 1 and above and errors[0] < _FLAT_SPREAD * errors[-1]


def _round_numbers() -> Iterator[int]:
    """Yield 1, 2, 5, 10, 20, 50, ... without end."""
    for exponent in count():
        yield from (digit * 10**exponent for digit in _LEADING)
