"""Trees in Drake: a MultibodyPlant, and what it computes of its context.

A free body has omega, then the velocity, in world axes; a ball joint has roll, pitch and yaw, which are
singular at a pitch of 90 degrees, and omega in the axes of its zero frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.contract import Stepping, TreeReadBack
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

_FREE_FIRST = "the adapter builds a free body only as the first"


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
            raise UnreportedError(_FREE_FIRST)
        self._build(0.0, masses_were)

    def _build(self, time_step_s: float, masses_were: float = 1.0) -> None:
        """Build the plant, continuous for a time step of 0."""
        drake, scene = self._drake, self._scene
        plant = self._plant = drake.MultibodyPlant(time_step_s)
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
        self._add_springs()
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
        damping = self._scene.bodies[self._links.index(link)].joint.damping
        if link.kind == "ball":
            return self._drake.BallRpyJoint(name, frame, own, damping=damping)
        return kinds[link.kind](name, frame, own, link.axis, damping=damping)

    def _add_springs(self) -> None:
        springs = {"hinge": self._drake.RevoluteSpring, "slide": self._drake.PrismaticSpring}
        for link, body, joint in zip(self._links, self._scene.bodies, self._joints, strict=True):
            if body.joint.stiffness:
                spring = springs[link.kind](joint, body.joint.rest, body.joint.stiffness)
                self._plant.AddForceElement(spring)

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
        return self.state()

    # --------------------------------------------------------------------------------------------- motion

    stepping: Stepping = "native"

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Refuse loads and armatures."""
        joints = [body.joint for body in scene.bodies]
        if any(joint.kind == "free" for joint in joints[1:]):
            return _FREE_FIRST
        if scene.loads or any(joint.armature for joint in joints):
            return "the adapter moves trees without loads and armatures only"
        return None

    def start(self, method: str, dt_s: float) -> None:
        """Build a new plant of the method, and set the start."""
        is_discrete = method == "discrete"
        self._build(dt_s if is_discrete else 0.0)
        self._dt_s, self._steps = dt_s, 0
        if not is_discrete:
            name = method.replace("-", "_")
            integrator = self._drake.ResetIntegratorFromFlags(self._simulator, name, dt_s)
            integrator.set_fixed_step_mode(True)
        self.set_state(self._scene.q0, self._scene.u0)
        self._simulator.Initialize()

    def advance(self, steps: int) -> None:
        """Make the steps in one call."""
        self._steps += steps
        self._simulator.AdvanceTo(self._steps * self._dt_s)

    def held(self) -> TreeReadBack:
        """Read the plant."""
        numbers: dict[str, list[Any]] = {}
        for link, body, joint in zip(self._links, self._bodies, self._joints, strict=True):
            inertia = body.CalcSpatialInertiaInBodyFrame(self._context)
            central = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
            one: dict[str, Any] = {
                "mass": inertia.get_mass(),
                "inertia": central,
                "centre": inertia.get_com(),
            }
            one |= {"place": link.place, "zero": link.zero, "damping": 0.0}
            if joint is not None:
                pose = joint.frame_on_parent().GetFixedPoseInBodyFrame()
                one["place"] = pose.translation()
                one["zero"] = matrix_to_quaternion(pose.rotation().matrix())
                one["damping"] = joint.default_damping_vector()[0]
            for name, value in one.items():
                numbers.setdefault(name, []).append(value)
        q, u = self.state()
        stored = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
        stored["gravity"] = np.array(self._plant.gravity_field().gravity_vector())
        return TreeReadBack(self._dt_s, stored | {"q": q, "u": u})

    def state(self) -> tuple[Array, Array]:
        """GetPositions and GetVelocities."""
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
