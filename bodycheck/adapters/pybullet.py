"""PyBullet: one body without a shape, as btMultiBody or, in maximal coordinates, as btRigidBody.

A pivoted body is the only link of a massless base, on a spherical joint. The engine's own frame is the body's
principal frame at its centre of mass. A constant rotation converts every state to body axes; it is the
identity for a diagonal inertia tensor. Bullet clears forces after each call of stepSimulation, and rotates
torques from body axes into world axes once per call.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib.metadata import version

import numpy as np
import pybullet

from bodycheck.adapters.contract import DEFAULTS, VARIANT, Method, ReadBack, Reading, Stepping
from bodycheck.adapters.engine_loads import ZeroOrderHold
from bodycheck.adapters.frames import EngineAxes, link_frame, pivot_place
from bodycheck.adapters.pybullet_substeps import powers_of_two, set_substeps
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import hat, matrix_to_quaternion
from bodycheck.reference_impl.scene import ConstantLoad, PointForce, Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

_REFRESHED = "one step at rest before the start, to refresh the world inertia"

_TIME_STEP = "p.setTimeStep({dt_s})"
_UNDAMPED = "p.changeDynamics(body, -1, linearDamping=0, angularDamping=0, maxJointVelocity=math.inf)"
_MAXIMAL_BODY = (
    "body = p.createMultiBody(mass, useMaximalCoordinates=True); "
    "p.changeDynamics(body, -1, localInertiaDiagonal=inertia)"
)

_MULTIBODY = Method(
    name="multibody",
    formula="M1, step angle at most pi/4",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| = 1; linear momentum",
    source="Bullet btMultiBody::computeAccelerationsArticulatedBodyAlgorithmMultiDof, stepPositionsMultiDof",
    changed_defaults=(
        "damping 0",
        "velocity clamp removed",
        "deactivation off",
    ),
    snippet=f"{_TIME_STEP}; {_UNDAMPED}",
)

_MAXIMAL = Method(
    name="maximal",
    formula="M3, step angle at most pi/4",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| = 1; linear momentum",
    source="Bullet btRigidBody::computeGyroscopicImpulseImplicit_Body (Catto 2015)",
    changed_defaults=("deactivation off", _REFRESHED),
    snippet=f"{_TIME_STEP}; {_MAXIMAL_BODY}",
)

_LINK = 0  # index of a pivoted body, the only link of its base

_SUBSTEPS, _SUBSTEPPED = 4, f"{VARIANT}substeps"
_SUBSTEP_SETTING = f"p.setPhysicsEngineParameter(fixedTimeStep={{dt_s}}, numSubSteps={_SUBSTEPS})"

_DAMPING = "velocities damped by 0.04 (1 + |v|) per second and clamped at 100, then "

_VARIANTS = tuple(
    variant
    for method, changed, damping in ((_MULTIBODY, (), _DAMPING), (_MAXIMAL, (_REFRESHED,), ""))
    for variant in (
        replace(
            method,
            name=f"{method.name}{DEFAULTS}",
            formula=f"{damping}{method.formula}",
            changed_defaults=changed,
            snippet=method.snippet.removesuffix(f"; {_UNDAMPED}"),
        ),
        replace(
            method,
            name=f"{method.name}{_SUBSTEPPED}",
            formula=f"{method.formula}, {_SUBSTEPS} steps per step",
            evaluations=_SUBSTEPS,
            changed_defaults=(*method.changed_defaults, f"numSubSteps {_SUBSTEPS}"),
            snippet=method.snippet.replace(_TIME_STEP, _SUBSTEP_SETTING),
        ),
    )
)


class PyBullet:
    """PyBullet (Coumans and Bai 2016-2025)."""

    name = "pybullet"
    version: str = version("pybullet")
    methods: Mapping[str, Method] = {method.name: method for method in (_MULTIBODY, _MAXIMAL, *_VARIANTS)}
    tree_model = "bodycheck.adapters.pybullet_tree:PyBulletTree"

    def __init__(self) -> None:
        self._idle_clients: list[int] = []  # connecting costs a hundred times as much as building a body

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse some pivots.

        Where |omega| h exceeds pi/4 in a step, Bullet rotates the body by less than |omega| h.
        """
        if scene.pivot is None:
            return None
        if method.startswith(_MAXIMAL.name):
            return "in maximal coordinates a pivot is a soft constraint, about 1e-5 m wide at 1e-3 s"
        if method.endswith(DEFAULTS):
            return "by default, Bullet's own motor would hold a pivoted body; it has to be disabled"
        if method.endswith(_SUBSTEPPED):
            return "pivoted bodies are only measured without substeps"
        if scene.link is not None:
            return "Bullet supports a pivoted link only in its principal axes at the pivot"
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> PyBulletSimulation | PivotedPyBulletSimulation:
        """Build the body in its own world."""
        client = self._idle_clients.pop() if self._idle_clients else pybullet.connect(pybullet.DIRECT)
        release = self._idle_clients.append
        try:
            if scene.pivot is not None:
                return PivotedPyBulletSimulation(scene, dt_s, client, release)
            return PyBulletSimulation(scene, method, dt_s, client, release)
        except BaseException:
            pybullet.disconnect(client)  # its world may hold a half-built body
            raise


