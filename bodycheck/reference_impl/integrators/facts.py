"""What an integrator says of itself; lists, reports and tests are made from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from bodycheck.reference_impl.arrays import Array

Advance: TypeAlias = Callable[[Array, Array, Array, float, int], None]
"""advance(state, body, load, dt, steps) makes the steps in place, compiled.

state (13,) or (18,): position, velocity, spin, then the attitude as quaternion or matrix, row by row.
body and load as in equations.py.
"""


@dataclass(frozen=True)
class Integrator:
    """One fixed-step method.

    attitude and spin name what the state holds: spin is omega in body axes, omega in world axes, or the
    angular momentum about the centre of mass in world axes. order is that of the orientation error.
    """

    name: str
    formula: str
    order: int
    evaluations: int
    torque: Literal["every stage", "held over the step"]
    keeps: str
    source: str
    attitude: Literal["quaternion", "matrix"]
    spin: Literal["omega_body", "omega_world", "angular_momentum"]
    advance: Advance
