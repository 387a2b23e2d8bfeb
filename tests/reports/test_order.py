"""The observed order and its interval, on synthetic errors of a known order."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq
from scipy.stats import norm

from bodycheck.reports.measurement.order import _summary, observed_order, predicted_error, settled_order

LADDERS = {
    4: [1e-2, 5e-3, 2e-3, 1e-3],
    5: [2e-2, 1e-2, 5e-3, 2e-3, 1e-3],
    6: [1e-1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3],
    7: [2.0**-k for k in range(7)],
}


@pytest.mark.parametrize("order", [0.7, 1.0, 2.0, 3.0, 4.0, 8.0])
def test_power_law_has_its_order(order: float) -> None:
    """Errors c dt^p have the order p, whose interval is a few thousandths wide from five steps."""
    steps = LADDERS[5]
    found = observed_order(steps, [1e-4 * (dt / 1e-2) ** order for dt in steps], 1e-30)
    assert found.order == pytest.approx(order, abs=1e-6)
    assert found.low < order < found.high
    assert found.half_width < 0.03


def series(rng: np.random.Generator, steps: np.ndarray, noise: float) -> tuple[float, np.ndarray, float]:
    """Return an order, errors with the next order's term, noise, and a floor below the finest error."""
    p = float(rng.choice([1, 2, 3, 4, 5, 6]))
    z = steps / steps.max()
    bend = rng.uniform(-0.5, 0.5)
    law = 1.0 + bend * (z if rng.random() < 0.6 else z**2)
    floor = 10.0 ** rng.uniform(-3.0, -1.2) * float(steps.min() ** p)
    scatter = np.exp(noise * rng.normal(size=len(steps)))
    return p, steps**p * law * scatter + floor * np.abs(rng.normal(size=len(steps))), floor


@pytest.mark.parametrize("points", LADDERS)
def test_interval_has_its_coverage(points: int) -> None:
    """With noise of 0.1 to 1 %, a next-order term and a floor, 90 to 100 of 100 intervals contain the order.

    From five points on the median half-width is at most 0.1.
    """
    rng = np.random.default_rng(points)
    steps, halves, hits = np.array(LADDERS[points]), [], 0
    for _ in range(200):
        p, errors, floor = series(rng, steps, 10.0 ** rng.uniform(-3.0, -2.0))
        found = observed_order(steps.tolist(), errors.tolist(), floor)
        hits += found.low <= p <= found.high
        halves.append(found.half_width)
    assert 180 <= hits <= 200
    assert float(np.median(halves)) <= 0.1


def test_least_squares_interval_misses_the_order() -> None:
    """The next order's term bends the law: least squares misses the order, this interval does not."""
    steps = LADDERS[5]
    errors = [dt * (1.0 + 0.4 * dt / steps[0]) for dt in steps]
    slope, covariance = np.polyfit(np.log(steps), np.log(errors), 1, cov=True)
    assert abs(slope[0] - 1.0) > 3.182446305284263 * math.sqrt(covariance[0, 0])
    found = observed_order(steps, errors, 1e-30)
    assert found.low < 1.0 < found.high


def test_mean_and_variance_are_those_of_a_brute_force_integration() -> None:
    """The posterior of p by numerical integration over c and p, for each sigma and tau of the grid."""
    from bodycheck.reports.measurement import order as module

    steps = np.array(LADDERS[5])
    errors = steps**2 * (1.0 + 0.3 * steps / steps[0]) * np.exp([0.01, -0.02, 0.0, 0.02, -0.01])
    x, y, z = np.log(steps), np.log(errors), steps / steps[0]
    products = np.outer(z, z)
    nodes, weights = leggauss(240)
    middle = np.polyfit(x, y, 1)
    p = middle[0] + nodes
    # the intercept at the mean of x, so that it hardly depends on p
    a = np.mean(y) + nodes
    total = first = 0.0
    for sigma in module._NOISES[:, 0]:
        for tau in module._BENDS:
            v = sigma**2 * np.eye(5) + tau**2 * products / (1.0 - 0.5 * products)
            inverse = np.linalg.inv(v)
            residual = y - a[:, None, None] - p[None, :, None] * (x - x.mean())
            density = np.exp(-0.5 * np.einsum("ijk,kl,ijl->ij", residual, inverse, residual))
            density *= np.outer(weights, weights) / math.sqrt(np.linalg.det(v))
            total += density.sum()
            first += (density * p).sum()
    found = observed_order(steps.tolist(), errors.tolist(), 1e-30)
    assert found.order == pytest.approx(first / total, abs=2e-3)


