"""Files that cannot grow: the effect of a full disk on a file that is being written."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Make writes beyond this size fail; Python ignores the accompanying signal."""
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    # a module that is first imported here would leave a truncated .pyc behind
    cached, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        yield
    finally:
        sys.dont_write_bytecode = cached
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))
