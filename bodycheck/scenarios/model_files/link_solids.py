"""The solids that the shapes of a link bound, at unit density, and how far they reach."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.scenarios.mass_properties.solid import MassProperties, Triangles, primitive
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.mjcf_shapes import mesh_inertia
from bodycheck.scenarios.model_files.model_file import ModelFile, Shape
from bodycheck.scenarios.model_files.shape_sizes import mesh_of
from bodycheck.scenarios.model_files.urdf import resolved

_Scale: TypeAlias = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Part:
    """A shape of known size: its kind, pose R (3, 3) and p (3,) in the link, and its solid in link axes.

    sizes: in m, as `primitive` defines them; none for a mesh. solid: at unit density; None for an open mesh.
    points (n, 3): in link axes, of a mesh, and the corners of a box.
    """

    kind: str
    sizes: tuple[float, ...]
    rotation: Array
    position: Array
    solid: MassProperties | None
    points: Array | None = None

    def reach(self, centre: Array) -> float:
        """max |x - c| over the shape, of an ellipsoid an upper bound, for a point c (3,) in link axes."""
        if self.points is not None:
            return float(np.max(np.linalg.norm(self.points - centre, axis=1)))
        arm = self.position - centre
        match self.kind:
            case "cylinder":
                radius, length = self.sizes
                axis = self.rotation[:, 2]
                along = abs(float(arm @ axis))
                across = float(np.linalg.norm(arm - (arm @ axis) * axis))
                return float(np.hypot(along + length / 2.0, across + radius))
            case "capsule":
                radius, length = self.sizes
                ends = arm + np.outer([-0.5, 0.5], length * self.rotation[:, 2])
                return float(np.max(np.linalg.norm(ends, axis=1))) + radius
        return float(np.linalg.norm(arm)) + max(self.sizes)

    @cached_property
    def corners(self) -> Array:
        """The points (n, 3) in link axes, of a mesh or of a box around the shape, whose hull holds it."""
        if self.points is not None:
            return self.points
        half = np.full(3, self.sizes[0])
        if self.kind in ("cylinder", "capsule"):
            half[2] = self.sizes[1] / 2.0 + (self.sizes[0] if self.kind == "capsule" else 0.0)
        elif self.kind == "ellipsoid":
            half = np.array(self.sizes)
        return np.asarray(_SIGNS * half @ self.rotation.T + self.position)

    @cached_property
    def span(self) -> tuple[Array, Array]:
        """The least and the greatest coordinates (3,) in link axes, of the box around the shape."""
        return self.corners.min(axis=0), self.corners.max(axis=0)


def sizes_of(shape: Shape, model: ModelFile) -> tuple[float, ...] | None:
    """Return the sizes of a primitive in m as `primitive` defines them; None if they are not known."""
    half = 2.0 if model.format == "mjcf" else 1.0
    match shape.kind, shape.size:
        case "box", (x, y, z):
            sizes: tuple[float, ...] = (half * x, half * y, half * z)
        case (("cylinder" | "capsule"), (radius, length, *_)):
            sizes = (radius, half * length)
        case "sphere", (radius, *_):
            sizes = (radius,)
        case "ellipsoid", (_, _, _):
            sizes = shape.size
        case _:
            return None
    return sizes if all(size > 0.0 for size in sizes) else None


def parts_of(shapes: Iterable[Shape], model: ModelFile) -> list[Part] | None:
    """Return the parts that shapes are; None if the size of one of them is not known."""
    found = []
    for shape in shapes:
        part = _part(shape, model)
        if part is None:
            return None
        found.append(part)
    return found


def _part(shape: Shape, model: ModelFile) -> Part | None:
    R, p = doubles(shape.frame.rotation), doubles(shape.frame.position)
    if shape.kind == "mesh":
        if not shape.mesh or len(shape.scale) != 3:
            return None
        mesh = _mesh(resolved(shape.mesh, model.path), shape.scale)
        if mesh is None:
            return None
        vertices, solid = mesh
        return Part("mesh", (), R, p, _placed(solid, R, p), vertices @ R.T + p)
    sizes = sizes_of(shape, model)
    if sizes is None:
        return None
    try:
        solid = primitive(shape.kind, sizes)
    except ValueError:  # beyond the range of lengths
        return None
    corners = 0.5 * _SIGNS * np.array(sizes) @ R.T + p if shape.kind == "box" else None
    return Part(shape.kind, sizes, R, p, _placed(solid, R, p), corners)


_SIGNS = np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T


def _placed(solid: MassProperties | None, R: Array, p: Array) -> MassProperties | None:
    return None if solid is None else solid.rotated(R).translated(p)


@lru_cache(maxsize=64)
def _mesh(path: Path, scale: _Scale) -> tuple[Array, MassProperties | None] | None:
    """Return the vertices (n, 3) of a mesh and its solid, None if it is open; None if it cannot be read."""
    mesh = mesh_of(path)
    if mesh is None:
        return None
    vertices, triangles = mesh
    return closed_solid(vertices * scale, triangles)


def closed_solid(vertices: Array, triangles: Triangles) -> tuple[Array, MassProperties | None]:
    """Return the vertices (n, 3) that triangles use, and the solid that these bound at unit density.

    The solid is None if an edge has not one neighbour in the other direction.
    """
    vertices, triangles = np.unique(vertices[triangles.ravel()], axis=0, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    return vertices, _solid_of(vertices, triangles)


def _solid_of(vertices: Array, triangles: Triangles) -> MassProperties | None:
    edges = np.concatenate([triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    edges = edges[edges[:, 0] != edges[:, 1]]
    n = len(vertices)
    forward, backward = (np.sort(edges[:, a] * n + edges[:, b]) for a, b in ((0, 1), (1, 0)))
    if not np.array_equal(forward, backward):
        return None
    try:
        return MassProperties(*mesh_inertia(vertices, triangles, "exact"))
    except ValueError:
        pass
    try:
        return MassProperties(*mesh_inertia(vertices, triangles[:, [0, 2, 1]], "exact"))
    except ValueError:
        return None


def united(parts: Iterable[Part], mass: float) -> MassProperties | None:
    """Return parts as one body of uniform density and this mass; None if one has no solid.

    What parts share is counted twice.
    """
    solids = [part.solid for part in parts]
    if not solids or None in solids:
        return None
    known = [solid for solid in solids if solid is not None]
    volume = sum(solid.mass for solid in known)
    centre = sum((solid.mass * solid.centre for solid in known), np.zeros(3)) / volume
    inertia = sum((solid.inertia_about(centre) for solid in known), np.zeros((3, 3)))
    return MassProperties(mass, centre, inertia * (mass / volume))


def masses_explain(parts: Iterable[Part], body: MassProperties, tolerance: float) -> bool:
    """Return whether masses of the parts, none negative, add up to a body, to a relative tolerance."""
    from scipy.optimize import nnls  # few links need it, and importing it takes time

    solids = [part.solid for part in parts if part.solid is not None]
    length = max(float(np.sqrt(np.trace(body.inertia) / body.mass)), 1e-300)
    rows, columns = np.triu_indices(3)

    def moments(solid: MassProperties) -> Array:
        """Return 1, x and the tensor about the body's centre, per mass, in units of `length`."""
        arm = (solid.centre - body.centre) / length
        about = solid.inertia / (solid.mass * length**2) + parallel_axis_tensor(arm)
        return np.concatenate([[1.0], arm, about[rows, columns]])

    A = np.stack([moments(solid) for solid in solids], axis=1)
    _, residual = nnls(A, moments(body))
    return bool(residual <= tolerance)
