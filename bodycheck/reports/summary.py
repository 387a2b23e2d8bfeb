"""What a run comes to in short: one cell a scenario and method, and the cases that did not end well."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bodycheck.reports.case import CaseResult
from bodycheck.reports.findings import (
    Findings,
    MethodKey,
    cases_by_method,
    common_step,
    key_of,
    shown_case,
)
from bodycheck.reports.states import FAULTS, STATES
from bodycheck.reports.wording import number

_ORIENTATION = "orientation_error_rad"
_FLOORS = 30.0  # times the truth's bound: the largest error of a method without steps that is the truth
_ORDER_SLACK = 0.2  # how far below its theory an observed order may lie and still be called its own
_GRAVITY = ("none", "floor", "good", "open", "bad", "fault")


@dataclass(frozen=True)
class Cell:
    """One method on one scenario: its state, its order, its error at the common step, what went wrong.

    faults: how many of the cases ended so. cases: how many there are. plateaus: the other measures that do
    not converge.
    """

    state: str
    order: float | None = None
    error: float | None = None
    faults: Mapping[str, int] = field(default_factory=dict)
    cases: int = 0
    plateaus: tuple[str, ...] = ()
    detail: str = ""

    @property
    def notes(self) -> list[str]:
        """What went wrong beside the state itself."""
        faults = [f"{amount} of {self.cases} {fault}" for fault, amount in self.faults.items()]
        return faults + [f"{measure} does not converge" for measure in self.plateaus]


def summary_cell(
    cases: Sequence[CaseResult], found: Mapping[str, Mapping[str, Any]], at_s: float | None
) -> Cell:
    """Return what the cases of one method on one scenario come to.

    found: their rows of methods.csv by quantity; at_s: the common step.
    """
    at_step = shown_case(cases, at_s)
    error = at_step.columns[_ORIENTATION] if at_step and at_step.ok else None
    ended = Counter(case.columns["outcome"] for case in cases)
    faults = {fault: ended[fault] for fault in FAULTS if ended[fault]}
    if not ended["ok"]:
        worst = next(iter(faults), "unsupported")
        reasons = dict.fromkeys(str(case.columns["message"]) for case in cases)
        return Cell(worst, faults=faults, cases=len(cases), detail="; ".join(reasons))
    if _ORIENTATION not in found:
        bound = _FLOORS * cases[0].columns["truth_bound_rad"]
        exact = error is not None and error <= bound
        return Cell("exact" if exact else "off", error=error, faults=faults, cases=len(cases))
    row = found[_ORIENTATION]
    return Cell(
        row["verdict"],
        row["order"] if row["order"] == row["order"] else None,
        error,
        faults,
        len(cases),
        tuple(q for q in found if q != _ORIENTATION and found[q]["verdict"] == "does-not-converge"),
        _detail(row),
    )


def _detail(found: Mapping[str, Any]) -> str:
    floor = f"floor {number(found['floor'], 2)} rad"
    if found["verdict"] != "converges":
        return floor
    low, high = number(found["order_low"], 3), number(found["order_high"], 3)
    return f"order between {low} and {high}, from {found['points']} steps; {floor}"


def summary_cells(run: Findings) -> dict[str, dict[MethodKey, Cell]]:
    """Return the cells by scenario, then by engine and method, in the order of the run."""
    by_scenario: dict[str, dict[MethodKey, list[CaseResult]]] = {n: {} for n in run.manifest["scenarios"]}
    by_scenario |= cases_by_method(run.cases)
    found: dict[tuple[str, str, str], dict[str, Any]] = {}
    rows: list[Any] = run.methods.to_dict("records")
    for row in rows:
        found.setdefault((row["scenario"], *key_of(row)), {})[row["quantity"]] = row
    cells = {}
    for scenario, methods in by_scenario.items():
        at_s = common_step(case for cases in methods.values() for case in cases)
        cells[scenario] = {
            key: summary_cell(cases, found.get((scenario, *key), {}), at_s) for key, cases in methods.items()
        }
    return cells


def theory(run: Findings, key: MethodKey) -> float:
    """Return the order that the method has in theory, 0 where it has none."""
    engine, method = key
    return run.manifest["engines"][engine]["methods"][method]["order"] or 0


def is_lower(run: Findings, key: MethodKey, cell: Cell) -> bool:
    """Whether a method shows a lower order than it has in theory."""
    return cell.order is not None and cell.order < theory(run, key) - _ORDER_SLACK


def worst_state(run: Findings, key: MethodKey, cell: Cell) -> str:
    """Return the gravest of what a cell says: how a case ended, a plateau, a lower order, or its verdict."""
    said = [*cell.faults, cell.state]
    if cell.plateaus:
        said.append("does-not-converge")
    if is_lower(run, key, cell):
        said.append("lower-order")
    return max(said, key=lambda state: _GRAVITY.index(STATES[state].tint))


@dataclass(frozen=True)
class Fault:
    """Cases of one method on one scenario that ended badly in the same way, at these steps or tolerances."""

    scenario: str
    key: MethodKey
    outcome: str
    message: str
    steps: tuple[float | None, ...]


def faults_of(cases: Iterable[CaseResult]) -> list[Fault]:
    """Return all that failed, was invalid, unstable or timed out, alike cases together."""
    steps: dict[tuple[str, MethodKey, str, str], list[float | None]] = {}
    for case in cases:
        columns = case.columns
        if columns["outcome"] in FAULTS:
            alike = (columns["scenario"], key_of(columns), columns["outcome"], columns["message"])
            steps.setdefault(alike, []).append(case.setting.fineness)
    return [Fault(*alike, steps=tuple(dts)) for alike, dts in steps.items()]
