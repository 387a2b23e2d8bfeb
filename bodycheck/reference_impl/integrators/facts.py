"""What an integrator says of itself; lists, reports and tests are made from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.tableau import Tableau

Spin: TypeAlias = Literal["omega_body", "omega_world", "angular_momentum"]

Structure: TypeAlias = Literal["angular momentum", "rotation group", "symplectic form", "time reversal"]
"""What the steps preserve to round-off: the angular momentum in world axes where no torque acts; R in SO(3);
the symplectic form, which bounds the energy error; the initial state, where the motion is reversed midway.
"""

Advance: TypeAlias = Callable[[Array, Array, Array, float, int], None]
"""advance(state, body, load, dt, steps) makes the steps in place, compiled.

state (13,) or (18,): position, velocity, spin, then the attitude as quaternion or matrix, row by row.
body and load as in right_hand_sides.py.
"""

AdvanceUnder: TypeAlias = Callable[[Array, Array, Array, Array, float, float, int], None]
"""advance_forced(state, body, load, lasting, begin, dt, steps): the same under lasting loads as well.

lasting as `continuous_loads.packed_lasting` makes it; begin: the time in s at which the first step begins.
"""


@dataclass(frozen=True)
class Integrator:
    """One fixed-step method.

    order: of the orientation error; evaluations: of the right-hand side, per step.
    keeps: the conserved quantities in words; preserves: those that tests measure.
    turn: the angle in rad that a step turns a body of constant omega by, of x = dt |omega|; exact is x.
    position_weight: w in x+ = x + dt v + w dt^2 F / m under a constant force; 0 where the pose is explicit, 1
    where it follows the new velocity, 1/2 where the order is 2 or more.
    attitude and spin name what the state holds: spin is omega in body axes, omega in world axes, or the
    angular momentum about the centre of mass in world axes.
    torque says when constant loads are turned with the body, lasting when lasting loads are evaluated;
    refused: the kinds of lasting loads that the method cannot take. tableau: of an explicit Runge-Kutta
    method on the whole state, which can so be driven stage by stage from outside its kernel.
    """

    name: str
    formula: str
    order: int
    evaluations: int
    torque: Literal["every stage", "held over the step"]
    keeps: str
    preserves: frozenset[Structure]
    source: str
    turn: Callable[[float], float]
    position_weight: float
    attitude: Literal["quaternion", "matrix"]
    spin: Spin
    advance: Advance
    advance_forced: AdvanceUnder
    lasting: Literal["every stage", "held over the step"] = "held over the step"
    refused: tuple[type[Any], ...] = ()
    tableau: Tableau | None = None


def exact_turn(x: float) -> float:
    """x: an exponential turns by the angle itself."""
    return x
