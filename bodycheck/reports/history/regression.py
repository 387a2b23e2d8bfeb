"""Compare a nightly run with the accepted levels: what is worse and since when, improved, or missing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.adapters.engine_names import pin_of
from bodycheck.reports.comparison.change import Change, Status
from bodycheck.reports.comparison.compare import (
    Comparison,
    compare,
    renamed,
    unversioned,
)
from bodycheck.reports.comparison.headlines import BROKEN, new_causes, releases
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.history.acceptances import Acceptance, read_acceptances, with_acceptances
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import Baseline, NightlyRun, baseline_of, machine_class
from bodycheck.reports.history.levels import Cells, Levels, LevelSource
from bodycheck.reports.history.open_regressions import (
    MeasuredValues,
    NightlyState,
    Regression,
    next_regressions,
)
from bodycheck.reports.history.queries import recorded_cases
from bodycheck.reports.history.step_detection import (
    CASE,
    MIN_AFTER,
    MIN_BEFORE,
    MIN_STEP,
    Key,
    Series,
    Step,
    detect_steps,
    series_of,
)
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.run_files.run_tables import Tables, announced_of, case_key

if TYPE_CHECKING:
    import pandas as pd

RunStatus: TypeAlias = Literal["regression", "no regression", "insufficient history", "nothing measured"]


@dataclass(frozen=True, eq=False)
class Judgement:
    """The newest nightly run compared with the accepted levels.

    comparison: with the levels; None if there is no baseline run. levels, state: what the next nightly run is
    compared with. acceptances: those that count on such a machine.
    speeds, errors: of all methods, over the baseline runs and the newest run. history: its folder.
    """

    history: Path
    newest: Tables
    baseline: Baseline
    comparison: Comparison | None
    levels: Levels
    state: NightlyState
    acceptances: tuple[Acceptance, ...]
    speeds: Speeds
    errors: Series

    @property
    def open(self) -> tuple[Regression, ...]:
        """The deteriorations that are neither gone nor accepted."""
        return tuple(one for one in self.state.regressions if one.is_failing)

    @property
    def other_maps(self) -> tuple[Regression, ...]:
        """The changes of maps and laws that are neither gone nor accepted; they fail nothing."""
        return tuple(one for one in self.state.regressions if not one.is_failing)

    @property
    def changes(self) -> tuple[Change, ...]:
        """All changes from the levels, the largest first, with those that the run could not measure."""
        own = () if self.comparison is None else self.comparison.changes
        present = {change.key for change in own}
        return (*own, *(one.change for one in self.state.regressions if one.change.key not in present))

    @property
    def status(self) -> RunStatus:
        """Whether a regression is open; undecided without a baseline run."""
        if not any(case.ok for case in self.newest.cases):
            return "nothing measured"
        if self.open:
            return "regression"
        return "no regression" if self.comparison and self.comparison.paired else "insufficient history"


def judge_run(history: History, newest: Tables, thresholds: Thresholds = DEFAULT_THRESHOLDS) -> Judgement:
    """Judge a nightly run against a history that does not contain it yet."""
    baseline, acceptances = _with_acceptances(history, baseline_of(history, newest.manifest))
    runs, cases = _recorded(baseline.runs[::-1], newest)
    first, of_first = _recorded(baseline.first, newest)
    earlier = first[:-1], of_first[of_first["run"] != newest.run_id]
    errors = series_of(runs, cases, ORIENTATION, _farthest)
    last = baseline.runs[0] if baseline.runs else baseline.other
    if last is None:
        speeds = speeds_of(runs, cases, (), earlier)
        levels, state = Levels.of(newest), NightlyState()
        return Judgement(history.folder, newest, baseline, None, levels, state, (), speeds, errors)
    tables, levels = last.tables, last.levels
    engines = (*newest.manifest["engines"], *(case.columns["engine"] for case in newest.cases))
    names = _common_names(engines, levels.engines) | announced_of(newest.manifest)
    aligned = renamed(newest, names)
    known, before = with_acceptances(levels.renamed(names), last.state, acceptances)
    definitions = _definitions(baseline, tables)
    known = known.of_scenarios(definitions)
    former = renamed(replace(tables, manifest={**tables.manifest, "scenarios": definitions}), names)
    known = _with_gains_of_accepted(
        known, former, _newly_accepted(acceptances, before, last.state), thresholds
    )
    comparison = _compared(former, known, aligned, thresholds)
    speeds = speeds_of(runs, cases, before.regressions, earlier)
    changes = [*comparison.changes, *speeds.changes]
    if not baseline.runs:  # on a new class of machines only what was open is compared
        open_before = {one.change.key for one in before.regressions}
        changes = [change for change in changes if change.key in open_before]
        known = Levels.of(aligned).with_levels_of([one.change for one in before.regressions], known)
    changes.sort(key=lambda change: -change.size)
    why = new_causes(former, aligned), releases(former, aligned)
    open_now = tuple(next_regressions(before.regressions, changes, aligned, thresholds, *why))
    changes = _without_gains_of_broken(changes, open_now)
    still = {one.change.key for one in open_now}
    closed = (replace(one, newly=False) for one in before.regressions if one.change.key not in still)
    levels, improved = _next_levels(known, aligned, comparison.redefined, changes, open_now, before)
    own = {names.get(name, name): name for name in engines}
    return Judgement(
        history=history.folder,
        newest=newest,
        baseline=baseline,
        # speeds have their own series
        comparison=replace(comparison, changes=tuple(changes), timed=0) if baseline.runs else None,
        levels=_with_speeds(levels, speeds).renamed(own),
        state=NightlyState(open_now, improved, before.acceptances, tuple(closed)),
        acceptances=acceptances,
        speeds=speeds,
        errors=errors,
    )


def _with_acceptances(history: History, baseline: Baseline) -> tuple[Baseline, tuple[Acceptance, ...]]:
    """Return the acceptances for the class of machines of a baseline; a damaged file is left out."""
    last = baseline.runs[0] if baseline.runs else baseline.other
    if last is None:
        return baseline, ()
    try:
        machine = machine_class(last.manifest)
        return baseline, tuple(one for one in read_acceptances(history) if one.machine == machine)
    except InputError as error:  # what it accepts stays open
        return replace(baseline, left_out=(*baseline.left_out, str(error))), ()


def _common_names(*runs: Iterable[str]) -> dict[str, str]:
    """Return `mujoco==4.0.0` -> `mujoco` for each engine that no run has in several versions."""
    single = [(set(run), unversioned(run)) for run in map(tuple, runs)]
    several = {_base(name) for every, alone in single for name in every - alone.keys()}
    return {name: base for _, alone in single for name, base in alone.items() if base not in several}


def _base(name: str) -> str:
    pin = pin_of(name)
    return name if pin is None else pin.engine


def _definitions(baseline: Baseline, tables: Tables) -> dict[str, Any]:
    """Return the newest definition of each scenario in the baseline runs."""
    scenarios: dict[str, Any] = {}
    for run in reversed(baseline.runs):
        scenarios |= run.manifest["scenarios"]
    return {**scenarios, **tables.manifest["scenarios"]}


def _compared(former: Tables, levels: Levels, newest: Tables, thresholds: Thresholds) -> Comparison:
    """Compare a run with the levels; settings with the run before, `former`.

    A case whose level is not to end well is compared with what it measured when it last did.
    """
    ended_well = {case_key(case.columns) for case in newest.cases if case.ok}
    before = levels.as_tables(former, {case_key(case.columns) for case in newest.cases})
    comparison = compare(before, newest, thresholds)
    returned = [case for case in before.cases if not case.ok and case_key(case.columns) in ended_well]
    changes = [change for change in comparison.changes if change.kind != "speed"]
    if returned:
        well = [replace(case, columns={**case.columns, "outcome": "ok"}) for case in returned]
        keys = {case_key(case.columns) for case in returned}
        mine = replace(newest, cases=tuple(c for c in newest.cases if case_key(c.columns) in keys))
        again = compare(replace(before, cases=tuple(well)), mine, thresholds)
        changes += [one for one in again.changes if one.kind == "accuracy"]
    return replace(comparison, changes=tuple(changes))


def _newly_accepted(
    acceptances: Iterable[Acceptance], now: NightlyState, before: NightlyState
) -> set[tuple[str, str]]:
    """Return engine and method of each deterioration that was accepted since the run before."""
    new = set(now.acceptances) - set(before.acceptances)
    return {(v.change.engine, v.change.method) for one in acceptances if one.id in new for v in one.values}


def _with_gains_of_accepted(
    levels: Levels, former: Tables, accepted: set[tuple[str, str]], thresholds: Thresholds
) -> Levels:
    """Return the levels with what was better together with a deterioration that has been accepted since."""
    if not accepted:
        return levels
    own = Levels.of(former)
    for change in _compared(former, levels, former, thresholds).changes:
        if change.status == "improved" and (change.engine, change.method) in accepted:
            levels = levels.with_cells(change, own.cells(change), LevelSource(former.run_id, "improvement"))
    return levels


def _without_gains_of_broken(changes: Iterable[Change], open_now: Iterable[Regression]) -> list[Change]:
    """Return the changes without what improved in a method that no longer converges or ends well."""
    broken = {(one.change.engine, one.change.method) for one in open_now if one.change.kind in BROKEN}
    return [one for one in changes if one.status != "improved" or (one.engine, one.method) not in broken]


def _next_levels(
    levels: Levels,
    newest: Tables,
    redefined_names: Iterable[str],
    changes: Iterable[Change],
    open_now: Iterable[Regression],
    before: NightlyState,
) -> tuple[Levels, tuple[Change, ...]]:
    """Return the levels after a nightly run, and the improvements that the next one has to confirm.

    What improved together with a deterioration of the same method is no level: a broken method often drifts
    less. Of the two values of a confirmed improvement the larger error is the level.
    """
    kept = {row["scenario"] for row in levels.rows("results").values()} - set(redefined_names)
    found = levels.of_scenarios(kept)
    found = found.with_first_values(newest, [change for change in changes if change.status == "new"])
    broken = {(one.change.engine, one.change.method) for one in open_now if one.is_failing}
    own, measured = Levels.of(newest), MeasuredValues(newest)
    improved = [change for change in before.improved if change.key not in measured]
    for change in changes:
        if change.status != "improved" or change.kind == "speed" or (change.engine, change.method) in broken:
            continue
        earlier = before.improvement(change)
        if earlier is None:
            improved.append(change)
        else:
            cells = _larger(own.cells(change), change, earlier)
            found = found.with_cells(change, cells, LevelSource(newest.run_id, "improvement"))
    return found, tuple(improved)


def _larger(cells: Cells, change: Change, earlier: Change) -> Cells:
    """Return the cells of an improved error, scaled up to its value in the run before if that was larger."""
    now, then = change.after, earlier.after
    if change.kind != "accuracy" or not (isinstance(now, float) and isinstance(then, float)):
        return cells
    return {name: cell * then / now for name, cell in cells.items()} if then > now > 0.0 else cells


def _with_speeds(levels: Levels, speeds: Speeds) -> Levels:
    """Return the levels with the run from which on a faster method's times are its level."""
    for change in speeds.changes:
        if change.status == "improved":
            first = speeds.series.runs[speeds.steps[change.engine, change.method][-1].first]
            levels = levels.with_cells(change, {}, LevelSource(first, "improvement"))
    return levels


