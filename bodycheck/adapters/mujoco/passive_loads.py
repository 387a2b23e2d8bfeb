"""Continuous loads as passive forces, evaluated at every stage by a callback: compiled, or Python.

MuJoCo has one such callback for the whole process: it is set around a call of mj_step, and does nothing
for any mjData but the one being stepped.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import mujoco
import numpy as np

from bodycheck._util.pinned_libraries import numba
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import continuous_wrench
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    add,
    cross,
    matrix_at,
    matrix_of,
    product,
    times,
    transposed_times,
    vector_at,
)
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import WrenchFunction

carray, cfunc, types = numba().carray, numba().cfunc, numba().types
intrinsic = numba().extending.intrinsic

# what the callback receives through memory: addresses, and how many loads' numbers there are
_DATA, _QPOS, _QVEL, _PASSIVE, _CLOCK, _JOINT, _LOADS, _LENGTH = range(8)
_shared = np.zeros(8, dtype=np.int64)
_SHARED_ADDRESS = _shared.ctypes.data
callback_in_use = threading.Lock()
"""Held while MuJoCo's one callback is set."""

_STAGES = 4  # the most evaluations that a step has


class PassiveLoads:
    """The continuous loads of one simulation.

    axes (3, 3): body axes to the axes of the joint's frame. anchor: None for a free joint, else where a ball
    joint is in the world, (3,). arm (3,): from the joint's origin to the centre of mass, in body axes.
    nodes: the times of a step's evaluations, in steps.
    """

    def __init__(
        self,
        loads: Array,
        axes: Array,
        anchor: Array | None,
        arm: Array,
        dt_s: float,
        nodes: tuple[float, ...],
    ) -> None:
        is_ball, place = (0.0, np.zeros(3)) if anchor is None else (1.0, anchor)
        self._loads = loads
        self._joint = np.concatenate([[is_ball], place, arm, axes.ravel()])
        self._clock = np.array([0.0, dt_s, len(nodes), *nodes], dtype=np.float64)

    def reset(self) -> None:
        """Go back to t = 0."""
        self._clock[0] = 0.0

    @contextmanager
    def acting_on(self, data: mujoco.MjData, steps: int) -> Iterator[None]:
        """Let the loads act while MuJoCo makes so many steps.

        Raises RuntimeError where it evaluated them more or less often than a step's stages are.
        """
        evaluations = self._clock[0] + steps * self._clock[2]
        with callback_in_use:
            _shared[_DATA], _shared[_LENGTH] = data._address, len(self._loads)
            _shared[_QPOS], _shared[_QVEL] = data.qpos.ctypes.data, data.qvel.ctypes.data
            _shared[_PASSIVE] = data.qfrc_passive.ctypes.data
            _shared[_CLOCK], _shared[_JOINT] = self._clock.ctypes.data, self._joint.ctypes.data
            _shared[_LOADS] = self._loads.ctypes.data
            mujoco.set_mjcb_passive(_callback()[1])
            try:
                yield
            finally:
                mujoco.set_mjcb_passive(None)
                _shared[_DATA] = 0
        if self._clock[0] != evaluations:
            raise RuntimeError(
                f"MuJoCo evaluated passive forces {self._clock[0]:g} times, not {evaluations:g}"
            )


@kernel
def _add_passive(
    qpos: Array, qvel: Array, passive: Array, clock: Array, joint: Array, loads: Array, is_ball: bool
) -> None:
    """Add the generalised force of the loads; count the evaluation, which tells the time."""
    stages = int(clock[2])
    count = int(clock[0])
    clock[0] += 1.0
    t = (count // stages + clock[3 + count % stages]) * clock[1]
    first = 0 if is_ball else 3
    frame = matrix_of((qpos[first], qpos[first + 1], qpos[first + 2], qpos[first + 3]))
    axes = matrix_at(joint, 7)
    rotation = product(frame, axes)
    omega = times(frame, vector_at(qvel, first))
    arm = times(rotation, vector_at(joint, 4))
    x, v = add(vector_at(joint, 1), arm), cross(omega, arm)
    if not is_ball:
        x, v = add(vector_at(qpos, 0), arm), add(vector_at(qvel, 0), v)
    force, torque = continuous_wrench(t, x, rotation, v, omega, loads)
    if not is_ball:
        for i in range(3):
            passive[i] += force[i]
    joint_torque = transposed_times(frame, add(torque, cross(arm, force)))
    passive[first] += joint_torque[0]
    passive[first + 1] += joint_torque[1]
    passive[first + 2] += joint_torque[2]


@intrinsic  # type: ignore[untyped-decorator]  # numba ships no types
def _pointer(_: Any, __: Any) -> Any:
    """Take an address for a pointer."""

    def convert(context: Any, builder: Any, ___: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(types.voidptr))

    return types.voidptr(types.int64), convert


@cache
def _callback() -> tuple[Any, Any]:
    """Compile the callback, and return it with the function pointer that MuJoCo takes."""
    add_passive = _add_passive.dispatcher  # numba knows no Kernel before the first one is compiled

    def passive(_: int, data: int) -> None:
        shared = carray(_pointer(_SHARED_ADDRESS), 8, np.int64)
        if shared[_DATA] != data:
            return
        joint = carray(_pointer(shared[_JOINT]), 16, np.float64)
        is_ball = joint[0] == 1.0
        add_passive(
            carray(_pointer(shared[_QPOS]), 7, np.float64),
            carray(_pointer(shared[_QVEL]), 6, np.float64),
            carray(_pointer(shared[_PASSIVE]), 6, np.float64),
            carray(_pointer(shared[_CLOCK]), 3 + _STAGES, np.float64),
            joint,
            carray(_pointer(shared[_LOADS]), shared[_LENGTH], np.float64),
            is_ball,
        )

    compiled = cfunc(types.void(types.int64, types.int64))(passive)
    signature = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
    return compiled, ctypes.cast(compiled.address, signature)


class CallbackLoads:
    """The continuous loads of one simulation, as PassiveLoads, but as one function of the motion."""

    def __init__(
        self,
        wrench: WrenchFunction,
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
