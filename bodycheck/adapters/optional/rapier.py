"""Rapier through the wheel rapier3d: a body without colliders, in float32.

Forces and torques persist until they are reset. The velocity is that of the centre of mass, both velocities
are in world axes, and the constructor of a rotation takes (w, x, y, z).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import BetweenSteps, FreeBodiesOnly, array
from bodycheck.adapters.optional.rapier_tree import (
    RapierTree,
    isometry,
    mass_properties,
    quaternion_of,
    tensor_of,
    unlimited,
    vector,
)
from bodycheck.reference_impl.arrays import Array
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
    modules = ("rapier3d",)
    methods: Mapping[str, Method] = {method.name: method for method in (_STEP, _DEFAULTS)}
    tree_model = RapierTree

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a world of one body."""
        return BetweenSteps(scene, dt_s, _Body(scene, dt_s, fair=method == _STEP.name))


class _Body:
    stepping: Stepping = "python"

    def __init__(self, scene: Scene, dt_s: float, *, fair: bool) -> None:
        import rapier3d

        self._world = rapier3d.PhysicsWorld(gravity=vector(scene.gravity))
        self._world.integration_parameters.dt = dt_s
        solid = mass_properties(scene.body.mass, scene.body.inertia, np.zeros(3))
        built = rapier3d.RigidBody.dynamic().additional_mass_properties(solid)
        if fair:
            built = unlimited(self._world, built)
        self._body = self._world.rigid_bodies[self._world.add_body(built)]
        self._body.recompute_mass_properties_from_colliders(self._world.colliders)
        self._is_pushed = False

    def model(self) -> tuple[float, Array, float, Array]:
        world, inertia = self._world, tensor_of(self._body.mass_properties)
        return self._body.mass, inertia, world.integration_parameters.dt, array(world.gravity.to_tuple())

    def set_state(self, state: State) -> None:
        self._body.position = isometry(state.position, state.quaternion)
        self._body.linvel = vector(state.velocity)
        self._body.angvel = vector(state.omega_world)

    def step(self, steps: int, force: Array, torque: Array) -> None:
        if self._is_pushed:
            self._body.reset_forces()
            self._body.reset_torques()
        self._is_pushed = bool(np.any(force) or np.any(torque))
        if self._is_pushed:
            self._body.add_force(vector(force))
            self._body.add_torque(vector(torque))
        for _ in range(steps):
            self._world.step()

    def read(self) -> Reading:
        body = self._body
        return Reading(
            array(body.translation.to_tuple()),
            array(body.linvel.to_tuple()),
            quaternion=quaternion_of(body.rotation),
            omega_world=array(body.angvel.to_tuple()),
        )
