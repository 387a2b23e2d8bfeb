"""MuJoCo's importer of URDF and MJCF."""

from __future__ import annotations

from typing import Any

import numpy as np

from bodycheck.adapters.importers import (
    DEFAULT,
    RECOMMENDED,
    WITHOUT_MESHES,
    ImportedLink,
    ImportRequest,
    MassMatrices,
    SpinRequest,
    random_displacements,
    rates_of,
    tensor_of,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint

FLAGS = {
    "urdf": {
        DEFAULT: "MjSpec.from_file(FILE).compile()",
        RECOMMENDED: f"fusestatic=false, {WITHOUT_MESHES}",
    },
    "mjcf": {DEFAULT: "MjSpec.from_file(FILE).compile()"},
}
_OF_JOINTS = (0, 1)  # the transmissions mjTRN_JOINT and mjTRN_JOINTINPARENT


def _spec(request: ImportRequest) -> Any:
    import mujoco

    if request.format == "urdf" and request.flags == RECOMMENDED:
        spec = mujoco.MjSpec.from_string(request.bare)
        spec.compiler.fusestatic = False
        return spec
    return mujoco.MjSpec.from_file(request.file)


def imported_links(request: ImportRequest) -> list[ImportedLink]:
    """Return the bodies of the compiled model, the world left out."""
    return _links(_spec(request).compile())


def _links(model: Any) -> list[ImportedLink]:
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return [_link(model, data, body) for body in range(1, model.nbody)]


def mass_matrices(request: ImportRequest, count: int) -> list[MassMatrices]:
    """Return M, armature included, of the whole model."""
    import mujoco

    model = _spec(request).compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    links = _links(model)
    columns = rates_of(links)
    if not columns:
        return []
    moved = random_displacements(links, columns, count)
    values = np.empty((count, model.nv, model.nv))
    data = mujoco.MjData(model)
    for displacement, M in zip(moved, values, strict=True):
        data.qpos[:] = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, displacement, 1.0)
        mujoco.mj_forward(model, data)
        for column, unit in zip(M, np.eye(model.nv), strict=True):
            mujoco.mj_mulM(model, data, column, unit)
    return [MassMatrices(columns, moved, values)]


def _link(model: Any, data: Any, body: int) -> ImportedLink:
    first = model.body_jntadr[body]
    return ImportedLink(
        model.body(body).name,
        float(model.body_mass[body]),
        model.body_ipos[body].tolist(),
        tensor_of(model.body_inertia[body], model.body_iquat[body]),
        data.xpos[body].tolist(),
        data.xmat[body].reshape(3, 3).tolist(),
        int(model.body_parentid[body]) - 1,
        tuple(_joint(model, int(first) + k) for k in range(model.body_jntnum[body])),
    )


def _joint(model: Any, joint: int) -> StatedJoint:
    import mujoco

    def first(values: Any) -> float:
        return float(np.ravel(values)[0])

    kind = ("free", "ball", "slide", "hinge")[model.jnt_type[joint]]
    name, rate, place = model.joint(joint).name, model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    scalar = kind in ("slide", "hinge")
    limits, effort = UNLIMITED, None
    if model.jnt_limited[joint]:
        limits = (float(model.jnt_range[joint][0]), float(model.jnt_range[joint][1]))
    if hasattr(model, "jnt_actfrcrange"):
        limited = model.jnt_actfrclimited[joint]
        effort = float(np.max(np.abs(model.jnt_actfrcrange[joint]))) if limited else float("inf")
    gains, mimic = np.zeros(2), None
    for k in range(model.nu):
        affine = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
        if model.actuator_trntype[k] in _OF_JOINTS and model.actuator_trnid[k][0] == joint and affine:
            gains -= model.actuator_gear[k][0] ** 2 * model.actuator_biasprm[k][1:3]
    for k in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)).tolist():
        offset, factor, *others = model.eq_data[k][:5].tolist()
        if model.eq_obj1id[k] == joint and model.eq_obj2id[k] >= 0 and not any(others):
            mimic = (model.joint(model.eq_obj2id[k]).name, factor, offset)
    return StatedJoint(
        name,
        kind,
        0,
        tuple(model.jnt_axis[joint].tolist()) if scalar else None,
        first(model.dof_damping[rate]),
        limits,
        tuple(model.jnt_pos[joint].tolist()),
        friction=first(model.dof_frictionloss[rate]),
        armature=first(model.dof_armature[rate]),
        stiffness=first(model.jnt_stiffness[joint]),
        rest=float(model.qpos_spring[place]) if scalar else None,
        reference=float(model.qpos0[place]) if scalar else None,
        effort=effort,
        mimic=mimic,
        gains=(float(gains[0]), float(gains[1])),
    )


def spin(request: ImportRequest, spin: SpinRequest) -> Array:
    """Spin the only body on a free joint with RK4; without gravity, contacts and damping."""
    import mujoco

    spec = _spec(request)
    body = spec.worldbody.first_body()
    if body is None:
        raise ValueError("the import has no body")
    if not list(body.joints):
        body.add_freejoint()
    spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_RK4, spin.dt_s
    spec.option.gravity = np.zeros(3)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[3:7] = [1.0, 0.0, 0.0, 0.0]
    data.qvel[3:6] = spin.omega_rad_s
    found = []
    for sample in range(spin.samples):
        if sample:
            mujoco.mj_step(model, data, nstep=spin.steps_per_sample)
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, data.qpos[3:7])
        found.append(matrix.reshape(3, 3))
    return np.array(found)
