"""Mass properties of one solid in any pose, axes and density, and closed forms for primitives."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.formatting import count
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor, principal_axes

Triangles: TypeAlias = NDArray[np.int64]
"""Vertex numbers (m, 3), each triangle counter-clockwise seen from outside."""

Overlap: TypeAlias = Literal["refuse", "count-twice"]
"""How to treat closed parts of a mesh that overlap: refuse the mesh, or count the overlap twice."""

TO_COUNT_TWICE = 'to accept that, use --overlap count-twice (mesh_overlap = "count-twice" in a scenario)'

LENGTHS = (1e-50, 1e50)
"""The range of lengths in m whose fifth powers, as in second moments, are normal doubles."""

_MIN = float(np.finfo(np.float64).tiny)
"""The smallest normal double: smaller numbers have lost digits."""


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass in kg, centre of mass (3,) in m, inertia tensor (3, 3) about it in kg m^2, in one set of axes.

    The off-diagonals are those of the tensor, I_xy = -sum m x y. The notes, one sentence each, report repairs
    and notable facts about the source shape.
    """

    mass: float
    centre: Array
    inertia: Array
    notes: tuple[str, ...] = ()

    @classmethod
    def of_moments(cls, moments: Array) -> MassProperties:
        """c = F / V, C = S - F F^T / V, I = tr(C) 1 - C, with V, F, S the integrals of 1, x and x x^T.

        Shape: (10,), of 1, x, y, z, xx, yy, zz, xy, yz, zx over a solid of 1 kg/m^3. The diagonal of I is
        computed as C_jj + C_kk: tr(C) - C_ii would lose the digits of a needle's smallest moment.
        """
        _, x, y, z, xx, yy, zz, xy, yz, zx = moments
        mass, first = float(moments[0]), np.array([x, y, z])
        centre = first / mass
        central = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]) - np.outer(first, first) / mass
        spread = np.diagonal(central)
        inertia = -central
        np.fill_diagonal(inertia, np.roll(spread, 1) + np.roll(spread, 2))
        return cls(mass, centre, inertia)

    def at_density(self, density: float) -> MassProperties:
        """m = rho V, I = rho I(1): scale these properties, at unit density, to density rho in kg/m^3.

        Raises ValueError if the density is not a positive finite number, or if the mass or the moments leave
        the range of normal doubles.
        """
        if not 0.0 < density < math.inf:
            raise ValueError(f"density must be positive and finite, not {density!r}")
        with np.errstate(over="ignore", under="ignore"):
            mass, inertia = density * self.mass, density * self.inertia
        if not all(_MIN <= x < math.inf for x in (mass, *np.diagonal(inertia))):
            raise ValueError(
                f"a density of {density!r} kg/m^3 makes a mass of {mass!r} kg and moments of "
                f"{np.diagonal(inertia).tolist()} kg m^2: beyond the range of double precision"
            )
        return replace(self, mass=mass, inertia=inertia)

    def of_mass(self, mass: float) -> MassProperties:
        """I = m I(1) / V: scale these properties, at unit density, to a mass in kg.

        Raises ValueError as at_density does.
        """
        if not 0.0 < mass < math.inf:
            raise ValueError(f"mass must be positive and finite, not {mass!r}")
        return replace(self.at_density(mass / self.mass), mass=mass)

    def scaled(self, factor: Fraction) -> MassProperties:
        """m' = s^3 m, c' = s c, I' = s^5 I: scale all lengths by s at the same density."""
        return replace(
            self,
            mass=self.mass * float(factor**3),
            centre=self.centre * float(factor),
            inertia=self.inertia * float(factor**5),
        )

    def translated(self, displacement: Array) -> MassProperties:
        """c' = c + d: displace the solid by d (3,), m; the inertia about its centre is unchanged."""
        return replace(self, centre=self.centre + displacement)

    def rotated(self, rotation: Array) -> MassProperties:
        """c' = R c, I' = R I R^T: rotate the solid about the origin by R (3, 3)."""
        inertia = rotation @ self.inertia @ rotation.T
        return replace(self, centre=rotation @ self.centre, inertia=0.5 * (inertia + inertia.T))

    def inertia_about(self, point: Array) -> Array:
        """I + m (|d|^2 1 - d d^T), d = c - p (Huygens-Steiner): the tensor (3, 3) about point p (3,), m."""
        return self.inertia + self.mass * parallel_axis_tensor(self.centre - point)

    def principal(self) -> tuple[Array, Array]:
        """I = A diag(J) A^T, det A = 1: ascending moments J (3,) and the axes, the columns of A (3, 3)."""
        return principal_axes(self.inertia)


@dataclass(frozen=True)
class Primitive:
    """The names of a shape's sizes, in m, in order, and its closed form."""

    sizes: tuple[str, ...]
    closed_form: Callable[..., MassProperties]


