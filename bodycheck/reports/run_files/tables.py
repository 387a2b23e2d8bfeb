"""The tables of a run, each declared once in TABLES; how cells are written and read; formats of tables."""

from __future__ import annotations

import csv
import json
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.pinned_libraries import duckdb_connection
from bodycheck._util.untrusted import escaped, no_formula, open_input
from bodycheck.reports.document import markdown_table
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.case_columns import COLUMNS, Holds
from bodycheck.reports.measurement.measures import IDENTITY, MEASURES
from bodycheck.reports.measurement.study import Study
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.method_words import LAW_VERDICTS, identified

if TYPE_CHECKING:
    import pandas as pd

Row: TypeAlias = dict[str, Any]
"""A row of a table, by column; cells without a value are absent, or None."""


@dataclass(frozen=True, eq=False)
class MeasuredTables:
    """What a run has measured, of which its tables are made.

    cases: with their speeds. studies: of each scenario and method. rows: of the tables that are measured as
    rows, without run_id, by table.
    """

    cases: Sequence[CaseResult]
    studies: Sequence[Study]
    rows: Mapping[str, Sequence[Mapping[str, Any]]]


@dataclass(frozen=True, kw_only=True)
class TableKind:
    """A table: the file NAME.csv, and for one of TABLES an attribute of `Run` and of `Tables` of that name.

    columns: in order. needed: those that every row has. words: those of words that other tables lack; the
    others are numbers. choices: the words that a column may have. intervals: estimates, each with an end _low
    and one _high. in_every_run: False where runs of earlier versions lack the table. made_of: what a run has
    measured -> the rows without run_id [default: those measured by that name].
    """

    name: str
    columns: tuple[str, ...]
    needed: tuple[str, ...]
    words: tuple[str, ...] = ()
    choices: Mapping[str, Collection[str]] = field(default_factory=dict)
    intervals: tuple[str, ...] = ()
    in_every_run: bool = False
    made_of: Callable[[MeasuredTables], Iterable[Mapping[str, Any]]] | None = None

    @property
    def is_of_studies(self) -> bool:
        """Whether a row belongs to a method on a scenario, rather than to a method alone."""
        return "scenario" in self.columns

    def has_words(self, column: str) -> bool:
        """Whether the cells of a column are words, rather than numbers."""
        return column in _TEXTS or column in self.words

    def rows(self, run_id: str, measured: MeasuredTables) -> list[Row]:
        """Return the rows of a run."""
        made = measured.rows.get(self.name, ()) if self.made_of is None else self.made_of(measured)
        return [{"run_id": run_id, **row} for row in made]


_OF_STUDY = ("run_id", "scenario", "engine", "method")
_OF_METHOD = ("run_id", "engine", "method")
_ENDINGS = ("ok", *STATES)


def _holding(holds: Holds) -> tuple[str, ...]:
    """Return the columns of results.csv that hold this."""
    return tuple(column.name for column in COLUMNS if column.holds == holds)


