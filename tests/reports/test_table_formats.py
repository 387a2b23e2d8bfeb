"""Tables for other programs: every format holds the same numbers to the last digit."""

from __future__ import annotations

import csv
import io
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.tables import as_csv, as_json, as_markdown, as_parquet


@pytest.fixture(scope="module")
def results(stored_run: Path) -> pd.DataFrame:
    """Return a table with texts, integers, floating-point numbers and missing values."""
    return read_tables(stored_run).results


def rows_of(path: Path) -> list[dict[str, str]]:
    """Return the rows of results.csv as text."""
    with (path / "results.csv").open() as file:
        return list(csv.DictReader(file))


def test_csv_is_that_of_the_run(results: pd.DataFrame, stored_run: Path) -> None:
    """The CSV equals results.csv byte for byte."""
    assert as_csv(results) == (stored_run / "results.csv").read_bytes()


def test_json_has_every_cell(results: pd.DataFrame, stored_run: Path) -> None:
    """Numbers parse back to the same doubles; a missing value is null, and a zero is not."""
    reported = json.loads(as_json(results))
    for row, cells in zip(reported, rows_of(stored_run), strict=True):
        assert {name: "" if cell is None else str(cell) for name, cell in row.items()} == cells
    assert any(row["energy_drift"] is None for row in reported)
    assert isinstance(reported[0]["steps"], int)


def test_a_markdown_row_cannot_be_broken_by_what_stands_in_it(results: pd.DataFrame) -> None:
    """Each line has as many bars as the heading; bars, tags and line ends of a message are escaped."""
    lines = as_markdown(results[["scenario", "outcome", "message"]]).decode().splitlines()
    assert len(lines) == len(results) + 2
    assert {line.replace("\\|", "").count("|") for line in lines} == {4}
    assert any("gave up \\| it said \\<so>" in line for line in lines)


def test_parquet_reads_back_as_the_same_table(
    results: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Types, nulls and every double are equal, whatever the name of the folder for temporary files."""
    (tmp_path / "o'clock").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "o'clock"))
    duckdb = pytest.importorskip("duckdb")
    (tmp_path / "results.parquet").write_bytes(as_parquet(results))
    with duckdb.connect() as database:
        again = database.execute(f"SELECT * FROM '{tmp_path / 'results.parquet'}'").df()
    pd.testing.assert_frame_equal(again, results, check_exact=True)


@pytest.mark.parametrize(
    ("cell", "reported", "shown"),
    [
        (pd.Timestamp("2026-01-02 03:04:05"), "2026-01-02 03:04:05", "2026-01-02 03:04:05"),
        (pd.NaT, None, ""),
        (np.array([1.5, np.nan]), [1.5, None], "\\[1.5, None]"),
        (np.array([]), [], "\\[]"),
        ({"a": math.inf}, {"a": "inf"}, "{'a': 'inf'}"),
        (math.inf, "inf", "inf"),
        (True, True, "True"),
    ],
    ids=str,
)
def test_any_cell_of_a_query_can_be_shown(cell: Any, reported: Any, shown: str) -> None:
    """JSON has text for types that it lacks, lists for arrays, and null for missing values."""
    table = pd.DataFrame({"found": pd.Series([cell], dtype=object)})
    assert json.loads(as_json(table)) == [{"found": reported}]
    assert as_markdown(table).decode().splitlines()[-1] == f"| {shown} |"


def test_a_table_of_none_has_its_head(results: pd.DataFrame) -> None:
    """A run in which no method has an order still has a table."""
    assert list(csv.reader(io.StringIO(as_csv(results[:0]).decode()))) == [list(results.columns)]
    assert json.loads(as_json(results[:0])) == []
