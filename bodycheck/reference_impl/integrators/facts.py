"""The facts of an integrator, from which lists, reports and tests are generated, and tableaus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array


class Tableau(NamedTuple):
    """k_i = f(t + c_i dt, y + dt sum a_ij k_j), y+ = y + dt sum b_i k_i."""

    a: Array
    """(s, s), strictly lower triangular."""
    b: Array
    """(s,)."""
    c: Array
    """(s,), the row sums of a."""

    def stability_function(self, z: complex) -> complex:
        """R(z) = 1 + z b (1 - z a)^-1 (1, ..., 1): a step of y' = lambda y with z = lambda dt is y+ = R(z) y.

        Hairer and Wanner (1996), Solving ODEs II, section IV.3.
        """
        slopes = np.linalg.solve(np.eye(len(self.b)) - z * self.a, np.ones(len(self.b)))
        return complex(1.0 + z * (self.b @ slopes))


Spin: TypeAlias = Literal["omega_body", "omega_world", "angular_momentum"]

Structure: TypeAlias = Literal["angular momentum", "rotation group", "symplectic form", "time reversal"]
"""Structure that the steps preserve to round-off: the angular momentum in world axes if no torque acts; R in
SO(3); the symplectic form, which bounds the energy error; the initial state if the motion is reversed midway.
"""

Advance: TypeAlias = Callable[[Array, Array, Array, float, int], None]
"""advance(state, body, load, dt, steps), compiled, advances the state by the steps, in place.

state (13,) or (18,): position, velocity, spin, then the attitude as a quaternion or a row-major matrix.
body and load as in right_hand_sides.py.
"""

AdvanceForced: TypeAlias = Callable[[Array, Array, Array, Array, float, float, int], None]
"""advance_forced(state, body, load, continuous, begin, dt, steps): the same, with continuous loads.

continuous: as `continuous_loads.packed_continuous_loads` returns it; begin: the time in s at the start of
the first step.
"""


@dataclass(frozen=True)
class Integrator:
    """One fixed-step method.

    order: of the orientation error; evaluations: of the right-hand side, per step.
    conserves: the conserved quantities in words; preserves: those that tests measure.
    step_angle: the rotation angle in rad of one step at constant omega, a function of x = dt |omega|; exact
    is x.
    position_weight: w in x+ = x + dt v + w dt^2 F / m under a constant force; 0 if the pose is explicit, 1 if
    it uses the new velocity, 1/2 if the order is 2 or more.
    attitude and spin: the content of the state; spin is omega in body axes, omega in world axes, or the
    angular momentum about the centre of mass in world axes.
    torque: when constant loads are rotated with the body; continuous: when continuous loads are evaluated;
    refused: the kinds of continuous loads that the method does not support. tableau: of an explicit
    Runge-Kutta method on the whole state, whose stages can then be evaluated outside its kernel.
    real: the type of all numbers that the kernels take and compute with.
    """

    name: str
    formula: str
    order: int
    evaluations: int
    torque: Literal["every stage", "zero-order hold"]
    conserves: str
    preserves: frozenset[Structure]
    source: str
    step_angle: Callable[[float], float]
    position_weight: float
    attitude: Literal["quaternion", "matrix"]
    spin: Spin
    advance: Advance
    advance_forced: AdvanceForced
    continuous: Literal["every stage", "zero-order hold"] = "zero-order hold"
    refused: tuple[type[Any], ...] = ()
    tableau: Tableau | None = None
    real: type[np.floating[Any]] = np.float64


def exact_step_angle(x: float) -> float:
    """x: the exponential map rotates by the exact angle."""
    return x