class PyBulletSimulation:
    """One client's world with one body; close removes the body and returns the client to the adapter."""

    stepping: Stepping

    def __init__(
        self, scene: Scene, method: str, dt_s: float, client: int, release: Callable[[int], None]
    ) -> None:
        needs_python = scene.continuous_loads or not all(
            _is_uniform(load) for load in scene.piecewise_constant_loads
        )
        self.stepping = "python" if needs_python else "native"
        self._client, self._release, self._closed = client, release, False
        self._gravity = scene.gravity
        # dt_s / substeps is exact, because the number of substeps is a power of two
        self._substeps = _SUBSTEPS if method.endswith(_SUBSTEPPED) else 1
        self._substep_s = dt_s / self._substeps
        moments, axes = diagonalised(scene.body.inertia)
        self._axes = EngineAxes(axes)
        self._initial = scene.initial
        self._continuous = ZeroOrderHold(scene, dt_s)
        self._is_maximal = method.startswith(_MAXIMAL.name)
        self._body = _add_free_body(client, scene, method, moments, axes)
        self.reset()

    def read_back(self) -> ReadBack:
        """Return the model as read from the engine."""
        model = _read_back(self._client, self._body, -1, self._axes.matrix, self.read())
        assert model.dt_s is not None
        return replace(model, dt_s=model.dt_s * self._substeps)

    def reset(self) -> None:
        """Restore the initial state, without a wrench, as freshly built."""
        set_substeps(self._client, self._substep_s, self._substeps)
        if self._is_maximal:
            self._refresh_world_inertia()
        self.apply(NO_WRENCH)
        pybullet.setGravity(*self._gravity, physicsClientId=self._client)
        self._set_state(self._initial.velocity, self._initial.omega_world)
        self._continuous.reset()

    def _refresh_world_inertia(self) -> None:
        """Make one step at rest in the initial pose.

        A btRigidBody updates its world inertia only in a step. Without this one, its first torque would act
        on a zero inverse inertia, which does not happen for a body loaded from a file.
        """
        at_rest = np.zeros(3)
        self._set_state(at_rest, at_rest)
        pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=self._client)
        pybullet.stepSimulation(self._client)

    def apply(self, wrench: Wrench) -> None:
        """Prepare the engine's calls, which advance makes before each step or group of steps."""
        to_engine = self._axes.engine_vector
        torque_body, force_body = to_engine(wrench.torque_body), to_engine(wrench.force_body)
        force_world, torque_map = wrench.force_world, np.zeros((3, 9))
        for at, force in wrench.point_forces:
            force_world = force_world + force
            torque_map += np.kron(hat(-force), to_engine(at))

        self._rotates_with_body = bool(np.any(torque_body) or np.any(force_body) or np.any(torque_map))
        push_torque = partial(pybullet.applyExternalTorque, self._body, -1, physicsClientId=self._client)
        push_force = partial(pybullet.applyExternalForce, self._body, -1, physicsClientId=self._client)
        body_axes, world_axes, centre = pybullet.LINK_FRAME, pybullet.WORLD_FRAME, (0.0, 0.0, 0.0)
        self._pushes: list[Callable[[], None]] = []
        if np.any(torque_body):
            self._pushes.append(partial(push_torque, tuple(torque_body), body_axes))
        if np.any(wrench.torque_world):
            self._pushes.append(partial(push_torque, tuple(wrench.torque_world), world_axes))
        if np.any(force_body):
            self._pushes.append(partial(push_force, tuple(force_body), centre, body_axes))
        if np.any(force_world) or np.any(torque_map):
            self._pushes.append(partial(self._push_in_world, tuple(force_world), torque_map))

    def advance(self, steps: int) -> None:
        """Make many steps in one call, unless the wrench rotates with the body and changes at every step."""
        if self._rotates_with_body or self._continuous:
            set_substeps(self._client, self._substep_s, self._substeps)
            for _ in range(steps):
                if self._continuous:
                    self._push_continuous_loads()
                self._step()
        else:
            for substeps in powers_of_two(steps * self._substeps):
                set_substeps(self._client, self._substep_s, substeps)
                self._step()

    def read(self) -> Reading:
        """Copy the state; the matrix is getMatrixFromQuaternion of the engine's own quaternion."""
        position, (x, y, z, w) = pybullet.getBasePositionAndOrientation(self._body, self._client)
        velocity, omega_world = pybullet.getBaseVelocity(self._body, self._client)
        return Reading(
            position=np.array(position),
            velocity=np.array(velocity),
            quaternion=self._axes.body_quaternion(np.array((w, x, y, z))),
            rotation=self._axes.body_rotation(_matrix((x, y, z, w))),
            omega_world=np.array(omega_world),
        )

    def close(self) -> None:
        """Remove the body from its world and return the client."""
        if not self._closed:
            self._closed = True
            pybullet.removeBody(self._body, self._client)  # resetSimulation takes five times as long
            self._release(self._client)

    def _step(self) -> None:
        for push in self._pushes:
            push()
        pybullet.stepSimulation(self._client)

    def _push_continuous_loads(self) -> None:
        """Apply the continuous loads at the present state, constant over the step (zero-order hold)."""
        position, quaternion = pybullet.getBasePositionAndOrientation(self._body, self._client)
        velocity, omega = pybullet.getBaseVelocity(self._body, self._client)
        rotation = self._axes.body_rotation(_matrix(quaternion))
        wrench = self._continuous.next_wrench(
            np.array(position), rotation, np.array(velocity), np.array(omega)
        )
        world = pybullet.WORLD_FRAME
        pybullet.applyExternalForce(self._body, -1, wrench[:3], position, world, self._client)
        pybullet.applyExternalTorque(self._body, -1, wrench[3:], world, self._client)

    def _set_state(self, velocity: Array, omega_world: Array) -> None:
        """Set the initial pose and a velocity."""
        w, x, y, z = self._axes.engine_quaternion(self._initial.quaternion)
        position = self._initial.position
        pybullet.resetBasePositionAndOrientation(self._body, position, (x, y, z, w), self._client)
        pybullet.resetBaseVelocity(self._body, velocity, omega_world, self._client)

    def _push_in_world(self, force: tuple[float, ...], torque_map: Array) -> None:
        """Apply a world force at the centre of mass, and the torque sum R at x F = torque_map vec(R).

        The engine's own call takes absolute points, whose arms would be rounded far from the origin.
        """
        position, quaternion = pybullet.getBasePositionAndOrientation(self._body, self._client)
        torque = torque_map @ pybullet.getMatrixFromQuaternion(quaternion)
        world = pybullet.WORLD_FRAME
        pybullet.applyExternalForce(self._body, -1, force, position, world, self._client)
        pybullet.applyExternalTorque(self._body, -1, torque, world, self._client)


