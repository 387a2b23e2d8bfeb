"""Engines that are registered for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.registry import _registered, register_adapter


@contextmanager
def registered(*adapters: Adapter) -> Iterator[None]:
    """Register adapters, and restore the registry at the end."""
    before = dict(_registered)
    try:
        for adapter in adapters:
            register_adapter(adapter)
        yield
    finally:
        _registered.clear()
        _registered.update(before)
