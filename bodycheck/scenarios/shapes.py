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
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.distributions import installed
from bodycheck._util.errors import InputError
from bodycheck._util.file_digests import digest_of
from bodycheck._util.files import opened, sealed
from bodycheck._util.formatting import number, vector
from bodycheck.scenarios.mass_properties.solid import TO_COUNT_TWICE, MassProperties, Overlap
from bodycheck.scenarios.mass_properties.solid import primitive as unit_density_primitive
from bodycheck.scenarios.mesh_files import open_mesh, read_polygons
from bodycheck.scenarios.mesh_files.decimation import decimated, obj_text
from bodycheck.scenarios.mesh_files.scenes import LIBRARIES

if TYPE_CHECKING:
    from bodycheck.scenarios.mass_properties.mesh_check import Mesh

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
DENSITIES = (0.05, 25000.0)
"""Plausible densities in kg/m^3: hydrogen has 0.08, osmium 22600."""

_INTERPRETED_TRIANGLES = 500
"""So many are checked in at most 2 s by interpretation; compilation takes 10 s. Both give the same bits."""


def plausibility_warnings(solid: MassProperties, density: float, unit: Unit | None) -> tuple[str, ...]:
    """Return one warning for each implausible combination of density, size and mass.

    Warn about a large and heavy solid if the unit of its mesh was not specified, and about a small and light
    one if the specified unit is shorter than a metre.
    """
    found = []
    if not DENSITIES[0] <= density <= DENSITIES[1]:
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


class MeshFacts(NamedTuple):
    """What is known of a mesh file: the solid at unit density and the decimated surface, in the file's unit.

    crossing: the place where the surface crosses itself, or "", and then the volume that it occupies and the
    half width of its 95 % interval.
    """

    solid: MassProperties
    surface: str
    crossing: str = ""
    occupied: tuple[float, float] = (0.0, 0.0)


