"""Trees in SAPIEN: PhysX articulations in reduced coordinates, in float32.

Joints turn about and move along x of their frames. A free body is the root of an articulation; the trees that
hang on the world share a fixed root. After a step, accelerations and joint forces are those of its start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, TreeReadBack
from bodycheck.adapters.optional.between_steps import array
from bodycheck.adapters.tree_contract import (
    JointedLink,
    TreeModel,
    UnreportedError,
    frame_about,
    held_loads,
    jointed_links,
    link_momenta,
    link_poses,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene

_KINDS = {"hinge": "revolute_unwrapped", "slide": "prismatic"}
_SHORT_S = 1e-7
UNLIMITED = 1e15
_NO_BALLS = "joints of SAPIEN are hinges and slides"


def physx_system(gravity: Array) -> Any:
    """Return a system of PhysX on the CPU."""
    from sapien import physx

    settings = physx.PhysxSceneConfig()
    settings.gravity = gravity
    physx.set_scene_config(settings)
    return physx.PhysxCpuSystem()


class SapienTree(TreeModel):
    """Articulations in a scene."""

    precision = "float32"
    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "compute_generalized_mass_matrix of create_pinocchio_model",
        "bias": "compute_passive_force",
        "gravity_bias": "compute_passive_force without coriolis_and_centrifugal",
        "accelerations": f"qacc after a step of {_SHORT_S:g} s",
        "wrenches": f"link_incoming_joint_forces after a step of {_SHORT_S:g} s; axes of the joint",
        "momenta": "of linear_velocity and angular_velocity of each link",
        "poses": "entity.pose, of the link",
    }

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        import sapien
        from sapien import physx

        self._sapien, self._physx = sapien, physx
        self._scene, self._links = scene, jointed_links(scene)
        self._frames = [frame_about(link.axis) if link.kind in _KINDS else np.eye(3) for link in self._links]
        if any(link.kind == "ball" for link in self._links):
            raise UnreportedError(_NO_BALLS)
        self._build(jointed_links(scene, masses_were), defaults=False)
        if masses_were != 1.0:
            for link, own in zip(self._links, self._own, strict=True):
                own.mass, own.inertia = link.mass, diagonalised(link.inertia)[0]

    def _build(self, links: Sequence[JointedLink], *, defaults: bool) -> None:
        self._system = physx_system(self._scene.gravity)
        self._world = self._sapien.Scene([self._system])
        self._base: Any = None
        self._own: list[Any] = []
        self._entities: list[Any] = []
        for link, body, frame in zip(links, self._scene.bodies, self._frames, strict=True):
            own = self._component(self._parent_of(link))
            moments, axes = diagonalised(link.inertia)
            own.mass, own.inertia = link.mass, moments
            own.cmass_local_pose = self._pose(link.centre, axes)
            joint = own.joint
            joint.name = link.name
            if link.kind in _KINDS:
                joint.type = _KINDS[link.kind]
                joint.pose_in_parent = self._pose(link.place, quaternion_to_matrix(link.zero) @ frame)
                joint.pose_in_child = self._pose(np.zeros(3), frame)
                joint.limit = np.array([-np.inf, np.inf])
                joint.set_drive_properties(body.joint.stiffness, body.joint.damping)
                joint.set_drive_target(body.joint.rest)
                joint.set_armature([body.joint.armature])
                if not defaults:
                    joint.friction, joint.max_velocity = 0.0, UNLIMITED
            if not defaults:
                own.linear_damping = own.angular_damping = 0.0
                own.max_linear_velocity = own.max_angular_velocity = UNLIMITED
            self._own.append(own)
        for entity in self._entities:
            self._world.add_entity(entity)
        self._trees = list({id(own.articulation): own.articulation for own in self._own}.values())
        numbers = {link.name: k for k, link in enumerate(links)}
        self._joints = [[numbers[joint.name] for joint in tree.active_joints] for tree in self._trees]
        if not defaults:
            for tree in self._trees:
                tree.sleep_threshold = 0.0

    def _parent_of(self, link: JointedLink) -> Any:
        if link.kind == "free":
            return None
        if link.parent >= 0:
            return self._own[link.parent]
        if self._base is None:
            self._base = self._component(None)
            self._base.joint.type = "fixed"
        return self._base

    def _component(self, parent: Any) -> Any:
        component, entity = self._physx.PhysxArticulationLinkComponent(parent), self._sapien.Entity()
        entity.add_component(component)
        self._entities.append(entity)  # a component does not keep its entity alive
        return component

    def _pose(self, place: Array, rotation: Array) -> Any:
        return self._sapien.Pose(place, matrix_to_quaternion(rotation))

    def set_state(self, q: Array, u: Array) -> None:
        """Set the pose and the velocities of free roots, and qpos and qvel of each articulation."""
        places, rates = self._scene.coordinate_slices, self._scene.rate_slices
        for k, link in enumerate(self._links):
            if link.kind == "free":
                own, velocity = q[places[k]], u[rates[k]]
                tree = self._own[k].articulation
                tree.root_pose = self._sapien.Pose(own[:3], own[3:])
                tree.root_linear_velocity = velocity[:3]
                tree.root_angular_velocity = quaternion_to_matrix(own[3:]) @ velocity[3:]
        for tree, joints in zip(self._trees, self._joints, strict=True):
            if joints:
                tree.qpos = q[[places[k].start for k in joints]]
                tree.qvel = u[[rates[k].start for k in joints]]
        self._own[0].wake_up()
        self._q, self._u, self._has_stepped = q, u, False

    def _joint_part(self) -> tuple[Any, list[int]]:
        """Return the only articulation, and the place in u of each of its rates; not of a free root."""
        if any(link.kind == "free" for link in self._links):
            raise UnreportedError("SAPIEN reports the rows of joints only, none of a free root")
        return self._trees[0], [self._scene.rate_slices[k].start for k in self._joints[0]]

    def mass_matrix(self) -> Array:
        """compute_generalized_mass_matrix."""
        tree, places = self._joint_part()
        model = tree.create_pinocchio_model()
        found = np.empty((len(places),) * 2)
        found[np.ix_(places, places)] = model.compute_generalized_mass_matrix(array(tree.qpos))
        return found

    def bias(self) -> Array:
        """compute_passive_force."""
        return self._passive_force(motion=True)

    def gravity_bias(self) -> Array:
        """compute_passive_force of gravity."""
        return self._passive_force(motion=False)

    def _passive_force(self, *, motion: bool) -> Array:
        tree, places = self._joint_part()
        found = np.empty(len(places))
        found[places] = array(tree.compute_passive_force(True, motion)).ravel()
        return found

    def accelerations(self) -> Array:
        """Return qacc, after a short step."""
        tree, places = self._joint_part()
        self._after_a_step()
        found = np.empty(len(places))
        found[places] = array(tree.qacc).ravel()
        return found

    def wrenches(self) -> Array:
        """Return link_incoming_joint_forces, after a short step."""
        self._after_a_step()
        found = np.zeros((len(self._links), 6))
        for k, (own, frame) in enumerate(zip(self._own, self._frames, strict=True)):
            forces = array(own.articulation.link_incoming_joint_forces)[own.index]
            if own.parent is not None:
                found[k] = np.concatenate([frame @ forces[:3], frame @ forces[3:]])
        return found

    def _after_a_step(self) -> None:
        if not self._has_stepped:
            before = self._q, self._u
            self.step(_SHORT_S)
            self.set_state(*before)

    def energy(self) -> Array:
        """Nothing."""
        raise UnreportedError("the engine has no call for it")

    def momenta(self) -> Array:
        """Return the sums over the links, from their velocities."""
        rotations = self._rotations()
        places = [
            p + R @ link.centre for p, R, link in zip(self._places(), rotations, self._links, strict=True)
        ]
        velocities, omegas = (
            array([getattr(own, name) for own in self._own])
            for name in ("linear_velocity", "angular_velocity")
        )
        return link_momenta(self._links, rotations, np.array(places), velocities, omegas)

    def _places(self) -> list[Array]:
        return [array(own.entity.pose.p) for own in self._own]

    def _rotations(self) -> list[Array]:
        return [quaternion_to_matrix(array(own.entity.pose.q)) for own in self._own]

    def poses(self) -> Array:
        """Return entity.pose."""
        return link_poses(self._links, self._places(), self._rotations())

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Make one step of the system."""
        self._system.timestep = dt_s
        self._system.step()
        self._has_stepped = True
        return self.state()

    # --------------------------------------------------------------------------------------------- motion

    def start(self, method: str, dt_s: float) -> None:
        """Build the articulations again, and set the start."""
        self._build(self._links, defaults=method.endswith(DEFAULTS))
        self._system.timestep = dt_s
        self._steps = 0
        self.set_state(self._scene.q0, self._scene.u0)

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Refuse balls."""
        return _NO_BALLS if any(body.joint.kind == "ball" for body in scene.bodies) else None

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Keep the loads, which every step sets again."""
        self._loads = tuple(loads)

    def _set_loads(self) -> None:
        held = held_loads(self._scene, self._loads, self._steps * self._system.timestep, self.state()[0])
        for tree, joints in zip(self._trees, self._joints, strict=True):
            if joints:
                tree.qf = np.concatenate([held.joint[k] for k in joints])
        for own, force, torque in zip(self._own, held.force, held.torque, strict=True):
            if np.any(force) or np.any(torque):
                own.add_force_torque(force, torque)

    def advance(self, steps: int) -> None:
        """Set the loads and make a step, as often as wanted."""
        for _ in range(steps):
            if self._scene.loads:
                self._set_loads()
            self._system.step()
            self._steps += 1

    def state(self) -> tuple[Array, Array]:
        """Return qpos and qvel, and the pose and the velocities of free roots."""
        q, u = np.empty_like(self._scene.q0), np.empty_like(self._scene.u0)
        places, rates = self._scene.coordinate_slices, self._scene.rate_slices
        for tree, joints in zip(self._trees, self._joints, strict=True):
            if joints:
                q[[places[k].start for k in joints]] = array(tree.qpos).ravel()
                u[[rates[k].start for k in joints]] = array(tree.qvel).ravel()
        for k, (link, own) in enumerate(zip(self._links, self._own, strict=True)):
            if link.kind == "free":
                tree = own.articulation
                quaternion = array(tree.root_pose.q)
                q[places[k]] = np.concatenate([array(tree.root_pose.p), quaternion])
                omega = array(tree.root_angular_velocity) @ quaternion_to_matrix(quaternion)
                u[rates[k]] = np.concatenate([array(tree.root_linear_velocity), omega])
        return q, u

    def held(self) -> TreeReadBack:
        """Read the links and their joints."""
        numbers: dict[str, list[Any]] = {}
        for link, own in zip(self._links, self._own, strict=True):
            joint, axes = own.joint, quaternion_to_matrix(array(own.cmass_local_pose.q))
            frame = quaternion_to_matrix(array(joint.pose_in_child.q))
            is_joint = link.kind in _KINDS
            one = {
                "mass": own.mass,
                "inertia": axes @ np.diag(array(own.inertia)) @ axes.T,
                "centre": array(own.cmass_local_pose.p),
                "place": array(joint.pose_in_parent.p),
                "zero": matrix_to_quaternion(quaternion_to_matrix(array(joint.pose_in_parent.q)) @ frame.T),
                "axis": frame[:, 0],
                "stiffness": joint.stiffness if is_joint else 0.0,
                "damping": joint.damping if is_joint else 0.0,
                "rest": joint.drive_target[0] if is_joint else 0.0,
                "armature": joint.armature[0] if is_joint else 0.0,
            }
            for name, value in one.items():
                numbers.setdefault(name, []).append(value)
        q, u = self.state()
        stored = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
        stored["gravity"] = array(self._system.config.gravity)
        return TreeReadBack(self._system.timestep, stored | {"q": q, "u": u})
