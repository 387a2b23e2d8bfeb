"""Whether the speed of a method changed: its cases judged together, each by the quartiles of its laps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from bodycheck.reports.comparison.change import Change, Status

_MOST = (0.25, 0.75)  # three quarters of the cases have to have moved one way
_NOISES_OF_A_SCENARIO = 3.0  # its few cases are timed one after the other: what disturbs one disturbs all


@dataclass(frozen=True)
class Ratio:
    """How a case's time changed: log10 of after over before, and the least that the quartiles leave of it."""

    scenario: str
    engine: str
    method: str
    decades: float
    sure: float


def ratio(before: Mapping[str, Any], after: Mapping[str, Any], *, same_machine: bool) -> Ratio | None:
    """Return how relative_cpu changed from one row to the other, or cpu_s on the same machine.

    None where neither can be compared, or a case was faster than the clock can tell.
    """
    if not min(before.get("cpu_s_low", 0.0), after.get("cpu_s_low", 0.0)) > 0.0:
        return None
    if "relative_cpu" in before and "relative_cpu" in after:
        scales = [row["relative_cpu"] / row["cpu_s"] for row in (before, after)]
    elif same_machine:
        scales = [1.0, 1.0]
    else:
        return None
    (low_a, mid_a, high_a), (low_b, mid_b, high_b) = (
        [math.log10(scale * row[name]) for name in ("cpu_s_low", "cpu_s", "cpu_s_high")]
        for scale, row in zip(scales, (before, after), strict=True)
    )
    least, most = low_b - high_a, high_b - low_a
    sure = least if least > 0.0 else most if most < 0.0 else 0.0
    return Ratio(after["scenario"], after["engine"], after["method"], mid_b - mid_a, sure)


def speed_changes(ratios: Iterable[Ratio], noises: tuple[float, float], threshold: float) -> Iterator[Change]:
    """Yield the methods that became slower or faster: at least three quarters of the cases, beyond the noise.

    noises: the yardstick's interquartile range over its median in either run. threshold: the relative change
    below which a method that is beyond the noise has merely moved. A method is judged by all its
    cases; where they do not agree, by those of each scenario, beyond three times the noise.
    """
    slack = math.log10(1.0 + sum(noises))
    ordered = sorted(ratios, key=lambda one: (one.engine, one.method, one.scenario))
    for _, of_method in groupby(ordered, key=lambda one: (one.engine, one.method)):
        cases = list(of_method)
        if (found := _judged(cases, slack, threshold, None)) is not None:
            yield found
            continue
        for scenario, of_scenario in groupby(cases, key=lambda one: one.scenario):
            one = _judged(list(of_scenario), _NOISES_OF_A_SCENARIO * slack, threshold, scenario)
            if one is not None:
                yield one


def _judged(cases: list[Ratio], slack: float, threshold: float, scenario: str | None) -> Change | None:
    low, high = np.quantile([case.sure for case in cases], _MOST).tolist()
    if low <= slack and high >= -slack:
        return None
    decades = float(np.median([case.decades for case in cases]))
    status: Status = "worse" if low > slack else "improved"
    if abs(decades) <= math.log10(1.0 + threshold):
        status = "moved"
    engine, method = cases[0].engine, cases[0].method
    return Change("speed", scenario, engine, method, "relative_cpu", None, None, status, decades=decades)
