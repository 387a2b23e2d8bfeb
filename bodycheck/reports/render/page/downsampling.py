"""Encode the numbers of plots and motions compactly, since they are most of the page."""

from __future__ import annotations

from base64 import b64encode

import numpy as np

from bodycheck.reference_impl.arrays import Array

LINE_POINTS = 81  # more are indistinguishable on a screen and enlarge the page


LEAST = 1e-18  # of a line on a logarithmic axis; smaller values are 0
CODES_PER_DECADE = 2500  # of a line on a logarithmic axis


def rounded(value: float) -> float:
    """Return a number rounded to 4 digits."""
    return float(f"{value:.4g}")


def packed_fractions(values: Array, largest: float = 1.0) -> str:
    """Return numbers of at most `largest` as the base64 of little-endian int16, 32767 for `largest`."""
    fractions = np.clip(values / (largest or 1.0), -1.0, 1.0)
    return b64encode(np.round(np.iinfo(np.int16).max * fractions).astype("<i2").tobytes()).decode()


def packed_line(values: Array) -> str | float:
    """Return a line of values >= 0 for a logarithmic axis, exact to 5e-4; for a constant line, its value.

    The base64 of little-endian uint16: 0 below 1e-18, else 2500 (18 + log10 value), at most 65535.
    """
    if np.all(values == values[0]):
        return rounded(float(min(values[0], np.finfo(np.float64).max)))
    codes = np.round(CODES_PER_DECADE * (np.log10(np.maximum(values, LEAST)) - np.log10(LEAST)))
    return b64encode(np.minimum(codes, np.iinfo(np.uint16).max).astype("<u2").tobytes()).decode()


def thinned_times(t_s: Array) -> Array:
    """Return the last time of each of the at most LINE_POINTS buckets of samples."""
    ends = np.append(_bucket_starts(len(t_s))[1:], len(t_s)) - 1
    return np.asarray(t_s[ends])


def thinned_maxima(values: Array) -> Array:
    """Return the largest value of each bucket, so that no peak is lost."""
    return np.asarray(np.maximum.reduceat(values, _bucket_starts(len(values))))


def _bucket_starts(samples: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.arange(0, samples, -(-samples // LINE_POINTS), dtype=np.intp)
