"""Name the cause of a difference between a stated and a held body, by trying each known fault on the file.

These faults are of importers: they rotate by frames of the file, drop or merge links and shapes, or compute
densities, none of which a scene has. So they are not among the faults of the diagnosis, which change how the
body of a scene moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, permutations, product

import numpy as np

from bodycheck._util.formatting import number, scientific
from bodycheck.audit.audit import SINGLE, Body, Difference
from bodycheck.audit.composite_causes import (
    WATER_KG_M3,
    Member,
    combined,
    composite_cause,
    invented,
    placed,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.scenarios.model_files.exact_arithmetic import (
    Frame,
    doubles,
    identity,
)
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, Shape
from bodycheck.scenarios.model_files.shape_sizes import bounding_boxes, uniform, volume_m3

DISCARDED = "tensor discarded"
_MARGIN_M = 0.04
"""Bullet's default margin of collision shapes."""
_MAX_SUBSETS = 8  # shapes: 255 sums, of which one agrees with a mass by chance once in 1,000 times
_NEARLY_A_BOX = 0.05  # shapes of meshes have small margins


KNOWN_ISSUES = {
    ("mujoco", "rotation of the inertial frame ignored"): "google-deepmind/mujoco#3559",
    ("mujoco", "rotation of the merged links ignored"): "google-deepmind/mujoco#2982",
    ("mujoco", "mimic dropped"): "google-deepmind/mujoco#3527",
    ("pybullet", "damping dropped"): "bulletphysics/bullet3#1916",
    ("usd", "rotated by the inverse of the principal axes"): "newton-physics/urdf-usd-converter#118",
    ("usd", "principal axes lost"): "isaac-sim/urdf-importer-extension#2",
    ("pybullet", f"{DISCARDED}: recomputed from the collision shape"): "bulletphysics/bullet3#1671",
    ("pybullet", f"{DISCARDED}: a placeholder"): "bulletphysics/bullet3#1671",
}
"""Engine or format, beginning of a cause -> where its developers discuss it."""


def with_issue(engine: str, cause: str) -> str:
    """Return a cause with the upstream issue about it, if one is known."""
    for (name, beginning), issue in KNOWN_ISSUES.items():
        if engine.partition("==")[0] == name and cause.startswith(beginning):
            return f"{cause} ({issue})"
    return cause


def body_causes(
    model: ModelFile,
    members: Sequence[Member],
    expected: Body | None,
    imported: Body,
    difference: Difference | None,
    discarded: str,
) -> tuple[str, ...]:
    """Return the named causes.

    members: the link and those merged into it. discarded: what a second import showed the tensor to come
    from, or "".
    """
    link = members[0][0]
    if expected is None or difference is None:
        return _invented(model, link, imported) if imported.mass_kg else ()
    if not (np.isfinite(imported.inertia_kg_m2).all() and math.isfinite(imported.mass_kg)):
        return ("not finite",)
    if difference.largest <= SINGLE:
        return (
            f"rounded: {scientific(difference.largest)}, as single precision or an unfinished iteration does",
        )
    if len(members) > 1 and (cause := composite_cause(model, members, expected, imported)):
        return (cause,)
    found = []
    if difference.mass > SINGLE:
        found.append(_mass_cause(model, members, expected, imported))
    if difference.centre > SINGLE:
        found.append(_centre_cause(link, expected, imported))
    if difference.inertia > SINGLE:
        found.append(_tensor_cause(model, members, expected, imported, discarded))
    return tuple(dict.fromkeys(found))


def _invented(model: ModelFile, link: ModelLink, imported: Body) -> tuple[str, ...]:
    """Return the cause of a mass that the file does not give."""
    shapes = invented(link, model)
    source = ""
    if shapes is not None and Difference.between(shapes, imported).largest <= SINGLE:
        source = f", made of its collision shapes at {WATER_KG_M3:g} kg/m^3"
    return (f"mass and tensor invented: the file gives this link no inertia{source}",)


