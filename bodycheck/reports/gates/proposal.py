"""Propose new bounds from the values of a run, and write them into a tolerance file, keeping its comments."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import Literal

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number, step
from bodycheck.reports.gates.gate import GATE_TABLE, Gate, parse_gates
from bodycheck.reports.gates.verdict import GateResult

_STRING = r'"(?:[^"\\\n]|\\.)*"|' + r"'[^'\n]*'"


def edited(text: str, where: str, changes: Sequence[BoundChange], why: str | None) -> str:
    """Return the text of a tolerance file with the changes applied, after parsing it again to check them.

    why: text that is added, once, to the reason of each loosened gate. Raises InputError if a bound is not on
    a line of its own under its [[gate]].
    """
    before = parse_gates(text, where)
    starts = [found.start() for found in GATE_TABLE.finditer(text)]
    parts = [text[a:b] for a, b in zip([0, *starts], [*starts, len(text)], strict=True)]
    expected = list(before)
    for change in changes:
        gate = expected[change.index]
        update: dict[str, object] = {change.key: change.new}
        lines: dict[str, tuple[str, str]] = {change.key: (r"[^\s#]+", step(change.new))}
        if change.loosens and why is not None and not gate.reason.endswith(added := f"; loosened: {why}"):
            update["reason"] = gate.reason + added
            lines["reason"] = (_STRING, json.dumps(update["reason"], ensure_ascii=False))
        expected[change.index] = gate.model_copy(update=update)
        if change.index + 1 < len(parts):
            parts[change.index + 1] = _with_lines(parts[change.index + 1], lines)
    new = "".join(parts)
    if not _reads_as(new, where, expected):
        raise InputError(f"{where}: cannot be edited: write each key of a [[gate]] on its own line")
    return new


def _with_lines(table: str, lines: dict[str, tuple[str, str]]) -> str:
    for key, (old, new) in lines.items():
        line = re.compile(rf"^([ \t]*{key}[ \t]*=[ \t]*)(?:{old})", flags=re.MULTILINE)
        table = line.sub(lambda found, new=new: found[1] + new, table, count=1)  # type: ignore[misc]
    return table


def _reads_as(text: str, where: str, expected: Sequence[Gate]) -> bool:
    try:
        return list(parse_gates(text, where)) == list(expected)
    except InputError:
        return False


MARGIN_DECADES = 0.3
"""The distance from a proposed bound to the worst measured value: a factor of 2."""


@dataclass(frozen=True)
class BoundChange:
    """The current and the proposed value of one bound, of the gate at index `index` of the file.

    measured: the worst value of the run, to which the margin is added.
    """

    index: int
    key: Literal["upper", "lower", "near"]
    old: float
    new: float
    measured: float
    loosens: bool


def proposals(results: Sequence[GateResult], margin: float, *, loosen: bool) -> list[BoundChange]:
    """Return new bounds at the margin, in decades, from the worst measured value, rounded to two digits.

    A bound is changed where the new one is tighter, or, with `loosen`, where the gate fails. Orders and words
    come from theory and are never changed; nor is a bound if one of its cases was not measured, or if it lies
    below its floor.
    """
    return [
        change
        for index, result in enumerate(results)
        for change in _proposed(index, result, margin)
        if loosen or not change.loosens
    ]


def _proposed(index: int, result: GateResult, margin: float) -> Iterator[BoundChange]:
    gate = result.gate
    values = [check.row.obtained for check in result.checks]
    numbers = [value for value in values if isinstance(value, float | int) and value > 0.0]
    if not numbers or len(numbers) < len(values) or not gate.target.in_decades:
        return
    smallest, largest = min(numbers), max(numbers)
    if gate.near is not None:
        if result.failed and (centre := _advanced(gate, smallest, largest)) is not None:
            yield BoundChange(index, "near", gate.near, centre, largest, loosens=True)
        return
    floor = gate.floor or 0.0
    if gate.upper is not None:
        new = _rounded(max(largest * 10.0**margin, floor), ROUND_CEILING)
        if new < gate.upper or max(largest, floor) > max(gate.upper, floor):
            yield BoundChange(index, "upper", gate.upper, new, largest, loosens=new > gate.upper)
    if gate.lower is not None:
        new = _rounded(smallest / 10.0**margin, ROUND_FLOOR)
        if max(new, floor) > max(gate.lower, floor) or max(smallest, floor) < max(gate.lower, floor):
            yield BoundChange(index, "lower", gate.lower, new, smallest, loosens=new < gate.lower)


def _advanced(gate: Gate, smallest: float, largest: float) -> float | None:
    """Return the geometric mean of both values; None if they lie farther apart than the gate allows."""
    middle = float(number(math.sqrt(smallest) * math.sqrt(largest), 3))
    factor = 10.0 ** (gate.decades or 0.0)
    return middle if middle / factor <= smallest and largest <= middle * factor else None


def _rounded(value: float, rounding: str) -> float:
    return float(Context(prec=2, rounding=rounding).create_decimal_from_float(value))
