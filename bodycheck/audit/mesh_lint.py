"""Compare what MuJoCo makes of a mesh, by its attribute `inertia`, with the solid that the mesh bounds.

Source: MuJoCo's XML reference, asset/mesh (inertia): legacy counts concave parts and walls of cavities more
than once, convex takes the hull, shell the surface, exact the solid.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.audit.audit import Body, Difference, LintFinding
from bodycheck.scenarios.mass_properties.solid import MassProperties
from bodycheck.scenarios.model_files.link_solids import closed_solid
from bodycheck.scenarios.model_files.mjcf_shapes import mesh_inertia
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, WeighedMesh

_SMALL = 1e-3  # relative difference up to which a mesh is as good as the solid
_CLEAR = 0.01  # relative difference from which a mesh is a warning
_WHY = {
    "legacy": "concave parts and walls of cavities count more than once",
    "convex": "its convex hull",
    "shell": "its surface",
}


def weighed_meshes(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:  # noqa: ARG001 - rules are alike
    """Report meshes whose inertia by MuJoCo's rules is not that of the solid that they bound."""
    seen = set()
    for mesh in link.meshes:
        key = mesh.name, mesh.mass, mesh.density
        if mesh.kind != "exact" and key not in seen:
            seen.add(key)
            yield from _compared(link, mesh)


def _compared(link: ModelLink, mesh: WeighedMesh) -> Iterator[LintFinding]:
    held = MassProperties(*mesh_inertia(mesh.vertices, mesh.triangles, mesh.kind))
    solid = closed_solid(mesh.vertices, mesh.triangles)[1] if len(mesh.triangles) else None
    if solid is None:
        return
    held_body, solid_body = (_weighed(one, mesh) for one in (held, solid))
    difference = Difference.between(solid_body, held_body)
    if difference.largest <= _SMALL:
        return
    large = difference.largest > _CLEAR and mesh.kind != "shell"
    what = f'mesh {mesh.name!r}, inertia="{mesh.kind}" ({_WHY[mesh.kind]}): MuJoCo '
    if mesh.mass is None:
        density = f"{number(mesh.density, 6)} kg/m^{2 if mesh.kind == 'shell' else 3}"
        what += (
            f"holds {number(held_body.mass_kg, 4)} kg at {density}; the solid that it bounds weighs "
            f"{number(solid_body.mass_kg, 4)} kg"
        )
    else:
        what += (
            f"gives its {number(mesh.mass, 6)} kg the largest moment {number(_largest(held_body), 4)} "
            f"kg m^2; the solid has {number(_largest(solid_body), 4)} kg m^2"
        )
    yield LintFinding(
        "mesh-inertia",
        "warning" if large else "note",
        "certain",
        str(link.file),
        mesh.line,
        link.name,
        what,
        _remedy(mesh),
    )


def _remedy(mesh: WeighedMesh) -> str:
    """Return how MuJoCo gets the solid's inertia.

    It refuses `exact` for faces that point inward, or that share an edge in the same direction; for the
    latter only if the corners are one vertex there, too, which in an OBJ depends on texture and normal.
    """
    a, b, c = mesh.triangles[np.diff(np.sort(mesh.triangles), axis=1).all(axis=1)].T
    edges = np.concatenate([np.stack(pair, axis=1) for pair in ((a, b), (b, c), (c, a))])
    if len(np.unique(edges, axis=0)) < len(edges):
        return (
            f'inertia="exact" in <mesh name="{mesh.name}">, if the part is solid; MuJoCo may refuse it, '
            "because two faces share an edge in the same direction: then mass and inertia of the part in "
            "<inertial>"
        )
    x, y, z = (mesh.vertices[corner] for corner in mesh.triangles.T)
    turned = ", with all faces turned outward" if np.sum(x * np.cross(y, z)) < 0.0 else ""
    return f'inertia="exact" in <mesh name="{mesh.name}">{turned}, if the part is solid'


def _weighed(unit: MassProperties, mesh: WeighedMesh) -> Body:
    solid = unit.at_density(mesh.density) if mesh.mass is None else unit.of_mass(mesh.mass)
    return Body(solid.mass, solid.centre, solid.inertia)


def _largest(body: Body) -> float:
    return float(np.max(body.principal[0]))
