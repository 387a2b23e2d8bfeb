"""Which triangles meet at which edge: in a closed surface, exactly two at each.

Half-edge 3 t + k runs from corner k of triangle t to its next corner.
"""

from __future__ import annotations

from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.mass_properties.places import first_few, place
from bodycheck.reference_impl.mass_properties.solid import Triangles

OPEN, SHARED, SHARED_TOO = -1, -2, -3
"""In place of a partner: the edge is that of one triangle only; or of more, as their first; or not."""


@kernel
def partners(triangles: Triangles, vertices: int) -> NDArray[np.int32]:
    """Return for each half-edge (3 m,) the other one on the same two of so many vertices.

    OPEN, SHARED and SHARED_TOO stand where there is none, or more than one. Half-edges are sorted by
    counting, first by the greater of their vertices and then by the lesser: in linear time.
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
    """Return the items (k,) by ascending key[item] < keys, stably: a counting sort."""
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
    return f"from {place(start)} to {place(end)}"


def refuse_edges(vertices: Array, triangles: Triangles, faulty: NDArray[np.int64], what: str) -> NoReturn:
    """Raise ValueError naming the first of the faulty edges (k,), each by one of its half-edges."""
    shown = first_few(described(vertices, triangles, half_edge) for half_edge in np.sort(faulty))
    raise ValueError(f"the mesh {what.format(len(faulty))}: {shown}")
