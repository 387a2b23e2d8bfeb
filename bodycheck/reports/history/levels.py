"""Whether noisy series moved to another level, decided anew each night, from what was known by then."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array

LEAST_BEFORE = 8
"""How many nights a level needs before a departure from it can be told."""
LEAST_AFTER = 5
"""How many nights the new level needs: a few may be the machine's doing."""
_MOST_BEFORE = 20
_SIGMAS = 7.0
_USUAL_COUNTS_AS = 5  # nights
_LEAST_SHARE = 0.5
_LEAST_STEP = math.log10(1.05)
_MAD_TO_SIGMA = 1.4826  # of a normal distribution
_QUIET_NIGHTS = 0.75
_QUIET_TO_SIGMA = 1.0 / 1.1503  # three quarters of a normal distribution lie within 1.1503 sigma


@dataclass(frozen=True)
class Step:
    """A move to another level: the first night on it, the night on which it was told, and how far it went."""

    first: int
    told: int
    size: float


def level_steps(series: Array) -> list[list[Step]]:
    """Return where each column of series (nights, methods) moved to another level; NaN: not measured.

    A step is told as soon as |shift| > max(least, 7 sigma sqrt(1/5 + 1/m)): the shift from the m nights
    before to the last five is the median of all differences between the two (Hodges and Lehmann, 1963), half
    of which each of the five has to share; sigma is at least that of most columns. From then on the nights
    before the step count no more. No night is judged by what came after it.
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
    """Return the median over the columns of sigma from one night to the next, in the last 20 nights.

    A column that moved to another level, or moves slowly, counts as one that did not.
    """
    moves = np.abs(np.diff(series[-_MOST_BEFORE:], axis=0))
    there = moves[:, ~np.all(np.isnan(moves), axis=0)]
    return (
        _MAD_TO_SIGMA / math.sqrt(2.0) * float(np.median(np.nanmedian(there, axis=0))) if there.size else 0.0
    )


def least_told(spread: float, nights: int) -> float:
    """Return the smallest step that is sure to be told by its fifth night, after so many nights before."""
    before = min(nights, _MOST_BEFORE)
    # sigma is known from so few nights no better than to a half
    return max(_LEAST_STEP, (1.5 * _SIGMAS + 2.0) * spread * math.sqrt(1.0 / LEAST_AFTER + 1.0 / before))


def _step_told(column: Array, usual: float) -> Step | None:
    """Return the step to the last five nights of one column, if there is one."""
    (there,) = np.nonzero(~np.isnan(column))
    before, now = column[there[:-LEAST_AFTER][-_MOST_BEFORE:]], column[there[-LEAST_AFTER:]]
    if len(before) < LEAST_BEFORE:
        return None
    shift = float(np.median(np.subtract.outer(now, before)))
    if abs(shift) <= _LEAST_STEP:
        return None
    error = _sigma(before, usual) * math.sqrt(1.0 / len(now) + 1.0 / len(before))
    # wild nights drag the shift with them, but not the other nights
    together = float(np.min((now - np.median(before)) / shift)) > _LEAST_SHARE
    if not together or abs(shift) <= _SIGMAS * error:
        return None
    return Step(int(there[-LEAST_AFTER]), len(column) - 1, shift)


def _sigma(values: Array, usual: float) -> float:
    """Return what one night adds by chance: by the values' own spread, which few of them tell but poorly.

    It is within which three quarters of them lie: fewer than a quarter of the nights may have been disturbed.
    """
    nights = len(values)
    quiet = float(np.quantile(np.abs(values - np.median(values)), _QUIET_NIGHTS))
    spread = _QUIET_TO_SIGMA * quiet * (1.0 + 1.0 / nights)
    blended = (nights * spread**2 + _USUAL_COUNTS_AS * usual**2) / (nights + _USUAL_COUNTS_AS)
    return max(usual, math.sqrt(blended))
