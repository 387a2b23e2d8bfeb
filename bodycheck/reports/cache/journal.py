"""The answers of one run, appended as they arrive: written answers persist, truncated ones are dropped."""

from __future__ import annotations

import errno
import fcntl
import os
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import check_regular, open_input
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reports.cache.disk_cache import Entry


class Journal:
    """Messages by key in one append-only file of checksummed lines, locked by one process at a time.

    Opening it again drops a truncated last line and skips damaged lines. Raises InputError where the file
    cannot be read or written, or another process has locked it.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        self._before: dict[str, Message] = {}
        try:
            if path.exists():
                check_regular(path)
            self._file = path.open("ab", buffering=0)
            try:
                # until this process ends, however it ends
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._end = self._read()
                self._file.truncate(self._end)
            except BaseException:
                self._file.close()
                raise
        except BlockingIOError:
            raise InputError(f"{path}: another process is using this run") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None

    def _read(self) -> int:
        """Load the intact entries; return the offset at which the last complete line ends."""
        end = 0
        with open_input(self._path) as file:
            for line in file:
                entry = Entry.read(line)
                if entry is not None:
                    self._before[entry.key] = entry.value
                if line.endswith(b"\n"):
                    end += len(line)
        return end

    @property
    def is_empty(self) -> bool:
        """Whether the journal is empty."""
        return self._end == 0

    def get(self, key: str) -> Message | None:
        """Return the message stored under this key before the journal was opened."""
        return self._before.get(key)

    def put(self, key: str, value: Message) -> None:
        """Append a message.

        Raises InputError where the disk is full; earlier messages remain.
        """
        self.append(Entry.of(key, value))

    def append(self, entry: Entry) -> None:
        """Append a message that already has its checksum, like `put`."""
        with self._lock:
            try:
                written = self._file.write(entry.line)
                if written != len(entry.line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError as error:
                with suppress(OSError):
                    self._file.truncate(self._end)
                raise InputError(f"{self._path}: cannot be written: {error.strerror}") from None
            self._end += len(entry.line)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
