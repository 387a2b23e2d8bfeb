"""A history of nights: each there whole or not at all, whatever happens while it is written."""

from __future__ import annotations

import multiprocessing
import signal
from pathlib import Path

import pytest
from full_disk import no_file_longer_than
from storing_nights import name, write, write_and_die, write_some

from bodycheck._util.errors import InputError
from bodycheck.reports.history.archive import History


def test_nights_are_in_the_order_in_which_they_began(tmp_path: Path) -> None:
    """In whatever order they were stored; what is no night is not among them."""
    history = History.at(tmp_path / "new" / "history")
    for number in (3, 1, 2):
        write(history.folder, number)
    (history.folder / "notes.txt").write_text("mine")
    (history.folder / "plots").mkdir()
    assert [night.name for night in history.nights()] == [name(1), name(2), name(3)]
    assert sorted(path.name for path in history.nights()[0].iterdir()) == ["manifest.json", "results.csv"]


def _begin_and_raise(history: History, error: type[BaseException]) -> None:
    with history.new_night(name(2)) as folder:
        (folder / "results.csv").write_text("half")
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_night_that_was_not_finished_is_none(tmp_path: Path, error: type[BaseException]) -> None:
    """Whatever stops the writing leaves the history as it was, and the next night succeeds."""
    history = History.at(tmp_path)
    write(tmp_path, 1)
    with pytest.raises(error):
        _begin_and_raise(history, error)
    assert [entry.name for entry in tmp_path.iterdir() if entry.is_dir()] == [name(1)]
    write(tmp_path, 3)
    assert [night.name for night in history.nights()] == [name(1), name(3)]


def test_a_full_disk_leaves_the_nights_that_are_there(tmp_path: Path) -> None:
    """One line says what could not be written; the next night, with room, succeeds."""
    history = History.at(tmp_path)
    write(tmp_path, 1)
    with (
        no_file_longer_than(1000),
        pytest.raises(InputError, match=f"{name(2)}: cannot be written"),
        history.new_night(name(2)) as folder,
    ):
        (folder / "results.csv").write_text(2000 * "x")
    write(tmp_path, 3)
    assert [night.name for night in history.nights()] == [name(1), name(3)]


def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path: Path) -> None:
    """A kill leaves no night, holds no lock, and its remains go when the next night is stored."""
    history = History.at(tmp_path)
    write(tmp_path, 1)
    process = multiprocessing.get_context("spawn").Process(target=write_and_die, args=(tmp_path, 2))
    process.start()
    process.join(60.0)
    assert process.exitcode == -signal.SIGKILL
    assert [night.name for night in history.nights()] == [name(1)]
    assert any(entry.name.startswith(".unfinished") for entry in tmp_path.iterdir())
    write(tmp_path, 3)
    assert not any(entry.name.startswith(".unfinished") for entry in tmp_path.iterdir())
    assert [night.name for night in history.nights()] == [name(1), name(3)]


def test_processes_that_store_at_once_lose_nothing(tmp_path: Path) -> None:
    """Four processes store ten nights each, side by side: all forty are there, whole."""
    context = multiprocessing.get_context("spawn")
    ranges = [range(10 * k, 10 * k + 10) for k in range(4)]
    processes = [context.Process(target=write_some, args=(tmp_path, numbers)) for numbers in ranges]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60.0)
    assert [process.exitcode for process in processes] == [0] * 4
    nights = History(tmp_path).nights()
    assert [(night / "results.csv").read_text() for night in nights] == [f"{k}\n" for k in range(40)]


def test_pruning_keeps_the_newest(tmp_path: Path) -> None:
    """The oldest nights go, whole, and their names are returned; nothing else is touched."""
    history = History.at(tmp_path)
    for number in range(5):
        write(tmp_path, number)
    (tmp_path / "notes.txt").write_text("mine")
    assert history.prune(2) == [name(0), name(1), name(2)]
    assert history.prune(2) == []
    assert [night.name for night in history.nights()] == [name(3), name(4)]
    assert (tmp_path / "notes.txt").exists()


def test_a_place_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    """Before anything is run: one line that names the place."""
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"--history .*file: cannot be written"):
        History.at(tmp_path / "file")


def test_a_history_without_nights_cannot_be_asked(tmp_path: Path) -> None:
    """Neither can a folder that is not there; the line says how a night is stored."""
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError, match="no nightly runs; `bodycheck nightly --history"):
            History.existing(folder)
