"""Closed surfaces turned outward, and cavities left inward, where the mesh leaves no doubt which is which."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.nesting import depths
from bodycheck.reference_impl.mass_properties.orientation import Surfaces
from bodycheck.reference_impl.mass_properties.places import place
from bodycheck.reference_impl.mass_properties.polyhedron import volume_area_reach
from bodycheck.reference_impl.mass_properties.solid import Triangles

_FLAT = 1e-14
"""A volume so much smaller than area times reach is round-off."""


def misfacing(vertices: Array, surfaces: Surfaces) -> NDArray[np.bool_]:
    """Say for each triangle (m,), consistent within its surface, whether it has to be turned.

    A surface within an even number of others bounds matter and faces outward; one within an odd number is a
    cavity and faces inward. A mesh wholly inside-out may be turned, and so may any surface that lies within
    no other. Raises ValueError where a surface encloses nothing, where two cross, and where one within
    another does not face as a cavity: it may be one drawn inside-out, or matter drawn twice.
    """
    members = _members(surfaces.surface)
    parts = [surfaces.triangles[rows] for rows in members]
    outward = np.array([_is_outward(vertices, part) for part in parts])
    depth = depths(vertices, parts) if len(parts) > 1 else np.zeros(1, dtype=np.int64)
    wrong = outward != (depth % 2 == 0)
    mended = np.array([surfaces.turned[rows].any() for rows in members])
    inside_out = wrong.all() and not mended.any()
    doubtful = np.flatnonzero((wrong | mended) & (depth > 0))
    if len(doubtful) and not inside_out:
        where = place(vertices[parts[doubtful[0]][0, 0]])
        raise ValueError(
            f"the mesh is ambiguous: the closed surface at {where} lies within another and does not face as "
            "a cavity; it may be one drawn inside-out, or matter drawn twice"
        )
    return wrong[surfaces.surface]


def _members(surface: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the triangles of each surface, ascending."""
    order = np.argsort(surface, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(surface[order])) + 1)


def _is_outward(vertices: Array, triangles: Triangles) -> bool:
    """Say whether a closed surface faces outward."""
    volume, area, reach = volume_area_reach(vertices, triangles)
    if abs(volume) <= _FLAT * area * reach:
        where = place(vertices[triangles[0, 0]])
        raise ValueError(f"the mesh is degenerate: the closed surface at {where} encloses no volume")
    return bool(volume > 0.0)
