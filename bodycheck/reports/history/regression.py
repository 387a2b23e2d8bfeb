"""Compare a nightly run with its baseline runs: worse, improved, moved, missing; slower or faster."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from bodycheck.reports.comparison.change import Change, Status
from bodycheck.reports.comparison.compare import (
    Comparison,
    compare,
    newly_ended_well,
    paired_versions,
    unversioned,
)
from bodycheck.reports.comparison.environment_diff import redefined
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.history.accepted_levels import at_accepted, next_accepted
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import Baseline, baseline_of
from bodycheck.reports.history.queries import recorded_cases
from bodycheck.reports.history.step_detection import Key, Series, Step, detect_steps, series_of
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.run_files.run_reader import Tables
from bodycheck.reports.run_files.run_tables import case_key

if TYPE_CHECKING:
    import pandas as pd

RunStatus: TypeAlias = Literal["regression", "no regression", "insufficient history", "nothing measured"]


@dataclass(frozen=True, eq=False)
class Judgement:
    """The newest nightly run compared with the baseline runs.

    comparison: with the accepted levels and the latest baseline run; changes of speed use all baseline runs.
    None if there is no baseline run. accepted: the levels with which the next nightly run is compared, as
    rows of results.csv. speeds, errors: of all methods, over the baseline runs and the newest run.
    """

    newest: Tables
    baseline: Baseline
    comparison: Comparison | None
    accepted: tuple[dict[str, Any], ...]
    speeds: Speeds
    errors: Series

    @property
    def status(self) -> RunStatus:
        """Whether anything became worse or is no longer measured; undecided without a baseline run."""
        if not any(case.ok for case in self.newest.cases):
            return "nothing measured"
        if self.comparison is None:
            return "insufficient history"
        if self.comparison.failing:
            return "regression"
        return "no regression" if self.comparison.paired else "insufficient history"


def judge_run(history: History, newest: Tables, thresholds: Thresholds = DEFAULT_THRESHOLDS) -> Judgement:
    """Judge a nightly run against a history that does not contain it yet."""
    baseline = baseline_of(history, newest.manifest)
    runs, cases = _recorded(baseline, newest)
    speeds = speeds_of(runs, cases)
    comparison, accepted = None, tuple(dict(case.columns) for case in newest.cases if case.ok)
    if baseline.runs:
        # the levels also have the engines that the newest baseline run lacks
        levels, aligned = paired_versions(baseline.runs[0].accepted, newest)
        before, _ = paired_versions(_with_all_definitions(baseline), newest)
        levels = _of_scenarios(levels, before.manifest["scenarios"])
        before = _with_missing_cases(at_accepted(before, levels), levels, aligned)
        comparison = compare(before, aligned, thresholds)
        changes = [change for change in comparison.changes if change.kind != "speed"]
        changes += [*_returned(before, levels, aligned, thresholds), *speeds.changes]
        changes.sort(key=lambda change: -change.size)
        comparison = replace(comparison, changes=tuple(changes), timed=0)  # speeds have their own series
        discarded = redefined(before.manifest, newest.manifest)
        own = {
            a.columns["engine"]: b.columns["engine"] for a, b in zip(aligned.cases, newest.cases, strict=True)
        }
        accepted = tuple(
            {**row, "engine": own.get(row["engine"], row["engine"])}
            for row in next_accepted(levels, aligned, discarded, changes)
        )
    errors = series_of(runs, cases, ORIENTATION, _farthest)
    return Judgement(newest, baseline, comparison, accepted, speeds, errors)


def _with_all_definitions(baseline: Baseline) -> Tables:
    """Return the newest baseline run, with the definition of each scenario in the newest run that has it."""
    tables = baseline.runs[0].tables
    scenarios: dict[str, Any] = {}
    for run in reversed(baseline.runs):
        scenarios |= run.manifest["scenarios"]
    return replace(tables, manifest={**tables.manifest, "scenarios": scenarios})


def _of_scenarios(tables: Tables, scenarios: Container[str]) -> Tables:
    return replace(tables, cases=tuple(c for c in tables.cases if c.columns["scenario"] in scenarios))


def _with_missing_cases(before: Tables, levels: Tables, newest: Tables) -> Tables:
    """Return a run with the levels of those cases that it lacks but the newest run has again."""
    present = {case_key(case.columns) for case in before.cases}
    again = {case_key(case.columns) for case in newest.cases} - present
    return replace(before, cases=(*before.cases, *(c for c in levels.cases if case_key(c.columns) in again)))


def _returned(before: Tables, levels: Tables, newest: Tables, thresholds: Thresholds) -> list[Change]:
    """Return the changes from their levels of cases that end well again after not ending well in `before`."""
    returned = compare(levels, newly_ended_well(before, newest), thresholds)
    return [change for change in returned.changes if change.kind == "accuracy"]


def _recorded(baseline: Baseline, newest: Tables) -> tuple[list[str], pd.DataFrame]:
    """Return the names of all runs, and their cases on scenarios whose definitions are unchanged.

    An engine that a run has in a single version is named without it, so that a series continues across
    releases.
    """
    import pandas as pd

    runs = baseline.runs[::-1]
    cases = recorded_cases([run.folder for run in runs])
    same = {(run.name, scenario) for run in runs for scenario in run.same_scenarios(newest.manifest)}
    comparable = [pair in same for pair in zip(cases["run"], cases["scenario"], strict=True)]
    own = newest.results[newest.results["outcome"] == "ok"].assign(run=newest.run_id)
    frames = [frame for frame in (cases[comparable], own[list(cases.columns)]) if len(frame)]
    found = pd.concat(frames) if frames else cases
    names = {run.name: unversioned(run.manifest["engines"]) for run in runs}
    names[newest.run_id] = unversioned(newest.manifest["engines"])
    engines = [
        names[run].get(engine, engine) for run, engine in zip(found["run"], found["engine"], strict=True)
    ]
    return [*(run.name for run in runs), newest.run_id], found.assign(engine=engines)


def _farthest(decades: pd.Series) -> float:
    """Return the value farthest from zero, so that no change of a single case is hidden by the others."""
    return max(decades.tolist(), key=abs)


@dataclass(frozen=True, eq=False)
class Speeds:
    """The times of all methods in each nightly run, and the detected steps."""

    series: Series
    steps: dict[Key, list[Step]]

    @property
    def changes(self) -> Iterator[Change]:
        """The steps detected in the newest run."""
        newest = len(self.series.runs) - 1
        for (engine, method), steps in self.steps.items():
            if steps and steps[-1].detected_at == newest:
                size = steps[-1].size
                status: Status = "worse" if size > 0.0 else "improved"
                yield Change("speed", None, engine, method, "relative_cpu", None, None, status, decades=size)


def speeds_of(runs: Sequence[str], cases: pd.DataFrame) -> Speeds:
    """Return the time of each method, as the median over its cases, and the steps detected in it.

    runs: names of nightly runs, the oldest first. cases: one row per case and run, with its relative_cpu.
    """
    series = series_of(runs, cases, "relative_cpu", lambda decades: float(decades.median()))
    return Speeds(series, dict(zip(series.methods, detect_steps(series.decades), strict=True)))
