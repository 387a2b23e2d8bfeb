"""numba, matplotlib and DuckDB without the settings that they would read from the working directory.

That folder may belong to anybody. The environment and the user's own settings still count.
"""

from __future__ import annotations

import glob
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bodycheck._util.errors import UnavailableError
from bodycheck._util.untrusted import check_regular

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection, DuckDBPyRelation

_NUMBA_FILE, _MATPLOTLIB_FILE = ".numba_config.yaml", "matplotlibrc"


@contextmanager
def _without(file: str) -> Iterator[None]:
    """Make a file of the working directory appear missing to a library that is being imported.

    Neither library has a setting for this, and to change the directory would affect other threads.
    """
    exists = os.path.exists
    os.path.exists = lambda path: path != file and exists(path)
    try:
        yield
    finally:
        os.path.exists = exists


@cache
def numba() -> Any:
    """Import numba; its settings are those of the environment, which are part of a build's identity."""
    with _without(_NUMBA_FILE):
        import numba as found
        from numba.core import config
    config._config_fname = ""  # it is read again whenever something is compiled
    config.reload_config()  # another package may have imported numba before
    return found


@cache
def matplotlib() -> Any:
    """Import matplotlib; raises ImportError if it is not installed."""
    with _without(_MATPLOTLIB_FILE):
        import matplotlib as found
    return found


@cache
def cma() -> Any:
    """Import cma, which imports matplotlib; raises ImportError if it is not installed."""
    with _without(_MATPLOTLIB_FILE):
        import cma as found
    return found


@cache
def duckdb() -> Any:
    """Import DuckDB; raises UnavailableError if it is not installed."""
    try:
        import duckdb as found
    except ImportError:
        raise UnavailableError(
            "histories, ensembles and Parquet files need DuckDB: pip install 'bodycheck[history]'"
        ) from None
    return found


def duckdb_connection() -> DuckDBPyConnection:
    """Return a database in memory that loads no extensions and writes nothing to the working directory.

    Raises UnavailableError without DuckDB.
    """
    settings: dict[str, Any] = {
        "autoinstall_known_extensions": "false",
        "autoload_known_extensions": "false",
        "temp_directory": tempfile.gettempdir(),
        "python_enable_replacements": "false",
    }
    connection: DuckDBPyConnection = duckdb().connect(config=settings)
    return connection


def read_parquet(database: DuckDBPyConnection, path: Path) -> DuckDBPyRelation:
    """Return the rows of a Parquet file; no part of its path is a pattern, a column or an address.

    Raises OSError and InputError as `check_regular` does.
    """
    check_regular(path)
    return database.read_parquet(glob.escape(str(path.absolute())), hive_partitioning=False)


def read_csv(
    database: DuckDBPyConnection, files: Sequence[Path], columns: Mapping[str, str]
) -> DuckDBPyRelation:
    """Return the rows of CSV files of the same columns, given by their types; paths as for `read_parquet`."""
    for file in files:
        check_regular(file)
    return database.read_csv(
        [glob.escape(str(file.absolute())) for file in files],
        columns=dict(columns),
        auto_detect=False,
        header=True,
        sep=",",
        quotechar='"',
        escapechar='"',
        hive_partitioning=False,
    )
