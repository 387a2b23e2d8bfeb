"""Loads that only a function knows as passive forces: MuJoCo calls back into Python at every evaluation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from bodycheck.adapters.mujoco.compiled_loads import callback_in_use
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Wrenching


class CallbackLoads:
    """The lasting loads of one simulation, as PassiveLoads, but as one function of the motion."""

    def __init__(
        self,
        wrench: Wrenching,
        axes: Array,
        anchor: Array | None,
        arm: Array,
        dt_s: float,
        nodes: tuple[float, ...],
    ) -> None:
        self._wrench, self._axes, self._anchor, self._arm = wrench, axes, anchor, arm
        self._dt_s, self._nodes, self._evaluations = dt_s, nodes, 0

    def reset(self) -> None:
        """Go back to t = 0."""
        self._evaluations = 0

    @contextmanager
    def acting_on(self, data: mujoco.MjData, steps: int) -> Iterator[None]:
        """Let the loads act while MuJoCo makes so many steps.

        Raises what the function raised, once MuJoCo is back, and RuntimeError where it evaluated the loads
        more or less often than a step's stages are.
        """
        due = self._evaluations + steps * len(self._nodes)
        faults: list[BaseException] = []

        def passive(_: mujoco.MjModel, evaluated: mujoco.MjData) -> None:
            if evaluated is not data:
                return
            try:
                if not faults:
                    self._add_to(data)
            except BaseException as fault:  # noqa: BLE001 - raised below: not through the frames of C
                faults.append(fault)
            self._evaluations += 1

        with callback_in_use:
            mujoco.set_mjcb_passive(passive)
            try:
                yield
            finally:
                mujoco.set_mjcb_passive(None)
        if faults:
            raise faults[0]
        if self._evaluations != due:
            raise RuntimeError(f"MuJoCo evaluated passive forces {self._evaluations} times, not {due}")

    def _add_to(self, data: mujoco.MjData) -> None:
        """Add the generalised force of the loads at this evaluation."""
        steps, stage = divmod(self._evaluations, len(self._nodes))
        frame = quaternion_to_matrix(data.qpos[-4:])
        rotation, omega = frame @ self._axes, frame @ data.qvel[-3:]
        arm = rotation @ self._arm
        position, velocity = arm, np.cross(omega, arm)
        if self._anchor is None:
            position, velocity = data.qpos[:3] + arm, data.qvel[:3] + velocity
        else:
            position = self._anchor + arm
        t = (steps + self._nodes[stage]) * self._dt_s
        force, torque = self._wrench(t, position, rotation, velocity, omega)
        if self._anchor is None:
            data.qfrc_passive[:3] += force
        data.qfrc_passive[-3:] += (torque + np.cross(arm, force)) @ frame
