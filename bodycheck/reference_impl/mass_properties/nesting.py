"""Which closed surface lies within which: by winding numbers, the solid angles of all its triangles summed.

Source: van Oosterom & Strackee (1983), The solid angle of a plane triangle, IEEE Trans. Biomed. Eng. 30.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import filterfalse, islice
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.mass_properties.crossing import boxes_about, crosses
from bodycheck.reference_impl.mass_properties.places import place
from bodycheck.reference_impl.mass_properties.solid import Triangles
from bodycheck.reference_impl.registers import cross

_PROBED = 64
"""How many triangles of a surface at most are asked where their corners and middles lie."""

_ANSWERS = 64
"""How many of these points must answer the same; one on the other surface gives no answer."""

_ON_FACE = 1e-9
"""How near to a triangle, over its size, a point lies on it."""


def depths(vertices: Array, surfaces: Sequence[Triangles]) -> NDArray[np.int64]:
    """Return for each closed surface (k,) how many of the others it lies within.

    Raises ValueError where two of them cross, or lie upon each other so that neither is inside or outside.
    """
    boxes = [boxes_about(vertices, triangles) for triangles in surfaces]
    lower = np.array([box[0].min(axis=0) for box in boxes])
    upper = np.array([box[1].max(axis=0) for box in boxes])
    depth = np.zeros(len(surfaces), dtype=np.int64)
    for this, triangles in enumerate(surfaces):
        meeting = np.all((lower <= upper[this]) & (lower[this] <= upper), axis=1)
        meeting[this] = False
        for other in np.flatnonzero(meeting).tolist():
            near = triangles[
                np.all((boxes[this][0] <= upper[other]) & (boxes[this][1] >= lower[other]), axis=1)
            ]
            if crosses(vertices, near, surfaces[other]):
                _refuse(vertices, triangles, surfaces[other], "cross; what they share would count twice")
            depth[this] += _within(vertices, triangles, surfaces[other])
    return depth


def _within(vertices: Array, triangles: Triangles, other: Triangles) -> bool:
    """Say whether a surface lies within another, all of it.

    The points asked also find crossings where edge meets edge, as with boxes shifted along a diagonal.
    """
    corners = vertices[triangles[:: max(1, len(triangles) // _PROBED)]]
    probes = np.concatenate([corners[:, 0], corners.mean(axis=1), corners[:, 1], corners[:, 2]])
    windings = (winding_number(tuple(probe), vertices, other) for probe in probes)
    answers = {round(winding) != 0 for winding in islice(filterfalse(math.isnan, windings), _ANSWERS)}
    if not answers:
        _refuse(vertices, triangles, other, "lie upon each other")
    if len(answers) > 1:
        _refuse(vertices, triangles, other, "cross; what they share would count twice")
    return answers.pop()


def _refuse(vertices: Array, one: Triangles, other: Triangles, what: str) -> NoReturn:
    """Raise ValueError naming two surfaces."""
    places = " and ".join(place(vertices[triangles[0, 0]]) for triangles in (one, other))
    raise ValueError(f"the mesh is ambiguous: its closed surfaces at {places} {what}")


@kernel
def winding_number(point: tuple[float, float, float], vertices: Array, triangles: Triangles) -> float:
    """sum of the solid angles / 4 pi, tan(angle / 2) = det(a, b, c) / (abc + a b.c + b c.a + c a.b).

    1 inside a closed surface that faces outward, -1 where it faces inward, 0 outside, NaN on it.
    """
    px, py, pz = point
    half_angles = 0.0
    for t in range(triangles.shape[0]):
        i, j, k = triangles[t]
        a = vertices[i, 0] - px, vertices[i, 1] - py, vertices[i, 2] - pz
        b = vertices[j, 0] - px, vertices[j, 1] - py, vertices[j, 2] - pz
        c = vertices[k, 0] - px, vertices[k, 1] - py, vertices[k, 2] - pz
        la = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
        lb = math.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
        lc = math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
        ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        bc = b[0] * c[0] + b[1] * c[1] + b[2] * c[2]
        ca = c[0] * a[0] + c[1] * a[1] + c[2] * a[2]
        n = cross(b, c)
        determinant = a[0] * n[0] + a[1] * n[1] + a[2] * n[2]
        rest = la * lb * lc + la * bc + lb * ca + lc * ab
        on_corner = min(la, lb, lc) <= _ON_FACE * max(la, lb, lc)
        if on_corner or max(abs(determinant), rest) <= _ON_FACE * la * lb * lc:
            return math.nan
        half_angles += math.atan2(determinant, rest)
    return half_angles / (2.0 * math.pi)