def _add_free_body(client: int, scene: Scene, method: str, moments: Array, axes: Array) -> int:
    """Put one body into an empty world, its inertial frame placed relative to the link."""
    frame = {}
    if scene.link is not None:
        link = link_frame(scene)
        w, x, y, z = link.rotated(matrix_to_quaternion(axes))
        frame = {
            "baseInertialFramePosition": link.point(np.zeros(3)),
            "baseInertialFrameOrientation": (x, y, z, w),
        }
    maximal, mass = method.startswith(_MAXIMAL.name), scene.body.mass
    body: int = pybullet.createMultiBody(
        baseMass=mass, useMaximalCoordinates=maximal, physicsClientId=client, **frame
    )
    # A body without a shape has no inertia; setting it without the mass makes a btRigidBody static.
    change_dynamics = partial(
        pybullet.changeDynamics, body, -1, mass=mass, localInertiaDiagonal=moments, physicsClientId=client
    )
    if method.endswith(DEFAULTS):
        change_dynamics()
    else:
        change_dynamics(
            linearDamping=0.0,
            angularDamping=0.0,
            maxJointVelocity=math.inf,  # it also clamps the components of the base's velocities
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        )
    return body


def _is_uniform(load: ConstantLoad) -> bool:
    """Return whether the load is constant in world axes for any rotation of the body."""
    return load.axes == "world" and not (isinstance(load, PointForce) and bool(np.any(load.at)))


