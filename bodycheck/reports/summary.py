"""What a run says in short: one cell a scenario and method, and a verdict in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from bodycheck.reports.case import SWITCH_NOTE, CaseResult
from bodycheck.reports.wording import count, names, number

if TYPE_CHECKING:
    import pandas as pd

_ORIENTATION = "orientation_error_rad"
_FLOORS = 30.0  # times the truth's bound: the largest error of a method without steps that is the truth
_ORDER_SLACK = 0.2  # how far below its theory an observed order may lie and still be called its own

MethodKey: TypeAlias = tuple[str, str]
"""Engine and method."""


class Findings(Protocol):
    """What a summary is made from: a run, or the tables of one."""

    @property
    def manifest(self) -> dict[str, Any]:
        """Versions, machine, settings, scenarios."""

    @property
    def methods(self) -> pd.DataFrame:
        """One row a scenario, method and quantity."""

    @property
    def stability(self) -> pd.DataFrame:
        """One row a scenario and method that is told a step."""

    @property
    def cases(self) -> tuple[CaseResult, ...]:
        """Every case, in the order of the run."""


@dataclass(frozen=True)
class State:
    """What a cell can say: its symbol, its word, what it means, and the tint that it shares with others."""

    symbol: str
    word: str
    meaning: str
    tint: str


STATES = {
    "converges": State("✓", "converges", "the error shrinks with the step at a steady order", "good"),
    "at-floor": State("≈", "at floor", "all errors lie at round-off or at the truth's own bound", "floor"),
    "exact": State("=", "exact", "a method without steps, at the truth's own bound", "floor"),
    "pre-asymptotic": State(
        "…", "pre-asymptotic", "errors too large or too irregular for an order to show", "open"
    ),
    "lower-order": State(
        "↓", "lower order", "the error shrinks, at a lower order than the method has in theory", "open"
    ),
    "too-few-points": State("?", "too few points", "fewer than four steps with a usable error", "open"),
    "chaotic": State("≋", "chaotic", "nearby motions part too fast for an error to mean much", "open"),
    "does-not-converge": State(
        "✗", "does not converge", "the error stays flat over two decades of step, well above the floor", "bad"
    ),
    "off": State("✗", "no steps, off", "a method without steps, above the truth's own bound", "bad"),
    "unstable": State(
        "▲", "unstable", "not finite, not a rotation, or 100 times the true kinetic energy", "fault"
    ),
    "failed": State("!", "failed", "the engine raised an error", "fault"),
    "timeout": State("!", "timeout", "the case took longer than it was given", "fault"),
    "invalid": State("≠", "invalid", "the engine held other parameters than it was given", "fault"),
    "unsupported": State("○", "unsupported", "the method cannot represent the scenario", "none"),
}
"""Every verdict of methods.csv and every outcome but ok, with words for what neither of them says."""

_FAULTS = ("invalid", "failed", "timeout", "unstable")
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
        if columns["outcome"] in _FAULTS:
            alike = (columns["scenario"], key_of(columns), columns["outcome"], columns["message"])
            steps.setdefault(alike, []).append(case.setting.fineness)
    return [Fault(*alike, steps=tuple(dts)) for alike, dts in steps.items()]


def key_of(row: Mapping[str, Any]) -> MethodKey:
    """Return engine and method of a row of either table."""
    return row["engine"], row["method"]


def common_step(cases: Iterable[CaseResult]) -> float | None:
    """Return the step that most methods were run at, the finest of several; None where there are no steps."""
    shared = Counter(
        case.dt_s for case in cases if case.dt_s is not None and case.columns["outcome"] != "unsupported"
    )
    return max(shared, key=lambda dt_s: (shared[dt_s], -dt_s), default=None)


def shown_case(cases: Iterable[CaseResult], at_s: float | None) -> CaseResult | None:
    """Return the case of a method that stands for it: at the common step, else at its finest tolerance."""
    fitting = [case for case in cases if case.dt_s in (None, at_s)]
    return min(fitting, key=lambda case: case.setting.fineness or 0.0, default=None)


def summary_cell(
    cases: Sequence[CaseResult], found: Mapping[str, Mapping[str, Any]], at_s: float | None
) -> Cell:
    """Return what the cases of one method on one scenario come to.

    found: their rows of methods.csv by quantity; at_s: the common step.
    """
    at_step = shown_case(cases, at_s)
    error = at_step.columns[_ORIENTATION] if at_step and at_step.ok else None
    ended = Counter(case.columns["outcome"] for case in cases)
    faults = {fault: ended[fault] for fault in _FAULTS if ended[fault]}
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
    by_pair: dict[str, dict[MethodKey, list[CaseResult]]] = {name: {} for name in run.manifest["scenarios"]}
    for case in run.cases:
        by_method = by_pair.setdefault(case.columns["scenario"], {})
        by_method.setdefault(key_of(case.columns), []).append(case)
    found: dict[tuple[str, str, str], dict[str, Any]] = {}
    rows: list[Any] = run.methods.to_dict("records")
    for row in rows:
        found.setdefault((row["scenario"], *key_of(row)), {})[row["quantity"]] = row
    cells = {}
    for scenario, methods in by_pair.items():
        at_s = common_step(case for cases in methods.values() for case in cases)
        cells[scenario] = {
            key: summary_cell(cases, found.get((scenario, *key), {}), at_s) for key, cases in methods.items()
        }
    return cells


def verdict_sentences(run: Findings, cells: Mapping[str, Mapping[MethodKey, Cell]]) -> list[str]:
    """Return what the run found, in a few sentences; whatever did not end well is always among them."""
    sentences = [
        _as_they_should(run, cells),
        _of_lower_order(run, cells),
        _listed("The orientation error does not converge", cells, ("does-not-converge", "off")),
        _other_plateaus(cells),
        _not_ended_well(run),
        _undecided(cells),
    ]
    return [sentence for sentence in sentences if sentence]


def theory(run: Findings, key: MethodKey) -> float:
    """Return the order that the method has in theory, 0 where it has none."""
    engine, method = key
    return run.manifest["engines"][engine]["methods"][method]["order"] or 0


def worst_state(run: Findings, key: MethodKey, cell: Cell) -> str:
    """Return the gravest of what a cell says: how a case ended, a plateau, a lower order, or its verdict."""
    said = [*cell.faults, cell.state]
    if cell.plateaus:
        said.append("does-not-converge")
    if is_lower(run, key, cell):
        said.append("lower-order")
    return max(said, key=lambda state: _GRAVITY.index(STATES[state].tint))


def is_lower(run: Findings, key: MethodKey, cell: Cell) -> bool:
    """Whether a method shows a lower order than it has in theory."""
    return cell.order is not None and cell.order < theory(run, key) - _ORDER_SLACK


def _as_they_should(run: Findings, cells: Mapping[str, Mapping[MethodKey, Cell]]) -> str:
    """Name the methods that keep their order, or are at the floor, wherever they are supported."""
    sound: dict[MethodKey, bool] = {}
    for methods in cells.values():
        for key, cell in methods.items():
            if cell.state == "unsupported":
                continue
            keeps = cell.state in ("converges", "at-floor", "exact") and not cell.notes
            sound[key] = sound.get(key, True) and keeps and not is_lower(run, key, cell)
    good = [":".join(key) for key, whether in sound.items() if whether]
    others = [":".join(key) for key, whether in sound.items() if not whether]
    where = "wherever supported" if len(cells) > 1 else f"in {next(iter(cells))}"
    if len(good) == 1:
        return f"{good[0]} converges with its order of theory, or is at the floor, {where}."
    what = f"converge with their order of theory, or are at the floor, {where}"
    if len(good) > len(others):
        return f"All {len(sound)} methods{' but ' if others else ''}{names(others)} {what}."
    return f"{names(good) or 'No methods'} {what}."


def _of_lower_order(run: Findings, cells: Mapping[str, Mapping[MethodKey, Cell]]) -> str:
    lower = [
        f"{':'.join(key)} in {scenario} ({number(cell.order, 3)}, in theory {theory(run, key)}"
        f"{_why_lower(run, scenario, key)})"
        for scenario, methods in cells.items()
        for key, cell in methods.items()
        if is_lower(run, key, cell)
    ]
    return f"Of a lower order than in theory: {names(lower)}." if lower else ""


def _why_lower(run: Findings, scenario: str, key: MethodKey) -> str:
    """Name the cause of a lower order where the cases' own messages have it."""
    cases = (case.columns for case in run.cases if case.columns["scenario"] == scenario)
    switched = any(SWITCH_NOTE in str(columns["message"]) for columns in cases if key_of(columns) == key)
    return ": a load switches inside a step" if switched else ""


