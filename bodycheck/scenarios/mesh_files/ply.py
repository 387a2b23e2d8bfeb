"""PLY, ASCII and binary of either byte order: a header that describes elements, then their rows.

Source: Turk (1994), The PLY polygon file format.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.words import fans, floats, integer, lines_of_words, shown

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

Columns: TypeAlias = dict[str, Sequence[Any] | NDArray[Any]]
"""Property -> its value in each row; of a list, one sequence a row."""


@dataclass(frozen=True)
class _Property:
    """A number a row, or a list of them with its length before it."""

    name: str
    item: str
    length: str | None


@dataclass
class _Element:
    """What the header says of one kind of rows."""

    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def parse_ply(data: bytes) -> tuple[Array, Triangles]:
    """Return vertices (n, 3) and triangles (m, 3). Raises ValueError saying where and what is wrong.

    The vertices are the x, y, z of element `vertex`, the faces the list `vertex_indices` (or `vertex_index`)
    of element `face`; everything else is skipped.
    """
    header, end, body = data.partition(b"end_header")
    rest_of_line, _, body = body.partition(b"\n")
    if not data.startswith(b"ply") or not end or rest_of_line.strip():
        raise ValueError("is no PLY: it lacks 'ply' at its start or the line 'end_header'")
    byte_order, elements = _parse_header(header)
    if byte_order:
        tables = _binary_tables(elements, body, byte_order)
    else:
        tables = _ascii_tables(elements, body, first_line=header.count(b"\n") + 2)
    vertices = _vertices(tables.get("vertex", {}))
    return vertices, _triangles(tables.get("face", {}), len(vertices))


def _parse_header(header: bytes) -> tuple[str, list[_Element]]:
    """Return the byte order ('' for ASCII) and the elements in their order."""
    byte_order: str | None = None
    elements: list[_Element] = []
    for line, words in lines_of_words(header):
        match words:
            case ["ply"] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, "1.0"] if kind in _BYTE_ORDERS:
                byte_order = _BYTE_ORDERS[kind]
            case ["element", name, count] if name not in {element.name for element in elements}:
                elements.append(_Element(name, _length(integer(count, line), f"line {line}")))
            case ["property", *kinds, name] if elements and name not in _names(elements[-1]):
                elements[-1].properties.append(_property(name, kinds, line))
            case _:
                raise ValueError(f"line {line}: {shown(words)} is out of place in a PLY header")
    if byte_order is None:
        raise ValueError("the header says no format")
    return byte_order, elements


def _names(element: _Element) -> set[str]:
    return {known.name for known in element.properties}


def _property(name: str, kinds: Sequence[str], line: int) -> _Property:
    """Return a property from its name and the words of its type."""
    corners = name in _CORNERS
    match [_TYPES.get(kind, kind) for kind in kinds]:
        case ["list", length, item] if length in _INTEGERS and item in (
            _INTEGERS if corners else _TYPES.values()
        ):
            return _Property(name, item, length)
        case [item] if item in _TYPES.values() and not corners:
            return _Property(name, item, None)
    raise ValueError(f"line {line}: {shown(kinds)} is no type of a property {name!r}")


def _length(number: int, where: str) -> int:
    """Return a count or the length of a list, unless it is negative."""
    if number < 0:
        raise ValueError(f"{where}: {number} is no count")
    return number


def _ascii_tables(elements: Sequence[_Element], body: bytes, first_line: int) -> dict[str, Columns]:
    """Return the columns of each element, one line of the body a row."""
    lines = lines_of_words(body, first_line)
    tables: dict[str, Columns] = {}
    for element in elements:
        rows = [_ascii_row(element, words, line) for line, words in islice(lines, element.count)]
        if len(rows) < element.count:
            raise ValueError(f"ends after {len(rows)} of {element.count} rows of element {element.name!r}")
        tables[element.name] = _columns(element, rows)
    return tables


def _ascii_row(element: _Element, words: list[str], line: int) -> list[Any]:
    """Return the value of each property in a line."""
    row: list[Any] = []
    at = 0
    for known in element.properties:
        count = 1
        if known.length is not None:
            count = _length(integer(words[at], line), f"line {line}") if at < len(words) else 1
            at += 1
        taken = words[at : at + count]
        if len(taken) < count:
            raise ValueError(f"line {line}: {shown(words)} ends within {known.name!r}")
        at += count
        numbers = [integer(word, line) for word in taken] if known.item in _INTEGERS else floats(taken, line)
        row.append(numbers[0] if known.length is None else numbers)
    if at < len(words):
        raise ValueError(f"line {line}: {shown(words)} goes on after its last property")
    return row


def _binary_tables(elements: Sequence[_Element], body: bytes, byte_order: str) -> dict[str, Columns]:
    """Return the columns of each element, row upon row without gaps."""
    tables: dict[str, Columns] = {}
    offset = 0
    for element in elements:
        least = element.count * sum(
            np.dtype(known.length or known.item).itemsize for known in element.properties
        )
        if least > len(body) - offset or (element.count and not element.properties):
            raise ValueError(
                f"element {element.name!r} has {element.count} rows of at least {least} bytes in all, "
                f"but {len(body) - offset} are left"
            )
        if element.count:
            tables[element.name], offset = _binary_columns(element, body, offset, byte_order)
    return tables


def _binary_columns(element: _Element, body: bytes, offset: int, byte_order: str) -> tuple[Columns, int]:
    """Return an element's columns and where they end: at once where all rows are as long as the first."""
    first, _ = _binary_row(element, body, offset, byte_order)
    fields: list[Any] = []
    for known, value in zip(element.properties, first, strict=True):
        if known.length is not None:
            fields.append((f"length of {known.name}", byte_order + known.length))
        fields.append((known.name, byte_order + known.item, np.shape(value)))
    layout = np.dtype(fields)
    end = offset + element.count * layout.itemsize
    if end <= len(body):
        table = np.frombuffer(body, layout, element.count, offset)
        lengths = [table[name] for name in layout.names or () if name.startswith("length of ")]
        if all((length == length[0]).all() for length in lengths):
            return {known.name: table[known.name] for known in element.properties}, end
    rows = []
    for _ in range(element.count):
        row, offset = _binary_row(element, body, offset, byte_order)
        rows.append(row)
    return _columns(element, rows), offset


