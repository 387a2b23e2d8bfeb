"""Mass properties of a fine mesh, against exact rational arithmetic and next to trimesh."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.effort import Effort
from benchmarks.exact_solid import exact_solid
from benchmarks.figures import Measured
from benchmarks.icosphere import ellipsoid_mesh
from benchmarks.task import Call
from benchmarks.timing import Spread, interleaved, ratio
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.polyhedron import polyhedron
from bodycheck.scenarios.mass_properties.solid import Triangles

_FAR_M = np.array([1000.0, 1000.0, 1000.0])


def mesh(effort: Effort) -> list[Measured]:
    """Measure an ellipsoid's mesh at the origin and far off it, and trimesh on the same arrays."""
    vertices, triangles = ellipsoid_mesh(effort.subdivisions)
    far = vertices + _FAR_M
    rival, version = _trimesh(vertices, triangles)
    ours = Call(partial(polyhedron, vertices, triangles))
    seconds = interleaved([ours] if rival is None else [ours, rival], effort)
    against = (
        Measured("mesh.against-trimesh", None, note=version)
        if rival is None
        else Measured.of("mesh.against-trimesh", ratio(seconds[1], seconds[0]), f"trimesh {version}")
    )
    return [
        Measured.of("mesh.time", Spread.of(seconds[0]).scaled(1e3), f"{len(triangles)} triangles"),
        Measured("mesh.error", exact_solid(vertices, triangles).error(polyhedron(vertices, triangles))),
        Measured("mesh.error-far", exact_solid(far, triangles).error(polyhedron(far, triangles))),
        against,
    ]


def _trimesh(vertices: Array, triangles: Triangles) -> tuple[Call | None, str]:
    """Return trimesh's own integral over the same arrays and its version, or None and why not."""
    try:
        import trimesh
    except ImportError as error:
        return None, f"trimesh cannot be imported: {error}"
    return Call(lambda: trimesh.triangles.mass_properties(vertices[triangles])), trimesh.__version__
