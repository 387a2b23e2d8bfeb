"""The answers of one run, appended as they come: what is written is never lost, what is torn is dropped."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path
from types import TracebackType

from bodycheck.adapters.protocol import Message
from bodycheck.errors import InputError
from bodycheck.reports.storage.sealed import opened, sealed


class Journal:
    """Messages by key in one append-only file of sealed lines.

    Opening it again drops a last line that was cut off, and what follows any line that is damaged. Raises
    InputError where the file cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        self._before: dict[str, Message] = {}
        try:
            whole = self._read()
            self._file = path.open("ab", buffering=0)
            self._file.truncate(whole)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None

    def _read(self) -> int:
        """Take in the lines that are whole; return where they end."""
        end = 0
        if self._path.exists():
            with self._path.open("rb") as file:
                for line in file:
                    message = opened(line)
                    if message is None:
                        break
                    self._before[message["key"]] = message["value"]
                    end += len(line)
        return end

    def get(self, key: str) -> Message | None:
        """Return what was put under this key before the journal was opened."""
        return self._before.get(key)

    def put(self, key: str, value: Message) -> None:
        """Append a message.

        Raises InputError where the disk is full; what was written before stays.
        """
        line = sealed({"key": key, "value": value})
        with self._lock:
            place = self._file.tell()
            try:
                written = self._file.write(line)
                if written != len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError as error:
                self._file.truncate(place)
                raise InputError(f"{self._path}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
