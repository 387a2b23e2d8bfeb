"""The kinds of loads: one module each in `kinds/`, found by `load_kinds`.

How to add a load. Write one module in `kinds/`, after `magnetic_dipole.py`: a frozen dataclass that
derives from `ContinuousLoad`, with

* `kind`, its name in scenario files;
* a field for each constant, in SI units, annotated with the `Key` of its table in a scenario file: the name
  with its unit, what it may be, and its value where it is left out;
* `wrench`, force and torque about the centre of mass in world axes, as one formula of the motion in the words
  of numpy that `tape.py` names;
* for a conservative load, `potential` and `potential_needs`, of which energy and work follow;
* `depends_on_velocity` and `couples_translation`, set to False where that is so, which spares it
  restrictions and time.

The reader of scenario files, the messages to workers, all engines, the integrators of the reference, the
Taylor series and the certified truth, the balance of energy and motions about a pivot know it by that. Add
its table to docs/scenarios.md, and a test of its motion against a solution found otherwise, as in
tests/reference_impl/test_magnetic_dipole.py.

Loads that come and go are torques and forces alone. A load whose formula branches cannot be recorded; it
needs kernels of its own, as the springs have (`continuous_loads.py`, `taylor/spring_terms.py`), or is left
to a function of the user's.
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
    """Return all kinds of loads by their names: what the modules of `kinds` define."""
    found: dict[str, type[Load]] = {}
    for module in pkgutil.iter_modules(kinds.__path__, f"{kinds.__name__}."):
        for value in vars(import_module(module.name)).values():
            if isinstance(value, type) and issubclass(value, Load) and "kind" in vars(value):
                found[value.kind] = value
    return MappingProxyType(found)
