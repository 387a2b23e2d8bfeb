"""A night as one HTML page: what changed, trends, and what earlier nights told."""

from __future__ import annotations

from bodycheck.reports.comparison.page import ChangesShown
from bodycheck.reports.comparison.words import HEADINGS
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.trends import trends_of
from bodycheck.reports.history.words import headline, night_sentences
from bodycheck.reports.templating import asset, environment

_TINTS = {"regression": "bad", "no regression": "good", "past too thin": "open", "nothing measured": "bad"}


def render_night(judged: Judgement) -> str:
    """Return the page of a night; it needs nothing else, and leads to the report beside it."""
    return (
        environment()
        .get_template("night.html")
        .render(
            run_id=judged.tonight.run_id,
            headline=headline(judged),
            tint=_TINTS[judged.status],
            sentences=night_sentences(judged),
            changes=ChangesShown.of(() if judged.comparison is None else judged.comparison.changes),
            statuses=list(HEADINGS),
            nights=len(judged.speeds.series.nights),
            trends=trends_of(judged.speeds, judged.errors),
            earlier=[night.told for night in judged.past.nights],
            css=asset("templates/report.css"),
        )
    )
