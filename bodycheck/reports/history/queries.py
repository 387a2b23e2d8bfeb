"""Query a history in SQL: DuckDB over the tables of its nightly runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bodycheck._util.errors import InputError
from bodycheck._util.pinned_libraries import duckdb, duckdb_connection, read_csv
from bodycheck._util.untrusted import escaped
from bodycheck.reports.history.baseline import read_summary
from bodycheck.reports.run_files.tables import EMPTY, TABLES, TableKind, as_table, column_type, open_csv

if TYPE_CHECKING:
    import pandas as pd
    from duckdb import DuckDBPyConnection, DuckDBPyRelation

CHANGES = TableKind(
    name="changes",
    columns=(
        *("run_id", "compared_with", "kind", "status", "scenario", "engine", "method", "control", "fineness"),
        *("quantity", "before", "after", "decades", "id", "since", "runs"),
    ),
    needed=("run_id", "kind", "status"),
    # before and after may be words or numbers
    words=("compared_with", "kind", "status", "before", "after", "id", "since"),
)
"""The changes of a nightly run from its levels."""

QUERIED = {**TABLES, CHANGES.name: CHANGES}
"""The tables of a nightly run, by name; with `nights`, the views of a query."""

_TEXT = "VARCHAR"
_SQL_TYPES = {"integer": "BIGINT", "boolean": "BOOLEAN", "number": "DOUBLE", "string": _TEXT}

_CASE = (
    "scenario",
    "engine",
    "method",
    "control",
    "dt_s",
    "tolerance",
    "relative_cpu",
    "orientation_error_rad",
)


def recorded_cases(runs: Sequence[Path], measures: Iterable[str] = ()) -> pd.DataFrame:
    """Return one row per case that ended well: its run, its identity, its speed and its error.

    runs: folders of nightly runs. measures: further columns, empty if no run has them. Raises InputError if a
    file cannot be read.
    """
    import pandas as pd

    columns = dict.fromkeys((*_CASE, *measures))
    if not runs:
        return pd.DataFrame(columns=["run", *columns])
    with _connection() as database:
        results = _rows(database, runs, "results")
        present = [name for name in columns if name in results.columns]
        found = results.filter("outcome = 'ok'").project(f"run_id AS run, {', '.join(present)}").df()
    return found.reindex(columns=["run", *columns])


def recorded(runs: Sequence[Path], table: str) -> pd.DataFrame:
    """Return the rows of a table of each run, with its run; raises InputError if a file cannot be read."""
    with _connection() as database:
        return _rows(database, runs, table).project("*, run_id AS run").df()


def tables_in(sql: str) -> list[str]:
    """Return the tables that a statement may name: of thousands of runs, reading all takes seconds."""
    return [table for table in QUERIED if table in sql.lower()]


def query(runs: Sequence[Path], sql: str) -> pd.DataFrame:
    """Run one SELECT over the views of QUERIED, and `nights`.

    runs: folders of nightly runs. Raises InputError if the statement is invalid or a file cannot be read.
    """
    with _connection() as database:
        # other statements write files, such as those of the runs
        kinds = [statement.type for statement in database.extract_statements(sql)]
        if kinds != [duckdb().StatementType.SELECT]:
            raise InputError(f"{sql!r}: must be one SELECT")
        if "nights" in sql.lower():
            database.register("nights", history_table(runs))
        for table in tables_in(sql):
            _rows(database, runs, table).create_view(table)
        try:
            table = database.sql(sql).df()
        except duckdb().CatalogException as error:
            unknown = str(error).partition("!")[0]
            if "Table with name" not in unknown:
                raise
            available = ", ".join(("nights", *QUERIED))
            raise InputError(f"{unknown} (available: {available})") from None
    for name in table.columns:
        if table[name].dtype == object or str(table[name].dtype) in ("str", "string"):
            table[name] = table[name].map(escaped, na_action="ignore")
    return table


def history_table(runs: Sequence[Path]) -> pd.DataFrame:
    """Return one row per nightly run: time, machine, engines, number of cases, status and changes."""
    import pandas as pd

    return pd.DataFrame([read_summary(run) for run in runs])


def _rows(database: DuckDBPyConnection, runs: Sequence[Path], table: str) -> DuckDBPyRelation:
    """Return the rows of a table of all runs that have it; columns that some of them lack are empty there."""
    kind = QUERIED[table]
    files: dict[tuple[str, ...], list[Path]] = {}
    for path in (run / f"{table}.csv" for run in runs):
        if path.exists():
            files.setdefault(_head(path), []).append(path)
    if not files:
        return database.from_df(as_table((), kind))
    # union_by_name of DuckDB finds the columns of each file itself, which takes ten times longer
    views = [f"{table}_{number}" for number in range(len(files))]
    for view, (columns, those) in zip(views, files.items(), strict=True):
        types = {name: _sql_type(name, kind) for name in columns}
        rows = read_csv(database, those, types)
        # not by force_not_null: of a query that reads some columns, DuckDB applies it to others
        if texts := [name for name in columns if types[name] == _TEXT and name in EMPTY]:
            filled = ", ".join(f"coalesce({name}, '{EMPTY[name]}') AS {name}" for name in texts)
            rows = rows.project(f"* REPLACE ({filled})")
        rows.create_view(view)
    return database.sql(" UNION ALL BY NAME ".join(f"FROM {view}" for view in views))


def _head(path: Path) -> tuple[str, ...]:
    with open_csv(path) as lines:
        return tuple(next(lines, ()))


def _sql_type(column: str, kind: TableKind) -> str:
    """Return the type of a column in a query; that of a version with other columns is text."""
    return _SQL_TYPES[column_type(column, kind)] if column in kind.columns else _TEXT


@contextmanager
def _connection() -> Iterator[DuckDBPyConnection]:
    """Give a database in memory; turn its errors into InputError with one line."""
    try:
        with duckdb_connection() as database:
            yield database
    except duckdb().Error as error:
        raise InputError(" ".join(str(error).split())) from None
