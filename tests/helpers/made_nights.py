"""Nights made from one run that was measured once: other times, planted changes, nothing measured anew."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.nightly_run import store_night

Change = Callable[[pd.DataFrame], pd.DataFrame]


def unchanged(results: pd.DataFrame) -> pd.DataFrame:
    """Return the same."""
    return results


def run_of_night(run: Run, number: int, change: Change = unchanged, **manifest: Any) -> Run:
    """Return the run as if it had been made on night `number`, with its results changed."""
    run_id = f"2026{number // 744 + 1:02d}{number // 24 % 31 + 1:02d}T{number % 24:02d}0000Z-{number:06x}"
    results = change(run.results.copy()).assign(run_id=run_id)
    outcomes = {str(name): int(count) for name, count in results["outcome"].value_counts().items()}
    return replace(
        run,
        run_id=run_id,
        results=results,
        methods=run.methods.assign(run_id=run_id),
        stability=run.stability.assign(run_id=run_id),
        probes=run.probes.assign(run_id=run_id),
        manifest={**run.manifest, "run_id": run_id, "outcomes": outcomes, **manifest},
    )


def stored(
    run: Run,
    folder: Path,
    changes: Iterable[Change],
    *,
    first: int = 0,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
    **manifest: Any,
) -> list[Judgement]:
    """Store one night for each change, in turn; return what was told of each."""
    history = History.at(folder)
    nights = (run_of_night(run, first + k, change, **manifest) for k, change in enumerate(changes))
    return [store_night(night, history, thresholds)[0] for night in nights]


def slower(results: pd.DataFrame, engine: str, factor: float) -> pd.DataFrame:
    """Return the results with all times of an engine so many times as long."""
    mine = results["engine"] == engine
    results.loc[mine, ["relative_cpu", "cpu_s", "cpu_s_low", "cpu_s_high"]] *= factor
    return results
