"""PyBullet's importers of URDF, MJCF and SDFormat."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck.adapters.importers import (
    DEFAULT,
    RECOMMENDED,
    WITHOUT_MESHES,
    ImportedLink,
    ImportRequest,
    SpinRequest,
    file_to_import,
    tensor_of,
)
from bodycheck.reference_impl.arrays import Array

FLAGS = {
    "urdf": {
        DEFAULT: "loadURDF(FILE)",
        RECOMMENDED: f"flags=URDF_USE_INERTIA_FROM_FILE, {WITHOUT_MESHES}",
    },
    "mjcf": {DEFAULT: "loadMJCF(FILE)"},
    "sdf": {DEFAULT: "loadSDF(FILE)", RECOMMENDED: WITHOUT_MESHES},
}
_REVOLUTE, _PRISMATIC, _FIXED = 0, 1, 4


@contextmanager
def _loaded(request: ImportRequest) -> Iterator[tuple[Any, int, tuple[int, ...]]]:
    """Load a file in a new server, with its folder as working directory as PyBullet's users do."""
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    before = Path.cwd()
    try:
        with file_to_import(request) as file:
            os.chdir(Path(file).parent)
            if request.format == "mjcf":
                bodies = pybullet.loadMJCF(file, physicsClientId=client)
            elif request.format == "sdf":
                bodies = pybullet.loadSDF(file, physicsClientId=client)
            else:
                flags = pybullet.URDF_USE_INERTIA_FROM_FILE if request.flags == RECOMMENDED else 0
                bodies = (pybullet.loadURDF(file, flags=flags, physicsClientId=client),)
        yield pybullet, client, bodies
    finally:
        os.chdir(before)
        pybullet.disconnect(client)


def imported_links(request: ImportRequest) -> list[ImportedLink]:
    """Return base and links of every body that the file makes."""
    with _loaded(request) as (bullet, client, bodies):
        found = []
        for body in bodies:
            joints = [
                bullet.getJointInfo(body, k, physicsClientId=client)
                for k in range(bullet.getNumJoints(body, physicsClientId=client))
            ]
            for index, joint in enumerate([None, *joints], start=-1):
                info = bullet.getDynamicsInfo(body, index, physicsClientId=client)
                name = bullet.getBodyInfo(body, physicsClientId=client)[0] if joint is None else joint[12]
                found.append(_link(name.decode(errors="replace"), info, joint))
        return found


def _link(name: str, info: Any, joint: Any) -> ImportedLink:
    x, y, z, w = info[4]
    damping = limits = None
    if joint is not None and joint[2] != _FIXED:
        damping = float(joint[6])
        if joint[2] in (_REVOLUTE, _PRISMATIC) and joint[8] <= joint[9]:  # lower > upper: no limit
            limits = (float(joint[8]), float(joint[9]))
    tensor = tensor_of(info[2], (w, x, y, z))
    return ImportedLink(name, float(info[0]), list(info[3]), tensor, damping, limits)


def spin(request: ImportRequest, spin: SpinRequest) -> Array:
    """Spin the base; only the recommended flags come with damping and the limit of speed switched off."""
    with _loaded(request) as (bullet, client, bodies):
        body = bodies[0]
        bullet.setGravity(0.0, 0.0, 0.0, physicsClientId=client)
        bullet.setTimeStep(spin.dt_s, physicsClientId=client)
        if request.flags == RECOMMENDED:
            bullet.changeDynamics(
                body, -1, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=1e30, physicsClientId=client
            )
        frame = np.array(bullet.getDynamicsInfo(body, -1, physicsClientId=client)[4])
        to_link = np.array(bullet.getMatrixFromQuaternion(frame)).reshape(3, 3)  # inertial to link axes
        here = bullet.getBasePositionAndOrientation(body, physicsClientId=client)[0]
        bullet.resetBasePositionAndOrientation(body, here, frame, physicsClientId=client)
        bullet.resetBaseVelocity(body, [0.0] * 3, list(spin.omega_rad_s), physicsClientId=client)
        found = []
        for sample in range(spin.samples):
            for _ in range(spin.steps_per_sample if sample else 0):
                bullet.stepSimulation(physicsClientId=client)
            _, quaternion = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
            R = np.array(bullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
            found.append(R @ to_link.T)
        return np.array(found)
