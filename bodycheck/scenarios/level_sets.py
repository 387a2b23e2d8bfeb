"""Mass properties of solids f(x) <= 0 by randomised quasi-Monte Carlo, with their standard errors.

Columns stand at scrambled Sobol points of the xy plane and are integrated exactly along z, over the chords
given by the solid. One additional point per column, at a random height, tests whether the chords are right
there; the difference is added with the weight of a point. The chords are thus a control variate of plain
sampling in three dimensions: the estimate is unbiased even if they miss a part, and the error shows it.

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
from bodycheck.scenarios.mass_properties.implicit import Chords, ImplicitSolid, LevelSet
from bodycheck.scenarios.mass_properties.solid import MassProperties
from bodycheck.scenarios.user_functions import error_text

_RANDOMISATIONS = 32
"""Independent scramblings; the relative error of the standard error is 1 / sqrt(2 * 31) = 13 %."""

HALF_WIDTH = float(t.ppf(0.975, _RANDOMISATIONS - 1))
"""Half width of a 95 % interval in standard errors: Student's t with 31 degrees of freedom, 2.04."""

MIN_COLUMNS_LOG2 = 10
"""With fewer columns the error of a scrambling is far from normal, and intervals cover too rarely."""

_MIN_HITS = 200
"""Points over all scramblings, below which their number does not determine its own spread."""

_BATCH = 4096
"""Columns per batch, so that a level set's grid fits into the processor's cache."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mass properties at unit density, with the standard error of each number, in its unit.

    The standard errors exclude round-off, about 1e-15 of the largest numbers: a number that is zero by
    symmetry in every scrambling has a standard error of zero.
    """

    properties: MassProperties
    mass_error: float
    centre_error: Array
    inertia_error: Array

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of the properties."""
        return self.properties.notes

    def half_widths(self) -> MassProperties:
        """Return the half widths of 95 % intervals, in the fields and units of the numbers."""
        return MassProperties(
            HALF_WIDTH * self.mass_error, HALF_WIDTH * self.centre_error, HALF_WIDTH * self.inertia_error
        )

    def at_density(self, density: float) -> Estimate:
        """m = rho V, I = rho I(1): scale from unit density to a density in kg/m^3, with the standard errors.

        Raises ValueError as MassProperties.at_density does.
        """
        scaled = self.properties.at_density(density)
        return Estimate(scaled, density * self.mass_error, self.centre_error, density * self.inertia_error)


def estimate(solid: ImplicitSolid, *, columns_log2: int = 12, seed: int = 0) -> Estimate:
    """Estimate the mass properties of an implicit solid from 32 scramblings of 2^columns_log2 columns each.

    The error decreases about as the number of columns to the power -1 if the chords are right, -2/3 if they
    miss a part. The same seed gives the same numbers. Raises ValueError for fewer than 2^10 columns, for an
    empty box, if a scrambling finds no part of the solid, or if most of the error comes from parts that the
    chords miss and too few points hit to estimate it.
    """
    if columns_log2 < MIN_COLUMNS_LOG2:
        raise ValueError(
            f"2^{columns_log2} columns are too few for a reliable error: at least 2^{MIN_COLUMNS_LOG2}"
        )
    _check_box(solid)
    seeds = np.random.SeedSequence(seed).spawn(_RANDOMISATIONS)
    samples = [_sampled(solid, columns_log2, np.random.default_rng(child)) for child in seeds]
    moments = np.array([sample.chords + sample.overlooked for sample in samples])
    if not (moments[:, 0] > 0.0).all():
        raise ValueError(
            f"no part of the solid was found in the box from {solid.lower.tolist()} to "
            f"{solid.upper.tolist()}; use a tighter box or more columns"
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
    """One scrambling's integrals (10,) over the chords and over what they miss, with the number of hits."""

    chords: Array
    overlooked: Array
    hits: int


