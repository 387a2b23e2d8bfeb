"""The nights of a history: one folder each, written whole or not at all, and never changed again."""

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

_RUN_ID = re.compile(r"\d{8}T\d{6}Z-[0-9a-f]{6}")
_STAMP, _STAMP_LENGTH = "%Y%m%dT%H%M%SZ", 16  # what such a name begins with
_LOCK = ".lock"
_UNFINISHED = ".unfinished-"


@dataclass(frozen=True)
class History:
    """A folder of nights, each named by its run: the names sort as the nights began."""

    folder: Path

    @classmethod
    def at(cls, folder: Path) -> History:
        """Return the history in a folder, which is made if it is not there; asked before anything is run.

        Raises InputError where nothing could be stored there.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
            check_folder(f"--history {folder}", folder)
        except OSError as error:
            raise InputError(f"--history {folder}: cannot be written: {error.strerror or error}") from None
        return cls(folder)

    @classmethod
    def existing(cls, folder: Path) -> History:
        """Return the history in a folder; InputError where there is none."""
        history = cls(folder)
        if not history.nights():
            raise InputError(f"{folder}: holds no night; `bodycheck nightly --history {folder}` stores one")
        return history

    def nights(self) -> list[Path]:
        """Return the folders of the nights, the oldest first; a night that is being written is none."""
        try:
            entries = sorted(self.folder.iterdir())
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be read: {error.strerror or error}") from None
        return [entry for entry in entries if _RUN_ID.fullmatch(entry.name)]

    def dated_in_future(self, run_id: str = "") -> list[Path]:
        """Return the nights that began after now, and after a run that is named: the last of `nights`.

        They are no baseline, and pruning counts none of them: a clock that was wrong once must not decide.
        """
        latest = max(f"{datetime.now(UTC):{_STAMP}}", run_id[:_STAMP_LENGTH])
        return [night for night in self.nights() if night.name[:_STAMP_LENGTH] > latest]

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Let no other process store or prune meanwhile; a process that is killed lets go of it.

        What a killed one left unfinished is removed: while this is held, nobody is writing it.
        """
        with (self.folder / _LOCK).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            for abandoned in self.folder.glob(f"{_UNFINISHED}*"):
                shutil.rmtree(abandoned, ignore_errors=True)
            yield

    @contextmanager
    def new_night(self, name: str) -> Iterator[Path]:
        """Give a folder to write a night into, which takes its place among the others at the end.

        Raises InputError where it cannot be written; then, and where the body raises, there is no such night.
        """
        unfinished, night = self.folder / f"{_UNFINISHED}{name}", self.folder / name
        try:
            with self._locked():
                try:
                    unfinished.mkdir()
                    yield unfinished
                    _settle(unfinished)
                    unfinished.rename(night)
                    _settle(self.folder)
                finally:
                    shutil.rmtree(unfinished, ignore_errors=True)
        except OSError as error:
            raise InputError(f"{night}: cannot be written: {error.strerror or error}") from None

    def prune(self, keep: int) -> list[str]:
        """Remove all nights but the newest `keep` and those of the future; return the names of the removed.

        Raises InputError where one cannot be removed.
        """
        if keep < 1:
            raise InputError(f"--keep {keep}: must be 1 or more nights")
        gone = []
        try:
            with self._locked():
                coming = self.dated_in_future()
                for night in [night for night in self.nights() if night not in coming][:-keep]:
                    leaving = self.folder / f"{_UNFINISHED}{night.name}"
                    night.rename(leaving)  # at once: a night is there whole or not at all
                    shutil.rmtree(leaving)
                    gone.append(night.name)
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be pruned: {error.strerror or error}") from None
        return gone


def _settle(folder: Path) -> None:
    """Bring a folder, and the files in it, to the disk: a night must outlast a loss of power."""
    for path in (*(entry for entry in folder.iterdir() if entry.is_file()), folder):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