def _recorded(runs: Sequence[NightlyRun], newest: Tables) -> tuple[list[str], pd.DataFrame]:
    """Return the names of runs and of the newest, and their cases on scenarios with unchanged definitions.

    An engine that a run has in a single version is named without it, so that a series continues across
    releases.
    """
    import pandas as pd

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
    """The times of all methods in each nightly run, and the detected steps.

    above: decades by which methods were slower than their accepted level after the run before.
    """

    series: Series
    steps: dict[Key, list[Step]]
    above: Mapping[Key, float]

    @property
    def judged(self) -> bool:
        """Whether enough nightly runs measured the speeds."""
        return self.series.measured >= MIN_BEFORE + MIN_AFTER

    @property
    def changes(self) -> Iterator[Change]:
        """The methods that are slower than their level, or that the newest run shows to be faster."""
        newest = len(self.series.runs) - 1
        for (engine, method), decades in zip(self.series.methods, self.series.decades.T, strict=True):
            if np.isnan(decades[-1]):
                continue
            steps = self.steps[engine, method]
            stepped = steps[-1].size if steps and steps[-1].detected_at == newest else 0.0
            size = self.above.get((engine, method), 0.0) + stepped
            if size > MIN_STEP or (stepped and size < -MIN_STEP):
                status: Status = "worse" if size > 0.0 else "improved"
                yield Change("speed", None, engine, method, "relative_cpu", None, None, status, decades=size)


