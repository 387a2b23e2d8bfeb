"""The bodies of a batch move as each body alone, for any number of bodies and threads."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import get_args

import numba
import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.batch import WIDTH, BatchMethod, advance_batch
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.scene import RigidBody
from tests.helpers.expected_messages import ExpectedMessage

EPS = float(np.finfo(np.float64).eps)

every_method = pytest.mark.parametrize("method", get_args(BatchMethod))


def bodies(n: int, seed: int = 1) -> tuple[Array, Array, Array]:
    """Return state, moments and torques of n random bodies."""
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(13, n))
    state[9:] /= np.linalg.norm(state[9:], axis=0)
    return state, rng.uniform(1.0, 1.9, size=(3, n)), rng.normal(size=(3, n))


@pytest.mark.parametrize("n", [0, 1, 2, 7, WIDTH - 1, WIDTH, WIDTH + 1, 2 * WIDTH + 5])
@every_method
def test_each_body_moves_as_alone(method: BatchMethod, n: int) -> None:
    """Bodies under their own torques follow the single-body kernel, whatever their number."""
    state, moments, torque = bodies(n)
    alone = state.copy()
    advance_batch(state, moments, 0.02, 100, method, torque)
    for j in range(n):
        one, load = alone[:, j].copy(), np.zeros(21)
        load[6:9] = torque[:, j]
        INTEGRATORS[method].advance(one, packed_body(RigidBody(1.0, np.diag(moments[:, j]))), load, 0.02, 100)
        alone[:, j] = one
    assert np.all(np.abs(state - alone) <= 100 * 16 * EPS)


@pytest.mark.parametrize("turn", [1e-9, 0.49, 1.01, 3.0, 40.0])
def test_m1_at_any_rotation_per_step(turn: float) -> None:
    """On both sides of the switch from series to library functions, M1 follows the single-body kernel.

    turn: |omega| dt in rad, next to slow bodies in the same block.
    """
    state, moments, _ = bodies(2 * WIDTH)
    moments[:] = 1.0  # spheres: omega is constant, so that only rounding differs
    state[6:9, ::3] *= turn / 0.02 / np.linalg.norm(state[6:9, ::3], axis=0)
    alone = state.copy()
    advance_batch(state, moments, 0.02, 20, "m1")
    for j in range(2 * WIDTH):
        one = alone[:, j].copy()
        INTEGRATORS["m1"].advance(one, packed_body(RigidBody(1.0, np.eye(3))), np.zeros(21), 0.02, 20)
        alone[:, j] = one
    # omega x I omega of a sphere is eps |omega|^2 with fused products and turns a step by eps turn^2
    assert np.all(np.abs(state[9:] - alone[9:]) <= 20 * (16 + turn + turn**2) * EPS)


@every_method
def test_neighbours_do_not_matter(method: BatchMethod) -> None:
    """A body moves the same, bit for bit, at any place in the batch and with any other bodies."""
    state, moments, torque = bodies(3 * WIDTH)
    together = state.copy()
    advance_batch(together, moments, 0.02, 50, method, torque)
    order = np.random.default_rng(2).permutation(3 * WIDTH)[: WIDTH + 9]
    some = np.ascontiguousarray(state[:, order])
    advance_batch(some, moments[:, order], 0.02, 50, method, torque[:, order])
    assert np.array_equal(some, together[:, order])


@every_method
def test_number_of_threads_does_not_matter(method: BatchMethod) -> None:
    """One thread and all threads give the same bits, and the setting is restored."""
    before, results = numba.get_num_threads(), []
    try:
        for threads in sorted({1, numba.config.NUMBA_NUM_THREADS}):
            numba.set_num_threads(threads)
            state, moments, torque = bodies(5 * WIDTH + 3)
            advance_batch(state, moments, 0.02, 50, method, torque)
            assert numba.get_num_threads() == threads
            results.append(state)
    finally:
        numba.set_num_threads(before)
    assert all(np.array_equal(result, results[0]) for result in results)


@every_method
def test_threads_of_the_caller_do_not_matter(method: BatchMethod) -> None:
    """Two batches stepped at the same time by two threads of the caller move as if stepped in sequence."""
    alone, moments, torque = bodies(3 * WIDTH)
    together = [alone.copy() for _ in range(4)]
    advance_batch(alone, moments, 0.02, 50, method, torque)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda one: advance_batch(one, moments, 0.02, 50, method, torque), together))
    assert all(np.array_equal(one, alone) for one in together)


@every_method
def test_steps_may_be_made_in_any_portions(method: BatchMethod) -> None:
    """advance(30) twice is advance(60), q and omega to the last bit; advance(0) does nothing."""
    whole, moments, torque = bodies(11)
    halves = whole.copy()
    before = whole.copy()
    advance_batch(whole, moments, 0.02, 0, method, torque)
    assert np.array_equal(whole, before)
    advance_batch(whole, moments, 0.02, 60, method, torque)
    for _ in range(2):
        advance_batch(halves, moments, 0.02, 30, method, torque)
    assert np.array_equal(whole[3:], halves[3:])
    assert np.max(np.abs(whole[:3] - halves[:3])) <= 16 * EPS


@every_method
def test_no_torque_equals_zero_torque(method: BatchMethod) -> None:
    """Free bodies equal those under a zero torque bit for bit, and velocities are constant."""
    free, moments, _ = bodies(9)
    with_zero_torque, start = free.copy(), free.copy()
    advance_batch(free, moments, 0.02, 20, method)
    advance_batch(with_zero_torque, moments, 0.02, 20, method, np.zeros((3, 9)))
    assert np.array_equal(free, with_zero_torque)
    assert np.array_equal(free[3:6], start[3:6])
    assert np.max(np.abs(free[0:3] - start[0:3] - 0.4 * start[3:6])) <= 8 * EPS


def test_order_eight_follows_the_closed_form() -> None:
    """After ten seconds of 500 steps the bodies agree with Jacobi's elliptic functions."""
    state, moments, _ = bodies(20, seed=3)
    start = state.copy()
    advance_batch(state, moments, 0.02, 500, "dop853")
    for j in range(20):
        exact = FreeRotation.from_state(np.diag(moments[:, j]), start[9:, j], start[6:9, j])
        quaternion, omega = exact.at(np.array([10.0]))
        assert geodesic_angle(state[9:, j], quaternion[0]) <= 1e-12
        assert np.max(np.abs(state[6:9, j] - omega[0])) <= 1e-12


