"""The closed form of the reference as a method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.adapters.contract import read_back_mismatch
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.scene import ConstantLoad, Drag, PointForce, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.truth.certification import solve_truth
from tests.helpers.expected_messages import ExpectedMessage

START = State(
    np.array([3.0, -2.0, 1.0]), np.array([0.5, 0.5, -0.5, 0.5]), np.ones(3), np.array([0.0, 2.0, 0.0])
)
TOP = Scene(RigidBody(1.3, np.diag([1.0, 2.0, 2.5])), START, (), np.array([0.0, 0.0, -9.81]), 2.0, 21)
PULSE = Torque("body", np.array([0.0, -3.0, 0.0]), 0.33, 1.4)
PUSH = PointForce("world", np.array([1.0, 0.5, 0.0]), np.zeros(3), 0.7)


@pytest.mark.parametrize(
    "loads",
    [(), (PULSE, PUSH), (Drag(0.1, 0.5 * TOP.body.inertia), PUSH)],
    ids=["free", "pulse and push", "drag"],
)
def test_closed_form_equals_the_exact_truth(loads: tuple[ConstantLoad, ...]) -> None:
    """The method reads back the scene, and its samples equal those of the exact truth."""
    scene, reference = replace(TOP, loads=loads), Reference()
    assert reference.unsupported(scene, "exact") is None
    solver = reference.solver(scene, "exact", None)
    assert read_back_mismatch(scene, None, solver.read_back()) is None
    found, truth = solver.solve(), solve_truth(scene, scene.sample_times)
    assert truth.kind == "exact"
    np.testing.assert_array_equal(found.attitude, truth.trajectory.attitude)
    np.testing.assert_array_equal(found.omega_body, truth.trajectory.omega_body)
    np.testing.assert_array_equal(found.position_m, truth.trajectory.position_m)


def test_scene_without_closed_form_is_unsupported(expected_message: ExpectedMessage) -> None:
    """A torque across the spin has no closed form, so the method states the reason and refuses to build."""
    scene, reference = replace(TOP, loads=(Torque("body", np.ones(3)),)), Reference()
    assert "no closed form" in str(reference.unsupported(scene, "exact"))
    assert reference.unsupported(scene, "taylor") is None
    with expected_message.raises(ValueError):
        reference.solver(scene, "exact", None)
