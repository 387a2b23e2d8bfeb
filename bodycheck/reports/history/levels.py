"""The accepted level of every value that nightly runs compare, and the run in which it was accepted.

First values and confirmed improvements become levels by themselves; a deterioration only if somebody accepts
it. A smaller change than the threshold leaves the level unchanged, so that small steps add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import open_input
from bodycheck.reports.comparison.change import NOT_MEASURED, Change, ChangeKey
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measures import IDENTITY, MEASURES
from bodycheck.reports.run_files.run_reader import Tables
from bodycheck.reports.run_files.run_tables import case_key, study_key
from bodycheck.reports.run_files.tables import (
    FINGERPRINT_COLUMNS,
    LAW_COLUMNS,
    METHOD_COLUMNS,
    RESULT_COLUMNS,
    STABILITY_COLUMNS,
    as_csv,
    as_table,
    plain_rows,
    read_rows,
)

FOLDER = "accepted"
"""The folder of the levels in a nightly run: its tables with each value at its level, and settings.csv."""

_SETTINGS = "settings.csv"
_FORMER_FILE = "accepted.csv"  # of results only, in the histories of earlier versions

ABSENT = "absent"
"""The outcome of a level that was accepted as no longer measured; its values count if the case returns."""

How: TypeAlias = Literal["first value", "improvement", "accepted", "withdrawn"]
Cells: TypeAlias = Mapping[str, Any]
_Row: TypeAlias = dict[str, Any]
_Key: TypeAlias = tuple[Any, ...]

_IDENTITY = ("run_id", *IDENTITY, "quantity")
_ORDER = ("order", "order_low", "order_high")
_SETTING_COLUMNS = (
    *("run_id", "how", "acceptance", "kind", "scenario", "engine", "method", "control", "fineness"),
    "quantity",
)
_OF_EVERY_SETTING = ("run_id", "how", "kind", "engine", "method", "quantity")


@dataclass(frozen=True)
class Setting:
    """Where a level comes from: the nightly run with this value, and the acceptance by which it counts."""

    run_id: str
    how: How
    acceptance: str = ""


@dataclass(frozen=True, eq=False)
class Levels:
    """The rows of the tables of a run with every value at its accepted level.

    run_id of a row: the nightly run that first measured it. settings: of the levels that are not first
    values, by change; those of speeds say from which run on a method's times are its level.
    """

    results: Mapping[_Key, _Row]
    methods: Mapping[_Key, _Row]
    stability: Mapping[_Key, _Row]
    settings: Mapping[ChangeKey, Setting] = field(default_factory=dict)
    fingerprints: Mapping[_Key, _Row] = field(default_factory=dict)
    laws: Mapping[_Key, _Row] = field(default_factory=dict)

    @classmethod
    def of(cls, tables: Tables) -> Levels:
        """Return the values of a run as levels."""
        results = ({**case.columns, "run_id": tables.run_id} for case in tables.cases)
        return cls(
            {case_key(row): row for row in results},
            _by_quantity(plain_rows(tables.methods)),
            {study_key(row): row for row in plain_rows(tables.stability)},
            fingerprints=_by_map(plain_rows(tables.fingerprints)),
            laws=_by_law(plain_rows(tables.laws)),
        )

    def setting(self, change: Change) -> Setting | None:
        """Return in which run and how the level of a changed value was accepted; None if it has no level."""
        if (found := self.settings.get(change.key)) is not None:
            return found
        table, key, _ = _place(change)
        row = getattr(self, table).get(key) if table else None
        return None if row is None else Setting(row["run_id"], "first value")

    def cells(self, change: Change) -> Cells:
        """Return the level of a changed value as cells of its row; those without a value are left out."""
        table, key, columns = _place(change)
        row = getattr(self, table).get(key, {}) if table else {}
        if not row and change.kind in ("case", "outcome"):
            return {"outcome": ABSENT}
        return {name: row[name] for name in columns if name in row}

    def with_cells(self, change: Change, cells: Cells, setting: Setting) -> Levels:
        """Return the levels with that of one value replaced."""
        table, key, columns = _place(change)
        updated = replace(self, settings={**self.settings, change.key: setting})
        rows = getattr(self, table) if table else {}
        if key not in rows:
            return updated
        kept = {name: cell for name, cell in rows[key].items() if name not in columns}
        return replace(updated, **{table: {**rows, key: {**kept, **cells}}})

    def of_scenarios(self, names: Iterable[str]) -> Levels:
        """Return the levels on these scenarios, and those of methods as a whole."""
        known = set(names)

        def mine(rows: Mapping[_Key, _Row]) -> dict[_Key, _Row]:
            return {key: row for key, row in rows.items() if row["scenario"] in known}

        settings = {k: s for k, s in self.settings.items() if k.scenario is None or k.scenario in known}
        return replace(
            self,
            results=mine(self.results),
            methods=mine(self.methods),
            stability=mine(self.stability),
            settings=settings,
        )

    def with_first_values(self, newest: Tables, new: Iterable[Change]) -> Levels:
        """Return the levels with the rows of a run that have none, and the values of changes that are new.

        What is not compared, such as bounds and commands, is as in the newest run.
        """
        own = Levels.of(newest)
        results = {**own.results, **self.results}
        for key, row in own.results.items():
            if key in self.results:
                level = self.results[key]
                results[key] = _at_level(row, level) if row["outcome"] == "ok" else {**level}
                if level["outcome"] == ABSENT:  # the case is back
                    results[key]["outcome"] = "ok" if _measures(level) else row["outcome"]
        found = replace(
            self,
            results=results,
            methods={**own.methods, **self.methods},
            stability={**own.stability, **self.stability},
            fingerprints={**own.fingerprints, **self.fingerprints},
            laws={**own.laws, **self.laws},
        )
        for change in new:
            if change.kind == "accuracy":
                found = found.with_cells(change, own.cells(change), Setting(newest.run_id, "first value"))
        return found

    def with_levels_of(self, changes: Iterable[Change], other: Levels) -> Levels:
        """Return the levels with those of some changed values taken from other levels, with their rows."""
        found = self
        for change in changes:
            table, key, _ = _place(change)
            if table and key in getattr(other, table) and key not in getattr(found, table):
                row = getattr(other, table)[key]
                found = replace(found, **{table: {**getattr(found, table), key: row}})
            if (setting := other.setting(change)) is not None:
                found = found.with_cells(change, other.cells(change), setting)
        return found

    def as_tables(self, run: Tables, returned: Iterable[_Key] = ()) -> Tables:
        """Return a run with its cases, methods, stable steps, maps and laws replaced by their levels.

        returned: keys of the cases that the next run has; those accepted as absent are left out otherwise.
        """
        again = set(returned)
        rows = [row for key, row in self.results.items() if row["outcome"] != ABSENT or key in again]
        rows = [
            {**row, "outcome": "ok"} if row["outcome"] == ABSENT and _measures(row) else row for row in rows
        ]
        always = {"dt_s": None, "tolerance": None, "message": ""}
        cases = ({name: cell for name, cell in {**always, **row}.items() if name != "run_id"} for row in rows)
        return replace(
            run,
            cases=tuple(map(CaseResult, cases)),
            methods=as_table(self.methods.values(), METHOD_COLUMNS),
            stability=as_table(self.stability.values(), STABILITY_COLUMNS),
            fingerprints=as_table(self.fingerprints.values(), FINGERPRINT_COLUMNS),
            laws=as_table(self.laws.values(), LAW_COLUMNS),
        )

    def renamed(self, names: Mapping[str, str]) -> Levels:
        """Return the levels with engines renamed."""

        def rows(table: Mapping[_Key, _Row]) -> list[_Row]:
            return [{**row, "engine": names.get(row["engine"], row["engine"])} for row in table.values()]

        return Levels(
            {case_key(row): row for row in rows(self.results)},
            _by_quantity(rows(self.methods)),
            {study_key(row): row for row in rows(self.stability)},
            {key._replace(engine=names.get(key.engine, key.engine)): s for key, s in self.settings.items()},
            _by_map(rows(self.fingerprints)),
            _by_law(rows(self.laws)),
        )

    @property
    def engines(self) -> tuple[str, ...]:
        """The engines that have levels."""
        return tuple(dict.fromkeys(row["engine"] for row in self.results.values()))


def _place(change: Change) -> tuple[str, _Key, tuple[str, ...]]:
    """Return table, key and columns of the level of a value; no table where it has none."""
    study = change.scenario, change.engine, change.method
    match change.kind:
        case "accuracy":
            measure = change.quantity.removesuffix("_abs")
            return "results", (*study, change.control, change.fineness), MEASURES[measure].columns
        case "outcome" | "case":
            return "results", (*study, change.control, change.fineness), ("outcome",)
        case "verdict" | "order":
            others = _ORDER if change.kind == "verdict" else ("verdict",)
            columns = tuple(name for name in METHOD_COLUMNS if name not in (*_IDENTITY, *others))
            return "methods", (*study, change.quantity.removeprefix(f"{change.kind} of ")), columns
        case "stability":
            columns = tuple(name for name in STABILITY_COLUMNS if name not in _IDENTITY)
            return "stability", study, columns
        case "fingerprint":
            columns = tuple(name for name in FINGERPRINT_COLUMNS if name not in ("run_id", *IDENTITY))
            return "fingerprints", (change.engine, change.method), columns
        case "law":
            columns = tuple(name for name in LAW_COLUMNS if name not in ("run_id", *IDENTITY, "law"))
            return "laws", (change.engine, change.method, change.quantity.removeprefix("law ")), columns
        case _:
            return "", (), ()


def _by_quantity(rows: Iterable[_Row]) -> dict[_Key, _Row]:
    return {(*study_key(row), row["quantity"]): row for row in rows}


def _by_map(rows: Iterable[_Row]) -> dict[_Key, _Row]:
    return {(row["engine"], row["method"]): row for row in rows if row["fingerprint"] not in NOT_MEASURED}


def _by_law(rows: Iterable[_Row]) -> dict[_Key, _Row]:
    return {
        (row["engine"], row["method"], row["law"]): row for row in rows if row["verdict"] not in NOT_MEASURED
    }


def _measures(row: Cells) -> set[str]:
    return {name for measure in MEASURES.values() for name in measure.columns if name in row}


def _at_level(row: _Row, level: _Row) -> _Row:
    """Return a row with its outcome and its measures at their levels; measures without one are left out."""
    measured = _measures(row)
    kept = {name: cell for name, cell in row.items() if name not in measured}
    return {**kept, **{name: level[name] for name in ("run_id", "outcome", *_measures(level))}}


def read_levels(folder: Path, tables: Tables) -> Levels:
    """Return the levels accepted after a nightly run; raises InputError if a file is damaged.

    tables: of the run. Of a run of an earlier version, the levels are as it accepted them: those of its file,
    and otherwise its own values.
    """
    of_case = ("run_id", "scenario", "engine", "method", "control", "outcome")
    if not (folder / FOLDER).is_dir():
        path, own = folder / _FORMER_FILE, Levels.of(tables)
        rows = read_rows(path, RESULT_COLUMNS, of_case) if path.exists() else []
        former = {case_key(row): {**row, "outcome": ABSENT} for row in rows}
        for key, row in own.results.items():
            former[key] = {**former[key], "outcome": row["outcome"]} if key in former else row
        return replace(own, results=former)
    place = folder / FOLDER
    of_method = ("run_id", "scenario", "engine", "method", "quantity", "verdict")
    of_search = ("run_id", "scenario", "engine", "method", "outcome")
    results = read_rows(place / "results.csv", RESULT_COLUMNS, of_case)
    own = Levels.of(tables)
    maps, laws = place / "fingerprints.csv", place / "laws.csv"  # missing from runs of earlier versions
    of_map = ("run_id", "engine", "method", "fingerprint")
    of_law = ("run_id", "engine", "method", "law", "verdict")
    return Levels(
        {case_key(row): row for row in results},
        _by_quantity(read_rows(place / "methods.csv", METHOD_COLUMNS, of_method)),
        {study_key(row): row for row in read_rows(place / "stability.csv", STABILITY_COLUMNS, of_search)},
        dict(_settings(place / _SETTINGS)),
        _by_map(read_rows(maps, FINGERPRINT_COLUMNS, of_map)) if maps.exists() else own.fingerprints,
        _by_law(read_rows(laws, LAW_COLUMNS, of_law)) if laws.exists() else own.laws,
    )


def settings_of(folder: Path) -> bytes:
    """Return the content of the settings after a nightly run, which changes where a level is set."""
    try:
        with open_input(folder / FOLDER / _SETTINGS) as file:
            return file.read()
    except FileNotFoundError:  # of an earlier version
        return b""


def _settings(path: Path) -> Iterable[tuple[ChangeKey, Setting]]:
    for row in read_rows(path, _SETTING_COLUMNS, _OF_EVERY_SETTING):
        if row["how"] not in get_args(How):
            raise InputError(f"{path}: unknown how {row['how']!r} (available: {', '.join(get_args(How))})")
        key: dict[str, Any] = {name: row.get(name) for name in ChangeKey._fields}
        yield (
            ChangeKey(**key),
            Setting(row["run_id"], row["how"], row.get("acceptance", "")),
        )


def write_levels(levels: Levels, folder: Path) -> None:
    """Write the levels with which the next nightly run is compared, into the folder of a nightly run."""
    place = folder / FOLDER
    place.mkdir()
    settings = (
        {**key._asdict(), "run_id": one.run_id, "how": one.how, "acceptance": one.acceptance or None}
        for key, one in levels.settings.items()
    )
    for name, rows, columns in (
        ("results", levels.results.values(), RESULT_COLUMNS),
        ("methods", levels.methods.values(), METHOD_COLUMNS),
        ("stability", levels.stability.values(), STABILITY_COLUMNS),
        ("fingerprints", levels.fingerprints.values(), FINGERPRINT_COLUMNS),
        ("laws", levels.laws.values(), LAW_COLUMNS),
        ("settings", settings, _SETTING_COLUMNS),
    ):
        (place / f"{name}.csv").write_bytes(as_csv(as_table(rows, columns)))
