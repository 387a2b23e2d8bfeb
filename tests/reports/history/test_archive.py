"""A history: each nightly run is stored completely or not at all."""

from __future__ import annotations

import multiprocessing
import signal
from datetime import UTC, datetime
from pathlib import Path

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.history.archive import History, started_at
from tests.helpers.concurrent_storage import name, write, write_and_die, write_some
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.file_size_limit import file_size_limit


def test_nightly_runs_are_sorted_by_their_start(tmp_path: Path) -> None:
    """They may be stored in any order; other folders are not listed."""
    history = History.at(tmp_path / "new" / "history")
    for number in (3, 1, 2):
        write(history.folder, number)
    (history.folder / "notes.txt").write_text("mine")
    (history.folder / "plots").mkdir()
    assert [run.name for run in history.runs()] == [name(1), name(2), name(3)]
    assert sorted(path.name for path in history.runs()[0].iterdir()) == ["manifest.json", "results.csv"]


def test_folder_of_a_run_is_no_history(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """Nightly runs would be stored among the files of the run."""
    (tmp_path / "manifest.json").write_text("{}")
    with expected_message.raises(InputError):
        History.at(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_name_too_long_for_a_folder_is_refused(tmp_path: Path) -> None:
    """The operating system refuses it; nothing is run first."""
    with pytest.raises(InputError):
        History.at(tmp_path / ("n" * 3000))


def test_start_is_that_of_the_run_id() -> None:
    """The start is in UTC, to the second."""
    assert started_at("20260102T030405Z-0a1b2c") == datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def _begin_and_raise(history: History, error: type[BaseException]) -> None:
    with history.new_run(name(2)) as folder:
        (folder / "results.csv").write_text("half")
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_unfinished_nightly_run_is_not_listed(tmp_path: Path, error: type[BaseException]) -> None:
    """An interruption leaves the history unchanged, and the next run is stored."""
    history = History.at(tmp_path)
    write(tmp_path, 1)
    with pytest.raises(error):
        _begin_and_raise(history, error)
    assert [entry.name for entry in tmp_path.iterdir() if entry.is_dir()] == [name(1)]
    write(tmp_path, 3)
    assert [run.name for run in history.runs()] == [name(1), name(3)]


def test_full_disk_leaves_the_stored_runs(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """One line names the file; the next run, with room, is stored."""
    history = History.at(tmp_path)
    write(tmp_path, 1)
    with (
        file_size_limit(1000),
        expected_message.raises(InputError),
        history.new_run(name(2)) as folder,
    ):
        (folder / "results.csv").write_text(2000 * "x")
    write(tmp_path, 3)
    assert [run.name for run in history.runs()] == [name(1), name(3)]


def test_remains_of_a_killed_process_are_removed(tmp_path: Path) -> None:
    """A kill leaves no run and no lock, and its files are removed by the next run."""
    history = History.at(tmp_path)
    write(tmp_path, 1)
    process = multiprocessing.get_context("spawn").Process(target=write_and_die, args=(tmp_path, 2))
    process.start()
    process.join(60.0)
    assert process.exitcode == -signal.SIGKILL
    assert [run.name for run in history.runs()] == [name(1)]
    assert any(entry.name.startswith(".unfinished") for entry in tmp_path.iterdir())
    write(tmp_path, 3)
    assert not any(entry.name.startswith(".unfinished") for entry in tmp_path.iterdir())
    assert [run.name for run in history.runs()] == [name(1), name(3)]


def test_concurrent_processes_lose_nothing(tmp_path: Path) -> None:
    """Four processes store ten runs each: all forty are complete."""
    context = multiprocessing.get_context("spawn")
    ranges = [range(10 * k, 10 * k + 10) for k in range(4)]
    processes = [context.Process(target=write_some, args=(tmp_path, numbers)) for numbers in ranges]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60.0)
    assert [process.exitcode for process in processes] == [0] * 4
    runs = History(tmp_path).runs()
    assert [(run / "results.csv").read_text() for run in runs] == [f"{k}\n" for k in range(40)]


def test_stored_run_is_flushed_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files and folder are flushed before the rename, and the history afterwards, since power may fail."""
    flushed: list[str] = []

    def fsync(descriptor: int) -> None:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        flushed.append(path.relative_to(tmp_path).as_posix())
        assert (tmp_path / name(1)).exists() is (not path.is_relative_to(tmp_path / f".unfinished-{name(1)}"))

    monkeypatch.setattr("bodycheck.reports.history.archive.os.fsync", fsync)
    write(tmp_path, 1)
    unfinished = f".unfinished-{name(1)}"
    files = [f"{unfinished}/manifest.json", f"{unfinished}/results.csv"]
    assert sorted(flushed[:2]) == files
    assert flushed[2] == unfinished
    assert flushed[-1] == "."


def test_unfinished_file_of_another_program_stops_nothing(tmp_path: Path) -> None:
    """What cannot be removed is left."""
    (tmp_path / ".unfinished-notes").write_text("mine")
    write(tmp_path, 1)
    assert [run.name for run in History(tmp_path).runs()] == [name(1)]


def test_runs_of_the_future_are_later_than_now_and_than_the_given_run(tmp_path: Path) -> None:
    """A run that began in the same second as the given one is not of its future."""
    seconds = [f"2999010{day}T000000Z-00000{day}" for day in (1, 2, 3)]
    for run_id in ("20260101T000000Z-000000", *seconds):
        (tmp_path / run_id).mkdir()
    found = History(tmp_path).dated_in_future
    assert [run.name for run in found()] == seconds
    assert [run.name for run in found("29990102T000000Z-ffffff")] == seconds[2:]


def test_unreadable_history_is_reported(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The line names the folder and the reason; one that does not exist has no runs."""
    assert History(tmp_path / "absent").runs() == []
    (tmp_path / "file").touch()
    with expected_message.raises(InputError):
        History(tmp_path / "file").runs()


def test_pruning_keeps_the_newest(tmp_path: Path) -> None:
    """The oldest runs are removed and their names returned; nothing else is changed."""
    history = History.at(tmp_path)
    for number in range(5):
        write(tmp_path, number)
    (tmp_path / "notes.txt").write_text("mine")
    assert history.prune(2) == [name(0), name(1), name(2)]
    assert history.prune(2) == []
    assert [run.name for run in history.runs()] == [name(3), name(4)]
    assert (tmp_path / "notes.txt").exists()


def test_unwritable_folder_is_refused_before_the_run(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """One line names the folder."""
    (tmp_path / "file").write_text("")
    with expected_message.raises(InputError):
        History.at(tmp_path / "file")


def test_empty_history_cannot_be_queried(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A missing folder is refused too; the line says how a run is stored."""
    for folder in (tmp_path, tmp_path / "absent"):
        with expected_message.raises(InputError):
            History.existing(folder)


def test_storing_a_run_settles_its_files_and_not_those_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the time to store a run grows with the history."""
    history = History.at(tmp_path)
    settled: list[str] = []

    def fsync(descriptor: int) -> None:
        settled.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)

    monkeypatch.setattr("bodycheck.reports.history.archive.os.fsync", fsync)
    for hour in range(3):
        settled.clear()
        with history.new_run(f"20260101T{hour:02d}0000Z-000000") as folder:
            for place in ("accepted", "report-files", "trajectories"):
                (folder / place).mkdir()
                (folder / place / f"in-{place}").touch()
            (folder / "night.json").touch()
    within = ["accepted", "in-accepted", "in-report-files", "night.json", "report-files"]
    folders = [".unfinished-20260101T020000Z-000000", tmp_path.name]
    assert sorted(settled) == sorted([*within, *folders])
