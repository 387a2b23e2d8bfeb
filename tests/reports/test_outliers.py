"""Which errors the others exclude, on made-up series: a fault at one step, none, and no law at all."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.convergence import Convergence, Criteria, Point, convergence_of
from bodycheck.reports.measurement.order import settled_order
from bodycheck.reports.measurement.outliers import FACTOR, exclusion_of
from tests.reports.test_order import LADDERS, series

STEPS = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
FLOOR = 1e-15


def power_law(order: float, places: dict[int, float], steps: tuple[float, ...] = STEPS) -> tuple[float, ...]:
    """Return errors 0.03 (h / h_max)^p, those at these places multiplied by these factors."""
    return tuple(0.03 * (h / steps[0]) ** order * places.get(k, 1.0) for k, h in enumerate(steps))


def judged(errors: tuple[float, ...], steps: tuple[float, ...] = STEPS, **criteria: float) -> Convergence:
    """Return order and verdict of these errors."""
    points = [Point(dt, error) for dt, error in zip(steps, errors, strict=True)]
    return convergence_of(points, Criteria(FLOOR, **criteria))


@pytest.mark.parametrize("order", [1, 2, 4, 6])
@pytest.mark.parametrize("place", [1, 3, 5])
def test_error_that_the_others_exclude_has_its_place_and_prediction(order: int, place: int) -> None:
    """One of seven is 300 times too large: the others settle the order and predict it."""
    found = exclusion_of(STEPS, power_law(order, {place: 300.0}), FLOOR)
    assert found is not None
    (outlier,) = found.outliers
    assert (outlier.place, outlier.is_above, outlier.is_finest) == (place, True, False)
    assert outlier.predicted == pytest.approx(power_law(order, {})[place], rel=1e-6)
    assert found.order.order == pytest.approx(order, abs=1e-6)


def test_five_steps_exclude_one_and_eight_exclude_two() -> None:
    """Of five, four settle the order; two excluded steps need two more that confirm it."""
    five = exclusion_of(STEPS[:5], power_law(4, {1: 1e3})[:5], FLOOR)
    assert five is not None
    assert [one.place for one in five.outliers] == [1]
    eight = (*STEPS, 1e-4)
    errors = power_law(2, {2: 100.0, 5: 1e4}, eight)
    found = exclusion_of(eight, errors, FLOOR)
    assert found is not None
    assert [one.place for one in found.outliers] == [2, 5]
    assert exclusion_of(eight[:6], power_law(2, {2: 100.0, 4: 1e4}, eight[:6]), FLOOR) is None


@pytest.mark.parametrize(
    "errors",
    [
        power_law(4, {}),
        power_law(4, {0: 1e2}),  # above the usable step
        power_law(4, {0: 1e3, 1: 1e2}),
        power_law(4, {3: 3.0}),
        power_law(4, {})[:4],
    ],
)
def test_coarse_steps_and_small_scatter_are_not_excluded(errors: tuple[float, ...]) -> None:
    """A coarser step that fits is required, and a factor of ten."""
    assert exclusion_of(STEPS[: len(errors)], errors, FLOOR) is None


def test_error_is_excluded_from_ten_times_the_prediction_on() -> None:
    """The interval of the prediction from six exact points is 1 % wide."""
    assert exclusion_of(STEPS, power_law(2, {3: 0.95 * FACTOR}), FLOOR) is None
    assert exclusion_of(STEPS, power_law(2, {3: 1.2 * FACTOR}), FLOOR) is not None


def test_wrong_step_is_a_finding_with_its_error_and_ratio() -> None:
    """The verdict is does-not-converge, without an order; the numbers are those of the excluded step."""
    errors = power_law(4, {2: 1e4})
    found = judged(errors)
    assert (found.verdict, found.order, found.excluded_dt_s) == ("does-not-converge", None, STEPS[2])
    assert found.excluded_error == errors[2]
    assert found.excluded_ratio == pytest.approx(1e4, rel=1e-6)
    saturated = judged((*errors[:2], 3.1, *errors[3:]))
    assert (saturated.verdict, saturated.excluded_error) == ("does-not-converge", 3.1)


def test_step_that_is_better_than_predicted_is_no_finding() -> None:
    """It gives no order that its error contradicts, and no wrong limit."""
    found = judged(power_law(1, {3: 1e-3}))
    assert found.excluded_dt_s is None
    assert found.verdict != "does-not-converge"


def test_finest_step_is_a_finding_only_above_round_off() -> None:
    """No finer step shows that its error is not round-off."""
    coarse = (0.1, 0.05, 0.02, 0.01, 0.005)
    errors = tuple(1e-6 * (h / 0.1) ** 4 for h in coarse)
    for last, verdict in ((3e-10, None), (3e-6, coarse[-1])):
        assert judged((*errors[:-1], last), coarse).excluded_dt_s == verdict
    assert judged((*errors[:-1], 3e-6), coarse, growing=1e-6).excluded_dt_s is None
    assert judged((*errors[:-1], 3e-6), coarse, arithmetic=1e-6).excluded_dt_s is None


@pytest.mark.parametrize("coarsest", [0.2, 3.0, None])
def test_steps_above_the_usable_one_are_named(coarsest: float | None) -> None:
    """A healthy method just past a stability limit converges; its order ends at the usable step."""
    errors = tuple(1e-3 * (h / 0.01) ** 2 for h in STEPS[1:])
    points = [Point(STEPS[0], coarsest), *(Point(h, e) for h, e in zip(STEPS[1:], errors, strict=True))]
    found = convergence_of(points, Criteria(FLOOR))
    assert (found.verdict, found.usable_dt_s) == ("converges", STEPS[1])
    assert judged(power_law(2, {})).usable_dt_s is None


@pytest.mark.parametrize("points", [6, 7, 8])
def test_errors_without_a_law_have_no_order(points: int) -> None:
    """None of 40 series drawn log-uniformly over ten decades; by the interval alone, 15 or more had one."""
    rng = np.random.default_rng(points)
    steps = tuple(2.0**-k for k in range(points))
    drawn = [tuple(0.3 * 10.0 ** rng.uniform(-10.0, 0.0, points)) for _ in range(40)]
    assert not any(settled_order(steps, errors, 1e-14) for errors in drawn)


def test_no_healthy_series_is_accused_and_all_have_their_order() -> None:
    """Noise up to 1 %, a next-order term and a floor, as in the trials of the interval."""
    rng = np.random.default_rng(11)
    for number in range(120):
        steps = np.array(LADDERS[4 + number % 4])
        _, errors, floor = series(rng, steps, 10.0 ** rng.uniform(-3.0, -2.0))
        assert settled_order(tuple(steps), tuple(errors), floor) is not None
        assert exclusion_of(tuple(steps), tuple(errors), floor) is None


def rising(first: float, factor: float, count: int) -> Array:
    """Return errors that grow by a factor with each finer step."""
    return np.asarray(first * factor ** np.arange(count))


@pytest.mark.parametrize(
    ("errors", "verdict"),
    [
        ((1e-4, *rising(1e-5, 1.6, 6)), "error-grows"),
        ((1e-3, 1e-4, 1e-5, 1e-6, *rising(1e-5, 3.0, 3)), "error-grows"),
        ((1e-4, 1e-4, 1e-4, 1e-4, 1e-5, *rising(4e-5, 1.9, 2)), "error-grows"),
        ((0.02, *rising(1e-2, 3.0, 3), 1.0, 2.0, 3.0), "error-grows"),
        (tuple(rising(1e-2, 6.0, 7)), "pre-asymptotic"),  # two of them are below 0.3
        ((1e-4, 1e-4, 1e-4, 1e-4, 1e-4, *rising(4e-5, 1.9, 2)), "pre-asymptotic"),
        (tuple(rising(1e-4, 1.1, 7)), "pre-asymptotic"),
    ],
)
def test_errors_that_rise_towards_finer_steps_are_a_finding(errors: tuple[float, ...], verdict: str) -> None:
    """Over three steps up to the finest one, to more than twice the first of them, below 0.3 rad."""
    assert judged(errors).verdict == verdict


def test_growth_that_the_arithmetic_explains_is_no_finding() -> None:
    """The round-off predicted at the finest step is a tenth of its error or more."""
    errors = (1e-4, *rising(1e-6, 2.0, 6))
    assert judged(errors).verdict == "error-grows"
    for cause in ("growing", "arithmetic"):
        assert judged(errors, **{cause: 0.11 * errors[-1]}).verdict == "pre-asymptotic"
    assert math.isclose(errors[-1], 3.2e-5)
