"""A table of a run is declared once: all that makes, writes, reads, merges and prints tables follows."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

import bodycheck
from bodycheck.reports.comparison.compare import renamed
from bodycheck.reports.measurement.case_columns import COLUMNS
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.run_files.run_reader import read_run, read_tables
from bodycheck.reports.run_files.tables import TABLES, TableKind
from bodycheck.runs.directory import run_to_folder
from bodycheck.runs.merge import merge
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import no_progress
from tests.helpers.changed_package import copy_with, printed_by
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import tumbling

COUNTED = TableKind(
    name="counted",
    columns=("run_id", "scenario", "engine", "method", "steps", "colour"),
    needed=("run_id", "scenario", "engine", "method"),
    words=("colour",),
    choices={"colour": ("red", "green")},
    made_of=lambda measured: [
        {
            "scenario": studied.cases[0].columns["scenario"],
            "engine": studied.cases[0].columns["engine"],
            "method": studied.cases[0].columns["method"],
            "steps": len(studied.cases),
            "colour": "green",
        }
        for studied in measured.studies
    ],
)


@pytest.fixture
def request_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Request:
    """Return a run of one scenario by two methods, with a table that is declared in one place."""
    monkeypatch.setitem(TABLES, COUNTED.name, COUNTED)
    (tmp_path / "mine.toml").write_text(tumbling())
    engines = ["reference:m1", "reference:rk4"]
    return Request(scenarios=[str(tmp_path / "mine.toml")], engines=engines, dt_s=[0.1, 0.05], speed=False)


@pytest.mark.slow
def test_a_new_table_is_found_wherever_tables_are(request_here: Request, tmp_path: Path) -> None:
    """It is written, read, an attribute of runs, renamed, merged and printed, without another declaration."""
    run, _ = run_to_folder(request_here, tmp_path / "whole", no_progress)
    expected = [("mine", "m1", 2, "green"), ("mine", "rk4", 2, "green")]

    def cells(table: pd.DataFrame) -> list[tuple[object, ...]]:
        return [*table[["scenario", "method", "steps", "colour"]].itertuples(index=False, name=None)]

    assert cells(run.counted) == expected
    assert cells(read_tables(tmp_path / "whole").counted) == expected
    assert cells(read_run(tmp_path / "whole", allow_code=False, cache=None).counted) == expected
    assert set(renamed(run, {"reference": "other"}).counted["engine"]) == {"other"}
    printed = run_bodycheck(tmp_path, "table", "whole", "counted", "--columns", "method,steps")
    assert printed.stdout.splitlines() == ["method,steps", "m1,2", "rk4,2"]
    for k in (1, 2):
        shard = Request(**{**vars(request_here), "shard": f"{k}/2"})
        run_to_folder(shard, tmp_path / f"part-{k}", no_progress)
    merged = merge([tmp_path / "part-1", tmp_path / "part-2"])
    assert cells(merged.counted) == expected
    assert set(merged.counted["run_id"]) == {merged.run_id}


@pytest.mark.slow
def test_what_a_table_declares_of_its_cells_is_checked(request_here: Request, tmp_path: Path) -> None:
    """A word that the declaration does not list is refused; a run of an earlier version lacks the table."""
    _, report = run_to_folder(request_here, tmp_path / "whole", no_progress)
    path = report.parent / "counted.csv"
    path.write_text(path.read_text().replace("green", "blue"))
    found = run_bodycheck(tmp_path, "table", "whole", "counted")
    assert found.returncode == 2
    assert "counted.csv" in found.stderr
    path.unlink()
    assert read_tables(report.parent).counted.empty


@pytest.mark.slow
def test_a_run_has_no_other_tables(request_here: Request, tmp_path: Path) -> None:
    """An attribute that is no table is missing, and the message lists the tables."""
    run, _ = run_to_folder(request_here, tmp_path / "whole", no_progress)
    with pytest.raises(AttributeError, match="counted"):
        _ = run.cuonted


@pytest.mark.slow
def test_every_column_of_results_has_a_value_in_some_case() -> None:
    """A symmetric top, a chaotic motion and a tree together have all columns that are no measures."""
    run = bodycheck.run(
        ["symmetric-top", "chaotic-top", "double-pendulum"],
        engines=["mujoco:euler", "reference:taylor"],
        dt_s=[0.02, 0.01],
        tolerances=[1e-6],
        laws=False,
    )
    of_measures = {name for measure in MEASURES.values() for name in measure.columns}
    given = {name for row in run.rows("results") for name, cell in row.items() if cell != ""}
    assert {column.name for column in COLUMNS} - of_measures <= given


COLUMN = """    CaseColumn(
        "last_omega_x_rad_s", of_motion=lambda case: case.compared.trajectory.omega_body[-1, 0]
    ),
"""
"""The column that is added to a copy of the package, in one place."""


@pytest.mark.slow
def test_a_new_column_of_results_is_known_wherever_columns_are(tmp_path: Path) -> None:
    """A line in case_columns.py adds it to the run, its files, what is printed of them and the schema."""
    file = "bodycheck/reports/measurement/case_columns.py"
    copy_with(tmp_path, file, '    CaseColumn("successive_difference_rad"),\n', COLUMN)
    (tmp_path / "mine.toml").write_text(tumbling())
    printed = partial(printed_by, tmp_path)
    for part in ("1/2", "2/2"):
        methods = "reference:m1,reference:rk4"
        options = ("--dt", "0.1", "--no-speed", "--quiet", "--shard", part, "--out", f"part-{part[0]}")
        printed("run", "mine.toml", "--engine", methods, *options)
    printed("merge", "part-1", "part-2", "--out", "whole")
    table = pd.read_csv(tmp_path / "whole/results.csv")
    names = [*table.columns]
    assert names[names.index("last_omega_x_rad_s") + 1] == "successive_difference_rad"
    assert table["last_omega_x_rad_s"].abs().min() > 0.0
    shown = printed("table", "whole", "--columns", "last_omega_x_rad_s").splitlines()
    assert shown == ["last_omega_x_rad_s", *map(repr, table["last_omega_x_rad_s"])]
    schema = json.loads(printed("schema", "results"))
    assert schema["items"]["properties"]["last_omega_x_rad_s"] == {"type": ["number", "null"]}
