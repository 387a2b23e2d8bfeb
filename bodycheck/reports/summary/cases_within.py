"""Select the cases that meet an error tolerance.

The error includes the truth's bound. Coarse steps that meet the tolerance by accident are excluded.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypeAlias

from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.convergence import LARGEST_ROUND_OFF
from bodycheck.reports.run_files.run_tables import MethodKey, cases_by_method

RefinementSequence: TypeAlias = Sequence[CaseResult]
"""The cases of one method on one scenario, finest first."""


def sequences_of(cases: Iterable[CaseResult]) -> Mapping[tuple[str, MethodKey], RefinementSequence]:
    """Return the cases of each method on each scenario, finest first."""
    return {
        (scenario, key): finest_first(own)
        for scenario, methods in cases_by_method(cases).items()
        for key, own in methods.items()
    }


def finest_first(cases: Iterable[CaseResult]) -> RefinementSequence:
    """Return the cases of one method on one scenario, finest first."""
    return sorted(cases, key=lambda case: case.setting.fineness or 0.0)


def largest_error(case: CaseResult, quantity: str) -> float:
    """measured + bound: an upper bound of the true error; infinite where the case did not end well."""
    return case.largest_errors.get(quantity, math.inf)


def cases_within(sequence: RefinementSequence, error: float, quantity: str) -> Iterator[CaseResult]:
    """Yield the cases that meet the error tolerance, finest first, up to the first one that does not.

    A coarser step that meets the tolerance after that does so by accident. A failure with an error below 1e-9
    does not count, because round-off can make finer steps worse there; in single precision it can make all
    steps worse that are finer than the best one, which are left out.
    """
    for case in without_round_off(sequence, quantity):
        largest = largest_error(case, quantity)
        if largest <= error:
            yield case
        elif largest > LARGEST_ROUND_OFF:
            return


def without_round_off(sequence: RefinementSequence, quantity: str) -> RefinementSequence:
    """Return the cases of a method, finest first, without those that single precision makes worse."""
    if not sequence or sequence[0].columns.get("precision", "float64") == "float64":
        return sequence
    errors = [largest_error(case, quantity) for case in sequence]
    best = min(range(len(sequence)), key=lambda i: (errors[i], -i))
    return sequence[best:]
