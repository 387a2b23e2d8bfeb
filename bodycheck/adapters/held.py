"""Lasting loads for engines that take forces between steps only: evaluated at a step's start, then held."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene


class HeldLoads:
    """The lasting loads of one scene, and the clock of one simulation: t = steps made x dt."""

    def __init__(self, scene: Scene, dt_s: float) -> None:
        self._any, self._dt_s, self._steps = bool(scene.lasting_loads), dt_s, 0
        if self._any:
            # late: numba is half the start of a worker, and most scenes have no such load
            from bodycheck.reference_impl.lasting import lasting_wrench_at, packed_lasting

            self._rows, self._wrench_at = packed_lasting(scene), lasting_wrench_at

    def __bool__(self) -> bool:
        """Tell whether the scene has any."""
        return self._any

    def reset(self) -> None:
        """Go back to t = 0."""
        self._steps = 0

    def next_step(self, position: Array, rotation: Array, velocity: Array, omega_world: Array) -> Array:
        """Return force and torque (6,) for the step that begins here, about the centre of mass, world axes.

        The state in world axes, rotation (3, 3) body to world; each call is one step.
        """
        t = self._steps * self._dt_s
        self._steps += 1
        turned = np.ascontiguousarray(rotation)
        held: Array = self._wrench_at(t, position, turned, velocity, omega_world, self._rows)
        return held
