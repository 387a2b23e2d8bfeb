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
_SEMI_AXES = np.array([1.0, 0.7, 0.4])


def mesh(effort: Effort) -> list[Measured]:
    """Measure an ellipsoid's mesh at the origin and far off it, and trimesh on the same arrays."""
    try:
        import trimesh
    except ImportError as error:
        figures = ("mesh.time", "mesh.error", "mesh.error-far", "mesh.against-trimesh")
        return [Measured(name, None, note=f"trimesh cannot be imported: {error}") for name in figures]
    vertices, triangles = ellipsoid_mesh(effort.subdivisions)
    far = vertices + _FAR_M
    ours = Task(partial(polyhedron, vertices, triangles))
    theirs = Task(lambda: trimesh.triangles.mass_properties(vertices[triangles]))
    fast, slow = interleaved([ours, theirs], effort)
    return [
        Measured.of("mesh.time", Spread.of(fast).scaled(1e3), f"{len(triangles)} triangles"),
        Measured("mesh.error", exact_solid(vertices, triangles).error(polyhedron(vertices, triangles))),
        Measured("mesh.error-far", exact_solid(far, triangles).error(polyhedron(far, triangles))),
        Measured.of("mesh.against-trimesh", ratio(slow, fast), f"trimesh {trimesh.__version__}"),
    ]


def ellipsoid_mesh(subdivisions: int) -> tuple[Array, Triangles]:
    """Return vertices (n, 3) and triangles (20 x 4^subdivisions, 3), counter-clockwise from outside.

    They are those of an icosahedron whose triangles are divided into four again and again.
    """
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions)
    return np.array(sphere.vertices) * _SEMI_AXES, np.array(sphere.faces, dtype=np.int64)
