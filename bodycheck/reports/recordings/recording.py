"""The columns of a recording in any format that is read: CSV, npz, Parquet, JSON lines, MCAP."""

from __future__ import annotations

import glob
import io
import json
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.formatting import suggestion
from bodycheck._util.pinned_libraries import duckdb_connection
from bodycheck._util.untrusted import from_outside, printable
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.recordings.resolution import Stamp, are_doubles, stamp_spacing
from bodycheck.reports.run_files.trajectory_files import COLUMNS, MAX_BYTES, doubles, read_npz

if TYPE_CHECKING:
    from mcap.reader import McapReader
    from mcap.records import Schema

_MAX_COLUMNS = 10_000
_DOUBLE_BYTES = 8
_STAMP = " in ns"
_EXACT = 2**53  # every integer up to here is a double


@dataclass(frozen=True, eq=False)
class Recording:
    """The columns of a file by name; a column is read as numbers when it is used.

    row_name: row -> what a message calls it, such as "line 2". faults: column -> why it cannot be used.
    metadata: those of them that are no series over time, such as the inertia of the body. text: column -> its
    cells as written, of a file whose numbers are text.
    """

    path: Path
    columns: Mapping[str, Any]
    rows: int
    row_name: Callable[[int], str] = lambda row: f"row {row + 1}"
    faults: Mapping[str, str] = field(default_factory=dict)
    metadata: Collection[str] = ()
    text: Callable[[str], Sequence[str]] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The columns, those that cannot be used included."""
        return tuple(dict.fromkeys([*self.columns, *self.faults]))

    def values(self, name: str) -> Array:
        """Return a column (n,) as doubles; raises InputError with the first cell that is not a number."""
        column, kind = self._column(name)
        try:
            if kind in "fiu":
                return doubles(np.asarray(column), name)
        except ValueError as error:
            raise InputError(f"{self.path}: {error}") from None
        return np.array([self._number(name, row, cell) for row, cell in enumerate(column)])

    def stamps(self, name: str) -> tuple[list[Stamp], float]:
        """Return a column of times (n,) exactly, and its resolution.

        Times are integers of any size, decimals, or doubles, also where these are printed in full.
        """
        column, kind = self._column(name)
        is_text = kind == "f" and self.text is not None
        cells: Any = self.text(name) if is_text and self.text else column
        exact = [self._exact(name, row, cell) for row, cell in enumerate(cells)]
        as_doubles = are_doubles(exact)
        held: Any = column if kind == "f" and (as_doubles or not is_text) else ()
        if kind == "O":
            held = [cell for cell in column if isinstance(cell, float)]
        as_held = float(np.spacing(np.max(np.abs(held)))) if len(held) else 0.0
        spacing = max(as_held, stamp_spacing(exact))
        return [Decimal(float(stamp)) for stamp in exact] if as_doubles else exact, spacing

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
        if isinstance(cell, str) and "_" not in cell:  # float() takes 1_000
            with suppress(ValueError):
                return float(cell)
        elif isinstance(cell, int | float | Decimal | np.number) and not isinstance(cell, bool):
            if not isinstance(cell, int) or abs(cell) <= _EXACT:
                return float(cell)
            raise InputError(f"{self.path}: {name} has integers above 2^53, which do not fit in doubles")
        raise self._not_a_number(name, row, cell)

    def _exact(self, name: str, row: int, cell: Any) -> Stamp:
        if isinstance(cell, int | np.integer) and not isinstance(cell, bool):
            return int(cell)
        if isinstance(cell, str | float | Decimal | np.number) and "_" not in str(cell):
            with suppress(ArithmeticError):
                exact = Decimal(str(cell).strip())
                if exact.is_finite():
                    return exact
        raise self._not_a_number(name, row, cell)

    def _not_a_number(self, name: str, row: int, cell: Any) -> InputError:
        found = "missing" if cell is None else repr(cell)
        where = f"{self.path}: {self.row_name(row)}"
        return InputError(f"{where}: {name} is {printable(found, 40)}, not a number")


def read_recording(path: Path, topic: str) -> Recording:
    """Return the columns of a file, by its suffix; any other than the known ones is CSV.

    topic: of an MCAP file. Raises InputError with one line that names the file and the fault.
    """
    if topic and path.suffix != ".mcap":
        raise InputError(f"{path}: topic={topic}: only an .mcap file has topics")
    try:
        reader = _READERS.get(path.suffix, _read_csv)
        if reader is not _read_csv:  # which opens the file itself, and only once
            with path.open("rb"):
                pass
        found = _read_mcap(path, topic) if path.suffix == ".mcap" else reader(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not found.rows:
        raise InputError(f"{path}: {next(iter(found.faults.values()), 'has no rows')}")
    if len(found.columns) > _MAX_COLUMNS:
        raise InputError(f"{path}: has more than {_MAX_COLUMNS} columns")
    return found


def _read_csv(path: Path) -> Recording:
    import pandas as pd

    options: dict[str, Any] = {
        "skipinitialspace": True,
        "index_col": False,
        "keep_default_na": False,
        "na_values": ["nan", "NaN"],
        "compression": None,  # do not guess from the file name
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # a row of the wrong width
            content = path.read_bytes()  # once, because it may be a pipe
            table = pd.read_csv(io.BytesIO(content), low_memory=False, **options)
            heads = pd.read_csv(io.BytesIO(content), header=None, nrows=1, dtype=str, **options)
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        raise InputError(f"{path}: not a CSV file: {' '.join(str(error).split())}") from None
    names = [str(head) for head in heads.iloc[0]]
    columns: dict[str, Any] = {}
    faults: dict[str, str] = {}
    for number, name in enumerate(names):
        column = table.iloc[:, number]
        if not columns.setdefault(name, column).equals(column):
            faults[name] = f"has two different columns {name}"

    def text(name: str) -> list[str]:
        cells = pd.read_csv(io.BytesIO(content), usecols=[names.index(name)], dtype=str, **options)
        return list(cells.iloc[:, 0])

    def row_name(row: int) -> str:
        return f"line {_line(content, row + 1)}"

    return Recording(path, columns, len(table), row_name, faults, text=text)


def _line(content: bytes, row: int) -> int:
    """Return the number of the line of a row, 0 for the header; blank lines are not rows."""
    filled = (number for number, line in enumerate(content.splitlines(), 1) if line.strip())
    return next(islice(filled, row, None))


def _read_npz(path: Path) -> Recording:
    """Return the arrays (n,) by name, those of more dimensions by element: "q[0]", "R[0][2]"."""
    faults: dict[str, str] = {}
    columns: dict[str, Any] = {}
    for name, array in read_npz(path, faults=faults).items():
        standard = COLUMNS.get(name, ())
        if array.ndim == 1:
            columns[name] = array
        elif array.ndim > 1 and len(array):
            flat = array.reshape(len(array), -1)
            for index in range(flat.shape[1]):
                names = (_member(name, index, array.shape[1:]), *standard[index : index + 1])
                columns |= dict.fromkeys(names, flat[:, index])
    rows = max(map(len, columns.values()), default=0)
    if rows > 1:  # one value is a constant, such as a mass, and not a quantity over time
        columns = {name: column for name, column in columns.items() if len(column) > 1 or name in COLUMNS}
    short = {name: len(column) for name, column in columns.items() if len(column) < rows}
    faults |= {name: f"{name} has {length} values, not {rows}" for name, length in short.items()}
    return Recording(path, columns, rows, faults=faults, metadata=faults.keys())


def _member(name: str, index: int, shape: tuple[int, ...]) -> str:
    return name + "".join(f"[{i}]" for i in np.unravel_index(index, shape))


def _read_parquet(path: Path) -> Recording:
    import duckdb

    try:
        with duckdb_connection() as database:
            table = database.read_parquet(glob.escape(str(path)))
            nested = [
                name
                for name, kind in zip(table.columns, table.types, strict=True)
                if kind.id in ("list", "array", "struct")
            ]
            ((rows,),) = table.aggregate("count(*)").fetchall()
            if rows * len(table.columns) * _DOUBLE_BYTES > MAX_BYTES:
                raise InputError(f"{path}: has {rows} rows, which exceeds the limit of {MAX_BYTES} bytes")
            columns = {
                name: _plain(table.select(duckdb.ColumnExpression(name)).fetchall())
                for name in table.columns
                if name not in nested
            }
            if nested:
                nested_rows = table.select(*map(duckdb.ColumnExpression, nested)).fetchall()
                records = (dict(zip(nested, row, strict=True)) for row in nested_rows)
                columns |= _columns_of(path, map(_flat, records))
    except (duckdb.Error, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        why = printable(" ".join(str(error).split()), 200)
        raise InputError(f"{path}: not a Parquet file: {why}") from None
    return Recording(path, columns, rows)


def _plain(rows: Sequence[tuple[Any]]) -> Any:
    """Return one column as an array of numbers, or as a list where it has anything else."""
    cells = [cell for (cell,) in rows]
    if all(type(cell) is float for cell in cells):
        return np.array(cells, dtype=np.float64)
    return cells


def _read_json_lines(path: Path) -> Recording:
    numbers: list[int] = []

    def records() -> Iterator[dict[str, Any]]:
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                if not line.strip():
                    continue
                try:
                    text = line.decode("utf-8-sig" if number == 1 else "utf-8")
                    record = json.loads(text, parse_float=_written)
                except RecursionError:
                    raise InputError(f"{path}: line {number}: is nested too deeply") from None
                except json.JSONDecodeError as error:
                    why = f"{error.msg}: column {error.colno}"
                    raise InputError(f"{path}: line {number}: is not JSON: {why}") from None
                except ValueError as error:
                    raise InputError(f"{path}: line {number}: is not JSON: {error}") from None
                if not isinstance(record, dict):
                    raise InputError(f'{path}: line {number}: is not a JSON object, like {{"t_s": 0.0}}')
                numbers.append(number)
                yield _flat(record)

    columns = _columns_of(path, records())
    return Recording(path, columns, len(numbers), lambda row: f"line {numbers[row]}")


def _written(text: str) -> Decimal | float:
    """Return a number of JSON as it is written, but for one that no decimal can hold."""
    try:
        return Decimal(text)
    except ArithmeticError:
        return float(text)


def _flat(record: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return nested objects and lists as one level: "pose.position.x", "q[0]"."""
    found: dict[str, Any] = {}
    for key, value in record.items():
        found |= _flat_value(f"{before}{key}", value)
    return found


