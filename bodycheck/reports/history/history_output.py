"""The report of a nightly run as a document and as one HTML page, and the list of nightly runs."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck._util.formatting import count, number
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.alerts import Alert
from bodycheck.reports.comparison.comparison_document import HEADINGS, change_tables, nothing, scope, searches
from bodycheck.reports.comparison.headlines import headlines, lines_of
from bodycheck.reports.document import Command, Document, Sentence, Table, page
from bodycheck.reports.history.acceptances import acceptance_text
from bodycheck.reports.history.archive import started_at
from bodycheck.reports.history.baseline import SUMMARY_KEYS, machine_class
from bodycheck.reports.history.headline import headline, title
from bodycheck.reports.history.nightly_files import versions_of
from bodycheck.reports.history.open_regressions import OpenLine, open_lines
from bodycheck.reports.history.regression import Judgement, Speeds
from bodycheck.reports.history.step_detection import (
    MIN_AFTER,
    MIN_BEFORE,
    Key,
    Series,
    Step,
    pooled_spread,
    smallest_detectable_step,
)
from bodycheck.reports.render.styles import engine_colour
from bodycheck.reports.summary.sentences import Summary
from bodycheck.reports.summary.worst_results import faulty
from bodycheck.reports.summary.worst_results import headline as methods_headline
from bodycheck.reports.table_layout import MEDIA, Column, Medium

if TYPE_CHECKING:
    import pandas as pd

_WIDTH, _HEIGHT, _EDGE = 240, 32, 4
_MAX_OPEN = 8
_MIN_HALF_RANGE = 0.05  # decades: a change of less than about 10 % looks flat


@dataclass(frozen=True)
class TrendLine:
    """A line in an SVG picture of width x height; zero: the median level; marks: (x, y) of detected steps.

    releases: (x, text) where the version of the engine changed. size: of the newest value, in decades.
    """

    width: int
    height: int
    path: str
    zero: str
    marks: tuple[tuple[str, str], ...]
    releases: tuple[tuple[str, str], ...]
    size: float
    newest: str
    label: str


@dataclass(frozen=True)
class Trend:
    """The lines of one method; None if not measured."""

    engine: str
    method: str
    speed: TrendLine | None
    error: TrendLine | None

    @property
    def size(self) -> float:
        """How far the newest speed or error is from its median, in decades."""
        return max(line.size for line in (self.speed, self.error) if line is not None)


def trends_of(speeds: Speeds, errors: Series, versions: Sequence[Mapping[str, str]]) -> list[Trend]:
    """Return one row per method that was measured in any nightly run, those farthest from usual first.

    versions: of each engine in each nightly run, the oldest first.
    """
    times = _lines(speeds.series, speeds.steps, versions, "time")
    error_lines = _lines(errors, {}, versions, "error")
    rows = [Trend(*key, times.get(key), error_lines.get(key)) for key in sorted({**times, **error_lines})]
    return sorted(rows, key=lambda row: -row.size)


def dates_of(run_ids: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return (x, SVG text-anchor, date) of the first and the last nightly run, given by their run ids."""
    first, last = (f"{started_at(run_id):%Y-%m-%d}" for run_id in (run_ids[0], run_ids[-1]))
    return (
        [("0", "start", first), (str(_WIDTH), "end", last)] if len(run_ids) > 1 else [("0", "start", first)]
    )


def release_changes(versions: Sequence[str | None]) -> list[tuple[int, str]]:
    """Return the places at which a version differs from the last known one, and "before -> after"."""
    found: list[tuple[int, str]] = []
    known: str | None = None
    for index, version in enumerate(versions):
        if version is not None and known is not None and version != known:
            found.append((index, f"{known} -> {version}"))
        known = version or known
    return found


def _lines(
    series: Series, steps: Mapping[Key, Sequence[Step]], versions: Sequence[Mapping[str, str]], quantity: str
) -> dict[Key, TrendLine]:
    columns = zip(series.methods, series.decades.T, strict=True)
    return {
        key: _line(
            decades, steps.get(key, ()), release_changes([own.get(key[0]) for own in versions]), quantity
        )
        for key, decades in columns
    }


