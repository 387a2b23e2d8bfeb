"""MuJoCo: one body without geometry, free or on a pivot, by every integrator of the installed version.

qpos is the position of the joint's frame and its quaternion; qvel is the velocity of that frame's origin in
world axes and omega in the frame's axes. The origin is the centre of mass, except for a link that is not
aligned. After mj_step, xpos, xmat and the sensors are one step old, so everything is read from qpos and qvel.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from bodycheck.adapters.contract import DEFAULTS, VARIANT, Method, ReadBack, Reading, Stepping
from bodycheck.adapters.frames import EngineAxes
from bodycheck.adapters.mujoco.mj_model import (
    BODY,
    OFF,
    PASSIVE_OFF,
    Build,
    Point,
    compiled,
    joint_axes,
    loaded_points,
    mass_properties,
    matrix_of,
    methods_of,
    variants_of,
)
from bodycheck.adapters.mujoco.mujoco_sensors import MuJoCoImu
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.imu import has_imu
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import Wrench, continuous_wrench_of

if TYPE_CHECKING:
    from bodycheck.adapters.batches import Batch, BatchAnswer
    from bodycheck.adapters.mujoco.passive_loads import CallbackLoads, PassiveLoads

_KNOWN = methods_of(mujoco.__version__)

# Only those of the installed version: older ones lack discrete.
_INTEGRATORS = {
    label: value
    for member, value in mujoco.mjtIntegrator.__members__.items()
    if (label := member.removeprefix("mjINT_").lower()) in _KNOWN
}

_BUILDS: dict[str, Build] = {
    "": "aligned",
    "defaults": "unaligned",
    "unaligned": "unaligned",
    "welded": "welded",
}
"""The variant of a method -> how the body is built."""

# With autoreset off, BADQPOS, BADQVEL and BADQACC only mean that a number is large or not finite, which the
# state shows too. After the following two, the engine continues with other numbers than it was given.
_ALTERING_WARNINGS = (mujoco.mjtWarning.mjWARN_INERTIA, mujoco.mjtWarning.mjWARN_BADCTRL)
# a member of the enumeration is slow as an index
_ALTERING_INDICES = [int(warning) for warning in _ALTERING_WARNINGS]
_BAD_SPEED_AT = int(mujoco.mjtWarning.mjWARN_BADQVEL)

_FULL_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS

# Times of the evaluations within a step, in steps.
_NODES = {"rk4": (0.0, 0.5, 0.5, 1.0)}


class MuJoCo:
    """MuJoCo (Todorov, Erez and Tassa 2012)."""

    name = "mujoco"
    version: str = mujoco.__version__
    methods: Mapping[str, Method] = {
        **{label: _KNOWN[label] for label in _INTEGRATORS},
        **variants_of([_KNOWN[label] for label in _INTEGRATORS]),
    }
    tree_model = "bodycheck.adapters.mujoco.tree:MuJoCoTree"

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse a mass or a principal moment below mjMINVAL, as MuJoCo's compiler does."""
        moments, _ = diagonalised(scene.body.inertia)
        smallest = min(scene.body.mass, float(np.min(moments)))
        if smallest < mujoco.mjMINVAL:
            return f"MuJoCo rejects a mass or inertia below {mujoco.mjMINVAL:g}, such as {smallest:g}"
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> MuJoCoSimulation:
        """Compile a model of one body with the actuators for the scene's loads."""
        return MuJoCoSimulation(scene, method, dt_s)

    def record_batch(self, batch: Batch) -> BatchAnswer | None:
        """Step free bodies in one call of `mujoco.rollout`; None for other batches."""
        if not batch.is_free or batch.setting.dt_s is None:
            return None
        from bodycheck.adapters.mujoco.rollouts import record_rollouts

        with _MutedWarnings():
            return record_rollouts(self, batch)


