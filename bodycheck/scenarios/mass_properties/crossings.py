"""Find crossing triangles of a mesh with a tree of bounding boxes, and the space that the mesh winds around.

Source: Lauterbach et al. (2009), Fast BVH construction on GPUs, Computer Graphics Forum 28, for the order of
the triangles.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import Vec, cross
from bodycheck.scenarios.mass_properties.implicit import Chords
from bodycheck.scenarios.mass_properties.solid import Triangles

_CLEAR = 1e-9
"""Roughly the least sine that counts as lying on one side: touching or coplanar surfaces do not cross."""

_LEAF = 4
"""Triangles per leaf of the tree."""

_CELLS = 1 << 16
"""Cells along each axis, by which triangles are ordered."""


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
    a, b, c = other[j, 0], other[j, 1], other[j, 2]
    for k in range(3):
        p, q = one[i, k], one[i, (k + 1) % 3]
        if p in (a, b, c) or q in (a, b, c):
            continue  # an end of the edge lies on the triangle
        if _pierces(
            _corner(vertices, p),
            _corner(vertices, q),
            _corner(vertices, a),
            _corner(vertices, b),
            _corner(vertices, c),
        ):
            return True
    return False


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


def _ordered(vertices: Array, triangles: Triangles) -> Triangles:
    """Return the triangles (m, 3) in the order of their first corners along a Z curve."""
    corners = vertices[triangles[:, 0]]
    lower = corners.min(axis=0)
    size = float((corners - lower).max()) or 1.0
    code = np.zeros(len(triangles), dtype=np.int64)
    for axis in range(3):
        cells = np.minimum((corners[:, axis] - lower[axis]) / size * _CELLS, _CELLS - 1).astype(np.int64)
        for shift, mask in ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249)):
            cells = (cells | cells << shift) & mask  # two zero bits between the bits of a number
        code |= cells << axis
    return triangles[np.argsort(code, kind="stable")]


@kernel
def _tree(vertices: Array, triangles: Triangles, leaves: int) -> Array:
    """Return the boxes (2 leaves, 6) of a binary tree over the triangles, least and greatest coordinates.

    leaves: a power of two. Node k has the children 2 k and 2 k + 1; leaf k has the _LEAF triangles from
    number k _LEAF on.
    """
    boxes = np.empty((2 * leaves, 6))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    for t in range(triangles.shape[0]):
        node = leaves + t // _LEAF
        for k in range(3):
            for axis in range(3):
                x = vertices[triangles[t, k], axis]
                boxes[node, axis] = min(boxes[node, axis], x)
                boxes[node, 3 + axis] = max(boxes[node, 3 + axis], x)
    for node in range(leaves - 1, 0, -1):
        for axis in range(3):
            boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
            boxes[node, 3 + axis] = max(boxes[2 * node, 3 + axis], boxes[2 * node + 1, 3 + axis])
    return boxes


@kernel
def _first_piercing(vertices: Array, one: Triangles, other: Triangles, boxes: Array) -> int:
    """Return the first triangle of one with an edge through one of the other, whose tree is given, or -1."""
    leaves = boxes.shape[0] // 2
    waiting = np.empty(64, dtype=np.int64)
    own = np.empty(6)
    for i in range(one.shape[0]):
        for axis in range(3):
            x, y, z = (
                vertices[one[i, 0], axis],
                vertices[one[i, 1], axis],
                vertices[one[i, 2], axis],
            )
            own[axis], own[3 + axis] = min(x, y, z), max(x, y, z)
        waiting[0], count = 1, 1
        while count > 0:
            count -= 1
            node = waiting[count]
            apart = False
            for axis in range(3):
                apart |= (boxes[node, axis] > own[3 + axis]) | (boxes[node, 3 + axis] < own[axis])
            if apart:
                continue
            if node < leaves:
                waiting[count], waiting[count + 1] = 2 * node, 2 * node + 1
                count += 2
                continue
            begin = (node - leaves) * _LEAF
            for j in range(begin, min(begin + _LEAF, other.shape[0])):
                if _pierces_triangle(vertices, one, other, i, j):
                    return i
    return -1


def piercing_triangle(vertices: Array, one: Triangles, other: Triangles) -> NDArray[np.int64] | None:
    """Return a triangle (3,) of one surface with an edge through the interior of a triangle of the other.

    Shapes: (n, 3), (k, 3), (l, 3); both surfaces may be the same. None if there is none: an edge that exactly
    meets an edge or a corner passes through no interior.
    """
    if one is not other:
        lower, upper = box(vertices, other)
        one = one[_near(vertices, one, lower, upper)]
        lower, upper = box(vertices, one)
        other = other[_near(vertices, other, lower, upper)]
    if not (len(one) and len(other)):
        return None
    other = _ordered(vertices, other)
    found = _first_piercing(vertices, one, other, _tree(vertices, other, _leaves(other)))
    return None if found < 0 else one[found]


def _leaves(triangles: Triangles) -> int:
    """Return the number of leaves of a tree: the least power of two that is enough."""
    return 1 << max(0, (-(-len(triangles) // _LEAF) - 1).bit_length())


@kernel
def _edge_side(vertices: Array, i: int, j: int, x: float, y: float) -> bool:
    """Return whether (x, y) is left of the edge from vertex i to j, which is true in one direction only."""
    low, high = min(i, j), max(i, j)
    ax, ay, bx, by = vertices[low, 0], vertices[low, 1], vertices[high, 0], vertices[high, 1]
    left = (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0
    return left == (low == i)


@kernel
def _pierced(
    vertices: Array, triangles: Triangles, boxes: Array, xy: Array
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Return the column (k,), height (k,) and sense (k,) of each passage of columns xy (n, 2) through a mesh.

    The sense is 1 where a column enters the mesh upwards, -1 where it leaves it.
    """
    column, height, sense = np.empty(64, dtype=np.int64), np.empty(64), np.empty(64, dtype=np.int64)
    leaves = boxes.shape[0] // 2
    waiting = np.empty(64, dtype=np.int64)
    found = 0
    for c in range(xy.shape[0]):
        x, y = xy[c, 0], xy[c, 1]
        waiting[0], count = 1, 1
        while count > 0:
            count -= 1
            node = waiting[count]
            if x < boxes[node, 0] or x > boxes[node, 3] or y < boxes[node, 1] or y > boxes[node, 4]:
                continue
            if node < leaves:
                waiting[count], waiting[count + 1] = 2 * node, 2 * node + 1
                count += 2
                continue
            begin = (node - leaves) * _LEAF
            for t in range(begin, min(begin + _LEAF, triangles.shape[0])):
                i, j, k = triangles[t]
                side = _edge_side(vertices, i, j, x, y)
                if side != _edge_side(vertices, j, k, x, y) or side != _edge_side(vertices, k, i, x, y):
                    continue
                a, b, d = _corner(vertices, i), _corner(vertices, j), _corner(vertices, k)
                n = cross((b[0] - a[0], b[1] - a[1], b[2] - a[2]), (d[0] - a[0], d[1] - a[1], d[2] - a[2]))
                if n[2] == 0.0:
                    continue
                if found == len(column):
                    column, height = np.append(column, column), np.append(height, height)
                    sense = np.append(sense, sense)
                column[found] = c
                height[found] = a[2] - ((x - a[0]) * n[0] + (y - a[1]) * n[1]) / n[2]
                sense[found] = -1 if side else 1
                found += 1
    return column[:found], height[:found], sense[:found]


class WoundSolid:
    """The space around which a closed mesh, whose triangles face outward, winds at least once.

    Shapes: vertices (n, 3) in m, triangles (m, 3). An ImplicitSolid.
    """

    def __init__(self, vertices: Array, triangles: Triangles) -> None:
        self.lower, self.upper = box(vertices, triangles)
        self._mesh = vertices, (ordered := _ordered(vertices, triangles))
        self._tree = _tree(vertices, ordered, _leaves(ordered))

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (n, 3) the mesh winds around."""
        column, height, sense = _pierced(*self._mesh, self._tree, points[:, :2])
        below = height < points[column, 2]
        return np.bincount(column[below], sense[below], len(points)) != 0

    def chords(self, xy: Array) -> Chords:
        """Return the pieces of the columns at xy (n, 2) that the mesh winds around."""
        column, height, sense = _pierced(*self._mesh, self._tree, xy)
        order = np.lexsort((height, column))
        column, height = column[order], height[order]
        wound = (np.cumsum(sense[order])[:-1] != 0) & (column[1:] == column[:-1])
        return Chords(column[:-1][wound], height[:-1][wound], height[1:][wound])
