"""The tables of a run of a few given cells, without an engine or a motion."""

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


def make_tables(
    cases: list[dict[str, Any]],
    methods: list[dict[str, Any]] | None = None,
    stability: list[dict[str, Any]] | None = None,
    **manifest: Any,
) -> Tables:
    """Return a run with rows like CASE, METHOD and stability.csv, with the given cells replaced."""
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
