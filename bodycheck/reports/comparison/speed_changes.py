"""Detect changes of the speed or of the largest stable step of a method."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from bodycheck.reports.comparison.change import Change, Status, by_rank

_MOST = (0.25, 0.75)  # three quarters of the cases must have changed in one direction
_NOISES_OF_A_SCENARIO = 3.0  # its few cases are timed in sequence, so one disturbance affects all


@dataclass(frozen=True)
class Ratio:
    """The change of a case's time: log10(after / before), and the part that the quartiles make certain."""

    scenario: str
    engine: str
    method: str
    decades: float
    sure: float


def ratio(before: Mapping[str, Any], after: Mapping[str, Any], *, same_machine: bool) -> Ratio | None:
    """Return the change of relative_cpu between two rows, or of cpu_s on the same machine.

    Returns None if neither can be compared, or if a case was too fast for the clock.
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
    """Yield the methods of which at least three quarters of the cases became slower or faster than the noise.

    A method is judged by all its cases; if they disagree, by those of each scenario, beyond three times the
    noise. noises: the interquartile range of the reference measurement over its median, in each run.
    threshold: the relative change below which a method beyond the noise has moved.
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


def stability_change(before: Mapping[str, Any], after: Mapping[str, Any], threshold: float) -> Change | None:
    """Return the change of the largest stable step of one method on one scenario; None if there is none.

    The limit lies between the last stable and the first unstable step; if these intervals overlap, the limits
    may be equal. before, after: rows of stability.csv without empty cells. threshold: the relative change of
    the last stable step above which it is worse or improved.
    """
    old, new = before["outcome"], after["outcome"]
    if old != new:
        return _change(after, "stable step: search", old, new, by_rank(old == "ok", new == "ok"))
    if old != "ok":
        return None
    (low_a, high_a), (low_b, high_b) = _span(before), _span(after)
    if low_b >= high_a or high_b <= low_a:
        up = low_b >= high_a
        decades = math.log10(max(low_a, low_b) / min(low_a, low_b)) if low_a and low_b else None
        matters = decades is None or decades > math.log10(1.0 + threshold)
        status: Status = "moved" if not matters else "improved" if up else "worse"
        signed = decades if decades is None or up else -decades
        texts = (before.get("dt_stable_s", "none"), after.get("dt_stable_s", "none"))
        return _change(after, "dt_stable_s", *texts, status, signed)
    return None


def _change(
    row: Mapping[str, Any],
    what: str,
    before: float | str,
    after: float | str,
    status: Status,
    decades: float | None = None,
) -> Change:
    who = row["scenario"], row["engine"], row["method"]
    return Change("stability", *who, what, before, after, status, decades=decades)


def _span(row: Mapping[str, Any]) -> tuple[float, float]:
    """Return the last stable step and the first unstable one; 0 and infinity if there is none."""
    return row.get("dt_stable_s", 0.0), row.get("dt_unstable_s", math.inf)
