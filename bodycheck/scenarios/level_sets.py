"""Mass properties of solids f(x) <= 0 by randomised quasi-Monte Carlo, with their standard errors.

Columns stand at scrambled Sobol points of the xy plane and are integrated along z exactly, over the chords
that the solid says. One more point a column, at random height, is asked whether it is in the solid: what the
chords say wrongly there is added, at the weight of a point. So the chords are a control variate of plain
sampling in three dimensions; the estimate is unbiased even where they miss a part, and the error shows it.

Sources: Owen (1997), Scrambled net variance for integrals of smooth functions, Ann. Stat. 25; L'Ecuyer &
Lemieux (2002), Recent advances in randomized quasi-Monte Carlo methods, for errors by randomisation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc, t

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.implicit import Chords, ImplicitSolid, LevelSet
from bodycheck.reference_impl.mass_properties.solid import MassProperties
from bodycheck.scenarios.user_functions import said

_RANDOMISATIONS = 32
"""Independent scramblings; the standard error is known to 1 / sqrt(2 * 31) = 13 % of itself."""

HALF_WIDTH = float(t.ppf(0.975, _RANDOMISATIONS - 1))
"""In standard errors, of a 95 % interval: Student's t for as many degrees of freedom, 2.04."""

LEAST_COLUMNS_LOG2 = 10
"""With fewer columns a scrambling's error is far from normal, and intervals hold too seldom."""

_LEAST_HITS = 200
"""Points, over all scramblings, from which on their number tells its own spread."""

_AT_ONCE = 4096
"""Columns handled together, so that a level set's grid fits the cache."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mass properties at unit density, and the standard error of each number in them, in its unit.

    Round-off, about 1e-15 of the largest numbers, comes on top: a number that symmetry makes zero in every
    scrambling has a standard error of nothing.
    """

    properties: MassProperties
    mass_error: float
    centre_error: Array
    inertia_error: Array

    def half_widths(self) -> MassProperties:
        """Return the half widths of 95 % intervals about the numbers, in their places and units."""
        return MassProperties(
            HALF_WIDTH * self.mass_error, HALF_WIDTH * self.centre_error, HALF_WIDTH * self.inertia_error
        )

    def at_density(self, density: float) -> Estimate:
        """m = rho V, I = rho I(1), and their standard errors with them: from unit density to another, kg/m^3.

        Raises ValueError as MassProperties.at_density does.
        """
        heavier = self.properties.at_density(density)
        return Estimate(heavier, density * self.mass_error, self.centre_error, density * self.inertia_error)


def estimate(solid: ImplicitSolid, *, columns_log2: int = 12, seed: int = 0) -> Estimate:
    """Estimate the mass properties of an implicit solid from 32 scramblings of 2^columns_log2 columns each.

    The error falls about as the number of columns to the power -1 where the chords are right, -2/3 where
    they miss a part. The same seed gives the same numbers. Raises ValueError for fewer than 2^10 columns, for
    a box without inside, and where a scrambling meets nothing of the solid, or most of the error comes from
    parts that the chords miss, met by so few points that it cannot be stated.
    """
    if columns_log2 < LEAST_COLUMNS_LOG2:
        raise ValueError(
            f"2^{columns_log2} columns are too few for an honest error: at least 2^{LEAST_COLUMNS_LOG2}"
        )
    _check_box(solid)
    seeds = np.random.SeedSequence(seed).spawn(_RANDOMISATIONS)
    samples = [_sampled(solid, columns_log2, np.random.default_rng(child)) for child in seeds]
    moments = np.array([sample.chords + sample.overlooked for sample in samples])
    if not (moments[:, 0] > 0.0).all():
        raise ValueError(
            f"nothing of the solid was met in the box from {solid.lower.tolist()} to {solid.upper.tolist()}; "
            "draw the box closer or take more columns"
        )
    _check_hits(samples)
    each = [MassProperties.of_moments(sample) for sample in moments]
    return Estimate(
        MassProperties.of_moments(moments.mean(axis=0)),
        float(_standard_error(np.array([sample.mass for sample in each]))),
        _standard_error(np.array([sample.centre for sample in each])),
        _standard_error(np.array([sample.inertia for sample in each])),
    )


class _Sample(NamedTuple):
    """One scrambling's integrals (10,) over the chords, and over what they overlook, with its points."""

    chords: Array
    overlooked: Array
    hits: int


def _check_hits(samples: Sequence[_Sample]) -> None:
    """Refuse an error of the mass that rests on a few points."""
    chords, overlooked = (
        np.std([part[0] for part in parts]) for parts in list(zip(*samples, strict=True))[:2]
    )
    hits = sum(sample.hits for sample in samples)
    if overlooked > chords and hits < _LEAST_HITS:
        raise ValueError(
            f"parts of the solid are thinner than the grid resolves, and only {hits} points met them: too "
            "few to state an error; draw the box closer, or write f as a distance, not as a sign"
        )


