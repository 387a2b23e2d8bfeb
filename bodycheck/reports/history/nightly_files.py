"""Write what a nightly run has beside the files of a run: its judgement, its pages and the feed."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck._util.formatting import count
from bodycheck.reports.comparison.change import FAILING
from bodycheck.reports.comparison.compare import unversioned
from bodycheck.reports.comparison.comparison_document import HEADINGS
from bodycheck.reports.history.acceptances import Acceptance, acceptance_text
from bodycheck.reports.history.archive import TRAJECTORIES, started_at
from bodycheck.reports.history.baseline import (
    NOT_JUDGED,
    SUMMARY_FILE,
    SUMMARY_KEYS,
    machine_class,
)
from bodycheck.reports.history.headline import headline
from bodycheck.reports.history.levels import write_levels
from bodycheck.reports.history.open_regressions import NightlyState, open_lines, write_state
from bodycheck.reports.history.queries import CHANGES
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Run, study_key
from bodycheck.reports.run_files.tables import Row, as_csv, as_table, read_rows
from bodycheck.reports.run_files.writer import trajectory_file


def write_unjudged(run: Run, folder: Path) -> None:
    """Write night.json and an empty changes.csv for a run that could not be judged."""
    known = {"run_id": run.run_id, "status": NOT_JUDGED, "cases": len(run.cases)}
    summary = {**dict.fromkeys(SUMMARY_KEYS, 0), "engines": ", ".join(run.manifest["engines"]), **known}
    summary |= {"created": run.manifest["created"], "machine": machine_class(run.manifest)}
    (folder / SUMMARY_FILE).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    _write_changes((), folder)


def write_judgement(judged: Judgement, folder: Path) -> None:
    """Write night.json, changes.csv, the accepted levels and what is open."""
    (folder / "night.json").write_text(json.dumps(_summary(judged), indent=2) + "\n", encoding="utf-8")
    _write_changes(_change_rows(judged), folder)
    write_levels(judged.levels, folder)
    write_state(judged.state, folder)


_RUNS_WITH_ALL_MOTIONS = 7
_THINNED = "thinned"  # an empty file in trajectories/: those of unchanged cases were removed


def remove_old_motions(runs: Sequence[Path]) -> None:
    """Remove the motions of unchanged cases from all but the newest nightly runs.

    runs: their folders, the oldest first. A removed motion is computed again where it is needed.
    """
    for folder in runs[:-_RUNS_WITH_ALL_MOTIONS]:
        motions = folder / TRAJECTORIES
        if not motions.is_dir() or (motions / _THINNED).exists():
            continue
        try:
            kept = {motions / file for file in _changed_motions(folder)}
        except (InputError, OSError, KeyError):  # a damaged run keeps all of them
            continue
        (motions / _THINNED).touch()
        for file in motions.glob("*/*.npz"):
            if file not in kept:
                file.unlink()


def _changed_motions(folder: Path) -> Iterator[Path]:
    """Yield the files of the cases that became worse, and those of methods that did, in trajectories/."""
    changes = read_rows(folder / f"{CHANGES.name}.csv", CHANGES)
    rows = [row for row in changes if row["status"] in FAILING and "scenario" in row]
    studies = {study_key(row) for row in rows if "fineness" not in row}
    cases = {(*study_key(row), row["fineness"]) for row in rows if "fineness" in row}
    tables = read_tables(folder)
    names = unversioned(tables.manifest["engines"])
    for case in tables.cases:
        row = case.columns
        study = row["scenario"], names.get(row["engine"], row["engine"]), row["method"]
        if study in studies or (*study, case.setting.fineness) in cases:
            yield trajectory_file(case)
            yield trajectory_file(case).with_name("truth.npz")


def versions_of(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the version of each engine that has one, by its name in a series."""
    names = unversioned(manifest["engines"])
    return {
        names.get(name, name): entry["version"]
        for name, entry in manifest["engines"].items()
        if "version" in entry
    }


def _summary(judged: Judgement) -> dict[str, Any]:
    manifest, comparison = judged.newest.manifest, judged.comparison
    return {
        "run_id": judged.newest.run_id,
        "created": manifest["created"],
        "machine": machine_class(manifest),
        "bodycheck": manifest["bodycheck"],
        "engines": ", ".join(f"{name} {version}" for name, version in versions_of(manifest).items()),
        "cases": len(judged.newest.cases),
        "compared_with": None if comparison is None else comparison.before.run_id,
        **{status: sum(change.status == status for change in judged.changes) for status in HEADINGS},
        "open": len(judged.open),
        "status": judged.status,
        "headline": headline(judged),
    }


