"""Judge made-up series of errors: without a law, with one wrong step, and healthy.

    python tools/verdict_trials.py --series 400 --healthy 2000 --seed 1

Without a law: errors drawn log-uniformly over ten decades, of which at most 2 % may have an order. One wrong
step: power laws of order 1, 2, 4 and 6 with a next-order term and scatter of 1 %, in which one interior error
below 0.3 is 1e2 to 1e5 times too large; it must be found in 95 %. Healthy: the series of
tests/reports/test_order.py; none may be accused, and each must have the order that it has without the test of
its fit. Prints the figures. Exit status 1 if one is missed.
"""

from __future__ import annotations

import numpy as np
from trials import command

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement import order as fits
from bodycheck.reports.measurement.convergence import Criteria, Point, convergence_of
from tests.reports.test_order import LADDERS
from tests.reports.test_order import series as healthy_series

_STEPS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)
_FLOOR = 1e-14


def main(series: int = 400, healthy: int = 2000, seed: int = 1) -> bool:
    """Print the figures; return whether one is missed."""
    chance = np.random.default_rng(seed)
    failed = 0
    for points in (6, 7, 8):
        ordered = sum(
            fits.settled_order(
                _STEPS[:points], tuple(0.3 * 10.0 ** chance.uniform(-10.0, 0.0, points)), _FLOOR
            )
            is not None
            for _ in range(series)
        )
        print(f"{points} points without a law: {series}, with an order: {ordered}", flush=True)
        failed += ordered > 0.02 * series
    for order in (1, 2, 4, 6):
        found = sum(one_wrong(chance, order) for _ in range(series))
        print(f"order {order}, one wrong step: {series}, found: {found}", flush=True)
        failed += found < 0.95 * series
    accused = changed = 0
    for number in range(healthy):
        steps = np.array(LADDERS[4 + number % 4])
        _, errors, floor = healthy_series(chance, steps, 10.0 ** chance.uniform(-3.0, -2.0))
        points = [Point(h, e) for h, e in zip(steps, errors, strict=True)]
        accused += convergence_of(points, Criteria(floor)).verdict in ("does-not-converge", "error-grows")
        changed += with_fit(tuple(steps), tuple(errors), floor)
    print(f"healthy: {healthy}, accused: {accused}, with another order: {changed}")
    return failed + accused + changed > 0


def one_wrong(chance: np.random.Generator, order: int) -> bool:
    """Whether the wrong step of a power law is a finding with its error."""
    steps = np.array(_STEPS[: int(chance.integers(5, 9))])
    z = steps / steps[0]
    while True:
        law = 10.0 ** chance.uniform(-6.0, -1.0) * z**order * (1.0 + chance.uniform(-0.5, 0.5) * z)
        errors: Array = law * np.exp(0.01 * chance.normal(size=len(steps)))
        place = int(chance.integers(1, len(steps) - 1))
        errors[place] *= 10.0 ** chance.uniform(2.0, 5.0)
        if errors[place] < 0.3:
            break
    points = [Point(h, e) for h, e in zip(steps, errors, strict=True)]
    found = convergence_of(points, Criteria(min(_FLOOR, 1e-3 * float(errors.min()))))
    return (found.verdict, found.excluded_dt_s) == ("does-not-converge", steps[place])


def with_fit(steps: tuple[float, ...], errors: tuple[float, ...], floor: float) -> bool:
    """Whether the test of the fit changes the order of a series."""
    tested = fits.settled_order(steps, errors, floor)
    least, fits._MIN_FIT = fits._MIN_FIT, 0.0
    try:
        fits.settled_order.cache_clear()
        return tested != fits.settled_order(steps, errors, floor)
    finally:
        fits._MIN_FIT = least
        fits.settled_order.cache_clear()


if __name__ == "__main__":
    command(main)
