"""Find the triangles that meet at each edge, and separate closed surfaces that touch along an edge.

Half-edge 3 t + k runs from corner k of triangle t to its next corner.
"""

from __future__ import annotations

import math
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.formatting import first_few, vector
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import Vec, cross, dot
from bodycheck.scenarios.mass_properties.solid import Triangles

OPEN, SHARED, SHARED_TOO = -1, -2, -3
"""In place of a partner. OPEN: the edge has only one triangle. SHARED, SHARED_TOO: the edge has more than
two; SHARED marks the first of its half-edges, SHARED_TOO the others."""


@kernel
def partners(triangles: Triangles, vertices: int) -> NDArray[np.int32]:
    """Return for each half-edge (3 m,) the other one on the same edge; vertices is the number of vertices.

    triangles (m, 3). OPEN, SHARED and SHARED_TOO mark half-edges with none or more than one other. Two
    counting sorts, by the greater and then by the lesser vertex, take linear time.
    """
    lower, upper = _ends(triangles)
    order = _sorted_by(lower, _sorted_by(upper, np.arange(lower.size).astype(np.int32), vertices), vertices)
    partner = np.empty(order.size, dtype=np.int32)
    begin = 0
    while begin < order.size:
        first = order[begin]
        end = begin + 1
        while end < order.size and lower[order[end]] == lower[first] and upper[order[end]] == upper[first]:
            end += 1
        if end - begin == 2:
            second = order[begin + 1]
            partner[first], partner[second] = second, first
        else:
            partner[order[begin:end]] = SHARED_TOO
            partner[first] = OPEN if end - begin == 1 else SHARED
        begin = end
    return partner


@kernel
def _ends(triangles: Triangles) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the lesser (3 m,) and the greater (3 m,) vertex of each half-edge."""
    lower = np.empty(triangles.size, dtype=np.int32)
    upper = np.empty(triangles.size, dtype=np.int32)
    for t in range(triangles.shape[0]):
        for k in range(3):
            start, end = triangles[t, k], triangles[t, (k + 1) % 3]
            lower[3 * t + k], upper[3 * t + k] = min(start, end), max(start, end)
    return lower, upper


@kernel
def _sorted_by(key: NDArray[np.int32], items: NDArray[np.int32], keys: int) -> NDArray[np.int32]:
    """Return the items (k,) sorted by key[item] < keys, stably, by counting."""
    begin = np.zeros(keys + 1, dtype=np.int32)
    for item in items:
        begin[key[item] + 1] += 1
    for k in range(keys):
        begin[k + 1] += begin[k]
    result = np.empty_like(items)
    for item in items:
        result[begin[key[item]]] = item
        begin[key[item]] += 1
    return result


def described(vertices: Array, triangles: Triangles, half_edge: int) -> str:
    """Return 'from (0, 0, 0) to (1, 0, 0)'."""
    triangle, corner = divmod(int(half_edge), 3)
    start, end = vertices[triangles[triangle, [corner, (corner + 1) % 3]]]
    return f"from {vector(start)} to {vector(end)}"


def refuse_edges(vertices: Array, triangles: Triangles, faulty: NDArray[np.int64], what: str) -> NoReturn:
    """Raise ValueError naming the first few faulty edges (k,), each given by one of its half-edges."""
    shown = first_few(described(vertices, triangles, half_edge) for half_edge in np.sort(faulty))
    raise ValueError(f"the mesh {what.format(len(faulty))}: {shown}")


_SAME_ANGLE = 1e-9
"""The angle, in about rad, within which two triangles count as coincident."""


class SplitMesh(NamedTuple):
    """Triangles (m, 3), the partner (3 m,) of each half-edge, and notes on the changes, one sentence each."""

    triangles: Triangles
    partner: NDArray[np.int32]
    notes: tuple[str, ...]


def split_shared_edges(vertices: Array, triangles: Triangles, partner: NDArray[np.int32]) -> SplitMesh:
    """Pair the half-edges of edges that more than two triangles share.

    Shapes: (n, 3), (m, 3), (3 m,) from edges.partners without open edges. Triangles back to back, as where
    two parts share a wall or in a detached pair, bound nothing and are removed. Raises ValueError naming the
    first edges around which matter and void do not alternate: edges of three triangles, of a part drawn
    twice, or of overlapping parts.
    """
    cancelled = _back_to_back(triangles, _may_cancel(partner))
    notes: tuple[str, ...] = ()
    if cancelled.any():
        where = first_few(vector(vertices[triangle[0]]) for triangle in triangles[cancelled])
        notes = (f"{cancelled.sum()} of the triangles lie back to back and were removed, at {where}",)
        triangles = triangles[~cancelled]
        if not len(triangles):
            raise ValueError("the mesh is degenerate: all its triangles lie back to back")
        partner = partners(triangles, len(vertices))
    shared = partner == SHARED
    if shared.any():
        _pair(vertices, triangles, partner)
        notes += (f"at {shared.sum()} edges parts touch; they were separated by which side is solid",)
    return SplitMesh(triangles, partner, notes)


def _may_cancel(partner: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which triangles (m,) have a shared edge, or meet the same triangle at all edges."""
    rows = partner.reshape(-1, 3)
    neighbours = rows // 3
    detached = (neighbours[:, 0] == neighbours[:, 1]) & (neighbours[:, 1] == neighbours[:, 2])
    return np.asarray(detached | (rows <= SHARED).any(axis=1))


