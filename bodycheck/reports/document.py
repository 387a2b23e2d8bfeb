"""What a command answers, as data, and its one renderer: for a console, as Markdown, as HTML and as JSON.

A document is a title and parts in reading order. Each medium shows the same parts; those of `only` are left
to the media that they name. No medium leaves out a character, except of names, which a narrow console
shortens in the middle.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import zip_longest
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

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
class Sentence:
    """One statement; strong: it heads what follows."""

    text: str
    tint: str = "none"
    strong: bool = False
    only: tuple[Medium, ...] = MEDIA


@dataclass(frozen=True)
class Command:
    """A line to copy, for a shell or a program, which is never wrapped; label: what it is for."""

    text: str
    label: str = ""
    only: tuple[Medium, ...] = MEDIA


@dataclass(frozen=True)
class Column:
    """The head of a column and how its cells are laid out."""

    head: str
    kind: Kind = "text"
    only: tuple[Medium, ...] = MEDIA


@dataclass(frozen=True)
class Table:
    """Rows under typed columns; empty heads are not shown.

    max_rows: the largest number of rows on a console and in Markdown. rest: where all of them are. folded:
    Markdown and pages unfold it on request.
    """

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""
    tint: str = "none"
    max_rows: int | None = None
    rest: str = ""
    folded: bool = False
    only: tuple[Medium, ...] = MEDIA

    def on(self, medium: Medium) -> Table:
        """Return the table with the columns for a medium."""
        indices = [index for index, column in enumerate(self.columns) if medium in column.only]
        rows = tuple(tuple(row[index] for index in indices) for row in self.rows)
        return replace(self, columns=tuple(self.columns[index] for index in indices), rows=rows)

    @property
    def heads(self) -> list[str]:
        """The heads of the columns."""
        return [column.head for column in self.columns]

    @property
    def unfolded(self) -> int:
        """The number of rows where a page unfolds all that are folded into one."""
        return sum(max([1, *(len(span.items) for cell in row for span in spans(cell))]) for row in self.rows)

    @property
    def left_out(self) -> int:
        """The number of rows that a console and Markdown leave out."""
        return 0 if self.max_rows is None else max(0, len(self.rows) - self.max_rows)

    @property
    def remark(self) -> str:
        """How many rows are left out, and where they are; "" if none is."""
        return f"and {self.left_out} more lines: {self.rest}" if self.left_out else ""


Part: TypeAlias = Sentence | Command | Table


@dataclass(frozen=True)
class Document:
    """What a command answers; consoles do not show the title, because the command stands above."""

    title: str
    parts: tuple[Part, ...]

    def on(self, medium: Medium) -> list[Part]:
        """Return the parts for a medium; a table without rows is left out everywhere."""
        shown = (part for part in self.parts if medium in part.only)
        return [
            part.on(medium) if isinstance(part, Table) else part
            for part in shown
            if not isinstance(part, Table) or part.rows
        ]


def answer(document: Document, data: Any, *, as_json: bool) -> None:
    """Print a document, or the data behind it, such as a dataclass or a mapping, as JSON."""
    if as_json:
        print(json_text(data))
    else:
        print_document(document)


def json_text(data: Any) -> str:
    """Return dataclasses, mappings, arrays and paths as JSON; null for NaN and infinite numbers."""
    from pydantic_core import to_jsonable_python

    made = to_jsonable_python(data, inf_nan_mode="null", fallback=_jsonable)
    return json.dumps(made, indent=1, allow_nan=False)


def _jsonable(value: Any) -> Any:
    """Return what pydantic does not know, NumPy's numbers and arrays, as plain data."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


# ---------------------------------------------------------------------------------------------- the console

_ENDLESS = 10_000
_LONGEST_ROW = 160  # a longer row is hard to read even where a pipe would take it
_SHORTEST_NAME = 18
_NARROWEST_TEXT = 10
_WIDEST_WORD = 24
_GAP = 2
_STYLES = {"good": "green", "floor": "green", "open": "yellow", "bad": "red", "fault": "red", "none": ""}


def console() -> Console:
    """Return a console on standard output; it wraps lines in a pipe only where COLUMNS is set."""
    from rich.console import Console  # imported here: a document as JSON needs none

    made = Console(highlight=False)
    if not made.is_terminal and not os.environ.get("COLUMNS"):
        made.width = _ENDLESS
    return made


def print_document(document: Document) -> None:
    """Print a document on standard output, as wide as the terminal."""
    out = console()
    for index, part in enumerate(document.on("console")):
        match part:
            case Sentence():
                _print_sentence(out, part, first=index == 0)
            case Command():
                _print_command(out, part)
            case Table():
                if part.title:
                    heading = Sentence(part.title, part.tint, strong=True)
                    _print_sentence(out, heading, first=index == 0)
                _print_table(out, part)


