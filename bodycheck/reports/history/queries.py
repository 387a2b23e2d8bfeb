"""Query a history in SQL: DuckDB over the Parquet files of its nightly runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bodycheck._util.errors import InputError
from bodycheck._util.pinned_libraries import duckdb, duckdb_connection, read_parquet
from bodycheck._util.untrusted import escaped
from bodycheck.reports.history.baseline import read_summary

if TYPE_CHECKING:
    import pandas as pd
    from duckdb import DuckDBPyConnection

TABLES = ("results", "methods", "stability", "changes")
"""The tables of each nightly run, as Parquet and CSV; with `nights`, the views of a query."""

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
        results = read_parquet(database, _files(runs, "results"), union_by_name=True)
        present = [name for name in columns if name in results.columns]
        found = results.filter("outcome = 'ok'").project(f"run_id AS run, {', '.join(present)}").df()
    return found.reindex(columns=["run", *columns])


def recorded(runs: Sequence[Path], table: str) -> pd.DataFrame:
    """Return the rows of a table of each run, with its run; raises InputError if a file cannot be read."""
    with _connection() as database:
        rows = read_parquet(database, _files(runs, table), union_by_name=True)
        return rows.project("*, run_id AS run").df()


def tables_in(sql: str) -> list[str]:
    """Return the tables that a statement may name: of thousands of runs, reading all takes seconds."""
    return [table for table in TABLES if table in sql.lower()]


def query(runs: Sequence[Path], sql: str) -> pd.DataFrame:
    """Run one SELECT over the views nights, results, methods, stability and changes.

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
            read_parquet(database, _files(runs, table), union_by_name=True).create_view(table)
        table = database.sql(sql).df()
    for name in table.columns:
        if table[name].dtype == object or str(table[name].dtype) in ("str", "string"):
            table[name] = table[name].map(escaped, na_action="ignore")
    return table


def history_table(runs: Sequence[Path]) -> pd.DataFrame:
    """Return one row per nightly run: time, machine, engines, number of cases, status and changes."""
    import pandas as pd

    return pd.DataFrame([read_summary(run) for run in runs])


def _files(runs: Sequence[Path], table: str) -> list[Path]:
    return [run / f"{table}.parquet" for run in runs]


@contextmanager
def _connection() -> Iterator[DuckDBPyConnection]:
    """Give a database in memory; turn its errors into InputError with one line."""
    try:
        with duckdb_connection() as database:
            yield database
    except duckdb().Error as error:
        raise InputError(" ".join(str(error).split())) from None
