"""The loops that users write around Pinocchio's integrate, of one body and of trees."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array


class PinocchioLoops:
    """Steps of the state (q, v); subclasses set it, and give the accelerations."""

    _pin: Any
    _model: Any
    _q: Array
    _v: Array
    _dt_s: float
    _steps_made: int
    _step: Callable[[float], None]

    def advance(self, steps: int) -> None:
        """Make the steps."""
        for _ in range(steps):
            self._step(self._steps_made * self._dt_s)
            self._steps_made += 1

    def _semi_implicit(self, t_s: float) -> None:
        self._v = self._v + self._dt_s * self._acceleration(t_s, self._q, self._v)
        self._q = self._pin.integrate(self._model, self._q, self._dt_s * self._v)

    def _rk4(self, t_s: float) -> None:
        h, q, v = self._dt_s, self._q, self._v
        rates, accelerations = [v], [self._acceleration(t_s, q, v)]
        for share in (0.5, 0.5, 1.0):
            stage = self._pin.integrate(self._model, q, share * h * rates[-1])
            rates.append(v + share * h * accelerations[-1])
            accelerations.append(self._acceleration(t_s + share * h, stage, rates[-1]))
        weights = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
        self._v = v + h * (weights @ accelerations)
        self._q = self._pin.integrate(self._model, q, h * (weights @ rates))

    def _acceleration(self, t_s: float, q: Array, v: Array) -> Array:
        """Return v' at a state."""
        raise NotImplementedError
