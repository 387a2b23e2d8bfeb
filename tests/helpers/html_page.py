"""A parsed HTML page, for tests of its tables and tags."""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser

from bodycheck.reports.render.html import report_pages
from bodycheck.reports.run_files.run_tables import Run


def report_page(run: Run) -> str:
    """Return the report of a run that has one page."""
    ((_, page),) = report_pages(run)
    return page


@dataclass
class Table:
    """A table of the page: its class, the id and the error of its section, and its cells as text."""

    kind: str
    place: str
    error: str
    rows: list[list[str]] = field(default_factory=list)
    columns: dict[int, str] = field(default_factory=dict)

    def records(self) -> list[dict[str, str]]:
        """Return the rows by the columns of the first row: the tooltip of a heading, or else its text."""
        names = [self.columns.get(place, text) for place, text in enumerate(self.rows[0])]
        return [dict(zip(names, row, strict=True)) for row in self.rows[1:]]


class Page(HTMLParser):
    """The tags, tables and text of a page; unbalanced tags fail."""

    VOID = frozenset({"meta", "input", "wbr", "br", "link", "img"})

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.tables: list[Table] = []
        self.text = ""
        self.data: list[str] = []
        self._open: list[tuple[str, dict[str, str]]] = []
        self.feed(html)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record the tag."""
        attributes = {name: value or "" for name, value in attrs}
        self.tags.append((tag, attributes))
        if tag == "table":
            self.tables.append(
                Table(attributes.get("class", ""), self._around("id"), self._around("data-error"))
            )
        elif tag == "tr":
            self.tables[-1].rows.append([])
        elif tag in ("td", "th"):
            table = self.tables[-1]
            if tag == "th" and len(table.rows) == 1 and "title" in attributes:
                table.columns[len(table.rows[0])] = attributes["title"]
            table.rows[-1].append("")
        elif tag == "script" and attributes.get("type") == "application/json":
            self.data.append("")
        if tag not in self.VOID:
            self._open.append((tag, attributes))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record a self-closing tag, as in SVG."""
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        """Check each end tag against its start tag."""
        assert self._open.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        """Add the text to the cell, the data or the page that contains it."""
        tags = [tag for tag, _ in self._open]
        if tags and tags[-1] == "script":
            if self.data and self.tags[-1][1].get("type"):
                self.data[-1] += data
        elif not tags or tags[-1] != "style":
            self.text += data
            if {"td", "th"} & set(tags):
                self.tables[-1].rows[-1][-1] += data

    def with_class(self, name: str) -> list[Table]:
        """Return the tables with these classes."""
        return [table for table in self.tables if {*name.split()} <= {*table.kind.split()}]

    def _around(self, attribute: str) -> str:
        """Return the nearest value of an attribute among the open elements, "" if none has it."""
        values = [attributes[attribute] for _, attributes in self._open if attribute in attributes]
        return values[-1] if values else ""
