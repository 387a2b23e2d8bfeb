"""Bodies of uniform density: a mesh file with its unit, or a primitive; solids of mesh files are cached."""

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

from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.errors import InputError
from bodycheck._util.file_digests import digest_of
from bodycheck._util.files import opened, sealed
from bodycheck.reference_impl.mass_properties.solid import MassProperties, Overlap
from bodycheck.reference_impl.mass_properties.solid import primitive as unit_density_primitive
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh
from bodycheck.scenarios.mesh_files.decimation import decimated, obj_text

Unit: TypeAlias = Literal["mm", "cm", "m", "in"]

UNITS: dict[Unit, Fraction] = {
    "mm": Fraction(1, 1000),
    "cm": Fraction(1, 100),
    "m": Fraction(1),
    "in": Fraction(254, 10000),
}
"""Unit -> its length in m."""

_LARGE_M, _HEAVY_KG = 10.0, 1e5
_SMALL_M, _LIGHT_KG = 2e-3, 1e-5
_DENSITIES = (0.05, 25000.0)
"""Plausible densities in kg/m^3: hydrogen has 0.08, osmium 22600."""

_INTERPRETED_TRIANGLES = 500
"""So many are checked in at most 2 s by interpretation; compilation takes 10 s. Both give the same bits."""


def plausibility_warnings(solid: MassProperties, density: float, unit: Unit | None) -> tuple[str, ...]:
    """Return one warning for each implausible combination of density, size and mass.

    Warn about a large and heavy solid if the unit of its mesh was not specified, and about a small and light
    one if the specified unit is shorter than a metre.
    """
    found = []
    if not _DENSITIES[0] <= density <= _DENSITIES[1]:
        found.append(
            f"warning: implausible density {density:g} kg/m^3; 1 g/cm^3 is 1000 kg/m^3, 1 t/mm^3 is 1e12"
        )
    size, mass = _diameter(solid), solid.mass
    if unit is None and size > _LARGE_M and mass > _HEAVY_KG:
        shorter, lighter = size * float(UNITS["mm"]), mass * float(UNITS["mm"] ** 3)
        found.append(
            f"warning: about {size:.3g} m across and {mass:.3g} kg; if the mesh is in mm, specify the unit "
            f"(--unit mm, or mesh_unit in a scenario): {shorter:.3g} m and {lighter:.3g} kg"
        )
    if unit not in (None, "m") and size < _SMALL_M and mass < _LIGHT_KG:
        found.append(
            f"warning: about {size:.3g} m across and {mass:.3g} kg; is the mesh really in {unit}, not in m?"
        )
    return tuple(found)


def _diameter(solid: MassProperties) -> float:
    """2 sqrt(5/3) k, k^2 = tr(I) / 2 m: diameter of the ball with the same radius of gyration, in m."""
    return 2.0 * math.sqrt(5.0 / 3.0 * 0.5 * float(np.trace(solid.inertia)) / solid.mass)


