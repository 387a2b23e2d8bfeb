"""Steps of noisy series: none where there is none, a fifth within five nights, nothing known in advance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.history.step_detection import (
    LEAST_AFTER,
    LEAST_BEFORE,
    detect_steps,
    pooled_spread,
    smallest_detectable_step,
)

FIFTH = math.log10(1.2)
SIGMA = 0.012  # what the median over a method's cases does from night to night


def noise(seed: int, nights: int, methods: int = 20, disturbed: float = 0.0) -> Array:
    """Return independent noise in decades; on disturbed nights a method takes up to half as long again."""
    rng = np.random.default_rng(seed)
    load = np.where(rng.random((nights, methods)) < disturbed, rng.random((nights, methods)), 0.0)
    return SIGMA * rng.normal(size=(nights, methods)) + math.log10(1.5) * load


@pytest.mark.parametrize("disturbed", [0.0, 0.02, 0.15])
@pytest.mark.parametrize("seed", range(4))
def test_unchanged_nights_hold_no_step(seed: int, disturbed: float) -> None:
    """Of twenty methods over sixty nights, some of which were disturbed, none is said to have moved."""
    assert not any(detect_steps(noise(seed, 60, disturbed=disturbed)))


@pytest.mark.parametrize("nights_before", [LEAST_BEFORE, 10, 30])
@pytest.mark.parametrize("factor", [1.2, 1.0 / 1.2])
@pytest.mark.parametrize("seed", range(5))
def test_a_fifth_is_told_within_five_nights_and_once(seed: int, factor: float, nights_before: int) -> None:
    """Of five methods that moved, four at least are told, each once, with its sign; of the others none is."""
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
def test_no_night_is_judged_by_what_came_after(seed: int, height: float, at: int, cut: int) -> None:
    """What is told by some night is the same whether later nights are there or not."""
    series = noise(seed, 30, methods=4)
    series[at:, 0] += height
    series[np.random.default_rng(seed).random(series.shape) < 0.1] = math.nan
    early, late = detect_steps(series[:cut]), detect_steps(series)
    assert early == [[step for step in steps if step.detected_at < cut] for steps in late]


@pytest.mark.parametrize("seed", range(5))
def test_a_fifth_is_told_where_every_fourth_night_is_disturbed(seed: int) -> None:
    """Neither do the disturbed nights hide that five methods became slower, nor are others said to be."""
    series = noise(seed, 25, disturbed=0.25)
    series[20:, :5] += FIFTH
    found = detect_steps(series)
    assert [len(steps) for steps in found[:5]].count(1) >= 4
    assert not any(found[5:])


def test_a_level_needs_some_nights() -> None:
    """However far the times move, fewer nights than both levels need tell nothing; one more does."""
    series = noise(0, LEAST_BEFORE + LEAST_AFTER, methods=3)
    series[LEAST_BEFORE:, 1] += 1.0
    assert not any(detect_steps(series[:-1]))
    assert [len(steps) for steps in detect_steps(series)] == [0, 1, 0]
    assert not any(detect_steps(series[1:]))


def test_one_night_alone_is_no_level() -> None:
    """A night on which everything took three times as long is the machine's, not the engines'."""
    series = noise(1, 30)
    series[15] = math.log10(3.0)
    assert not any(detect_steps(series))


def test_nights_on_which_a_method_was_not_measured_change_nothing() -> None:
    """With holes in it, a series is judged as it would be without those nights."""
    whole = noise(3, 30, methods=6)
    whole[15:, 2] += FIFTH
    holes = np.insert(whole, [4, 12, 20], math.nan, axis=0)
    places = [k for k in range(len(holes)) if not np.isnan(holes[k]).any()]
    told = [
        [(places[s.first], places[s.detected_at], s.size) for s in steps] for steps in detect_steps(whole)
    ]
    assert [[(s.first, s.detected_at, s.size) for s in steps] for steps in detect_steps(holes)] == told


def test_the_usual_spread_is_that_of_the_noise() -> None:
    """Neither a method that moved, and was told, nor one that was never measured raises it."""
    series = noise(4, 40, methods=101)
    series[20:, :30] += 1.0
    series[:, 30:40] = math.nan
    steps = detect_steps(series)
    assert all(steps[:30])
    assert pooled_spread(series, steps) == pytest.approx(SIGMA, rel=0.15)


def test_without_nights_enough_no_spread_is_known() -> None:
    """Of fewer nights than a level needs the spread is said to be 0."""
    few = noise(5, LEAST_BEFORE - 1)
    assert pooled_spread(few, detect_steps(few)) == 0.0


def test_what_is_said_to_be_told_is_told() -> None:
    """Of 200 steps of the size that is promised within five nights, at least 98 % are told by then."""
    size = smallest_detectable_step(SIGMA)
    told = []
    for seed in range(10):
        series = noise(seed, 25)
        series[20:] += size
        told += [bool(steps) for steps in detect_steps(series)]
    assert np.mean(told) >= 0.98
