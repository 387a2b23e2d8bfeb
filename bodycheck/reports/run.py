"""A run: all the cases of one invocation, as tables and as the motions behind them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bodycheck.reports.case import CaseResult
from bodycheck.reports.subject import Subject
from bodycheck.reports.tables import no_probes

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Run:
    """What `bodycheck.run` returns.

    results: one row a case (results.csv). methods: one row a scenario, method and quantity (methods.csv).
    stability: one row a scenario and method that is told a step (stability.csv); none where steps were asked
    for.
    manifest: versions, machine, settings (manifest.json). subjects: the scenarios with their truths.
    cases: the rows of results in the same order, each with its trajectory and its measures over time.
    probes: one row per method and check (probes.csv).
    """

    run_id: str
    results: pd.DataFrame
    methods: pd.DataFrame
    stability: pd.DataFrame
    manifest: dict[str, Any]
    subjects: tuple[Subject, ...]
    cases: tuple[CaseResult, ...]
    probes: pd.DataFrame = field(default_factory=no_probes)
