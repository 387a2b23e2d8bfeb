"""Damaged past runs: each is named and left out, and stops no other."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import read_summary, seal_run
from bodycheck.reports.history.queries import query
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.run_files.tables import TABLES
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


def _sealed_again(damage: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return the same damage by somebody who writes the sums anew."""

    def damage_both(path: Path) -> None:
        damage(path)
        seal_run(path.parent)

    return damage_both


DAMAGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "no libraries": ("manifest.json", _text('"libraries": {', '"libraries": [], "were": {')),
    "no libraries, sealed again": (
        "manifest.json",
        _sealed_again(_text('"libraries": {', '"libraries": [], "were": {')),
    ),
    "nested without end": ("manifest.json", lambda path: path.write_text("[" * 200_000)),
    "another number": ("results.csv", _text("0.05", "0.06")),
    "an unknown verdict": ("methods.csv", _sealed_again(_text("converges", "convulses"))),
    "an open quotation mark": ("results.csv", _sealed_again(_text("bodycheck run", "bodycheck 'run"))),
    "a page": ("report.html", lambda path: path.unlink()),
    "a status": ("night.json", _text("no regression", "no repression")),
    "a number in place of the run": ("night.json", lambda path: path.write_text("3")),
}


@pytest.mark.nightly(after=1)
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


def test_tables_of_runs_with_other_columns_are_read_together(tmp_path: Path) -> None:
    """What a version did not write is empty, a text that was empty is not, and every cell keeps its type."""
    texts = {
        "old": 'run_id,engine,steps,message\nold,a,3,\nold,"b, c",4,"two\nlines"\n',
        "new": "run_id,engine,dt_s,reused,message\nnew,a,0.1,True,\nnew,b,inf,False,x\n",
        "later": "run_id,engine,unheard_of\nlater,a,1e-3\n",
        "without": None,
    }
    for name, text in texts.items():
        (tmp_path / name).mkdir()
        if text is not None:
            (tmp_path / name / "results.csv").write_text(text)
    columns = ["run_id", "engine", "steps", "dt_s", "reused", "message", "unheard_of"]

    def read(names: Sequence[str]) -> list[list[object]]:
        sql = f"SELECT {', '.join(names)} FROM results ORDER BY run_id, engine"
        found = query([tmp_path / name for name in texts], sql).astype(object)
        return found.where(found.notna(), None).to_numpy().tolist()

    rows = read(columns)
    assert rows == [
        ["later", "a", None, None, None, None, "1e-3"],
        ["new", "a", None, 0.1, True, "", None],
        ["new", "b", None, math.inf, False, "x", None],
        ["old", "a", 3, None, None, "", None],
        ["old", "b, c", 4, None, None, "two\nlines", None],
    ]
    for count in range(1, len(columns)):
        for some in combinations(range(len(columns)), count):
            assert read([columns[one] for one in some]) == [[row[one] for one in some] for row in rows]


def test_table_of_no_run_has_its_columns_and_no_row(tmp_path: Path) -> None:
    """A query of a table that came later answers, in an old history too."""
    found = query([tmp_path], "SELECT * FROM joints")
    assert (list(found.columns), len(found)) == (list(TABLES["joints"].columns), 0)