def known_solid(name: str, compute: Callable[[], tuple[MassProperties, str]]) -> tuple[MassProperties, str]:
    """Return the solid of a mesh file and its surface from the cache, or compute and cache them.

    name: the file's hash and suffix. The cache key also covers the code that reads and integrates meshes:
    another release of bodycheck, numpy or numba computes the solid again. If the cache folder cannot be
    written, nothing is cached.
    """
    code = digest_of(Path(__file__).parent / "mesh_files")[:16]
    libraries = "-".join(version(library) for library in ("numpy", "numba"))
    place = cache_directory() / "solids" / f"{code}-{libraries}-{name}"
    with suppress(OSError):
        stored = opened(place.read_bytes())
        if stored is not None:
            centre, inertia = np.array(stored["centre"]), np.array(stored["inertia"])
            return MassProperties(stored["mass"], centre, inertia, tuple(stored["notes"])), stored["surface"]
    found, surface = compute()
    arrays = {"centre": found.centre.tolist(), "inertia": found.inertia.tolist()}
    with suppress(OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        stored = {"mass": found.mass, **arrays, "notes": list(found.notes), "surface": surface}
        place.write_bytes(sealed(stored))
    return found, surface


@dataclass(frozen=True)
class MeshSolid:
    """A mesh file's name and SHA-256, and the solid that it bounds, at unit density in the file's axes.

    unit: as specified, or None; the lengths of `solid` are always in m. surface: the decimated mesh, for
    drawing, as OBJ in the file's unit; "" in runs of earlier versions.
    """

    name: str
    sha256: str
    unit: Unit | None
    solid: MassProperties = field(compare=False)
    surface: str = field(compare=False, default="")

    def at_density(self, density: float) -> MassProperties:
        """Return the solid at a density in kg/m^3, with warnings about implausible values in its notes."""
        found = self.solid.at_density(density)
        return replace(found, notes=(*found.notes, *plausibility_warnings(found, density, self.unit)))


def mesh_solid(
    folder: Traversable, name: str, unit: Unit | None = None, overlap: Overlap | None = None
) -> MeshSolid:
    """Return the solid bounded by a mesh file, whose name is relative to a folder.

    unit: of the lengths in the file [default: m]. overlap: what to do with overlapping parts [default:
    refuse]. The notes of the solid list the corrections of the mesh. Raises InputError with one line if the
    file or the mesh is unusable.
    """
    path, overlap = folder.joinpath(name), overlap or "refuse"
    with open_mesh(path) as file:
        digest = file_digest(file, "sha256").hexdigest()
        known_as = f"{digest}-{overlap}{Path(name).suffix}"
        solid, surface = known_solid(known_as, lambda: _solid(path, file, digest, overlap))
    return MeshSolid(name, digest, unit, solid.scaled(UNITS[unit or "m"]), surface)


def _solid(
    path: Traversable, file: BufferedIOBase, digest: str, overlap: Overlap
) -> tuple[MassProperties, str]:
    """Return the solid of an open mesh file with this SHA-256, and its surface, decimated, as OBJ.

    Raises InputError if the file changes meanwhile.
    """
    # importing numba takes a second, and most meshes are cached
    from bodycheck.reference_impl.kernels.jit import interpreted
    from bodycheck.reference_impl.mass_properties.mesh_check import checked_mesh
    from bodycheck.reference_impl.mass_properties.polyhedron import polyhedron

    file.seek(0)
    vertices, triangles = parse_mesh(path, file)
    file.seek(0)
    if file_digest(file, "sha256").hexdigest() != digest:
        raise InputError(f"{path}: changed while it was read")

    def checked() -> tuple[MassProperties, str]:
        mesh = checked_mesh(vertices, triangles, overlap)
        solid = replace(polyhedron(mesh.vertices, mesh.triangles), notes=mesh.notes)
        return solid, obj_text(*decimated(mesh.vertices, mesh.triangles))

    try:
        if len(triangles) <= _INTERPRETED_TRIANGLES:
            with suppress(FloatingPointError), interpreted():  # compiled code has inf and NaN
                return checked()
        return checked()
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def load_mesh(
    path: Path, density: float, unit: Unit | None = None, overlap: Overlap | None = None
) -> MassProperties:
    """Return the mass properties of a mesh file's solid at a density in kg/m^3.

    Raises InputError with one line if the file, the mesh or the density is unusable.
    """
    mesh = mesh_solid(path.parent, path.name, unit, overlap)
    try:
        return mesh.at_density(density)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def primitive(shape: str, size: Sequence[float], density: float) -> MassProperties:
    """Return the mass properties of a primitive with its centre at the origin and its axis along z.

    Sizes in m: box, the full edges along x, y, z; sphere, the radius; ellipsoid, the semi-axes along x, y, z;
    cylinder, radius and length; capsule, radius and length of the cylindrical part; torus, major and minor
    radius. Density in kg/m^3. Raises InputError with one line if an argument is wrong.
    """
    try:
        return unit_density_primitive(shape, size).at_density(density)
    except ValueError as error:
        raise InputError(str(error)) from None
