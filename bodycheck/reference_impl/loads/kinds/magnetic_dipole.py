"""A magnetic dipole fixed in the body, in a uniform field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, Key

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene
    from bodycheck.reference_impl.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class MagneticDipole(ContinuousLoad):
    """tau = (R moment) x field, F = 0, U = -(R moment) . field.

    moment (3,) in A m^2, body axes; field (3,) in T, world axes. Source: Jackson (1999), Classical
    Electrodynamics, equations 5.71 and 5.72.
    """

    kind: ClassVar[str] = "magnetic-dipole"
    potential_needs: ClassVar[frozenset[str]] = frozenset({"attitude"})
    depends_on_velocity: ClassVar[bool] = False
    couples_translation: ClassVar[bool] = False

    moment: Annotated[Array, Key("moment_a_m2", "vector", seconds=0)]
    field: Annotated[Array, Key("field_t", "vector", seconds=-2)]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return zero force, and the torque above."""
        return np.zeros_like(at.omega), np.cross(at.rotated(self.moment), self.field)

    def potential(self, scene: Scene, motion: Trajectory) -> Array:
        """Return U (n,) in J, zero if the dipole is perpendicular to the field."""
        return np.asarray(-(motion.rotation_matrices @ self.moment) @ self.field)
