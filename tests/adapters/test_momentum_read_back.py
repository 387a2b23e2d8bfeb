"""What an engine stores of omega if its state is the angular momentum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.adapters.contract import read_back_mismatch
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.rotations import exp_matrix, normalised
from bodycheck.reference_impl.scene import RigidBody, Scene, State


def needle(seed: int) -> Scene:
    """Return a body with rotated axes whose least moment is up to 1e4 times smaller than the others."""
    draw = np.random.default_rng(seed)
    axes = exp_matrix(draw.normal(size=3))
    inertia = axes @ np.diag([10.0 ** draw.uniform(-4.0, -1.0), 1.0, 1.0]) @ axes.T
    start = State(np.zeros(3), normalised(draw.normal(size=4)), np.zeros(3), draw.normal(size=3))
    return Scene(RigidBody(1.0, 0.5 * (inertia + inertia.T)), start, (), np.zeros(3), 1.0, 2)


@pytest.mark.parametrize("method", [m.name for m in INTEGRATORS.values() if m.spin == "angular_momentum"])
def test_omega_out_of_the_momentum_is_no_mismatch(method: str) -> None:
    """I^-1 (I omega) has the round-off of the condition of I; a difference of 1e-6 is still a mismatch."""
    for seed in range(30):
        scene = needle(seed)
        held = Reference().build(scene, method, 0.1).read_back()
        assert read_back_mismatch(scene, 0.1, held) is None, seed
        state = held.state
        wrong = replace(
            state,
            omega_body=None if state.omega_body is None else (1.0 + 1e-6) * state.omega_body,
            omega_world=None if state.omega_world is None else (1.0 + 1e-6) * state.omega_world,
        )
        assert "omega" in str(read_back_mismatch(scene, 0.1, replace(held, state=wrong))), seed