class MuJoCoSimulation:
    """A simulation with one mjModel and its mjData."""

    stepping: Stepping

    def __init__(self, scene: Scene, method: str, dt_s: float) -> None:
        label, _, variant = method.partition(VARIANT)
        with_defaults, build = method.endswith(DEFAULTS), _BUILDS[variant]
        off = () if with_defaults else OFF if scene.continuous_loads else OFF + PASSIVE_OFF
        self._initial, self._pivot = scene.initial, scene.pivot
        self._points = loaded_points(scene)
        self._model = compiled(scene, _INTEGRATORS[label], dt_s, self._points, off, build)
        self._solid = self._model.nbody - 1
        self._axes = EngineAxes(joint_axes(scene, build))
        self._arm = self._arm_of_the_joint()
        self._is_off_centre = bool(np.any(self._arm))
        self.stepping = "python" if scene.has_callback_load else "native"
        nodes = _NODES.get(label, (0.0,))
        self._continuous = self._passive_loads(scene, dt_s, nodes) if scene.continuous_loads else None
        self._data = mujoco.MjData(self._model)
        # views of the engine's memory: getting them from mjData again costs more than copying them
        self._qpos, self._qvel = self._data.qpos, self._data.qvel
        self._warned = self._data.warning.number
        if has_imu(scene) and not scene.continuous_loads:
            # compiled only where the motion is recorded
            self._imu = cache(partial(MuJoCoImu, scene, self._model, self._points, build))
            self.imu = self._read_imu
        self.reset()

    def _passive_loads(
        self, scene: Scene, dt_s: float, nodes: tuple[float, ...]
    ) -> PassiveLoads | CallbackLoads:
        """Return the continuous loads as MuJoCo's callback: compiled, unless there is a user's function."""
        # importing numba takes half of a worker's start, and most scenes have no such load
        from bodycheck.adapters.mujoco.passive_loads import CallbackLoads, PassiveLoads
        from bodycheck.reference_impl.continuous_loads import packed_continuous_loads

        axes, anchor = self._axes.matrix.T, None if scene.pivot is None else self._anchor()
        arm = self._axes.body_vector(self._arm)
        if scene.has_callback_load:
            return CallbackLoads(continuous_wrench_of(scene), axes, anchor, arm, dt_s, nodes)
        return PassiveLoads(packed_continuous_loads(scene), axes, anchor, arm, dt_s, nodes)

    def read_back(self) -> ReadBack:
        """Return the model as read from mjModel and mjData."""
        model, axes = self._model, self._axes.matrix
        properties, self._arm = mass_properties(model), self._arm_of_the_joint()
        return ReadBack(
            mass=properties.mass,
            inertia=axes @ properties.inertia @ axes.T,
            dt_s=float(model.opt.timestep),
            gravity=model.opt.gravity.copy(),
            state=self.read(),
        )

    def reset(self) -> None:
        """Call mj_resetData, which also clears forces and controls, and restore the initial state."""
        initial = self._initial
        mujoco.mj_resetData(self._model, self._data)
        self._qpos[-4:] = self._axes.engine_quaternion(initial.quaternion)
        self._qvel[-3:] = self._axes.engine_vector(initial.omega_body)
        if self._pivot is None:
            frame = matrix_of(self._qpos[-4:])
            arm, omega = frame @ self._arm, frame @ self._qvel[-3:]
            self._qpos[:3], self._qvel[:3] = initial.position - arm, initial.velocity - np.cross(omega, arm)
        if self._continuous is not None:
            self._continuous.reset()

    def apply(self, wrench: Wrench) -> None:
        """Write the wrench to inputs that the engine itself rotates into body axes at every stage.

        Raises ValueError for a load at a point where the scene has none.
        """
        data = self._data
        data.xfrc_applied[self._solid, :3] = wrench.force_world
        data.qfrc_applied[-3:] = self._axes.engine_vector(wrench.torque_body)
        data.xfrc_applied[self._solid, 3:] = wrench.torque_world
        if self._model.nu:
            self._model.actuator_gear[:, :3] = 0.0
            data.ctrl[:] = 1.0
        if np.any(wrench.force_body):
            self._push(None, wrench.force_body)
        for at, force in wrench.point_forces:
            self._push(tuple(at), force)

    def advance(self, steps: int) -> None:
        """Make the steps in one call of mj_step."""
        with _MutedWarnings():
            if self._continuous is None:
                mujoco.mj_step(self._model, self._data, nstep=steps)
                return
            with self._continuous.acting_on(self._data, steps):
                mujoco.mj_step(self._model, self._data, nstep=steps)

    def read(self) -> Reading:
        """Copy qpos and qvel; the matrix is mju_quat2Mat of qpos.

        Raises RuntimeError if MuJoCo warned that it continued with other numbers than it was given.
        """
        self._raise_altering_warnings()
        qpos, qvel = self._qpos.copy(), self._qvel.copy()
        rotation = matrix_of(qpos[-4:])
        if self._pivot is not None:
            position, velocity = self._anchor(), np.zeros(3)
        else:
            position, velocity = qpos[:3], qvel[:3]
        if self._is_off_centre:
            arm = rotation @ self._arm
            position, velocity = position + arm, velocity + np.cross(rotation @ qvel[-3:], arm)
        return Reading(
            position=position,
            velocity=velocity,
            quaternion=self._axes.body_quaternion(qpos[-4:]),
            rotation=self._axes.body_rotation(rotation),
            omega_body=self._axes.body_vector(qvel[-3:]),
        )

    def _read_imu(self) -> tuple[Array, Array]:
        """Return what an accelerometer and a gyro read in this state, under the present loads."""
        return self._imu().read(self._model, self._data)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self._model

    def state(self) -> Array:
        """Return the time, qpos and qvel as one array."""
        found = np.empty(mujoco.mj_stateSize(self._model, _FULL_STATE))
        mujoco.mj_getState(self._model, self._data, found, _FULL_STATE)
        return found

    def read_at(self, state: Array) -> Reading:
        """Return what `read` returns in a state, as `state` has it, of the same model."""
        mujoco.mj_setState(self._model, self._data, state, _FULL_STATE)
        return self.read()

    def close(self) -> None:
        """Do nothing; the model and the data are freed with this object."""

    def _anchor(self) -> Array:
        """Return the position (3,) in m of the ball joint in the world; the body's frame is not rotated."""
        return np.asarray(self._model.body_pos[BODY] + self._model.jnt_pos[0])

    def _arm_of_the_joint(self) -> Array:
        """Return the centre of mass (3,) in m from the joint's origin, in the axes of its frame."""
        centre = mass_properties(self._model).centre
        return centre if self._pivot is None else np.asarray(centre - self._model.jnt_pos[0])

    def _push(self, point: Point, force: Array) -> None:
        if point not in self._points:
            raise ValueError(f"no load of the scene acts at {np.asarray(point).tolist()}")
        self._model.actuator_gear[self._points.index(point), :3] += force

    def _raise_altering_warnings(self) -> None:
        counts = self._warned
        if counts[_BAD_SPEED_AT]:
            return  # beyond 1e10 rad/s the motion has diverged, which the state shows
        for warning, place in zip(_ALTERING_WARNINGS, _ALTERING_INDICES, strict=True):
            if counts[place]:
                raise RuntimeError(f"MuJoCo warned of {warning.name} in {counts[place]} evaluations")


class _MutedWarnings:
    """Keep MuJoCo's warnings off the terminal and out of MUJOCO_LOG.TXT; mjData still counts them.

    A class, because the generator of a `contextmanager` would take longer than a step.
    """

    def __enter__(self) -> None:
        self._handler = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(_ignore)

    def __exit__(self, *_: object) -> None:
        mujoco.set_mju_user_warning(self._handler)


def _ignore(message: str) -> None:
    """Ignore the message."""
