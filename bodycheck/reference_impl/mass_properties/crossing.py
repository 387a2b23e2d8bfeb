"""Detect crossing surfaces: an edge of one passes through a triangle of the other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import Vec, cross
from bodycheck.reference_impl.mass_properties.solid import Triangles

_CLEAR = 1e-9
"""Roughly the least sine that counts as lying on one side: touching or coplanar surfaces do not cross."""


@kernel
def _side(a: Vec, b: Vec, c: Vec, d: Vec) -> int:
    """Return 1 if d is on the side of plane abc that sees abc counter-clockwise, -1 opposite, 0 near it."""
    ab = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ad = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    n = cross(ab, ac)
    volume = n[0] * ad[0] + n[1] * ad[1] + n[2] * ad[2]
    scale = 1.0
    for v in (ab, ac, ad):
        scale *= math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if abs(volume) <= _CLEAR * scale:
        return 0
    return 1 if volume > 0.0 else -1


@kernel
def _pierces(p: Vec, q: Vec, a: Vec, b: Vec, c: Vec) -> bool:
    """Return whether the segment pq passes through the interior of the triangle abc."""
    if _side(a, b, c, p) * _side(a, b, c, q) >= 0:
        return False
    side = _side(p, q, a, b)
    return side != 0 and _side(p, q, b, c) == side and _side(p, q, c, a) == side


@kernel
def _corner(vertices: Array, i: int) -> Vec:
    """Vertex i."""
    return vertices[i, 0], vertices[i, 1], vertices[i, 2]


@kernel
def _pierces_triangle(vertices: Array, one: Triangles, other: Triangles, i: int, j: int) -> bool:
    """Return whether an edge of triangle i of one passes through the interior of triangle j of the other."""
    a, b, c = _corner(vertices, other[j, 0]), _corner(vertices, other[j, 1]), _corner(vertices, other[j, 2])
    for k in range(3):
        if _pierces(_corner(vertices, one[i, k]), _corner(vertices, one[i, (k + 1) % 3]), a, b, c):
            return True
    return False


@kernel
def _any_pierces(
    vertices: Array,
    one: Triangles,
    other: Triangles,
    boxes: Array,
    other_boxes: Array,
    begin: NDArray[np.int64],
) -> bool:
    """Return whether an edge of one passes through the other.

    The other's boxes ascend along x; triangle i of one can meet those from begin[i] on, begin (k,).
    """
    for i in range(one.shape[0]):
        lower, upper = boxes[0, i], boxes[1, i]
        for j in range(begin[i], other.shape[0]):
            if other_boxes[0, j, 0] > upper[0]:
                break
            apart = False
            for axis in range(3):
                apart |= (other_boxes[0, j, axis] > upper[axis]) | (other_boxes[1, j, axis] < lower[axis])
            if not apart and _pierces_triangle(vertices, one, other, i, j):
                return True
    return False


@kernel
def _boxes(vertices: Array, triangles: Triangles) -> Array:
    """Return the bounding boxes (2, m, 3) of the triangles: least and greatest coordinates."""
    boxes = np.empty((2, triangles.shape[0], 3))
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t]
        for axis in range(3):
            x, y, z = vertices[a, axis], vertices[b, axis], vertices[c, axis]
            boxes[0, t, axis], boxes[1, t, axis] = min(x, y, z), max(x, y, z)
    return boxes


@kernel
def box(vertices: Array, triangles: Triangles) -> tuple[Array, Array]:
    """Return the least (3,) and greatest (3,) coordinates of the triangles (m, 3) on vertices (n, 3)."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for t in range(triangles.shape[0]):
        for k in range(3):
            for axis in range(3):
                x = vertices[triangles[t, k], axis]
                lower[axis], upper[axis] = min(lower[axis], x), max(upper[axis], x)
    return lower, upper


@kernel
def _near(vertices: Array, triangles: Triangles, lower: Array, upper: Array) -> NDArray[np.bool_]:
    """Return which triangles (m,) have a bounding box that meets the box from lower (3,) to upper (3,)."""
    near = np.ones(triangles.shape[0], dtype=np.bool_)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t]
        for axis in range(3):
            x, y, z = vertices[a, axis], vertices[b, axis], vertices[c, axis]
            near[t] &= (min(x, y, z) <= upper[axis]) & (max(x, y, z) >= lower[axis])
    return near


def crosses(vertices: Array, one: Triangles, other: Triangles) -> bool:
    """Return whether an edge of one surface passes through the interior of a triangle of the other.

    Shapes: (n, 3), (k, 3), (l, 3). An edge that exactly meets an edge or a corner passes through no interior.
    The other's triangles are sorted along x, so that each triangle is compared only with those near it.
    """
    one = one[_near(vertices, one, *box(vertices, other))]
    other = other[_near(vertices, other, *box(vertices, one))]
    if not (len(one) and len(other)):
        return False
    boxes, other_boxes = _boxes(vertices, one), _boxes(vertices, other)
    order = np.argsort(other_boxes[0, :, 0])
    other, other_boxes = other[order], other_boxes[:, order]
    widest = np.ptp(other_boxes[:, :, 0], axis=0).max()
    begin = np.searchsorted(other_boxes[0, :, 0], boxes[0, :, 0] - widest)
    return bool(_any_pierces(vertices, one, other, boxes, other_boxes, begin))
