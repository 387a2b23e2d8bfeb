"""Tonight beside the past: what became worse, better, or is not measured any more."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

from bodycheck.errors import InputError
from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import Comparison, compare, ended_well_anew
from bodycheck.reports.history.nights import History
from bodycheck.reports.history.past import Night, Past, past_of
from bodycheck.reports.history.queries import recorded_cases
from bodycheck.reports.history.series import Series, series_of
from bodycheck.reports.history.speeds import Speeds, speeds_of
from bodycheck.reports.stored import Tables

if TYPE_CHECKING:
    import pandas as pd

Status: TypeAlias = Literal["regression", "no regression", "past too thin", "nothing measured"]


@dataclass(frozen=True, eq=False)
class Judgement:
    """What tonight is beside the past.

    comparison: with the night before, but for the changes of speed, which the nights before that have a say
    in; None where there is no night to compare with. speeds, errors: of all methods in the past and tonight.
    """

    tonight: Tables
    past: Past
    comparison: Comparison | None
    speeds: Speeds
    errors: Series

    @property
    def status(self) -> Status:
        """Whether anything became worse or is not measured any more; without a past nothing can be told."""
        if not any(case.ok for case in self.tonight.cases):
            return "nothing measured"
        if self.comparison is None or not self.comparison.paired:
            return "past too thin"
        worse = any(change.direction == "worse" for change in self.comparison.changes)
        return "regression" if worse else "no regression"


def judge_night(history: History, tonight: Tables) -> Judgement:
    """Return what a night is beside those of the history, which it is not among."""
    past = past_of(history, tonight.manifest)
    nights, cases = _recorded(past, tonight)
    speeds = speeds_of(nights, cases)
    comparison = None
    if past.nights:
        before = past.nights[0].tables
        comparison = compare(before, tonight)
        changes = [_worse_if_lost(change) for change in comparison.changes if change.kind != "speed"]
        changes += [*_returned(past, before, tonight), *speeds.changes]
        changes.sort(key=lambda change: -change.size)
        comparison = replace(comparison, changes=tuple(changes))
    errors = series_of(nights, cases, "orientation_error_rad", _farthest)
    return Judgement(tonight, past, comparison, speeds, errors)


def _worse_if_lost(change: Change) -> Change:
    """Return a change as a night sees it, where what is not measured any more is worse."""
    lost = change.kind in ("case", "accuracy") and change.after is None
    return replace(change, direction="worse") if lost else change


def _returned(past: Past, before: Tables, tonight: Tables) -> Iterator[Change]:
    """Yield how cases that end well tonight, but did not the night before, changed since they last did."""
    waiting = ended_well_anew(before, tonight)
    for night in past.nights[1:]:
        if not waiting.cases:
            return
        older = _whole(night)
        if older is not None:
            yield from (change for change in compare(older, waiting).changes if change.kind == "accuracy")
            waiting = ended_well_anew(older, waiting)


def _whole(night: Night) -> Tables | None:
    """Return a night's tables; None where they are damaged: then a night before it may tell."""
    try:
        return night.tables
    except InputError:
        return None


def _recorded(past: Past, tonight: Tables) -> tuple[list[str], pd.DataFrame]:
    """Return the nights up to tonight, and the cases of each, of the scenarios that are still the same."""
    import pandas as pd

    nights = past.nights[::-1]
    cases = recorded_cases([night.folder for night in nights])
    same = {(night.name, scenario) for night in nights for scenario in night.same_scenarios(tonight.manifest)}
    comparable = [pair in same for pair in zip(cases["night"], cases["scenario"], strict=True)]
    mine = tonight.results[tonight.results["outcome"] == "ok"].assign(night=tonight.run_id)
    together = [frame for frame in (cases[comparable], mine[list(cases.columns)]) if len(frame)]
    return [*(night.name for night in nights), tonight.run_id], pd.concat(together) if together else cases


def _farthest(decades: pd.Series) -> float:
    """Return the one that is farthest from zero: no case's error may move unseen among others."""
    return max(decades.tolist(), key=abs)