class PivotedPyBulletSimulation:
    """One client's world with one pivoted body; close removes the body and returns the client.

    The body is built in its principal axes, because Bullet rotates a spherical joint in the axes of the
    link's inertia. The joint's state is the orientation and omega in those axes; getLinkState is accurate to
    5e-8 only. Loads act as a torque of the joint: a torque in the link's frame would be rotated by the
    previous step's pose.
    """

    stepping: Stepping

    def __init__(self, scene: Scene, dt_s: float, client: int, release: Callable[[int], None]) -> None:
        assert scene.pivot is not None
        self.stepping = "python" if scene.loads else "native"
        self._client, self._release, self._closed = client, release, False
        self._dt_s, self._initial, self._arm = dt_s, scene.initial, -scene.pivot
        moments, axes = diagonalised(scene.body.inertia)
        self._axes = EngineAxes(axes)
        self._continuous = ZeroOrderHold(scene, dt_s)
        self._body = _add_pivoted_body(client, scene, moments, self._axes.engine_vector(self._arm))
        pybullet.setGravity(*scene.gravity, physicsClientId=client)
        self.reset()

    def read_back(self) -> ReadBack:
        """Return the model as read from the engine."""
        return _read_back(self._client, self._body, _LINK, self._axes.matrix, self.read())

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
        rotation = self._axes.body_rotation(_matrix((x, y, z, w)))
        omega_body = self._axes.body_vector(np.array(omega))
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


def _add_pivoted_body(client: int, scene: Scene, moments: Array, centre: Array) -> int:
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


def _read_back(client: int, body: int, link: int, axes: Array, state: Reading) -> ReadBack:
    """I = A diag(moments) A^T: read the model from getDynamicsInfo and getPhysicsEngineParameters.

    link: index of the link, -1 for the base. axes A (3, 3): the engine's axes as columns, in body axes.
    """
    mass, _, moments, *_ = pybullet.getDynamicsInfo(body, link, client)
    world = pybullet.getPhysicsEngineParameters(client)
    return ReadBack(
        mass=mass,
        inertia=axes @ np.diag(moments) @ axes.T,
        dt_s=world["fixedTimeStep"] / world["numSubSteps"],
        gravity=np.array([world[f"gravityAcceleration{axis}"] for axis in "XYZ"]),
        state=state,
    )


def _matrix(quaternion: tuple[float, ...]) -> Array:
    """getMatrixFromQuaternion(q): (x, y, z, w) -> (3, 3)."""
    return np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