def _check_hits(samples: Sequence[_Sample]) -> None:
    """Refuse an error of the mass that is determined by a few points."""
    chords, overlooked = (
        np.std([part[0] for part in parts]) for parts in list(zip(*samples, strict=True))[:2]
    )
    hits = sum(sample.hits for sample in samples)
    if overlooked > chords and hits < _MIN_HITS:
        raise ValueError(
            f"parts of the solid are thinner than the grid resolves, and only {hits} points hit them: too "
            "few to estimate an error; use a tighter box, or return a distance from f, not a sign"
        )


def _check_box(solid: ImplicitSolid) -> None:
    """Refuse an empty box."""
    lower, upper = np.asarray(solid.lower), np.asarray(solid.upper)
    if lower.shape != (3,) or upper.shape != (3,):
        raise ValueError(f"the corners of the box must be (3,), not {lower.shape} and {upper.shape}")
    if not (np.isfinite([lower, upper]).all() and (lower < upper).all()):
        raise ValueError(f"the box from {lower.tolist()} to {upper.tolist()} is empty or not finite")


def _standard_error(samples: Array) -> Array:
    """s / sqrt(n) of independent samples (n, ...) -> (...)."""
    return np.asarray(np.std(samples, axis=0, ddof=1) / math.sqrt(len(samples)))


def _sampled(solid: ImplicitSolid, columns_log2: int, rng: np.random.Generator) -> _Sample:
    """Return one scrambling's estimate of the integrals (10,) of 1, x, y, z, xx, yy, zz, xy, yz, zx."""
    unit = qmc.Sobol(3, seed=rng).random_base2(columns_log2)
    points = solid.lower + unit * (solid.upper - solid.lower)
    width, depth, height = solid.upper - solid.lower
    along, overlooked, hits = np.zeros(10), np.zeros(10), 0
    for begin in range(0, len(points), _BATCH):
        batch = points[begin : begin + _BATCH]
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
    """Sum 1, x, ..., zx over points in the solid but on no chord, minus those on a chord but outside: (10,).

    Also return the number of these points.
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
"""Points along each edge of a side of the box, at cell centres, to test whether it cuts the solid."""


def estimate_level_set(name: str, function: Callable[[Array], Any], box: Sequence[float]) -> Estimate:
    """Estimate, at unit density, the solid f <= 0 within the box xmin, ymin, zmin, xmax, ymax, zmax, in m.

    f is called as f(points) -> values with points (n, 3) in m and values (n,). The notes name the sides of
    the box that the solid reaches. Raises InputError with one line, prefixed with `name`, for an empty box, a
    function that raises or does not return n numbers, and a box without any part of the solid.
    """
    if len(box) != 6:
        raise InputError(
            f"{name}: the box needs 6 numbers, xmin,ymin,zmin,xmax,ymax,zmax in m, not {len(box)}"
        )
    solid = LevelSet(_guarded(name, function), np.array(box[:3]), np.array(box[3:]))
    try:
        found = estimate(solid)
        sides = ", ".join(_sides_reached(solid))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    notes = (f"the solid reaches the sides {sides} of the box and is cut off there",) if sides else ()
    return replace(found, properties=replace(found.properties, notes=notes))


def _guarded(name: str, function: Callable[[Array], Any]) -> Callable[[Array], Array]:
    """Return f with float values (n,) and a copy of its points; turn its errors into InputError."""

    def values(points: Array) -> Array:
        try:
            found = np.asarray(function(points.copy()))
        except (Exception, SystemExit) as error:
            raise InputError(f"{name}: failed for points {points.shape}: {error_text(error)}") from error
        if found.dtype.kind not in "iuf":
            raise InputError(
                f"{name}: f(points) for points {points.shape} must return numbers, not {found.dtype}"
            )
        return found.astype(np.float64)

    return values


def _sides_reached(solid: LevelSet) -> list[str]:
    """Return the sides of the box, like 'x = 1.0', on which there are points of the solid."""
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
