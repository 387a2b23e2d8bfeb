"""The tables of a run of a few given cells, without an engine or a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import pandas as pd

from bodycheck.reports.run_files.run_tables import Tables, case_key, case_of

_Run = TypeVar("_Run", bound=Tables)

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
    orders = [{**METHOD, **cells} for cells in methods or []]
    method_rows = [{"order_low": row["order"], "order_high": row["order"], **row} for row in orders]
    return Tables(
        run_id="made-up",
        manifest={"dt_s": None, "tolerances": None, "engines": {}, **manifest},
        cases=tuple(case_of({**CASE, **cells}) for cells in cases),
        tables={"methods": method_rows, "stability": stability or []},
    )


def with_tables(run: _Run, **tables: pd.DataFrame | Sequence[dict[str, Any]]) -> _Run:
    """Return a run with some tables replaced; a case whose row is still in `results` keeps its motion."""
    rows = {name: _rows(table) for name, table in tables.items()}
    if (results := rows.pop("results", None)) is not None:
        known = {case_key(case.columns): case for case in run.cases}
        made = [case_of(row) for row in results]
        run = replace(
            run,
            cases=tuple(replace(known.get(case_key(one.columns), one), columns=one.columns) for one in made),
        )
    return run.with_rows(**rows)


def _rows(table: pd.DataFrame | Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    rows = table.to_dict("records") if isinstance(table, pd.DataFrame) else table
    return [{str(name): cell for name, cell in row.items() if not pd.isna(cell)} for row in rows]
