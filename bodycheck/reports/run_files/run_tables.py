"""A run, new or stored: its tables, and its cases by scenario and method."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from bodycheck._util.errors import InputError
from bodycheck.adapters.engine_names import with_method
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.sentinels import Sentinel
from bodycheck.reports.run_files.tables import no_diagnoses, no_fingerprints, no_laws, no_probes

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Run:
    """The result of `bodycheck.run`.

    results: one row per case (results.csv). methods: one row per scenario, method and quantity (methods.csv).
    stability: one row per scenario and method with a step (stability.csv); empty where steps were specified.
    manifest: versions, machine, settings (manifest.json). problems: the scenarios with their truths. cases:
    the rows of results in the same order, each with its trajectory and its measures over time. probes: one
    row per method and check (probes.csv). sentinels: the cases that every shard runs; none in another run.
    diagnoses: one row per scenario and method with a verdict against it (diagnoses.csv). fingerprints: one
    row per method (fingerprints.csv). laws: one row per method and law (laws.csv).
    """

    run_id: str
    results: pd.DataFrame
    methods: pd.DataFrame
    stability: pd.DataFrame
    manifest: dict[str, Any]
    problems: tuple[Problem, ...]
    cases: tuple[CaseResult, ...]
    probes: pd.DataFrame = field(default_factory=no_probes)
    sentinels: tuple[Sentinel, ...] = ()
    diagnoses: pd.DataFrame = field(default_factory=no_diagnoses)
    fingerprints: pd.DataFrame = field(default_factory=no_fingerprints)
    laws: pd.DataFrame = field(default_factory=no_laws)


MethodKey: TypeAlias = tuple[str, str]
"""(engine, method)"""

StudyKey: TypeAlias = tuple[str, str, str]
"""(scenario, engine, method)"""

CaseKey: TypeAlias = tuple[str, str, str, str, float | None]
"""(scenario, engine, method, control, step or tolerance)"""


class RunTables(Protocol):
    """A run, or the tables of a run."""

    @property
    def manifest(self) -> dict[str, Any]:
        """Versions, machine, settings, scenarios."""

    @property
    def methods(self) -> pd.DataFrame:
        """One row per scenario, method and quantity."""

    @property
    def stability(self) -> pd.DataFrame:
        """One row per scenario and method with a step."""

    @property
    def probes(self) -> pd.DataFrame:
        """One row per method and check of its probes; empty for a run of a version without probes."""

    @property
    def diagnoses(self) -> pd.DataFrame:
        """One row per diagnosed method and scenario; empty for a run of a version without diagnoses."""

    @property
    def fingerprints(self) -> pd.DataFrame:
        """One row per method: its known map; empty for a run without fingerprints."""

    @property
    def laws(self) -> pd.DataFrame:
        """One row per method and law; empty for a run without laws."""

    @property
    def cases(self) -> tuple[CaseResult, ...]:
        """All cases, in the order of the run."""


def key_of(row: Mapping[str, Any]) -> MethodKey:
    """Return the engine and method of a row of any table."""
    return row["engine"], row["method"]


def study_key(row: Mapping[Any, Any]) -> StudyKey:
    """Return the scenario, engine and method of a row of any table of studies."""
    return row["scenario"], row["engine"], row["method"]


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


def shown_case(cases: Iterable[CaseResult], at_s: float | None) -> CaseResult | None:
    """Return the case that represents a method: at the common step, or else at its finest tolerance."""
    candidates = [case for case in cases if case.dt_s in (None, at_s)]
    return min(candidates, key=lambda case: case.setting.fineness or 0.0, default=None)


def check_engines(run: RunTables, engines: Sequence[str]) -> None:
    """Raise InputError for an engine or ENGINE:METHOD that the run does not have."""
    keys = dict.fromkeys(key_of(case.columns) for case in run.cases)
    known = [*dict.fromkeys(engine for engine, _ in keys), *(with_method(*key) for key in keys)]
    if unknown := [name for name in engines if name not in known]:
        raise InputError(f"--engine {', '.join(unknown)}: not in this run (available: {', '.join(known)})")
