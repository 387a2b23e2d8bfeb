"""Compile the kernels of reference_impl, and verify numba's cache files by a digest."""

from __future__ import annotations

import hashlib
import pickle
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import IndexDataCacheFile

from bodycheck._util.compiled_cache import cache_directory


def _compile(function: Callable[..., Any], **options: Any) -> Any:
    # numba reads CACHE_DIR when it decorates a function. The setting is global to the process, so it is
    # restored.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_directory())
    try:
        return check_files_of(numba.njit(cache=True, error_model="numpy", **options)(function))
    finally:
        numba.config.CACHE_DIR = before


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for speed: products and sums may be fused, but not reordered."""
    return _compile(function, fastmath={"contract"})


def long_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `kernel` does, and release the GIL, so that threads that report progress can run."""
    return _compile(function, fastmath={"contract"}, nogil=True)


def parallel_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `kernel` does, with prange loops distributed over numba's threads."""
    return _compile(function, fastmath={"contract"}, parallel=True)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that allocates no array, without reference counting of its arguments.

    The reference counts are atomic. They are updated wherever an inlined function takes an array, even in the
    innermost loops. An undocumented option of numba leaves them out.
    """
    return _compile(function, fastmath={"contract"}, _nrt=False)


def borrowing_inline(function: Callable[..., Any]) -> Any:
    """Compile as `borrowing_kernel` does, force-inlined into the callers; numba types it only once."""
    return _compile(function, fastmath={"contract"}, _nrt=False, forceinline=True)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """Inline a function of a few lines into its callers: compiling it separately costs 50 ms."""
    return _compile(function, fastmath={"contract"}, inline="always")


def exact_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function exactly as written, each operation rounded: for error-free arithmetic."""
    # explicit, because a function without the flag inherits it from the first kernel that calls it
    return _compile(function, fastmath=False)


_DIGEST_BYTES = 32


class _DamagedError(ValueError):
    """The content of a cache file does not match its digest."""


class CheckedCacheFile(IndexDataCacheFile):  # type: ignore[misc]
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
    """Return the content of a file. Raise OSError, or _DamagedError if it does not match its digest."""
    data = path.read_bytes()
    digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise _DamagedError(path)
    return pickle.loads(content)


@cache
def _say_once(why: str) -> None:
    print(f"{why}; compiled code is cached for this command only", file=sys.stderr)


def check_files_of(dispatcher: Any) -> Any:
    """Store the compiled code of a numba dispatcher in checksummed files, and return the dispatcher."""
    kept = getattr(dispatcher, "_cache", None)
    if kept is not None:  # None if NUMBA_DISABLE_JIT is set
        kept._cache_file = CheckedCacheFile(
            cache_path=kept._cache_path,
            filename_base=kept._impl.filename_base,
            source_stamp=kept._impl.locator.get_source_stamp(),
        )
    return dispatcher
