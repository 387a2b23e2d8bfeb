"""Each rule of orders, floors and verdicts at its very edge; the interval by another way to it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bodycheck.reports.convergence import (
    Convergence,
    Point,
    convergence_of,
    decades,
    is_flat,
    obedience_of,
    round_off_floor,
    usable,
)
from bodycheck.reports.ladder import next_step

LIMIT = 2.0**-50
STUDENT = {2: 4.302652729911275, 3: 3.182446305284263}  # Abramowitz and Stegun (1964), table 26.10
HALVED = [2.0**-k for k in range(5, 10)]


def points(*pairs: tuple[float, float | None], settling: float | None = 0.5) -> list[Point]:
    """Return cases of steps and errors."""
    return [Point(dt_s, error, settling) for dt_s, error in pairs]


def power_law(order: float, *, at_1: float = 1e-3, steps: list[float] | None = None) -> list[Point]:
    """Return errors c dt^p, by default of five steps, each half of the one before."""
    return points(*((dt_s, at_1 * dt_s**order) for dt_s in steps or HALVED))


def bent(order: float, half_width: float) -> list[Point]:
    """Return four errors c dt^p exp(+-r): r gives the slope p this half-width by Student's t."""
    r = half_width * math.log(2.0) / (STUDENT[2] * math.sqrt(0.4))
    signs = (1.0, -1.0, -1.0, 1.0)
    law = power_law(order, steps=HALVED[1:])
    return [Point(p.dt_s, (p.error or 0.0) * math.exp(r * sign)) for p, sign in zip(law, signs, strict=True)]


def half_width(some: list[Point]) -> float:
    """Return that of the 95 % interval of the slope, by numpy's covariance of the fit."""
    x, y = np.log([p.dt_s for p in some]), np.log([p.error or math.nan for p in some])
    _, covariance = np.polyfit(x, y, 1, cov=True)
    return STUDENT[len(some) - 2] * math.sqrt(covariance[0, 0])


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


@pytest.mark.parametrize(
    ("errors", "flat"),
    [
        ((1.99e-3, 1.0, 1e-3), True),
        ((2.0e-3, 1.0, 1e-3), False),
        ((1e-3, 1e-3, 10.0 * LIMIT), False),
        ((2.0**-40, 2.0**-40, 2.0**-40), True),
        ((10.0 * LIMIT, 10.0 * LIMIT, 10.0 * LIMIT), False),
        ((1e-3, None, 1e-3), True),
        ((None, None, 1e-3), False),
    ],
)
def test_errors_are_flat_where_they_shrink_by_less_than_two(
    errors: tuple[float | None, ...], flat: bool
) -> None:
    """From the coarsest to the finest, all well above the floor; one alone is not flat."""
    assert is_flat(points(*zip((0.4, 0.2, 0.1), errors, strict=True)), LIMIT) == flat


def test_decades_are_those_from_the_finest_to_the_coarsest_step() -> None:
    """In whatever order."""
    assert decades(points((1e-2, 0.1), (1.0, 0.1), (0.1, 0.1))) == pytest.approx(2.0)


# ---------------------------------------------------------------------------------------------- the order


@pytest.mark.parametrize("seed", range(3))
def test_order_and_interval_are_those_of_a_straight_line_by_another_way(seed: int) -> None:
    """Slope and 95 % interval of a noisy law agree with numpy's fit and its covariance."""
    rng = np.random.default_rng(seed)
    some = [Point(p.dt_s, (p.error or 0.0) * math.exp(0.005 * rng.normal())) for p in power_law(2.0)]
    found = convergence_of(some, LIMIT)
    slope, _ = np.polyfit(np.log(HALVED), np.log([p.error or math.nan for p in some]), 1)
    half = half_width(some)
    assert half <= 0.05
    told = (found.order, found.order_low, found.order_high)
    assert told == pytest.approx((slope, slope - half, slope + half), rel=1e-9)
    assert (found.verdict, found.points, found.floor) == ("converges", 5, LIMIT)


