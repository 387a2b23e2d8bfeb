"""Query a history in SQL: DuckDB over the Parquet files of its nightly runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import escaped
from bodycheck.reports.history.baseline import told_of

if TYPE_CHECKING:
    import duckdb
    import pandas as pd

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


def recorded_cases(nights: Sequence[Path]) -> pd.DataFrame:
    """Return one row per case that ended well: its run, its identity, its speed and its error.

    nights: folders of nightly runs. Raises InputError if a file cannot be read.
    """
    import pandas as pd

    if not nights:
        return pd.DataFrame(columns=["night", *_CASE])
    with _asking() as database:
        results = database.read_parquet(_files(nights, "results"), union_by_name=True)
        return results.filter("outcome = 'ok'").project(f"run_id AS night, {', '.join(_CASE)}").df()


def query(nights: Sequence[Path], sql: str) -> pd.DataFrame:
    """Run one SQL statement over the views nights, results, methods, stability and changes.

    nights: folders of nightly runs. Raises InputError if the statement is invalid or a file cannot be read.
    """
    with _asking() as database:
        database.register("nights", nights_table(nights))
        for table in TABLES:
            database.read_parquet(_files(nights, table), union_by_name=True).create_view(table)
        found = database.sql(sql)
        if found is None:
            raise InputError(f"{sql}: returns no table; a query must be a SELECT")
        table = found.df()
    for name in table.columns:
        if table[name].dtype == object or str(table[name].dtype) in ("str", "string"):
            table[name] = table[name].map(escaped, na_action="ignore")
    return table


def nights_table(nights: Sequence[Path]) -> pd.DataFrame:
    """Return one row per nightly run: time, machine, engines, number of cases, status and changes."""
    import pandas as pd

    return pd.DataFrame([told_of(night) for night in nights])


def _files(nights: Sequence[Path], table: str) -> list[str]:
    return [str(night / f"{table}.parquet") for night in nights]


@contextmanager
def _asking() -> Iterator[duckdb.DuckDBPyConnection]:
    """Give a database in memory; turn its errors into InputError with one line."""
    import duckdb

    try:
        with duckdb.connect() as database:
            yield database
    except duckdb.Error as error:
        raise InputError(" ".join(str(error).split())) from None