_ALL = (
    TableKind(
        name="results",
        columns=("run_id", *(column.name for column in COLUMNS)),
        needed=(*_OF_STUDY, "control", "outcome", "reproduce"),
        words=_holding("words"),
        choices={"outcome": _ENDINGS},
        intervals=("cpu_s",),
        in_every_run=True,
    ),
    TableKind(
        name="methods",
        columns=(
            "run_id",
            *IDENTITY,
            "quantity",
            "expected_order",
            "order",
            "order_low",
            "order_high",
            "points",
            "floor",
            "finest_dt_s",
            "finest_tolerance",
            "finest_error",
            "best_dt_s",
            "least_error",
            "predicted_floor",
            "measured_floor",
            "limit_distance",
            "limit_uncertainty",
            "usable_dt_s",
            "excluded_dt_s",
            "excluded_error",
            "excluded_ratio",
            "verdict",
            "growth",
            "growth_exponent",
            "growth_exponent_low",
            "growth_exponent_high",
            "fingerprint",
            "replay",
        ),
        needed=(*_OF_STUDY, "quantity", "verdict"),
        words=("growth", "fingerprint", "replay"),
        choices={"verdict": STATES, "quantity": MEASURES},
        intervals=("order", "growth_exponent"),
        in_every_run=True,
        made_of=lambda measured: identified(
            [row for study in measured.studies for row in study.method_rows],
            measured.rows["fingerprints"],
            measured.rows["laws"],
        ),
    ),
    TableKind(
        name="stability",
        columns=(
            *("run_id", *IDENTITY, "dt_stable_s", "dt_unstable_s", "reason", "outcome", "message"),
            *("reused", "build"),
        ),
        needed=(*_OF_STUDY, "outcome"),
        words=("reason",),
        choices={"outcome": _ENDINGS},
        in_every_run=True,
        made_of=lambda measured: [
            study.stability_row for study in measured.studies if study.stability_row is not None
        ],
    ),
    TableKind(
        name="joints",
        columns=(
            *("run_id", *IDENTITY, "dt_s", "tolerance", "body", "unit"),
            *("joint_error", "joint_error_final", "joint_rate_error"),
        ),
        needed=(*_OF_STUDY, "body"),
        words=("body", "unit"),
        made_of=lambda measured: (row for case in measured.cases for row in case.joint_rows),
    ),
    TableKind(
        name="probes",
        columns=(
            *("run_id", "engine", "engine_version", "method"),
            *("check", "measured", "expected", "deviation", "tolerance"),
            *("dt_s", "verdict", "message", "reproduce"),
        ),
        needed=(*_OF_METHOD, "check", "verdict", "reproduce"),
        words=("check",),
    ),
    TableKind(
        name="diagnoses",
        columns=(
            *("run_id", *IDENTITY, "dt_s", "tolerance", "quantity", "verdict", "diagnosis"),
            *("faults", "parameter", "value", "value_low", "value_high", "unit", "share", "alike"),
            *("map", "before", "after", "round_off", "reproduce"),
        ),
        needed=(*_OF_STUDY, "verdict", "diagnosis", "reproduce"),
        words=("diagnosis", "faults", "parameter", "unit", "alike", "map"),
    ),
    TableKind(
        name="fingerprints",
        columns=(
            *("run_id", "engine", "engine_version", "method", "fingerprint"),
            *("agreement", "digits", "runner_up", "runner_up_distance", "position_update"),
            *("local_order", "leading_error", "description", "message", "reproduce"),
        ),
        needed=(*_OF_METHOD, "fingerprint", "reproduce"),
        words=("fingerprint", "runner_up", "position_update", "leading_error", "description"),
    ),
    TableKind(
        name="laws",
        columns=(
            *("run_id", "engine", "engine_version", "method", "law", "verdict"),
            *("size", "tolerance", "quantity", "state", "dt_s", "t_s", "message", "reproduce"),
        ),
        needed=(*_OF_METHOD, "law", "verdict", "reproduce"),
        words=("law", "state"),
        choices={"verdict": LAW_VERDICTS},
    ),
)
TABLES: dict[str, TableKind] = {kind.name: kind for kind in _ALL}
"""The tables of a run, by name: writing, reading, merging, renaming of engines, the Python interface and the
command `table` follow from it."""

_YES_OR_NO = _holding("yes or no")
EMPTY = {"reused": False, "message": ""}
"""What an empty cell stands for, where it is known."""
_WHOLE_NUMBERS = (*_holding("whole number"), "points")
_LARGEST_WHOLE = 2**63 - 1
_TEXTS = frozenset(
    ("run_id", *IDENTITY, "control", "outcome", "message", "reproduce", "build", "quantity", "verdict")
)
"""The columns of words that several tables have."""


def as_table(rows: Iterable[Mapping[str, Any]], kind: TableKind) -> pd.DataFrame:
    """Return the rows as a table with exactly its columns; what was not measured is missing, never 0.

    Raises ValueError where a row has a column that the table does not have.
    """
    import pandas as pd  # imported here: takes a third of a second

    rows = list(rows)
    known = set(kind.columns)
    cells: dict[str, list[Any]] = {column: [EMPTY.get(column)] * len(rows) for column in kind.columns}
    for index, row in enumerate(rows):
        if not row.keys() <= known:
            raise ValueError(f"unknown column {', '.join(sorted(row.keys() - known))}")
        for column, cell in row.items():
            cells[column][index] = cell
    return pd.DataFrame(
        {column: pd.Series(cells[column], dtype=_dtype(column, kind)) for column in kind.columns}
    )


def known_cells(row: Mapping[str, Any]) -> Row:
    """Return the cells of a row that have a value."""
    return {name: cell for name, cell in row.items() if cell is not None and cell == cell}


def column_type(column: str, kind: TableKind) -> str:
    """Return the type of a column as JSON has it: integer, boolean, string or number."""
    return {"Int64": "integer", "bool": "boolean", None: "string"}.get(_dtype(column, kind), "number")


