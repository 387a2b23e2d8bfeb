"""The loads of a scene for engines: evaluated at the stages of a step, or held constant over it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench, continuous_wrench_of


class StageLoads:
    """The constant loads that act now, the weight, and the continuous loads, users' functions included.

    wrench: the constant loads, which `apply` of a simulation replaces.
    """

    def __init__(self, scene: Scene) -> None:
        self.wrench: Wrench = NO_WRENCH
        self._weight, self._continuous = scene.body.mass * scene.gravity, continuous_wrench_of(scene)

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


class ZeroOrderHold:
    """The continuous loads of one scene, and the clock of one simulation: t = number of steps x dt."""

    def __init__(self, scene: Scene, dt_s: float) -> None:
        self._dt_s, self._steps = dt_s, 0
        self._wrench_at = _wrench_at(scene) if scene.continuous_loads else None

    def __bool__(self) -> bool:
        """Whether the scene has any."""
        return self._wrench_at is not None

    def reset(self) -> None:
        """Go back to t = 0."""
        self._steps = 0

    def next_wrench(self, position: Array, rotation: Array, velocity: Array, omega_world: Array) -> Array:
        """Return force and torque (6,) for the step that begins here, about the centre of mass, world axes.

        The state in world axes, rotation (3, 3) body to world; each call is one step.
        """
        t = self._steps * self._dt_s
        self._steps += 1
        assert self._wrench_at is not None
        return self._wrench_at(t, position, np.ascontiguousarray(rotation), velocity, omega_world)


def _wrench_at(scene: Scene) -> Callable[[float, Array, Array, Array, Array], Array]:
    """Return force and torque (6,) as a function of (t, x, R, v, omega), compiled where no callback acts."""
    if scene.has_callback_load:
        wrench = continuous_wrench_of(scene)
        return lambda *motion: np.concatenate(wrench(*motion))
    # imported here: most scenes have no such load; numba is imported when the kernel is first called
    from bodycheck.reference_impl.continuous_loads import continuous_wrench_at, packed_continuous_loads

    rows = packed_continuous_loads(scene)
    return lambda *motion: continuous_wrench_at(*motion, rows)
