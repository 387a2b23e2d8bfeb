"""Nightly runs derived from one measured run: other times and planted changes, nothing measured again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs import nightly_run
from tests.helpers.gate_tables import with_tables

Change = Callable[[pd.DataFrame], pd.DataFrame]


def unchanged(results: pd.DataFrame) -> pd.DataFrame:
    """Return the results unchanged."""
    return results


def scaled(factor: float, method: str = "m1", dt_s: float = 0.01, scenario: str = "slow") -> Change:
    """Return a change that multiplies the orientation error of one case."""

    def change(results: pd.DataFrame) -> pd.DataFrame:
        mine = (results["scenario"] == scenario) & (results["method"] == method) & (results["dt_s"] == dt_s)
        results.loc[mine, "orientation_error_rad"] *= factor
        return results

    return change


def as_nightly_run(run: Run, number: int, change: Change = unchanged, **manifest: Any) -> Run:
    """Return the run as nightly run `number`, with its results changed."""
    run_id = f"2026{number // 744 + 1:02d}{number // 24 % 31 + 1:02d}T{number % 24:02d}0000Z-{number:06x}"
    results = change(run.results.copy())
    outcomes = {str(name): int(count) for name, count in results["outcome"].value_counts().items()}
    return replace(
        with_tables(run, results=results),
        run_id=run_id,
        tables={name: [{**row, "run_id": run_id} for row in rows] for name, rows in run.tables.items()},
        manifest={**run.manifest, "run_id": run_id, "outcomes": outcomes, **manifest},
    )


def store_nightly_runs(
    run: Run,
    folder: Path,
    changes: Iterable[Change],
    *,
    first: int = 0,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
    pages: bool = True,
    **manifest: Any,
) -> list[Judgement]:
    """Store one nightly run per change, in their order; return the judgement of each.

    pages: whether to render the report and the trends, and to write the motions.
    """
    history = History.at(folder)
    runs = (as_nightly_run(run, first + k, change, **manifest) for k, change in enumerate(changes))
    with nullcontext() if pages else without_pages():
        return [nightly_run.store_nightly(run, history, thresholds)[0] for run in runs]


def judged_nightly_runs(*args: Any, **kwargs: Any) -> list[Judgement]:
    """Store nightly runs as store_nightly_runs does, without pages."""
    return store_nightly_runs(*args, pages=False, **kwargs)


@contextmanager
def without_pages() -> Iterator[None]:
    """Store nightly runs without the report, the trends and the motions, which take most of the time."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(nightly_run, "report_pages", lambda _: ())
        patched.setattr(nightly_run, "write_trajectories", lambda *_: None)
        patched.setattr(nightly_run, "trends_page", lambda _: "")
        yield


def slower(results: pd.DataFrame, engine: str, factor: float) -> pd.DataFrame:
    """Return the results with all times of an engine multiplied by a factor."""
    mine = results["engine"] == engine
    results.loc[mine, ["relative_cpu", "cpu_s", "cpu_s_low", "cpu_s_high"]] *= factor
    return results
