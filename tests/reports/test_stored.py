"""Stored runs: a run read from its folder equals the one written; a damaged one is refused."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bodycheck
from bodycheck._util.errors import InputError
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.run_files.run_reader import read_run, read_tables
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.directory import write_run
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.html_page import report_page


@pytest.fixture(scope="module")
def again(stored_run: Path) -> Run:
    """Return the run, read back."""
    return read_run(stored_run, allow_code=False, cache=Cache.default())


@pytest.mark.slow
def test_report_of_a_stored_run_is_the_same_byte_for_byte(stored_run: Path, again: Run) -> None:
    """Tables, truths and measures over time are read to the last digit, without the mesh file."""
    assert report_page(again) == (stored_run / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_run_read_and_written_again_is_the_same(stored_run: Path, again: Run, tmp_path: Path) -> None:
    """Every table and every number of every trajectory is the same."""
    write_run(again, tmp_path / "again")
    for path in sorted(stored_run.rglob("*")):
        copy = tmp_path / "again" / path.relative_to(stored_run)
        if path.suffix == ".npz":
            with np.load(path) as one, np.load(copy) as other:
                assert one.files == other.files
                assert all(np.array_equal(one[name], other[name]) for name in one.files)
        elif path.is_file():
            assert copy.read_bytes() == path.read_bytes(), path.name


def test_tables_have_every_case_with_its_outcome(stored_run: Path) -> None:
    """Failed cases are included, with their message and without measures."""
    tables = read_tables(stored_run)
    assert tables.results.to_csv(index=False) == (stored_run / "results.csv").read_text()
    failed = [case for case in tables.cases if case.columns["outcome"] == "failed"]
    assert failed
    assert all("orientation_error_rad" not in case.columns for case in failed)
    assert all("the solver gave up" in case.columns["message"] for case in failed)


def _text(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        (folder / name).write_text(change((folder / name).read_text()))

    return damage


def _judged(column: str, cell: str = "") -> Callable[[Path], None]:
    """Write a cell into each row of methods.csv that has an order."""

    def damage(folder: Path) -> None:
        table = pd.read_csv(folder / "methods.csv", dtype=str)
        table.loc[table["order"].notna(), column] = cell
        table.to_csv(folder / "methods.csv", index=False)

    return damage


def _measured(column: str, cell: str) -> Callable[[Path], None]:
    """Write a cell into the first row with outcome ok of results.csv."""

    def damage(folder: Path) -> None:
        table = pd.read_csv(folder / "results.csv", dtype=str, keep_default_na=False)
        table.loc[table.index[table["outcome"] == "ok"][0], column] = cell
        table.to_csv(folder / "results.csv", index=False)

    return damage


def _motions_swapped(folder: Path) -> None:
    motions = folder / "trajectories/free"
    (motions / "reference_m1_0.02.npz").write_bytes((motions / "reference_m1_0.01.npz").read_bytes())


def _another_start(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["scenarios"]["free"]["initial"]["omega_body_rad_s"][0] = 0.31
    (folder / "manifest.json").write_text(json.dumps(manifest))


DAMAGES: dict[str, tuple[Callable[[Path], None], str]] = {
    "no manifest": (lambda folder: (folder / "manifest.json").unlink(), "not a run folder"),
    "half a manifest": (_text("manifest.json", lambda text: text[:500]), "manifest.json: is not JSON"),
    "a foreign manifest": (_text("manifest.json", lambda _: "{}"), "not a manifest of a run"),
    "no machine": (
        _text("manifest.json", lambda text: text.replace('"system"', '"sistem"')),
        "not a manifest of a run: system: is required",
    ),
    "a list for a table": (
        _text("manifest.json", lambda text: re.sub(r'"outcomes": {[^}]*}', '"outcomes": []', text)),
        "not a manifest of a run: outcomes: should be a valid dictionary",
    ),
    "a number for a body": (
        _text("manifest.json", lambda text: re.sub(r'"body": {', '"body": 1.0, "was": {', text)),
        "body: should be a table (it is 1.0)",
    ),
    "a row lost": (_text("results.csv", lambda text: text[: text[:-1].rindex("\n") + 1]), "is damaged"),
    "a negative error": (
        _measured("omega_error", "-0.01"),
        "omega_error is -0.01, not a finite number from 0 on",
    ),
    "an error that is not a number": (
        _measured("orientation_error_rad", "nan"),
        "orientation_error_rad is nan",
    ),
    "an infinite error": (_measured("energy_drift_abs", "inf"), "energy_drift_abs is inf"),
    "a sign of another size": (
        _measured("energy_drift_signed", "-0.5"),
        "energy_drift_signed is -0.5, but energy_drift is",
    ),
    "no error of a case that ended well": (
        _measured("orientation_error_rad", ""),
        "a case with outcome ok has no orientation_error_rad",
    ),
    "a method without verdicts": (
        _text("methods.csv", lambda text: re.sub("(?m)^.*,m1,.*\\n", "", text)),
        "methods.csv: has no row of free, reference:m1; ",
    ),
    "half a row": (_text("results.csv", lambda text: text[:-200]), "cells, not"),
    "a word for a number": (
        _text("results.csv", lambda text: text.replace(",m1,dt,float64,0.02,", ",m1,dt,float64,coarse,")),
        "dt_s is 'coarse', not a number",
    ),
    "another run's table": (
        _text("methods.csv", lambda text: text.replace("Z-", "Z-0")),
        "but the tables of",
    ),
    "unknown quantity": (
        _text("methods.csv", lambda text: text.replace(",omega_error,", ",omega_fault,")),
        "unknown quantity 'omega_fault'",
    ),
    "an outcome for a verdict": (
        _text("methods.csv", lambda text: text.replace(",converges,", ",ok,")),
        "unknown verdict 'ok'",
    ),
    "an order without interval": (_judged("order_low"), "without order_low"),
    "an order outside of its interval": (
        _judged("order_low", "9.5"),
        "is not between order_low 9.5 and",
    ),
    "a negative time": (_measured("relative_cpu", "-0.01"), "relative_cpu is -0.01, not a finite number"),
    "a column more": (
        _text("methods.csv", lambda text: text.replace("verdict", "judgement")),
        "missing column",
    ),
    "no motion": (
        lambda folder: (folder / "trajectories/free/reference_m1_0.02.npz").unlink(),
        "cannot be read",
    ),
    "motions swapped": (_motions_swapped, "but results.csv has"),
    "another start": (_another_start, "differs from the truth of free as solved now"),
    "a mesh of another mass": (
        _text("manifest.json", lambda text: text.replace('"density_kg_m3": 600.0', '"density_kg_m3": "x"')),
        "is not a scenario as a run writes it",
    ),
    "a mesh of no density": (
        _text("manifest.json", lambda text: text.replace('"density_kg_m3": 600.0', '"density_kg_m3": 0.0')),
        "is not a scenario as a run writes it",
    ),
    "a key more": (
        _text("manifest.json", lambda text: text.replace('"samples": 11', '"samples": 11, "sample": 11')),
        "sample: is not a key of this table",
    ),
    "held by nobody": (
        _text("read_back.json", lambda text: text.replace("mass", "weight")),
        "not a valid read-back",
    ),
}


def test_a_scenario_in_place_of_a_run_is_answered_by_the_command_that_runs_it(
    expected_message: ExpectedMessage,
) -> None:
    """A scenario's name is refused with the command that runs it; any other name is refused without one."""
    with expected_message.raises(InputError):
        read_tables(Path("t-handle"))
    with expected_message.raises(InputError):
        read_tables(Path("t-handles"))


