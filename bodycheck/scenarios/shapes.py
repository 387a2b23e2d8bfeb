"""Bodies from shapes: mass properties of a mesh file or a primitive of one density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from importlib.resources.abc import Traversable
from pathlib import Path

from bodycheck.errors import InputError
from bodycheck.reference_impl.mass_properties import primitives
from bodycheck.reference_impl.mass_properties.solid import MassProperties
from bodycheck.scenarios.known_solids import known_solid
from bodycheck.scenarios.mesh_files import mesh_bytes, parse_mesh


@dataclass(frozen=True)
class MeshSolid:
    """A mesh file's name and SHA-256, and the solid that it bounds, at unit density in the file's axes."""

    name: str
    sha256: str
    solid: MassProperties = field(compare=False)


def mesh_solid(folder: Traversable, name: str) -> MeshSolid:
    """Return the solid that a mesh file, named from a folder, bounds; lengths in it are taken as m.

    The notes of the solid say what was put right in the mesh. Raises InputError with one line where the
    file or the mesh is not good for it.
    """
    path = folder.joinpath(name)
    data = mesh_bytes(path)
    digest = sha256(data).hexdigest()
    return MeshSolid(name, digest, known_solid(f"{digest}{Path(name).suffix}", lambda: _solid(path, data)))


def _solid(path: Traversable, data: bytes) -> MassProperties:
    # late: numba takes a second to begin with, and most meshes were worked out before
    from bodycheck.reference_impl.mass_properties.mesh_check import checked_mesh
    from bodycheck.reference_impl.mass_properties.polyhedron import polyhedron

    vertices, triangles = parse_mesh(path, data)
    try:
        mesh = checked_mesh(vertices, triangles)
        solid = polyhedron(mesh.vertices, mesh.triangles)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return replace(solid, notes=mesh.notes)


def load_mesh(path: Path, density: float) -> MassProperties:
    """Return the mass properties of a mesh file's solid at a density in kg/m^3.

    Raises InputError with one line where the file, the mesh or the density is not good for it.
    """
    solid = mesh_solid(path.parent, path.name).solid
    try:
        return solid.at_density(density)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


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
