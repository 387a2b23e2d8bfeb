"""Bodies from shapes: mass properties of a mesh file or a primitive of one density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bodycheck.errors import InputError
from bodycheck.reference_impl.mass_properties import primitives
from bodycheck.reference_impl.mass_properties.mesh_check import checked_mesh
from bodycheck.reference_impl.mass_properties.polyhedron import polyhedron
from bodycheck.reference_impl.mass_properties.solid import MassProperties
from bodycheck.scenarios.mesh_files import read_mesh


def load_mesh(path: Path, density: float) -> MassProperties:
    """Return the mass properties, in the file's own axes, of the solid that a mesh file bounds.

    Lengths in the file are taken as m; density in kg/m^3. The notes say what was put right in the mesh.
    Raises InputError with one line where the file, the mesh or the density is not good for it.
    """
    vertices, triangles = read_mesh(path)
    try:
        mesh = checked_mesh(vertices, triangles)
        solid = polyhedron(mesh.vertices, mesh.triangles).at_density(density)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return replace(solid, notes=mesh.notes)


def primitive(shape: str, size: Sequence[float], density: float) -> MassProperties:
    """Return the mass properties of a primitive, its centre at the origin, its axis along z.

    Sizes in m: box, the full edges along x, y, z; sphere, the radius; ellipsoid, the semi-axes along x, y, z;
    cylinder, radius and length; capsule, radius and length of the cylindrical part; torus, major and minor
    radius. Density in kg/m^3. Raises InputError with one line where one of them is wrong.
    """
    try:
        return primitives.primitive(shape, size).at_density(density)
    except ValueError as error:
        raise InputError(str(error)) from None
