"""The torque of a central field on a satellite in a circular orbit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, NoReturn

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, Key

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene


@dataclass(frozen=True, eq=False)
class GravityGradient(ContinuousLoad):
    """tau = 3 n^2 u x (I u) in world axes, u(t) = (-sin n t, 0, -cos n t).

    rate: n of the circular orbit, rad/s.
    """

    kind: ClassVar[str] = "gravity-gradient"
    depends_on_velocity: ClassVar[bool] = False
    couples_translation: ClassVar[bool] = False

    rate: Annotated[float, Key("orbit_rate_rad_s", "positive", seconds=-1)]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return zero force, and the torque above."""
        angle = self.rate * at.t[..., None]
        u = np.concatenate([-np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
        inertia = at.rotation @ scene.body.inertia @ np.swapaxes(at.rotation, -1, -2)
        inertial = (inertia @ u[..., None])[..., 0]
        return np.zeros_like(at.omega), 3.0 * self.rate**2 * np.cross(u, np.asarray(inertial))

    def about_pivot(self, scene: Scene, pivot: Array) -> NoReturn:
        """Raise ValueError: the formula holds about the centre of mass only."""
        raise ValueError("a gravity gradient is defined about the centre of mass, not about a pivot")
