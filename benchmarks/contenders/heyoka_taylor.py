"""heyoka's adaptive Taylor method, scalar, compiled for the body and the load (Biscani and Izzo 2021)."""

from __future__ import annotations

import math
from typing import Any

import heyoka
import numpy as np

from benchmarks.contenders.contender import Contender
from benchmarks.contenders.principal import principal_case, start_of
from benchmarks.problems import End, Problem

# Its tolerance chooses the order of the series, ceil(1 - ln(tolerance) / 2), and nothing else: one for each
# order is every setting that there is. eps is the tightest that it is made for.
_ORDERS = range(3, 20)


def _equations(problem: Problem) -> list[tuple[Any, Any]]:
    """q' = q omega / 2, I omega' = R^T tau - omega x I omega, R that of q / |q|."""
    moments, (tx, ty, tz) = principal_case(problem.scene)
    w, x, y, z = quaternion = heyoka.make_vars("w", "x", "y", "z")
    a, b, c = omega = heyoka.make_vars("a", "b", "c")
    torque: list[Any] = [0.0, 0.0, 0.0]
    if any((tx, ty, tz)):
        # |q| = 1 holds to the tolerance: the quotient by |q|^2 would cost another series
        torque = [
            (1.0 - 2.0 * (y * y + z * z)) * tx + 2.0 * ((x * y + w * z) * ty + (x * z - w * y) * tz),
            (1.0 - 2.0 * (x * x + z * z)) * ty + 2.0 * ((x * y - w * z) * tx + (y * z + w * x) * tz),
            (1.0 - 2.0 * (x * x + y * y)) * tz + 2.0 * ((x * z + w * y) * tx + (y * z - w * x) * ty),
        ]
    i1, i2, i3 = moments
    spins = [((i2 - i3) / i1) * b * c, ((i3 - i1) / i2) * c * a, ((i1 - i2) / i3) * a * b]
    quaternion_rate = [
        -0.5 * (x * a + y * b + z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
    ]
    angular_acceleration = [spin + tau / i for spin, tau, i in zip(spins, torque, moments, strict=True)]
    return list(zip([*quaternion, *omega], [*quaternion_rate, *angular_acceleration], strict=True))


class _Propagation:
    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._start, self._until = start_of(problem.scene), problem.scene.duration_s
        self._integrator = heyoka.taylor_adaptive(
            _equations(problem), self._start, tol=tolerance, high_accuracy=False, compact_mode=False
        )

    def reset(self) -> None:
        """Set state and time back."""
        self._integrator.state[:] = self._start
        self._integrator.time = 0.0

    def run(self) -> None:
        """Propagate to the end."""
        self._integrator.propagate_until(self._until)

    def end(self) -> End:
        """Copy the state."""
        state = np.array(self._integrator.state)
        return state[:4], state[4:]


def heyoka_taylor() -> Contender:
    """Tune the tolerance, which is to tune the order."""
    settings = tuple(math.exp(-2.0 * (order - 1)) for order in _ORDERS)
    return Contender("heyoka Taylor", heyoka.__version__, "tolerance", settings, _Propagation)
