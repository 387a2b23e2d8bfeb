"""Fit the parameters of candidate faults to the transitions of a trajectory, by damped Gauss-Newton steps.

Source: Nocedal and Wright (2006), Numerical Optimization, section 10.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import Base
from bodycheck.examine.diagnosis.engine_model import Model
from bodycheck.examine.diagnosis.faults.fault import Fault, FaultContext, Parameter
from bodycheck.examine.diagnosis.transitions import Transitions
from bodycheck.reference_impl.arrays import Array

_CHANGE = 1e-6  # of a parameter, over its size: for the derivatives
_SWEEPS = 14
_SETTLED = 1e-4  # relative improvement below which a fit ends
_UNDETERMINED = 1e-6  # of the largest singular value, for parameters of size 1
_INVOLVED = 1e-3  # component of a direction that is not determined
_LARGEST_STEP = 2.0  # of the logarithm of a parameter that is always positive
_CONTENDERS = 32  # that are fitted on after two sweeps


Start: TypeAlias = tuple[tuple[Fault, ...], Sequence[float] | Array]
"""Faults, and the values of their parameters where a fit starts."""


def _parts(faults: Iterable[Fault], values: Array) -> Iterator[tuple[Fault, Array]]:
    """Yield each fault with its parameters; values: of all faults, in order."""
    first = 0
    for fault in faults:
        last = first + len(fault.parameters)
        yield fault, values[first:last]
        first = last


@dataclass(frozen=True, eq=False)
class Fit:
    """Faults with the parameters that explain a trajectory best.

    values: of all faults, in order. cost: root mean square of the remaining differences. remaining: they
    themselves (12, s), over these transitions. slopes: their derivatives (12 s, p).
    """

    faults: tuple[Fault, ...]
    values: Array
    cost: float
    remaining: Array
    slopes: Array
    transitions: Transitions

    @property
    def parts(self) -> list[tuple[Fault, Array]]:
        """Each fault with its parameters."""
        return list(_parts(self.faults, self.values))

    @property
    def size(self) -> int:
        """The number of parameters."""
        return len(self.values)

    @property
    def names(self) -> frozenset[str]:
        """The names of the faults."""
        return frozenset(fault.name for fault in self.faults)

    @property
    def is_general(self) -> bool:
        """Whether a fault contains others as special cases."""
        return any(fault.is_general for fault in self.faults)

    @property
    def complexity(self) -> int:
        """The number of parameters without particular values, such as 0; general faults count for more."""
        special = sum(bool(fault.special_text(values)) for fault, values in self.parts)
        return self.size - special + 3 * sum(fault.is_general for fault in self.faults)

    @property
    def least_determined(self) -> float:
        """The smallest singular value, over the largest, that is more than the errors of the derivatives."""
        return _UNDETERMINED / max((1.0, *(p.size for fault in self.faults for p in fault.parameters)))

    @property
    def half_widths(self) -> Array:
        """Half the 95 % intervals of the parameters; infinite along what the motion does not determine.

        From the scatter of the remaining differences of the quantities that vary, and errors that rows share.
        """
        if not self.size:
            return np.zeros(0)
        sizes, values, axes = self.curvature
        determined = values > self.least_determined * values[0]
        deviation = max(self._scatter, self.transitions.least)
        spread = np.sum((axes[determined] / values[determined, None]) ** 2, axis=0)
        variance = deviation**2 * spread
        shared = self.transitions.shared_errors
        if len(shared):
            patterns = shared.reshape(len(shared), -1).T
            moved = np.linalg.lstsq(self.slopes / sizes, patterns, rcond=self.least_determined)[0]
            variance = variance + np.sum(moved**2, axis=1)
        loose = np.any(np.abs(axes[~determined]) > _INVOLVED, axis=0)
        return np.where(loose, np.inf, 1.96 * np.sqrt(variance) / sizes)

    @property
    def _scatter(self) -> float:
        """The standard deviation of the remaining differences of the quantities that vary."""
        known = self.remaining[np.any(self.slopes.reshape(*self.remaining.shape, -1), axis=(1, 2))]
        return math.sqrt(float(np.sum(known**2)) / max(known.size - self.size, 1))

    @property
    def smallest_half_widths(self) -> Array:
        """Half the 95 % intervals of Cramer and Rao, for the scatter alone."""
        sizes, values, axes = self.curvature
        determined = values > self.least_determined * values[0]
        spread = np.sum((axes[determined] / values[determined, None]) ** 2, axis=0)
        return np.asarray(1.96 * self._scatter * np.sqrt(spread) / sizes)

    @property
    def undetermined(self) -> Array:
        """The directions (k, p) of unit length in which the parameters can change without an effect."""
        if not self.size:
            return np.zeros((0, 0))
        sizes, values, axes = self.curvature
        found = axes[values <= self.least_determined * values[0]] / sizes
        return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))

    @cached_property
    def curvature(self) -> tuple[Array, Array, Array]:
        """Sizes of the slopes (p,), and their singular values (p,) and axes (p, p) over these sizes."""
        columns = np.linalg.norm(self.slopes, axis=0)
        # one size per fault, so that its parameters move as little as possible where they are not determined
        sizes = np.concatenate(
            [np.full(len(own), np.max(own, initial=0.0)) for _, own in _parts(self.faults, columns)]
        )
        sizes = np.where(sizes > 0.0, sizes, np.max(sizes) or 1.0)
        _, values, axes = np.linalg.svd(self.slopes / sizes, full_matrices=False)
        return sizes, values, axes


@dataclass
class _Candidate:
    faults: tuple[Fault, ...]
    values: Array
    best: Fit | None = None
    promised: float = math.inf  # cost after a full step, if the differences were linear
    share: float = 1.0
    settled: bool = False

    @property
    def parameters(self) -> list[Parameter]:
        return [parameter for fault in self.faults for parameter in fault.parameters]


def planted(at: FaultContext, healthy: Model, faults: Sequence[Fault], values: Array) -> Model:
    """Return the healthy model with the faults."""
    model = healthy.copied()
    for fault, own in _parts(faults, values):
        fault.plant(model, own, at)
    return model


def fitted(
    transitions: Transitions,
    base: Base,
    at: FaultContext,
    starts: Sequence[Start],
    sweeps: int = _SWEEPS,
) -> list[Fit]:
    """Return the best fit of each set of faults, in the order of the first starts."""
    healthy = transitions.grid.model(transitions.scene)
    candidates = [_Candidate(faults, np.array(values, dtype=np.float64)) for faults, values in starts]
    for sweep in range(sweeps):
        active = [one for one in candidates if not one.settled]
        if not active:
            break
        _sweep(active, transitions, base, at, healthy)
        if sweep == 1:
            _prune(candidates)
    best: dict[tuple[str, ...], Fit] = {}
    for one in candidates:
        assert one.best is not None
        names = tuple(fault.name for fault in one.faults)
        if names not in best or one.best.cost < best[names].cost:
            best[names] = one.best
    return list(best.values())


def _prune(candidates: Sequence[_Candidate]) -> None:
    """Let only the candidates go on that are best, or that promise to be."""
    worst = sorted(one.promised for one in candidates)[min(_CONTENDERS, len(candidates)) - 1]
    for one in candidates:
        one.settled |= one.promised > worst


def _sweep(
    active: Sequence[_Candidate], transitions: Transitions, base: Base, at: FaultContext, healthy: Model
) -> None:
    """Evaluate candidates and the derivatives of their predictions, and take one step."""
    models, changes = [], []
    for one in active:
        models.append(planted(at, healthy, one.faults, one.values))
        steps = [_change(p, value) for p, value in zip(one.parameters, one.values, strict=True)]
        changes.append(steps)
        for index, step in enumerate(steps):
            moved = one.values.copy()
            moved[index] += step
            models.append(planted(at, healthy, one.faults, moved))
    found = transitions.differences(models, base)
    first = 0
    for one, steps in zip(active, changes, strict=True):
        here, others = found[first], found[first + 1 : first + 1 + len(steps)]
        first += 1 + len(steps)
        pairs = zip(others, steps, strict=True)
        columns = [(other - here).ravel() / step for other, step in pairs]
        slopes = np.stack(columns, axis=1) if columns else np.zeros((here.size, 0))
        _step(one, here, slopes, transitions)


def _change(parameter: Parameter, value: float) -> float:
    step = _CHANGE * max(parameter.size, abs(value))
    return -step if value + step > parameter.high or math.isinf(parameter.healthy) else step


def _step(one: _Candidate, here: Array, slopes: Array, transitions: Transitions) -> None:
    """Keep the best values, and move on from them."""
    cost = transitions.cost_of(here)
    before, best = one.best, one.best
    if before is None or cost < before.cost:
        best = one.best = Fit(one.faults, one.values.copy(), cost, here, slopes, transitions)
        one.settled = before is not None and cost > (1.0 - _SETTLED) * before.cost
        one.share = 1.0 if before is None else min(1.0, 2.0 * one.share)
    else:
        one.share *= 0.25
        one.settled = one.share < 0.05
    assert best is not None
    one.promised = min(one.promised, best.cost)
    one.settled |= not len(best.values)
    if one.settled:
        return
    sizes = best.curvature[0]
    step = (
        np.linalg.lstsq(best.slopes / sizes, -best.remaining.ravel(), rcond=best.least_determined)[0] / sizes
    )
    one.promised = min(
        one.promised, transitions.cost_of(best.remaining + (best.slopes @ step).reshape(here.shape))
    )
    low = np.array([parameter.low for parameter in one.parameters])
    high = np.array([parameter.high for parameter in one.parameters])
    values = best.values + one.share * step
    positive = low > 0.0  # their logarithm is changed: a linear step may lead below 0
    relative = np.clip(step[positive] / best.values[positive], -_LARGEST_STEP, _LARGEST_STEP)
    values[positive] = best.values[positive] * np.exp(one.share * relative)
    one.values = np.clip(values, low, high)
