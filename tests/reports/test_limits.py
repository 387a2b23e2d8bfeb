"""The limit of ever finer steps, on synthetic motions with a known limit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.convergence import Criteria, Point, convergence_of
from bodycheck.reports.measurement.limits import Limit, limit_of

SAMPLES = np.linspace(0.0, 1.0, 61)
LADDERS = (
    (2e-2, 1e-2, 5e-3, 2e-3, 1e-3),
    (1e-2, 5e-3, 2e-3, 1e-3),
    (4e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4),
    tuple(2.0**-k for k in range(4, 11)),
)
FLOOR = 1e-13


def field(rng: np.random.Generator) -> Array:
    """Return a smooth motion (samples, 3) from 0, of size one."""
    terms = [
        rng.normal(size=3) * np.sin(np.outer(SAMPLES, rng.uniform(0.5, 9.0, size=3)) + rng.uniform(0.0, 3.0))
        for _ in range(3)
    ]
    values = np.sum(terms, axis=0)
    values -= values[0]
    return np.asarray(values / np.linalg.norm(values, axis=-1).max())


def departures(
    rng: np.random.Generator, steps: Sequence[float], limit: float, *, saturating: bool = False
) -> tuple[list[Array], float]:
    """Return L + C h^p + C' h^(p + 1), with noise of up to 1 % and round-off, and C h^p at the finest."""
    order, at_coarsest = rng.choice([1.0, 2.0, 3.0, 4.0, 5.0]), 10.0 ** rng.uniform(-3.0, -0.5)
    if saturating:
        at_coarsest *= 100.0
    main, next_one, off = field(rng), field(rng) * rng.uniform(-0.5, 0.5), field(rng)
    noise = 10.0 ** rng.uniform(-4.0, -2.0)
    motions, own = [], 0.0
    for step in steps:
        z = step / steps[0]
        own = at_coarsest * z**order
        part = own * (main + z * next_one + noise * rng.normal() * main + noise * rng.normal() * field(rng))
        if saturating:
            part = np.sin(part)
        motions.append(limit * off + part + FLOOR * rng.normal(size=part.shape))
    return motions, own


@pytest.mark.parametrize(
    ("distance", "order", "is_truth"), [(0.01, 2.0, True), (0.2, 2.0, False), (0.01, 0.0, False)]
)
def test_a_limit_is_the_truth_if_near_and_approached(distance: float, order: float, is_truth: bool) -> None:
    """Its distance is within its uncertainty, and the differences shrink."""
    assert Limit(distance, 0.1, order, is_off=False).is_truth is is_truth


@pytest.mark.parametrize(
    ("distance", "order", "is_doubtful"),
    [(0.029, 1.0, False), (0.031, 1.0, True), (0.031, 0.5, True), (0.031, 0.49, False)],
)
def test_a_limit_far_from_the_truth_is_doubtful(distance: float, order: float, is_doubtful: bool) -> None:
    """Only differences that shrink have a limit; it must be three uncertainties off."""
    assert Limit(distance, 0.01, order, is_off=False).is_doubtful is is_doubtful


def judged(steps: Sequence[float], motions: Sequence[Array], how: Criteria | None = None) -> str:
    """Return the verdict on a quantity with these motions."""
    points = [
        Point(step, float(np.max(np.linalg.norm(motion, axis=-1))), motion)
        for step, motion in zip(steps, motions, strict=True)
    ]
    return convergence_of(points, how or Criteria(floor=FLOOR, growing=10.0 * FLOOR)).verdict


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("saturating", [False, True])
def test_no_healthy_method_is_reported(saturating: bool) -> None:
    """Of 1,000 motions that converge to the truth, saturated at coarse steps or not, none is reported."""
    rng = np.random.default_rng(5 + saturating)
    for number in range(1000):
        steps = LADDERS[number % len(LADDERS)]
        motions, _ = departures(rng, steps, 0.0, saturating=saturating)
        assert judged(steps, motions) != "does-not-converge"


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("whole_motions", [True, False])
def test_plateau_is_reported(whole_motions: bool) -> None:
    """Of 200 motions flat to a fifth over their three finest steps, at least 95 % are reported.

    Also where only the errors are known.
    """
    named = 0
    for number in range(200):
        steps = LADDERS[number % len(LADDERS)]
        healthy, _ = departures(np.random.default_rng(number), steps, 0.0)
        limit = 5.0 * float(np.max(np.linalg.norm(healthy[-3], axis=-1)))
        motions, _ = departures(np.random.default_rng(number), steps, limit)
        if whole_motions:
            named += judged(steps, motions) == "does-not-converge"
        else:
            errors = [float(np.max(np.linalg.norm(motion, axis=-1))) for motion in motions]
            points = [Point(step, min(error, 0.29)) for step, error in zip(steps, errors, strict=True)]
            named += convergence_of(points, Criteria(floor=FLOOR)).verdict == "does-not-converge"
    assert named >= 190


