"""What an earlier version has stored is read: shards, an interrupted run, a history, shards of an ensemble.

tests/stored_runs has what the version of 25 November 2026 wrote, without pages and pictures; its scenario
mine.toml is that of every folder.
"""

from __future__ import annotations

import json
from pathlib import Path
from zipfile import ZipFile

import pandas as pd
import pytest

from bodycheck.reports.history.archive import History
from bodycheck.reports.history.levels import read_levels
from bodycheck.reports.run_files.run_reader import read_tables
from tests.helpers.in_process_cli import run_bodycheck

STORED = sorted((Path(__file__).parent / "stored_runs").glob("*.zip"))
ERRORS = {"m1": 3.75e-3, "rk4": 4.49e-9}
"""The errors in rad that the version of that day printed."""


@pytest.fixture(params=STORED, ids=lambda path: path.stem)
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a folder with all that one version has stored."""
    with ZipFile(request.param) as stored:
        stored.extractall(tmp_path)
    return tmp_path


def test_shards_are_merged(folder: Path) -> None:
    """The tables have the cases of both shards, with their errors; the manifest has what was requested."""
    done = run_bodycheck(folder, "merge", "part-1", "part-2", "--out", "whole")
    assert done.returncode == 0, done.stderr
    results = pd.read_csv(folder / "whole/results.csv").set_index("method")["orientation_error_rad"]
    assert results.to_dict() == pytest.approx(ERRORS, rel=2e-3)
    found = read_tables(folder / "whole")
    assert {row["method"] for row in found.rows("laws")} == {"m1", "rk4"}
    manifest = json.loads((folder / "whole/manifest.json").read_text())
    assert (manifest["dt_s"], manifest["request"]["speed"]) == ([0.05], False)


@pytest.mark.slow
def test_an_interrupted_run_is_continued(folder: Path) -> None:
    """It has its own settings, and options that came later have their defaults."""
    done = run_bodycheck(folder, "run", "--resume", "begun", "--quiet")
    assert done.returncode == 0, done.stderr
    (row,) = pd.read_csv(folder / "begun/results.csv").to_dict("records")
    assert (row["method"], row["dt_s"]) == ("m1", 0.05)
    assert row["orientation_error_rad"] == pytest.approx(ERRORS["m1"], rel=2e-3)
    assert json.loads((folder / "begun/manifest.json").read_text())["timeout_s"] == 60.0


def test_a_history_is_read(folder: Path) -> None:
    """Its runs are listed, each with its tables and its accepted levels."""
    done = run_bodycheck(folder, "history", "list", "nights")
    assert done.returncode == 0, done.stderr
    runs = History(folder / "nights").runs()
    assert len(runs) == 2
    for run in runs:
        tables = read_tables(run)
        levels = read_levels(run, tables)
        assert len(levels.rows("results")) == len(tables.cases) == 3
        assert len(levels.rows("methods")) == len(tables.rows("methods")) > 0
        assert len(levels.rows("laws")) > 0


@pytest.mark.nightly
def test_shards_of_an_ensemble_are_merged(folder: Path) -> None:
    """Each quantile is of all six bodies."""
    done = run_bodycheck(folder, "merge", "ens-1", "ens-2", "--out", "bodies")
    assert done.returncode == 0, done.stderr
    assert pd.read_csv(folder / "bodies/methods.csv")["bodies"].tolist() == [6]
