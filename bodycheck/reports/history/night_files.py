"""The files of a night: its tables as CSV and as Parquet, what was told of it, and its pages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bodycheck.reports.comparison.change import Change
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.machine_class import machine_class
from bodycheck.reports.html import render_report
from bodycheck.reports.run import Run
from bodycheck.reports.store import write_tables
from bodycheck.reports.table_formats import as_csv, as_parquet

if TYPE_CHECKING:
    import pandas as pd

_CHANGE_COLUMNS = (
    *("run_id", "compared_with", "kind", "direction", "scenario", "engine", "method", "control", "fineness"),
    *("what", "before", "after", "decades"),
)


def write_run_of_night(run: Run, night: Path) -> None:
    """Write what was measured, before it is judged: the tables and report.html."""
    write_tables(run, night)
    for name, table in {"results": run.results, "methods": run.methods, "stability": run.stability}.items():
        (night / f"{name}.parquet").write_bytes(as_parquet(table))
    (night / "report.html").write_text(render_report(run), encoding="utf-8")


def write_judgement(judged: Judgement, night: Path) -> None:
    """Write what was told: night.json, and each change in changes.csv and changes.parquet."""
    (night / "night.json").write_text(json.dumps(_summary(judged), indent=2) + "\n", encoding="utf-8")
    changes = _changes_table(judged)
    (night / "changes.csv").write_bytes(as_csv(changes))
    (night / "changes.parquet").write_bytes(as_parquet(changes))


def _summary(judged: Judgement) -> dict[str, Any]:
    manifest, comparison = judged.tonight.manifest, judged.comparison
    changes = comparison.changes if comparison is not None else ()
    versions = {name: entry["version"] for name, entry in manifest["engines"].items() if "version" in entry}
    return {
        "run_id": judged.tonight.run_id,
        "created": manifest["created"],
        "machine": machine_class(manifest),
        "bodycheck": manifest["bodycheck"],
        "engines": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "cases": len(judged.tonight.cases),
        "compared_with": None if comparison is None else comparison.before.run_id,
        "worse": sum(change.direction == "worse" for change in changes),
        "better": sum(change.direction == "better" for change in changes),
        "other": sum(change.direction == "other" for change in changes),
        "status": judged.status,
    }


def _changes_table(judged: Judgement) -> pd.DataFrame:
    import pandas as pd

    comparison = judged.comparison
    rows = [] if comparison is None else [_row(change) for change in comparison.changes]
    with_whom = {} if comparison is None else {"compared_with": comparison.before.run_id}
    table = pd.DataFrame(rows, columns=list(_CHANGE_COLUMNS)).assign(
        run_id=judged.tonight.run_id, **with_whom
    )
    return table.astype(dict.fromkeys(("fineness", "decades"), "float64"))


def _row(change: Change) -> dict[str, Any]:
    """Return a change as cells; before and after are words or numbers, and stand as text."""
    row = {name: getattr(change, name) for name in _CHANGE_COLUMNS if hasattr(change, name)}
    return row | {name: None if row[name] is None else str(row[name]) for name in ("before", "after")}
