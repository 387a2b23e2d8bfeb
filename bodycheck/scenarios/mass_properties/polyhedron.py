"""Exact integrals over a closed triangle mesh, as a sum of signed tetrahedra about the mesh's centroid.

Sources: Mirtich (1996), Fast and accurate computation of polyhedral mass properties, J. Graphics Tools 1;
Tonon (2004), Explicit exact formulas for the 3-D tetrahedron inertia tensor in terms of its vertex
coordinates, J. Math. Stat. 1. Compensated sums: Neumaier (1974), with Knuth's branch-free two-sum.
The kernels are exact, so that small meshes, which are interpreted, have the same bits.
"""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.double_double import two_sum
from bodycheck.reference_impl.kernels.jit import exact_kernel
from bodycheck.reference_impl.kernels.small_vectors import Vec, exact_cross, exact_dot
from bodycheck.scenarios.mass_properties.solid import MassProperties, Triangles

_LANES = 32
"""Triangles per block, with one row per quantity, so that one instruction processes several triangles."""

_CORNERS, _TERMS = 9, 10
_FIRST_TERM = _CORNERS * _LANES

_MULTIPLES = np.array([6.0, 24.0, 24.0, 24.0, 120.0, 120.0, 120.0, 120.0, 120.0, 120.0])


@exact_kernel
def _corner(vertices: Array, i: int, origin: Vec) -> Vec:
    """Return vertex i relative to the given origin."""
    return vertices[i, 0] - origin[0], vertices[i, 1] - origin[1], vertices[i, 2] - origin[2]


@exact_kernel
def _subtract(a: Vec, b: Vec) -> Vec:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@exact_kernel
def _determinant(a: Vec, b: Vec, c: Vec) -> float:
    """det(a, b, c) = a . (b - a) x (c - a), with the cross product at the corner between the shorter edges.

    The plain triple product of a fine mesh's nearly equal corners cancels down to the triangle's share of the
    surface, whereas the edges are nearly exact. The cross product of a sliver's two long edges would cancel.
    """
    ab, bc, ca = _subtract(b, a), _subtract(c, b), _subtract(a, c)
    ab2, bc2, ca2 = exact_dot(ab, ab), exact_dot(bc, bc), exact_dot(ca, ca)
    if ab2 >= bc2 and ab2 >= ca2:
        corner, before, after = c, bc, ca
    elif bc2 >= ca2:
        corner, before, after = a, ca, ab
    else:
        corner, before, after = b, ab, bc
    return exact_dot(corner, exact_cross(before, after))


@exact_kernel
def volume_area_reach(vertices: Array, triangles: Triangles) -> tuple[float, float, float]:
    """V = sum D / 6, A = sum |(b - a) x (c - a)| / 2, r = max |x - x0|, uncompensated, for signs and scales.

    Shapes: (n, 3), (m, 3) -> m^3, m^2, m. The round-off of V is about 1e-16 A r.
    """
    volume = area = reach2 = 0.0
    origin = _corner(vertices, triangles[0, 0], (0.0, 0.0, 0.0))
    for t in range(triangles.shape[0]):
        a = _corner(vertices, triangles[t, 0], origin)
        b = _corner(vertices, triangles[t, 1], origin)
        c = _corner(vertices, triangles[t, 2], origin)
        normal = exact_cross(_subtract(b, a), _subtract(c, a))
        volume += exact_dot(a, normal)
        area += math.sqrt(exact_dot(normal, normal))
        reach2 = max(reach2, exact_dot(a, a), exact_dot(b, b), exact_dot(c, c))
    return volume / 6.0, area / 2.0, math.sqrt(reach2)


@exact_kernel
def _gather(work: Array, vertices: Array, triangles: Triangles, origin: Vec, begin: int) -> None:
    """Copy the corners of the triangles from `begin` on into the lanes; pad with triangles of no volume."""
    count = min(_LANES, triangles.shape[0] - begin)
    for i in range(count):
        for k in range(3):
            x, y, z = _corner(vertices, triangles[begin + i, k], origin)
            row = 3 * k * _LANES + i
            work[row], work[row + _LANES], work[row + 2 * _LANES] = x, y, z
    for i in range(count, _LANES):
        for row in range(_CORNERS):
            work[row * _LANES + i] = 0.0


