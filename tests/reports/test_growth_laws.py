"""Each kind of growth at its very edge, on powers and exponentials without any noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.growth import Growth, growth_of

T = np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 601)])
STUDENT = 3.182446305284263  # of 3 degrees of freedom: Abramowitz and Stegun (1964), table 26.10


@pytest.mark.parametrize(
    ("power", "kind"),
    [
        (0.0, "bounded"),
        (0.09, "bounded"),
        (0.11, None),
        (0.24, None),
        (0.26, "sqrt"),
        (0.74, "sqrt"),
        (0.76, None),
        (0.84, None),
        (0.86, "linear"),
        (1.19, "linear"),
        (1.21, None),
        (1.74, None),
        (1.76, "quadratic"),
        (2.29, "quadratic"),
        (2.31, None),
    ],
)
def test_a_power_of_t_has_the_kind_of_its_band_and_no_interval(power: float, kind: str | None) -> None:
    """The exponent is the power."""
    found = growth_of(T, T**power, 1e-12)
    assert found.growth == kind
    assert (found.growth_exponent, found.growth_exponent_low, found.growth_exponent_high) == pytest.approx(
        3 * (power,), abs=1e-9
    )


@pytest.mark.parametrize(("rate", "told"), [(2.0, False), (3.0, True), (20.0, True)])
def test_an_exponential_is_told_where_it_has_come_far_enough(rate: float, told: bool) -> None:
    """Its slope against log t has to be above 1.5 at the end."""
    assert (growth_of(T, np.exp(rate * T), 1e-12).growth == "exponential") == told


def misfit(argument: Array, values: Array) -> float:
    """Return the root of the mean squared residual of a straight line, by numpy's fit."""
    fitted = np.polyval(np.polyfit(argument, values, 1), argument)
    return float(np.sqrt(np.mean((values - fitted) ** 2)))


@pytest.mark.parametrize(("gain", "told"), [(3.1, True), (2.9, False)])
def test_an_exponential_follows_t_three_times_as_well_as_it_follows_log_t(gain: float, told: bool) -> None:
    """Between exp(t) and a power that grows with log t, by how much straighter log M is in t."""
    x = np.linspace(math.log(1e-2), 0.0, 40)

    def log_drift(at: Array, share: float) -> Array:
        return 40.0 * ((1.0 - share) * np.exp(at) + share * (at - x[0]) ** 2 / 20.0)

    low, high = 0.0, 1.0
    for _ in range(50):
        share = 0.5 * (low + high)
        values = log_drift(x, share)
        better = misfit(x, values) > gain * misfit(np.exp(x), values)
        low, high = (share, high) if better else (low, share)
    drift = np.exp(log_drift(np.log(np.maximum(T, 1e-2)), low))
    assert (growth_of(T, drift, 1e-12).growth == "exponential") == told


def test_the_interval_is_that_of_the_slopes_of_four_pieces() -> None:
    """Student's t with three degrees of freedom, of the slopes in each half of the two decades."""
    x = np.log(np.maximum(T, 1e-9) / 1e-2)  # from 0 over two decades
    found = growth_of(T, np.exp(np.where(x < 0.0, 0.9 * x, 0.9 * x + 0.02 * x**2)), 1e-12)
    assert found.growth_exponent is not None
    assert found.growth_exponent_low is not None
    assert found.growth_exponent_high is not None
    edges = np.linspace(0.0, math.log(100.0), 5)
    slopes = 0.9 + 0.02 * (edges[1:] + edges[:-1])
    half = STUDENT * float(np.std(slopes, ddof=1)) / 2.0
    # the series is read at forty points, and straight between them
    assert found.growth_exponent_high - found.growth_exponent == pytest.approx(half, rel=5e-3)
    assert found.growth_exponent - found.growth_exponent_low == pytest.approx(half, rel=5e-3)


@pytest.mark.parametrize(("decades", "told"), [(1.52, True), (1.48, False)])
def test_a_decade_and_a_half_above_the_floor_is_the_least(decades: float, told: bool) -> None:
    """What lies beneath the floor does not count."""
    assert (growth_of(T, T, 10.0**-decades) != Growth()) == told


@pytest.mark.parametrize(("samples", "told"), [(100, True), (99, False)])
def test_a_hundred_samples_within_two_decades_are_the_least(samples: int, told: bool) -> None:
    """The one at their beginning counts, those before it do not."""
    t = np.concatenate([[0.0], np.geomspace(1e-5, 0.9e-2, 500), np.geomspace(1e-2, 1.0, samples)])
    assert (growth_of(t, t, 1e-12) != Growth()) == told
    assert growth_of(np.concatenate([t, [1.0001]])[: len(t)], 2.0 * t, 3.0) == Growth()


def test_what_grew_in_the_last_decade_otherwise_than_before_is_none_of_the_powers() -> None:
    """Linear over all, and a tenth steeper or flatter than linear may be at the end."""
    for late, kind in ((1.28, "linear"), (1.45, None)):
        early = 2.0 - late
        drift = np.where(T < 0.1, T**early * 0.1 ** (late - early), T**late)
        assert growth_of(T, drift, 1e-12).growth == kind


def drift_of(slopes: tuple[float, ...]) -> Array:
    """Return a drift whose log rises with these slopes against log t, by pieces of the last two decades."""
    edges = np.linspace(math.log(1e-2), 0.0, len(slopes) + 1)
    heights = np.concatenate([[0.0], np.cumsum(np.array(slopes) * np.diff(edges))])
    return np.asarray(np.exp(np.interp(np.log(np.maximum(T, 1e-9)), edges, heights)))


def test_a_swing_that_has_not_turned_back_yet_is_no_random_walk() -> None:
    """A first slope of 1 or a jump is none; neither is what no longer grows at the end."""
    for slopes, kind in (
        ((0.5, 0.5, 0.5, 0.5), "sqrt"),
        ((1.0, 0.4, 0.4, 0.3), None),
        ((0.2, 1.6, 0.1, 0.2), None),
        ((0.2, 1.2, 0.5, 0.05), None),
        ((0.8, 0.0, 0.0, 0.0), "bounded"),
    ):
        assert growth_of(T, drift_of(slopes), 1e-12).growth == kind, slopes


def test_an_exponential_steepens_after_its_first_half_decade() -> None:
    """The slopes of exp(10 t), but for one that is lower than the one before."""
    for slopes, kind in (
        ((0.2, 0.6, 1.9, 5.9), "exponential"),
        ((0.7, 0.6, 1.9, 5.9), "exponential"),
        ((0.2, 0.9, 0.3, 5.9), None),
    ):
        assert growth_of(T, drift_of(slopes), 1e-12).growth == kind, slopes
