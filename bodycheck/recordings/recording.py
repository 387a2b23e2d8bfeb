"""The columns of a recording, as numbers or as exact stamps."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import number_of, printable
from bodycheck.recordings.resolution import (
    SAMPLES,
    Digits,
    Stamp,
    are_doubles,
    iso_seconds,
    stamp_spacing,
    written_digits,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.trajectory_files import doubles

EXACT = 2**53
"""Every integer up to here is a double."""


@dataclass(frozen=True, eq=False)
class Recording:
    """The columns of a file by name; a column is read as numbers when it is used.

    row_name: row -> what a message calls it, such as "line 2". faults: column -> why it cannot be used.
    metadata: those of them that are no series over time, such as the inertia of the body. text: column -> its
    cells as written, or the first `rows` of them, of a file whose numbers are text. is_named: whether the
    file names its columns.
    described: the map that the file itself states, as in a TOML file.
    """

    path: Path
    columns: Mapping[str, Any]
    rows: int
    row_name: Callable[[int], str] = lambda row: f"row {row + 1}"
    faults: Mapping[str, str] = field(default_factory=dict)
    metadata: Collection[str] = ()
    text: Callable[..., Sequence[str]] | None = None
    is_named: bool = True
    described: Mapping[str, Any] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """The columns, those that cannot be used included."""
        return tuple(dict.fromkeys([*self.columns, *self.faults]))

    def values(self, name: str) -> Array:
        """Return a column (n,) as doubles, times in s since 1970.

        Raises InputError with the first cell that is not a number.
        """
        column, kind = self._column(name)
        try:
            if kind in "fiu":
                return doubles(np.asarray(column), name)
        except ValueError as error:
            raise InputError(f"{self.path}: {error}") from None
        return np.array([self._number(name, row, cell) for row, cell in enumerate(column)])

    def renamed(self, names: Sequence[str]) -> Recording:
        """Return the recording with other names of its columns; raises InputError for too many or too few."""
        if len(names) != len(self.columns):
            count = len(self.columns)
            raise InputError(f"{self.path}: has {count} columns, not {len(names)}: {', '.join(names)}")
        old = dict(zip(names, self.columns, strict=True))
        text = self.text
        return replace(
            self,
            columns={name: self.columns[before] for name, before in old.items()},
            text=None if text is None else lambda name, rows=None: text(old[name], rows),
        )

    def stamps(self, name: str, *, relative: bool) -> tuple[list[Stamp], float]:
        """Return a column of times (n,) exactly, and its resolution.

        Times are integers of any size, decimals, or doubles, also where these are printed in full. relative:
        whether they are used as differences; then doubles leave open what lies between two of them.
        """
        column, kind = self._column(name)
        is_text = kind == "f" and self.text is not None
        cells: Any = self.text(name) if is_text and self.text else column
        exact = [self._exact(name, row, cell) for row, cell in enumerate(cells)]
        as_doubles = are_doubles(exact)
        held: Any = column if kind == "f" and (as_doubles or not is_text) else ()
        if kind == "O":
            held = [cell for cell in column if isinstance(cell, float)]
        spacing = 0.0 if as_doubles else stamp_spacing(exact)
        if len(held):
            doubles_ = np.asarray(held, dtype=np.float64)
            largest = np.max(np.abs(doubles_))
            if as_doubles and np.array_equal(doubles_, doubles_.astype(np.float32)):
                spacing = float(np.spacing(np.float32(largest)))
            elif relative and exact[0] != 0:
                spacing = max(spacing, float(np.spacing(largest)))
        return [Decimal(float(stamp)) for stamp in exact] if as_doubles else exact, spacing

    def written_digits(self, name: str) -> Digits | None:
        """Return how a column is rounded, where the text of its first rows shows it."""
        return None if self.text is None else written_digits(self.text(name, SAMPLES))

    def _column(self, name: str) -> tuple[Any, str]:
        """Return a column and the kind of its type, as NumPy's letter."""
        if name in self.faults:
            raise InputError(f"{self.path}: {self.faults[name]}")
        column = self.columns[name]
        kind = column.dtype.kind if hasattr(column, "dtype") else "O"
        if kind == "b":
            raise InputError(f"{self.path}: {name} has booleans, not numbers")
        return column, kind

    def _number(self, name: str, row: int, cell: Any) -> float:
        if isinstance(cell, str):
            with suppress(ValueError):
                since_1970 = iso_seconds(cell)
                return number_of(cell.strip(" \t")) if since_1970 is None else float(since_1970)
        elif isinstance(cell, int | float | Decimal | np.number) and not isinstance(cell, bool):
            if not isinstance(cell, int) or abs(cell) <= EXACT:
                return float(cell)
            raise InputError(f"{self.path}: {name} has integers above 2^53, which do not fit in doubles")
        raise self._not_a_number(name, row, cell)

    def _exact(self, name: str, row: int, cell: Any) -> Stamp:
        if isinstance(cell, int | np.integer) and not isinstance(cell, bool):
            return int(cell)
        if isinstance(cell, str) and (since_1970 := iso_seconds(cell)) is not None:
            return since_1970
        if isinstance(cell, str | float | Decimal | np.number):
            with suppress(ArithmeticError, ValueError):
                number_of(str(cell).strip(" \t"))
                exact = Decimal(str(cell).strip(" \t"))
                if exact.is_finite():
                    return exact
        raise self._not_a_number(name, row, cell)

    def _not_a_number(self, name: str, row: int, cell: Any) -> InputError:
        found = "missing" if cell is None else repr(cell)
        where = f"{self.path}: {self.row_name(row)}"
        return InputError(f"{where}: {name} is {printable(found, 40)}, not a number")
