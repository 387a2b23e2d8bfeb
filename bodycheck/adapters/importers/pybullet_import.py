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
    MassMatrices,
    SpinRequest,
    file_to_import,
    random_displacements,
    rates_of,
    tensor_of,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint, limit_of

FLAGS = {
    "urdf": {
        DEFAULT: "loadURDF(FILE)",
        RECOMMENDED: f"flags=URDF_USE_INERTIA_FROM_FILE, {WITHOUT_MESHES}",
    },
    "mjcf": {DEFAULT: "loadMJCF(FILE)"},
    "sdf": {DEFAULT: "loadSDF(FILE)", RECOMMENDED: WITHOUT_MESHES},
}
_REVOLUTE, _PRISMATIC = 0, 1
_KINDS = {_REVOLUTE: "hinge", _PRISMATIC: "slide", 2: "ball", 3: "planar", 4: "fixed"}


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
        found: list[ImportedLink] = []
        for body in bodies:
            found += _links(bullet, client, body, len(found))
        return found


def _links(bullet: Any, client: int, body: int, before: int) -> list[ImportedLink]:
    """Return base and links of a body, with all coordinates at zero; `before`: the index of its base."""
    count = bullet.getNumJoints(body, physicsClientId=client)
    infos = [bullet.getJointInfo(body, k, physicsClientId=client) for k in range(count)]
    for k, info in enumerate(infos):
        if info[2] in (_REVOLUTE, _PRISMATIC):
            bullet.resetJointState(body, k, 0.0, physicsClientId=client)
    held = [bullet.getDynamicsInfo(body, k, physicsClientId=client) for k in range(-1, count)]
    principal = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
    poses = [bullet.multiplyTransforms(*principal, *bullet.invertTransform(held[0][3], held[0][4]))]
    for k in range(count):
        state = bullet.getLinkState(body, k, computeForwardKinematics=1, physicsClientId=client)
        poses.append(state[4:6])
    name = bullet.getBodyInfo(body, physicsClientId=client)[0]
    base = StatedJoint("", "free" if held[0][0] > 0.0 else "fixed", 0)  # Bullet fixes a base without mass
    found = [_link(name, held[0], poses[0], -1, base)]
    for info, dynamics, pose in zip(infos, held[1:], poses[1:], strict=True):
        found.append(_link(info[12], dynamics, pose, before + 1 + info[16], _joint(info, dynamics)))
    return found


def _link(name: bytes, dynamics: Any, pose: Any, parent: int, joint: StatedJoint) -> ImportedLink:
    return ImportedLink(
        name.decode(errors="replace"),
        float(dynamics[0]),
        list(dynamics[3]),
        tensor_of(dynamics[2], _scalar_first(dynamics[4])),
        list(pose[0]),
        quaternion_to_matrix(np.array(_scalar_first(pose[1]))).tolist(),
        parent,
        (joint,),
    )


def _scalar_first(quaternion: Any) -> tuple[float, ...]:
    x, y, z, w = quaternion
    return w, x, y, z


def _joint(info: Any, dynamics: Any) -> StatedJoint:
    kind, name = _KINDS.get(info[2], "another kind"), info[1].decode(errors="replace")
    if kind == "fixed":
        return StatedJoint(name, kind, 0)
    axis, limits = None, UNLIMITED
    if kind in ("hinge", "slide"):
        to_link = quaternion_to_matrix(np.array(_scalar_first(dynamics[4])))
        axis = tuple((to_link @ info[13]).tolist())  # held in principal axes
        if info[8] <= info[9]:  # lower > upper: no limit
            limits = (float(info[8]), float(info[9]))
    return StatedJoint(
        name,
        kind,
        0,
        axis,
        float(info[6]),
        limits,
        friction=float(info[7]),
        armature=0.0,
        stiffness=0.0,
        rest=0.0,
        reference=0.0,
        effort=limit_of(float(info[10])),
        velocity=limit_of(float(info[11])),
        gains=(0.0, 0.0),
    )


def mass_matrices(request: ImportRequest, count: int) -> list[MassMatrices]:
    """Return M of every body whose joints are hinges and slides; that of balls has other coordinates."""
    with _loaded(request) as (bullet, client, bodies):
        found, before = [], 0
        for body in bodies:
            links = _links(bullet, client, body, before)
            columns = rates_of(links)
            moving = [k for k, link in enumerate(links) if link.joints[0].motion in ("hinge", "slide")]
            if columns and moving and all(link.joints[0].motion != "ball" for link in links):
                moved = random_displacements(links, columns, count)
                of_joints = moved[:, len(columns) - len(moving) :].tolist()
                values = [bullet.calculateMassMatrix(body, at, physicsClientId=client) for at in of_joints]
                placed = [(before + link, joint) for link, joint in columns]
                found.append(MassMatrices(placed, moved, np.array(values)))
            before += len(links)
        return found


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
