"""v' = a(t) - c v, x' = v, the acceleration constant from switch to switch: in closed form, double-double."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.exponential import decay_means
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.jit import exact_kernel


@exact_kernel
def _moved(
    x: DoubleDouble,
    v: DoubleDouble,
    a: DoubleDouble,
    t: DoubleDouble,
    means: tuple[DoubleDouble, DoubleDouble, DoubleDouble],
) -> tuple[DoubleDouble, DoubleDouble]:
    """x + t (v m1 + a t m2) and v e^-ct + a t m1, with the means of the decay e^-ct."""
    decayed, mean1, mean2 = means
    gained = dd.multiply(a, t)
    way = dd.multiply(t, dd.add(dd.multiply(v, mean1), dd.multiply(gained, mean2)))
    return dd.add(x, way), dd.add(dd.multiply(v, decayed), dd.multiply(gained, mean1))


@exact_kernel
def _move(
    state: Array, acceleration: Array, decay: DoubleDouble, begin: float, end: float, goal: Array
) -> None:
    """Fill goal (2, k, 2), x and v and their high and low parts, from a state alike, accelerations (k, 2)."""
    t = dd.two_sum(end, -begin)
    means = decay_means(dd.multiply(decay, t))
    for j in range(len(acceleration)):
        a = (acceleration[j, 0], acceleration[j, 1])
        x, v = (state[0, j, 0], state[0, j, 1]), (state[1, j, 0], state[1, j, 1])
        x, v = _moved(x, v, a, t, means)
        goal[0, j, 0], goal[0, j, 1] = x
        goal[1, j, 0], goal[1, j, 1] = v


@exact_kernel
def _follow_switches(begins: Array, accelerations: Array, decay: DoubleDouble, states: Array) -> None:
    """Fill the states (p, 2, k, 2) at the begins of the pieces (p,), given the first."""
    for i in range(len(begins) - 1):
        _move(states[i], accelerations[i], decay, begins[i], begins[i + 1], states[i + 1])


@exact_kernel
def _follow(
    begins: Array, accelerations: Array, decay: DoubleDouble, states: Array, t_s: Array, out: Array
) -> None:
    """Fill out (n, 2, k, 2) at the times t_s (n,) >= 0."""
    for i in range(len(t_s)):
        piece = np.searchsorted(begins, t_s[i], side="right") - 1
        _move(states[piece], accelerations[piece], decay, begins[piece], t_s[i], out[i])


@dataclass(frozen=True, eq=False)
class DecayingMotion:
    """x(t) and v(t), k components each, of v' = a(t) - c v.

    Errors are some 2^-100 of the largest terms, so that rounding the results is what is left to a double.
    """

    _begins: Array
    _accelerations: Array
    _decay: DoubleDouble
    _states: Array

    @classmethod
    def of(
        cls,
        x: Sequence[DoubleDouble],
        v: Sequence[DoubleDouble],
        pieces: Sequence[tuple[float, Sequence[DoubleDouble]]],
        decay: DoubleDouble,
    ) -> DecayingMotion:
        """Set up from x and v at t = 0 and (begin, acceleration) of each piece, the first from 0 on."""
        begins = np.array([begin for begin, _ in pieces])
        accelerations = np.array([acceleration for _, acceleration in pieces], dtype=np.float64)
        states = np.empty((len(pieces), 2, len(x), 2))
        states[0] = x, v
        _follow_switches(begins, accelerations, decay, states)
        return cls(begins, accelerations, decay, states)

    @property
    def largest_rate(self) -> float:
        """The largest |v| where a piece begins; within one it lies between that of its ends."""
        return float(np.abs(self._states[:, 1, :, 0]).max())

    def errors(self, t_s: Array, rates: Array) -> tuple[Array, Array]:
        """What x and v are off by before they are rounded, (n,) and (n,): 2^-96 of the terms of each piece.

        rates: |v| at t_s (n,). No term of v exceeds twice the largest |v| until then, none of x its way.
        """
        largest = 4.0 * self._share * np.maximum(rates, self.largest_rate)
        return self._share * float(np.abs(self._states[0, 0, :, 0]).max()) + largest * t_s, largest

    @property
    def _share(self) -> float:
        return len(self._begins) * 2.0**-96

    def at(self, t_s: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Return x and v, each (n, k), high parts and low parts, at times t_s >= 0 (n,)."""
        out = np.empty((len(t_s), *self._states.shape[1:]))
        _follow(self._begins, self._accelerations, self._decay, self._states, t_s, out)
        return (out[:, 0, :, 0], out[:, 0, :, 1]), (out[:, 1, :, 0], out[:, 1, :, 1])
