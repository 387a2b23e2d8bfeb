"""The fixed-step integrators: one module each, which assigns an `Integrator` to METHOD.

CONTRIBUTING.md describes how to add one.
"""

from __future__ import annotations

import pkgutil
from dataclasses import replace
from importlib import import_module

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.kernels.jit import in_single_precision
from bodycheck.reference_impl.loads.load import ContinuousLoad

_MODULES = [import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
_METHODS: list[Integrator] = [module.METHOD for module in _MODULES if hasattr(module, "METHOD")]

INTEGRATORS = {
    method.name: method for method in sorted(_METHODS, key=lambda method: (method.order, method.name))
}
"""The integrators by name, sorted by order and name."""


def _in_single_precision(method: Integrator) -> Integrator:
    """Return a method whose state, parameters, step and arithmetic are float32; it takes constant loads."""

    def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
        in_single_precision(method.advance)(state, body, load, np.float32(dt), steps)

    return replace(
        method,
        name=f"{method.name}-f32",
        real=np.float32,
        advance=advance,
        refused=(ContinuousLoad,),
    )


SINGLE_PRECISION = {
    single.name: single for single in map(_in_single_precision, (INTEGRATORS["m1"], INTEGRATORS["rk4"]))
}
"""The methods in single precision by name; not among INTEGRATORS, whose laws hold to double precision."""

STEPPED = {**INTEGRATORS, **SINGLE_PRECISION}
"""All fixed-step methods by name."""
