"""PyBullet: a pivoted body as the only link of a massless base, on a spherical joint.

The body is built in its principal axes, because Bullet rotates a spherical joint in the axes of the link's
inertia. The joint's state is the orientation and omega in those axes; getLinkState is accurate to 5e-8 only.
Loads act as a torque of the joint: a torque in the link's frame would be rotated by the previous step's pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pybullet

from bodycheck.adapters.contract import ReadBack, Reading, Stepping
from bodycheck.adapters.engine_loads import ZeroOrderHold
from bodycheck.adapters.frames import EngineAxes, pivot_place
from bodycheck.adapters.pybullet.bullet_calls import powers_of_two, read_back, set_substeps
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

_LINK = 0


class PivotedPyBulletSimulation:
    """One client's world with one pivoted body; close removes the body and returns the client."""

    stepping: Stepping

    def __init__(self, scene: Scene, dt_s: float, client: int, release: Callable[[int], None]) -> None:
        assert scene.pivot is not None
        self.stepping = "python" if scene.loads else "native"
        self._client, self._release, self._closed = client, release, False
        self._dt_s, self._initial, self._arm = dt_s, scene.initial, -scene.pivot
        moments, axes = diagonalised(scene.body.inertia)
        self._axes = EngineAxes(axes)
        self._continuous = ZeroOrderHold(scene, dt_s)
        self._body = _add_body(client, scene, moments, self._axes.engine_vector(self._arm))
        pybullet.setGravity(*scene.gravity, physicsClientId=client)
        self.reset()

    def read_back(self) -> ReadBack:
        """Return the model as read from the engine."""
        return read_back(self._client, self._body, _LINK, self._axes.matrix, self.read())

    def reset(self) -> None:
        """Restore the initial state, without a wrench."""
        w, x, y, z = self._axes.engine_quaternion(self._initial.quaternion)
        omega = self._axes.engine_vector(self._initial.omega_body)
        pybullet.resetJointStateMultiDof(
            self._body, _LINK, (x, y, z, w), tuple(omega), physicsClientId=self._client
        )
        set_substeps(self._client, self._dt_s, 1)
        self._continuous.reset()
        self.apply(NO_WRENCH)

    def apply(self, wrench: Wrench) -> None:
        """Store the wrench, whose moment about the pivot is set before each step."""
        self._wrench = wrench

    def advance(self, steps: int) -> None:
        """Make many steps in one call, unless a load rotates with the body and is set at every step."""
        if self._wrench.is_zero and not self._continuous:
            for substeps in powers_of_two(steps):
                set_substeps(self._client, self._dt_s, substeps)
                pybullet.stepSimulation(self._client)
            return
        set_substeps(self._client, self._dt_s, 1)
        for _ in range(steps):
            self._push()
            pybullet.stepSimulation(self._client)

    def read(self) -> Reading:
        """Copy the joint's state; the matrix is getMatrixFromQuaternion of the engine's own quaternion."""
        (x, y, z, w), omega, *_ = pybullet.getJointStateMultiDof(self._body, _LINK, self._client)
        matrix = np.array(pybullet.getMatrixFromQuaternion((x, y, z, w))).reshape(3, 3)
        rotation, omega_body = self._axes.body_rotation(matrix), self._axes.body_vector(np.array(omega))
        arm = rotation @ self._arm
        place, _ = pybullet.getBasePositionAndOrientation(self._body, self._client)
        return Reading(
            position=np.array(place) + arm,
            velocity=np.cross(rotation @ omega_body, arm),
            quaternion=self._axes.body_quaternion(np.array((w, x, y, z))),
            rotation=rotation,
            omega_body=omega_body,
        )

    def close(self) -> None:
        """Remove the body from its world and return the client."""
        if not self._closed:
            self._closed = True
            pybullet.removeBody(self._body, self._client)
            self._release(self._client)

    def _push(self) -> None:
        """Set the joint's torque for one step: the moment about the pivot of all loads except gravity."""
        state = self.read()
        assert state.rotation is not None
        assert state.omega_body is not None
        moment = self._moment(state.rotation)
        if self._continuous:
            omega_world = state.rotation @ state.omega_body
            continuous = self._continuous.next_wrench(
                state.position, state.rotation, state.velocity, omega_world
            )
            moment += state.rotation.T @ continuous[3:] + np.cross(
                self._arm, state.rotation.T @ continuous[:3]
            )
        pybullet.setJointMotorControlMultiDof(
            self._body,
            _LINK,
            pybullet.TORQUE_CONTROL,
            force=tuple(self._axes.engine_vector(moment)),
            physicsClientId=self._client,
        )

    def _moment(self, rotation: Array) -> Array:
        """Return the moment (3,) of the wrench about the pivot, in body axes."""
        wrench = self._wrench
        force = wrench.force_body + wrench.force_world @ rotation
        moment = wrench.torque_body + wrench.torque_world @ rotation + np.cross(self._arm, force)
        for at, push in wrench.point_forces:
            moment += np.cross(self._arm + at, push @ rotation)
        return np.asarray(moment)


def _add_body(client: int, scene: Scene, moments: Array, centre: Array) -> int:
    """Put a massless base into an empty world, and the body on it."""
    identity = (0.0, 0.0, 0.0, 1.0)
    body: int = pybullet.createMultiBody(
        baseMass=0.0,
        basePosition=pivot_place(scene),
        linkMasses=[scene.body.mass],
        linkCollisionShapeIndices=[-1],
        linkVisualShapeIndices=[-1],
        linkPositions=[(0.0, 0.0, 0.0)],
        linkOrientations=[identity],
        linkInertialFramePositions=[centre],
        linkInertialFrameOrientations=[identity],
        linkParentIndices=[0],
        linkJointTypes=[pybullet.JOINT_SPHERICAL],
        linkJointAxis=[(0.0, 0.0, 1.0)],
        physicsClientId=client,
    )
    # Setting a velocity limit with the first inertia makes a link without a shape NaN; setting it with the
    # mass halves the inertia.
    pybullet.changeDynamics(body, _LINK, localInertiaDiagonal=moments, physicsClientId=client)
    pybullet.changeDynamics(
        body,
        _LINK,
        localInertiaDiagonal=moments,
        linearDamping=0.0,
        angularDamping=0.0,
        jointDamping=0.0,
        maxJointVelocity=math.inf,
        physicsClientId=client,
    )
    pybullet.setJointMotorControlMultiDof(
        body,
        _LINK,
        pybullet.POSITION_CONTROL,
        targetPosition=identity,
        force=[0.0, 0.0, 0.0],
        physicsClientId=client,
    )
    return body
