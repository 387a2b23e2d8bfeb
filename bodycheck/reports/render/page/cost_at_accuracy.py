"""The cheapest methods that meet an error tolerance, on one scenario and over all scenarios of a run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.adapters.engine_names import REFERENCE
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measure_bounds import floor_of
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.run_tables import MethodKey
from bodycheck.reports.summary.error_curve import RefinementSequence, cheapest, sequences_of

ERRORS = (ORIENTATION, "energy_drift", "angular_momentum_drift", "omega_error")
"""The errors for which costs are compared."""

TARGETS = tuple(float(f"1e-{k}") for k in range(1, 14))
"""The error tolerances, one per decade; a coarser one is useless, a finer one is round-off."""


_Found = TypeVar("_Found")


@dataclass(frozen=True, eq=False)
class Cheapest(Generic[_Found]):
    """What meets an error tolerance at the least cost, a case or a method: of all, and of engines only."""

    target: float
    of_all: _Found
    of_engines: _Found | None


def cheapest_cases(
    problem: Problem, sequences: Mapping[MethodKey, RefinementSequence], error: str
) -> list[Cheapest[CaseResult]]:
    """Return the cases of one scenario with the least processor time, for each tolerance above its floor.

    Tolerances that no case meets are left out.
    """
    floor = floor_of(problem.columns, error)
    engines = [sequence for (engine, _), sequence in sequences.items() if engine != REFERENCE]
    found = []
    for target in TARGETS:
        of_all = cheapest(sequences.values(), target, error)
        if target >= floor and of_all is not None:
            found.append(Cheapest(target, of_all, cheapest(engines, target, error)))
    return found


@dataclass(frozen=True)
class Cost:
    """The cost of meeting an error tolerance, in processor seconds per simulated second.

    median, low, high: over the scenarios that the method supports and whose truth resolves the error;
    infinite where the method misses the tolerance. met: the number of scenarios in which it meets it.
    """

    key: MethodKey
    target: float
    median: float
    low: float
    high: float
    met: int
    scenarios: int


def costs(
    problems: Sequence[Problem], cases: Iterable[CaseResult], error: str
) -> dict[MethodKey, list[Cost]]:
    """Return the costs of every method whose speed was measured, for each tolerance of the error.

    Methods that ran in fewer than half of the scenarios are left out: their medians cannot be compared.
    """
    by_method: dict[MethodKey, dict[str, RefinementSequence]] = {}
    for (scenario, key), sequence in sequences_of(cases).items():
        if any(case.columns["outcome"] != "unsupported" for case in sequence):
            by_method.setdefault(key, {})[scenario] = sequence
    floors = {problem.scenario.name: floor_of(problem.columns, error) for problem in problems}
    found = {}
    for key, sequences in by_method.items():
        if 2 * len(sequences) < len(problems):
            continue
        if any("cpu_s" in case.columns for sequence in sequences.values() for case in sequence):
            resolved = [
                (floors[scenario], sequence)
                for scenario, sequence in sequences.items()
                if any(error in case.columns for case in sequence) or not any(case.ok for case in sequence)
            ]
            of_key = (_cost(key, target, error, resolved) for target in TARGETS)
            found[key] = [cost for cost in of_key if cost is not None]
    return found


def _cost(
    key: MethodKey, target: float, error: str, resolved: Sequence[tuple[float, RefinementSequence]]
) -> Cost | None:
    """resolved: the floor and the cases of each scenario."""
    seconds = [_price(sequence, target, error) for floor, sequence in resolved if target >= floor]
    if not seconds:
        return None
    # of an even number of scenarios the more expensive one: meeting it in half of them is not enough
    low, median, high = np.quantile(seconds, [0.25, 0.5, 0.75], method="higher").tolist()
    return Cost(key, target, median, low, high, sum(map(math.isfinite, seconds)), len(seconds))


def _price(sequence: RefinementSequence, target: float, error: str) -> float:
    """Return the least cost that meets a tolerance, per simulated second; infinite if no case meets it."""
    case = cheapest([sequence], target, error)
    return math.inf if case is None else case.columns["cpu_s"] / case.columns["duration_s"]


def fronts(found: Mapping[MethodKey, Sequence[Cost]]) -> list[Cheapest[Cost]]:
    """Return the methods with the least median cost, for each tolerance that any meets in most scenarios."""
    front = []
    for target in TARGETS:
        meeting = [cost for own in found.values() for cost in own if cost.target == target]
        meeting = sorted((c for c in meeting if math.isfinite(c.median)), key=lambda c: c.median)
        engines = [cost for cost in meeting if cost.key[0] != REFERENCE]
        if meeting:
            front.append(Cheapest(target, meeting[0], engines[0] if engines else None))
    return front


def cost_sentences(front: Mapping[str, Sequence[Cheapest[Cost]]]) -> list[str]:
    """Return sentences that name the cheapest methods for a coarse and for a fine orientation error."""
    return [
        f"Cheapest method for an orientation error of {number(target)} rad: {_priced(found.of_all)}; "
        f"cheapest engine: {_priced(found.of_engines) if found.of_engines else 'none in most scenarios'}."
        for found in front[ORIENTATION]
        for target in (1e-3, 1e-6)
        if found.target == target
    ]


def _priced(cost: Cost) -> str:
    return f"{':'.join(cost.key)}, {number(cost.median, 2)} CPU s per simulated s"
