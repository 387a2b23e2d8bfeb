"""A body under a callback load: the same steps as the kernel for known torques, and order 8."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.callback_motion import solve_with_callback
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.rotations import (
    geodesic_angle,
    normalised,
)
from bodycheck.reference_impl.scene import RigidBody, State
from bodycheck.reference_impl.wrench import Wrench
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.textbook_motion import solved_end

EPS = float(np.finfo(np.float64).eps)

BODY = RigidBody(1.3, np.array([[1.2, 0.1, -0.2], [0.1, 1.9, 0.3], [-0.2, 0.3, 2.3]]))
START = State(
    position=np.array([0.3, -0.2, 0.1]),
    quaternion=normalised(np.array([0.5, -0.1, 0.7, 0.3])),
    velocity=np.array([0.3, 0.1, -0.2]),
    omega_body=np.array([1.9, 2.3, -1.8]),
)
AT, PULL = np.array([0.3, -0.2, 0.4]), np.array([0.7, -0.4, 1.1])
BODY_TORQUE, WORLD_TORQUE, BODY_FORCE = (
    np.array([0.9, -1.2, 0.7]),
    np.array([-0.3, 0.8, 0.2]),
    np.array([0.2, 0.5, -0.6]),
)
CONSTANT = Wrench(BODY_TORQUE, WORLD_TORQUE, BODY_FORCE, np.zeros(3), ((AT, PULL),))


def constant_wrench(_t: float, _x: Array, rotation: Array, _v: Array, _omega: Array) -> tuple[Array, Array]:
    """Return the forces and torques of CONSTANT in world axes."""
    force = rotation @ BODY_FORCE + PULL
    return force, rotation @ BODY_TORQUE + WORLD_TORQUE + np.cross(rotation @ AT, PULL)


def of_everything(
    t: float, position: Array, rotation: Array, velocity: Array, omega: Array
) -> tuple[Array, Array]:
    """Return a wrench that depends on all its arguments."""
    force = -2.0 * position - 0.3 * velocity + math.sin(3.0 * t) * rotation[:, 0]
    torque = np.array([math.sin(2.0 * t), rotation[1, 2], -0.4]) - 0.2 * omega + np.cross(position, velocity)
    return force, torque


@pytest.mark.slow
def test_steps_equal_those_of_the_kernel() -> None:
    """Under constant torques and forces the states are those of the dop853 kernel to round-off."""
    samples = np.linspace(0.0, 1.25, 6)
    found = solve_with_callback(BODY, START, constant_wrench, samples, 0.05)
    state = np.concatenate([START.position, START.velocity, START.omega_body, START.quaternion])
    load = CONSTANT.packed(BODY, np.zeros(3))
    assert found.quaternion is not None
    assert found.omega_body_rad_s is not None
    for k in range(6):
        columns = (found.position_m, found.velocity_m_s, found.omega_body_rad_s, found.quaternion)
        gap = np.concatenate([column[k] for column in columns]) - state
        assert np.max(np.abs(gap)) <= 32 * (5 * k + 1) * EPS
        INTEGRATORS["dop853"].advance(state, packed_body(BODY), load, 0.05, 5)


@pytest.mark.nightly
def test_compiled_function_gives_the_same_motion() -> None:
    """A function compiled by numba gives the same motion as its Python function."""
    compiled = numba.njit(of_everything)
    samples = np.array([0.0, 0.3, 1.0])
    plain, fast = (solve_with_callback(BODY, START, f, samples, 0.1) for f in (of_everything, compiled))
    assert np.max(np.abs(plain.position_m - fast.position_m)) <= 64 * EPS
    assert np.max(np.abs(plain.attitude - fast.attitude)) <= 64 * EPS
    assert np.max(np.abs(plain.omega_body - fast.omega_body)) <= 64 * EPS


def test_order_is_eight_for_a_wrench_of_everything() -> None:
    """The function receives time, position, attitude, velocity and omega in world axes at each stage."""
    end = solved_end(BODY, START, of_everything, 2.0)
    steps = (10, 14, 20)
    found = [solve_with_callback(BODY, START, of_everything, np.array([0.0, 2.0]), 2.0 / n) for n in steps]
    for errors in (
        [float(geodesic_angle(motion.attitude[-1], end.quaternion)) for motion in found],
        [float(np.linalg.norm(motion.position_m[-1] - end.position)) for motion in found],
    ):
        assert -np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(8.0, abs=0.5)
        assert errors[-1] <= 1e-9


def test_every_sample_is_the_end_of_a_step() -> None:
    """Samples at uneven times are reached by equal steps that are not longer than requested."""
    seen: list[float] = []

    def watching(t: float, x: Array, rotation: Array, v: Array, omega: Array) -> tuple[Array, Array]:
        seen.append(t)
        return constant_wrench(t, x, rotation, v, omega)

    samples = np.array([0.5, 0.6, 0.95])
    motion = solve_with_callback(BODY, START, watching, samples, 0.1)
    assert np.array_equal(motion.t_s, samples)
    assert np.array_equal(motion.position_m[0], START.position)
    starts = seen[::12]
    assert starts == pytest.approx([0.5, 0.6, 0.6 + 0.35 / 4, 0.6 + 0.7 / 4, 0.6 + 1.05 / 4])
    assert max(seen) <= 0.95 * (1.0 + EPS)


def test_no_samples_give_no_motion() -> None:
    """An empty list of times gives an empty trajectory, and time 0 alone gives the initial state."""
    assert solve_with_callback(BODY, START, constant_wrench, np.array([]), 0.1).position_m.shape == (0, 3)
    single = solve_with_callback(BODY, START, constant_wrench, np.array([3.0]), 0.1)
    assert np.array_equal(single.attitude[0], START.quaternion)


@pytest.mark.parametrize("dt", [0.0, -0.1, math.nan, math.inf])
def test_impossible_steps_are_refused(dt: float, expected_message: ExpectedMessage) -> None:
    """A step that is not a positive number of seconds is refused with its value."""
    with expected_message.raises(ValueError):
        solve_with_callback(BODY, START, constant_wrench, np.array([0.0, 1.0]), dt)


@pytest.mark.parametrize("times", [[0.0, 0.0], [1.0, 0.5], [0.0, math.nan], [[0.0, 1.0]]])
def test_impossible_times_are_refused(times: list[float], expected_message: ExpectedMessage) -> None:
    """Times that do not ascend are refused with their values."""
    with expected_message.raises(ValueError):
        solve_with_callback(BODY, START, constant_wrench, np.array(times), 0.1)


def test_nan_in_the_initial_state_is_refused(expected_message: ExpectedMessage) -> None:
    """NaN in the initial state is refused by name."""
    bad = State(np.array([0.0, math.nan, 0.0]), START.quaternion, START.velocity, START.omega_body)
    with expected_message.raises(ValueError):
        solve_with_callback(BODY, bad, constant_wrench, np.array([0.0, 1.0]), 0.1)


@pytest.mark.parametrize("value", [np.array([0.0, math.nan, 0.0]), np.zeros(2), np.array([math.inf, 0, 0])])
def test_result_of_the_function_is_checked(value: Array, expected_message: ExpectedMessage) -> None:
    """A force or a torque that is not three finite numbers is refused with its time."""
    for answer in ((value, np.zeros(3)), (np.zeros(3), value)):
        with expected_message.raises(ValueError):
            solve_with_callback(BODY, START, lambda *_, answer=answer: answer, np.array([0.0, 1.0]), 0.1)
