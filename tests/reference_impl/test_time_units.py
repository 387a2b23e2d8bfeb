"""Truths of the same motion in other units of time, and of motions that no truth can follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reference_impl.scene import RigidBody, Scene, State, Torque
from bodycheck.reference_impl.truth import certification
from bodycheck.reference_impl.truth.certification import certified_truth, solve_truth
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage

TORQUE = Scene(
    RigidBody(1.0, np.diag([1.0, 2.0, 2.5])),
    State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.6, 0.1, 0.2])),
    (Torque("body", np.array([0.01, 0.0, 0.02])),),
    np.zeros(3),
    duration_s=10.0,
    samples=6,
)
"""Slow enough that the series of its fast copies overflow in seconds."""


def scaled(scene: Scene, exponent: int) -> Scene:
    """Return the same motion, 2^exponent times as slow."""
    found = scene.in_time_unit(-exponent)
    assert found is not None
    return found


@pytest.mark.parametrize("exponent", [-40, -31, -21, 33, 40])
def test_a_motion_in_another_unit_of_time_has_the_same_attitudes(exponent: int) -> None:
    """Attitudes, omega and bounds are equal to the last bit."""
    one = solve_truth(TORQUE, TORQUE.sample_times)
    other = solve_truth(scaled(TORQUE, exponent), np.ldexp(TORQUE.sample_times, exponent))
    assert other.kind == "certified"
    np.testing.assert_array_equal(other.trajectory.attitude, one.trajectory.attitude)
    np.testing.assert_array_equal(np.ldexp(other.trajectory.omega_body, exponent), one.trajectory.omega_body)
    np.testing.assert_allclose(other.bound_rad, one.bound_rad, rtol=1e-3)
    np.testing.assert_allclose(np.ldexp(other.bound_omega_rad_s, exponent), one.bound_omega_rad_s, rtol=1e-3)
    np.testing.assert_array_equal(other.trajectory.t_s, np.ldexp(TORQUE.sample_times, exponent))


def test_position_velocity_and_horizon_are_in_seconds() -> None:
    """A thruster and gravity, 2^30 times as fast."""
    scene = load_scenario("powered-flight").scene
    one = solve_truth(scene, scene.sample_times)
    other = solve_truth(scaled(scene, -30), np.ldexp(scene.sample_times, -30))
    np.testing.assert_array_equal(other.trajectory.position_m, one.trajectory.position_m)
    np.testing.assert_array_equal(np.ldexp(other.trajectory.velocity_m_s, -30), one.trajectory.velocity_m_s)
    np.testing.assert_allclose(other.bound_m, one.bound_m, rtol=1e-3)
    assert other.trusted_until_s == one.trusted_until_s == np.inf


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["heavy-top", "sine-torque", "spring-pendulum", "satellite-libration",
                                  "detumbling", "torsion-spring", "probe", "compass"])  # fmt: skip
@pytest.mark.parametrize("exponent", [-40, -30, 30, 40])
def test_every_load_is_the_same_in_another_unit_of_time(name: str, exponent: int) -> None:
    """Attitudes, omega and positions of the built-in scenes are equal to the last bit."""
    scene = load_scenario(name).scene
    times = scene.sample_times[:: max(1, scene.samples // 10)]
    one = solve_truth(scene, times).trajectory
    other = solve_truth(scaled(scene, exponent), np.ldexp(times, exponent)).trajectory
    np.testing.assert_array_equal(other.attitude, one.attitude)
    np.testing.assert_array_equal(np.ldexp(other.omega_body, exponent), one.omega_body)
    np.testing.assert_array_equal(other.position_m, one.position_m)


def test_a_slow_motion_stays_on_the_unit_sphere() -> None:
    """1e25 s of a motion at 1e-25 rad/s: in seconds the high terms of its series underflow."""
    slow = replace(scaled(TORQUE, 83), samples=2)
    truth = solve_truth(slow, slow.sample_times)
    assert abs(np.linalg.norm(truth.trajectory.attitude[-1]) - 1.0) < 1e-15


@pytest.mark.parametrize("t_s", [1e19, 1e30])
def test_a_motion_of_too_many_steps_is_refused(t_s: float, expected_message: ExpectedMessage) -> None:
    """The reason is the number of steps."""
    with expected_message.raises(ValueError):
        solve_truth(TORQUE, np.array([t_s]))


def test_a_quaternion_off_the_unit_sphere_is_refused(
    monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """Solved in seconds, both resolutions of the slow motion agree on the same wrong attitude."""
    slow = replace(scaled(TORQUE, 83), samples=2)
    monkeypatch.setattr(certification, "_units", lambda _scene, _t_s: [0])
    with expected_message.raises(ValueError):
        certified_truth(slow, slow.sample_times)
