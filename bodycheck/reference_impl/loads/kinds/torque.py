"""A torque within an interval of time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Axes, Instants, Key, Load

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene


@dataclass(frozen=True, eq=False)
class Torque(Load):
    """A torque (3,) in N m, constant in the body's or the world's axes, within [from_s, until_s)."""

    kind: ClassVar[str] = "torque"

    axes: Annotated[Axes, Key("axes", "axes")]
    value: Annotated[Array, Key("value_n_m", "vector", seconds=-2)]
    from_s: Annotated[float, Key("from_s", "number", 0.0, seconds=1)] = 0.0
    until_s: Annotated[float, Key("until_s", "number", math.inf, seconds=1)] = math.inf

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return zero force and the torque within the interval."""
        return np.zeros_like(at.omega), at.in_world(self.axes, self.value)

    def about_pivot(self, scene: Scene, pivot: Array) -> Torque:
        """Return the load unchanged: a torque is the same about any point."""
        return self
