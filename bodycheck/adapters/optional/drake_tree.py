"""Trees in Drake: a MultibodyPlant, and what it computes of its context.

A free body has omega, then the velocity, in world axes; a ball joint has roll, pitch and yaw, which are
singular at a pitch of 90 degrees, and omega in the axes of its zero frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.tree_contract import (
    JointedLink,
    RateMap,
    TreeModel,
    UnreportedError,
    jointed_links,
    link_poses,
    swapped_in_world,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeScene


class DrakeTree(TreeModel):
    """A continuous plant, a simulator of it with semi-explicit Euler steps, and its context."""

    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "CalcMassMatrix; omega, then v, world axes; balls in the zero frame",
        "bias": "CalcBiasTerm, CalcGravityGeneralizedForces",
        "gravity_bias": "CalcGravityGeneralizedForces",
        "accelerations": "generalized_acceleration port",
        "wrenches": "reaction_forces port; child axes, at the joint",
        "energy": "EvalKineticEnergy, EvalPotentialEnergy",
        "momenta": "CalcSpatialMomentumInWorldAboutPoint",
        "poses": "EvalBodyPoseInWorld; of the link",
    }

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        from pydrake import all as drake

        self._drake: Any = drake
        self._scene, self._links = scene, jointed_links(scene)
        if any(link.kind == "free" and k for k, link in enumerate(self._links)):
            raise UnreportedError("the adapter builds a free body only as the first")
        plant = self._plant = drake.MultibodyPlant(0.0)
        plant.mutable_gravity_field().set_gravity_vector(scene.gravity)
        self._bodies: list[Any] = []
        self._joints: list[Any] = []
        for link in self._links:
            body = plant.AddRigidBody(
                link.name, self._inertia(link.mass * masses_were, link.centre, link.inertia * masses_were)
            )
            self._bodies.append(body)
            if link.kind == "free":
                self._joints.append(None)
                continue
            parent = plant.world_frame() if link.parent < 0 else self._bodies[link.parent].body_frame()
            pose = drake.RigidTransform(drake.RotationMatrix(quaternion_to_matrix(link.zero)), link.place)
            frame = plant.AddFrame(drake.FixedOffsetFrame(f"{link.name}-zero", parent, pose))
            self._joints.append(plant.AddJoint(self._joint(link, frame, body.body_frame())))
        plant.Finalize()
        self._simulator = drake.Simulator(plant)
        self._context = self._simulator.get_mutable_context()
        if masses_were != 1.0:
            for link, body in zip(self._links, self._bodies, strict=True):
                body.SetSpatialInertiaInBodyFrame(
                    self._context, self._inertia(link.mass, link.centre, link.inertia)
                )
        starts = [
            body.floating_velocities_start_in_v() if joint is None else joint.velocity_start()
            for body, joint in zip(self._bodies, self._joints, strict=True)
        ]
        self._map = RateMap(scene, starts)

    def _joint(self, link: JointedLink, frame: Any, own: Any) -> Any:
        kinds = {"hinge": self._drake.RevoluteJoint, "slide": self._drake.PrismaticJoint}
        name = f"{link.name}-joint"
        if link.kind == "ball":
            return self._drake.BallRpyJoint(name, frame, own)
        return kinds[link.kind](name, frame, own, link.axis)

    def _inertia(self, mass: float, centre: Array, inertia: Array) -> Any:
        drake = self._drake
        moments = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        return drake.SpatialInertia.MakeFromCentralInertia(mass, centre, drake.RotationalInertia(*moments))

    def set_state(self, q: Array, u: Array) -> None:
        """Set positions and velocities in the context."""
        own = np.empty(self._plant.num_positions())
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            values = q[part]
            start = (
                self._bodies[k].floating_positions_start()
                if link.kind == "free"
                else self._joints[k].position_start()
            )
            if link.kind == "free":
                values = np.concatenate([values[3:], values[:3]])
                self._map.turn(k, swapped_in_world(q[part][3:]))
            elif link.kind == "ball":
                rotation = quaternion_to_matrix(values)
                self._map.turn(k, rotation)
                values = self._drake.RollPitchYaw(self._drake.RotationMatrix(rotation)).vector()
            own[start : start + len(values)] = values
        self._plant.SetPositions(self._context, own)
        self._plant.SetVelocities(self._context, self._map.rates(u))

    def mass_matrix(self) -> Array:
        """CalcMassMatrix."""
        return self._map.mass_matrix(np.array(self._plant.CalcMassMatrix(self._context)))

    def bias(self) -> Array:
        """CalcBiasTerm, less CalcGravityGeneralizedForces."""
        terms = np.array(self._plant.CalcBiasTerm(self._context))
        return self._map.bias(terms) + self.gravity_bias()

    def gravity_bias(self) -> Array:
        """The opposite of CalcGravityGeneralizedForces."""
        return -self._map.bias(np.array(self._plant.CalcGravityGeneralizedForces(self._context)))

    def accelerations(self) -> Array:
        """get_generalized_acceleration_output_port."""
        port = self._plant.get_generalized_acceleration_output_port()
        return self._map.accelerations(np.array(port.Eval(self._context)))

    def wrenches(self) -> Array:
        """get_reaction_forces_output_port: on the child at the joint, in the axes of its frame."""
        forces = self._plant.get_reaction_forces_output_port().Eval(self._context)
        found = np.zeros((len(self._links), 6))
        for row, joint in zip(found, self._joints, strict=True):
            if joint is not None:
                force = forces[int(joint.index())]
                row[:3], row[3:] = force.translational(), force.rotational()
        return found

    def energy(self) -> Array:
        """EvalKineticEnergy and EvalPotentialEnergy."""
        plant, context = self._plant, self._context
        return np.array([plant.EvalKineticEnergy(context), plant.EvalPotentialEnergy(context)])

    def momenta(self) -> Array:
        """CalcSpatialMomentumInWorldAboutPoint, the origin."""
        found = self._plant.CalcSpatialMomentumInWorldAboutPoint(self._context, np.zeros(3))
        return np.concatenate([found.translational(), found.rotational()])

    def poses(self) -> Array:
        """EvalBodyPoseInWorld."""
        poses = [self._plant.EvalBodyPoseInWorld(self._context, body) for body in self._bodies]
        return link_poses(
            self._links,
            [np.array(pose.translation()) for pose in poses],
            [pose.rotation().matrix() for pose in poses],
        )

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Make one semi-explicit Euler step by AdvanceTo."""
        simulator, start = self._simulator, self._context.get_time()
        integrator = self._drake.ResetIntegratorFromFlags(simulator, "semi_explicit_euler", dt_s)
        integrator.set_fixed_step_mode(True)
        simulator.Initialize()
        simulator.AdvanceTo(start + dt_s)
        own, parts = np.array(self._plant.GetPositions(self._context)), []
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            start = (
                self._bodies[k].floating_positions_start()
                if link.kind == "free"
                else self._joints[k].position_start()
            )
            if link.kind == "free":
                values = np.roll(own[start : start + 7], 3)
                self._map.turn(k, swapped_in_world(values[3:]))
            elif link.kind == "ball":
                rotation = self._drake.RollPitchYaw(own[start : start + 3]).ToRotationMatrix().matrix()
                self._map.turn(k, rotation)
                values = matrix_to_quaternion(rotation)
            else:
                values = own[start : start + part.stop - part.start]
            parts.append(values)
        return np.concatenate(parts), self._map.own_rates(np.array(self._plant.GetVelocities(self._context)))
