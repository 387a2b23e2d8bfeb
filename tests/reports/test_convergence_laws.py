"""Each rule of orders, floors and verdicts at its very edge; the interval by another way to it."""

from __future__ import annotations

import math

import pytest

from bodycheck.reports.measurement.convergence import (
    Convergence,
    Criteria,
    Point,
    convergence_of,
    next_step_size,
    round_off_floor,
    stepless_verdict,
    tolerance_convergence,
    usable,
)

LIMIT = 2.0**-50
HALVED = [2.0**-k for k in range(5, 10)]


def points(*pairs: tuple[float, float | None]) -> list[Point]:
    """Return cases of steps and errors."""
    return [Point(dt_s, error) for dt_s, error in pairs]


def power_law(order: float, *, at_1: float = 1e-3, steps: list[float] | None = None) -> list[Point]:
    """Return errors c dt^p, by default of five steps, each half of the one before."""
    return points(*((dt_s, at_1 * dt_s**order) for dt_s in steps or HALVED))


# --------------------------------------------------------------------------------------- what can be used


def test_usable_errors_lie_strictly_between_ten_floors_and_three_tenths() -> None:
    """Coarsest first; a case that did not end well is none."""
    edge = 10.0 * LIMIT
    some = points((0.1, edge), (0.4, 0.3), (0.2, None), (0.3, math.nextafter(0.3, 0.0)))
    some += points((0.5, math.nextafter(edge, 1.0)))
    assert [p.dt_s for p in usable(some, LIMIT)] == [0.5, 0.3]


@pytest.mark.parametrize(
    ("coarser", "finer", "floor"),
    [
        (2.0**-31, 2.0**-32, LIMIT),  # a fourth of the step gains a half: that is order 1/2
        (math.nextafter(2.0**-31, 0.0), 2.0**-32, 2.0**-31),
        (2.0**-33, 2.0**-32, 2.0**-32),
        (1e-9, 1e-9, LIMIT),  # no round-off is that large
        (0.99e-9, 1e-9, 1e-9),
    ],
)
def test_the_floor_is_where_finer_steps_gain_less_than_half_an_order(
    coarser: float, finer: float, floor: float
) -> None:
    """Both errors lie on it then; cases that did not end well are passed over."""
    some = points((4e-3, coarser), (2e-3, None), (1e-3, finer))
    assert round_off_floor(some, LIMIT) == pytest.approx(floor, rel=1e-15, abs=0.0)
    assert round_off_floor(some, 1e-8) == 1e-8


# ---------------------------------------------------------------------------------------------- the order


@pytest.mark.parametrize(
    ("some", "verdict"),
    [
        (power_law(0.51), "converges"),
        (power_law(0.45, steps=HALVED[:4]), "pre-asymptotic"),
        (power_law(2.0, steps=HALVED[:4]), "converges"),
        (power_law(2.0, steps=HALVED[:2]), "too-few-points"),
    ],
)
def test_an_order_settles_from_four_points_from_a_half_on(some: list[Point], verdict: str) -> None:
    """Fewer points or a lower order are none."""
    found = convergence_of(some, Criteria(LIMIT))
    assert found.verdict == verdict
    assert (found.order is None) == (verdict != "converges")


# ------------------------------------------------------------------------------------------------ verdicts


@pytest.mark.parametrize(
    ("some", "limit", "told"),
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
    ],
)
def test_a_verdict_without_an_order_has_its_reason(
    some: list[Point], limit: float, told: tuple[str, int, float]
) -> None:
    """Verdict, usable points and floor, in whatever order the cases come."""
    for ordered in (some, some[::-1]):
        found = convergence_of(ordered, Criteria(limit))
        assert (found.verdict, found.points, found.floor) == told


@pytest.mark.parametrize(
    ("some", "limit", "told"),
    [
        (points((0.1, 1e-3)), 0.0031, ("chaotic", 0, 0.0031)),
        (points((0.1, 1e-3)), 0.003, ("at-floor", 0, 0.003)),
        (points((0.1, None)), LIMIT, ("unstable", 0, LIMIT)),
        (points((0.1, 10.0 * LIMIT), (0.2, LIMIT)), LIMIT, ("at-floor", 0, LIMIT)),
        (points((0.1, LIMIT), (0.2, 10.0 * LIMIT)), LIMIT, ("at-floor", 0, LIMIT)),
        (points((0.1, 10.0 * LIMIT), (0.2, 0.2)), LIMIT, ("converges", 1, LIMIT)),
        (points((1e-4, 0.99e-3), (1e-2, 1e-2)), LIMIT, ("converges", 2, LIMIT)),
        (points((1e-4, 1.01e-3), (1e-2, 1e-2)), LIMIT, ("does-not-converge", 2, LIMIT)),
        (points((2.0**-12, 2.0**-8), (2.0**-4, 2.0**-4)), LIMIT, ("does-not-converge", 2, LIMIT)),
        (points((1.1e-4, 1.2e-3), (1e-2, 1e-2)), LIMIT, ("too-few-points", 2, LIMIT)),
        (points((1e-4, 1.01e-3), (1e-3, None), (1e-2, 1.0)), LIMIT, ("converges", 1, LIMIT)),
    ],
)
def test_a_tolerance_is_obeyed_where_errors_fall_with_its_root(
    some: list[Point], limit: float, told: tuple[str, int, float]
) -> None:
    """Or down to the floor; two decades of tolerance are needed to say that they do not."""
    assert tolerance_convergence(some, Criteria(limit)) == Convergence(*told)
    assert tolerance_convergence(some[::-1], Criteria(limit)) == Convergence(*told)


def test_a_property_of_the_state_does_not_fail_to_obey() -> None:
    """Flat errors of what the state holds are no fault."""
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
    """One error decides."""
    assert stepless_verdict(points((0.0, error)), Criteria(floor)).verdict == verdict


# ------------------------------------------------------------------------------------------- the next step


@pytest.mark.parametrize(
    ("some", "duration_s", "strides"),
    [
        (points((0.1, 1.0)), 10.0, 20),  # ten steps an interval, then 20, 50, 100, ...
        (points((0.05, 1.0)), 10.0, 50),
        (points((0.01, 1.0)), 10.0, 200),
        (points((0.02, 1.0), (0.1, 1.0)), 10.0, 100),
        (points((0.1, 1.0)), 10_000.0, 20),
        (points((0.1, 1.0)), 10_001.0, None),  # more than 200 000 steps
        (points((0.1, None), (0.02, 1e-16)), 10.0, None),
        (points((0.1, None), (0.02, None)), 10.0, 100),
        (points((0.1, 1e-14), (0.02, 1e-16)), 10.0, 5),  # too good: coarser
        # four that can be used, and no order: finer
        (points((0.1, 0.2), (0.05, 0.01), (0.02, 0.1), (0.01, 0.01)), 10.0, 200),
        (points((1.0, 1e-14)), 10.0, None),  # nothing is coarser than the interval
        (power_law(2.0, steps=[0.1, 0.05, 0.02, 0.01]), 10.0, None),
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
