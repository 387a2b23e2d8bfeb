"""Trees in PyBullet: a btMultiBody without shapes.

Each link's inertial frame lies along its principal axes A, so the base's orientation is R A, and a ball has
the quaternion of A^T R A and A^T omega. Links are renumbered depth first, and found again by their names.
Bullet returns no accelerations, and wrenches only of a step: both take a step of 1e-7 s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import pybullet

from bodycheck.adapters.contract import DEFAULTS, VARIANT, TreeReadBack
from bodycheck.adapters.pybullet_substeps import powers_of_two, set_substeps
from bodycheck.adapters.tree_contract import (
    JointedLink,
    RateMap,
    TreeModel,
    UnreportedError,
    held_loads,
    jointed_links,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import (
    conjugate,
    matrix_to_quaternion,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene

_SHORT_S = 1e-7
_KINDS = {
    "hinge": pybullet.JOINT_REVOLUTE,
    "slide": pybullet.JOINT_PRISMATIC,
    "ball": pybullet.JOINT_SPHERICAL,
}
_BASE = -1


class PyBulletTree(TreeModel):
    """The only multibody of a client."""

    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "calculateMassMatrix; omega, then v, principal axes; joints depth first",
        "bias": "calculateInverseDynamics",
        "gravity_bias": "calculateInverseDynamics at rest",
        "accelerations": "(u(h) - u(0)) / h, h = 1e-7 s",
        "wrenches": "getJointState; principal axes, about the centre of mass",
        "poses": "getLinkState; principal axes",
    }
    known_faults: ClassVar[Mapping[str, str]] = {"wrenches": "Bullet's joint wrenches are wrong in motion"}
    resolution: ClassVar[Mapping[str, float]] = {"accelerations": 1e-5}

    _client: int | None = None

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        self._scene, self._links = scene, jointed_links(scene)
        kinds = [link.kind for link in self._links]
        self._is_floating = kinds[0] == "free"
        if reason := _unbuilt(self._links):
            raise UnreportedError(reason)
        if PyBulletTree._client is None:
            PyBulletTree._client = pybullet.connect(pybullet.DIRECT)
        self._at = {"physicsClientId": PyBulletTree._client}
        pybullet.resetSimulation(**self._at)
        self._axes = [diagonalised(link.inertia)[1] for link in self._links]
        self._body = self._created(self._links, masses_were)
        if masses_were != 1.0:
            self._set_inertias(self._links)
        pybullet.setGravity(*scene.gravity, **self._at)
        starts, start = [0] * len(self._links), 6 if self._is_floating else 0
        for k in self._order():
            starts[k] = start
            start += {"ball": 3}.get(kinds[k], 1)
        self._map = RateMap(scene, starts)

    def _created(
        self, links: Sequence[JointedLink], masses_were: float = 1.0, *, defaults: bool = False
    ) -> int:
        jointed = links[1:] if self._is_floating else links
        first = 0 if self._is_floating else 1
        base: dict[str, object] = {"baseMass": 0.0}
        if self._is_floating:
            base = {"baseMass": links[0].mass, "baseInertialFrameOrientation": _scalar_last(self._axes[0])}
        body = pybullet.createMultiBody(
            **base,
            linkMasses=[link.mass for link in jointed],
            linkCollisionShapeIndices=[-1] * len(jointed),
            linkVisualShapeIndices=[-1] * len(jointed),
            linkPositions=[link.place.tolist() for link in jointed],
            linkOrientations=[np.roll(link.zero, -1).tolist() for link in jointed],
            linkInertialFramePositions=[link.centre.tolist() for link in jointed],
            linkInertialFrameOrientations=[_scalar_last(axes) for axes in self._axes[1 - first :]],
            linkParentIndices=[link.parent + first for link in jointed],
            linkJointTypes=[_KINDS[link.kind] for link in jointed],
            linkJointAxis=[link.axis.tolist() for link in jointed],
            **self._at,
        )
        self._indices = [_BASE] * len(links)
        for index in range(pybullet.getNumJoints(body, **self._at)):
            name = pybullet.getJointInfo(body, index, **self._at)[1].decode()
            self._indices[int(name.removeprefix("joint")) - first] = index
        self._body = body
        self._set_inertias([*links], masses_were, defaults=defaults)
        for index, link in zip(self._indices, links, strict=True):
            if index == _BASE:
                continue
            pybullet.enableJointForceTorqueSensor(body, index, 1, **self._at)
            if defaults:
                continue
            if link.kind == "ball":
                pybullet.setJointMotorControlMultiDof(
                    body, index, pybullet.POSITION_CONTROL, targetPosition=[0, 0, 0, 1],
                    positionGain=0, velocityGain=0, force=[0, 0, 0], **self._at,
                )  # fmt: skip
            else:
                pybullet.setJointMotorControl2(body, index, pybullet.VELOCITY_CONTROL, force=0, **self._at)
        return int(body)

    def _set_inertias(
        self, links: Sequence[JointedLink], factor: float = 1.0, *, defaults: bool = False
    ) -> None:
        # together, these leave the inertia at zero, or change the base in place of the link
        for index, link in zip(self._indices, links, strict=True):
            moments = factor * diagonalised(link.inertia)[0]
            inertia = {"mass": factor * link.mass, "localInertiaDiagonal": moments.tolist()}
            undamped = {"linearDamping": 0, "angularDamping": 0, "jointDamping": 0}
            unclamped = {"maxJointVelocity": math.inf}
            for change in (inertia,) if defaults else (undamped, inertia, unclamped):
                pybullet.changeDynamics(self._body, index, **change, **self._at)

    def _order(self) -> list[int]:
        """Return the jointed bodies in Bullet's order."""
        return sorted(
            (k for k, index in enumerate(self._indices) if index != _BASE), key=self._indices.__getitem__
        )

    def set_state(self, q: Array, u: Array) -> None:
        """Set the pose and the velocities of the base, and each joint."""
        self._q, self._u, self._has_stepped = q, u, False
        scene = self._scene
        for k, (link, index) in enumerate(zip(self._links, self._indices, strict=True)):
            own, rates, axes = q[scene.coordinate_slices[k]], u[scene.rate_slices[k]], self._axes[k]
            if link.kind == "free":
                rotation = quaternion_to_matrix(own[3:])
                pybullet.resetBasePositionAndOrientation(
                    self._body, own[:3].tolist(), _scalar_last(rotation @ axes), **self._at
                )
                omega = rotation @ rates[3:]
                pybullet.resetBaseVelocity(self._body, rates[:3].tolist(), omega.tolist(), **self._at)
                block = np.zeros((6, 6))
                block[:3, 3:], block[3:, :3] = axes.T, axes.T @ rotation.T
                self._map.turn(k, block)
            elif link.kind == "ball":
                turned = axes.T @ quaternion_to_matrix(own) @ axes
                pybullet.resetJointStateMultiDof(
                    self._body, index, _scalar_last(turned), (axes.T @ rates).tolist(), **self._at
                )
                self._map.turn(k, axes.T)
            else:
                pybullet.resetJointState(self._body, index, own[0], rates[0], **self._at)

    def _without_balls(self) -> None:
        if any(link.kind == "ball" for link in self._links):
            raise UnreportedError(
                "its matrix of a tree with a ball joint is in coordinates that are not documented"
            )

    def mass_matrix(self) -> Array:
        """calculateMassMatrix at the joint positions."""
        self._without_balls()
        own = [float(self._q[self._scene.coordinate_slices[k]][0]) for k in self._order()]
        return self._map.mass_matrix(np.array(pybullet.calculateMassMatrix(self._body, own, **self._at)))

    def bias(self) -> Array:
        """calculateInverseDynamics without accelerations."""
        return self._inverse_dynamics(1.0)

    def gravity_bias(self) -> Array:
        """calculateInverseDynamics at rest."""
        return self._inverse_dynamics(0.0)

    def _inverse_dynamics(self, motion: float) -> Array:
        self._without_balls()
        if self._is_floating:
            raise UnreportedError("calculateInverseDynamics of a floating base is wrong or corrupts memory")
        scene = self._scene
        own = [float(self._q[scene.coordinate_slices[k]][0]) for k in self._order()]
        rates = [motion * float(self._u[scene.rate_slices[k]][0]) for k in self._order()]
        found = pybullet.calculateInverseDynamics(self._body, own, rates, [0.0] * len(own), **self._at)
        return self._map.bias(np.array(found))

    def accelerations(self) -> Array:
        """(u(h) - u(0)) / h of a step of h = 1e-7 s."""
        if self._has_stepped:
            raise UnreportedError("the engine returns no accelerations of a step")
        before, (_, after) = (self._q, self._u), self.step(_SHORT_S)
        self.set_state(*before)
        return (after - before[1]) / _SHORT_S

    def wrenches(self) -> Array:
        """getJointState: in principal axes, the moment about the centre of mass."""
        before, is_short = (self._q, self._u), not self._has_stepped
        if is_short:
            self.step(_SHORT_S)
        found = np.zeros((len(self._links), 6))
        for row, link, index, axes in zip(found, self._links, self._indices, self._axes, strict=True):
            if index == _BASE:
                continue
            read = pybullet.getJointStateMultiDof if link.kind == "ball" else pybullet.getJointState
            wrench = np.array(read(self._body, index, **self._at)[2])
            row[:3], row[3:] = axes @ wrench[:3], axes @ wrench[3:] + np.cross(link.centre, axes @ wrench[:3])
        if is_short:
            self.set_state(*before)
        return found

    def energy(self) -> Array:
        """Nothing."""
        raise UnreportedError("the engine has no call for it")

    momenta = energy

    def poses(self) -> Array:
        """getBasePositionAndOrientation and getLinkState, of inertial frames."""
        found = []
        for index, axes in zip(self._indices, self._axes, strict=True):
            if index == _BASE:
                place, quaternion = pybullet.getBasePositionAndOrientation(self._body, **self._at)
            else:
                state = pybullet.getLinkState(self._body, index, computeForwardKinematics=1, **self._at)
                place, quaternion = state[:2]
            found.append(np.concatenate([place, _body_quaternion(quaternion, axes)]))
        return np.array(found)

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """stepSimulation, as one step: the substeps of a motion survive resetSimulation."""
        set_substeps(self._at["physicsClientId"], dt_s, 1)
        pybullet.stepSimulation(**self._at)
        q, u = self.state()
        self._q, self._u, self._has_stepped = q, u, True
        return q, u

    # --------------------------------------------------------------------------------------------- motion

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:
        """Refuse maximal coordinates, springs and armatures."""
        name, _, _ = method.partition(VARIANT)
        if name != "multibody":
            return "a body in maximal coordinates has no joints"
        for what in ("stiffness", "armature"):
            if any(getattr(body.joint, what) for body in scene.bodies):
                return f"Bullet's joints have no {what}"
        return _unbuilt(jointed_links(scene))

    def start(self, method: str, dt_s: float) -> None:
        """Set dampers, step and state; for Bullet's defaults, build the bodies again, with motors."""
        _, _, variant = method.partition(VARIANT)
        self._substeps = 4 if variant == "substeps" else 1
        if VARIANT + variant == DEFAULTS:
            pybullet.removeBody(self._body, **self._at)
            self._body = self._created(self._links, defaults=True)
        for body, index in zip(self._scene.bodies, self._indices, strict=True):
            if body.joint.damping:
                pybullet.changeDynamics(self._body, index, jointDamping=body.joint.damping, **self._at)
        self._dt_s, self._steps = dt_s, 0
        self.set_state(self._scene.q0, self._scene.u0)

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Keep the loads, which Bullet forgets after every step."""
        self._loads = tuple(loads)
        # Bullet evaluates damping once per call, and holds it over the substeps
        is_damped = any(body.joint.damping for body in self._scene.bodies)
        self.stepping = "python" if loads or is_damped else "native"

    def advance(self, steps: int) -> None:
        """Make many steps in one call, unless loads or dampers are renewed in each."""
        if self.stepping == "native":
            for substeps in powers_of_two(steps * self._substeps):
                set_substeps(self._at["physicsClientId"], self._dt_s / self._substeps, substeps)
                pybullet.stepSimulation(**self._at)
        else:
            set_substeps(self._at["physicsClientId"], self._dt_s / self._substeps, self._substeps)
            for _ in range(steps):
                self._push_loads()
                pybullet.stepSimulation(**self._at)
                self._steps += 1

    def _push_loads(self) -> None:
        """Apply the loads at the present state.

        A force acts about the centre of mass of the last kinematics, which getLinkState computes again.
        """
        held = held_loads(self._scene, self._loads, self._steps * self._dt_s, self.state()[0])
        places = self.poses()[:, :3]
        loaded = {load.body for load, _ in self._loads}
        for k in loaded:
            index, axes, kind = self._indices[k], self._axes[k], self._links[k].kind
            if kind == "ball":
                pybullet.setJointMotorControlMultiDof(
                    self._body,
                    index,
                    pybullet.TORQUE_CONTROL,
                    force=(axes.T @ held.joint[k]).tolist(),
                    **self._at,
                )
            elif kind != "free":
                pybullet.setJointMotorControl2(
                    self._body, index, pybullet.TORQUE_CONTROL, force=held.joint[k][0], **self._at
                )
            pybullet.applyExternalForce(
                self._body,
                index,
                held.force[k].tolist(),
                places[k].tolist(),
                pybullet.WORLD_FRAME,
                **self._at,
            )
            pybullet.applyExternalTorque(
                self._body, index, held.torque[k].tolist(), pybullet.WORLD_FRAME, **self._at
            )

    def held(self) -> TreeReadBack:
        """Read getDynamicsInfo and getJointInfo, whose damping is the one at the creation of the body."""
        world = pybullet.getPhysicsEngineParameters(**self._at)
        numbers: dict[str, list[Any]] = {}
        for link, index, axes in zip(self._links, self._indices, self._axes, strict=True):
            info = pybullet.getDynamicsInfo(self._body, index, **self._at)
            held = quaternion_to_matrix(np.roll(info[4], 1))
            one: dict[str, Any] = {"mass": info[0], "inertia": held @ np.diag(info[2]) @ held.T}
            one["centre"] = info[3]
            if index == _BASE:
                place, zero, axis = link.place, link.zero, np.zeros(3)
            else:
                joint = pybullet.getJointInfo(self._body, index, **self._at)
                # the parent frame is relative to the parent's inertial frame
                before = self._links[link.parent] if link.parent >= 0 else None
                turned = self._axes[link.parent] if before is not None else np.eye(3)
                place = turned @ np.array(joint[14]) + (0.0 if before is None else before.centre)
                zero = matrix_to_quaternion(turned @ quaternion_to_matrix(np.roll(joint[15], 1)).T @ axes.T)
                axis = axes @ np.array(joint[13])
            one |= {"place": place, "zero": zero, "axis": axis}
            for name, value in one.items():
                numbers.setdefault(name, []).append(value)
        q, u = self.state()
        stored = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
        gravity = np.array([world[f"gravityAcceleration{axis}"] for axis in "XYZ"])
        return TreeReadBack(self._dt_s, stored | {"gravity": gravity, "q": q, "u": u})

    def state(self) -> tuple[Array, Array]:
        """Return the pose and velocities of the base, and the state of each joint."""
        q, u = [], []
        for link, index, axes in zip(self._links, self._indices, self._axes, strict=True):
            if link.kind == "free":
                place, quaternion = pybullet.getBasePositionAndOrientation(self._body, **self._at)
                velocity, omega = pybullet.getBaseVelocity(self._body, **self._at)
                own = _body_quaternion(quaternion, axes)
                q.append(np.concatenate([place, own]))
                u.append(np.concatenate([velocity, quaternion_to_matrix(own).T @ omega]))
            elif link.kind == "ball":
                quaternion, rates = pybullet.getJointStateMultiDof(self._body, index, **self._at)[:2]
                turned = axes @ quaternion_to_matrix(np.roll(quaternion, 1)) @ axes.T
                q.append(matrix_to_quaternion(turned))
                u.append(axes @ np.array(rates))
            else:
                coordinate, rate = pybullet.getJointState(self._body, index, **self._at)[:2]
                q.append(np.array([coordinate]))
                u.append(np.array([rate]))
        return np.concatenate(q), np.concatenate(u)


def _unbuilt(links: Sequence[JointedLink]) -> str | None:
    """Return why Bullet cannot build a tree; None if it can."""
    frees = [link.kind for link in links].count("free")
    roots = [link.parent for link in links].count(-1)
    if frees and (links[0].kind != "free" or roots > 1):
        return "a btMultiBody has one base: a free body is the first and the only root"
    return None


def _scalar_last(rotation: Array) -> list[float]:
    return np.roll(matrix_to_quaternion(rotation), -1).tolist()


def _body_quaternion(quaternion: Sequence[float], axes: Array) -> Array:
    """Return the quaternion of R, of that of R A, scalar last."""
    return quaternion_product(np.roll(quaternion, 1), conjugate(matrix_to_quaternion(axes)))
