"""The error of a method from its arithmetic alone, predicted before a step is made, and fitted to its cases.

e(h) = u (S + C sqrt((R G)^2 + N) + B R N) with the unit round-off u of the arithmetic, N = T / h steps, and S
and R, the maximum and the root mean square over time of the motion's sensitivity. G^2 = sum over the
components of share^2 N n. A rounding error repeats until the increment of a component has changed by a unit
in the last place, in n = u max|x| / (h^2 |x''|) steps: n = 1 gives the square root of N, a random walk
(Brouwer 1937, Astron. J. 46, 149), and n = N, the increments being constant, gives N. B is the mean rounding
error of omega in one step over u, which the method states; it is 0 where errors only scatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bodycheck.adapters.contract import Precision
from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reports.measurement.measure_bounds import relative
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.measurement.problem import Problem

UNIT_ROUND_OFF: dict[Precision, float] = {"float64": 2.0**-53, "float32": 2.0**-24, "mixed": 2.0**-24}
"""Half the distance from 1 to the next number."""

_EPS = float(np.finfo(np.float64).eps)
_PER_STEP = 0.1  # C, measured: median over the standard suite (tools/precision_trials.py)
_CONSTANT = 1e-12  # relative: a component that changes less is not added to, so it is not rounded
_SCATTER = 0.5  # of the logarithm of an error on the floor: one of equal steps may be better by luck
_LEVEL_SPREAD = math.log(10.0) / 2.0  # of the logarithm of the formula's own error: a factor of 10 is 2 sigma
_LEVELS = np.linspace(-3.0, 3.0, 61) * _LEVEL_SPREAD
_LEVEL_FACTORS = np.exp(_LEVELS)
_COARSE_TERMS = 121  # candidates for the coefficient of h^p
_OUTLIER = 3.0  # standard deviations, beyond which one case counts no further


@dataclass(frozen=True)
class RoundOff:
    """Predicts the error of one quantity of one problem from round-off, over its scale.

    largest, typical: S and R; of a translation, R is its largest size over the scale. components: share of
    the norm, and curvature |x''| / max|x| in 1/s^2, root mean square over time, of each component of the
    motion that is added to; of omega, or of position and velocity. rotates: whether sums of an attitude add N
    under the root. bias: B, in unit round-offs.
    """

    unit: float
    duration_s: float
    largest: float
    typical: float
    components: tuple[tuple[tuple[float, float], ...], ...]
    rotates: bool
    bias: float = 0.0

    @classmethod
    @lru_cache(maxsize=128)  # all methods on a problem share it
    def of(cls, problem: Problem, quantity: str, precision: Precision, bias: float = 0.0) -> RoundOff:
        """Derive the prediction from the truth and its sensitivity; a norm of the state has neither."""
        kind = MEASURES[quantity].bound
        unit, duration_s = UNIT_ROUND_OFF[precision], problem.scenario.duration_s
        if kind is None:
            return cls(unit, duration_s, 1.0, 0.0, (), rotates=True)
        growth = getattr(problem.truth, f"round_off_{kind}")[: problem.compared] / _EPS
        largest, typical = (
            relative(float(size), problem.columns, quantity)
            for size in (np.max(growth), math.sqrt(float(np.mean(growth * growth))))
        )
        motion = problem.truth.trajectory
        translates = {"m": (motion.velocity_m_s, motion.position_m), "m_s": (motion.velocity_m_s,)}
        summed = translates.get(kind, (motion.omega_body,))
        rotates = kind not in translates
        if not rotates:  # far from the origin, the components are larger than the scale
            typical = max(1.0, relative(largest_norm(summed[-1]), problem.columns, quantity))
        components = tuple(_components(motion.t_s, values.reshape(len(values), -1)) for values in summed)
        return cls(
            unit,
            duration_s,
            largest,
            typical,
            components,
            rotates=rotates,
            bias=bias if rotates else 0.0,
        )

    def at(self, dt_s: float) -> float:
        """Return the predicted error at a step in s."""
        steps = self.duration_s / dt_s
        walk = self.typical * max((self._walk(each, dt_s, steps) for each in self.components), default=0.0)
        scattered = _PER_STEP * math.hypot(walk, math.sqrt(steps) if self.rotates else 1.0)
        return self.unit * (self.largest + scattered + self.bias * self.typical * steps)

    def _walk(self, components: tuple[tuple[float, float], ...], dt_s: float, steps: float) -> float:
        total = 0.0
        for share, curvature in components:
            changing = dt_s * dt_s * curvature
            correlated = min(max(self.unit / changing, 1.0), steps) if changing > 0.0 else steps
            total += share * share * steps * correlated
        return math.sqrt(total)


def _components(t_s: Array, values: Array) -> tuple[tuple[float, float], ...]:
    """Return (share, curvature) of each component of values (n, 3) that changes at all."""
    norm = float(np.max(np.linalg.norm(values, axis=1)))
    found = []
    for component in values.T:
        size = float(np.max(np.abs(component)))
        if size == 0.0 or float(np.max(np.abs(np.diff(component)))) <= _CONSTANT * size:
            continue
        bend = np.diff(component, 2) / (t_s[1] - t_s[0]) ** 2
        found.append((size / norm, math.sqrt(float(np.mean(bend * bend))) / size if len(bend) else 0.0))
    return tuple(found)


@dataclass(frozen=True)
class Branches:
    """error(h) = coarse h^order + level x round-off(h): truncation above the best step, round-off below it.

    level: of the formula's prediction; the factor by which the arithmetic does worse than predicted.
    """

    coarse: float
    order: float
    level: float

    def error(self, dt_s: float, predicted: float) -> float:
        """Return the error at a step in s; predicted: from round-off, at this step."""
        return self.coarse * dt_s**self.order + self.level * predicted


def fitted(
    steps_s: Sequence[float], errors: Sequence[float], predicted: Sequence[float], order: float
) -> Branches:
    """Return the most probable branches given errors > 0 at these steps, and the error predicted at each.

    The logarithm of an error scatters by 0.5, without outliers of more than 3 sigma; the formula itself is
    within a factor of 10 in 95 of 100 cases.
    """
    h, e, floor = (np.asarray(values, dtype=np.float64) for values in (steps_s, errors, predicted))
    powers = h**order
    scale = e / powers
    coarse = np.concatenate(
        [[0.0], np.geomspace(0.05 * float(scale.min()), 2.0 * float(scale.max()), _COARSE_TERMS)]
    )
    cost = np.tile((_LEVELS / _LEVEL_SPREAD) ** 2, (len(coarse), 1))
    for truncation, arithmetic in zip(powers / e, floor / e, strict=True):  # one array that stays in cache
        misfit = np.log(np.add.outer(truncation * coarse, arithmetic * _LEVEL_FACTORS))
        misfit = np.clip(misfit / _SCATTER, -_OUTLIER, _OUTLIER)
        cost += misfit * misfit
    i, k = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return Branches(float(coarse[i]), order, float(_LEVEL_FACTORS[k]))
