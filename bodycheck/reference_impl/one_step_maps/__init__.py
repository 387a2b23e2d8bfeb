"""One-step maps in numpy: what engines are compared with, n states at a time, without compilation.

To add a map, see "A known map" in CONTRIBUTING.md: fingerprints, diagnoses and tests find it in MAPS.
"""

from __future__ import annotations

import re

from bodycheck.reference_impl.one_step_maps.first_order import first_order_maps
from bodycheck.reference_impl.one_step_maps.lie_group import lie_group_maps
from bodycheck.reference_impl.one_step_maps.one_step_map import OneStepMap
from bodycheck.reference_impl.one_step_maps.runge_kutta_maps import exact_flow, runge_kutta_maps
from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS, TreeMap

__all__ = [
    "EXACT",
    "MAPS",
    "TREE_MAPS",
    "OneStepMap",
    "TreeMap",
    "formula_of",
    "named_map",
    "substepped",
]

EXACT = OneStepMap(
    "exact flow", "the exact motion, to round-off", "", 99, exact_flow, reversible=True, stages=True
)

MAPS = {one.name: one for one in (EXACT, *first_order_maps(), *runge_kutta_maps(), *lie_group_maps())}
"""The maps by name. Names are unique, and no two of them are the same map."""

_SUBSTEPPED = re.compile(r"(.+), (\d+) steps per step")


def substepped(name: str, parts: int) -> str:
    """Return the name of a map that is made several times per step."""
    return name if parts == 1 else f"{name}, {parts} steps per step"


def named_map(name: str) -> tuple[OneStepMap, int] | None:
    """Return the map of a name and the number of its steps per step; None for words that name no map."""
    found = _SUBSTEPPED.fullmatch(name)
    one = MAPS.get(found[1] if found else name)
    return None if one is None else (one, int(found[2]) if found else 1)


def formula_of(stated: str) -> str:
    """Return what a method states as its formula, "MAP" or "MAP; REMARK" with the formula of a known map."""
    name, mark, remark = stated.partition("; ")
    found = named_map(name)
    return stated if found is None else f"{name}: {found[0].description}{mark}{remark}"
