"""Step detection in series of speeds: false alarms, delay, size, and the levels and noise behind them."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.history.regression import _farthest, speeds_of
from bodycheck.reports.history.step_detection import (
    MIN_BEFORE,
    Series,
    Step,
    detect_steps,
    pooled_spread,
    series_of,
    smallest_detectable_step,
)

FIFTH = math.log10(1.2)
SIGMA = 0.012  # spread of the median over a method's cases between nightly runs


def noise(seed: int, runs: int, methods: int = 20, disturbed: float = 0.0) -> Array:
    """Return independent noise in decades; in disturbed runs a method takes up to 1.5 times as long."""
    rng = np.random.default_rng(seed)
    load = np.where(rng.random((runs, methods)) < disturbed, rng.random((runs, methods)), 0.0)
    return SIGMA * rng.normal(size=(runs, methods)) + math.log10(1.5) * load


@pytest.mark.slow(after=1)
@pytest.mark.nightly(after=4)
@pytest.mark.parametrize("disturbed", [0.0, 0.02, 0.15])
@pytest.mark.parametrize("seed", range(4))
def test_unchanged_runs_have_no_step(seed: int, disturbed: float) -> None:
    """In twenty methods over sixty runs, some of them disturbed, no step is reported."""
    assert not any(detect_steps(noise(seed, 60, disturbed=disturbed)))


@pytest.mark.slow(after=8)
@pytest.mark.parametrize("nights_before", [MIN_BEFORE, 10, 30])
@pytest.mark.parametrize("factor", [1.2, 1.0 / 1.2])
@pytest.mark.parametrize("seed", range(5))
def test_step_of_a_fifth_is_reported_once_within_five_runs(
    seed: int, factor: float, nights_before: int
) -> None:
    """At least four of five changed methods are reported once with their sign, and no other."""
    series = noise(seed, nights_before + 12)
    moved = range(5)
    series[nights_before:, moved] += math.log10(factor)
    found = detect_steps(series)
    assert not any(found[len(moved) :])
    assert [len(found[method]) for method in moved].count(1) >= 4
    for step in (step for method in moved for step in found[method]):
        assert nights_before <= step.detected_at <= nights_before + 4
        assert abs(step.first - nights_before) <= 2
        assert step.size == pytest.approx(math.log10(factor), abs=4.0 * SIGMA)


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 10_000), height=st.floats(-0.5, 0.5), at=st.integers(0, 29), cut=st.integers(1, 30)
)
def test_later_runs_do_not_change_earlier_reports(seed: int, height: float, at: int, cut: int) -> None:
    """What is reported by some run is the same with and without later runs."""
    series = noise(seed, 30, methods=4)
    series[at:, 0] += height
    series[np.random.default_rng(seed).random(series.shape) < 0.1] = math.nan
    early, late = detect_steps(series[:cut]), detect_steps(series)
    assert early == [[step for step in steps if step.detected_at < cut] for steps in late]


@pytest.mark.parametrize("seed", range(5))
def test_step_is_reported_although_every_fourth_run_is_disturbed(seed: int) -> None:
    """Disturbed runs neither hide that five methods became slower nor accuse others."""
    series = noise(seed, 25, disturbed=0.25)
    series[20:, :5] += FIFTH
    found = detect_steps(series)
    assert [len(steps) for steps in found[:5]].count(1) >= 4
    assert not any(found[5:])


def test_one_run_is_not_a_level() -> None:
    """A run in which everything took three times as long is a disturbance of the machine."""
    series = noise(1, 30)
    series[15] = math.log10(3.0)
    assert not any(detect_steps(series))


def test_runs_without_a_measurement_change_nothing() -> None:
    """A series with gaps is judged as it would be without those runs."""
    whole = noise(3, 30, methods=6)
    whole[15:, 2] += FIFTH
    holes = np.insert(whole, [4, 12, 20], math.nan, axis=0)
    places = [k for k in range(len(holes)) if not np.isnan(holes[k]).any()]
    detected = [
        [(places[s.first], places[s.detected_at], s.size) for s in steps] for steps in detect_steps(whole)
    ]
    assert [[(s.first, s.detected_at, s.size) for s in steps] for steps in detect_steps(holes)] == detected


def test_pooled_spread_is_that_of_the_noise() -> None:
    """Methods with a reported step, or without measurements, do not increase it."""
    series = noise(4, 40, methods=101)
    series[20:, :30] += 1.0
    series[:, 30:40] = math.nan
    steps = detect_steps(series)
    assert all(steps[:30])
    assert pooled_spread(series, steps) == pytest.approx(SIGMA, rel=0.15)


def test_spread_of_too_few_runs_is_zero() -> None:
    """With fewer runs than a level needs the spread is 0."""
    few = noise(5, MIN_BEFORE - 1)
    assert pooled_spread(few, detect_steps(few)) == 0.0


def test_smallest_detectable_step_is_reported() -> None:
    """Of 200 steps of the promised size at least 98 % are reported within five runs."""
    size = smallest_detectable_step(SIGMA)
    detected = []
    for seed in range(10):
        series = noise(seed, 25)
        series[20:] += size
        detected += [bool(steps) for steps in detect_steps(series)]
    assert np.mean(detected) >= 0.98


CREEP = math.log10(1.004)


def creeping(seed: int, runs: int, before: int, methods: int = 20, disturbed: float = 0.0) -> Array:
    """Return noise with every method 0.4 % slower in each run after the first `before`."""
    slower = CREEP * np.maximum(np.arange(before + runs) - before + 1.0, 0.0)
    return noise(seed, before + runs, methods, disturbed) + slower[:, None]


@pytest.mark.parametrize("disturbed", [0.0, 0.15])
@pytest.mark.parametrize("before", [0, 20])
def test_creep_is_reported_before_it_reaches_a_fifth(before: int, disturbed: float) -> None:
    """Of 40 methods that become 0.4 % slower in each run, at least 36 are reported within 45 such runs."""
    found = detect_steps(creeping(before, 45, before, methods=40, disturbed=disturbed))
    assert sum(any(step.size > 0.0 and step.detected_at >= before for step in one) for one in found) >= 36


def test_creep_of_one_method_is_reported_once_for_each_shift() -> None:
    """The level after a report is the accepted one; the 19 constant methods are not reported."""
    series = noise(8, 120)
    series[:, 0] += CREEP * np.arange(120)
    moved, *constant = detect_steps(series)
    assert not any(constant)
    assert len(moved) >= 2
    assert moved[0].creeps
    assert all(step.size > LEAST for step in moved)
    assert sum(step.size for step in moved) < CREEP * 120


def test_creep_to_a_faster_level_has_its_sign() -> None:
    """A method that becomes 0.4 % faster in each run is reported with a negative size."""
    (found,) = detect_steps(-CREEP * np.arange(45.0)[:, None])
    assert [(step.creeps, step.size < -LEAST) for step in found] == [(True, True)]


def test_a_level_is_that_of_the_undisturbed_runs() -> None:
    """No creep where eleven of the latest fifteen runs are 30 % slower, and the other four as before."""
    series = noise(8, 40)
    series[25:, 0] += math.log10(1.3)
    series[[26, 30, 34, 38], 0] -= math.log10(1.3)
    assert not any(detect_steps(series))


@pytest.mark.nightly
def test_a_speed_that_creeps_more_slowly_than_the_latest_runs_show_is_reported() -> None:
    """By 0.05 % in each of 200 runs, of which the last sixty and the first twenty are judged."""

    def rows_of(runs: range) -> tuple[list[str], pd.DataFrame]:
        names = [f"run {run:03d}" for run in runs]
        times = [10.0 ** (math.log10(1.0005) * run + 1e-3 * math.sin(7.0 * run)) for run in runs]
        return names, cases(*({"run": n, "relative_cpu": t} for n, t in zip(names, times, strict=True)))

    names, latest = rows_of(range(140, 200))
    assert not any(speeds_of(names, latest).steps.values())
    (steps,) = speeds_of(names, latest, (), rows_of(range(20))).steps.values()
    assert steps
    reported = []
    for last in range(100, 200):
        names, latest = rows_of(range(last - 60, last))
        reported += [change.status for change in speeds_of(names, latest, (), rows_of(range(20))).changes]
    assert reported == ["worse"]


# -------------------------------------------------------------------------------------- series without noise


LEAST = math.log10(1.08)


def column(*levels: tuple[float, int]) -> Array:
    """Return one method's series without noise: each level for a number of runs."""
    return np.concatenate([np.full(runs, level) for level, runs in levels])[:, None]


