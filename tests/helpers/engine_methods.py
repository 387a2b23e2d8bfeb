"""The adapters of the engines that can be imported, and their methods as test parameters."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from typing import Any

import pytest

from bodycheck.adapters.contract import Adapter

ADAPTERS = {"mujoco": "MuJoCo", "pybullet": "PyBullet", "dart": "Dart", "reference": "Reference"}
"""Engine -> the name of its adapter's class."""


def adapter_of(engine: str) -> Adapter:
    """Return an adapter of an engine; raise ImportError if the engine is not installed."""
    adapter: Adapter = getattr(importlib.import_module(f"bodycheck.adapters.{engine}"), ADAPTERS[engine])()
    return adapter


def engine_methods(engines: Iterable[str], accepts: Callable[[Adapter, str], bool]) -> list[Any]:
    """Return a test parameter (adapter, method) for each wanted method; absent engines are skipped."""
    found: list[Any] = []
    for engine in engines:
        try:
            adapter = adapter_of(engine)
        except ImportError as error:
            found.append(pytest.param(None, "", id=engine, marks=pytest.mark.skip(reason=str(error))))
            continue
        found += [
            pytest.param(adapter, method, id=f"{engine}:{method}")
            for method in adapter.methods
            if accepts(adapter, method)
        ]
    return found
