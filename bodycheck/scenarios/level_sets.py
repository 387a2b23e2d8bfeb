"""Solids f(x) <= 0 whose f a user wrote: what it returns is checked before it is believed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bodycheck.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.implicit import LevelSet
from bodycheck.scenarios.quasi_monte_carlo import Estimate, estimate
from bodycheck.scenarios.user_functions import said

_SIDE = 32
"""Points along either edge of a side of the box, in the middles of cells, when it is asked what it cuts."""


def estimate_level_set(name: str, function: Callable[[Array], Any], box: Sequence[float]) -> Estimate:
    """Estimate, at unit density, the solid f <= 0 within the box xmin, ymin, zmin, xmax, ymax, zmax, in m.

    f maps points (n, 3) to values (n,). The notes name the sides of the box that the solid reaches. Raises
    InputError with one line, which `name` begins, for a box without inside, a function that raises or gives
    anything else than n numbers, and a box that has nothing of the solid in it.
    """
    if len(box) != 6:
        raise InputError(f"{name}: its box has 6 numbers, xmin,ymin,zmin,xmax,ymax,zmax in m, not {len(box)}")
    solid = LevelSet(_guarded(name, function), np.array(box[:3]), np.array(box[3:]))
    try:
        found = estimate(solid)
        sides = ", ".join(_reached(solid))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    notes = (f"the solid reaches the sides {sides} of the box: what lies beyond is cut off",) if sides else ()
    return replace(found, properties=replace(found.properties, notes=notes))


def _guarded(name: str, function: Callable[[Array], Any]) -> Callable[[Array], Array]:
    """Return f as floats of a copy of the points, which it may change; refuse what it raises or returns."""

    def values(points: Array) -> Array:
        try:
            found = np.asarray(function(points.copy()))
        except (Exception, SystemExit) as error:
            raise InputError(f"{name}: failed for points {points.shape}: {said(error)}") from error
        if found.dtype.kind not in "iuf":
            raise InputError(
                f"{name}: f of points {points.shape} must be numbers, f <= 0 inside, not {found.dtype}"
            )
        return found.astype(np.float64)

    return values


def _reached(solid: LevelSet) -> list[str]:
    """Name the sides of the box, as 'x = 1.0', on which there are points of the solid."""
    middles = (np.arange(_SIDE) + 0.5) / _SIDE
    u, v = (grid.ravel() for grid in np.meshgrid(middles, middles))
    sides = []
    for axis, letter in enumerate("xyz"):
        for end, corner in enumerate((solid.lower, solid.upper)):
            unit = np.insert(np.column_stack([u, v]), axis, end, axis=1)
            points = solid.lower + unit * (solid.upper - solid.lower)
            points[:, axis] = corner[axis]
            if solid.inside(points).any():
                sides.append(f"{letter} = {corner[axis]}")
    return sides
