"""Trees in MuJoCo: an mjModel without geometry, and what mj_forward computes of it.

qvel of a free joint is the velocity in world axes, then omega in body axes; joints are numbered depth first.
After mj_step, the mass matrix, bias, accelerations, energy, poses and sensors are those of its start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from bodycheck.adapters.contract import DEFAULTS, VARIANT, Stepping, TreeReadBack
from bodycheck.adapters.mujoco.mj_model import OFF, PASSIVE_OFF, matrix_of
from bodycheck.adapters.tree_contract import (
    JointedLink,
    RateMap,
    TreeModel,
    jointed_links,
    link_poses,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, JointSineTorque, TreeLoad, TreeScene

_SENSORS = mujoco.mjtSensor
_OF_THE_TREE = (_SENSORS.mjSENS_SUBTREELINVEL, _SENSORS.mjSENS_SUBTREEANGMOM, _SENSORS.mjSENS_SUBTREECOM)
_LEAST = 2.0 * mujoco.mjMINVAL
"""kg and kg m^2: links without mass, such as those between two joints, are refused."""
_KINDS = {
    "hinge": mujoco.mjtJoint.mjJNT_HINGE,
    "slide": mujoco.mjtJoint.mjJNT_SLIDE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
}


class MuJoCoTree(TreeModel):
    """An mjModel and its mjData."""

    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "mj_fullM; v world, omega body; joints depth first",
        "bias": "qfrc_bias",
        "gravity_bias": "qfrc_bias at rest",
        "accelerations": "qacc",
        "wrenches": "force and torque sensors; child axes, at the joint",
        "energy": "energy; potential first",
        "momenta": "subtree sensors; world axes, about the centre of mass",
        "poses": "xpos, xquat; of the link",
    }

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        self._scene, self._links = scene, jointed_links(scene)
        self.model = compiled_tree(scene, jointed_links(scene, masses_were))
        self._bodies = [self.model.body(link.name).id for link in self._links]
        if masses_were != 1.0:
            for link, body in zip(self._links, self._bodies, strict=True):
                self.model.body_mass[body] = link.mass
                self.model.body_inertia[body] /= masses_were
        self.data = mujoco.MjData(self.model)
        if masses_were != 1.0:
            mujoco.mj_setConst(self.model, self.data)
        joints = [int(self.model.body_jntadr[body]) for body in self._bodies]
        self._joints, self._dofs = joints, [int(self.model.jnt_dofadr[joint]) for joint in joints]
        self._add_passive_forces()
        self._coordinates = np.concatenate(
            [
                np.arange(part.stop - part.start) + self.model.jnt_qposadr[joint]
                for part, joint in zip(scene.coordinate_slices, joints, strict=True)
            ]
        )
        self._map = RateMap(scene, self._dofs)
        self._total_mass = sum(link.mass for link in self._links)

    def set_state(self, q: Array, u: Array) -> None:
        """Set qpos and qvel, and call mj_forward."""
        qpos = np.empty(self.model.nq)
        qpos[self._coordinates] = q
        self._put(qpos, self._map.rates(u))
        self._forward()

    def mass_matrix(self) -> Array:
        """mj_fullM."""
        return self._map.mass_matrix(self._full_mass_matrix())

    def bias(self) -> Array:
        """qfrc_bias."""
        return self._map.bias(self._field("qfrc_bias"))

    def gravity_bias(self) -> Array:
        """qfrc_bias of another mj_forward, at rest."""
        qpos, qvel = self._field("qpos"), self._field("qvel")
        self._put(qpos, np.zeros_like(qvel))
        self._forward()
        found = self._map.bias(self._field("qfrc_bias"))
        self._put(qpos, qvel)
        self._forward()
        return found

    def accelerations(self) -> Array:
        """Qacc."""
        return self._map.accelerations(self._field("qacc"))

    def wrenches(self) -> Array:
        """Return the force and torque sensors at a site on each joint."""
        return self._field("sensordata")[9:].reshape(-1, 6)

    def energy(self) -> Array:
        """Energy, whose first number is the potential."""
        return self._field("energy")[::-1].copy()

    def momenta(self) -> Array:
        """Return the subtree sensors of the world: velocity of the centre of mass, and L about it."""
        velocity, about_centre, centre = self._field("sensordata")[:9].reshape(3, 3)
        momentum = self._total_mass * velocity
        return np.concatenate([momentum, about_centre + np.cross(centre, momentum)])

    def poses(self) -> Array:
        """Xpos and xquat, of the links."""
        places, quaternions = self._field("xpos"), self._field("xquat")
        return link_poses(
            self._links,
            [places[body] for body in self._bodies],
            [matrix_of(quaternions[body]) for body in self._bodies],
        )

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """mj_step."""
        self._step(dt_s)
        return self.state()

    def _add_passive_forces(self) -> None:
        """Give the joints their springs, dampers and armatures."""
        model = self.model
        for body, joint, dof in zip(self._scene.bodies, self._joints, self._dofs, strict=True):
            own = slice(dof, dof + body.joint.of_kind.rates)
            model.dof_damping[own], model.dof_armature[own] = body.joint.damping, body.joint.armature
            model.jnt_stiffness[joint] = body.joint.stiffness
            if body.joint.of_kind.is_scalar:
                model.qpos_spring[model.jnt_qposadr[joint]] = body.joint.rest
        if np.any(model.dof_armature):
            mujoco.mj_setConst(model, mujoco.MjData(model))

    # --------------------------------------------------------------------------------------------- motion

    stepping: Stepping = "native"

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:
        """Refuse variants of a lone body, and bodies without mass, as MuJoCo's compiler does."""
        _, mark, variant = method.partition(VARIANT)
        if mark and VARIANT + variant != DEFAULTS:
            return f"the variant {variant} is one of a lone body"
        smallest = min(min(body.mass, float(np.min(diagonalised(body.inertia)[0]))) for body in scene.bodies)
        if smallest < mujoco.mjMINVAL:
            return f"MuJoCo rejects a mass or inertia below {mujoco.mjMINVAL:g}, such as {smallest:g}"
        return None

    def start(self, method: str, dt_s: float) -> None:
        """Set integrator, step and flags, reset the data, and set the start."""
        label, _, _ = method.partition(VARIANT)
        option = self.model.opt
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{label.upper()}")
        option.timestep = dt_s
        joints = [body.joint for body in self._scene.bodies]
        is_passive = self._scene.loads or any(joint.stiffness or joint.damping for joint in joints)
        # the integrator euler treats damping implicitly, as `implicitfast` does
        off = {*OFF, *(() if is_passive else PASSIVE_OFF)} - {mujoco.mjtDisableBit.mjDSBL_EULERDAMP}
        option.disableflags = 0 if method.endswith(DEFAULTS) else sum(int(bit) for bit in off)
        option.enableflags = 0
        mujoco.mj_resetData(self.model, self.data)
        self._set_start()

    def _set_start(self) -> None:
        qpos = np.empty(self.model.nq)
        qpos[self._coordinates] = self._scene.q0
        self._put(qpos, self._map.rates(self._scene.u0))

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Keep the loads for the callback of passive forces, which every stage calls."""
        self._loads = tuple(loads)

    def advance(self, steps: int) -> None:
        """Make all steps in one call."""
        if not self._loads:
            mujoco.mj_step(self.model, self.data, nstep=steps)
            return
        mujoco.set_mjcb_passive(self._add_loads)
        try:
            mujoco.mj_step(self.model, self.data, nstep=steps)
        finally:
            mujoco.set_mjcb_passive(None)

    def _add_loads(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Add the loads at the present stage to qfrc_passive."""
        for load, share in self._loads:
            dof, link = self._dofs[load.body], self._bodies[load.body]
            if isinstance(load, JointSineTorque):
                data.qfrc_passive[dof] += load.amplitude * np.sin(load.rate * data.time + load.phase)
            elif not isinstance(load, BodyLoad):
                data.qfrc_passive[dof : dof + len(load.value)] += share * load.value
            else:
                rotation, one = data.xmat[link].reshape(3, 3), load.load
                value = share * (rotation @ one.value if one.axes == "body" else one.value)
                force, torque = (np.zeros(3), value) if isinstance(one, Torque) else (value, np.zeros(3))
                at = data.xipos[link] + (0.0 if isinstance(one, Torque) else rotation @ one.at)
                mujoco.mj_applyFT(model, data, force, torque, at, link, data.qfrc_passive)

    def state(self) -> tuple[Array, Array]:
        """Qpos and qvel."""
        return self._field("qpos")[self._coordinates], self._map.own_rates(self._field("qvel"))

    def held(self) -> TreeReadBack:
        """Read mjModel, qpos and qvel."""
        model, bodies, joints = self.model, self._bodies, self._joints
        axes = [matrix_of(model.body_iquat[body]) for body in bodies]
        q, u = self.state()
        return TreeReadBack(
            float(model.opt.timestep),
            {
                "mass": model.body_mass[bodies],
                "inertia": np.array(
                    [A @ np.diag(model.body_inertia[b]) @ A.T for A, b in zip(axes, bodies, strict=True)]
                ),
                "centre": model.body_ipos[bodies],
                "place": model.body_pos[bodies] * np.where(self._are_free, 0.0, 1.0)[:, None],
                "zero": np.where(self._are_free[:, None], [1.0, 0.0, 0.0, 0.0], model.body_quat[bodies]),
                "axis": model.jnt_axis[joints],
                "stiffness": model.jnt_stiffness[joints],
                "rest": model.qpos_spring[model.jnt_qposadr[joints]],
                "damping": model.dof_damping[self._dofs],
                "armature": model.dof_armature[self._dofs],
                "gravity": model.opt.gravity.copy(),
                "q": q,
                "u": u,
            },
        )

    @property
    def _are_free(self) -> Any:
        return np.array([link.kind == "free" for link in self._links])

    # --------------------------------------------------------------------------------------------- engine

    def _put(self, qpos: Array, qvel: Array) -> None:
        self.data.qpos, self.data.qvel = qpos, qvel

    def _forward(self) -> None:
        mujoco.mj_forward(self.model, self.data)

    def _step(self, dt_s: float) -> None:
        self.model.opt.timestep = dt_s
        mujoco.mj_step(self.model, self.data)

    def _field(self, name: str) -> Array:
        return np.array(getattr(self.data, name), dtype=np.float64)

    def _full_mass_matrix(self) -> Array:
        found = np.zeros((self.model.nv, self.model.nv))
        if int(mujoco.__version__.split(".")[0]) >= 4:
            mujoco.mj_fullM(self.model, self.data, found)
        else:
            mujoco.mj_fullM(self.model, found, self.data.qM)
        return found


