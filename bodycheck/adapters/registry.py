"""The known engines, and their import."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.file_digests import digest_of
from bodycheck.adapters.contract import Adapter

_BUILT_IN = {
    "mujoco": ("bodycheck.adapters.mujoco", "MuJoCo"),
    "pybullet": ("bodycheck.adapters.pybullet", "PyBullet"),
    "dart": ("bodycheck.adapters.dart", "Dart"),
    "reference": ("bodycheck.adapters.reference", "Reference"),
}
_DISTRIBUTIONS = {"mujoco": "mujoco", "pybullet": "pybullet", "dart": "dartpy"}
_registered: dict[str, Adapter] = {}


_CONTRACT = ("name", "version", "methods", "unsupported", "build")


def register_adapter(adapter: Adapter) -> None:
    """Register an engine under adapter.name, replacing any other of that name.

    Raises InputError if it lacks an attribute of the contract.
    """
    if missing := [part for part in _CONTRACT if not hasattr(adapter, part)]:
        raise InputError(f"{adapter!r} is not an adapter: it has no {', no '.join(missing)}")
    _registered[adapter.name] = adapter


@contextmanager
def registered(adapter: Adapter) -> Iterator[None]:
    """Register an engine for the duration of a with block."""
    before = dict(_registered)
    register_adapter(adapter)
    try:
        yield
    finally:
        _registered.clear()
        _registered.update(before)


def engine_names() -> tuple[str, ...]:
    """Return the names of all known engines, whether or not they can be imported."""
    return tuple(dict.fromkeys([*_BUILT_IN, *_plugged_in(), *_registered]))


def distribution_of(engine: str) -> str | None:
    """Return the package that provides the engine and its version; for a plug-in, that of its entry point.

    Returns None for an engine without a package: the reference, and those passed to register_adapter.
    """
    if engine in _DISTRIBUTIONS:
        return _DISTRIBUTIONS[engine]
    point = _plugged_in().get(engine)
    return None if point is None or point.dist is None else point.dist.name


def registered_adapter(name: str) -> Adapter | None:
    """Return the adapter registered under this name; None for an engine that any process can import."""
    return _registered.get(name)


@cache
def own_code() -> str:
    """Return a hash of the sources of _util, reference_impl and adapters."""
    package = Path(__file__).parents[1]
    return "".join(digest_of(package / room)[:16] for room in ("_util", "reference_impl", "adapters"))


def get_adapter(name: str) -> Adapter:
    """Return the engine of that name, imported on first use.

    Raises InputError for an unknown name, UnavailableError if the import fails.
    """
    if name in _registered:
        return _registered[name]
    if name not in engine_names():
        raise InputError(f"unknown engine {name!r} (available: {', '.join(engine_names())})")
    return _import(name)


@cache
def _plugged_in() -> dict[str, EntryPoint]:
    """Return the engines of other packages: the entry points of the group bodycheck.adapters."""
    return {point.name: point for point in entry_points(group="bodycheck.adapters")}


@cache
def _import(name: str) -> Adapter:
    try:
        if name in _BUILT_IN:
            module, attribute = _BUILT_IN[name]
            make = getattr(importlib.import_module(module), attribute)
        else:
            make = _plugged_in()[name].load()
        adapter: Adapter = make()
    except Exception as error:  # an engine's module may raise anything
        what = error if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise UnavailableError(f"{name} cannot be imported: {what}") from error
    if missing := [part for part in _CONTRACT if not hasattr(adapter, part)]:
        raise UnavailableError(f"{name} is not an adapter: it has no {', no '.join(missing)}")
    return adapter
