"""PLY, ASCII or binary in either byte order: a header that describes elements, then their rows.

Source: Turk (1994), The PLY polygon file format.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BufferedIOBase, BytesIO, TextIOWrapper
from itertools import islice
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.formatting import count
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mesh_files.polygons import Polygons
from bodycheck.scenarios.mesh_files.text_formats import (
    encoding_notes,
    encoding_of,
    floats,
    integer,
    quoted,
    split_lines,
)

_TYPES = {
    name: code
    for names, code in (
        ("char int8", "i1"),
        ("uchar uint8", "u1"),
        ("short int16", "i2"),
        ("ushort uint16", "u2"),
        ("int int32", "i4"),
        ("uint uint32", "u4"),
        ("float float32", "f4"),
        ("double float64", "f8"),
    )
    for name in names.split()
}
_INTEGERS = {code for code in _TYPES.values() if code[0] in "iu"}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
_AXES = ("x", "y", "z")
_NEEDED = (*_AXES, *_CORNERS)


class _Lists(NamedTuple):
    """The length (k,) of each row's list, and the concatenated numbers of all lists."""

    lengths: NDArray[Any]
    numbers: NDArray[Any]


Columns: TypeAlias = dict[str, NDArray[Any] | _Lists]
"""Property -> its values, one per row."""


@dataclass(frozen=True)
class _Property:
    """A number per row, or a list of numbers preceded by its length."""

    name: str
    item: str
    length: str | None


@dataclass
class _Element:
    """An element of the header: its name, number of rows and properties."""

    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def parse_ply(file: BufferedIOBase) -> Polygons:
    """Return the polygons of a file. Raises ValueError with the position and what is wrong.

    The vertices are the x, y, z of element `vertex`, the faces the list `vertex_indices` (or `vertex_index`)
    of element `face`, and the triangles of the strips in element `tristrips`; all else is skipped.
    """
    encoding = encoding_of(file)
    data = file.read()
    if encoding != "utf-8":
        data = data.decode(encoding, errors="replace").encode()
    header, body = _parts(data)
    byte_order, elements = _parse_header(header)
    if byte_order:
        tables, more = _binary_tables(elements, body, byte_order)
    else:
        first_line = sum(1 for _ in TextIOWrapper(BytesIO(header))) + 1
        tables, more = _ascii_tables(elements, body, first_line)
    vertices = _vertices(tables.get("vertex", {}))
    found = _faces(tables, len(vertices))
    notes = (*encoding_notes(encoding), *([f"ignored: {more} after the last element"] if more else []))
    return Polygons(vertices, found.lengths, found.numbers, notes)


def _parts(data: bytes) -> tuple[bytes, bytes]:
    """Return the header, up to the line end_header, and the bytes after it.

    The first line shows how lines end: after a lone CR, a binary body may begin with the byte of LF.
    """
    ending = rb"\r" if re.match(rb"ply[ \t]*\r(?!\n)", data) else rb"\r?\n"
    end = re.search(rb"[\r\n]end_header[ \t]*" + ending, data)
    if not data.startswith(b"ply") or end is None:
        raise ValueError("not a PLY file: 'ply' at its start or the line 'end_header' is missing")
    return data[: end.end()], data[end.end() :]


def _parse_header(header: bytes) -> tuple[str, list[_Element]]:
    """Return the byte order ('' for ASCII) and the elements in the order of the file."""
    byte_order: str | None = None
    elements: list[_Element] = []
    for line, words in split_lines(BytesIO(header)):
        match words:
            case ["ply"] | ["end_header"] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, "1.0"] if kind in _BYTE_ORDERS:
                byte_order = _BYTE_ORDERS[kind]
            case ["element", name, count] if name not in {element.name for element in elements}:
                elements.append(_Element(name, _length(integer(count, line), f"line {line}")))
            case ["property", *kinds, name] if elements and name not in _names(elements[-1]):
                elements[-1].properties.append(_property(name, kinds, line))
            case _:
                raise ValueError(f"line {line}: {quoted(words)} is out of place in a PLY header")
    if byte_order is None:
        raise ValueError("the header has no format line")
    return byte_order, elements


def _names(element: _Element) -> set[str]:
    return {known.name for known in element.properties}


def _property(name: str, kinds: Sequence[str], line: int) -> _Property:
    """Return the property with this name and the words of its type."""
    corners = name in _CORNERS
    match [_TYPES.get(kind, kind) for kind in kinds]:
        case ["list", length, item] if length in _INTEGERS and item in (
            _INTEGERS if corners else _TYPES.values()
        ):
            return _Property(name, item, length)
        case [item] if item in _TYPES.values() and not corners:
            return _Property(name, item, None)
    raise ValueError(f"line {line}: {quoted(kinds)} is not a valid type of property {name!r}")


