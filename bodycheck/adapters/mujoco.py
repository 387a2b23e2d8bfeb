"""MuJoCo: one free body without geometry, by every integrator of the installed version.

qpos is the position of the body's origin, here its centre of mass, and its quaternion; qvel is the
velocity of that point in world axes and omega in body axes. What mj_step leaves in xpos, xmat and the
sensors is a step old, so everything is read from qpos and qvel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import mujoco
import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Stepping, beyond_constant_loads
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reference_impl.scene import PointForce, Scene
from bodycheck.reference_impl.wrench import Wrench

_MANUAL = "MuJoCo documentation, Computation, Numerical integration"
_KEEPS = "|q| = 1; linear momentum"
_CHANGED = ("autoreset off", "constraints, contacts, springs, dampers and sensors off")
_EXPLICIT = "omega += h I^-1 (tau - omega x I omega); q = q exp(h omega)"
_IMPLICIT = (
    "omega += h (I + h D)^-1 (tau - omega x I omega), D = d(omega x I omega)/domega; q = q exp(h omega)"
)


def _one_evaluation(name: str, formula: str) -> Method:
    return Method(name, formula, 1, 1, "held over the step", _KEEPS, _MANUAL, changed_defaults=_CHANGED)


_KNOWN = {
    "euler": _one_evaluation("euler", _EXPLICIT),
    "rk4": Method(
        name="rk4",
        formula="classical Runge-Kutta 4 on the rotation group: q = q exp(h sum b_i k_i)",
        order=4,
        evaluations=4,
        torque="every stage",
        keeps=_KEEPS,
        source=_MANUAL,
        changed_defaults=_CHANGED,
    ),
    "implicit": _one_evaluation("implicit", _IMPLICIT),
    "implicitfast": _one_evaluation("implicitfast", _IMPLICIT),
    "discrete": _one_evaluation("discrete", _IMPLICIT),
}

# Only what the installed version has: discrete came late in the series.
_INTEGRATORS = {
    label: value
    for member, value in mujoco.mjtIntegrator.__members__.items()
    if (label := member.removeprefix("mjINT_").lower()) in _KNOWN
}

_OFF = (
    mujoco.mjtDisableBit.mjDSBL_AUTORESET,  # it would put a body that grew unstable back to rest, in silence
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    mujoco.mjtDisableBit.mjDSBL_CONTACT,
    mujoco.mjtDisableBit.mjDSBL_SPRING,
    mujoco.mjtDisableBit.mjDSBL_DAMPER,
    mujoco.mjtDisableBit.mjDSBL_EULERDAMP,
    mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL,
    mujoco.mjtDisableBit.mjDSBL_SENSOR,
)

# With autoreset off, BADQPOS, BADQVEL and BADQACC only say that a number is large or not finite, and the
# state tells that itself. After these two the engine went on with other numbers than it was given.
_ALTERING = (mujoco.mjtWarning.mjWARN_INERTIA, mujoco.mjtWarning.mjWARN_BADCTRL)

_BODY = 1  # body 0 is the world


class MuJoCo:
    """MuJoCo (Todorov, Erez and Tassa 2012)."""

    name = "mujoco"
    version: str = mujoco.__version__
    methods: Mapping[str, Method] = {label: _KNOWN[label] for label in _INTEGRATORS}

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse what is not built, and a mass or a moment below mjMINVAL, as MuJoCo's compiler does."""
        if reason := beyond_constant_loads(scene):
            return reason
        moments, _ = diagonalised(scene.body.inertia)
        smallest = min(scene.body.mass, float(np.min(moments)))
        if smallest < mujoco.mjMINVAL:
            return f"MuJoCo takes no mass or inertia below {mujoco.mjMINVAL:g}; here is {smallest:g}"
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> MuJoCoSimulation:
        """Compile a model of one free body, with the actuators that the scene's loads need."""
        return MuJoCoSimulation(scene, _INTEGRATORS[method], dt_s)


