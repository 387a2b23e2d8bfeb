"""The kinds of loads: one module each in `kinds/`, discovered by `load_kinds`.

CONTRIBUTING.md describes how to add one. Only torques and forces can switch on and off. A load whose formula
branches cannot be recorded: it needs its own kernels, as the springs do (`continuous_loads.py`,
`taylor/spring_terms.py`), or must be supplied as a user function.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from types import MappingProxyType

from bodycheck.reference_impl.loads import kinds
from bodycheck.reference_impl.loads.load import Load


@cache
def load_kinds() -> Mapping[str, type[Load]]:
    """Return all kinds of loads by name, as the modules of `kinds` define them."""
    found: dict[str, type[Load]] = {}
    for module in pkgutil.iter_modules(kinds.__path__, f"{kinds.__name__}."):
        for value in vars(import_module(module.name)).values():
            if isinstance(value, type) and issubclass(value, Load) and "kind" in vars(value):
                found[value.kind] = value
    return MappingProxyType(found)