@pytest.mark.parametrize(("sign", "detected_on"), [(1.0, 14), (-1.0, 12)])
@pytest.mark.parametrize(("size", "detected"), [(0.999 * LEAST, 0), (1.001 * LEAST, 1)])
def test_step_without_noise_is_reported_beyond_8_percent(
    size: float, detected: int, sign: float, detected_on: int
) -> None:
    """Slower in the fifth run of the new level, faster in the third, with first run and size."""
    (found,) = detect_steps(column((0.0, 10), (sign * size, 6)))
    assert [(step.first, step.detected_at) for step in found] == detected * [(10, detected_on)]
    assert [step.size for step in found] == pytest.approx(detected * [sign * size])


def test_each_step_is_reported_once_from_its_own_level() -> None:
    """Steps by 0.5 after 9 runs, and back after 10 more, are reported; runs before a step no longer count."""
    (found,) = detect_steps(column((0.0, 9), (0.5, 10), (0.0, 6)))
    assert found == [Step(9, 13, 0.5), Step(19, 21, -0.5)]


def test_first_step_can_be_reported_in_the_thirteenth_run() -> None:
    """Eight runs before and five after; a run without a value shifts no other."""
    (found,) = detect_steps(column((0.0, 8), (0.5, 5)))
    assert found == [Step(8, 12, 0.5)]
    assert detect_steps(column((0.0, 7), (0.5, 5))) == [[]]
    holed = np.insert(column((0.0, 8), (0.5, 5)), 2, math.nan, axis=0)
    assert detect_steps(holed) == [[Step(9, 13, 0.5)]]
    assert detect_steps(np.append(holed, [[math.nan]], axis=0)) == [[Step(9, 13, 0.5)]]


