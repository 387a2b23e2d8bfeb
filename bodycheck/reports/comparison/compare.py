"""Compare two runs: a pure function of their tables, symmetric in the two."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from bodycheck.adapters.engine_names import pin_of
from bodycheck.reports.comparison.change import (
    FAILING,
    NOT_MEASURED,
    Change,
    Floors,
    Ratio,
    Status,
    accuracy_changes,
    by_rank,
    changed_judgements,
    ratio,
    sign_changes,
    speed_changes,
    stability_change,
)
from bodycheck.reports.comparison.environment_diff import (
    environment_diff,
    is_refinement,
    redefined,
    same_machine,
)
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.run_files.run_tables import CaseKey, Tables, announced_of, case_key, study_key


def paired_versions(before: Tables, after: Tables) -> tuple[Tables, Tables]:
    """Return both runs with `mujoco==3.17.0` of one and `mujoco==4.0.0` of the other renamed to `mujoco`.

    An engine that either run has in several versions keeps its names: each version counts as an engine.
    A program that one run calls by its command has the name that it announced in the other.
    """
    announced = announced_of(before.manifest) | announced_of(after.manifest)
    before, after = renamed(before, announced), renamed(after, announced)
    old, new = (_versions(_engines(tables)) for tables in (before, after))
    alone = [
        base
        for base in old.keys() & new.keys()
        if len(old[base]) == len(new[base]) == 1 and old[base] != new[base]
    ]
    return renamed(before, {name: base for base in alone for name in old[base]}), renamed(
        after, {name: base for base in alone for name in new[base]}
    )


def unversioned(names: Iterable[str]) -> dict[str, str]:
    """Return `mujoco==3.17.0` -> `mujoco` for each engine that the names have in a single version."""
    return {name: base for base, found in _versions(names).items() if len(found) == 1 for name in found}


def _versions(names: Iterable[str]) -> dict[str, set[str]]:
    """Return the names of each engine, with and without versions."""
    found: dict[str, set[str]] = {}
    for name in names:
        pin = pin_of(name)
        found.setdefault(name if pin is None else pin.engine, set()).add(name)
    return found


def _engines(tables: Tables) -> Iterable[str]:
    return dict.fromkeys((*tables.manifest["engines"], *(case.columns["engine"] for case in tables.cases)))


def renamed(run: Tables, names: Mapping[str, str]) -> Tables:
    """Return the tables of a run with engines renamed in each table, in the cases and in the manifest."""
    if all(name == base for name, base in names.items()):
        return run

    def row(one: Mapping[str, Any]) -> dict[str, Any]:
        return {**one, "engine": names.get(one["engine"], one["engine"])}

    engines: dict[str, Any] = {
        names.get(name, name): entry for name, entry in run.manifest["engines"].items()
    }
    return Tables(
        run_id=run.run_id,
        manifest={**run.manifest, "engines": engines},
        cases=tuple(replace(case, columns=row(case.columns)) for case in run.cases),
        tables={name: list(map(row, rows)) for name, rows in run.tables.items()},
    )


_Row: TypeAlias = Mapping[str, Any]
_Key: TypeAlias = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """What changed from one run to another.

    before, after: the two runs, with one name for both versions of an engine. environment: differences of
    machine, versions and settings. redefined: scenarios whose definitions differ between the runs; their
    cases are not compared. paired: the number of cases that both runs have and that were compared. timed: how
    many of them were also compared by speed. refined: the number of cases that only one run has, at steps
    that it chose itself. thresholds: the sizes above which a change is worse or improved. changes: the
    largest first.
    """

    before: Tables
    after: Tables
    environment: tuple[str, ...]
    redefined: tuple[str, ...]
    paired: int
    timed: int
    refined: int
    thresholds: Thresholds
    changes: tuple[Change, ...]

    def of_status(self, *statuses: Status) -> tuple[Change, ...]:
        """Return the changes of these statuses, the largest first."""
        return tuple(change for change in self.changes if change.status in statuses)

    @property
    def failing(self) -> tuple[Change, ...]:
        """The changes that became worse or are no longer measured."""
        return self.of_status(*FAILING)


def compare(before: Tables, after: Tables, thresholds: Thresholds = DEFAULT_THRESHOLDS) -> Comparison:
    """Return the changes of cases, outcomes, verdicts, orders, stable steps, accuracy and speed.

    Accuracy is deterministic, so a change counts if it exceeds round-off. Speed is judged by the quartiles of
    the laps and the noise of both machines.
    """
    before, after = paired_versions(before, after)
    redefined_names = redefined(before.manifest, after.manifest)
    old, new = (_cases(tables, redefined_names) for tables in (before, after))
    both = [(old[key], new[key]) for key in new if key in old]
    ratios = _ratios(both, same=same_machine(before.manifest, after.manifest))
    noises = (before.manifest.get("speed_noise") or 0.0, after.manifest.get("speed_noise") or 0.0)
    verdicts = [_judged(tables, redefined_names) for tables in (before, after)]
    errors = list(_accuracies(both, _floors(before), _floors(after), thresholds))
    missing = _one_run_only(old, new, before.manifest)
    new_cases = _one_run_only(new, old, after.manifest)
    changes = [
        *(_of_case("case", key, "case", row["outcome"], None, "missing") for key, row in missing.items()),
        *(_of_case("case", key, "case", None, row["outcome"], "new") for key, row in new_cases.items()),
        *_outcomes(both),
        *changed_judgements(verdicts[0], verdicts[1], _theories(before, after), errors, thresholds),
        *_stable_steps(before, after, redefined_names, thresholds),
        *errors,
        *_fingerprints(before, after),
        *_laws(before, after),
        *speed_changes(ratios, noises, thresholds.of("relative_cpu")),
    ]
    return Comparison(
        before=before,
        after=after,
        environment=environment_diff(before.manifest, after.manifest),
        redefined=redefined_names,
        paired=len(both),
        timed=len(ratios),
        refined=len(old.keys() ^ new.keys()) - len(missing) - len(new_cases),
        thresholds=thresholds,
        changes=tuple(sorted(changes, key=lambda change: -change.size)),
    )


def _fingerprints(before: Tables, after: Tables) -> Iterator[Change]:
    """Yield a change where a method became another one-step map, such as "M1 -> implicit midpoint"."""
    old = {(row["engine"], row["method"]): row["fingerprint"] for row in before.rows("fingerprints")}
    for row in after.rows("fingerprints"):
        was, now = old.get((row["engine"], row["method"])), row["fingerprint"]
        if was is not None and was != now and not {was, now} & {*NOT_MEASURED}:
            yield Change("fingerprint", None, row["engine"], row["method"], "one-step map", was, now, "moved")


def _laws(before: Tables, after: Tables) -> Iterator[Change]:
    """Yield a change where a method breaks a law that it obeyed, or obeys one that it broke.

    It moved, whatever the size: errors show whether that matters, and a gate can bound a violation.
    """
    old, new = (
        {(row["engine"], row["method"], row["law"]): row["verdict"] for row in tables.rows("laws")}
        for tables in (before, after)
    )
    for (engine, method, law), now in new.items():
        was = old.get((engine, method, law))
        if was is None or {was, now} & {*NOT_MEASURED} or (was == "broken") == (now == "broken"):
            continue
        yield Change("law", None, engine, method, f"law {law}", was, now, "moved")


def _cases(tables: Tables, redefined_names: tuple[str, ...]) -> dict[CaseKey, _Row]:
    rows = (case.columns for case in tables.cases if case.columns["scenario"] not in redefined_names)
    return {case_key(row): row for row in rows}


def _one_run_only(
    first: Mapping[CaseKey, _Row], second: Mapping[CaseKey, _Row], manifest: Mapping[str, Any]
) -> dict[CaseKey, _Row]:
    """Return the cases that only the first run has, except those at steps that it chose itself."""
    return {key: row for key, row in first.items() if key not in second and not is_refinement(row, manifest)}


def _of_case(kind: Any, key: CaseKey, quantity: str, before: Any, after: Any, status: Status) -> Change:
    scenario, engine, method, control, fineness = key
    return Change(kind, scenario, engine, method, quantity, before, after, status, control, fineness)


def _outcomes(both: Iterable[tuple[_Row, _Row]]) -> Iterator[Change]:
    for old, new in both:
        before, after = old["outcome"], new["outcome"]
        if before != after:
            status = by_rank(before == "ok", after == "ok")
            yield _of_case("outcome", case_key(new), "outcome", before, after, status)


def _accuracies(
    both: Iterable[tuple[_Row, _Row]],
    old_floors: Mapping[_Key, Floors],
    new_floors: Mapping[_Key, Floors],
    thresholds: Thresholds,
) -> Iterator[Change]:
    for old, new in both:
        if old["outcome"] == new["outcome"] == "ok":
            method = study_key(new)
            floors = old_floors.get(method, {}), new_floors.get(method, {})
            yield from accuracy_changes(old, new, floors, thresholds)
            yield from sign_changes(old, new, floors)


def _ratios(both: Iterable[tuple[_Row, _Row]], *, same: bool) -> list[Ratio]:
    ratios = (ratio(old, new, same_machine=same) for old, new in both)
    return [found for found in ratios if found is not None]


def _judged(tables: Tables, redefined_names: tuple[str, ...] = ()) -> dict[_Key, dict[str, Any]]:
    """Return the rows of methods.csv by scenario, engine, method and quantity, without empty cells."""
    rows = ((row, study_key(row)) for row in tables.rows("methods"))
    return {(*key, row["quantity"]): row for row, key in rows if key[0] not in redefined_names}


def _theories(*runs: Tables) -> dict[tuple[str, str], float | None]:
    """Return the theoretical order of each method; the higher one if the runs differ."""
    found: dict[tuple[str, str], float | None] = {}
    for tables in runs:
        for engine, entry in tables.manifest["engines"].items():
            for method, facts in entry.get("methods", {}).items():
                orders = (found.get((engine, method)), facts.get("order"))
                found[engine, method] = max((order for order in orders if order is not None), default=None)
    return found


def _floors(tables: Tables) -> dict[_Key, dict[str, float]]:
    floors: dict[_Key, dict[str, float]] = {}
    for (*method, quantity), row in _judged(tables).items():
        if "floor" in row:
            floors.setdefault(tuple(method), {})[quantity] = row["floor"]
    return floors


def _stable_steps(
    before: Tables, after: Tables, redefined_names: tuple[str, ...], thresholds: Thresholds
) -> Iterator[Change]:
    old, new = ({study_key(row): row for row in tables.rows("stability")} for tables in (before, after))
    chaotic = _chaotic(before) | _chaotic(after)
    for key in new:
        if key in old and key[0] not in redefined_names:
            change = stability_change(old[key], new[key], thresholds.of("stability.dt_stable_s"))
            if change is not None:
                # in a chaotic motion the step at which a method becomes unstable is random
                by_chance = key[0] in chaotic and change.quantity == "dt_stable_s"
                yield replace(change, status="moved") if by_chance else change


def _chaotic(tables: Tables) -> set[str]:
    """Return the scenarios whose truth ends before their duration does."""
    rows = (case.columns for case in tables.cases)
    return {
        row["scenario"] for row in rows if row.get("compared_until_s", math.inf) < row.get("duration_s", 0.0)
    }
