"""stability.csv: one row per scenario and method with a step, whatever its outcome."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

import bodycheck
from bodycheck.reports.run_files.tables import TABLES

METHODS = ["reference:m1", "reference:euler", "reference:splitting6", "reference:taylor", "reference:exact"]


@pytest.fixture(scope="module")
def run() -> bodycheck.Run:
    """Return a run of methods that break down early, late, or cannot represent the scene."""
    return bodycheck.run(["stiff-drag"], engines=METHODS, speed=False, laws=False)


def row(run: bodycheck.Run, method: str) -> dict[str, object]:
    """Return the one row of a method."""
    (found,) = run.stability[run.stability["method"] == method].to_dict("records")
    return found


@pytest.mark.slow
def test_every_method_with_a_step_has_a_row(run: bodycheck.Run) -> None:
    """Methods with a tolerance, or without a setting, have none."""
    assert tuple(run.stability.columns) == TABLES["stability"].columns
    assert run.stability["method"].tolist() == ["m1", "euler", "splitting6"]
    assert set(run.stability["run_id"]) == {run.run_id}


@pytest.mark.slow
def test_map_agrees_with_the_cases(run: bodycheck.Run) -> None:
    """No case is stable at a step that the map calls unstable, or the reverse."""
    for method in ("m1", "euler"):
        limits = row(run, method)
        cases = run.results[run.results["method"] == method]
        assert (cases.loc[cases["outcome"] == "ok", "dt_s"] < limits["dt_unstable_s"]).all()
        assert (cases.loc[cases["outcome"] == "unstable", "dt_s"] > limits["dt_stable_s"]).all()
        assert set(cases["outcome"]) == {"ok", "unstable"}
        assert limits["reason"]
        assert limits["outcome"] == "ok"


@pytest.mark.slow
def test_unsupported_method_has_a_row_with_the_reason(run: bodycheck.Run) -> None:
    """Its row has no step."""
    found = row(run, "splitting6")
    assert found["outcome"] == "unsupported"
    assert found["message"] == "splitting6 does not support drag: its kicks must be exact"
    assert pd.isna(found["dt_stable_s"])
    assert pd.isna(found["dt_unstable_s"])


@pytest.mark.slow
def test_requested_steps_leave_the_map_empty(tmp_path: Path) -> None:
    """With --dt only those steps are run; the file exists and has no row."""
    run = bodycheck.run(["full-tensor"], engines=["reference:m1"], dt_s=[0.01], speed=False, laws=False)
    assert run.stability.empty
    bodycheck.write_run(run, tmp_path / "out")
    assert pd.read_csv(tmp_path / "out/stability.csv").columns.tolist() == list(TABLES["stability"].columns)
