"""What a run found, in a few sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bodycheck.reports.case import SWITCH_NOTE
from bodycheck.reports.findings import Findings, MethodKey, key_of
from bodycheck.reports.states import FAULTS
from bodycheck.reports.summary import Cell, is_lower, theory
from bodycheck.reports.wording import count, names, number


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
    for fault in FAULTS:
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
