"""A run as gates see it, made of a few cells: no engine, no motion."""

from __future__ import annotations

from typing import Any

from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.run_files.run_reader import Tables
from bodycheck.reports.run_files.tables import METHOD_COLUMNS, RESULT_COLUMNS, STABILITY_COLUMNS, as_table

CASE: dict[str, Any] = {
    "scenario": "brick",
    "engine": "mujoco",
    "method": "rk4",
    "control": "dt",
    "dt_s": 0.01,
    "tolerance": None,
    "outcome": "ok",
    "message": "",
    "reproduce": "bodycheck run brick --engine mujoco:rk4 --dt 0.01",
    "orientation_error_rad": 1e-9,
}
METHOD = {
    "scenario": "brick",
    "engine": "mujoco",
    "method": "rk4",
    "quantity": "orientation_error_rad",
    "order": 4.0,
    "verdict": "converges",
}


def a_run(
    cases: list[dict[str, Any]],
    methods: list[dict[str, Any]] | None = None,
    stability: list[dict[str, Any]] | None = None,
    **manifest: Any,
) -> Tables:
    """Return a run of CASE with other cells, one a row; methods likewise of METHOD; rows of stability.csv."""
    rows = [{**CASE, **cells} for cells in cases]
    method_rows = [{**METHOD, **cells} for cells in methods or []]
    return Tables(
        run_id="made-up",
        results=as_table(rows, RESULT_COLUMNS),
        methods=as_table(method_rows, METHOD_COLUMNS),
        stability=as_table(stability or [], STABILITY_COLUMNS),
        manifest={"dt_s": None, "tolerances": None, "engines": {}, **manifest},
        cases=tuple(CaseResult(row) for row in rows),
    )
