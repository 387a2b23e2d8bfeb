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
    SpinRequest,
    tensor_of,
)
from bodycheck.reference_impl.arrays import Array

FLAGS = {
    "urdf": {
        DEFAULT: "MjSpec.from_file(FILE).compile()",
        RECOMMENDED: f"fusestatic=false, {WITHOUT_MESHES}",
    },
    "mjcf": {DEFAULT: "MjSpec.from_file(FILE).compile()"},
}


def _spec(request: ImportRequest) -> Any:
    import mujoco

    if request.format == "urdf" and request.flags == RECOMMENDED:
        spec = mujoco.MjSpec.from_string(request.bare)
        spec.compiler.fusestatic = False
        return spec
    return mujoco.MjSpec.from_file(request.file)


def imported_links(request: ImportRequest) -> list[ImportedLink]:
    """Return the bodies of the compiled model, the world left out."""
    model = _spec(request).compile()
    return [_link(model, body) for body in range(1, model.nbody)]


def _link(model: Any, body: int) -> ImportedLink:
    import mujoco

    joint, damping, limits = model.body_jntadr[body], None, None
    if model.body_jntnum[body] == 1 and model.jnt_type[joint] in (
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
    ):
        damping = float(np.ravel(model.dof_damping[model.jnt_dofadr[joint]])[0])
        if model.jnt_limited[joint]:
            low, high = model.jnt_range[joint]
            limits = (float(low), float(high))
    return ImportedLink(
        model.body(body).name,
        float(model.body_mass[body]),
        model.body_ipos[body].tolist(),
        tensor_of(model.body_inertia[body], model.body_iquat[body]),
        damping,
        limits,
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
