"""Check that triangles bound a solid: repair unambiguous faults and reject the rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bodycheck._util.formatting import first_few, vector
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.crossings import piercing_triangle
from bodycheck.scenarios.mass_properties.edges import (
    OPEN,
    SplitMesh,
    partners,
    refuse_edges,
    split_shared_edges,
)
from bodycheck.scenarios.mass_properties.outward_orientation import (
    consistent,
    outward_orientation,
    with_flipped,
)
from bodycheck.scenarios.mass_properties.solid import LENGTHS, Overlap, Triangles
from bodycheck.scenarios.mass_properties.vertex_merge import merged, without_slits

_MAX_TRIANGLES = (1 << 31) // 3
"""Half-edges have 32-bit numbers."""


class Mesh(NamedTuple):
    """Vertices (n, 3) in m, triangles (m, 3) that face outward, and notes on repairs, one sentence each.

    crossing (3,): a place near which the surface crosses itself, or surfaces cross each other; None if none
    was found.
    """

    vertices: Array
    triangles: Triangles
    notes: tuple[str, ...]
    crossing: Array | None


def checked_mesh(vertices: ArrayLike, triangles: ArrayLike, overlap: Overlap = "refuse") -> Mesh:
    """Return the mesh with equal vertices merged and its triangles facing outward, if it bounds a solid.

    Shapes: vertices (n, 3) in m, triangles (m, 3) of vertex numbers. Repairs, each reported in a note:
    triangles with two equal corners and triangles back to back are removed, corners that only round-off
    separates are joined, and flipped triangles and inside-out meshes are reoriented.

    Raises ValueError, naming the fault and its place, for coordinates that are not finite, invalid vertex
    numbers, an open mesh, edges around which matter and void do not alternate, a one-sided surface, a surface
    that encloses nothing, and ambiguous nested or crossing surfaces. If the overlap is "count-twice", matter
    within matter counts as often as it is drawn. A surface that crosses itself is not refused here, but
    reported: what it winds around twice counts twice.
    """
    points, corners = _arrays(vertices, triangles)
    points, corners = _merged(points, corners)
    collapsed = _is_collapsed(corners)
    kept = corners[~collapsed] if collapsed.any() else corners
    notes = _note(points, corners[collapsed], "had two equal corners and were removed")
    closed = _closed(points, kept)
    surfaces = consistent(points, closed.triangles, closed.partner)
    orientation = outward_orientation(points, surfaces, overlap)
    notes += (
        *closed.notes,
        *_flipped_note(points, closed.triangles, surfaces.flipped != orientation.wrong),
        *orientation.notes,
    )
    outward = with_flipped(surfaces.triangles, orientation.wrong)
    piercing = piercing_triangle(points, outward, outward)
    return Mesh(points, outward, notes, None if piercing is None else points[piercing].mean(axis=0))


def _arrays(vertices: ArrayLike, triangles: ArrayLike) -> tuple[Array, Triangles]:
    """Return vertices (n, 3) and triangles (m, 3) as arrays; raise ValueError for bad shapes or numbers."""
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"vertices must be (n, 3), not {points.shape}")
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.issubdtype(corners.dtype, np.integer):
        raise ValueError(f"triangles must be whole numbers (m, 3), not {corners.dtype} {corners.shape}")
    if not len(corners):
        raise ValueError("the mesh has no triangles")
    if len(corners) > _MAX_TRIANGLES:
        raise ValueError(f"the mesh has {len(corners)} triangles; at most {_MAX_TRIANGLES} are taken")
    if corners.min() < 0 or corners.max() >= len(points):
        row = np.flatnonzero(((corners < 0) | (corners >= len(points))).any(axis=1))[0]
        raise ValueError(
            f"triangle {row} has the corners {corners[row].tolist()}, but vertices are 0 to {len(points) - 1}"
        )
    if not np.isfinite(points).all():
        row = np.flatnonzero(~np.isfinite(points).all(axis=1))[0]
        raise ValueError(f"vertex {row} is not finite: {points[row].tolist()}")
    size = float(max(points.max(), -points.min()))
    if not LENGTHS[0] < size < LENGTHS[1]:
        raise ValueError(
            f"the largest coordinate is {size!r} m; it must be within {LENGTHS[0]} to {LENGTHS[1]} m"
        )
    return points, np.ascontiguousarray(corners, dtype=np.int64)


def _merged(vertices: Array, triangles: Triangles) -> tuple[Array, Triangles]:
    """Return the distinct vertices (k, 3), and the triangles (m, 3) renumbered accordingly."""
    points, number = merged(vertices)
    same = len(points) == len(vertices)
    return points, triangles if same else number.astype(np.int64)[triangles]


def _is_collapsed(triangles: Triangles) -> NDArray[np.bool_]:
    """Return which triangles (m,) have two equal corners: these bound nothing, and their neighbours meet."""
    a, b, c = triangles.T
    collapsed = (a == b) | (b == c) | (c == a)
    if collapsed.all():
        raise ValueError("the mesh is degenerate: each triangle has two equal corners")
    return np.asarray(collapsed)


def _closed(vertices: Array, triangles: Triangles) -> SplitMesh:
    """Return the triangles with the partners of all their half-edges; raise ValueError for an open mesh."""
    partner = partners(triangles, len(vertices))
    notes: tuple[str, ...] = ()
    if (partner == OPEN).any():
        joined = without_slits(vertices, triangles, partner)
        if joined is None:
            faulty = np.flatnonzero(partner == OPEN)
            refuse_edges(vertices, triangles, faulty, "is open: {} edges belong to one triangle only")
        triangles, partner, notes = joined.triangles, joined.partner, (joined.note,)
    split = split_shared_edges(vertices, triangles, partner)
    return split._replace(notes=notes + split.notes)


def _flipped_note(vertices: Array, triangles: Triangles, flipped: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return a note on the reversed triangles, if any."""
    if flipped.all():
        return ("the mesh was inside-out; all its triangles were reversed",)
    return _note(vertices, triangles[flipped], "had the wrong orientation and were reversed")


def _note(vertices: Array, triangles: Triangles, what: str) -> tuple[str, ...]:
    """Return '5 triangles <what>, at (0, 0, 1); ...' if there are any."""
    if not len(triangles):
        return ()
    where = first_few(vector(vertices[triangle[0]]) for triangle in triangles)
    return (f"{len(triangles)} of the triangles {what}, at {where}",)
