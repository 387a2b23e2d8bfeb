"""Lasting loads for engines that take forces between steps only: evaluated at a step's start, then held."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.lasting import lasting_wrench_at, packed_lasting
from bodycheck.reference_impl.scene import Scene


class HeldLoads:
    """The lasting loads of one scene, and the clock of one simulation: t = steps made x dt."""

    def __init__(self, scene: Scene, dt_s: float) -> None:
        self._rows, self._dt_s, self._steps = packed_lasting(scene), dt_s, 0

    def __bool__(self) -> bool:
        """Tell whether the scene has any."""
        return bool(len(self._rows))

    def reset(self) -> None:
        """Go back to t = 0."""
        self._steps = 0

    def next_step(self, position: Array, rotation: Array, velocity: Array, omega_world: Array) -> Array:
        """Return force and torque (6,) for the step that begins here, about the centre of mass, world axes.

        The state in world axes, rotation (3, 3) body to world; each call is one step.
        """
        t = self._steps * self._dt_s
        self._steps += 1
        return lasting_wrench_at(
            t, position, np.ascontiguousarray(rotation), velocity, omega_world, self._rows
        )
