"""The data behind the plots."""

from __future__ import annotations

import re
from base64 import b64decode

import numpy as np
import pytest

from bodycheck.reports.render.page.downsampling import LINE_POINTS, packed_line, thinned_maxima, thinned_times
from bodycheck.reports.render.page.plots import growth_text
from bodycheck.reports.render.styles import (
    COLOURS,
    CONTEXT,
    DASHES,
    MARKERS,
    TRUTH,
    engine_colour,
    heading,
    merged,
    styles,
)
from bodycheck.reports.templating import asset


def test_thinned_lines_keep_their_peaks() -> None:
    """A long line keeps its largest value and its last time; a short one keeps every sample."""
    values = np.random.default_rng(1).random(10_007)
    times = np.arange(10_007.0)
    assert len(thinned_times(times)) == len(thinned_maxima(values)) <= LINE_POINTS
    assert thinned_maxima(values).max() == values.max()
    assert thinned_times(times)[-1] == times[-1]
    assert np.array_equal(thinned_maxima(values[:LINE_POINTS]), values[:LINE_POINTS])


def test_a_packed_line_has_three_digits() -> None:
    """Decoding gives every value back to 5e-4, and 0 below 1e-18; a constant is stored as a number."""
    values = np.append(10.0 ** np.random.default_rng(1).uniform(-17.9, 8.0, 1000), [0.0, 1e-19])
    codes = np.frombuffer(b64decode(str(packed_line(values))), dtype="<u2")
    unpacked = np.where(codes > 0, 10.0 ** (codes / 2500 - 18), 0.0)
    np.testing.assert_allclose(unpacked, np.where(values < 1e-18, 0.0, values), rtol=5e-4)
    assert packed_line(np.zeros(50)) == 0.0
    assert packed_line(np.full(3, 0.25)) == 0.25


def test_lines_can_be_distinguished_without_colour() -> None:
    """As many methods as there are pairs of marker and dash all look different."""
    several = styles((f"engine-{i % 4}", f"method-{i}") for i in range(len(MARKERS) * len(DASHES)))
    assert len({(style.marker, style.dash) for style in several.values()}) == len(several)


def test_an_engine_has_one_colour_in_every_run() -> None:
    """Its colour depends on its name only, not on the other engines."""
    engines = ("mujoco", "pybullet", "dart", "reference", "other", "another")
    together = styles((engine, "m1") for engine in engines)
    for engine in engines:
        alone = styles([(engine, "rk4")])[engine, "rk4"].colour
        assert alone == together[engine, "m1"].colour == engine_colour(engine)
        assert 0 <= alone < 8
    assert len({engine_colour(engine) for engine in engines[:4]}) == 4
    assert {engine_colour(engine) for engine in engines[4:]} <= set(range(4, 8))


def test_figures_and_pages_have_the_same_colours() -> None:
    """A dark page has another value of each colour of engines, the truth and the context; scripts use all."""
    light, dark = str(asset("templates/report.css")).split("@media")[:2]
    names = [f"engine-{number}" for number in range(len(COLOURS))] + ["truth", "context"]
    values = [dict(re.findall(r"--([\w-]+): (#\w+)", part)) for part in (light, dark)]
    assert [values[0][name] for name in names] == [*COLOURS, TRUTH, CONTEXT]
    assert all(values[0][name] != values[1][name] for name in names)
    scripts = "".join(str(asset(f"templates/{name}.js")) for name in ("page", "motion", "plot_style"))
    assert {"--engine-", "--truth", "--context"} <= {*re.findall(r"--(?:engine-|truth|context)", scripts)}


def test_only_equal_lines_are_merged() -> None:
    """Lines that differ by less than 2e-3 everywhere, or only below the floor, are merged; others are not."""
    x, y = np.array([1.0, 2.0, 3.0]), np.array([1e-3, 1e-6, 1e-12])
    lines = {
        "first": (x, y),
        "equal": (x, y * 1.001),
        "elsewhere": (x + 1.0, y),
        "shorter": (x[:2], y[:2]),
        "below the floor": (x, y * [1.0, 1.0, 5.0]),
        "different": (x, y * [1.0, 1.01, 1.0]),
        "equal to different": (x, y * [1.0, 1.011, 1.0]),
    }
    assert merged(lines, floor=1e-11) == [
        ["first", "equal", "below the floor"],
        ["elsewhere"],
        ["shorter"],
        ["different", "equal to different"],
    ]
    assert ["below the floor"] in merged(lines, floor=1e-13)


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("orientation_error_rad", "orientation error, rad"),
        ("energy_drift", "energy drift"),
        ("cpu_s", "CPU time, s"),
        ("order", "order"),
    ],
)
def test_a_heading_is_words_with_a_unit(column: str, words: str) -> None:
    """The unit of a column comes after a comma; a column without a unit has its words only."""
    assert heading(column) == words


@pytest.mark.parametrize(
    ("growth", "exponent", "words"),
    [
        ("linear", 1.018, "linear, t^1.02"),
        ("sqrt", 0.5, "sqrt, t^0.5"),
        ("bounded", 0.02, "bounded"),
        ("exponential", 3.0, "exponential"),
        (None, np.nan, ""),
    ],
)
def test_a_growth_is_described_with_its_exponent(growth: str, exponent: float, words: str) -> None:
    """A power of t has its exponent, bounded and exponential growth do not, and a missing growth is empty."""
    assert growth_text({"growth": growth, "growth_exponent": exponent}) == words
