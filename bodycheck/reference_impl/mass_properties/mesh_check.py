"""From any triangles to a mesh that bounds a solid: put right where that is clear, refused where not."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.edges import partners
from bodycheck.reference_impl.mass_properties.facing import misfacing
from bodycheck.reference_impl.mass_properties.merging import merged
from bodycheck.reference_impl.mass_properties.orientation import consistent, with_turned
from bodycheck.reference_impl.mass_properties.places import first_few, place
from bodycheck.reference_impl.mass_properties.solid import LENGTHS, Triangles


class Mesh(NamedTuple):
    """Vertices (n, 3) in m, triangles (m, 3) that face outward, and what was put right, a sentence each."""

    vertices: Array
    triangles: Triangles
    notes: tuple[str, ...]


def checked_mesh(vertices: ArrayLike, triangles: ArrayLike) -> Mesh:
    """Return the mesh, its equal vertices made one and its triangles facing outward, if it bounds a solid.

    Shapes: (n, 3) in m, (m, 3) numbers of vertices. Triangles with two equal corners are left out, flipped
    ones and an inside-out mesh are turned; the notes say so. Raises ValueError, naming what and where, for
    coordinates that are not finite, numbers of no vertex, an open mesh, edges of more than two triangles, a
    one-sided surface, one that encloses nothing, and nested or crossing ones that can be read in two ways.
    A surface that crosses itself is not looked for: what it winds around twice counts twice.
    """
    points, given = _arrays(vertices, triangles)
    points, number = merged(points)
    corners = number[given]
    collapsed = _is_collapsed(corners)
    kept = corners[~collapsed]
    surfaces = consistent(points, kept, partners(points, kept))
    wrong = misfacing(points, surfaces)
    notes = (
        *_note(points, corners[collapsed], "had two equal corners and were left out"),
        *_turned_note(points, kept, surfaces.turned != wrong),
        *_parts_note(surfaces.surface),
    )
    return Mesh(points, with_turned(surfaces.triangles, wrong), notes)


def _arrays(vertices: ArrayLike, triangles: ArrayLike) -> tuple[Array, Triangles]:
    """Return both as arrays, or refuse their shapes and numbers."""
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"vertices must be (n, 3), not {points.shape}")
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.issubdtype(corners.dtype, np.integer):
        raise ValueError(f"triangles must be whole numbers (m, 3), not {corners.dtype} {corners.shape}")
    if not len(corners):
        raise ValueError("the mesh has no triangles")
    if corners.min() < 0 or corners.max() >= len(points):
        row = np.flatnonzero(((corners < 0) | (corners >= len(points))).any(axis=1))[0]
        raise ValueError(
            f"triangle {row} has the corners {corners[row].tolist()}, but vertices are 0 to {len(points) - 1}"
        )
    if not np.isfinite(points).all():
        row = np.flatnonzero(~np.isfinite(points).all(axis=1))[0]
        raise ValueError(f"vertex {row} is not finite: {points[row].tolist()}")
    size = float(np.abs(points).max())
    if not LENGTHS[0] < size < LENGTHS[1]:
        raise ValueError(
            f"the largest coordinate is {size!r} m; it must be within {LENGTHS[0]} to {LENGTHS[1]} m"
        )
    return points, corners.astype(np.int64)


def _is_collapsed(triangles: Triangles) -> NDArray[np.bool_]:
    """Say which triangles (m,) have two equal corners: they bound nothing, their neighbours still meet."""
    a, b, c = triangles.T
    collapsed = (a == b) | (b == c) | (c == a)
    if collapsed.all():
        raise ValueError("the mesh is degenerate: each triangle has two equal corners")
    return np.asarray(collapsed)


def _turned_note(vertices: Array, triangles: Triangles, turned: NDArray[np.bool_]) -> tuple[str, ...]:
    """Say which triangles were turned, if any."""
    if turned.all():
        return ("the mesh was inside-out; all its triangles were turned",)
    return _note(vertices, triangles[turned], "faced the wrong way and were turned")


def _note(vertices: Array, triangles: Triangles, what: str) -> tuple[str, ...]:
    """Return '5 triangles <what>, at (0, 0, 1); ...' if there are any."""
    if not len(triangles):
        return ()
    where = first_few(place(vertices[triangle[0]]) for triangle in triangles)
    return (f"{len(triangles)} of the triangles {what}, at {where}",)


def _parts_note(surface: NDArray[np.int64]) -> tuple[str, ...]:
    """Say how many closed surfaces there are, if more than one."""
    parts = int(surface.max()) + 1
    return (f"the mesh has {parts} closed surfaces; none was found to cross another",) if parts > 1 else ()