def _length(number: int, where: str) -> int:
    """Return a count or the length of a list; raises ValueError if it is negative."""
    if number < 0:
        raise ValueError(f"{where}: a count cannot be {number}")
    return number


class _Rows:
    """Collects the needed properties of an element's rows."""

    def __init__(self, element: _Element) -> None:
        self._needed = [known for known in element.properties if known.name in _NEEDED]
        self._numbers = {known.name: array("q" if known.item in _INTEGERS else "d") for known in self._needed}
        self._lengths = {known.name: array("q") for known in self._needed if known.length is not None}

    def add(self, row: dict[str, Sequence[Any]]) -> None:
        """Add a row: property -> its numbers."""
        for known in self._needed:
            self._numbers[known.name].extend(row[known.name])
            if known.length is not None:
                self._lengths[known.name].append(len(row[known.name]))

    def columns(self) -> Columns:
        """Return the rows as columns."""
        numbers = {name: np.asarray(column) for name, column in self._numbers.items()}
        lists = {name: _Lists(np.asarray(each), numbers[name]) for name, each in self._lengths.items()}
        return {**numbers, **lists}


def _ascii_tables(
    elements: Sequence[_Element], body: bytes, first_line: int
) -> tuple[dict[str, Columns], str]:
    """Return the columns of each element, and what follows the last; each line of the body is a row."""
    lines = split_lines(BytesIO(body), first_line)
    tables: dict[str, Columns] = {}
    for element in elements:
        rows, read = _Rows(element), 0
        for line, words in islice(lines, element.count):
            rows.add(_ascii_row(element, words, line))
            read += 1
        if read < element.count:
            raise ValueError(f"ends after {read} of {element.count} rows of element {element.name!r}")
        tables[element.name] = rows.columns()
    more = sum(1 for _ in lines)
    return tables, count(more, "line") if more else ""


def _ascii_row(element: _Element, words: list[str], line: int) -> dict[str, Sequence[Any]]:
    """Return property -> its numbers in a line."""
    row: dict[str, Sequence[Any]] = {}
    at = 0
    for known in element.properties:
        amount = 1
        if known.length is not None:
            amount = _length(integer(words[at], line), f"line {line}") if at < len(words) else 1
            at += 1
        items = words[at : at + amount]
        if len(items) < amount:
            raise ValueError(f"line {line}: {quoted(words)} ends within {known.name!r}")
        at += amount
        row[known.name] = (
            [integer(word, line) for word in items] if known.item in _INTEGERS else floats(items, line)
        )
    if at < len(words):
        raise ValueError(f"line {line}: {quoted(words)} continues after its last property")
    return row


def _binary_tables(
    elements: Sequence[_Element], body: bytes, byte_order: str
) -> tuple[dict[str, Columns], str]:
    """Return the columns of each element, whose rows are stored without gaps, and what follows the last."""
    tables: dict[str, Columns] = {}
    offset = 0
    for element in elements:
        min_bytes = element.count * sum(
            np.dtype(known.length or known.item).itemsize for known in element.properties
        )
        if min_bytes > len(body) - offset or (element.count and not element.properties):
            raise ValueError(
                f"element {element.name!r} has {element.count} rows of at least {min_bytes} bytes in total, "
                f"but {len(body) - offset} are left"
            )
        if element.count:
            tables[element.name], offset = _binary_columns(element, body, offset, byte_order)
    more = len(body) - offset
    return tables, count(more, "byte") if more else ""


def _binary_columns(element: _Element, body: bytes, offset: int, byte_order: str) -> tuple[Columns, int]:
    """Return an element's columns and their end; read them at once if all rows are as long as the first."""
    first, _ = _binary_row(element, body, offset, byte_order)
    fields: list[Any] = []
    for known in element.properties:
        if known.length is not None:
            fields.append((f"length of {known.name}", byte_order + known.length))
            fields.append((known.name, byte_order + known.item, len(first[known.name])))
        else:
            fields.append((known.name, byte_order + known.item))
    layout = np.dtype(fields)
    end = offset + element.count * layout.itemsize
    if end <= len(body):
        table = np.frombuffer(body, layout, element.count, offset)
        lengths = {
            known.name: table[f"length of {known.name}"] for known in element.properties if known.length
        }
        if all((length == length[0]).all() for length in lengths.values()):
            return {
                known.name: (
                    _Lists(lengths[known.name], table[known.name].reshape(-1))
                    if known.name in lengths
                    else table[known.name]
                )
                for known in element.properties
                if known.name in _NEEDED
            }, end
    rows = _Rows(element)
    for _ in range(element.count):
        row, offset = _binary_row(element, body, offset, byte_order)
        rows.add(row)
    return rows.columns(), offset