def _centred(mass: float, *moments: float) -> MassProperties:
    """Return a body with its centre at the origin and its principal axes along x, y, z."""
    return MassProperties(mass, np.zeros(3), np.diag(moments))


def box(x: float, y: float, z: float) -> MassProperties:
    """V = x y z, I_x = V (y^2 + z^2) / 12; full edges."""
    volume = x * y * z
    moments = (volume / 12.0 * (p * p + q * q) for p, q in ((y, z), (z, x), (x, y)))
    return _centred(volume, *moments)


def ellipsoid(a: float, b: float, c: float) -> MassProperties:
    """V = 4/3 pi a b c, I_x = V (b^2 + c^2) / 5; semi-axes."""
    volume = 4.0 / 3.0 * math.pi * a * b * c
    moments = (volume / 5.0 * (p * p + q * q) for p, q in ((b, c), (c, a), (a, b)))
    return _centred(volume, *moments)


def sphere(radius: float) -> MassProperties:
    """V = 4/3 pi r^3, I = 2/5 V r^2."""
    return ellipsoid(radius, radius, radius)


def cylinder(radius: float, length: float) -> MassProperties:
    """V = pi r^2 l, I_z = V r^2 / 2, I_x = V (r^2 / 4 + l^2 / 12)."""
    volume = math.pi * radius**2 * length
    across = volume * (radius**2 / 4.0 + length**2 / 12.0)
    return _centred(volume, across, across, volume * radius**2 / 2.0)


def capsule(radius: float, length: float) -> MassProperties:
    """Cylinder C and sphere S, I_z = C_z + S_z, I_x = C_x + S_x + S (l^2 / 4 + 3 l r / 8).

    The length is that of the cylindrical part. The last term moves each hemisphere, whose centre is 3 r / 8
    from its base, to the end of that part.
    """
    core, ends = cylinder(radius, length), sphere(radius)
    translated = ends.mass * (length**2 / 4.0 + 3.0 * length * radius / 8.0)
    moments = np.diagonal(core.inertia + ends.inertia) + np.array([translated, translated, 0.0])
    return _centred(core.mass + ends.mass, *moments)


def torus(major: float, minor: float) -> MassProperties:
    """V = 2 pi^2 R r^2, I_z = V (R^2 + 3/4 r^2), I_x = V (R^2 / 2 + 5/8 r^2), R >= r.

    R is the radius to the middle of the tube, r that of the tube. Raises ValueError if the tube meets itself.
    """
    if major < minor:
        raise ValueError(f"the major radius {major!r} m must not be less than the minor one, {minor!r} m")
    volume = 2.0 * math.pi**2 * major * minor**2
    across = volume * (major**2 / 2.0 + 5.0 / 8.0 * minor**2)
    return _centred(volume, across, across, volume * (major**2 + 3.0 / 4.0 * minor**2))


PRIMITIVES: dict[str, Primitive] = {
    "box": Primitive(("edge along x", "edge along y", "edge along z"), box),
    "sphere": Primitive(("radius",), sphere),
    "ellipsoid": Primitive(("semi-axis along x", "semi-axis along y", "semi-axis along z"), ellipsoid),
    "cylinder": Primitive(("radius", "length"), cylinder),
    "capsule": Primitive(("radius", "length of the cylindrical part"), capsule),
    "torus": Primitive(("major radius", "minor radius"), torus),
}


def known_shape(shape: str) -> str:
    """Return the name unchanged if a primitive has it. Raises ValueError, listing the names, otherwise."""
    if shape not in PRIMITIVES:
        raise ValueError(f"unknown shape {shape!r} (available: {', '.join(PRIMITIVES)})")
    return shape


def primitive(shape: str, size: Sequence[float]) -> MassProperties:
    """Return the mass properties, at unit density, of a primitive given by its name and sizes in m.

    Raises ValueError for an unknown name, a wrong number of sizes, sizes that are not positive and finite, a
    largest size outside LENGTHS, and a torus whose tube meets itself.
    """
    known = PRIMITIVES[known_shape(shape)]
    if len(size) != len(known.sizes):
        raise ValueError(
            f"a {shape} has {count(len(known.sizes), 'size')} ({', '.join(known.sizes)}), not {len(size)}"
        )
    for name, value in zip(known.sizes, size, strict=True):
        if not 0.0 < value < math.inf:
            raise ValueError(f"the {name} of a {shape} must be positive and finite, not {value!r}")
    largest = max(size)
    if not LENGTHS[0] < largest < LENGTHS[1]:
        raise ValueError(
            f"the largest size of a {shape} must be within {LENGTHS[0]} to {LENGTHS[1]} m, not {largest!r}"
        )
    return known.closed_form(*map(float, size))
