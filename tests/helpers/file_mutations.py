"""Seeded damage to files: within their grammar, so that the first parser accepts it, and byte by byte."""

from __future__ import annotations

import csv
import io
import json
import random
import re
import tempfile
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from bodycheck._util.pinned_libraries import duckdb_connection, read_parquet

Mutation: TypeAlias = Callable[[bytes, random.Random], bytes]
"""Valid content and a random generator -> damaged content."""

NASTY: tuple[Any, ...] = (
    *(0, -1, 1, 2, 10**18, 10**400, -(10**400), 2**63, 0.0, -0.0, 1e308, -1e308, 5e-324, 1e-300),
    *(float("nan"), float("inf"), float("-inf"), True, False, None),
    *(
        "",
        "x",
        "\ud800",
        "\x1b[31mred\x07",
        "a\nb",
        "\x00",
        "..",
        "../../x",
        "'",
        '"',
        "nan",
        "1e5",
        "x" * 5000,
    ),
    *([], {}, [[]], [1.0], [0, 0, 0], [[1, 2], [3]], {"x": 1}, [None], {"": None}, [[[[[[[[1]]]]]]]]),
)


def _nested(depth: int) -> Any:
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all values within plain data."""
    found = [path] if path else []
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in parts:
        found += _places(part, (*path, key))
    return found


def changed(data: Any, dice: random.Random) -> Any:
    """Return plain data with one value replaced, left out, renamed, doubled or moved."""
    data = json.loads(json.dumps(data))
    places = _places(data)
    if not places or dice.random() < 0.02:
        return dice.choice(NASTY)
    # choose the depth first: most values lie deep in a few tables
    depth = dice.choice(sorted({len(place) for place in places}))
    *path, last = dice.choice([place for place in places if len(place) == depth])
    holder = data
    for key in path:
        holder = holder[key]
    match dice.randrange(8):
        case 0:
            del holder[last]
        case 1 if isinstance(holder, dict):
            holder[f"{last}x"] = holder.pop(last)
        case 2:
            holder[last] = [holder[last]]
        case 3 if isinstance(holder, list):
            holder.insert(last, holder[last])
        case 4:
            holder[last] = _nested(dice.choice([10, 100, 300]))
        case 5 if isinstance(holder[last], int | float) and not isinstance(holder[last], bool):
            holder[last] = holder[last] * dice.choice([-1.0, 1.0 + 1e-9, 1e3, 1e-3, 1e300])
        case _:
            holder[last] = dice.choice(NASTY)
    return data


def json_value(content: bytes, dice: random.Random) -> bytes:
    """Change one value of a JSON file."""
    if dice.random() < 0.01:
        return b"[" * 200_000
    return json.dumps(changed(json.loads(content), dice)).encode()


_TOML_VALUES = (
    *(
        "0",
        "-1",
        "1",
        "1e308",
        "-1e308",
        "5e-324",
        "nan",
        "inf",
        "-inf",
        "true",
        '""',
        '"x"',
        '"\\u001b[31m"',
    ),
    *(
        "[]",
        "{}",
        "[1]",
        "[[1, 2], [3]]",
        "[1, 2, 3]",
        "[nan, 0, 0]",
        "{x = 1}",
        "1979-05-27",
        "0x10",
        "9" * 400,
    ),
    *("9" * 400, '"\\u001b[31m"'),
    *("9" * 5000, '"' + "y" * 3000 + '"', "[" * 300 + "]" * 300, "1e-300", '["a", 1]', '"../../etc/passwd"'),
)


def toml_line(content: bytes, dice: random.Random) -> bytes:
    """Change, rename, leave out or double one line of a TOML file."""
    lines = content.decode().splitlines()
    place = dice.randrange(len(lines))
    key, equals, value = lines[place].partition(" = ")
    match dice.randrange(6):
        case 0:
            del lines[place]
        case 1:
            lines.insert(place, lines[place])
        case 2 if equals:
            lines[place] = f"{key}x = {value}"
        case 3 if equals and re.search(r"\d", value):
            number = dice.choice(["0", "-1", "1e308", "nan", "1e-300", "inf", "1e9", "999999999999"])
            lines[place] = (
                f"{key} = {re.sub(r'[-+.0-9e]*[0-9]', lambda _: number, value, count=dice.randint(1, 3))}"
            )
        case _ if equals:
            lines[place] = f"{key} = {dice.choice(_TOML_VALUES)}"
        case _:
            lines.insert(place, f"extra = {dice.choice(_TOML_VALUES)}")
    return ("\n".join(lines) + "\n").encode()


_CELLS = (
    *(
        "",
        "x",
        "nan",
        "inf",
        "-inf",
        "1e308",
        "-1",
        "0",
        "1e999",
        "9" * 400,
        "9" * 5000,
        "1+2j",
        "True",
        "1_0",
        "0x1",
    ),
    *(
        "\x1b[31m",
        "a\nb",
        "'",
        '"',
        "é",
        " ",
        "1e-320",
        "9007199254740993",
        "converges",
        "ok",
        "None",
        "2020-01-01",
    ),
)


def csv_cell(content: bytes, dice: random.Random) -> bytes:
    """Change a cell, a column or a row of a CSV file."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    row = dice.randrange(len(rows))
    column = dice.randrange(len(rows[0]))
    match dice.randrange(10):
        case 0:
            del rows[row]
        case 1:
            rows.insert(row, list(rows[row]))
        case 2:
            rows = [[cell for place, cell in enumerate(line) if place != column] for line in rows]
        case 3:
            rows[0][column] = dice.choice(("x", "", "t_s", "run_id", "\x1b[31m"))
        case 4:
            rows = [[*line, line[column]] for line in rows]
        case 5:
            rows[row] = rows[row][: dice.randrange(len(rows[row]) + 1)]
        case 6:
            dice.shuffle(rows)
        case _:
            rows[max(row, 1) % len(rows)][column] = dice.choice(_CELLS)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def npz_member(content: bytes, dice: random.Random) -> bytes:
    """Change one array of an npz file, its header, or how it is packed."""
    with np.load(io.BytesIO(content)) as stored:
        arrays: dict[str, Any] = {name: stored[name] for name in stored.files}
    name = dice.choice(sorted(arrays))
    values, method, flags, header = arrays[name], zipfile.ZIP_STORED, 0, None
    match dice.randrange(13):
        case 0:
            del arrays[name]
        case 1:
            kinds = ("f4", "f2", "i8", "u1", "c16", "U5", "S5", "?", "M8[s]", "i4,f8", "f16", ">f8")
            with np.errstate(all="ignore"):
                arrays[name] = np.zeros(values.shape, dice.choice(kinds))
        case 2:
            arrays[name] = values[: dice.randrange(len(values))]
        case 3:
            arrays[name] = values.reshape(dice.choice([(-1,), (1, -1), (1, 1, 1, -1), (-1, 1)]))
        case 4:
            flat = values.copy().reshape(-1)
            flat[dice.randrange(flat.size)] = dice.choice([np.nan, np.inf, -np.inf, 1e308, 5e-324, -1.0, 0.0])
            arrays[name] = flat.reshape(values.shape)
        case 5:
            method = dice.choice([zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
        case 6:
            flags = 0x1
        case 7:
            shapes = (
                "(10**12,)",
                "(2**62, 4)",
                "(-1,)",
                "(300_000_000, 3)",
                "(True,)",
                "()",
                "(0,)",
                "(11, 3, 3, 3)",
            )
            header = dice.choice(shapes)
        case 8:
            arrays[f"{name}x"] = arrays.pop(name)
        case 9:
            arrays[name] = np.asfortranarray(values)
        case 10:
            return _bomb(name, dice.choice([3_000_000, 30_000_000]))
        case _:
            arrays[name] = np.array([None, 1.0], dtype=object)
    return _packed(arrays, name, method, flags, header)


def _bomb(name: str, rows: int) -> bytes:
    """Return an npz of a few MB at most that declares, and really contains, this many rows of zeros."""
    whole = io.BytesIO()
    header = io.BytesIO()
    header_text = {"descr": "|u1", "fortran_order": False, "shape": (rows, 3)}
    np.lib.format.write_array_header_1_0(header, header_text)
    with (
        zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(f"{name}.npy", "w") as member,
    ):
        member.write(header.getvalue())
        for _ in range(rows // 1_000_000):
            member.write(bytes(3_000_000))
    return whole.getvalue()


def _packed(arrays: dict[str, Any], odd: str, method: int, flags: int, shape: str | None) -> bytes:
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for name, values in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, values, allow_pickle=True)
            content = member.getvalue()
            if name == odd and shape is not None:
                end = 10 + int.from_bytes(content[8:10], "little")
                header_text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(
                    end - 11
                )[: end - 11]
                content = content[:10] + header_text.encode() + b"\n" + content[end:]
            archive.writestr(f"{name}.npy", content, compress_type=method if name == odd else None)
        if flags:
            archive.NameToInfo[f"{odd}.npy"].flag_bits |= flags
    return whole.getvalue()


def token(content: bytes, dice: random.Random) -> bytes:
    """Change, leave out or double one word of a text, such as an ASCII mesh."""
    words = re.split(rb"(\s+)", content)
    place = dice.randrange(0, len(words), 2)
    nasty = (
        b"nan",
        b"inf",
        b"1e308",
        b"-1",
        b"0",
        b"999999999",
        b"x",
        b"",
        b"1e999",
        b"9" * 400,
        b"\xff",
        b"1/2/3",
    )
    match dice.randrange(4):
        case 0:
            words[place] = b""
        case 1:
            words[place] += b" " + words[place]
        case _:
            words[place] = dice.choice(nasty)
    return b"".join(words)


_TYPES = (
    "VARCHAR",
    "BLOB",
    "FLOAT",
    "BIGINT",
    "BOOLEAN",
    "DOUBLE[]",
    "STRUCT(x DOUBLE)",
    "TIMESTAMP",
    "HUGEINT",
)
_VALUES = (
    *("NULL", "'nan'::DOUBLE", "'inf'::DOUBLE", "1e308", "-1", "0", "'x'", "repeat('x', 5000)"),
    *("'\x1b[31m'", "[1.0]", "{'x': 1.0}", "'2020-01-01'::DATE", "12345678901234567890"),
)


def parquet_column(content: bytes, dice: random.Random) -> bytes:
    """Change a column, a row or the order of a Parquet file; what follows is valid Parquet."""
    with tempfile.TemporaryDirectory() as folder, duckdb_connection() as database:
        path = Path(folder, "table.parquet")
        path.write_bytes(content)
        table = read_parquet(database, path)
        name = dice.choice(table.columns)
        cast = f'TRY_CAST("{name}" AS {dice.choice(_TYPES)}) AS "{name}"'
        value = dice.choice(_VALUES)
        found = {
            0: lambda: table.project(f"* EXCLUDE ({name})" if len(table.columns) > 1 else "1 AS x"),
            1: lambda: table.project(f"* REPLACE ({cast})"),
            2: lambda: table.project(f"* REPLACE ({value} AS {name})"),
            3: lambda: table.project(f"* RENAME ({name} AS {name}x)"),
            4: lambda: table.limit(dice.randrange(3)),
            5: lambda: table.order("random()"),
            6: lambda: table.union(table),
            7: lambda: table.project(f"*, {value} AS more"),
        }[dice.randrange(8)]()
        found.write_parquet(str(Path(folder, "changed.parquet")))
        return Path(folder, "changed.parquet").read_bytes()


def mcap_message(content: bytes, dice: random.Random) -> bytes:
    """Change a message, a stamp, a topic or an encoding in an MCAP file; its records and sums are valid."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    found = [
        (channel.topic, json.loads(message.data), message.log_time)
        for _, channel, message in make_reader(io.BytesIO(content)).iter_messages()
    ]
    place, encoding, schema = dice.randrange(len(found)), "json", b'{"type": "object"}'
    topic, row, stamp = found[place]
    data: dict[int, bytes] = {}
    match dice.randrange(8):
        case 0:
            data[place] = dice.choice([b"", b"{", b"[" * 100_000, b"\xff\xfe", b"null", b'{"a": 1e999}'])
        case 1:
            found[place] = topic, row, dice.choice([0, 1, 2**63, 2**64 - 1])
        case 2:
            found[place] = dice.choice(["", "/other", "\x1b[31m", "x" * 5000]), row, stamp
        case 3:
            encoding = dice.choice(["", "cdr", "protobuf", "\x1b[31m"])
        case 4:
            schema = dice.choice([b"", b"{", b"\xff"])
        case 5:
            found = found[:place]
        case _:
            found[place] = topic, changed(row, dice), stamp
    whole = io.BytesIO()
    writer = Writer(whole, compression=dice.choice(list(CompressionType)))
    writer.start()
    channels: dict[str, int] = {}
    for number, (name, message, at) in enumerate(found):
        if name not in channels:
            kind = writer.register_schema("state", "jsonschema", schema)
            channels[name] = writer.register_channel(name, encoding, kind)
        writer.add_message(channels[name], at, data.get(number, json.dumps(message).encode()), at)
    writer.finish()
    return whole.getvalue()


def any_bytes(content: bytes, dice: random.Random) -> bytes:
    """Flip, cut off, remove, double, insert or replace bytes, whatever the format."""
    place = dice.randrange(len(content) + 1)
    length = dice.choice([1, 1, 4, 16, 200])
    match dice.randrange(7):
        case 0:
            return content[:place]
        case 1:
            return content[:place] + content[place + length :]
        case 2:
            return content[:place] + content[place : place + length] * 2 + content[place + length :]
        case 3:
            return content[:place] + bytes(length) + content[place + length :]
        case 4:
            return content[:place] + dice.randbytes(length) + content[place:]
        case 5:
            return dice.choice([b"", b"\xff\xfe", b"\x00" * 100, b"PK\x03\x04", dice.randbytes(500)])
    flipped = bytearray(content)
    for _ in range(dice.choice([1, 1, 3, 20])):
        if flipped:
            flipped[dice.randrange(len(flipped))] ^= 1 << dice.randrange(8)
    return bytes(flipped)


def passes(kind: str, content: bytes) -> bool:
    """Return whether the first parser of a format accepts the content.

    The parsers are json, tomllib, csv with rows of equal length, the magic of numpy's files, DuckDB's of
    Parquet, and mcap's of records and summary.
    """
    try:
        match kind:
            case "json":
                json.loads(content)
            case "toml":
                tomllib.loads(content.decode())
            case "csv":
                rows = list(csv.reader(io.StringIO(content.decode(), newline=""), strict=True))
                return len({len(row) for row in rows}) == 1
            case "npz":
                with zipfile.ZipFile(io.BytesIO(content)) as archive:
                    for name in archive.namelist():
                        with archive.open(name) as member:
                            np.lib.format.read_magic(member)
            case "parquet":
                with tempfile.NamedTemporaryFile(suffix=".parquet") as file, duckdb_connection() as database:
                    Path(file.name).write_bytes(content)
                    read_parquet(database, Path(file.name))
            case "mcap":
                from mcap.reader import make_reader

                return make_reader(io.BytesIO(content)).get_summary() is not None
            case _:
                return False
    except Exception as error:
        if kind in ("parquet", "mcap"):
            return False
        if not isinstance(error, _REFUSALS):
            raise
        return False
    return True


_REFUSALS = (
    ValueError,
    RecursionError,
    RuntimeError,
    NotImplementedError,
    OSError,
    csv.Error,
    zipfile.BadZipFile,
)
"""The errors of the parsers in the standard library and numpy."""
