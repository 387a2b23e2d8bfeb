"""What a one-step map is: a name, its formula, its source, and a function of arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps.motion import Loads, Motion, Solid

Attitude: TypeAlias = Literal["group", "quaternion", "unit quaternion", "matrix", "projected matrix"]
"""How a step changes the attitude: by rotations, or by adding to a quaternion or a matrix, which is then kept
as it is, or normalised or projected onto SO(3)."""

Step: TypeAlias = Callable[[Solid, Motion, Array, Loads], Motion]
"""step(solid, motion, dt, loads) -> the states dt () or (n,) seconds later."""


@dataclass(frozen=True, eq=False)
class OneStepMap:
    """One integration step of a rigid body.

    description: its formula. order: of the error of a torque-free motion, 0 where a term is missing. aliases:
    other names of the same map. reversible: whether a step back from the reversed state returns to the start.
    stages: whether loads are evaluated more than once per step, so that holding them constant is another map.
    """

    name: str
    description: str
    source: str
    order: int
    step: Step
    attitude: Attitude = "group"
    aliases: tuple[str, ...] = ()
    reversible: bool = False
    stages: bool = False
