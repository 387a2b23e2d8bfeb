"""Tables of text: CSV, and what other programs write instead: semicolons, blanks, comments, no header."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import number_of
from bodycheck.recordings.recording import Recording
from bodycheck.recordings.resolution import iso_seconds

_COMMENTS = (b"#", b"%")
_BLANKS = r"\s+"
_SEPARATORS = ("\t", ";", ",")
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]+)?")
_HEAD_BYTES = 1 << 20  # the comments and the header of a file are shorter


@dataclass(frozen=True)
class _Layout:
    """How a table is written.

    names: of the columns. above: lines above the first row of numbers. separator: as pandas takes it.
    comment: the character that begins comments among the rows. decimal: the decimal sign. is_named: whether
    the names are in a header, and not in a comment, which may state something else.
    """

    names: tuple[str, ...]
    above: int
    separator: str
    comment: str | None
    decimal: str
    is_named: bool = True


def read_text_table(path: Path, content: bytes) -> Recording:
    """Return the columns of a table; those of a file without a header are c1, c2, ...

    Raises InputError where the file is not text, or a row has another number of cells.
    """
    import pandas as pd

    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        content = content.decode("utf-16", errors="replace").encode()
    content = content.removeprefix(b"\xef\xbb\xbf")
    if b"\0" in content:
        raise InputError(f"{path}: is not text")
    layout = _layout(path, content)
    options: dict[str, Any] = {
        "header": None,
        "names": range(len(layout.names)),
        "skiprows": layout.above,
        "sep": layout.separator,
        "comment": layout.comment,
        "decimal": layout.decimal,
        "skipinitialspace": True,
        "index_col": False,
        "keep_default_na": False,
        "na_values": ["nan", "NaN"],
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # a row of the wrong width
            table = pd.read_csv(io.BytesIO(content), low_memory=False, **options)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: has no rows") from None
    except pd.errors.ParserWarning:
        raise InputError(f"{path}: a row has more cells than there are columns") from None
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}: is not a table: {' '.join(str(error).split())}") from None
    columns: dict[str, Any] = {}
    faults: dict[str, str] = {}
    for number, name in enumerate(layout.names):
        column = table.iloc[:, number]
        if not columns.setdefault(name, column).equals(column):
            faults[name] = f"has two different columns {name}"

    def text(name: str, rows: int | None = None) -> list[str]:
        number = layout.names.index(name)
        try:
            cells = pd.read_csv(io.BytesIO(content), usecols=[number], dtype=str, nrows=rows, **options)
        except pd.errors.ParserError:
            raise InputError(f"{path}: no row has as many cells as there are columns") from None
        return [str(cell).replace(layout.decimal, ".") for cell in cells.iloc[:, 0]]

    def row_name(row: int) -> str:
        return f"line {_line(content, layout.above, row)}"

    return Recording(path, columns, len(table), row_name, faults, text=text, is_named=layout.is_named)


def _line(content: bytes, above: int, row: int) -> int:
    """Return the number of the line of a row; blank lines and comments are not rows."""
    filled = (
        number
        for number, line in enumerate(content.splitlines(), 1)
        if number > above and not _is_no_row(line)
    )
    return next(islice(filled, row, None))


def _layout(path: Path, content: bytes) -> _Layout:
    """Return how a table is written, from its first lines."""
    lines = content[:_HEAD_BYTES].splitlines(keepends=True)
    above = list(takewhile(_is_no_row, lines))
    comments = [line for line in above if line.strip()]
    number = len(above) + 1
    first, below, *_ = *(line for line in lines[len(above) :] if line.strip()), b"", b""
    head = _decoded(path, first, number)
    if not head.strip():
        raise InputError(f"{path}: has no rows")
    separator = next((one for one in _SEPARATORS if one in head), _BLANKS)
    cells = _split(head, separator)
    row = cells if _is_row(cells, separator) else _split(_decoded(path, below, number + 1), separator)
    decimal = "," if separator == ";" and any(map(_DECIMAL_COMMA.fullmatch, row)) else "."
    start = sum(map(len, above))
    comment = next((one.decode() for one in _COMMENTS if content.find(b"\n" + one, start) > 0), None)
    if not _is_row(cells, separator):
        return _Layout(tuple(cells), number, separator, comment, decimal)
    names = _commented_names(comments, separator, len(cells))
    numbered = tuple(f"c{index}" for index in range(1, len(cells) + 1))
    return _Layout(names or numbered, number - 1, separator, comment, decimal, is_named=False)


def _is_no_row(line: bytes) -> bool:
    return not line.strip() or line.lstrip().startswith(_COMMENTS)


def _decoded(path: Path, line: bytes, number: int) -> str:
    try:
        return line.decode().rstrip("\r\n")
    except UnicodeDecodeError:
        raise InputError(f"{path}: line {number}: is not text in UTF-8") from None


def _split(line: str, separator: str) -> list[str]:
    """Return the cells of one line, without the quotation marks around them."""
    if separator == _BLANKS:
        return line.split()
    import csv

    cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return [cell.strip() for cell in cells]


def _is_row(cells: Sequence[str], separator: str) -> bool:
    """Whether a line has numbers and times only, and no names."""
    return all(
        _is_number(cell.replace(",", ".") if separator == ";" else cell) or iso_seconds(cell) is not None
        for cell in cells
    )


def _is_number(cell: str) -> bool:
    try:
        number_of(cell)
    except ValueError:
        return False
    return True


def _commented_names(comments: Sequence[bytes], separator: str, count: int) -> tuple[str, ...] | None:
    """Return the names in the last comment above the rows, if it has as many as there are columns."""
    last = comments[-1].decode(errors="replace").strip().lstrip("#% ") if comments else ""
    for one in (separator, ",", _BLANKS):
        cells = _split(last, one)
        if len(cells) == count and not any(map(_is_number, cells)):
            return tuple(cells)
    return None
