"""Trees in Rapier: multibodies in reduced coordinates, in float32.

Joints turn about and move along x of their frames. The rates of a ball are in the frame of its joint in the
parent, those of a free root in world axes, the velocity first. A multibody has no call that sets coordinates,
only one that adds to them, so each state is set in a new world.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, TreeReadBack
from bodycheck.adapters.optional.between_steps import array
from bodycheck.adapters.tree_contract import (
    JointedLink,
    RateMap,
    TreeModel,
    UnreportedError,
    frame_about,
    jointed_links,
    link_momenta,
    link_poses,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import log_quaternion, matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeScene

_KINDS = {
    "hinge": "LOCKED_REVOLUTE_AXES",
    "slide": "LOCKED_PRISMATIC_AXES",
    "ball": "LOCKED_SPHERICAL_AXES",
}
_COORDINATE = {"hinge": 3, "slide": 0}
_SHORT_S = 1e-7


class RapierTree(TreeModel):
    """A world with one multibody per root."""

    precision = "float32"
    native: ClassVar[Mapping[str, str]] = {
        "accelerations": f"generalized_acceleration after a step of {_SHORT_S:g} s",
        "energy": "of each body, after such a step: kinetic_energy, gravitational_potential_energy",
        "momenta": "of linvel and angvel of each body, after such a step",
        "poses": "position of each body",
    }

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        import rapier3d

        if masses_were != 1.0:
            raise UnreportedError("the adapter changes no masses of a multibody")
        self._r: Any = rapier3d
        self._scene, self._links = scene, jointed_links(scene)
        parents = {link.parent for link in self._links}
        if any(link.kind == "free" and k not in parents for k, link in enumerate(self._links)):
            raise UnreportedError("a free body without joints is no multibody")
        self._frames = [
            frame_about(link.axis) if link.kind in _COORDINATE else np.eye(3) for link in self._links
        ]
        self._dt_s, self._defaults = _SHORT_S, False
        self._build({})

    def _build(self, free: Mapping[int, Array]) -> None:
        """Build the world with all coordinates at 0, and free bodies in these poses."""
        r = self._r
        self._world = r.PhysicsWorld(gravity=vector(self._scene.gravity))
        self._world.integration_parameters.dt = self._dt_s
        self._handles: list[Any] = []
        self._joints: list[Any] = []
        for k, (link, frame) in enumerate(zip(self._links, self._frames, strict=True)):
            built = r.RigidBody.dynamic().additional_mass_properties(
                mass_properties(link.mass, link.inertia, link.centre)
            )
            if k in free:
                built = built.position(isometry(free[k][:3], free[k][3:]))
            if not self._defaults:
                built = unlimited(self._world, built)
            handle = self._world.add_body(built)
            self._world.rigid_bodies[handle].recompute_mass_properties_from_colliders(self._world.colliders)
            self._handles.append(handle)
            self._joints.append(None if link.kind == "free" else self._add_joint(link, frame))
        self._bodies = [self._world.rigid_bodies[handle] for handle in self._handles]
        self._find_rates()
        if not self._defaults:
            joints = [body.joint for body in self._scene.bodies]
            for name in ("damping", "armature"):
                given = [np.full(joint.of_kind.rates, getattr(joint, name)) for joint in joints]
                self._pass(f"set_{name}", self._map.rates(np.concatenate(given)))

    def _add_joint(self, link: JointedLink, frame: Array) -> Any:
        joint = self._r.GenericJoint(getattr(self._r.JointAxesMask, _KINDS[link.kind]))
        joint.local_frame1 = isometry(
            link.place, matrix_to_quaternion(quaternion_to_matrix(link.zero) @ frame)
        )
        joint.local_frame2 = isometry(np.zeros(3), matrix_to_quaternion(frame))
        parent = (
            self._world.add_body(self._r.RigidBody.fixed()) if link.parent < 0 else self._handles[link.parent]
        )
        return self._world.multibody_joints.insert(parent, self._handles[-1], joint)

    def _find_rates(self) -> None:
        """Find the multibodies, the link of each body, and where its rates are."""
        joints = self._world.multibody_joints
        places = [joints.rigid_body_link(handle) for handle in self._handles]
        keys = [(place.multibody.index, place.multibody.generation) for place in places]
        own = {key: joints.get_multibody(place.multibody) for key, place in zip(keys, places, strict=True)}
        self._trees = list(own.values())
        for tree in self._trees:
            tree.forward_kinematics(self._world.rigid_bodies, True)  # a fixed root loses its rates here
        self._offsets = np.cumsum([0, *(tree.ndofs for tree in self._trees)])
        firsts = dict(zip(own, self._offsets[:-1].tolist(), strict=True))
        self._where = [(own[key], place.id) for key, place in zip(keys, places, strict=True)]
        self._starts = [
            firsts[key] + tree.get_link(number).assembly_id
            for key, (tree, number) in zip(keys, self._where, strict=True)
        ]
        self._map = RateMap(self._scene, self._starts)

    def _pass(self, call: str, values: Array) -> None:
        """Pass each multibody its part of the values (nu,)."""
        for tree, first, last in zip(self._trees, self._offsets[:-1], self._offsets[1:], strict=True):
            getattr(tree, call)([float(value) for value in values[first:last]])

    def _joined(self, call: str) -> Array:
        return np.concatenate([array(getattr(tree, call)()) for tree in self._trees])

    def set_state(self, q: Array, u: Array) -> None:
        """Build the world, and add the coordinates and the rates of each multibody."""
        places, rates = self._scene.coordinate_slices, self._scene.rate_slices
        kinds = [link.kind for link in self._links]
        self._build({k: q[places[k]] for k, kind in enumerate(kinds) if kind == "free"})
        moved = np.zeros(len(u))
        for k, kind in enumerate(kinds):
            if kind != "free":
                moved[rates[k]] = log_quaternion(q[places[k]]) if kind == "ball" else q[places[k]]
        self._pass("apply_displacements", self._map.rates(moved))
        self._turn(q)
        self._pass("set_generalized_velocity", self._map.rates(u))
        for tree in self._trees:
            tree.forward_kinematics(self._world.rigid_bodies, True)
            tree.update_rigid_bodies(self._world.rigid_bodies, True)
        self._q, self._u, self._has_stepped = q, u, False

    def _turn(self, q: Array) -> None:
        """Set the map of rates at these coordinates."""
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            if link.kind == "ball":
                self._map.turn(k, quaternion_to_matrix(q[part]))
            elif link.kind == "free":
                block = np.eye(6)
                block[3:, 3:] = quaternion_to_matrix(q[part][3:])
                self._map.turn(k, block)

    def _after_a_step(self) -> None:
        """Make a short step, after which the velocities of bodies are known."""
        if not self._has_stepped:
            self._world.integration_parameters.dt = _SHORT_S
            self._world.step()

    def accelerations(self) -> Array:
        """generalized_acceleration."""
        self._after_a_step()
        found = self._map.accelerations(self._joined("generalized_acceleration"))
        return self._undone(found)

    def _undone(self, found: Array) -> Array:
        if not self._has_stepped:
            self.set_state(self._q, self._u)
        return found

    def energy(self) -> Array:
        """Return the sums of kinetic_energy and gravitational_potential_energy."""
        self._after_a_step()
        gravity = self._world.gravity
        kinetic = sum(body.kinetic_energy() for body in self._bodies)
        potential = sum(body.gravitational_potential_energy(0.0, gravity) for body in self._bodies)
        return self._undone(np.array([kinetic, potential]))

    def momenta(self) -> Array:
        """Return the sums over the bodies, from their velocities."""
        self._after_a_step()
        rotations = [quaternion_to_matrix(quaternion_of(body.rotation)) for body in self._bodies]
        found = link_momenta(
            self._links,
            rotations,
            *(
                array([getattr(body, name).to_tuple() for body in self._bodies])
                for name in ("center_of_mass", "linvel", "angvel")
            ),
        )
        return self._undone(found)

    def poses(self) -> Array:
        """Return position, of the link."""
        return link_poses(
            self._links,
            [array(body.translation.to_tuple()) for body in self._bodies],
            [quaternion_to_matrix(quaternion_of(body.rotation)) for body in self._bodies],
        )

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Make one step of the world."""
        self._world.integration_parameters.dt = dt_s
        self._world.step()
        self._has_stepped = True
        return self.state()

    # --------------------------------------------------------------------------------------------- motion

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Refuse loads and springs."""
        if scene.loads:
            return "a multibody accepts no forces of joints; the adapter moves trees without loads"
        sprung = any(body.joint.stiffness for body in scene.bodies)
        return "the springs of Rapier are motors; the adapter sets none" if sprung else None

    def start(self, method: str, dt_s: float) -> None:
        """Build the world with this step, and set the start."""
        self._dt_s, self._defaults = dt_s, method.endswith(DEFAULTS)
        self.set_state(self._scene.q0, self._scene.u0)

    def advance(self, steps: int) -> None:
        """Make the steps one by one."""
        for _ in range(steps):
            self._world.step()

    def state(self) -> tuple[Array, Array]:
        """Return coords and joint_rot of each link, the position of free bodies, and generalized_velocity."""
        parts = []
        for link, body, (tree, number) in zip(self._links, self._bodies, self._where, strict=True):
            held = tree.get_link(number)
            if link.kind == "free":
                part = np.concatenate([array(body.translation.to_tuple()), quaternion_of(body.rotation)])
            elif link.kind == "ball":
                part = quaternion_of(held.joint_rot)
            else:
                part = array(held.coords)[[_COORDINATE[link.kind]]]
            parts.append(part)
        q = np.concatenate(parts)
        self._turn(q)
        return q, self._map.own_rates(self._joined("generalized_velocity"))

    def held(self) -> TreeReadBack:
        """Read the bodies and their joints."""
        damping, armature = self._joined("damping"), self._joined("armature")
        numbers: dict[str, list[Any]] = {}
        for link, body, joint, start in zip(
            self._links, self._bodies, self._joints, self._starts, strict=True
        ):
            solid = body.mass_properties
            one: dict[str, Any] = {
                "mass": body.mass,
                "inertia": tensor_of(solid),
                "centre": array(body.local_center_of_mass.to_tuple()),
                "place": link.place,
                "zero": link.zero,
                "axis": link.axis,
                "damping": damping[start + 3 if link.kind == "free" else start],
                "armature": armature[start],
            }
            if joint is not None:
                data = self._world.multibody_joints[joint].data
                frames = [
                    quaternion_to_matrix(quaternion_of(f.rotation))
                    for f in (data.local_frame1, data.local_frame2)
                ]
                one["place"] = array(data.local_frame1.translation.to_tuple())
                one["zero"] = matrix_to_quaternion(frames[0] @ frames[1].T)
                one["axis"] = frames[1][:, 0]
            for name, value in one.items():
                numbers.setdefault(name, []).append(value)
        q, u = self.state()
        stored = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
        stored["gravity"] = array(self._world.gravity.to_tuple())
        return TreeReadBack(self._world.integration_parameters.dt, stored | {"q": q, "u": u})


def vector(values: Array) -> Any:
    """(3,) -> Vec3."""
    from rapier3d import Vec3

    return Vec3(*(float(value) for value in values))


def isometry(place: Array, quaternion: Array) -> Any:
    """Return the pose of (3,) and (4,)."""
    from rapier3d import Isometry3, Rotation3

    return Isometry3(vector(place), Rotation3(*(float(value) for value in quaternion)))


def mass_properties(mass: float, inertia: Array, centre: Array) -> Any:
    """Return the MassProperties of an inertia (3, 3) about a centre (3,)."""
    from rapier3d import MassProperties, Rotation3

    moments, axes = diagonalised(inertia)
    return MassProperties(vector(centre), mass, vector(moments), Rotation3(*matrix_to_quaternion(axes)))


def unlimited(world: Any, built: Any) -> Any:
    """Return a body under construction that neither sleeps nor has a limit of its velocities."""
    world.integration_parameters.normalized_max_linear_velocity = float(np.finfo(np.float32).max)
    return built.can_sleep(False).gyroscopic_forces(True).allow_fast_rotation(True)


def tensor_of(solid: Any) -> Array:
    """Return the inertia (3, 3) of MassProperties."""
    rotation = quaternion_to_matrix(quaternion_of(solid.principal_inertia_local_frame))
    return np.asarray(rotation @ np.diag(array(solid.principal_inertia.to_tuple())) @ rotation.T)


def quaternion_of(rotation: Any) -> Array:
    """Return (4,) of a Rotation3."""
    return array((rotation.w, rotation.i, rotation.j, rotation.k))
