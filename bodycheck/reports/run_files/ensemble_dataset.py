"""The dataset of an ensemble: Parquet files in hive layout, TABLE/KEY=VALUE/.../part-N.parquet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

SCHEMA_VERSION = 1
"""The column `schema_version` of every table; it changes with the meaning or the name of a column."""

_ROWS = 1 << 17  # per file


@dataclass(frozen=True)
class Part:
    """The folder of some rows of a table: its name, then KEY=VALUE for each partition."""

    folders: tuple[str, ...]

    @classmethod
    def of_method(cls, table: str, engine: str, method: str, setting: str) -> Part:
        """Return the part of a method at a step or tolerance; values are percent-encoded where needed."""
        keys = {"engine": engine, "method": method, "setting": setting}
        return cls((table, *(f"{key}={quote(value, safe='@.+-')}" for key, value in keys.items())))


class Dataset:
    """Collects columns of rows, and writes a file when there are enough."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._waiting: dict[Part, list[Mapping[str, Any]]] = {}
        self._files: dict[Part, int] = {}
        self._connection: DuckDBPyConnection | None = None

    def __enter__(self) -> Dataset:
        import duckdb  # late: only stored datasets need it

        self._connection = duckdb.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._connection is not None
        try:
            if kind is None:
                for part in list(self._waiting):
                    self._write(part)
        finally:
            self._connection.close()

    def add(self, part: Part, columns: Mapping[str, Any]) -> None:
        """Add rows given by their columns, (n,) each."""
        waiting = self._waiting.setdefault(part, [])
        waiting.append(columns)
        if sum(len(next(iter(one.values()))) for one in waiting) >= _ROWS:
            self._write(part)

    def _write(self, part: Part) -> None:
        import pandas as pd

        waiting = self._waiting.pop(part, [])
        if not waiting:
            return
        table = pd.DataFrame({name: _joined([one[name] for one in waiting]) for name in waiting[0]})
        if "schema_version" not in table:
            table.insert(0, "schema_version", SCHEMA_VERSION)
        folder = self._folder.joinpath(*part.folders)
        folder.mkdir(parents=True, exist_ok=True)
        number = self._files.get(part, 0)
        self._files[part] = number + 1
        assert self._connection is not None
        self._connection.from_df(table).write_parquet(str(folder / f"part-{number}.parquet"))


def _joined(pieces: list[Any]) -> Any:
    """Return a column of all pieces; texts as categories, of which an ensemble has few."""
    import pandas as pd

    joined = np.concatenate([np.asarray(piece) for piece in pieces])
    return joined if joined.dtype.kind in "fiub" else pd.Categorical(joined.astype(str))
