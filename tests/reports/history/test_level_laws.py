"""Levels and series by hand: a step told at its very edge, the spread it is measured by, the usual number."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pandas as pd
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.history.judgement import _farthest
from bodycheck.reports.history.levels import Step, least_told, level_steps, usual_spread
from bodycheck.reports.history.series import Series, series_of

MAD = 1.4826  # the standard deviation over the median absolute deviation, of a normal distribution
LEAST = math.log10(1.05)


def column(*levels: tuple[float, int]) -> Array:
    """Return one method's series without noise: each level for so many nights."""
    return np.concatenate([np.full(nights, level) for level, nights in levels])[:, None]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("size", "told"), [(LEAST, 0), (1.001 * LEAST, 1)])
def test_without_noise_a_step_is_told_beyond_a_twentieth(size: float, told: int, sign: float) -> None:
    """On the fifth night of the new level, with its first night and its size."""
    (found,) = level_steps(column((0.0, 8), (sign * size, 6)))
    assert [(step.first, step.told) for step in found] == told * [(8, 12)]
    assert [step.size for step in found] == pytest.approx(told * [sign * size])


def test_each_step_is_told_once_and_from_its_own_level_on() -> None:
    """Up by a half after 9 nights, and back after 10 more; what was before a step counts no more."""
    (found,) = level_steps(column((0.0, 9), (0.5, 10), (0.0, 6)))
    assert found == [Step(9, 13, 0.5), Step(19, 23, -0.5)]


def test_the_first_night_that_can_tell_is_the_thirteenth() -> None:
    """Eight nights before and five after; a night without a figure tells nothing, and shifts no other."""
    (found,) = level_steps(column((0.0, 8), (0.5, 5)))
    assert found == [Step(8, 12, 0.5)]
    assert level_steps(column((0.0, 7), (0.5, 5))) == [[]]
    holed = np.insert(column((0.0, 8), (0.5, 5)), 2, math.nan, axis=0)
    assert level_steps(holed) == [[Step(9, 13, 0.5)]]
    assert level_steps(np.append(holed, [[math.nan]], axis=0)) == [[Step(9, 13, 0.5)]]


def test_one_night_of_the_new_level_that_does_not_share_the_step_ends_it() -> None:
    """Each of them has to share more than a half: 0.26 of 0.5 does, 0.25 does not."""
    for share, told in ((0.26, 1), (0.25, 0)):
        series = column((0.0, 8), (0.5, 5))
        series[8:13, 0] = [0.5, 0.5, share, 0.5, 0.5]
        (found,) = level_steps(series)
        assert len(found) == told


def test_fewer_than_a_quarter_of_wild_nights_hide_no_step_and_more_do() -> None:
    """What chance does is told by three quarters of the nights before: of twenty, four may be anything."""
    for wild, told in ((4, 1), (6, 0)):
        series = column((0.0, 20), (0.1, 5))
        series[1 : 1 + 3 * wild : 3, 0] = 0.3
        (found,) = level_steps(np.hstack([series, np.zeros((25, 3))]))[:1]
        assert len(found) == told


def test_the_night_after_has_no_say_in_what_is_usual() -> None:
    """Steps near the edge are told on the same nights, whether the later nights are there or not."""
    rng = np.random.default_rng(5)
    series = 0.01 * rng.normal(size=(24, 30))
    series[12:] += rng.uniform(0.02, 0.08, 30)
    late = level_steps(series)
    for cut in range(8, 24):
        assert level_steps(series[:cut]) == [[one for one in steps if one.told < cut] for steps in late]


def test_the_usual_spread_is_the_median_over_the_methods_of_the_last_twenty_nights() -> None:
    """MAD / sqrt(2) of the moves night by night; not of older nights, nor of what was never measured."""
    quiet = np.outer((-1.0) ** np.arange(25), [0.01, 0.03, 0.02])  # each moves by twice its height
    quiet[:5] *= 1000.0
    quiet[19:] *= 2.0  # fewer than half of those nights
    expected = MAD / math.sqrt(2.0) * 0.04
    assert usual_spread(quiet) == pytest.approx(expected)
    assert usual_spread(np.insert(quiet, 1, math.nan, axis=1)) == pytest.approx(expected)
    assert usual_spread(quiet[:1]) == 0.0
    holed = quiet.copy()
    holed[10, 2] = math.nan
    assert usual_spread(holed) == pytest.approx(expected)


@pytest.mark.parametrize("nights", [5, 20, 40])
def test_what_is_sure_to_be_told_shrinks_with_the_nights_before(nights: int) -> None:
    """(1.5 x 7 + 2) sigma sqrt(1/5 + 1/n), n no more than 20; never less than a twentieth."""
    assert least_told(0.1, nights) == pytest.approx(1.25 * math.sqrt(0.2 + 1.0 / min(nights, 20)))
    assert least_told(0.0, nights) == LEAST


def test_a_step_is_told_beyond_seven_sigma_of_its_error() -> None:
    """sigma of nights that go to and fro by h: h / 1.15 and 1/n of it, beside what is usual."""
    height, before, after = 0.02, 20, 5
    to_and_fro = height * (-1.0) ** np.arange(before)
    spread = height / NormalDist().inv_cdf(0.875) * (1.0 + 1.0 / before)
    sigma = spread * math.sqrt(before / (before + 5.0))  # the usual one is 0, and counts as five nights
    edge = 7.0 * sigma * math.sqrt(1.0 / after + 1.0 / before)
    for factor, told in ((0.999, 0), (1.001, 1)):
        series = np.zeros((before + after, 4))
        series[:before, 0] = to_and_fro
        series[before:, 0] = factor * edge
        assert [len(steps) for steps in level_steps(series)] == [told, 0, 0, 0]


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
