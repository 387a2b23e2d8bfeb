"""The unit in which a mesh is drawn, which its file does not say, and what gives a wrong one away."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.mass_properties.solid import MassProperties

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
