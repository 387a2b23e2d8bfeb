"""Encode the numbers of plots and motions compactly, since they are most of the page."""

from __future__ import annotations

from base64 import b64encode

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array

LINE_POINTS = 200  # more are indistinguishable on a screen and enlarge the page


def rounded(value: float) -> float:
    """Return a number rounded to 4 digits."""
    return float(f"{value:.4g}")


def packed(values: Array | NDArray[np.float32]) -> str:
    """Return the base64 of little-endian float32: half as long as decimals."""
    return b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def packed_line(values: Array) -> str | float:
    """Return a downsampled line, packed; for a constant line, its value."""
    line = np.minimum(thinned_maxima(values), np.finfo(np.float32).max).astype(np.float32)
    return rounded(line[0]) if np.all(line == line[0]) else packed(line)


def thinned_times(t_s: Array) -> Array:
    """Return the last time of each of the at most LINE_POINTS buckets of samples."""
    ends = np.append(_bucket_starts(len(t_s))[1:], len(t_s)) - 1
    return np.asarray(t_s[ends])


def thinned_maxima(values: Array) -> Array:
    """Return the largest value of each bucket, so that no peak is lost."""
    return np.asarray(np.maximum.reduceat(values, _bucket_starts(len(values))))


def _bucket_starts(samples: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.arange(0, samples, -(-samples // LINE_POINTS), dtype=np.intp)