def _dtype(column: str, kind: TableKind) -> str | None:
    """Return the dtype of a column; None where pandas chooses the text type."""
    if column in _WHOLE_NUMBERS:
        return "Int64"
    if column in _YES_OR_NO:
        return "bool"
    return None if kind.has_words(column) else "float64"


def _yes_or_no(cell: str) -> bool:
    if cell not in ("True", "False"):
        raise ValueError(cell)
    return cell == "True"


@contextmanager
def open_csv(path: Path) -> Iterator[Iterator[list[str]]]:
    """Give the lines of a CSV file as their cells; InputError names it where it cannot be read."""
    try:
        with TextIOWrapper(open_input(path), encoding="utf-8", newline="") as file:
            yield csv.reader(file, strict=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a CSV file: {error}") from None


def read_rows(path: Path, kind: TableKind) -> list[Row]:
    """Read the rows of a table of a run, with the types they were written with; empty cells are left out.

    Raises InputError with one line that names the file and the fault.
    """
    with open_csv(path) as lines:
        head = next(lines, [])
        if missing := [name for name in kind.needed if name not in head]:
            raise InputError(f"{path}: not a table of a run: missing column {', '.join(missing)}")
        if unknown := [name for name in head if name not in kind.columns]:
            raise InputError(f"{path}: this version of bodycheck has no column {', '.join(unknown)}")
        readers = [(name, _reader_of(name, kind)) for name in head]
        return [_row(path, number, readers, line, kind.needed) for number, line in enumerate(lines, 1)]


def _reader_of(column: str, kind: TableKind) -> Callable[[str], Any]:
    """Return what reads a cell of a column, and raises ValueError where it does not fit."""
    if column in _YES_OR_NO:
        return _yes_or_no
    if kind.has_words(column):
        return _text
    return _whole_number if column in _WHOLE_NUMBERS else float


def _text(cell: str) -> str:
    return sys.intern(cell if cell.isprintable() else str(escaped(cell)))  # most texts recur in many rows


def _whole_number(cell: str) -> int:
    if abs(integer := int(cell)) > _LARGEST_WHOLE:
        raise ValueError(cell)
    return integer


def _row(
    path: Path,
    number: int,
    columns: Sequence[tuple[str, Callable[[str], Any]]],
    line: list[str],
    needed: tuple[str, ...],
) -> dict[str, Any]:
    if len(line) != len(columns):
        raise InputError(f"{path}: row {number} has {len(line)} cells, not {len(columns)}")
    row: dict[str, Any] = {}
    for (name, read), cell in zip(columns, line, strict=True):
        if cell:
            try:
                row[name] = read(cell)
            except ValueError:
                expected = "True or False" if name in _YES_OR_NO else "a number"
                raise InputError(f"{path}: row {number}: {name} is {cell!r}, not {expected}") from None
    if missing := [name for name in needed if name not in row]:
        raise InputError(f"{path}: row {number} has no {', '.join(missing)}")
    return row


def as_csv(table: pd.DataFrame) -> bytes:
    """Return a header and one line per row; what was not measured is empty, and no cell is a formula."""
    from pandas.api import types as pd_types

    texts = [name for name in table.columns if not pd_types.is_numeric_dtype(table[name])]
    table = table.assign(**{name: table[name].map(no_formula, na_action="ignore") for name in texts})
    return table.rename(columns=no_formula).to_csv(index=False).encode()


def as_json(table: pd.DataFrame) -> bytes:
    """Return a list with one object per row; what was not measured is null."""
    return (json.dumps(_rows(table), indent=1, allow_nan=False) + "\n").encode()


def as_markdown(table: pd.DataFrame) -> bytes:
    """Return a Markdown table; what was not measured is empty."""
    cells = [["" if cell is None else str(cell) for cell in row.values()] for row in _rows(table)]
    return ("\n".join(markdown_table([str(name) for name in table.columns], cells)) + "\n").encode()


def as_parquet(table: pd.DataFrame) -> bytes:
    """Return a Parquet file with the table's own types; what was not measured is null.

    It is written by DuckDB, which also queries a history, so pyarrow is not required.
    """
    # the type of an empty text column cannot be inferred
    texts = {name: "string" for name in table.columns if table[name].dtype == object}
    with tempfile.TemporaryDirectory() as folder, duckdb_connection() as database:
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
