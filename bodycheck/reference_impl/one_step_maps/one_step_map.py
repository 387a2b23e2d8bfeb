"""What a one-step map is: a name, its formula, its source, and a function of arrays.

The arrays are of n bodies or states at once; loads act on them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Instants
from bodycheck.reference_impl.rotations import (
    cross,
    exp_quaternion,
    project_to_so3,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import RigidBody, Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import wrench_at, wrench_between


@dataclass(frozen=True, eq=False)
class Solid:
    """mass () or (n,) in kg; inertia (3, 3) or (n, 3, 3) in kg m^2 about the centre of mass, body axes."""

    mass: Array
    inertia: Array

    @classmethod
    def of(cls, body: RigidBody) -> Solid:
        """Return the arrays of a body."""
        return cls(np.asarray(body.mass), body.inertia)

    @cached_property
    def inverse(self) -> Array:
        """I^-1, of the shape of the inertia."""
        return np.asarray(np.linalg.inv(self.inertia))

    @cached_property
    def principal(self) -> tuple[Array, Array]:
        """Moments (..., 3), ascending, and the principal axes as the columns of (..., 3, 3)."""
        moments, axes = np.linalg.eigh(self.inertia)
        return moments, axes


@dataclass(frozen=True, eq=False)
class Motion:
    """n states, each at its own time t (n,) in s.

    position and velocity (n, 3) of the centre of mass in world axes; quaternion (n, 4), body to world, of any
    norm; omega (n, 3) in body axes, rad/s. rotation (n, 3, 3): the matrix of an engine that holds one, which
    need not be orthogonal; None where the attitude is the quaternion.
    """

    t: Array
    position: Array
    velocity: Array
    quaternion: Array
    omega: Array
    rotation: Array | None = None

    @classmethod
    def of(cls, path: Trajectory) -> Motion:
        """Return the states of a trajectory, with its matrices where it has no quaternions."""
        matrices = path.rotation if path.quaternion is None else None
        return cls(
            path.t_s, path.position_m, path.velocity_m_s, path.attitude, path.omega_body, rotation=matrices
        )

    @cached_property
    def orthogonal(self) -> Array:
        """R (n, 3, 3), proper and orthogonal: of q / |q|, or the polar factor of the matrix."""
        if self.rotation is not None:
            return project_to_so3(self.rotation)
        return quaternion_to_matrix(self.quaternion)

    @property
    def matrix(self) -> Array:
        """R (n, 3, 3) as the engine holds it, which need not be orthogonal; otherwise that of q / |q|."""
        return self.orthogonal if self.rotation is None else self.rotation

    def part(self, rows: slice | NDArray[np.intp]) -> Motion:
        """Return some of the states."""
        matrices = None if self.rotation is None else self.rotation[rows]
        return Motion(
            self.t[rows],
            self.position[rows],
            self.velocity[rows],
            self.quaternion[rows],
            self.omega[rows],
            matrices,
        )


Loads: TypeAlias = Callable[[Array, Array, Array, Array, Array], tuple[Array, Array]]
"""f(t (n,), position, R (n, 3, 3), velocity, omega_world) -> force and torque (n, 3).

The force is in world axes, N, and includes the weight; the torque is about the centre of mass in body axes,
N m.
"""


def scene_loads(scene: Scene) -> Loads:
    """Return the loads of a scene: the weight, the constant loads, and the continuous ones."""
    constant = wrench_between(scene, 0.0, scene.duration_s)
    weight, continuous = scene.body.mass * scene.gravity, scene.continuous_loads

    def loads(
        t: Array, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        force = constant.force_world + weight + rotation @ constant.force_body
        torque = constant.torque_body + constant.torque_world @ rotation
        for at, push in constant.point_forces:
            force = force + push
            torque = torque + cross(np.broadcast_to(at, omega.shape), push @ rotation)
        if continuous:
            instants = Instants(t, position, rotation, velocity, omega)
            for load in continuous:
                push, couple = wrench_at(load, scene, instants)
                force, torque = force + push, torque + back(rotation, couple)
        return force, torque

    return loads


def rotated(q: Array, angle: Array) -> Array:
    """q exp(angle / 2), angle (n, 3) in body axes."""
    return quaternion_product(q, exp_quaternion(angle))


def weighted_sum(weights: Array, stages: Sequence[Array], like: Array) -> Array:
    """Return the sum of w_i k_i over the stages; zeros with the shape of `like` if all weights are 0."""
    total = np.zeros_like(like)
    for weight, stage in zip(weights, stages, strict=False):
        if weight != 0.0:
            total = total + weight * stage
    return total


def zero_order_hold(loads: Loads, begin: Motion, *, in_body_axes: bool) -> Loads:
    """Return the loads as evaluated at the start of the step, constant over it in body or in world axes."""
    start = begin.orthogonal
    force, torque = loads(begin.t, begin.position, start, begin.velocity, times(start, begin.omega))
    force_body, torque_world = back(start, force), times(start, torque)

    def constant(
        t: Array, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        del t, position, velocity, omega
        if in_body_axes:
            return times(rotation, force_body), torque
        return force, back(rotation, torque_world)

    return constant


def held_acceleration(solid: Solid, loads: Loads, begin: Motion) -> Loads:
    """Return loads whose force and angular acceleration are those at the start of the step, in world axes."""
    start = begin.orthogonal
    force, torque = loads(begin.t, begin.position, start, begin.velocity, times(start, begin.omega))
    acceleration = times(start, times(solid.inverse, torque))

    def constant(
        t: Array, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        del t, position, velocity, omega
        return force, times(solid.inertia, back(rotation, acceleration))

    return constant


def stepped(motion: Motion, dt: Array) -> Motion:
    """Return the states with their times advanced by dt."""
    return replace(motion, t=motion.t + dt)


def times(matrix: Array, vector: Array) -> Array:
    """M v (..., 3)."""
    return np.asarray((matrix @ vector[..., None])[..., 0])


def back(matrix: Array, vector: Array) -> Array:
    """M^T v (..., 3)."""
    return np.asarray((vector[..., None, :] @ matrix)[..., 0, :])


Attitude: TypeAlias = Literal["group", "quaternion", "unit quaternion", "matrix", "projected matrix"]
"""How a step changes the attitude: by rotations, or by adding to a quaternion or a matrix, which is then kept
as it is, or normalised or projected onto SO(3)."""

Step: TypeAlias = Callable[[Solid, Motion, Array, Loads], Motion]
"""step(solid, motion, dt, loads) -> the states dt () or (n,) seconds later."""


@dataclass(frozen=True, eq=False)
class OneStepMap:
    """One integration step of a rigid body.

    description: its formula. order: of the error of a torque-free motion, 0 where a term is missing. aliases:
    other names of the same map. reversible: whether a step back from the reversed state returns to the start.
    stages: whether loads are evaluated more than once per step, so that holding them constant is another map.
    """

    name: str
    description: str
    source: str
    order: int
    step: Step
    attitude: Attitude = "group"
    aliases: tuple[str, ...] = ()
    reversible: bool = False
    stages: bool = False
