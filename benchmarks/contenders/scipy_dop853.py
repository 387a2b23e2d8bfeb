"""scipy's DOP853, with adaptive steps, on a right-hand side compiled by numba with its constants in it."""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
import scipy
from scipy.integrate import solve_ivp

from benchmarks.contenders.contender import Contender, tolerances
from benchmarks.contenders.principal import principal_case, start_of
from benchmarks.problems import End, Problem
from bodycheck.reference_impl.arrays import Array

_TIGHTEST = 2.3e-14  # solve_ivp raises a relative tolerance to 100 eps


def _right_hand_side(problem: Problem) -> Callable[[float, Array], Array]:
    (i1, i2, i3), (tx, ty, tz) = principal_case(problem.scene)
    forced = any((tx, ty, tz))

    @numba.njit(fastmath={"contract"}, error_model="numpy")
    def rates(_: float, y: Array) -> Array:
        """q' = q omega / 2, I omega' = R^T tau - omega x I omega."""
        w, x, y_, z, a, b, c = y[0], y[1], y[2], y[3], y[4], y[5], y[6]
        k1, k2, k3 = (i2 - i3) * b * c, (i3 - i1) * c * a, (i1 - i2) * a * b
        if forced:
            # |q| = 1 holds to the tolerance: no division by |q|^2
            xx, yy, zz = 2.0 * x * x, 2.0 * y_ * y_, 2.0 * z * z
            k1 += (1.0 - yy - zz) * tx + 2.0 * ((x * y_ + w * z) * ty + (x * z - w * y_) * tz)
            k2 += (1.0 - xx - zz) * ty + 2.0 * ((x * y_ - w * z) * tx + (y_ * z + w * x) * tz)
            k3 += (1.0 - xx - yy) * tz + 2.0 * ((x * z + w * y_) * tx + (y_ * z - w * x) * ty)
        return np.array(
            [
                0.5 * (-x * a - y_ * b - z * c),
                0.5 * (w * a + y_ * c - z * b),
                0.5 * (w * b + z * a - x * c),
                0.5 * (w * c + x * b - y_ * a),
                k1 / i1,
                k2 / i2,
                k3 / i3,
            ]
        )

    rates(0.0, start_of(problem.scene))
    compiled: Callable[[float, Array], Array] = rates
    return compiled


class _Integration:
    def __init__(self, problem: Problem, rates: Callable[[float, Array], Array], tolerance: float) -> None:
        self._rates, self._tolerance = rates, tolerance
        self._start, self._span = start_of(problem.scene), (0.0, problem.scene.duration_s)
        self._last = self._start

    def reset(self) -> None:
        """Do nothing: each run begins at the initial state."""

    def run(self) -> None:
        """One call of solve_ivp, without dense output."""
        solution = solve_ivp(
            self._rates, self._span, self._start, method="DOP853", rtol=self._tolerance, atol=self._tolerance
        )
        self._last = solution.y[:, -1]

    def end(self) -> End:
        """Return the last state."""
        return self._last[:4], self._last[4:]


def scipy_dop853() -> Contender:
    """Tune rtol = atol. The right-hand side is compiled once a problem."""
    compiled: dict[str, Callable[[float, Array], Array]] = {}

    def prepare(problem: Problem, tolerance: float) -> _Integration:
        if problem.name not in compiled:
            compiled[problem.name] = _right_hand_side(problem)
        return _Integration(problem, compiled[problem.name], tolerance)

    return Contender("scipy DOP853", scipy.__version__, "tolerance", tolerances(1e-1, _TIGHTEST), prepare)