def _flat_value(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, Mapping):
        return _flat(value, f"{name}.")
    if isinstance(value, list | tuple):
        found: dict[str, Any] = {}
        for index, part in enumerate(value[: _MAX_COLUMNS + 1]):
            found |= _flat_value(f"{name}[{index}]", part)
        return found
    return {name: value}


def _columns_of(path: Path, records: Iterable[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return records as columns; None where a record lacks one."""
    columns: dict[str, list[Any]] = {}
    count = 0
    for count, record in enumerate(records, 1):
        for name, value in record.items():
            column = columns.setdefault(name, [])
            column += [None] * (count - 1 - len(column))
            column.append(value)
        if len(columns) > _MAX_COLUMNS:
            raise InputError(f"{path}: has more than {_MAX_COLUMNS} columns")
    for column in columns.values():
        column += [None] * (count - len(column))
    return columns


def _read_mcap(path: Path, topic: str) -> Recording:
    """Return the messages of one topic, with log_time_s, and a stamp of sec and nanosec as one time.

    Times are in s since the first message, because nanoseconds since 1970 do not fit in doubles.
    """
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise UnavailableError(
            f"{path}: MCAP needs the package mcap: pip install 'bodycheck[mcap]'"
        ) from None
    with path.open("rb") as file, from_outside(path):
        reader = make_reader(file, validate_crcs=True)
        chosen = _topic_of(path, reader, topic)
        columns = _columns_of(path, _messages(path, reader, chosen))
        for name in [name for name in columns if name.endswith(_STAMP)]:
            columns[name.removesuffix(_STAMP) + "_s"] = _since_first(columns.pop(name))
    return Recording(path, columns, len(columns.get("log_time_s", ())), lambda row: f"message {row + 1}")


def _since_first(stamps: Sequence[int | None]) -> list[Decimal | None]:
    """Return times in s since the first of the times in ns."""
    first = next((stamp for stamp in stamps if stamp is not None), 0)
    return [None if stamp is None else Decimal(stamp - first).scaleb(-9) for stamp in stamps]


def _topic_of(path: Path, reader: McapReader, topic: str) -> str:
    """Return the topic to read; raises InputError where the file does not have it, or has several."""
    summary = reader.get_summary()
    if summary is None:
        raise InputError(f"{path}: has no summary; write it again with `mcap recover`")
    if sum(chunk.uncompressed_size for chunk in summary.chunk_indexes) > MAX_BYTES:
        raise InputError(f"{path}: unpacked, it exceeds the limit of {MAX_BYTES} bytes")
    topics = sorted({channel.topic for channel in summary.channels.values()})
    if topic and topic not in topics:
        raise InputError(f"{path}: topic={topic}: unknown topic{suggestion(topic, topics)}")
    if not topic and len(topics) != 1:
        raise InputError(f"{path}: choose a topic with --map topic=NAME{suggestion('', topics)}")
    return topic or topics[0]


def _messages(path: Path, reader: McapReader, topic: str) -> Iterator[dict[str, Any]]:
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for number, (schema, channel, message) in enumerate(reader.iter_messages(topics=[topic]), 1):
        decode = decoders.get(channel.id)
        if decode is None:
            decode = decoders[channel.id] = _decoder(path, topic, channel.message_encoding, schema)
        content = decode(message.data)
        if not isinstance(content, dict):
            raise InputError(f"{path}: message {number}: is not a JSON object")
        yield {**_flat(content), **_stamps(content), f"log_time{_STAMP}": message.log_time}


def _decoder(path: Path, topic: str, encoding: str, schema: Schema | None) -> Callable[[bytes], Any]:
    """Return what decodes messages; raises InputError for an encoding or a schema that is not read."""
    if encoding == "json":
        return json.loads
    written = "" if schema is None else f" with a schema in {schema.encoding!r}"
    supported = "supported: json; cdr with a schema in 'ros2msg', by the package mcap-ros2-support"
    fault = InputError(f"{path}: topic {topic} has the encoding {encoding!r}{written} ({supported})")
    try:
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise fault from None
    decode = DecoderFactory().decoder_for(encoding, schema)
    if decode is None:
        raise fault
    return lambda data: _as_plain(decode(data))


def _stamps(content: Mapping[str, Any], before: str = "") -> dict[str, int]:
    """Return the times of a message in ns, by name."""
    found: dict[str, int] = {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            found |= _stamps(value, f"{before}{key}.")
            seconds, nanoseconds = value.get("sec"), value.get("nanosec")
            if isinstance(seconds, int) and isinstance(nanoseconds, int):
                found[f"{before}{key}{_STAMP}"] = seconds * 10**9 + nanoseconds
    return found


def _as_plain(value: Any) -> Any:
    """Return a decoded ROS 2 message as mappings and lists."""
    names = getattr(value, "__slots__", None)
    if names is not None:
        return {name: _as_plain(getattr(value, name)) for name in names}
    return [_as_plain(part) for part in value] if isinstance(value, list | tuple) else value


_READERS: dict[str, Callable[[Path], Recording]] = {
    ".npz": _read_npz,
    ".parquet": _read_parquet,
    ".jsonl": _read_json_lines,
    ".ndjson": _read_json_lines,
    ".json": _read_json_lines,
}
