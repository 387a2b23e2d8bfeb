"""The formats of recordings: tables of text, npz, Parquet, JSON lines, MCAP, messages of CCSDS."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.formatting import suggestion
from bodycheck._util.pinned_libraries import duckdb_connection, read_parquet
from bodycheck._util.untrusted import check_regular, from_outside, open_input, read_bytes
from bodycheck.reports.recordings.aem import BEGINS, read_aem
from bodycheck.reports.recordings.recording import Recording
from bodycheck.reports.recordings.text_table import read_text_table
from bodycheck.reports.run_files.trajectory_files import COLUMNS, MAX_BYTES, read_npz

if TYPE_CHECKING:
    from mcap.reader import McapReader
    from mcap.records import Schema

_MAX_COLUMNS = 10_000
_DOUBLE_BYTES = 8
_STAMP = " in ns"
_TABLES = (".csv", ".tsv", ".txt", ".dat", "")


def read_recording(path: Path, topic: str) -> Recording:
    """Return the columns of a file, by its suffix; one with another than the known ones is read as a table.

    topic: of an MCAP file. Raises InputError with one line that names the file and the fault.
    """
    if topic and path.suffix != ".mcap":
        raise InputError(f"{path}: topic={topic}: only an .mcap file has topics")
    try:
        reader = _READERS.get(path.suffix, _read_table)
        if reader is not _read_table:  # which opens the file itself, and only once
            with open_input(path, MAX_BYTES):
                pass
        found = _read_mcap(path, topic) if path.suffix == ".mcap" else reader(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not found.rows:
        raise InputError(f"{path}: {next(iter(found.faults.values()), 'has no rows')}")
    if len(found.columns) > _MAX_COLUMNS:
        raise InputError(f"{path}: has more than {_MAX_COLUMNS} columns")
    return found


def _read_table(path: Path) -> Recording:
    """Return the columns of text; the formats that are read are named where an unknown one is no table."""
    content = read_bytes(path, MAX_BYTES)
    try:
        return read_aem(path, content) if content.startswith(BEGINS) else read_text_table(path, content)
    except InputError as error:
        if path.suffix.lower() in _TABLES or content.startswith(BEGINS):
            raise
        raise InputError(f"{error}; {path.suffix} is not a known format; known: {FORMATS}") from None


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
    """Return the columns of a file; those without parts are read when they are used."""
    check_regular(path)
    with from_outside(path), duckdb_connection() as database:
        table = read_parquet(database, [path])
        kinds = dict(zip(table.columns, table.types, strict=True))
        nested = [name for name, kind in kinds.items() if kind.id in _NESTED]
        ((rows,),) = table.aggregate("count(*)").fetchall()
        _check_size(path, table, {name: kinds[name] for name in nested}, rows)
        columns: dict[str, Any] = {}
        if nested:
            nested_rows = table.select(*map(_quoted_column, nested)).fetchall()
            records = (dict(zip(nested, row, strict=True)) for row in nested_rows)
            columns = _columns_of(path, map(_flat, records))
    plain = {name: kind for name, kind in kinds.items() if name not in nested}
    return Recording(path, _ParquetColumns(path, plain, columns, rows), rows)


_NESTED = ("list", "array", "struct", "map", "union", "variant")


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
        with from_outside(self._path), duckdb_connection() as database:
            table = read_parquet(database, [self._path])
            _check_size(self._path, table, {name: kind}, self._rows)
            column = f"epoch_ns({_quoted(name)})" if kind.id.startswith("timestamp") else _quoted(name)
            rows = table.project(column).fetchall()
        if kind.id.startswith("timestamp"):
            return [ns if ns is None else Decimal(ns).scaleb(-9) for (ns,) in rows]
        return _plain(rows)


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
            sizes = [_size(one, child, depth + 1) for one, (_, child) in zip(fields, kind.children, strict=True)]
            return f"({' + '.join(sizes)})"
        case "list" | "array":
            child = dict(kind.children)["child"]
            element = f"x{depth}"
            inner = _size(element, child, depth + 1)
            return f"coalesce(list_sum(list_transform({value}::{child}[], lambda {element}: {inner})), 0)"
        case "map":
            keys, values = f"map_keys({value})", f"map_values({value})"
            types = dict(kind.children)
            both = ((keys, types["key"]), (values, types["value"]))
            sums = []
            for number, (part, child) in enumerate(both):
                element = f"x{depth}_{number}"
                inner = _size(element, child, depth + 1)
                sums.append(f"coalesce(list_sum(list_transform({part}, lambda {element}: {inner})), 0)")
            return f"({' + '.join(sums)})"
    return str(_DOUBLE_BYTES)


_DEEPEST = 50


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _text(name: str) -> str:
    return "'" + name.replace("'", "''") + "'"


def _quoted_column(name: str) -> Any:
    import duckdb

    return duckdb.ColumnExpression(name)


def _plain(rows: Sequence[tuple[Any]]) -> Any:
    """Return one column as an array of numbers, or as a list where it has anything else."""
    cells = [cell for (cell,) in rows]
    if all(type(cell) is float for cell in cells):
        return np.array(cells, dtype=np.float64)
    return cells


def _read_json_lines(path: Path) -> Recording:
    numbers: list[int] = []

    def records() -> Iterator[dict[str, Any]]:
        with open_input(path, MAX_BYTES) as file:
            for number, line in enumerate(file, 1):
                if not line.strip():
                    continue
                try:
                    text = line.decode("utf-8-sig" if number == 1 else "utf-8")
                    record = json.loads(text, parse_float=_written)
                    flat = _flat(record) if isinstance(record, dict) else None
                except RecursionError:
                    raise InputError(f"{path}: line {number}: is nested too deeply") from None
                except json.JSONDecodeError as error:
                    why = f"{error.msg}: column {error.colno}"
                    raise InputError(f"{path}: line {number}: is not JSON: {why}") from None
                except ValueError as error:
                    raise InputError(f"{path}: line {number}: is not JSON: {error}") from None
                if flat is None:
                    raise InputError(f'{path}: line {number}: is not a JSON object, like {{"t_s": 0.0}}')
                numbers.append(number)
                yield flat

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
            if name not in columns:
                if not _is_text(name):
                    raise InputError(f"{path}: {name!a:.60}: is not Unicode text, and names no column")
                columns[name] = []
            column = columns[name]
            column += [None] * (count - 1 - len(column))
            column.append(value)
        if len(columns) > _MAX_COLUMNS:
            raise InputError(f"{path}: has more than {_MAX_COLUMNS} columns")
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
    with open_input(path, MAX_BYTES) as file, from_outside(path):
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


FORMATS = (
    "tables of text (.csv, .tsv, .txt), .npz, .parquet, JSON lines (.jsonl, .ndjson, .json), .mcap, and "
    "attitude ephemeris messages of CCSDS (.aem)"
)
"""What can be read."""

_READERS: dict[str, Callable[[Path], Recording]] = {
    ".npz": _read_npz,
    ".parquet": _read_parquet,
    ".jsonl": _read_json_lines,
    ".ndjson": _read_json_lines,
    ".json": _read_json_lines,
}
