"""The faults that a diagnosis tries, one module for each kind.

To add a fault, add one `Fault` to the function of its kind. A tie goes to the first fault, so specific ones
come before general ones.
"""

from __future__ import annotations

from bodycheck.examine.diagnosis.faults.body_faults import body_faults, gravity_faults
from bodycheck.examine.diagnosis.faults.fault import Fault
from bodycheck.examine.diagnosis.faults.general_faults import general_faults
from bodycheck.examine.diagnosis.faults.limit_faults import limit_faults
from bodycheck.examine.diagnosis.faults.load_faults import load_faults
from bodycheck.examine.diagnosis.faults.map_faults import map_faults
from bodycheck.examine.diagnosis.faults.reading_faults import reading_faults
from bodycheck.examine.diagnosis.faults.tableau_faults import tableau_faults
from bodycheck.examine.diagnosis.faults.wrench_faults import wrench_faults

FAULTS: tuple[Fault, ...] = (
    *map_faults(),
    *limit_faults(),
    *gravity_faults(),
    *body_faults(),
    *load_faults(),
    *wrench_faults(),
    *reading_faults(),
    *tableau_faults(),  # after "the step is scaled", which a wrong sum of weights almost is
    *general_faults(),
)
"""All faults, the specific ones first."""
