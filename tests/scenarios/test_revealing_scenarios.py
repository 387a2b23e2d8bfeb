"""Scenarios that reveal a fault that no other scenario of the library does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.scene import Drag
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.scenarios.library import load_scenario, suites

CLAMP = 628.0
"""rad/s: 100 turns per second, a limit of omega that engines have."""


@pytest.mark.slow
def test_a_transposed_drag_matrix_changes_the_motion() -> None:
    """The attitude is off by more than 0.1 rad, which exceeds the errors of healthy methods of order 1."""
    assert "swirl-drag" in suites()["forcings"]
    scene = load_scenario("swirl-drag").scene
    (drag,) = scene.loads
    assert isinstance(drag, Drag)
    transposed = replace(scene, loads=(replace(drag, angular=drag.angular.T),))
    motions = (solve_truth(one, scene.sample_times).trajectory for one in (scene, transposed))
    assert np.max(geodesic_angle(*(motion.attitude for motion in motions))) > 0.1


def test_a_clamp_at_a_hundred_turns_per_second_acts_in_every_form() -> None:
    """At every sample a component of omega exceeds it in body axes and another one in world axes."""
    assert "fast-rotor" in suites()["standard"]
    scene = load_scenario("fast-rotor").scene
    motion = solve_truth(scene, scene.sample_times).trajectory
    for omega in (motion.omega_body, motion.omega_world):
        assert np.all(np.max(np.abs(omega), axis=1) > 1.05 * CLAMP)