def test_one_fast_run_excludes_that_a_method_is_slower() -> None:
    """The fastest of five runs counts; of a faster method two runs may be slow."""
    for fastest, detected in ((1.001 * LEAST, 1), (0.999 * LEAST, 0)):
        series = column((0.0, 8), (0.5, 5))
        series[10, 0] = fastest
        assert [len(steps) for steps in detect_steps(series)] == [detected]
    for slow, detected in (([9, 11], 1), ([9, 11, 12], 0)):
        series = column((0.0, 8), (-0.5, 5))
        series[slow, 0] = 0.3
        assert [len(steps) for steps in detect_steps(series)] == [detected]


def test_faster_method_is_reported_despite_two_disturbed_runs() -> None:
    """Even if the two disturbed runs and the slowest other one lie closest together."""
    series = column((0.0, 8), (0.0, 5))
    series[8:, 0] = [-0.5, -0.3, -0.1, 0.0, 0.01]
    assert detect_steps(series) == [[Step(8, 12, -0.1)]]


def test_disturbed_baseline_runs_are_not_the_level() -> None:
    """Nine of twenty runs may be slower by any amount; one fast run hides only a speed-up."""
    for disturbed, detected in ((9, 1), (11, 0)):
        series = column((0.0, 20), (0.1, 5))
        series[1 : 1 + disturbed, 0] = 0.3
        assert [len(steps) for steps in detect_steps(series)] == [detected]
    for sign in (1.0, -1.0):
        series = column((0.0, 20), (sign * 0.1, 5))
        series[7, 0] = -0.2
        assert [len(steps) for steps in detect_steps(series)] == [int(sign > 0.0)]


def test_later_runs_do_not_change_the_spread() -> None:
    """Steps near the threshold are reported in the same runs, with and without later ones."""
    rng = np.random.default_rng(5)
    series = 0.01 * rng.normal(size=(24, 30))
    series[12:] += rng.uniform(0.02, 0.08, 30)
    late = detect_steps(series)
    for cut in range(8, 24):
        assert detect_steps(series[:cut]) == [
            [one for one in steps if one.detected_at < cut] for steps in late
        ]


def test_pooled_spread_is_the_median_over_the_methods() -> None:
    """Half the width of the shortest half over 0.6745, in the twenty runs before the last five."""
    steps = np.arange(30.0)[:, None] * np.array([0.01, 0.03, 0.02])
    # eleven of twenty nightly runs span ten increments; the last factor corrects for the small number
    expected = 0.5 * 10.0 * 0.02 / 0.6745 * (1.0 + 5.0 / 19.0)
    assert pooled_spread(steps, [[]] * 3) == pytest.approx(expected)
    steps[:5] = steps[25:] = 7.0
    assert pooled_spread(steps, [[]] * 3) == pytest.approx(expected)
    unmeasured = np.insert(steps, 1, math.nan, axis=1)
    assert pooled_spread(unmeasured, [[]] * 4) == pytest.approx(expected)
    # of a method that moved, only the later runs count, once there are enough
    assert pooled_spread(steps, [[], [Step(17, 21, 1.0)], []]) == pytest.approx(
        np.median(
            [0.5 * 0.01 * 10.0 * (1.0 + 5.0 / 19.0), 0.5 * 0.03 * 4.0 * (1.0 + 5.0 / 7.0), expected * 0.6745]
        )
        / 0.6745
    )
    assert pooled_spread(steps, [[Step(18, 22, 1.0)]] * 3) == 0.0


