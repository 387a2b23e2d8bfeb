"""Prepare a scene once for the Taylor integrator in doubles, and solve it repeatedly.

The constants that depend only on the scene and the tolerance are packed in advance; solving is compiled code.
A scene without springs or a pivot, whose centre of mass moves on a parabola, is integrated along its
principal axes (fast_rotation.py), any other by the general recurrences (taylor_steps.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple, Protocol

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import borrowing_kernel
from bodycheck.reference_impl.rational import added, fractions
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.taylor.fast_rotation import follow, working_space
from bodycheck.reference_impl.taylor.forcing import ACCELERATION_WORLD
from bodycheck.reference_impl.taylor.principal_frame import PrincipalFrame, packed_rotation
from bodycheck.reference_impl.taylor.solution import (
    Forcings,
    SeriesAccuracy,
    follow_scene,
    forcings_of,
    packed_state,
    resolution_for,
    trajectory_of,
)
from bodycheck.reference_impl.taylor.taylor_terms import STATE, V, X
from bodycheck.reference_impl.trajectory import Trajectory


class TaylorSolution(NamedTuple):
    """The states (n, 13), q, omega_body, v, x at t_s (n,), and the number of steps.

    The states are NaN from the time at which the motion leaves the range of doubles.
    """

    t_s: Array
    states: Array
    steps: int

    @property
    def trajectory(self) -> Trajectory:
        """Return the solution as a trajectory."""
        return trajectory_of(self.t_s, self.states)


class _Solver(Protocol):
    def solve(self, t_s: Array) -> tuple[Array, int]:
        """Return the states (n, 13) at ascending times, and the number of steps."""


@dataclass(frozen=True, eq=False)
class TaylorMotion:
    """The motion of a scene. Each step has an error of about the tolerance.

    Not thread-safe: all solves share one workspace.
    """

    _solver: _Solver

    @classmethod
    def of(cls, scene: Scene, tolerance: float) -> TaylorMotion:
        """Pack a scene. Raise ValueError, which names the tolerance, if it is outside [1e-17, 1)."""
        resolution, forcings = resolution_for(tolerance), forcings_of(scene, math.inf)
        simple = scene.pivot is None and all(
            forcing.on_parabola and forcing.springs is None and forcing.torsion is None
            for _, _, forcing in forcings
        )
        return cls(
            _Principal.of(scene, forcings, resolution) if simple else _General(scene, forcings, resolution)
        )

    def solve(self, t_s: Array) -> TaylorSolution:
        """Return the states at ascending times (n,). More times cost only the evaluation of the series.

        Raises ValueError, which names the first time that is negative, not finite or before its predecessor.
        """
        t_s = np.array(t_s, dtype=np.float64)  # the only type that the kernels are compiled for
        out_of_order = _first_out_of_order(t_s)
        if out_of_order < len(t_s):
            t = float(t_s[out_of_order])
            raise ValueError(f"times must be finite, not negative and ascending; {t!r} is not")
        return TaylorSolution(t_s, *self._solver.solve(t_s))


@borrowing_kernel
def _first_out_of_order(t_s: Array) -> int:
    """Return the index of the first time out of order, or the number of times if there is none."""
    before = 0.0
    for i in range(len(t_s)):
        if not before <= t_s[i] < math.inf:
            return i
        before = t_s[i]
    return len(t_s)


@dataclass(frozen=True, eq=False)
class _General:
    """Any scene, by the general recurrences."""

    scene: Scene
    forcings: Forcings
    resolution: SeriesAccuracy

    def solve(self, t_s: Array) -> tuple[Array, int]:
        """Return the states (n, 13) at times in order, and the steps made."""
        until = float(t_s[-1]) if len(t_s) else 0.0
        forcings = tuple(
            (begin, min(end, until), forcing) for begin, end, forcing in self.forcings if begin <= until
        )
        start = packed_state(self.scene.initial)
        solution = follow_scene(self.scene, forcings, start, t_s, self.resolution)
        return solution.high, solution.steps


@dataclass(frozen=True, eq=False)
class _Segment:
    """The rotational forcing between two switches, its workspace, and the centre of mass at the beginning.

    parabola (3, 3): acceleration, v and x.
    """

    begin_s: float
    end_s: float
    body: Array
    loads: Array | None
    series: Array
    parabola: Array


@dataclass(frozen=True, eq=False)
class _Principal:
    """The rotation along the principal axes, and the centre of mass independent of it."""

    start: Array
    segments: tuple[_Segment, ...]
    tolerance: float
    is_moving: bool
    initial_centre: Array
    """v and x at the start, (6,), which stay constant unless is_moving."""

    @classmethod
    def of(cls, scene: Scene, forcings: Forcings, resolution: SeriesAccuracy) -> _Principal:
        """Pack a scene without springs whose centre of mass moves on parabolas."""
        frame = PrincipalFrame.of(scene.body)
        segments = []
        for (begin_s, end_s, _), parabola in zip(forcings, _parabolas(scene.initial, forcings), strict=True):
            body, loads = packed_rotation(scene, frame, begin_s, end_s)
            series = working_space(loads, resolution.order)
            segments.append(_Segment(begin_s, end_s, body, loads, series, parabola))
        is_moving = any(segment.parabola[:2].any() for segment in segments)
        initial_centre = segments[0].parabola[1:].ravel()
        return cls(
            frame.start(scene.initial), tuple(segments), resolution.tolerance, is_moving, initial_centre
        )

    def solve(self, t_s: Array) -> tuple[Array, int]:
        """Return the states (n, 13) at times in order, and the steps made."""
        out, state = np.empty((len(t_s), STATE)), self.start.copy()
        out[:, V:] = self.initial_centre
        until = float(t_s[-1]) if len(t_s) else 0.0
        due = steps = 0
        for segment in self.segments:
            first, begin, end = due, segment.begin_s, min(segment.end_s, until)
            due, made = follow(
                state, segment.series, segment.body, segment.loads, t_s, due, begin, end, self.tolerance, out
            )
            steps += made
            if self.is_moving:
                (a, v, x), t = segment.parabola, t_s[first:due, None] - begin
                out[first:due, V:X], out[first:due, X:] = v + t * a, x + t * (v + 0.5 * t * a)
            if end == until:
                break
        return out, steps


def _parabolas(start: State, forcings: Forcings) -> list[Array]:
    """(3, 3) for each of the forcings: a, v and x at its start, in rational arithmetic, rounded once."""
    v, x = fractions(start.velocity), fractions(start.position)
    found = []
    for begin_s, end_s, forcing in forcings:
        world_rows = slice(ACCELERATION_WORLD, ACCELERATION_WORLD + 3)
        a = added(*(fractions(part[world_rows]) for part in forcing.translational))
        found.append(np.array([a, v, x], dtype=np.float64))
        if end_s < math.inf:
            t = Fraction(end_s) - Fraction(begin_s)
            x = [p + t * (q + t * r / 2) for p, q, r in zip(x, v, a, strict=True)]
            v = [q + t * r for q, r in zip(v, a, strict=True)]
    return found
