"""Corners of an open mesh that round-off set apart, made one: where that closes it, and nothing else would.

A corner computed twice, once for either triangle, may differ in its last digits; the mesh is then open by
slits of no width. No solid is changed by joining them, for an open mesh bounds none; but a real gap must not
be closed. So only corners on open edges are joined; only within a tolerance relative to the mesh's size, and
the least of the tolerances that does it; only if a tolerance a hundred times as large would join the very
same ones; and only if then no edge is open and no triangle has lost a corner.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.mass_properties.edges import OPEN, partners
from bodycheck.reference_impl.mass_properties.solid import Triangles

TOLERANCES = (1e-13, 1e-10, 1e-7)
"""Over the size: round-off of doubles near the origin, the same farther off, and round-off of 32 bits."""

_CLEAR = 100.0
"""What lies between a tolerance and so many times as much could be either, round-off or a gap."""

_OBLIQUE = np.array([0.5377, 0.6421, 0.5464])
"""A direction along which few corners of what people draw coincide; of length 1 to four digits."""


class Joined(NamedTuple):
    """Triangles (m, 3) whose edges all meet, their partners (3 m,), and what was joined, in a sentence."""

    triangles: Triangles
    partner: NDArray[np.int32]
    note: str


def without_slits(vertices: Array, triangles: Triangles, partner: NDArray[np.int32]) -> Joined | None:
    """Return the mesh with the corners at its open edges joined, or None where they are really apart.

    Shapes: (n, 3), (m, 3), (3 m,) from edges.partners.
    """
    rim = np.unique(_ends_of(triangles, np.flatnonzero(partner == OPEN)))
    size = _size(vertices, triangles)
    for tolerance in TOLERANCES:
        first = _clusters(vertices[rim], tolerance * size)
        joined = _renumbered(triangles, len(vertices), rim, rim[first])
        closed = partners(joined, len(vertices))
        if not (closed == OPEN).any():
            clear = np.array_equal(first, _clusters(vertices[rim], _CLEAR * tolerance * size))
            if not clear or _loses_a_corner(joined):
                return None
            return Joined(joined, closed, _note(vertices, rim, first, size))
    return None


def _ends_of(triangles: Triangles, half_edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the vertices (2, k) at both ends of half-edges (k,)."""
    triangle, corner = np.divmod(half_edges, 3)
    return np.stack([triangles[triangle, corner], triangles[triangle, (corner + 1) % 3]])


def _size(vertices: Array, triangles: Triangles) -> float:
    """Return the largest extent along an axis of the vertices that are in use."""
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[triangles] = True
    return float(np.ptp(vertices[used], axis=0).max())


def _clusters(points: Array, reach: float) -> NDArray[np.int64]:
    """Return for each point (k, 3) the first of those that it is linked to by steps no longer than reach."""
    along = points @ _OBLIQUE
    order = np.argsort(along, kind="stable")
    return np.asarray(_linked(points, along, order, reach))


@kernel
def _root(parent: NDArray[np.int64], i: int) -> int:
    """Return the first of the cluster of i, halving the way there."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _linked(points: Array, along: Array, order: NDArray[np.int64], reach: float) -> NDArray[np.int64]:
    """Link each point to those near it, which follow it closely in their order along some direction."""
    parent = np.arange(len(points))
    for k in range(len(order)):
        i = order[k]
        for n in range(k + 1, len(order)):
            j = order[n]
            if along[j] - along[i] > 1.001 * reach:  # the direction's length is 1 to four digits
                break
            dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
            if dx * dx + dy * dy + dz * dz <= reach * reach:
                a, b = _root(parent, i), _root(parent, j)
                parent[max(a, b)] = min(a, b)
    for i in range(len(points)):
        parent[i] = _root(parent, i)
    return parent


def _renumbered(
    triangles: Triangles, count: int, old: NDArray[np.int64], new: NDArray[np.int64]
) -> Triangles:
    """Return the triangles (m, 3) with new vertices (k,) in place of old ones (k,), of so many in all."""
    number = np.arange(count)
    number[old] = new
    return number[triangles]


def _loses_a_corner(triangles: Triangles) -> bool:
    a, b, c = triangles.T
    return bool(((a == b) | (b == c) | (c == a)).any())


def _note(vertices: Array, rim: NDArray[np.int64], first: NDArray[np.int64], size: float) -> str:
    """Say how many corners were joined, and how far the farthest was from its own."""
    moved = first != np.arange(len(first))
    apart = float(np.linalg.norm(vertices[rim] - vertices[rim[first]], axis=1).max()) / size
    return (
        f"the mesh was open by round-off only: {moved.sum()} corners were joined to others at most "
        f"{apart:.1g} of its size away"
    )
