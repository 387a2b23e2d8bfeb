"""A comparison as one HTML page, in the report's own style."""

from __future__ import annotations

from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.words import HEADINGS, change_text, groups, identity, sentences
from bodycheck.reports.templating import asset, environment


def render_comparison(comparison: Comparison) -> str:
    """Return all that changed as one HTML page that needs nothing else."""
    made = groups(comparison.changes)
    return (
        environment()
        .get_template("compare.html")
        .render(
            before=identity(comparison.before),
            after=identity(comparison.after),
            sentences=sentences(comparison),
            sections={
                heading: [group for group in made if group.direction == direction]
                for direction, heading in HEADINGS.items()
            },
            tints=dict(zip(HEADINGS.values(), ("bad", "good", "open"), strict=True)),
            change_text=change_text,
            css=asset("templates/report.css"),
        )
    )
