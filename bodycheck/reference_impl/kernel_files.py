"""numba's cache of compiled kernels with a digest in each file: numba itself does not check them.

A file that a loss of power cut off would end every command, and a changed one would run as machine code. Such
a file, or one that cannot be read, counts as absent: the kernel is compiled again and takes its place. Where
nothing can be written the kernel is used as it is.
"""

from __future__ import annotations

import hashlib
import pickle
import sys
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

_DIGEST_BYTES = 32


class _DamagedError(ValueError):
    """A file that is not what was written."""


class CheckedCacheFile(IndexDataCacheFile):  # type: ignore[misc]
    """The index and the data files of one kernel, each with its SHA-256 before its content."""

    def load(self, key: Any) -> Any:
        """Return what is stored under a key; None where it is absent, damaged or unreadable."""
        try:
            return super().load(key)
        except (OSError, _DamagedError):
            return None

    def save(self, key: Any, data: Any) -> None:
        """Store compiled code, or say once that it cannot be stored."""
        try:
            super().save(key, data)
        except OSError as error:
            _say_once(f"{self._cache_path}: cannot be written: {error.strerror or error}")

    def _load_index(self) -> Any:
        try:
            version, stamp, overloads = _content(Path(self._index_path))
        except (OSError, _DamagedError):
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self, overloads: Any) -> None:
        with self._open_for_write(self._index_path) as file:
            file.write(self._dump((self._version, self._source_stamp, overloads)))

    def _load_data(self, name: str) -> Any:
        return _content(Path(self._data_path(name)))

    def _dump(self, obj: Any) -> bytes:
        content: bytes = super()._dump(obj)
        return hashlib.sha256(content).digest() + content


def _content(path: Path) -> Any:
    """Return what a file holds; OSError or _DamagedError where it is not what was written."""
    data = path.read_bytes()
    digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise _DamagedError(path)
    return pickle.loads(content)


@cache
def _say_once(why: str) -> None:
    print(f"{why}; what is compiled is kept for this command alone", file=sys.stderr)


def check_files_of(dispatcher: Any) -> Any:
    """Have a dispatcher of numba keep its compiled code in files that are checked; return it."""
    kept = getattr(dispatcher, "_cache", None)
    if kept is not None:  # no dispatcher: NUMBA_DISABLE_JIT
        kept._cache_file = CheckedCacheFile(
            cache_path=kept._cache_path,
            filename_base=kept._impl.filename_base,
            source_stamp=kept._impl.locator.get_source_stamp(),
        )
    return dispatcher
