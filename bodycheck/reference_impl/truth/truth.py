"""What a truth is: a motion with bounds on how far it may be off. How it is found: see truth.py."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory

Kind: TypeAlias = Literal["exact", "certified", "estimated"]

QUANTITIES = ("rad", "energy", "momentum", "omega_rad_s", "m", "m_s")
"""What a truth has a `bound_` and a `round_off_` of, in this order."""


@dataclass(frozen=True, eq=False)
class Truth:
    """A motion that others are measured with, and how far it may itself be off at each sample (n,).

    bound_rad: orientation. bound_energy, bound_momentum: relative to the scene's largest kinetic energy
    and angular momentum. bound_omega_rad_s (body axes), bound_m and bound_m_s: angular velocity, position and
    velocity, in SI units. round_off_*: eps x sensitivity, in the same units, what any stepper in double
    precision has to expect. kind: exact, in closed form; certified, solved twice in
    double-double arithmetic, or, where only a function knows a load, with halved steps that agree as a method
    of high order must; estimated, where those do not, as with a function that jumps. trusted_until_s: the
    first of the times at which bound_rad exceeds 1e-10 rad, or another bound 1e-10 of its scale; infinite
    where none does.
    """

    trajectory: Trajectory
    kind: Kind
    bound_rad: Array
    bound_energy: Array
    bound_momentum: Array
    bound_omega_rad_s: Array
    bound_m: Array
    bound_m_s: Array
    round_off_rad: Array
    round_off_energy: Array
    round_off_momentum: Array
    round_off_omega_rad_s: Array
    round_off_m: Array
    round_off_m_s: Array
    trusted_until_s: float = math.inf

    @property
    def bounds(self) -> Array:
        """(6, n): one row per quantity, in the order of QUANTITIES."""
        return np.array([getattr(self, f"bound_{quantity}") for quantity in QUANTITIES])

    @property
    def end_reason(self) -> str:
        """Why samples beyond trusted_until_s are compared with nothing."""
        if np.isfinite(self.bounds).all():
            return "the motion is chaotic"
        return "neighbours of the start leave all bounds, as where a load is not smooth"

    @property
    def round_offs(self) -> Array:
        """(6, n): likewise."""
        return np.array([getattr(self, f"round_off_{quantity}") for quantity in QUANTITIES])
