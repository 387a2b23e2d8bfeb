"""MuJoCo's accelerometer and gyro at a point of the body.

They are in a model of their own, so that the model that is stepped has no sensors. mj_forward evaluates them
in the state of the simulation; those of mj_step would be of the state before the step.
"""

from __future__ import annotations

import mujoco
import numpy as np

from bodycheck.adapters.mujoco.mj_model import Build, Point, compiled
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.imu import imu_point
from bodycheck.reference_impl.scene import Scene


class MuJoCoImu:
    """The sensors of one simulation, whose state and loads are copied to read them."""

    def __init__(self, scene: Scene, model: mujoco.MjModel, points: tuple[Point, ...], build: Build) -> None:
        off = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        integrator = mujoco.mjtIntegrator(model.opt.integrator)
        self._model = compiled(scene, integrator, model.opt.timestep, points, off, build, imu_point(scene))
        self._data = mujoco.MjData(self._model)

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return the specific force (3,) in m/s^2 and the rate (3,) in rad/s, in body axes."""
        mine = self._data
        self._model.actuator_gear[:] = model.actuator_gear
        for name in ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"):
            getattr(mine, name)[:] = getattr(data, name)
        mujoco.mj_forward(self._model, mine)
        found = np.array(mine.sensordata)
        return found[:3], found[3:]
