"""A scene prepared once for the Taylor integrator in doubles, and solved as often as wanted.

Everything that depends on the scene and the tolerance alone is packed when the motion is made: solving it again
is compiled code. Where the motion leaves the range of doubles the states are NaN from there on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.taylor import Course, Resolution, course_of, resolution_for, solve
from bodycheck.reference_impl.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TaylorSolution:
    """What a solve returned: states (n, 13), namely q, omega_body, v, x at t_s (n,), and the steps made."""

    t_s: Array
    states: Array
    steps: int

    @property
    def trajectory(self) -> Trajectory:
        """The same as a trajectory."""
        return Trajectory(
            t_s=self.t_s,
            position_m=self.states[:, 10:13],
            velocity_m_s=self.states[:, 7:10],
            quaternion=self.states[:, 0:4],
            omega_body_rad_s=self.states[:, 4:7],
        )


@dataclass(frozen=True, eq=False)
class TaylorMotion:
    """The motion of a scene, each of whose steps errs by about the tolerance."""

    course: Course
    start: State
    resolution: Resolution

    @classmethod
    def of(cls, scene: Scene, tolerance: float) -> TaylorMotion:
        """Pack a scene. Raises ValueError that names a tolerance outside [1e-17, 1)."""
        return cls(course_of(scene, math.inf), scene.initial, resolution_for(tolerance))

    def solve(self, t_s: Array) -> TaylorSolution:
        """Return the states at ascending times (n,), steps and samples being independent.

        Raises ValueError that names the first time which is negative, not finite or before its predecessor.
        """
        before = 0.0
        for t in t_s:
            if not before <= t < math.inf:
                raise ValueError(f"times are finite, not negative and ascending: {float(t)!r} is not")
            before = t
        if not len(t_s):
            return TaylorSolution(t_s, np.empty((0, 13)), 0)
        until = float(t_s[-1])
        course = tuple((a, min(b, until), forcing) for a, b, forcing in self.course if a <= until)
        solution = solve(course, self.start, t_s, self.resolution)
        return TaylorSolution(t_s, solution.high, solution.steps)
