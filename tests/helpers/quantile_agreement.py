"""Whether two estimates of a quantile agree."""

import math

from bodycheck.reports.summary.quantiles import Quantile


def agree(one: Quantile, other: Quantile) -> bool:
    """Return whether two estimates differ by at most the root of the sum of their squared error bars.

    Independent samples of one population agree in 95 of 100 cases.
    """
    lower, upper = sorted((one, other), key=lambda quantile: quantile.value)
    return upper.value - lower.value <= math.hypot(lower.high - lower.value, upper.value - upper.low)
