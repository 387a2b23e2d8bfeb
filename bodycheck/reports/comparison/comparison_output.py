"""A comparison on the terminal, in Markdown and as one HTML page."""

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
    """Print what changed, and what became worse or is missing; of a long list, how many more lines it has."""
    out = console()
    out.print(Text(f"before  {identity(comparison.before)}"))
    out.print(Text(f"after   {identity(comparison.after)}"))
    for sentence in sentences(comparison):
        out.print(Text(sentence))
    print_changes(comparison.changes, "--html FILE has all")


def print_changes(changes: Iterable[Change], where_all_are: str) -> None:
    """Print the changes that fail in groups under their headings; of a long list, where the rest is."""
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
    """Return what the terminal shows: the sentences, and a table of what became worse or is missing."""
    runs = f"Before: {identity(comparison.before)}. After: {identity(comparison.after)}."
    lines = [
        "### bodycheck compare",
        "",
        *(f"- {escaped_markdown(sentence)}" for sentence in sentences(comparison)),
        f"- {escaped_markdown(runs)}",
        *changes_table(comparison.changes, "bodycheck compare --html FILE has all"),
    ]
    return "\n".join(lines) + "\n"


def changes_table(changes: Iterable[Change], where_all_are: str) -> list[str]:
    """Return the lines of a table of the changes that fail; of a long list, where the rest is."""
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
    """What a page shows of changes: groups by heading, the tint of each heading, and a change in words.

    open: the headings whose changes stand open; the others are folded.
    """

    sections: dict[str, list[Group]]
    tints: dict[str, str]
    open: frozenset[str]
    text: Callable[[Change], str] = change_text

    @classmethod
    def of(cls, changes: Iterable[Change]) -> ChangesShown:
        """Return them under the heading of their status, the most severe first."""
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
    """Return all that changed as one HTML page that needs nothing else."""
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
