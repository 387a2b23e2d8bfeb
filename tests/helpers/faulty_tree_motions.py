"""Trees that MuJoCo moves with one fault: in its model, forces, step, or the point of its free body."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.mujoco import MuJoCo
from bodycheck.adapters.mujoco.tree import MuJoCoTree
from bodycheck.examine.diagnosis.diagnosis import Diagnosis
from bodycheck.examine.dynamics.tree_motion_diagnosis import diagnosed_tree
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, JointTorque, TreeBody, TreeLoad, TreeScene
from bodycheck.reports.measurement.scales import scene_scales
from bodycheck.scenarios.library import load_trees

TREES = ("free-chain", "free-ball", "quadruped")
STEP_S, STEPS = 5e-3, 4


def loaded_tree(name: str) -> TreeScene:
    """Return a built-in tree under gravity, a force on its first body, and a torque on its last joint."""
    ((_, tree),) = load_trees(name)
    scene = tree.scene
    interval = STEPS * STEP_S
    last, rates = len(scene.bodies) - 1, scene.bodies[-1].joint.of_kind.rates
    torque = JointTorque(last, np.linspace(0.3, 0.5, rates), from_s=3 * interval)
    push = BodyLoad(0, PointForce("world", np.array([2.0, -1.0, 3.0]), np.array([0.02, 0.05, -0.03])))
    gravity = np.array([1.0, -2.0, -9.0])
    return TreeScene(scene.bodies, (torque, push), gravity, 40 * interval, 41)


class _Moved(MuJoCoTree):
    """A model with the scene that the engine should have."""

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        super().__init__(scene, masses_were)
        self.last = self._dofs[-1], len(scene.bodies) - 1


def _built(change: Callable[[TreeBody], TreeBody]) -> type[MuJoCoTree]:
    """Return a model whose last body is another one."""

    class Built(MuJoCoTree):
        def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
            bodies = (*scene.bodies[:-1], change(scene.bodies[-1]))
            super().__init__(replace(scene, bodies=bodies), masses_were)

    return Built


def _jointed(change: Callable[[Any], dict[str, Any]]) -> type[MuJoCoTree]:
    return _built(lambda body: replace(body, joint=replace(body.joint, **change(body.joint))))


def _set(change: Callable[[_Moved], None]) -> type[MuJoCoTree]:
    """Return a model with a change of mjModel before the motion starts."""

    class Set(_Moved):
        def start(self, method: str, dt_s: float) -> None:
            super().start(method, dt_s)
            self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_DAMPER)
            self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_SPRING)
            change(self)

    return Set


def _pushed(force: Callable[[_Moved, Any, Any], Array]) -> type[MuJoCoTree]:
    """Return a model with a further generalised force at each step."""

    class Pushed(_Moved):
        def advance(self, steps: int) -> None:
            for _ in range(steps):
                mujoco.set_mjcb_passive(self._with_more)
                try:
                    mujoco.mj_step(self.model, self.data)
                finally:
                    mujoco.set_mjcb_passive(None)

        def _with_more(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
            self._add_loads(model, data)
            data.qfrc_passive += force(self, model, data)

    return Pushed


def _friction(own: _Moved, model: Any, data: Any) -> Array:
    found = np.zeros(model.nv)
    found[own.last[0]] = -0.2 * np.sign(data.qvel[own.last[0]])
    return found


def _velocity_terms(share: float) -> Callable[[_Moved, Any, Any], Array]:
    def force(_own: _Moved, model: Any, data: Any) -> Array:
        moving, still = np.zeros((2, model.nv))
        other = mujoco.MjData(model)
        for velocity, found in ((data.qvel, moving), (np.zeros(model.nv), still)):
            other.qpos, other.qvel = data.qpos, velocity
            mujoco.mj_kinematics(model, other)
            mujoco.mj_comPos(model, other)
            mujoco.mj_comVel(model, other)
            mujoco.mj_rne(model, other, 0, found)
        return np.asarray((1.0 - share) * (moving - still))

    return force


def _no_gyroscopic(own: _Moved, model: Any, data: Any) -> Array:
    link = own._bodies[-1]
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, None, jacobian, link)
    R = data.xmat[link].reshape(3, 3)
    omega = R.T @ jacobian @ data.qvel
    return np.asarray(jacobian.T @ R @ np.cross(omega, own._scene.bodies[-1].inertia @ omega))


class _Late(MuJoCoTree):
    def start(self, method: str, dt_s: float) -> None:
        super().start(method, dt_s)
        self._next: tuple[tuple[TreeLoad, float], ...] = ()
        self._acting: tuple[tuple[TreeLoad, float], ...] = ()

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        self._next = tuple(loads)

    def advance(self, steps: int) -> None:
        for _ in range(steps):
            super().push(self._acting)
            super().advance(1)
            self._acting = self._next


class _Halved(MuJoCoTree):
    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        super().push([(load, 0.5 * share) for load, share in loads])


class _AtOrigin(_Moved):
    """The free body is stepped at the origin of its link, off its centre of mass."""

    point = np.array([0.05, -0.03, 0.02])

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        super().__init__(scene, masses_were)
        base = self._bodies[0]
        self.model.body_ipos[base] = -self.point
        for body, link in zip(scene.bodies, self._bodies, strict=True):
            if body.joint.kind != "free" and body.joint.parent == 0:
                self.model.body_pos[link] -= self.point
        mujoco.mj_setConst(self.model, self.data)

    def _set_start(self) -> None:
        super()._set_start()
        q, u = self.data.qpos, self.data.qvel
        arm = quaternion_to_matrix(q[3:7]) @ self.point
        q[:3] += arm
        u[:3] += np.cross(quaternion_to_matrix(q[3:7]) @ u[3:6], arm)

    def state(self) -> tuple[Array, Array]:
        q, u = super().state()
        R = quaternion_to_matrix(q[3:7])
        q[:3] -= R @ self.point
        u[:3] -= np.cross(R @ u[3:6], R @ self.point)
        return q, u


def _assign(name: str, value: float, *, every: bool = False) -> type[MuJoCoTree]:
    def change(own: _Moved) -> None:
        first = 6 if every else own.last[0]
        getattr(own.model, name)[first:] = value
        mujoco.mj_setConst(own.model, mujoco.MjData(own.model))

    return _set(change)


def _gravity(share: float) -> type[MuJoCoTree]:
    return _set(lambda own: own.model.opt.gravity.__imul__(share))


def _held(own: _Moved) -> None:
    joint = own._joints[-1]
    own.model.jnt_stiffness[joint] = 3.0
    own.model.qpos_spring[own.model.jnt_qposadr[joint]] = own._scene.bodies[-1].joint.coordinates[0]


def _slower(own: _Moved) -> None:
    own.model.opt.timestep *= 1.01


@dataclass(frozen=True)
class MotionFault:
    """A fault: the tree model that has it, the fault that is to be named, and its parameters.

    kinds: of the last joint, to which it can be given.
    """

    name: str
    model: type[MuJoCoTree]
    expected: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    kinds: tuple[str, ...] = ("hinge", "ball")


_OFF = np.array([0.02, -0.015, 0.03])
_XYZ = dict(zip("xyz", _OFF.tolist(), strict=True))
FAULTS = (
    MotionFault("damping", _assign("dof_damping", 0.05), "damping", {"damping": 0.05}),
    MotionFault("damping-of-all", _assign("dof_damping", 0.04, every=True), "damping", {"damping": 0.04}),
    MotionFault("armature", _assign("dof_armature", 0.02), "armature", {"armature": 0.02}),
    MotionFault("armature-of-all", _assign("dof_armature", 0.01, every=True), "armature", {"armature": 0.01}),
    MotionFault("motor-holds", _set(_held), "motor-position", {"gain": 3.0}, ("hinge",)),
    MotionFault("motor-brakes", _pushed(_friction), "motor-friction", {"force": 0.2}, ("hinge",)),
    MotionFault(
        "point-in-parent", _jointed(lambda j: {"at_parent": j.at_parent + _OFF}), "parent-offset", _XYZ
    ),
    MotionFault("point-in-child", _jointed(lambda j: {"at_body": j.at_body + _OFF}), "body-offset", _XYZ),
    MotionFault(
        "zero-turned",
        _jointed(lambda j: {"zero": quaternion_product(j.zero, exp_quaternion(0.05 * j.axis))}),
        "coordinate-shift",
        {"shift": 0.05},
        ("hinge",),
    ),
    MotionFault("axis", _jointed(lambda j: {"axis": -j.axis}), "axis-opposite", {}, ("hinge",)),
    MotionFault(
        "inertia-about-joint",
        _built(lambda b: replace(b, inertia=b.inertia + b.mass * parallel_axis_tensor(b.joint.at_body))),
        "inertia-about-joint",
    ),
    MotionFault("no-coriolis", _pushed(_velocity_terms(0.0)), "missing-coriolis", {"factor": 0.0}),
    MotionFault("half-coriolis", _pushed(_velocity_terms(0.5)), "missing-coriolis", {"factor": 0.5}),
    MotionFault("no-gyroscopic", _pushed(_no_gyroscopic), "gyroscopic-term", {"factor": 0.0}),
    MotionFault("gravity-compensated", _gravity(0.0), "gravity", {"factor": 0.0}),
    MotionFault("gravity-off", _gravity(1.01), "gravity", {"factor": 1.01}),
    MotionFault("mass", _built(lambda b: replace(b, mass=1.1 * b.mass)), "mass", {"factor": 1.1}),
    MotionFault("inertia", _built(lambda b: replace(b, inertia=1.2 * b.inertia)), "inertia", {"factor": 1.2}),
    MotionFault("base-point", _AtOrigin, "base-point", {"x": 0.05, "y": -0.03, "z": 0.02}),
    MotionFault("load-late", _Late, "load-late", {"steps": 1.0}),
    MotionFault("load-halved", _Halved, "load-factor", {"factor": 0.5}),
    MotionFault("step", _set(_slower), "step", {"factor": 1.01}),
)
"""Faults of all kinds that a motion can have."""


class _Faulty(MuJoCo):
    tree_model = MuJoCoTree

    def __init__(self, fault: MotionFault) -> None:
        self.name, self.tree_model = f"faulty-{fault.name}", fault.model


def diagnosed_motion(
    adapter: Any, scene: TreeScene, method: str, dt_s: float, order: int
) -> Diagnosis | None:
    """Return the diagnosis of the motion of an engine in this process."""
    answer = record(adapter, Case(scene, method, Setting(dt_s=dt_s)))
    assert answer.trajectory is not None, answer.message
    scales = scene_scales(scene, answer.trajectory)
    precision = adapter.methods[method].precision
    return diagnosed_tree(scene, answer.trajectory, scales, dt_s, order=order, precision=precision)


def diagnosed_fault(fault: MotionFault, name: str) -> Diagnosis | None:
    """Return the diagnosis of a fault in one of the trees."""
    return diagnosed_motion(_Faulty(fault), loaded_tree(name), "euler", STEP_S, 1)


def is_named(fault: MotionFault, found: Diagnosis | None) -> bool:
    """Whether the fault stands first, with its parameters within 5 %."""
    if found is None or not found.faults or found.faults[0].name != fault.expected:
        return False
    values = {one.name: one.value for one in found.faults[0].parameters}
    return all(
        abs(values[name] - right) <= 0.05 * max(abs(right), 1e-2) for name, right in fault.parameters.items()
    )
