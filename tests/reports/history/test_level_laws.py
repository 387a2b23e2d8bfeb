"""Levels and series by hand: a step told at its very edge, the spread it is measured by, the usual number."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.history.regression import _farthest
from bodycheck.reports.history.step_detection import (
    Series,
    Step,
    detect_steps,
    pooled_spread,
    series_of,
    smallest_detectable_step,
)

LEAST = math.log10(1.08)


def column(*levels: tuple[float, int]) -> Array:
    """Return one method's series without noise: each level for so many nights."""
    return np.concatenate([np.full(nights, level) for level, nights in levels])[:, None]


@pytest.mark.parametrize(("sign", "told_on"), [(1.0, 14), (-1.0, 12)])
@pytest.mark.parametrize(("size", "told"), [(0.999 * LEAST, 0), (1.001 * LEAST, 1)])
def test_without_noise_a_step_is_told_beyond_a_twelfth(
    size: float, told: int, sign: float, told_on: int
) -> None:
    """Up on the fifth night of the new level, down on the third, with its first night and its size."""
    (found,) = detect_steps(column((0.0, 10), (sign * size, 6)))
    assert [(step.first, step.detected_at) for step in found] == told * [(10, told_on)]
    assert [step.size for step in found] == pytest.approx(told * [sign * size])


def test_each_step_is_told_once_and_from_its_own_level_on() -> None:
    """Up by a half after 9 nights, and back after 10 more; what was before a step counts no more."""
    (found,) = detect_steps(column((0.0, 9), (0.5, 10), (0.0, 6)))
    assert found == [Step(9, 13, 0.5), Step(19, 21, -0.5)]


def test_the_first_night_that_can_tell_is_the_thirteenth() -> None:
    """Eight nights before and five after; a night without a figure tells nothing, and shifts no other."""
    (found,) = detect_steps(column((0.0, 8), (0.5, 5)))
    assert found == [Step(8, 12, 0.5)]
    assert detect_steps(column((0.0, 7), (0.5, 5))) == [[]]
    holed = np.insert(column((0.0, 8), (0.5, 5)), 2, math.nan, axis=0)
    assert detect_steps(holed) == [[Step(9, 13, 0.5)]]
    assert detect_steps(np.append(holed, [[math.nan]], axis=0)) == [[Step(9, 13, 0.5)]]


def test_one_quick_night_shows_that_a_method_is_not_slower() -> None:
    """The quickest of the five nights is the one that counts; of a quicker method two may be slow."""
    for quickest, told in ((1.001 * LEAST, 1), (0.999 * LEAST, 0)):
        series = column((0.0, 8), (0.5, 5))
        series[10, 0] = quickest
        assert [len(steps) for steps in detect_steps(series)] == [told]
    for slow, told in (([9, 11], 1), ([9, 11, 12], 0)):
        series = column((0.0, 8), (-0.5, 5))
        series[slow, 0] = 0.3
        assert [len(steps) for steps in detect_steps(series)] == [told]


def test_a_method_that_became_quicker_is_told_so_whatever_disturbs_two_of_its_nights() -> None:
    """Even where the two disturbed ones, and the least quick one, lie closest together."""
    series = column((0.0, 8), (0.0, 5))
    series[8:, 0] = [-0.5, -0.3, -0.1, 0.0, 0.01]
    assert detect_steps(series) == [[Step(8, 12, -0.1)]]


def test_disturbed_nights_before_are_not_the_level() -> None:
    """Of twenty nights nine may be slower by anything; a quick one among them hides a speed-up alone."""
    for disturbed, told in ((9, 1), (11, 0)):
        series = column((0.0, 20), (0.1, 5))
        series[1 : 1 + disturbed, 0] = 0.3
        assert [len(steps) for steps in detect_steps(series)] == [told]
    for sign in (1.0, -1.0):
        series = column((0.0, 20), (sign * 0.1, 5))
        series[7, 0] = -0.2
        assert [len(steps) for steps in detect_steps(series)] == [int(sign > 0.0)]


def test_the_night_after_has_no_say_in_what_is_usual() -> None:
    """Steps near the edge are told on the same nights, whether the later nights are there or not."""
    rng = np.random.default_rng(5)
    series = 0.01 * rng.normal(size=(24, 30))
    series[12:] += rng.uniform(0.02, 0.08, 30)
    late = detect_steps(series)
    for cut in range(8, 24):
        assert detect_steps(series[:cut]) == [
            [one for one in steps if one.detected_at < cut] for steps in late
        ]


