"""What an engine makes of a scene, with the terms that a fault can change; healthy as it stands.

Components come first: a vector of all candidates and transitions is (3, c, s), a quaternion (4, c, s).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reference_impl.integrators.facts import Tableau
from bodycheck.reference_impl.rotations import vee
from bodycheck.reference_impl.scene import PointForce, Scene
from bodycheck.reference_impl.wrench import plan_steps, shares_of_loads

ClampAxes: TypeAlias = Literal["body", "world", "norm"]
Indices: TypeAlias = NDArray[np.intp]


def cross(a: Array, b: Array) -> Array:
    """a x b, components first: (3, ...)."""
    made = np.empty(np.broadcast_shapes(a.shape, b.shape))
    made[0] = a[1] * b[2] - a[2] * b[1]
    made[1] = a[2] * b[0] - a[0] * b[2]
    made[2] = a[0] * b[1] - a[1] * b[0]
    return made


def times(matrix: Array, vector: Array) -> Array:
    """M v, components first: (3, 3, ...) and (3, ...)."""
    return np.einsum("ij...,j...->i...", matrix, vector)


def transposed_times(matrix: Array, vector: Array) -> Array:
    """M^T v, components first."""
    return np.einsum("ji...,j...->i...", matrix, vector)


def product(p: Array, q: Array) -> Array:
    """p q, scalar first, components first: (4, ...)."""
    made = np.empty(np.broadcast_shapes(p.shape, q.shape))
    made[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    made[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    made[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    made[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]
    return made


def conjugated(q: Array) -> Array:
    """q*, components first."""
    return np.concatenate([q[:1], -q[1:]])


def exponential(v: Array) -> Array:
    """exp(v / 2) of rotation vectors (3, ...)."""
    half = 0.5 * np.sqrt((v * v).sum(axis=0))
    return np.concatenate([np.cos(half)[None], (0.5 * np.sinc(half / np.pi)) * v])


def matrix_of(q: Array) -> Array:
    """R (3, 3, ...) of quaternions (4, ...) of any norm."""
    w, x, y, z = q / np.sqrt((q * q).sum(axis=0))
    made = np.empty((3, 3, *q.shape[1:]))
    made[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    made[0, 1] = 2.0 * (x * y - w * z)
    made[0, 2] = 2.0 * (x * z + w * y)
    made[1, 0] = 2.0 * (x * y + w * z)
    made[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    made[1, 2] = 2.0 * (y * z - w * x)
    made[2, 0] = 2.0 * (x * z - w * y)
    made[2, 1] = 2.0 * (y * z + w * x)
    made[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return made


def rotation_vector(q: Array) -> Array:
    """log: the rotation vectors (3, ...) of unit quaternions (4, ...), of at most pi."""
    sine = np.sqrt((q[1:] * q[1:]).sum(axis=0))
    half = np.arctan2(sine, np.abs(q[0]))
    factor = np.where(sine > 0.0, 2.0 * half / np.where(sine > 0.0, sine, 1.0), 2.0)
    return factor * np.where(q[0] < 0.0, -1.0, 1.0) * q[1:]


@dataclass(frozen=True, eq=False)
class Loads:
    """The constant loads of each segment (p, ...) between switches; the last row is the absence of loads.

    force_body, force_world: (p, 3) in N. torque_body, torque_world: (p, 3) in N m. lever, moment: (p, 3, 3),
    sums of a F^T of body and of world forces at points a in body axes.
    """

    force_body: Array
    force_world: Array
    torque_body: Array
    torque_world: Array
    lever: Array
    moment: Array

    @classmethod
    def of(cls, spans: Sequence[Sequence[tuple[Any, float]]]) -> Loads:
        """Sum the loads of each segment, each multiplied by its share of the time."""
        p = len(spans) + 1
        a, b, c, d = np.zeros((4, p, 3))
        loads = cls(a, b, c, d, *np.zeros((2, p, 3, 3)))
        for row, span in enumerate(spans):
            for load, share in span:
                value = share * load.value
                if isinstance(load, PointForce) and load.axes == "body":
                    loads.force_body[row] += value
                    loads.lever[row] += np.outer(load.at, value)
                elif isinstance(load, PointForce):
                    loads.force_world[row] += value
                    loads.moment[row] += np.outer(load.at, value)
                else:
                    (loads.torque_body if load.axes == "body" else loads.torque_world)[row] += value
        return loads

    @property
    def kinds(self) -> frozenset[str]:
        """The names of the parts that act at some time."""
        acting = vars(self) | {"lever": self.lever_torque}
        return frozenset(name for name, value in acting.items() if np.any(value))

    @property
    def lever_torque(self) -> Array:
        """The moments (p, 3) of body forces in body axes: sums of a x F."""
        return -2.0 * vee(self.lever)


@dataclass
class ReportedStates:
    """States as an engine reports them: x, v, w (3, s), q (4, s); w in its own axes."""

    x: Array
    v: Array
    q: Array
    w: Array


@dataclass(frozen=True)
class Misreading:
    """A wrong reading: what becomes of a right one, and how it is undone."""

    apply: Callable[[ReportedStates], ReportedStates]
    undo: Callable[[ReportedStates], ReportedStates]


@dataclass
class Model:
    """One candidate: the constants of its motion. A fault assigns new values and changes none in place.

    timeline: (steps,) the row of `loads` that acts in each step. arm_in_world: 1 where the arms of world
    forces are taken in world axes, 2 where they keep their initial direction. body_arm_in_world: 1 where the
    arms of body forces are taken in world axes. held_loads: 1 where the force in world axes and the torque in
    body axes keep, throughout a step, the components that they have at its start.
    total_force_by, total_torque_by: 1 where the sum in its axes is rotated by R, 2 where it is rotated by
    R^T, 0 where it is right. attitude_step: the place in ATTITUDE_STEPS, from 1, of how a Runge-Kutta method
    advances q instead. stale: the quantities of x, v, q, w that are read `lateness` steps late. largest_turn,
    asleep: 0 where there is no such limit. clamped_first: whether limits of velocities apply before the pose
    is updated. slowed_v, slowed_w: rates by which velocities are damped after the kick, or after the step
    where slowed_late. turn_factor: of the omega that turns the attitude. tableau: in place of that of RK4.
    force_body_by and so on: 1 where a vector is rotated by the transpose, 2 where it is rotated twice, 0
    where it is right.
    """

    mass: float
    inertia: Array
    gravity: Array
    loads: Loads
    timeline: Indices
    initial_rotation: Array
    gravity_body: Array = field(default_factory=lambda: np.zeros(3))
    gyro: float = 1.0
    continuous: float = 1.0
    damping_v: float = 0.0
    damping_w: float = 0.0
    damping_torque: float = 0.0
    slowed_v: float = 0.0
    slowed_w: float = 0.0
    slowed_late: bool = False
    damping_v_speed: float = 0.0
    damping_w_speed: float = 0.0
    spurious_force_world: Array = field(default_factory=lambda: np.zeros(3))
    spurious_torque_world: Array = field(default_factory=lambda: np.zeros(3))
    spurious_torque_body: Array = field(default_factory=lambda: np.zeros(3))
    spurious_force_body: Array = field(default_factory=lambda: np.zeros(3))
    clamp_v: tuple[ClampAxes, float] | None = None
    clamp_w: tuple[ClampAxes, float] | None = None
    clamped_first: bool = True
    largest_turn: float = 0.0
    energy_pull: float = 0.0
    body_velocity: float = 0.0
    world_turn: float = 0.0
    old_velocity: float = 0.0
    inertia_in_world: float = 0.0
    asleep: float = 0.0
    single_stage: float = 0.0
    single_state: float = 0.0
    ramp: float = 0.0
    held_loads: float = 0.0
    total_force_by: float = 0.0
    total_torque_by: float = 0.0
    attitude_step: float = 0.0
    arm_in_world: float = 0.0
    body_arm_in_world: float = 0.0
    step_factor: float = 1.0
    repeats: float = 0.0
    force_body_by: float = 0.0
    force_world_by: float = 0.0
    torque_body_by: float = 0.0
    torque_world_by: float = 0.0
    moment_by: float = 0.0
    turn_factor: float = 1.0
    tableau: Tableau | None = None
    stale: frozenset[str] = frozenset()
    lateness: float = 1.0
    start: Callable[[Array], Array] | None = None
    misreadings: tuple[Misreading, ...] = ()
    pivot: Array | None = None

    def copied(self) -> Model:
        """Return a copy whose fields can be assigned."""
        return copy.copy(self)

    @property
    def turning_inertia(self) -> Array:
        """I about the centre of mass, or about the pivot."""
        if self.pivot is None:
            return self.inertia
        return self.inertia + self.mass * parallel_axis_tensor(self.pivot)

    def packed_loads(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return the accelerations of forces in body and world axes, the torques, and the moments, (p, ...).

        The last are those of world forces, and of body forces whose arms are taken in world axes.

        About a pivot, which carries all forces, these have moments only.
        """
        loads, weight = self.loads, self.mass * self.gravity
        body_weight = self.mass * self.gravity_body
        torque = loads.torque_body + self.spurious_torque_body
        moment, lever = loads.moment, self.body_arm_in_world * loads.lever
        if not self.body_arm_in_world:
            torque = torque + loads.lever_torque
        force_body = loads.force_body + body_weight + self.spurious_force_body
        force_world = loads.force_world + weight + self.spurious_force_world
        if self.pivot is not None:
            arm = -self.pivot
            torque = torque + np.cross(arm, force_body)
            moment = moment + arm[:, None] * force_world[:, None, :]
            force_body, force_world = 0.0 * force_body, 0.0 * force_world
        torque_world = loads.torque_world + self.spurious_torque_world
        if self.arm_in_world:
            turn = self.initial_rotation if self.arm_in_world > 1.0 else np.eye(3)
            turned = np.einsum("ij,pjk->pik", turn, moment)
            torque_world = torque_world - 2.0 * vee(turned)
            moment = 0.0 * moment
        return force_body / self.mass, force_world / self.mass, torque, torque_world, moment, lever


