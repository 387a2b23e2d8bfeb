"""The report of a nightly run as a document and as one HTML page, and the list of nightly runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bodycheck._util.formatting import count, number
from bodycheck.reports.comparison.describe import HEADINGS, change_tables, searches, sentences
from bodycheck.reports.comparison.headlines import by_method
from bodycheck.reports.document import Column, Command, Document, Sentence, Table, page
from bodycheck.reports.history.baseline import TOLD, machine_class
from bodycheck.reports.history.nightly_files import versions_of
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.history.step_detection import (
    LEAST_AFTER,
    LEAST_BEFORE,
    pooled_spread,
    smallest_detectable_step,
)
from bodycheck.reports.history.trends import dates_of, trends_of
from bodycheck.reports.render.styles import engine_colour
from bodycheck.reports.summary.sentences import Summary
from bodycheck.reports.summary.worst_results import faulty
from bodycheck.reports.summary.worst_results import headline as methods_headline

if TYPE_CHECKING:
    import pandas as pd

_STATUSES = {
    "regression": ("bad", "Regression: something became worse or is no longer measured."),
    "no regression": ("good", "No regression."),
    "nothing measured": ("bad", "Nothing was measured: no case has outcome ok."),
    "insufficient history": (
        "open",
        "Insufficient history: no baseline run on such a machine has comparable cases.",
    ),
}
"""Status -> the tint and the text of its sentence."""

_MOST_NAMED = 3


def headline(judged: Judgement) -> str:
    """Return the status in one sentence, with the methods that improved."""
    changes = () if judged.comparison is None else judged.comparison.changes
    improved = [f"{one.engine}:{one.method}" for one in by_method(changes) if one.net == "improved"]
    if judged.status != "no regression" or not improved:
        return _STATUSES[judged.status][1]
    who = ", ".join(improved) if len(improved) <= _MOST_NAMED else count(len(improved), "method")
    return f"No regression; {who} improved."


def night_sentences(judged: Judgement) -> list[str]:
    """Return sentences: what changed, what was compared, how far speed can be judged, what was left out."""
    found: list[str] = []
    if judged.comparison is not None:
        found = [
            *sentences(judged.comparison),
            f"Compared with the accepted levels after the nightly run {judged.comparison.before.run_id}.",
        ]
    found += _findings(judged)
    found += [_speed_sentence(judged), f"Machine: {machine_class(judged.tonight.manifest)}."]
    found += [f"Nightly run excluded: {why}." for why in judged.past.left_out]
    return found


def night_commands(judged: Judgement) -> list[Command]:
    """Return the commands that find the releases of the changes."""
    return [] if judged.comparison is None else searches(judged.comparison)


def _findings(judged: Judgement) -> list[str]:
    """Return the faults of the methods in this run, changed or not, worded as in its report."""
    wrong = faulty(Summary.of(judged.tonight).worst)
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


def night_document(judged: Judgement) -> Document:
    """Return status, circumstances and changes, the worst changes first."""
    changes = () if judged.comparison is None else judged.comparison.changes
    return Document(
        f"bodycheck: nightly run {judged.tonight.run_id}",
        (
            Sentence(headline(judged), _STATUSES[judged.status][0], strong=True),
            *(Sentence(sentence) for sentence in night_sentences(judged)),
            *night_commands(judged),
            *change_tables(changes, "night.html and changes.csv list all"),
        ),
    )


def night_data(judged: Judgement) -> dict[str, Any]:
    """Return the judgement as data: status, sentences and every single change."""
    return {
        "run_id": judged.tonight.run_id,
        "status": judged.status,
        "sentences": night_sentences(judged),
        "find_release": [command.text for command in night_commands(judged)],
        "changes": () if judged.comparison is None else judged.comparison.changes,
    }


def nights_data(nights: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the listed columns of each nightly run, the oldest first."""
    rows: list[dict[str, Any]] = nights[list(TOLD)].to_dict("records")  # type: ignore[assignment]
    return rows


def nights_document(nights: pd.DataFrame) -> Document:
    """Return one row per nightly run, the oldest first."""
    numbers = (*HEADINGS, "cases")
    texts = ("engines", "machine")
    columns = [
        Column(name, "number" if name in numbers else "text" if name in texts else "fixed") for name in TOLD
    ]
    rows = nights[list(TOLD)].astype(str).to_numpy().tolist()
    return Document("bodycheck: nightly runs", (Table(tuple(columns), tuple(map(tuple, rows))),))


_PAGES = ("night.html", "report.html")


def night_page(judged: Judgement, folder: str = "") -> str:
    """Return the self-contained HTML page of a nightly run.

    folder: that of the run, as seen from the page and ending in "/", for links; "" if the page is in it.
    """
    manifests = [*(night.manifest for night in judged.past.nights[::-1]), judged.tonight.manifest]
    return page(
        night_document(judged),
        "night.html",
        statuses=list(HEADINGS),
        nights=len(judged.speeds.series.nights),
        trends=trends_of(judged.speeds, judged.errors, [versions_of(manifest) for manifest in manifests]),
        dates=dates_of(judged.speeds.series.nights),
        earlier=[
            (night.told, [page for page in _PAGES if (night.folder / page).exists()])
            for night in judged.past.nights
        ],
        engine_colour=engine_colour,
        folder=folder,
    )
