"""How the kernels of reference_impl are compiled, and numba's cache with a digest per file."""

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
    # numba chooses the place of its cache while it decorates; its configuration belongs to the
    # whole process, so it is handed back as it was.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_directory())
    try:
        return check_files_of(numba.njit(cache=True, error_model="numpy", **options)(function))
    finally:
        numba.config.CACHE_DIR = before


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for speed: products and sums may be fused, nothing is reordered."""
    return _compile(function, fastmath={"contract"})


def long_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `kernel` does; while it runs, other threads do: those that tell how long it has taken."""
    return _compile(function, fastmath={"contract"}, nogil=True)


def parallel_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `kernel` does, with prange shared by numba's threads."""
    return _compile(function, fastmath={"contract"}, parallel=True)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that makes no array, so that those it is given need no counting of references.

    The counts are atomic, and stand wherever an inlined function takes an array: within the innermost loops.
    numba lets them be left out by an option that it does not document.
    """
    return _compile(function, fastmath={"contract"}, _nrt=False)


def borrowing_inline(function: Callable[..., Any]) -> Any:
    """The same for a part of a loop, to vanish in its callers: typed once, however often it is used."""
    return _compile(function, fastmath={"contract"}, _nrt=False, forceinline=True)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of a few lines into each of its callers: a compilation of its own costs 50 ms."""
    return _compile(function, fastmath={"contract"}, inline="always")


def exact_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function as written, rounding by rounding: for error-free arithmetic."""
    # said aloud: what is left open here is inherited from the kernel that calls it first
    return _compile(function, fastmath=False)


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
    print(f"{why}; compiled code is cached for this command only", file=sys.stderr)


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