@dataclass(frozen=True, eq=False)
class Grid:
    """The steps between samples: their number in one sample interval, their length, and the segments.

    dt_s: (s_all,) the step in each sample interval. timeline: (samples - 1, stride) segment of each step.
    """

    stride: int
    dt_s: Array
    loads: Loads
    timeline: Indices

    @classmethod
    def of(cls, scene: Scene, dt_s: float) -> Grid:
        """Return the grid of a method with a fixed step."""
        plan = plan_steps(scene, dt_s)
        step = plan.dt_s
        spans: list[list[tuple[Any, float]]] = []
        rows, done = np.empty(plan.steps, dtype=np.intp), 0
        for length, _ in plan.segments:
            rows[done : done + length] = len(spans)
            spans.append(shares_of_loads(scene, done * step, (done + length) * step))
            done += length
        dts = np.full(scene.samples - 1, step)
        return cls(plan.stride, dts, Loads.of(spans), rows.reshape(scene.samples - 1, plan.stride))

    @classmethod
    def between(cls, scene: Scene, t_s: Array, stride: int) -> Grid:
        """Return a grid of `stride` steps between any two consecutive times t_s (n,)."""
        gaps = np.diff(t_s)
        dts = gaps / stride
        if not scene.switches_before(float(t_s[-1])):
            acting = shares_of_loads(scene, float(t_s[0]), float(t_s[-1]))
            return cls(stride, dts, Loads.of([acting]), np.zeros((len(gaps), stride), dtype=np.intp))
        spans: list[Any] = []
        known: dict[tuple[Any, ...], int] = {}
        rows = np.empty((len(gaps), stride), dtype=np.intp)
        for k, start in enumerate(t_s[:-1]):
            for i in range(stride):
                span = shares_of_loads(scene, start + i * dts[k], start + (i + 1) * dts[k])
                key = tuple((id(load), share) for load, share in span)
                if key not in known:
                    known[key] = len(spans)
                    spans.append(span)
                rows[k, i] = known[key]
        return cls(stride, dts, Loads.of(spans), rows)

    def model(self, scene: Scene) -> Model:
        """Return the healthy model of a scene."""
        return Model(
            mass=scene.body.mass,
            inertia=scene.body.inertia,
            gravity=scene.gravity,
            loads=self.loads,
            timeline=self.timeline.ravel(),
            initial_rotation=scene.initial.rotation,
            pivot=scene.pivot,
        )
