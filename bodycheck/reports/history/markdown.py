"""A night in less than 60 lines of Markdown, fit for a job's summary or an issue."""

from __future__ import annotations

from bodycheck.reports.comparison.markdown import changes_table
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.words import headline, night_sentences
from bodycheck.reports.markdown import escaped


def night_markdown(judged: Judgement) -> str:
    """Return status, circumstances, and what changed, the worst first."""
    lines = [
        f"### bodycheck nightly: {judged.status}",
        "",
        escaped(headline(judged)),
        "",
        *(f"- {escaped(sentence)}" for sentence in night_sentences(judged)),
    ]
    if judged.comparison is not None:
        lines += changes_table(judged.comparison.changes, "night.html has all")
    return "\n".join(lines) + "\n"
