"""Bodies from shapes: mass properties of a mesh file or a primitive of one density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from hashlib import file_digest
from importlib.resources.abc import Traversable
from io import BufferedIOBase
from pathlib import Path

from bodycheck.errors import InputError
from bodycheck.reference_impl.mass_properties import primitives
from bodycheck.reference_impl.mass_properties.solid import MassProperties, Overlap
from bodycheck.scenarios.known_solids import known_solid
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh
from bodycheck.scenarios.mesh_units import UNITS, Unit, doubts


@dataclass(frozen=True)
class MeshSolid:
    """A mesh file's name and SHA-256, and the solid that it bounds, at unit density in the file's axes.

    unit: as it was stated, if it was; lengths are in m all the same.
    """

    name: str
    sha256: str
    unit: Unit | None
    solid: MassProperties = field(compare=False)

    def at_density(self, density: float) -> MassProperties:
        """Return the solid at a density in kg/m^3, noting what is implausible about it."""
        found = self.solid.at_density(density)
        return replace(found, notes=(*found.notes, *doubts(found, density, self.unit)))


def mesh_solid(
    folder: Traversable, name: str, unit: Unit | None = None, overlap: Overlap | None = None
) -> MeshSolid:
    """Return the solid that a mesh file, named from a folder, bounds.

    Lengths in the file are in the unit [default: m]. Parts that overlap are refused if nothing else is
    stated. The notes of the solid say what was put right in the mesh. Raises InputError with
    one line where the file or the mesh is not good for it.
    """
    path, overlap = folder.joinpath(name), overlap or "refuse"
    with open_mesh(path) as file:
        digest = file_digest(file, "sha256").hexdigest()
        known_as = f"{digest}-{overlap}{Path(name).suffix}"
        solid = known_solid(known_as, lambda: _solid(path, file, digest, overlap))
    return MeshSolid(name, digest, unit, solid.scaled(UNITS[unit or "m"]))


def _solid(path: Traversable, file: BufferedIOBase, digest: str, overlap: Overlap) -> MassProperties:
    """Return the solid of an open mesh file of this SHA-256, or refuse a file that changes meanwhile."""
    # late: numba takes a second to begin with, and most meshes were worked out before
    from bodycheck.reference_impl.mass_properties.mesh_check import checked_mesh
    from bodycheck.reference_impl.mass_properties.polyhedron import polyhedron

    file.seek(0)
    vertices, triangles = parse_mesh(path, file)
    file.seek(0)
    if file_digest(file, "sha256").hexdigest() != digest:
        raise InputError(f"{path}: changed while it was read")
    try:
        mesh = checked_mesh(vertices, triangles, overlap)
        solid = polyhedron(mesh.vertices, mesh.triangles)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return replace(solid, notes=mesh.notes)


def load_mesh(
    path: Path, density: float, unit: Unit | None = None, overlap: Overlap | None = None
) -> MassProperties:
    """Return the mass properties of a mesh file's solid at a density in kg/m^3.

    Raises InputError with one line where the file, the mesh or the density is not good for it.
    """
    mesh = mesh_solid(path.parent, path.name, unit, overlap)
    try:
        return mesh.at_density(density)
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
