"""The data behind the plots."""

from __future__ import annotations

from base64 import b64decode

import numpy as np
import pytest

from bodycheck.reports.render.page.downsampling import LINE_POINTS, packed_line, thinned_maxima, thinned_times
from bodycheck.reports.render.page.plots import growth_words
from bodycheck.reports.render.styles import DASHES, MARKERS, styles


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


@pytest.mark.parametrize(
    ("growth", "exponent", "words"),
    [
        ("linear", 1.018, "linear, t^1.02"),
        ("sqrt", 0.5, "sqrt, t^0.5"),
        ("bounded", 0.02, "bounded"),
        ("exponential", 3.0, "exponential"),
        (np.nan, np.nan, ""),
        (None, np.nan, ""),
    ],
)
def test_a_growth_is_told_with_its_exponent(growth: str, exponent: float, words: str) -> None:
    """A power of t has its exponent; what is bounded or exponential has none, and nothing is nothing."""
    assert growth_words({"growth": growth, "growth_exponent": exponent}) == words