@pytest.mark.parametrize("dt_s", [5e-4, 3e-3, 4e-2])
def test_predicted_error_is_that_of_conditioned_normal_distributions(dt_s: float) -> None:
    """Mean and quantiles of a mixture of normal distributions with a wide prior of c and p, conditioned."""
    from bodycheck.reports.measurement import order as module

    steps = np.array(LADDERS[5])
    errors = steps**2 * (1.0 + 0.3 * steps / steps[0]) * np.exp([0.01, -0.02, 0.0, 0.02, -0.01])
    h = np.array([*steps, dt_s])
    z = h / h.max()
    x, y = np.log(h / steps[2]), np.log(errors) - np.log(errors[2])
    wide = 1e3 * (1.0 + np.outer(x, x))
    products = np.outer(z, z)
    weights, means, deviations = [], [], []
    for sigma in np.ravel(module._NOISES):
        for tau in module._BENDS:
            v = sigma**2 * np.eye(6) + tau**2 * products / (1.0 - 0.5 * products) + wide
            gain = np.linalg.solve(v[:5, :5], v[:5, 5])
            quadratic = y @ np.linalg.solve(v[:5, :5], y)
            weights.append(-0.5 * (np.linalg.slogdet(v[:5, :5])[1] + quadratic))
            means.append(gain @ y + math.log(errors[2]))
            deviations.append(math.sqrt(v[5, 5] - gain @ v[:5, 5]))
    shares = np.exp(np.array(weights) - max(weights))
    shares /= shares.sum()

    def quantile(part: float) -> float:
        return float(
            brentq(lambda q: shares @ norm.cdf(q, means, deviations) - part, -60.0, 20.0, xtol=1e-12)
        )

    found = predicted_error(steps.tolist(), errors.tolist(), 1e-30, dt_s)
    expected = [shares @ np.array(means), quantile(0.025), quantile(0.975)]
    np.testing.assert_allclose(np.log([found.error, found.low, found.high]), expected, rtol=0, atol=1e-4)


def test_high_order_with_few_points_is_accepted() -> None:
    """Order 5 with errors from 1.9e-7 to 1.2e-12 is found, although the coarsest pair bends the law."""
    found = settled_order(tuple(LADDERS[4]), (1.9e-7, 4.0e-9, 3.8e-11, 1.2e-12), 3e-14)
    assert found is not None
    assert found.low <= 5.0 <= found.high


def test_coarse_steps_that_are_not_asymptotic_are_left_out() -> None:
    """Of four coarse steps of order 1 and four fine ones of order 3, the finer ones are used."""
    steps = [2.0**-k for k in range(3, 10)]
    errors = [1e-2 * (dt if dt >= steps[3] else dt**3 / steps[3] ** 2) for dt in steps]
    found = settled_order(tuple(steps), tuple(errors), 1e-30)
    assert found is not None
    assert (round(found.order), found.first, found.points) == (3, 3, 4)


@pytest.mark.parametrize("errors", [[1e-3, 2e-3, 1e-4, 3e-3], [1e-3] * 4, [1e-1, 1e-3]])
def test_irregular_errors_have_no_order(errors: list[float]) -> None:
    """Irregular errors, constant errors and too few errors have none."""
    assert settled_order(tuple(LADDERS[4][: len(errors)]), tuple(errors), 1e-14) is None


@pytest.mark.parametrize(
    ("means", "shares", "parts"), [([3.0], [1.0], (0.025, 0.975)), ([-1.0, 1.0], [0.5, 0.5], (0.05, 0.95))]
)
def test_quantiles_of_a_mixture_are_resolved(
    means: list[float], shares: list[float], parts: tuple[float, float]
) -> None:
    """They are found to half of 40 standard deviations / 2^16, of one narrow normal distribution or two."""
    width = 1e-3
    found = _summary(np.array([shares]), np.array([means]), np.array([[width] * len(means)]))
    deviation = math.hypot(width, np.std(means))
    assert found[0] == pytest.approx(np.mean(means), abs=1e-15)
    ends = [means[0] + width * norm.ppf(parts[0]), means[-1] + width * norm.ppf(parts[1])]
    assert np.abs(np.subtract(found[1:], ends)).max() <= 20.0 * deviation / 2**16


def test_many_points_have_an_order_and_a_prediction() -> None:
    """The likelihood of 60 points on a line exceeds the largest double; only ratios of it are used."""
    steps = np.geomspace(1e-1, 1e-4, 60)
    found = observed_order(steps.tolist(), (steps**2).tolist(), 1e-30)
    assert (found.order, found.points, found.first) == (pytest.approx(2.0, abs=1e-9), 60, 0)
    predicted = predicted_error(steps.tolist(), (steps**2).tolist(), 1e-30, 1e-5)
    assert predicted.error == pytest.approx(1e-10, rel=1e-3)


def test_prediction_far_beyond_the_points_is_finite() -> None:
    """Of order 30, a step 1e12 times as large has an error of e^829, which no double holds."""
    steps = [4e-3, 2e-3, 1e-3]
    found = predicted_error(steps, [(dt / 1e-3) ** 30 for dt in steps], 1e-30, 1e9)
    assert found.error == found.high == math.exp(700.0)
