"""The polygons of a mesh file, their triangles, and what the choice of triangles changes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.formatting import count, number
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles

_PLANE = 1e-9
"""The share of the volume up to which the choice of triangles does not matter."""
_BATCH = 4096
_MOST_CUTS = 32
"""Of a polygon with more corners, so many are tried as the common one of its triangles."""


class Polygons(NamedTuple):
    """What a mesh file has: vertices (n, 3) in its unit of length, polygons, and notes, one sentence each.

    lengths (k,): the number of corners of each polygon, at least 3; corners (l,): their vertex numbers, one
    polygon after the other. Vertices of a file that states its unit are in m.
    """

    vertices: Array
    lengths: NDArray[np.integer[Any]]
    corners: NDArray[np.integer[Any]]
    notes: tuple[str, ...] = ()

    @classmethod
    def of_triangles(cls, vertices: Array, triangles: Triangles, *notes: str) -> Polygons:
        """Return triangles (m, 3) as polygons."""
        return cls(vertices, np.full(len(triangles), 3, dtype=np.uint8), triangles.reshape(-1), notes)

    def triangles(self) -> Triangles:
        """Return the triangles (m, 3) of all polygons, as fans about their first corners."""
        lengths, corners = self.lengths, self.corners
        if (lengths == 3).all():
            return np.ascontiguousarray(corners.reshape(-1, 3), dtype=np.int64)
        lengths = lengths.astype(np.int64)
        count = lengths - 2
        first = np.repeat(np.cumsum(lengths) - lengths, count)
        step = np.arange(1, len(first) + 1) - np.repeat(np.cumsum(count) - count, count)
        found = np.empty((len(first), 3), dtype=np.int64)
        found[:, 0], found[:, 1] = corners[first], corners[first + step]
        found[:, 2] = corners[first + step + 1]
        return found

    def ambiguity(self, volume: float) -> tuple[str, ...]:
        """Return a note on polygons that are not plane, if their triangles matter for a solid of this volume.

        sum_k max_c |V_kc - V_k0|, where V_kc is what polygon k adds to the volume as a fan about its corner
        c: all are equal if the polygon is plane.
        """
        begin = np.cumsum(self.lengths, dtype=np.int64) - self.lengths
        amount, change = 0, 0.0
        for corners in np.unique(self.lengths[self.lengths > 3]).tolist():
            which = begin[self.lengths == corners]
            for rows in np.split(which, range(_BATCH, len(which), _BATCH)):
                points = self.vertices[self.corners[rows[:, None] + np.arange(corners)]]
                changes = _changes(points - points[:, :1])
                amount += int(np.sum(changes > _PLANE * volume / len(self.lengths)))
                change += float(changes.sum())
        if change <= _PLANE * volume:
            return ()
        return (
            f"{count(amount, 'polygon')} not plane, cut about the first corner: other cuts change volume "
            f"and mass by up to {number(100.0 * change / volume, 3)} %",
        )


def _changes(points: Array) -> Array:
    """Return max_k |V_k - V_0| (m,) of polygons (m, n, 3) whose first corners are at the origin.

    V_0 is zero: the triangles of that fan contain the origin.
    """
    corners = points.shape[1]
    largest = np.zeros(len(points))
    for k in range(1, corners, max(1, corners // _MOST_CUTS)):
        rolled = np.roll(points, -k, axis=1)
        normals = np.cross(rolled[:, 1:-1] - rolled[:, :1], rolled[:, 2:] - rolled[:, :1]).sum(axis=1)
        np.maximum(largest, np.abs(np.einsum("ij,ij->i", rolled[:, 0], normals)) / 6.0, out=largest)
    return largest
