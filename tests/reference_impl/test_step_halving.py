"""The truth of callback loads by step halving, compared with the certified truth of the same loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import log_quaternion, matrix_to_quaternion
from bodycheck.reference_impl.scene import CallbackLoad, PointForce, Scene, Torque
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.motion_distance import distances
from bodycheck.reference_impl.wrench import sum_of_wrenches
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage


def hidden(scene: Scene) -> Scene:
    """Return the scene with its continuous loads as one callback load."""
    wrench = sum_of_wrenches(scene.continuous_loads, replace(scene, gravity=np.zeros(3)))
    return replace(scene, loads=(*scene.piecewise_constant_loads, CallbackLoad("tests:wrench", wrench)))


NAMES = [
    "heavy-top",
    "damped-fall",
    *(
        pytest.param(name, marks=pytest.mark.nightly)  # each solver takes about 15 s to compile
        for name in ("satellite-libration", "sine-torque", "spring-pendulum", "torsion-spring")
    ),
]


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("name", NAMES)
def test_callback_load_gives_the_motion_of_its_loads(name: str) -> None:
    """Each truth is within the other's bounds, and that of the callback is certified to 1e-11."""
    scene = load_scenario(name).scene
    t_s = np.linspace(0.0, 0.2 * scene.duration_s, 6)
    open_truth, truth = solve_truth(scene, t_s), solve_truth(hidden(scene), t_s)
    assert truth.kind == "certified"
    bounds = truth.bounds
    assert np.all(distances(scene, open_truth.trajectory, truth.trajectory) <= bounds + 1e-15)
    assert np.max(bounds) <= 1e-11
    apart = np.abs(truth.trajectory.position_m - open_truth.trajectory.position_m)
    assert np.max(apart) <= 1e-12


@pytest.mark.slow
def test_switches_of_other_loads_are_met_exactly() -> None:
    """Next to a callback, a load acts exactly from its switching time between two samples."""
    pulses = (
        Torque("body", np.array([0.3, 0.0, -0.2]), 0.123, 0.777),
        PointForce("world", np.array([0.0, 1.0, 0.0]), np.array([0.2, 0.0, 0.1]), 0.5),
    )
    scene = load_scenario("detumbling").scene
    pulsed = replace(scene, loads=(*scene.loads, *pulses))
    t_s = np.array([0.0, 1.0])
    truth = solve_truth(hidden(pulsed), t_s)
    gaps = distances(pulsed, solve_truth(pulsed, t_s).trajectory, truth.trajectory)
    assert np.all(gaps[0] <= truth.bound_rad + 1e-15)
    assert truth.bound_rad[-1] <= 1e-12


@pytest.mark.nightly
def test_discontinuous_function_is_only_estimated() -> None:
    """If halved steps do not converge with order 8, the truth is not certified."""

    def bang(t: float, *_: Array) -> tuple[Array, Array]:
        sign = 1.0 if np.sin(37.0 * t) > 0.0 else -1.0
        return np.zeros(3), sign * np.array([1.0, 2.0, 0.5])

    scene = replace(load_scenario("detumbling").scene, loads=(CallbackLoad("tests:bang", bang),))
    truth = solve_truth(scene, np.array([0.0, 1.0]))
    assert truth.kind == "estimated"
    assert truth.bound_rad[-1] > 1e-10


def test_every_load_has_the_wrench_of_its_formula() -> None:
    """The torsion spring acts along the rotation vector of R R(0)^T, in world axes."""
    scene = load_scenario("torsion-spring").scene
    rotation = load_scenario("heavy-top").scene.initial.rotation
    still = (np.zeros(3), rotation, np.zeros(3), np.zeros(3))
    force, torque = sum_of_wrenches(scene.loads, scene)(0.0, *still)
    assert not force.any()
    expected = -1.5 * log_quaternion(matrix_to_quaternion(rotation @ scene.initial.rotation.T))
    assert torque == pytest.approx(expected, abs=1e-15)


def test_force_that_is_not_finite_is_refused_with_its_time(expected_message: ExpectedMessage) -> None:
    """If a function returns NaN there is no truth, and the message has the time."""
    nothing = CallbackLoad("tests:nan", lambda *_: (np.full(3, np.nan), np.zeros(3)))
    scene = replace(load_scenario("detumbling").scene, loads=(nothing,))
    with expected_message.raises(ValueError):
        solve_truth(scene, np.array([0.0, 1.0]))


def test_times_may_be_none_or_the_start_alone() -> None:
    """An empty list of times gives no rows, and time 0 gives the initial state."""
    scene = hidden(load_scenario("detumbling").scene)
    assert solve_truth(scene, np.zeros(0)).trajectory.attitude.shape == (0, 4)
    start = solve_truth(scene, np.zeros(2)).trajectory
    assert np.array_equal(start.omega_body, np.tile(scene.initial.omega_body, (2, 1)))
