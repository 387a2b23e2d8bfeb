"""Whether noisy series moved to another level, decided anew each night, from what was known by then."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array

LEAST_BEFORE = 8
"""How many nights a level needs before a departure from it can be told."""
LEAST_AFTER = 4
"""How many nights the new level needs: a few may be the machine's doing."""
_MOST_BEFORE = 20
_MOST_AFTER = 5
_SIGMAS = 8.0
_USUAL_COUNTS_AS = 5  # nights
_LEAST_SHARE = 0.25
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

    A step is told as soon as |shift| > max(least, 8 sigma sqrt(1/k + 1/m)): the shift from the m nights
    before to the last k is the median of all differences between the two (Hodges and Lehmann, 1963), a
    quarter of which each of the k has to share; sigma is at least that of most columns. From then on the
    nights before the step count no more. No night is judged by what came after it.
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
    return max(_LEAST_STEP, (1.5 * _SIGMAS + 2.0) * spread * math.sqrt(1.0 / _MOST_AFTER + 1.0 / before))


def _step_told(column: Array, usual: float) -> Step | None:
    """Return the clearest step to the end of one column, if there is one."""
    (there,) = np.nonzero(~np.isnan(column))
    values = column[there]
    clearest, found = 0.0, None
    for after in range(LEAST_AFTER, min(_MOST_AFTER, len(values) - LEAST_BEFORE) + 1):
        before, now = values[:-after][-_MOST_BEFORE:], values[-after:]
        error = _sigma(before, usual) * math.sqrt(1.0 / after + 1.0 / len(before))
        shift = float(np.median(np.subtract.outer(now, before)))
        # a single wild night drags the shift with it, but not the other nights
        together = float(np.min((now - np.median(before)) / shift)) > _LEAST_SHARE if shift else False
        if together and abs(shift) > max(_LEAST_STEP, _SIGMAS * error, clearest * error):
            clearest = abs(shift) / error if error > 0.0 else math.inf
            found = Step(int(there[-after]), len(column) - 1, shift)
    return found


def _sigma(values: Array, usual: float) -> float:
    """Return what one night adds by chance: by the values' own spread, which few of them tell but poorly.

    Their standard deviation, as nights that were disturbed are part of what chance does.
    """
    nights = len(values)
    spread = float(np.std(values, ddof=1)) * (1.0 + 1.0 / nights)
    blended = (nights * spread**2 + _USUAL_COUNTS_AS * usual**2) / (nights + _USUAL_COUNTS_AS)
    return max(usual, math.sqrt(blended))
