"""A torsion spring that rotates the body back to its initial attitude by the shortest rotation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, Key
from bodycheck.reference_impl.rotations import conjugate, log_matrix, log_quaternion, quaternion_product

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene
    from bodycheck.reference_impl.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TorsionSpring(ContinuousLoad):
    """tau = -stiffness x the rotation vector of R R(0)^T, for angles below pi; U = stiffness angle^2 / 2.

    stiffness in N m.
    """

    kind: ClassVar[str] = "torsion-spring"
    potential_needs: ClassVar[frozenset[str]] = frozenset({"attitude"})
    depends_on_velocity: ClassVar[bool] = False
    couples_translation: ClassVar[bool] = False

    stiffness: Annotated[float, Key("stiffness_n_m", "positive", seconds=-2)]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return zero force, and the torque above."""
        rotated = at.rotation @ scene.initial.rotation.T
        return np.zeros_like(at.omega), -self.stiffness * log_matrix(rotated)

    def potential(self, scene: Scene, motion: Trajectory) -> Array:
        """Return U (n,) in J, zero at the start."""
        rotated = quaternion_product(conjugate(scene.initial.quaternion), motion.attitude)
        angle = np.linalg.norm(log_quaternion(rotated), axis=-1)
        return np.asarray(0.5 * self.stiffness * angle**2)

    def about_pivot(self, scene: Scene, pivot: Array) -> TorsionSpring:
        """Return the load unchanged: a torque is the same about any point."""
        return self
