"""The kernels of reference_impl: plain functions that are compiled when first called, or interpreted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, cached_property, update_wrapper
from types import FunctionType
from typing import Any

import numpy as np

from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.pinned_libraries import numba

_interpreting: ContextVar[bool] = ContextVar("interpreting", default=False)


@contextmanager
def interpreted() -> Iterator[None]:
    """Run the kernels that are called in this context as plain Python, without compiling anything.

    Exact kernels give the same bits; the sums and products of others may be fused where they are compiled.
    Raises FloatingPointError where compiled code would go on with inf or NaN.
    """
    token = _interpreting.set(True)
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    finally:
        _interpreting.reset(token)


class Kernel:
    """A function that is compiled when it is first called, or interpreted within `interpreted()`."""

    def __init__(self, function: Callable[..., Any], *, for_literals: bool = True, **options: Any) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._options, self._for_literals = options, for_literals

    @cached_property
    def dispatcher(self) -> Any:
        """The compiled function; importing numba takes a second, so it is imported here."""
        compiled = _compiled(self.py_func, self._options)
        return compiled if self._for_literals else _without_literals(compiled)

    @property
    def targetoptions(self) -> dict[str, Any]:
        """The options of numba, which its inliner reads from the globals of a function."""
        return self._options

    def __call__(self, *args: Any) -> Any:
        """Call the compiled or the interpreted function."""
        return self.py_func(*args) if _interpreting.get() else self.dispatcher(*args)


@cache
def _numba() -> Any:
    """Import numba, and let compiled functions call kernels."""
    found = numba()
    dispatcher_type = found.core.types.Dispatcher
    found.extending.typeof_impl.register(Kernel)(lambda kernel, _: dispatcher_type(kernel.dispatcher))
    return found


def _compiled(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    from bodycheck.reference_impl.kernels.cache_files import check_files_of

    compiler = _numba()
    # numba reads CACHE_DIR when it decorates a function. The setting is global to the process, so it is
    # restored.
    before = compiler.config.CACHE_DIR
    compiler.config.CACHE_DIR = str(cache_directory())
    try:
        return check_files_of(compiler.njit(cache=True, error_model="numpy", **options)(function))
    finally:
        compiler.config.CACHE_DIR = before


def _without_literals(dispatcher: Any) -> Any:
    """Let numba compile a function once for all integers, not again for each constant in a call."""
    from numba.core.types.misc import unliteral

    template = getattr(dispatcher, "get_call_template", None)
    if template is not None:  # None if NUMBA_DISABLE_JIT is set
        dispatcher.get_call_template = lambda args, kws: template([unliteral(arg) for arg in args], kws)
    return dispatcher


def as_exact(kernel: Kernel) -> Any:
    """Return the same function, compiled exactly as written."""
    original = kernel.py_func
    copy = FunctionType(original.__code__, original.__globals__, original.__name__, original.__defaults__)
    copy.__qualname__ = f"{original.__qualname__}_exact"  # numba names the files of its cache by it
    copy.__module__ = original.__module__
    return exact_kernel(copy)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for speed: products and sums may be fused, but not reordered."""
    return Kernel(function, fastmath={"contract"})


def unspecialised_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `kernel` does, but only once: numba would do so for each constant integer in a call."""
    return Kernel(function, for_literals=False, fastmath={"contract"})


def long_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `kernel` does, and release the GIL, so that threads that report progress can run."""
    return Kernel(function, fastmath={"contract"}, nogil=True)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that allocates no array, without reference counting of its arguments.

    The reference counts are atomic. They are updated wherever an inlined function takes an array, even in the
    innermost loops. An undocumented option of numba leaves them out.
    """
    return Kernel(function, fastmath={"contract"}, _nrt=False)


def unspecialised_borrowing_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `borrowing_kernel` does, but only once for all constant integers in calls."""
    return Kernel(function, for_literals=False, fastmath={"contract"}, _nrt=False)


def borrowing_inline(function: Callable[..., Any]) -> Any:
    """Compile as `borrowing_kernel` does, force-inlined into the callers; numba types it only once."""
    return Kernel(function, for_literals=False, fastmath={"contract"}, _nrt=False, forceinline=True)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """Inline a function of a few lines into its callers: compiling it separately costs 50 ms."""
    return Kernel(function, fastmath={"contract"}, inline="always")


def merged_kernel(function: Callable[..., Any]) -> Any:
    """Compile a long function that several kernels share, force-inlined into each of them.

    Otherwise each of them has a copy, which LLVM optimises separately. The process that compiles them runs
    the copy that it linked first, and every later one the copy in the file of the kernel that it loads: the
    last bits of the results would depend on that.
    """
    return Kernel(function, fastmath={"contract"}, forceinline=True)


def exact_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function exactly as written, each operation rounded: for error-free arithmetic."""
    # explicit, because a function without the flag inherits it from the first kernel that calls it
    return Kernel(function, fastmath=False)


def long_exact_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `exact_kernel` does, and release the GIL, so that threads can share a batch."""
    return Kernel(function, fastmath=False, nogil=True)


@cache
def in_single_precision(double: Any) -> Any:
    """Return a kernel compiled from the same source, with each constant and each kernel it calls in float32.

    Call it with float32 arrays and scalars only: numba computes in the wider of two types. A kernel that
    allocates arrays, or mixes integers into its arithmetic, would need its own types.
    """
    function = _function_of(double)
    named = {name: _single(function.__globals__[name]) for name in _named_in(function)}
    constants = tuple(_single(constant) for constant in function.__code__.co_consts)
    single = FunctionType(
        function.__code__.replace(co_consts=constants), {**function.__globals__, **named}, function.__name__
    )
    single.__qualname__ = f"{function.__qualname__}_f32"  # numba names its cache files by it
    single.__module__, single.__doc__ = function.__module__, function.__doc__
    return kernel(single)


def _function_of(compiled: Any) -> FunctionType:
    """Return the Python source of a kernel, which with NUMBA_DISABLE_JIT is the kernel itself."""
    function: FunctionType = getattr(compiled, "py_func", compiled)
    return function


def _named_in(function: FunctionType) -> list[str]:
    return [name for name in function.__code__.co_names if name in function.__globals__]


def _single(value: Any) -> Any:
    """Return a float or a kernel in single precision, anything else unchanged."""
    if isinstance(value, float):
        return np.float32(value)
    source = _function_of(value)
    is_own = isinstance(source, FunctionType) and source.__module__.startswith("bodycheck.")
    return in_single_precision(value) if is_own else value
