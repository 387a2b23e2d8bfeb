"""The rational mass properties with which meshes are compared."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from benchmarks.exact_solid import exact_solid
from benchmarks.topics.mesh import ellipsoid_mesh
from bodycheck.scenarios.mass_properties.polyhedron import polyhedron
from bodycheck.scenarios.mass_properties.solid import MassProperties

_CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.mark.parametrize("shift", [np.zeros(3), np.array([1000.0, -0.1, 3.0])])
def test_unit_tetrahedron_has_the_textbook_values(shift: np.ndarray) -> None:
    """m = 1/6, centre 1/4, and about it I_xx = 1/80, I_xy = 1/480, exactly, wherever it lies."""
    moved = _CORNERS + shift
    exact = exact_solid(moved, _FACES)
    if not shift.any():
        assert exact.mass == Fraction(1, 6)
        assert exact.centre == (Fraction(1, 4),) * 3
        assert exact.inertia == (Fraction(1, 80),) * 3 + (Fraction(1, 480),) * 3
    assert float(exact.mass) == pytest.approx(1 / 6, rel=1e-12, abs=0.0)
    assert [float(x) for x in exact.inertia] == pytest.approx(
        [1 / 80] * 3 + [1 / 480] * 3, rel=1e-12, abs=0.0
    )


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["mass", "centre", "inertia"])
def test_wrong_solid_is_detected(fault: str) -> None:
    """A part in 10^9 in mass, centre or inertia is detected."""
    vertices, triangles = ellipsoid_mesh(1)
    right = polyhedron(vertices, triangles)
    exact = exact_solid(vertices, triangles)
    assert exact.error(right) < 1e-15
    wrong = {
        "mass": MassProperties(right.mass * (1 + 1e-9), right.centre, right.inertia),
        "centre": MassProperties(right.mass, right.centre + np.array([1e-9, 0, 0]), right.inertia),
        "inertia": MassProperties(right.mass, right.centre, right.inertia * (1 + 1e-9)),
    }[fault]
    assert 0.5e-9 < exact.error(wrong) < 4e-9


@pytest.mark.nightly
@pytest.mark.parametrize("subdivisions", [0, 1, 3])
def test_mesh_is_closed_and_converges_to_the_ellipsoid(subdivisions: int) -> None:
    """20 x 4^n triangles, each edge once in each direction, volume towards 4/3 pi a b c from below."""
    vertices, triangles = ellipsoid_mesh(subdivisions)
    assert len(triangles) == 20 * 4**subdivisions
    assert len(vertices) == len(triangles) / 2 + 2
    edges = {(a, b) for t in triangles.tolist() for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0]))}
    assert len(edges) == 3 * len(triangles)
    assert edges == {(b, a) for a, b in edges}
    ellipsoid = 4.0 / 3.0 * np.pi * 0.7 * 0.4
    deficit = 1.0 - polyhedron(vertices, triangles).mass / ellipsoid
    assert 0.0 < deficit < 0.6 * 4.0**-subdivisions