def known_mesh(name: str, compute: Callable[[], MeshFacts]) -> MeshFacts:
    """Return the facts about a mesh file from the cache, or compute and cache them.

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
            solid = MassProperties(stored["mass"], centre, inertia, tuple(stored["notes"]))
            return MeshFacts(solid, stored["surface"], stored["crossing"], tuple(stored["occupied"]))
    found = compute()
    solid = found.solid
    with suppress(OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        stored = {
            "mass": solid.mass,
            "centre": solid.centre.tolist(),
            "inertia": solid.inertia.tolist(),
            "notes": list(solid.notes),
            "surface": found.surface,
            "crossing": found.crossing,
            "occupied": list(found.occupied),
        }
        place.write_bytes(sealed(stored))
    return found


@dataclass(frozen=True)
class MeshSolid:
    """A mesh file's name and SHA-256, and the solid that it bounds, at unit density in the file's axes.

    unit: as specified, or None; the lengths of `solid` are always in m. surface: the decimated mesh, for
    drawing, as OBJ in the file's unit; "" in runs of earlier versions. crossing: what makes its volume
    ambiguous, as in MeshFacts, relative to the volume of `solid`.
    """

    name: str
    sha256: str
    unit: Unit | None
    solid: MassProperties = field(compare=False)
    surface: str = field(compare=False, default="")
    overlap: Overlap = field(compare=False, default="refuse")
    crossing: str = field(compare=False, default="")
    occupied: tuple[float, float] = field(compare=False, default=(0.0, 0.0))

    def at_density(self, density: float) -> MassProperties:
        """Return the solid at a density in kg/m^3, with warnings about implausible values in its notes.

        Raises ValueError as MassProperties.at_density does, and for crossing surfaces, unless what they wind
        around twice is to count twice.
        """
        return self._checked(self.solid.at_density(density), density)

    def of_mass(self, mass: float) -> MassProperties:
        """Return the solid at a uniform density with a mass in kg, with warnings as at_density."""
        return self._checked(self.solid.of_mass(mass), mass / self.solid.mass)

    def _checked(self, found: MassProperties, density: float) -> MassProperties:
        warnings = plausibility_warnings(found, density, self.unit)
        if not self.crossing:
            return replace(found, notes=(*found.notes, *warnings))
        volume, error = (share * self.solid.mass for share in self.occupied)
        both = (
            f"surfaces cross near {self.crossing}: the volume is {number(self.solid.mass, 6)} m^3 "
            f"({number(found.mass, 6)} kg) with what they wind around twice counted twice, and what they "
            f"occupy is {number(volume, 6)} +- {number(error, 1)} m^3 ({number(density * volume, 6)} kg)"
        )
        if self.overlap == "refuse":
            raise ValueError(f"the mesh is ambiguous: {both}; {TO_COUNT_TWICE.replace('that', 'the first')}")
        return replace(found, notes=(*found.notes, both, *warnings))


def mesh_solid(
    folder: Traversable, name: str, unit: Unit | None = None, overlap: Overlap | None = None
) -> MeshSolid:
    """Return the solid bounded by a mesh file, whose name is relative to a folder.

    unit: of the lengths in the file [default: m]. overlap: what to do with overlapping parts [default:
    refuse]. The notes of the solid list the corrections of the mesh. Raises InputError with one line if the
    file or the mesh is unusable.
    """
    path, overlap, suffix = folder.joinpath(name), overlap or "refuse", Path(name).suffix.lower()
    if unit is not None and suffix in LIBRARIES:
        raise InputError(f"{path}: a {suffix} file states its unit; leave out --unit and mesh_unit")
    with open_mesh(path) as file:
        digest = file_digest(file, "sha256").hexdigest()
        readers = filter(None, map(installed, LIBRARIES.get(suffix, ())))
        libraries = "".join(f"-{reader.name}-{reader.version}" for reader in readers)
        known_as = f"{digest}-{overlap}{libraries}{suffix}"
        known = known_mesh(known_as, lambda: _facts(path, file, digest, overlap))
    low, high = (value / known.solid.mass for value in known.occupied)
    solid = known.solid.scaled(UNITS[unit or "m"])
    return MeshSolid(name, digest, unit, solid, known.surface, overlap, known.crossing, (low, high))


def _facts(path: Traversable, file: BufferedIOBase, digest: str, overlap: Overlap) -> MeshFacts:
    """Return the facts about an open mesh file with this SHA-256; raises InputError if it is unusable."""
    # importing numba takes a second, and most meshes are cached
    from bodycheck.reference_impl.kernels.jit import interpreted
    from bodycheck.scenarios.mass_properties.mesh_check import checked_mesh
    from bodycheck.scenarios.mass_properties.polyhedron import polyhedron

    file.seek(0)
    polygons = read_polygons(path, file)
    triangles = polygons.triangles()
    file.seek(0)
    if file_digest(file, "sha256").hexdigest() != digest:
        raise InputError(f"{path}: changed while it was read")

    def checked() -> tuple[Mesh, MassProperties]:
        mesh = checked_mesh(polygons.vertices, triangles, overlap)
        return mesh, polyhedron(mesh.vertices, mesh.triangles)

    found = None
    try:
        if len(triangles) <= _INTERPRETED_TRIANGLES:
            with suppress(FloatingPointError), interpreted():  # compiled code has inf and NaN
                found = checked()
        mesh, solid = found or checked()
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    notes = (*polygons.notes, *mesh.notes, *polygons.ambiguity(solid.mass))
    facts = MeshFacts(replace(solid, notes=notes), obj_text(*decimated(mesh.vertices, mesh.triangles)))
    if mesh.crossing is None:
        return facts
    return facts._replace(crossing=vector(mesh.crossing), occupied=_occupied(mesh))


def _occupied(mesh: Mesh) -> tuple[float, float]:
    """Return an estimate of the volume that a crossing surface winds around, and the half width at 95 %."""
    from bodycheck.scenarios.level_sets import HALF_WIDTH, MIN_COLUMNS_LOG2, estimate  # imports scipy
    from bodycheck.scenarios.mass_properties.crossings import WoundSolid

    found = estimate(WoundSolid(mesh.vertices, mesh.triangles), columns_log2=MIN_COLUMNS_LOG2)
    return found.properties.mass, HALF_WIDTH * found.mass_error


def load_mesh(
    path: Path,
    density: float | None,
    unit: Unit | None = None,
    overlap: Overlap | None = None,
    mass: float | None = None,
) -> MassProperties:
    """Return the mass properties of a mesh file's solid at a density in kg/m^3, or of a mass in kg.

    Raises InputError with one line if the file, the mesh or the density is unusable.
    """
    mesh = mesh_solid(path.parent, path.name, unit, overlap)
    try:
        return _weighed(mesh, density, mass)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def primitive(
    shape: str, size: Sequence[float], density: float | None, mass: float | None = None
) -> MassProperties:
    """Return the mass properties of a primitive with its centre at the origin and its axis along z.

    Sizes in m: box, the full edges along x, y, z; sphere, the radius; ellipsoid, the semi-axes along x, y, z;
    cylinder, radius and length; capsule, radius and length of the cylindrical part; torus, major and minor
    radius. Density in kg/m^3, or the mass in kg. Raises InputError with one line if an argument is wrong.
    """
    try:
        return _weighed(unit_density_primitive(shape, size), density, mass)
    except ValueError as error:
        raise InputError(str(error)) from None


def _weighed(solid: MassProperties | MeshSolid, density: float | None, mass: float | None) -> MassProperties:
    """Return a solid at a density, or of a mass, of which one is given."""
    if mass is not None:
        return solid.of_mass(mass)
    assert density is not None
    return solid.at_density(density)
