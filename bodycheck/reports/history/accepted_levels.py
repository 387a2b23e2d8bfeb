"""The accepted level of each measure, to which the next nightly run is compared so that small steps add up.

A level is the value from the nightly run in which the measure last changed by more than the threshold and was
reported, or in which it was first measured. A smaller change leaves the level unchanged.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from bodycheck.reports.comparison.change import Change
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.run_files.run_reader import Tables
from bodycheck.reports.run_files.run_tables import case_key
from bodycheck.reports.run_files.tables import RESULT_COLUMNS, as_csv, as_table, read_rows

FILE = "accepted.csv"
"""A file in the folder of a nightly run: rows of results.csv, each measure at its accepted level."""

_NEEDED = ("scenario", "engine", "method", "control", "outcome")
_REPORTED = ("worse", "improved", "new")

_Row: TypeAlias = Mapping[str, Any]


def read_accepted(folder: Path, tables: Tables) -> Tables:
    """Return the tables of a nightly run with the accepted levels as its cases.

    If the run stored no levels, they are its own cases that ended well. Raises InputError if the file is
    damaged.
    """
    path = folder / FILE
    if not path.exists():
        return replace(tables, cases=tuple(case for case in tables.cases if case.ok))
    always = {"dt_s": None, "tolerance": None, "message": ""}
    rows = read_rows(path, RESULT_COLUMNS, _NEEDED)
    return replace(tables, cases=tuple(CaseResult({**always, **row}) for row in rows))


def write_accepted(accepted: Iterable[_Row], run_id: str, folder: Path) -> None:
    """Write the accepted levels with which the next nightly run is compared."""
    rows = ({**row, "run_id": run_id} for row in accepted)
    (folder / FILE).write_bytes(as_csv(as_table(rows, RESULT_COLUMNS)))


def at_accepted(tables: Tables, accepted: Tables) -> Tables:
    """Return the tables with the measures of all cases that ended well set to their accepted levels."""
    levels = {case_key(case.columns): case.columns for case in accepted.cases}

    def leveled(case: CaseResult) -> CaseResult:
        level = levels.get(case_key(case.columns)) if case.ok else None
        return case if level is None else replace(case, columns=_with_levels(case.columns, level, ()))

    return replace(tables, cases=tuple(map(leveled, tables.cases)))


def next_accepted(
    accepted: Tables, newest: Tables, redefined: Iterable[str], changes: Iterable[Change]
) -> Iterator[dict[str, Any]]:
    """Yield the accepted levels after a nightly run, as rows of results.csv.

    A measure whose change was reported gets its new value as level; all others keep theirs, and so does a
    case that did not end well. redefined: scenarios whose old levels are discarded.
    """
    discarded = set(redefined)
    levels = {case_key(case.columns): case.columns for case in accepted.cases}
    reported: dict[tuple[Any, ...], list[str]] = {}
    for change in changes:
        if change.kind == "accuracy" and change.status in _REPORTED:
            key = change.scenario, change.engine, change.method, change.control, change.fineness
            reported.setdefault(key, []).append(change.quantity)
    ended_well = {case_key(case.columns): case.columns for case in newest.cases if case.ok}
    for key, row in ended_well.items():
        level = levels.get(key)
        if level is None or row["scenario"] in discarded:
            yield dict(row)
        else:
            yield _with_levels(row, level, reported.get(key, ()))
    for key, level in levels.items():
        if key not in ended_well and level["scenario"] not in discarded:
            yield dict(level)


def _with_levels(row: _Row, level: _Row, reported: Iterable[str]) -> dict[str, Any]:
    """Return a row with its measures set to their levels, except the reported ones."""
    updated = {name for measure in reported for name in _columns_of(measure.removesuffix("_abs"))}
    columns = (name for measure in MEASURES for name in _columns_of(measure) if name not in updated)
    return {**row, **{name: level[name] for name in columns if name in row and name in level}}


def _columns_of(measure: str) -> tuple[str, str]:
    return measure, f"{measure}_abs"
