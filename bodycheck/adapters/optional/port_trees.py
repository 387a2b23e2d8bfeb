"""Trees in the ports of MuJoCo, MJX and MuJoCo Warp: MuJoCo's own model, put into the port."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from bodycheck.adapters.contract import VARIANT, Stepping
from bodycheck.adapters.mujoco.tree import MuJoCoTree
from bodycheck.adapters.optional.between_steps import array
from bodycheck.adapters.tree_contract import UnreportedError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene


class _PortTree(MuJoCoTree):
    """A tree whose model and data are those of a port."""

    precision = "float32"
    stepping: Stepping = "python"

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        if masses_were != 1.0:
            raise UnreportedError("the masses of a port's model are those of MuJoCo's")
        super().__init__(scene)
        self._dt_s = float(self.model.opt.timestep)
        self.model.opt.disableflags = 0  # a port refuses some of them; there is nothing to disable
        self._load()

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:
        """Refuse loads, and methods in float64."""
        if VARIANT in method:
            return "the adapter moves trees in float32 only"
        if scene.loads:
            return "MuJoCo's callback of passive forces does not exist in the port"
        return super().unmoved(scene, method)

    def start(self, method: str, dt_s: float) -> None:
        """Set the step and the integrator of MuJoCo's model, and put it into the port."""
        super().start(method, dt_s)
        self.model.opt.disableflags = 0
        self._dt_s = dt_s
        self._load()
        self._set_start()

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Nothing acts."""

    def advance(self, steps: int) -> None:
        """Make the steps one by one."""
        for _ in range(steps):
            self._make_step()

    def _load(self) -> None:
        """Put the model and the data into the port."""
        raise NotImplementedError

    def _step(self, dt_s: float) -> None:
        if dt_s != self._dt_s:
            self._dt_s = self.model.opt.timestep = dt_s
            self._load_step()
        self._make_step()

    def _load_step(self) -> None:
        raise NotImplementedError

    def _make_step(self) -> None:
        raise NotImplementedError


class MjxTree(_PortTree):
    """A tree in JAX, in float32."""

    def advance(self, steps: int) -> None:
        """Make the steps one by one, and wait for the last."""
        super().advance(steps)
        self._state.qpos.block_until_ready()

    def _load(self) -> None:
        from mujoco import mjx

        from bodycheck.adapters.optional.mjx import jax_on_cpu

        self._jax, self._mjx = jax_on_cpu(double=False), mjx
        self.model.opt.enableflags = 0  # MJX has no energy
        self._port: Any = mjx.put_model(self.model)
        self._state: Any = mjx.put_data(self.model, self.data)
        self._compiled = {name: self._jax.jit(getattr(mjx, name)) for name in ("forward", "step")}

    def _load_step(self) -> None:
        self._port = self._port.tree_replace({"opt.timestep": self._jax.numpy.float32(self._dt_s)})

    def _put(self, qpos: Array, qvel: Array) -> None:
        real = self._state.qpos.dtype
        self._state = self._state.replace(
            qpos=self._jax.numpy.asarray(qpos, real), qvel=self._jax.numpy.asarray(qvel, real)
        )

    def _forward(self) -> None:
        self._state = self._compiled["forward"](self._port, self._state)

    def _make_step(self) -> None:
        self._state = self._compiled["step"](self._port, self._state)

    def _field(self, name: str) -> Array:
        return array(getattr(self._state, name))

    def _full_mass_matrix(self) -> Array:
        return array(self._mjx.full_m(self._port, self._state))

    def energy(self) -> Array:
        """Nothing."""
        raise UnreportedError("MJX computes no energy")

    def wrenches(self) -> Array:
        """Nothing."""
        raise UnreportedError("MJX's force and torque sensors were 0 in a trial of the adapter")


class WarpTree(_PortTree):
    """A tree in Warp, in one world."""

    def _load(self) -> None:
        import mujoco_warp

        self._warp: Any = mujoco_warp
        self._port = mujoco_warp.put_model(self.model)
        self._state: Any = mujoco_warp.put_data(self.model, self.data)

    def _load_step(self) -> None:
        self._port.opt.timestep.fill_(self._dt_s)

    def _put(self, qpos: Array, qvel: Array) -> None:
        self._state.qpos.assign(qpos[None].astype(np.float32))
        self._state.qvel.assign(qvel[None].astype(np.float32))

    def _forward(self) -> None:
        self._warp.forward(self._port, self._state)

    def _make_step(self) -> None:
        self._warp.step(self._port, self._state)

    def _field(self, name: str) -> Array:
        return array(getattr(self._state, name).numpy())[0]

    def _full_mass_matrix(self) -> Array:
        held = mujoco.MjData(self.model)
        self._warp.get_data_into(held, self.model, self._state)
        found = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, held, found)
        return found
