"""On-disk cache of results, keyed by the hash of everything they depend on: one checksummed line per file."""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from bodycheck._util.cache_dir import cache_dir
from bodycheck._util.files import atomic_write, opened, sealed
from bodycheck.adapters.workers.protocol import Message


@dataclass(frozen=True, eq=False)
class Entry:
    """A message with its key, and the checksummed line of both, which the cache and the journal share."""

    key: str
    value: Message
    line: bytes

    @classmethod
    def of(cls, key: str, value: Message) -> Entry:
        """Return the entry of a message, with its checksum."""
        return cls(key, value, sealed({"key": key, "value": value}))

    @classmethod
    def read(cls, line: bytes) -> Entry | None:
        """Return the entry of a line; None where the line is truncated or changed."""
        message = opened(line)
        return None if message is None else cls(message["key"], message["value"], line)


def key_of(**parts: Any) -> str:
    """Return the hash of plain data: equal if and only if all the data are equal."""
    text = json.dumps(parts, sort_keys=True)
    return sha256(text.encode()).hexdigest()


_MAX_BYTES = 2_000_000_000
_UNUSED_S = 30 * 86400.0
_PRUNED_AGAIN_S = 3600.0  # a folder of many entries takes 0.3 s, and each run prunes
_MARKED_AGAIN_S = 86400.0  # the time of last use is updated at most this often


class Cache:
    """Messages by key. A damaged file counts as absent; nothing is stored in an unwritable folder."""

    def __init__(self, folder: Path, *, readable: bool = True) -> None:
        self._folder, self._readable = folder, readable
        self._writable = True

    @classmethod
    def default(cls) -> Cache:
        """Return the cache next to the compiled kernels; BODYCHECK_CACHE_DIR moves both."""
        return cls(cache_dir() / "results")

    def write_only(self) -> Cache:
        """Return the same cache without reading: results are computed again and replace the old entries."""
        return Cache(self._folder, readable=False)

    def get(self, key: str) -> Message | None:
        """Return the message stored under this key; None where it is absent or damaged."""
        entry = self.entry(key)
        return None if entry is None else entry.value

    def has(self, key: str) -> bool:
        """Whether there is a file for this key, intact or damaged."""
        return self._readable and os.path.isfile(self._path(key))  # noqa: PTH113 - False without permission

    def entry(self, key: str) -> Entry | None:
        """Return the entry stored under this key, with its line; None where it is absent or damaged."""
        if not self._readable:
            return None
        path = self._path(key)
        try:
            with path.open("rb", buffering=0) as file:
                used = os.fstat(file.fileno()).st_mtime
                entry = Entry.read(file.readall())
        except OSError:
            return None
        if entry is None or entry.key != key:
            return None
        if abs(time.time() - used) > _MARKED_AGAIN_S:
            with suppress(OSError):
                os.utime(path)
        return entry

    def put(self, key: str, message: Message) -> None:
        """Store a message atomically; once the disk is full or read-only, do nothing."""
        self.keep(Entry.of(key, message))

    def keep(self, entry: Entry) -> None:
        """Store a message that already has its checksum, like `put`."""
        if not self._writable:
            return
        path = self._path(entry.key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(path, entry.line)
        except OSError:
            self._writable = False

    def prune(self, now_s: float | None = None) -> None:
        """Remove entries unused for 30 days, then the least recently used ones, to 2 GB; once an hour."""
        now_s = time.time() if now_s is None else now_s
        mark = self._folder / "pruned"
        with suppress(OSError):  # where it is absent, or cannot be written, this folder is pruned each time
            if abs(now_s - mark.stat().st_mtime) < _PRUNED_AGAIN_S:
                return
        with suppress(OSError):
            mark.touch()
            os.utime(mark, (now_s, now_s))
        files = []
        with suppress(OSError):  # the folder may be absent or unreadable
            for folder in self._folder.iterdir():
                with suppress(OSError), os.scandir(folder) as entries:  # another process may prune it too
                    for entry in entries:
                        facts = entry.stat()
                        files.append((facts.st_mtime, facts.st_size, entry.path))
        total = sum(size for _, size, _ in files)
        for used, size, path in sorted(files):
            if now_s - used < _UNUSED_S and total <= _MAX_BYTES:
                break
            with suppress(OSError):
                Path(path).unlink()
            total -= size

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / key[2:]