def _check_box(solid: ImplicitSolid) -> None:
    """Refuse a box that has no inside."""
    lower, upper = np.asarray(solid.lower), np.asarray(solid.upper)
    if lower.shape != (3,) or upper.shape != (3,):
        raise ValueError(f"the corners of the box must be (3,), not {lower.shape} and {upper.shape}")
    if not (np.isfinite([lower, upper]).all() and (lower < upper).all()):
        raise ValueError(f"the box from {lower.tolist()} to {upper.tolist()} has no finite inside")


def _standard_error(samples: Array) -> Array:
    """s / sqrt(n) of independent samples (n, ...) -> (...)."""
    return np.asarray(np.std(samples, axis=0, ddof=1) / math.sqrt(len(samples)))


def _sampled(solid: ImplicitSolid, columns_log2: int, rng: np.random.Generator) -> _Sample:
    """Return one scrambling's estimate of the integrals (10,) of 1, x, y, z, xx, yy, zz, xy, yz, zx."""
    unit = qmc.Sobol(3, seed=rng).random_base2(columns_log2)
    points = solid.lower + unit * (solid.upper - solid.lower)
    width, depth, height = solid.upper - solid.lower
    along, overlooked, hits = np.zeros(10), np.zeros(10), 0
    for begin in range(0, len(points), _AT_ONCE):
        batch = points[begin : begin + _AT_ONCE]
        chords = solid.chords(batch[:, :2])
        along += _along_chords(batch[:, :2], chords)
        missed, met = _overlooked(solid, batch, chords)
        overlooked += height * missed
        hits += met
    weight = width * depth / len(points)
    return _Sample(weight * along, weight * overlooked, hits)


def _along_chords(xy: Array, chords: Chords) -> Array:
    """Return the integrals along z of 1, x, y, z, xx, yy, zz, xy, yz, zx, summed over all chords: (10,)."""
    x, y = xy[chords.column].T
    z1, z2, z3 = ((chords.top**k - chords.bottom**k) / k for k in (1, 2, 3))
    integrals = [z1, x * z1, y * z1, z2, x * x * z1, y * y * z1, z3, x * y * z1, y * z2, x * z2]
    return np.sum(integrals, axis=1)


def _overlooked(solid: ImplicitSolid, points: Array, chords: Chords) -> tuple[Array, int]:
    """Return 1, x, ..., zx summed over the points in the solid but on no chord, less the reverse: (10,).

    And how many points these are.
    """
    z = points[chords.column, 2]
    on_chord = np.zeros(len(points), dtype=np.bool_)
    on_chord[chords.column[(chords.bottom <= z) & (z <= chords.top)]] = True
    sign = solid.inside(points).astype(np.float64) - on_chord
    wrong = sign != 0.0
    x, y, z = points[wrong].T
    monomials = [np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, y * z, z * x]
    return np.array(monomials) @ sign[wrong], int(wrong.sum())


_SIDE = 32
"""Points along either edge of a side of the box, in the middles of cells, when it is asked what it cuts."""


def estimate_level_set(name: str, function: Callable[[Array], Any], box: Sequence[float]) -> Estimate:
    """Estimate, at unit density, the solid f <= 0 within the box xmin, ymin, zmin, xmax, ymax, zmax, in m.

    f maps points (n, 3) to values (n,). The notes name the sides of the box that the solid reaches. Raises
    InputError with one line, which `name` begins, for a box without inside, a function that raises or gives
    anything else than n numbers, and a box that has nothing of the solid in it.
    """
    if len(box) != 6:
        raise InputError(f"{name}: its box has 6 numbers, xmin,ymin,zmin,xmax,ymax,zmax in m, not {len(box)}")
    solid = LevelSet(_guarded(name, function), np.array(box[:3]), np.array(box[3:]))
    try:
        found = estimate(solid)
        sides = ", ".join(_reached(solid))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    notes = (f"the solid reaches the sides {sides} of the box: what lies beyond is cut off",) if sides else ()
    return replace(found, properties=replace(found.properties, notes=notes))


def _guarded(name: str, function: Callable[[Array], Any]) -> Callable[[Array], Array]:
    """Return f as floats of a copy of the points, which it may change; refuse what it raises or returns."""

    def values(points: Array) -> Array:
        try:
            found = np.asarray(function(points.copy()))
        except (Exception, SystemExit) as error:
            raise InputError(f"{name}: failed for points {points.shape}: {said(error)}") from error
        if found.dtype.kind not in "iuf":
            raise InputError(
                f"{name}: f of points {points.shape} must be numbers, f <= 0 inside, not {found.dtype}"
            )
        return found.astype(np.float64)

    return values


def _reached(solid: LevelSet) -> list[str]:
    """Name the sides of the box, as 'x = 1.0', on which there are points of the solid."""
    middles = (np.arange(_SIDE) + 0.5) / _SIDE
    u, v = (grid.ravel() for grid in np.meshgrid(middles, middles))
    sides = []
    for axis, letter in enumerate("xyz"):
        for end, corner in enumerate((solid.lower, solid.upper)):
            unit = np.insert(np.column_stack([u, v]), axis, end, axis=1)
            points = solid.lower + unit * (solid.upper - solid.lower)
            points[:, axis] = corner[axis]
            if solid.inside(points).any():
                sides.append(f"{letter} = {corner[axis]}")
    return sides
