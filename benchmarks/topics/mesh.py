"""Mass properties of a fine mesh, against exact rational arithmetic and next to trimesh."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.exact_solid import exact_solid
from benchmarks.figures import Measured
from benchmarks.solver import Task
from benchmarks.timing import Effort, Spread, interleaved, ratio
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.polyhedron import polyhedron
from bodycheck.scenarios.mass_properties.solid import Triangles

_FAR_M = np.array([1000.0, 1000.0, 1000.0])
_GOLDEN = 0.5 * (1.0 + 5.0**0.5)
_SEMI_AXES = np.array([1.0, 0.7, 0.4])


def mesh(effort: Effort) -> list[Measured]:
    """Measure an ellipsoid's mesh at the origin and far off it, and trimesh on the same arrays."""
    vertices, triangles = ellipsoid_mesh(effort.subdivisions)
    far = vertices + _FAR_M
    tasks = [Task(partial(polyhedron, vertices, triangles))]
    try:
        import trimesh
    except ImportError as error:
        note = f"trimesh cannot be imported: {error}"
    else:
        note = f"trimesh {trimesh.__version__}"
        tasks.append(Task(lambda: trimesh.triangles.mass_properties(vertices[triangles])))
    ours, *theirs = interleaved(tasks, effort)
    figure = "mesh.against-trimesh"
    return [
        Measured.of("mesh.time", Spread.of(ours).scaled(1e3), f"{len(triangles)} triangles"),
        Measured("mesh.error", exact_solid(vertices, triangles).error(polyhedron(vertices, triangles))),
        Measured("mesh.error-far", exact_solid(far, triangles).error(polyhedron(far, triangles))),
        Measured.of(figure, ratio(theirs[0], ours), note) if theirs else Measured(figure, None, note=note),
    ]


def ellipsoid_mesh(subdivisions: int) -> tuple[Array, Triangles]:
    """Return vertices (n, 3) and triangles (20 x 4^subdivisions, 3), counter-clockwise from outside."""
    vertices, triangles = _icosahedron()
    for _ in range(subdivisions):
        vertices, triangles = _divided(vertices, triangles)
    return vertices * _SEMI_AXES, triangles


def _icosahedron() -> tuple[Array, Triangles]:
    """Return the twelve vertices, on the unit sphere, and the triples that are nearest neighbours."""
    signs = [(a, b) for a in (-1.0, 1.0) for b in (-_GOLDEN, _GOLDEN)]
    corners = np.array([np.roll([0.0, a, b], k) for k in range(3) for a, b in signs])
    near = np.linalg.norm(corners[:, None] - corners, axis=-1) < 2.1
    threes = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[k, i]
    ]
    outward = [
        three if np.linalg.det(corners[list(three)]) > 0.0 else (three[0], three[2], three[1])
        for three in threes
    ]
    return corners / np.linalg.norm(corners[0]), np.array(outward, dtype=np.int64)


def _divided(vertices: Array, triangles: Triangles) -> tuple[Array, Triangles]:
    """Divide each triangle into four at the midpoints of its edges, projected onto the sphere."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1).reshape(-1, 2)
    pairs, which = np.unique(edges, axis=0, return_inverse=True)
    middles = vertices[pairs].sum(axis=1)
    middles /= np.linalg.norm(middles, axis=-1, keepdims=True)
    a, b, c = triangles.T
    ab, bc, ca = (len(vertices) + which.reshape(-1, 3)).T
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    divided = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return np.concatenate([vertices, middles]), divided.astype(np.int64)
