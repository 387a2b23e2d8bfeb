"""Triangles turned until each edge is run through once in either direction, surface by surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.mass_properties.edges import described
from bodycheck.reference_impl.mass_properties.solid import Triangles

_UNSEEN = -1
_NONE = -1


class Surfaces(NamedTuple):
    """Triangles (m, 3), consistent within each surface; the surface (m,) of each; which were turned (m,)."""

    triangles: Triangles
    surface: NDArray[np.int32]
    turned: NDArray[np.bool_]


def consistent(vertices: Array, triangles: Triangles, partner: NDArray[np.int32]) -> Surfaces:
    """Turn as few triangles as make each connected surface consistently oriented, either way out.

    Shapes: (n, 3), (m, 3), (3 m,) from edges.partners. Raises ValueError naming an edge where a surface has
    but one side (a Möbius band or Klein bottle is in it).
    """
    surface, turned, conflict = _spread(triangles, partner)
    if conflict != _NONE:
        raise ValueError(
            "the mesh is not orientable: its surface has one side only; the two sides meet on the edge "
            + described(vertices, triangles, conflict)
        )
    minority = 2 * np.bincount(surface[turned], minlength=surface.max() + 1) > np.bincount(surface)
    turned = turned != minority[surface]
    return Surfaces(with_turned(triangles, turned), surface, turned)


def with_turned(triangles: Triangles, turned: NDArray[np.bool_]) -> Triangles:
    """Return the triangles (m, 3), those marked (m,) run through the other way."""
    return np.where(turned[:, None], triangles[:, ::-1], triangles) if turned.any() else triangles


@kernel
def _spread(
    triangles: Triangles, partner: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.bool_], int]:
    """Walk each surface from its first triangle over every edge, turning what disagrees with the one before.

    Returns the surface (m,) of each triangle, which ones are turned (m,), and a half-edge at which two walked
    triangles still disagree, or -1.
    """
    count = len(partner) // 3
    start = triangles.ravel()
    surface = np.full(count, _UNSEEN, dtype=np.int32)
    turned = np.zeros(count, dtype=np.bool_)
    stack = np.empty(count, dtype=np.int32)
    surfaces = 0
    for seed in range(count):
        if surface[seed] != _UNSEEN:
            continue
        surface[seed] = surfaces
        stack[0] = seed
        waiting = 1
        while waiting > 0:
            waiting -= 1
            here = stack[waiting]
            for half_edge in range(3 * here, 3 * here + 3):
                there = partner[half_edge] // 3
                agreeing = start[half_edge] != start[partner[half_edge]]
                should_be = turned[here] == agreeing
                if surface[there] == _UNSEEN:
                    surface[there] = surfaces
                    turned[there] = should_be
                    stack[waiting] = there
                    waiting += 1
                elif turned[there] != should_be:
                    return surface, turned, half_edge
        surfaces += 1
    return surface, turned, _NONE