def _mass_cause(model: ModelFile, members: Sequence[Member], expected: Body, imported: Body) -> str:
    def matches(mass: float) -> bool:
        return abs(mass - imported.mass_kg) <= SINGLE * imported.mass_kg

    link = members[0][0]
    if imported.mass_kg == 0.0:
        return "mass discarded: the link cannot move"
    if expected.mass_kg == 0.0:
        return f"mass invented: {number(imported.mass_kg, 6)} kg"
    if imported.mass_kg > expected.mass_kg and imported.mass_kg in (1e-3, 1e-6, 1e-2, 0.1, 1.0):
        return f"mass clamped to {number(imported.mass_kg, 6)} kg"
    if imported.mass_kg == 1.0 and np.array_equal(imported.inertia_kg_m2, np.eye(3)):
        return "mass discarded: 1 kg in its place"
    if (stated := link.stated) is not None:
        if len(members) > 1 and matches(float(stated.inertia.mass)):
            return "mass of this link alone: that of the links merged into it is lost"
        if len(stated.parts) > 1 and any(matches(float(part.mass)) for part in stated.parts):
            return f"mass of one of {len(stated.parts)} shapes only"
        if stated.overruled_mass is not None and matches(stated.overruled_mass):
            return "mass of <inertial>, which the file overrules by its geoms"
    if counted := _counted(link, model, imported.mass_kg):
        some = "the" if len(counted) == len(link.shapes) else f"{len(counted)} of {len(link.shapes)}"
        unsized = "" if set(counted) <= set(link.shapes) else ", boxes with half edges of 1 m"
        return f"mass recomputed: the volume of {some} shapes at {WATER_KG_M3:g} kg/m^3{unsized}"
    return f"mass times {number(imported.mass_kg / expected.mass_kg, 6)}"


def _counted(link: ModelLink, model: ModelFile, mass_kg: float) -> tuple[Shape, ...]:
    """Return the shapes that have a mass at the density of water, or none; all of them if possible.

    Of many shapes, all or one of them. Bullet gives half edges of 1 m to boxes that have their size from a
    default class.
    """
    unsized = tuple(
        replace(shape, size=(1.0, 1.0, 1.0)) if shape.kind == "box" else shape for shape in link.shapes
    )
    many = len(link.shapes) > _MAX_SUBSETS
    for shapes in dict.fromkeys((link.shapes, unsized)):
        volumes = [volume_m3(shape, model) for shape in shapes]
        for size in (len(shapes), 1) if many else range(len(shapes), 0, -1):
            for some in combinations(range(len(shapes)), size):
                mass = WATER_KG_M3 * sum(volumes[k] for k in some)
                if mass > 0.0 and abs(mass - mass_kg) <= SINGLE * mass:
                    return tuple(shapes[k] for k in some)
    return ()


def _centre_cause(link: ModelLink, expected: Body, imported: Body) -> str:
    scale = max(float(np.linalg.norm(expected.centre_m)), expected.gyration_m)

    def matches(other: Array) -> bool:
        return bool(np.linalg.norm(imported.centre_m - other) <= SINGLE * scale)

    if matches(np.zeros(3)):
        return "centre of mass ignored"
    if matches(-expected.centre_m):
        return "centre of mass of the wrong sign"
    parts = () if link.stated is None else link.stated.parts
    shapes = link.shapes if len(link.shapes) > 1 else ()
    centres = (*(part.centre for part in parts), *(shape.frame.position for shape in shapes))
    if len(centres) > 1 and any(matches(doubles(centre)) for centre in centres):
        return "centre of mass of one shape only"
    if link.stated is not None:
        turned = doubles(link.stated.frame.rotation)
        if matches(turned @ expected.centre_m) or matches(turned.T @ expected.centre_m):
            return "centre of mass rotated by the inertial frame"
    return f"centre of mass {number(float(np.linalg.norm(imported.centre_m - expected.centre_m)), 3)} m off"


