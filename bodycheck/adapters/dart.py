"""DART: a skeleton of one body on a free or a ball joint, stepped as World.step does but without a world.

A world gives the same digits and only adds collision detection and deactivation. The velocities of a free
joint are (omega, velocity) in world axes; its positions are a rotation vector and the position of the link's
origin, whose velocity is integrated. A ball joint has omega in body axes and a rotation vector.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import dartpy
import numpy as np

from bodycheck.adapters.contract import DEFAULTS, Method, ReadBack, Reading, Stepping
from bodycheck.adapters.engine_loads import ZeroOrderHold
from bodycheck.adapters.frames import EngineAxes, LinkFrame, link_frame, pivot_place
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

_SEMI_IMPLICIT = Method(
    name="semi-implicit",
    formula="M1",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="R^T R = 1; linear momentum where the link is at the centre of mass",
    source="DART World::step: Skeleton::computeForwardDynamics, integrateVelocities, integratePositions",
    changed_defaults=("no world: no collision detection, no deactivation",),
    snippet="world.setTimeStep({dt_s})",
)
_WITH_DEFAULTS = replace(_SEMI_IMPLICIT, name=f"{_SEMI_IMPLICIT.name}{DEFAULTS}", changed_defaults=())


class Dart:
    """DART (Lee et al. 2018) through dartpy."""

    name = "dart"
    version: str = dartpy.__version__
    methods: Mapping[str, Method] = {method.name: method for method in (_SEMI_IMPLICIT, _WITH_DEFAULTS)}
    tree_model = "bodycheck.adapters.dart_tree:DartTree"

    def __init__(self) -> None:
        """Raise ImportError for a release whose free joints have velocities in body axes."""
        major, minor = map(int, self.version.split(".")[:2])
        if (major, minor) < (6, 17):
            raise ImportError(f"velocities of free joints have body axes in {self.version}; 6.17 is needed")

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Return None: every scene is supported."""
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> DartSimulation:
        """Build a skeleton of one body; the variant with unchanged defaults puts it into a world."""
        return DartSimulation(scene, dt_s, in_world=method == _WITH_DEFAULTS.name)


