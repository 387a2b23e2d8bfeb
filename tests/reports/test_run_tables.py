"""A table of a run is declared once: all that makes, writes, reads, merges and prints tables follows."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from bodycheck.reports.comparison.compare import renamed
from bodycheck.reports.run_files.run_reader import read_run, read_tables
from bodycheck.reports.run_files.tables import TABLES, TableKind
from bodycheck.runs.directory import run_to_folder
from bodycheck.runs.merge import merge
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import no_progress
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
