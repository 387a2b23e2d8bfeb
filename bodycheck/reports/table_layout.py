"""The cells and columns of a table, and their layout on a console of any width.

No character of a cell is left out, except of names, which a narrow console shortens in the middle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import zip_longest
from textwrap import wrap
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

Medium: TypeAlias = Literal["console", "markdown", "page"]
MEDIA: tuple[Medium, ...] = ("console", "markdown", "page")

Kind: TypeAlias = Literal["text", "name", "fixed", "number", "command"]
"""text wraps; name wraps nowhere and may be shortened in the middle; fixed stays whole; number is right-
aligned; command goes below its row where the row has no room for it."""


@dataclass(frozen=True)
class Span:
    """Text with a tint: good, floor, open, bad, fault, none. items: lines that a page shows unfolded."""

    text: str
    tint: str = "none"
    items: tuple[str, ...] = ()


Cell: TypeAlias = str | Span | tuple[Span, ...]


def spans(cell: Cell) -> tuple[Span, ...]:
    """Return the spans of a cell."""
    return (Span(cell),) if isinstance(cell, str) else (cell,) if isinstance(cell, Span) else cell


def plain(cell: Cell) -> str:
    """Return the text of a cell."""
    return "".join(span.text for span in spans(cell))


@dataclass(frozen=True)
class Column:
    """The head of a column and how its cells are laid out."""

    head: str
    kind: Kind = "text"
    only: tuple[Medium, ...] = MEDIA


_LONGEST_ROW = 160  # a longer row is hard to read even where a pipe would take it
_SHORTEST_NAME = 18
_NARROWEST_TEXT = 10
_WIDEST_WORD = 24
_GAP = 2
_STYLES = {"good": "green", "floor": "green", "open": "yellow", "bad": "red", "fault": "red", "none": ""}


def tinted(cell: Cell, *, bold: bool = False) -> Text:
    """Return a cell as text with its tints."""
    from rich.text import Text

    parts = ((span.text, ("bold " if bold else "") + _STYLES[span.tint]) for span in spans(cell))
    return Text.assemble(*((text, style.strip()) for text, style in parts))


def print_command(out: Console, text: str, label: str = "") -> None:
    """Print a line to copy, which is never wrapped; without a label it is indented."""
    before = f"{label}: " if label else "    "
    out.print(tinted(f"{before}{text}"), soft_wrap=True)


def print_table(out: Console, columns: Sequence[Column], rows: Sequence[Sequence[Cell]]) -> None:
    """Print rows under their heads, as wide as the console; commands stand below a row that is too long."""
    commands = [index for index, column in enumerate(columns) if column.kind == "command"]
    below = commands if _total(_longest(columns, rows)) > min(out.width, _LONGEST_ROW) else []
    indices = [index for index in range(len(columns)) if index not in below]
    across = [columns[index] for index in indices]
    cells = [[row[index] for index in indices] for row in rows]
    widths = _widths(across, cells, out.width)
    if widths is not None and any(column.head for column in across):
        _print_row(out, across, [column.head for column in across], widths, bold=True)
    for row, row_cells in zip(rows, cells, strict=True):
        if widths is None:
            _print_stacked(out, across, row_cells)
        else:
            _print_row(out, across, row_cells, widths)
        for index in below:
            print_command(out, plain(row[index]))


def _longest(columns: Sequence[Column], rows: Iterable[Sequence[Cell]]) -> list[int]:
    """Return the longest text of each column, its head included."""
    lines = [[column.head for column in columns], *([plain(cell) for cell in row] for row in rows)]
    return [max(map(len, texts)) for texts in zip(*lines, strict=True)]


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + _GAP * (len(widths) - 1)


def _widths(columns: Sequence[Column], rows: Sequence[Sequence[Cell]], width: int) -> list[int] | None:
    """Return widths that fit: texts and heads wrap, and names are shortened where that saves lines.

    None where nothing fits, or where two names would be shortened to the same text.
    """
    natural = _longest(columns, rows)
    if _total(natural) <= width:
        return natural
    names = [index for index, column in enumerate(columns) if column.kind == "name"]
    short = [min(wide, _SHORTEST_NAME) if index in names else wide for index, wide in enumerate(natural)]
    texts = [[column.head, *(plain(row[index]) for row in rows)] for index, column in enumerate(columns)]
    found = []
    for start in (natural, short):
        if (wrapped := _wrapped(columns, texts, start, width)) is not None:
            widened = _widened(wrapped, natural, names, width)
            if _distinct(rows, names, widened):
                found.append(widened)
    return min(found, key=lambda widths: sum(_heights(texts, widths)), default=None)


def _wrapped(
    columns: Sequence[Column], texts: Sequence[Sequence[str]], start: Sequence[int], width: int
) -> list[int] | None:
    """Return widths of at most `width` together by wrapping texts, with as few lines as possible."""
    found = list(start)
    min_widths = [
        wide if column.kind == "name" else min(wide, _min_width(column, cells))
        for column, cells, wide in zip(columns, texts, start, strict=True)
    ]
    while _total(found) > width:
        free = [index for index in range(len(found)) if found[index] > min_widths[index]]
        if not free:
            return None
        narrower = [[wide - (k == index) for k, wide in enumerate(found)] for index in free]
        found = min(narrower, key=lambda widths: (sum(_heights(texts, widths)), -max(widths)))
    return found


def _widened(widths: Sequence[int], natural: Sequence[int], names: Iterable[int], width: int) -> list[int]:
    """Return widths with the room that is left given to the names."""
    found = list(widths)
    for index in names:
        found[index] += min(natural[index] - found[index], width - _total(found))
    return found


def _heights(texts: Sequence[Sequence[str]], widths: Sequence[int]) -> list[int]:
    """Return the number of lines of each row."""
    columns = ([_height(text, wide) for text in cells] for cells, wide in zip(texts, widths, strict=True))
    return [max(row) for row in zip(*columns, strict=True)]


@cache
def _height(text: str, width: int) -> int:
    return max(1, len(wrap(text, max(width, 1)))) if len(text) > width and " " in text else 1


def _min_width(column: Column, cells: Iterable[str]) -> int:
    """Return the width below which a column would break words or, unless it is text, cells."""
    if column.kind == "text":
        words = [word for cell in cells for word in cell.split()]
        return max(_NARROWEST_TEXT, min(_WIDEST_WORD, max(map(len, words), default=0)))
    _, *others = cells
    return max(map(len, (*column.head.split(), *others)), default=0)


def _distinct(rows: Sequence[Sequence[Cell]], names: Iterable[int], widths: Sequence[int]) -> bool:
    for index in names:
        full_names = {plain(row[index]) for row in rows}
        if len({shortened(name, widths[index]) for name in full_names}) < len(full_names):
            return False
    return True


def shortened(text: str, width: int) -> str:
    """Return text of at most `width` characters, the middle of longer text replaced by dots.

    More is left of the end, by which the methods of an engine differ.
    """
    if len(text) <= width:
        return text
    left = max(0, width - 3)
    head, tail = left // 3, left - left // 3
    return text[:head] + "..."[:width] + (text[-tail:] if tail else "")


def _print_row(
    out: Console,
    columns: Sequence[Column],
    cells: Sequence[Cell],
    widths: Sequence[int],
    *,
    bold: bool = False,
) -> None:
    """Print one row, wrapped within its columns, without trailing blanks."""
    from rich.text import Text

    blocks = []
    for column, cell, width in zip(columns, cells, widths, strict=True):
        cell = shortened(plain(cell), width) if column.kind == "name" else cell
        lines = list(tinted(cell, bold=bold).wrap(out, max(width, 1))) or [Text()]
        for line in lines:
            line.rstrip()
            if column.kind == "number":
                line.pad_left(width - len(line))
        blocks.append(lines)
    for lines_across in zip_longest(*blocks, fillvalue=Text()):
        line_text = Text()
        offset = 0
        for line, width in zip(lines_across, widths, strict=True):
            line_text.append(" " * (offset - len(line_text))).append_text(line)
            offset += width + _GAP
        line_text.rstrip()
        out.print(line_text, soft_wrap=True)


def _print_stacked(out: Console, columns: Sequence[Column], cells: Sequence[Cell]) -> None:
    """Print a row that does not fit: its first cell, and below it the others with their heads."""
    from rich.padding import Padding
    from rich.text import Text

    first, *others = cells
    out.print(tinted(first))
    fields = [
        Text.assemble((f"{column.head} " if column.head else ""), tinted(cell))
        for column, cell in zip(columns[1:], others, strict=True)
        if plain(cell)
    ]
    for line in Text("; ").join(fields).wrap(out, max(out.width - 4, 1)):
        line.rstrip()
        out.print(Padding(line, (0, 0, 0, 4), expand=False))
