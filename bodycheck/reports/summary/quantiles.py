"""Quantiles of a stream of non-negative numbers, with error bars, from counts in bins.

A bin is an interval of doubles that share their exponent and leading bits (Tene's HdrHistogram; Masson, Rim
and Lee (2019), DDSketch, PVLDB 12, 2195), so that ranks are exact, values are known to 2^-11 of themselves,
and the result does not depend on the order of the numbers.
The sketches of t-digest and KLL keep fewer numbers, but their ranks are estimates that depend on the order or
on random bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array

_BITS = 11
_SHIFT = 52 - _BITS
_TAIL = 0.025  # of the binomial distribution of a rank, on each side: error bars of 95 %

SHARES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 0.999, 0.9999)
"""The quantiles that are reported."""


@dataclass(frozen=True)
class Quantile:
    """The quantile of a share of a population, estimated from a sample, and its 95 % error bar.

    high is infinite, or low 0, where the sample is too small to bound the quantile.
    """

    share: float
    value: float
    low: float
    high: float


@dataclass
class QuantileSketch:
    """Counts of numbers by their leading bits: keys (k,), ascending, and counts (k,)."""

    keys: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    counts: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def total(self) -> int:
        """The number of numbers."""
        return int(self.counts.sum())

    def add(self, values: Array) -> None:
        """Count numbers (n,) >= 0, infinity included; raises ValueError for NaN and negative ones."""
        if not np.all(values >= 0.0):
            raise ValueError(f"a sketch accepts only numbers of 0 or more, not {values[~(values >= 0.0)][0]}")
        keys = np.abs(np.asarray(values, dtype=np.float64)).view(np.int64) >> _SHIFT
        keys, counts = np.unique(keys, return_counts=True)
        both, index = np.unique(np.concatenate([self.keys, keys]), return_inverse=True)
        summed = np.zeros(len(both), dtype=np.int64)
        np.add.at(summed, index, np.concatenate([self.counts, counts]))
        self.keys, self.counts = both, summed

    @property
    def edges(self) -> tuple[Array, Array]:
        """The lower and the upper ends of the bins, (k,) each."""
        return (self.keys << _SHIFT).view(np.float64), (np.minimum(self.keys + 1, _INFINITE) << _SHIFT).view(
            np.float64
        )

    def quantile(self, share: float) -> Quantile:
        """Return the number of rank ceil(share n), and the numbers between which the population's lies.

        The rank of the population's quantile is binomial, whatever the distribution. The ends of the error
        bar include the width of their bins. Raises ValueError for an empty sketch.
        """
        from scipy.stats import binom

        n = self.total
        if n == 0:
            raise ValueError("a sketch without numbers has no quantiles")
        first, last = int(binom.ppf(_TAIL, n, share)), int(binom.ppf(1.0 - _TAIL, n, share)) + 1
        low, high = self._at_rank(max(math.ceil(share * n), 1))
        return Quantile(
            share,
            math.sqrt(low) * math.sqrt(high) if high < math.inf else low,
            self._at_rank(first)[0] if first >= 1 else 0.0,
            self._at_rank(last)[1] if last <= n else math.inf,
        )

    def _at_rank(self, rank: int) -> tuple[float, float]:
        """Return the ends of the bin of the number of this rank, from 1 to n."""
        index = int(np.searchsorted(np.cumsum(self.counts), rank))
        low, high = self.edges
        return float(low[index]), float(high[index])


_INFINITE = int(np.array(np.inf).view(np.int64)) >> _SHIFT
