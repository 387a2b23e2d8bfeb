"""Exact derivatives of a rotation by its principal moments and its first omega, also with a term missing."""

from __future__ import annotations

from functools import cache

import numpy as np

from bodycheck.adapters.gradients import PARAMETERS
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import wrench_between

TERMS = (
    "d omega x I omega",
    "omega x I d omega",
    "omega x dI omega",
    "dI omega'",
    "the turn of the torque",
    "d omega in d theta/dt",
    "omega x d theta",
)
"""The terms of the variational equations, of which the first five are of d omega/dt."""
_SAME = 1e-13


@cache
def sensitivity(scene: Scene, missing: str = "") -> Array:
    """(6, 6) at the end: theta (R exp([theta]x)) and omega in body axes, by moments and first omega.

    I d omega' = -d omega x I omega - omega x I d omega - omega x dI omega - dI omega' + tau x theta,
    theta' = d omega - omega x theta, with tau the constant torque of the world in body axes; solved by
    DOP853 together with the motion. missing: one of TERMS that is left out. The body axes are principal.
    Relative error: about 1e-12.
    """
    from scipy.integrate import solve_ivp

    moments, wrench = np.diag(scene.body.inertia), wrench_between(scene, 0.0, scene.duration_s)
    start = scene.initial
    kept = [float(term != missing) for term in TERMS]
    by_moment = np.zeros((3, PARAMETERS))
    by_moment[:, :3] = np.eye(3)  # dI omega = by_moment * omega

    def slope(_: float, y: Array) -> Array:
        q, omega, theta, d_omega = y[:4], y[4:7], y[7:25].reshape(3, 6), y[25:].reshape(3, 6)
        torque = quaternion_to_matrix(q).T @ wrench.torque_world
        rate = (torque + wrench.torque_body - np.cross(omega, moments * omega)) / moments
        w, momentum = omega[:, None], (moments * omega)[:, None]
        terms = (
            -_cross(d_omega, momentum),
            -_cross(w, moments[:, None] * d_omega),
            -_cross(w, by_moment * w),
            -by_moment * rate[:, None],
            _cross(torque[:, None], theta),
        )
        turn = (d_omega, -_cross(w, theta))
        by_time = sum(keep * term for keep, term in zip(kept[:5], terms, strict=True)) / moments[:, None]
        d_theta = sum(keep * term for keep, term in zip(kept[5:], turn, strict=True))
        x = omega / 2.0
        d_q = np.array([-q[1:] @ x, *(q[0] * x + np.cross(q[1:], x))])
        return np.concatenate([d_q, rate, np.ravel(d_theta), np.ravel(by_time)])

    first = np.zeros((3, PARAMETERS))
    first[:, 3:] = np.eye(3)
    y = np.concatenate([start.quaternion, start.omega_body, np.zeros(18), first.ravel()])
    solved = solve_ivp(slope, (0.0, scene.duration_s), y, method="DOP853", rtol=_SAME, atol=_SAME)
    return np.asarray(solved.y[7:, -1].reshape(6, 6))


def _cross(a: Array, b: Array) -> Array:
    return np.cross(a, b, axis=0)
