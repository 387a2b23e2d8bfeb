"""The equations of motion with R and L in world axes, as textbooks have them, solved by SciPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import RigidBody, State

WrenchAt: TypeAlias = Callable[[float, Array, Array, Array, Array], tuple[Array, Array]]
"""(t, x, R, v, omega) -> force and torque (3,) about the centre of mass; all in world axes."""


def solved_end(body: RigidBody, start: State, wrench: WrenchAt, duration_s: float) -> State:
    """x' = v, m v' = F, R' = [omega]x R, L' = tau, by DOP853 at a relative tolerance of 1e-13."""
    inverse = np.linalg.inv(body.inertia)

    def rates(t: float, y: Array) -> Array:
        x, v, momentum, rotation = y[:3], y[3:6], y[6:9], y[9:].reshape(3, 3)
        omega = rotation @ inverse @ rotation.T @ momentum
        force, torque = wrench(t, x, rotation, v, omega)
        return np.concatenate([v, force / body.mass, torque, np.cross(omega, rotation.T).T.ravel()])

    rotation = Rotation.from_quat(start.quaternion, scalar_first=True).as_matrix()
    momentum = rotation @ body.inertia @ start.omega_body
    y0 = np.concatenate([start.position, start.velocity, momentum, rotation.ravel()])
    y = solve_ivp(rates, (0.0, duration_s), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    turn = Rotation.from_matrix(y[9:].reshape(3, 3))
    omega_body = inverse @ turn.apply(y[6:9], inverse=True)
    return State(y[:3], turn.as_quat(scalar_first=True), y[3:6], omega_body)
