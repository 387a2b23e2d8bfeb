"""The fixed-step integrators, one module each.

To add an integrator, add a module to this package that assigns its `Integrator` to METHOD. The registry, the
adapter, the lists and the tests find it by that name.

An explicit Runge-Kutta method is its tableau and its facts: `midpoint.py` is a whole one. Any other method is
a kernel and its facts: `explicit_gyro.py` for loads that are held constant over the step (zero-order hold),
`cf4.py` for loads that are evaluated at every stage. The tests derive from the facts which laws they hold a
method to; `tests/reference_impl/test_integrators.py` takes the formula of a method without a tableau in
numpy, which is compared with the kernel step by step. Add a line to `docs/engines/reference.md`.
"""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

from bodycheck.reference_impl.integrators.facts import Integrator

INTEGRATORS: dict[str, Integrator]
"""The integrators by name, sorted by order and name."""


@cache
def _discovered() -> dict[str, Integrator]:
    """Return what the modules of this package assign to METHOD."""
    modules = [import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
    methods = [module.METHOD for module in modules if hasattr(module, "METHOD")]
    return {method.name: method for method in sorted(methods, key=lambda method: (method.order, method.name))}


def __getattr__(name: str) -> dict[str, Integrator]:
    # At the first use, not on import: the modules import loads/, which imports right_hand_sides from here.
    if name == "INTEGRATORS":
        return _discovered()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
