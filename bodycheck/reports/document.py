"""What a command answers, as data, and its one renderer: for a console, as Markdown, as HTML and as JSON.

A document is a title and parts in reading order. Each medium shows the same parts; those of `only` are left
to the media that they name.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, TypeAlias

from bodycheck.reports.table_layout import (
    MEDIA,
    Cell,
    Column,
    Medium,
    Span,
    plain,
    print_command,
    print_table,
    spans,
    tinted,
)

if TYPE_CHECKING:
    from markupsafe import Markup
    from rich.console import Console


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


class DocumentSection:
    """Content below a heading; each kind draws its content in the media of its `only`.

    title: the heading. tint: that of the heading on a console.
    """

    title: str
    tint: str = "none"
    only: tuple[Medium, ...] = MEDIA

    @property
    def is_empty(self) -> bool:
        """Whether nothing stands below the heading; no medium then shows the section."""
        return False

    def on(self, medium: Medium) -> Self:
        """Return the section for a medium."""
        del medium
        return self

    def print_on(self, out: Console) -> None:
        """Print what stands below the heading."""
        raise NotImplementedError

    def markdown(self) -> Iterator[str]:
        """Yield the lines below the heading."""
        raise NotImplementedError

    def html(self) -> Markup:
        """Return what stands below the heading of a page."""
        raise NotImplementedError


@dataclass(frozen=True)
class Table(DocumentSection):
    """Rows under typed columns; empty heads are not shown. Without a title it heads a page.

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

    @property
    def is_empty(self) -> bool:
        """Whether there are no rows."""
        return not self.rows

    def on(self, medium: Medium) -> Self:
        """Return the table with the columns for a medium."""
        indices = [index for index, column in enumerate(self.columns) if medium in column.only]
        rows = tuple(tuple(row[index] for index in indices) for row in self.rows)
        return replace(self, columns=tuple(self.columns[index] for index in indices), rows=rows)

    @property
    def unfolded(self) -> int:
        """The number of rows where a page unfolds all that are folded into one."""
        return sum(max([1, *(len(span.items) for cell in row for span in spans(cell))]) for row in self.rows)

    @property
    def left_out(self) -> int:
        """The number of rows that a console and Markdown leave out."""
        return 0 if self.max_rows is None else max(0, len(self.rows) - self.max_rows)

    @property
    def _remark(self) -> str:
        """How many rows are left out, and where they are; "" if none is."""
        return f"and {self.left_out} more lines: {self.rest}" if self.left_out else ""

    def print_on(self, out: Console) -> None:
        """Print the rows, as many as fit across, and where the rest is."""
        print_table(out, self.columns, self.rows[: self.max_rows])
        if self._remark:
            out.print(tinted(self._remark))

    def markdown(self) -> Iterator[str]:
        """Yield the rows, with commands as code, and where the rest is."""
        coded = [column.kind == "command" for column in self.columns]
        yield from markdown_table(
            [column.head for column in self.columns],
            [
                [
                    f"`{plain(cell)}`" if code and plain(cell) else plain(cell)
                    for cell, code in zip(row, coded, strict=True)
                ]
                for row in self.rows[: self.max_rows]
            ],
        )
        if self._remark:
            yield from ("", f"{self._remark}.")

    def html(self) -> Markup:
        """Return the rows, which a narrow screen stacks."""
        from markupsafe import Markup

        from bodycheck.reports.templating import rendered

        return Markup(rendered("table.html", table=self, spans=spans))


@dataclass(frozen=True)
class Drawing(DocumentSection):
    """A drawing as SVG, for pages; note: what it shows."""

    title: str
    note: str
    drawing: Markup
    only: tuple[Medium, ...] = ("page",)

    @property
    def is_empty(self) -> bool:
        """Whether nothing was drawn."""
        return not self.drawing

    def html(self) -> Markup:
        """Return the drawing below its note."""
        from markupsafe import Markup

        note = Markup('<p class="note">{}</p>\n').format(self.note)
        return note + Markup('<div class="figure">{}</div>').format(self.drawing)


Part: TypeAlias = Sentence | Command | DocumentSection


@dataclass(frozen=True)
class Document:
    """What a command answers; consoles do not show the title, because the command stands above."""

    title: str
    parts: tuple[Part, ...]

    def on(self, medium: Medium) -> list[Part]:
        """Return the parts for a medium, without empty sections."""
        shown = (part for part in self.parts if medium in part.only)
        return [
            part.on(medium) if isinstance(part, DocumentSection) else part
            for part in shown
            if not (isinstance(part, DocumentSection) and part.is_empty)
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


_ENDLESS = 10_000


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
                print_command(out, part.text, part.label)
            case DocumentSection():
                if part.title:
                    heading = Sentence(part.title, part.tint, strong=True)
                    _print_sentence(out, heading, first=index == 0)
                part.print_on(out)


def _print_sentence(out: Console, sentence: Sentence, *, first: bool) -> None:
    if sentence.strong and not first:
        out.print()
    out.print(tinted(Span(sentence.text, sentence.tint), bold=sentence.strong))


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
            case DocumentSection():
                lines += [*[""] * bool(lines[-1]), *_markdown_section(part)]
    return "\n".join(lines) + "\n"


def _markdown_section(part: DocumentSection) -> Iterator[str]:
    folded = isinstance(part, Table) and part.folded
    if folded:
        yield from (f"<details><summary>{part.title}</summary>", "")
    elif part.title:
        yield from (f"**{escaped_markdown(part.title)}**", "")
    yield from (*part.markdown(), "")
    if folded:
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


def page(document: Document, template: str = "document.html", **others: Any) -> str:
    """Return a document as one self-contained HTML page.

    template: extends document.html by what only this page has, from `others`.
    """
    from bodycheck.reports.templating import rendered

    parts = document.on("page")
    facts = [part for part in parts if isinstance(part, Table) and not part.title]
    return rendered(
        template,
        title=document.title,
        sentences=[part for part in parts if isinstance(part, Sentence)],
        commands=[part for part in parts if isinstance(part, Command)],
        facts=facts,
        sections=[part for part in parts if isinstance(part, DocumentSection) and part not in facts],
        **others,
    )
