"""The adapters of the engines that can be imported, and their methods as test parameters."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.adapters.contract import Adapter, Method, Reading
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps import EXACT, named_map
from bodycheck.reports.run_files.method_words import NO_KNOWN_MAP

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


def expected_map(method: Method) -> str:
    """Return the known map that a method states; else that of none, or by a tolerance the exact flow."""
    stated = method.formula.partition("; ")[0]
    if named_map(stated) is not None:
        return stated
    return EXACT.name if method.control == "tolerance" else NO_KNOWN_MAP


def state_of(reading: Reading) -> tuple[Array, Array, Array, Array]:
    """Return position, velocity, rotation and omega_body of a reading."""
    r = reading.rotation
    if r is None:
        assert reading.quaternion is not None
        r = Rotation.from_quat(reading.quaternion, scalar_first=True).as_matrix()
    omega_body = reading.omega_body
    if omega_body is None:
        assert reading.omega_world is not None
        omega_body = np.linalg.solve(r, reading.omega_world)
    return reading.position, reading.velocity, r, omega_body
