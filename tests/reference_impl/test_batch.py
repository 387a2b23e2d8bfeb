"""The bodies of a batch move as each body alone, for any number of bodies."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import get_args

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.batch import WIDTH, BatchMethod, advance_batch
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.scene import RigidBody

pytestmark = pytest.mark.slow  # they compile kernels that few others use

EPS = float(np.finfo(np.float64).eps)

every_method = pytest.mark.parametrize("method", get_args(BatchMethod))


def bodies(n: int, seed: int = 1) -> tuple[Array, Array, Array]:
    """Return state, moments and torques of n random bodies."""
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(13, n))
    state[9:] /= np.linalg.norm(state[9:], axis=0)
    return state, rng.uniform(1.0, 1.9, size=(3, n)), rng.normal(size=(3, n))


@pytest.mark.nightly(after=16)
@pytest.mark.parametrize("n", [0, 1, 2, 7, WIDTH - 1, WIDTH, WIDTH + 1, 2 * WIDTH + 5])
@every_method
def test_each_body_moves_as_alone(method: BatchMethod, n: int) -> None:
    """Bodies under their own torques follow the single-body kernel, whatever their number."""
    state, moments, torque = bodies(n)
    alone = state.copy()
    advance_batch(state, moments, torque, 0.02, 100, method)
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
    advance_batch(state, moments, np.zeros_like(moments), 0.02, 20, "m1")
    for j in range(2 * WIDTH):
        one = alone[:, j].copy()
        INTEGRATORS["m1"].advance(one, packed_body(RigidBody(1.0, np.eye(3))), np.zeros(21), 0.02, 20)
        alone[:, j] = one
    # omega x I omega of a sphere is eps |omega|^2 with fused products and turns a step by eps turn^2
    assert np.all(np.abs(state[9:] - alone[9:]) <= 20 * (16 + turn + turn**2) * EPS)


@pytest.mark.nightly(after=2)
@every_method
def test_neighbours_do_not_matter(method: BatchMethod) -> None:
    """A body moves the same, bit for bit, at any place in the batch and with any other bodies."""
    state, moments, torque = bodies(3 * WIDTH)
    together = state.copy()
    advance_batch(together, moments, torque, 0.02, 50, method)
    order = np.random.default_rng(2).permutation(3 * WIDTH)[: WIDTH + 9]
    some, *constants = (np.ascontiguousarray(array[:, order]) for array in (state, moments, torque))
    advance_batch(some, *constants, 0.02, 50, method)
    assert np.array_equal(some, together[:, order])


@pytest.mark.nightly
@every_method
def test_threads_of_the_caller_do_not_matter(method: BatchMethod) -> None:
    """Two batches stepped at the same time by two threads of the caller move as if stepped in sequence."""
    alone, moments, torque = bodies(3 * WIDTH)
    together = [alone.copy() for _ in range(4)]
    advance_batch(alone, moments, torque, 0.02, 50, method)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda one: advance_batch(one, moments, torque, 0.02, 50, method), together))
    assert all(np.array_equal(one, alone) for one in together)


@every_method
def test_steps_may_be_made_in_any_portions(method: BatchMethod) -> None:
    """advance(30) twice is advance(60), q and omega to the last bit; advance(0) does nothing."""
    whole, moments, torque = bodies(11)
    halves = whole.copy()
    before = whole.copy()
    advance_batch(whole, moments, torque, 0.02, 0, method)
    assert np.array_equal(whole, before)
    advance_batch(whole, moments, torque, 0.02, 60, method)
    for _ in range(2):
        advance_batch(halves, moments, torque, 0.02, 30, method)
    assert np.array_equal(whole[3:], halves[3:])
    assert np.max(np.abs(whole[:3] - halves[:3])) <= 16 * EPS


@every_method
def test_centre_of_mass_moves_uniformly(method: BatchMethod) -> None:
    """Velocities are constant, and positions change by v t."""
    state, moments, torque = bodies(9)
    start = state.copy()
    advance_batch(state, moments, torque, 0.02, 20, method)
    assert np.array_equal(state[3:6], start[3:6])
    assert np.max(np.abs(state[0:3] - start[0:3] - 0.4 * start[3:6])) <= 8 * EPS


def test_order_eight_follows_the_closed_form() -> None:
    """After ten seconds of 500 steps the bodies agree with Jacobi's elliptic functions."""
    state, moments, _ = bodies(20, seed=3)
    start = state.copy()
    advance_batch(state, moments, np.zeros_like(moments), 0.02, 500, "dop853")
    for j in range(20):
        exact = FreeRotation.from_state(np.diag(moments[:, j]), start[9:, j], start[6:9, j])
        quaternion, omega = exact.at(np.array([10.0]))
        assert geodesic_angle(state[9:, j], quaternion[0]) <= 1e-12
        assert np.max(np.abs(state[6:9, j] - omega[0])) <= 1e-12
