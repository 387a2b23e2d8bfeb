"""A night as one HTML page: what changed, trends, and what earlier nights told."""

from __future__ import annotations

from bodycheck.reports.comparison.words import HEADINGS, change_text, groups
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.trends import trends_of
from bodycheck.reports.history.words import headline, night_sentences
from bodycheck.reports.templating import asset, environment

_TINTS = {"regression": "bad", "no regression": "good", "past too thin": "open", "nothing measured": "bad"}


def render_night(judged: Judgement) -> str:
    """Return the page of a night; it needs nothing else, and leads to the report beside it."""
    made = groups(judged.comparison.changes) if judged.comparison is not None else []
    return (
        environment()
        .get_template("night.html")
        .render(
            run_id=judged.tonight.run_id,
            headline=headline(judged),
            tint=_TINTS[judged.status],
            sentences=night_sentences(judged),
            sections={
                heading: [group for group in made if group.direction == direction]
                for direction, heading in HEADINGS.items()
            },
            tints=dict(zip(HEADINGS.values(), ("bad", "good", "open"), strict=True)),
            change_text=change_text,
            nights=len(judged.speeds.series.nights),
            trends=trends_of(judged.speeds, judged.errors),
            earlier=[night.told for night in judged.past.nights],
            css=asset("templates/report.css"),
        )
    )
