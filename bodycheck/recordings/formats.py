"""The formats of recordings: tables of text, npz, Parquet, JSON lines, MCAP, messages of CCSDS."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.formatting import suggestion, unread
from bodycheck._util.untrusted import from_outside, open_input, read_bytes
from bodycheck.recordings.aem import BEGINS, read_aem
from bodycheck.recordings.parquet_table import read_parquet_table
from bodycheck.recordings.recording import Recording
from bodycheck.recordings.records import MAX_COLUMNS, columns_of, flat
from bodycheck.recordings.text_table import read_text_table
from bodycheck.reports.run_files.trajectory_files import COLUMNS, MAX_BYTES, read_npz

if TYPE_CHECKING:
    from mcap.reader import McapReader
    from mcap.records import Schema

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
        raise InputError(unread(path, error)) from None
    if not found.rows:
        raise InputError(f"{path}: {next(iter(found.faults.values()), 'has no rows')}")
    if len(found.columns) > MAX_COLUMNS:
        raise InputError(f"{path}: has more than {MAX_COLUMNS} columns")
    return found


def _read_table(path: Path) -> Recording:
    """Return the columns of text; the formats that are read are named where an unknown one is no table."""
    content = read_bytes(path, MAX_BYTES, from_shell=True)
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
                    found = flat(record) if isinstance(record, dict) else None
                except RecursionError:
                    raise InputError(f"{path}: line {number}: is nested too deeply") from None
                except json.JSONDecodeError as error:
                    why = f"{error.msg}: column {error.colno}"
                    raise InputError(f"{path}: line {number}: is not JSON: {why}") from None
                except ValueError as error:
                    raise InputError(f"{path}: line {number}: is not JSON: {error}") from None
                if found is None:
                    raise InputError(f'{path}: line {number}: is not a JSON object, like {{"t_s": 0.0}}')
                numbers.append(number)
                yield found

    columns = columns_of(path, records())
    return Recording(path, columns, len(numbers), lambda row: f"line {numbers[row]}")


def _written(text: str) -> Decimal | float:
    """Return a number of JSON as it is written, but for one that no decimal can hold."""
    try:
        return Decimal(text)
    except ArithmeticError:
        return float(text)


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
        columns = columns_of(path, _messages(path, reader, chosen))
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
        yield {**flat(content), **_stamps(content), f"log_time{_STAMP}": message.log_time}


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
    ".parquet": read_parquet_table,
    ".jsonl": _read_json_lines,
    ".ndjson": _read_json_lines,
    ".json": _read_json_lines,
}
