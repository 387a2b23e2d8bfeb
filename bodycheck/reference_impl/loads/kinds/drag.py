"""Linear drag on the centre of mass and on the rotation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, Key

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene

_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Drag(ContinuousLoad):
    """F = -linear v, tau = -angular omega.

    linear in N s/m; angular (3, 3) in N m s, body axes.
    """

    kind: ClassVar[str] = "drag"
    couples_translation: ClassVar[bool] = False

    linear: Annotated[float, Key("linear_n_s_m", "not negative", 0.0, seconds=-1)]
    angular: Annotated[Array, Key("angular_n_m_s", "damping matrix", (_ZERO, _ZERO, _ZERO), seconds=-1)]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return the formulas above, in world axes."""
        rotated = at.rotation @ self.angular @ np.swapaxes(at.rotation, -1, -2)
        return -self.linear * at.velocity, -np.asarray((rotated @ at.omega[..., None])[..., 0])

    def about_pivot(self, scene: Scene, pivot: Array) -> Drag:
        """Return the drag of the centre of mass, v = omega x c, as angular drag: c x (omega x c) linear."""
        return Drag(0.0, self.angular + self.linear * parallel_axis_tensor(pivot))
