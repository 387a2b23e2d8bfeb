"""The solvers of Newton with their options, for one body and for trees."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bodycheck.reference_impl.arrays import Array


@dataclass(frozen=True)
class NewtonSolver:
    """A class of newton.solvers with its options: fair ones, and which of them change a default.

    bias: its rounding bias, the median over the standard suite (tools/precision_trials.py).
    """

    name: str
    options: Mapping[str, Any]
    formula: str
    changed: tuple[str, ...] = ()
    order: int | None = 1
    bias: float = 1.4


_EULER = "M1, additive quaternion renormalised"
_PORT = "; MuJoCo Warp, in the version that Newton requires"
SOLVERS = {
    "semi-implicit": NewtonSolver(
        "SolverSemiImplicit", {"angular_damping": 0.0}, _EULER, ("no angular damping",)
    ),
    "xpbd": NewtonSolver("SolverXPBD", {}, _EULER),
    # its argument angular_damping has no effect
    "featherstone": NewtonSolver(
        "SolverFeatherstone", {}, _EULER + "; by the articulated body algorithm", bias=0.0
    ),
    "mujoco-euler": NewtonSolver(
        "SolverMuJoCo",
        {"integrator": "euler"},
        f"M1{_PORT}",
    ),
    "mujoco-implicitfast": NewtonSolver(
        "SolverMuJoCo",
        {"integrator": "implicitfast"},
        f"M2{_PORT}",
    ),
    "mujoco-rk4": NewtonSolver(
        "SolverMuJoCo",
        {"integrator": "rk4"},
        f"RK4 on the rotation group, stages averaged{_PORT}",
        order=None,
    ),
}


def finalized(builder: Any, gravity: Array, **options: bool) -> Any:
    """Return the model of a builder on the CPU, with inertias as they were given.

    Releases before 1.8 cannot skip the validation, which raises moments below 1e-10 kg m^2; the builders of
    some have gravity along one axis only.
    """
    builder.balance_inertia = False
    if (skip := "skip_validation_inertia") in inspect.signature(builder.finalize).parameters:
        options[skip] = True
    model = builder.finalize(device="cpu", **options)
    model.set_gravity(gravity)
    return model
