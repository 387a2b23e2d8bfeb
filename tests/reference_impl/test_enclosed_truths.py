"""Truths lie within their bounds of rigorous enclosures; tools/truth_trials.py --enclosed tries hundreds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reference_impl.truth.certification import solve_truth
from tests.helpers.random_motions import FORCED, free_scene

pytest.importorskip("flint")
from tests.helpers.ball_arithmetic import BITS, ENCLOSED, enclosures, largest_ratios, short_times

TIMES = [0.0, 0.3, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_free_truth_is_within_its_bound_of_the_enclosure(seed: int) -> None:
    """The largest possible distance from the enclosed motion is at most the stated bound."""
    scene, times = free_scene(seed)
    times = short_times(scene, times)
    assert largest_ratios(solve_truth(scene, np.array(times)), enclosures(scene, times)).max() <= 1.0


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["drag", "fixed axis", "torques and forces"])
def test_forced_truth_is_within_its_bound_of_the_enclosure(kind: str) -> None:
    """The same under loads; the others are left to the trials."""
    scene = FORCED[kind][1](0)
    found = largest_ratios(solve_truth(scene, np.array(TIMES)), enclosures(scene, TIMES))
    assert found.max() <= 1.0


@pytest.mark.slow
def test_enclosure_detects_a_truth_outside_its_bound() -> None:
    """A bound that is too small by 1e6 is exceeded: the enclosure is much narrower than the bounds."""
    scene, times = free_scene(2)
    times = short_times(scene, times)
    enclosed = enclosures(scene, times)
    assert all(part.rad() < 1e-17 for state in enclosed for part in state)
    truth = solve_truth(scene, np.array(times))
    assert largest_ratios(replace(truth, bound_rad=truth.bound_rad * 1e-6), enclosed)[0].max() > 1.0
    moved = replace(truth.trajectory, position_m=truth.trajectory.position_m + 1e-13)
    assert largest_ratios(replace(truth, trajectory=moved), enclosed)[2].max() > 1.0
    assert 2 * np.finfo(np.float64).nmant < BITS
    assert set(ENCLOSED) < set(FORCED)
