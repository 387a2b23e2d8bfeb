"""A force at a point of the body, within an interval of time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Axes, Instants, Key, Load

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene


@dataclass(frozen=True, eq=False)
class PointForce(Load):
    """A force (3,) in N, constant in its axes within [from_s, until_s), at a body-fixed point.

    at (3,) in m: the point, from the centre of mass, in body axes.
    """

    kind: ClassVar[str] = "force"

    axes: Annotated[Axes, Key("axes", "axes")]
    value: Annotated[Array, Key("value_n", "vector", seconds=-2)]
    at: Annotated[Array, Key("at_m", "vector", (0.0, 0.0, 0.0), seconds=0)]
    from_s: Annotated[float, Key("from_s", "number", 0.0, seconds=1)] = 0.0
    until_s: Annotated[float, Key("until_s", "number", math.inf, seconds=1)] = math.inf

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return force and torque within the interval."""
        force = at.in_world(self.axes, self.value)
        return force, np.cross(at.rotated(self.at), force)

    def about_pivot(self, scene: Scene, pivot: Array) -> PointForce:
        """Return the force with its point relative to the pivot."""
        return replace(self, at=self.at - pivot)
