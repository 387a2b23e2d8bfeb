"""The limit of a method under step refinement: the truth, something else, or undecided.

Whole motions are compared at common samples, with their sign: a difference of states is a smooth function of
the step, but the maximum of an error over time is not. With D1 = x(h1) - x(h2) and D2 = x(h2) - x(h3) of
steps h1 > h2 > h3, x(h) = x(0) + C h^p gives p from (h1^p - h2^p) / (h2^p - h3^p) = |D1| / |D2|, and the
limit x(0) = x(h3) - D2 h3^p / (h2^p - h3^p) (Richardson 1911, Phil. Trans. R. Soc. A 210, 307).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array

SURELY_OFF = 30.0  # multiples of the uncertainty: correct methods stay below 3, planted faults exceed 1000
_DOUBTFUL = 3.0  # multiples of the uncertainty, below which correct methods stay
_STANDS_OFF = 10.0  # multiples of the last difference: a correct method of order 1/2 has an error of 2.4
_ORDERS = (0.2, 9.0)
_MIN_ORDER = 0.5  # of the differences, which must shrink for an extrapolation to be meaningful
_BISECTIONS = 40
_SHARE = 0.1  # of the last difference: an extrapolation is never assumed to be more accurate
_SETTLED_SPAN = 3.9  # ratio of the steps over which a motion must not have changed


@dataclass(frozen=True)
class Limit:
    """The limit of the motions under step refinement.

    distance: root mean square over the samples of the limit's distance from the truth. uncertainty: of the
    limit itself. order: p of the last three steps; 0 where the differences do not shrink. is_off: whether the
    limit certainly differs from the truth.
    """

    distance: float
    uncertainty: float
    order: float
    is_off: bool

    @property
    def is_truth(self) -> bool:
        """Whether the differences shrink and the limit equals the truth within the uncertainty."""
        return self.order >= _MIN_ORDER and self.distance <= self.uncertainty

    @property
    def is_doubtful(self) -> bool:
        """Whether the differences shrink, but probably towards something other than the truth."""
        return self.order >= _MIN_ORDER and self.distance > _DOUBTFUL * self.uncertainty


def limit_of(
    steps: Sequence[float], motions: Sequence[Array], certain: float, *, extrapolated: bool = True
) -> Limit | None:
    """Return the limit of a method's motions; None for fewer than three steps.

    steps (n,) in s, descending. motions: n arrays (samples, k), each the signed departure from the truth,
    over a scale. certain: the smallest meaningful distance: the truth's bound, and round-off as it grows with
    the number of steps. extrapolated: False where the differences do not follow a power of the step, as where
    a load switches inside one. In that case, and where the distance grows with finer steps, the limit is off
    only if the motion has stopped changing far from the truth.
    """
    if len(steps) < 3:
        return None
    last_but_one, last = (_size(motions[i] - motions[i + 1]) for i in (-3, -2))
    here = _size(motions[-1])
    still = max(last_but_one, last, certain)
    stands_off = here > _STANDS_OFF * still and steps[-3] >= _SETTLED_SPAN * steps[-1]
    found = _extrapolated(steps[-3:], motions[-3:], certain)
    if found is None or not extrapolated:
        return Limit(here, still, 0.0, stands_off)
    end, order = found
    if here > max(_size(motions[-2]), certain):  # a growing distance cannot be extrapolated
        still = max(last, certain)
        return Limit(here, still, order, order >= _MIN_ORDER and here > _STANDS_OFF * still)
    distance, uncertainty = _size(end), max(_SHARE * last, certain)
    if len(steps) == 3:
        uncertainty = max(uncertainty, last)
    else:
        coarser = _extrapolated(steps[-4:-1], motions[-4:-1], certain)
        uncertainty = max(uncertainty, _size(end - (motions[-2] if coarser is None else coarser[0])))
    # require both the limit and the finest motion to be off: if they disagree, nothing is certain
    off = order >= _MIN_ORDER and min(distance, here) > SURELY_OFF * uncertainty
    return Limit(distance, uncertainty, order, off or stands_off)


def _extrapolated(
    steps: Sequence[float], motions: Sequence[Array], certain: float
) -> tuple[Array, float] | None:
    """Return the limit and the order of three motions; None where their differences do not shrink."""
    d1, d2 = motions[0] - motions[1], motions[1] - motions[2]
    one, two = _size(d1), _size(d2)
    if two <= certain:
        return motions[2], _ORDERS[1]
    order = _order_of(steps, one / two)
    if order is None:
        return None
    h2, h3 = steps[1] ** order, steps[2] ** order
    return motions[2] - d2 * (h3 / (h2 - h3)), order


def _order_of(steps: Sequence[float], ratio: float) -> float | None:
    """Solve (h1^p - h2^p) / (h2^p - h3^p) = ratio for p, capped at 9; None below 0.2."""
    a, b = math.log(steps[0] / steps[2]), math.log(steps[1] / steps[2])

    def ratio_of(p: float) -> float:
        return (math.expm1(p * a) - math.expm1(p * b)) / math.expm1(p * b)

    low, high = _ORDERS
    if ratio <= ratio_of(low):
        return None
    if ratio >= ratio_of(high):
        return high
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio_of(middle) < ratio else (low, middle)
    return low


def _size(departure: Array) -> float:
    """Return the root mean square over the samples of the norm of (samples, k)."""
    flat = departure.ravel()
    return math.sqrt(float(np.dot(flat, flat)) / len(departure))
