"""The exact motion of a body that nothing turns: Euler's free rotation on a parabola."""

from __future__ import annotations

from dataclasses import dataclass

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class ExactMotion:
    """x = x0 + v0 t + g t^2 / 2, v = v0 + g t, and the free rotation in closed form."""

    scene: Scene
    rotation: FreeRotation

    @classmethod
    def of(cls, scene: Scene) -> ExactMotion:
        """Set up once for a scene without loads.

        Raises ValueError where a load acts: there is no closed form then.
        """
        if not scene.is_free_rotation:
            raise ValueError("a closed form needs a scene without torques and forces, gravity apart")
        initial = scene.initial
        return cls(scene, FreeRotation.from_state(scene.body.inertia, initial.quaternion, initial.omega_body))

    def at(self, t_s: Array) -> Trajectory:
        """Return the motion at any times (n,), each at the same cost."""
        quaternion, omega_body = self.rotation.at(t_s)
        initial, gravity, t = self.scene.initial, self.scene.gravity, t_s[:, None]
        return Trajectory(
            t_s=t_s,
            position_m=initial.position + t * (initial.velocity + 0.5 * t * gravity),
            velocity_m_s=initial.velocity + t * gravity,
            quaternion=quaternion,
            omega_body_rad_s=omega_body,
        )
