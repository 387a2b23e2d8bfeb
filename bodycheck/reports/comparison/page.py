"""A comparison as one HTML page, in the report's own style."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.words import HEADINGS, Group, change_text, groups, identity, sentences
from bodycheck.reports.templating import asset, environment


@dataclass(frozen=True)
class ChangesShown:
    """What a page shows of changes: groups by heading, the tint of each heading, and a change in words."""

    sections: dict[str, list[Group]]
    tints: dict[str, str]
    text: Callable[[Change], str] = change_text

    @classmethod
    def of(cls, changes: Iterable[Change]) -> ChangesShown:
        """Return them under worse, better and other."""
        made = groups(changes)
        return cls(
            sections={
                heading: [group for group in made if group.direction == direction]
                for direction, heading in HEADINGS.items()
            },
            tints=dict(zip(HEADINGS.values(), ("bad", "good", "open"), strict=True)),
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
            changes=ChangesShown.of(comparison.changes),
            css=asset("templates/report.css"),
        )
    )