def test_wrong_limit_is_reported_before_the_error_is_flat() -> None:
    """Of order 1, an error that still falls by a third per step already has a wrong limit."""
    rng = np.random.default_rng(3)
    main, off = field(rng), field(rng)
    steps = [8e-3, 4e-3, 2e-3, 1e-3]
    motions = [0.05 * off + 10.0 * step * main for step in steps]
    found = limit_of(steps, motions, FLOOR)
    assert found is not None
    rms = math.sqrt(float(np.mean(np.sum((0.05 * off) ** 2, axis=-1))))
    assert found.distance == pytest.approx(rms, rel=1e-9)
    assert found.order == pytest.approx(1.0, abs=1e-6)
    assert found.is_off == (rms > 30.0 * found.uncertainty)
    last = math.sqrt(float(np.mean(np.sum((0.01 * main) ** 2, axis=-1))))
    assert found.uncertainty == pytest.approx(0.1 * last, rel=1e-6)


@pytest.mark.parametrize(("steps", "order"), [((4e-3, 2e-3, 1e-3), 2.0), ((1e-2, 5e-3, 2e-3), 4.0)])
def test_limit_of_a_power_law_is_found(steps: tuple[float, ...], order: float) -> None:
    """Three motions L + C h^p give p and L, whatever the ratio of the steps."""
    rng = np.random.default_rng(1)
    main, off = field(rng), field(rng)
    found = limit_of(steps, [1e-3 * off + 1e3 * h**order * main for h in steps], 1e-15)
    assert found is not None
    assert found.order == pytest.approx(order, abs=1e-5)
    truth = limit_of(steps, [1e3 * h**order * main for h in steps], 1e-15)
    assert truth is not None
    assert truth.distance <= 1e-9
    assert truth.is_truth


def test_saturated_motions_are_not_reported() -> None:
    """Errors of pi at every step whose motions still change have no limit yet."""
    rng = np.random.default_rng(2)
    assert judged(LADDERS[0], [3.1 * field(rng) for _ in LADDERS[0]]) == "pre-asymptotic"


def test_no_extrapolation_where_a_load_switches_inside_a_step() -> None:
    """Only a motion that no longer changes, far from the truth, is reported."""
    rng = np.random.default_rng(4)
    main, off = field(rng), field(rng)
    steps = (8e-3, 4e-3, 2e-3, 1e-3)
    moving = [0.2 * off + 30.0 * h * main for h in steps]
    how = Criteria(floor=FLOOR, extrapolated=False)
    assert judged(steps, moving) == "does-not-converge"
    assert judged(steps, moving, how) != "does-not-converge"
    still = [0.2 * off + 0.05 * h * main for h in steps]
    assert judged(steps, still, how) == "does-not-converge"


def test_rising_errors_are_not_extrapolated() -> None:
    """Round-off that grows with the number of steps is not a wrong limit."""
    rng = np.random.default_rng(6)
    off = field(rng)
    assert judged(LADDERS[0], [1e-7 / h * off for h in LADDERS[0]]) != "does-not-converge"


def test_property_is_never_wrong() -> None:
    """A quaternion norm with the same deviation at every step is a design, however large."""
    off = field(np.random.default_rng(8))
    motions = [1e-3 * off for _ in LADDERS[0]]
    assert judged(LADDERS[0], motions) == "does-not-converge"
    assert judged(LADDERS[0], motions, Criteria(floor=FLOOR, judged="property")) != "does-not-converge"


def test_errors_of_round_off_are_not_reported() -> None:
    """An error of 1e-10 that finer steps do not reduce may be an engine's own rounding."""
    off = field(np.random.default_rng(9))
    assert judged(LADDERS[0], [1e-10 * off for _ in LADDERS[0]]) == "at-floor"
    assert judged(LADDERS[0], [1e-8 * off for _ in LADDERS[0]]) == "does-not-converge"


def test_two_steps_have_no_limit() -> None:
    """Three steps are needed."""
    assert limit_of([2e-2, 1e-2], [np.ones((3, 1))] * 2, FLOOR) is None


