"""The distance of two motions of one scene, for any subset of quantities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reference_impl.scene import RigidBody, Scene, Spring, State
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth import motion_distance as closeness

START = State(np.ones(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.3, 1.0, 0.2]))
SPRING = Spring(np.zeros(3), np.array([0.1, -0.2, 0.3]), 5.0, 0.4)
SCENE = Scene(RigidBody(2.0, np.diag([1.0, 2.0, 2.5])), START, (SPRING,), np.array([0.0, 0.0, -9.81]), 1.0, 7)


@pytest.mark.parametrize("rows", [1, 7, 40, 1000])
def test_rounding_is_the_sum_over_all_numbers(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The distance is half an ulp in each number of a state, however many quantities are computed at once."""
    random = np.random.default_rng(3)
    motion = Trajectory(
        t_s=SCENE.sample_times,
        position_m=random.normal(size=(7, 3)),
        velocity_m_s=random.normal(size=(7, 3)),
        quaternion=random.normal(size=(7, 4)),
        omega_body_rad_s=random.normal(size=(7, 3)),
    )
    step = 2.0**-24  # representable in doubles
    expected = np.zeros((6, 7))
    for name in ("position_m", "velocity_m_s", "quaternion", "omega_body_rad_s"):
        value = getattr(motion, name)
        for column in np.eye(value.shape[1]):
            shifted = replace(motion, **{name: value * (1.0 + step * column)})
            expected += closeness.distances(SCENE, motion, shifted) * 2.0**-53 / step
    monkeypatch.setattr(closeness, "_MAX_ROWS", rows)
    assert expected.min() > 0.0
    assert closeness.rounding(SCENE, motion) == pytest.approx(expected, rel=1e-6, abs=0.0)
