"""The truth: a reference motion with bounds on its error. `certification` computes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory

Kind: TypeAlias = Literal["exact", "certified", "estimated"]

QUANTITIES = ("rad", "energy", "momentum", "omega_rad_s", "m", "m_s")
"""The quantities for which a truth has a `bound_` and a `round_off_`, in this order."""


@dataclass(frozen=True, eq=False)
class Truth:
    """A reference motion, and bounds on its own error at each sample (n,).

    bound_rad: orientation. bound_energy, bound_momentum: relative to the scene's largest kinetic energy
    and angular momentum. bound_omega_rad_s (body axes), bound_m and bound_m_s: angular velocity, position and
    velocity, in SI units. round_off_*: eps x sensitivity, in the same units: the error to expect of any
    stepper in double precision. trusted_until_s: the first sample time at which bound_rad exceeds 1e-10 rad,
    or another bound exceeds 1e-10 of its scale; infinite if there is none.

    kind: "exact", in closed form; "certified", solved twice in double-double arithmetic or, with callback
    loads, with halved steps that agree as a high-order method must; "estimated", where halved steps do not
    agree, as for a callback that jumps.
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
        """Why samples beyond trusted_until_s are not compared."""
        if np.isfinite(self.bounds).all():
            return "the motion is chaotic"
        return "motions from nearby initial states diverge without bound, as at a load that is not smooth"

    @property
    def round_offs(self) -> Array:
        """(6, n): one row per quantity, in the order of QUANTITIES."""
        return np.array([getattr(self, f"round_off_{quantity}") for quantity in QUANTITIES])