def _binary_row(
    element: _Element, body: bytes, offset: int, byte_order: str
) -> tuple[dict[str, Sequence[Any]], int]:
    """Return the numbers of each property in the row at an offset, and the offset of the next."""
    row: dict[str, Sequence[Any]] = {}
    for known in element.properties:
        count = 1
        if known.length is not None:
            length, offset = _numbers_at(body, byte_order + known.length, 1, offset, known.name)
            count = _length(int(length[0]), f"a list {known.name!r}")
        numbers, offset = _numbers_at(body, byte_order + known.item, count, offset, known.name)
        row[known.name] = numbers.tolist()
    return row, offset


def _numbers_at(body: bytes, code: str, count: int, offset: int, name: str) -> tuple[NDArray[Any], int]:
    """Return `count` numbers at an offset, and the offset after them."""
    end = offset + count * np.dtype(code).itemsize
    if end > len(body):
        raise ValueError(
            f"ends within {name!r}: {count} numbers do not fit the {len(body) - offset} bytes left"
        )
    return np.frombuffer(body, code, count, offset), end


def _vertices(table: Columns) -> Array:
    """Return the vertices (n, 3)."""
    axes = [table.get(axis) for axis in _AXES]
    if any(axis is None or isinstance(axis, _Lists) for axis in axes):
        raise ValueError("has no vertices: it lacks the numbers x, y, z of element 'vertex'")
    return np.column_stack([np.asarray(axis, dtype=np.float64) for axis in axes])


def _faces(tables: dict[str, Columns], vertices: int) -> _Lists:
    """Return the corners of the faces, and of the triangles of all strips."""
    found = [_checked(_corner_lists(tables, "face"), vertices)]
    if "tristrips" in tables:
        found.append(_checked(_strip_triangles(_corner_lists(tables, "tristrips")), vertices))
    return _Lists(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _corner_lists(tables: dict[str, Columns], element: str) -> _Lists:
    table = tables.get(element, {})
    lists = next((table[name] for name in _CORNERS if name in table), None)
    if not isinstance(lists, _Lists):
        return _Lists(np.empty(0, np.int64), np.empty(0, np.int64))
    # unsigned lengths and corners would wrap around where they are subtracted
    return _Lists(lists.lengths.astype(np.int64), lists.numbers)


def _strip_triangles(strips: _Lists) -> _Lists:
    """Return the triangles of strips, in which -1 begins another: each corner forms one with the two before.

    Every second triangle of a strip has the opposite order, so that all face the same side.
    """
    begins = np.cumsum(strips.lengths) - strips.lengths
    corners = np.insert(strips.numbers.astype(np.int64), begins, -1)
    place = np.arange(len(corners))
    in_strip = place - np.maximum.accumulate(np.where(corners == -1, place, 0)) - 1
    last = np.flatnonzero(in_strip >= 2)
    found = corners[last[:, None] - np.array([2, 1, 0])]
    odd = in_strip[last] % 2 == 1
    found[odd] = found[odd][:, [1, 0, 2]]
    bridges = (found == np.roll(found, 1, axis=1)).any(axis=1)  # to the next strip: they have no area
    found = found[~bridges]
    return _Lists(np.full(len(found), 3), found.ravel())


def _checked(lists: _Lists, vertices: int) -> _Lists:
    """Return lists of corners; raises ValueError for too few, or for one that is no vertex."""
    lengths, corners = lists
    wrong = (corners < 0) | (corners >= vertices)
    if wrong.any() or (lengths < 3).any():
        ends = np.cumsum(lengths)
        short = np.flatnonzero(lengths < 3)[:1].tolist()
        out_of_range = np.searchsorted(ends, np.flatnonzero(wrong)[:1], side="right").tolist()
        row = min(short + out_of_range)
        corner_list = quoted(str(corner) for corner in corners[ends[row] - lengths[row] : ends[row]].tolist())
        raise ValueError(
            f"face {row} (the first is 0) has the corners {corner_list}; there are {vertices} vertices"
        )
    return lists
