"""The deteriorations, and other maps, that are neither gone nor accepted, after each nightly run."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import log10
from pathlib import Path
from typing import Any, TypeAlias

from pydantic import TypeAdapter, ValidationError

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count
from bodycheck._util.untrusted import read_json
from bodycheck.reports.comparison.change import FAILING, MAP_KINDS, NOT_MEASURED, Change, ChangeKey
from bodycheck.reports.comparison.headlines import Headline, cause_of, causes_of, is_known
from bodycheck.reports.document import json_text
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.history.archive import started_at
from bodycheck.reports.measurement.verdicts import severity
from bodycheck.reports.run_files.run_tables import StudyKey, Tables, case_key, study_key
from bodycheck.scenarios.reader import fault_lines

_NUMBER = re.compile(r"[-+]?\d[\d.e+-]*")
FILE = "regressions.json"
"""The file in the folder of a nightly run: what is open after it."""


@dataclass(frozen=True)
class Regression:
    """A deterioration from the accepted level, or another map or law, that is neither gone nor accepted.

    change: as last measured. since: the nightly run that reported it first. runs: the number of nightly runs
    from then on. cause: the diagnosis of the motion. release: like "3.16.0 -> 3.17.0" if the version of the
    engine changed with it, else the range of commits, if known. newly: it is worse than in the run before.
    measured: whether the newest run could measure it.
    """

    change: Change
    since: str
    runs: int = 1
    cause: str = ""
    release: str = ""
    newly: bool = True
    measured: bool = True

    @property
    def id(self) -> str:
        """The id of the changed value, the same in every nightly run."""
        return self.change.key.id

    @property
    def is_failing(self) -> bool:
        """Whether it fails the nightly run; another map does not."""
        return self.change.status in FAILING


@dataclass(frozen=True)
class OpenLine:
    """The open regressions of a method, or of methods of one engine with one cause, as one line."""

    line: Headline
    regressions: tuple[Regression, ...]

    @property
    def newly(self) -> bool:
        """Whether it is worse than in the run before."""
        return self.regressions[0].newly

    @property
    def since(self) -> str:
        """The nightly run that reported it first."""
        return min(one.since for one in self.regressions)

    @property
    def duration(self) -> str:
        """Return "2026-11-25 (2 nightly runs)"."""
        runs = max(one.runs for one in self.regressions)
        return f"{started_at(self.since):%Y-%m-%d} ({count(runs, 'nightly run')})"

    @property
    def id(self) -> str:
        """An id by which all of it is accepted: the same while it is open."""
        name = f"{self.line.engine}:{self.line.methods[0]} {self.since}"
        return hashlib.sha256(name.encode()).hexdigest()[:8]

    @property
    def text(self) -> str:
        """What is worse, and whether this run measured it."""
        unknown = "" if any(one.measured for one in self.regressions) else " (not measured in this run)"
        return f"{self.line.text}{unknown}"

    @property
    def text_closed(self) -> str:
        """That it is gone, and since when it was open."""
        was = "worse" if self.line.direction == "worse" else "another map"
        return f"{self.line.subject}: back at its level{self.line.where}; it was {was} since {self.duration}"


def open_lines(regressions: Iterable[Regression]) -> list[OpenLine]:
    """Return the lines of open regressions: what is newly worse first, then the most severe.

    What two nights made worse of a method is two lines.
    """
    of_method: dict[tuple[str, str, str, bool, bool], list[Regression]] = {}
    for one in sorted(regressions, key=lambda one: -one.change.size):
        group = one.change.engine, one.change.method, one.since, one.newly, one.is_failing
        of_method.setdefault(group, []).append(one)
    of_cause: dict[tuple[str, str, str, bool, bool], list[Regression]] = {}
    for (engine, method, since, newly, failing), own in of_method.items():
        cause = cause_of([(one.change, one.cause) for one in own])
        shared = cause if is_known(cause) else f":{method}"
        of_cause.setdefault((engine, shared, since, newly, failing), []).extend(own)
    found = [
        OpenLine(
            Headline(
                engine,
                tuple(dict.fromkeys(one.change.method for one in own)),
                "worse" if failing else "moved",
                tuple(one.change for one in own),
                cause=cause_of([(one.change, one.cause) for one in own]),
                release=next((one.release for one in own if one.release), ""),
            ),
            tuple(own),
        )
        for (engine, _, _, _, failing), own in of_cause.items()
    ]
    heaviest = sorted(found, key=lambda one: one.line.weight, reverse=True)
    return sorted(heaviest, key=lambda one: not one.newly)


def _scope(one: Regression) -> tuple[object, ...]:
    return one.change.scenario, one.change.engine, one.change.method, one.is_failing


@dataclass(frozen=True)
class NightlyState:
    """What a nightly run leaves to the next one, besides the levels, and what it closed.

    regressions: the open ones. improved: the changes that a second run has to confirm. acceptances: ids of
    those that the levels contain. closed: what was open after the run before and is back at its level, or
    left to a worse verdict.
    """

    regressions: tuple[Regression, ...] = ()
    improved: tuple[Change, ...] = ()
    acceptances: tuple[str, ...] = ()
    closed: tuple[Regression, ...] = ()

    @property
    def recovered(self) -> list[Regression]:
        """What closed, of methods with nothing else open in that scenario, by their values or their map."""
        still = {_scope(one) for one in self.regressions}
        return [one for one in self.closed if _scope(one) not in still]

    def improvement(self, change: Change) -> Change | None:
        """Return the improvement of the same value in the run before; None if there was none."""
        return {one.key: one for one in self.improved}.get(change.key)


@cache
def _adapter() -> TypeAdapter[NightlyState]:
    return TypeAdapter(NightlyState)


def read_state(folder: Path) -> NightlyState:
    """Return what is open after a nightly run; nothing after one of an earlier version.

    Raises InputError if the file is damaged.
    """
    path = folder / FILE
    try:
        return _adapter().validate_python(read_json(path))
    except FileNotFoundError:
        return NightlyState()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        raise InputError(f"{path}: is damaged: {fault_lines(error)[0]}") from None


def write_state(state: NightlyState, folder: Path) -> None:
    """Write what is open after a nightly run into its folder."""
    (folder / FILE).write_text(json_text(state) + "\n", encoding="utf-8")


def next_regressions(
    before: Sequence[Regression],
    changes: Sequence[Change],
    newest: Tables,
    thresholds: Thresholds,
    causes: Mapping[StudyKey, str],
    releases: Mapping[str, str],
) -> Iterator[Regression]:
    """Yield what is open after a nightly run: failing changes, other maps, and earlier ones not measured.

    An order that is not measured because the verdict is worse is left to the verdict.

    before: what was open, without what was accepted since. changes: from the accepted levels. causes,
    releases: diagnoses and versions that differ from those of the run before. A new cause is that of what it
    made worse, not of what was as bad before.
    """
    known = {one.change.key: one for one in before}
    found = {one.key: one for one in changes if one.status in FAILING or one.kind in MAP_KINDS}
    measured, all_causes = MeasuredValues(newest), causes_of(newest)
    grown = {
        _study(change)
        for key, change in found.items()
        if (earlier := known.get(key)) is None or _is_worse(change, earlier.change, thresholds)
    }
    for key, change in found.items():
        earlier, study = known.get(key), _study(change)
        if earlier is None:
            cause = causes.get(study, "")
            yield Regression(change, newest.run_id, cause=cause, release=releases.get(change.engine, ""))
        else:
            newly = _is_worse(change, earlier.change, thresholds)
            of_others = not (earlier.cause or newly) and study in grown  # it was there before that cause
            cause = "" if of_others else (all_causes if earlier.cause else causes).get(study, "")
            if _is_another(cause, earlier.cause):
                yield Regression(change, newest.run_id, cause=cause, release=releases.get(change.engine, ""))
                continue
            yield replace(
                earlier, change=change, runs=earlier.runs + 1, cause=cause, newly=newly, measured=True
            )
    worse_verdicts = {key for key, change in found.items() if change.status in FAILING}
    for key, earlier in known.items():
        if key not in found and key not in measured and key.of_verdict not in worse_verdicts:
            yield replace(earlier, runs=earlier.runs + 1, newly=False, measured=False)


def _study(change: Change) -> StudyKey:
    return change.scenario or "", change.engine, change.method


def _is_another(cause: str, earlier: str) -> bool:
    """Whether a known cause took the place of another one, whatever its numbers: then it is as old as it."""
    names = [_NUMBER.sub("", one) for one in (cause, earlier)]
    return is_known(cause) and earlier != "" and names[0] != names[1]


def _is_worse(change: Change, earlier: Change, thresholds: Thresholds) -> bool:
    """Whether what was already worse deteriorated beyond its threshold, or a map changed again."""
    if change.decades is not None and earlier.decades is not None:
        factor = abs(change.decades) - abs(earlier.decades)
        return factor > log10(1.0 + thresholds.of(change.quantity))
    if change.kind == "order" and isinstance(change.after, float) and isinstance(earlier.after, float):
        quantity = change.quantity.removeprefix("order of ")
        return earlier.after - change.after > thresholds.of_order(quantity)
    if change.kind == "verdict":
        return severity(str(change.after)) > severity(str(earlier.after))
    if change.kind in MAP_KINDS:
        return change.after != earlier.after
    return change.after is None and earlier.after is not None


_Key: TypeAlias = tuple[object, ...]


class MeasuredValues:
    """Which values a nightly run measured, so that one that is not failing is within its level."""

    def __init__(self, newest: Tables) -> None:
        self._cases: dict[tuple[object, ...], bool] = {
            case_key(case.columns): case.ok for case in newest.cases
        }
        self._methods: dict[tuple[object, ...], dict[str, Any]] = {
            (*study_key(row), row["quantity"]): row for row in newest.rows("methods")
        }
        maps = (
            *((row, "one-step map", row["fingerprint"]) for row in newest.rows("fingerprints")),
            *((row, f"law {row['law']}", row["verdict"]) for row in newest.rows("laws")),
        )
        self._maps = {
            (row["engine"], row["method"], quantity)
            for row, quantity, found in maps
            if found not in NOT_MEASURED
        }
        self._searches = {study_key(row) for row in newest.rows("stability")}
        self._timed = {
            (case.columns["engine"], case.columns["method"])
            for case in newest.cases
            if "relative_cpu" in case.columns
        }

    def __contains__(self, key: ChangeKey) -> bool:
        study = key.scenario, key.engine, key.method
        match key.kind:
            case "case" | "outcome":
                return (*study, key.control, key.fineness) in self._cases
            case "accuracy":
                return self._cases.get((*study, key.control, key.fineness), False)
            case "verdict" | "order":
                row = self._methods.get((*study, key.quantity.removeprefix(f"{key.kind} of ")), {})
                # a sound verdict needs no order, as of errors at round-off
                return bool(row) and (key.kind in row or severity(row["verdict"]) == 0)
            case "fingerprint" | "law":
                return (key.engine, key.method, key.quantity) in self._maps
            case "speed":
                return (key.engine, key.method) in self._timed
            case _:
                return study in self._searches
