"""A run, new or stored: its tables, and its cases by scenario and method."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from glob import escape
from typing import TYPE_CHECKING, Any, Self, TypeAlias

from bodycheck._util.errors import InputError
from bodycheck.adapters.engine_names import is_named, with_method
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.sentinels import Sentinel
from bodycheck.reports.run_files.tables import TABLES, Row, as_table, known_cells

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, kw_only=True)
class Tables:
    """The tables of a run, which suffice to compare, advise and summarise.

    manifest: versions, machine, settings (manifest.json). cases: the rows of results, in order. tables: the
    rows of the other tables by name; those of runs of earlier versions lack some. Each table of TABLES is an
    attribute of its name, a DataFrame; `rows` has its rows as they are.
    """

    run_id: str
    manifest: dict[str, Any]
    cases: tuple[CaseResult, ...]
    tables: Mapping[str, Sequence[Row]] = field(default_factory=dict)

    def rows(self, name: str) -> list[Row]:
        """Return the rows of a table without their empty cells."""
        return [known_cells(row) for row in self._rows(name)]

    def with_rows(self, **tables: Sequence[Row]) -> Self:
        """Return the run with the rows of some tables replaced, by name; cases are those of results."""
        return replace(self, tables={**self.tables, **tables})

    def __getattr__(self, name: str) -> pd.DataFrame:
        """Return a table as a DataFrame, made on first use."""
        if name not in TABLES:
            raise AttributeError(f"a run has no {name}; its tables are {', '.join(TABLES)}")
        frame = self.__dict__[name] = as_table(self._rows(name), TABLES[name])
        return frame

    def _rows(self, name: str) -> Sequence[Row]:
        if name == "results":
            return [{"run_id": self.run_id, **case.columns} for case in self.cases]
        return self.tables.get(name, ())


@dataclass(frozen=True, eq=False, kw_only=True)
class Run(Tables):
    """The result of `bodycheck.run`.

    results: one row per case (results.csv). methods: one row per scenario, method and quantity (methods.csv).
    stability: one row per scenario and method with a step (stability.csv); empty where steps were specified.
    manifest: versions, machine, settings (manifest.json). problems: the scenarios with their truths. cases:
    the rows of results in the same order, each with its trajectory and its measures over time. probes: one
    row per method and check (probes.csv). sentinels: the cases that every shard runs; none in another run.
    diagnoses: one row per scenario and method with a verdict against it (diagnoses.csv). fingerprints: one
    row per method (fingerprints.csv). laws: one row per method and law (laws.csv).
    """

    problems: tuple[Problem, ...]
    sentinels: tuple[Sentinel, ...] = ()


MethodKey: TypeAlias = tuple[str, str]
"""(engine, method)"""

StudyKey: TypeAlias = tuple[str, str, str]
"""(scenario, engine, method)"""

CaseKey: TypeAlias = tuple[str, str, str, str, float | None]
"""(scenario, engine, method, control, step or tolerance)"""

FAILED_CHECKS = "failed_checks"
"""The key of a manifest for the checks of pytest or of gates that failed, in words."""

FAILED_CASES = "failed_cases"
"""The same for the cases that failed them, or that became worse, as SCENARIO,ENGINE:METHOD[,STEP]."""


def failed_case(scenario: str, engine: str, method: str, *fineness: float | None) -> str:
    """Return an entry of FAILED_CASES, which fits this case alone."""
    return ",".join([escape(scenario), f"{escape(engine)}:{escape(method)}", *map(repr, fineness)])


def key_of(row: Mapping[str, Any]) -> MethodKey:
    """Return the engine and method of a row of any table."""
    return row["engine"], row["method"]


def study_key(row: Mapping[Any, Any]) -> StudyKey:
    """Return the scenario, engine and method of a row of any table of studies."""
    return row["scenario"], row["engine"], row["method"]


def case_of(row: Row) -> CaseResult:
    """Return a row of results.csv as a case without a motion."""
    always = {"dt_s": None, "tolerance": None, "message": ""}
    return CaseResult({name: cell for name, cell in {**always, **row}.items() if name != "run_id"})


def case_key(row: Mapping[str, Any]) -> CaseKey:
    """Return the scenario, engine, method, control, and step or tolerance of a row of results.csv."""
    fineness = row.get("tolerance") if row.get("dt_s") is None else row["dt_s"]
    return *study_key(row), row["control"], fineness


def cases_by_method(cases: Iterable[CaseResult]) -> dict[str, dict[MethodKey, list[CaseResult]]]:
    """Return the cases by scenario, then by engine and method, all in the order of the run."""
    found: dict[str, dict[MethodKey, list[CaseResult]]] = {}
    for case in cases:
        found.setdefault(case.columns["scenario"], {}).setdefault(key_of(case.columns), []).append(case)
    return found


def common_step(cases: Iterable[CaseResult]) -> float | None:
    """Return the step used by most methods, the finest of several; None where there are no steps."""
    shared = Counter(
        case.dt_s for case in cases if case.dt_s is not None and case.columns["outcome"] != "unsupported"
    )
    return max(shared, key=lambda dt_s: (shared[dt_s], -dt_s), default=None)


def coarsest_shared_step(cases: Iterable[CaseResult]) -> float | None:
    """Return the coarsest of the steps at which most methods ended well; None where there are no steps."""
    shared = Counter(case.dt_s for case in cases if case.dt_s is not None and case.ok)
    return max(shared, key=lambda dt_s: (shared[dt_s], dt_s), default=None)


def shown_case(cases: Iterable[CaseResult], at_s: float | None) -> CaseResult | None:
    """Return the case that represents a method: at the common step, or else at its finest tolerance."""
    candidates = [case for case in cases if case.dt_s in (None, at_s)]
    return min(candidates, key=lambda case: case.setting.fineness or 0.0, default=None)


def announced_of(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return cmd:COMMAND -> the name that the program announced, of the programs of a run."""
    engines = manifest["engines"].items()
    return {entry["command"]: name for name, entry in engines if entry.get("command")}


def check_engines(run: Tables, engines: Sequence[str]) -> None:
    """Raise InputError for an engine or ENGINE:METHOD that the run does not have."""
    keys = dict.fromkeys(key_of(case.columns) for case in run.cases)
    known = [*dict.fromkeys(engine for engine, _ in keys), *(with_method(*key) for key in keys)]
    if unknown := [name for name in engines if not any(is_named([name], *key) for key in keys)]:
        raise InputError(f"--engine {', '.join(unknown)}: not in this run (available: {', '.join(known)})")
