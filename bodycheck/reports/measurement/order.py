"""The observed order of a method with its 95 % interval, from errors at several steps.

log e = c + p log h + f(h) + noise. f is the contribution of the higher orders, a smooth function that
vanishes with the step: sum_m a_m z^m with z = h / h_max and a_m ~ N(0, tau^2 / 2^(m - 1)). The noise is
N(0, sigma^2). tau and sigma are unknown: the interval is that of the posterior of p, averaged over both. It
widens where the data cannot distinguish the order from the next one, and narrows where they can. Errors that
even the largest sigma and tau leave improbable do not follow the law, so that they have no order, however
narrow the interval. Sources: Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, sections
2.7 and 5.2; Gelman et al. (2013), Bayesian Data Analysis, section 6.3, on posterior predictive p-values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bodycheck.reference_impl.arrays import Array

MIN_POINTS = 4
_NOISES = np.geomspace(2e-4, 0.1, 16)[:, None]  # sigma: relative scatter of maxima over samples
_BENDS = np.geomspace(0.1, 0.8, 6)  # tau: contribution of the next order at the coarsest step
_DECAY = 0.5  # of the variance of each further order
_FLOOR_NOISE = 0.01  # of the error: a floor of this size makes the noise sqrt 2 times as large
_TAILS = np.array([0.025, 0.975])
_REACH, _HALVINGS = 20.0, 16  # of the quantile search, resolved to 40 standard deviations / 2^16
_WIDEST_ORDERS = (0.05, 0.1, 0.25)  # half-widths of the interval that settle an order, best first
_MIN_ORDER = 0.5
_MIN_FIT = 1e-6  # posterior predictive p-value, below which errors do not follow the law
_LARGEST_LOG = 700.0  # exp of it is finite


@dataclass(frozen=True)
class Order:
    """The order, the ends of its 95 % interval, the number of points used, and the place of the first.

    fit: probability of residuals as large as these, if the errors follow the law.
    """

    order: float
    low: float
    high: float
    points: int
    first: int = 0
    fit: float = 1.0

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


@lru_cache(maxsize=1024)  # the refinement computes it first, and needs it again, as error curves do
def settled_order(steps: tuple[float, ...], errors: tuple[float, ...], floor: float) -> Order | None:
    """Return the order settled by the longest run of consecutive steps; None where no run settles it.

    The errors of the run must follow the law. steps (n,) in s, descending, and errors (n,) > 0, all usable.
    The coarsest steps may not be asymptotic and round-off may affect the finest. A tighter interval takes
    precedence over a longer run, and of runs of equal length the finer one is used.
    """
    count = len(steps)
    runs = [
        slice(first, first + length)
        for length in range(count, MIN_POINTS - 1, -1)
        for first in range(count - length, -1, -1)
    ]
    found: dict[int, Order] = {}
    for widest in _WIDEST_ORDERS:
        for number, run in enumerate(runs):
            if number not in found:
                found[number] = replace(observed_order(steps[run], errors[run], floor), first=run.start)
            one = found[number]
            certain = one.half_width <= widest and one.order >= max(_MIN_ORDER, one.half_width)
            if certain and one.fit >= _MIN_FIT:
                return one
    return None


def observed_order(steps: Sequence[float], errors: Sequence[float], floor: float) -> Order:
    """Return the posterior mean of p and its central 95 % interval, from at least 3 points.

    steps (n,) in s, descending; errors (n,) > 0; floor: of the errors, whose noise grows towards it.
    """
    from scipy.special import chdtrc  # imported here: takes half a second

    e = np.asarray(errors)
    spreads = _spreads(e, floor)
    fit = _fit_of(tuple(steps), tuple(spreads))
    y = np.log(e) / spreads
    rest = fit.residual @ y
    noise, bend = _NOISES[..., None] ** 2, _BENDS[:, None] ** 2
    variance = noise + bend * fit.variances
    misfit = np.sum(rest * rest / variance, axis=-1)
    likelihood = -0.5 * (np.sum(np.log(variance), axis=-1) + misfit)
    weights = np.exp(likelihood - likelihood.max())
    weights /= weights.sum()
    means = fit.slope @ y - np.sum(bend * fit.covariances * rest / variance, axis=-1)
    spread = (
        noise[..., 0] * fit.slope_noise
        + bend[:, 0] * fit.slope_bend
        - np.sum((bend * fit.covariances) ** 2 / variance, axis=-1)
    )
    deviations = np.sqrt(np.maximum(spread, 0.0)) + 1e-15
    mean, low, high = _summary(weights, means, deviations)
    probability = float(np.sum(weights * chdtrc(len(rest), misfit)))
    return Order(mean, low, high, len(e), fit=probability)


@dataclass(frozen=True)
class PredictedError:
    """The error expected at a step that was not measured, and the ends of its 95 % interval."""

    error: float
    low: float
    high: float


def predicted_error(
    steps: Sequence[float], errors: Sequence[float], floor: float, dt_s: float
) -> PredictedError:
    """Return the posterior prediction of the error at dt_s, from at least 3 points.

    steps (n,) in s, errors (n,) > 0, floor: as for observed_order. The interval widens with the distance to
    the points, and where these cannot distinguish the order from the next one.
    """
    e = np.asarray(errors)
    h = np.array([*steps, dt_s])
    z = h / h.max()
    products = np.outer(z, z)
    bends = products / (1.0 - _DECAY * products)
    basis, y, noises = np.stack([np.ones_like(h), np.log(h)], axis=-1), np.log(e), _spreads(e, floor) ** 2
    x, new = basis[:-1], basis[-1]

    noise, bend = (_NOISES**2)[..., None, None], (_BENDS**2)[:, None, None]
    inverse = np.linalg.inv(noise * np.diag(noises) + bend * bends[:-1, :-1])
    weighted = x.T @ inverse
    information = weighted @ x
    line = np.linalg.solve(information, (weighted @ y)[..., None])[..., 0]
    rest = y - line @ x.T
    pull = (inverse @ rest[..., None])[..., 0]
    # the determinant of the inverse covariance enters with the opposite sign
    likelihood = 0.5 * (
        np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(information)[1] - np.sum(rest * pull, axis=-1)
    )
    weights = np.exp(likelihood - likelihood.max())
    weights /= weights.sum()

    shared = bend[..., 0] * bends[:-1, -1]
    means = line @ new + np.sum(shared * pull, axis=-1)
    solved = (inverse @ np.broadcast_to(shared, rest.shape)[..., None])[..., 0]
    off = new - solved @ x
    spread = np.sum(off * np.linalg.solve(information, off[..., None])[..., 0], axis=-1)
    variances = noise[..., 0, 0] + bend[..., 0, 0] * bends[-1, -1] - np.sum(shared * solved, axis=-1) + spread
    deviations = np.sqrt(np.maximum(variances, 0.0)) + 1e-15
    logarithms = _summary(weights, means, deviations)
    return PredictedError(*(math.exp(min(value, _LARGEST_LOG)) for value in logarithms))


def _spreads(errors: Array, floor: float) -> Array:
    """Return the noise of each error (n,) relative to sigma; it grows towards the floor."""
    return np.asarray(np.round(np.sqrt(1.0 + (floor / (_FLOOR_NOISE * errors)) ** 2), 2))


def _summary(weights: Array, means: Array, deviations: Array) -> tuple[float, float, float]:
    """Return the mean, and the 2.5 % and 97.5 % quantiles, of a mixture of normal distributions."""
    from scipy.special import ndtr  # imported here: takes half a second

    mean = float(np.sum(weights * means))
    reach = _REACH * math.sqrt(float(np.sum(weights * (deviations**2 + (means - mean) ** 2))))
    low, high = np.full(2, mean - reach), np.full(2, mean + reach)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = ndtr((middle[:, None, None] - means) / deviations).reshape(2, -1) @ weights.ravel() < _TAILS
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    ends = 0.5 * (low + high)
    return mean, float(ends[0]), float(ends[1])


@dataclass(frozen=True, eq=False)
class _Fit:
    """The straight line through n weighted points, and their residual as n - 2 uncorrelated components.

    slope (n,), residual (n - 2, n): map the points to these. variances (n - 2,): of the components, due to f
    with tau = 1. covariances (n - 2,): of the components and the slope. slope_bend, slope_noise: variance of
    the slope, due to f and to noise with sigma = 1.
    """

    slope: Array
    residual: Array
    variances: Array
    covariances: Array
    slope_bend: float
    slope_noise: float


@lru_cache(maxsize=1024)
def _fit_of(steps: tuple[float, ...], spreads: tuple[float, ...]) -> _Fit:
    """Return the fit for these steps; spreads (n,): the noise of each point relative to sigma."""
    h, weights = np.array(steps), 1.0 / np.array(spreads)
    z = h / h.max()
    products = np.outer(z, z)
    bend = products / (1.0 - _DECAY * products) * np.outer(weights, weights)
    line = np.stack([weights, np.log(h) * weights], axis=-1)
    slope = np.linalg.pinv(line)[1]
    others = np.linalg.qr(line, mode="complete")[0][:, 2:]
    variances, axes = np.linalg.eigh(others.T @ bend @ others)
    residual = (others @ axes).T
    return _Fit(
        slope,
        residual,
        np.maximum(variances, 0.0),
        residual @ bend @ slope,
        float(slope @ bend @ slope),
        float(slope @ slope),
    )
