"""Estimates of implicit solids compared with closed forms, and the reliability of their standard errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bodycheck.scenarios.level_sets import Estimate, estimate
from bodycheck.scenarios.mass_properties.implicit import (
    ImplicitEllipsoid,
    ImplicitSolid,
    ImplicitTorus,
    LevelSet,
)
from bodycheck.scenarios.mass_properties.solid import MassProperties, primitive
from tests.helpers.expected_messages import ExpectedMessage

UPRIGHT = ImplicitTorus(1.0, 0.4)


def lying(points: Any) -> Any:
    """Return f of the torus about x, whose columns along z meet it once or twice."""
    return (np.hypot(points[:, 1], points[:, 2]) - 1.0) ** 2 + points[:, 0] ** 2 - 0.16


def jumping(points: Any) -> Any:
    """Return the sign of the same f, which cannot be interpolated."""
    return np.where(lying(points) <= 0.0, -1.0, 1.0)


def lying_torus(cells: int = 32, function: Any = lying) -> LevelSet:
    """Return that torus with a grid of this many cells per column."""
    return LevelSet(function, UPRIGHT.lower[::-1], UPRIGHT.upper[::-1], cells)


def plate(thickness: float) -> LevelSet:
    """Return a distance to a tilted plate of 1 m^2 in a cube of 2 m, thinner than a cell of its grid."""

    def distance(p: Any) -> Any:
        across = np.abs(0.6 * p[:, 0] + 0.8 * p[:, 2]) - 0.5 * thickness
        return np.maximum(across, np.maximum(np.abs(0.8 * p[:, 0] - 0.6 * p[:, 2]), np.abs(p[:, 1])) - 0.5)

    return LevelSet(distance, np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0]), 16)


TORUS = primitive("torus", [1.0, 0.4])
TILT = np.array([[0.6, 0.0, -0.8], [0.0, 1.0, 0.0], [0.8, 0.0, 0.6]])
LYING = MassProperties(TORUS.mass, TORUS.centre, TORUS.inertia[::-1, ::-1])
CASES: dict[str, tuple[ImplicitSolid, MassProperties]] = {
    "torus": (UPRIGHT, TORUS),
    "ellipsoid": (ImplicitEllipsoid(1.0, 0.7, 0.4), primitive("ellipsoid", [1.0, 0.7, 0.4])),
    "level set": (lying_torus(), LYING),
    "level set that jumps": (lying_torus(function=jumping), LYING),
    "level set on a grid too coarse": (lying_torus(cells=3, function=jumping), LYING),
    "thin plate": (plate(1e-3), primitive("box", [1e-3, 1.0, 1.0]).rotated(TILT)),
}


def deviations(found: Estimate, truth: MassProperties) -> Any:
    """Return the errors over their standard errors, except for numbers that are only round-off."""
    errors = np.concatenate(
        [
            [found.properties.mass - truth.mass],
            found.properties.centre - truth.centre,
            (found.properties.inertia - truth.inertia)[np.triu_indices(3)],
        ]
    )
    standard = np.concatenate(
        [[found.mass_error], found.centre_error, found.inertia_error[np.triu_indices(3)]]
    )
    known = standard > 1e-14
    assert np.all(np.abs(errors[~known]) < 1e-14)
    return errors[known] / standard[known]


@pytest.mark.parametrize("case", CASES)
def test_estimates_are_within_four_standard_errors(case: str) -> None:
    """Mass, centre and inertia are each within 4 standard errors of the closed form."""
    solid, truth = CASES[case]
    assert np.all(np.abs(deviations(estimate(solid, columns_log2=10), truth)) < 4.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        *("torus", "ellipsoid"),
        *(
            pytest.param(case, marks=pytest.mark.nightly)
            for case in ("level set on a grid too coarse", "thin plate")
        ),
    ],
)
def test_standard_errors_match_the_scatter(case: str) -> None:
    """Over 40 seeds the mass is within 2 standard errors in 85 to 100 %, and they equal its scatter."""
    solid, truth = CASES[case]
    found = [estimate(solid, columns_log2=10, seed=seed) for seed in range(40)]
    deviation = np.array([(one.properties.mass - truth.mass) / one.mass_error for one in found])
    assert 0.85 <= np.mean(np.abs(deviation) < 2.0) <= 1.0
    assert 0.7 < np.std(deviation) < 1.4
    assert abs(np.mean(deviation)) < 4.0 / np.sqrt(40)


@pytest.mark.parametrize(("case", "least"), [("torus", 0.9), ("ellipsoid", 0.9)])
def test_standard_errors_converge_faster_than_monte_carlo(case: str, least: float) -> None:
    """From 2^10 to 2^15 columns the errors decrease with the power -0.9 of their number, or faster."""
    solid, _ = CASES[case]
    coarse, fine = (estimate(solid, columns_log2=n) for n in (10, 15))
    assert np.log2(coarse.mass_error / fine.mass_error) / 5.0 > least
    assert np.log2(coarse.inertia_error[2, 2] / fine.inertia_error[2, 2]) / 5.0 > least


def test_coarse_grid_increases_the_standard_error() -> None:
    """If the chords miss parts, the estimate stays correct and its standard error increases."""
    missing, right = (estimate(lying_torus(cells, jumping), columns_log2=10) for cells in (3, 32))
    assert missing.mass_error > 3.0 * right.mass_error


@pytest.mark.parametrize("thickness", [0.05, 1e-3, 1e-6])
def test_walls_thinner_than_the_grid_are_found(thickness: float) -> None:
    """The chords find a wall within one cell, so that its relative error is that of any other wall."""
    found = estimate(plate(thickness), columns_log2=10)
    assert abs(found.properties.mass - thickness) < 4.0 * found.mass_error < 0.02 * thickness


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["walls", "gaps"])
def test_two_thin_walls_next_to_a_grid_point_are_found(sign: float) -> None:
    """A column that grazes a shell meets it twice between the neighbours of one grid point."""
    corner = np.ones(3)
    solid = LevelSet(lambda p: sign * (np.abs(np.abs(p[:, 2]) - 0.05) - 1e-4), -corner, corner, 16)
    found = solid.chords(np.zeros((1, 2)))
    length = float(np.sum(found.top - found.bottom))
    assert length == pytest.approx(4e-4 if sign > 0.0 else 2.0 - 4e-4, rel=1e-9, abs=0.0)


@pytest.mark.slow
def test_gaps_thinner_than_the_grid_are_found() -> None:
    """A slit of a thousandth of a block reduces its mass by that amount, within 2 %."""
    thin = plate(1e-3)

    def block(p: Any) -> Any:
        return np.maximum(np.max(np.abs(p), axis=1) - 0.9, -np.asarray(thin.function(p)))

    found = estimate(LevelSet(block, thin.lower, thin.upper, 16), columns_log2=10)
    solid = estimate(
        LevelSet(lambda p: np.max(np.abs(p), axis=1) - 0.9, thin.lower, thin.upper, 16), columns_log2=10
    )
    assert solid.properties.mass - found.properties.mass == pytest.approx(1e-3, rel=0.02, abs=0.0)


def test_estimate_from_a_few_points_is_refused(expected_message: ExpectedMessage) -> None:
    """A wall given only by a sign, so thin that about ten points meet it, is refused."""
    thin = plate(1e-3)
    sign = LevelSet(
        lambda p: np.where(np.asarray(thin.function(p)) <= 0.0, -1.0, 1.0), thin.lower, thin.upper, 16
    )
    with expected_message.raises(ValueError):
        estimate(sign, columns_log2=10)


@pytest.mark.parametrize("columns_log2", [0, 7, 9])
def test_too_few_columns_are_refused(columns_log2: int, expected_message: ExpectedMessage) -> None:
    """Below 2^10 columns the intervals are unreliable, so nothing is estimated."""
    with expected_message.raises(ValueError):
        estimate(UPRIGHT, columns_log2=columns_log2)


def test_intervals_are_those_of_students_t() -> None:
    """The half-width of a 95 % interval is 2.0395 standard errors: 31 degrees of freedom."""
    found = estimate(UPRIGHT, columns_log2=10)
    half = found.half_widths()
    assert half.mass == pytest.approx(2.039513 * found.mass_error, rel=1e-6, abs=0.0)
    assert half.inertia == pytest.approx(2.039513 * found.inertia_error, rel=1e-6, abs=1e-15)


def test_box_cuts_the_solid_off() -> None:
    """Half a ball remains if the box ends at its equator."""
    ball = LevelSet(
        lambda p: np.sum(p * p, axis=1) - 1.0, np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.0]), 16
    )
    found = estimate(ball, columns_log2=10)
    assert abs(found.properties.mass - 2.0 / 3.0 * np.pi) < 4.0 * found.mass_error
    assert abs(found.properties.centre[2] - 3.0 / 8.0) < 4.0 * found.centre_error[2]


def test_same_seed_gives_the_same_numbers() -> None:
    """The same seed repeats an estimate bit for bit, and another seed gives another one."""
    one, again, other = (estimate(UPRIGHT, columns_log2=10, seed=seed) for seed in (1, 1, 2))
    assert one.properties.mass == again.properties.mass != other.properties.mass


BOX = (np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0]))


@pytest.mark.parametrize(
    "solid",
    [
        LevelSet(lambda p: np.ones(len(p)), *BOX),
        LevelSet(lambda p: np.full(len(p), np.nan), *BOX),
        LevelSet(lambda p: p, *BOX),
        LevelSet(lambda p: p[:, 0], BOX[1], BOX[0]),
        LevelSet(lambda p: p[:, 0], BOX[0] * np.nan, BOX[1]),
        LevelSet(lambda p: p[:, 0], BOX[0][:2], BOX[1]),
        ImplicitTorus(1.0, -0.4),
    ],
    ids=[
        "empty",
        "not a number",
        "wrong shape",
        "inside out",
        "nan corner",
        "two coordinates",
        "negative radius",
    ],
)
def test_impossible_solids_are_refused(solid: ImplicitSolid, expected_message: ExpectedMessage) -> None:
    """An empty solid, a box without interior and a function that does not return numbers are refused."""
    with pytest.raises(ValueError, match=r".") as caught:
        estimate(solid, columns_log2=10)
    expected_message(str(caught.value))