def _write_changes(rows: Iterable[Row], folder: Path) -> None:
    (folder / f"{CHANGES.name}.csv").write_bytes(as_csv(as_table(rows, CHANGES)))


def _change_rows(judged: Judgement) -> Iterator[Row]:
    compared_with = judged.comparison.before.run_id if judged.comparison else None
    open_now = {one.id: one for one in judged.open}
    for change in judged.changes:
        row: Row = {"run_id": judged.newest.run_id, "compared_with": compared_with}
        row |= {name: getattr(change, name) for name in CHANGES.columns if hasattr(change, name)}
        row |= {name: None if row[name] is None else str(row[name]) for name in ("before", "after")}
        row["id"] = change.key.id
        if (one := open_now.get(change.key.id)) is not None:
            row |= {"since": one.since, "runs": one.runs}
        yield row


_FEED_FILE = "feed.xml"
"""The name of the feed in the folder of a history."""

_ATOM = "http://www.w3.org/2005/Atom"
_ENTRIES = 50
_NEVER = datetime(1970, 1, 1, tzinfo=UTC)


def write_feed(
    folder: Path, runs: Iterable[tuple[Mapping[str, Any], NightlyState]], acceptances: Iterable[Acceptance]
) -> None:
    """Write the feed of a history atomically; raises InputError if it cannot be written.

    runs: the content of each night.json with what is open after the run, the oldest first.
    """
    write_file(folder / _FEED_FILE, feed(runs, acceptances))


@dataclass(frozen=True)
class _Entry:
    """What a nightly run opened, closed or found accepted. name: unique within the run."""

    run: Mapping[str, Any]
    name: str
    title: str
    summary: str


def feed(
    runs: Iterable[tuple[Mapping[str, Any], NightlyState]], acceptances: Iterable[Acceptance] = ()
) -> bytes:
    """Return the feed: an entry per regression that is newly worse, gone or accepted, the newest first.

    Its links are relative to the folder of the history.
    """
    entries = list(_entries(runs, {one.id: one for one in acceptances}))[::-1][:_ENTRIES]
    updated = started_at(entries[0].run["run_id"]) if entries else _NEVER
    root = ET.Element("feed", xmlns=_ATOM)
    _describe(root, "urn:bodycheck:history", "bodycheck: regressions", updated)
    ET.SubElement(ET.SubElement(root, "author"), "name").text = "bodycheck"
    ET.SubElement(root, "link", rel="self", href=_FEED_FILE)
    for one in entries:
        entry, run_id = ET.SubElement(root, "entry"), one.run["run_id"]
        _describe(entry, f"urn:bodycheck:{run_id}{one.name}", one.title, started_at(run_id))
        ET.SubElement(entry, "link", rel="alternate", href=f"{run_id}/night.html")
        ET.SubElement(entry, "summary").text = one.summary
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _entries(
    runs: Iterable[tuple[Mapping[str, Any], NightlyState]], acceptances: Mapping[str, Acceptance]
) -> Iterator[_Entry]:
    """Yield the entries of each run, the most severe last."""
    told: set[str] = set()
    for run, state in runs:
        measured = f"{count(run['cases'], 'case')} of {run['engines']} on {run['machine']}"
        for one in open_lines(one for one in state.recovered if one.is_failing):
            yield _Entry(run, f":closed:{one.id}", one.text_closed, measured)
        for name in state.acceptances:
            if name in acceptances and name not in told:
                told.add(name)
                yield _Entry(
                    run, f":accepted:{name}", f"Acceptance {acceptance_text(acceptances[name])}", measured
                )
        for one in reversed(open_lines(one for one in state.regressions if one.is_failing)):
            if one.newly:
                since = f"worse since {one.duration}; {measured}"
                yield _Entry(run, f":opened:{one.id}", one.text, since)
        if run["status"] == "regression" and not state.regressions:  # of an earlier version
            yield _Entry(run, "", f"{run['worse']} worse, {run['missing']} no longer measured", measured)


def _describe(parent: ET.Element, identity: str, title: str, updated: datetime) -> None:
    for name, text in (("id", identity), ("title", title), ("updated", updated.isoformat())):
        ET.SubElement(parent, name).text = text
