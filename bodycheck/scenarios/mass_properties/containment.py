"""Determine which closed surface lies within which, by winding numbers: sums of the triangles' solid angles.

Source: van Oosterom & Strackee (1983), The solid angle of a plane triangle, IEEE Trans. Biomed. Eng. 30.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from itertools import filterfalse, islice
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.formatting import vector
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import cross
from bodycheck.scenarios.mass_properties.crossings import box, piercing_triangle
from bodycheck.scenarios.mass_properties.solid import TO_COUNT_TWICE, Overlap, Triangles

_PROBED = 64
"""The maximum number of triangles of a surface whose corners and centroids serve as probes."""

_ANSWERS = 64
"""How many probes must agree; a probe on the other surface gives no answer."""

_ON_FACE = 1e-9
"""The distance to a triangle, relative to its size, within which a point counts as lying on it."""


class Containment(NamedTuple):
    """How k closed surfaces are nested.

    depth (k,): how many others contain each surface. winding (k,): their total winding number around it,
    signed by their orientation. crossing (k,): whether it crosses another. pairs: how many pairs cross.
    """

    depth: NDArray[np.int64]
    winding: NDArray[np.int64]
    crossing: NDArray[np.bool_]
    pairs: int


class _Relation(Enum):
    """How one closed surface lies relative to another."""

    OUTSIDE = "outside"
    WITHIN = "within"
    CROSSING = "cross, so that what they share would count twice"
    COINCIDENT = "lie upon each other"


def containment(
    vertices: Array, surfaces: Sequence[Triangles], outward: NDArray[np.bool_], overlap: Overlap
) -> Containment:
    """Return how k closed surfaces are nested; outward (k,) tells which of them face outward.

    Raises ValueError where two of them cross, unless the overlap is "count-twice", and where they coincide,
    so that neither is inside or outside the other.
    """
    lower, upper = (np.array(corners) for corners in zip(*(box(vertices, s) for s in surfaces), strict=True))
    depth, winding = np.zeros((2, len(surfaces)), dtype=np.int64)
    crossing = np.zeros(len(surfaces), dtype=np.bool_)
    pairs = 0
    for this, triangles in enumerate(surfaces):
        meeting = np.all((lower <= upper[this]) & (lower[this] <= upper), axis=1)
        for other in (np.flatnonzero(meeting[:this])).tolist():
            relations = _relations(vertices, triangles, surfaces[other])
            if _Relation.COINCIDENT in relations or (_Relation.CROSSING in relations and overlap == "refuse"):
                _refuse(vertices, surfaces[other], triangles, max(relations, key=list(_Relation).index))
            if _Relation.CROSSING in relations:
                pairs += 1
                crossing[[this, other]] = True
                continue
            for inner, outer, relation in zip((this, other), (other, this), relations, strict=True):
                if relation is _Relation.WITHIN:
                    depth[inner] += 1
                    winding[inner] += 1 if outward[outer] else -1
    return Containment(depth, winding, crossing, pairs)


def _relations(vertices: Array, one: Triangles, other: Triangles) -> tuple[_Relation, _Relation]:
    """Return how `one` lies relative to `other`, and `other` relative to `one`."""
    if any(piercing_triangle(vertices, *pair) is not None for pair in ((one, other), (other, one))):
        return _Relation.CROSSING, _Relation.CROSSING
    return _by_points(vertices, one, other), _by_points(vertices, other, one)


def _by_points(vertices: Array, triangles: Triangles, other: Triangles) -> _Relation:
    """Return how a surface lies relative to another, by probing points of it.

    The probes also detect crossings where edge meets edge, as with boxes shifted along a diagonal.
    """
    corners = vertices[triangles[:: max(1, len(triangles) // _PROBED)]]
    probes = np.concatenate([corners[:, 0], corners.mean(axis=1), corners[:, 1], corners[:, 2]])
    windings = (winding_number(tuple(probe), vertices, other) for probe in probes)
    answers = {round(winding) != 0 for winding in islice(filterfalse(math.isnan, windings), _ANSWERS)}
    if len(answers) != 1:
        return _Relation.CROSSING if answers else _Relation.COINCIDENT
    return _Relation.WITHIN if answers.pop() else _Relation.OUTSIDE


def _refuse(vertices: Array, one: Triangles, other: Triangles, relation: _Relation) -> NoReturn:
    """Raise ValueError naming two surfaces."""
    places = " and ".join(vector(vertices[triangles[0, 0]]) for triangles in (one, other))
    remedy = f"; {TO_COUNT_TWICE}" if relation is _Relation.CROSSING else ""
    raise ValueError(f"the mesh is ambiguous: its closed surfaces at {places} {relation.value}{remedy}")


@kernel
def winding_number(point: tuple[float, float, float], vertices: Array, triangles: Triangles) -> float:
    """sum of the solid angles / 4 pi, tan(angle / 2) = det(a, b, c) / (abc + a b.c + b c.a + c a.b).

    Shapes: point (3,), vertices (n, 3), triangles (m, 3). 1 inside a closed surface that faces outward, -1
    inside one that faces inward, 0 outside, NaN on it.
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
