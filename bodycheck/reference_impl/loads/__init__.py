"""The kinds of loads: one module each in `kinds/`, discovered by `load_kinds`.

To add a load, write one module in `kinds/`, modelled on `magnetic_dipole.py`. It defines a frozen dataclass
derived from `ContinuousLoad`, with

1. `kind`, its name in scenario files;
2. a field for each constant, in SI units, annotated with the `Key` of its table in a scenario file: the name
   with its unit, the form of the value, and the default;
3. `wrench`, force and torque about the centre of mass in world axes, as one formula of the motion that uses
   the numpy operations listed in `tape.py`;
4. for a conservative load, `potential` and `potential_needs`, from which energy and work are derived;
5. `depends_on_velocity` and `couples_translation`, set to False where the load does not, which lifts
   restrictions and saves time.

Scenario files, messages to workers, all engines, the integrators of the reference, the Taylor series, the
certified truth, the energy balance and motions about a pivot then support it. CONTRIBUTING.md lists the
tests, the tables of the docs and the scenario that it needs.

Only torques and forces can switch on and off. A load whose formula branches cannot be recorded: it needs its
own kernels, as the springs do (`continuous_loads.py`, `taylor/spring_terms.py`), or must be supplied as a
user function.
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
