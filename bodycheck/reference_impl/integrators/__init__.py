"""The fixed-step integrators, one module each.

To add an integrator, add a module to this package that assigns an `Integrator` to METHOD. The registry, the
reference engine and `bodycheck list methods` find it there. An explicit Runge-Kutta method needs only its
tableau and its facts, as in `midpoint.py`. Any other method needs a kernel: the one in `explicit_gyro.py`
holds loads constant over the step (zero-order hold), the one in `cf4.py` evaluates them at every stage. The
facts select the laws that the tests apply: order, angle per step, preserved structure. CONTRIBUTING.md lists
what to run.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module

from bodycheck.reference_impl.integrators.facts import Integrator

_MODULES = [import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
_METHODS: list[Integrator] = [module.METHOD for module in _MODULES if hasattr(module, "METHOD")]

INTEGRATORS = {
    method.name: method for method in sorted(_METHODS, key=lambda method: (method.order, method.name))
}
"""The integrators by name, sorted by order and name."""
