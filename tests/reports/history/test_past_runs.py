"""Damaged past runs: each is named and left out, and stops no other."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import told_of
from bodycheck.reports.history.queries import query
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.nightly_run import store_night
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.nightly_runs import as_nightly_run, store_nightly_runs, unchanged

pytestmark = pytest.mark.slow


def test_run_that_cannot_be_judged_is_stored(
    night_run: Run, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A run with inconsistent tables is refused after it is stored, and is not a baseline."""
    store_nightly_runs(night_run, tmp_path, [unchanged])
    with expected_message.raises(InputError):
        store_night(as_nightly_run(night_run, 1, outcomes={"ok": 1}), History(tmp_path))
    nights = History(tmp_path).nights()
    assert [told_of(night)["status"] for night in nights] == ["insufficient history", "not judged"]
    (judged,) = store_nightly_runs(night_run, tmp_path, [unchanged], first=2)
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == nights[0].name
    assert [why.startswith(str(nights[1] / "results.csv")) for why in judged.past.left_out] == [True]


def test_internal_error_of_judging_loses_no_run(
    night_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is raised after the run is stored; the message has the folder, and a query reads it."""

    def broken(*_: object) -> None:
        raise TypeError("nobody expected this")

    monkeypatch.setattr("bodycheck.runs.nightly_run.judge_night", broken)
    with pytest.raises(TypeError) as raised:
        store_nightly_runs(night_run, tmp_path, [unchanged])
    (night,) = History(tmp_path).nights()
    assert raised.value.__notes__ == [f"the run is stored in {night}, but could not be judged"]
    assert told_of(night)["status"] == "not judged"
    count = query([night], "SELECT count(*) AS n FROM results")["n"].tolist()
    assert count == [len(night_run.results)]


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
        told = json.loads((path.parent / "night.json").read_text())
        del told["sha256"], told["seal"]
        (path.parent / "night.json").write_text(json.dumps(told))

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
    what: str, pair: Path, night_run: Run, tmp_path: Path
) -> None:
    """The next run is stored and compared with the one before; the damaged file is named."""
    history = tmp_path / "history"
    shutil.copytree(pair, history)
    older, newer = History(history).nights()
    name, damage = DAMAGES[what]
    damage(newer / name)
    (judged,) = store_nightly_runs(night_run, history, [unchanged], first=2)
    (why,) = judged.past.left_out
    assert why.startswith(f"{newer / name}: ")
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == older.name
    assert judged.status == "no regression"
    assert f"{newer / name}: " in (History(history).nights()[-1] / "night.md").read_text()


@pytest.fixture(scope="module")
def pair(night_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a history of two nightly runs."""
    folder = tmp_path_factory.mktemp("pair")
    store_nightly_runs(night_run, folder, [unchanged, unchanged])
    return folder


def test_run_dated_in_the_future_is_reported_and_not_a_baseline(
    night_run: Run, pair: Path, tmp_path: Path
) -> None:
    """A wrong clock decides neither what is compared nor what is pruned."""
    history = tmp_path / "history"
    shutil.copytree(pair, history)
    older, newer = History(history).nights()
    coming = history / "29990101T000000Z-00000f"
    shutil.copytree(newer, coming)
    (judged,) = store_nightly_runs(night_run, history, [unchanged], first=2)
    assert judged.past.left_out == (f"{coming}: is dated in the future",)
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == newer.name
    assert History(history).prune(1) == [older.name, newer.name]
    assert [night.name for night in History(history).nights()] == [judged.tonight.run_id, coming.name]