def _back_to_back(triangles: Triangles, selected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the selected triangles (m,) cancel one with the same corners, oppositely oriented."""
    cancelled = np.zeros(len(triangles), dtype=np.bool_)
    rows = np.flatnonzero(selected)
    corners = triangles[rows]
    a, b, c = corners.T
    even = (a < b).astype(int) + (b < c) + (c < a) == 2  # a cyclic shift of ascending corners
    order = np.lexsort(np.sort(corners, axis=1).T)
    ascending = np.sort(corners, axis=1)[order]
    group = np.cumsum((np.diff(ascending, axis=0, prepend=-1) != 0).any(axis=1)) - 1
    flipped = ~even[order]
    pairs = np.minimum(np.bincount(group, ~flipped), np.bincount(group, flipped))
    for side in (flipped, ~flipped):
        rank = np.cumsum(side) - side  # how many of this side precede, over all groups
        rank -= rank[np.searchsorted(group, group)]
        cancelled[rows[order[side & (rank < pairs[group])]]] = True
    return cancelled


def _pair(vertices: Array, triangles: Triangles, partner: NDArray[np.int32]) -> None:
    """Write the partners (3 m,) of half-edges on shared edges, or raise ValueError."""
    shared = np.flatnonzero(partner <= SHARED)
    start, end = triangles.ravel()[shared], np.roll(triangles, -1, axis=1).ravel()[shared]
    lower, upper = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((upper, lower))
    changes = np.diff(lower[order], prepend=-1) | np.diff(upper[order], prepend=-1)
    begin = np.append(np.flatnonzero(changes), len(order))
    faulty = _pair_by_angle(vertices, triangles, shared[order], begin, partner)
    if faulty.any():
        refuse_edges(
            vertices,
            triangles,
            shared[order[begin[:-1][faulty]]],
            "is not a surface: {} edges are shared by more than two triangles, and solid and void do not "
            "alternate around them",
        )


@kernel
def _difference(vertices: Array, i: int, j: int) -> Vec:
    """Return vertex i relative to vertex j."""
    return vertices[i, 0] - vertices[j, 0], vertices[i, 1] - vertices[j, 1], vertices[i, 2] - vertices[j, 2]


@kernel
def _angles(vertices: Array, triangles: Triangles, half_edges: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the angle (k,), in [0, 2 pi), of each triangle about the first one's edge, and its sense (k,).

    The sense is 1 for a half-edge from the edge's lesser vertex: matter is then at lesser angles. Otherwise
    matter is at greater angles.
    """
    angle, sense = np.empty(len(half_edges)), np.empty(len(half_edges))
    first, corner = divmod(half_edges[0], 3)
    ends = triangles[first, corner], triangles[first, (corner + 1) % 3]
    low, high = min(ends), max(ends)
    axis = _difference(vertices, high, low)
    length2 = dot(axis, axis)
    e1 = e2 = axis
    for k in range(len(half_edges)):
        t, corner = divmod(half_edges[k], 3)
        sense[k] = 1.0 if triangles[t, corner] == low else -1.0
        w = _difference(vertices, triangles[t, (corner + 2) % 3], low)
        share = dot(w, axis) / length2
        w = w[0] - share * axis[0], w[1] - share * axis[1], w[2] - share * axis[2]
        if k == 0:
            e1 = w
            e2 = cross(axis, w)
        angle[k] = math.atan2(dot(w, e2) / math.sqrt(length2), dot(w, e1))
        # of coincident triangles, the one with matter at lesser angles comes first
        angle[k] = (angle[k] - 0.5 * sense[k] * _SAME_ANGLE) % (2.0 * math.pi)
    return angle, sense


@kernel
def _pair_by_angle(
    vertices: Array,
    triangles: Triangles,
    half_edges: NDArray[np.int64],
    begin: NDArray[np.int64],
    partner: NDArray[np.int32],
) -> NDArray[np.bool_]:
    """Pair the half-edges (k,) of each shared edge, delimited by begin (e + 1,); return the failures (e,)."""
    faulty = np.zeros(len(begin) - 1, dtype=np.bool_)
    for e in range(len(faulty)):
        group = half_edges[begin[e] : begin[e + 1]]
        angle, sense = _angles(vertices, triangles, group)
        order = np.argsort(angle)
        for k in range(len(order)):
            this, following = order[k], order[(k + 1) % len(order)]
            if sense[this] == sense[following]:
                faulty[e] = True
            elif sense[this] < 0.0:
                partner[group[this]], partner[group[following]] = group[following], group[this]
    return faulty