def _tensor_cause(
    model: ModelFile, members: Sequence[Member], expected: Body, imported: Body, discarded: str
) -> str:
    if np.array_equal(imported.inertia_kg_m2, np.eye(3)):
        return "replaced by the identity"
    if discarded:
        return f"{DISCARDED}: {discarded}"
    size = max(float(np.max(np.abs(expected.inertia_kg_m2))), float(np.max(np.abs(imported.inertia_kg_m2))))
    for fault, tensor in _faults_of(members):
        other = float(np.max(np.abs(tensor - expected.inertia_kg_m2)))
        if other > SINGLE * size and float(np.max(np.abs(tensor - imported.inertia_kg_m2))) <= SINGLE * size:
            turned = _turned(expected, imported)
            return f"{fault}, {turned} degrees off" if turned else fault
    if imported.mass_kg > 0.0 and imported.mass_kg != expected.mass_kg > 0.0:
        scaled = expected.inertia_kg_m2 * (imported.mass_kg / expected.mass_kg)
        if float(np.max(np.abs(scaled - imported.inertia_kg_m2))) <= SINGLE * size:
            return "tensor scaled with the mass"
    link = members[0][0]
    moment = float(np.max(np.abs(imported.inertia_kg_m2)))
    for shape_name, tolerance, tensor in _of_shapes(link, model, imported.mass_kg):
        if moment > 0.0 and float(np.max(np.abs(tensor - imported.inertia_kg_m2))) <= tolerance * moment:
            return f"{DISCARDED}: recomputed from {shape_name}"
    return _by_moments(link, expected, imported)


def _of_shapes(link: ModelLink, model: ModelFile, mass_kg: float) -> Iterator[tuple[str, float, Array]]:
    """Yield what importers compute tensors (3, 3) from in place of the file's, with a relative tolerance."""
    solid = uniform(replace(link, shapes=tuple(replace(one, collides=True) for one in link.shapes)), model)
    if solid is not None:
        yield "the only shape", SINGLE, solid.inertia * (mass_kg / solid.mass)
    around, wider = "a box around the collision shapes", f" with margins of {_MARGIN_M:g} m"
    for box in bounding_boxes(link, model, mass_kg):
        yield around, _NEARLY_A_BOX, box
    for box in bounding_boxes(link, model, mass_kg, _MARGIN_M):
        yield around + wider, _NEARLY_A_BOX, box
    unturned = tuple(
        shape if shape.by_ends else replace(shape, frame=Frame(identity(), shape.frame.position))
        for shape in link.shapes
    )
    for box in bounding_boxes(replace(link, shapes=unturned), model, mass_kg, _MARGIN_M):
        yield f"{around} without their rotations", SINGLE, box
    counted = _counted(link, model, mass_kg)
    if counted and counted != link.shapes:
        for box in bounding_boxes(replace(link, shapes=counted), model, mass_kg, _MARGIN_M):
            yield f"a box around {len(counted)} of {len(link.shapes)} shapes", SINGLE, box


def _faults_of(members: Sequence[Member]) -> Iterator[tuple[str, Array]]:
    """Yield each known fault, and the tensor in link axes if it is made with every member, or with one."""
    stated = [(link, frame) for link, frame in members if link.stated is not None]
    bodies = [Body.of(link.stated.in_link) for link, _ in stated if link.stated is not None]
    faults = [list(_faults(link, body)) for (link, _), body in zip(stated, bodies, strict=True)]

    def with_tensors(tensors: Sequence[Array], *, turned: bool = True) -> Array:
        parts = []
        for (_, frame), body, tensor in zip(stated, bodies, tensors, strict=True):
            part = placed(Body(body.mass_kg, body.centre_m, tensor), frame)
            parts.append(part if turned else Body(part.mass_kg, part.centre_m, tensor))
        return combined(parts).inertia_kg_m2

    for made in zip(*faults, strict=True):
        yield made[0][0], with_tensors([tensor for _, tensor in made])
    if len(stated) > 1:
        right = [body.inertia_kg_m2 for body in bodies]
        yield "rotation of the merged links ignored", with_tensors(right, turned=False)
        for k, (link, _) in enumerate(stated):
            for fault, tensor in faults[k]:
                yield f"{fault}, in {link.name} only", with_tensors([*right[:k], tensor, *right[k + 1 :]])