HALVING = (4.0, 2.0, 1.0)
SMALL_STEPS = (3.0, 2.0, 1.5)
"""Their span of 2 is too short to tell whether a motion has stopped changing."""


@pytest.mark.parametrize(
    ("steps", "values", "limit"),
    [
        # h itself: the limit is 0, as uncertain as the last difference of three
        (HALVING, (4.0, 2.0, 1.0), Limit(0.0, 1.0, 1.0, is_off=False)),
        # 5 + h: two extrapolations agree, which is as certain as a tenth of the last difference
        ((8.0, *HALVING), (13.0, 9.0, 7.0, 6.0), Limit(5.0, 0.1, 1.0, is_off=True)),
        (
            (8.0, *HALVING),
            (12.0, 8.0, 6.0, 4.9),
            Limit(32.0 / 9.0, 4.0 / 9.0, math.log2(20.0 / 11.0), is_off=False),
        ),
        # 1 + h at five steps: the coarser extrapolation takes the three before the finest
        ((20.0, 10.0, 5.0, 2.0, 1.0), (21.0, 11.0, 6.0, 3.0, 2.0), Limit(1.0, 0.1, 1.0, is_off=False)),
        # the differences before do not shrink: the limit is compared with the finest motion but one
        ((16.0, 8.0, *HALVING), (30.0, 7.5, 7.0, 5.0, 4.0), Limit(3.0, 2.0, 1.0, is_off=False)),
        # a limit beyond the truth on the other side; the distance has not grown
        (HALVING, (-5.0, -1.0, 1.0), Limit(3.0, 2.0, 1.0, is_off=False)),
        # a growing distance is not extrapolated
        (HALVING, (4.0, 5.0, 5.5), Limit(5.5, 0.5, 1.0, is_off=True)),
        (HALVING, (6.0, 5.0, 5.5), Limit(5.5, 0.5, 1.0, is_off=True)),
        (HALVING, (7.0, 9.0, 10.0), Limit(10.0, 1.0, 1.0, is_off=False)),
        # the differences do not shrink
        (HALVING, (1.0, 2.0, 3.0), Limit(3.0, 1.0, 0.0, is_off=False)),
        (HALVING, (8.0, 9.0, 10.0), Limit(10.0, 1.0, 0.0, is_off=False)),
        (HALVING, (9.0, 10.0, 11.0), Limit(11.0, 1.0, 0.0, is_off=True)),
        ((4.0, 2.0, 1.1), (9.0, 10.0, 11.0), Limit(11.0, 1.0, 0.0, is_off=False)),
        ((3.9, 2.0, 1.0), (9.0, 10.0, 11.0), Limit(11.0, 1.0, 0.0, is_off=True)),
        # nothing changes by more than what is certain: the last motion is the limit, of the highest order
        (HALVING, (0.5, 0.1, 0.1), Limit(0.1, 0.01, 9.0, is_off=False)),
        (HALVING, (1.0, 0.01, 0.0), Limit(0.0, 0.01, 9.0, is_off=False)),
        # differences that shrink faster than any order are of the highest
        (HALVING, (20.02, 0.02, 0.0), Limit(0.02 / 511.0, 0.02, 9.0, is_off=False)),
    ],
)
def test_limit_of_a_few_numbers(steps: tuple[float, ...], values: tuple[float, ...], limit: Limit) -> None:
    """Distance, uncertainty, order and conclusion, by hand, where a hundredth is certain."""
    found = limit_of(steps, [np.array([[value]]) for value in values], 0.01)
    assert found is not None
    numbers = [found.distance, found.uncertainty, found.order]
    assert numbers == pytest.approx([limit.distance, limit.uncertainty, limit.order], rel=1e-3, abs=1e-9)
    assert found.is_off is limit.is_off


@pytest.mark.parametrize(("order", "is_off"), [(0.3, False), (0.6, True)])
def test_differences_that_hardly_shrink_show_no_wrong_limit(order: float, is_off: bool) -> None:
    """Below order 1/2 nothing is extrapolated, whether the distance falls or grows."""
    for sign in (1.0, -1.0):
        motions = [np.array([[20.0 + sign * 0.1 * h**order]]) for h in (*SMALL_STEPS, 1.1, 0.8)]
        found = limit_of((*SMALL_STEPS, 1.1, 0.8), motions, 1e-6)
        assert found is not None
        assert found.order == pytest.approx(order, abs=1e-6)
        assert found.is_off is is_off
