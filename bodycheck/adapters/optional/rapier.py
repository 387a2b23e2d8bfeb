"""Rapier through the wheel rapier3d: a body without colliders, in float32.

Forces and torques persist until they are reset. The velocity is that of the centre of mass, both velocities
are in world axes, and the constructor of a rotation takes (w, x, y, z).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import BetweenSteps, FreeBodiesOnly, array
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene, State

_STEP = Method(
    name="semi-implicit",
    formula="rescaled momentum, torque first, additive quaternion renormalised, 4 steps per step"
    "; the accelerations of loads are held over the step",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| = 1; linear momentum",
    source="Rapier, angvel_with_gyroscopic_forces in each of num_solver_iterations = 4",
    changed_defaults=("no sleeping", "no cap of the angular and linear speed"),
    snippet="world.integration_parameters.dt = {dt_s}; body.gyroscopic_forces_enabled = True",
    precision="float32",
    rounding_bias=4.0,
)
_DEFAULTS = replace(
    _STEP,
    name=f"{_STEP.name}{DEFAULTS}",
    formula=f"{_STEP.formula}; |omega| at most pi/4 / dt, |v| at most 400 m/s",
    changed_defaults=(),
)


class Rapier(FreeBodiesOnly):
    """Rapier (dimforge) in Python."""

    name = "rapier"
    distribution = "rapier3d"
    requires = ("rapier3d>=0.36",)
    methods: Mapping[str, Method] = {method.name: method for method in (_STEP, _DEFAULTS)}

    def __init__(self) -> None:
        import rapier3d  # noqa: F401 - fails here where it is missing

        self.version = version(self.distribution)

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a world of one body."""
        return BetweenSteps(scene, dt_s, _Body(scene, dt_s, fair=method == _STEP.name))


class _Body:
    stepping: Stepping = "python"

    def __init__(self, scene: Scene, dt_s: float, *, fair: bool) -> None:
        import rapier3d

        self._r: Any = rapier3d
        self._world = rapier3d.PhysicsWorld(gravity=self._vector(scene.gravity))
        self._world.integration_parameters.dt = dt_s
        moments, axes = diagonalised(scene.body.inertia)
        frame = rapier3d.Rotation3(*matrix_to_quaternion(axes))
        solid = rapier3d.MassProperties(
            self._vector(np.zeros(3)), scene.body.mass, self._vector(moments), frame
        )
        built = rapier3d.RigidBody.dynamic().additional_mass_properties(solid)
        if fair:
            self._world.integration_parameters.normalized_max_linear_velocity = float(
                np.finfo(np.float32).max
            )
            built = built.can_sleep(False).gyroscopic_forces(True).allow_fast_rotation(True)
        self._body = self._world.rigid_bodies[self._world.add_body(built)]
        self._body.recompute_mass_properties_from_colliders(self._world.colliders)
        self._is_pushed = False

    def _vector(self, values: Array) -> Any:
        return self._r.Vec3(*(float(value) for value in values))

    def model(self) -> tuple[float, Array, float, Array]:
        solid = self._body.mass_properties
        rotation = quaternion_to_matrix(_quaternion(solid.principal_inertia_local_frame))
        inertia = rotation @ np.diag(array(solid.principal_inertia.to_tuple())) @ rotation.T
        world = self._world
        return self._body.mass, inertia, world.integration_parameters.dt, array(world.gravity.to_tuple())

    def set_state(self, state: State) -> None:
        rotation = self._r.Rotation3(*(float(value) for value in state.quaternion))
        self._body.position = self._r.Isometry3(self._vector(state.position), rotation)
        self._body.linvel = self._vector(state.velocity)
        self._body.angvel = self._vector(state.omega_world)

    def step(self, steps: int, force: Array, torque: Array) -> None:
        if self._is_pushed:
            self._body.reset_forces()
            self._body.reset_torques()
        self._is_pushed = bool(np.any(force) or np.any(torque))
        if self._is_pushed:
            self._body.add_force(self._vector(force))
            self._body.add_torque(self._vector(torque))
        for _ in range(steps):
            self._world.step()

    def read(self) -> Reading:
        body = self._body
        return Reading(
            array(body.translation.to_tuple()),
            array(body.linvel.to_tuple()),
            quaternion=_quaternion(body.rotation),
            omega_world=array(body.angvel.to_tuple()),
        )


def _quaternion(rotation: Any) -> Array:
    return array((rotation.w, rotation.i, rotation.j, rotation.k))
