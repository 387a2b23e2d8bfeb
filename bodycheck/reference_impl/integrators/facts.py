"""What an integrator says of itself; lists, reports and tests are made from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.truth.callback_motion import Tableau

Spin: TypeAlias = Literal["omega_body", "omega_world", "angular_momentum"]

Advance: TypeAlias = Callable[[Array, Array, Array, float, int], None]
"""advance(state, body, load, dt, steps) makes the steps in place, compiled.

state (13,) or (18,): position, velocity, spin, then the attitude as quaternion or matrix, row by row.
body and load as in equations.py.
"""

AdvanceUnder: TypeAlias = Callable[[Array, Array, Array, Array, float, float, int], None]
"""advance_forced(state, body, load, lasting, begin, dt, steps): the same under lasting loads as well.

lasting as `lasting.packed_lasting` makes it; begin: the time in s at which the first step begins.
"""


@dataclass(frozen=True)
class Integrator:
    """One fixed-step method.

    attitude and spin name what the state holds: spin is omega in body axes, omega in world axes, or the
    angular momentum about the centre of mass in world axes. order is that of the orientation error.
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
    source: str
    attitude: Literal["quaternion", "matrix"]
    spin: Spin
    advance: Advance
    advance_forced: AdvanceUnder
    lasting: Literal["every stage", "held over the step"] = "held over the step"
    refused: tuple[type[Any], ...] = ()
    tableau: Tableau | None = None
