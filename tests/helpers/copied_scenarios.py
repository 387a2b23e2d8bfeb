"""Runs whose scenarios are copies of one of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.run_tables import Run


def with_scenarios(run: Run, problems: Iterable[Problem]) -> dict[str, Any]:
    """Return the manifest of a run with these scenarios, each described like the first one of the run."""
    first = next(iter(run.manifest["scenarios"].values()))
    return {**run.manifest, "scenarios": {problem.scenario.name: first for problem in problems}}
