"""A spring between a point of the world and a point of the body."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, Key
from bodycheck.reference_impl.rotations import quaternion_to_matrix

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene
    from bodycheck.reference_impl.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Spring(ContinuousLoad):
    """F = -stiffness (|d| - rest_length) d / |d|, d = x + R at - anchor, at a body-fixed point; F(0) = 0.

    anchor (3,) in world axes, m; at (3,) from the centre of mass in body axes, m; stiffness in N/m,
    rest_length in m. U = stiffness (|d| - rest_length)^2 / 2.
    """

    kind: ClassVar[str] = "spring"
    potential_needs: ClassVar[frozenset[str]] = frozenset({"position", "attitude"})
    depends_on_velocity: ClassVar[bool] = False

    anchor: Annotated[Array, Key("anchor_m", "vector", seconds=0)]
    at: Annotated[Array, Key("at_m", "vector", (0.0, 0.0, 0.0), seconds=0)]
    stiffness: Annotated[float, Key("stiffness_n_m", "positive", seconds=-2)]
    rest_length: Annotated[float, Key("rest_length_m", "not negative", 0.0, seconds=0)]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return the force above, and its moment."""
        arm = at.rotated(self.at)
        stretch = at.position + arm - self.anchor
        length = np.linalg.norm(stretch, axis=-1, keepdims=True)
        shortfall = np.divide(self.rest_length, length, out=np.ones_like(length), where=length > 0.0)
        force = -self.stiffness * (1.0 - shortfall) * stretch
        return force, np.cross(arm, force)

    def potential(self, scene: Scene, motion: Trajectory) -> Array:
        """Return U (n,) in J, zero if the spring is relaxed."""
        arm = quaternion_to_matrix(motion.attitude) @ self.at
        length = np.linalg.norm(motion.position_m + arm - self.anchor, axis=-1)
        return np.asarray(0.5 * self.stiffness * (length - self.rest_length) ** 2)

    def about_pivot(self, scene: Scene, pivot: Array) -> Spring:
        """Return the spring with its point relative to the pivot."""
        return replace(self, at=self.at - pivot)
