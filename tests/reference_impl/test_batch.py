"""Many bodies at once move as each would alone, however many there are and whoever does the work."""

from __future__ import annotations

import math
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
def test_each_body_moves_as_it_would_alone(method: BatchMethod, n: int) -> None:
    """Whatever their number, under torques of their own, the bodies follow the single-body kernel."""
    state, moments, torque = bodies(n)
    alone = state.copy()
    advance_batch(state, moments, 0.02, 100, method, torque)
    for j in range(n):
        one, load = alone[:, j].copy(), np.zeros(21)
        load[6:9] = torque[:, j]
        INTEGRATORS[method].advance(one, packed_body(RigidBody(1.0, np.diag(moments[:, j]))), load, 0.02, 100)
        alone[:, j] = one
    assert np.all(np.abs(state - alone) <= 100 * 16 * EPS)


@every_method
def test_neighbours_do_not_matter(method: BatchMethod) -> None:
    """A body moves the same to the last bit wherever it stands and whoever stands beside it."""
    state, moments, torque = bodies(3 * WIDTH)
    together = state.copy()
    advance_batch(together, moments, 0.02, 50, method, torque)
    order = np.random.default_rng(2).permutation(3 * WIDTH)[: WIDTH + 9]
    some = np.ascontiguousarray(state[:, order])
    advance_batch(some, moments[:, order], 0.02, 50, method, torque[:, order])
    assert np.array_equal(some, together[:, order])


@every_method
def test_the_number_of_threads_does_not_matter(method: BatchMethod) -> None:
    """One thread and all threads give the same bits, and the setting is left as it was."""
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
def test_no_torque_is_a_torque_of_zero(method: BatchMethod) -> None:
    """Free bodies are those under a zero torque, to the last bit; velocities stay."""
    free, moments, _ = bodies(9)
    held, start = free.copy(), free.copy()
    advance_batch(free, moments, 0.02, 20, method)
    advance_batch(held, moments, 0.02, 20, method, np.zeros((3, 9)))
    assert np.array_equal(free, held)
    assert np.array_equal(free[3:6], start[3:6])
    assert np.max(np.abs(free[0:3] - start[0:3] - 0.4 * start[3:6])) <= 8 * EPS


def test_order_eight_follows_the_closed_form() -> None:
    """After ten seconds of 500 steps the bodies are where Jacobi's functions have them."""
    state, moments, _ = bodies(20, seed=3)
    start = state.copy()
    advance_batch(state, moments, 0.02, 500, "dop853")
    for j in range(20):
        exact = FreeRotation.from_state(np.diag(moments[:, j]), start[9:, j], start[6:9, j])
        quaternion, omega = exact.at(np.array([10.0]))
        assert geodesic_angle(state[9:, j], quaternion[0]) <= 1e-12
        assert np.max(np.abs(state[6:9, j] - omega[0])) <= 1e-12


def test_flat_and_thin_bodies_are_bodies() -> None:
    """A plate, whose largest moment is the sum of the others up to rounding, and a needle are stepped."""
    state, _, _ = bodies(3)
    moments = np.array([[0.1, 1.0, 1e-9], [0.2, 2.0, 1.0], [0.1 + 0.2, 3.0, 1.0]])
    advance_batch(state, moments, 0.001, 3)
    assert np.isfinite(state).all()


# ------------------------------------------------------------------------------------------ refusals


@pytest.mark.parametrize("dt", [0.0, -0.1, math.nan, math.inf])
def test_impossible_steps_are_refused(dt: float) -> None:
    """A step that is not a positive number of seconds is named."""
    state, moments, _ = bodies(2)
    with pytest.raises(ValueError, match=rf"dt must be .* got {dt!r}"):
        advance_batch(state, moments, dt, 1)


@pytest.mark.parametrize("steps", [-1, 1.5])
def test_impossible_numbers_of_steps_are_refused(steps: int) -> None:
    """A number of steps that is no count is named."""
    state, moments, _ = bodies(2)
    with pytest.raises(ValueError, match=rf"steps must be .* got {steps!r}"):
        advance_batch(state, moments, 0.1, steps)


def test_an_unknown_method_is_refused() -> None:
    """The methods that there are stand beside the one that there is not."""
    state, moments, _ = bodies(2)
    with pytest.raises(ValueError, match="method must be one of rk4, dop853, got 'euler'"):
        advance_batch(state, moments, 0.1, 1, "euler")  # type: ignore[arg-type]


def test_wrong_shapes_are_refused() -> None:
    """Arrays of another shape than (13, n) and (3, n) are named by the shape that they have."""
    state, moments, torque = bodies(4)
    with pytest.raises(ValueError, match=r"state must have shape \(13, n\), got \(4, 13\)"):
        advance_batch(np.ascontiguousarray(state.T), moments, 0.1, 1)
    with pytest.raises(ValueError, match=r"state must have shape \(13, n\), got \(13,\)"):
        advance_batch(state[:, 0], moments, 0.1, 1)
    with pytest.raises(ValueError, match=r"moments must have shape \(3, 4\) .* got \(3, 3\)"):
        advance_batch(state, moments[:, :3], 0.1, 1)
    with pytest.raises(ValueError, match=r"torque must have shape \(3, 4\) .* got \(3, 1\)"):
        advance_batch(state, moments, 0.1, 1, torque=torque[:, :1])


def test_a_state_that_cannot_be_stepped_in_place_is_refused() -> None:
    """Single precision, another order in memory, and what is read-only are named."""
    state, moments, _ = bodies(4)
    frozen = state.copy()
    frozen.flags.writeable = False
    for bad in (state.astype(np.float32), np.asfortranarray(state), frozen):
        with pytest.raises(ValueError, match="state must be writeable C-contiguous float64, got float"):
            advance_batch(bad, moments, 0.1, 1)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    """NaN and infinity are named with their row and their body, and nothing has moved."""
    for name in ("state", "moments", "torque"):
        arrays = dict(zip(("state", "moments", "torque"), bodies(5), strict=True))
        arrays[name][1, 3] = value
        before = arrays["state"].copy()
        with pytest.raises(ValueError, match=f"{name} must be finite, got {value} in row 1 of body 3"):
            advance_batch(arrays["state"], arrays["moments"], 0.1, 1, torque=arrays["torque"])
        assert np.array_equal(arrays["state"], before, equal_nan=True)


@pytest.mark.parametrize("moments", [(1.0, 1.0, 0.0), (1.0, 1.0, -1.0), (1.0, 1.0, 2.1)])
def test_impossible_bodies_are_refused(moments: tuple[float, float, float]) -> None:
    """Moments that no body has are named, with the body that has them."""
    state, good, _ = bodies(5)
    good[:, 2] = moments
    with pytest.raises(ValueError, match=r"no body has the principal moments \[1.0, 1.0, .*\] of body 2"):
        advance_batch(state, good, 0.1, 1)
