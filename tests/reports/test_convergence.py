"""Floors, verdicts and further steps, on errors made up to be what they are called."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bodycheck.reports.measurement.convergence import (
    Criteria,
    Point,
    convergence_of,
    next_step_size,
    round_off_floor,
)

STEPS = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3)
CRITERIA = Criteria(floor=3e-14)
LOST = np.random.default_rng(0).normal(size=(20, 61, 3))


def power_law(order: float, at_1e_2: float, steps: tuple[float, ...] = STEPS) -> list[Point]:
    """Return errors c dt^order."""
    return [Point(dt, at_1e_2 * (dt / 1e-2) ** order) for dt in steps]


@pytest.mark.parametrize("order", [0.7, 1.0, 2.0, 3.0, 4.0])
def test_a_power_law_converges_with_its_order(order: float) -> None:
    """Errors c dt^p have the order p, and converge."""
    found = convergence_of(power_law(order, 1e-4), CRITERIA)
    assert found.verdict == "converges"
    assert found.order == pytest.approx(order, abs=1e-6)
    assert found.points == 5


def test_coarse_steps_that_are_not_asymptotic_are_left_out() -> None:
    """Errors above 0.3 rad, and coarse ones off the line, do not bend the order."""
    points = [Point(5e-2, 3.1), Point(2e-2, 2.0), Point(1e-2, 0.25)]
    points += power_law(1.0, 0.2, (5e-3, 2e-3, 1e-3, 5e-4))
    found = convergence_of(points, CRITERIA)
    assert found.verdict == "converges"
    assert found.order == pytest.approx(1.0, abs=0.05)


def test_fine_steps_on_the_round_off_floor_are_left_out() -> None:
    """Errors that no longer shrink because of rounding define the floor and do not bend the order."""
    points = power_law(4.0, 1e-8, (5e-2, 2e-2, 1e-2, 5e-3))
    points += [Point(2e-3, 2.0e-11), Point(1e-3, 2.5e-11), Point(5e-4, 1.8e-11)]
    assert round_off_floor(points, CRITERIA.floor) == 2.5e-11
    found = convergence_of(points, CRITERIA)
    assert found.verdict == "converges"
    assert found.order == pytest.approx(4.0, abs=0.02)


def test_errors_within_ten_floors_are_at_the_floor() -> None:
    """An error that is all rounding is neither converging nor failing to."""
    points = [Point(dt, error) for dt, error in zip(STEPS, (2e-15, 5e-15, 3e-15, 9e-15, 1e-14), strict=True)]
    assert convergence_of(points, CRITERIA).verdict == "at-floor"


@pytest.mark.parametrize("level", [1e-7, 1e-3, 0.1])
def test_errors_that_have_stopped_falling_do_not_converge(level: float) -> None:
    """A fall of order 2, then a plateau over three steps: it is looked for at the fine end."""
    points = [*power_law(2.0, 2.0 * level, (1e-2, 7e-3)), *(Point(dt, level) for dt in (4e-3, 2e-3, 1e-3))]
    assert convergence_of(points, CRITERIA).verdict == "does-not-converge"


def test_a_wrong_limit_outweighs_an_order_at_coarser_steps() -> None:
    """Five steps of order 2, then three that are flat: a settled order does not hide the plateau."""
    points = [*power_law(2.0, 1e-1), *(Point(dt, 1.0e-3) for dt in (5e-4, 2e-4, 1e-4))]
    assert convergence_of(points, CRITERIA).verdict == "does-not-converge"


def test_the_limit_needs_three_steps() -> None:
    """Two equal errors say nothing yet."""
    assert convergence_of([Point(2e-3, 1e-3), Point(1e-3, 1e-3)], CRITERIA).verdict == "too-few-points"


def test_an_error_that_is_saturated_without_a_motion_has_no_limit() -> None:
    """Errors near pi stand still although the motion does not."""
    assert convergence_of([Point(dt, 3.1) for dt in STEPS], CRITERIA).verdict == "pre-asymptotic"


def test_a_method_of_which_nothing_ended_is_unstable() -> None:
    """Without one error the verdict is unstable, never at-floor."""
    assert convergence_of([Point(dt, None) for dt in STEPS], CRITERIA).verdict == "unstable"


def test_two_steps_are_too_few() -> None:
    """An order needs four points."""
    assert convergence_of(power_law(1.0, 1e-3, (1e-2, 1e-3)), CRITERIA).verdict == "too-few-points"


def test_errors_that_grow_with_finer_steps_never_converge() -> None:
    """A method that gets worse with finer steps, well above round-off, is never called convergent."""
    points = [Point(dt, 1e-3 * (1e-2 / dt) ** 0.5) for dt in (*STEPS, 5e-4, 2e-4)]
    assert convergence_of(points, CRITERIA).verdict == "pre-asymptotic"


def climb(law: tuple[float, float]) -> tuple[list[float], str]:
    """Return the steps tried and the verdict for a method whose error is min(pi, c dt^p)."""
    order, scale = law
    points = [Point(dt, min(math.pi, scale * dt**order), LOST[k]) for k, dt in enumerate(STEPS)]
    tried: list[float] = []
    while (step := next_step_size(points, CRITERIA, STEPS, 0.1, 10.0)) is not None:
        tried.append(step)
        points.append(Point(step, max(min(math.pi, scale * step**order), 1e-16), LOST[len(points)]))
        assert len(tried) < 20
    return tried, convergence_of(points, CRITERIA).verdict


def test_finer_steps_are_tried_while_errors_are_too_large() -> None:
    """A crude method is refined until four errors are below 0.3 rad."""
    tried, verdict = climb((1.0, 100.0))
    assert tried == [5e-4, 2e-4]
    assert verdict == "converges"


def test_refinement_ends_two_decades_down() -> None:
    """A method too crude for the budget stays pre-asymptotic, and is not accused."""
    tried, verdict = climb((1.0, 1000.0))
    assert tried == [5e-4, 2e-4]
    assert verdict == "pre-asymptotic"


def test_coarser_steps_are_tried_while_errors_are_at_the_floor() -> None:
    """A method too good for the steps listed is made coarser, up to the sampling interval."""
    tried, verdict = climb((8.0, 1e3))
    assert tried == [5e-2, 1e-1]
    assert verdict in ("converges", "too-few-points", "pre-asymptotic")


def test_finer_steps_are_tried_where_large_errors_hardly_shrink() -> None:
    """Three points are few, but coarser ones would not tell what errors like these converge to."""
    points = [Point(0.02, 0.15), Point(0.01, 0.11), Point(0.005, 0.1)]
    assert next_step_size(points, CRITERIA, (0.02, 0.01, 0.005), 0.1, 10.0) == 0.002
    falling = [Point(0.02, 0.015), Point(0.01, 0.0011), Point(0.005, 0.0001)]
    assert next_step_size(falling, CRITERIA, (0.02, 0.01, 0.005), 0.1, 10.0) == 0.05


def test_three_steps_show_convergence_by_their_limit() -> None:
    """An order needs four points; a limit at the truth needs three."""
    found = convergence_of(power_law(2.0, 1e-1, (4e-3, 2e-3, 1e-3)), CRITERIA)
    assert (found.verdict, found.order) == ("converges", None)
    assert convergence_of(power_law(2.0, 1e-1, (2e-3, 1e-3)), CRITERIA).verdict == "too-few-points"


def test_nothing_is_tried_when_the_order_shows() -> None:
    """Four clean points are enough."""
    assert climb((1.0, 1.0)) == ([], "converges")


def test_a_quantity_that_needs_no_order_is_refined_until_it_is_decided() -> None:
    """At the floor nothing more is tried; above it finer steps are."""
    at_floor = [Point(dt, 1e-15) for dt in STEPS]
    assert next_step_size(at_floor, CRITERIA, STEPS, 0.1, 10.0, needs_order=False) is None
    lost = [Point(dt, 3.1, LOST[k]) for k, dt in enumerate(STEPS)]
    assert next_step_size(lost, CRITERIA, STEPS, 0.1, 10.0, needs_order=False) == 5e-4


def test_every_step_tried_divides_the_sampling_interval() -> None:
    """Whatever the interval, a further step goes a whole number of times into it."""
    for interval in (0.1, 0.05, 0.02, 1.0 / 3.0, 7e-3):
        steps = tuple(interval / n for n in (5, 10, 20))
        points = [Point(dt, 3.0) for dt in steps]
        step = next_step_size(points, CRITERIA, steps, interval, 100 * interval)
        assert step is not None
        assert interval / step == pytest.approx(round(interval / step), rel=1e-12)


def test_nothing_is_said_where_the_truth_itself_is_lost() -> None:
    """Where bound or sensitivity times eps is large, the verdict is chaotic, never at-floor."""
    lost, how = [Point(dt, 3.1) for dt in STEPS], Criteria(floor=90.0)
    assert convergence_of(lost, how).verdict == "chaotic"
    assert next_step_size(lost, how, STEPS, 0.1, 10.0) is None
