"""SAPIEN: a PhysX body on the CPU without collision shapes, in float32.

A pose is that of the body frame, its quaternion (w, x, y, z). Velocities are those of the centre of mass in
world axes. A step clears forces and torques.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import BetweenSteps, FreeBodiesOnly, array
from bodycheck.adapters.optional.sapien_tree import UNLIMITED, SapienTree, physx_system
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene, State

_PHYSX = Method(
    name="physx",
    formula="rescaled momentum, torque first",
    order=None,  # at usual steps its error is that of float32
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| = 1; linear momentum",
    source="PhysX 5, rigid body dynamics on the CPU, gyroscopic forces on",
    changed_defaults=("no damping", "no sleeping", "no limits of velocities"),
    snippet="system.timestep = {dt_s}; body.linear_damping = body.angular_damping = 0",
    precision="float32",
    rounding_bias=2.5,
)
_DEFAULTS = replace(
    _PHYSX,
    name=f"{_PHYSX.name}{DEFAULTS}",
    formula=f"omega damped by 1 - 0.05 dt and limited to 100 rad/s, else {_PHYSX.formula}",
    conserves="|q| = 1",
    changed_defaults=(),
    snippet="system.timestep = {dt_s}",
)


class Sapien(FreeBodiesOnly):
    """SAPIEN 3 (Xiang et al. 2020) with PhysX 5."""

    name = "sapien"
    distribution = "sapien"
    requires = ("sapien>=3.0.3",)
    modules = ("sapien",)
    methods: Mapping[str, Method] = {method.name: method for method in (_PHYSX, _DEFAULTS)}
    tree_model = SapienTree

    def __init__(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns of a missing libvulkan, which only pictures need
            super().__init__()

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a scene of one entity."""
        return BetweenSteps(scene, dt_s, _Body(scene, dt_s, fair=method == _PHYSX.name))


class _Body:
    stepping: Stepping = "python"

    def __init__(self, scene: Scene, dt_s: float, *, fair: bool) -> None:
        import sapien
        from sapien import physx

        self._pose: Any = sapien.Pose
        self._system = physx_system(scene.gravity)
        self._system.timestep = dt_s
        self._scene, self._entity = sapien.Scene([self._system]), sapien.Entity()
        moments, axes = diagonalised(scene.body.inertia)
        self._body = physx.PhysxRigidDynamicComponent()
        self._body.mass = scene.body.mass
        self._body.inertia = moments
        self._body.cmass_local_pose = self._pose(np.zeros(3), matrix_to_quaternion(axes))
        if fair:
            self._body.linear_damping = self._body.angular_damping = self._body.sleep_threshold = 0.0
            self._body.max_linear_velocity = self._body.max_angular_velocity = UNLIMITED
        self._entity.add_component(self._body)
        self._scene.add_entity(self._entity)

    def model(self) -> tuple[float, Array, float, Array]:
        body, system = self._body, self._system
        rotation = quaternion_to_matrix(array(body.cmass_local_pose.q))
        inertia = rotation @ np.diag(array(body.inertia)) @ rotation.T
        return body.mass, inertia, system.timestep, array(system.config.gravity)

    def set_state(self, state: State) -> None:
        self._entity.pose = self._pose(state.position, state.quaternion)
        self._body.linear_velocity = state.velocity
        self._body.angular_velocity = state.omega_world
        self._body.wake_up()

    def step(self, steps: int, force: Array, torque: Array) -> None:
        if np.any(force) or np.any(torque):
            self._body.add_force_torque(force, torque)
        for _ in range(steps):
            self._system.step()

    def read(self) -> Reading:
        body, pose = self._body, self._entity.pose
        return Reading(
            array(pose.p),
            array(body.linear_velocity),
            quaternion=array(pose.q),
            omega_world=array(body.angular_velocity),
        )
