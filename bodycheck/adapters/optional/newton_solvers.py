"""The solvers of Newton with their options, for one body and for trees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


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
