"""Methods in single precision: the kernels of other modules, compiled for float32."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators import INTEGRATORS, explicit_gyro, rk4
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.kernels.jit import in_single_precision
from bodycheck.reference_impl.loads.load import ContinuousLoad

SUFFIX = "-f32"


def _in_single_precision(method: Integrator) -> Integrator:
    """Return a method whose state, parameters, step and arithmetic are float32; it takes constant loads."""

    def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
        in_single_precision(method.advance)(state, body, load, np.float32(dt), steps)

    return replace(
        method,
        name=f"{method.name}{SUFFIX}",
        real=np.float32,
        advance=advance,
        refused=(ContinuousLoad,),
    )


SINGLE_PRECISION = {
    single.name: single for single in map(_in_single_precision, (explicit_gyro.METHOD, rk4.METHOD))
}
"""The methods in single precision by name; not among INTEGRATORS, whose laws hold to double precision."""

STEPPED = {**INTEGRATORS, **SINGLE_PRECISION}
"""All fixed-step methods by name."""
