"""Extents and uniform-density tensors of collision shapes, as estimates to compare stated inertias with."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import MassProperties, Triangles, primitive
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, Shape
from bodycheck.scenarios.model_files.urdf import resolved

_LARGEST_MESH = 30_000_000  # bytes: larger ones take seconds


def half_extents(shape: Shape, model: ModelFile) -> tuple[Array, Array] | None:
    """Return middle and half edges (3,) of the box around a shape, in its axes; None if unknown."""
    size = np.array(shape.size)
    half = model.format == "mjcf"
    match shape.kind:
        case "box" if len(size) == 3:
            return np.zeros(3), size if half else size / 2.0
        case "ellipsoid" if len(size) == 3:
            return np.zeros(3), size
        case "sphere" if len(size) >= 1:
            return np.zeros(3), np.full(3, size[0])
        case "cylinder" | "capsule" if len(size) >= 2:
            half_size = (size[1] if half else size[1] / 2.0) + (size[0] if shape.kind == "capsule" else 0.0)
            return np.zeros(3), np.array([size[0], size[0], half_size])
        case "mesh" if shape.mesh and len(shape.scale) == 3:
            box = _mesh_box(resolved(shape.mesh, model.path))
            if box is not None:
                low, high = np.array(box) * np.array(shape.scale)
                return 0.5 * (low + high), 0.5 * np.abs(high - low)
    return None


@cache
def _mesh_box(path: Path) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    mesh = mesh_of(path)
    if mesh is None:
        return None
    vertices, _ = mesh
    return tuple(vertices.min(axis=0).tolist()), tuple(vertices.max(axis=0).tolist())


def mesh_of(path: Path) -> tuple[Array, Triangles] | None:
    """Return vertices (n, 3) and triangles (m, 3) of a mesh file.

    None if it is large, cannot be read or has vertices that are not finite.
    """
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST_MESH:
            return None
        with open_mesh(path) as file:
            vertices, triangles = parse_mesh(path, file)
    except (InputError, OSError, ValueError):
        return None  # its size is then unknown; importers report what they make of it
    return (vertices, triangles) if np.isfinite(vertices).all() else None


def uniform(link: ModelLink, model: ModelFile) -> MassProperties | None:
    """Return a link's only shape at the link's mass and uniform density, in link axes; None if it is not one.

    A mesh counts as the box around it.
    """
    if len(link.collisions) != 1 or link.stated is None:
        return None
    (shape,) = link.collisions
    solid = _solid(shape, model)
    if solid is None:
        return None
    mass = float(link.stated.inertia.mass)
    solid = solid.rotated(doubles(shape.frame.rotation)).translated(doubles(shape.frame.position))
    return solid.at_density(mass / solid.mass) if mass > 0.0 else None


def _solid(shape: Shape, model: ModelFile) -> MassProperties | None:
    """Return a shape at unit density in its axes, a mesh as the box around it; None if that is unknown."""
    box = half_extents(shape, model)
    if box is None or not np.all(box[1] > 0.0):
        return None
    middle, half = box
    match shape.kind:
        case "sphere":
            solid = primitive("sphere", [half[0]])
        case "ellipsoid":
            solid = primitive("ellipsoid", half.tolist())
        case "cylinder":
            solid = primitive("cylinder", [half[0], 2.0 * half[2]])
        case "capsule":
            solid = primitive("capsule", [half[0], 2.0 * (half[2] - half[0])])
        case _:
            solid = primitive("box", (2.0 * half).tolist())
    return solid.translated(middle)


def volume_m3(shape: Shape, model: ModelFile) -> float:
    """Return the volume of a shape in m^3; 0 for meshes and shapes whose size is unknown."""
    solid = None if shape.kind == "mesh" else _solid(shape, model)
    return 0.0 if solid is None else solid.mass


def bounding_boxes(link: ModelLink, model: ModelFile, mass: float, margin_m: float = 0.0) -> list[Array]:
    """Return tensors (3, 3) in link axes of uniform boxes around all shapes, along the axes of each frame.

    Once around the shapes that collide, and once around all: Bullet ignores the default classes of MJCF,
    which may say that shapes do not collide. margin_m: added to each mesh, and to each capsule that a file
    gives by its ends, as Bullet does.
    """
    found = []
    for shapes in dict.fromkeys((link.collisions, link.shapes)):
        inertial = [] if link.stated is None else [doubles(link.stated.frame.rotation)]
        for R in [np.eye(3), *inertial, *(doubles(shape.frame.rotation) for shape in shapes)]:
            spans = [span for shape in shapes if (span := span_along(shape, model, R, margin_m)) is not None]
            if spans:
                low, high = np.min([a for a, _ in spans], axis=0), np.max([b for _, b in spans], axis=0)
                edges = high - low
                found.append(R @ np.diag(mass / 12.0 * (edges @ edges - edges**2)) @ R.T)
    return found


def span_along(shape: Shape, model: ModelFile, R: Array, margin_m: float = 0.0) -> tuple[Array, Array] | None:
    """Return the least and the greatest coordinates (3,) of a shape along the columns of R, in link axes.

    margin_m: as in bounding_boxes. None if the size is unknown.
    """
    box = half_extents(shape, model)
    if box is None:
        return None
    middle, half = box
    relative = R.T @ doubles(shape.frame.rotation)
    at = relative @ middle + R.T @ doubles(shape.frame.position)
    along = np.abs(relative[:, 2])
    match shape.kind:
        case "sphere":
            half_size = half
        case "capsule" if shape.by_ends:  # Bullet makes it of two spheres, with a margin
            half_size = along * (half[2] - half[0]) + half[0] + margin_m
        case "capsule":  # Bullet rotates the capsule's box and takes the box around the result
            half_size = np.abs(relative) @ half
        case "mesh":
            half_size = np.abs(relative) @ (half + margin_m)
        case "cylinder":
            half_size = along * half[2] + np.sqrt(np.maximum(0.0, 1.0 - along**2)) * half[0]
        case _:
            half_size = np.abs(relative) @ half
    return at - half_size, at + half_size
