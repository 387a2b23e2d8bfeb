"""The accepted level of every value that nightly runs compare, and the run in which it was accepted.

First values and confirmed improvements become levels by themselves; a deterioration only if somebody accepts
it. A smaller change than the threshold leaves the level unchanged, so that small steps add up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import open_input
from bodycheck.reports.comparison.change import NOT_MEASURED, Change, ChangeKey
from bodycheck.reports.measurement.measures import IDENTITY, MEASURES
from bodycheck.reports.run_files.run_tables import Tables, case_key, case_of, key_of, study_key
from bodycheck.reports.run_files.tables import TABLES, TableKind, as_csv, as_table, read_rows

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

_ORDER = ("order", "order_low", "order_high")
_SETTING_TABLE = TableKind(
    name="settings",
    columns=(
        *("run_id", "how", "acceptance", "kind", "scenario", "engine", "method", "control", "fineness"),
        "quantity",
    ),
    needed=("run_id", "how", "kind", "engine", "method", "quantity"),
    words=("how", "acceptance", "kind"),
)


@dataclass(frozen=True)
class LevelSource:
    """Where a level comes from: the nightly run with this value, and the acceptance by which it counts."""

    run_id: str
    how: How
    acceptance: str = ""


@dataclass(frozen=True, eq=False)
class Levels:
    """The rows of the tables of a run, by table and key, with every value at its accepted level.

    run_id of a row: the nightly run that first measured it. settings: of the levels that are not first
    values, by change; those of speeds say from which run on a method's times are its level.
    """

    tables: Mapping[str, Mapping[_Key, _Row]] = field(default_factory=dict)
    settings: Mapping[ChangeKey, LevelSource] = field(default_factory=dict)

    @classmethod
    def of(cls, tables: Tables) -> Levels:
        """Return the values of a run as levels."""
        results = ({**case.columns, "run_id": tables.run_id} for case in tables.cases)
        others = {name: tables.rows(name) for name in _KEYS if name != "results"}
        return cls({name: _by_key(name, rows) for name, rows in {"results": results, **others}.items()})

    def rows(self, table: str) -> Mapping[_Key, _Row]:
        """Return the rows of a table by their keys."""
        return self.tables.get(table, {})

    def setting(self, change: Change) -> LevelSource | None:
        """Return in which run and how the level of a changed value was accepted; None if it has no level."""
        if (found := self.settings.get(change.key)) is not None:
            return found
        table, key, _ = _place(change)
        row = self.rows(table).get(key)
        return None if row is None else LevelSource(row["run_id"], "first value")

    def cells(self, change: Change) -> Cells:
        """Return the level of a changed value as cells of its row; those without a value are left out."""
        table, key, columns = _place(change)
        row = self.rows(table).get(key, {})
        if not row and change.kind in ("case", "outcome"):
            return {"outcome": ABSENT}
        return {name: row[name] for name in columns if name in row}

    def with_cells(self, change: Change, cells: Cells, setting: LevelSource) -> Levels:
        """Return the levels with that of one value replaced."""
        table, key, columns = _place(change)
        updated = replace(self, settings={**self.settings, change.key: setting})
        rows = self.rows(table)
        if key not in rows:
            return updated
        kept = {name: cell for name, cell in rows[key].items() if name not in columns}
        return updated._with_row(table, key, {**kept, **cells})

    def _with_row(self, table: str, key: _Key, row: _Row) -> Levels:
        return replace(self, tables={**self.tables, table: {**self.rows(table), key: row}})

    def of_scenarios(self, names: Iterable[str]) -> Levels:
        """Return the levels on these scenarios, and those of methods as a whole."""
        known = set(names)

        def mine(name: str, rows: Mapping[_Key, _Row]) -> Mapping[_Key, _Row]:
            of_studies = TABLES[name].is_of_studies
            return {key: row for key, row in rows.items() if not of_studies or row["scenario"] in known}

        settings = {k: s for k, s in self.settings.items() if k.scenario is None or k.scenario in known}
        return Levels({name: mine(name, rows) for name, rows in self.tables.items()}, settings)

    def with_first_values(self, newest: Tables, new: Iterable[Change]) -> Levels:
        """Return the levels with the rows of a run that have none, and the values of changes that are new.

        What is not compared, such as bounds and commands, is as in the newest run.
        """
        own = Levels.of(newest)
        tables = {name: {**own.rows(name), **self.rows(name)} for name in _KEYS}
        results = tables["results"]
        for key, row in own.rows("results").items():
            if (level := self.rows("results").get(key)) is not None:
                results[key] = _at_level(row, level) if row["outcome"] == "ok" else {**level}
                if level["outcome"] == ABSENT:  # the case is back
                    results[key]["outcome"] = "ok" if _measures(level) else row["outcome"]
        found = replace(self, tables=tables)
        for change in new:
            if change.kind == "accuracy":
                found = found.with_cells(change, own.cells(change), LevelSource(newest.run_id, "first value"))
        return found

    def with_levels_of(self, changes: Iterable[Change], other: Levels) -> Levels:
        """Return the levels with those of some changed values taken from other levels, with their rows."""
        found = self
        for change in changes:
            table, key, _ = _place(change)
            if key in other.rows(table) and key not in found.rows(table):
                found = found._with_row(table, key, other.rows(table)[key])
            if (setting := other.setting(change)) is not None:
                found = found.with_cells(change, other.cells(change), setting)
        return found

    def as_tables(self, run: Tables, returned: Iterable[_Key] = ()) -> Tables:
        """Return a run with its cases, methods, stable steps, maps and laws replaced by their levels.

        returned: keys of the cases that the next run has; those accepted as absent are left out otherwise.
        """
        again = set(returned)
        rows = [row for key, row in self.rows("results").items() if row["outcome"] != ABSENT or key in again]
        rows = [
            {**row, "outcome": "ok"} if row["outcome"] == ABSENT and _measures(row) else row for row in rows
        ]
        others = {name: list(self.rows(name).values()) for name in _KEYS if name != "results"}
        return replace(run.with_rows(**others), cases=tuple(map(case_of, rows)))

    def renamed(self, names: Mapping[str, str]) -> Levels:
        """Return the levels with engines renamed."""

        def rows(table: Mapping[_Key, _Row]) -> list[_Row]:
            return [{**row, "engine": names.get(row["engine"], row["engine"])} for row in table.values()]

        return Levels(
            {name: _by_key(name, rows(table)) for name, table in self.tables.items()},
            {key._replace(engine=names.get(key.engine, key.engine)): s for key, s in self.settings.items()},
        )

    @property
    def engines(self) -> tuple[str, ...]:
        """The engines that have levels."""
        return tuple(dict.fromkeys(row["engine"] for row in self.rows("results").values()))


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
            quantity = change.quantity.removeprefix(f"{change.kind} of ")
            return "methods", (*study, quantity), _columns("methods", "quantity", *others)
        case "stability":
            return "stability", study, _columns("stability")
        case "fingerprint":
            return "fingerprints", (change.engine, change.method), _columns("fingerprints")
        case "law":
            law = change.quantity.removeprefix("law ")
            return "laws", (change.engine, change.method, law), _columns("laws", "law")
        case _:
            return "", (), ()


def _columns(table: str, *others: str) -> tuple[str, ...]:
    """Return the columns of a table without those that identify a row, and without some others."""
    return tuple(name for name in TABLES[table].columns if name not in ("run_id", *IDENTITY, *others))


_KEYS: dict[str, Callable[[Cells], _Key]] = {
    "results": case_key,
    "methods": lambda row: (*study_key(row), row["quantity"]),
    "stability": study_key,
    "fingerprints": key_of,
    "laws": lambda row: (*key_of(row), row["law"]),
}
"""The tables that have levels, and what identifies a row of each."""

_WORDS = {"fingerprints": "fingerprint", "laws": "verdict"}


def _by_key(table: str, rows: Iterable[_Row]) -> dict[_Key, _Row]:
    """Return the rows of a table by their keys; a map or a law that was not measured has no level."""
    word = _WORDS.get(table, "")
    return {_KEYS[table](row): row for row in rows if row.get(word) not in NOT_MEASURED}


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
    own = Levels.of(tables)
    if not (folder / FOLDER).is_dir():
        path = folder / _FORMER_FILE
        rows = _read("results", path) if path.exists() else []
        former = {case_key(row): {**row, "outcome": ABSENT} for row in rows}
        for key, row in own.rows("results").items():
            former[key] = {**former[key], "outcome": row["outcome"]} if key in former else row
        return replace(own, tables={**own.tables, "results": former})
    found = dict(own.tables)
    for name in _KEYS:
        path = folder / FOLDER / f"{name}.csv"
        if TABLES[name].in_every_run or path.exists():
            found[name] = _by_key(name, _read(name, path))
    return Levels(found, dict(_settings(folder / FOLDER / _SETTINGS)))


def _read(table: str, path: Path) -> list[_Row]:
    """Read the rows of a table of levels, which lack commands."""
    kind = TABLES[table]
    return read_rows(path, replace(kind, needed=tuple(name for name in kind.needed if name != "reproduce")))


def settings_of(folder: Path) -> bytes:
    """Return the content of the settings after a nightly run, which changes where a level is set."""
    try:
        with open_input(folder / FOLDER / _SETTINGS) as file:
            return file.read()
    except FileNotFoundError:  # of an earlier version
        return b""


def _settings(path: Path) -> Iterable[tuple[ChangeKey, LevelSource]]:
    for row in read_rows(path, _SETTING_TABLE):
        if row["how"] not in get_args(How):
            raise InputError(f"{path}: unknown how {row['how']!r} (available: {', '.join(get_args(How))})")
        key: dict[str, Any] = {name: row.get(name) for name in ChangeKey._fields}
        yield (
            ChangeKey(**key),
            LevelSource(row["run_id"], row["how"], row.get("acceptance", "")),
        )


def write_levels(levels: Levels, folder: Path) -> None:
    """Write the levels with which the next nightly run is compared, into the folder of a nightly run."""
    place = folder / FOLDER
    place.mkdir()
    settings = (
        {**key._asdict(), "run_id": one.run_id, "how": one.how, "acceptance": one.acceptance or None}
        for key, one in levels.settings.items()
    )
    for name in _KEYS:
        (place / f"{name}.csv").write_bytes(as_csv(as_table(levels.rows(name).values(), TABLES[name])))
    (place / _SETTINGS).write_bytes(as_csv(as_table(settings, _SETTING_TABLE)))
