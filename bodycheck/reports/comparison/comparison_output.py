"""Write a comparison to the terminal, as Markdown and as one HTML page."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from rich.text import Text

from bodycheck._util.formatting import console, escaped_markdown, markdown_table, print_columns
from bodycheck.reports.comparison.change import FAILING, Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.describe import HEADINGS, Group, change_text, groups, identity, sentences
from bodycheck.reports.templating import asset, environment

_MOST_LINES = 20


def print_comparison(comparison: Comparison) -> None:
    """Print the sentences of a comparison, then what became worse or is missing, shortened if it is long."""
    out = console()
    out.print(Text(f"before  {identity(comparison.before)}"))
    out.print(Text(f"after   {identity(comparison.after)}"))
    for sentence in sentences(comparison):
        out.print(Text(sentence))
    print_changes(comparison.changes, "--html FILE lists all")


def print_changes(changes: Iterable[Change], where_all_are: str) -> None:
    """Print the failing changes in groups under their headings.

    where_all_are: text that says where to find the rest of a long list.
    """
    out, made = console(), groups(changes)
    for status in FAILING:
        alike = [group for group in made if group.status == status]
        if not alike:
            continue
        out.print(Text(f"\n{HEADINGS[status]}", style="bold red"))
        rows = ((group.where, group.method, group.text) for group in alike[:_MOST_LINES])
        print_columns(out, ("", "", ""), rows)
        if len(alike) > _MOST_LINES:
            out.print(Text(f"and {len(alike) - _MOST_LINES} more lines: {where_all_are}"))


_MOST_TABLE_ROWS = 30


def comparison_markdown(comparison: Comparison) -> str:
    """Return the sentences of a comparison and a table of what became worse or is missing, as Markdown."""
    runs = f"Before: {identity(comparison.before)}. After: {identity(comparison.after)}."
    lines = [
        "### bodycheck compare",
        "",
        *(f"- {escaped_markdown(sentence)}" for sentence in sentences(comparison)),
        f"- {escaped_markdown(runs)}",
        *changes_table(comparison.changes, "bodycheck compare --html FILE lists all"),
    ]
    return "\n".join(lines) + "\n"


def changes_table(changes: Iterable[Change], where_all_are: str) -> list[str]:
    """Return the lines of a table of the failing changes; where_all_are as in print_changes."""
    made = [group for group in groups(changes) if group.status in FAILING]
    if not made:
        return []
    rows = [
        (HEADINGS[group.status].lower(), group.where, group.method, group.text)
        for group in made[:_MOST_TABLE_ROWS]
    ]
    lines = ["", *markdown_table(("", "scenario", "engine:method", "change"), rows)]
    if len(made) > _MOST_TABLE_ROWS:
        lines += ["", f"and {len(made) - _MOST_TABLE_ROWS} more lines: {where_all_are}."]
    return lines


_TINTS = ("bad", "bad", "good", "open", "open")


@dataclass(frozen=True)
class ChangesShown:
    """The changes of a page: groups by heading, the tint of each heading, and the text of a change.

    open: the headings whose changes are shown unfolded.
    """

    sections: dict[str, list[Group]]
    tints: dict[str, str]
    open: frozenset[str]
    text: Callable[[Change], str] = change_text

    @classmethod
    def of(cls, changes: Iterable[Change]) -> ChangesShown:
        """Group the changes under the heading of their status, the most severe first."""
        made = groups(changes)
        return cls(
            sections={
                heading: [group for group in made if group.status == status]
                for status, heading in HEADINGS.items()
            },
            tints=dict(zip(HEADINGS.values(), _TINTS, strict=True)),
            open=frozenset(HEADINGS[status] for status in FAILING),
        )


def render_comparison(comparison: Comparison) -> str:
    """Return all changes as one self-contained HTML page."""
    return (
        environment()
        .get_template("compare.html")
        .render(
            before=identity(comparison.before),
            after=identity(comparison.after),
            sentences=sentences(comparison),
            threshold=100.0 * comparison.thresholds.default,
            changes=ChangesShown.of(comparison.changes),
            css=asset("templates/report.css"),
        )
    )
