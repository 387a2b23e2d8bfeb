"""Mass properties of moved, rotated and scaled bodies."""

from __future__ import annotations

import numpy as np
import pytest

from bodycheck.reference_impl.dynamics import inertia_of_points
from bodycheck.reference_impl.rotations import exp_matrix
from bodycheck.scenarios.mass_properties.solid import MassProperties
from tests.helpers.expected_messages import ExpectedMessage

POINTS = np.random.default_rng(1).normal(size=(20, 3))
MASSES = np.random.default_rng(2).uniform(0.1, 1.0, size=20)
X, Y, Z = POINTS.T
CLOUD = MassProperties.of_moments(
    np.array([np.ones(20), X, Y, Z, X * X, Y * Y, Z * Z, X * Y, Y * Z, Z * X]) @ MASSES
)


def test_moments_give_the_inertia_of_points() -> None:
    """Centre and inertia from first and second moments equal sums over the points."""
    centre = MASSES @ POINTS / MASSES.sum()
    assert pytest.approx(centre, rel=1e-14, abs=0.0) == CLOUD.centre
    assert pytest.approx(inertia_of_points(MASSES, POINTS - centre), rel=1e-13, abs=0.0) == CLOUD.inertia


def test_inertia_about_another_point_is_huygens_steiner() -> None:
    """The parallel-axis theorem (Huygens-Steiner) gives the inertia of the points about that point."""
    point = np.array([1.0, -2.0, 3.0])
    assert CLOUD.inertia_about(point) == pytest.approx(
        inertia_of_points(MASSES, POINTS - point), rel=1e-13, abs=0.0
    )


def test_moving_and_rotating_equals_that_of_the_points() -> None:
    """Moving and then rotating a solid gives the properties of the moved and rotated points."""
    rotation, displacement = exp_matrix(np.array([0.4, -1.0, 2.0])), np.array([3.0, 4.0, 5.0])
    posed = CLOUD.translated(displacement).rotated(rotation)
    points = (POINTS + displacement) @ rotation.T
    assert posed.centre == pytest.approx(MASSES @ points / MASSES.sum(), rel=1e-14, abs=0.0)
    assert posed.inertia == pytest.approx(
        inertia_of_points(MASSES, points - posed.centre), rel=1e-12, abs=0.0
    )
    assert np.array_equal(posed.inertia, posed.inertia.T)


def test_density_scales_mass_and_inertia() -> None:
    """Twice the density gives twice the mass and inertia and the same centre."""
    heavy = CLOUD.at_density(2.0)
    assert heavy.mass == 2.0 * CLOUD.mass
    assert np.array_equal(heavy.inertia, 2.0 * CLOUD.inertia)
    assert np.array_equal(heavy.centre, CLOUD.centre)


@pytest.mark.parametrize("density", [0.0, -1.0, np.nan, np.inf])
def test_an_impossible_density_is_refused(density: float, expected_message: ExpectedMessage) -> None:
    """A density that is not positive and finite is refused by name."""
    with expected_message.raises(ValueError):
        CLOUD.at_density(density)


@pytest.mark.parametrize("density", [1e-310, 1.7e308])
def test_density_beyond_double_precision_is_refused(
    density: float, expected_message: ExpectedMessage
) -> None:
    """If mass or moments would be infinite or lose digits, the message gives their values."""
    with expected_message.raises(ValueError):
        CLOUD.at_density(density)


def test_principal_axes_diagonalise() -> None:
    """A diag(J) A^T is the inertia, with A a rotation and J ascending."""
    moments, axes = CLOUD.principal()
    assert axes @ np.diag(moments) @ axes.T == pytest.approx(CLOUD.inertia, rel=1e-13, abs=0.0)
    assert np.linalg.det(axes) == pytest.approx(1.0, rel=1e-14, abs=0.0)
    assert list(moments) == sorted(moments)