def compiled_tree(scene: TreeScene, links: tuple[JointedLink, ...]) -> mujoco.MjModel:
    """Compile a tree, with sensors for its momenta and for the wrench of each joint."""
    spec = mujoco.MjSpec()
    spec.option.gravity = scene.gravity
    off = set(OFF) - {mujoco.mjtDisableBit.mjDSBL_SENSOR}
    spec.option.disableflags = sum(int(bit) for bit in off)
    spec.option.enableflags = int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    bodies: list[Any] = []
    for link in links:
        parent = spec.worldbody if link.parent < 0 else bodies[link.parent]
        moments, axes = diagonalised(link.inertia)
        moments = np.maximum(moments, _LEAST)
        body = parent.add_body(name=link.name, pos=link.place, quat=link.zero)
        body.mass, body.ipos, body.iquat = max(link.mass, _LEAST), link.centre, matrix_to_quaternion(axes)
        body.inertia = np.minimum(moments, np.roll(moments, 1) + np.roll(moments, 2))
        body.explicitinertial = True
        if link.kind == "free":
            body.add_freejoint()
        else:
            body.add_joint(type=_KINDS[link.kind], axis=link.axis)
        body.add_site(name=link.name)
        bodies.append(body)
    for kind in _OF_THE_TREE:
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_BODY, objname="world")
    for link in links:
        for kind in (_SENSORS.mjSENS_FORCE, _SENSORS.mjSENS_TORQUE):
            spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=link.name)
    return spec.compile()
