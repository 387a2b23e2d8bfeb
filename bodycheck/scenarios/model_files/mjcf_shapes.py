"""Mass properties of MJCF geoms: primitives in 40-digit arithmetic, meshes in doubles.

Source: MuJoCo's XML reference, body/geom (size, shellinertia) and asset/mesh (inertia); a capsule's size is
its radius and the half length of the cylindrical part, a box's its half edges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.model_files.exact_arithmetic import Exact, ExactInertia, exact, mp

MeshInertia: TypeAlias = Literal["convex", "exact", "legacy", "shell"]
Moments: TypeAlias = tuple[Any, Any, Any]


def geom_inertia(kind: str, size: Sequence[Any], *, shell: bool, mass: Any, density: Any) -> ExactInertia:
    """Return the inertia of a primitive about its centre: of the given mass, or else of the density.

    The density is in kg/m^3, of a shell in kg/m^2. Raises ValueError for a kind without a closed form.
    """
    forms = _SHELLS if shell else _SOLIDS
    if kind not in forms:
        raise ValueError(f"a {'shell' if shell else 'solid'} {kind} has no closed form here")
    measure, moments = forms[kind](*size)
    total = density * measure if mass is None else mass
    tensor = exact(np.zeros((3, 3)))
    for axis, moment in enumerate(moments):
        tensor[axis, axis] = total * moment / measure
    return ExactInertia(total, exact(np.zeros(3)), tensor)


def _sphere(r: Any) -> tuple[Any, Moments]:
    return _ellipsoid(r, r, r)


def _ellipsoid(a: Any, b: Any, c: Any) -> tuple[Any, Moments]:
    volume = 4 * mp.pi * a * b * c / 3
    return volume, (volume * (b * b + c * c) / 5, volume * (a * a + c * c) / 5, volume * (a * a + b * b) / 5)


def _box(a: Any, b: Any, c: Any) -> tuple[Any, Moments]:
    volume = 8 * a * b * c
    return volume, (volume * (b * b + c * c) / 3, volume * (a * a + c * c) / 3, volume * (a * a + b * b) / 3)


def _cylinder(r: Any, half: Any) -> tuple[Any, Moments]:
    volume = 2 * mp.pi * r * r * half
    across = volume * (r * r / 4 + half * half / 3)
    return volume, (across, across, volume * r * r / 2)


def _capsule(r: Any, half: Any) -> tuple[Any, Moments]:
    core, (across, _, along) = _cylinder(r, half)
    ends = 4 * mp.pi * r**3 / 3
    across += ends * (2 * r * r / 5 + half * half + 3 * half * r / 4)
    return core + ends, (across, across, along + ends * 2 * r * r / 5)


def _sphere_shell(r: Any) -> tuple[Any, Moments]:
    area = 4 * mp.pi * r * r
    return area, (2 * area * r * r / 3,) * 3


def _tube(r: Any, half: Any) -> tuple[Any, Any, Any]:
    """Return the area of an open tube, and its moments across and along the axis."""
    area = 4 * mp.pi * r * half
    return area, area * (r * r / 2 + half * half / 3), area * r * r


def _cylinder_shell(r: Any, half: Any) -> tuple[Any, Moments]:
    area, across, along = _tube(r, half)
    caps = 2 * mp.pi * r * r
    across += caps * (r * r / 4 + half * half)
    return area + caps, (across, across, along + caps * r * r / 2)


def _capsule_shell(r: Any, half: Any) -> tuple[Any, Moments]:
    area, across, along = _tube(r, half)
    ends = 4 * mp.pi * r * r  # hemispherical shells, whose centres are r / 2 from their bases
    across += ends * (2 * r * r / 3 + half * half + half * r)
    return area + ends, (across, across, along + ends * 2 * r * r / 3)


def _box_shell(a: Any, b: Any, c: Any) -> tuple[Any, Moments]:
    faces = (8 * b * c, 8 * a * c, 8 * a * b)  # the pairs normal to x, y, z
    half = (a, b, c)
    second = [  # integral of x_i^2 over the surface
        faces[i] * half[i] ** 2 + sum(faces[k] * half[i] ** 2 / 3 for k in range(3) if k != i)
        for i in range(3)
    ]
    total = sum(second, mp.mpf(0))
    x, y, z = (total - one for one in second)
    return sum(faces, mp.mpf(0)), (x, y, z)


_Form: TypeAlias = Callable[..., tuple[Any, Moments]]
_SOLIDS: dict[str, _Form] = {
    "sphere": _sphere,
    "ellipsoid": _ellipsoid,
    "box": _box,
    "cylinder": _cylinder,
    "capsule": _capsule,
}
_SHELLS: dict[str, _Form] = {
    "sphere": _sphere_shell,
    "box": _box_shell,
    "cylinder": _cylinder_shell,
    "capsule": _capsule_shell,
}
SIZES = {"sphere": 1, "ellipsoid": 3, "box": 3, "cylinder": 2, "capsule": 2}
"""Kind -> the number of sizes that it has."""


def mesh_inertia(vertices: Array, triangles: Triangles, kind: MeshInertia) -> tuple[float, Array, Array]:
    """Return volume or area, centre (3,) and tensor (3, 3) of a mesh at unit density, as MJCF defines.

    Shapes: vertices (n, 3) in m, triangles (m, 3). `exact` sums signed tetrahedra, `legacy` the absolute
    volumes of those about the centroid of the faces (then about the centre), which counts concave parts
    twice, `convex` takes the hull. Raises ValueError where the volume is not positive.
    """
    if kind == "convex":
        vertices, triangles = _hull(vertices)
    corners = vertices[triangles]
    middles = corners.mean(axis=1)
    normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    if not areas.sum() > 0.0:
        raise ValueError("the mesh has no area")
    about = areas @ middles / areas.sum()

    def weights(origin: Array) -> Array:
        if kind == "shell":
            return areas
        volumes = np.einsum("ij,ij->i", middles - origin, normals) / 3.0
        return np.abs(volumes) if kind == "legacy" else volumes

    first = weights(about)
    if not first.sum() > 0.0:
        raise ValueError("the mesh has no positive volume")
    centres = middles if kind == "shell" else 0.75 * middles + 0.25 * about
    centre = first @ centres / first.sum()
    w, x = weights(centre), corners - centre
    summed = x.sum(axis=1)
    products = np.einsum("t,tki,tkj->ij", w, x, x) + np.einsum("t,ti,tj->ij", w, summed, summed)
    products /= 12.0 if kind == "shell" else 20.0
    return float(w.sum()), centre, np.trace(products) * np.eye(3) - products


def _hull(vertices: Array) -> tuple[Array, Triangles]:
    """Return the convex hull with its faces counter-clockwise seen from outside."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(vertices)
    except QhullError:
        raise ValueError("the mesh has no convex hull with a volume") from None
    triangles = hull.simplices.astype(np.int64)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    triangles[inward] = triangles[inward][:, [0, 2, 1]]
    return vertices, triangles


def exact_of(mass: float, centre: Array, tensor: Array) -> ExactInertia:
    """Return doubles as an ExactInertia."""
    position: Exact = exact(centre)
    return ExactInertia(mp.mpf(mass), position, exact(tensor))
