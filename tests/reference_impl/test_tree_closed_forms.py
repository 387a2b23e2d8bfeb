"""The truth of trees that have a closed form: a pendulum by elliptic functions, a gyrostat that precesses."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import asin, ellipf, ellipfun, ellipk, mp, mpf, sin, sqrt

from bodycheck.reference_impl.rotations import exp_matrix, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene
from bodycheck.reference_impl.trees.tree_truth import certified_tree
from bodycheck.scenarios.library import load_trees


def _pendulum(angle0: mpf, rate0: mpf, omega0: mpf, t: mpf) -> mpf:
    """sin(a / 2) = k sn(omega0 t + u0, k) for an angle a from the lowest position, swinging.

    Source: Lawden (1989), Elliptic Functions and Applications, section 5.1.
    """
    k2 = sin(angle0 / 2) ** 2 + (rate0 / (2 * omega0)) ** 2
    k = sqrt(k2)
    u0 = ellipf(asin(sin(angle0 / 2) / k), k2)
    if rate0 < 0:
        u0 = 2 * ellipk(k2) - u0
    return 2 * asin(k * ellipfun("sn")(omega0 * t + u0, m=k2))


def test_physical_pendulum_has_its_elliptic_functions() -> None:
    """The built-in pendulum, off centre in two directions, within the bound of its truth for 20 s."""
    ((_, tree),) = load_trees("physical-pendulum")
    scene = tree.scene
    (body,) = scene.bodies
    truth = certified_tree(scene, scene.sample_times)
    with mp.workdps(40):
        arm = [mpf(x) for x in (-body.joint.at_body).tolist()]  # from the hinge to the centre of mass
        reach2 = arm[0] ** 2 + arm[2] ** 2
        inertia = mpf(float(body.inertia[1, 1])) + mpf(body.mass) * reach2
        omega0 = sqrt(mpf(body.mass) * mpf(9.81) * sqrt(reach2) / inertia)
        offset = mp.atan2(arm[0], -arm[2])  # of the centre of mass from straight down, at coordinate 0
        start, rate = (mpf(float(part[0])) for part in (scene.q0, scene.u0))
        # turning about +y by a carries -z towards -x
        for k, t in enumerate(scene.sample_times.tolist()):
            angle = offset - _pendulum(offset - start, -rate, omega0, mpf(t))
            assert abs(mpf(float(truth.motion.q[k, 0])) - angle) <= truth.bounds["rad"][k]


@pytest.mark.parametrize("spin", [0.0, 40.0, -15.0])
def test_gyrostat_with_its_rotor_on_the_axis_precesses_at_a_constant_rate(spin: float) -> None:
    """A symmetric hull with a rotor on its axis: the axis turns about L at |L| over the transverse moment.

    Source: Hughes (1986), Spacecraft Attitude Dynamics, section 6.1.
    """
    hull = TreeBody(
        "hull",
        3.0,
        np.diag([0.2, 0.2, 0.1]),
        Joint("free", rate=np.array([0.0, 0.0, 0.0, 0.7, -0.4, 1.5])),
    )
    rotor = TreeBody("rotor", 0.5, np.diag([0.01, 0.01, 0.015]), Joint("hinge", 0, rate=np.array([spin])))
    scene = TreeScene((hull, rotor), (), np.zeros(3), 3.0, 31)
    truth = certified_tree(scene, scene.sample_times)
    omega = scene.u0[3:6]
    momentum = np.array([0.21 * omega[0], 0.21 * omega[1], 0.115 * omega[2] + 0.015 * spin])
    axes = quaternion_to_matrix(truth.motion.quaternion[:, 0])[:, :, 2]
    for axis, t in zip(axes, scene.sample_times.tolist(), strict=True):
        turned = exp_matrix(momentum * (t / 0.21)) @ np.array([0.0, 0.0, 1.0])
        assert np.max(np.abs(axis - turned)) < 1e-14
    assert np.ptp(truth.motion.u[:, 6]) < 1e-13 * max(1.0, abs(spin))