def test_flat_and_thin_bodies_are_bodies() -> None:
    """A plate, whose largest moment is the sum of the others up to rounding, and a needle can be stepped."""
    state, _, _ = bodies(3)
    moments = np.array([[0.1, 1.0, 1e-9], [0.2, 2.0, 1.0], [0.1 + 0.2, 3.0, 1.0]])
    advance_batch(state, moments, 0.001, 3)
    assert np.isfinite(state).all()


# ------------------------------------------------------------------------------------------ refusals


@pytest.mark.parametrize("dt", [0.0, -0.1, math.nan, math.inf])
def test_impossible_steps_are_refused(dt: float, expected_message: ExpectedMessage) -> None:
    """A step that is not a positive number of seconds is refused with its value."""
    state, moments, _ = bodies(2)
    with expected_message.raises(ValueError):
        advance_batch(state, moments, dt, 1)


@pytest.mark.parametrize("steps", [-1, 1.5])
def test_impossible_numbers_of_steps_are_refused(steps: int, expected_message: ExpectedMessage) -> None:
    """A number of steps that is not a count is refused with its value."""
    state, moments, _ = bodies(2)
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - the whole message is compared
        advance_batch(state, moments, 0.1, steps)
    expected_message(str(refused.value))


def test_unknown_method_is_refused(expected_message: ExpectedMessage) -> None:
    """The error lists the available methods."""
    state, moments, _ = bodies(2)
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - the whole message is compared
        advance_batch(state, moments, 0.1, 1, "euler")  # type: ignore[arg-type]
    expected_message(str(refused.value))


def test_wrong_shapes_are_refused(expected_message: ExpectedMessage) -> None:
    """Arrays of another shape than (13, n) and (3, n) are refused with their shape."""
    state, moments, torque = bodies(4)
    with expected_message.raises(ValueError):
        advance_batch(np.ascontiguousarray(state.T), moments, 0.1, 1)
    with expected_message.raises(ValueError):
        advance_batch(state[:, 0], moments, 0.1, 1)
    with expected_message.raises(ValueError):
        advance_batch(state, moments[:, :3], 0.1, 1)
    with expected_message.raises(ValueError):
        advance_batch(state, moments, 0.1, 1, torque=torque[:, :1])


def test_state_that_cannot_be_stepped_in_place_is_refused(expected_message: ExpectedMessage) -> None:
    """Single precision, another memory order and read-only arrays are refused by name."""
    state, moments, _ = bodies(4)
    frozen = state.copy()
    frozen.flags.writeable = False
    for bad in (state.astype(np.float32), np.asfortranarray(state), frozen):
        with expected_message.raises(ValueError):
            advance_batch(bad, moments, 0.1, 1)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_values_that_are_not_finite_are_refused(value: float, expected_message: ExpectedMessage) -> None:
    """NaN and infinity are refused with their row and body, before anything moves."""
    for name in ("state", "moments", "torque"):
        arrays = dict(zip(("state", "moments", "torque"), bodies(5), strict=True))
        arrays[name][1, 3] = value
        before = arrays["state"].copy()
        with expected_message.raises(ValueError):
            advance_batch(arrays["state"], arrays["moments"], 0.1, 1, torque=arrays["torque"])
        assert np.array_equal(arrays["state"], before, equal_nan=True)


@pytest.mark.parametrize("moments", [(1.0, 1.0, 0.0), (1.0, 1.0, -1.0), (1.0, 1.0, 2.1)])
def test_impossible_bodies_are_refused(
    moments: tuple[float, float, float], expected_message: ExpectedMessage
) -> None:
    """Moments that no body has are refused with the index of the body."""
    state, good, _ = bodies(5)
    good[:, 2] = moments
    with expected_message.raises(ValueError):
        advance_batch(state, good, 0.1, 1)
