"""Orders, floors and verdicts, on errors made up to be what they are called."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bodycheck.reports.convergence import Point, convergence_of, round_off_floor
from bodycheck.reports.ladder import next_step

STEPS = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3)
LIMIT = 3e-14


def power_law(order: float, at_1e_2: float, steps: tuple[float, ...] = STEPS) -> list[Point]:
    """Return errors c dt^order."""
    return [Point(dt, at_1e_2 * (dt / 1e-2) ** order, settling=0.5) for dt in steps]


@pytest.mark.parametrize("order", [0.7, 1.0, 2.0, 3.0, 4.0])
def test_a_power_law_shows_its_order(order: float) -> None:
    """Errors c dt^p have the order p, in an interval of no width, and converge."""
    found = convergence_of(power_law(order, 1e-4), LIMIT)
    assert found.verdict == "converges"
    assert found.order == pytest.approx(order, abs=1e-9)
    assert found.points == 5


def test_the_interval_holds_the_order_of_a_noisy_law() -> None:
    """The 95 % interval of the slope holds the true order in about 95 of 100 noisy cases."""
    generator = np.random.default_rng(1)
    hits = 0
    for _ in range(200):
        noisy = [
            Point(p.dt_s, (p.error or 0.0) * math.exp(generator.normal(0.0, 0.03)))
            for p in power_law(2.0, 1e-4)
        ]
        found = convergence_of(noisy, LIMIT)
        assert found.order_low is not None
        assert found.order_high is not None
        hits += found.order_low <= 2.0 <= found.order_high
    assert 180 <= hits <= 200


def test_coarse_steps_that_are_not_asymptotic_are_left_out() -> None:
    """Errors above 0.3 rad, and coarse ones off the line, do not bend the order."""
    points = [Point(5e-2, 3.1), Point(2e-2, 2.0), Point(1e-2, 0.25)]
    points += power_law(1.0, 0.2, (5e-3, 2e-3, 1e-3, 5e-4))
    found = convergence_of(points, LIMIT)
    assert found.verdict == "converges"
    assert found.order == pytest.approx(1.0, abs=0.05)


def test_fine_steps_on_the_round_off_floor_are_left_out() -> None:
    """Errors that no longer shrink because of rounding define the floor and do not bend the order."""
    points = power_law(4.0, 1e-8, (5e-2, 2e-2, 1e-2, 5e-3))
    points += [Point(2e-3, 2.0e-11), Point(1e-3, 2.5e-11), Point(5e-4, 1.8e-11)]
    assert round_off_floor(points, LIMIT) == 2.5e-11
    found = convergence_of(points, LIMIT)
    assert found.verdict == "converges"
    assert found.order == pytest.approx(4.0, abs=1e-6)


def test_errors_within_ten_floors_are_at_the_floor() -> None:
    """An error that is all rounding is neither converging nor failing to."""
    points = [Point(dt, error) for dt, error in zip(STEPS, (2e-15, 5e-15, 3e-15, 9e-15, 1e-14), strict=True)]
    assert convergence_of(points, LIMIT).verdict == "at-floor"


def plateau(level: float, settling: float) -> list[Point]:
    """Return an error that is flat over two decades of step."""
    return [Point(dt, level * (1.0 + dt), settling) for dt in (*STEPS, 5e-4, 2e-4)]


@pytest.mark.parametrize("level", [1e-7, 1e-3, 0.2, 3.1])
def test_a_settled_plateau_over_two_decades_does_not_converge(level: float) -> None:
    """An engine that converges to a wrong motion is told so, whether the error is small or total."""
    assert convergence_of(plateau(level, settling=1e-3), LIMIT).verdict == "does-not-converge"


def test_a_saturated_error_is_not_accused() -> None:
    """Flat errors near pi whose motions still change from step to step are only not asymptotic yet."""
    assert convergence_of(plateau(3.1, settling=0.9), LIMIT).verdict == "pre-asymptotic"


def test_a_plateau_over_one_decade_is_not_enough() -> None:
    """A method is not accused on one decade of steps."""
    assert convergence_of(plateau(3.1, settling=1e-3)[:5], LIMIT).verdict == "pre-asymptotic"


def test_a_method_of_which_nothing_ended_is_unstable() -> None:
    """Without one error the verdict is unstable, never at-floor."""
    assert convergence_of([Point(dt, None) for dt in STEPS], LIMIT).verdict == "unstable"


def test_two_steps_are_too_few() -> None:
    """An order needs four points."""
    assert convergence_of(power_law(1.0, 1e-3, (1e-2, 1e-3)), LIMIT).verdict == "too-few-points"


def test_errors_that_grow_with_finer_steps_do_not_converge() -> None:
    """A method that gets worse with finer steps, well above round-off, is never called convergent."""
    points = [Point(dt, 1e-3 * (1e-2 / dt) ** 0.2, 1e-3) for dt in (*STEPS, 5e-4, 2e-4)]
    assert convergence_of(points, LIMIT).verdict == "does-not-converge"


def climb(law: tuple[float, float]) -> tuple[list[float], str]:
    """Return the steps tried and the verdict for a method whose error is min(pi, c dt^p)."""
    order, scale = law
    points = [Point(dt, min(math.pi, scale * dt**order), 0.9) for dt in STEPS]
    tried: list[float] = []
    while (step := next_step(points, LIMIT, STEPS, 0.1, 10.0)) is not None:
        tried.append(step)
        points.append(Point(step, max(min(math.pi, scale * step**order), 1e-16), 0.9))
        assert len(tried) < 20
    return tried, convergence_of(points, LIMIT).verdict


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
    assert verdict in ("converges", "too-few-points")


def test_nothing_is_tried_when_the_order_shows() -> None:
    """Four clean points are enough."""
    assert climb((1.0, 1.0)) == ([], "converges")


def test_every_step_tried_divides_the_sampling_interval() -> None:
    """Whatever the interval, a further step goes a whole number of times into it."""
    for interval in (0.1, 0.05, 0.02, 1.0 / 3.0, 7e-3):
        steps = tuple(interval / n for n in (5, 10, 20))
        points = [Point(dt, 3.0, 0.9) for dt in steps]
        step = next_step(points, LIMIT, steps, interval, 100 * interval)
        assert step is not None
        assert interval / step == pytest.approx(round(interval / step), rel=1e-12)


def test_nothing_is_said_where_the_truth_itself_is_lost() -> None:
    """Where bound or sensitivity times eps is large, the verdict is chaotic, never at-floor."""
    lost = [Point(dt, 3.1, 0.9) for dt in STEPS]
    assert convergence_of(lost, limit=90.0).verdict == "chaotic"
    assert next_step(lost, 90.0, STEPS, 0.1, 10.0) is None
