"""Write the files of a nightly run: tables as CSV and Parquet, its report and its pages."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import unversioned
from bodycheck.reports.comparison.describe import HEADINGS
from bodycheck.reports.history.accepted_levels import write_accepted
from bodycheck.reports.history.baseline import SUMMARY_FILE, SUMMARY_KEYS, machine_class
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.render.html import render_report
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.run_files.table_formats import as_csv, as_parquet
from bodycheck.reports.run_files.writer import write_tables

if TYPE_CHECKING:
    import pandas as pd

_CHANGE_COLUMNS = (
    *("run_id", "compared_with", "kind", "status", "scenario", "engine", "method", "control", "fineness"),
    *("quantity", "before", "after", "decades"),
)


def write_nightly_tables(run: Run, folder: Path) -> None:
    """Write the measured tables, before the run is judged."""
    write_tables(run, folder)
    for name, table in {"results": run.results, "methods": run.methods, "stability": run.stability}.items():
        (folder / f"{name}.parquet").write_bytes(as_parquet(table))


def write_nightly_report(run: Run, folder: Path) -> None:
    """Write report.html."""
    (folder / "report.html").write_text(render_report(run), encoding="utf-8")


def write_unjudged(run: Run, folder: Path) -> None:
    """Write night.json and empty tables of changes for a run that could not be judged."""
    import pandas as pd

    known = {"run_id": run.run_id, "status": "not judged", "cases": len(run.cases)}
    summary = {**dict.fromkeys(SUMMARY_KEYS, 0), "engines": ", ".join(run.manifest["engines"]), **known}
    summary |= {"created": run.manifest["created"], "machine": machine_class(run.manifest)}
    (folder / SUMMARY_FILE).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    empty = pd.DataFrame(columns=list(_CHANGE_COLUMNS))
    (folder / "changes.csv").write_bytes(as_csv(empty))
    (folder / "changes.parquet").write_bytes(as_parquet(empty))


def write_judgement(judged: Judgement, folder: Path) -> None:
    """Write night.json, changes.csv, changes.parquet and the accepted levels."""
    (folder / "night.json").write_text(json.dumps(_summary(judged), indent=2) + "\n", encoding="utf-8")
    changes = _changes_table(judged)
    (folder / "changes.csv").write_bytes(as_csv(changes))
    (folder / "changes.parquet").write_bytes(as_parquet(changes))
    write_accepted(judged.accepted, judged.newest.run_id, folder)


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
    changes = comparison.changes if comparison is not None else ()
    return {
        "run_id": judged.newest.run_id,
        "created": manifest["created"],
        "machine": machine_class(manifest),
        "bodycheck": manifest["bodycheck"],
        "engines": ", ".join(f"{name} {version}" for name, version in versions_of(manifest).items()),
        "cases": len(judged.newest.cases),
        "compared_with": None if comparison is None else comparison.before.run_id,
        **{status: sum(change.status == status for change in changes) for status in HEADINGS},
        "status": judged.status,
    }


def _changes_table(judged: Judgement) -> pd.DataFrame:
    import pandas as pd

    comparison = judged.comparison
    rows = [] if comparison is None else [_row(change) for change in comparison.changes]
    compared_with = {} if comparison is None else {"compared_with": comparison.before.run_id}
    table = pd.DataFrame(rows, columns=list(_CHANGE_COLUMNS)).assign(
        run_id=judged.newest.run_id, **compared_with
    )
    return table.astype(dict.fromkeys(("fineness", "decades"), "float64"))


def _row(change: Change) -> dict[str, Any]:
    """Return a change as cells; before and after may be words or numbers, so both are stored as text."""
    row = {name: getattr(change, name) for name in _CHANGE_COLUMNS if hasattr(change, name)}
    return row | {name: None if row[name] is None else str(row[name]) for name in ("before", "after")}
