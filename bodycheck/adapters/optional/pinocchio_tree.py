"""Trees in Pinocchio: its algorithms at a state. Its users write the steps.

A quaternion is scalar last; the rates of a free-flyer are velocity and omega, both in body axes. Joints are
added depth first: otherwise crba returns a wrong matrix without an error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.contract import TreeReadBack
from bodycheck.adapters.optional.between_steps import scalar_first, scalar_last
from bodycheck.adapters.optional.pinocchio_loops import PinocchioLoops
from bodycheck.adapters.tree_contract import (
    JointedLink,
    RateMap,
    TreeModel,
    depth_first,
    joint_forces,
    jointed_links,
    link_poses,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene


class PinocchioTree(PinocchioLoops, TreeModel):
    """A model, its data and a state."""

    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "crba; v and omega in body axes; joints depth first",
        "bias": "nonLinearEffects",
        "gravity_bias": "computeGeneralizedGravity",
        "accelerations": "aba",
        "wrenches": "data.f of rnea; child axes, at the joint",
        "energy": "computeKineticEnergy, computePotentialEnergy",
        "momenta": "data.hg of ccrba; about the centre of mass",
        "poses": "data.oMi; of the joint",
    }

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        import pinocchio

        self._pin: Any = pinocchio
        self._scene, self._links = scene, jointed_links(scene)
        self._model = pinocchio.Model()
        self._model.gravity = pinocchio.Motion(scene.gravity, np.zeros(3))
        self._joints = [0] * len(self._links)
        for k in depth_first(self._links):
            link = self._links[k]
            place = pinocchio.SE3(quaternion_to_matrix(link.zero), link.place)
            parent = 0 if link.parent < 0 else self._joints[link.parent]
            self._joints[k] = self._model.addJoint(parent, self._kind(link), place, link.name)
            solid = pinocchio.Inertia(masses_were * link.mass, link.centre, masses_were * link.inertia)
            self._model.appendBodyToJoint(self._joints[k], solid, pinocchio.SE3.Identity())
        self._data = self._model.createData()
        if masses_were != 1.0:
            for link, joint in zip(self._links, self._joints, strict=True):
                self._model.inertias[joint] = pinocchio.Inertia(link.mass, link.centre, link.inertia)
        self._map = RateMap(scene, [int(self._model.idx_vs[joint]) for joint in self._joints])

    def _kind(self, link: JointedLink) -> Any:
        if link.kind == "free":
            return self._pin.JointModelFreeFlyer()
        if link.kind == "ball":
            return self._pin.JointModelSpherical()
        unaligned = {
            "hinge": self._pin.JointModelRevoluteUnaligned,
            "slide": self._pin.JointModelPrismaticUnaligned,
        }
        return unaligned[link.kind](link.axis)

    def set_state(self, q: Array, u: Array) -> None:
        """Keep q and v, which every algorithm takes."""
        self._q = np.empty(self._model.nq)
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            own = q[part]
            if link.kind in ("ball", "free"):
                own = np.concatenate([own[:-4], scalar_last(own[-4:])])
            start = int(self._model.idx_qs[self._joints[k]])
            self._q[start : start + len(own)] = own
            if link.kind == "free":
                rotation, rates = quaternion_to_matrix(q[part][3:]), u[self._scene.rate_slices[k]]
                block = np.eye(6)
                block[:3, :3] = rotation.T
                turning = np.concatenate([-np.cross(rates[3:], rotation.T @ rates[:3]), np.zeros(3)])
                self._map.turn(k, block, turning)
        self._v = self._map.rates(u)

    def mass_matrix(self) -> Array:
        """Crba, whose lower triangle is not filled."""
        return self._map.mass_matrix(self._crba())

    def _crba(self) -> Array:
        upper = np.triu(np.array(self._pin.crba(self._model, self._data, self._q)))
        return np.asarray(upper + np.triu(upper, 1).T)

    def bias(self) -> Array:
        """nonLinearEffects."""
        found = np.array(self._pin.nonLinearEffects(self._model, self._data, self._q, self._v))
        return self._map.bias(found, self._crba())

    def gravity_bias(self) -> Array:
        """computeGeneralizedGravity."""
        return self._map.bias(np.array(self._pin.computeGeneralizedGravity(self._model, self._data, self._q)))

    def accelerations(self) -> Array:
        """Aba without torques."""
        return self._map.accelerations(self._aba())

    def _aba(self) -> Array:
        none = np.zeros(self._model.nv)
        return np.array(self._pin.aba(self._model, self._data, self._q, self._v, none))

    def wrenches(self) -> Array:
        """data.f after rnea with the accelerations of aba."""
        self._pin.rnea(self._model, self._data, self._q, self._v, self._aba())
        return np.array([np.array(self._data.f[joint].vector) for joint in self._joints])

    def energy(self) -> Array:
        """computeKineticEnergy and computePotentialEnergy."""
        kinetic = self._pin.computeKineticEnergy(self._model, self._data, self._q, self._v)
        return np.array([kinetic, self._pin.computePotentialEnergy(self._model, self._data, self._q)])

    def momenta(self) -> Array:
        """data.hg of ccrba, about the centre of mass data.com[0]."""
        self._pin.ccrba(self._model, self._data, self._q, self._v)
        linear, centre = np.array(self._data.hg.linear), np.array(self._data.com[0])
        return np.concatenate([linear, np.array(self._data.hg.angular) + np.cross(centre, linear)])

    def poses(self) -> Array:
        """data.oMi of forwardKinematics."""
        self._pin.forwardKinematics(self._model, self._data, self._q)
        poses = [self._data.oMi[joint] for joint in self._joints]
        return link_poses(
            self._links,
            [np.array(pose.translation) for pose in poses],
            [np.array(pose.rotation) for pose in poses],
        )

    # --------------------------------------------------------------------------------------------- motion

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Refuse armatures."""
        return "the adapter gives joints no armature" if any(b.joint.armature for b in scene.bodies) else None

    def start(self, method: str, dt_s: float) -> None:
        """Choose the loop of the method, and set the start."""
        self._step = self._rk4 if method == "rk4" else self._semi_implicit
        self._dt_s, self._steps_made = dt_s, 0
        self.push(())
        self.set_state(self._scene.q0, self._scene.u0)

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Keep the loads, which act at every evaluation."""
        self._loads = tuple(loads)

    def _acceleration(self, t_s: float, q: Array, v: Array) -> Array:
        """Aba under the loads, springs and dampers at this state."""
        forces = np.zeros(self._model.nv)
        if self._loads or any(body.joint.damping or body.joint.stiffness for body in self._scene.bodies):
            own = self._own(q, v)
            forces = self._map.rates(joint_forces(self._scene, self._loads, t_s, *own))
        return np.array(self._pin.aba(self._model, self._data, q, v, forces))

    def _own(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return q and u in the conventions of trees."""
        parts = []
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            start = int(self._model.idx_qs[self._joints[k]])
            own = np.array(q[start : start + part.stop - part.start])
            if link.kind in ("ball", "free"):
                own = np.concatenate([own[:-4], scalar_first(own[-4:])])
            if link.kind == "free":
                block = np.eye(6)
                block[:3, :3] = quaternion_to_matrix(own[3:]).T
                self._map.turn(k, block)
            parts.append(own)
        return np.concatenate(parts), self._map.own_rates(v)

    def state(self) -> tuple[Array, Array]:
        """Return q and v of the loop."""
        return self._own(self._q, self._v)

    def held(self) -> TreeReadBack:
        """Read the model; the step is this loop's."""
        model, joints = self._model, self._joints
        q, u = self.state()
        numbers = {
            "mass": [model.inertias[joint].mass for joint in joints],
            "inertia": [np.array(model.inertias[joint].inertia) for joint in joints],
            "centre": [np.array(model.inertias[joint].lever) for joint in joints],
            "place": [np.array(model.jointPlacements[joint].translation) for joint in joints],
            "zero": [
                matrix_to_quaternion(np.array(model.jointPlacements[joint].rotation)) for joint in joints
            ],
            "gravity": np.array(model.gravity.linear),
            "q": q,
            "u": u,
        }
        stored = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
        return TreeReadBack(self._dt_s, stored)
