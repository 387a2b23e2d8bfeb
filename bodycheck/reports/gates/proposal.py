"""New bounds by what a run measured: tighter ones freely, looser ones only for a reason."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import Literal

from bodycheck.reports.gates.gate import Gate
from bodycheck.reports.gates.verdict import GateResult
from bodycheck.reports.wording import number

MARGIN_DECADES = 0.3
"""What a proposed bound leaves between itself and the worst that was measured: a factor of 2."""


@dataclass(frozen=True)
class Change:
    """One bound of the gate at a place of the file, as it is and as it is proposed.

    measured: the worst value of the run, from which the margin is counted.
    """

    place: int
    key: Literal["upper", "lower", "near"]
    old: float
    new: float
    measured: float
    loosens: bool


def proposals(results: Sequence[GateResult], margin: float, *, loosen: bool) -> list[Change]:
    """Return the bounds that lie the margin, in decades, from the worst measured, to two digits.

    A bound is changed where that is tighter, or, with `loosen`, where the gate fails. Orders and words come
    from theory and are never changed; nor is a bound of which a case was not measured, or one below its
    floor.
    """
    return [
        change
        for place, result in enumerate(results)
        for change in _proposed(place, result, margin)
        if loosen or not change.loosens
    ]


def _proposed(place: int, result: GateResult, margin: float) -> Iterator[Change]:
    gate = result.gate
    values = [check.row.obtained for check in result.checks]
    numbers = [value for value in values if isinstance(value, float | int) and value > 0.0]
    if not numbers or len(numbers) < len(values) or not gate.looks_at.in_decades:
        return
    least, most = min(numbers), max(numbers)
    if gate.near is not None:
        if result.failed and (moved := _moved(gate, least, most)) is not None:
            yield Change(place, "near", gate.near, moved, most, loosens=True)
        return
    floor = gate.floor or 0.0
    if gate.upper is not None:
        new = _rounded(max(most * 10.0**margin, floor), ROUND_CEILING)
        if new < gate.upper or max(most, floor) > max(gate.upper, floor):
            yield Change(place, "upper", gate.upper, new, most, loosens=new > gate.upper)
    if gate.lower is not None:
        new = _rounded(least / 10.0**margin, ROUND_FLOOR)
        if max(new, floor) > max(gate.lower, floor) or max(least, floor) < max(gate.lower, floor):
            yield Change(place, "lower", gate.lower, new, least, loosens=new < gate.lower)


def _moved(gate: Gate, least: float, most: float) -> float | None:
    """Return the middle of the values on a log scale; None where they lie farther apart than allowed."""
    middle = float(number(math.sqrt(least) * math.sqrt(most), 3))
    reach = 10.0 ** (gate.decades or 0.0)
    return middle if middle / reach <= least and most <= middle * reach else None


def _rounded(value: float, rounding: str) -> float:
    return float(Context(prec=2, rounding=rounding).create_decimal_from_float(value))
