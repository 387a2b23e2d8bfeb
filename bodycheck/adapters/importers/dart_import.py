"""DART's importers of URDF, MJCF and SDFormat."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.untrusted import read_bytes
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
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files.joint import StatedJoint, limit_of

FLAGS = {
    "urdf": {DEFAULT: "DartLoader().parseSkeleton(FILE)", RECOMMENDED: WITHOUT_MESHES},
    "mjcf": {DEFAULT: "MjcfParser.readWorld(FILE)"},
    "sdf": {
        DEFAULT: "SdfParser.readWorld(FILE), or readSkeleton(FILE) without a <world>",
        RECOMMENDED: WITHOUT_MESHES,
    },
}

_KINDS = {
    "RevoluteJoint": "hinge",
    "PrismaticJoint": "slide",
    "BallJoint": "ball",
    "FreeJoint": "free",
    "WeldJoint": "fixed",
}


def _skeletons(request: ImportRequest) -> list[Any]:
    with file_to_import(request) as file:
        return _read(file, request)


def _read(file: str, request: ImportRequest) -> list[Any]:
    import dartpy

    if request.format == "sdf" and not _has_world(file):
        skeleton = dartpy.utils.SdfParser.readSkeleton(file)
        if skeleton is None:
            raise ValueError("SdfParser.readSkeleton returned nothing")
        return [skeleton]
    if request.format != "urdf":
        parser = dartpy.utils.MjcfParser if request.format == "mjcf" else dartpy.utils.SdfParser
        world = parser.readWorld(file)
        if world is None:
            raise ValueError(f"{parser.__name__}.readWorld returned nothing")
        return [world.getSkeleton(k) for k in range(world.getNumSkeletons())]
    loader = dartpy.utils.DartLoader()
    for folder in Path(request.file).parents:  # package://NAME/ is the nearest folder of that name
        if folder.name:
            loader.addPackageDirectory(folder.name, str(folder))
    skeleton = loader.parseSkeleton(file)
    if skeleton is None:
        raise ValueError("DartLoader.parseSkeleton returned nothing")
    return [skeleton]


def _has_world(file: str) -> bool:
    return b"<world" in re.sub(rb"<!--.*?-->", b"", read_bytes(Path(file)), flags=re.DOTALL)


def imported_links(request: ImportRequest) -> list[ImportedLink]:
    """Return the body nodes of every skeleton that the file makes."""
    found: list[ImportedLink] = []
    for skeleton in _skeletons(request):
        found += _links(skeleton, len(found))
    return found


def _links(skeleton: Any, before: int) -> list[ImportedLink]:
    """Return the links of a skeleton, with all coordinates at zero; `before`: the index of the first."""
    skeleton.setPositions(np.zeros(skeleton.getNumDofs()))
    return [_link(skeleton.getBodyNode(k), before) for k in range(skeleton.getNumBodyNodes())]


def mass_matrices(request: ImportRequest, count: int) -> list[MassMatrices]:
    """Return M of every skeleton whose joints are hinges, slides, balls or free."""
    found, before = [], 0
    for skeleton in _skeletons(request):
        links = _links(skeleton, before)
        # rates of a skeleton are in the order of its body nodes
        if columns := rates_of(links):
            moved = random_displacements(links, columns, count)
            values = []
            for displacement in moved:
                skeleton.setPositions(displacement)
                values.append(np.array(skeleton.getMassMatrix()))
            placed = [(before + link, joint) for link, joint in columns]
            found.append(MassMatrices(placed, moved, np.array(values)))
        before += len(links)
    return found


def _link(node: Any, before: int) -> ImportedLink:
    inertia, parent, pose = node.getInertia(), node.getParentBodyNode(), node.getTransform()
    return ImportedLink(
        node.getName(),
        float(inertia.getMass()),
        np.array(inertia.getLocalCOM()).tolist(),
        np.array(inertia.getMoment()).tolist(),
        np.array(pose.translation()).tolist(),
        np.array(pose.rotation()).tolist(),
        -1 if parent is None else before + int(parent.getIndexInSkeleton()),
        (_joint(node.getParentJoint()),),
    )


def _joint(joint: Any) -> StatedJoint:
    kind = _KINDS.get(joint.getType(), joint.getType())
    if not joint.getNumDofs():
        return StatedJoint(joint.getName(), kind, 0)
    within = joint.getTransformFromChildBodyNode()
    axis = None
    if kind in ("hinge", "slide"):
        axis = tuple((np.array(within.rotation()) @ np.array(joint.getAxis())).tolist())
    follows = joint.getActuatorType().name == "MIMIC"
    return StatedJoint(
        joint.getName(),
        kind,
        0,
        axis,
        float(joint.getDampingCoefficient(0)),
        (float(joint.getPositionLowerLimit(0)), float(joint.getPositionUpperLimit(0))),
        tuple(np.array(within.translation()).tolist()),
        friction=float(joint.getCoulombFriction(0)),
        armature=0.0,
        stiffness=float(joint.getSpringStiffness(0)),
        rest=float(joint.getRestPosition(0)),
        reference=0.0,
        effort=limit_of(float(joint.getForceUpperLimit(0))),
        velocity=limit_of(float(joint.getVelocityUpperLimit(0))),
        mimic=("", math.nan, math.nan) if follows else None,  # dartpy does not report which joint
        gains=(0.0, 0.0),
    )


def spin(request: ImportRequest, spin: SpinRequest) -> Array:
    """Spin the root body node on its free joint, without gravity."""
    (skeleton,) = _skeletons(request)
    skeleton.setGravity(np.zeros(3))
    skeleton.setTimeStep(spin.dt_s)
    joint, body = skeleton.getRootJoint(), skeleton.getBodyNode(0)
    if joint.getNumDofs() != 6:
        raise ValueError(f"the root joint is a {joint.getType()}, not free")
    arm = np.array(body.getInertia().getLocalCOM())
    omega = np.array(spin.omega_rad_s)
    joint.setPositions(np.zeros(6))
    joint.setVelocities(np.concatenate([omega, -np.cross(omega, arm)]))  # the centre of mass at rest
    found = []
    for sample in range(spin.samples):
        for _ in range(spin.steps_per_sample if sample else 0):
            skeleton.computeForwardDynamics()
            skeleton.integrateVelocities(spin.dt_s)
            skeleton.integratePositions(spin.dt_s)
        found.append(np.array(body.getTransform().rotation()))
    return np.array(found)
