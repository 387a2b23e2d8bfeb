"""Solve a scene with callback loads by halving the step until two motions agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.callback_motion import solve_with_callback
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.scene import ConstantLoad, RigidBody, Scene, State, WrenchFunction
from bodycheck.reference_impl.taylor.forcing import pivot_position
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth.motion_distance import distances, scales
from bodycheck.reference_impl.wrench import constant_loads_between, sum_of_wrenches

_MIN_STEPS, _MAX_STEPS = 64, 2**13  # steps
_CONVERGED = 1e-14  # rad, or relative: finer steps would only accumulate round-off
_SHRINKS = 16.0  # least factor per halving; order 8 gives 256
_ROUND_OFF = 1e-11  # a gap below this that no longer shrinks is round-off


@dataclass(frozen=True, eq=False)
class Halved:
    """The finest motion, and its distance from the motion with steps of twice the length.

    gaps (6, n): as `distances`. converged: whether the gaps shrank as those of a high-order method do, down
    to round-off or up to the last halving. steps: number of steps of the finest motion.
    """

    motion: Trajectory
    gaps: Array
    converged: bool
    steps: int


def solve_by_halving(scene: Scene, t_s: Array) -> Halved:
    """Halve the step until two motions agree to round-off; t_s (n,) ascending, in s.

    Raises ValueError as solve_with_callback does.
    """
    until = float(t_s[-1]) if len(t_s) and t_s[-1] > 0.0 else 1.0
    steps, before = _MIN_STEPS, math.inf
    coarse = solve_with_steps(scene, scene.initial, t_s, until / steps)
    while True:
        steps *= 2
        fine = solve_with_steps(scene, scene.initial, t_s, until / steps)
        gaps = distances(scene, fine, coarse)
        gap = float(np.max(gaps / scales(scene, fine), initial=0.0))
        shrank = gap * _SHRINKS <= before < math.inf
        at_round_off = gap <= _CONVERGED or (gap <= _ROUND_OFF and not shrank)
        if at_round_off or steps >= _MAX_STEPS:
            return Halved(fine, gaps, at_round_off or shrank, steps)
        coarse, before = fine, gap


def solve_with_steps(scene: Scene, start: State, t_s: Array, dt_s: float) -> Trajectory:
    """Solve from a start, switch by switch, with steps of at most dt_s; t_s (n,) ascending, in s.

    Raises ValueError as solve_with_callback does.
    """
    times, places = np.unique(t_s, return_inverse=True)
    end = float(times[-1]) if len(times) else 0.0
    edges = list(dict.fromkeys([0.0, *scene.switches_before(end), end]))
    found, state = [packed(start)[None]], start
    for begin, until in pairwise(edges):
        inside = times[(times > begin) & (times <= until)]
        grid = np.unique([begin, *inside, until])
        solved = _solved(scene, constant_loads_between(scene, begin, until), state, grid, dt_s)
        found.append(solved[np.isin(grid, inside)])
        state = State(*np.split(solved[-1], [3, 7, 10]))
    states = np.concatenate(found)[1 if len(times) and times[0] > 0.0 else 0 :][places]
    position, quaternion, velocity, omega_body = np.split(states, [3, 7, 10], axis=1)
    return Trajectory(
        t_s=t_s,
        position_m=position,
        velocity_m_s=velocity,
        quaternion=quaternion,
        omega_body_rad_s=omega_body,
    )


def packed(state: State) -> Array:
    """Return position, quaternion, velocity and omega in the order of State: (13,)."""
    return np.concatenate([state.position, state.quaternion, state.velocity, state.omega_body])


def _solved(
    scene: Scene, constant_loads: Sequence[ConstantLoad], start: State, t_s: Array, dt_s: float
) -> Array:
    """Return the states (n, 13) under these loads and the continuous ones."""
    wrench = sum_of_wrenches([*constant_loads, *scene.continuous_loads], scene)
    if scene.pivot is None:
        motion = solve_with_callback(scene.body, start, wrench, t_s, dt_s)
        position, velocity = motion.position_m, motion.velocity_m_s
    else:
        place = PivotPlace.of(scene)
        body = RigidBody(scene.body.mass, rotational_inertia(scene))
        motion = solve_with_callback(body, start, place.about_pivot(wrench), t_s, dt_s)
        position, velocity = place.centre(motion.rotation_matrices, motion.omega_world)
    return np.hstack([position, motion.attitude, velocity, motion.omega_body])


@dataclass(frozen=True, eq=False)
class PivotPlace:
    """The pivot's fixed position in the body (3,) and in the world (3,), m."""

    in_body: Array
    in_world: Array

    @classmethod
    def of(cls, scene: Scene) -> PivotPlace:
        """Derive the pivot's positions from the initial state."""
        assert scene.pivot is not None
        return cls(scene.pivot, np.array(pivot_position(scene), dtype=np.float64))

    def centre(self, rotation: Array, omega_world: Array) -> tuple[Array, Array]:
        """x = p - R r, v = -omega x R r: position and velocity (..., 3) of the centre of mass.

        p and r are the pivot in world and body axes; rotation (..., 3, 3), omega_world (..., 3) in rad/s.
        """
        arm = -(rotation @ self.in_body)
        return self.in_world + arm, np.cross(omega_world, arm)

    def about_pivot(self, wrench: WrenchFunction) -> WrenchFunction:
        """Return the wrench of the same loads about the pivot, which supports every force."""

        def pivot_wrench(t: float, _: Array, rotation: Array, __: Array, omega: Array) -> tuple[Array, Array]:
            position, velocity = self.centre(rotation, omega)
            force, torque = wrench(t, position, rotation, velocity, omega)
            return np.zeros(3), torque + np.cross(position - self.in_world, force)

        return pivot_wrench
