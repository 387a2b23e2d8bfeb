"""The Taylor integrator in doubles, packed once for a scene and solved as often as wanted."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.taylor import (
    Solution,
    advance,
    course_of,
    packed_state,
    resolution_for,
)


class PreparedTaylor:
    """The motion of a scene in which nothing switches."""

    def __init__(self, scene: Scene, tolerance: float) -> None:
        ((_, _, self._forcing),) = course_of(scene, scene.duration_s)
        self._start = packed_state(scene.initial)
        self._resolution = resolution_for(tolerance)

    def solve(self, t_s: Array) -> Solution:
        """Return the states at ascending times (n,)."""
        high, low = np.empty((len(t_s), 13)), np.empty((len(t_s), 13))
        state = self._start[0].copy(), self._start[1].copy()
        steps = advance(state, self._forcing, self._resolution, t_s, (0.0, t_s[-1]), (high, low))
        return Solution(high, low, steps)