@pytest.mark.parametrize("what", DAMAGES)
def test_damaged_or_foreign_folder_is_refused_in_one_line(
    what: str, stored_run: Path, tmp_path: Path
) -> None:
    """No part of it is shown; the line has the file and the error."""
    folder = tmp_path / "run"
    shutil.copytree(stored_run, folder)
    damage, message = DAMAGES[what]
    damage(folder)
    with pytest.raises(InputError) as refused:
        _ = [case.trajectory for case in read_run(folder, allow_code=False, cache=Cache.default()).cases]
    assert message in str(refused.value)
    assert "run" in str(refused.value)


@pytest.mark.slow
def test_stored_callback_load_needs_permission_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """Reading the run would execute this code; a changed function is detected."""
    module = tmp_path / "loads_of_a_stored_run.py"
    module.write_text("def f(t, x, r, v, omega):\n    return -0.5 * v, -0.2 * omega\n")
    (tmp_path / "called.toml").write_text(
        'name = "called"\nduration_s = 0.1\nsamples = 2\n'
        "[body]\nmass_kg = 1.0\ninertia_kg_m2 = [1.0, 2.0, 2.5]\n"
        "[initial]\nomega_body_rad_s = [0.3, 1.0, -0.2]\n"
        '[[forcing]]\nkind = "callable"\nfunction = "loads_of_a_stored_run:f"\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    called = tmp_path / "called.toml"
    run = bodycheck.run([called], engines=["reference:exact"], speed=False, laws=False, allow_code=True)
    bodycheck.write_run(run, tmp_path / "run")
    with expected_message.raises(InputError):
        read_run(tmp_path / "run", allow_code=False, cache=None)
    assert len(read_run(tmp_path / "run", allow_code=True, cache=None).cases) == 1
    import loads_of_a_stored_run  # type: ignore[import-not-found]

    monkeypatch.setattr(loads_of_a_stored_run, "f", lambda *state: (-0.5 * state[3], -0.1 * state[4]))
    with expected_message.raises(InputError):
        read_run(tmp_path / "run", allow_code=True, cache=None)
