"""Free rotation and Jacobi's functions compared with numbers that other projects publish."""

from __future__ import annotations

import math
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from bodycheck.reference_impl import elliptic
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.rotations import rotate
from tests.helpers.expected_messages import ExpectedMessage

IDENTITY = [1.0, 0.0, 0.0, 0.0]


def free(moments: Any, momentum: Any, quaternion: Any = IDENTITY) -> FreeRotation:
    """Return the motion for principal moments and an angular momentum in body axes."""
    return FreeRotation.from_state(np.diag(moments), quaternion, np.array(momentum) / np.array(moments))


def test_detest_b5() -> None:
    """DETEST B5 (Hull et al. 1972, after Krogh): Euler's equations with I3 = 0, as Jacobi's functions.

    y1' = y2 y3, y2' = -y1 y3, y3' = -0.51 y1 y2 from (0, 1, 1) is sn, cn, dn with m = 0.51.
    """
    expected = (-0.9396570798729192, -0.3421177754000779, 0.7414126596199957)
    assert elliptic.jacobi(20.0, 0.49) == pytest.approx(expected, rel=0.0, abs=1e-13)


def test_detest_b5_is_no_body(expected_message: ExpectedMessage) -> None:
    """No rigid body has a vanishing moment, so B5 as a body is refused."""
    with expected_message.raises(ValueError):
        FreeRotation.from_state(np.diag([1.0, 1.0, 0.0]), IDENTITY, [0.0, 1.0, 1.0])


def test_principia_dzhanibekov() -> None:
    """Principia, physics/euler_solver_test.cpp, the Dzhanibekov effect: quarter period and omega at 100 s."""
    rotation = free([3.0, 5.0, 9.0], [0.0, 2.0, 0.01])
    assert rotation.quarter_period_s == pytest.approx(29.527721761596436, rel=1e-12, abs=0.0)
    expected = (0.0696980876099254, 0.394497096218929, 0.0284758108573114)
    assert rotation.at([100.0])[1][0] == pytest.approx(expected, rel=0.0, abs=1e-12)


TIMES = np.linspace(0.0, 5.0, 51)
OBLATE = -14.0 / 9.0 * TIMES
PROLATE = 14.0 / 9.0 * TIMES


@pytest.mark.parametrize(
    ("moments", "first", "expected"),
    [
        ([3.0, 3.0, 9.0], [0.0, 5.0, 7.0], [5.0 * np.sin(OBLATE), 5.0 * np.cos(OBLATE), 7.0 + 0.0 * TIMES]),
        ([3.0, 9.0, 9.0], [7.0, 0.0, 5.0], [7.0 + 0.0 * TIMES, 5.0 * np.sin(PROLATE), 5.0 * np.cos(PROLATE)]),
    ],
    ids=["oblate", "prolate"],
)
def test_principia_symmetric_tops(moments: list[float], first: list[float], expected: list[Array]) -> None:
    """Principia, physics/euler_solver_test.cpp, symmetric tops: the momentum turns uniformly, to 100 ulp."""
    momentum = free(moments, first).at(TIMES)[1] * np.array(moments)
    hundred_ulp = 100.0 * np.spacing(np.linalg.norm(first))
    assert np.abs(momentum - np.stack(expected, axis=1)).max() <= hundred_ulp


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_orekit_torque_free(order: tuple[int, int, int]) -> None:
    """Orekit, TorqueFreeTest: the momentum keeps its direction in the world to 1.6e-15 rad, in any axes."""
    moments = np.array([3.0 / 8.0, 1.0 / 2.0, 5.0 / 8.0])[list(order)]
    omega = np.array([0.05, 0.0, 0.04])[list(order)]
    attitude = np.array([0.9, 0.437, 0.0, 0.0]) / math.hypot(0.9, 0.437)
    times = np.linspace(-40.0, 40.0, 801)
    quaternion, found = FreeRotation.from_state(np.diag(moments), attitude, omega).at(times)
    momentum = rotate(quaternion, found * moments)
    first = rotate(attitude, omega * moments)
    sine = np.linalg.norm(np.cross(momentum, first), axis=1) / np.linalg.norm(first) ** 2
    assert np.arcsin(sine).max() <= 1.6e-15


@pytest.mark.parametrize(
    ("moments", "omega", "t_s", "expected"),
    [
        (
            [0.2, 0.5, 0.4],
            [0.7, -0.5, 0.9],
            0.2,
            (0.656101451048804, -0.449861413387142, 0.948312358296295),
        ),
        (
            [0.7, 1.0, 1.2],
            [8.0, -4.0, 6.0],
            1.0,
            (5.21216613578143962, 8.96985603578859326, -1.94186543009897352),
        ),
    ],
    ids=["Newton test_torque_free_precession", "DART bm_free_body_energy.cpp"],
)
def test_omega(moments: Any, omega: Any, t_s: float, expected: tuple[float, ...]) -> None:
    """Free bodies of Newton and DART have the omega of their own tests and benchmarks to 1e-13."""
    found = FreeRotation.from_state(np.diag(moments), IDENTITY, omega).at([t_s])[1][0]
    assert found == pytest.approx(expected, rel=1e-13, abs=0.0)


def test_basilisk() -> None:
    """Basilisk, test_spacecraft.py, SCTransAndRotation: modified Rodrigues parameters at 10 s, to 1e-9."""
    rotation = FreeRotation.from_state(np.diag([500.0, 200.0, 300.0]), IDENTITY, [0.5, -0.4, 0.7])
    w, *vector = rotation.at([10.0])[0][0]
    sign = 1.0 if w >= 0.0 else -1.0  # the shorter of the two sets
    found = sign * np.array(vector) / (1.0 + abs(w))
    assert found == pytest.approx((0.373034285, -0.00239564413, 0.208570797), rel=0.0, abs=1e-9)
