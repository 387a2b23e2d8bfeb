"""The truth of forced motion compared with fifty digits: springs, drag, orbits and pivots, by other formulas.

The state is R and the angular momentum in world axes, about the pivot if there is one, and position and
velocity; the method is Gauss's of twelve stages, order 24, in decimal arithmetic.
"""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, localcontext

import numpy as np
import pytest

from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.motion_distance import distances
from bodycheck.scenarios.library import load_scenario
from tests.helpers.decimal_gauss_solver import DIGITS, Oracle, decimals, dot, norm, plus, rotation_of, times
from tests.helpers.expected_messages import ExpectedMessage

CASES = {
    "lagrange-top": (0.4, 1 / 64),
    "sleeping-top/9.0": (1.0, 1 / 12),
    "sleeping-top/10.3": (1.0, 1 / 12),
    "heavy-top": (1.0, 1 / 12),
    "kovalevskaya-top": (1.0, 1 / 10),
    "torsion-spring": (1.5, 1 / 6),
    "compass": (1.5, 1 / 6),
    "satellite-libration": (8.0, 1.0),
    "self-excited": (2.0, 1 / 4),
    "detumbling": (1.5, 1 / 6),
    "swirl-drag": (1.5, 1 / 6),
    "spring-pendulum": (1.0, 1 / 10),
    "sine-torque": (1.5, 1 / 6),
    "damped-fall": (1.5, 1 / 6),
    "thruster": (1.5, 1 / 6),
    "far-from-origin": (1.5, 1 / 6),
    "off-grid-torque": (3.0, 1 / 4),
    "chaotic-top": (0.5, 1 / 20),
}
"""The time up to which forty digits follow each scene, and steps within which no load switches."""

OWN_KERNEL = {
    "detumbling",
    "swirl-drag",
    "satellite-libration",
    "sine-torque",
    "spring-pendulum",
    "torsion-spring",
}
"""Scenes whose kernels take up to 10 s to compile; test_taylor.py covers their loads at each push."""


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.nightly if name in OWN_KERNEL else ()) for name in CASES],
)
def test_truth_of_forced_motion_lies_within_its_bounds(name: str) -> None:
    """All quantities are within their bounds of fifty digits; x, v and omega agree to round-off."""
    scene, (until, step) = load_scenario(name).scene, CASES[name]
    t_s = [0.0, 0.5 * until, until]
    truth = solve_truth(scene, np.array(t_s))
    motion = truth.trajectory
    with localcontext() as context:
        context.prec = DIGITS
        oracle = Oracle(scene)
        exact = [oracle.parts(y) for y in oracle.states(t_s, step)]
        kinetic = max(oracle.energies(r, w, x, v)[0] for r, _, w, x, v in exact)
        largest = max(norm(momentum) for _, momentum, _, _, _ in exact)
        for k, (rotation, momentum, spin, position, velocity) in enumerate(exact):
            found_rotation = rotation_of(motion.attitude[k])
            found_spin, found_position, found_velocity = (
                decimals(values[k]) for values in (motion.omega_body, motion.position_m, motion.velocity_m_s)
            )
            chord = sum(
                (dot(d, d) for d in (plus(*rows, -1) for rows in zip(found_rotation, rotation, strict=True))),
                Decimal(0),
            )
            angle = (chord / 2).sqrt()  # |R - S|_F = 2 sqrt(2) sin(angle / 2)
            assert angle <= Decimal(truth.bound_rad[k])
            energy = oracle.energies(rotation, spin, position, velocity)[1]
            found_energy = oracle.energies(found_rotation, found_spin, found_position, found_velocity)[1]
            assert abs(found_energy - energy) <= Decimal(truth.bound_energy[k]) * kinetic
            found_momentum = times(found_rotation, times(oracle.inertia, found_spin))
            assert norm(plus(found_momentum, momentum, -1)) <= Decimal(truth.bound_momentum[k]) * largest
            for one, other, bound in (
                (found_spin, spin, truth.bound_omega_rad_s[k]),
                (found_position, position, truth.bound_m[k]),
                (found_velocity, velocity, truth.bound_m_s[k]),
            ):
                assert norm(plus(one, other, -1)) <= Decimal(bound)
                assert Decimal(bound) <= Decimal("4e-15") * (1 + norm(other))  # claimed for closed forms
    assert np.max(truth.bound_rad) <= 5e-15


@pytest.mark.parametrize("name", ["heavy-top", "sleeping-top/9.0"])
def test_series_of_a_pivoted_body_equals_the_truth(name: str) -> None:
    """In doubles the body rotates about its fixed pivot, and its centre of mass follows."""
    scene = load_scenario(name).scene
    truth = solve_truth(scene, scene.sample_times).trajectory
    found = TaylorMotion.of(scene, 1e-15).solve(scene.sample_times).trajectory
    assert np.max(distances(scene, truth, found)) <= 1e-12
    assert np.max(np.abs(found.position_m - truth.position_m)) <= 1e-12
    assert np.max(np.abs(found.velocity_m_s - truth.velocity_m_s)) <= 1e-11
    places = found.position_m + found.rotation_matrices @ scene.pivot
    assert np.max(np.abs(places - places[0])) <= 1e-15


def test_pivot_with_gravity_gradient_is_refused(expected_message: ExpectedMessage) -> None:
    """A body in orbit cannot have a pivot that is fixed in the world."""
    scene = replace(load_scenario("satellite-libration").scene, pivot=np.array([0.0, 0.0, 1.0]))
    with expected_message.raises(ValueError):
        solve_truth(scene, np.array([1.0]))
