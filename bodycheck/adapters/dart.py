"""DART: a skeleton of one body on a free joint, stepped as World.step does but without a world.

A world would only add collision detection and deactivation to what is done here, digit for digit the
same. The joint's velocities are (omega, velocity) in world axes; its positions are a rotation vector
and the origin, here the centre of mass.
"""

from __future__ import annotations

from collections.abc import Mapping

import dartpy
import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Stepping, beyond_constant_loads
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

_SEMI_IMPLICIT = Method(
    name="semi-implicit",
    formula="omega += h I^-1 (tau - omega x I omega); R = R exp([h omega]x)",
    order=1,
    evaluations=1,
    torque="held over the step",
    keeps="R^T R = 1; linear momentum",
    source="DART World::step: Skeleton::computeForwardDynamics, integrateVelocities, integratePositions",
    changed_defaults=("no world: no collision detection, no deactivation",),
)


class Dart:
    """DART (Lee et al. 2018) through dartpy."""

    name = "dart"
    version: str = dartpy.__version__
    methods: Mapping[str, Method] = {_SEMI_IMPLICIT.name: _SEMI_IMPLICIT}

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse what is not built."""
        return beyond_constant_loads(scene)

    def build(self, scene: Scene, method: str, dt_s: float) -> DartSimulation:  # noqa: ARG002 - there is one
        """Make a skeleton of one body."""
        return DartSimulation(scene, dt_s)


class DartSimulation:
    """One skeleton."""

    stepping: Stepping = "python"

    def __init__(self, scene: Scene, dt_s: float) -> None:
        self._initial = scene.initial
        self._skeleton = dartpy.dynamics.Skeleton("body")
        self._joint, self._body = self._skeleton.createFreeJointAndBodyNodePair()
        self._body.setInertia(dartpy.dynamics.Inertia(scene.body.mass, _CENTRE, scene.body.inertia))
        self._skeleton.setGravity(scene.gravity)
        self._skeleton.setTimeStep(dt_s)
        self.reset()

    def read_back(self) -> ReadBack:
        """Ask the skeleton."""
        inertia = self._body.getInertia()
        return ReadBack(
            mass=inertia.getMass(),
            inertia=np.array(inertia.getMoment()),
            dt_s=self._skeleton.getTimeStep(),
            gravity=np.array(self._skeleton.getGravity()),
            state=self.read(),
        )

    def reset(self) -> None:
        """Set the initial state and no wrench."""
        initial = self._initial
        pose = dartpy.math.Isometry3()
        pose.set_rotation(initial.rotation)
        pose.set_translation(initial.position)
        self._joint.setTransform(pose)
        self._joint.setLinearVelocity(initial.velocity)
        self._joint.setAngularVelocity(initial.omega_world)
        self._is_lost = False
        self.apply(NO_WRENCH)

    def apply(self, wrench: Wrench) -> None:
        """Hand over the wrench: nothing here clears forces between steps.

        What is given to the joint stays fixed in world axes. An external force stays fixed in body axes,
        even one given in world axes, so the loads of the world at body points are renewed in every step.
        """
        self._wrench = wrench
        self._joint.setForces(np.concatenate([wrench.torque_world, wrench.force_world]))
        self._renew_external_forces()

    def advance(self, steps: int) -> None:
        """Make each step by three calls; a lost state stays lost, without DART's three warnings a step."""
        if self._is_lost:
            return
        skeleton, turns_with_body = self._skeleton, bool(self._wrench.point_forces)
        dt_s = skeleton.getTimeStep()
        for _ in range(steps):
            if turns_with_body:
                self._renew_external_forces()
            skeleton.computeForwardDynamics()
            skeleton.integrateVelocities(dt_s)
            skeleton.integratePositions(dt_s)

    def read(self) -> Reading:
        """Copy the joint's positions and velocities; the matrix is that of getWorldTransform.

        It is NaN where the joint's rotation vector is: there DART shows the identity instead.
        """
        positions, velocities = np.array(self._joint.getPositions()), np.array(self._joint.getVelocities())
        rotation = np.array(self._body.getWorldTransform().rotation())
        self._is_lost = not np.all(np.isfinite(positions))
        if self._is_lost:
            rotation[:] = np.nan
        return Reading(
            position=positions[3:],
            velocity=velocities[3:],
            rotation=rotation,
            omega_world=velocities[:3],
        )

    def close(self) -> None:
        """Do nothing: the skeleton goes with this object."""

    def _renew_external_forces(self) -> None:
        """Give the body's own loads, and the world's at body points for the present orientation."""
        wrench, body = self._wrench, self._body
        body.clearExternalForces()
        body.addExtTorque(wrench.torque_body, True)
        body.addExtForce(wrench.force_body, _CENTRE, True, True)
        for at, force in wrench.point_forces:
            body.addExtForce(force, at, False, True)


_CENTRE = np.zeros(3)
