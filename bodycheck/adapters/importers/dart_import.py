"""DART's importers of URDF, MJCF and SDFormat."""

from __future__ import annotations

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
    SpinRequest,
    file_to_import,
)
from bodycheck.reference_impl.arrays import Array

FLAGS = {
    "urdf": {DEFAULT: "DartLoader().parseSkeleton(FILE)", RECOMMENDED: WITHOUT_MESHES},
    "mjcf": {DEFAULT: "MjcfParser.readWorld(FILE)"},
    "sdf": {
        DEFAULT: "SdfParser.readWorld(FILE), or readSkeleton(FILE) without a <world>",
        RECOMMENDED: WITHOUT_MESHES,
    },
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
    skeletons = _skeletons(request)
    return [_link(one.getBodyNode(k)) for one in skeletons for k in range(one.getNumBodyNodes())]


def _link(node: Any) -> ImportedLink:
    inertia, joint = node.getInertia(), node.getParentJoint()
    damping = limits = None
    if joint.getNumDofs() == 1:
        damping = float(joint.getDampingCoefficient(0))
        low, high = joint.getPositionLowerLimit(0), joint.getPositionUpperLimit(0)
        limits = (float(low), float(high)) if np.isfinite([low, high]).all() else None
    return ImportedLink(
        node.getName(),
        float(inertia.getMass()),
        np.array(inertia.getLocalCOM()).tolist(),
        np.array(inertia.getMoment()).tolist(),
        damping,
        limits,
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