def _line(
    decades: Array, steps: Sequence[Step], releases: Sequence[tuple[int, str]], quantity: str
) -> TrendLine:
    """Return the line of decades (runs,); a run without a value interrupts it."""
    runs = len(decades)
    x = np.linspace(_EDGE, _WIDTH - _EDGE, runs) if runs > 1 else np.array([_WIDTH / 2.0])
    half = max(_MIN_HALF_RANGE, float(np.nanmax(np.abs(decades))))
    middle = _HEIGHT / 2.0
    y = middle - (middle - _EDGE) * decades / half
    measured = ~np.isnan(decades)
    drawn, pen_up = [], True
    for index in range(runs):
        if measured[index]:
            drawn.append(f"{'M' if pen_up else 'L'}{x[index]:.1f} {y[index]:.1f}")
        pen_up = not measured[index]
    factor = number(10.0 ** decades[-1], 3) if measured[-1] else ""
    marks = [(f"{x[step.first]:.1f}", f"{y[step.first]:.1f}") for step in steps if measured[step.first]]
    total = int(measured.sum())
    return TrendLine(
        width=_WIDTH,
        height=_HEIGHT,
        path="".join(drawn),
        zero=f"M0 {middle:g}H{_WIDTH}",
        marks=tuple(marks),
        releases=tuple((f"{x[index]:.1f}", text) for index, text in releases),
        size=abs(float(decades[-1])) if measured[-1] else 0.0,
        newest=f"× {factor}" if factor else "",
        label=f"{quantity} relative to the median of {total} runs, latest {factor or 'not measured'}",
    )


_TINTS = {
    "regression": "bad",
    "no regression": "good",
    "nothing measured": "bad",
    "insufficient history": "open",
}


def nightly_sentences(judged: Judgement) -> list[str]:
    """Return sentences: what improved, closed or was accepted, what was compared, what was left out."""
    found = [f"{one.text_closed}." for one in open_lines(judged.state.recovered)]
    if judged.status == "insufficient history":
        found.append("Exit status 3 says only this; run the same command again to compare.")
    earlier = () if not judged.baseline.runs else judged.baseline.runs[0].state.acceptances
    found += [f"Acceptance {acceptance_text(one)}." for one in judged.acceptances if one.id not in earlier]
    if judged.comparison is not None:
        lines = lines_of(judged.comparison)
        better = [one for one in lines if one.direction != "worse"]
        if judged.changes:
            found += headlines(better)
        elif not judged.state.recovered:
            found.append(nothing(judged.comparison))
        # beside what became worse of a method, its map is in no line above
        worse = {(one.change.engine, one.change.method) for one in judged.open}
        beside = [one for one in judged.other_maps if (one.change.engine, one.change.method) in worse]
        found += [f"{one.text}, since {one.duration}, {one.id}." for one in open_lines(beside)]
        found += scope(judged.comparison, lines)
        before = judged.comparison.before.run_id
        found.append(f"Compared with the accepted levels after the nightly run {before}.")
    wrong = faulty(Summary.of(judged.newest).worst)
    if wrong:
        found.append(f"{methods_headline(wrong)} report.html lists them.")
    found += [_speed_sentence(judged), f"Machine: {machine_class(judged.newest.manifest)}."]
    found += [f"Nightly run excluded: {why}." for why in judged.baseline.left_out]
    return found


def nightly_commands(judged: Judgement) -> list[Command]:
    """Return the command that accepts what is open, and those that find the releases of the changes."""
    found = [] if judged.comparison is None else searches(judged.comparison)
    failing = open_lines(judged.open)
    listed = {line.id for line in failing}  # what one night changed of a method has one id, its map too
    maps = [line for line in open_lines(judged.other_maps) if line.id not in listed]
    firsts = [(failing[:1], "To accept it"), (maps[:1], "To accept the map")]
    accept = [Command(_accept_command(judged, one), words) for some, words in firsts for one in some]
    return [*accept, *found]


def _accept_command(judged: Judgement, line: OpenLine) -> str:
    accept = ["bodycheck", "history", "accept", str(judged.history), "--change", line.id]
    return f"{shlex.join(accept)} --reason TEXT"


def alerts_of(judged: Judgement) -> list[Alert]:
    """Return one alert per open line, and one if nothing was measured."""
    if judged.status == "nothing measured":
        return [Alert("nothing-measured", headline(judged))]
    return [
        Alert(
            "regression",
            f"{one.text}\nworse since {one.duration}\nto accept it: {_accept_command(judged, one)}",
        )
        for one in open_lines(judged.open)
    ]


