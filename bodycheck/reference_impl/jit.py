"""How the kernels of reference_impl are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from bodycheck.reference_impl.cache_home import cache_directory
from bodycheck.reference_impl.kernel_files import check_files_of


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
