"""The user's integrator in the README's test: classical Runge-Kutta 4."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bodycheck import StepState
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_acceleration
from bodycheck.reference_impl.rotations import quaternion_product


def step(state: StepState, dt: float) -> StepState:
    """y+ = y + dt/6 (k1 + 2 k2 + 2 k3 + k4), y = (q, omega_body), without loads."""

    def rate(y: Array) -> Array:
        turn = 0.5 * quaternion_product(y[:4], np.array([0.0, *y[4:]]))
        return np.concatenate([turn, angular_acceleration(state.body.inertia, y[4:], np.zeros(3))])

    y = np.concatenate([state.quaternion, state.omega_body])
    k1 = rate(y)
    k2 = rate(y + 0.5 * dt * k1)
    k3 = rate(y + 0.5 * dt * k2)
    k4 = rate(y + dt * k3)
    y = y + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return replace(state, quaternion=y[:4], omega_body=y[4:])
