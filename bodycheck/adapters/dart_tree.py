"""Trees in DART: a skeleton of joints and bodies, and what it computes of its present state.

Free and ball joints have rotation vectors; the rates of a free joint are omega, then the velocity of the
link's origin, in world axes. Bodies are numbered in the order of their creation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import dartpy
import numpy as np

from bodycheck.adapters.contract import DEFAULTS, TreeReadBack
from bodycheck.adapters.tree_contract import (
    RateMap,
    TreeModel,
    held_loads,
    jointed_links,
    link_poses,
    swapped_in_world,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene

_logarithm = dartpy.dynamics.BallJoint.convertToPositions
_rotation = dartpy.dynamics.BallJoint.convertToRotation
_OVERFLOWS_J = 1e100


class DartTree(TreeModel):
    """A skeleton."""

    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "getMassMatrix; omega, then v of the link, world axes",
        "bias": "getCoriolisAndGravityForces",
        "gravity_bias": "getGravityForces",
        "accelerations": "getAccelerations",
        "wrenches": "getBodyForce; moment first, child axes, at the joint",
        "energy": "computeKineticEnergy, computePotentialEnergy",
        "momenta": "getLinearMomentum, getAngularMomentum; body axes",
        "poses": "getWorldTransform; of the link",
    }

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        self._scene, self._links = scene, jointed_links(scene)
        self._skeleton = dartpy.dynamics.Skeleton("tree")
        self._skeleton.setGravity(scene.gravity)
        self._bodies: list[Any] = []
        self._joints: list[Any] = []
        kinds = dartpy.dynamics
        for link in self._links:
            parent = None if link.parent < 0 else self._bodies[link.parent]
            if link.kind == "free":
                joint, body = self._skeleton.createFreeJointAndBodyNodePair(parent)
            elif link.kind == "ball":
                joint, body = self._skeleton.createBallJointAndBodyNodePair(parent)
            elif link.kind == "hinge":
                of_hinge = kinds.RevoluteJointProperties()
                of_hinge.mAxis = link.axis
                joint, body = self._skeleton.createRevoluteJointAndBodyNodePair(parent, of_hinge)
            else:
                of_slide = kinds.PrismaticJointProperties()
                of_slide.mAxis = link.axis
                joint, body = self._skeleton.createPrismaticJointAndBodyNodePair(parent, of_slide)
            pose = dartpy.math.Isometry3()
            pose.set_rotation(quaternion_to_matrix(link.zero))
            pose.set_translation(link.place)
            joint.setTransformFromParentBodyNode(pose)
            self._bodies.append(body)
            self._joints.append(joint)
            self._set_inertia(body, masses_were * link.mass, link.centre, masses_were * link.inertia)
        if masses_were != 1.0:
            self._skeleton.getMassMatrix()
            for link, body in zip(self._links, self._bodies, strict=True):
                self._set_inertia(body, link.mass, link.centre, link.inertia)
        self._map = RateMap(scene, [joint.getIndexInSkeleton(0) for joint in self._joints])

    def _set_inertia(self, body: Any, mass: float, centre: Array, inertia: Array) -> None:
        body.setInertia(dartpy.dynamics.Inertia(mass, centre, inertia))

    def set_state(self, q: Array, u: Array) -> None:
        """Set positions and velocities of each joint, and compute the accelerations."""
        for joint, link, part in zip(self._joints, self._links, self._scene.coordinate_slices, strict=True):
            if link.kind == "free":
                x, quaternion = q[part][:3], q[part][3:]
                joint.setPositions(np.concatenate([_logarithm(quaternion_to_matrix(quaternion)), x]))
            else:
                own = _logarithm(quaternion_to_matrix(q[part])) if link.kind == "ball" else q[part]
                joint.setPositions(own)
        self._turn()
        self._skeleton.setVelocities(self._map.rates(u))
        self._skeleton.computeForwardDynamics()

    def _turn(self) -> None:
        for k, link in enumerate(self._links):
            if link.kind == "free":
                rotation = np.array(self._bodies[k].getWorldTransform().rotation())
                self._map.turn(k, swapped_in_world(matrix_to_quaternion(rotation)))

    def mass_matrix(self) -> Array:
        """Skeleton::getMassMatrix."""
        return self._map.mass_matrix(np.array(self._skeleton.getMassMatrix()))

    def bias(self) -> Array:
        """Skeleton::getCoriolisAndGravityForces."""
        return self._map.bias(np.array(self._skeleton.getCoriolisAndGravityForces()))

    def gravity_bias(self) -> Array:
        """Skeleton::getGravityForces."""
        return self._map.bias(np.array(self._skeleton.getGravityForces()))

    def accelerations(self) -> Array:
        """Skeleton::getAccelerations."""
        return self._map.accelerations(np.array(self._skeleton.getAccelerations()))

    def wrenches(self) -> Array:
        """BodyNode::getBodyForce: moment, then force, at the link's origin."""
        found = [np.roll(np.array(body.getBodyForce()), 3) for body in self._bodies]
        return np.array(
            [
                np.zeros(6) if link.kind == "free" else one
                for link, one in zip(self._links, found, strict=True)
            ]
        )

    def energy(self) -> Array:
        """Skeleton::computeKineticEnergy, computePotentialEnergy."""
        return np.array([self._skeleton.computeKineticEnergy(), self._skeleton.computePotentialEnergy()])

    def momenta(self) -> Array:
        """BodyNode::getLinearMomentum and getAngularMomentum(origin of the world), both in body axes."""
        found = np.zeros((2, 3))
        for body in self._bodies:
            pose = body.getWorldTransform()
            rotation, place = np.array(pose.rotation()), np.array(pose.translation())
            linear = rotation @ np.array(body.getLinearMomentum())
            found += linear, rotation @ np.array(body.getAngularMomentum()) + np.cross(place, linear)
        return found.ravel()

    def poses(self) -> Array:
        """BodyNode::getWorldTransform."""
        poses = [body.getWorldTransform() for body in self._bodies]
        return link_poses(
            self._links,
            [np.array(pose.translation()) for pose in poses],
            [np.array(pose.rotation()) for pose in poses],
        )

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Make the three calls of World::step."""
        self._step(dt_s)
        return self.state()

    def _step(self, dt_s: float) -> None:
        self._skeleton.computeForwardDynamics()
        self._skeleton.integrateVelocities(dt_s)
        self._skeleton.integratePositions(dt_s)

    # --------------------------------------------------------------------------------------------- motion

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Refuse armatures."""
        return "DART's joints have no armature" if any(b.joint.armature for b in scene.bodies) else None

    def start(self, method: str, dt_s: float) -> None:
        """Set the joints' springs and dampers, the step and the state; with its defaults, in a world."""
        self._world = None
        for joint, body in zip(self._joints, self._scene.bodies, strict=True):
            for index in range(body.joint.of_kind.rates if body.joint.kind != "free" else 0):
                joint.setDampingCoefficient(index, body.joint.damping)
                if body.joint.stiffness:
                    joint.setSpringStiffness(index, body.joint.stiffness)
                    joint.setRestPosition(index, body.joint.rest)
        self._skeleton.setTimeStep(dt_s)
        self._skeleton.resetCommands()
        self.set_state(self._scene.q0, self._scene.u0)
        self._steps = 0
        if method.endswith(DEFAULTS):
            self._world = dartpy.simulation.World()
            self._world.setGravity(self._scene.gravity)
            self._world.setTimeStep(dt_s)
            self._world.addSkeleton(self._skeleton)

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Keep the loads, which every step sets again: DART turns world forces with the body otherwise."""
        self._loads = tuple(loads)
        self._set_loads()

    def _set_loads(self) -> None:
        held = held_loads(
            self._scene, self._loads, self._steps * self._skeleton.getTimeStep(), self.state()[0]
        )
        for joint, own in zip(self._joints, held.joint, strict=True):
            joint.setForces(own)
        for body, link, force, torque in zip(self._bodies, self._links, held.force, held.torque, strict=True):
            body.clearExternalForces()
            body.addExtForce(force, link.centre, False, True)
            body.addExtTorque(torque, False)

    def advance(self, steps: int) -> None:
        """Set the loads and make a step, as often as wanted, as long as the state can be squared.

        DART sets what is no longer finite to 0, with a page of warnings per step.
        """
        dt_s, kinetic_j = self._skeleton.getTimeStep(), self._skeleton.computeKineticEnergy
        for _ in range(steps):
            if not kinetic_j() < _OVERFLOWS_J:
                return
            if self._loads:
                self._set_loads()
            if self._world is None:
                self._step(dt_s)
            else:
                self._world.step(False)  # False: keep the forces
            self._steps += 1

    def state(self) -> tuple[Array, Array]:
        """getPositions and getVelocities."""
        self._turn()
        parts = []
        for joint, link in zip(self._joints, self._links, strict=True):
            own = np.array(joint.getPositions())
            if link.kind == "free":
                own = np.concatenate([own[3:], matrix_to_quaternion(np.array(_rotation(own[:3])))])
            elif link.kind == "ball":
                own = matrix_to_quaternion(np.array(_rotation(own)))
            parts.append(own)
        return np.concatenate(parts), self._map.own_rates(np.array(self._skeleton.getVelocities()))

    def held(self) -> TreeReadBack:
        """Read the skeleton."""
        inertias = [body.getInertia() for body in self._bodies]
        poses = [joint.getTransformFromParentBodyNode() for joint in self._joints]
        kinds = [link.kind for link in self._links]
        q, u = self.state()
        axes = [
            np.array(joint.getAxis()) if kind in ("hinge", "slide") else np.zeros(3)
            for joint, kind in zip(self._joints, kinds, strict=True)
        ]
        numbers = {
            "mass": [one.getMass() for one in inertias],
            "inertia": [np.array(one.getMoment()) for one in inertias],
            "centre": [np.array(one.getLocalCOM()) for one in inertias],
            "place": [np.array(pose.translation()) for pose in poses],
            "zero": [matrix_to_quaternion(np.array(pose.rotation())) for pose in poses],
            "axis": axes,
            "stiffness": [joint.getSpringStiffness(0) for joint in self._joints],
            "rest": [joint.getRestPosition(0) for joint in self._joints],
            "damping": [joint.getDampingCoefficient(0) for joint in self._joints],
            "gravity": np.array(self._skeleton.getGravity()),
            "q": q,
            "u": u,
        }
        stored = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
        return TreeReadBack(float(self._skeleton.getTimeStep()), stored)
