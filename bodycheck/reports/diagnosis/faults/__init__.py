"""The faults that a diagnosis tries, one module for each kind.

To add a fault, add one `Fault` to the function of its kind. A tie goes to the first fault, so specific ones
come before general ones.
"""

from __future__ import annotations

from bodycheck.reports.diagnosis.faults.body import body_faults, gravity_faults
from bodycheck.reports.diagnosis.faults.fault import Fault
from bodycheck.reports.diagnosis.faults.general import general_faults
from bodycheck.reports.diagnosis.faults.limits import limit_faults
from bodycheck.reports.diagnosis.faults.loads import load_faults
from bodycheck.reports.diagnosis.faults.maps import map_faults
from bodycheck.reports.diagnosis.faults.readings import reading_faults

FAULTS: tuple[Fault, ...] = (
    *map_faults(),
    *limit_faults(),
    *gravity_faults(),
    *body_faults(),
    *load_faults(),
    *reading_faults(),
    *general_faults(),
)
"""All faults, the specific ones first."""