def _listed(what: str, cells: Mapping[str, Mapping[MethodKey, Cell]], states: Sequence[str]) -> str:
    """Say what is the case, and for which methods in which scenarios."""
    where: dict[str, list[str]] = {}
    for scenario, methods in cells.items():
        for key, cell in methods.items():
            if cell.state in states:
                where.setdefault(":".join(key), []).append(scenario)
    return f"{what}: {names([f'{m} in {names(s)}' for m, s in where.items()])}." if where else ""


def _other_plateaus(cells: Mapping[str, Mapping[MethodKey, Cell]]) -> str:
    where = [
        f"{names(cell.plateaus)} of {':'.join(key)} in {scenario}"
        for scenario, methods in cells.items()
        for key, cell in methods.items()
        if cell.plateaus
    ]
    return f"Other measures that do not converge: {names(where)}." if where else ""


def _not_ended_well(run: Findings) -> str:
    parts = []
    for fault in _FAULTS:
        ended = [case.columns for case in run.cases if case.columns["outcome"] == fault]
        if ended:
            where = dict.fromkeys(
                f"{':'.join(key_of(columns))} in {columns['scenario']}" for columns in ended
            )
            parts.append(f"{count(len(ended), 'case')} {fault} ({names(list(where))})")
    return f"Did not end well: {'; '.join(parts)}." if parts else ""


def _undecided(cells: Mapping[str, Mapping[MethodKey, Cell]]) -> str:
    states = ("pre-asymptotic", "too-few-points", "chaotic")
    pairs = [cell for methods in cells.values() for cell in methods.values()]
    undecided = sum(cell.state in states for cell in pairs)
    if not undecided:
        return ""
    where = [s for s, methods in cells.items() if any(cell.state in states for cell in methods.values())]
    return (
        f"No order can be told for {undecided} of {count(len(pairs), 'pair')} of method and scenario, "
        f"in {names(where)}."
    )
