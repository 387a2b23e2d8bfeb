"""Fit the parameters of candidate faults to the transitions of a trajectory, by damped Gauss-Newton steps.

Source: Nocedal and Wright (2006), Numerical Optimization, section 10.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.diagnosis.engine_model import Model
from bodycheck.reports.diagnosis.faults.fault import Fault, FaultContext, Parameter
from bodycheck.reports.diagnosis.flow import Base
from bodycheck.reports.diagnosis.transitions import Transitions

_CHANGE = 1e-6  # of a parameter, over its size: for the derivatives
_SWEEPS = 7
_SETTLED = 1e-4  # relative improvement below which a fit ends
_CONTENDERS = 24  # that are fitted on after two sweeps


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
    themselves (12, s). slopes: their derivatives (12 s, p).
    """

    faults: tuple[Fault, ...]
    values: Array
    cost: float
    remaining: Array
    slopes: Array

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
    def half_widths(self) -> Array:
        """Half the 95 % intervals of the parameters, from the scatter of the remaining differences."""
        if not self.size:
            return np.zeros(0)
        freedom = max(self.remaining.size - self.size, 1)
        variance = float(np.sum(self.remaining**2)) / freedom
        covariance = np.linalg.pinv(self.slopes.T @ self.slopes) * variance
        return np.asarray(1.96 * np.sqrt(np.maximum(np.diag(covariance), 0.0)))


@dataclass
class _Candidate:
    faults: tuple[Fault, ...]
    values: Array
    best: Fit | None = None
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
    """Let only the best candidates go on."""
    costs = sorted(one.best.cost for one in candidates if one.best is not None)
    worst = costs[min(_CONTENDERS, len(costs)) - 1]
    for one in candidates:
        one.settled |= one.best is not None and one.best.cost > worst


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
        best = one.best = Fit(one.faults, one.values.copy(), cost, here, slopes)
        one.settled = before is not None and cost > (1.0 - _SETTLED) * before.cost
        one.share = 1.0 if before is None else min(1.0, 2.0 * one.share)
    else:
        one.share *= 0.25
        one.settled = one.share < 0.05
    assert best is not None
    if not len(best.values) or best.cost <= transitions.round_off:
        one.settled = True
    if one.settled:
        return
    step = np.linalg.lstsq(best.slopes, -best.remaining.ravel(), rcond=1e-12)[0]
    low = np.array([parameter.low for parameter in one.parameters])
    high = np.array([parameter.high for parameter in one.parameters])
    one.values = np.clip(best.values + one.share * step, low, high)
