"""The results of a run in a few sentences: what is wrong, what is correct, and what is undecided."""

from __future__ import annotations

from collections.abc import Mapping

from bodycheck._util.formatting import count, names
from bodycheck.reports.run_files.run_tables import MethodKey, RunTables
from bodycheck.reports.summary.cells import Cell
from bodycheck.reports.summary.worst_results import MethodResults, faulty, headline, worst_methods

_UNDECIDED = ("pre-asymptotic", "too-few-points", "chaotic")


def verdict_sentences(run: RunTables, cells: Mapping[str, Mapping[MethodKey, Cell]]) -> list[str]:
    """Return the results of the run in a few sentences that name every method with findings."""
    found = worst_methods(run)
    sentences = [headline(found), _as_they_should(cells, found), _undecided(cells), _properties(found)]
    return [sentence for sentence in sentences if sentence]


def _as_they_should(cells: Mapping[str, Mapping[MethodKey, Cell]], found: list[MethodResults]) -> str:
    """Name the methods with the expected order, or at the floor, in every quantity wherever supported."""
    wrong = {one.method for one in faulty(found)}
    sound: dict[str, bool] = {}
    for methods in cells.values():
        for key, cell in methods.items():
            if cell.state != "unsupported":
                method = ":".join(key)
                sound[method] = sound.get(method, method not in wrong) and cell.is_sound
    good = [method for method, whether in sound.items() if whether]
    others = [method for method, whether in sound.items() if not whether]
    where = "wherever supported" if len(cells) > 1 else f"in {next(iter(cells))}"
    what = f"in all quantities with the expected order, or at the floor, {where}"
    if not good:
        return ""
    if len(sound) == 1:
        return f"{good[0]} converges {what}."
    if not others:
        return f"All {len(sound)} methods converge {what}."
    return f"{len(good)} of {len(sound)} methods converge {what}: {names(good)}."


def _undecided(cells: Mapping[str, Mapping[MethodKey, Cell]]) -> str:
    pairs = [cell for methods in cells.values() for cell in methods.values()]
    undecided = sum(cell.state in _UNDECIDED for cell in pairs)
    if not undecided:
        return ""
    where = [s for s, methods in cells.items() if any(c.state in _UNDECIDED for c in methods.values())]
    return (
        f"No verdict for {undecided} of {count(len(pairs), 'pair')} of method and scenario, "
        f"in {names(where)}: too few steps show an order."
    )


def _properties(found: list[MethodResults]) -> str:
    """Name the properties of the engines' states: an unnormalised quaternion is a design, not a fault."""
    results = [
        f"{one.method}: {result.sentence}"
        for one in found
        for result in one.results
        if result.kind == "property"
    ]
    return f"Properties of the engines' states, not faults: {'; '.join(results)}." if results else ""
