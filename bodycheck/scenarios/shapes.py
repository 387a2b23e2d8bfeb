"""Bodies of one density: a mesh file with its unit, or a primitive; solids computed before are cached."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from hashlib import file_digest
from importlib.metadata import version
from importlib.resources.abc import Traversable
from io import BufferedIOBase
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from bodycheck._util.checksummed_json import opened, sealed
from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.errors import InputError
from bodycheck._util.file_digests import digest_of
from bodycheck.reference_impl.mass_properties.solid import MassProperties, Overlap
from bodycheck.reference_impl.mass_properties.solid import primitive as unit_density_primitive
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh

Unit: TypeAlias = Literal["mm", "cm", "m", "in"]

UNITS: dict[Unit, Fraction] = {
    "mm": Fraction(1, 1000),
    "cm": Fraction(1, 100),
    "m": Fraction(1),
    "in": Fraction(254, 10000),
}
"""Their lengths in m."""

_LARGE_M, _HEAVY_KG = 10.0, 1e5
_SMALL_M, _LIGHT_KG = 2e-3, 1e-5
_DENSITIES = (0.05, 25000.0)
"""In kg/m^3: hydrogen has 0.08, osmium 22600."""


def doubts(solid: MassProperties, density: float, unit: Unit | None) -> tuple[str, ...]:
    """Return a sentence each for what is implausible about density, size and mass together.

    A large and heavy solid is doubtful if nobody stated the unit of its mesh, a small and light one if
    somebody stated one that is shorter than a metre.
    """
    found = []
    if not _DENSITIES[0] <= density <= _DENSITIES[1]:
        found.append(
            f"warning: nothing has a density of {density:g} kg/m^3; 1 g/cm^3 is 1000 kg/m^3, 1 t/mm^3 is 1e12"
        )
    size, mass = _diameter(solid), solid.mass
    if unit is None and size > _LARGE_M and mass > _HEAVY_KG:
        shorter, lighter = size * float(UNITS["mm"]), mass * float(UNITS["mm"] ** 3)
        found.append(
            f"warning: about {size:.3g} m across and {mass:.3g} kg; if the mesh is drawn in mm, state it "
            f"(--unit mm, or mesh_unit in a scenario): {shorter:.3g} m and {lighter:.3g} kg"
        )
    if unit not in (None, "m") and size < _SMALL_M and mass < _LIGHT_KG:
        found.append(
            f"warning: about {size:.3g} m across and {mass:.3g} kg; is the mesh drawn in {unit}, not in m?"
        )
    return tuple(found)


def _diameter(solid: MassProperties) -> float:
    """2 sqrt(5/3) k, k^2 = tr(I) / 2 m: of the ball with the same radius of gyration, m."""
    return 2.0 * math.sqrt(5.0 / 3.0 * 0.5 * float(np.trace(solid.inertia)) / solid.mass)


def known_solid(name: str, work_out: Callable[[], MassProperties]) -> MassProperties:
    """Return the solid of a mesh file, from disk where it is there and whole, else worked out and kept.

    name: the file's hash and ending. What reads meshes and what integrates over them count too: another
    release of bodycheck, numpy or numba works it out anew. A folder that cannot be written keeps nothing.
    """
    code = digest_of(Path(__file__).parent / "mesh_files")[:16]
    libraries = "-".join(version(library) for library in ("numpy", "numba"))
    place = cache_directory() / "solids" / f"{code}-{libraries}-{name}"
    with suppress(OSError):
        kept = opened(place.read_bytes())
        if kept is not None:
            centre, inertia = np.array(kept["centre"]), np.array(kept["inertia"])
            return MassProperties(kept["mass"], centre, inertia, tuple(kept["notes"]))
    found = work_out()
    arrays = {"centre": found.centre.tolist(), "inertia": found.inertia.tolist()}
    with suppress(OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(sealed({"mass": found.mass, **arrays, "notes": list(found.notes)}))
    return found


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
        return unit_density_primitive(shape, size).at_density(density)
    except ValueError as error:
        raise InputError(str(error)) from None
