"""Ports of MuJoCo that step the model of its own compiler: MJX and MuJoCo Warp.

qpos is the position of the joint's frame and its quaternion (w, x, y, z), qvel the velocity of that frame's
origin in world axes and omega in the frame's axes. The frame's origin is the centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Protocol

import mujoco
import numpy as np

from bodycheck.adapters.batches import Batch, BatchAnswer
from bodycheck.adapters.contract import Precision, ReadBack, Reading, Stepping, read_back_mismatch
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.adapters.mujoco.mj_model import BODY, Point, compiled, loaded_points, matrix_of
from bodycheck.adapters.optional.between_steps import array
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench


class Worlds(Protocol):
    """m free bodies with models of one shape, stepped together by a port."""

    def model(self) -> Any:
        """Return an object with body_mass, body_inertia, body_iquat and opt, as the port holds them.

        Each field has a first axis of length m, or none if it is that of all bodies.
        """

    def put(self, **state: Array) -> None:
        """Set qpos (m, 7) and qvel (m, 6)."""

    def step(self, steps: int) -> None:
        """Make the steps."""

    def get(self) -> tuple[Array, Array]:
        """Return copies of qpos (m, 7) and qvel (m, 6)."""


class Port(Worlds, Protocol):
    """One body on the port's side, whose states have no first axis.

    It also takes the state's ctrl (nu,), qfrc_applied (6,) and xfrc_applied (2, 6).
    """

    def put_gear(self, gear: Array) -> None:
        """Set actuator_gear (nu, 6)."""


def mj_model(scene: Scene, integrator: str, dt_s: float) -> mujoco.MjModel:
    """Compile the scene's body without geometry."""
    found = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    return compiled(scene, found, dt_s, loaded_points(scene), (), "aligned")


OF_BODY = (
    *("body_mass", "body_subtreemass", "body_inertia", "body_iquat", "body_ipos"),
    *("body_invweight0", "dof_invweight0"),
)
"""The fields of a model that differ from body to body."""


def record_worlds(
    batch: Batch,
    integrator: str,
    precision: Precision,
    worlds: Callable[[Sequence[mujoco.MjModel]], Worlds],
) -> BatchAnswer:
    """Step all bodies of a batch of free bodies in the worlds of their models."""
    dt_s, scenes = batch.dt_s, list(batch.scenes())
    assert dt_s is not None
    together = worlds([mj_model(scene, integrator, dt_s) for scene in scenes])
    starts = [start_of(scene) for scene in scenes]
    together.put(qpos=np.array([one for one, _ in starts]), qvel=np.array([one for _, one in starts]))
    answer = BatchAnswer.none(batch, "ok", "")
    states = [together.get()]
    model, (qpos, qvel) = together.model(), states[0]
    endings, messages = list(answer.endings), list(answer.messages)
    for row, scene in enumerate(scenes):
        read_back = _read_back(model, row, _reading(qpos[row], qvel[row]))
        if fault := read_back_mismatch(scene, dt_s, read_back, precision):
            endings[row], messages[row] = "invalid", fault
    for _ in range(batch.template.samples - 1):
        together.step(batch.steps_per_sample)
        states.append(together.get())
    valid = np.array(endings) == "ok"
    answer.quaternion[valid] = np.stack([qpos[:, 3:] for qpos, _ in states], axis=1)[valid]
    answer.omega_body[valid] = np.stack([qvel[:, 3:] for _, qvel in states], axis=1)[valid]
    return BatchAnswer(answer.quaternion, answer.omega_body, tuple(endings), tuple(messages))


def start_of(scene: Scene) -> tuple[Array, Array]:
    """Return qpos (7,) and qvel (6,) at the start."""
    start = scene.initial
    qpos = np.concatenate([start.position, start.quaternion])
    return qpos, np.concatenate([start.velocity, start.omega_body])


class PortSimulation:
    """A scene in a port: constant loads at every stage, continuous ones held constant over the step.

    As in MuJoCo's adapter, a force in body axes or off the centre of mass is the gear of an actuator.
    """

    def __init__(self, scene: Scene, dt_s: float, port: Port, stepping: Stepping) -> None:
        self._scene, self._dt_s, self._port, self.stepping = scene, dt_s, port, stepping
        self._loads = StageLoads(replace(scene, gravity=np.zeros(3)))
        self._points = loaded_points(scene)
        self.reset()

    def reset(self) -> None:
        """Restore the initial state at t = 0, without a wrench."""
        qpos, qvel = start_of(self._scene)
        self._port.put(qpos=qpos, qvel=qvel)
        self._steps_made = 0
        self.apply(NO_WRENCH)

    def apply(self, wrench: Wrench) -> None:
        """Write the wrench to inputs that the port itself rotates into body axes at every stage.

        Raises ValueError for a load at a point where the scene has none.
        """
        self._at_stages = np.concatenate([wrench.force_world, wrench.torque_world])
        self._torque = np.concatenate([np.zeros(3), wrench.torque_body])
        self._push(np.zeros(6))
        if self._points:
            gear = np.zeros((len(self._points), 6))
            for point, force in _forces_at_points(wrench):
                gear[self._points.index(point), :3] += force
            self._port.put(ctrl=np.ones(len(self._points)))
            self._port.put_gear(gear)

    def _push(self, more: Array) -> None:
        """Apply a wrench (6,) in world axes in addition to the constant one."""
        xfrc = np.zeros((2, 6))
        xfrc[BODY] = self._at_stages + more
        self._port.put(qfrc_applied=self._torque, xfrc_applied=xfrc)

    def advance(self, steps: int) -> None:
        """Make the steps in one call, unless continuous loads are to be renewed in each."""
        if not self._scene.continuous_loads:
            self._port.step(steps)
            self._steps_made += steps
            return
        for _ in range(steps):
            qpos, qvel = self._port.get()
            rotation = matrix_of(qpos[3:])
            t_s = self._steps_made * self._dt_s
            force, torque = self._loads.at(t_s, qpos[:3], rotation, qvel[:3], rotation @ qvel[3:])
            self._push(np.concatenate([force, rotation @ torque]))
            self._port.step(1)
            self._steps_made += 1

    def read(self) -> Reading:
        """Return copies of the state."""
        return _reading(*self._port.get())

    def read_back(self) -> ReadBack:
        """Return the model and the state as the port holds them."""
        return _read_back(self._port.model(), 0, self.read())

    def close(self) -> None:
        """Do nothing; the port is freed with this object."""


def _reading(qpos: Array, qvel: Array) -> Reading:
    return Reading(qpos[:3], qvel[:3], quaternion=qpos[3:], omega_body=qvel[3:])


def _read_back(model: Any, row: int, reading: Reading) -> ReadBack:
    """Return what the port holds of a body; a field without a first axis for the bodies is that of all."""

    def field(values: Any, *shape: int) -> Array:
        found = array(values).reshape(-1, *shape)
        return np.asarray(found[row] if len(found) > 1 else found[0])

    bodies = BODY + 1
    axes = matrix_of(field(model.body_iquat, bodies, 4)[BODY])
    inertia = axes @ np.diag(field(model.body_inertia, bodies, 3)[BODY]) @ axes.T
    mass = float(field(model.body_mass, bodies)[BODY])
    return ReadBack(mass, inertia, float(field(model.opt.timestep)), field(model.opt.gravity, 3), reading)


def _forces_at_points(wrench: Wrench) -> Iterator[tuple[Point, Array]]:
    """Yield the forces that need an actuator: of the points of `loaded_points`."""
    if np.any(wrench.force_body):
        yield None, wrench.force_body
    for at, force in wrench.point_forces:
        yield tuple(at), force