@exact_kernel
def _expand(work: Array) -> None:
    """Write D, D s and D (a a^T + b b^T + c c^T + s s^T), s = a + b + c, of the triangles in the lanes.

    Each triangle spans a tetrahedron with its apex at the origin, D = det(a, b, c). The terms are 6 times its
    volume, 24 times its first moments and 120 times its second moments xx, yy, zz, xy, yz, zx.
    """
    n, to = _LANES, _FIRST_TERM
    for i in range(_LANES):
        a = work[i], work[n + i], work[2 * n + i]
        b = work[3 * n + i], work[4 * n + i], work[5 * n + i]
        c = work[6 * n + i], work[7 * n + i], work[8 * n + i]
        d = _determinant(a, b, c)
        s = a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2]
        work[to + i] = d
        work[to + n + i] = d * s[0]
        work[to + 2 * n + i] = d * s[1]
        work[to + 3 * n + i] = d * s[2]
        work[to + 4 * n + i] = d * (a[0] * a[0] + b[0] * b[0] + c[0] * c[0] + s[0] * s[0])
        work[to + 5 * n + i] = d * (a[1] * a[1] + b[1] * b[1] + c[1] * c[1] + s[1] * s[1])
        work[to + 6 * n + i] = d * (a[2] * a[2] + b[2] * b[2] + c[2] * c[2] + s[2] * s[2])
        work[to + 7 * n + i] = d * (a[0] * a[1] + b[0] * b[1] + c[0] * c[1] + s[0] * s[1])
        work[to + 8 * n + i] = d * (a[1] * a[2] + b[1] * b[2] + c[1] * c[2] + s[1] * s[2])
        work[to + 9 * n + i] = d * (a[2] * a[0] + b[2] * b[0] + c[2] * c[0] + s[2] * s[0])


@exact_kernel
def _add(high: Array, low: Array, work: Array) -> None:
    """Add each lane's terms to its own sums, and the rounding errors of these sums to the low parts."""
    for i in range(_TERMS * _LANES):
        high[i], error = two_sum(high[i], work[_FIRST_TERM + i])
        low[i] += error


@exact_kernel
def _moments(vertices: Array, triangles: Triangles, origin: Vec) -> Array:
    """Integrals of 1, x, y, z, xx, yy, zz, xy, yz, zx over the solid, about the given origin: (10,)."""
    high, low = np.zeros(_TERMS * _LANES), np.zeros(_TERMS * _LANES)
    work = np.empty((_CORNERS + _TERMS) * _LANES)
    for begin in range(0, triangles.shape[0], _LANES):
        _gather(work, vertices, triangles, origin, begin)
        _expand(work)
        _add(high, low, work)
    integrals = np.empty(_TERMS)
    for k in range(_TERMS):
        total, rest = 0.0, 0.0
        for i in range(k * _LANES, (k + 1) * _LANES):
            total, error = two_sum(total, high[i])
            rest += error + low[i]
        integrals[k] = (total + rest) / _MULTIPLES[k]
    return integrals


@exact_kernel
def _mean(vertices: Array) -> Vec:
    """Return the mean of all vertices, ten times as fast as mean(axis=0)."""
    x = y = z = 0.0
    for i in range(vertices.shape[0]):
        x += vertices[i, 0]
        y += vertices[i, 1]
        z += vertices[i, 2]
    return x / vertices.shape[0], y / vertices.shape[0], z / vertices.shape[0]


def polyhedron(vertices: Array, triangles: Triangles) -> MassProperties:
    """Return the mass properties, at unit density, of the solid that a closed outward mesh bounds.

    Shapes: vertices (n, 3) in m, triangles (m, 3). The mesh must have passed mesh_check. The relative error
    is 1e-15 wherever the mesh lies: the integrals are taken about the mean of the vertices, and again about
    the centroid where the mean is so far off that the parallel-axis theorem would cancel digits. Two cases
    lose more: a thin shell, by the ratio of the whole to what the cavity leaves; and a small part far from
    the rest, 1e-16 times its distance over its size.
    """
    origin = np.array(_mean(vertices))
    solid = MassProperties.of_moments(_moments(vertices, triangles, tuple(origin)))
    spread = 0.5 * np.trace(solid.inertia) - np.diagonal(solid.inertia)
    if np.any(solid.mass * solid.centre**2 > spread):
        origin = origin + solid.centre
        solid = MassProperties.of_moments(_moments(vertices, triangles, tuple(origin)))
    return solid.translated(origin)
