"""Damaged past runs: each is named and left out, and stops no other."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bodycheck._util.errors import InputError
from bodycheck._util.pinned_libraries import duckdb_connection, read_parquet
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import read_summary
from bodycheck.reports.history.queries import query
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.nightly_run import store_nightly
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.nightly_runs import as_nightly_run, judged_nightly_runs, store_nightly_runs, unchanged

pytestmark = pytest.mark.slow


def test_run_that_cannot_be_judged_is_stored(
    nightly_run: Run, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A run with inconsistent tables is refused after it is stored, and is not a baseline."""
    judged_nightly_runs(nightly_run, tmp_path, [unchanged])
    with expected_message.raises(InputError):
        store_nightly(as_nightly_run(nightly_run, 1, outcomes={"ok": 1}), History(tmp_path))
    runs = History(tmp_path).runs()
    assert [read_summary(run)["status"] for run in runs] == ["insufficient history", "not judged"]
    (judged,) = judged_nightly_runs(nightly_run, tmp_path, [unchanged], first=2)
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == runs[0].name
    assert judged.baseline.left_out == (f"{runs[1]}: was not judged",)


def test_internal_error_of_judging_loses_no_run(
    nightly_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error is raised after the run is stored; the message has the folder, and a query reads the run."""

    def broken(*_: object) -> None:
        raise TypeError("nobody expected this")

    monkeypatch.setattr("bodycheck.runs.nightly_run.judge_run", broken)
    with pytest.raises(TypeError) as raised:
        judged_nightly_runs(nightly_run, tmp_path, [unchanged])
    (run,) = History(tmp_path).runs()
    assert raised.value.__notes__ == [f"the run is stored in {run}, but could not be judged"]
    assert read_summary(run)["status"] == "not judged"
    count = query([run], "SELECT count(*) AS n FROM results")["n"].tolist()
    assert count == [len(nightly_run.results)]


def _text(old: str, new: str) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return damage


def _footer(path: Path) -> None:
    content = bytearray(path.read_bytes())
    for place in range(len(content) - 200, len(content) - 100):
        content[place] ^= 0xFF
    path.write_bytes(content)


def _unsealed(damage: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return the same damage of a run that was stored before there were sums."""

    def damage_both(path: Path) -> None:
        damage(path)
        summary = json.loads((path.parent / "night.json").read_text())
        del summary["sha256"], summary["seal"]
        (path.parent / "night.json").write_text(json.dumps(summary))

    return damage_both


DAMAGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "no libraries": ("manifest.json", _text('"libraries": {', '"libraries": [], "were": {')),
    "no libraries, before sums": (
        "manifest.json",
        _unsealed(_text('"libraries": {', '"libraries": [], "were": {')),
    ),
    "nested without end": ("manifest.json", lambda path: path.write_text("[" * 200_000)),
    "another number": ("results.csv", _text("0.05", "0.06")),
    "an unknown verdict": ("methods.csv", _unsealed(_text("converges", "convulses"))),
    "an open quotation mark": ("results.csv", _unsealed(_text("bodycheck run", "bodycheck 'run"))),
    "a footer": ("results.parquet", _footer),
    "a footer, before sums": ("results.parquet", _unsealed(_footer)),
    "a page": ("report.html", lambda path: path.unlink()),
    "a status": ("night.json", _text("no regression", "no repression")),
    "a number in place of the run": ("night.json", lambda path: path.write_text("3")),
}


@pytest.mark.parametrize("what", DAMAGES)
def test_damaged_past_run_is_named_and_not_a_baseline(
    what: str, pair: Path, nightly_run: Run, tmp_path: Path
) -> None:
    """The next run is stored and compared with the one before; the damaged file is named."""
    history = tmp_path / "history"
    shutil.copytree(pair, history)
    older, newer = History(history).runs()
    name, damage = DAMAGES[what]
    damage(newer / name)
    (judged,) = judged_nightly_runs(nightly_run, history, [unchanged], first=2)
    (why,) = judged.baseline.left_out
    assert why.startswith(f"{newer / name}: ")
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == older.name
    assert judged.status == "no regression"
    assert f"{newer / name}: " in (History(history).runs()[-1] / "night.md").read_text()


@pytest.fixture(scope="module")
def pair(nightly_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a history of two nightly runs."""
    folder = tmp_path_factory.mktemp("pair")
    store_nightly_runs(nightly_run, folder, [unchanged, unchanged])
    return folder


def test_run_dated_in_the_future_is_reported_and_not_a_baseline(
    nightly_run: Run, pair: Path, tmp_path: Path
) -> None:
    """A wrong clock decides neither what is compared nor what is pruned."""
    history = tmp_path / "history"
    shutil.copytree(pair, history)
    older, newer = History(history).runs()
    coming = history / "29990101T000000Z-00000f"
    shutil.copytree(newer, coming)
    (judged,) = judged_nightly_runs(nightly_run, history, [unchanged], first=2)
    assert judged.baseline.left_out == (f"{coming}: is dated in the future",)
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == newer.name
    assert History(history).prune(1) == [older.name, newer.name]
    assert [run.name for run in History(history).runs()] == [judged.newest.run_id, coming.name]


@pytest.mark.parametrize(
    ("others", "columns", "rows"),
    [
        ([], ["a", "b"], [(1, "x"), (2, "z")]),
        (["1.5 AS a, 'w' AS b"], ["a", "b"], [(1, "x"), (2, "z"), (1.5, "w")]),
        (["4 AS a, 'y' AS b, 3 AS c"], ["a", "b", "c"], [(1, "x", None), (2, "z", None), (4, "y", 3)]),
    ],
)
def test_files_of_equal_and_of_other_columns_are_read_together(
    others: list[str], columns: list[str], rows: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    """Columns that some files lack are empty there, and numbers of two types are all kept."""
    tables = ["1 AS a, 'x' AS b", "2 AS a, 'z' AS b", *others]
    paths = [tmp_path / f"{number}.parquet" for number in range(len(tables))]
    with duckdb_connection() as database:
        for table, path in zip(tables, paths, strict=True):
            database.sql(f"SELECT {table}").write_parquet(str(path))
        found = read_parquet(database, paths, union_by_name=True)
        assert (found.columns, found.fetchall()) == (columns, rows)