def test_the_usual_spread_is_the_median_over_the_methods() -> None:
    """Half of the width of the shortest half over 0.6745, in the twenty nights before the last five."""
    steps = np.arange(30.0)[:, None] * np.array([0.01, 0.03, 0.02])
    # eleven of twenty nights, a step apart, and the factor for so few
    expected = 0.5 * 10.0 * 0.02 / 0.6745 * (1.0 + 5.0 / 19.0)
    assert pooled_spread(steps, [[]] * 3) == pytest.approx(expected)
    steps[:5] = steps[25:] = 7.0
    assert pooled_spread(steps, [[]] * 3) == pytest.approx(expected)
    unmeasured = np.insert(steps, 1, math.nan, axis=1)
    assert pooled_spread(unmeasured, [[]] * 4) == pytest.approx(expected)
    # of a method that moved only what came after counts, once it is long enough
    assert pooled_spread(steps, [[], [Step(17, 21, 1.0)], []]) == pytest.approx(
        np.median(
            [0.5 * 0.01 * 10.0 * (1.0 + 5.0 / 19.0), 0.5 * 0.03 * 4.0 * (1.0 + 5.0 / 7.0), expected * 0.6745]
        )
        / 0.6745
    )
    assert pooled_spread(steps, [[Step(18, 22, 1.0)]] * 3) == 0.0


def test_what_is_sure_to_be_told_is_the_edge_and_what_chance_does() -> None:
    """max(8 %, 2.5 sigma) + 3.5 sigma."""
    assert smallest_detectable_step(0.1) == pytest.approx(0.6)
    assert smallest_detectable_step(0.001) == pytest.approx(LEAST + 0.0035)
    assert smallest_detectable_step(0.0) == LEAST


def test_a_step_is_told_beyond_two_and_a_half_sigma() -> None:
    """sigma is that of most methods, not the method's own."""
    spread = 0.04 * np.linspace(-1.0, 1.0, 20)
    for factor, told in ((0.999, 0), (1.001, 1)):
        series = np.zeros((25, 4))
        series[:20, 1:] = spread[:, None]
        edge = 2.5 * pooled_spread(series, [[]] * 4)
        assert edge > LEAST
        series[20:, 0] = factor * edge
        assert [len(steps) for steps in detect_steps(series)] == [told, 0, 0, 0]


# ------------------------------------------------------------------------------------------------- series

ROW = {"engine": "e", "method": "m", "scenario": "s", "control": "dt", "dt_s": 0.1, "tolerance": math.nan}


def cases(*rows: dict[str, object]) -> pd.DataFrame:
    """Return cases of one method at one step, but for what is told."""
    return pd.DataFrame([{**ROW, **row} for row in rows])


def test_each_case_is_measured_over_its_own_median() -> None:
    """In decades: nights of 1, 10 and 100 are -1, 0, 1; another case's size is no matter."""
    rows = [{"night": night, "x": 10.0**k} for k, night in enumerate("abc")]
    rows += [{"night": night, "x": 1e-5, "dt_s": 0.2} for night in "abc"]
    rows += [{"night": night, "x": 1e7, "control": "tolerance", "tolerance": 1e-6} for night in "abc"]
    rows += [{"night": night, "x": 1e3, "scenario": "t"} for night in "abc"]
    found = series_of("abcd", cases(*rows), "x", lambda decades: float(decades.sum()))
    assert (found.nights, found.methods) == (("a", "b", "c", "d"), (("e", "m"),))
    assert found.decades[:3, 0] == pytest.approx([-1.0, 0.0, 1.0])
    assert np.isnan(found.decades[3, 0])
    assert found.measured == 3


def test_methods_are_columns_in_the_order_of_their_names_and_nights_rows_in_theirs() -> None:
    """What a method did on a night on which it was not measured is NaN; 0 is no measurement."""
    rows = [
        {"night": "b", "engine": "z", "x": 1.0},
        {"night": "a", "method": "n", "x": 0.5},
        {"night": "a", "x": 1.0},
        {"night": "b", "x": 100.0},
        {"night": "b", "method": "n", "x": 0.0},
    ]
    found = series_of(["b", "a"], cases(*rows), "x", lambda decades: float(decades.max()))
    assert found.methods == (("e", "m"), ("e", "n"), ("z", "m"))
    assert found.decades == pytest.approx(
        np.array([[1.0, math.nan, 0.0], [-1.0, 0.0, math.nan]]), nan_ok=True
    )


def test_of_nothing_there_is_a_series_of_no_methods() -> None:
    """Its nights are there, and nothing was measured on any."""
    found = series_of(["a", "b"], cases({"night": "a", "x": 0.0}), "x", lambda decades: float(decades.max()))
    assert (found.nights, found.methods, found.decades.shape, found.measured) == (("a", "b"), (), (2, 0), 0)
    partly = Series(("a", "b"), (("e", "m"), ("e", "n")), np.array([[1.0, math.nan], [math.nan] * 2]))
    assert partly.measured == 1


def test_the_farthest_of_a_methods_errors_stands_for_them() -> None:
    """Whichever way it went."""
    assert _farthest(pd.Series([0.5, -2.0, 1.0])) == -2.0
