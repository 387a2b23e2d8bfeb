"""Engines that are there for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.registry import _registered, register_adapter


@contextmanager
def registered(*adapters: Adapter) -> Iterator[None]:
    """Register adapters; at the end those are registered that were before, and no other."""
    before = dict(_registered)
    try:
        for adapter in adapters:
            register_adapter(adapter)
        yield
    finally:
        _registered.clear()
        _registered.update(before)