def _text(cell: Cell, *, bold: bool = False) -> Text:
    from rich.text import Text

    parts = ((span.text, ("bold " if bold else "") + _STYLES[span.tint]) for span in spans(cell))
    return Text.assemble(*((text, style.strip()) for text, style in parts))


def _print_sentence(out: Console, sentence: Sentence, *, first: bool) -> None:
    if sentence.strong and not first:
        out.print()
    out.print(_text(Span(sentence.text, sentence.tint), bold=sentence.strong))


def _print_command(out: Console, command: Command) -> None:
    before = f"{command.label}: " if command.label else "    "
    out.print(_text(f"{before}{command.text}"), soft_wrap=True)


def _print_table(out: Console, table: Table) -> None:
    rows = table.rows[: table.max_rows]
    commands = [index for index, column in enumerate(table.columns) if column.kind == "command"]
    below = commands if _total(_longest(table.columns, rows)) > min(out.width, _LONGEST_ROW) else []
    indices = [index for index in range(len(table.columns)) if index not in below]
    columns = [table.columns[index] for index in indices]
    cells = [[row[index] for index in indices] for row in rows]
    widths = _widths(columns, cells, out.width)
    if widths is not None and any(column.head for column in columns):
        _print_row(out, columns, [column.head for column in columns], widths, bold=True)
    for row, row_cells in zip(rows, cells, strict=True):
        if widths is None:
            _print_stacked(out, columns, row_cells)
        else:
            _print_row(out, columns, row_cells, widths)
        for index in below:
            _print_command(out, Command(plain(row[index])))
    if table.remark:
        out.print(_text(table.remark))


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
        lines = list(_text(cell, bold=bold).wrap(out, max(width, 1))) or [Text()]
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
    out.print(_text(first))
    fields = [
        Text.assemble((f"{column.head} " if column.head else ""), _text(cell))
        for column, cell in zip(columns[1:], others, strict=True)
        if plain(cell)
    ]
    for line in Text("; ").join(fields).wrap(out, max(out.width - 4, 1)):
        line.rstrip()
        out.print(Padding(line, (0, 0, 0, 4), expand=False))


# --------------------------------------------------------------------------------------------- Markdown, HTML


def markdown(document: Document) -> str:
    """Return a document as Markdown, for a comment on a pull request."""
    lines = [f"### {escaped_markdown(document.title)}", ""]
    for part in document.on("markdown"):
        match part:
            case Sentence():
                lines.append(f"- {escaped_markdown(part.text)}")
            case Command():
                label = f"{escaped_markdown(part.label)}: " if part.label else ""
                lines.append(f"- {label}`{part.text}`")
            case Table():
                lines += [*[""] * bool(lines[-1]), *_markdown_part(part)]
    return "\n".join(lines) + "\n"


def _markdown_part(table: Table) -> Iterator[str]:
    if table.folded:
        yield from (f"<details><summary>{table.title}</summary>", "")
    elif table.title:
        yield from (f"**{escaped_markdown(table.title)}**", "")
    coded = [column.kind == "command" for column in table.columns]
    yield from markdown_table(
        table.heads,
        [
            [
                f"`{plain(cell)}`" if code and plain(cell) else plain(cell)
                for cell, code in zip(row, coded, strict=True)
            ]
            for row in table.rows[: table.max_rows]
        ],
    )
    if table.remark:
        yield from ("", f"{table.remark}.")
    yield ""
    if table.folded:
        yield from ("</details>", "")


def markdown_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table; what stands in a cell cannot end it."""
    lines = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(escaped_markdown(cell) for cell in line)} |" for line in lines]


def escaped_markdown(text: str) -> str:
    """Return text that Markdown shows as it stands, in one line: no table, tag or mention begins in it."""
    plain = " ".join(text.split())
    if plain.startswith("`") and plain.endswith("`") and "`" not in plain[1:-1]:
        return plain.replace("|", "\\|")
    return re.sub(r"[\\|<*`\[@]|(?<!\w)_|_(?!\w)", r"\\\g<0>", plain)


def page(document: Document, template: str, **others: Any) -> str:
    """Return a document as one self-contained HTML page.

    template: extends document.html by what only this page has, from `others`.
    """
    from bodycheck.reports.templating import environment

    parts = document.on("page")
    return (
        environment()
        .get_template(template)
        .render(
            title=document.title,
            sentences=[part for part in parts if isinstance(part, Sentence)],
            commands=[part for part in parts if isinstance(part, Command)],
            tables=[part for part in parts if isinstance(part, Table)],
            spans=spans,
            **others,
        )
    )
