"""A sample of `python tools/truth_trials.py`: random motions compared with fifty digits."""

from __future__ import annotations

import numpy as np
import pytest

from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.truth.certification import solve_truth
from tests.helpers.random_motions import FORCED, exact_motion, far_scene, free_scene, ratios, truth_scene

SAMPLE = {
    **{f"free {seed}": ("free", *free_scene(seed)) for seed in range(6)},
    **{f"far {seed}": ("far", *far_scene(seed)) for seed in range(3)},
    **{
        f"{kind} {seed}": (kind, FORCED[kind][1](seed), [0.0, 0.7])
        for kind in ("torques and forces", "fixed axis", "drag")
        for seed in range(2)
    },
}


@pytest.mark.slow
@pytest.mark.nightly(after=6)
@pytest.mark.parametrize("name", SAMPLE)
def test_random_motion_lies_within_its_bounds(name: str) -> None:
    """Attitude, omega, position and velocity are within their bounds of an independent solution."""
    kind, scene, times = SAMPLE[name]
    assert isinstance(scene, Scene)
    truth = solve_truth(truth_scene(kind, scene), np.array(times))
    found, errors = ratios(truth, exact_motion(kind, scene, times))
    assert np.all(found <= 1.0), errors