def _binary_row(element: _Element, body: bytes, offset: int, byte_order: str) -> tuple[list[Any], int]:
    """Return the value of each property in the row at an offset, and the offset of the next."""
    row: list[Any] = []
    for known in element.properties:
        count = 1
        if known.length is not None:
            length, offset = _take(body, byte_order + known.length, 1, offset, known.name)
            count = _length(int(length[0]), f"a list {known.name!r}")
        numbers, offset = _take(body, byte_order + known.item, count, offset, known.name)
        row.append(numbers[0] if known.length is None else numbers)
    return row, offset


def _take(body: bytes, code: str, count: int, offset: int, name: str) -> tuple[NDArray[Any], int]:
    """Return `count` numbers at an offset and the offset behind them."""
    end = offset + count * np.dtype(code).itemsize
    if end > len(body):
        raise ValueError(
            f"ends within {name!r}: {count} numbers do not fit the {len(body) - offset} bytes left"
        )
    return np.frombuffer(body, code, count, offset), end


def _columns(element: _Element, rows: Sequence[Sequence[Any]]) -> Columns:
    """Return rows as columns by name."""
    columns = zip(*rows, strict=True) if rows else ([] for _ in element.properties)
    return {known.name: list(column) for known, column in zip(element.properties, columns, strict=True)}


def _vertices(table: Columns) -> Array:
    """Return the vertices (n, 3)."""
    if any(axis not in table or np.ndim(table[axis]) != 1 for axis in _AXES):
        raise ValueError("has no vertices: it lacks the numbers x, y, z of element 'vertex'")
    return np.column_stack([np.asarray(table[axis], dtype=np.float64) for axis in _AXES])


def _triangles(table: Columns, vertices: int) -> Triangles:
    """Return the faces as triangles (m, 3)."""
    polygons = next((table[name] for name in _CORNERS if name in table), ())
    faces = polygons.tolist() if isinstance(polygons, np.ndarray) else [list(polygon) for polygon in polygons]
    for row, face in enumerate(faces):
        if len(face) < 3 or min(face) < 0 or max(face) >= vertices:
            corners = shown(str(corner) for corner in face)
            raise ValueError(
                f"face {row} (the first is 0) has the corners {corners}; there are {vertices} vertices"
            )
    return fans(faces)