def test_smallest_detectable_step_is_the_threshold_and_the_noise() -> None:
    """max(8 %, 2.5 sigma) + 3.5 sigma."""
    assert smallest_detectable_step(0.1) == pytest.approx(0.6)
    assert smallest_detectable_step(0.001) == pytest.approx(LEAST + 0.0035)
    assert smallest_detectable_step(0.0) == LEAST


def test_step_is_reported_beyond_two_and_a_half_sigma() -> None:
    """sigma is that of most methods, not the method's own."""
    spread = 0.04 * np.linspace(-1.0, 1.0, 20)
    for factor, detected in ((0.999, 0), (1.001, 1)):
        series = np.zeros((25, 4))
        series[:20, 1:] = spread[:, None]
        edge = 2.5 * pooled_spread(series, [[]] * 4)
        assert edge > LEAST
        series[20:, 0] = factor * edge
        assert [len(steps) for steps in detect_steps(series)] == [detected, 0, 0, 0]


# ------------------------------------------------------------------------------------------------- series

ROW = {"engine": "e", "method": "m", "scenario": "s", "control": "dt", "dt_s": 0.1, "tolerance": math.nan}


def cases(*rows: dict[str, object]) -> pd.DataFrame:
    """Return cases of one method at one step, with the given cells replaced."""
    return pd.DataFrame([{**ROW, **row} for row in rows])


def test_series_is_relative_to_the_median_of_each_case() -> None:
    """In decades: runs of 1, 10 and 100 are -1, 0, 1; the size of another case does not matter."""
    rows = [{"run": run, "x": 10.0**k} for k, run in enumerate("abc")]
    rows += [{"run": run, "x": 1e-5, "dt_s": 0.2} for run in "abc"]
    rows += [{"run": run, "x": 1e7, "control": "tolerance", "tolerance": 1e-6} for run in "abc"]
    rows += [{"run": run, "x": 1e3, "scenario": "t"} for run in "abc"]
    found = series_of("abcd", cases(*rows), "x", lambda decades: float(decades.sum()))
    assert (found.runs, found.methods) == (("a", "b", "c", "d"), (("e", "m"),))
    assert found.decades[:3, 0] == pytest.approx([-1.0, 0.0, 1.0])
    assert np.isnan(found.decades[3, 0])
    assert found.measured == 3


def test_series_has_methods_as_columns_and_runs_as_rows() -> None:
    """A method that was not measured in a run is NaN; 0 is not a measurement."""
    rows = [
        {"run": "b", "engine": "z", "x": 1.0},
        {"run": "a", "method": "n", "x": 0.5},
        {"run": "a", "x": 1.0},
        {"run": "b", "x": 100.0},
        {"run": "b", "method": "n", "x": 0.0},
    ]
    found = series_of(["b", "a"], cases(*rows), "x", lambda decades: float(decades.max()))
    assert found.methods == (("e", "m"), ("e", "n"), ("z", "m"))
    assert found.decades == pytest.approx(
        np.array([[1.0, math.nan, 0.0], [-1.0, 0.0, math.nan]]), nan_ok=True
    )


def test_series_without_measurements_has_no_methods() -> None:
    """The series has the runs, with nothing measured in any."""
    found = series_of(["a", "b"], cases({"run": "a", "x": 0.0}), "x", lambda decades: float(decades.max()))
    assert (found.runs, found.methods, found.decades.shape, found.measured) == (("a", "b"), (), (2, 0), 0)
    partly = Series(("a", "b"), (("e", "m"), ("e", "n")), np.array([[1.0, math.nan], [math.nan] * 2]))
    assert partly.measured == 1


def test_largest_deviation_represents_a_method() -> None:
    """The deviation counts in either direction."""
    assert _farthest(pd.Series([0.5, -2.0, 1.0])) == -2.0
