"""The mass properties of one solid, and how they change with its pose, its axes and its density."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import principal_axes

Triangles: TypeAlias = NDArray[np.int64]
"""Vertex numbers (m, 3), each triangle counter-clockwise seen from outside."""

Overlap: TypeAlias = Literal["refuse", "count-twice"]
"""What to do about closed parts of a mesh that share room: refuse it, or count the room twice."""

LENGTHS = (1e-50, 1e50)
"""Lengths in m whose fifth powers, the second moments, are normal doubles."""

_LEAST = float(np.finfo(np.float64).tiny)
"""The least normal double: what is smaller has lost digits."""


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass in kg, centre of mass (3,) in m, inertia tensor (3, 3) about it in kg m^2, in one set of axes.

    The inertia has its true off-diagonals, I_xy = -sum m x y. The notes say, one sentence each, what was
    put right or is worth knowing about the shape that they came from.
    """

    mass: float
    centre: Array
    inertia: Array
    notes: tuple[str, ...] = ()

    @classmethod
    def of_moments(cls, moments: Array) -> MassProperties:
        """c = F / V, C = S - F F^T / V, I = tr(C) 1 - C: from the integrals V of 1, F of x and S of x x^T.

        Shape: (10,), of 1, x, y, z, xx, yy, zz, xy, yz, zx over a solid of 1 kg/m^3. The diagonal of I is
        summed as C_jj + C_kk: tr(C) - C_ii would lose the digits of a needle's smallest moment.
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
        """m = rho V, I = rho I(1): these properties, taken as those of unit density, at another, kg/m^3.

        Raises ValueError where the density is not a positive finite number, and where mass or moments leave
        the range of normal doubles.
        """
        if not 0.0 < density < math.inf:
            raise ValueError(f"density must be positive and finite, not {density!r}")
        with np.errstate(over="ignore", under="ignore"):
            mass, inertia = density * self.mass, density * self.inertia
        if not all(_LEAST <= x < math.inf for x in (mass, *np.diagonal(inertia))):
            raise ValueError(
                f"a density of {density!r} kg/m^3 makes a mass of {mass!r} kg and moments of "
                f"{np.diagonal(inertia).tolist()} kg m^2: beyond the range of double precision"
            )
        return replace(self, mass=mass, inertia=inertia)

    def scaled(self, factor: Fraction) -> MassProperties:
        """m' = s^3 m, c' = s c, I' = s^5 I: the solid with all its lengths times s, at one density."""
        return replace(
            self,
            mass=self.mass * float(factor**3),
            centre=self.centre * float(factor),
            inertia=self.inertia * float(factor**5),
        )

    def moved(self, displacement: Array) -> MassProperties:
        """c' = c + d: the solid displaced by d (3,), m; the inertia about its centre stays."""
        return replace(self, centre=self.centre + displacement)

    def rotated(self, rotation: Array) -> MassProperties:
        """c' = R c, I' = R I R^T: the solid turned about the origin by R (3, 3)."""
        inertia = rotation @ self.inertia @ rotation.T
        return replace(self, centre=rotation @ self.centre, inertia=0.5 * (inertia + inertia.T))

    def inertia_about(self, point: Array) -> Array:
        """I + m (|d|^2 1 - d d^T), d = c - p (Huygens-Steiner): the tensor (3, 3) about a point p (3,), m."""
        d = self.centre - point
        return self.inertia + self.mass * (np.dot(d, d) * np.eye(3) - np.outer(d, d))

    def principal(self) -> tuple[Array, Array]:
        """I = A diag(J) A^T, det A = 1: the moments J (3,), ascending, and the axes, A's columns (3, 3)."""
        return principal_axes(self.inertia)
