"""Exact mass properties of a triangle mesh, in rational arithmetic."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import MassProperties, Triangles

_Integers = NDArray[Any]
"""An object array of Python integers, which do not overflow."""

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


@dataclass(frozen=True)
class ExactSolid:
    """Mass, centre (3 numbers) and inertia about it (xx, yy, zz, xy, yz, zx), at unit density."""

    mass: Fraction
    centre: tuple[Fraction, ...]
    inertia: tuple[Fraction, ...]

    def error(self, solid: MassProperties) -> float:
        """Return the largest of the relative errors of mass, centre and inertia.

        They are relative to the mass, the radius of gyration plus the distance of the centre from the origin,
        and the largest moment.
        """
        mass = abs(Fraction(solid.mass) - self.mass) / self.mass
        shift = math.hypot(
            *(float(Fraction(float(x)) - c) for x, c in zip(solid.centre, self.centre, strict=True))
        )
        radius = math.sqrt(float(sum(self.inertia[:3]) / self.mass / 2))
        away = math.hypot(*map(float, self.centre))
        held = [Fraction(float(solid.inertia[i, j])) for i, j in _PAIRS]
        bent = max(abs(a - b) for a, b in zip(held, self.inertia, strict=True)) / max(self.inertia[:3])
        return max(float(mass), shift / (radius + away), float(bent))


def exact_solid(vertices: Array, triangles: Triangles) -> ExactSolid:
    """m = sum D / 6, F = sum D s / 24, S = sum D (a a^T + b b^T + c c^T + s s^T) / 120, s = a + b + c.

    D = det(a, b, c), tetrahedra from the origin (Tonon 2004). Shapes: (n, 3) in m, (m, 3).
    """
    corners, unit = _integers(vertices)
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    determinant = (
        a[:, 0] * (b[:, 1] * c[:, 2] - b[:, 2] * c[:, 1])
        + a[:, 1] * (b[:, 2] * c[:, 0] - b[:, 0] * c[:, 2])
        + a[:, 2] * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    )
    s = a + b + c
    mass = Fraction(sum(determinant)) * unit**3 / 6
    first = [Fraction(sum(determinant * s[:, i])) * unit**4 / 24 for i in range(3)]
    second = [
        Fraction(sum(determinant * sum(x[:, i] * x[:, j] for x in (a, b, c, s)))) * unit**5 / 120
        for i, j in _PAIRS
    ]
    central = [second[k] - first[i] * first[j] / mass for k, (i, j) in enumerate(_PAIRS)]
    xx, yy, zz, xy, yz, zx = central
    centre = tuple(f / mass for f in first)
    return ExactSolid(mass, centre, (yy + zz, zz + xx, xx + yy, -xy, -yz, -zx))


def _integers(values: Array) -> tuple[_Integers, Fraction]:
    """Return doubles as integer multiples of a common power of two, and that power."""
    ratios = [x.as_integer_ratio() for x in values.ravel().tolist()]
    finest = max(denominator for _, denominator in ratios)
    whole = [numerator * (finest // denominator) for numerator, denominator in ratios]
    return np.array(whole, dtype=object).reshape(values.shape), Fraction(1, finest)
