"""Records of names and values as columns: nested ones as one level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bodycheck._util.errors import InputError

MAX_COLUMNS = 10_000
_DEEPEST = 50


def flat(record: Mapping[str, Any], before: str = "", depth: int = 0) -> dict[str, Any]:
    """Return nested objects and lists as one level: "pose.position.x", "q[0]".

    Raises RecursionError for a record that is nested too deeply.
    """
    found: dict[str, Any] = {}
    for key, value in record.items():
        found |= _flat_value(f"{before}{key}", value, depth)
    return found


def _flat_value(name: str, value: Any, depth: int) -> dict[str, Any]:
    if depth > _DEEPEST:
        raise RecursionError(f"{name[:_DEEPEST]}... is nested too deeply")
    if isinstance(value, Mapping):
        return flat(value, f"{name}.", depth + 1)
    if isinstance(value, list | tuple):
        found: dict[str, Any] = {}
        for index, part in enumerate(value[: MAX_COLUMNS + 1]):
            found |= _flat_value(f"{name}[{index}]", part, depth + 1)
        return found
    return {name: value}


def columns_of(path: Path, records: Iterable[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return records as columns; None where a record lacks one."""
    columns: dict[str, list[Any]] = {}
    count = 0
    for count, record in enumerate(records, 1):
        for name, value in record.items():
            if name not in columns:
                if not _is_text(name):
                    raise InputError(f"{path}: {name!a:.60}: is not Unicode text, and names no column")
                columns[name] = []
            column = columns[name]
            column += [None] * (count - 1 - len(column))
            column.append(value)
        if len(columns) > MAX_COLUMNS:
            raise InputError(f"{path}: has more than {MAX_COLUMNS} columns")
    for column in columns.values():
        column += [None] * (count - len(column))
    return columns


def _is_text(name: str) -> bool:
    """Whether a name can be printed: JSON can escape one half of a character."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
