"""A torque that varies sinusoidally with time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Axes, ContinuousLoad, Instants, Key

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene


@dataclass(frozen=True, eq=False)
class SineTorque(ContinuousLoad):
    """tau = amplitude sin(rate t + phase), in the body's or the world's axes.

    amplitude (3,) in N m, rate in rad/s, phase in rad.
    """

    kind: ClassVar[str] = "sine-torque"
    depends_on_velocity: ClassVar[bool] = False
    couples_translation: ClassVar[bool] = False

    axes: Annotated[Axes, Key("axes", "axes")]
    amplitude: Annotated[Array, Key("amplitude_n_m", "vector", seconds=-2)]
    rate: Annotated[float, Key("rate_rad_s", "number", seconds=-1)]
    phase: Annotated[float, Key("phase_rad", "number", 0.0, seconds=0)]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return zero force, and the torque above."""
        swing = np.sin(self.rate * at.t[..., None] + self.phase)
        return np.zeros_like(at.omega), swing * at.in_world(self.axes, self.amplitude)

    def about_pivot(self, scene: Scene, pivot: Array) -> SineTorque:
        """Return the load unchanged: a torque is the same about any point."""
        return self
