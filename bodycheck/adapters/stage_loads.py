"""All loads of a scene at any state, for engines that evaluate them at the stages of a step."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads_at import lasting_wrench_of
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench


class StageLoads:
    """The constant loads that act now, the weight, and the continuous loads, users' functions included.

    wrench: the constant loads, which `apply` of a simulation replaces.
    """

    def __init__(self, scene: Scene) -> None:
        self.wrench: Wrench = NO_WRENCH
        self._weight, self._continuous = scene.body.mass * scene.gravity, lasting_wrench_of(scene)

    def at(
        self, t_s: float, position: Array, rotation: Array, velocity: Array, omega_world: Array
    ) -> tuple[Array, Array]:
        """Return force (3,) in world axes, N, with the weight, and torque (3,) in body axes, N m.

        The torque is about the centre of mass. The state may be that of any stage: position and velocity of
        the centre of mass and omega (3,) in world axes, rotation (3, 3) body to world.
        """
        wrench = self.wrench
        force = wrench.force_world + rotation @ wrench.force_body + self._weight
        torque = wrench.torque_body + rotation.T @ wrench.torque_world
        for point, push in wrench.point_forces:
            force, torque = force + push, torque + np.cross(point, rotation.T @ push)
        more_force, more_torque = self._continuous(t_s, position, rotation, velocity, omega_world)
        return force + more_force, torque + rotation.T @ more_torque