class MuJoCoSimulation:
    """One mjModel and its mjData."""

    stepping: Stepping = "native"

    def __init__(self, scene: Scene, integrator: mujoco.mjtIntegrator, dt_s: float) -> None:
        self._initial = scene.initial
        self._points = _loaded_points(scene)
        self._model = _compiled(scene, integrator, dt_s, self._points)
        self._data = mujoco.MjData(self._model)
        self.reset()

    def read_back(self) -> ReadBack:
        """Read mjModel and mjData."""
        model = self._model
        axes = _matrix(model.body_iquat[_BODY])
        return ReadBack(
            mass=float(model.body_mass[_BODY]),
            inertia=axes @ np.diag(model.body_inertia[_BODY]) @ axes.T,
            dt_s=float(model.opt.timestep),
            gravity=model.opt.gravity.copy(),
            state=self.read(),
        )

    def reset(self) -> None:
        """mj_resetData, which clears forces and controls too, and the initial state."""
        data, initial = self._data, self._initial
        mujoco.mj_resetData(self._model, data)
        data.qpos[:3], data.qpos[3:] = initial.position, initial.quaternion
        data.qvel[:3], data.qvel[3:] = initial.velocity, initial.omega_body

    def apply(self, wrench: Wrench) -> None:
        """Write the wrench where the engine turns it into body axes at every stage by itself.

        Raises ValueError for a load that the scene of this simulation has not.
        """
        data = self._data
        data.qfrc_applied[:3] = wrench.force_world  # the origin is the centre of mass
        data.qfrc_applied[3:] = wrench.torque_body
        data.xfrc_applied[_BODY, 3:] = wrench.torque_world
        if self._model.nu:
            self._model.actuator_gear[:, :3] = 0.0
            data.ctrl[:] = 1.0
        if np.any(wrench.force_body):
            self._push(None, wrench.force_body)
        for at, force in wrench.point_forces:
            self._push(tuple(at), force)

    def advance(self, steps: int) -> None:
        """One call of mj_step."""
        with _unheard():
            mujoco.mj_step(self._model, self._data, nstep=steps)

    def read(self) -> Reading:
        """Copy qpos and qvel; the matrix is mju_quat2Mat of qpos.

        Raises RuntimeError where MuJoCo warned that it went on with other numbers than it was given.
        """
        self._raise_altering_warnings()
        qpos, qvel = self._data.qpos.copy(), self._data.qvel.copy()
        return Reading(
            position=qpos[:3],
            velocity=qvel[:3],
            quaternion=qpos[3:],
            rotation=_matrix(qpos[3:]),
            omega_body=qvel[3:],
        )

    def close(self) -> None:
        """Do nothing: the model and the data go with this object."""

    def _push(self, point: _Point, force: Array) -> None:
        if point not in self._points:
            raise ValueError(f"no load of the scene acts at {point}")
        self._model.actuator_gear[self._points.index(point), :3] += force

    def _raise_altering_warnings(self) -> None:
        counts = self._data.warning.number
        for warning in _ALTERING:
            if counts[warning]:
                raise RuntimeError(f"MuJoCo warned of {warning.name} in {counts[warning]} evaluations")


# A body-fixed point where a world force acts; None for the body-fixed forces, summed at the centre of mass.
_Point = tuple[float, ...] | None


def _loaded_points(scene: Scene) -> tuple[_Point, ...]:
    """Return where site actuators are needed, each once."""
    forces = [load for load in scene.loads if isinstance(load, PointForce)]
    points: dict[_Point, None] = {}
    for force in forces:
        if force.axes == "body":
            points[None] = None
        elif np.any(force.at):
            points[tuple(force.at)] = None
    return tuple(points)


def _compiled(
    scene: Scene, integrator: mujoco.mjtIntegrator, dt_s: float, points: tuple[_Point, ...]
) -> mujoco.MjModel:
    """Compile through MjSpec: XML would round every number to six digits."""
    spec = mujoco.MjSpec()
    spec.option.integrator = integrator
    spec.option.timestep = dt_s
    spec.option.gravity = scene.gravity
    spec.option.disableflags = sum(int(bit) for bit in _OFF)

    moments, axes = diagonalised(scene.body.inertia)
    body = spec.worldbody.add_body(name="body")
    body.add_freejoint()
    body.mass = scene.body.mass
    body.ipos = np.zeros(3)  # left unset, the compiler drops iquat without a word
    body.iquat = matrix_to_quaternion(axes)
    # A flat plate's moments may break the triangle inequality by a round-off, which the compiler refuses.
    body.inertia = np.minimum(moments, np.roll(moments, 1) + np.roll(moments, 2))

    if points:
        spec.worldbody.add_site(name="world")
    for number, point in enumerate(points):
        _add_force(spec, body, f"point-{number}", point)
    model = spec.compile()
    if not np.array_equal(model.body_inertia[_BODY], moments):
        model.body_inertia[_BODY] = moments
        # The mass matrix of a simple body is not computed in a step but copied from dof_M0.
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _add_force(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, point: _Point) -> None:
    """Add an actuator whose gear will be the force: one actuator a point costs less than one a component."""
    body.add_site(name=name, pos=point or (0.0, 0.0, 0.0))
    axes_of_the_world = "" if point is None else "world"
    spec.add_actuator(
        name=name, trntype=mujoco.mjtTrn.mjTRN_SITE, target=name, refsite=axes_of_the_world, gear=np.zeros(6)
    )


def _matrix(quaternion: Array) -> Array:
    """Return mju_quat2Mat of it: (4,) -> (3, 3)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


@contextmanager
def _unheard() -> Iterator[None]:
    """Keep MuJoCo's warnings off the terminal and out of MUJOCO_LOG.TXT; mjData counts them all the same."""
    heard_by = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(_ignore)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(heard_by)


def _ignore(message: str) -> None:
    """Take the message and do nothing with it."""