@pytest.mark.parametrize(
    ("some", "verdict"),
    [
        (power_law(0.51), "converges"),
        (power_law(0.49), "pre-asymptotic"),
        (power_law(2.0, steps=HALVED[:4]), "converges"),
        (power_law(2.0, steps=HALVED[:3]), "too-few-points"),
        (bent(2.0, 0.249), "converges"),
        (bent(2.0, 0.251), "pre-asymptotic"),
    ],
)
def test_an_order_settles_from_four_points_within_a_quarter_from_a_half_on(
    some: list[Point], verdict: str
) -> None:
    """Fewer points, a wider interval or a lower order are none."""
    found = convergence_of(some, LIMIT)
    assert found.verdict == verdict
    assert (found.order is None) == (verdict != "converges")


@pytest.mark.parametrize(("inner", "edge"), [(0.0, 0.05), (0.06, 0.1), (0.11, 0.25)])
def test_a_tighter_interval_goes_before_a_longer_run(inner: float, edge: float) -> None:
    """Five points whose interval is just within a level are taken; just beyond it, the four within it."""
    first, *finest = power_law(2.0)[0], *bent(2.0, inner)

    def five(off: float) -> list[Point]:
        return [Point(first.dt_s, (first.error or 0.0) * math.exp(off)), *finest]

    for wanted, count in ((0.99 * edge, 5), (1.01 * edge, 4)):
        low, high = 0.0, 1.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if half_width(five(middle)) < wanted else (low, middle)
        assert convergence_of(five(low), LIMIT).points == count


def test_of_runs_of_one_length_the_finer_is_taken() -> None:
    """Four coarse steps of order 1 and four fine ones of order 3."""
    steps = [2.0**-k for k in range(3, 10)]
    some = [Point(dt, 1e-2 * (dt if dt >= steps[3] else dt**3 / steps[3] ** 2)) for dt in steps]
    found = convergence_of(some, LIMIT)
    assert (found.order, found.points) == (pytest.approx(3.0), 4)


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
        (points((1e-2, 1e-3), (1e-4, 1e-3), settling=0.1), LIMIT, ("does-not-converge", 2, LIMIT)),
        (points((1e-2, 1e-3), (1e-4, 1e-3), settling=0.11), LIMIT, ("too-few-points", 2, LIMIT)),
        (points((1e-2, 1e-3), (1e-4, 1e-3), settling=None), LIMIT, ("too-few-points", 2, LIMIT)),
        (points((1e-2, 1e-3), (1.1e-4, 1e-3), settling=0.1), LIMIT, ("too-few-points", 2, LIMIT)),
        (points((100.0, 1e-3), (10.0**0.5e-6, 1e-3), settling=0.1), LIMIT, ("does-not-converge", 2, LIMIT)),
        (points((100.0, 1e-3), (10.0**1.5e-6, 1e-3), settling=0.1), LIMIT, ("too-few-points", 2, LIMIT)),
        (points((1e-2, 2.1e-3), (1e-4, 1e-3), settling=0.1), LIMIT, ("too-few-points", 2, LIMIT)),
    ],
)
def test_a_verdict_without_an_order_has_its_reason(
    some: list[Point], limit: float, told: tuple[str, int, float]
) -> None:
    """Verdict, usable points and floor; it is the finest step that must have settled."""
    assert convergence_of(some, limit) == Convergence(*told)
    assert convergence_of(some[::-1], limit) == Convergence(*told)


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
    assert obedience_of(some, limit) == Convergence(*told)
    assert obedience_of(some[::-1], limit) == Convergence(*told)


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
    found = next_step(some, LIMIT, [0.1], 1.0, duration_s)
    assert found == (None if strides is None else 1.0 / strides)


@pytest.mark.parametrize(("listed", "strides"), [(0.2, 500), (0.21, None)])
def test_no_step_is_finer_than_a_hundredth_of_the_coarsest_listed(listed: float, strides: int | None) -> None:
    """Exactly a hundredth is still tried."""
    found = next_step(points((0.005, 1.0)), LIMIT, [0.001, listed], 1.0, 10.0)
    assert found == (None if strides is None else 1.0 / strides)
