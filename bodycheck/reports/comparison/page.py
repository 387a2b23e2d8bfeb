"""A comparison as one HTML page, in the report's own style."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from bodycheck.reports.comparison.change import FAILING, Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.words import HEADINGS, Group, change_text, groups, identity, sentences
from bodycheck.reports.templating import asset, environment

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