def _faults(link: ModelLink, expected: Body) -> Iterator[tuple[str, Array]]:
    """Yield each known fault, and the tensor in link axes that it would make of the file."""
    stated = link.stated
    if stated is None:
        return
    J, R = doubles(stated.inertia.tensor), doubles(stated.frame.rotation)
    c, m = expected.centre_m, expected.mass_kg
    diagonal = np.diag(np.diagonal(J))
    yield "off-diagonals dropped", R @ diagonal @ R.T
    yield "off-diagonals of the wrong sign", R @ (2.0 * diagonal - J) @ R.T
    yield "rotation of the inertial frame ignored", J
    yield "rotated by the inverse of the inertial frame", R.T @ J @ R
    yield "rotation of the inertial frame applied twice", R @ R @ J @ R.T @ R.T
    yield "off-diagonals dropped and rotation of the inertial frame ignored", diagonal
    steiner = m * parallel_axis_tensor(c)
    yield "taken about the link's origin, not the centre of mass", expected.inertia_kg_m2 - steiner
    yield "held about the link's origin, not the centre of mass", expected.inertia_kg_m2 + steiner
    moments, V = np.linalg.eigh(J)
    yield "made isotropic: each moment is the mean", np.eye(3) * moments.mean()
    for order in permutations(range(3)):
        ordered = np.diag(moments[list(order)])
        yield "principal axes lost: the moments lie along the inertial frame", R @ ordered @ R.T
        yield "principal axes and rotation of the inertial frame lost", ordered
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=2)):
        A = V[:, list(order)] * np.array([*signs, 1.0])
        A[:, 2] *= np.linalg.det(A)
        ordered = np.diag(moments[list(order)])
        yield "rotated by the inverse of the principal axes", R @ A.T @ ordered @ A @ R.T
        yield "rotations composed in the wrong order", A @ R @ ordered @ R.T @ A.T
        yield "rotated by the inverse of inertial frame and principal axes", A.T @ R.T @ ordered @ R @ A


def _by_moments(link: ModelLink, expected: Body, imported: Body) -> str:
    """Return what the principal moments and axes alone tell."""
    given, found_moments = expected.principal[0], imported.principal[0]
    if not found_moments.any():
        return "tensor discarded: all moments are zero"
    if turned := _turned(expected, imported):
        return f"principal axes rotated by {turned} degrees"
    if given[2] > 0.0:
        ratio = imported.inertia_kg_m2 / given[2]
        factor = float(np.sum(ratio * expected.inertia_kg_m2) / np.sum(expected.inertia_kg_m2**2 / given[2]))
        if (
            np.max(np.abs(imported.inertia_kg_m2 - factor * expected.inertia_kg_m2))
            <= SINGLE * abs(factor) * given[2]
        ):
            scaling = link.inertia_scaling
            scaled = scaling != 1.0 and abs(factor - scaling) <= SINGLE * abs(scaling)
            return f"tensor times {number(factor, 6)}" + (": <inertia_scaling> of the file" if scaled else "")
    raised = [k for k in range(3) if found_moments[k] > given[k] * (1.0 + SINGLE)]
    others_equal = all(k in raised or abs(found_moments[k] - given[k]) <= SINGLE * given[2] for k in range(3))
    if (
        raised
        and others_equal
        and float(np.ptp(found_moments[raised])) <= SINGLE * float(found_moments[raised[0]])
    ):
        return f"moments clamped to {number(float(found_moments[raised[0]]), 4)} kg m^2"
    return "tensor changed; no known fault makes these numbers of the file"


def _turned(expected: Body, imported: Body) -> str:
    """Return the angle between the principal axes in degrees, where the moments are the same; else ""."""
    given, held = expected.principal[0], imported.principal[0]
    if not given[2] > 0.0 or np.max(np.abs(held - given)) > SINGLE * given[2]:
        return ""
    return number(math.degrees(_angle(expected, imported)), 4)


def _angle(expected: Body, imported: Body) -> float:
    """Return the smallest angle in rad between two sets of principal axes, which have no signs."""
    Q = expected.principal[1].T @ imported.principal[1]
    signed = (Q * np.array([a, b, 1.0]) for a, b in product((1.0, -1.0), repeat=2))
    angles = []
    for turn in signed:
        turn[:, 2] *= np.sign(np.linalg.det(turn)) or 1.0
        angles.append(math.acos(min(1.0, max(-1.0, (float(np.trace(turn)) - 1.0) / 2.0))))
    return min(angles)
