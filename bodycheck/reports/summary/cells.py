"""One cell per scenario and method, one overview per method over all scenarios, and failed cases."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from bodycheck._util.formatting import number, setting, step
from bodycheck.reports.measurement.case import SWITCH_NOTE, CaseResult
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.verdicts import (
    FAULTS,
    QuantityVerdict,
    method_verdict,
    most_severe,
)
from bodycheck.reports.run_files.run_tables import (
    MethodKey,
    StudyKey,
    Tables,
    cases_by_method,
    common_step,
    key_of,
    shown_case,
    study_key,
)
from bodycheck.scenarios.model import DEFAULT_STEPS_PER_SAMPLE

_SAME = 1e-9  # relative difference of two steps that count as equal


@dataclass(frozen=True)
class Cell:
    """One method on one scenario, with its most severe state.

    verdict: the most severe of the quantities; None where no case ended well. order: of the orientation.
    error: of the orientation at the common step, or at the finest tolerance; `at` names it. largest: the
    largest over the listed steps or tolerances; `largest_at` names it. finest: the one at the finest step or
    tolerance; `finest_at` names it. faults: number of cases per fault.
    cases: total number of cases. wrong: the quantities that count against the method, most severe first.
    properties: of the engine's state, not faults. detail: what the verdict is based on. cause: the diagnosis
    of a wrong motion.
    """

    state: str
    verdict: QuantityVerdict | None = None
    order: float | None = None
    error: float | None = None
    at: str = ""
    largest: float | None = None
    largest_at: str = ""
    finest: float | None = None
    finest_at: str = ""
    faults: Mapping[str, int] = field(default_factory=dict)
    cases: int = 0
    wrong: tuple[QuantityVerdict, ...] = ()
    properties: tuple[QuantityVerdict, ...] = ()
    detail: str = ""
    cause: str = ""

    @property
    def notes(self) -> list[str]:
        """The faults, the wrong and undecided quantities and the properties of the state, as text."""
        faults = [f"{amount} of {self.cases} {fault}" for fault, amount in self.faults.items()]
        causes = [f"diagnosis: {self.cause}"] if self.cause else []
        quantities = (*self.wrong, *self._undecided, *self.properties)
        return [*faults, *(one.text for one in quantities), *causes]

    @property
    def _undecided(self) -> tuple[QuantityVerdict, ...]:
        """The verdict, if it is that of an undecided quantity other than the orientation."""
        shown = self.verdict
        return (shown,) if shown is not None and shown.is_open and shown.quantity != ORIENTATION else ()

    @property
    def is_sound(self) -> bool:
        """Whether the method behaves as theory predicts, as far as was measured."""
        return self.state in ("converges", "at-floor", "at-precision-floor", "exact")


def summary_cell(
    cases: Sequence[CaseResult],
    found: Mapping[str, Mapping[str, Any]],
    at_s: float | None,
    coarsest_s: float = math.inf,
) -> Cell:
    """Return the cell of one method on one scenario.

    found: its rows of methods.csv by quantity; at_s: the common step; coarsest_s: the coarsest listed step.
    """
    at_step = shown_case(cases, at_s)
    error = at_step.columns[ORIENTATION] if at_step and at_step.ok else None
    ended = Counter(case.columns["outcome"] for case in cases)
    faults = {fault: ended[fault] for fault in FAULTS if ended[fault]}
    (largest, largest_at), (finest, finest_at) = _largest_error(cases, coarsest_s), _finest_error(cases)
    verdicts = {quantity: QuantityVerdict.of(row) for quantity, row in found.items()}
    verdict = method_verdict(verdicts)
    if not ended["ok"] or verdict is None:
        worst = next(iter(faults), "unsupported")
        reasons = dict.fromkeys(str(case.columns["message"]) for case in cases)
        return Cell(worst, faults=faults, cases=len(cases), detail="; ".join(reasons))
    return Cell(
        next(iter(faults), verdict.state),
        verdict,
        verdicts[ORIENTATION].order if ORIENTATION in verdicts else None,
        error,
        "" if at_step is None else setting(at_step.columns["control"], at_step.setting.fineness),
        largest,
        largest_at,
        finest,
        finest_at,
        faults,
        len(cases),
        tuple(most_severe(verdicts.values())),
        tuple(one for one in verdicts.values() if one.is_property),
        _detail(cases, found.get(ORIENTATION)),
    )


def _largest_error(cases: Sequence[CaseResult], coarsest_s: float) -> tuple[float | None, str]:
    """Return the largest error of the orientation, of steps up to the coarsest listed one, and its step."""
    listed = [case for case in cases if case.ok and (case.dt_s or 0.0) <= coarsest_s * (1.0 + _SAME)]
    measured = [(case.columns[ORIENTATION], case) for case in listed if ORIENTATION in case.columns]
    if not measured:
        return None, ""
    error, case = max(measured, key=lambda pair: pair[0])
    return error, setting(case.columns["control"], case.setting.fineness)


def _finest_error(cases: Sequence[CaseResult]) -> tuple[float | None, str]:
    """Return the error of the orientation at the finest step or tolerance, and which that is."""
    measured = [case for case in cases if case.ok and ORIENTATION in case.columns]
    if not measured:
        return None, ""
    case = min(measured, key=lambda one: one.setting.fineness or 0.0)
    return case.columns[ORIENTATION], setting(case.columns["control"], case.setting.fineness)


def _detail(cases: Sequence[CaseResult], row: Mapping[str, Any] | None) -> str:
    """Return what the verdict on the orientation is based on, and what lowers the order."""
    if row is None:
        return ""
    parts = [f"floor {number(row.get('floor'), 2)} rad"]
    if row["verdict"] == "converges" and row.get("order") is not None:
        low, high = number(row["order_low"], 3), number(row["order_high"], 3)
        parts.insert(0, f"order between {low} and {high}, from {row['points']} steps")
        if (usable := row.get("usable_dt_s")) is not None:
            parts.insert(1, f"errors at steps above its usable step, {step(usable)} s, are larger")
    if any(SWITCH_NOTE in str(case.columns["message"]) for case in cases):
        parts.append("a load switches inside a step, which lowers the order")
    return "; ".join(parts)


def summary_cells(run: Tables) -> dict[str, dict[MethodKey, Cell]]:
    """Return the cells by scenario, then by engine and method, in the order of the run."""
    by_scenario: dict[str, dict[MethodKey, list[CaseResult]]] = {n: {} for n in run.manifest["scenarios"]}
    by_scenario |= cases_by_method(run.cases)
    found: dict[StudyKey, dict[str, Any]] = {}
    for row in run.rows("methods"):
        found.setdefault(study_key(row), {})[row["quantity"]] = row
    causes = {study_key(row): row["diagnosis"] for row in run.rows("diagnoses")}
    cells = {}
    for scenario, methods in by_scenario.items():
        at_s = common_step(case for cases in methods.values() for case in cases)
        coarsest_s = _coarsest_listed(run.manifest, scenario)
        cells[scenario] = {
            key: replace(
                summary_cell(cases, found.get((scenario, *key), {}), at_s, coarsest_s),
                cause=causes.get((scenario, *key), ""),
            )
            for key, cases in methods.items()
        }
    return cells


def _coarsest_listed(manifest: Mapping[str, Any], scenario: str) -> float:
    """Return the coarsest requested step in s: a run adds coarser ones where errors are too small."""
    stored = manifest["scenarios"].get(scenario, {})
    if steps := manifest.get("dt_s") or stored.get("steps_s"):
        return max(steps)
    samples = stored.get("samples", 0)
    return stored["duration_s"] / (samples - 1) / min(DEFAULT_STEPS_PER_SAMPLE) if samples > 1 else math.inf


@dataclass(frozen=True)
class CaseFault:
    """Cases of one method on one scenario with the same fault, at these steps or tolerances."""

    scenario: str
    key: MethodKey
    outcome: str
    message: str
    steps: tuple[float | None, ...]


def faults_of(cases: Iterable[CaseResult]) -> list[CaseFault]:
    """Return the invalid, failed, timed-out and unstable cases, grouped by fault."""
    steps: dict[tuple[str, MethodKey, str, str], list[float | None]] = {}
    for case in cases:
        columns = case.columns
        if columns["outcome"] in FAULTS:
            fault = (columns["scenario"], key_of(columns), columns["outcome"], columns["message"])
            steps.setdefault(fault, []).append(case.setting.fineness)
    return [CaseFault(*fault, steps=tuple(dts)) for fault, dts in steps.items()]


@dataclass(frozen=True)
class Overview:
    """The results of one method: its cells by scenario, in the order of the run."""

    method: str
    cells: Mapping[str, Cell]

    @property
    def states(self) -> Counter[str]:
        """The number of scenarios in each state."""
        return Counter(cell.state for cell in self.cells.values())

    @property
    def order(self) -> str:
        """The observed orders of the orientation: one, or the smallest and the largest."""
        orders = sorted(cell.order for cell in self.cells.values() if cell.order is not None)
        return " to ".join(dict.fromkeys(f"{order:.2f}" for order in (*orders[:1], *orders[-1:])))

    @property
    def supported(self) -> int:
        """The number of scenarios that the method supports."""
        return sum(cell.state != "unsupported" for cell in self.cells.values())

    def error_at_step(self, chaotic: Collection[str]) -> float | None:
        """The largest error at the common steps in rad, without chaotic scenarios; None if one is unknown."""
        supported = [
            cell.error
            for scenario, cell in self.cells.items()
            if cell.state != "unsupported" and scenario not in chaotic
        ]
        known = [error for error in supported if error is not None]
        return max(known) if known and len(known) == len(supported) else None

    @property
    def largest_error(self) -> tuple[str, str]:
        """The largest orientation error over all listed steps and scenarios in rad; its step and scenario."""
        errors = [
            (cell.largest, cell.largest_at, scenario)
            for scenario, cell in self.cells.items()
            if cell.largest is not None
        ]
        if not errors:
            return "", ""
        error, at, scenario = max(errors)
        return number(error, 3), at if len(self.cells) == 1 else f"{at}, {scenario}"


def overviews(cells: Mapping[str, Mapping[MethodKey, Cell]]) -> list[Overview]:
    """Return the methods of a summary, in the order of the run."""
    by_method: dict[MethodKey, dict[str, Cell]] = {}
    for scenario, methods in cells.items():
        for key, cell in methods.items():
            by_method.setdefault(key, {})[scenario] = cell
    return [Overview(":".join(key), found) for key, found in by_method.items()]
