"""Solids f(x) <= 0, cut along chords parallel to z: what an estimate of their mass properties needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array

_BISECTIONS = 48
"""From the cell of a grid to the last bits: no error beside the sampling's, also of an f that jumps."""


class Chords(NamedTuple):
    """Pieces of columns within the solid: the column (k,) that each lies in, its bottom and top (k,), m."""

    column: NDArray[np.int64]
    bottom: Array
    top: Array


class ImplicitSolid(Protocol):
    """A solid within the box from lower (3,) to upper (3,), m."""

    @property
    def lower(self) -> Array:
        """The box's least corner (3,), m."""

    @property
    def upper(self) -> Array:
        """The box's greatest corner (3,), m."""

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Say which points (n, 3) are in the solid."""

    def chords(self, xy: Array) -> Chords:
        """Return the pieces within the solid of the columns at xy (n, 2)."""


@dataclass(frozen=True)
class ImplicitEllipsoid:
    """(x/a)^2 + (y/b)^2 + (z/c)^2 <= 1, semi-axes in m."""

    a: float
    b: float
    c: float

    @property
    def lower(self) -> Array:
        """The box's least corner (3,), m."""
        return -self.upper

    @property
    def upper(self) -> Array:
        """The box's greatest corner (3,), m."""
        return np.array([self.a, self.b, self.c])

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Say which points (n, 3) are in the solid."""
        return np.asarray(np.sum((points / self.upper) ** 2, axis=1) <= 1.0)

    def chords(self, xy: Array) -> Chords:
        """|z| <= c sqrt(1 - (x/a)^2 - (y/b)^2), over columns at xy (n, 2), m."""
        return _symmetric_chords(self.c**2 * (1.0 - np.sum((xy / self.upper[:2]) ** 2, axis=1)))


@dataclass(frozen=True)
class ImplicitTorus:
    """(sqrt(x^2 + y^2) - R)^2 + z^2 <= r^2, radii in m."""

    major: float
    minor: float

    @property
    def lower(self) -> Array:
        """The box's least corner (3,), m."""
        return -self.upper

    @property
    def upper(self) -> Array:
        """The box's greatest corner (3,), m."""
        return np.array([self.major + self.minor, self.major + self.minor, self.minor])

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Say which points (n, 3) are in the solid."""
        return np.asarray(points[:, 2] ** 2 <= self._half_chords2(points[:, :2]))

    def chords(self, xy: Array) -> Chords:
        """|z| <= sqrt(r^2 - (sqrt(x^2 + y^2) - R)^2), over columns at xy (n, 2), m."""
        return _symmetric_chords(self._half_chords2(xy))

    def _half_chords2(self, xy: Array) -> Array:
        return self.minor**2 - (np.hypot(xy[:, 0], xy[:, 1]) - self.major) ** 2


def _symmetric_chords(half2: Array) -> Chords:
    """Return the chords |z| <= sqrt(half2), one a column where that is real."""
    column = np.flatnonzero(half2 > 0.0)
    half = np.sqrt(half2[column])
    return Chords(column, -half, half)


@dataclass(frozen=True, eq=False)
class LevelSet:
    """f(x) <= 0 within a box; f maps points (n, 3) in m to values (n,), and need not be smooth.

    What of the solid lies beyond the box is cut off. The ends of chords are found where f changes sign
    between two neighbours of `cells` + 1 points evenly spaced along a column, then by bisection; what slips
    between two of them is left to the estimate, which corrects the chords by points of its own.
    """

    function: Callable[[Array], Array]
    lower: Array
    upper: Array
    cells: int = 64

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Say which points (n, 3) are in the solid. Raises ValueError for values that are not n numbers."""
        values = np.asarray(self.function(points), dtype=np.float64)
        if values.shape != (len(points),):
            raise ValueError(f"f of points {points.shape} must be ({len(points)},), not {values.shape}")
        if np.isnan(values).any():
            raise ValueError(f"f is not a number at {points[np.argmax(np.isnan(values))].tolist()}")
        return values <= 0.0

    def chords(self, xy: Array) -> Chords:
        """Return the pieces of the columns at xy (n, 2) within the solid, as far as the grid tells."""
        z = np.linspace(self.lower[2], self.upper[2], self.cells + 1)
        points = np.column_stack([np.repeat(xy, len(z), axis=0), np.tile(z, len(xy))])
        inside = np.pad(
            self.inside(points).reshape(len(xy), len(z)), ((0, 0), (1, 1))
        )  # nothing beyond the box
        column, entered = np.nonzero(~inside[:, :-1] & inside[:, 1:])
        _, left = np.nonzero(inside[:, :-1] & ~inside[:, 1:])
        z = np.concatenate([z[:1], z, z[-1:]])
        outside = np.concatenate([z[entered], z[left + 1]])
        within = np.concatenate([z[entered + 1], z[left]])
        bottom, top = np.split(self._boundary(np.tile(xy[column], (2, 1)), outside, within), 2)
        return Chords(column, bottom, top)

    def _boundary(self, xy: Array, outside: Array, within: Array) -> Array:
        """Bisect to where each column (k, 2) passes from outside (k,) to within (k,)."""
        for _ in range(_BISECTIONS):
            middle = 0.5 * (outside + within)
            inside = self.inside(np.column_stack([xy, middle]))
            outside, within = np.where(inside, outside, middle), np.where(inside, middle, within)
        return within
