"""The faults of trees, one module for what each changes.

To add a fault, add one `TreeFault` to the function of its module. A tie goes to the first fault, so specific
ones come before general ones.
"""

from __future__ import annotations

from bodycheck.examine.dynamics.faults.model_faults import model_faults, motion_faults
from bodycheck.examine.dynamics.faults.rate_faults import rate_faults
from bodycheck.examine.dynamics.faults.single_reading_faults import single_reading_faults
from bodycheck.examine.dynamics.faults.tree_fault import TreeFault

TREE_FAULTS: tuple[TreeFault, ...] = (
    *rate_faults(),
    *motion_faults(),
    *model_faults(),
    *single_reading_faults(),
)
"""All faults of trees, the specific ones first."""
