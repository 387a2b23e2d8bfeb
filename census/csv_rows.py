"""Rows of the census's CSV files as records: one column per field, whole numbers where the field is one."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import asdict, fields
from pathlib import Path
from typing import TypeVar

Row = TypeVar("Row")


def read_rows(path: Path, kind: type[Row]) -> list[Row]:
    """Return the rows of a file; kind: a dataclass of texts and whole numbers."""
    whole = {one.name for one in fields(kind) if one.type == "int"}  # type: ignore[arg-type]
    with path.open(newline="", encoding="utf-8") as file:
        return [
            kind(**{name: int(cell) if name in whole else cell for name, cell in row.items()})
            for row in csv.DictReader(file)
        ]


def write_rows(path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Write rows to a file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [one.name for one in fields(kind)], lineterminator="\n")  # type: ignore[arg-type]
        writer.writeheader()
        writer.writerows(asdict(one) for one in rows)  # type: ignore[call-overload]
