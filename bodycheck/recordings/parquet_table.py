"""The columns of a Parquet file, whose size in memory is checked before they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.pinned_libraries import duckdb, duckdb_connection, read_parquet
from bodycheck._util.untrusted import from_outside, printable
from bodycheck.recordings.recording import Recording
from bodycheck.recordings.records import columns_of, flat
from bodycheck.reports.run_files.trajectory_files import MAX_BYTES

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

_NESTED = ("list", "array", "struct", "map", "union", "variant")
_DEEPEST = 50
_DOUBLE_BYTES = 8


def read_parquet_table(path: Path) -> Recording:
    """Return the columns of a file; those without parts are read when they are used."""
    with _opened(path) as database:
        table = read_parquet(database, path)
        kinds = dict(zip(table.columns, table.types, strict=True))
        nested = [name for name, kind in kinds.items() if kind.id in _NESTED]
        ((rows,),) = table.aggregate("count(*)").fetchall()
        _check_size(path, table, {name: kinds[name] for name in nested}, rows)
        columns: dict[str, Any] = {}
        if nested:
            nested_rows = table.project(", ".join(map(_quoted, nested))).fetchall()
            records = (dict(zip(nested, row, strict=True)) for row in nested_rows)
            columns = columns_of(path, map(flat, records))
    plain = {name: kind for name, kind in kinds.items() if name not in nested}
    return Recording(path, _ParquetColumns(path, plain, columns, rows), rows)


class _ParquetColumns(Mapping[str, Any]):
    """The columns of a Parquet file: plain ones are read on first use, those of nested ones were read."""

    def __init__(self, path: Path, plain: Mapping[str, Any], nested: Mapping[str, Any], rows: int) -> None:
        self._path, self._plain, self._nested, self._rows = path, plain, nested, rows
        self._read: dict[str, Any] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._plain, *self._nested]))

    def __len__(self) -> int:
        return len(self._plain.keys() | self._nested.keys())

    def __getitem__(self, name: str) -> Any:
        if name not in self._plain:
            return self._nested[name]
        if name not in self._read:
            self._read[name] = self._column(name, self._plain[name])
        return self._read[name]

    def _column(self, name: str, kind: Any) -> Any:
        with _opened(self._path) as database:
            table = read_parquet(database, self._path)
            _check_size(self._path, table, {name: kind}, self._rows)
            column = f"epoch_ns({_quoted(name)})" if kind.id.startswith("timestamp") else _quoted(name)
            rows = table.project(column).fetchall()
        if kind.id.startswith("timestamp"):
            return [ns if ns is None else Decimal(ns).scaleb(-9) for (ns,) in rows]
        return _plain(rows)


@contextmanager
def _opened(path: Path) -> Iterator[DuckDBPyConnection]:
    try:
        with duckdb_connection() as database, from_outside(path):
            database.execute("SET memory_limit = '1GB'")
            yield database
    except InputError as error:
        if isinstance(error.__cause__, duckdb().Error):
            why = printable(" ".join(str(error.__cause__).split()), 200)
            raise InputError(f"{path}: not a Parquet file: {why}") from None
        raise


def _check_size(path: Path, table: Any, kinds: Mapping[str, Any], rows: int) -> None:
    """Raise InputError where these columns exceed the limit as values in memory: packed, they may be tiny."""
    sizes = [_size(_quoted(name), kind) for name, kind in kinds.items()]
    total = rows * _DOUBLE_BYTES * len(kinds)
    if total <= MAX_BYTES and any(size != str(_DOUBLE_BYTES) for size in sizes):
        ((total,),) = table.aggregate(f"coalesce(sum(({' + '.join(sizes)})::HUGEINT), 0)").fetchall()
    if total > MAX_BYTES:
        listed = ", ".join(kinds)
        raise InputError(f"{path}: {listed:.60}: {total} bytes, which exceeds the limit of {MAX_BYTES}")


def _size(value: str, kind: Any, depth: int = 0) -> str:
    """Return an SQL expression of the bytes of a value in memory, by its type."""
    if depth > _DEEPEST:
        raise ValueError("is nested too deeply")
    match kind.id:
        case "varchar":
            return f"coalesce(strlen({value}), 0)"
        case "blob":
            return f"coalesce(octet_length({value}), 0)"
        case "struct":
            fields = [f"struct_extract({value}, {_text(name)})" for name, _ in kind.children]
            sizes = [
                _size(one, child, depth + 1) for one, (_, child) in zip(fields, kind.children, strict=True)
            ]
            return f"({' + '.join(sizes)})"
        case "list" | "array":
            child = dict(kind.children)["child"]
            return _size_of_list(f"{value}::{child}[]", child, depth)
        case "map":
            types = dict(kind.children)
            keys = _size_of_list(f"map_keys({value})", types["key"], depth)
            return f"({keys} + {_size_of_list(f'map_values({value})', types['value'], depth)})"
    return str(_DOUBLE_BYTES)


def _size_of_list(values: str, kind: Any, depth: int) -> str:
    element = f"x{depth}"
    inner = _size(element, kind, depth + 1)
    return f"coalesce(list_sum(list_transform({values}, lambda {element}: {inner})), 0)"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _text(name: str) -> str:
    return "'" + name.replace("'", "''") + "'"


def _plain(rows: Sequence[tuple[Any]]) -> Any:
    """Return one column as an array of numbers, or as a list where it has anything else."""
    cells = [cell for (cell,) in rows]
    if all(type(cell) is float for cell in cells):
        return np.array(cells, dtype=np.float64)
    return cells
