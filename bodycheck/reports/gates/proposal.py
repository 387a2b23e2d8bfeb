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
from bodycheck.reports.gates.gate import Gate, parse_gates
from bodycheck.reports.gates.verdict import GateResult

_HEADER = re.compile(r"^[ \t]*\[\[[ \t]*gate[ \t]*\]\]", flags=re.MULTILINE)
_STRING = r'"(?:[^"\\\n]|\\.)*"|' + r"'[^'\n]*'"


def edited(text: str, where: str, changes: Sequence[Change], why: str | None) -> str:
    """Return the text of a tolerance file with the changes applied, after parsing it again to check them.

    why: text that is added, once, to the reason of each loosened gate. Raises InputError if a bound is not on
    a line of its own under its [[gate]].
    """
    before = parse_gates(text, where)
    starts = [found.start() for found in _HEADER.finditer(text)]
    parts = [text[a:b] for a, b in zip([0, *starts], [*starts, len(text)], strict=True)]
    wanted = list(before)
    for change in changes:
        gate = wanted[change.place]
        told: dict[str, object] = {change.key: change.new}
        lines: dict[str, tuple[str, str]] = {change.key: (r"[^\s#]+", step(change.new))}
        if change.loosens and why is not None and not gate.reason.endswith(added := f"; loosened: {why}"):
            told["reason"] = gate.reason + added
            lines["reason"] = (_STRING, json.dumps(told["reason"], ensure_ascii=False))
        wanted[change.place] = gate.model_copy(update=told)
        if change.place + 1 < len(parts):
            parts[change.place + 1] = _with_lines(parts[change.place + 1], lines)
    new = "".join(parts)
    if not _says(new, where, wanted):
        raise InputError(f"{where}: cannot be edited: write each key of a [[gate]] on its own line")
    return new


def _with_lines(table: str, lines: dict[str, tuple[str, str]]) -> str:
    for key, (old, new) in lines.items():
        line = re.compile(rf"^([ \t]*{key}[ \t]*=[ \t]*)(?:{old})", flags=re.MULTILINE)
        table = line.sub(lambda found, new=new: found[1] + new, table, count=1)  # type: ignore[misc]
    return table


def _says(text: str, where: str, wanted: Sequence[Gate]) -> bool:
    try:
        return list(parse_gates(text, where)) == list(wanted)
    except InputError:
        return False


MARGIN_DECADES = 0.3
"""The distance from a proposed bound to the worst measured value: a factor of 2."""


@dataclass(frozen=True)
class Change:
    """The current and the proposed value of one bound, of the gate at index `place` of the file.

    measured: the worst value of the run, to which the margin is added.
    """

    place: int
    key: Literal["upper", "lower", "near"]
    old: float
    new: float
    measured: float
    loosens: bool


def proposals(results: Sequence[GateResult], margin: float, *, loosen: bool) -> list[Change]:
    """Return new bounds at the margin, in decades, from the worst measured value, rounded to two digits.

    A bound is changed where the new one is tighter, or, with `loosen`, where the gate fails. Orders and words
    come from theory and are never changed; nor is a bound if one of its cases was not measured, or if it lies
    below its floor.
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
        if result.failed and (moved := _advanced(gate, least, most)) is not None:
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


def _advanced(gate: Gate, least: float, most: float) -> float | None:
    """Return the geometric mean of both values; None if they lie farther apart than the gate allows."""
    middle = float(number(math.sqrt(least) * math.sqrt(most), 3))
    reach = 10.0 ** (gate.decades or 0.0)
    return middle if middle / reach <= least and most <= middle * reach else None


def _rounded(value: float, rounding: str) -> float:
    return float(Context(prec=2, rounding=rounding).create_decimal_from_float(value))
