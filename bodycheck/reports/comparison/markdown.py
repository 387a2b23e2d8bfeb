"""A comparison in less than 60 lines of Markdown, fit for a job's summary or a pull request."""

from __future__ import annotations

from collections.abc import Iterable

from bodycheck.reports.comparison.change import FAILING, Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.words import HEADINGS, groups, identity, sentences
from bodycheck.reports.markdown import escaped, markdown_table

_MOST_LINES = 30


def comparison_markdown(comparison: Comparison) -> str:
    """Return what the terminal shows: the sentences, and a table of what became worse or is missing."""
    lines = [
        "### bodycheck compare",
        "",
        *(f"- {escaped(sentence)}" for sentence in sentences(comparison)),
        f"- {escaped(f'Before: {identity(comparison.before)}. After: {identity(comparison.after)}.')}",
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
        for group in made[:_MOST_LINES]
    ]
    lines = ["", *markdown_table(("", "scenario", "engine:method", "change"), rows)]
    if len(made) > _MOST_LINES:
        lines += ["", f"and {len(made) - _MOST_LINES} more lines: {where_all_are}."]
    return lines
