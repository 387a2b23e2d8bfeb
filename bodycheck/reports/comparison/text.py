"""A comparison on the terminal, or in a pipe."""

from __future__ import annotations

from collections.abc import Iterable

from rich.text import Text

from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.words import HEADINGS, groups, identity, sentences
from bodycheck.reports.console import console, print_columns

_MOST_LINES = 20
_STYLES = {"worse": "red", "better": "green", "other": "yellow"}


def print_comparison(comparison: Comparison) -> None:
    """Print what changed, the worst first; of a long list, how many lines there are beyond those shown."""
    out = console()
    out.print(Text(f"before  {identity(comparison.before)}"))
    out.print(Text(f"after   {identity(comparison.after)}"))
    for sentence in sentences(comparison):
        out.print(Text(sentence))
    print_changes(comparison.changes, "--html FILE has all")


def print_changes(changes: Iterable[Change], where_all_are: str) -> None:
    """Print changes in groups under worse, better and other; of a long list, where the rest is."""
    out, made = console(), groups(changes)
    for direction, heading in HEADINGS.items():
        alike = [group for group in made if group.direction == direction]
        if not alike:
            continue
        out.print(Text(f"\n{heading}", style=f"bold {_STYLES[direction]}"))
        rows = ((group.where, group.method, group.text) for group in alike[:_MOST_LINES])
        print_columns(out, ("", "", ""), rows)
        if len(alike) > _MOST_LINES:
            out.print(Text(f"and {len(alike) - _MOST_LINES} more lines: {where_all_are}"))
