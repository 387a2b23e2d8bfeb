"""Write the report of a nightly run to the terminal, as Markdown and as one HTML page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from bodycheck._util.formatting import console, count, escaped_markdown, number, print_columns
from bodycheck.reports.comparison.comparison_output import ChangesShown, changes_table, print_changes
from bodycheck.reports.comparison.describe import HEADINGS, sentences
from bodycheck.reports.comparison.release_search import release_searches
from bodycheck.reports.history.baseline import TOLD, machine_class
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.history.step_detection import (
    LEAST_AFTER,
    LEAST_BEFORE,
    pooled_spread,
    smallest_detectable_step,
)
from bodycheck.reports.history.trends import trends_of
from bodycheck.reports.summary.worst_results import faulty, worst_methods
from bodycheck.reports.summary.worst_results import headline as methods_headline
from bodycheck.reports.templating import asset, environment

if TYPE_CHECKING:
    import pandas as pd

_HEADLINES = {
    "regression": "Regression: something became worse or is no longer measured.",
    "no regression": "No regression.",
    "nothing measured": "Nothing was measured: no case ended well.",
    "insufficient history": "Insufficient history: no baseline run on such a machine has comparable cases.",
}


def headline(judged: Judgement) -> str:
    """Return the status in one sentence."""
    return _HEADLINES[judged.status]


def night_sentences(judged: Judgement) -> list[str]:
    """Return sentences: what changed, what was compared, how far speed can be judged, what was left out."""
    found: list[str] = []
    if judged.comparison is not None:
        searches = release_searches(judged.comparison)
        found = [*sentences(judged.comparison), *(f"To find the release: {command}" for command in searches)]
        found += [
            f"Compared with the accepted levels after the nightly run {judged.comparison.before.run_id}."
        ]
    found += _findings(judged)
    found += [_speed_sentence(judged), f"Machine: {machine_class(judged.tonight.manifest)}."]
    found += [f"Nightly run left out: {why}." for why in judged.past.left_out]
    return found


def _findings(judged: Judgement) -> list[str]:
    """Return the faults of the methods in this run, changed or not, worded as in its report."""
    wrong = faulty(worst_methods(judged.tonight))
    lines = [f"{one.method}: {one.sentence}. Reproduce: {one.worst.reproduce}" for one in wrong]
    return [methods_headline(wrong), *lines] if wrong else []


def _speed_sentence(judged: Judgement) -> str:
    speeds, least = judged.speeds.series, LEAST_BEFORE + LEAST_AFTER
    if not judged.tonight.manifest["speed"]:
        return "Speed was not measured."
    if speeds.measured < least:
        return f"Speed is not judged yet: {speeds.measured} of the {least} required nightly runs measured it."
    spread = pooled_spread(speeds.decades, list(judged.speeds.steps.values()))
    percent = 100.0 * (10.0 ** smallest_detectable_step(spread) - 1.0)
    told = f"a slowdown of {number(percent, 2)} % is detected within five nightly runs"
    return f"Speed is judged from {count(speeds.measured, 'nightly run')}: {told}."


_STYLES = {
    "regression": "bold red",
    "no regression": "bold green",
    "insufficient history": "bold yellow",
    "nothing measured": "bold red",
}


def print_night(judged: Judgement) -> None:
    """Print the report of a nightly run, the worst changes first."""
    out = console()
    out.print(Text(headline(judged), style=_STYLES[judged.status]))
    for sentence in night_sentences(judged):
        out.print(Text(sentence))
    if judged.comparison is not None:
        print_changes(judged.comparison.changes, "night.html and changes.csv list all")


def print_nights(nights: pd.DataFrame) -> None:
    """Print one line per nightly run, the oldest first."""
    rows = nights[list(TOLD)].astype(str).to_numpy().tolist()
    print_columns(console(), TOLD, rows, right=(*HEADINGS, "cases"))


def night_markdown(judged: Judgement) -> str:
    """Return status, circumstances and changes as Markdown, the worst changes first."""
    lines = [
        f"### bodycheck nightly: {judged.status}",
        "",
        escaped_markdown(headline(judged)),
        "",
        *(f"- {escaped_markdown(sentence)}" for sentence in night_sentences(judged)),
    ]
    if judged.comparison is not None:
        lines += changes_table(judged.comparison.changes, "night.html lists all")
    return "\n".join(lines) + "\n"


_TINTS = {
    "regression": "bad",
    "no regression": "good",
    "insufficient history": "open",
    "nothing measured": "bad",
}


def render_night(judged: Judgement) -> str:
    """Return the self-contained HTML page of a nightly run; it links to report.html in the same folder."""
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
