"""Closed forms compared with integrals of thirty digits and with each other, and refused sizes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest

from bodycheck.scenarios.mass_properties.solid import PRIMITIVES, primitive
from tests.helpers.expected_messages import ExpectedMessage

SIZES: dict[str, list[float]] = {
    "box": [1.1, 0.7, 0.4],
    "sphere": [0.7],
    "ellipsoid": [1.1, 0.7, 0.4],
    "cylinder": [0.7, 1.9],
    "capsule": [0.7, 1.9],
    "torus": [1.3, 0.4],
}


def stacked(outer: Callable[[Any], Any], inner: Callable[[Any], Any], *ends: Any) -> list[float]:
    """Return V, I_x, I_z of rings inner(z) <= rho <= outer(z) stacked along z, to thirty digits."""

    def power(n: int) -> Any:
        return lambda z: outer(z) ** n - inner(z) ** n

    volume = mpmath.quad(lambda z: mpmath.pi * power(2)(z), ends)
    axial = mpmath.quad(lambda z: mpmath.pi / 2 * power(4)(z), ends)
    across = axial / 2 + mpmath.quad(lambda z: mpmath.pi * power(2)(z) * z**2, ends)
    return [float(volume), float(across), float(axial)]


def half_chord(radius: Any, z: Any) -> Any:
    """sqrt(r^2 - z^2)."""
    return mpmath.sqrt(max(radius**2 - z**2, 0))


def test_solids_of_revolution_match_integrals_over_rings() -> None:
    """Sphere, cylinder, capsule and torus agree with rings stacked along z to 1e-15."""
    with mpmath.workdps(30):
        radius, half, major, tube = mpmath.mpf(0.7), mpmath.mpf(1.9) / 2, mpmath.mpf(1.3), mpmath.mpf(0.4)

        def none(_: Any) -> Any:
            return mpmath.mpf(0)

        integrals = {
            "sphere": stacked(lambda z: half_chord(radius, z), none, -radius, radius),
            "cylinder": stacked(lambda _: radius, none, -half, half),
            "capsule": stacked(
                lambda z: half_chord(radius, max(abs(z) - half, 0)),
                none,
                -half - radius,
                -half,
                half,
                half + radius,
            ),
            "torus": stacked(
                lambda z: major + half_chord(tube, z), lambda z: major - half_chord(tube, z), -tube, tube
            ),
        }
    for shape, (volume, across, axial) in integrals.items():
        solid = primitive(shape, SIZES[shape])
        assert solid.mass == pytest.approx(volume, rel=1e-15, abs=0.0)
        assert np.diagonal(solid.inertia) == pytest.approx([across, across, axial], rel=1e-15, abs=0.0)


def test_box_and_ellipsoid_match_stretched_integrals() -> None:
    """The second moments of cube and ball, stretched along the axes, give the inertia to 1e-15."""
    for shape, volume, spread in (("box", 1.0, 1.0 / 12.0), ("ellipsoid", 4.0 / 3.0 * np.pi, 0.2)):
        size = np.array(SIZES[shape])
        solid = primitive(shape, SIZES[shape])
        assert solid.mass == pytest.approx(volume * np.prod(size), rel=1e-15, abs=0.0)
        second = solid.mass * spread * size**2
        assert np.diagonal(solid.inertia) == pytest.approx(second.sum() - second, rel=2e-15, abs=0.0)


def test_limits_between_shapes() -> None:
    """A sphere is an ellipsoid with equal axes, and a capsule without length equals a sphere to round-off."""
    sphere, ball = primitive("sphere", [0.7]), primitive("capsule", [0.7, 1e-300])
    assert np.array_equal(sphere.inertia, primitive("ellipsoid", [0.7] * 3).inertia)
    assert ball.inertia == pytest.approx(sphere.inertia, rel=1e-15, abs=0.0)


@pytest.mark.parametrize("shape", PRIMITIVES)
def test_every_primitive_is_a_possible_body(shape: str) -> None:
    """Mass and moments are positive, the centre is the origin, and the triangle inequality holds."""
    solid = primitive(shape, SIZES[shape])
    moments, _ = solid.principal()
    assert solid.mass > 0.0
    assert not solid.centre.any()
    assert moments[0] > 0.0
    assert moments[2] <= moments[0] + moments[1]


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ("cone", [1.0]),
        ("box", [1.0, 2.0]),
        ("sphere", [-1.0]),
        ("cylinder", [1.0, float("nan")]),
        ("capsule", [float("inf"), 1.0]),
        ("box", [1.0, 1e60, 1.0]),
        ("sphere", [1e-60]),
        ("torus", [1.0, 2.0]),
    ],
)
def test_impossible_sizes_are_refused(
    shape: str, size: list[float], expected_message: ExpectedMessage
) -> None:
    """A wrong name, number of sizes or size is refused with a message that names it."""
    with expected_message.raises(ValueError):
        primitive(shape, size)
