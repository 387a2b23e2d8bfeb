"""What was computed before, by the hash of all that it depends on: one sealed line a file."""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from bodycheck.adapters.protocol import Message
from bodycheck.reference_impl.cache_home import cache_home
from bodycheck.reports.storage.sealed import opened, sealed

_MOST_BYTES = 2_000_000_000
_UNUSED_S = 30 * 86400.0


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
        place = self._place(key)
        if not self._readable:
            return None
        try:
            message = opened(place.read_bytes())
        except OSError:
            return None
        if message is None or message["key"] != key:
            return None
        with suppress(OSError):
            os.utime(place)
        value: Message = message["value"]
        return value

    def put(self, key: str, message: Message) -> None:
        """Keep a message, whole or not at all; once the disk is full or read-only, nothing more."""
        if not self._writable:
            return
        place = self._place(key)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            descriptor, unfinished = tempfile.mkstemp(dir=place.parent, suffix=".part")
            try:
                with os.fdopen(descriptor, "wb") as file:
                    file.write(sealed({"key": key, "value": message}))
                Path(unfinished).replace(place)
            except BaseException:
                with suppress(OSError):
                    Path(unfinished).unlink()
                raise
        except OSError:
            self._writable = False

    def prune(self, now_s: float | None = None) -> None:
        """Remove what was not used for a month, and then the longest unused, down to two gigabytes."""
        now_s = time.time() if now_s is None else now_s
        files = []
        for path in self._folder.glob("*/*"):
            with suppress(OSError):
                facts = path.stat()
                files.append((facts.st_mtime, facts.st_size, path))
        total = sum(size for _, size, _ in files)
        for used, size, path in sorted(files):
            if now_s - used < _UNUSED_S and total <= _MOST_BYTES:
                break
            with suppress(OSError):
                path.unlink()
            total -= size

    def _place(self, key: str) -> Path:
        return self._folder / key[:2] / key[2:]