def speeds_of(
    runs: Sequence[str],
    cases: pd.DataFrame,
    open_before: Iterable[Regression] = (),
    earlier: tuple[Sequence[str], pd.DataFrame] | None = None,
) -> Speeds:
    """Return the time of each method, as the median over its cases, and the steps detected in it.

    runs: names of nightly runs, the oldest first. cases: one row per case and run, with its relative_cpu.
    open_before: what was open after the run before. earlier: the same two of the first runs of the history,
    from which a speed may creep more slowly than these runs show.
    """
    import pandas as pd

    def median(decades: pd.Series) -> float:
        return float(decades.median())

    series = series_of(runs, cases, "relative_cpu", median)
    names, more = earlier or ((), cases.iloc[:0])
    known = more.merge(cases[[*CASE]].drop_duplicates(), on=[*CASE])  # of the cases that are still run
    whole = (
        series
        if known.empty
        else series_of([*names, *runs], pd.concat([known, cases]), "relative_cpu", median)
    )
    above = {
        (change.engine, change.method): change.decades or 0.0
        for change in (one.change for one in open_before)
        if change.kind == "speed"
    }
    shift = len(whole.runs) - len(series.runs)
    steps = {
        method: [
            replace(one, first=max(one.first - shift, 0), detected_at=one.detected_at - shift)
            for one in found
            if one.detected_at >= shift
        ]
        for method, found in zip(whole.methods, detect_steps(whole.decades), strict=True)
    }
    return Speeds(series, steps, above)
