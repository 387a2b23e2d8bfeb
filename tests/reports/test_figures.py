"""The data behind the plots."""

from __future__ import annotations

from base64 import b64decode

import numpy as np

from bodycheck.reports.figures import (
    DASHES,
    LINE_POINTS,
    MARKERS,
    packed_line,
    styles,
    thinned_maxima,
    thinned_times,
)


def test_thinned_lines_keep_their_peaks() -> None:
    """A line of many samples keeps its largest value and its last time; a short one keeps every sample."""
    values = np.random.default_rng(1).random(10_007)
    times = np.arange(10_007.0)
    assert len(thinned_times(times)) == len(thinned_maxima(values)) <= LINE_POINTS
    assert thinned_maxima(values).max() == values.max()
    assert thinned_times(times)[-1] == times[-1]
    assert np.array_equal(thinned_maxima(values[:LINE_POINTS]), values[:LINE_POINTS])
    unpacked = np.frombuffer(b64decode(str(packed_line(values))), dtype="<f4")
    assert np.array_equal(unpacked, thinned_maxima(values).astype("f4"))
    assert packed_line(np.zeros(50)) == 0.0


def test_lines_can_be_told_without_colour() -> None:
    """No two of as many methods as there are pairs of marker and dash look alike."""
    several = styles((f"engine-{i % 4}", f"method-{i}") for i in range(len(MARKERS) * len(DASHES)))
    assert len({(style.marker, style.dash) for style in several.values()}) == len(several)
