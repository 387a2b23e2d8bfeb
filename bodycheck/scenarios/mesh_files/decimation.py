"""Reduce a triangle mesh to a size that pages can hold, and write it as OBJ; for drawing only.

Source: Rossignac & Borrel (1993), Multi-resolution 3D approximations for rendering complex scenes.
"""

from __future__ import annotations

from io import BytesIO

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.obj import parse_obj

MAX_TRIANGLES = 600
"""The largest number of triangles of a decimated mesh."""

_RESOLUTIONS = (20, 16, 13, 11, 9, 8, 7, 6, 5, 4)
"""Numbers of cells along the longest edge of the bounding box, finest first."""


def decimated(vertices: Array, triangles: Triangles) -> tuple[Array, Triangles]:
    """Merge the vertices (n, 3) in each cell of ever coarser cubic grids until few triangles remain.

    A mesh that has no more triangles (m, 3) is returned unchanged.
    """
    for resolution in _RESOLUTIONS:
        if len(triangles) <= MAX_TRIANGLES:
            break
        vertices, triangles = _clustered(vertices, triangles, resolution)
    return vertices, triangles[:MAX_TRIANGLES]


def _clustered(vertices: Array, triangles: Triangles, resolution: int) -> tuple[Array, Triangles]:
    """Replace the vertices of each cell by their mean, and drop degenerate and duplicate triangles.

    resolution: the number of cells along the longest edge of the bounding box. Large arrays have 32 bits,
    since a mesh may have millions of triangles.
    """
    lower, size = vertices.min(axis=0), float(np.max(np.ptp(vertices, axis=0)))
    cells = np.zeros(len(vertices), dtype=np.int32)
    for axis in range(3):
        cells *= resolution + 1
        cells += ((vertices[:, axis] - lower[axis]) * (resolution / size)).astype(np.int32)
    occupied, counts = np.unique(cells, return_counts=True)
    numbers = np.searchsorted(occupied, cells).astype(np.int32)
    means = np.stack([np.bincount(numbers, axis) for axis in vertices.T], axis=1) / counts[:, None]
    a, b, c = (numbers[corner] for corner in triangles.T)
    distinct = (a != b) & (b != c) & (c != a)
    corners = np.stack([a[distinct], b[distinct], c[distinct]], axis=1)
    first = np.argmin(corners, axis=1)
    n, rows = len(occupied), np.arange(len(corners))
    codes = corners[rows, first].astype(np.int64)  # with the least corner first, of a triangle's vertices
    for k in (1, 2):
        codes *= n
        codes += corners[rows, (first + k) % 3]
    codes = np.unique(codes)
    unique = np.stack([codes // n**2, codes // n % n, codes % n], axis=1)
    used, renumbered = np.unique(unique, return_inverse=True)
    return means[used], renumbered.reshape(-1, 3)


def obj_text(vertices: Array, triangles: Triangles) -> str:
    """Return a mesh as OBJ, with 6 digits of its longest extent."""
    decimals = 5 - int(np.floor(np.log10(np.max(np.ptp(vertices, axis=0)))))
    points = (" ".join(repr(round(x, decimals)) for x in vertex) for vertex in vertices.tolist())
    faces = (" ".join(str(corner + 1) for corner in triangle) for triangle in triangles.tolist())
    return "".join([*(f"v {point}\n" for point in points), *(f"f {face}\n" for face in faces)])


def read_obj_text(text: str) -> tuple[Array, Triangles]:
    """Return the mesh of an OBJ text; raises ValueError if it is not one, or larger than a decimated mesh."""
    found = parse_obj(BytesIO(text.encode()))
    vertices, triangles = found.vertices, found.triangles()
    if not 0 < len(triangles) <= MAX_TRIANGLES:
        raise ValueError(f"has {len(triangles)} triangles, not 1 to {MAX_TRIANGLES}")
    return vertices, triangles