class DartSimulation:
    """A simulation with one skeleton."""

    stepping: Stepping = "python"

    def __init__(self, scene: Scene, dt_s: float, *, in_world: bool) -> None:
        self._initial, self._pivot = scene.initial, scene.pivot
        link = link_frame(scene)
        self._axes, self._centre = EngineAxes(link.rotation), link.point(_ORIGIN)
        # joint forces act at the joint's origin; elsewhere their moment would rotate with the body
        self._by_joint = scene.pivot is None and not np.any(self._centre)
        self._skeleton = dartpy.dynamics.Skeleton("body")
        self._joint, self._body = self._jointed(scene, link)
        inertia = link.rotation.T @ scene.body.inertia @ link.rotation
        self._body.setInertia(dartpy.dynamics.Inertia(scene.body.mass, self._centre, inertia))
        self._skeleton.setGravity(scene.gravity)
        self._skeleton.setTimeStep(dt_s)
        self._world = dartpy.simulation.World() if in_world else None
        if self._world is not None:
            self._world.setGravity(scene.gravity)
            self._world.setTimeStep(dt_s)
            self._world.addSkeleton(self._skeleton)
        self._continuous = ZeroOrderHold(scene, dt_s)
        self.reset()

    def _jointed(self, scene: Scene, link: LinkFrame) -> tuple[Any, Any]:
        """Create the body on a free joint in link axes, or on a ball joint at the pivot in body axes."""
        if scene.pivot is None:
            return self._skeleton.createFreeJointAndBodyNodePair()
        joint, body = self._skeleton.createBallJointAndBodyNodePair()
        joint.setTransformFromChildBodyNode(_pose(link.point(scene.pivot), link.rotation.T))
        joint.setTransformFromParentBodyNode(_pose(pivot_place(scene), np.eye(3)))
        return joint, body

    def read_back(self) -> ReadBack:
        """Return the model as read from the skeleton."""
        inertia, axes = self._body.getInertia(), self._axes.matrix
        return ReadBack(
            mass=inertia.getMass(),
            inertia=axes @ np.array(inertia.getMoment()) @ axes.T,
            dt_s=self._skeleton.getTimeStep(),
            gravity=np.array(self._skeleton.getGravity()),
            state=self.read(),
        )

    def reset(self) -> None:
        """Restore the initial state, without a wrench."""
        initial = self._initial
        logarithm = dartpy.dynamics.BallJoint.convertToPositions
        if self._pivot is None:
            frame = initial.rotation @ self._axes.matrix
            arm, omega = frame @ self._centre, initial.omega_world
            self._joint.setPositions(np.concatenate([logarithm(frame), initial.position - arm]))
            self._joint.setVelocities(np.concatenate([omega, initial.velocity - np.cross(omega, arm)]))
        else:
            self._joint.setPositions(logarithm(initial.rotation))
            self._joint.setVelocities(initial.omega_body)
        self._is_lost = False
        self._continuous.reset()
        self.apply(NO_WRENCH)

    def apply(self, wrench: Wrench) -> None:
        """Set the wrench, which nothing clears between steps.

        Forces of a free joint stay fixed in world axes. External forces stay fixed in body axes, even if they
        are given in world axes, so world loads at body points are set again in every step.
        """
        self._wrench = wrench
        if self._by_joint:
            self._joint.setForces(np.concatenate([wrench.torque_world, wrench.force_world]))
        self._renew_external_forces()

    def advance(self, steps: int) -> None:
        """Make each step by three calls; skip the steps of a lost state, which print three warnings each."""
        if self._is_lost:
            return
        skeleton = self._skeleton
        renewed = bool(self._wrench.point_forces) or bool(self._continuous) or not self._by_joint
        dt_s = skeleton.getTimeStep()
        for _ in range(steps):
            if renewed:
                self._renew_external_forces()
            if self._continuous:
                self._add_continuous_loads()
            if self._world is not None:
                self._world.step(False)  # False: keep the forces
                continue
            skeleton.computeForwardDynamics()
            skeleton.integrateVelocities(dt_s)
            skeleton.integratePositions(dt_s)

    def read(self) -> Reading:
        """Copy the joint's positions and velocities; the matrix is that of getTransform.

        If the joint's rotation vector is not finite, the matrix is NaN; DART returns the identity.
        """
        position, rotation, velocity, omega_world = self._state()
        self._is_lost = not all(map(math.isfinite, self._joint.getPositions().tolist()))
        if self._is_lost:
            rotation = np.full((3, 3), np.nan)
        return Reading(position=position, velocity=velocity, rotation=rotation, omega_world=omega_world)

    def _state(self) -> tuple[Array, Array, Array, Array]:
        """Return position (3,), rotation (3, 3), velocity (3,) and omega (3,) of the body, in world axes."""
        positions, velocities = self._joint.getPositions(), self._joint.getVelocities()
        rotation = self._axes.body_rotation(np.ascontiguousarray(self._body.getTransform().rotation()))
        if self._by_joint:
            return positions[3:], rotation, velocities[3:], velocities[:3]
        if self._pivot is None:
            omega, arm = velocities[:3], rotation @ self._axes.body_vector(self._centre)
            return positions[3:] + arm, rotation, velocities[3:] + np.cross(omega, arm), omega
        omega = rotation @ velocities
        arm = rotation @ -self._pivot
        place = np.array(self._joint.getTransformFromParentBodyNode().translation())
        return place + arm, rotation, np.cross(omega, arm), omega

    def close(self) -> None:
        """Do nothing; the skeleton is freed with this object."""

    def _renew_external_forces(self) -> None:
        """Set the body-axes loads, and the world-axes loads at body points, for the present orientation."""
        wrench, body, to_engine = self._wrench, self._body, self._axes.engine_vector
        body.clearExternalForces()
        body.addExtTorque(to_engine(wrench.torque_body), True)
        body.addExtForce(to_engine(wrench.force_body), self._centre, True, True)
        for at, force in wrench.point_forces:
            body.addExtForce(force, self._centre + to_engine(at), False, True)
        if not self._by_joint:
            body.addExtForce(wrench.force_world, self._centre, False, True)
            body.addExtTorque(wrench.torque_world, False)

    def _add_continuous_loads(self) -> None:
        """Add the continuous loads at the present state, held constant over the step (zero-order hold)."""
        force_and_torque = self._continuous.next_wrench(*self._state())
        self._body.addExtForce(force_and_torque[:3], self._centre, False, True)
        self._body.addExtTorque(force_and_torque[3:], False)


def _pose(place: Array, rotation: Array) -> Any:
    pose = dartpy.math.Isometry3()
    pose.set_rotation(rotation)
    pose.set_translation(place)
    return pose


_ORIGIN = np.zeros(3)
