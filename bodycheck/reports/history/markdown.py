"""A night in less than 60 lines of Markdown, fit for a job's summary or an issue."""

from __future__ import annotations

from bodycheck.reports.comparison.words import HEADINGS, groups
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.words import headline, night_sentences
from bodycheck.reports.markdown import escaped, markdown_table

_MOST_LINES = 30


def night_markdown(judged: Judgement) -> str:
    """Return status, circumstances, and what changed, the worst first."""
    lines = [
        f"### bodycheck nightly: {judged.status}",
        "",
        escaped(headline(judged)),
        "",
        *(f"- {escaped(sentence)}" for sentence in night_sentences(judged)),
    ]
    made = groups(judged.comparison.changes) if judged.comparison is not None else []
    if made:
        rows = [
            (HEADINGS[group.direction].lower(), group.where, group.method, group.text)
            for group in made[:_MOST_LINES]
        ]
        lines += ["", *markdown_table(("", "scenario", "engine:method", "change"), rows)]
    if len(made) > _MOST_LINES:
        lines += ["", f"and {len(made) - _MOST_LINES} more lines, in night.html."]
    return "\n".join(lines) + "\n"
