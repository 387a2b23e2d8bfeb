"""Merge vertices with equal coordinates, and corners that round-off separates if that closes the mesh."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.scenarios.mass_properties.edges import OPEN, partners
from bodycheck.scenarios.mass_properties.solid import Triangles

_EMPTY = -1
_SLOTS = 1 << 10
"""The initial size of the hash table, a power of two."""


def merged(vertices: NDArray[np.floating[Any]]) -> tuple[Array, NDArray[np.int32]]:
    """Return the distinct vertices (k, 3), in order of appearance, and the index (n,) of each given one.

    Shape: (n, 3), finite, of 32 or 64 bits. Coordinates are compared bit for bit except for the sign of zero:
    a tolerance might join the two sides of a thin wall.
    """
    with np.errstate(over="ignore"):  # the hash wraps around, which matters where it is interpreted
        kinds, number = _kinds(np.ascontiguousarray(vertices), _SLOTS)
    return kinds, number


@kernel
def _slot(x: float, y: float, z: float, mask: int) -> np.int64:
    """Return a slot from 0 to mask, a power of two minus one: multiply, xor and shift (Steele 2014)."""
    mixed = np.uint64(0)
    for coordinate in (x, y, z):
        mixed ^= np.float64(coordinate).view(np.uint64)
        mixed *= np.uint64(0x9E3779B97F4A7C15)  # wraps around, as intended
        mixed ^= mixed >> np.uint64(29)
    mixed ^= mixed >> np.uint64(32)  # otherwise a sign never reaches the last bits
    return np.int64(mixed & np.uint64(mask))


@kernel
def _find(kinds: Array, slots: NDArray[np.int32], x: float, y: float, z: float) -> int:
    """Return the slot that holds (x, y, z), or the empty slot where it belongs, by open addressing."""
    mask = len(slots) - 1
    slot = _slot(x, y, z, mask)
    while slots[slot] != _EMPTY:
        kind = slots[slot]
        if kinds[kind, 0] == x and kinds[kind, 1] == y and kinds[kind, 2] == z:
            break
        slot = (slot + 1) & mask
    return slot


@kernel
def _grown(kinds: Array, slots: NDArray[np.int32], count: int) -> tuple[Array, NDArray[np.int32]]:
    """Return a table of twice the size with the same kinds."""
    larger = np.full(2 * len(slots), _EMPTY, dtype=np.int32)
    buffer = np.empty((len(slots), 3))
    buffer[:count] = kinds[:count]
    for kind in range(count):
        larger[_find(buffer, larger, buffer[kind, 0], buffer[kind, 1], buffer[kind, 2])] = kind
    return buffer, larger


@kernel
def _kinds(vertices: NDArray[np.floating[Any]], size: int) -> tuple[Array, NDArray[np.int32]]:
    """Return the kinds (k, 3) and the kind (n,) of each row, by a hash table that is at most half full."""
    slots = np.full(size, _EMPTY, dtype=np.int32)
    kinds = np.empty((size // 2, 3))
    number = np.empty(len(vertices), dtype=np.int32)
    count = 0
    for row in range(len(vertices)):
        x, y, z = vertices[row, 0] + 0.0, vertices[row, 1] + 0.0, vertices[row, 2] + 0.0  # no -0.0
        slot = _find(kinds, slots, x, y, z)
        if slots[slot] == _EMPTY:
            if count == len(kinds):
                kinds, slots = _grown(kinds, slots, count)
                slot = _find(kinds, slots, x, y, z)
            kinds[count, 0], kinds[count, 1], kinds[count, 2] = x, y, z
            slots[slot] = count
            count += 1
        number[row] = slots[slot]
    return kinds[:count].copy(), number


TOLERANCES = (1e-13, 1e-10, 1e-7)
"""Relative to the size: round-off of doubles near the origin, of doubles farther off, and of 32 bits."""

_CLEAR = 100.0
"""A distance between a tolerance and this many times the tolerance may be round-off or a gap."""

_OBLIQUE = np.array([0.5377, 0.6421, 0.5464])
"""A direction along which few corners of typical drawings coincide; of length 1 to four digits."""


class Joined(NamedTuple):
    """Triangles (m, 3) without open edges, their partners (3 m,), and a note on what was joined."""

    triangles: Triangles
    partner: NDArray[np.int32]
    note: str


def without_slits(vertices: Array, triangles: Triangles, partner: NDArray[np.int32]) -> Joined | None:
    """Return the mesh with the corners at its open edges joined, or None where there is a real gap.

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
    """Return the vertices (2, k) at the ends of half-edges (k,)."""
    triangle, corner = np.divmod(half_edges, 3)
    return np.stack([triangles[triangle, corner], triangles[triangle, (corner + 1) % 3]])


def _size(vertices: Array, triangles: Triangles) -> float:
    """Return the largest extent of the used vertices along an axis."""
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[triangles] = True
    return float(np.ptp(vertices[used], axis=0).max())


def _clusters(points: Array, reach: float) -> NDArray[np.int64]:
    """Return for each point (k, 3) the first one linked to it by steps no longer than reach."""
    along = points @ _OBLIQUE
    order = np.argsort(along, kind="stable")
    return np.asarray(_linked(points, along, order, reach))


@kernel
def _root(parent: NDArray[np.int64], i: int) -> int:
    """Return the first member of the cluster of i, halving the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _linked(points: Array, along: Array, order: NDArray[np.int64], reach: float) -> NDArray[np.int64]:
    """Link each point (k, 3) to those near it, which follow it closely in the order along a direction."""
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
    """Return the triangles (m, 3) with old vertices (k,) replaced by new ones (k,); count: all vertices."""
    number = np.arange(count)
    number[old] = new
    return number[triangles]


def _loses_a_corner(triangles: Triangles) -> bool:
    a, b, c = triangles.T
    return bool(((a == b) | (b == c) | (c == a)).any())


def _note(vertices: Array, rim: NDArray[np.int64], first: NDArray[np.int64], size: float) -> str:
    """Return a note on how many corners were joined, and over which distance at most."""
    moved = first != np.arange(len(first))
    apart = float(np.linalg.norm(vertices[rim] - vertices[rim[first]], axis=1).max()) / size
    return (
        f"the mesh was open by round-off only: {moved.sum()} corners were joined to others at most "
        f"{apart:.1g} of its size away"
    )
