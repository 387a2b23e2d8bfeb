"""Whether noisy series moved to another level, decided anew each night, from what was known by then."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array

LEAST_BEFORE = 5
"""How many nights a level needs before a departure from it can be told."""
LEAST_AFTER = 2
"""How many nights the new level needs: one alone may be the machine's doing."""
_MOST_BEFORE = 20
_MOST_AFTER = 5
_SIGMAS = 4.5
_LEAST_STEP = math.log10(1.05)
_MAD_TO_SIGMA = 1.4826  # of a normal distribution


@dataclass(frozen=True)
class Step:
    """A move to another level: the first night on it, the night on which it was told, and how far it went."""

    first: int
    told: int
    size: float


def level_steps(series: Array) -> list[list[Step]]:
    """Return where each column of series (nights, methods) moved to another level; NaN: not measured.

    A step is told as soon as |shift| > max(least, 4.5 sigma sqrt(1/k + 1/m)): the shift from the m nights
    before to the last k is the median of all differences between the two (Hodges and Lehmann, 1963), sigma
    the larger of the column's own spread and the usual one of all columns. From then on the nights before
    the step count no more. No night is judged by what came after it.
    """
    found: list[list[Step]] = [[] for _ in range(series.shape[1])]
    for night in range(LEAST_BEFORE + LEAST_AFTER - 1, len(series)):
        usual = usual_spread(series[: night + 1])
        for column, steps in zip(series.T, found, strict=True):
            if math.isnan(column[night]):
                continue
            begin = steps[-1].first if steps else 0
            step = _step_told(column[begin : night + 1], usual)
            if step is not None:
                steps.append(Step(begin + step.first, night, step.size))
    return found


def usual_spread(series: Array) -> float:
    """Return the median over the columns of their spread in the last 20 nights: that of an idle change."""
    spreads = [_spread(column[~np.isnan(column)]) for column in series[-_MOST_BEFORE:].T]
    return float(np.median([spread for spread in spreads if spread > 0.0] or [0.0]))


def least_told(spread: float, nights: int) -> float:
    """Return the smallest step that is sure to be told by its fifth night, after so many nights before."""
    before = min(nights, _MOST_BEFORE)
    return max(_LEAST_STEP, (_SIGMAS + 2.0) * spread * math.sqrt(1.0 / _MOST_AFTER + 1.0 / before))


def _step_told(column: Array, usual: float) -> Step | None:
    """Return the clearest step to the end of one column, if there is one."""
    (there,) = np.nonzero(~np.isnan(column))
    values = column[there]
    clearest, found = 0.0, None
    for after in range(LEAST_AFTER, min(_MOST_AFTER, len(values) - LEAST_BEFORE) + 1):
        before = values[:-after][-_MOST_BEFORE:]
        sigma = max(usual, _spread(before))
        error = sigma * math.sqrt(1.0 / after + 1.0 / len(before))
        shift = float(np.median(np.subtract.outer(values[-after:], before)))
        if abs(shift) > max(_LEAST_STEP, _SIGMAS * error) and abs(shift) > clearest * error:
            clearest = abs(shift) / error if error > 0.0 else math.inf
            found = Step(int(there[-after]), len(column) - 1, shift)
    return found


def _spread(values: Array) -> float:
    """Return sigma from the median absolute deviation, widened as a short series needs."""
    if len(values) < 2:
        return 0.0
    deviation = float(np.median(np.abs(values - np.median(values))))
    return _MAD_TO_SIGMA * deviation * (1.0 + 2.0 / len(values))
