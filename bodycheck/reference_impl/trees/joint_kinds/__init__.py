"""The kinds of joints: one module each, discovered by `joint_kinds`.

A kind is data: the kernels of `tree_terms.py` compute any combination of its rotation and its translation.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from types import MappingProxyType

from bodycheck.reference_impl.trees.joint_kind import JointKind


@cache
def joint_kinds() -> Mapping[str, JointKind]:
    """Return all kinds of joints by name, as the modules of this package define them."""
    modules = (import_module(module.name) for module in pkgutil.iter_modules(__path__, f"{__name__}."))
    return MappingProxyType({module.JOINT.name: module.JOINT for module in modules})
