"""Floors, orders, verdicts and further steps on made-up errors, and the limits of each rule."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reports.measurement.convergence import (
    LARGEST_LIMIT,
    Convergence,
    Criteria,
    Point,
    best_of,
    convergence_of,
    next_step_size,
    reaches_round_off,
    round_off_floor,
    stepless_verdict,
    tolerance_convergence,
    usable,
)
from bodycheck.reports.measurement.measures import Judgement
from bodycheck.reports.measurement.verdicts import STATES

STEPS = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3)
CRITERIA = Criteria(floor=3e-14)
HALVED_LONG = [2.0**-k for k in range(4, 11)]
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
    bent = [Point(dt, 1e-2 * (dt if dt >= 2.0**-7 else dt**3 * 4.0**7)) for dt in HALVED_LONG]
    found = convergence_of(bent, CRITERIA)
    assert (round(found.order or 0.0), found.points) == (3, 4)


def test_a_motion_that_is_far_off_shows_no_order() -> None:
    """However small its error, and whatever the power of the step, until the motion is near the truth."""
    law = power_law(1.0, 0.1)
    far = [replace(point, is_far=True) for point in law]
    found = convergence_of(far, CRITERIA)
    assert (found.verdict, found.order, found.points) == ("pre-asymptotic", None, 0)
    near = convergence_of([*far[:1], *law[1:]], CRITERIA)
    assert (near.verdict, near.points) == ("converges", len(law) - 1)


def test_fine_steps_on_the_round_off_floor_are_left_out() -> None:
    """Errors that no longer shrink because of rounding define the floor and do not bend the order."""
    points = power_law(4.0, 1e-8, (5e-2, 2e-2, 1e-2, 5e-3))
    points += [Point(2e-3, 2.0e-11), Point(1e-3, 2.5e-11), Point(5e-4, 1.8e-11)]
    assert round_off_floor(points, CRITERIA.floor) == 2.5e-11
    found = convergence_of(points, CRITERIA)
    assert found.verdict == "converges"
    assert found.order == pytest.approx(4.0, abs=0.02)


def test_errors_within_ten_floors_are_at_the_floor() -> None:
    """Errors that consist of rounding alone neither converge nor fail to converge."""
    points = [Point(dt, error) for dt, error in zip(STEPS, (2e-15, 5e-15, 3e-15, 9e-15, 1e-14), strict=True)]
    assert convergence_of(points, CRITERIA).verdict == "at-floor"


@pytest.mark.parametrize("level", [1e-7, 1e-3, 0.1])
def test_errors_that_have_stopped_falling_do_not_converge(level: float) -> None:
    """A fall of order 2 and then a plateau over the three finest steps is not convergence."""
    points = [*power_law(2.0, 2.0 * level, (1e-2, 7e-3)), *(Point(dt, level) for dt in (4e-3, 2e-3, 1e-3))]
    assert convergence_of(points, CRITERIA).verdict == "does-not-converge"


@pytest.mark.parametrize(("finest", "verdict"), [(1.01e-9, "does-not-converge"), (0.99e-9, "pre-asymptotic")])
def test_errors_that_stop_falling_at_round_off_have_no_verdict(finest: float, verdict: str) -> None:
    """A plateau counts as a wrong limit if the error at the finest step is above 1e-9."""
    points = [*power_law(2.0, 4e-9, (1e-2, 7e-3)), Point(4e-3, 1.1e-9), Point(2e-3, 1.05e-9)]
    assert convergence_of([*points, Point(1e-3, finest)], CRITERIA).verdict == verdict


def test_the_best_case_is_the_coarsest_with_the_least_error() -> None:
    """Cases that did not end well are left out."""
    points = [Point(0.1, 2.0), Point(0.05, 1.0), Point(0.02, 1.0), Point(0.01, None)]
    assert best_of(points) is points[1]
    assert best_of(points[3:]) is None


@pytest.mark.parametrize(
    ("errors", "reached"),
    [
        ((1e-3, 1e-5, 1e-6), False),
        ((1e-3, 1e-5, 8.9e-7), True),
        ((1e-3, 8.9e-6, 1e-5), True),
        ((1e-3, 9.1e-6, 1e-5), False),
        ((1e-3, None, None), False),
        ((None, None, None), False),
    ],
)
def test_round_off_is_reached_where_the_error_is_that_predicted(
    errors: tuple[float | None, ...], reached: bool
) -> None:
    """The least error is up to 10 times that at the finest step, or 100 times before errors rise."""
    assert reaches_round_off(rounded(errors, 9e-8)) is reached


def rounded(errors: tuple[float | None, ...], round_off: float) -> list[Point]:
    """Return cases at three steps, each of which is predicted to have this round-off."""
    steps = (0.1, 0.01, 0.001)
    return [Point(dt, error, None, round_off) for dt, error in zip(steps, errors, strict=True)]


def test_round_off_that_is_not_predicted_is_not_reached() -> None:
    """Ten times the predicted round-off still reaches it; an error of 0 reaches none without a prediction."""
    assert reaches_round_off(rounded((1.0, 0.5, 10.0 * 2.0**-20), 2.0**-20))
    assert not reaches_round_off([Point(0.1, 0.0)])


@pytest.mark.parametrize(
    ("errors", "verdict"),
    [
        ((1e-3, 1e-5, 8.9e-7), "at-precision-floor"),
        ((1e-3, 8.9e-6, 1e-5), "at-precision-floor"),
        ((1e-3, 9.1e-6, 1e-5), "does-not-converge"),
    ],
)
def test_errors_that_reach_round_off_are_at_the_floor_of_the_arithmetic(
    errors: tuple[float, ...], verdict: str
) -> None:
    """They neither converge nor fail to; beyond the predicted round-off they fail."""
    assert convergence_of(rounded(errors, 9e-8), CRITERIA).verdict == verdict


RISING = rounded((1.35e-6, 1.08e-6, 1.17e-6), 9e-8)
"""Errors that a finer step than the best one increases, as round-off does."""


def test_the_best_of_the_rounded_cases_is_the_finest_usable_one() -> None:
    """Where the arithmetic is coarser than double precision, finer steps show nothing."""
    assert usable(RISING, LIMIT) == RISING[:2]
    assert len(usable([replace(point, round_off=0.0) for point in RISING], LIMIT)) == 3


def test_coarser_steps_are_tried_at_the_floor_of_the_arithmetic() -> None:
    """Finer ones would only add round-off; without the need for an order nothing is tried."""
    assert convergence_of(RISING, CRITERIA).verdict == "at-precision-floor"
    assert next_step_size(RISING, CRITERIA, (0.1, 0.01, 0.001), 1.0, 10.0) == 0.2
    assert next_step_size(RISING, CRITERIA, (0.1,), 1.0, 10.0, needs_order=False) is None


def test_steps_that_only_add_round_off_do_not_blur_the_limit() -> None:
    """The limit is that of the coarsest steps for which it is most certain."""
    some = [Point(dt, 1e-2 * dt**2 + 2e-8 / dt, None, 1e-8) for dt in HALVED_LONG]
    found = [convergence_of(some[:count], CRITERIA).limit_uncertainty for count in range(3, 8)]
    certain = [uncertainty for uncertainty in found if uncertainty is not None]
    assert len(certain) == 5
    assert found[-1] == min(certain) < certain[0]


@pytest.mark.parametrize(
    ("offset", "judged", "verdict"),
    [(2e-4, "limit", "converges"), (4e-4, "limit", "pre-asymptotic"), (4e-4, "property", "converges")],
)
def test_an_order_towards_another_limit_does_not_converge(
    offset: float, judged: Judgement, verdict: str
) -> None:
    """Motions 0.1 h + c have an order at these steps; their limit is c, 4 times its uncertainty of 1e-4."""
    motions = [(h, np.full((5, 1), 0.1 * h + offset)) for h in (0.08, 0.04, 0.02, 0.01)]
    some = [Point(h, float(motion[0, 0]), motion) for h, motion in motions]
    assert convergence_of(some, Criteria(1e-14, judged=judged)).verdict == verdict


@pytest.mark.parametrize(("finest", "verdict"), [(1.9e-5, "converges"), (2.1e-5, "pre-asymptotic")])
def test_an_order_at_coarser_steps_than_a_larger_error_is_none(finest: float, verdict: str) -> None:
    """After four errors of order 1, the error at a finer step is twice as large as at the last of them."""
    some = points((0.08, 8e-5), (0.04, 4e-5), (0.02, 2e-5), (0.01, 1e-5), (0.005, finest))
    assert convergence_of(some, CRITERIA).verdict == verdict


@pytest.mark.parametrize(("growing", "verdict"), [(0.0, "error-grows"), (3e-9, "converges")])
def test_round_off_that_grows_with_the_steps_contradicts_no_order(growing: float, verdict: str) -> None:
    """Errors of order 4 fall to 1.5e-9, then round-off doubles with each halving of the step."""
    errors = [*(1e-4 / 16**k for k in range(5)), 3e-9, 6e-9, 12e-9, 24e-9]
    some = [Point(0.1 / 2**k, error) for k, error in enumerate(errors)]
    assert convergence_of(some, Criteria(1e-14, growing=growing)).verdict == verdict


def test_two_finer_steps_are_tried_where_the_motion_does_not_depend_on_the_step() -> None:
    """A correct method may make shorter steps of its own; a wrong motion is the same at all of them."""
    listed = (0.01, 0.005, 0.002, 0.001)
    same = [Point(dt, 0.0141, np.full((5, 1), 0.0141)) for dt in listed]
    assert convergence_of(same, CRITERIA).verdict == "does-not-converge"
    assert next_step_size(same, CRITERIA, listed, 0.1, 10.0) == 0.0005
    one_finer = [*same, replace(same[0], dt_s=0.0005)]
    assert next_step_size(one_finer, CRITERIA, listed, 0.1, 10.0) == 0.0002
    assert next_step_size([*one_finer, replace(same[0], dt_s=0.0002)], CRITERIA, listed, 0.1, 10.0) is None
    nearly = [replace(point, error=0.0141 + 1e-9 * point.dt_s) for point in same]
    assert next_step_size(nearly, CRITERIA, listed, 0.1, 10.0) == 0.0005
    changing = [replace(point, error=0.0141 + 1e-6 * point.dt_s) for point in same]
    assert next_step_size(changing, CRITERIA, listed, 0.1, 10.0) is None


def test_a_wrong_limit_outweighs_an_order_at_coarser_steps() -> None:
    """After five steps of order 2 and three flat ones, the order does not hide the plateau."""
    points = [*power_law(2.0, 1e-1), *(Point(dt, 1.0e-3) for dt in (5e-4, 2e-4, 1e-4))]
    found = convergence_of(points, CRITERIA)
    assert found.verdict == "does-not-converge"
    assert found.limit_distance == pytest.approx(1e-3)
    assert found.limit_uncertainty is not None
    assert found.limit_uncertainty < 1e-9


def test_the_limit_needs_three_steps() -> None:
    """Two equal errors give no verdict yet."""
    assert convergence_of([Point(2e-3, 1e-3), Point(1e-3, 1e-3)], CRITERIA).verdict == "too-few-points"


def test_an_error_that_is_saturated_without_a_motion_has_no_limit() -> None:
    """Errors near pi are constant although the motion still changes, so they show no limit."""
    assert convergence_of([Point(dt, 3.1) for dt in STEPS], CRITERIA).verdict == "pre-asymptotic"


def test_a_method_of_which_nothing_ended_is_unstable() -> None:
    """Without a single error the verdict is unstable, never at-floor."""
    assert convergence_of([Point(dt, None) for dt in STEPS], CRITERIA).verdict == "unstable"


def test_two_steps_are_too_few() -> None:
    """An order needs four points."""
    assert convergence_of(power_law(1.0, 1e-3, (1e-2, 1e-3)), CRITERIA).verdict == "too-few-points"


def test_errors_that_grow_with_finer_steps_never_converge() -> None:
    """A method that gets worse with finer steps, well above round-off, is never called convergent."""
    points = [Point(dt, 1e-3 * (1e-2 / dt) ** 0.5) for dt in (*STEPS, 5e-4, 2e-4)]
    assert convergence_of(points, CRITERIA).verdict == "error-grows"


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
    """A method too inaccurate at all permitted steps stays pre-asymptotic, and is not reported as faulty."""
    tried, verdict = climb((1.0, 1000.0))
    assert tried == [5e-4, 2e-4]
    assert verdict == "pre-asymptotic"


def test_coarser_steps_are_tried_while_errors_are_at_the_floor() -> None:
    """A method too accurate at the listed steps is run at coarser ones, up to the sampling interval."""
    tried, verdict = climb((8.0, 1e3))
    assert tried == [5e-2, 1e-1]
    assert verdict in ("converges", "too-few-points", "pre-asymptotic")


def test_finer_steps_are_tried_where_large_errors_hardly_shrink() -> None:
    """Although three points are few, coarser steps would not show what errors like these converge to."""
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
    """At the floor no further step is tried; above it a finer one is."""
    at_floor = [Point(dt, 1e-15) for dt in STEPS]
    assert next_step_size(at_floor, CRITERIA, STEPS, 0.1, 10.0, needs_order=False) is None
    lost = [Point(dt, 3.1, LOST[k]) for k, dt in enumerate(STEPS)]
    assert next_step_size(lost, CRITERIA, STEPS, 0.1, 10.0, needs_order=False) == 5e-4


def test_every_step_tried_divides_the_sampling_interval() -> None:
    """Whatever the interval, it is a whole multiple of each further step."""
    for interval in (0.1, 0.05, 0.02, 1.0 / 3.0, 7e-3):
        steps = tuple(interval / n for n in (5, 10, 20))
        points = [Point(dt, 3.0) for dt in steps]
        step = next_step_size(points, CRITERIA, steps, interval, 100 * interval)
        assert step is not None
        assert interval / step == pytest.approx(round(interval / step), rel=1e-12)


def test_nothing_is_said_where_the_truth_itself_is_lost() -> None:
    """Where bound or sensitivity times eps is large, the verdict is chaotic and no further step is tried."""
    lost, how = [Point(dt, 3.1) for dt in STEPS], Criteria(floor=90.0)
    assert convergence_of(lost, how).verdict == "chaotic"
    assert next_step_size(lost, how, STEPS, 0.1, 10.0) is None


LIMIT = 2.0**-50
HALVED = [2.0**-k for k in range(5, 10)]


def points(*pairs: tuple[float, float | None]) -> list[Point]:
    """Return cases of steps and errors."""
    return [Point(dt_s, error) for dt_s, error in pairs]


def halved_power_law(order: float, *, at_1: float = 1e-3, steps: list[float] | None = None) -> list[Point]:
    """Return errors c dt^p, by default of five steps, each half of the one before."""
    return points(*((dt_s, at_1 * dt_s**order) for dt_s in steps or HALVED))


# ------------------------------------------------------------------------------------------ usable errors


def test_usable_errors_lie_strictly_between_ten_floors_and_three_tenths() -> None:
    """The coarsest comes first; a case that did not end well has no usable error."""
    edge = 10.0 * LIMIT
    some = points((0.1, edge), (0.4, 0.3), (0.2, None), (0.3, math.nextafter(0.3, 0.0)))
    some += points((0.5, math.nextafter(edge, 1.0)))
    assert [p.dt_s for p in usable(some, LIMIT)] == [0.5, 0.3]


@pytest.mark.parametrize(
    ("coarser", "finer", "floor"),
    [
        (2.0**-31, 2.0**-32, LIMIT),  # a quarter of the step halves the error: order 1/2
        (math.nextafter(2.0**-31, 0.0), 2.0**-32, 2.0**-31),
        (2.0**-33, 2.0**-32, 2.0**-32),
        (1e-9, 1e-9, LIMIT),  # no round-off is that large
        (0.99e-9, 1e-9, 1e-9),
    ],
)
def test_the_floor_is_where_finer_steps_gain_less_than_half_an_order(
    coarser: float, finer: float, floor: float
) -> None:
    """Both errors are then at the floor; cases that did not end well are skipped."""
    some = points((4e-3, coarser), (2e-3, None), (1e-3, finer))
    assert round_off_floor(some, LIMIT) == pytest.approx(floor, rel=1e-15, abs=0.0)
    assert round_off_floor(some, 1e-8) == 1e-8


# ---------------------------------------------------------------------------------------------- the order


@pytest.mark.parametrize(
    ("some", "verdict"),
    [
        (halved_power_law(0.51), "converges"),
        (halved_power_law(0.45, steps=HALVED[:4]), "pre-asymptotic"),
        (halved_power_law(2.0, steps=HALVED[:4]), "converges"),
        (halved_power_law(2.0, steps=HALVED[:2]), "too-few-points"),
    ],
)
def test_an_order_settles_from_four_points_from_a_half_on(some: list[Point], verdict: str) -> None:
    """Fewer points or a lower order give no order."""
    found = convergence_of(some, Criteria(LIMIT))
    assert found.verdict == verdict
    assert (found.order is None) == (verdict != "converges")


# ------------------------------------------------------------------------------------------------ verdicts


@pytest.mark.parametrize(
    ("some", "limit", "reported"),
    [
        (points((0.1, 1.0), (0.2, 1.0)), 0.0031, ("chaotic", 0, 0.0031)),
        (points((0.1, 1.0), (0.2, 1.0)), 0.003, ("pre-asymptotic", 0, 0.003)),
        (points((0.1, None), (0.2, None)), LIMIT, ("unstable", 0, LIMIT)),
        ([], LIMIT, ("unstable", 0, LIMIT)),
        (points((0.1, 10.0 * LIMIT), (0.2, LIMIT)), LIMIT, ("at-floor", 0, 10.0 * LIMIT)),
        (points((0.1, 1e-6)), 1e-7, ("at-floor", 0, 1e-7)),
        (points((0.1, 1.01e-6)), 1e-7, ("too-few-points", 1, 1e-7)),
        (points((0.1, 1e-3), (0.2, 0.3)), LIMIT, ("pre-asymptotic", 1, LIMIT)),
        (points((0.1, 1e-3), (0.2, 0.2)), LIMIT, ("too-few-points", 2, LIMIT)),
        (points((0.1, 1e-3), (0.2, 0.2), (0.4, None)), LIMIT, ("pre-asymptotic", 2, LIMIT)),
        (points((0.1, 0.1), (0.2, 0.01), (0.4, 0.1), (0.8, 0.01)), LIMIT, ("pre-asymptotic", 4, LIMIT)),
        (points((0.01, 2e-9), (0.02, 1.1e-9), (0.04, 8e-10)), LIMIT, ("at-floor", 0, 1.1e-9)),
        (points((0.001, 6e-8), (0.005, 2e-8), (0.01, 8e-10)), LIMIT, ("at-floor", 0, 2e-8)),
        (
            points((0.001, 0.1), (0.002, 0.1), (0.004, 0.1), (0.005, 4e-12)),
            LIMIT,
            ("does-not-converge", 4, LIMIT),
        ),
        (points((0.01, 0.25), (0.02, 0.2), (0.04, 0.1), (0.08, 5e-10)), LIMIT, ("error-grows", 4, LIMIT)),
    ],
)
def test_a_verdict_without_an_order_has_its_reason(
    some: list[Point], limit: float, reported: tuple[str, int, float]
) -> None:
    """Verdict, usable points and floor do not depend on the order in which the cases are given."""
    for ordered in (some, some[::-1]):
        found = convergence_of(ordered, Criteria(limit))
        assert (found.verdict, found.points, found.floor) == reported


@pytest.mark.parametrize(
    ("some", "limit", "reported"),
    [
        (points((0.1, 1e-3)), 0.0031, ("chaotic", 0, 0.0031)),
        (points((0.1, 1e-3)), 0.003, ("at-floor", 0, 0.003)),
        (points((0.1, None)), LIMIT, ("unstable", 0, LIMIT)),
        (points((0.1, 10.0 * LIMIT), (0.2, LIMIT)), LIMIT, ("at-floor", 0, 10.0 * LIMIT)),
        (points((0.1, LIMIT), (0.2, 10.0 * LIMIT)), LIMIT, ("at-floor", 0, LIMIT)),
        (points((0.1, 10.0 * LIMIT), (0.2, 0.2)), LIMIT, ("converges", 1, LIMIT)),
        (points((1e-4, 10.0 * LIMIT), (1e-2, 11.0 * LIMIT)), LIMIT, ("at-floor", 0, 11.0 * LIMIT)),
        (points((1e-16, 3.8e-13), (1e-14, 3.9e-13), (1e-12, 3.8e-13)), LIMIT, ("at-floor", 0, 3.9e-13)),
        (points((1e-9, 4e-10), (1e-5, 9e-10)), LIMIT, ("at-floor", 0, 9e-10)),
        (points((1e-9, 4e-10), (1e-5, 1.1e-9)), LIMIT, ("pre-asymptotic", 2, LIMIT)),
        (points((1e-9, 1.1e-9), (1e-5, 1.2e-9)), LIMIT, ("does-not-converge", 2, LIMIT)),
        (points((1e-4, 1e-6), (1e-2, 9e-6)), 1e-7, ("converges", 1, 1e-7)),
        (points((1e-4, 1.01e-6), (1e-2, 1.5e-6)), 1e-7, ("does-not-converge", 2, 1e-7)),
        (points((1e-4, 1.01e-6), (1e-2, 6e-6)), 1e-7, ("pre-asymptotic", 2, 1e-7)),
        (points((1e-6, 0.1), (1e-3, 5e-10)), LIMIT, ("does-not-converge", 2, LIMIT)),
        (points((1e-8, 5e-6), (1e-6, 5e-10), (1e-4, 5e-10)), LIMIT, ("does-not-converge", 1, 5e-10)),
        (points((1e-4, 1.58e-3), (1e-2, 1e-2)), LIMIT, ("converges", 2, LIMIT)),
        (points((1e-4, 1.59e-3), (1e-2, 1e-2)), LIMIT, ("pre-asymptotic", 2, LIMIT)),
        (points((1e-4, 6.3e-3), (1e-2, 1e-2)), LIMIT, ("pre-asymptotic", 2, LIMIT)),
        (points((1e-4, 6.32e-3), (1e-2, 1e-2)), LIMIT, ("does-not-converge", 2, LIMIT)),
        (points((2.0**-12, 2.0**-8), (2.0**-4, 2.0**-4)), LIMIT, ("converges", 2, LIMIT)),
        (points((1.1e-4, 1.7e-3), (1e-2, 1e-2)), LIMIT, ("too-few-points", 2, LIMIT)),
        (points((1e-4, 1.01e-3), (1e-3, None), (1e-2, 1.0)), LIMIT, ("converges", 1, LIMIT)),
        # only the finest two decades count: a plateau below a large first error, and a flat start
        (
            points((1e-8, 6.26e-5), (1e-7, 6.43e-5), (1e-6, 8.6e-5), (1e-5, 4.1e-4), (1e-3, 0.238)),
            LIMIT,
            ("does-not-converge", 5, LIMIT),
        ),
        (
            points((1e-6, 1.12e-7), (1e-5, 1.13e-6), (1e-4, 2.82e-6), (1e-3, 2.82e-6)),
            LIMIT,
            ("converges", 4, LIMIT),
        ),
        (
            points((1e-6, 0.0034), (1e-5, 0.0107), (1e-4, 0.0331), (1e-3, 0.0978)),
            LIMIT,
            ("converges", 4, LIMIT),
        ),
        (points((1e-6, 1.0e-4), (1e-5, 1.1e-4), (1e-4, 1e-2)), LIMIT, ("pre-asymptotic", 3, LIMIT)),
    ],
)
def test_a_tolerance_is_obeyed_where_errors_fall_with_it(
    some: list[Point], limit: float, reported: tuple[str, int, float]
) -> None:
    """Errors at the floor also obey it; a failure is reported only over two decades of tolerance."""
    assert tolerance_convergence(some, Criteria(limit)) == Convergence(*reported)
    assert tolerance_convergence(some[::-1], Criteria(limit)) == Convergence(*reported)


def test_a_property_of_the_state_does_not_fail_to_obey() -> None:
    """Constant errors of a property of the state are not a fault."""
    flat = points((1e-4, 1e-3), (1e-2, 1e-3))
    assert tolerance_convergence(flat, Criteria(LIMIT)).verdict == "does-not-converge"
    assert tolerance_convergence(flat, Criteria(LIMIT, judged="property")).verdict == "pre-asymptotic"


@pytest.mark.parametrize(
    ("error", "floor", "verdict"),
    [
        (10.0 * LIMIT, LIMIT, "exact"),
        (10.1 * LIMIT, LIMIT, "off"),
        (None, LIMIT, "unstable"),
        (1.0, 0.0031, "chaotic"),
    ],
)
def test_a_method_without_steps_is_exact_within_ten_floors(
    error: float | None, floor: float, verdict: str
) -> None:
    """A single error decides the verdict."""
    assert stepless_verdict(points((0.0, error)), Criteria(floor)) == Convergence(verdict, 0, floor)


def test_a_verdict_is_decided_where_finer_steps_would_not_change_it() -> None:
    """More cases are run for the others."""
    decided = {"converges", "does-not-converge", "at-floor", "at-precision-floor", "chaotic"}
    assert {name for name in STATES if Convergence(name, 0, 0.0).is_decided} == decided


@pytest.mark.parametrize("judge", [convergence_of, tolerance_convergence, stepless_verdict])
def test_round_off_up_to_the_largest_limit_allows_a_verdict(
    judge: Callable[[list[Point], Criteria], Convergence],
) -> None:
    """The motion is chaotic only beyond it."""
    some = points((0.1, 0.02), (0.2, 0.04))
    assert judge(some, Criteria(LARGEST_LIMIT)).verdict != "chaotic"
    assert judge(some, Criteria(math.nextafter(LARGEST_LIMIT, 1.0))).verdict == "chaotic"


# ------------------------------------------------------------------------------------------- the next step


@pytest.mark.parametrize(
    ("some", "duration_s", "strides"),
    [
        (points((0.1, 1.0)), 10.0, 20),  # ten steps per interval, then 20, 50, 100, ...
        (points((0.05, 1.0)), 10.0, 50),
        (points((0.01, 1.0)), 10.0, 200),
        (points((0.02, 1.0), (0.1, 1.0)), 10.0, 100),
        (points((0.1, 1.0)), 10_000.0, 20),
        (points((0.1, 1.0)), 10_000.04, None),  # more than 200 000 steps
        (points((0.1, None), (0.02, 1e-16)), 10.0, None),
        (points((0.1, None), (0.02, LIMIT)), 10.0, None),
        (points((0.1, None), (0.02, None)), 10.0, 100),
        (points((0.1, 0.15), (0.05, 0.11)), 10.0, 50),  # hardly shrinks: finer
        (points((0.1, 0.15), (0.05, 0.05), (0.02, 0.1)), 10.0, 100),
        (points((0.1, 1e-3), (0.05, 1e-3), (0.02, 1e-3), (0.01, 1e-3)), 10.0, None),  # does not converge
        (points((0.1, 1e-14), (0.02, 1e-16)), 10.0, 5),  # too accurate: coarser
        # four usable points without an order: finer
        (points((0.1, 0.2), (0.05, 0.01), (0.02, 0.1), (0.01, 0.01)), 10.0, 200),
        (points((1.0, 1e-14)), 10.0, None),  # nothing is coarser than the interval
        (halved_power_law(2.0, steps=[0.1, 0.05, 0.02, 0.01]), 10.0, None),
    ],
)
def test_the_next_step_is_the_next_round_number_of_the_interval(
    some: list[Point], duration_s: float, strides: int | None
) -> None:
    """1, 2 or 5 times a power of ten: finer where errors are large, coarser where they are too small."""
    found = next_step_size(some, Criteria(LIMIT), [0.1], 1.0, duration_s)
    assert found == (None if strides is None else 1.0 / strides)


@pytest.mark.parametrize(("listed", "strides"), [(0.2, 500), (0.21, None)])
def test_no_step_is_finer_than_a_hundredth_of_the_coarsest_listed(listed: float, strides: int | None) -> None:
    """Exactly a hundredth is still tried."""
    found = next_step_size(points((0.005, 1.0)), Criteria(LIMIT), [0.001, listed], 1.0, 10.0)
    assert found == (None if strides is None else 1.0 / strides)