def _speed_sentence(judged: Judgement) -> str:
    speeds, required = judged.speeds.series, MIN_BEFORE + MIN_AFTER
    if not judged.newest.manifest["speed"]:
        return "Speed was not measured."
    if not judged.speeds.judged:
        return (
            f"Speed is not judged yet: {speeds.measured} of the {required} required nightly runs measured it."
        )
    spread = pooled_spread(speeds.decades, list(judged.speeds.steps.values()))
    percent = 100.0 * (10.0 ** smallest_detectable_step(spread) - 1.0)
    sensitivity = f"a slowdown of {number(percent, 2)} % is detected within five nightly runs"
    return f"Speed is judged from {count(speeds.measured, 'nightly run')}: {sensitivity}."


def nightly_document(judged: Judgement) -> Document:
    """Return what is worse and since when, what else changed, and all changes."""
    heading, first = title(judged), headline(judged)
    columns = (Column("since"), Column("worse than its level"), Column("id", "fixed"))
    rows = tuple((one.duration, one.text, one.id) for one in open_lines(judged.open))
    listed: tuple[Medium, ...] = MEDIA if len(rows) > 1 else ()  # one is the headline
    run = f"Nightly run {judged.newest.run_id}"
    return Document(
        heading,
        (
            Sentence(first, _TINTS[judged.status], strong=True, only=("console",)),
            *([] if first == heading else [Sentence(first, only=("markdown", "page"))]),
            Table(
                *(columns, rows, "Open regressions", "bad"),
                max_rows=_MAX_OPEN,
                rest="night.html lists all",
                only=listed,
            ),
            Sentence(run, only=("markdown", "page")),
            *(Sentence(sentence) for sentence in nightly_sentences(judged)),
            *nightly_commands(judged),
            *change_tables(judged.changes, "night.html and changes.csv list all"),
        ),
    )


def nightly_data(judged: Judgement) -> dict[str, Any]:
    """Return the judgement as data: status, what is open and why, sentences and every single change."""
    return {
        "run_id": judged.newest.run_id,
        "status": judged.status,
        "headline": headline(judged),
        "open": [
            {"id": one.id, "text": one.text, "since": one.since, "regressions": one.regressions}
            for one in open_lines(judged.open)
        ],
        "sentences": nightly_sentences(judged),
        "find_release": [one.text for one in (searches(judged.comparison) if judged.comparison else ())],
        "acceptances": judged.acceptances,
        "changes": judged.changes,
    }


def history_data(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the listed columns of each nightly run, the oldest first."""
    rows: list[dict[str, Any]] = runs[list(SUMMARY_KEYS)].to_dict("records")  # type: ignore[assignment]
    return rows


def history_document(runs: pd.DataFrame) -> Document:
    """Return one row per nightly run, the oldest first; engines and machine once where all have the same."""
    columns = [
        Column("run", "fixed"),
        Column("status", "fixed"),
        Column("changes"),
        Column("cases", "number"),
    ]
    columns += [Column(name) for name in ("engines", "machine") if runs[name].nunique() > 1]
    counted = [name for name in (*HEADINGS, "open") if name in runs]
    rows = [
        (
            row["run_id"],
            row["status"],
            ", ".join(f"{row[name]} {name}" for name in counted if row[name]) or "none",
            *(str(row[column.head]) for column in columns[3:]),
        )
        for row in history_data(runs)
    ]
    same = [
        Sentence(f"{name.capitalize()}: {runs[name].iloc[0]}")
        for name in ("engines", "machine")
        if runs[name].nunique() == 1
    ]
    return Document("bodycheck: nightly runs", (Table(tuple(columns), tuple(rows)), *same))


_PAGES = ("night.html", "report.html")


def nightly_page(judged: Judgement, folder: str = "") -> str:
    """Return the self-contained HTML page of a nightly run.

    folder: that of the run, as seen from the page and ending in "/", for links; "" if the page is in it.
    """
    manifests = [*(run.manifest for run in judged.baseline.runs[::-1]), judged.newest.manifest]
    return page(
        nightly_document(judged),
        "night.html",
        tint=_TINTS[judged.status],
        acceptances=[acceptance_text(one) for one in reversed(judged.acceptances)],
        statuses=list(HEADINGS),
        runs=len(judged.speeds.series.runs),
        trends=trends_of(judged.speeds, judged.errors, [versions_of(manifest) for manifest in manifests]),
        dates=dates_of(judged.speeds.series.runs),
        earlier=[
            (run.summary, [page for page in _PAGES if (run.folder / page).exists()])
            for run in judged.baseline.runs
        ],
        engine_colour=engine_colour,
        folder=folder,
    )
