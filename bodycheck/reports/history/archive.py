"""The nightly runs of a history: one folder each, written atomically and never changed afterwards."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.files import check_folder
from bodycheck._util.pinned_libraries import duckdb
from bodycheck._util.untrusted import check_regular

_RUN_ID = re.compile(r"\d{8}T\d{6}Z-[0-9a-f]{6}")
_STAMP, _STAMP_LENGTH = "%Y%m%dT%H%M%SZ", 16  # the beginning of a run id
_SETTLED = ("accepted", "report-files")  # folders of a run
_LOCK = ".lock"
TRAJECTORIES = "trajectories"
"""The folder of the trajectories in a run."""
_UNFINISHED = ".unfinished-"


def started_at(run_id: str) -> datetime:
    """Return the time at which a run began, from its run id."""
    return datetime.strptime(run_id[:_STAMP_LENGTH], _STAMP).replace(tzinfo=UTC)


@dataclass(frozen=True)
class History:
    """A folder of nightly runs, each in a folder named by its run id; the names sort by start time."""

    folder: Path

    @classmethod
    def at(cls, folder: Path) -> History:
        """Return the history in a folder, which is created when it is first needed.

        Call this before anything is run. Raises InputError if nothing can be stored there, UnavailableError
        without DuckDB, which reads the tables.
        """
        duckdb()
        check_folder(f"--history {folder}", folder)
        if (folder / "manifest.json").exists():
            raise InputError(f"--history {folder}: is the folder of a run, not of a history")
        return cls(folder)

    @classmethod
    def existing(cls, folder: Path) -> History:
        """Return the history in a folder; raise InputError if it contains no nightly run."""
        history = cls(folder)
        if not history.runs():
            raise InputError(f"{folder}: no nightly runs; `bodycheck nightly --history {folder}` stores one")
        return history

    def runs(self) -> list[Path]:
        """Return the folders of the nightly runs, the oldest first, without one that is being written."""
        try:
            entries = sorted(self.folder.iterdir())
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be read: {error.strerror or error}") from None
        return [entry for entry in entries if _RUN_ID.fullmatch(entry.name)]

    def dated_in_future(self, run_id: str = "") -> list[Path]:
        """Return the nightly runs that began after now and after the run `run_id`: the last of `runs`.

        They are not baseline runs and pruning ignores them, so that one wrong clock has no lasting effect.
        """
        latest = max(f"{datetime.now(UTC):{_STAMP}}", run_id[:_STAMP_LENGTH])
        return [run for run in self.runs() if run.name[:_STAMP_LENGTH] > latest]

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the history against other processes that store or prune; a killed process releases its lock.

        Remove the unfinished folders of killed processes: while the lock is held, nobody writes to them.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        if (self.folder / _LOCK).exists():
            check_regular(self.folder / _LOCK)
        with (self.folder / _LOCK).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            for abandoned in self.folder.glob(f"{_UNFINISHED}*"):
                shutil.rmtree(abandoned, ignore_errors=True)
            yield

    @contextmanager
    def new_run(self, name: str) -> Iterator[Path]:
        """Give a temporary folder for a nightly run, and rename it into the history at the end.

        Raises InputError if it cannot be written. Then, and if the body raises, nothing is stored.
        """
        unfinished, run = self.folder / f"{_UNFINISHED}{name}", self.folder / name
        try:
            with self.locked():
                try:
                    unfinished.mkdir()
                    yield unfinished
                    _settle(unfinished)
                    unfinished.rename(run)
                    _settle(self.folder)
                finally:
                    shutil.rmtree(unfinished, ignore_errors=True)
        except OSError as error:
            raise InputError(f"{run}: cannot be written: {error.strerror or error}") from None

    def prune(self, keep: int) -> list[str]:
        """Remove all nightly runs except the newest `keep` and those of the future; return the removed names.

        Raises InputError if one cannot be removed.
        """
        if keep < 1:
            raise InputError(f"--keep {keep}: must be 1 or more")
        removed = []
        try:
            with self.locked():
                future = self.dated_in_future()
                for run in [run for run in self.runs() if run not in future][:-keep]:
                    doomed = self.folder / f"{_UNFINISHED}{run.name}"
                    run.rename(doomed)  # atomic: a nightly run is complete or absent
                    shutil.rmtree(doomed)
                    removed.append(run.name)
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be pruned: {error.strerror or error}") from None
        return removed


def _settle(folder: Path) -> None:
    """Flush a folder and its files to disk, so that a nightly run survives a loss of power.

    Motions are left out: there are many, and each is checked against its row when it is read.
    """
    inside = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
    folders = (entry for entry in inside if entry.name in _SETTLED)
    deeper = [path for entry in folders for path in (*entry.iterdir(), entry)]
    for path in (*(entry for entry in inside if entry.is_file()), *deeper, folder):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
