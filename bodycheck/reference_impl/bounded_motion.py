"""What a truth is: a motion with bounds on how far it may be off. How it is found: see truth.py."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory

Kind: TypeAlias = Literal["exact", "certified", "estimated"]


@dataclass(frozen=True, eq=False)
class Truth:
    """A motion that others are measured with, and how far it may itself be off at each sample (n,).

    bound_rad: orientation. bound_energy, bound_momentum: relative to the scene's largest kinetic energy
    and angular momentum. round_off_rad, round_off_energy, round_off_momentum: eps x sensitivity, what
    any stepper in double precision has to expect. kind: exact, in closed form; certified, solved twice in
    double-double arithmetic, or, where only a function knows a load, with halved steps that agree as a method
    of high order must; estimated, where those do not, as with a function that jumps. trusted_until_s: the
    first of the times at which a chaotic motion's bound_rad exceeds 1e-10 rad; infinite where none does.
    """

    trajectory: Trajectory
    kind: Kind
    bound_rad: Array
    bound_energy: Array
    bound_momentum: Array
    round_off_rad: Array
    round_off_energy: Array
    round_off_momentum: Array
    trusted_until_s: float = math.inf
