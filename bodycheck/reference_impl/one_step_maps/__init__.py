"""One-step maps in numpy: what engines are compared with, n states at a time, without compilation.

To add a map, yield an `OneStepMap` from `first_order.py`, `runge_kutta_maps.py` or `lie_group.py`:
fingerprints and tests find it in MAPS.
"""

from __future__ import annotations

from bodycheck.reference_impl.one_step_maps.first_order import first_order_maps
from bodycheck.reference_impl.one_step_maps.lie_group import lie_group_maps
from bodycheck.reference_impl.one_step_maps.one_step_map import OneStepMap
from bodycheck.reference_impl.one_step_maps.runge_kutta_maps import exact_flow, runge_kutta_maps
from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS, TreeMap

__all__ = ["EXACT", "MAPS", "TREE_MAPS", "OneStepMap", "TreeMap"]

EXACT = OneStepMap(
    "exact flow", "the exact motion, to round-off", "", 99, exact_flow, reversible=True, stages=True
)

MAPS = {one.name: one for one in (EXACT, *first_order_maps(), *runge_kutta_maps(), *lie_group_maps())}
"""The maps by name. Names are unique, and no two of them are the same map."""
