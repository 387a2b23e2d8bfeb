"""Which cases of a method keep an error: by what was measured and the truth's bound, and not by luck."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypeAlias

from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.convergence import LARGEST_ROUND_OFF
from bodycheck.reports.measurement.measure_bounds import bound_of
from bodycheck.reports.run_files.run_tables import MethodKey, cases_by_method

RefinementSequence: TypeAlias = Sequence[CaseResult]
"""The cases of one method on one scenario, the finest first."""


def ladders_of(cases: Iterable[CaseResult]) -> Mapping[tuple[str, MethodKey], RefinementSequence]:
    """Return the cases of each method on each scenario."""
    return {
        (scenario, key): sorted(own, key=lambda case: case.setting.fineness or 0.0)
        for scenario, methods in cases_by_method(cases).items()
        for key, own in methods.items()
    }


def largest_error(case: CaseResult, quantity: str) -> float:
    """measured + bound: what the true error is at most; infinite where the case did not end well."""
    columns = case.columns
    if not case.ok or quantity not in columns:
        return math.inf
    return float(columns[quantity] + bound_of(columns, quantity))


def keeping(ladder: RefinementSequence, error: float, quantity: str) -> Iterator[CaseResult]:
    """Yield the cases that keep the error, the finest first, down to a step that does not.

    A coarser step that keeps it all the same does so by luck. Below 1e-9 it is no luck: there finer steps
    may be worse by their round-off.
    """
    for case in ladder:
        largest = largest_error(case, quantity)
        if largest <= error:
            yield case
        elif largest > LARGEST_ROUND_OFF:
            return
