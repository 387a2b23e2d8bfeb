"""Solids f(x) <= 0 and their chords parallel to z, from which mass properties are estimated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array

_BISECTIONS = 48
"""From a grid cell to the last bits: negligible relative to the sampling error, even if f jumps."""

_SECTIONS = 40
"""Golden-section steps per extremum: these narrow its bracket to 4e-9 of a cell."""

_MARGIN = 1.01
"""Allows for round-off and for an f that is steeper within a cell than the values at its ends show."""

_GOLDEN = 0.5 * (5.0**0.5 - 1.0)


class Chords(NamedTuple):
    """Pieces of columns within the solid: the column (k,) of each, its bottom (k,) and its top (k,), m."""

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
        """Return which points (n, 3) are in the solid."""

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
        """Return which points (n, 3) are in the solid."""
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
        """Return which points (n, 3) are in the solid."""
        return np.asarray(points[:, 2] ** 2 <= self._half_chords2(points[:, :2]))

    def chords(self, xy: Array) -> Chords:
        """|z| <= sqrt(r^2 - (sqrt(x^2 + y^2) - R)^2), over columns at xy (n, 2), m."""
        return _symmetric_chords(self._half_chords2(xy))

    def _half_chords2(self, xy: Array) -> Array:
        return self.minor**2 - (np.hypot(xy[:, 0], xy[:, 1]) - self.major) ** 2


def _symmetric_chords(half2: Array) -> Chords:
    """Return the chords |z| <= sqrt(half2), one per column where the root is real; half2 (n,), m^2."""
    column = np.flatnonzero(half2 > 0.0)
    half = np.sqrt(half2[column])
    return Chords(column, -half, half)


@dataclass(frozen=True, eq=False)
class LevelSet:
    """f(x) <= 0 within a box; f maps points (n, 3) in m to values (n,), and need not be smooth.

    The box cuts off any part of the solid beyond it. f is sampled at `cells` + 1 points evenly spaced along
    each column; bisection refines the chord ends between neighbours of opposite sign. Where f may have an
    extremum near 0 within a cell, a golden-section search looks for a wall or a gap thinner than the cell.
    The estimate corrects for missed features by sampling points of its own.
    """

    function: Callable[[Array], Array]
    lower: Array
    upper: Array
    cells: int = 64

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (n, 3) are in the solid. Raises ValueError if f does not return n numbers."""
        return self._values(points) <= 0.0

    def chords(self, xy: Array) -> Chords:
        """Return the pieces of the columns at xy (n, 2) within the solid that the sampling of f detects."""
        grid = np.linspace(self.lower[2], self.upper[2], self.cells + 1)
        points = np.column_stack([np.repeat(xy, len(grid), axis=0), np.tile(grid, len(xy))])
        values = self._values(points).reshape(len(xy), len(grid))
        column, z, inside = self._thin(xy, grid, values)
        ends = np.repeat(np.arange(len(xy)), 2)  # nothing beyond the box
        column = np.concatenate([np.repeat(np.arange(len(xy)), len(grid)), column, ends])
        z = np.concatenate([points[:, 2], z, np.tile(grid[[0, -1]], len(xy))])
        inside = np.concatenate([values.ravel() <= 0.0, inside, np.zeros(len(ends), dtype=np.bool_)])
        last = np.concatenate([np.zeros(len(z) - len(ends)), np.tile([-1.0, 1.0], len(xy))])
        order = np.lexsort((last, z, column))
        column, z, inside = column[order], z[order], inside[order]
        entered = np.flatnonzero(~inside[:-1] & inside[1:])
        left = np.flatnonzero(inside[:-1] & ~inside[1:])
        bottom = self._boundary(xy[column[entered]], z[entered], z[entered + 1])
        top = self._boundary(xy[column[left]], z[left + 1], z[left])
        return Chords(column[entered], bottom, top)

    def _values(self, points: Array) -> Array:
        """Return f at points (n, 3), or raise ValueError if f does not return n numbers."""
        values = np.asarray(self.function(points), dtype=np.float64)
        if values.shape != (len(points),):
            raise ValueError(f"f of points {points.shape} must be ({len(points)},), not {values.shape}")
        if np.isnan(values).any():
            raise ValueError(f"f is not a number at {points[np.argmax(np.isnan(values))].tolist()}")
        return values

    def _thin(
        self, xy: Array, grid: Array, values: Array
    ) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
        """Return columns (k,) and heights (k,) of points in thin walls and gaps, and which are in walls (k,).

        values (n, g): f on the grid (g,). A cell next to an extremum over the grid is searched if f has one
        sign at both ends and is small enough to reach 0 between them without being steeper than between some
        neighbours on the column. A column that grazes a shell meets it once in each of two such cells.
        """
        steepest = _MARGIN * np.max(np.abs(np.diff(values, axis=1)), axis=1, keepdims=True)
        found = []
        for sign in (1.0, -1.0):
            before, here, after = (sign * values[:, k : k - 2 or None] for k in range(3))
            extremum = (here > 0.0) & (before >= here) & (after >= here) & ((before > here) | (after > here))
            below, above = (np.argwhere(extremum & (here + end <= steepest)) for end in (before, after))
            column, k = np.concatenate([below, above + np.array([0, 1])]).T
            z = self._below_zero(xy[column], grid[k], grid[k + 1], sign)
            reached = ~np.isnan(z)
            found.append((column[reached], z[reached], np.full(reached.sum(), sign > 0.0)))
        column, z, inside = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return column, z, inside

    def _below_zero(self, xy: Array, low: Array, high: Array, sign: float) -> Array:
        """Return heights (k,) with sign f < 0 between low (k,) and high (k,) on columns (k, 2), or NaN."""
        found = np.full(len(xy), np.nan)
        open_ = np.arange(len(xy))
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        f_left, f_right = (sign * self._values(np.column_stack([xy, z])) for z in (left, right))
        for _ in range(_SECTIONS):
            reached = np.minimum(f_left, f_right) < 0.0
            found[open_[reached]] = np.where(f_left < f_right, left, right)[reached]
            remaining = ~reached
            if not remaining.any():
                break
            open_, low, high, left, right = (
                open_[remaining],
                low[remaining],
                high[remaining],
                left[remaining],
                right[remaining],
            )
            f_left, f_right = f_left[remaining], f_right[remaining]
            lower = f_left < f_right
            low, high = np.where(lower, low, left), np.where(lower, right, high)
            new = np.where(lower, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
            f_new = sign * self._values(np.column_stack([xy[open_], new]))
            left, right = np.where(lower, new, right), np.where(lower, left, new)
            f_left, f_right = np.where(lower, f_new, f_right), np.where(lower, f_left, f_new)
        return found

    def _boundary(self, xy: Array, outside: Array, within: Array) -> Array:
        """Bisect for the height (k,) where each column (k, 2) passes from outside (k,) to within (k,)."""
        for _ in range(_BISECTIONS):
            middle = 0.5 * (outside + within)
            inside = self.inside(np.column_stack([xy, middle]))
            outside, within = np.where(inside, outside, middle), np.where(inside, middle, within)
        return within
