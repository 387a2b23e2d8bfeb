"""Errors of the joints of a tree, from coordinates that are known to be off."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene
from bodycheck.reports.measurement.joint_errors import JointErrors, joint_errors, worst_body
from bodycheck.reports.measurement.measures import MEASURES

START = exp_quaternion(np.array([0.4, -1.0, 0.2]))


def errors(q: list[float], u: list[float]) -> JointErrors:
    """Return the errors at one time of a ball, a hinge and a slider whose truth is (START, 0.3, 0.2), 0."""
    inertia = np.eye(3)
    joints = [Joint("ball"), Joint("hinge", parent=0), Joint("slide", parent=1)]
    bodies = tuple(
        TreeBody(name, 1.0, inertia, joint) for name, joint in zip(("a", "b", "c"), joints, strict=True)
    )
    scene = TreeScene(bodies, (), np.zeros(3), 1.0, 2)
    zero = np.zeros((1, 3, 3))
    still = {"position_m": zero, "velocity_m_s": zero, "omega_body_rad_s": zero}
    still["quaternion"] = np.tile([1.0, 0.0, 0.0, 0.0], (1, 3, 1))
    truth, motion = (
        Trajectory(np.zeros(1), **still, q=np.array([own]), u=np.array([rates]))
        for own, rates in (([*START, 0.3, 0.2], [0.0] * 5), (q, u))
    )
    return joint_errors(scene, truth, motion)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_errors_are_angles_lengths_and_rates_of_each_joint(sign: float) -> None:
    """Attitudes of both signs are the same, and angles are compared modulo 2 pi."""
    turned = sign * quaternion_product(START, exp_quaternion(np.array([0.0, 3e-3, 4e-3])))
    found = errors([*turned, 0.3 + 2.0 * math.pi - 2e-3, 0.2 - 1e-4], [0.0, 3.0, 4.0, -2.0, -0.5])
    expected = {"a.q_rad": 5e-3, "a.rate_rad_s": 5.0, "b.q_rad": 2e-3, "b.rate_rad_s": 2.0}
    expected |= {"c.q_m": 1e-4, "c.rate_m_s": 0.5}
    assert {name: values[0] for name, values in found.series.items()} == {
        f"joint.{name}": pytest.approx(value, rel=1e-9) for name, value in expected.items()
    }
    assert found.angles is not None
    assert found.lengths is not None
    assert np.linalg.norm(found.angles[0, :4]) == pytest.approx(5e-3, rel=1e-5)
    assert found.angles[0, 4] == pytest.approx(-2e-3, rel=1e-9)
    assert found.lengths[0] == pytest.approx([-1e-4], rel=1e-9)
    of_all: Any = SimpleNamespace(joints=found)
    for unit, departures, largest in (("rad", found.angles, 5e-3), ("m", found.lengths, 1e-4)):
        measured = MEASURES[f"joint_error_{unit}"].over_time(of_all, departures)
        assert measured == pytest.approx([largest], rel=1e-9)


def test_the_worst_body_is_that_of_the_largest_angle_or_else_length() -> None:
    """A length in m is no larger than an angle in rad, whatever the numbers."""
    errors = {
        "a.q_rad": [1e-3, 0.0],
        "b.q_rad": [0.0, 2e-3],
        "c.q_m": [5.0],
        "d.q_m": [6.0],
        "d.rate_m_s": [9.0],
    }
    series = {f"joint.{name}": np.array(values) for name, values in errors.items()}
    assert worst_body(series) == "b"
    assert worst_body({name: values for name, values in series.items() if "q_rad" not in name}) == "d"
    assert worst_body({}) is None
