"""What was computed before, by the hash of all that it depends on: one checksummed line per file."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Literal, TypeAlias

from bodycheck._util.cache_dir import cache_home
from bodycheck._util.files import atomic_write
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reports.cache.entries import Entry

Reuse: TypeAlias = Literal["nothing", "truths", "installed", "everything"]
"""nothing; the truths of scenarios; the answers of installed engines too; the answers of all engines whose
identity is known, plug-ins and editable ones included."""


def reuse_of(fresh: bool | None, default: Reuse) -> Reuse:
    """Return what --fresh or --reuse asks for; where neither is given, the default of a command."""
    return default if fresh is None else "nothing" if fresh else "everything"


_MOST_BYTES = 2_000_000_000
_UNUSED_S = 30 * 86400.0
_MARKED_AGAIN_S = 86400.0  # a file that was used less long ago is not marked as used once more


class Cache:
    """Messages by key. A file that is damaged counts as absent; a folder that cannot be written, as full."""

    def __init__(self, folder: Path, *, readable: bool = True) -> None:
        self._folder, self._readable = folder, readable
        self._writable = True

    @classmethod
    def default(cls) -> Cache:
        """The one beside the compiled kernels; BODYCHECK_CACHE_DIR moves both."""
        return cls(cache_home() / "results")

    def write_only(self) -> Cache:
        """Return the same without what is in it: all is computed anew, and takes the place of what was."""
        return Cache(self._folder, readable=False)

    def get(self, key: str) -> Message | None:
        """Return what was put under this key, if it is there and whole."""
        entry = self.entry(key)
        return None if entry is None else entry.value

    def has(self, key: str) -> bool:
        """Whether there is a file for this key, whole or not."""
        return self._readable and os.path.isfile(self._place(key))  # noqa: PTH113 - False without permission

    def entry(self, key: str) -> Entry | None:
        """Return the same, with the line that holds it."""
        if not self._readable:
            return None
        place = self._place(key)
        try:
            with place.open("rb", buffering=0) as file:
                used = os.fstat(file.fileno()).st_mtime
                entry = Entry.read(file.readall())
        except OSError:
            return None
        if entry is None or entry.key != key:
            return None
        if abs(time.time() - used) > _MARKED_AGAIN_S:
            with suppress(OSError):
                os.utime(place)
        return entry

    def put(self, key: str, message: Message) -> None:
        """Keep a message, whole or not at all; once the disk is full or read-only, nothing more."""
        self.keep(Entry.of(key, message))

    def keep(self, entry: Entry) -> None:
        """Keep a message that is sealed already, as `put` does."""
        if not self._writable:
            return
        place = self._place(entry.key)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(place, entry.line)
        except OSError:
            self._writable = False

    def prune(self, now_s: float | None = None) -> None:
        """Remove what was not used for a month, and then the longest unused, down to two gigabytes."""
        now_s = time.time() if now_s is None else now_s
        files = []
        with suppress(OSError):  # it may not be there, or not be readable
            for folder in self._folder.iterdir():
                with suppress(OSError), os.scandir(folder) as entries:  # another process may prune it too
                    for entry in entries:
                        facts = entry.stat()
                        files.append((facts.st_mtime, facts.st_size, entry.path))
        total = sum(size for _, size, _ in files)
        for used, size, path in sorted(files):
            if now_s - used < _UNUSED_S and total <= _MOST_BYTES:
                break
            with suppress(OSError):
                Path(path).unlink()
            total -= size

    def _place(self, key: str) -> Path:
        return self._folder / key[:2] / key[2:]
