"""Tables of a run as CSV, JSON, Markdown or Parquet, with numbers in full precision."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck.reports.document import markdown_table

if TYPE_CHECKING:
    import pandas as pd


def as_csv(table: pd.DataFrame) -> bytes:
    """Return a header and one line per row; what was not measured is empty."""
    return table.to_csv(index=False).encode()


def as_json(table: pd.DataFrame) -> bytes:
    """Return a list with one object per row; what was not measured is null."""
    return (json.dumps(_rows(table), indent=1, allow_nan=False) + "\n").encode()


def as_markdown(table: pd.DataFrame) -> bytes:
    """Return a Markdown table; what was not measured is empty."""
    cells = [["" if cell is None else str(cell) for cell in row.values()] for row in _rows(table)]
    return ("\n".join(markdown_table([str(name) for name in table.columns], cells)) + "\n").encode()


def as_parquet(table: pd.DataFrame) -> bytes:
    """Return a Parquet file with the table's own types; what was not measured is null.

    It is written by DuckDB, which also reads and queries a history, so pyarrow is not required.
    """
    import duckdb

    # the type of an empty text column cannot be inferred
    texts = {name: "string" for name in table.columns if table[name].dtype == object}
    with tempfile.TemporaryDirectory() as folder, duckdb.connect() as database:
        path = Path(folder, "table.parquet")
        database.from_df(table.astype(texts)).write_parquet(str(path))
        return path.read_bytes()


FORMATS: dict[str, Callable[[pd.DataFrame], bytes]] = {
    "csv": as_csv,
    "json": as_json,
    "md": as_markdown,
    "parquet": as_parquet,
}


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows: list[dict[Any, Any]] = table.to_dict("records")
    return [{name: _plain(cell) for name, cell in row.items()} for row in rows]


def _plain(cell: Any) -> Any:
    """Return a cell as a JSON value: null for a missing value, text for what JSON cannot represent."""
    import pandas as pd

    match cell:
        case np.ndarray():  # a list column of a query
            return _plain(cell.tolist())
        case list():
            return [_plain(part) for part in cell]
        case dict():
            return {name: _plain(part) for name, part in cell.items()}
    if pd.isna(cell):
        return None
    return (
        cell if isinstance(cell, str | int) or (isinstance(cell, float) and np.isfinite(cell)) else str(cell)
    )
