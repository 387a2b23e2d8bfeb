"""Errors at single steps that the errors at the other steps exclude.

A method that is wrong at some steps only follows its order at all others. A step is left out if the others
then settle an order, on both sides of it or, for the finest steps, on the coarser side, and if this order
predicts another error there. A coarser step that fits is required: just beyond its stability limit a healthy
method is wrong too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from bodycheck.reports.measurement.order import MIN_POINTS, Order, predicted_error, settled_order

FACTOR = 10.0
"""The ratio of an error to the nearest end of its predicted interval, beyond which it is excluded."""

_SUSPECTED = math.log(10.0)  # deviation of log e from its neighbours, from which the others are fitted alone
_MOST_SUSPECTS = 4
_CONFIRMING = 2  # steps besides the fewest that settle an order, for each excluded step but the first


@dataclass(frozen=True)
class Outlier:
    """A step whose error the others exclude: its place, its error, and the error that they predict.

    is_finest: whether no finer step confirms the prediction.
    """

    place: int
    error: float
    predicted: float
    is_finest: bool = False

    @property
    def is_above(self) -> bool:
        """Whether the error is larger than predicted; one that is smaller is no fault."""
        return self.error > self.predicted


@dataclass(frozen=True)
class Exclusion:
    """The excluded steps, coarsest first, and the order of the others; order.first counts these alone."""

    outliers: tuple[Outlier, ...]
    order: Order

    @property
    def is_open(self) -> bool:
        """Whether no step that follows the order is finer than one of the excluded ones."""
        return any(one.is_finest for one in self.outliers)


@lru_cache(maxsize=1024)
def exclusion_of(steps: tuple[float, ...], errors: tuple[float, ...], floor: float) -> Exclusion | None:
    """Return the steps that must be left out so that the most others settle an order around them.

    steps (n,) in s, descending; errors (n,) > 0, all above the floor; floor: as for settled_order. None where
    nothing is excluded, or no order explains the others.
    """
    order = settled_order(steps, errors, floor)
    if len(steps) <= MIN_POINTS or (order is not None and order.points == len(steps)):
        return None
    suspects = [*_suspects(steps, errors)]
    most = max(1, (len(steps) - MIN_POINTS) // _CONFIRMING)
    candidates = (
        _without(steps, errors, floor, tuple(sorted(places)))
        for number in range(1, most + 1)
        for places in combinations(suspects, number)
    )
    explained = 0 if order is None else order.points
    found = [one for one in candidates if one is not None and one.order.points + one.is_open > explained]
    return max(found, key=lambda one: one.order.points, default=None)


def _suspects(steps: Sequence[float], errors: Sequence[float]) -> Iterator[int]:
    """Yield the places, but the coarsest, of errors far from the line through two neighbours, worst first."""
    x, y = np.log(steps), np.log(errors)
    last = len(steps) - 1
    far = []
    for place in range(1, last + 1):
        a, b = (place - 1, place + 1) if place < last else (place - 2, place - 1)
        line = y[a] + (y[b] - y[a]) * (x[place] - x[a]) / (x[b] - x[a])
        far.append((abs(y[place] - line), place))
    for size, place in sorted(far, reverse=True)[:_MOST_SUSPECTS]:
        if size > _SUSPECTED:
            yield place


def _without(
    steps: tuple[float, ...], errors: tuple[float, ...], floor: float, places: tuple[int, ...]
) -> Exclusion | None:
    """Return the exclusion of these places; None unless the others settle an order that excludes each."""
    rest = [k for k in range(len(steps)) if k not in places]
    order = settled_order(tuple(steps[k] for k in rest), tuple(errors[k] for k in rest), floor)
    if order is None:
        return None
    used = rest[order.first : order.first + order.points]
    if used[0] > places[0]:
        return None
    outliers = []
    for place in places:
        found = predicted_error([steps[k] for k in used], [errors[k] for k in used], floor, steps[place])
        if found.low / FACTOR <= errors[place] <= found.high * FACTOR:
            return None
        outliers.append(Outlier(place, errors[place], found.error, is_finest=place > used[-1]))
    return Exclusion(tuple(outliers), order)
