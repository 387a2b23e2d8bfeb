"""Documents on a console of any width, as Markdown, as a page and as JSON have the same, complete content."""

from __future__ import annotations

import json
import math
import random
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup, escape
from rich.console import Console

from bodycheck.reports import document
from bodycheck.reports.document import (
    Command,
    Document,
    DocumentSection,
    Drawing,
    Part,
    Sentence,
    Table,
    json_text,
    markdown,
    page,
    print_document,
)
from bodycheck.reports.table_layout import Column, Kind, Span, plain, shortened
from tests.helpers.doc_pages import blocks

COMMAND = "bodycheck run intermediate-axis --engine reference:quaternion-euler --dt 0.001 --no-speed"
COLUMNS = (
    Column("engine:method", "name"),
    Column("verdict"),
    Column("order", "fixed"),
    Column("error", "number"),
    Column("reproduce", "command"),
)
NAMES = ("mujoco:rk4", "reference:quaternion-euler", "pybullet:multibody@defaults")


def on_console(parts: tuple[Part, ...], width: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the lines that a terminal of this width shows; a command is one line, however long."""
    made = Console(width=width, force_terminal=True, color_system=None, highlight=False)
    monkeypatch.setattr(document, "console", lambda: made)
    with made.capture() as shown:
        print_document(Document("title", parts))
    return shown.get().splitlines()


def rows(verdict: str) -> tuple[tuple[str, ...], ...]:
    """Return one row per name."""
    return tuple((name, verdict, "3.99 to 4.01", "1.23e-12", COMMAND) for name in NAMES)


@pytest.mark.parametrize("width", [20, 40, 60, 80, 120, 200])
@pytest.mark.parametrize("verdict", ["converges", "converges 12, does not converge 3, unsupported 1"])
def test_no_cell_but_a_name_loses_a_character(
    width: int, verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every word of every row is printed, commands are whole, and nothing else is wider than the terminal."""
    lines = on_console((Table(COLUMNS, rows(verdict)),), width, monkeypatch)
    assert sum(COMMAND in line for line in lines) == len(NAMES)
    for line in lines:
        assert COMMAND in line or len(line) <= width
    words = " ".join(lines).split()
    for word in (*verdict.split(), "1.23e-12"):
        found = sum(re.sub(r"[;,]$", "", other) == word.rstrip(",") for other in words)
        assert found >= len(NAMES) or len(word) > width - 4


@pytest.mark.parametrize("width", [60, 80])
def test_a_long_name_is_shortened_in_its_middle_only_where_room_is_needed(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both ends of the name remain, and different names stay different."""
    verdict = "converges with the expected order"
    lines = on_console((Table(COLUMNS[:4], tuple(row[:4] for row in rows(verdict))),), width, monkeypatch)
    shown = [line.split()[0] for line in lines if re.match(r"(mujoco|refer|pybul)", line)]
    assert len(set(shown)) == len(NAMES)
    for name, seen in zip(NAMES, shown, strict=True):
        head, dots, tail = seen.partition("...")
        assert name.startswith(head)
        assert name.endswith(tail)
        assert dots or seen == name
    wide = on_console((Table(COLUMNS[:4], tuple(row[:4] for row in rows("converges"))),), 80, monkeypatch)
    assert "reference:quaternion-euler" in "".join(wide)


def test_names_that_would_become_equal_are_not_shortened(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows are printed as text instead."""
    names = [f"engine:{'a' * 30}{k}{'b' * 30}" for k in range(3)]
    table = Table((Column("m", "name"), Column("n", "number")), tuple((name, "1") for name in names))
    shown = "".join(on_console((table,), 40, monkeypatch))
    for name in names:
        assert name in shown.replace("\n", "")


def test_shortened_text_has_exactly_the_width() -> None:
    """The length is the smaller of the width and the text's own, even below the width of the dots."""
    for width in range(1, 40):
        text = shortened("reference:quaternion-euler", width)
        assert len(text) == min(width, 26)


KINDS: tuple[Kind, ...] = ("text", "name", "fixed", "number", "command")


@pytest.mark.parametrize("seed", range(200))
def test_no_drawn_table_is_wider_than_its_terminal(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For random columns and widths, each word is complete or longer than a line."""
    dice = random.Random(seed)
    columns = tuple(Column(f"head{k}", dice.choice(KINDS[:4])) for k in range(dice.randint(1, 7)))
    words = [f"{'w' * dice.randint(1, 12)}{k}" for k in range(60)]

    def cell(column: Column) -> str:
        return " ".join(dice.choices(words, k=dice.randint(0, 6 if column.kind == "text" else 1)))

    table = Table(columns, tuple(tuple(map(cell, columns)) for _ in range(dice.randint(1, 6))))
    width = dice.randint(30, 140)
    lines = on_console((table,), width, monkeypatch)
    assert max(map(len, lines)) <= width
    shown = " ".join(lines).replace(";", " ").split()
    for row in table.rows:
        for column, text in zip(columns, row, strict=True):
            if column.kind != "name":
                assert set(plain(text).split()) <= set(shown)


@pytest.mark.parametrize(("columns", "lines"), [("40", 3), ("", 1)])
def test_a_pipe_wraps_only_where_columns_is_set(
    columns: str, lines: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """COLUMNS is the width of the lines; without it a sentence is one line."""
    monkeypatch.setenv("COLUMNS", columns)
    document.print_document(Document("", (Sentence(" ".join(10 * ["ten words"])),)))
    assert len(capsys.readouterr().out.splitlines()) == lines


def test_a_short_list_of_a_long_table_says_where_the_rest_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """The console and Markdown both say so."""
    table = Table((Column("a"),), tuple((f"row {k}",) for k in range(5)), max_rows=2, rest="--html FILE")
    lines = on_console((table,), 80, monkeypatch)
    assert lines == ["a", "row 0", "row 1", "and 3 more lines: --html FILE"]
    text = markdown(Document("t", (table,)))
    assert "| row 1 |" in text
    assert "| row 2 |" not in text
    assert "and 3 more lines: --html FILE." in text


def test_a_part_or_column_of_some_media_is_left_out_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sentence may be for Markdown only, and a column for pages only."""
    table = Table((Column("a"), Column("b", only=("page",))), (("shown", "hidden"),))
    parts = (Sentence("in Markdown", only=("markdown",)), Command("true"), table)
    assert on_console(parts, 80, monkeypatch) == ["    true", "a", "shown"]
    text = markdown(Document("t", parts))
    assert "- in Markdown\n- `true`" in text
    assert "hidden" not in text


@dataclass(frozen=True)
class Answer:
    """A possible answer of a command."""

    error: float
    values: Any
    folder: Path
    nested: tuple[Span, ...]


HEADING, CONTENT = "A heading", "[red]content[/red] <i>as</i> *it* is"
"""What every example of a section says, which no medium may take for markup."""
SECTIONS: dict[type[DocumentSection], DocumentSection] = {
    Table: Table((Column("c"),), ((CONTENT,),), title=HEADING),
    Drawing: Drawing(HEADING, CONTENT, Markup("<svg></svg>")),
}
"""An example of each kind of section."""


def recipe() -> DocumentSection:
    """Return an example of the kind that CONTRIBUTING.md adds, from its text."""
    (text,) = [one.text for one in blocks("CONTRIBUTING.md", "python") if "DocumentSection" in one.text]
    found: dict[str, Any] = {"__name__": "recipe"}
    exec(compile(text, "CONTRIBUTING.md", "exec", dont_inherit=True), found)
    made: DocumentSection = found["Listing"](HEADING, (CONTENT,))
    return made


def test_every_kind_of_section_has_an_example() -> None:
    """An example is needed to see that it draws itself."""
    known = {kind for kind in DocumentSection.__subclasses__() if kind.__module__ != "recipe"}
    assert set(SECTIONS) == known


@pytest.mark.parametrize("section", [*SECTIONS.values(), recipe()], ids=lambda one: type(one).__name__)
def test_a_section_draws_its_content_below_its_heading_in_each_of_its_media(
    section: DocumentSection, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As text, in the media of `only` and in no other."""
    shown = Document("title", (section,))
    texts = {
        "console": "\n".join(on_console(shown.parts, 80, monkeypatch)),
        "markdown": re.sub(r"\\(.)", r"\1", markdown(shown)),
        "page": page(shown),
    }
    for medium, text in texts.items():
        content = str(escape(CONTENT)) if medium == "page" else CONTENT
        assert (content in text.partition(HEADING)[2]) is (medium in section.only), text
    assert re.search(f"<h2 [^>]*>{HEADING}</h2>", texts["page"])


def test_json_has_dataclasses_arrays_and_paths_and_no_nan() -> None:
    """Numbers parse back to the same doubles; those that are not finite become null."""
    found = json.loads(json_text(Answer(0.1, np.array([1e-300, math.nan]), Path("a/b"), (Span("t"),))))
    assert found == {
        "error": 0.1,
        "values": [1e-300, None],
        "folder": "a/b",
        "nested": [{"text": "t", "tint": "none", "items": []}],
    }
    assert json.loads(json_text({"x": np.float64(0.1), "n": np.int64(3), "inf": math.inf})) == {
        "x": 0.1,
        "n": 3,
        "inf": None,
    }
