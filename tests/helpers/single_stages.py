"""Classical Runge-Kutta 4 in float64, with one quantity of one stage rounded to float32."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bodycheck import StepState
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_acceleration
from bodycheck.reference_impl.rotations import quaternion_product
from bodycheck.reference_impl.scene import Scene

PARTS = {
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "quaternion": slice(6, 10),
    "omega_body": slice(10, 13),
}
"""The quantities of y = (x, v, q, omega)."""
STAGES = range(4)


def rk4_with_a_single_stage(
    scene: Scene, stage: int | None, part: str, *, of_rate: bool
) -> Callable[[StepState, float], StepState]:
    """Return the step of a body under gravity.

    stage, part: what is rounded; None for nothing. of_rate: the rate k of the stage, else the state at which
    it is evaluated.
    """

    def rounded(values: Array, at: int, is_rate: bool) -> Array:
        if at == stage and is_rate == of_rate:
            values = values.copy()
            values[PARTS[part]] = values[PARTS[part]].astype(np.float32)
        return values

    def step(state: StepState, dt: float) -> StepState:
        def rate(y: Array, at: int) -> Array:
            y = rounded(y, at, is_rate=False)
            turn = 0.5 * quaternion_product(y[6:10], np.array([0.0, *y[10:]]))
            spin = angular_acceleration(state.body.inertia, y[10:], np.zeros(3))
            return rounded(np.concatenate([y[3:6], scene.gravity, turn, spin]), at, is_rate=True)

        y = np.concatenate([state.position, state.velocity, state.quaternion, state.omega_body])
        k1 = rate(y, 0)
        k2 = rate(y + 0.5 * dt * k1, 1)
        k3 = rate(y + 0.5 * dt * k2, 2)
        k4 = rate(y + dt * k3, 3)
        y = y + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return replace(state, **{name: y[part] for name, part in PARTS.items()})

    return step
