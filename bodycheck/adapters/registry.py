"""Which engines there are, which of them can be imported here, and why the others cannot."""

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
    """Make an engine known under adapter.name, in place of any other of that name.

    Raises InputError where it lacks what the contract asks of an adapter.
    """
    if missing := [part for part in _CONTRACT if not hasattr(adapter, part)]:
        raise InputError(f"{adapter!r} is no adapter: it has no {', no '.join(missing)}")
    _registered[adapter.name] = adapter


@contextmanager
def registered(adapter: Adapter) -> Iterator[None]:
    """Make an engine known as register_adapter does, and forget it again at the end."""
    before = dict(_registered)
    register_adapter(adapter)
    try:
        yield
    finally:
        _registered.clear()
        _registered.update(before)


def engine_names() -> tuple[str, ...]:
    """Return the names of all engines known, whether or not they can be imported here."""
    return tuple(dict.fromkeys([*_BUILT_IN, *_plugged_in(), *_registered]))


def distribution_of(engine: str) -> str | None:
    """Return the package whose versions are the engine's: for a plugged-in one, that of its entry point.

    None for an engine that no package of its own brings: the reference, and those handed to register_adapter.
    """
    if engine in _DISTRIBUTIONS:
        return _DISTRIBUTIONS[engine]
    point = _plugged_in().get(engine)
    return None if point is None or point.dist is None else point.dist.name


def registered_adapter(name: str) -> Adapter | None:
    """Return what register_adapter was given under this name; None for an engine that others can import."""
    return _registered.get(name)


@cache
def own_code() -> str:
    """Return a hash of the sources of _util, reference_impl and adapters."""
    package = Path(__file__).parents[1]
    return "".join(digest_of(package / room)[:16] for room in ("_util", "reference_impl", "adapters"))


def get_adapter(name: str) -> Adapter:
    """Return the engine of that name, imported at its first use.

    Raises InputError for a name that is not known, UnavailableError where the import fails.
    """
    if name in _registered:
        return _registered[name]
    if name not in engine_names():
        raise InputError(f"no engine is named {name!r}; known are {', '.join(engine_names())}")
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
    except Exception as error:  # an engine's module may raise anything, not only where it is missing
        what = error if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise UnavailableError(f"{name} cannot be imported: {what}") from error
    if missing := [part for part in _CONTRACT if not hasattr(adapter, part)]:
        raise UnavailableError(f"{name} is no adapter: it has no {', no '.join(missing)}")
    return adapter
