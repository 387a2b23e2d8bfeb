"""Which triangles meet at which edge: in a closed surface, exactly two at each.

Half-edge 3 t + k runs from corner k of triangle t to its next corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.places import first_few, place
from bodycheck.reference_impl.mass_properties.solid import Triangles


def partners(vertices: Array, triangles: Triangles) -> NDArray[np.int64]:
    """Return for each half-edge (3 m,) the other one on the same two vertices.

    Raises ValueError naming the first edges that belong to one triangle only (the mesh is open) or to more
    than two (it is no surface there).
    """
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edge = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    order = np.argsort(edge)
    begin = np.flatnonzero(np.diff(edge[order], prepend=-1))
    sharing = np.diff(begin, append=len(order))
    _refuse(vertices, triangles, order[begin[sharing == 1]], "is open: {} edges belong to one triangle only")
    _refuse(
        vertices,
        triangles,
        order[begin[sharing > 2]],
        "is no surface: {} edges are shared by more than two triangles",
    )
    partner = np.empty_like(order)
    partner[order[0::2]], partner[order[1::2]] = order[1::2], order[0::2]
    return partner


def described(vertices: Array, triangles: Triangles, half_edge: int) -> str:
    """Return 'from (0, 0, 0) to (1, 0, 0)'."""
    triangle, corner = divmod(int(half_edge), 3)
    start, end = vertices[triangles[triangle, [corner, (corner + 1) % 3]]]
    return f"from {place(start)} to {place(end)}"


def _refuse(vertices: Array, triangles: Triangles, faulty: NDArray[np.int64], what: str) -> None:
    """Raise ValueError where there are faulty edges."""
    if len(faulty):
        shown = first_few(described(vertices, triangles, half_edge) for half_edge in np.sort(faulty))
        raise ValueError(f"the mesh {what.format(len(faulty))}: {shown}")
