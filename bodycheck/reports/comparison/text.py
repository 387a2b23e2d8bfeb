"""A comparison on the terminal, or in a pipe."""

from __future__ import annotations

from collections.abc import Iterable

from rich.text import Text

from bodycheck.reports.comparison.change import FAILING, Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.words import HEADINGS, groups, identity, sentences
from bodycheck.reports.console import console, print_columns

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
