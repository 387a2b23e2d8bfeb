"""The truth of a batch of free rotations is the truth of each of them."""

from __future__ import annotations

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.free_batch import FreeTruths, free_truths
from tests.helpers.expected_messages import ExpectedMessage

TIMES = np.array([0.0, 2.5, 5.0, 7.5, 10.0])


def bodies(m: int, seed: int = 4) -> tuple[Array, Array, Array]:
    """Return tensors, quaternions and angular velocities of random and of special bodies."""
    rng = np.random.default_rng(seed)
    inertia = np.zeros((m, 3, 3))
    inertia[:, range(3), range(3)] = rng.uniform(1.0, 1.9, (m, 3))
    quaternion, omega = rng.normal(size=(m, 4)), rng.normal(size=(m, 3))
    quaternion /= np.linalg.norm(quaternion, axis=1)[:, None]
    inertia[0], omega[0] = np.diag([2.0, 5.0, 6.0]), (1.0, 1.5, 1.0)  # on the separatrix
    inertia[1], omega[1] = np.diag([2.0, 5.0, 6.0]), (1.0, 1.5, 1.0 + 1e-12)
    omega[2] = (0.0, 1.3, 0.0)  # a steady rotation
    omega[3] = 0.0
    inertia[4] = np.diag([1.0, 1.0, 1.5])
    inertia[5] *= 1e-9
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia[6] = turn @ inertia[6] @ turn.T
    inertia[6] = 0.5 * (inertia[6] + inertia[6].T)
    return inertia, quaternion, omega


def one_by_one(inertia: Array, quaternion: Array, omega: Array) -> FreeTruths:
    """Return the same values from `solve_truth`, body by body."""
    found = []
    for body in range(len(inertia)):
        start = State(np.zeros(3), quaternion[body], np.zeros(3), omega[body])
        scene = Scene(RigidBody(1.0, inertia[body]), start, (), np.zeros(3), 10.0, 5)
        found.append(solve_truth(scene, TIMES))
    return FreeTruths(
        np.array([truth.trajectory.attitude for truth in found]),
        np.array([truth.trajectory.omega_body for truth in found]),
        np.array([truth.bound_rad[-1] for truth in found]),
        np.array([truth.round_off_rad[-1] for truth in found]),
    )


@pytest.mark.slow
def test_batch_of_truths_equals_single_truths() -> None:
    """Attitudes and omega equal those of solve_truth to the last bit, bounds and floors to 1e-6."""
    given = bodies(24)
    batch, single = free_truths(*given, TIMES), one_by_one(*given)
    assert np.array_equal(batch.quaternion, single.quaternion)
    assert np.array_equal(batch.omega_body, single.omega_body)
    np.testing.assert_allclose(batch.bound_rad, single.bound_rad, rtol=1e-6)
    np.testing.assert_allclose(batch.round_off_rad, single.round_off_rad, rtol=1e-6)


def test_order_and_size_of_a_batch_do_not_matter() -> None:
    """A body has the same truth at any place in any batch."""
    given = bodies(40)
    whole = free_truths(*given, TIMES)
    some = np.random.default_rng(1).permutation(40)[:9]
    part = free_truths(*(array[some] for array in given), TIMES)
    for name in ("quaternion", "omega_body", "bound_rad", "round_off_rad"):
        assert np.array_equal(getattr(part, name), getattr(whole, name)[some])


def test_no_times_are_refused(expected_message: ExpectedMessage) -> None:
    """A truth at no times is refused with the name of the argument."""
    with expected_message.raises(ValueError):
        free_truths(*bodies(7), TIMES[:0])
