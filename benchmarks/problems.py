"""The motions that are measured: a tumbling body, free or under a single load, and a heavy top."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    Load,
    RigidBody,
    Scene,
    SineTorque,
    State,
    Torque,
)
from bodycheck.reference_impl.truth.certification import certified_truth
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.scenarios.library import load_scenario

_SAMPLES = 101
_TORQUE = (0.3, -0.2, 0.1)

End = tuple[Array, Array]
"""The end of a motion: quaternion (4,) of any norm, body to world, and omega_body (3,), rad/s."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene to be integrated from its start to its end."""

    name: str
    scene: Scene

    @cached_property
    def truth(self) -> Truth:
        """The certified motion in double-doubles, at evenly spaced samples, of which the last is the end.

        This includes free bodies, whose closed form is one of the contenders.
        """
        return certified_truth(self.scene, self.scene.sample_times)

    @cached_property
    def largest_omega(self) -> float:
        """max |omega*| over the samples, rad/s."""
        return float(np.max(np.linalg.norm(self.truth.trajectory.omega_body, axis=-1)))

    def error(self, end: End) -> float:
        """max(angle to the truth in rad, |omega - omega*| / max |omega*|) at the end; infinite if lost."""
        quaternion, omega = end
        if not (np.isfinite(quaternion).all() and np.isfinite(omega).all() and quaternion.any()):
            return math.inf
        true = self.truth.trajectory
        angle = float(geodesic_angle(true.attitude[-1], quaternion))
        return max(angle, float(np.linalg.norm(omega - true.omega_body[-1])) / self.largest_omega)


def tumbling(name: str, *loads: Load, duration_s: float = 10.0) -> Problem:
    """Return I = diag(1, 2, 3) kg m^2 with omega = (0.1, 2, 0.1) rad/s, near the intermediate axis."""
    body = RigidBody(1.0, np.diag([1.0, 2.0, 3.0]))
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 2.0, 0.1]))
    return Problem(name, Scene(body, start, loads, np.zeros(3), duration_s, _SAMPLES))


FREE = tumbling("free")
FREE_LONG = tumbling("free, 1000 s", duration_s=1000.0)
WORLD_TORQUE = tumbling("constant world torque", Torque("world", np.array(_TORQUE)))
BODY_TORQUE = tumbling("constant body torque", Torque("body", np.array(_TORQUE)))
DRAG = tumbling("angular drag", Drag(0.0, 0.1 * np.eye(3)))
BODY_SINE = tumbling("body sine torque", SineTorque("body", np.array(_TORQUE), rate=2.0, phase=0.3))
GRAVITY_GRADIENT = tumbling("gravity gradient", GravityGradient(rate=0.5))
FORCED = BODY_TORQUE, DRAG, BODY_SINE, GRAVITY_GRADIENT, WORLD_TORQUE
HEAVY_TOP = load_scenario("heavy-top").scene
"""An asymmetric body with a fixed point. Energy and angular momentum about the vertical are conserved."""
