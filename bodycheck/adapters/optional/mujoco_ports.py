"""Ports of MuJoCo that step the model of its own compiler: MJX and MuJoCo Warp.

qpos is the position of the joint's frame and its quaternion (w, x, y, z), qvel the velocity of that frame's
origin in world axes and omega in the frame's axes. The frame's origin is the centre of mass.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Protocol

import mujoco
import numpy as np

from bodycheck.adapters.contract import ReadBack, Reading, Stepping
from bodycheck.adapters.mujoco.mj_model import BODY, Point, compiled, loaded_points, matrix_of
from bodycheck.adapters.optional.between_steps import array
from bodycheck.adapters.stage_loads import StageLoads
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench


class Port(Protocol):
    """A model and a state on the port's side."""

    def model(self) -> Any:
        """Return an object with body_mass, body_inertia, body_iquat and opt, as the port holds them."""

    def put(self, **state: Array) -> None:
        """Set qpos (7,), qvel (6,), ctrl (nu,), qfrc_applied (6,) or xfrc_applied (2, 6)."""

    def put_gear(self, gear: Array) -> None:
        """Set actuator_gear (nu, 6)."""

    def step(self, steps: int) -> None:
        """Make the steps."""

    def get(self) -> tuple[Array, Array]:
        """Return copies of qpos (7,) and qvel (6,)."""


def mj_model(scene: Scene, integrator: str, dt_s: float) -> mujoco.MjModel:
    """Compile the scene's body without geometry."""
    found = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    return compiled(scene, found, dt_s, loaded_points(scene), (), "aligned")


class PortSimulation:
    """A scene in a port: constant torques and forces at every stage, continuous loads held over the step.

    As in MuJoCo's adapter, a force in body axes or off the centre of mass is the gear of an actuator.
    """

    def __init__(self, scene: Scene, dt_s: float, port: Port, stepping: Stepping) -> None:
        self._scene, self._dt_s, self._port, self.stepping = scene, dt_s, port, stepping
        self._loads = StageLoads(replace(scene, gravity=np.zeros(3)))
        self._points = loaded_points(scene)
        self.reset()

    def reset(self) -> None:
        """Restore the initial state at t = 0, without a wrench."""
        start = self._scene.initial
        self._port.put(
            qpos=np.concatenate([start.position, start.quaternion]),
            qvel=np.concatenate([start.velocity, start.omega_body]),
        )
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
        if not self._scene.lasting_loads:
            self._port.step(steps)
            self._steps_made += steps
            return
        for _ in range(steps):
            qpos, qvel = self._port.get()
            turn = matrix_of(qpos[3:])
            t_s = self._steps_made * self._dt_s
            force, torque = self._loads.at(t_s, qpos[:3], turn, qvel[:3], turn @ qvel[3:])
            self._push(np.concatenate([force, turn @ torque]))
            self._port.step(1)
            self._steps_made += 1

    def read(self) -> Reading:
        """Return copies of the state."""
        qpos, qvel = self._port.get()
        return Reading(qpos[:3], qvel[:3], quaternion=qpos[3:], omega_body=qvel[3:])

    def read_back(self) -> ReadBack:
        """Return the model and the state as the port holds them."""
        model = self._port.model()
        axes = matrix_of(array(model.body_iquat).reshape(-1, 4)[BODY])
        inertia = axes @ np.diag(array(model.body_inertia).reshape(-1, 3)[BODY]) @ axes.T
        mass = float(array(model.body_mass).ravel()[BODY])
        timestep, gravity = float(array(model.opt.timestep).ravel()[0]), array(model.opt.gravity).ravel()[:3]
        return ReadBack(mass, inertia, timestep, gravity, self.read())

    def close(self) -> None:
        """Do nothing; the port is freed with this object."""


def _forces_at_points(wrench: Wrench) -> Iterator[tuple[Point, Array]]:
    """Yield the forces that need an actuator: of the points of `loaded_points`."""
    if np.any(wrench.force_body):
        yield None, wrench.force_body
    for at, force in wrench.point_forces:
        yield tuple(at), force
