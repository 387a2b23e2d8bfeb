"""Verify the files of numba's cache by a digest."""

from __future__ import annotations

import hashlib
import pickle
import sys
from functools import cache
from pathlib import Path
from typing import Any

from bodycheck._util.pinned_libraries import numba

_DIGEST_BYTES = 32


class _DamagedError(ValueError):
    """The content of a cache file does not match its digest."""


class CheckedCacheFile(numba().core.caching.IndexDataCacheFile):  # type: ignore[misc]
    """The index and data files of one kernel, each preceded by the SHA-256 of its content."""

    def load(self, key: Any) -> Any:
        """Return the code stored under a key, or None if it is absent, damaged or unreadable."""
        try:
            return super().load(key)
        except (OSError, _DamagedError):
            return None

    def save(self, key: Any, data: Any) -> None:
        """Store compiled code, or report once that it cannot be stored."""
        try:
            super().save(key, data)
        except OSError as error:
            _warn_once(f"{self._cache_path}: cannot be written: {error.strerror or error}")

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
    """Return the content of a file. Raise OSError, or _DamagedError if it does not match its digest."""
    data = path.read_bytes()
    digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise _DamagedError(path)
    return pickle.loads(content)


@cache
def _warn_once(reason: str) -> None:
    print(f"{reason}; compiled code is cached for this command only", file=sys.stderr)


def check_files_of(dispatcher: Any) -> Any:
    """Store the compiled code of a numba dispatcher in checksummed files, and return the dispatcher."""
    numba_cache = getattr(dispatcher, "_cache", None)
    if numba_cache is not None:  # None if NUMBA_DISABLE_JIT is set
        numba_cache._cache_file = CheckedCacheFile(
            cache_path=numba_cache._cache_path,
            filename_base=numba_cache._impl.filename_base,
            source_stamp=numba_cache._impl.locator.get_source_stamp(),
        )
    return dispatcher
