"""Whether a gate holds: every row that it matches within its bounds, and at least one that was measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from bodycheck.reports.findings import Findings
from bodycheck.reports.gates.gate import Gate
from bodycheck.reports.gates.rows import Row, rows_of, why_none
from bodycheck.reports.wording import number


@dataclass(frozen=True)
class Check:
    """One row held against the gate's bounds.

    beyond: how far outside the nearest bound, negative inside: in decades where the measure is compared so,
    else in its unit; None for words and for what was not measured.
    """

    row: Row
    passed: bool
    beyond: float | None = None


@dataclass(frozen=True)
class GateResult:
    """A gate with all that it matched.

    status: passed, failed, or nothing where no row matched or none was measured, which never passes.
    why: of the status nothing, the reason. floor, bound and title are the gate's.
    """

    gate: Gate
    checks: tuple[Check, ...]
    status: Literal["passed", "failed", "nothing"]
    why: str = ""

    @property
    def failed(self) -> tuple[Check, ...]:
        """The rows that did not pass."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def worst(self) -> Check | None:
        """The measured row that is the farthest out, or the least far in; None where there is none."""

        def badness(check: Check) -> tuple[bool, float]:
            return not check.passed, -math.inf if check.beyond is None else check.beyond

        return max((c for c in self.checks if c.row.obtained is not None), key=badness, default=None)


def held(gates: Sequence[Gate], run: Findings) -> tuple[GateResult, ...]:
    """Return what a run has to say to each gate; nothing is asked of an engine."""
    return tuple(_held(gate, run) for gate in gates)


def _held(gate: Gate, run: Findings) -> GateResult:
    checks = tuple(_checked(gate, row) for row in rows_of(gate, run))
    if not checks:
        return GateResult(gate, (), "nothing", why_none(gate, run))
    if all(check.row.obtained is None for check in checks):
        reasons = dict.fromkeys(check.row.why for check in checks)
        return GateResult(gate, checks, "nothing", "; ".join(reasons))
    return GateResult(gate, checks, "passed" if all(check.passed for check in checks) else "failed")


def _checked(gate: Gate, row: Row) -> Check:
    if row.obtained is None:
        return Check(row, passed=False)
    if isinstance(row.obtained, str):
        return Check(row, passed=row.obtained == gate.equals)
    floor = -math.inf if gate.floor is None else gate.floor
    value = max(row.obtained, floor)
    sides = []
    if gate.most is not None:
        sides.append(_beyond(value, max(gate.most, floor), gate))
    if gate.least is not None:
        sides.append(_beyond(max(gate.least, floor), value, gate))
    beyond = max(sides)
    return Check(row, passed=beyond <= 0.0, beyond=beyond)


def _beyond(larger: float, smaller: float, gate: Gate) -> float:
    """Return how far the first is above the second, negative below: exact in its sign."""
    if larger == smaller:
        return 0.0
    if not gate.looks_at.in_decades:
        return larger - smaller
    sign = 1.0 if larger > smaller else -1.0
    if min(larger, smaller) <= 0.0:
        return sign * math.inf
    # two neighbouring doubles have the same logarithm, and are not the same
    return sign * max(abs(math.log10(larger) - math.log10(smaller)), math.ulp(0.0))


def distance(check: Check, gate: Gate) -> str:
    """Return how far a value is from its bound, in words."""
    if check.beyond is None or math.isinf(check.beyond):
        return ""
    size = number(abs(check.beyond), 2)
    unit = f"{size} decades" if gate.looks_at.in_decades else size
    return f"{unit} {'beyond' if check.beyond > 0.0 else 'within'}"
