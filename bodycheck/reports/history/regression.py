"""Compare a nightly run with its baseline runs: worse, improved, moved, missing; slower or faster."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from bodycheck.reports.comparison.change import Change, Status
from bodycheck.reports.comparison.compare import (
    Comparison,
    compare,
    ended_well_anew,
    paired_versions,
    unversioned,
)
from bodycheck.reports.comparison.environment_diff import redefined
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.history.accepted_levels import at_accepted, next_accepted
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import Past, past_of
from bodycheck.reports.history.queries import recorded_cases
from bodycheck.reports.history.step_detection import Key, Series, Step, detect_steps, series_of
from bodycheck.reports.run_files.run_reader import Tables

if TYPE_CHECKING:
    import pandas as pd

NightStatus: TypeAlias = Literal["regression", "no regression", "insufficient history", "nothing measured"]


@dataclass(frozen=True, eq=False)
class Judgement:
    """The newest nightly run compared with the baseline runs.

    comparison: with the accepted levels and the latest baseline run; changes of speed use all baseline runs.
    None if there is no baseline run. accepted: the levels with which the next nightly run is compared, as
    rows of results.csv. speeds, errors: of all methods, over the baseline runs and the newest run.
    """

    tonight: Tables
    past: Past
    comparison: Comparison | None
    accepted: tuple[dict[str, Any], ...]
    speeds: Speeds
    errors: Series

    @property
    def status(self) -> NightStatus:
        """Whether anything became worse or is no longer measured; undecided without a baseline run."""
        if not any(case.ok for case in self.tonight.cases):
            return "nothing measured"
        if self.comparison is None or not self.comparison.paired:
            return "insufficient history"
        return "regression" if self.comparison.failing else "no regression"


def judge_night(history: History, tonight: Tables, thresholds: Thresholds = DEFAULT_THRESHOLDS) -> Judgement:
    """Judge a nightly run against a history that does not contain it yet."""
    past = past_of(history, tonight.manifest)
    nights, cases = _recorded(past, tonight)
    speeds = speeds_of(nights, cases)
    comparison, accepted = None, tuple(dict(case.columns) for case in tonight.cases if case.ok)
    if past.nights:
        levels, aligned = paired_versions(past.nights[0].accepted, tonight)
        before, _ = paired_versions(past.nights[0].tables, tonight)
        comparison = compare(at_accepted(before, levels), aligned, thresholds)
        changes = [change for change in comparison.changes if change.kind != "speed"]
        changes += [*_returned(before, levels, aligned, thresholds), *speeds.changes]
        changes.sort(key=lambda change: -change.size)
        comparison = replace(comparison, changes=tuple(changes))
        apart = redefined(before.manifest, tonight.manifest)
        own = {
            a.columns["engine"]: b.columns["engine"]
            for a, b in zip(aligned.cases, tonight.cases, strict=True)
        }
        accepted = tuple(
            {**row, "engine": own.get(row["engine"], row["engine"])}
            for row in next_accepted(levels, aligned, apart, changes)
        )
    errors = series_of(nights, cases, "orientation_error_rad", _farthest)
    return Judgement(tonight, past, comparison, accepted, speeds, errors)


def _returned(before: Tables, levels: Tables, tonight: Tables, thresholds: Thresholds) -> list[Change]:
    """Return the changes from their levels of cases that end well again after not ending well in `before`."""
    returned = compare(levels, ended_well_anew(before, tonight), thresholds)
    return [change for change in returned.changes if change.kind == "accuracy"]


def _recorded(past: Past, tonight: Tables) -> tuple[list[str], pd.DataFrame]:
    """Return the names of all runs, and their cases on scenarios whose definitions are unchanged.

    An engine that a run has in a single version is named without it, so that a series continues across
    releases.
    """
    import pandas as pd

    nights = past.nights[::-1]
    cases = recorded_cases([night.folder for night in nights])
    same = {(night.name, scenario) for night in nights for scenario in night.same_scenarios(tonight.manifest)}
    comparable = [pair in same for pair in zip(cases["night"], cases["scenario"], strict=True)]
    mine = tonight.results[tonight.results["outcome"] == "ok"].assign(night=tonight.run_id)
    together = [frame for frame in (cases[comparable], mine[list(cases.columns)]) if len(frame)]
    found = pd.concat(together) if together else cases
    names = {night.name: unversioned(night.manifest["engines"]) for night in nights}
    names[tonight.run_id] = unversioned(tonight.manifest["engines"])
    engines = [
        names[night].get(engine, engine)
        for night, engine in zip(found["night"], found["engine"], strict=True)
    ]
    return [*(night.name for night in nights), tonight.run_id], found.assign(engine=engines)


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
        tonight = len(self.series.nights) - 1
        for (engine, method), steps in self.steps.items():
            if steps and steps[-1].detected_at == tonight:
                size = steps[-1].size
                status: Status = "worse" if size > 0.0 else "improved"
                yield Change("speed", None, engine, method, "relative_cpu", None, None, status, decades=size)


def speeds_of(nights: Sequence[str], cases: pd.DataFrame) -> Speeds:
    """Return the time of each method, as the median over its cases, and the steps detected in it.

    nights: names of nightly runs, the oldest first. cases: one row per case and run, with its relative_cpu.
    """
    series = series_of(nights, cases, "relative_cpu", lambda decades: float(decades.median()))
    return Speeds(series, dict(zip(series.methods, detect_steps(series.decades), strict=True)))
